// A stand-in for ROS 2's generated header: the same names, types and order of fields.
#pragma once

#include <memory>
#include <vector>

#include <visualization_msgs/msg/marker.hpp>

namespace visualization_msgs::msg {

struct MarkerArray {
    using SharedPtr = std::shared_ptr<MarkerArray>;
    using ConstSharedPtr = std::shared_ptr<const MarkerArray>;
    std::vector<Marker> markers{};
};

}  // namespace visualization_msgs::msg
