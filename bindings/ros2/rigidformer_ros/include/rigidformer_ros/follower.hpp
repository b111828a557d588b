// Follows rigid bodies in depth images or clouds of points. Knows nothing of ROS.
#pragma once

#include <rigidformer_tracker.h>

#include <array>
#include <cstdint>
#include <optional>
#include <string>
#include <vector>

#include "rigidformer_ros/predictor.hpp"

namespace rigidformer_ros {

// A body that is followed. Its frame is at its centre.
struct Followed {
    std::uint32_t id = 0;
    // RF_TRACK_...
    std::uint32_t flags = 0;
    Pose pose;
    // Of the centre, m/s, and the spin, rad/s, in the world's axes.
    std::array<double, 6> velocity{};
    // By rows: translation, then rotation, in the world's axes.
    std::array<double, 36> pose_covariance{}, velocity_covariance{};
    // Corners of the box around its points, in its frame, metres.
    std::array<double, 3> low{}, high{};
};

// Where bodies will be. Those that are not known well enough are left out.
struct Future {
    std::vector<std::uint32_t> ids;
    double step_s = 0;
    // (steps, ids)
    std::vector<std::vector<Pose>> poses;
};

struct Seen {
    std::vector<Followed> units;
    std::vector<rf_plane> planes;
    // Absent where nothing was to be predicted.
    std::optional<Future> future;
    // What the library has to say of the future it refused; empty where it did not.
    std::string refused;
    rf_capture_report report{};
};

struct FollowerOptions {
    // Path of a packed model; empty for none.
    std::string model;
    std::array<double, 3> gravity = {0, 0, -9.81};
    // Empty: planes are found.
    std::vector<rf_plane> planes;
    double horizon_s = 1;
    // An interval longer than this begins anew.
    double max_gap_s = 2;
    rf_tracker_options rest{};

    // With the library's own.
    FollowerOptions();
};

// Owns its tracker. One call at a time.
class Follower {
public:
    // Throws Refused where options or the model cannot be.
    explicit Follower(FollowerOptions options);

    // What is seen at a time. Throws Refused where a capture cannot be used, or is not later than the last: that one stays. A
    // capture that is more than max_gap_s earlier or later begins anew, and `anew` says why. Views point to memory of the caller.
    Seen observe(std::int64_t stamp_ns, const std::vector<rf_depth_view> &depths,
                 const std::vector<rf_cloud_view> &clouds, std::string *anew = nullptr);

private:
    struct End {
        void operator()(rf_tracker *tracker) const { rf_tracker_destroy(tracker); }
    };

    using Tracker = std::unique_ptr<rf_tracker, End>;

    Tracker begun() const;
    static void check(rf_status status, rf_tracker *tracker);
    Followed followed(const rf_track &track) const;
    Future future(const std::vector<rf_track> &tracks) const;

    FollowerOptions options_;
    Tracker tracker_;
    std::optional<std::int64_t> first_ns_, last_ns_;
};

}  // namespace rigidformer_ros
