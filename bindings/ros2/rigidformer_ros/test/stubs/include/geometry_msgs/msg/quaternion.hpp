// A stand-in for ROS 2's generated header: the same names, types and order of fields.
#pragma once

#include <memory>

namespace geometry_msgs::msg {

struct Quaternion {
    using SharedPtr = std::shared_ptr<Quaternion>;
    using ConstSharedPtr = std::shared_ptr<const Quaternion>;
    double x{};
    double y{};
    double z{};
    double w = 1;
};

}  // namespace geometry_msgs::msg
