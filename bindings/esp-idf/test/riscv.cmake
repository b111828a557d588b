# gcc for the processor of an IDF_TARGET.
set(CMAKE_SYSTEM_NAME Generic)
set(CMAKE_SYSTEM_PROCESSOR riscv32)
set(CMAKE_C_COMPILER riscv64-unknown-elf-gcc)
set(CMAKE_ASM_COMPILER riscv64-unknown-elf-gcc)
set(CMAKE_TRY_COMPILE_TARGET_TYPE STATIC_LIBRARY)
list(APPEND CMAKE_TRY_COMPILE_PLATFORM_VARIABLES IDF_TARGET)
# As ESP-IDF has them, but for extensions that gcc 12 has no libgcc of: zicsr and zifencei.
set(flags_esp32c3 "-march=rv32imc -mabi=ilp32")
set(flags_esp32c6 "-march=rv32imac -mabi=ilp32")
set(flags_esp32h2 "${flags_esp32c6}")
set(flags_esp32p4 "-march=rv32imafc -mabi=ilp32f")
set(CMAKE_C_FLAGS_INIT "${flags_${IDF_TARGET}} -std=gnu17 -O2 -ffreestanding -ffp-contract=off")
set(CMAKE_ASM_FLAGS_INIT "${flags_${IDF_TARGET}}")
