// A stand-in for ROS 2's generated header: the same names, types and order of fields.
#pragma once

#include <memory>
#include <vector>

#include <geometry_msgs/msg/pose_stamped.hpp>
#include <std_msgs/msg/header.hpp>

namespace nav_msgs::msg {

struct Path {
    using SharedPtr = std::shared_ptr<Path>;
    using ConstSharedPtr = std::shared_ptr<const Path>;
    std_msgs::msg::Header header{};
    std::vector<geometry_msgs::msg::PoseStamped> poses{};
};

}  // namespace nav_msgs::msg
