// A stand-in for ROS 2's generated header: the same names, types and order of fields.
#pragma once

#include <cstdint>
#include <memory>
#include <string>
#include <vector>

#include <std_msgs/msg/header.hpp>

namespace sensor_msgs::msg {

struct CompressedImage {
    using SharedPtr = std::shared_ptr<CompressedImage>;
    using ConstSharedPtr = std::shared_ptr<const CompressedImage>;
    std_msgs::msg::Header header{};
    std::string format{};
    std::vector<std::uint8_t> data{};
};

}  // namespace sensor_msgs::msg
