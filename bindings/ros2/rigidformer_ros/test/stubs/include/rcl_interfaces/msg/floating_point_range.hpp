// A stand-in for ROS 2's generated header: the same names, types and order of fields.
#pragma once

#include <memory>

namespace rcl_interfaces::msg {

struct FloatingPointRange {
    using SharedPtr = std::shared_ptr<FloatingPointRange>;
    using ConstSharedPtr = std::shared_ptr<const FloatingPointRange>;
    double from_value{};
    double to_value{};
    double step{};
};

}  // namespace rcl_interfaces::msg
