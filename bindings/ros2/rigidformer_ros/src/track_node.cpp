// Depth images or clouds in, bodies and where they will be out: the ROS side of Follower.
#include <geometry_msgs/msg/pose_array.hpp>
#include <geometry_msgs/msg/transform_stamped.hpp>
#include <nav_msgs/msg/odometry.hpp>
#include <rcl_interfaces/msg/integer_range.hpp>
#include <rclcpp/rclcpp.hpp>
#include <sensor_msgs/msg/camera_info.hpp>
#include <sensor_msgs/msg/image.hpp>
#include <sensor_msgs/msg/point_cloud2.hpp>
#include <trajectory_msgs/msg/multi_dof_joint_trajectory.hpp>
#include <visualization_msgs/msg/marker_array.hpp>
// Newer distributions warn of the one, and older ones lack the other.
#if __has_include(<tf2/exceptions.hpp>)
#include <tf2/exceptions.hpp>
#else
#include <tf2/exceptions.h>
#endif
#if __has_include(<tf2_ros/buffer.hpp>)
#include <tf2_ros/buffer.hpp>
#include <tf2_ros/transform_listener.hpp>
#else
#include <tf2_ros/buffer.h>
#include <tf2_ros/transform_listener.h>
#endif

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <cstring>
#include <exception>
#include <memory>
#include <string>
#include <utility>
#include <vector>

#include "messages.hpp"
#include "rigidformer_ros/follower.hpp"

namespace rigidformer_ros {
namespace {

// Of the library; larger images are refused before their memory is looked at.
constexpr std::uint32_t MAX_SIDE = 8192;
// Points of a cloud that are handed on, at most: the library takes 20,000 of them.
constexpr std::size_t MAX_POINTS = 200000;
// Depths of images in metres are rounded to this, as the library's recordings do.
constexpr float STEP_M = .001F;

builtin_interfaces::msg::Duration duration(double seconds) {
    const auto time = stamp(std::llround(seconds * static_cast<double>(SECOND_NS)));
    builtin_interfaces::msg::Duration duration;
    duration.sec = time.sec;
    duration.nanosec = time.nanosec;
    return duration;
}

std::string name(std::uint32_t id) { return "unit_" + std::to_string(id); }

using Matrix = std::array<std::array<double, 3>, 3>;

// Carries a vector of the world into a frame: the transpose of its rotation.
Matrix into_frame(const std::array<double, 4> &q) {
    const auto [x, y, z, w] = q;
    return {{{1 - 2 * (y * y + z * z), 2 * (x * y + w * z), 2 * (x * z - w * y)},
             {2 * (x * y - w * z), 1 - 2 * (x * x + z * z), 2 * (y * z + w * x)},
             {2 * (x * z + w * y), 2 * (y * z - w * x), 1 - 2 * (x * x + y * y)}}};
}

// Both halves of six numbers, turned.
std::array<double, 6> turned(const Matrix &by, const std::array<double, 6> &all) {
    std::array<double, 6> result{};
    for (std::size_t row = 0; row < 6; row++) {
        for (std::size_t i = 0; i < 3; i++) result[row] += by[row % 3][i] * all[row / 3 * 3 + i];
    }
    return result;
}

// R C R^T, with R twice on the diagonal.
std::array<double, 36> turned(const Matrix &by, const std::array<double, 36> &all) {
    std::array<double, 36> half{}, result{};
    for (std::size_t row = 0; row < 6; row++) {
        for (std::size_t column = 0; column < 6; column++) {
            for (std::size_t i = 0; i < 3; i++) {
                half[6 * row + column] += by[row % 3][i] * all[6 * (row / 3 * 3 + i) + column];
            }
        }
    }
    for (std::size_t row = 0; row < 6; row++) {
        for (std::size_t column = 0; column < 6; column++) {
            for (std::size_t i = 0; i < 3; i++) {
                result[6 * row + column] += half[6 * row + column / 3 * 3 + i] * by[column % 3][i];
            }
        }
    }
    return result;
}

rf_pose from(const geometry_msgs::msg::Transform &transform) {
    const auto &p = transform.translation;
    const auto &q = transform.rotation;
    return {{static_cast<float>(p.x), static_cast<float>(p.y), static_cast<float>(p.z)},
            {static_cast<float>(q.x), static_cast<float>(q.y), static_cast<float>(q.z),
             static_cast<float>(q.w)}};
}

rcl_interfaces::msg::ParameterDescriptor counted(const std::string &description, std::int64_t from,
                                                 std::int64_t to) {
    rcl_interfaces::msg::ParameterDescriptor descriptor = described(description);
    rcl_interfaces::msg::IntegerRange range;
    range.from_value = from;
    range.to_value = to;
    descriptor.integer_range.push_back(range);
    return descriptor;
}

// A number of a message, whatever its address.
template <typename T>
T read(const std::uint8_t *bytes) {
    T number;
    std::memcpy(&number, bytes, sizeof number);
    return number;
}

bool is_big_endian() {
    const std::uint16_t one = 1;
    return read<std::uint8_t>(reinterpret_cast<const std::uint8_t *>(&one)) == 0;
}

}  // namespace

class TrackNode : public rclcpp::Node {
public:
    // Throws Refused where parameters cannot be.
    explicit TrackNode(const rclcpp::NodeOptions &options = rclcpp::NodeOptions())
        : Node("rigidformer_track", options), follower_(declared()), buffer_(get_clock()),
          listener_(buffer_) {
        units_ = create_publisher<nav_msgs::msg::Odometry>("~/units", rclcpp::QoS(64));
        poses_ = create_publisher<geometry_msgs::msg::PoseArray>("~/poses", 10);
        planes_ = create_publisher<geometry_msgs::msg::PoseArray>("~/planes", 10);
        predictions_ = create_publisher<trajectory_msgs::msg::MultiDOFJointTrajectory>("~/predictions", 10);
        markers_ = create_publisher<visualization_msgs::msg::MarkerArray>("~/markers", 10);
        if (input_ == "points") {
            points_ = create_subscription<sensor_msgs::msg::PointCloud2>(
                "~/points", rclcpp::SensorDataQoS(),
                [this](sensor_msgs::msg::PointCloud2::ConstSharedPtr message) {
                    taking([&] { take(*message); });
                });
            return;
        }
        info_ = create_subscription<sensor_msgs::msg::CameraInfo>(
            "~/camera_info", rclcpp::SensorDataQoS(),
            [this](sensor_msgs::msg::CameraInfo::ConstSharedPtr message) { last_info_ = message; });
        depth_ = create_subscription<sensor_msgs::msg::Image>(
            "~/depth", rclcpp::SensorDataQoS(),
            [this](sensor_msgs::msg::Image::ConstSharedPtr message) { taking([&] { take(*message); }); });
    }

private:
    // rclcpp drops values of what no node declares: with a name misspelt the default would stay, silently.
    void refuse_unknown() {
        for (const auto &given : get_node_parameters_interface()->get_parameter_overrides()) {
            const std::string &name = given.first;
            if (name == "use_sim_time" || name.rfind("qos_overrides.", 0) == 0) continue;
            if (!has_parameter(name)) {
                throw Refused("there is no parameter " + name, "correct the name: docs/INTEGRATIONS.md lists them");
            }
        }
    }

    FollowerOptions declared() {
        FollowerOptions options;
        rf_tracker_options &rest = options.rest;
        const auto number = [this](const std::string &name, float &value, const std::string &description,
                                   double from, double to) {
            value = static_cast<float>(
                declare_parameter(name, static_cast<double>(value), ranged(description, from, to)));
        };
        const auto count = [this](const std::string &name, std::uint32_t &value,
                                  const std::string &description, std::int64_t from, std::int64_t to) {
            value = static_cast<std::uint32_t>(
                declare_parameter(name, std::int64_t{value}, counted(description, from, to)));
        };
        options.model = declare_parameter(
            "model", std::string(),
            described("Path of a packed model for rigid units, .rfm; without one nothing is predicted"));
        input_ = declare_parameter("input", std::string("depth"),
                                   described("depth: ~/depth with ~/camera_info; points: ~/points"));
        world_ = declare_parameter("world_frame", world_,
                                   described("Frame that stands still, near the robot: bodies are in it"));
        transform_timeout_s_ = declare_parameter(
            "transform_timeout_s", transform_timeout_s_,
            ranged("How long a capture waits for its transform, s", 0, 1));
        depth_scale_m_ = declare_parameter("depth_scale_m", depth_scale_m_,
                                           ranged("Metres a step of 16-bit depths", 1e-6, 10));
        const auto gravity = declare_parameter("gravity", std::vector<double>{0, 0, -9.81},
                                               described("x, y, z of gravity in world_frame, m/s^2"));
        const auto planes = declare_parameter(
            "planes", std::vector<double>(),
            described("x, y, z of the normal and the distance from the origin, m, of each plane in "
                      "world_frame, at most 8; without any they are found"));
        options.horizon_s = declare_parameter("horizon_s", options.horizon_s,
                                              ranged("How far ahead to predict, s", 1.0 / 24, 10));
        options.max_gap_s = declare_parameter(
            "max_gap_s", options.max_gap_s,
            ranged("Captures farther apart than this begin all tracks anew, s", .01, 60));
        rest.hidden_s = declare_parameter("hidden_s", rest.hidden_s,
                                          ranged("How long a body may be hidden, s", 0, 60));
        count("confirm", rest.confirm, "Captures that show a body before it is published", 1, 100);
        count("missed", rest.missed, "Captures in a row that may miss a body", 0, 1000);
        count("max_units", rest.max_units, "Bodies that are followed, at most", 1, 256);
        count("max_clusters", rest.max_clusters, "Clusters of a capture that are looked at, at most", 1, 1024);
        number("min_extent_m", rest.min_extent_m, "Least diameter of a body, m", 1e-4, 100);
        number("max_extent_m", rest.max_extent_m, "Largest diameter of a body, m", 1e-4, 100);
        number("density_kg_m3", rest.density_kg_m3, "Assumed density of bodies", 1e-3, 1e6);
        number("friction", rest.unit_friction, "Assumed friction of bodies", 0, 1000);
        number("restitution", rest.unit_restitution, "Assumed restitution of bodies", 0, 1000);
        number("plane_friction", rest.plane_friction, "Friction of planes", 0, 1000);
        number("plane_restitution", rest.plane_restitution, "Restitution of planes", 0, 1000);
        refuse_unknown();
        if (input_ != "depth" && input_ != "points") {
            throw Refused("the parameter input is '" + input_ + "'", "set it to depth or points");
        }
        if (world_.empty()) throw Refused("the parameter world_frame is empty", "name a frame of TF");
        if (gravity.size() != 3) {
            throw Refused("the parameter gravity has " + std::to_string(gravity.size()) + " numbers",
                          "give three: x, y, z");
        }
        std::copy(gravity.begin(), gravity.end(), options.gravity.begin());
        if (planes.size() % 4 != 0) {
            throw Refused("the parameter planes has " + std::to_string(planes.size()) + " numbers",
                          "give x, y, z of the normal and the distance of each");
        }
        for (std::size_t i = 0; i + 3 < planes.size(); i += 4) {
            const auto at = [&](std::size_t k) { return static_cast<float>(planes[i + k]); };
            options.planes.push_back(
                {{at(0), at(1), at(2)}, at(3), rest.plane_friction, rest.plane_restitution});
        }
        max_gap_s_ = options.max_gap_s;
        return options;
    }

    // Where a frame was in the world. Throws Refused.
    rf_pose where(const std_msgs::msg::Header &header) {
        try {
            const auto found = buffer_.lookupTransform(world_, header.frame_id, rclcpp::Time(header.stamp),
                                                       rclcpp::Duration::from_seconds(transform_timeout_s_));
            return from(found.transform);
        } catch (const tf2::TransformException &error) {
            throw Refused(error.what(), "publish the transform from " + header.frame_id + " to " + world_ +
                                            ", or raise transform_timeout_s");
        }
    }

    template <typename Take>
    void taking(Take take) {
        try {
            take();
        } catch (const Refused &refused) {
            warn(refused.what());
        }
    }

    void take(const sensor_msgs::msg::Image &image) {
        if (!last_info_) throw Refused("there was no ~/camera_info yet", "remap it to the depth camera's");
        const sensor_msgs::msg::CameraInfo &info = *last_info_;
        if (info.width != image.width || info.height != image.height) {
            throw Refused("~/camera_info is of " + std::to_string(info.width) + " x " +
                              std::to_string(info.height) + " pixels, and ~/depth of " +
                              std::to_string(image.width) + " x " + std::to_string(image.height),
                          "remap it to that of the depth image");
        }
        const auto depth = steps(image);
        // Of rectified images; K where nobody rectified.
        const bool is_rectified = info.p[0] > 0;
        const auto at = [](double value) { return static_cast<float>(value); };
        rf_depth_view view{};
        view.width = image.width;
        view.height = image.height;
        view.focal[0] = at(is_rectified ? info.p[0] : info.k[0]);
        view.focal[1] = at(is_rectified ? info.p[5] : info.k[4]);
        view.centre[0] = at(is_rectified ? info.p[2] : info.k[2]);
        view.centre[1] = at(is_rectified ? info.p[6] : info.k[5]);
        view.camera = where(image.header);
        view.scale_m = image.encoding == "32FC1" ? STEP_M : at(depth_scale_m_);
        view.depth = depth.data();
        publish(image.header.stamp, {view}, {});
    }

    static std::vector<std::uint16_t> steps(const sensor_msgs::msg::Image &image) {
        const bool is_float = image.encoding == "32FC1";
        if (!is_float && image.encoding != "16UC1" && image.encoding != "mono16") {
            throw Refused("~/depth has the encoding '" + image.encoding + "'", "publish 16UC1 or 32FC1");
        }
        if ((image.is_bigendian != 0) != is_big_endian()) {
            throw Refused("~/depth has the other order of bytes", "publish it from a machine of this order");
        }
        if (image.width == 0 || image.height == 0 || image.width > MAX_SIDE || image.height > MAX_SIDE) {
            throw Refused("~/depth has " + std::to_string(image.width) + " x " + std::to_string(image.height) +
                              " pixels",
                          "each side must have 1 to 8192");
        }
        const std::size_t bytes = is_float ? 4 : 2, row = image.width * bytes, stride = image.step;
        if (stride < row || image.data.size() < stride * (image.height - 1) + row) {
            throw Refused("~/depth is shorter than its width, height and step", "correct who publishes it");
        }
        std::vector<std::uint16_t> depth;
        depth.reserve(std::size_t{image.width} * image.height);
        for (std::size_t y = 0; y < image.height; y++) {
            const std::uint8_t *start = image.data.data() + y * stride;
            for (std::size_t x = 0; x < image.width; x++) {
                if (!is_float) {
                    depth.push_back(read<std::uint16_t>(start + 2 * x));
                    continue;
                }
                // NaN and infinity are none, and so is what no step reaches.
                const float steps = std::round(read<float>(start + 4 * x) / STEP_M);
                depth.push_back(steps >= 1 && steps <= 65535 ? static_cast<std::uint16_t>(steps) : std::uint16_t{0});
            }
        }
        return depth;
    }

    void take(const sensor_msgs::msg::PointCloud2 &cloud) {
        if (cloud.is_bigendian != is_big_endian()) {
            throw Refused("~/points has the other order of bytes", "publish it from a machine of this order");
        }
        std::array<std::size_t, 3> offsets{};
        for (std::size_t axis = 0; axis < 3; axis++) {
            const std::string wanted(1, "xyz"[axis]);
            const auto field = std::find_if(cloud.fields.begin(), cloud.fields.end(),
                                            [&](const auto &one) { return one.name == wanted; });
            if (field == cloud.fields.end() || field->datatype != sensor_msgs::msg::PointField::FLOAT32 ||
                field->offset > cloud.point_step || cloud.point_step - field->offset < 4) {
                throw Refused("~/points has no field " + wanted + " of FLOAT32", "publish x, y and z as FLOAT32");
            }
            offsets[axis] = field->offset;
        }
        const std::size_t width = cloud.width, height = cloud.height, size = cloud.point_step;
        const std::size_t row = width * size, stride = cloud.row_step;
        if (height > 0 && width > 0 && (stride < row || cloud.data.size() < row ||
                                        (cloud.data.size() - row) / std::max<std::size_t>(stride, 1) < height - 1)) {
            throw Refused("~/points is shorter than its width, height and steps", "correct who publishes it");
        }
        const rf_pose sensor = where(cloud.header);
        const std::array<double, 4> q = {sensor.quaternion[0], sensor.quaternion[1], sensor.quaternion[2],
                                         sensor.quaternion[3]};
        const Matrix back = into_frame(q);
        // Every so many of a large cloud.
        const std::size_t each = (width * height + MAX_POINTS - 1) / MAX_POINTS;
        std::vector<float> points;
        points.reserve(3 * std::min(width * height, MAX_POINTS));
        for (std::size_t i = 0; i < width * height; i += each) {
            const std::uint8_t *at = cloud.data.data() + i / width * stride + i % width * size;
            std::array<float, 3> own{};
            for (std::size_t axis = 0; axis < 3; axis++) own[axis] = read<float>(at + offsets[axis]);
            // NaN is how organised clouds say that nothing was measured.
            if (!std::isfinite(own[0] + own[1] + own[2])) continue;
            for (std::size_t axis = 0; axis < 3; axis++) {
                double world = sensor.position[axis];
                for (std::size_t k = 0; k < 3; k++) world += back[k][axis] * own[k];
                points.push_back(static_cast<float>(world));
            }
        }
        rf_cloud_view view{};
        view.points = points.data();
        view.point_count = points.size() / 3;
        view.has_sensor = 1;
        std::copy(std::begin(sensor.position), std::end(sensor.position), std::begin(view.sensor));
        publish(cloud.header.stamp, {}, {view});
    }

    // Once a second at most: cameras see more often.
    void warn(const std::string &why) {
        RCLCPP_WARN_THROTTLE(get_logger(), steady_, 1000, "%s", why.c_str());
    }

    void publish(const builtin_interfaces::msg::Time &time, const std::vector<rf_depth_view> &depths,
                 const std::vector<rf_cloud_view> &clouds) {
        std::string anew;
        const std::int64_t ns = nanoseconds(time);
        const Seen seen = follower_.observe(ns, depths, clouds, &anew);
        if (!anew.empty()) warn(anew);
        if (!seen.refused.empty()) warn("nothing predicted: " + seen.refused);
        if (seen.report.is_blind != 0) warn("below a hundredth of the image has a depth; remedy: look at the camera");
        std_msgs::msg::Header header;
        header.stamp = stamp(ns);
        header.frame_id = world_;

        geometry_msgs::msg::PoseArray poses;
        poses.header = header;
        for (const Followed &unit : seen.units) {
            poses.poses.push_back(to(unit.pose));
            units_->publish(odometry(header, unit));
        }
        poses_->publish(poses);

        geometry_msgs::msg::PoseArray planes;
        planes.header = header;
        for (const rf_plane &plane : seen.planes) planes.poses.push_back(pose_of(plane));
        planes_->publish(planes);

        if (seen.future) predictions_->publish(trajectory(header, *seen.future));
        markers_->publish(markers(header, seen));
    }

    static nav_msgs::msg::Odometry odometry(const std_msgs::msg::Header &header, const Followed &unit) {
        nav_msgs::msg::Odometry odometry;
        odometry.header = header;
        odometry.child_frame_id = name(unit.id);
        odometry.pose.pose = to(unit.pose);
        odometry.pose.covariance = unit.pose_covariance;
        // A twist is in the child's frame.
        const Matrix into = into_frame(unit.pose.quaternion);
        const auto velocity = turned(into, unit.velocity);
        odometry.twist.twist.linear.x = velocity[0];
        odometry.twist.twist.linear.y = velocity[1];
        odometry.twist.twist.linear.z = velocity[2];
        odometry.twist.twist.angular.x = velocity[3];
        odometry.twist.twist.angular.y = velocity[4];
        odometry.twist.twist.angular.z = velocity[5];
        odometry.twist.covariance = turned(into, unit.velocity_covariance);
        return odometry;
    }

    // The plane's point nearest to the origin, with z along the normal.
    static geometry_msgs::msg::Pose pose_of(const rf_plane &plane) {
        const double x = plane.normal[0], y = plane.normal[1], z = plane.normal[2], d = plane.offset_m;
        Pose pose;
        pose.position = {d * x, d * y, d * z};
        // The shortest turn of z; half a turn about x where it points down.
        const double length = std::sqrt(x * x + y * y + (1 + z) * (1 + z));
        if (length > 1e-3) {
            pose.quaternion = {-y / length, x / length, 0, (1 + z) / length};
        } else {
            pose.quaternion = {1, 0, 0, 0};
        }
        return to(pose);
    }

    static trajectory_msgs::msg::MultiDOFJointTrajectory trajectory(const std_msgs::msg::Header &header,
                                                                    const Future &future) {
        trajectory_msgs::msg::MultiDOFJointTrajectory trajectory;
        trajectory.header = header;
        for (const std::uint32_t id : future.ids) trajectory.joint_names.push_back(name(id));
        for (std::size_t step = 0; step < future.poses.size(); step++) {
            trajectory_msgs::msg::MultiDOFJointTrajectoryPoint point;
            point.time_from_start = duration(future.step_s * static_cast<double>(step + 1));
            for (const Pose &pose : future.poses[step]) {
                const auto message = to(pose);
                geometry_msgs::msg::Transform transform;
                transform.translation.x = message.position.x;
                transform.translation.y = message.position.y;
                transform.translation.z = message.position.z;
                transform.rotation = message.orientation;
                point.transforms.push_back(transform);
            }
            trajectory.points.push_back(point);
        }
        return trajectory;
    }

    visualization_msgs::msg::MarkerArray markers(const std_msgs::msg::Header &header, const Seen &seen) const {
        visualization_msgs::msg::MarkerArray array;
        for (const Followed &unit : seen.units) {
            visualization_msgs::msg::Marker box;
            box.header = header;
            box.ns = "units";
            box.id = static_cast<std::int32_t>(unit.id);
            box.type = visualization_msgs::msg::Marker::CUBE;
            box.action = visualization_msgs::msg::Marker::ADD;
            Pose middle = unit.pose;
            const Matrix back = into_frame(unit.pose.quaternion);
            for (std::size_t axis = 0; axis < 3; axis++) {
                for (std::size_t k = 0; k < 3; k++) {
                    middle.position[axis] += back[k][axis] * (unit.low[k] + unit.high[k]) / 2;
                }
            }
            box.pose = to(middle);
            // RViz refuses a box without extent.
            box.scale.x = std::max(unit.high[0] - unit.low[0], .01);
            box.scale.y = std::max(unit.high[1] - unit.low[1], .01);
            box.scale.z = std::max(unit.high[2] - unit.low[2], .01);
            // Grey where it is not seen.
            box.color.r = (unit.flags & RF_TRACK_SEEN) != 0 ? .1F : .5F;
            box.color.g = (unit.flags & RF_TRACK_SEEN) != 0 ? .8F : .5F;
            box.color.b = (unit.flags & RF_TRACK_SEEN) != 0 ? .3F : .5F;
            box.color.a = .5F;
            box.lifetime = duration(max_gap_s_);
            array.markers.push_back(box);
        }
        if (!seen.future) return array;
        for (std::size_t unit = 0; unit < seen.future->ids.size(); unit++) {
            visualization_msgs::msg::Marker line;
            line.header = header;
            line.ns = "predictions";
            line.id = static_cast<std::int32_t>(seen.future->ids[unit]);
            line.type = visualization_msgs::msg::Marker::LINE_STRIP;
            line.action = visualization_msgs::msg::Marker::ADD;
            line.pose.orientation.w = 1;
            line.scale.x = .005;
            line.color.g = .6F;
            line.color.b = 1;
            line.color.a = 1;
            line.lifetime = duration(max_gap_s_);
            for (const Followed &other : seen.units) {
                if (other.id == seen.future->ids[unit]) line.points.push_back(to(other.pose).position);
            }
            for (const auto &poses : seen.future->poses) line.points.push_back(to(poses[unit]).position);
            array.markers.push_back(line);
        }
        return array;
    }

    // Not the node's clock: with use_sim_time that may stand still or go back, and nothing would be said.
    rclcpp::Clock steady_{RCL_STEADY_TIME};
    // Before follower_, whose making sets them.
    std::string input_, world_ = "odom";
    double transform_timeout_s_ = .1, depth_scale_m_ = .001, max_gap_s_ = 0;
    Follower follower_;
    tf2_ros::Buffer buffer_;
    // On a thread of its own, so that a capture can wait for a transform.
    tf2_ros::TransformListener listener_;
    sensor_msgs::msg::CameraInfo::ConstSharedPtr last_info_;
    rclcpp::Publisher<nav_msgs::msg::Odometry>::SharedPtr units_;
    rclcpp::Publisher<geometry_msgs::msg::PoseArray>::SharedPtr poses_, planes_;
    rclcpp::Publisher<trajectory_msgs::msg::MultiDOFJointTrajectory>::SharedPtr predictions_;
    rclcpp::Publisher<visualization_msgs::msg::MarkerArray>::SharedPtr markers_;
    rclcpp::Subscription<sensor_msgs::msg::PointCloud2>::SharedPtr points_;
    rclcpp::Subscription<sensor_msgs::msg::CameraInfo>::SharedPtr info_;
    rclcpp::Subscription<sensor_msgs::msg::Image>::SharedPtr depth_;
};

}  // namespace rigidformer_ros

int main(int argc, char **argv) {
    int status = 0;
    try {
        rclcpp::init(argc, argv);
        rclcpp::spin(std::make_shared<rigidformer_ros::TrackNode>());
    } catch (const std::exception &error) {
        RCLCPP_FATAL(rclcpp::get_logger("rigidformer_track"), "%s", error.what());
        status = 1;
    }
    rclcpp::shutdown();
    return status;
}
