/* A model in read-only memory, for GNU assemblers of any architecture:

     cc -c -DRF_MODEL_FILE='"nano.rfm"' model.S

   and in C:  extern const uint8_t rf_model[], rf_model_end[];

   -DRF_MODEL_SYMBOL=other names it other ... other_end, for a second one.
   -DRF_MODEL_SECTION=.rf_slow puts it into a section of your own, for the linker script to place.
   It is aligned to 64 bytes, more than the RF_ALIGNMENT that rf_init asks for. */
#ifndef RF_MODEL_SECTION
#define RF_MODEL_SECTION .rodata.rf_model
#endif
#ifndef RF_MODEL_SYMBOL
#define RF_MODEL_SYMBOL rf_model
#endif
#define RF_END_OF(symbol) RF_JOINED(symbol, _end)
#define RF_JOINED(a, b) a##b
    .section RF_MODEL_SECTION, "a"
    .balign 64
    .global RF_MODEL_SYMBOL
    .global RF_END_OF(RF_MODEL_SYMBOL)
RF_MODEL_SYMBOL:
    .incbin RF_MODEL_FILE
RF_END_OF(RF_MODEL_SYMBOL):
#ifdef __linux__
    .section .note.GNU-stack, "", %progbits
#endif
