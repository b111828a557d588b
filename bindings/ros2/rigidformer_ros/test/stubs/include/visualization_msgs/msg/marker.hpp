// A stand-in for ROS 2's generated header: the same names, types and order of fields.
#pragma once

#include <cstdint>
#include <memory>
#include <string>
#include <vector>

#include <builtin_interfaces/msg/duration.hpp>
#include <geometry_msgs/msg/point.hpp>
#include <geometry_msgs/msg/pose.hpp>
#include <geometry_msgs/msg/vector3.hpp>
#include <sensor_msgs/msg/compressed_image.hpp>
#include <std_msgs/msg/color_rgba.hpp>
#include <std_msgs/msg/header.hpp>
#include <visualization_msgs/msg/mesh_file.hpp>
#include <visualization_msgs/msg/uv_coordinate.hpp>

namespace visualization_msgs::msg {

struct Marker {
    using SharedPtr = std::shared_ptr<Marker>;
    using ConstSharedPtr = std::shared_ptr<const Marker>;
    static constexpr std::int32_t ARROW = 0;
    static constexpr std::int32_t CUBE = 1;
    static constexpr std::int32_t SPHERE = 2;
    static constexpr std::int32_t CYLINDER = 3;
    static constexpr std::int32_t LINE_STRIP = 4;
    static constexpr std::int32_t LINE_LIST = 5;
    static constexpr std::int32_t CUBE_LIST = 6;
    static constexpr std::int32_t SPHERE_LIST = 7;
    static constexpr std::int32_t POINTS = 8;
    static constexpr std::int32_t TEXT_VIEW_FACING = 9;
    static constexpr std::int32_t MESH_RESOURCE = 10;
    static constexpr std::int32_t TRIANGLE_LIST = 11;
    static constexpr std::int32_t ARROW_STRIP = 12;
    static constexpr std::int32_t ADD = 0;
    static constexpr std::int32_t MODIFY = 0;
    static constexpr std::int32_t DELETE = 2;
    static constexpr std::int32_t DELETEALL = 3;
    std_msgs::msg::Header header{};
    std::string ns{};
    std::int32_t id{};
    std::int32_t type{};
    std::int32_t action{};
    geometry_msgs::msg::Pose pose{};
    geometry_msgs::msg::Vector3 scale{};
    std_msgs::msg::ColorRGBA color{};
    builtin_interfaces::msg::Duration lifetime{};
    bool frame_locked{};
    std::vector<geometry_msgs::msg::Point> points{};
    std::vector<std_msgs::msg::ColorRGBA> colors{};
    std::string texture_resource{};
    sensor_msgs::msg::CompressedImage texture{};
    std::vector<UVCoordinate> uv_coordinates{};
    std::string text{};
    std::string mesh_resource{};
    MeshFile mesh_file{};
    bool mesh_use_embedded_materials{};
};

}  // namespace visualization_msgs::msg
