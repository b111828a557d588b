include("${CMAKE_CURRENT_LIST_DIR}/../package.cmake")
stub_package(nav_msgs)
