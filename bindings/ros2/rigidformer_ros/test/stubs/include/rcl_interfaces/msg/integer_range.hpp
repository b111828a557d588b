// A stand-in for ROS 2's generated header: the same names, types and order of fields.
#pragma once

#include <cstdint>
#include <memory>

namespace rcl_interfaces::msg {

struct IntegerRange {
    using SharedPtr = std::shared_ptr<IntegerRange>;
    using ConstSharedPtr = std::shared_ptr<const IntegerRange>;
    std::int64_t from_value{};
    std::int64_t to_value{};
    std::uint64_t step{};
};

}  // namespace rcl_interfaces::msg
