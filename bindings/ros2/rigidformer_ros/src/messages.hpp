// What both nodes say to ROS alike: times, poses and descriptions of parameters.
#pragma once

#include <geometry_msgs/msg/point.hpp>
#include <geometry_msgs/msg/pose.hpp>
#include <rcl_interfaces/msg/floating_point_range.hpp>
#include <rcl_interfaces/msg/parameter_descriptor.hpp>
#include <rclcpp/rclcpp.hpp>

#include <array>
#include <cstdint>
#include <string>

#include "rigidformer_ros/predictor.hpp"

namespace rigidformer_ros {

constexpr std::int64_t SECOND_NS = 1000000000;

inline builtin_interfaces::msg::Time stamp(std::int64_t ns) {
    builtin_interfaces::msg::Time time;
    // Rounded down, as ROS has it: nanosec is never negative.
    const std::int64_t rest = (ns % SECOND_NS + SECOND_NS) % SECOND_NS;
    time.sec = static_cast<std::int32_t>((ns - rest) / SECOND_NS);
    time.nanosec = static_cast<std::uint32_t>(rest);
    return time;
}

inline std::int64_t nanoseconds(const builtin_interfaces::msg::Time &time) {
    return time.sec * SECOND_NS + time.nanosec;
}

inline geometry_msgs::msg::Point point(const std::array<double, 3> &from) {
    geometry_msgs::msg::Point point;
    point.x = from[0];
    point.y = from[1];
    point.z = from[2];
    return point;
}

inline geometry_msgs::msg::Pose to(const Pose &from) {
    geometry_msgs::msg::Pose pose;
    pose.position = point(from.position);
    pose.orientation.x = from.quaternion[0];
    pose.orientation.y = from.quaternion[1];
    pose.orientation.z = from.quaternion[2];
    pose.orientation.w = from.quaternion[3];
    return pose;
}

inline rcl_interfaces::msg::ParameterDescriptor described(const std::string &description) {
    rcl_interfaces::msg::ParameterDescriptor descriptor;
    descriptor.description = description;
    // What a node follows by is made once, when it starts.
    descriptor.read_only = true;
    return descriptor;
}

inline rcl_interfaces::msg::ParameterDescriptor ranged(const std::string &description, double from,
                                                       double to) {
    rcl_interfaces::msg::ParameterDescriptor descriptor = described(description);
    rcl_interfaces::msg::FloatingPointRange range;
    range.from_value = from;
    range.to_value = to;
    descriptor.floating_point_range.push_back(range);
    return descriptor;
}

}  // namespace rigidformer_ros
