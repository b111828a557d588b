// A stand-in for ROS 2's generated header: the same names, types and order of fields.
#pragma once

#include <cstdint>
#include <memory>
#include <string>

#include <geometry_msgs/msg/transform.hpp>
#include <std_msgs/msg/header.hpp>

namespace geometry_msgs::msg {

struct TransformStamped {
    using SharedPtr = std::shared_ptr<TransformStamped>;
    using ConstSharedPtr = std::shared_ptr<const TransformStamped>;
    std_msgs::msg::Header header{};
    std::string child_frame_id;
    Transform transform{};
};

}  // namespace geometry_msgs::msg
