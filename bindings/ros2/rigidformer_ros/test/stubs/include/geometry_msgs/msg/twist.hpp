// A stand-in for ROS 2's generated header: the same names, types and order of fields.
#pragma once

#include <cstdint>
#include <memory>

#include <geometry_msgs/msg/vector3.hpp>

namespace geometry_msgs::msg {

struct Twist {
    using SharedPtr = std::shared_ptr<Twist>;
    using ConstSharedPtr = std::shared_ptr<const Twist>;
    Vector3 linear{};
    Vector3 angular{};
};

}  // namespace geometry_msgs::msg
