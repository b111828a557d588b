// A stand-in for ROS 2's generated header: the same names, types and order of fields.
#pragma once

#include <cstdint>
#include <memory>
#include <vector>

#include <builtin_interfaces/msg/duration.hpp>
#include <geometry_msgs/msg/transform.hpp>
#include <geometry_msgs/msg/twist.hpp>

namespace trajectory_msgs::msg {

struct MultiDOFJointTrajectoryPoint {
    using SharedPtr = std::shared_ptr<MultiDOFJointTrajectoryPoint>;
    using ConstSharedPtr = std::shared_ptr<const MultiDOFJointTrajectoryPoint>;
    std::vector<geometry_msgs::msg::Transform> transforms;
    std::vector<geometry_msgs::msg::Twist> velocities;
    std::vector<geometry_msgs::msg::Twist> accelerations;
    builtin_interfaces::msg::Duration time_from_start{};
};

}  // namespace trajectory_msgs::msg
