# Links a model into a component as rf_model ... rf_model_end, aligned as rf_init asks for. For the CMakeLists.txt of a
# component that requires rigidformer: rigidformer_embed_model(${COMPONENT_LIB} nano.rfm)
set(RIGIDFORMER_COMPONENT "${CMAKE_CURRENT_LIST_DIR}" CACHE INTERNAL "Where rigidformer's component is")
function(rigidformer_embed_model target file)
    get_filename_component(file "${file}" ABSOLUTE)
    if(NOT EXISTS "${file}")
        message(FATAL_ERROR "rigidformer: there is no model ${file}. Name a packed model, .rfm")
    endif()
    set(assembly "${RIGIDFORMER_COMPONENT}/share/model.S")
    if(NOT EXISTS "${assembly}")
        set(assembly "${RIGIDFORMER_COMPONENT}/../../c/share/model.S")
    endif()
    # A copy of its own, so that several targets can have a model each.
    set(source "${CMAKE_CURRENT_BINARY_DIR}/rigidformer_model.S")
    configure_file("${assembly}" "${source}" COPYONLY)
    set_source_files_properties("${source}" PROPERTIES
        COMPILE_DEFINITIONS "RF_MODEL_FILE=\"${file}\""
        OBJECT_DEPENDS "${file}")
    target_sources("${target}" PRIVATE "${source}")
endfunction()
