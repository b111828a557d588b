// Poses in, predicted poses out: the ROS side of Predictor.
#include <geometry_msgs/msg/pose_array.hpp>
#include <nav_msgs/msg/path.hpp>
#include <rclcpp/rclcpp.hpp>
#include <visualization_msgs/msg/marker_array.hpp>

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <exception>
#include <memory>
#include <string>
#include <utility>
#include <vector>

#include "messages.hpp"
#include "rigidformer_ros/predictor.hpp"

namespace rigidformer_ros {
namespace {

std_msgs::msg::Header header(const std::string &frame, std::int64_t ns) {
    std_msgs::msg::Header header;
    header.stamp = stamp(ns);
    header.frame_id = frame;
    return header;
}

Pose from(const geometry_msgs::msg::Pose &pose) {
    return {{pose.position.x, pose.position.y, pose.position.z},
            {pose.orientation.x, pose.orientation.y, pose.orientation.z, pose.orientation.w}};
}

// Whether a name can be a part of a topic and of a parameter.
bool is_name(const std::string &text) {
    const auto letter = [](char c) {
        return (c >= 'a' && c <= 'z') || (c >= 'A' && c <= 'Z') || c == '_';
    };
    if (text.empty() || !letter(text.front())) return false;
    for (char c : text) {
        if (!letter(c) && !(c >= '0' && c <= '9')) return false;
    }
    // The list of names is a parameter of that name.
    if (text == "names") return false;
    // ROS has its own use for two underscores.
    return text.find("__") == std::string::npos && text.back() != '_';
}

std::vector<std::array<double, 3>> triples(const std::string &name,
                                           const std::vector<double> &numbers) {
    if (numbers.size() % 3 != 0) {
        throw Refused("the parameter " + name + " has " + std::to_string(numbers.size()) +
                          " numbers",
                      "give x, y, z of each");
    }
    std::vector<std::array<double, 3>> all;
    for (std::size_t i = 0; i + 2 < numbers.size(); i += 3) {
        all.push_back({numbers[i], numbers[i + 1], numbers[i + 2]});
    }
    return all;
}

std::array<double, 3> triple(const std::string &name, const std::vector<double> &numbers) {
    if (numbers.size() != 3) {
        throw Refused("the parameter " + name + " has " + std::to_string(numbers.size()) +
                          " numbers",
                      "give three: x, y, z");
    }
    return {numbers[0], numbers[1], numbers[2]};
}

}  // namespace

class PredictorNode : public rclcpp::Node {
public:
    // Throws Refused where parameters cannot be.
    explicit PredictorNode(const rclcpp::NodeOptions &options = rclcpp::NodeOptions())
        : Node("rigidformer_predictor", options), predictor_(declared()) {
        predicted_ = create_publisher<geometry_msgs::msg::PoseArray>("~/predicted", 10);
        markers_ = create_publisher<visualization_msgs::msg::MarkerArray>("~/markers", 10);
        for (const Unit &unit : predictor_.units()) {
            paths_.push_back(create_publisher<nav_msgs::msg::Path>("~/paths/" + unit.name, 10));
        }
        poses_ = create_subscription<geometry_msgs::msg::PoseArray>(
            "~/poses", rclcpp::SensorDataQoS(),
            [this](geometry_msgs::msg::PoseArray::ConstSharedPtr message) { take(*message); });
        RCLCPP_INFO(get_logger(), "%zu units, %zu bytes of workspace", predictor_.units().size(),
                    predictor_.workspace_bytes());
    }

private:
    Unit unit(const std::string &name) {
        if (!is_name(name)) {
            throw Refused("units.names has '" + name + "'",
                          "use letters, digits and single underscores between them, a letter first, and no unit named names");
        }
        const std::string prefix = "units." + name + ".";
        Unit unit;
        unit.name = name;
        const auto points = declare_parameter(
            prefix + "points", std::vector<double>(),
            described("x, y, z of each point on its surface in its own frame, m; for what is no box"));
        const auto size = declare_parameter(
            prefix + "size", std::vector<double>(),
            described("Edges of the box around the origin of its frame, m; where there are no points"));
        unit.mass_kg =
            declare_parameter(prefix + "mass_kg", unit.mass_kg, ranged("Mass, kg", 1e-9, 1e9));
        unit.friction = declare_parameter(prefix + "friction", unit.friction,
                                          ranged("Friction coefficient", 0, 1000));
        unit.restitution = declare_parameter(prefix + "restitution", unit.restitution,
                                             ranged("Restitution coefficient", 0, 1000));
        unit.fixed = declare_parameter(prefix + "fixed", unit.fixed,
                                       described("Scenery that nothing moves, such as a table"));
        // Before sizes are looked at: one that is missing may be one that is misspelt.
        refuse_unknown(prefix, "correct the name: a unit has size, points, mass_kg, friction, "
                               "restitution and fixed");
        unit.points = triples(prefix + "points", points);
        if (points.empty()) unit.size = triple(prefix + "size", size);
        return unit;
    }

    std::optional<std::vector<Ground>> ground() {
        const auto kind = declare_parameter(
            "ground", std::string("model"),
            described("model: z = 0 with the model's friction and restitution; plane: that of "
                      "ground_height_m, ground_friction and ground_restitution; none"));
        Ground ground;
        ground.height_m =
            declare_parameter("ground_height_m", ground.height_m,
                              ranged("Height of the ground where ground is plane, m", -1e6, 1e6));
        ground.friction =
            declare_parameter("ground_friction", ground.friction,
                              ranged("Friction coefficient of the ground", 0, 1000));
        ground.restitution =
            declare_parameter("ground_restitution", ground.restitution,
                              ranged("Restitution coefficient of the ground", 0, 1000));
        if (kind != "model" && kind != "plane" && kind != "none") {
            throw Refused("the parameter ground is '" + kind + "'",
                          "set it to model, plane or none");
        }
        refuse_unknown("ground_", "correct the name: ground is a plane of ground_height_m, "
                                  "ground_friction and ground_restitution");
        if (kind == "plane") return std::vector<Ground>{ground};
        for (const std::string &unused : overridden("ground_")) {
            if (!has_parameter(unused)) continue;
            throw Refused("the parameter " + unused + " is set, and ground is " + kind,
                          "set ground to plane, or leave out " + unused);
        }
        if (kind == "none") return std::vector<Ground>();
        return std::nullopt;
    }

    // Names that someone gave values to, and that start so.
    std::vector<std::string> overridden(const std::string &start) {
        std::vector<std::string> names;
        for (const auto &given : get_node_parameters_interface()->get_parameter_overrides()) {
            if (given.first.rfind(start, 0) == 0) names.push_back(given.first);
        }
        return names;
    }

    // rclcpp drops values of what no node declares: with a name misspelt the default would stay, silently.
    void refuse_unknown(const std::string &start, const std::string &remedy) {
        for (const std::string &name : overridden(start)) {
            // Sections for all nodes, such as those of simulators, name topics so.
            if (name.rfind("ground_truth", 0) == 0) continue;
            if (!has_parameter(name)) throw Refused("there is no parameter " + name, remedy);
        }
    }

    Predictor declared() {
        const auto model =
            declare_parameter("model", std::string(), described("Path of a packed model, .rfm"));
        Times times;
        times.horizon_s = declare_parameter(
            "horizon_s", times.horizon_s,
            ranged("How far ahead to predict, s: a whole number of steps", 1.0 / 240, 60));
        times.step_s = declare_parameter(
            "step_s", times.step_s,
            ranged("Time of a step, s; models are trained with 1/240 to 1/6", 1.0 / 240, 1.0 / 6));
        times.max_gap_s = declare_parameter(
            "max_gap_s", times.max_gap_s,
            ranged("Observations farther apart than this make no pair, s; models are trained with "
                   "1/240 to 1/6",
                   1e-3, 60));
        // A file that knows nothing of the shortest gap may have a shorter one as its longest.
        times.min_gap_s = declare_parameter(
            "min_gap_s", std::min(times.min_gap_s, times.max_gap_s / 2),
            ranged("Observations closer than this make no pair, s: the earlier one waits for a "
                   "later one",
                   1e-6, 60));
        Scene scene;
        const auto names = declare_parameter(
            "units.names", std::vector<std::string>(),
            described("Names of the units, in the order in which ~/poses has their poses"));
        for (const std::string &name : names) {
            for (const Unit &other : scene.units) {
                if (other.name == name) {
                    throw Refused("units.names has " + name + " twice", "give each its own name");
                }
            }
            scene.units.push_back(unit(name));
        }
        refuse_unknown("units.", "correct the name, or add the unit to units.names");
        const auto gravity =
            declare_parameter("gravity", std::vector<double>(),
                              described("x, y, z of gravity, m/s^2; the model's where left out"));
        if (!gravity.empty()) scene.gravity = triple("gravity", gravity);
        scene.ground = ground();
        lifetime_ns_ = std::llround(times.max_gap_s * static_cast<double>(SECOND_NS));
        return Predictor(read_model(model), std::move(scene), times);
    }

    void take(const geometry_msgs::msg::PoseArray &message) {
        Observation observation;
        observation.stamp_ns = nanoseconds(message.header.stamp);
        observation.frame = message.header.frame_id;
        for (const auto &pose : message.poses) observation.poses.push_back(from(pose));
        try {
            std::string gap;
            const auto prediction = predictor_.observe(observation, &gap);
            if (!gap.empty()) warn(gap);
            if (prediction) publish(*prediction);
        } catch (const Refused &refused) {
            warn(refused.what());
        }
    }

    // Once a second at most: trackers publish as often as cameras see.
    void warn(const std::string &why) {
        RCLCPP_WARN_THROTTLE(get_logger(), steady_, 1000, "nothing predicted: %s", why.c_str());
    }

    void publish(const Prediction &prediction) {
        geometry_msgs::msg::PoseArray predicted;
        predicted.header = header(prediction.frame, prediction.stamps_ns.back());
        for (const Pose &pose : prediction.poses.back()) predicted.poses.push_back(to(pose));
        predicted_->publish(predicted);

        visualization_msgs::msg::MarkerArray markers;
        for (std::size_t unit = 0; unit < paths_.size(); unit++) {
            nav_msgs::msg::Path path;
            path.header = header(prediction.frame, prediction.observed_ns);
            for (std::size_t step = 0; step < prediction.poses.size(); step++) {
                geometry_msgs::msg::PoseStamped pose;
                pose.header = header(prediction.frame, prediction.stamps_ns[step]);
                pose.pose = to(prediction.poses[step][unit]);
                path.poses.push_back(pose);
            }
            paths_[unit]->publish(path);
            markers.markers.push_back(body(prediction, unit));
            markers.markers.push_back(way(prediction, unit));
        }
        markers_->publish(markers);
    }

    visualization_msgs::msg::Marker marker(const Prediction &prediction, std::size_t unit) const {
        visualization_msgs::msg::Marker marker;
        // Of the observation: RViz would wait for a transform of the future.
        marker.header = header(prediction.frame, prediction.observed_ns);
        marker.id = static_cast<std::int32_t>(unit);
        marker.action = visualization_msgs::msg::Marker::ADD;
        marker.color.r = .1F;
        marker.color.g = .6F;
        marker.color.b = 1;
        marker.color.a = .5F;
        // A prediction that no other follows goes away.
        const auto lifetime = stamp(lifetime_ns_);
        marker.lifetime.sec = lifetime.sec;
        marker.lifetime.nanosec = lifetime.nanosec;
        return marker;
    }

    // Where a unit will be.
    visualization_msgs::msg::Marker body(const Prediction &prediction, std::size_t number) const {
        const Unit &unit = predictor_.units()[number];
        visualization_msgs::msg::Marker shape = marker(prediction, number);
        shape.ns = "units";
        shape.pose = to(prediction.poses.back()[number]);
        if (unit.points.empty()) {
            shape.type = visualization_msgs::msg::Marker::CUBE;
            shape.scale.x = unit.size[0];
            shape.scale.y = unit.size[1];
            shape.scale.z = unit.size[2];
        } else {
            shape.type = visualization_msgs::msg::Marker::SPHERE_LIST;
            shape.scale.x = shape.scale.y = shape.scale.z = .01;
            for (const auto &at : unit.points) shape.points.push_back(point(at));
        }
        return shape;
    }

    // On which way it gets there.
    visualization_msgs::msg::Marker way(const Prediction &prediction, std::size_t number) const {
        visualization_msgs::msg::Marker line = marker(prediction, number);
        line.ns = "paths";
        line.type = visualization_msgs::msg::Marker::LINE_STRIP;
        line.pose.orientation.w = 1;
        line.scale.x = .005;
        // RViz refuses a line of one point, which a horizon of one step would be.
        line.points.push_back(point(prediction.observed[number].position));
        for (const auto &poses : prediction.poses) {
            line.points.push_back(point(poses[number].position));
        }
        return line;
    }

    // Not the node's clock: with use_sim_time that may stand still or go back, and nothing would be said.
    rclcpp::Clock steady_{RCL_STEADY_TIME};
    // Before predictor_, whose making sets it.
    std::int64_t lifetime_ns_ = 0;
    Predictor predictor_;
    rclcpp::Publisher<geometry_msgs::msg::PoseArray>::SharedPtr predicted_;
    rclcpp::Publisher<visualization_msgs::msg::MarkerArray>::SharedPtr markers_;
    std::vector<rclcpp::Publisher<nav_msgs::msg::Path>::SharedPtr> paths_;
    rclcpp::Subscription<geometry_msgs::msg::PoseArray>::SharedPtr poses_;
};

}  // namespace rigidformer_ros

int main(int argc, char **argv) {
    int status = 0;
    try {
        rclcpp::init(argc, argv);
        rclcpp::spin(std::make_shared<rigidformer_ros::PredictorNode>());
    } catch (const std::exception &error) {
        RCLCPP_FATAL(rclcpp::get_logger("rigidformer_predictor"), "%s", error.what());
        status = 1;
    }
    rclcpp::shutdown();
    return status;
}
