#include "rigidformer_ros/follower.hpp"

#include <algorithm>
#include <cmath>
#include <limits>
#include <utility>

namespace rigidformer_ros {
namespace {

// What `read` writes: asked first how many there are. `read` takes an array, its length and where to say how many.
template <typename T, typename Read>
std::vector<T> all(Read read) {
    std::size_t count = 0;
    std::vector<T> found;
    // Twice at most: nothing comes in between.
    if (read(static_cast<T *>(nullptr), std::size_t{0}, &count) == RF_ERROR_BUFFER) {
        found.resize(count);
        if (read(found.data(), found.size(), &count) != RF_OK) found.clear();
    }
    return found;
}

std::array<double, 3> turned(const std::array<double, 4> &q, const std::array<double, 3> &v) {
    const auto [x, y, z, w] = q;
    const std::array<double, 3> t = {2 * (y * v[2] - z * v[1]), 2 * (z * v[0] - x * v[2]),
                                     2 * (x * v[1] - y * v[0])};
    return {v[0] + w * t[0] + y * t[2] - z * t[1], v[1] + w * t[1] + z * t[0] - x * t[2],
            v[2] + w * t[2] + x * t[1] - y * t[0]};
}

// The pose of a frame at the centre.
Pose centred(const rf_pose &pose, const float (&centre)[3]) {
    Pose at;
    std::copy(std::begin(pose.quaternion), std::end(pose.quaternion), at.quaternion.begin());
    const auto way = turned(at.quaternion, {centre[0], centre[1], centre[2]});
    for (std::size_t axis = 0; axis < 3; axis++) {
        at.position[axis] = static_cast<double>(pose.position[axis]) + way[axis];
    }
    return at;
}

}  // namespace

FollowerOptions::FollowerOptions() {
    const rf_status status = rf_tracker_defaults(RF_ABI_VERSION, &rest);
    if (status != RF_OK) {
        throw Refused(rf_error_string(status), "build the package against the installed library", status);
    }
}

Follower::Follower(FollowerOptions options) : options_(std::move(options)), tracker_(begun()) {}

Follower::Tracker Follower::begun() const {
    rf_tracker_options options = options_.rest;
    for (std::size_t axis = 0; axis < 3; axis++) {
        options.gravity_m_s2[axis] = static_cast<float>(options_.gravity[axis]);
    }
    if (!options_.model.empty()) options.model_path = options_.model.c_str();
    if (!options_.planes.empty()) {
        options.planes = options_.planes.data();
        options.plane_count = options_.planes.size();
    }
    rf_tracker *tracker = nullptr;
    char why[512];
    const rf_status status = rf_tracker_create(&options, &tracker, why, sizeof why);
    if (status != RF_OK) throw Refused(why, "correct the parameter", status);
    return Tracker(tracker);
}

void Follower::check(rf_status status, rf_tracker *tracker) {
    if (status == RF_OK) return;
    char why[512];
    const bool is_kept = rf_tracker_message(tracker, why, sizeof why) == RF_OK;
    throw Refused(is_kept ? why : rf_error_string(status), "leave the capture out", status);
}

Seen Follower::observe(std::int64_t stamp_ns, const std::vector<rf_depth_view> &depths,
                       const std::vector<rf_cloud_view> &clouds, std::string *anew) {
    const double gap_s =
        last_ns_ ? static_cast<double>(stamp_ns - *last_ns_) * 1e-9 : 0.0;
    const bool begins = std::abs(gap_s) > options_.max_gap_s;
    // A capture that is refused leaves the old tracks.
    Tracker fresh = begins ? begun() : nullptr;
    // Seconds since the first: a double of nanoseconds since 1970 would not tell captures apart.
    const std::int64_t first_ns = begins ? stamp_ns : first_ns_.value_or(stamp_ns);
    const rf_capture capture = {static_cast<double>(stamp_ns - first_ns) * 1e-9, depths.data(),
                                depths.size(), clouds.data(), clouds.size()};
    Seen seen;
    rf_tracker *const tracker = begins ? fresh.get() : tracker_.get();
    const rf_status status = rf_tracker_observe(tracker, &capture, &seen.report);
    try {
        check(status, tracker);
    } catch (const Refused &) {
        // A tracker with a defect takes no more captures.
        if (status == RF_ERROR_DEFECT && !begins) {
            tracker_ = begun();
            first_ns_.reset();
            last_ns_.reset();
        }
        throw;
    }
    if (begins) {
        if (anew != nullptr) {
            *anew = "this capture is " + std::to_string(gap_s) +
                    " s after the last one, beyond max_gap_s: all tracks begin anew";
        }
        tracker_ = std::move(fresh);
    }
    first_ns_ = first_ns;
    last_ns_ = stamp_ns;

    const auto tracks = all<rf_track>([this](rf_track *slots, std::size_t capacity, std::size_t *count) {
        return rf_tracker_units(tracker_.get(), slots, capacity, count);
    });
    for (const rf_track &track : tracks) seen.units.push_back(followed(track));
    seen.planes = all<rf_plane>([this](rf_plane *slots, std::size_t capacity, std::size_t *count) {
        return rf_tracker_planes(tracker_.get(), slots, capacity, count);
    });
    if (!options_.model.empty()) {
        rf_forecast forecast{};
        if (rf_tracker_predict(tracker_.get(), options_.horizon_s, &forecast) == RF_OK) {
            seen.future = future(tracks);
            seen.future->step_s = forecast.step_s;
        } else {
            char why[512] = "";
            rf_tracker_message(tracker_.get(), why, sizeof why);
            seen.refused = why;
        }
    }
    return seen;
}

Followed Follower::followed(const rf_track &track) const {
    Followed unit;
    unit.id = track.id;
    unit.flags = track.flags;
    unit.pose = centred(track.pose, track.centre);
    std::copy(std::begin(track.velocity), std::end(track.velocity), unit.velocity.begin());
    std::copy(std::begin(track.pose_covariance), std::end(track.pose_covariance),
              unit.pose_covariance.begin());
    std::copy(std::begin(track.velocity_covariance), std::end(track.velocity_covariance),
              unit.velocity_covariance.begin());
    using Point = std::array<float, 3>;
    const auto points = all<Point>([&](Point *slots, std::size_t capacity, std::size_t *count) {
        float *start = slots == nullptr ? nullptr : slots->data();
        return rf_tracker_shape(tracker_.get(), track.id, start, capacity, count);
    });
    if (!points.empty()) {
        unit.low.fill(std::numeric_limits<double>::max());
        unit.high.fill(std::numeric_limits<double>::lowest());
    }
    for (const Point &point : points) {
        for (std::size_t axis = 0; axis < 3; axis++) {
            const double at = static_cast<double>(point[axis]) - static_cast<double>(track.centre[axis]);
            unit.low[axis] = std::min(unit.low[axis], at);
            unit.high[axis] = std::max(unit.high[axis], at);
        }
    }
    return unit;
}

Future Follower::future(const std::vector<rf_track> &tracks) const {
    Future future;
    const auto predictions =
        all<rf_prediction>([this](rf_prediction *slots, std::size_t capacity, std::size_t *count) {
            return rf_tracker_predictions(tracker_.get(), slots, capacity, count);
        });
    for (const rf_prediction &one : predictions) {
        if (one.step == 1) future.ids.push_back(one.id);
        if (one.step > future.poses.size()) future.poses.emplace_back();
        const auto track = std::find_if(tracks.begin(), tracks.end(),
                                        [&](const rf_track &unit) { return unit.id == one.id; });
        const float none[3] = {0, 0, 0};
        future.poses.back().push_back(centred(one.pose, track == tracks.end() ? none : track->centre));
    }
    return future;
}

}  // namespace rigidformer_ros
