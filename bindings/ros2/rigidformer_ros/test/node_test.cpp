// Runs the node in this process: node_test model.rfm. Prints what it proved, or what is wrong.
#define main predictor_node_main
#include "../src/predictor_node.cpp"
#undef main

#include <cmath>
#include <cstring>
#include <fstream>
#include <iostream>
#include <limits>

namespace {

using geometry_msgs::msg::PoseArray;
using nav_msgs::msg::Path;
using rclcpp::Parameter;
using rclcpp::stub::published;
using rclcpp::stub::world;
using rigidformer_ros::PredictorNode;
using visualization_msgs::msg::Marker;
using visualization_msgs::msg::MarkerArray;

const std::string TOPIC = "/rigidformer_predictor/";
constexpr double DT = 1.0 / 30;
constexpr int STEPS = 12;
constexpr float STEP_S = static_cast<float>(1.0 / 24);

int failures = 0;
std::string part;

void expect(bool holds, const std::string &what) {
    if (holds) return;
    std::cerr << part << ": " << what << "\n";
    failures++;
}

struct Scene {
    const char *name;
    // Edges of each box.
    std::vector<std::array<double, 3>> sizes;
    std::vector<double> masses;
    std::vector<bool> fixed;
    // Where each is at a time.
    std::function<std::vector<geometry_msgs::msg::Pose>(double)> at;
    // Where in the frame's x and y all that is, metres: multiples of 1024, of which C calls know nothing.
    std::array<double, 2> origin{};

    std::vector<geometry_msgs::msg::Pose> seen(double t) const {
        auto poses = at(t);
        for (auto &pose : poses) {
            // 0 would change the sign of a zero.
            if (origin[0] != 0) pose.position.x += origin[0];
            if (origin[1] != 0) pose.position.y += origin[1];
        }
        return poses;
    }
};

geometry_msgs::msg::Pose placed(double x, double y, double z, double turn = 0) {
    geometry_msgs::msg::Pose pose;
    pose.position.x = x;
    pose.position.y = y;
    pose.position.z = z;
    pose.orientation.z = std::sin(turn / 2);
    pose.orientation.w = std::cos(turn / 2);
    return pose;
}

const std::vector<Scene> SCENES = {
    {"a box falls",
     {{.2, .3, .1}},
     {1.5},
     {false},
     [](double t) { return std::vector{placed(.1, -.2, .9 - 4.9 * t * t, .3 * t)}; },
     {}},
    {"a box slides",
     {{.2, .2, .1}},
     {.8},
     {false},
     [](double t) { return std::vector{placed(1.2 * t, .1, .05)}; },
     {}},
    {"a box slides into one that a table holds",
     {{.1, .1, .1}, {.12, .12, .1}, {1, .6, .04}},
     {.4, .9, 5},
     {false, false, true},
     [](double t) {
         return std::vector{placed(-.2 + .9 * t, 0, .55), placed(0, 0, .55), placed(-0., 0, .48)};
     },
     {}},
};

std::vector<Parameter> parameters(const std::string &model, const Scene &scene) {
    std::vector<Parameter> all = {{"model", model},
                                  {"horizon_s", STEPS / 24.0},
                                  {"step_s", 1.0 / 24},
                                  {"gravity", std::vector<double>{0, 0, -9.81}},
                                  {"ground", "plane"},
                                  {"ground_friction", .4},
                                  {"ground_restitution", .2}};
    std::vector<std::string> names;
    for (std::size_t i = 0; i < scene.sizes.size(); i++) {
        const std::string name = "unit" + std::to_string(i), prefix = "units." + name + ".";
        const auto &size = scene.sizes[i];
        names.push_back(name);
        all.emplace_back(prefix + "size", std::vector<double>(size.begin(), size.end()));
        all.emplace_back(prefix + "mass_kg", scene.masses[i]);
        all.emplace_back(prefix + "friction", .6);
        all.emplace_back(prefix + "restitution", .1);
        all.emplace_back(prefix + "fixed", static_cast<bool>(scene.fixed[i]));
    }
    all.emplace_back("units.names", names);
    return all;
}

// Replaces one parameter.
std::vector<Parameter> with(std::vector<Parameter> all, const Parameter &parameter) {
    for (Parameter &other : all) {
        if (other.get_name() == parameter.get_name()) {
            other = parameter;
            return all;
        }
    }
    all.push_back(parameter);
    return all;
}

std::vector<Parameter> without(const std::vector<Parameter> &all, const std::string &name) {
    std::vector<Parameter> rest;
    for (const Parameter &parameter : all) {
        if (parameter.get_name() != name) rest.push_back(parameter);
    }
    return rest;
}

constexpr std::int64_t START_NS = 1700000000900000000;
std::int64_t time_ns(double t) { return START_NS + std::llround(t * 1e9); }

PoseArray message(const std::string &frame, std::int64_t ns,
                  std::vector<geometry_msgs::msg::Pose> poses) {
    PoseArray array;
    array.header.frame_id = frame;
    array.header.stamp.sec = static_cast<std::int32_t>(ns / 1000000000);
    array.header.stamp.nanosec = static_cast<std::uint32_t>(ns % 1000000000);
    array.poses = std::move(poses);
    return array;
}

std::int64_t time_of(const builtin_interfaces::msg::Time &stamp) {
    return std::int64_t{stamp.sec} * 1000000000 + stamp.nanosec;
}

void reset() {
    world().published.clear();
    world().logs.clear();
}

std::size_t warnings() {
    std::size_t count = 0;
    for (const auto &log : world().logs) count += log.level == "WARN";
    return count;
}

bool same(double a, float b, double origin = 0) {
    const double wanted = origin != 0 ? origin + b : double{b};
    return std::memcmp(&a, &wanted, sizeof a) == 0;
}

bool same(const geometry_msgs::msg::Pose &pose, const rf_pose &wanted,
          const std::array<double, 2> &origin) {
    return same(pose.position.x, wanted.position[0], origin[0]) &&
           same(pose.position.y, wanted.position[1], origin[1]) &&
           same(pose.position.z, wanted.position[2]) &&
           same(pose.orientation.x, wanted.quaternion[0]) &&
           same(pose.orientation.y, wanted.quaternion[1]) &&
           same(pose.orientation.z, wanted.quaternion[2]) &&
           same(pose.orientation.w, wanted.quaternion[3]);
}

// The same by C calls alone: the poses after each step.
std::vector<std::vector<rf_pose>> by_c(const std::string &model, const Scene &scene, double before_s,
                                       double now_s) {
    const std::size_t units = scene.sizes.size();
    std::ifstream file(model, std::ios::binary);
    const std::string bytes((std::istreambuf_iterator<char>(file)), {});
    std::vector<std::max_align_t> kept(bytes.size() / sizeof(std::max_align_t) + 1);
    std::memcpy(kept.data(), bytes.data(), bytes.size());
    const rf_config config = {RF_ABI_VERSION,
                              static_cast<std::uint32_t>(units),
                              static_cast<std::uint32_t>(8 * units),
                              0,
                              reinterpret_cast<const std::uint8_t *>(kept.data()),
                              bytes.size()};
    std::size_t size = 0;
    expect(rf_workspace_bytes(&config, &size) == RF_OK, "rf_workspace_bytes");
    std::vector<std::max_align_t> memory(size / sizeof(std::max_align_t) + 1);
    rf_simulator *simulator = nullptr;
    expect(rf_init(&config, memory.data(), size, &simulator, nullptr) == RF_OK, "rf_init");

    std::vector<float> points;
    std::vector<rf_physics> physics;
    std::vector<std::uint32_t> counts, roles;
    for (std::size_t i = 0; i < units; i++) {
        for (int z = 0; z < 2; z++) {
            for (int y = 0; y < 2; y++) {
                for (int x = 0; x < 2; x++) {
                    points.push_back(static_cast<float>((x - .5) * scene.sizes[i][0]));
                    points.push_back(static_cast<float>((y - .5) * scene.sizes[i][1]));
                    points.push_back(static_cast<float>((z - .5) * scene.sizes[i][2]));
                }
            }
        }
        physics.push_back({static_cast<float>(scene.masses[i]), .6F, .1F});
        counts.push_back(8);
        roles.push_back(scene.fixed[i] ? RF_ROLE_FIXED : RF_ROLE_FREE);
    }
    const auto at = [&](double t) {
        std::vector<rf_pose> poses;
        for (const auto &pose : scene.seen(t)) {
            poses.push_back({{static_cast<float>(pose.position.x - scene.origin[0]),
                              static_cast<float>(pose.position.y - scene.origin[1]),
                              static_cast<float>(pose.position.z)},
                             {static_cast<float>(pose.orientation.x),
                              static_cast<float>(pose.orientation.y),
                              static_cast<float>(pose.orientation.z),
                              static_cast<float>(pose.orientation.w)}});
        }
        return poses;
    };
    const float gravity[3] = {0, 0, -9.81F};
    const rf_plane ground = {{0, 0, 1}, 0, .4F, .2F};
    rf_units all{};
    all.unit_count = units;
    all.physics = physics.data();
    all.point_counts = counts.data();
    all.point_count = 8 * units;
    all.roles = roles.data();
    const auto dt_s =
        static_cast<float>(static_cast<double>(time_ns(now_s) - time_ns(before_s)) / 1e9);
    const std::vector<rf_pose> before = at(before_s), now = at(now_s);
    expect(rf_set_gravity(simulator, gravity) == RF_OK, "rf_set_gravity");
    expect(rf_set_planes(simulator, &ground, 1) == RF_OK, "rf_set_planes");
    expect(rf_observe_poses(simulator, dt_s, &all, points.data(), before.data(), now.data(),
                            nullptr) == RF_OK,
           "rf_observe_poses");
    expect(rf_set_dt(simulator, STEP_S) == RF_OK, "rf_set_dt");
    std::vector<std::vector<rf_pose>> steps;
    for (int step = 0; step < STEPS; step++) {
        std::vector<rf_pose> poses(units);
        expect(rf_step(simulator, nullptr) == RF_OK, "rf_step");
        expect(rf_poses(simulator, poses.data(), units) == RF_OK, "rf_poses");
        steps.push_back(poses);
    }
    rf_release(simulator);
    return steps;
}

// A second after the last one, so that each warning is heard.
void send(const PoseArray &array) {
    world().steady_ns += 1000000000;
    rclcpp::stub::send(TOPIC + "poses", array);
}

void send(const Scene &scene, double t, const std::string &frame = "map") {
    send(message(frame, time_ns(t), scene.seen(t)));
}

// What was published for the observation at a time, with the bits of C calls.
void compare(const std::string &model, const Scene &scene, double before_s, double now_s,
             const std::string &frame) {
    const auto wanted = by_c(model, scene, before_s, now_s);
    const std::size_t units = scene.sizes.size();
    const std::int64_t observed = time_ns(now_s);
    const std::int64_t ahead = observed + 500000000;

    const auto predicted = published<PoseArray>(TOPIC + "predicted");
    expect(!predicted.empty(), "no poses are published");
    if (predicted.empty()) return;
    expect(predicted.back().header.frame_id == frame, "the frame of the poses");
    expect(time_of(predicted.back().header.stamp) == ahead, "the stamp of the poses");
    expect(predicted.back().poses.size() == units, "the number of poses");
    for (std::size_t i = 0; i < units; i++) {
        expect(same(predicted.back().poses[i], wanted.back()[i], scene.origin), "the bits of a pose");
        const auto paths = published<Path>(TOPIC + "paths/unit" + std::to_string(i));
        expect(!paths.empty() && paths.back().poses.size() == STEPS, "the length of a path");
        if (paths.empty() || paths.back().poses.size() != STEPS) return;
        expect(time_of(paths.back().header.stamp) == observed, "the stamp of a path");
        expect(paths.back().header.frame_id == frame, "the frame of a path");
        for (int step = 0; step < STEPS; step++) {
            const auto at = static_cast<std::size_t>(step);
            const auto &pose = paths.back().poses[at];
            expect(same(pose.pose, wanted[at][i], scene.origin), "the bits of a path");
            expect(pose.header.frame_id == frame, "the frame on a path");
            expect(time_of(pose.header.stamp) ==
                       observed + std::llround(5e8 * (step + 1) / double{STEPS}),
                   "the stamps of a path");
        }
    }

    const auto arrays = published<MarkerArray>(TOPIC + "markers");
    expect(arrays.size() == predicted.size(), "the number of arrays of markers");
    expect(!arrays.empty() && arrays.back().markers.size() == 2 * units, "the number of markers");
    if (arrays.empty() || arrays.back().markers.size() != 2 * units) return;
    for (std::size_t i = 0; i < units; i++) {
        const Marker &body = arrays.back().markers[2 * i], &way = arrays.back().markers[2 * i + 1];
        for (const Marker *marker : {&body, &way}) {
            expect(marker->header.frame_id == frame && marker->id == static_cast<int>(i) &&
                       time_of(marker->header.stamp) == observed && marker->action == Marker::ADD &&
                       marker->color.a > 0,
                   "what markers have in common");
            expect(marker->lifetime.sec == 0 && marker->lifetime.nanosec == 166666667,
                   "the lifetime of markers");
        }
        expect(body.ns == "units" && body.type == Marker::CUBE, "the marker of a unit");
        expect(body.scale.x == scene.sizes[i][0] && body.scale.y == scene.sizes[i][1] &&
                   body.scale.z == scene.sizes[i][2],
               "the size of a marker");
        expect(same(body.pose, wanted.back()[i], scene.origin), "the pose of a marker");
        expect(way.ns == "paths" && way.type == Marker::LINE_STRIP && way.points.size() == STEPS + 1 &&
                   way.pose.orientation.w == 1,
               "the marker of a path");
        const auto start = scene.seen(now_s)[i].position;
        expect(!way.points.empty() && way.points[0].x == start.x && way.points[0].y == start.y &&
                   way.points[0].z == start.z,
               "the start of the marker of a path");
        for (std::size_t step = 0; step < STEPS && step + 1 < way.points.size(); step++) {
            const auto &at = way.points[step + 1];
            const rf_pose &pose = wanted[step][i];
            expect(same(at.x, pose.position[0], scene.origin[0]) &&
                       same(at.y, pose.position[1], scene.origin[1]) && same(at.z, pose.position[2]),
                   "the bits of the marker of a path");
        }
    }
}

void predicts(const std::string &model, const Scene &scene) {
    part = scene.name + std::string(scene.origin[0] != 0 ? ", far away" : "");
    reset();
    const PredictorNode node(rclcpp::NodeOptions().parameter_overrides(parameters(model, scene)));
    send(scene, 0);
    expect(published<PoseArray>(TOPIC + "predicted").empty(), "one observation predicts");
    send(scene, DT);
    compare(model, scene, 0, DT, "map");
    // Not the distance of the first pair.
    send(scene, 2.5 * DT);
    compare(model, scene, DT, 2.5 * DT, "map");
    expect(published<PoseArray>(TOPIC + "predicted").size() == 2, "the number of predictions");
    expect(warnings() == 0, "a warning");
}

// On a map, whose coordinates are beyond what floats tell apart, and beyond 1e6 m.
void far(const std::string &model) {
    for (Scene scene : SCENES) {
        scene.origin = {512 * 1024, -4096 * 1024};
        predicts(model, scene);
    }
    // Not a multiple of anything: the prediction is moved by as much, to what floats are good for.
    part = "a box slides far away";
    const std::array<double, 2> by = {500000.3, -700000.7};
    const Scene &near = SCENES[1];
    Scene there = near;
    there.origin = by;
    std::vector<geometry_msgs::msg::Pose> ends;
    for (const Scene &scene : {near, there}) {
        reset();
        const PredictorNode node(rclcpp::NodeOptions().parameter_overrides(parameters(model, scene)));
        for (int i = 0; i < 2; i++) send(scene, i * DT);
        const auto predicted = published<PoseArray>(TOPIC + "predicted");
        expect(predicted.size() == 1, "no prediction");
        if (predicted.size() == 1) ends.push_back(predicted[0].poses[0]);
    }
    expect(ends.size() == 2 && std::abs(ends[1].position.x - by[0] - ends[0].position.x) < 5e-3 &&
               std::abs(ends[1].position.y - by[1] - ends[0].position.y) < 5e-3,
           "it ends elsewhere");
}

// Observations closer than min_gap_s wait for a later one, in silence; bad ones are told of.
void too_close(const std::string &model) {
    part = "min_gap_s";
    const Scene &scene = SCENES[0];
    reset();
    const PredictorNode node(rclcpp::NodeOptions().parameter_overrides(parameters(model, scene)));
    const auto count = [] { return published<PoseArray>(TOPIC + "predicted").size(); };
    for (double t : {0., 1e-9, 2e-4, 9e-4}) send(scene, t);
    expect(count() == 0 && warnings() == 0, "two that are too close predict, or warn");
    send(scene, DT);
    compare(model, scene, 0, DT, "map");
    auto bad = scene.at(DT + 5e-4);
    bad[0].position.x = std::numeric_limits<double>::quiet_NaN();
    send(message("map", time_ns(DT + 5e-4), bad));
    expect(count() == 1 && warnings() == 1, "a bad one that is too close is not told of");
    send(scene, DT + 6e-4);
    send(scene, 2 * DT);
    compare(model, scene, DT, 2 * DT, "map");
    expect(count() == 2, "the number of predictions");
    // Trackers, whose stamps are rounded to a nanosecond and jitter.
    std::size_t pairs = 2;
    double t = 2 * DT;
    for (const double hz : {240., 250., 500., 1000.}) {
        for (int i = 1; i <= 8; i++) {
            t += 1 / hz;
            send(scene, t + (hz < 1000 ? (i % 2 - .5) * 2e-4 : 0));
        }
        pairs += 8;
        expect(count() == pairs, "a tracker of " + std::to_string(hz) + " Hz makes " +
               std::to_string(count()) + " pairs of " + std::to_string(pairs));
    }
    // As told, not always the default.
    const PredictorNode slow(rclcpp::NodeOptions().parameter_overrides(
        with(parameters(model, scene), {"min_gap_s", .05})));
    reset();
    send(scene, 0);
    send(scene, DT);
    expect(count() == 0, "closer than min_gap_s predicts");
    send(scene, 2 * DT);
    compare(model, scene, 0, 2 * DT, "map");
    // A file that knows of no shortest gap may have a short longest one.
    const PredictorNode fast(rclcpp::NodeOptions().parameter_overrides(
        with(parameters(model, scene), {"max_gap_s", 1e-3})));
}

// Once a second by a clock that neither stands still nor goes back, whatever the node's does.
void warns(const std::string &model) {
    part = "warnings";
    reset();
    const PredictorNode node(rclcpp::NodeOptions().parameter_overrides(parameters(model, SCENES[0])));
    const PoseArray none = message("map", time_ns(0), {});
    const std::int64_t before_ns = world().ros_ns;
    // As before the first message on /clock, then at 100 s, then as after a bag began again.
    for (double now : {0., 100., 3., 3.}) {
        world().ros_ns = std::llround(now * 1e9);
        const std::size_t warned = warnings();
        send(none);
        expect(warnings() == warned + 1, "none at " + std::to_string(now) + " s of the node's clock");
        world().steady_ns += 999999999;
        rclcpp::stub::send(TOPIC + "poses", none);
        expect(warnings() == warned + 1, "two within a second");
    }
    world().ros_ns = before_ns;
}

// Every observation that is refused, then one whose prediction shows that the last good one stayed.
void refuses(const std::string &model) {
    part = "refusals";
    const Scene &scene = SCENES[2];
    reset();
    const PredictorNode node(rclcpp::NodeOptions().parameter_overrides(parameters(model, scene)));
    const auto refused = [&](const std::string &what, const PoseArray &array,
                             const std::string &why, const std::string &remedy) {
        const std::size_t before = published<PoseArray>(TOPIC + "predicted").size();
        const std::size_t warned = warnings();
        send(array);
        expect(published<PoseArray>(TOPIC + "predicted").size() == before, what + ": it predicts");
        expect(published<MarkerArray>(TOPIC + "markers").size() == before, what + ": it marks");
        expect(warnings() == warned + 1, what + ": not one warning");
        const std::string text = world().logs.empty() ? "" : world().logs.back().text;
        expect(text.find(why) != std::string::npos, what + ": '" + text + "' lacks '" + why + "'");
        const std::size_t at = text.find("; remedy: ");
        expect(at != std::string::npos && text.find(remedy, at) != std::string::npos,
               what + ": '" + text + "' lacks the remedy '" + remedy + "'");
    };
    const double next = 2 * DT;
    const auto poses = [&] { return scene.at(next); };
    const auto changed = [&](const std::function<void(geometry_msgs::msg::Pose &)> &change) {
        auto all = poses();
        change(all[1]);
        return message("map", time_ns(next), all);
    };
    const std::string pose_text = std::string(rf_error_string(RF_ERROR_BAD_POSE)) + "; unit unit1";
    const std::string pose_remedy = "publish finite poses in metres";
    const double nan = std::numeric_limits<double>::quiet_NaN();
    // The first unit, near which floats count from, in the first observation: no earlier one is far from it.
    for (double bad : {nan, std::numeric_limits<double>::infinity(), 1e300, -2e9}) {
        auto all = poses();
        all[0].position.x = bad;
        refused("the first unit at " + std::to_string(bad), message("map", time_ns(next), all),
                std::string(rf_error_string(RF_ERROR_BAD_POSE)) + "; unit unit0", pose_remedy);
    }

    send(scene, 0);
    send(scene, DT);
    auto few = poses();
    few.pop_back();
    refused("a pose too few", message("map", time_ns(next), few),
            "an observation has 2 poses, and there are 3 units", "one pose for each of units.names");
    auto many = poses();
    many.push_back(many.back());
    refused("a pose too many", message("map", time_ns(next), many),
            "an observation has 4 poses, and there are 3 units", "one pose for each of units.names");
    refused("none", message("map", time_ns(next), {}), "an observation has 0 poses", "one pose");

    refused("a position that is no number", changed([&](auto &pose) { pose.position.y = nan; }),
            pose_text, pose_remedy);
    refused("an infinite position",
            changed([](auto &pose) { pose.position.z = std::numeric_limits<double>::infinity(); }),
            pose_text, pose_remedy);
    refused("a position beyond float", changed([](auto &pose) { pose.position.x = 1e300; }),
            pose_text, pose_remedy);
    refused("a position beyond 1e6 m", changed([](auto &pose) { pose.position.x = 2e6; }), pose_text,
            pose_remedy);
    refused("a quaternion that is no number",
            changed([&](auto &pose) { pose.orientation.x = nan; }), pose_text, pose_remedy);
    refused("a quaternion of zeros",
            changed([](auto &pose) { pose.orientation.z = pose.orientation.w = 0; }), pose_text,
            pose_remedy);

    refused("the same stamp again", message("map", time_ns(DT), poses()),
            "follows one of", "in the order of their stamps");
    refused("a stamp that goes back", message("map", time_ns(DT / 2), poses()),
            "follows one of", "in the order of their stamps");
    refused("a stamp that goes back by nearly max_gap_s", message("map", time_ns(DT - .166), poses()),
            "follows one of", "in the order of their stamps");
    send(scene, next);
    compare(model, scene, DT, next, "map");

    // A gap starts anew; there is nothing to go on with, and the next pair is sound.
    refused("a gap", message("map", time_ns(.5), scene.at(.5)), "max_gap_s is 0.166667",
            "publish poses more often");
    send(scene, .5 + DT);
    compare(model, scene, .5, .5 + DT, "map");
    refused("another frame", message("odom", time_ns(.6), scene.at(.6)),
            "the frame was map and is odom", "publish all poses in one frame");
    send(scene, .6 + DT, "odom");
    compare(model, scene, .6, .6 + DT, "odom");

    // A bag begins again, and once a stamp is of the future: each costs a pair.
    refused("a bag that begins again", message("odom", time_ns(.1), scene.at(.1)),
            "farther back than max_gap_s, 0.166667", "none where a bag or a simulation began again");
    send(scene, .1 + DT, "odom");
    compare(model, scene, .1, .1 + DT, "odom");
    refused("a stamp of the future", message("odom", time_ns(1e8), scene.at(.2)), "max_gap_s is",
            "more often");
    refused("what follows it", message("odom", time_ns(.2), scene.at(.2)),
            "farther back than max_gap_s", "in the order of their stamps");
    send(scene, .2 + DT, "odom");
    compare(model, scene, .2, .2 + DT, "odom");

    // After a gap a bad observation is no first one: the last one stays, and the gap too.
    auto bad = scene.at(1);
    bad[0].position.x = nan;
    refused("a bad observation after a gap", message("odom", time_ns(1), bad),
            rf_error_string(RF_ERROR_BAD_POSE), pose_remedy);
    refused("a good one after that", message("odom", time_ns(1 + DT), scene.at(1 + DT)),
            "max_gap_s", "more often");
    send(scene, 1 + 2 * DT, "odom");
    compare(model, scene, 1 + DT, 1 + 2 * DT, "odom");
}

// Parameters that cannot be end the node with a text and a remedy.
void parameters_refused(const std::string &model) {
    part = "parameters";
    const std::vector<Parameter> good = parameters(model, SCENES[1]);
    const auto refused = [&](const std::vector<Parameter> &all, const std::string &why,
                             const std::string &remedy) {
        world().arguments = all;
        reset();
        char name[] = "predictor_node";
        char *arguments[] = {name, nullptr};
        expect(predictor_node_main(1, arguments) == 1, why + ": the node starts");
        const std::string text = world().logs.empty() ? "" : world().logs.back().text;
        expect(!world().logs.empty() && world().logs.back().level == "FATAL" &&
                   text.find(why) != std::string::npos && text.find(remedy) != std::string::npos,
               "'" + text + "' lacks '" + why + "' or '" + remedy + "'");
    };
    using Numbers = std::vector<double>;
    using Names = std::vector<std::string>;
    refused(with(good, {"model", "no/such.rfm"}), "cannot open the model no/such.rfm",
            "set the parameter model");
    refused(with(good, {"model", "/"}), "cannot read the model /", "set the parameter model");
    refused(with(good, {"model", __FILE__}), rf_error_string(RF_ERROR_MODEL_MAGIC),
            "name a whole .rfm file");
    const std::string folder = model.substr(0, model.find_last_of('/') + 1);
    refused(with(good, {"model", folder + "g1.rfm"}), rf_error_string(RF_ERROR_NO_COMMAND),
            "take a model without a command, such as nano.rfm");
    refused(with(good, {"max_gap_s", 60.}), "", "lower max_gap_s");
    refused({{"model", model}}, rf_error_string(RF_ERROR_NO_UNITS), "units.names");
    refused(without(good, "units.names"), "there is no parameter units.unit0.",
            "add the unit to units.names");
    refused(with(good, {"units.crate.mass_kg", 2.}), "there is no parameter units.crate.mass_kg",
            "add the unit to units.names");
    refused(with(good, {"units.name", Names{"unit0"}}), "there is no parameter units.name;",
            "correct the name");
    refused(with(good, {"units.unit0.mass", 2.}), "there is no parameter units.unit0.mass;",
            "a unit has size, points, mass_kg");
    refused(with(without(good, "units.unit0.size"), {"units.unit0.sise", Numbers{1, 1, 1}}),
            "there is no parameter units.unit0.sise", "correct the name");
    refused(with(good, {"ground_frictoin", .5}), "there is no parameter ground_frictoin",
            "ground_height_m, ground_friction");
    for (const char *ground : {"model", "none"}) {
        // Sections for all nodes name topics so.
        const PredictorNode other(rclcpp::NodeOptions().parameter_overrides(
            with(good, {"ground_truth_topic", "/truth"})));
        refused(with(good, {"ground", ground}), "ground_friction is set, and ground is " +
                std::string(ground), "set ground to plane, or leave out ground_friction");
    }
    refused(without(good, "ground"), "ground_friction is set, and ground is model",
            "set ground to plane");
    refused(with(good, {"units.names", Names{"unit0", "unit0"}}), "unit0 twice", "its own name");
    for (const char *name : {"", "a b", "1st", "a/b", "a__b", "a_", "names"}) {
        refused(with(good, {"units.names", Names{name}}), std::string("units.names has '") + name,
                "use letters");
    }
    refused(without(good, "units.unit0.size"), "units.unit0.size has 0 numbers", "three");
    refused(with(good, {"units.unit0.size", Numbers{1, 0, 1}}), "an edge of 0 m",
            "three lengths above 0");
    refused(with(good, {"units.unit0.points", Numbers{1, 2, 3, 4}}), "points has 4 numbers",
            "x, y, z");
    refused(with(good, {"units.unit0.points", Numbers{1, 2, 3}}),
            std::string(rf_error_string(RF_ERROR_TOO_FEW_POINTS)) + "; unit unit0",
            "correct the parameters of that unit");
    refused(with(good, {"units.unit0.mass_kg", 0.}), "units.unit0.mass_kg is out of its range", "");
    refused(with(good, {"units.unit0.friction", -1.}), "friction is out of its range", "");
    refused(with(good, {"units.unit0.mass_kg", true}), "mass_kg has another type", "");
    refused(with(good, {"gravity", Numbers{0, 0}}), "gravity has 2 numbers", "three");
    refused(with(good, {"gravity", Numbers{0, 0, 2e4}}), rf_error_string(RF_ERROR_BAD_GRAVITY),
            "give gravity three numbers");
    refused(with(good, {"ground", "grass"}), "ground is 'grass'", "model, plane or none");
    refused(with(good, {"ground_friction", 2000.}), "ground_friction is out of its range", "");
    refused(with(good, {"horizon_s", .52}), "horizon_s is 12.48 times step_s", "whole number");
    refused(with(good, {"step_s", 1.}), "step_s is out of its range", "");
    refused(with(good, {"max_gap_s", 0.}), "max_gap_s is out of its range", "");
    refused(with(good, {"min_gap_s", 0.}), "min_gap_s is out of its range", "");
    const double max_gap_s = rigidformer_ros::Times().max_gap_s;
    for (double gap_s : {.2, max_gap_s}) {
        refused(with(good, {"min_gap_s", gap_s}), "and at most 0.166667 s",
                "give min_gap_s above 0 and below max_gap_s");
    }
    for (const auto &[name, descriptor] : world().declared) {
        expect(!descriptor.description.empty() && descriptor.read_only, name + " is not described");
    }

    // Ranges may let NaN pass, and others take the class without the node.
    const double nan = std::numeric_limits<double>::quiet_NaN();
    const double infinite = std::numeric_limits<double>::infinity();
    for (double gap_s : {nan, -1., 0., infinite, 1e-60}) {
        rigidformer_ros::Times times;
        times.min_gap_s = gap_s;
        // 1e-60 is no float above 0.
        if (gap_s == infinite) times.max_gap_s = infinite;
        rigidformer_ros::Scene scene;
        scene.units.push_back({"unit0", {.1, .1, .1}, {}, 1, .5, 0, false});
        std::string text;
        try {
            rigidformer_ros::Predictor(rigidformer_ros::read_model(model), scene, times);
        } catch (const rigidformer_ros::Refused &refusal) {
            text = refusal.what();
        }
        expect(text.find("_gap_s") != std::string::npos,
               "min_gap_s of " + std::to_string(gap_s) + ": '" + text + "'");
    }

    // main() itself, with all that is good; points instead of a box, no ground and the model's gravity.
    part = "main";
    Numbers tetrahedron = {.1, .1, .1, -.1, -.1, .1, -.1, .1, -.1, .1, -.1, -.1};
    auto some = with(with(good, {"units.unit0.points", tetrahedron}), {"ground", "none"});
    for (const char *name : {"gravity", "units.unit0.size", "ground_friction", "ground_restitution"}) {
        some = without(some, name);
    }
    world().arguments = some;
    reset();
    world().spinning = [] {
        for (int i = 0; i < 2; i++) send(SCENES[1], i * DT);
    };
    char name[] = "predictor_node";
    char *arguments[] = {name, nullptr};
    expect(predictor_node_main(1, arguments) == 0, "it fails");
    world().spinning = nullptr;
    const auto predicted = published<PoseArray>(TOPIC + "predicted");
    expect(predicted.size() == 1 && predicted[0].poses[0].position.z < -.5,
           "what nothing holds does not fall");
    const auto markers = published<MarkerArray>(TOPIC + "markers");
    expect(markers.size() == 1 && markers[0].markers[0].type == Marker::SPHERE_LIST &&
               markers[0].markers[0].points.size() == 4,
           "the marker of points");
    expect(warnings() == 0, "a warning");
}

}  // namespace

int main(int argc, char **argv) {
    if (argc != 2) {
        std::cerr << "node_test model.rfm\n";
        return 2;
    }
    try {
        for (const Scene &scene : SCENES) predicts(argv[1], scene);
        far(argv[1]);
        too_close(argv[1]);
        warns(argv[1]);
        refuses(argv[1]);
        parameters_refused(argv[1]);
    } catch (const std::exception &error) {
        std::cerr << part << ": " << error.what() << "\n";
        failures++;
    }
    if (failures != 0) {
        std::cerr << failures << " things are wrong\n";
        return 1;
    }
    std::cout << "node: " << SCENES.size()
              << " scenes with the bits of C calls, there and far away, every refusal warned of, none published\n";
    return 0;
}
