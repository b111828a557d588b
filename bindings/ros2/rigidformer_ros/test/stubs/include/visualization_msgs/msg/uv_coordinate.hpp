// A stand-in for ROS 2's generated header: the same names, types and order of fields.
#pragma once

#include <memory>

namespace visualization_msgs::msg {

struct UVCoordinate {
    using SharedPtr = std::shared_ptr<UVCoordinate>;
    using ConstSharedPtr = std::shared_ptr<const UVCoordinate>;
    float u{};
    float v{};
};

}  // namespace visualization_msgs::msg
