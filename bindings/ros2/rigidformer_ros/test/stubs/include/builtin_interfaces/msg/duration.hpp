// A stand-in for ROS 2's generated header: the same names, types and order of fields.
#pragma once

#include <cstdint>
#include <memory>

namespace builtin_interfaces::msg {

struct Duration {
    using SharedPtr = std::shared_ptr<Duration>;
    using ConstSharedPtr = std::shared_ptr<const Duration>;
    std::int32_t sec{};
    std::uint32_t nanosec{};
};

}  // namespace builtin_interfaces::msg
