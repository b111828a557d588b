// A stand-in for ROS 2's generated header: the same names, types and order of fields.
#pragma once

#include <cstdint>
#include <memory>

#include <geometry_msgs/msg/quaternion.hpp>
#include <geometry_msgs/msg/vector3.hpp>

namespace geometry_msgs::msg {

struct Transform {
    using SharedPtr = std::shared_ptr<Transform>;
    using ConstSharedPtr = std::shared_ptr<const Transform>;
    Vector3 translation{};
    Quaternion rotation{};
};

}  // namespace geometry_msgs::msg
