// Runs the node in this process: track_test model.rfm. Prints what it proved, or what is wrong.
#define main track_node_main
#include "../src/track_node.cpp"
#undef main

#include <functional>
#include <iostream>
#include <limits>

namespace {

using geometry_msgs::msg::PoseArray;
using nav_msgs::msg::Odometry;
using rclcpp::Parameter;
using rclcpp::stub::published;
using rclcpp::stub::world;
using rigidformer_ros::TrackNode;
using sensor_msgs::msg::CameraInfo;
using sensor_msgs::msg::Image;
using sensor_msgs::msg::PointCloud2;
using trajectory_msgs::msg::MultiDOFJointTrajectory;
using visualization_msgs::msg::MarkerArray;

const std::string TOPIC = "/rigidformer_track/";
constexpr std::uint32_t WIDTH = 320, HEIGHT = 240;
constexpr float FOCAL = 300, CENTRE[2] = {159.5F, 119.5F};
constexpr float EYE[3] = {-2, 0, 1}, EDGES[3] = {.25F, .3F, .2F};
// Forward and down by 12 degrees.
constexpr float COS = .9781476F, SIN = .2079117F;
constexpr std::int64_t START_NS = 1700000000900000000, FRAME_NS = 33333333;

int failures = 0;
std::string part;

void expect(bool holds, const std::string &what) {
    if (holds) return;
    std::cerr << part << ": " << what << "\n";
    failures++;
}

double seconds(std::int64_t ns) { return static_cast<double>(ns - START_NS) * 1e-9; }

// A box falls above a floor: metres along the camera's axis, by rows.
std::vector<float> seen(double t) {
    const float box[3] = {0, 0, static_cast<float>(.95 - 4.905 * t * t)};
    std::vector<float> depth;
    for (std::uint32_t row = 0; row < HEIGHT; row++) {
        for (std::uint32_t column = 0; column < WIDTH; column++) {
            const float u = (static_cast<float>(column) - CENTRE[0]) / FOCAL;
            const float v = (static_cast<float>(row) - CENTRE[1]) / FOCAL;
            const float ray[3] = {COS - v * SIN, -u, -SIN - v * COS};
            float best = ray[2] < 0 ? -EYE[2] / ray[2] : std::numeric_limits<float>::infinity(), from = 0, to = 1e9F;
            for (int axis = 0; axis < 3; axis++) {
                const float a = (box[axis] - EDGES[axis] / 2 - EYE[axis]) / ray[axis];
                const float b = (box[axis] + EDGES[axis] / 2 - EYE[axis]) / ray[axis];
                from = std::max(from, std::min(a, b));
                to = std::min(to, std::max(a, b));
            }
            if (from < to) best = std::min(best, from);
            depth.push_back(best < 6 ? best : std::numeric_limits<float>::quiet_NaN());
        }
    }
    return depth;
}

std_msgs::msg::Header header(std::int64_t ns) {
    std_msgs::msg::Header header;
    header.frame_id = "camera";
    header.stamp = rigidformer_ros::stamp(ns);
    return header;
}

// In metres, or in millimetres; two bytes of nothing at the end of each row.
Image image(std::int64_t ns, bool is_float = false) {
    Image image;
    image.header = header(ns);
    image.width = WIDTH;
    image.height = HEIGHT;
    image.encoding = is_float ? "32FC1" : "16UC1";
    image.step = WIDTH * (is_float ? 4 : 2) + 2;
    image.data.resize(std::size_t{image.step} * HEIGHT);
    const auto depth = seen(seconds(ns));
    for (std::size_t at = 0; at < depth.size(); at++) {
        std::uint8_t *to = image.data.data() + at / WIDTH * image.step + at % WIDTH * (is_float ? 4 : 2);
        const auto steps = static_cast<std::uint16_t>(depth[at] > 0 ? std::lround(depth[at] * 1000) : 0);
        const float metres = steps > 0 ? static_cast<float>(steps) / 1000 : depth[at];
        if (is_float) std::memcpy(to, &metres, 4);
        if (!is_float) std::memcpy(to, &steps, 2);
    }
    return image;
}

PointCloud2 cloud(std::int64_t ns) {
    PointCloud2 cloud;
    cloud.header = header(ns);
    cloud.width = WIDTH;
    cloud.height = HEIGHT;
    // Something else in front of each coordinate.
    const char *const names[] = {"x", "y", "z"};
    for (std::uint32_t axis = 0; axis < 3; axis++) {
        sensor_msgs::msg::PointField field;
        field.name = names[axis];
        field.offset = 4 + 4 * axis;
        field.datatype = sensor_msgs::msg::PointField::FLOAT32;
        field.count = 1;
        cloud.fields.push_back(field);
    }
    cloud.point_step = 20;
    cloud.row_step = 20 * WIDTH;
    cloud.data.resize(std::size_t{cloud.row_step} * HEIGHT);
    const auto depth = seen(seconds(ns));
    for (std::size_t at = 0; at < depth.size(); at++) {
        const float z = depth[at];
        const float point[3] = {(static_cast<float>(at % WIDTH) - CENTRE[0]) / FOCAL * z,
                                (static_cast<float>(at / WIDTH) - CENTRE[1]) / FOCAL * z, z};
        std::memcpy(cloud.data.data() + 20 * at + 4, point, sizeof point);
    }
    return cloud;
}

CameraInfo info() {
    CameraInfo info;
    info.header = header(START_NS);
    info.width = WIDTH;
    info.height = HEIGHT;
    const double f = double{FOCAL};
    info.k = {f, 0, double{CENTRE[0]}, 0, f, double{CENTRE[1]}, 0, 0, 1};
    info.p = {f, 0, double{CENTRE[0]}, 0, 0, f, double{CENTRE[1]}, 0, 0, 0, 1, 0};
    return info;
}

// The camera's place; of another frame there is none.
geometry_msgs::msg::Transform placed(const std::string &target, const std::string &source, std::int64_t) {
    if (target != "odom" || source != "camera") throw tf2::LookupException("no frame " + source);
    geometry_msgs::msg::Transform transform;
    const double a = std::sqrt((1 + double{SIN}) / 4), b = std::sqrt((1 - double{SIN}) / 4);
    transform.translation.x = double{EYE[0]};
    transform.translation.z = double{EYE[2]};
    transform.rotation.x = -a;
    transform.rotation.y = a;
    transform.rotation.z = -b;
    transform.rotation.w = b;
    return transform;
}

void reset() {
    world().published.clear();
    world().logs.clear();
    tf2_ros::stub::lookup() = placed;
}

std::size_t warnings() {
    std::size_t count = 0;
    for (const auto &log : world().logs) count += log.level == "WARN";
    return count;
}

template <typename M>
void send(const std::string &topic, const M &message) {
    // A second after the last one, so that each warning is heard.
    world().steady_ns += 1000000000;
    rclcpp::stub::send(TOPIC + topic, message);
}

std::vector<Parameter> parameters(const std::string &model, std::vector<Parameter> more = {}) {
    more.emplace_back("model", model);
    return more;
}

rclcpp::NodeOptions options(const std::vector<Parameter> &all) {
    return rclcpp::NodeOptions().parameter_overrides(all);
}

double square(double number) { return number * number; }

// What a box that falls must be followed by, whatever the sensor.
void falls(std::size_t captures, double tolerance) {
    const double t = seconds(START_NS + FRAME_NS * static_cast<std::int64_t>(captures - 1));
    const double height = .95 - 4.905 * t * t;
    const auto units = published<Odometry>(TOPIC + "units");
    const auto poses = published<PoseArray>(TOPIC + "poses");
    expect(poses.size() == captures, "an array of poses for each capture");
    expect(!units.empty() && !poses.empty() && poses.back().poses.size() == 1, "one unit");
    if (units.empty() || poses.back().poses.size() != 1) return;
    const Odometry &unit = units.back();
    expect(unit.header.frame_id == "odom" && unit.child_frame_id == "unit_1", "the frames of a unit");
    expect(std::abs(seconds(rigidformer_ros::nanoseconds(unit.header.stamp)) - t) < 1e-8, "the stamp of a unit");
    const auto &at = unit.pose.pose.position;
    expect(std::abs(at.x) < .08 && std::abs(at.y) < .03 && std::abs(at.z - height) < .06,
           "the centre is at " + std::to_string(at.x) + " " + std::to_string(at.y) + " " + std::to_string(at.z));
    // The twist is in the unit's frame, and this unit has not turned.
    const auto &speed = unit.twist.twist.linear;
    expect(std::abs(speed.z + 9.81 * t) < tolerance,
           "it falls at " + std::to_string(speed.z) + " instead of " + std::to_string(-9.81 * t));
    for (std::size_t i = 0; i < 6; i++) {
        expect(unit.pose.covariance[7 * i] > 0 && unit.twist.covariance[7 * i] > 0, "a variance is not positive");
    }

    const auto planes = published<PoseArray>(TOPIC + "planes");
    expect(!planes.empty() && planes.back().poses.size() == 1, "one plane");
    if (!planes.empty() && planes.back().poses.size() == 1) {
        const auto &plane = planes.back().poses[0];
        expect(std::abs(plane.position.z) < .01 && square(plane.orientation.w) > .999, "the floor");
    }

    const auto predictions = published<MultiDOFJointTrajectory>(TOPIC + "predictions");
    expect(predictions.size() == captures, "a prediction for each capture");
    if (predictions.empty()) return;
    const auto &last = predictions.back();
    expect(last.header.frame_id == "odom" && last.joint_names == std::vector<std::string>{"unit_1"}, "who is predicted");
    expect(last.points.size() == 24, "steps of a prediction");
    if (last.points.size() != 24 || last.points.back().transforms.size() != 1) return;
    const auto &end = last.points.back();
    expect(end.time_from_start.sec == 1 && end.time_from_start.nanosec == 0, "a second ahead");
    expect(std::abs(end.transforms[0].translation.z - .1) < .06,
           "it is predicted at " + std::to_string(end.transforms[0].translation.z) + " m, not on the floor");
    const auto markers = published<MarkerArray>(TOPIC + "markers");
    expect(!markers.empty() && markers.back().markers.size() == 2, "markers of a unit and of its way");
    if (!markers.empty() && markers.back().markers.size() == 2) {
        const auto &box = markers.back().markers[0];
        expect(std::abs(box.scale.y - double{EDGES[1]}) < .06 && std::abs(box.scale.z - double{EDGES[2]}) < .06,
               "the size of a marker");
        expect(markers.back().markers[1].points.size() == 25, "the length of a way");
    }
}

constexpr std::size_t FRAMES = 9;

std::int64_t frame_ns(std::size_t frame) { return START_NS + FRAME_NS * static_cast<std::int64_t>(frame); }

std::vector<Odometry> follows(const std::string &model, bool is_float) {
    part = is_float ? "32FC1" : "16UC1";
    reset();
    const TrackNode node(options(parameters(model)));
    send("camera_info", info());
    for (std::size_t frame = 0; frame < FRAMES; frame++) send("depth", image(frame_ns(frame), is_float));
    falls(FRAMES, .3);
    expect(warnings() == 0, "a warning");
    return published<Odometry>(TOPIC + "units");
}

void clouds(const std::string &model) {
    part = "PointCloud2";
    reset();
    const TrackNode node(options(parameters(model, {{"input", "points"}})));
    for (std::size_t frame = 0; frame < FRAMES; frame++) send("points", cloud(frame_ns(frame)));
    falls(FRAMES, .8);
    expect(warnings() == 0, "a warning");
    // Damaged ones.
    const PointCloud2 good = cloud(frame_ns(FRAMES));
    const std::vector<std::function<void(PointCloud2 &)>> faults = {
        [](PointCloud2 &bad) { bad.fields.erase(bad.fields.begin()); },
        [](PointCloud2 &bad) { bad.fields[2].offset = 17; },
        [](PointCloud2 &bad) { bad.fields[2].offset = std::numeric_limits<std::uint32_t>::max(); },
        [](PointCloud2 &bad) { bad.fields[1].datatype = sensor_msgs::msg::PointField::FLOAT64; },
        [](PointCloud2 &bad) { bad.data.pop_back(); },
        [](PointCloud2 &bad) { bad.row_step--; },
        [](PointCloud2 &bad) { bad.height = std::numeric_limits<std::uint32_t>::max(); },
        [](PointCloud2 &bad) { bad.width = std::numeric_limits<std::uint32_t>::max(); },
        [](PointCloud2 &bad) { bad.is_bigendian = !bad.is_bigendian; },
        [](PointCloud2 &bad) { bad.header.frame_id = "elsewhere"; },
    };
    for (std::size_t i = 0; i < faults.size(); i++) {
        PointCloud2 bad = good;
        faults[i](bad);
        send("points", bad);
        expect(warnings() == i + 1, "no warning of fault " + std::to_string(i));
    }
    PointCloud2 empty = good;
    empty.width = empty.height = empty.row_step = 0;
    empty.data.clear();
    send("points", empty);
    expect(published<PoseArray>(TOPIC + "poses").size() == FRAMES + 1, "an empty cloud is a capture");
}

void damaged(const std::string &model) {
    part = "damaged messages";
    reset();
    const TrackNode node(options(parameters(model)));
    std::size_t said = 0;
    const auto warned = [&](const std::string &what) {
        expect(warnings() == ++said, "no warning: " + what);
        expect(!world().logs.empty() && world().logs.back().text.find("remedy: ") != std::string::npos, "no remedy: " + what);
    };
    send("depth", image(frame_ns(0)));
    warned("no camera_info");
    CameraInfo small = info();
    small.width = 64;
    send("camera_info", small);
    send("depth", image(frame_ns(0)));
    warned("another size");
    CameraInfo blind = info();
    blind.p[0] = blind.k[0] = 0;
    send("camera_info", blind);
    send("depth", image(frame_ns(0)));
    warned("no focal length");
    send("camera_info", info());
    for (std::size_t frame = 0; frame < 4; frame++) send("depth", image(frame_ns(frame)));
    const auto before = published<Odometry>(TOPIC + "units");
    expect(!before.empty(), "nothing is followed");
    const std::vector<std::function<void(Image &)>> faults = {
        [](Image &bad) { bad.encoding = "rgb8"; },
        [](Image &bad) { bad.data.resize(bad.data.size() - 3); },
        [](Image &bad) { bad.step = 2 * WIDTH - 1; },
        [](Image &bad) { bad.is_bigendian = 1; },
        [](Image &bad) { bad.header.frame_id = "elsewhere"; },
        // The same stamp again, and an earlier one.
        [](Image &bad) { bad.header = header(frame_ns(3)); },
        [](Image &bad) { bad.header = header(frame_ns(2)); },
    };
    for (std::size_t i = 0; i < faults.size(); i++) {
        Image bad = image(frame_ns(4));
        faults[i](bad);
        send("depth", bad);
        warned("fault " + std::to_string(i));
    }
    tf2_ros::stub::lookup() = [](const std::string &, const std::string &, std::int64_t) {
        geometry_msgs::msg::Transform transform;
        transform.rotation.w = std::numeric_limits<double>::quiet_NaN();
        return transform;
    };
    send("depth", image(frame_ns(4)));
    warned("a transform of NaN");
    tf2_ros::stub::lookup() = placed;
    expect(published<Odometry>(TOPIC + "units").size() == before.size(), "something is published of a bad one");
    send("depth", image(frame_ns(4)));
    expect(warnings() == said && published<Odometry>(TOPIC + "units").size() == before.size() + 1, "it does not go on");
    // A bag that begins again: the numbers begin again, too.
    for (std::size_t frame = 0; frame < 4; frame++) {
        Image again = image(frame_ns(frame));
        again.header.stamp.sec -= 100;
        send("depth", again);
    }
    expect(warnings() == ++said, "no warning of a bag that began again");
    expect(published<Odometry>(TOPIC + "units").back().child_frame_id == "unit_1", "the number of a unit");
}

void refusals(const std::string &model) {
    part = "parameters";
    const std::vector<std::pair<Parameter, std::string>> faults = {
        {{"model", "/nowhere/none.rfm"}, "none.rfm"},
        {{"input", "video"}, "depth or points"},
        {{"world_frame", ""}, "frame of TF"},
        {{"gravity", std::vector<double>{0, -9.81}}, "x, y, z"},
        {{"planes", std::vector<double>{0, 0, 1}}, "normal"},
        {{"planes", std::vector<double>{0, 0, 3, 0}}, "length 1"},
        {{"max_extent_m", .001}, "extents"},
        {{"horizon", 1.}, "no parameter horizon"},
        {{"horizon_s", 11.}, "out of its range"},
        {{"max_units", std::int64_t{-1}}, "out of its range"},
    };
    for (const auto &fault : faults) {
        std::vector<Parameter> all = {fault.first};
        if (fault.first.get_name() != "model") all.emplace_back("model", model);
        std::string said = "nothing";
        try {
            const TrackNode node(options(all));
        } catch (const std::exception &error) {
            said = error.what();
        }
        expect(said.find(fault.second) != std::string::npos, fault.first.get_name() + ": " + said);
    }
    // Without a model bodies are followed and not predicted; planes may be given.
    reset();
    const TrackNode node(options({{"planes", std::vector<double>{0, 0, 1, 0}}}));
    send("camera_info", info());
    for (std::size_t frame = 0; frame < 4; frame++) send("depth", image(frame_ns(frame)));
    expect(!published<Odometry>(TOPIC + "units").empty(), "nothing is followed without a model");
    expect(published<MultiDOFJointTrajectory>(TOPIC + "predictions").empty(), "predictions without a model");
    expect(world().declared.size() == 21, std::to_string(world().declared.size()) + " parameters");
    for (const auto &parameter : world().declared) {
        expect(parameter.second.read_only && !parameter.second.description.empty(), parameter.first + " is not described");
    }
}

// Half a turn, and rotations of covariances, against plain sums.
void turns() {
    part = "frames";
    rf_plane plane = {{0, 0, -1}, 2, 0, 0};
    reset();
    std::array<double, 36> unit{};
    for (std::size_t i = 0; i < 6; i++) unit[7 * i] = static_cast<double>(i + 1);
    // A quarter turn about z: x of the world is -y of the frame.
    const double s = std::sqrt(.5);
    const auto into = rigidformer_ros::into_frame({0, 0, s, s});
    const auto moved = rigidformer_ros::turned(into, std::array<double, 6>{1, 2, 3, 4, 5, 6});
    const std::array<double, 6> wanted = {2, -1, 3, 5, -4, 6};
    const auto turned = rigidformer_ros::turned(into, unit);
    const std::array<double, 6> diagonal = {2, 1, 3, 5, 4, 6};
    for (std::size_t i = 0; i < 6; i++) {
        expect(std::abs(moved[i] - wanted[i]) < 1e-12, "a vector");
        expect(std::abs(turned[7 * i] - diagonal[i]) < 1e-12, "a covariance");
    }
    expect(plane.offset_m == 2, "a plane");
}

}  // namespace

int main(int argc, char **argv) {
    if (argc < 2) return 2;
    const std::string model = argv[1];
    const auto whole = follows(model, false), metres = follows(model, true);
    part = "16UC1 and 32FC1";
    expect(whole.size() == metres.size() && !whole.empty() &&
               whole.back().twist.twist.linear.z == metres.back().twist.twist.linear.z,
           "differ");
    clouds(model);
    damaged(model);
    refusals(model);
    turns();
    if (failures > 0) return 1;
    std::cout << "a box that falls is followed in images and clouds, and predicted on the floor; 25 faults are told of\n";
    return 0;
}
