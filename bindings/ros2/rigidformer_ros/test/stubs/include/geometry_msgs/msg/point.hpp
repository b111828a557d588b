// A stand-in for ROS 2's generated header: the same names, types and order of fields.
#pragma once

#include <memory>

namespace geometry_msgs::msg {

struct Point {
    using SharedPtr = std::shared_ptr<Point>;
    using ConstSharedPtr = std::shared_ptr<const Point>;
    double x{};
    double y{};
    double z{};
};

}  // namespace geometry_msgs::msg
