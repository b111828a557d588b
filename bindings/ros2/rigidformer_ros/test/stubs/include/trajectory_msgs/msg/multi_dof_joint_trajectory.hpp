// A stand-in for ROS 2's generated header: the same names, types and order of fields.
#pragma once

#include <cstdint>
#include <memory>
#include <string>
#include <vector>

#include <std_msgs/msg/header.hpp>
#include <trajectory_msgs/msg/multi_dof_joint_trajectory_point.hpp>

namespace trajectory_msgs::msg {

struct MultiDOFJointTrajectory {
    using SharedPtr = std::shared_ptr<MultiDOFJointTrajectory>;
    using ConstSharedPtr = std::shared_ptr<const MultiDOFJointTrajectory>;
    std_msgs::msg::Header header{};
    std::vector<std::string> joint_names;
    std::vector<MultiDOFJointTrajectoryPoint> points;
};

}  // namespace trajectory_msgs::msg
