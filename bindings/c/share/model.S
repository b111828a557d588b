/* A model in read-only memory, for GNU assemblers of any architecture:

     cc -c -DRF_MODEL_FILE='"nano.rfm"' model.S

   and in C:  extern const uint8_t rf_model[], rf_model_end[];

   -DRF_MODEL_SECTION=.rf_slow puts it into a section of your own, for the linker script to place.
   It is aligned to 64 bytes, more than the RF_ALIGNMENT that rf_init asks for. */
#ifndef RF_MODEL_SECTION
#define RF_MODEL_SECTION .rodata.rf_model
#endif
    .section RF_MODEL_SECTION, "a"
    .balign 64
    .global rf_model
    .global rf_model_end
rf_model:
    .incbin RF_MODEL_FILE
rf_model_end:
#ifdef __linux__
    .section .note.GNU-stack, "", %progbits
#endif
