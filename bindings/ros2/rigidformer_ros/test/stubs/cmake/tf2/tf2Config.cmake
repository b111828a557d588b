include("${CMAKE_CURRENT_LIST_DIR}/../package.cmake")
stub_package(tf2)
