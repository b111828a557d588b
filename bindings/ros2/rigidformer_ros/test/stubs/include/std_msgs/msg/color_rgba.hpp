// A stand-in for ROS 2's generated header: the same names, types and order of fields.
#pragma once

#include <memory>

namespace std_msgs::msg {

struct ColorRGBA {
    using SharedPtr = std::shared_ptr<ColorRGBA>;
    using ConstSharedPtr = std::shared_ptr<const ColorRGBA>;
    float r{};
    float g{};
    float b{};
    float a{};
};

}  // namespace std_msgs::msg
