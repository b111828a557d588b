/* A model in read-only memory, for GNU assemblers of any architecture:

     cc -c -DRF_MODEL_FILE='"nano.rfm"' model.S

   and in C:  extern const uint8_t rf_model[], rf_model_end[];

   It is aligned to 64 bytes, more than the RF_ALIGNMENT that rf_init asks for. */
    .section .rodata.rf_model, "a"
    .balign 64
    .global rf_model
    .global rf_model_end
rf_model:
    .incbin RF_MODEL_FILE
rf_model_end:
#ifdef __linux__
    .section .note.GNU-stack, "", %progbits
#endif
