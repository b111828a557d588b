// A stand-in for ROS 2's generated header: the same names, types and order of fields.
#pragma once

#include <cstdint>
#include <memory>
#include <string>
#include <vector>

#include <rcl_interfaces/msg/floating_point_range.hpp>
#include <rcl_interfaces/msg/integer_range.hpp>

namespace rcl_interfaces::msg {

struct ParameterDescriptor {
    using SharedPtr = std::shared_ptr<ParameterDescriptor>;
    using ConstSharedPtr = std::shared_ptr<const ParameterDescriptor>;
    std::string name{};
    std::uint8_t type{};
    std::string description{};
    std::string additional_constraints{};
    bool read_only{};
    bool dynamic_typing{};
    std::vector<FloatingPointRange> floating_point_range{};
    std::vector<IntegerRange> integer_range{};
};

}  // namespace rcl_interfaces::msg
