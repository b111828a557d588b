// A stand-in for ROS 2's generated header: the same names, types and order of fields.
#pragma once

#include <cstdint>
#include <memory>
#include <string>

#include <builtin_interfaces/msg/time.hpp>

namespace std_msgs::msg {

struct Header {
    using SharedPtr = std::shared_ptr<Header>;
    using ConstSharedPtr = std::shared_ptr<const Header>;
    builtin_interfaces::msg::Time stamp{};
    std::string frame_id{};
};

}  // namespace std_msgs::msg
