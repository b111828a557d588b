/* The recorded scene, as share/rigidformer/model.S embeds a model. */
    .section .rodata.scene, "a"
    .balign 16
    .global scene
scene:
    .incbin SCENE_FILE
