// A stand-in for ROS 2's generated header: the same names, types and order of fields.
#pragma once

#include <cstdint>
#include <memory>

namespace sensor_msgs::msg {

struct RegionOfInterest {
    using SharedPtr = std::shared_ptr<RegionOfInterest>;
    using ConstSharedPtr = std::shared_ptr<const RegionOfInterest>;
    std::uint32_t x_offset = 0;
    std::uint32_t y_offset = 0;
    std::uint32_t height = 0;
    std::uint32_t width = 0;
    bool do_rectify = false;
};

}  // namespace sensor_msgs::msg
