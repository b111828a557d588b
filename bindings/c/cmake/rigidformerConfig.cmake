# find_package(rigidformer): targets rigidformer::rigidformer (shared) and rigidformer::static, and
# rigidformer_embed_model(target file [SYMBOL name]).
get_filename_component(RIGIDFORMER_PREFIX "${CMAKE_CURRENT_LIST_DIR}/../../.." ABSOLUTE)

if(NOT TARGET rigidformer::rigidformer)
    add_library(rigidformer::rigidformer SHARED IMPORTED)
    set_target_properties(rigidformer::rigidformer PROPERTIES
        IMPORTED_LOCATION "${RIGIDFORMER_PREFIX}/lib/librigidformer.so.5"
        IMPORTED_SONAME "librigidformer.so.5"
        INTERFACE_INCLUDE_DIRECTORIES "${RIGIDFORMER_PREFIX}/include")

    find_package(Threads REQUIRED)
    add_library(rigidformer::static STATIC IMPORTED)
    set_target_properties(rigidformer::static PROPERTIES
        IMPORTED_LOCATION "${RIGIDFORMER_PREFIX}/lib/librigidformer.a"
        INTERFACE_INCLUDE_DIRECTORIES "${RIGIDFORMER_PREFIX}/include"
        # Not gcc_s, which has no static library: compilers link what unwinds by themselves.
        INTERFACE_LINK_LIBRARIES "Threads::Threads;${CMAKE_DL_LIBS};m;rt;util")
endif()

# Links a model into a target as rf_model ... rf_model_end, or as name ... name_end; the language ASM must be enabled.
function(rigidformer_embed_model target file)
    cmake_parse_arguments(PARSE_ARGV 2 model "" "SYMBOL" "")
    if(NOT model_SYMBOL)
        set(model_SYMBOL rf_model)
    endif()
    if(model_UNPARSED_ARGUMENTS OR NOT model_SYMBOL MATCHES "^[A-Za-z_][A-Za-z0-9_]*$")
        message(FATAL_ERROR "rigidformer_embed_model(${target}): write the model's file, and after it "
            "nothing or SYMBOL and a name of C")
    endif()
    get_filename_component(file "${file}" ABSOLUTE)
    if(NOT EXISTS "${file}" OR IS_DIRECTORY "${file}")
        message(FATAL_ERROR "rigidformer_embed_model(${target}): there is no model file ${file}")
    endif()
    get_property(languages GLOBAL PROPERTY ENABLED_LANGUAGES)
    list(FIND languages ASM assembler)
    if(assembler EQUAL -1)
        message(FATAL_ERROR "rigidformer_embed_model(${target}): needs the language ASM: "
            "write enable_language(ASM), or project(... LANGUAGES C ASM)")
    endif()
    # The linker would keep one of two with the same name.
    get_property(other TARGET "${target}" PROPERTY "RIGIDFORMER_MODEL_${model_SYMBOL}")
    if(other)
        message(FATAL_ERROR "rigidformer_embed_model(${target}): ${model_SYMBOL} is ${other} already; "
            "give the other model a name of its own: rigidformer_embed_model(${target} FILE SYMBOL NAME)")
    endif()
    set_property(TARGET "${target}" PROPERTY "RIGIDFORMER_MODEL_${model_SYMBOL}" "${file}")
    get_property(prefix TARGET rigidformer::rigidformer PROPERTY INTERFACE_INCLUDE_DIRECTORIES)
    set(source "${CMAKE_CURRENT_BINARY_DIR}/${target}_${model_SYMBOL}.S")
    configure_file("${prefix}/../share/rigidformer/model.S" "${source}" COPYONLY)
    # The target may be of another folder than the caller; CMake before 3.18 does not know how to say so.
    set(where)
    if(NOT CMAKE_VERSION VERSION_LESS 3.18)
        set(where TARGET_DIRECTORY "${target}")
    endif()
    set_source_files_properties("${source}" ${where} PROPERTIES
        COMPILE_DEFINITIONS "RF_MODEL_FILE=\"${file}\";RF_MODEL_SYMBOL=${model_SYMBOL}"
        OBJECT_DEPENDS "${file}")
    target_sources("${target}" PRIVATE "${source}")
endfunction()
