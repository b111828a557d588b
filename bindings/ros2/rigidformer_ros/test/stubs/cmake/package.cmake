# What find_package() of a ROS 2 package gives: a target, and a list of them.
macro(stub_package name)
    if(NOT TARGET "${name}::${name}")
        add_library("${name}::${name}" INTERFACE IMPORTED)
        get_filename_component(stub_include "${CMAKE_CURRENT_LIST_DIR}/../../include" ABSOLUTE)
        set_target_properties("${name}::${name}" PROPERTIES
            INTERFACE_INCLUDE_DIRECTORIES "${stub_include}")
    endif()
    set("${name}_TARGETS" "${name}::${name}")
endmacro()
