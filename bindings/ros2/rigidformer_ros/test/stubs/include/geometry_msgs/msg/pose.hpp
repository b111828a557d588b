// A stand-in for ROS 2's generated header: the same names, types and order of fields.
#pragma once

#include <cstdint>
#include <memory>

#include <geometry_msgs/msg/point.hpp>
#include <geometry_msgs/msg/quaternion.hpp>

namespace geometry_msgs::msg {

struct Pose {
    using SharedPtr = std::shared_ptr<Pose>;
    using ConstSharedPtr = std::shared_ptr<const Pose>;
    Point position{};
    Quaternion orientation{};
};

}  // namespace geometry_msgs::msg
