// A stand-in for the parts of tf2_ros that the node uses; tf2_ros::stub is the test's side of them.
#pragma once

#include <functional>
#include <memory>
#include <string>

#include <geometry_msgs/msg/transform_stamped.hpp>
#include <rclcpp/rclcpp.hpp>
#include <tf2/exceptions.h>

namespace tf2_ros {

namespace stub {
// The pose of a frame in another, or an exception.
using Lookup = std::function<geometry_msgs::msg::Transform(const std::string &target,
                                                           const std::string &source, std::int64_t ns)>;
inline Lookup &lookup() {
    static Lookup lookup;
    return lookup;
}
}  // namespace stub

class Buffer {
public:
    explicit Buffer(rclcpp::Clock::SharedPtr) {}
    geometry_msgs::msg::TransformStamped lookupTransform(const std::string &target_frame,
                                                         const std::string &source_frame,
                                                         const rclcpp::Time &time,
                                                         const rclcpp::Duration) const {
        geometry_msgs::msg::TransformStamped found;
        found.transform = stub::lookup()(target_frame, source_frame, time.nanoseconds());
        return found;
    }
};

}  // namespace tf2_ros
