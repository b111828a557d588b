// Predicts where rigid bodies will be, from two timed observations of their poses. Knows nothing of ROS.
#pragma once

#include <rigidformer.h>

#include <array>
#include <cstddef>
#include <cstdint>
#include <memory>
#include <new>
#include <optional>
#include <stdexcept>
#include <string>
#include <vector>

namespace rigidformer_ros {

// A pose in a world whose z is up: metres, and a unit quaternion x, y, z, w. In double, as ROS has it; the library
// computes in float.
struct Pose {
    std::array<double, 3> position{};
    std::array<double, 4> quaternion{0, 0, 0, 1};
};

// A rigid body. Its frame is that of the observed poses.
struct Unit {
    std::string name;
    // Edges of a box around the origin of its frame, metres. Not looked at where there are points.
    std::array<double, 3> size{};
    // Points on its surface, metres: they say where it is where it is no box. Empty for boxes.
    std::vector<std::array<double, 3>> points;
    double mass_kg = 1;
    double friction = .5;
    double restitution = 0;
    // Scenery, such as a table: nothing moves it.
    bool fixed = false;
};

// What a scene stands on.
struct Ground {
    double height_m = 0;
    double friction = .5;
    double restitution = 0;
};

struct Scene {
    std::vector<Unit> units;
    // m/s^2; the model's where absent.
    std::optional<std::array<double, 3>> gravity;
    // Absent: z = 0 with the friction and restitution of the model. Empty: none.
    std::optional<std::vector<Ground>> ground;
};

struct Times {
    double horizon_s = .5;
    // The horizon is a whole number of steps.
    double step_s = 1.0 / 24;
    // Observations farther apart than this do not make a pair.
    double max_gap_s = 1.0 / 6;
    // Nor do closer ones: the noise of two poses over a short time is a large velocity. Below what trackers have from frame to
    // frame, jitter included, or every other one would be left out.
    double min_gap_s = 1e-3;
};

struct Observation {
    std::int64_t stamp_ns = 0;
    std::string frame;
    // In the order of the units.
    std::vector<Pose> poses;
};

struct Prediction {
    std::string frame;
    // Of the observation that it starts from.
    std::int64_t observed_ns = 0;
    // One for each step.
    std::vector<std::int64_t> stamps_ns;
    // (steps, units)
    std::vector<std::vector<Pose>> poses;
    // Where the units were observed.
    std::vector<Pose> observed;
};

// What was refused: why, and what to do about it.
struct Refused : std::runtime_error {
    Refused(const std::string &why, const std::string &remedy, rf_status code = RF_OK)
        : std::runtime_error(why + "; remedy: " + remedy), code(code) {}
    // The library's; RF_OK where the library was not asked.
    rf_status code;
};

// Bytes at an address that the library accepts.
class AlignedBytes {
public:
    explicit AlignedBytes(std::size_t size)
        : size_(size), data_(static_cast<std::uint8_t *>(
                           ::operator new(size, std::align_val_t{RF_ALIGNMENT}))) {}
    std::uint8_t *data() { return data_.get(); }
    const std::uint8_t *data() const { return data_.get(); }
    std::size_t size() const { return size_; }

private:
    struct Release {
        void operator()(std::uint8_t *data) const {
            ::operator delete(data, std::align_val_t{RF_ALIGNMENT});
        }
    };
    std::size_t size_;
    std::unique_ptr<std::uint8_t, Release> data_;
};

// A model file in memory. Throws Refused.
AlignedBytes read_model(const std::string &file);

// Owns its model, its workspace and the last observation. One call at a time.
class Predictor {
public:
    // Throws Refused where the scene, the times or the model cannot be.
    Predictor(AlignedBytes model, Scene scene, Times times);
    Predictor(Predictor &&) = default;
    // Member by member it would free the workspace before its simulator ends.
    Predictor &operator=(Predictor &&) = delete;

    // Predicts from the last observation and this one, which becomes the last.
    //
    // Nothing is predicted from the first one, nor where the last is farther back than max_gap_s, later by more than
    // max_gap_s (a bag or a simulation that began again), or in another frame: `gap` then says why, and this observation
    // is the first of a new pair. Nothing is predicted from one that is closer than min_gap_s either: the last one stays,
    // and makes a pair with a later one. Throws Refused where an observation cannot be used; the last one stays.
    std::optional<Prediction> observe(const Observation &observation, std::string *gap = nullptr);

    const std::vector<Unit> &units() const { return scene_.units; }
    // Bytes of the workspace.
    std::size_t workspace_bytes() const { return workspace_.size(); }

private:
    struct End {
        void operator()(rf_simulator *simulator) const { rf_release(simulator); }
    };

    void check(rf_status status, const char *remedy) const;
    void take(double dt_s, const std::vector<rf_pose> &before, const std::vector<rf_pose> &now,
              const char *remedy);
    Prediction roll_out(const Observation &observation, const std::array<double, 2> &origin);

    // In this order: the simulator ends before its workspace does.
    AlignedBytes model_;
    Scene scene_;
    Times times_;
    std::size_t steps_;
    std::vector<rf_physics> physics_;
    std::vector<std::uint32_t> counts_;
    std::vector<std::uint32_t> roles_;
    std::vector<float> points_;
    AlignedBytes workspace_;
    std::unique_ptr<rf_simulator, End> simulator_;
    std::optional<Observation> last_;
};

}  // namespace rigidformer_ros
