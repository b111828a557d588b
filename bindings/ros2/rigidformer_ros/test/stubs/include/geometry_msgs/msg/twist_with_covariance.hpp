// A stand-in for ROS 2's generated header: the same names, types and order of fields.
#pragma once

#include <array>
#include <cstdint>
#include <memory>

#include <geometry_msgs/msg/twist.hpp>

namespace geometry_msgs::msg {

struct TwistWithCovariance {
    using SharedPtr = std::shared_ptr<TwistWithCovariance>;
    using ConstSharedPtr = std::shared_ptr<const TwistWithCovariance>;
    Twist twist{};
    std::array<double, 36> covariance{};
};

}  // namespace geometry_msgs::msg
