// A stand-in for ROS 2's generated header: the same names, types and order of fields.
#pragma once

#include <cstdint>
#include <memory>
#include <string>

namespace sensor_msgs::msg {

struct PointField {
    using SharedPtr = std::shared_ptr<PointField>;
    using ConstSharedPtr = std::shared_ptr<const PointField>;
    enum : std::uint8_t { INT8 = 1, UINT8, INT16, UINT16, INT32, UINT32, FLOAT32, FLOAT64 };
    std::string name;
    std::uint32_t offset = 0;
    std::uint8_t datatype = 0;
    std::uint32_t count = 0;
};

}  // namespace sensor_msgs::msg
