// A stand-in for ROS 2's generated header: the same names, types and order of fields.
#pragma once

#include <array>
#include <cstdint>
#include <memory>

#include <geometry_msgs/msg/pose.hpp>

namespace geometry_msgs::msg {

struct PoseWithCovariance {
    using SharedPtr = std::shared_ptr<PoseWithCovariance>;
    using ConstSharedPtr = std::shared_ptr<const PoseWithCovariance>;
    Pose pose{};
    std::array<double, 36> covariance{};
};

}  // namespace geometry_msgs::msg
