// A stand-in for ROS 2's generated header: the same names, types and order of fields.
#pragma once

#include <memory>

namespace geometry_msgs::msg {

struct Vector3 {
    using SharedPtr = std::shared_ptr<Vector3>;
    using ConstSharedPtr = std::shared_ptr<const Vector3>;
    double x{};
    double y{};
    double z{};
};

}  // namespace geometry_msgs::msg
