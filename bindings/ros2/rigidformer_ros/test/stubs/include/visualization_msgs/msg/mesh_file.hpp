// A stand-in for ROS 2's generated header: the same names, types and order of fields.
#pragma once

#include <cstdint>
#include <memory>
#include <string>
#include <vector>

namespace visualization_msgs::msg {

struct MeshFile {
    using SharedPtr = std::shared_ptr<MeshFile>;
    using ConstSharedPtr = std::shared_ptr<const MeshFile>;
    std::string filename{};
    std::vector<std::uint8_t> data{};
};

}  // namespace visualization_msgs::msg
