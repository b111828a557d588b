// A stand-in for ROS 2's generated header: the same names, types and order of fields.
#pragma once

#include <cstdint>
#include <memory>
#include <string>

#include <geometry_msgs/msg/pose_with_covariance.hpp>
#include <geometry_msgs/msg/twist_with_covariance.hpp>
#include <std_msgs/msg/header.hpp>

namespace nav_msgs::msg {

struct Odometry {
    using SharedPtr = std::shared_ptr<Odometry>;
    using ConstSharedPtr = std::shared_ptr<const Odometry>;
    std_msgs::msg::Header header{};
    std::string child_frame_id;
    geometry_msgs::msg::PoseWithCovariance pose{};
    geometry_msgs::msg::TwistWithCovariance twist{};
};

}  // namespace nav_msgs::msg
