// A stand-in for ROS 2's generated header: the same names, types and order of fields.
#pragma once

#include <memory>

#include <geometry_msgs/msg/pose.hpp>
#include <std_msgs/msg/header.hpp>

namespace geometry_msgs::msg {

struct PoseStamped {
    using SharedPtr = std::shared_ptr<PoseStamped>;
    using ConstSharedPtr = std::shared_ptr<const PoseStamped>;
    std_msgs::msg::Header header{};
    Pose pose{};
};

}  // namespace geometry_msgs::msg
