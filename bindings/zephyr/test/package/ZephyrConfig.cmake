# Stand-ins for what find_package(Zephyr) does: Kconfig first, then a compiler for the board, then modules, and an image
# that has the application whole. On a board the image starts by the firmware example's own start-up code.
#   PYTHON: with kconfiglib; BOARD_CONF: lines that a board selects; ON_HOST: for this machine instead of a board
get_filename_component(test "${CMAKE_CURRENT_LIST_DIR}/.." REALPATH)
foreach(module ${EXTRA_ZEPHYR_MODULES})
    if(NOT EXISTS "${module}/zephyr/module.yml")
        message(FATAL_ERROR "${module} is no module: it has no zephyr/module.yml")
    endif()
endforeach()
list(LENGTH EXTRA_ZEPHYR_MODULES count)
if(NOT count EQUAL 1)
    message(FATAL_ERROR "the stand-in for Zephyr takes one module, not ${count}")
endif()
set(dotconfig "${CMAKE_BINARY_DIR}/.config")
execute_process(
    COMMAND "${CMAKE_COMMAND}" -E env "MODULE_KCONFIG=${EXTRA_ZEPHYR_MODULES}/bindings/zephyr/Kconfig"
        "${PYTHON}" "${test}/configure.py" "${test}/Kconfig" "${dotconfig}"
        "${BOARD_CONF}" "${CMAKE_CURRENT_SOURCE_DIR}/prj.conf"
    RESULT_VARIABLE failed ERROR_VARIABLE said)
if(failed)
    message(FATAL_ERROR "Kconfig: ${said}")
endif()
file(STRINGS "${dotconfig}" lines REGEX "^CONFIG_")
foreach(line ${lines})
    string(REGEX MATCH "^(CONFIG_[^=]+)=\"?([^\"]*)\"?$" matched "${line}")
    set("${CMAKE_MATCH_1}" "${CMAKE_MATCH_2}")
endforeach()

if(NOT ON_HOST)
    set(CMAKE_SYSTEM_NAME Generic)
    set(CMAKE_SYSTEM_PROCESSOR arm)
    set(CMAKE_C_COMPILER arm-none-eabi-gcc)
    set(CMAKE_ASM_COMPILER arm-none-eabi-gcc)
    set(CMAKE_TRY_COMPILE_TARGET_TYPE STATIC_LIBRARY)
    # As Zephyr has them for this processor.
    set(flags "-mcpu=cortex-m7 -mthumb -mfloat-abi=hard -mfpu=fpv5-d16")
    set(CMAKE_C_FLAGS_INIT "${flags} -ffreestanding -ffunction-sections -fdata-sections")
    set(CMAKE_ASM_FLAGS_INIT "${flags}")
endif()
project(Zephyr-Kernel LANGUAGES C ASM)
set(CMAKE_C_STANDARD 11)
# The flags by which bits are compared, and those by which nothing is overlooked.
add_compile_options(-O2 -ffp-contract=off $<$<COMPILE_LANGUAGE:C>:-Wall> $<$<COMPILE_LANGUAGE:C>:-Wextra>
    $<$<COMPILE_LANGUAGE:C>:-Werror>)

add_library(app STATIC)
target_include_directories(app PRIVATE "${test}/include")
add_subdirectory("${EXTRA_ZEPHYR_MODULES}/bindings/zephyr" modules/rigidformer)

add_executable(zephyr_final "${test}/run.c")
target_include_directories(zephyr_final PRIVATE "${test}/include" "${EXTRA_ZEPHYR_MODULES}/bindings/c/examples/firmware")
target_link_libraries(zephyr_final PRIVATE -Wl,--whole-archive app -Wl,--no-whole-archive)
if(NOT ON_HOST)
    set(firmware "${EXTRA_ZEPHYR_MODULES}/bindings/c/examples/firmware")
    target_sources(zephyr_final PRIVATE "${firmware}/board.c")
    # The application has an rf_panic of its own.
    set_source_files_properties("${firmware}/board.c" PROPERTIES COMPILE_DEFINITIONS "rf_panic=board_panic")
    target_link_options(zephyr_final PRIVATE -nostdlib -static -Wl,--gc-sections,--no-warn-rwx-segments,-z,noexecstack
        "-T${firmware}/mps2.ld" "-T${firmware}/sections.ld")
    target_link_libraries(zephyr_final PRIVATE gcc)
else()
    # What the library for Linux takes.
    target_link_libraries(rigidformer INTERFACE pthread dl m rt util)
endif()
