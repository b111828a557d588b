#include "rigidformer_ros/predictor.hpp"

#include <algorithm>
#include <cmath>
#include <fstream>
#include <iterator>
#include <utility>

namespace rigidformer_ros {
namespace {

constexpr double SECOND_NS = 1e9;
// A part of the shortest gap. Trackers of exactly that rate have stamps that are rounded; half of them would be too close.
constexpr double ROUNDING = 1e-3;
// An origin of the library's floats is a multiple of this: at half of it their step is 0.03 mm.
constexpr double GRID_M = 1024;
// Doubles are finer than floats out to here; beyond it is no place.
constexpr double FARTHEST_M = 1e9;
// What to do about a pose that the library refuses.
constexpr const char *POSES = "publish finite poses in metres, with quaternions of length 1";

std::string number(double value) {
    std::string text = std::to_string(value);
    text.erase(text.find_last_not_of('0') + 1);
    if (!text.empty() && text.back() == '.') text.pop_back();
    return text;
}

// The library's text with its numbers; units by name.
std::string told(const rf_detail &detail, const std::vector<Unit> &units) {
    std::string text = rf_error_string(detail.code);
    if (detail.unit < units.size()) text += "; unit " + units[detail.unit].name;
    if (detail.index != RF_NONE) text += ", index " + std::to_string(detail.index);
    if (detail.found != 0 || detail.expected != 0) {
        text += "; found " + std::to_string(detail.found);
        text += ", expected " + std::to_string(detail.expected);
    }
    return text;
}

// Points that span a unit: those that were given, or the corners of its box.
std::vector<float> points_of(const Unit &unit) {
    std::vector<float> points;
    const auto add = [&](double x, double y, double z) {
        for (double value : {x, y, z}) points.push_back(static_cast<float>(value));
    };
    for (const auto &point : unit.points) add(point[0], point[1], point[2]);
    if (!unit.points.empty()) return points;
    for (std::size_t axis = 0; axis < 3; axis++) {
        // Written so that NaN is refused too.
        if (!(unit.size[axis] > 0)) {
            throw Refused("unit " + unit.name + " has an edge of " + number(unit.size[axis]) + " m",
                          "give units." + unit.name + ".size three lengths above 0, or .points");
        }
    }
    for (int corner = 0; corner < 8; corner++) {
        const auto side = [&](int axis) {
            return (corner >> axis & 1 ? .5 : -.5) * unit.size[static_cast<std::size_t>(axis)];
        };
        add(side(0), side(1), side(2));
    }
    return points;
}

std::size_t steps_of(const Times &times) {
    if (!(times.step_s > 0) || !(times.horizon_s > 0) || !std::isfinite(times.horizon_s)) {
        throw Refused("a horizon of " + number(times.horizon_s) + " s in steps of " +
                          number(times.step_s) + " s",
                      "give horizon_s and step_s above 0");
    }
    if (!(times.max_gap_s > 0)) {
        throw Refused("a gap of at most " + number(times.max_gap_s) + " s",
                      "give max_gap_s above 0");
    }
    if (!(times.min_gap_s > 0) || !(times.min_gap_s < times.max_gap_s)) {
        throw Refused("a gap of at least " + number(times.min_gap_s) + " s and at most " +
                          number(times.max_gap_s) + " s",
                      "give min_gap_s above 0 and below max_gap_s");
    }
    const double steps = times.horizon_s / times.step_s;
    const double whole = std::round(steps);
    // A millionth of a step is rounding; a tenth is a mistake.
    if (whole < 1 || std::abs(steps - whole) > 1e-3 || whole > 1e5) {
        throw Refused("horizon_s is " + number(steps) + " times step_s",
                      "make it a whole number of steps, from 1 to 100000");
    }
    return static_cast<std::size_t>(whole);
}

rf_config config_of(const AlignedBytes &model, std::size_t units, std::size_t points) {
    return {RF_ABI_VERSION,
            static_cast<std::uint32_t>(units),
            static_cast<std::uint32_t>(points),
            0,
            model.data(),
            model.size()};
}

// What the library needs, or why it does not take the model.
std::size_t needed(const AlignedBytes &model, std::size_t units, std::size_t points) {
    if (units == 0) {
        throw Refused(rf_error_string(RF_ERROR_NO_UNITS), "name units in units.names",
                      RF_ERROR_NO_UNITS);
    }
    const rf_config config = config_of(model, units, points);
    std::size_t bytes = 0;
    const rf_status status = rf_workspace_bytes(&config, &bytes);
    if (status != RF_OK) {
        throw Refused(std::string("the model: ") + rf_error_string(status),
                      "name a whole .rfm file that this version of the library reads", status);
    }
    return bytes;
}

// Where in x and y the library's floats count from: near the first unit. A map's coordinates are large, and at 500 km a
// float's step is 3 cm, which is a metre a second between two frames. z stays, for the ground's height is told in it; the
// ground is level, and nothing else has a place. Within half of GRID_M of the frame's origin that origin stays.
std::array<double, 2> origin_of(const std::vector<Pose> &poses) {
    std::array<double, 2> origin{};
    for (std::size_t axis = 0; axis < 2 && !poses.empty(); axis++) {
        const double at = poses.front().position[axis];
        // Of what is no number or no place the library says which unit it is.
        if (!(std::abs(at) <= FARTHEST_M)) continue;
        // Never -0: less that, a -0 would be a 0.
        origin[axis] = std::round(at / GRID_M) * GRID_M + 0.0;
    }
    return origin;
}

std::vector<rf_pose> poses_of(const Observation &observation, const std::array<double, 2> &origin) {
    std::vector<rf_pose> poses;
    for (const Pose &from : observation.poses) {
        rf_pose pose{};
        for (std::size_t i = 0; i < 3; i++) {
            const double at = i < 2 ? from.position[i] - origin[i] : from.position[i];
            pose.position[i] = static_cast<float>(at);
        }
        for (std::size_t i = 0; i < 4; i++) {
            pose.quaternion[i] = static_cast<float>(from.quaternion[i]);
        }
        poses.push_back(pose);
    }
    return poses;
}

double seconds(std::int64_t ns) { return static_cast<double>(ns) / SECOND_NS; }

}  // namespace

AlignedBytes read_model(const std::string &file) {
    const auto refuse = [&](const char *why) -> Refused {
        return {why + (" the model " + file), "set the parameter model to an .rfm file"};
    };
    std::ifstream stream(file, std::ios::binary | std::ios::ate);
    if (!stream) throw refuse("cannot open");
    const std::streamoff size = stream.tellg();
    // A folder opens, and says a length that no file has.
    if (size <= 0 || size > std::streamoff{1} << 40) throw refuse("cannot read");
    AlignedBytes bytes(static_cast<std::size_t>(size));
    stream.seekg(0);
    stream.read(reinterpret_cast<char *>(bytes.data()), static_cast<std::streamsize>(size));
    if (!stream) throw refuse("cannot read");
    return bytes;
}

Predictor::Predictor(AlignedBytes model, Scene scene, Times times)
    : model_(std::move(model)), scene_(std::move(scene)), times_(times), steps_(steps_of(times)),
      workspace_(0) {
    for (const Unit &unit : scene_.units) {
        const std::vector<float> points = points_of(unit);
        points_.insert(points_.end(), points.begin(), points.end());
        counts_.push_back(static_cast<std::uint32_t>(points.size() / 3));
        physics_.push_back({static_cast<float>(unit.mass_kg), static_cast<float>(unit.friction),
                            static_cast<float>(unit.restitution)});
        roles_.push_back(unit.fixed ? RF_ROLE_FIXED : RF_ROLE_FREE);
    }
    const std::size_t units = scene_.units.size();
    workspace_ = AlignedBytes(needed(model_, units, points_.size() / 3));
    const rf_config config = config_of(model_, units, points_.size() / 3);
    rf_detail detail{};
    rf_simulator *simulator = nullptr;
    const rf_status status =
        rf_init(&config, workspace_.data(), workspace_.size(), &simulator, &detail);
    if (status != RF_OK) {
        throw Refused("the model: " + told(detail, scene_.units),
                      "name a whole .rfm file that this version of the library reads", status);
    }
    simulator_.reset(simulator);
    if (scene_.gravity) {
        std::array<float, 3> gravity{};
        std::transform(scene_.gravity->begin(), scene_.gravity->end(), gravity.begin(),
                       [](double value) { return static_cast<float>(value); });
        check(rf_set_gravity(simulator_.get(), gravity.data()),
              "give gravity three numbers, m/s^2, each at most 1e4");
    }
    if (scene_.ground) {
        std::vector<rf_plane> planes;
        for (const Ground &ground : *scene_.ground) {
            planes.push_back({{0, 0, 1},
                              static_cast<float>(ground.height_m),
                              static_cast<float>(ground.friction),
                              static_cast<float>(ground.restitution)});
        }
        check(rf_set_planes(simulator_.get(), planes.data(), planes.size()),
              "correct ground_height_m, ground_friction and ground_restitution");
    }
    // The units themselves, before any observation: what is wrong with them is wrong from the start.
    std::vector<rf_pose> anywhere(units);
    for (rf_pose &pose : anywhere) pose.quaternion[3] = 1;
    // The longest pair that observe() tries: one that the model refuses would be refused ever after.
    take(times_.max_gap_s, anywhere, anywhere,
         "correct the parameters of that unit, or lower max_gap_s");
    take(times_.min_gap_s, anywhere, anywhere,
         "correct the parameters of that unit, or raise min_gap_s");
    take(times_.step_s, anywhere, anywhere, "correct the parameters of that unit");
    // A model that needs a command would refuse every step. What else a step may fail of depends on where units are.
    const rf_status trial = rf_step(simulator_.get(), nullptr);
    if (trial == RF_ERROR_NO_COMMAND) {
        check(trial, "take a model without a command, such as nano.rfm");
    }
}

std::optional<Prediction> Predictor::observe(const Observation &observation, std::string *gap) {
    const std::size_t count = scene_.units.size();
    if (observation.poses.size() != count) {
        throw Refused("an observation has " + std::to_string(observation.poses.size()) +
                          " poses, and there are " + std::to_string(count) + " units",
                      "publish one pose for each of units.names, in that order");
    }
    const std::array<double, 2> origin = origin_of(observation.poses);
    const std::vector<rf_pose> now = poses_of(observation, origin);
    std::string why;
    bool starts = true;
    if (last_ && last_->frame != observation.frame) {
        why = "the frame was " + last_->frame + " and is " + observation.frame +
              "; remedy: publish all poses in one frame whose z is up";
    } else if (last_) {
        const double dt_s = seconds(observation.stamp_ns - last_->stamp_ns);
        const std::string order = "an observation of " + number(seconds(observation.stamp_ns)) +
                                  " s follows one of " + number(seconds(last_->stamp_ns)) + " s";
        // Otherwise one stamp of the future, or a bag that begins again, would end all predictions.
        if (dt_s < -times_.max_gap_s) {
            why = order + ", farther back than max_gap_s, " + number(times_.max_gap_s) +
                  "; remedy: none where a bag or a simulation began again, otherwise publish poses "
                  "in the order of their stamps";
        } else if (dt_s <= 0) {
            throw Refused(order, "publish poses in the order of their stamps");
        } else if (dt_s > times_.max_gap_s) {
            why = "observations are " + number(dt_s) + " s apart, and max_gap_s is " +
                  number(times_.max_gap_s) + "; remedy: publish poses more often";
        } else if (dt_s < times_.min_gap_s * (1 - ROUNDING)) {
            starts = false;
        } else {
            take(dt_s, poses_of(*last_, origin), now, POSES);
            // Velocities stay; a step takes another time than the pair did.
            check(rf_set_dt(simulator_.get(), static_cast<float>(times_.step_s)),
                  "give step_s a number above 0");
            Prediction prediction = roll_out(observation, origin);
            last_ = observation;
            return prediction;
        }
    }
    // The first of a pair must be sound too, or it would spoil the next one. Of those too close a bad one is told of too.
    take(times_.step_s, now, now, POSES);
    if (starts) last_ = observation;
    if (gap != nullptr) *gap = why;
    return std::nullopt;
}

void Predictor::take(double dt_s, const std::vector<rf_pose> &before,
                     const std::vector<rf_pose> &now, const char *remedy) {
    rf_units units{};
    units.unit_count = scene_.units.size();
    units.physics = physics_.data();
    units.point_counts = counts_.data();
    units.point_count = points_.size() / 3;
    units.roles = roles_.data();
    check(rf_observe_poses(simulator_.get(), static_cast<float>(dt_s), &units, points_.data(),
                           before.data(), now.data(), nullptr),
          remedy);
}

Prediction Predictor::roll_out(const Observation &observation,
                               const std::array<double, 2> &origin) {
    Prediction prediction{observation.frame, observation.stamp_ns, {}, {}, observation.poses};
    std::vector<rf_pose> poses(scene_.units.size());
    for (std::size_t step = 1; step <= steps_; step++) {
        check(rf_step(simulator_.get(), nullptr),
              "look for units that overlap or moved too far between two observations");
        check(rf_poses(simulator_.get(), poses.data(), poses.size()), "report this");
        // From the whole horizon, so that the last stamp has no rounding of the steps.
        const double ahead_s =
            times_.horizon_s * static_cast<double>(step) / static_cast<double>(steps_);
        prediction.stamps_ns.push_back(observation.stamp_ns + std::llround(ahead_s * SECOND_NS));
        std::vector<Pose> all;
        for (const rf_pose &pose : poses) {
            Pose to;
            std::copy(std::begin(pose.position), std::end(pose.position), to.position.begin());
            for (std::size_t axis = 0; axis < 2; axis++) {
                // To add 0 would change the sign of a zero.
                if (origin[axis] != 0) to.position[axis] += origin[axis];
            }
            std::copy(std::begin(pose.quaternion), std::end(pose.quaternion),
                      to.quaternion.begin());
            all.push_back(to);
        }
        prediction.poses.push_back(std::move(all));
    }
    return prediction;
}

void Predictor::check(rf_status status, const char *remedy) const {
    if (status == RF_OK) return;
    rf_detail detail{status, RF_NONE, RF_NONE, 0, 0, 0};
    rf_last_error_detail(simulator_.get(), &detail);
    throw Refused(told(detail, scene_.units), remedy, status);
}

}  // namespace rigidformer_ros
