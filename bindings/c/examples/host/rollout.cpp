// rollout MODEL SCENE: what the firmware example does, on Linux. Prints the same lines.
#include <cinttypes>
#include <cstdio>
#include <cstring>
#include <limits>

#include "file.hpp"
#include "simulator.hpp"

using rigidformer::aligned_bytes;
using rigidformer::simulator;

// A scene of firmware-sim/firmware/scenes: three counts, then physics and two frames.
struct recorded {
    explicit recorded(aligned_bytes file) {
        std::uint32_t counts[3];
        if (file.size() < sizeof counts) throw std::runtime_error("the scene is cut off");
        std::memcpy(counts, file.data(), sizeof counts);
        dt_s = static_cast<float>(counts[0]) / 240.0f;
        physics.resize(counts[1]);
        point_counts.assign(counts[1], counts[2]);
        const std::size_t numbers = std::size_t{3} * counts[1] * counts[2];
        previous.resize(numbers);
        current.resize(numbers);
        const std::uint8_t *at = file.data() + sizeof counts;
        if (file.size() != sizeof counts + physics.size() * sizeof(rf_physics) + 8 * numbers)
            throw std::runtime_error("the scene has another length than its counts say");
        std::memcpy(physics.data(), at, physics.size() * sizeof(rf_physics));
        at += physics.size() * sizeof(rf_physics);
        std::memcpy(previous.data(), at, 4 * numbers);
        std::memcpy(current.data(), at + 4 * numbers, 4 * numbers);
    }

    rf_units units() const {
        rf_units units{};
        units.unit_count = physics.size();
        units.physics = physics.data();
        units.point_counts = point_counts.data();
        units.point_count = previous.size() / 3;
        return units;
    }

    float dt_s;
    std::vector<rf_physics> physics;
    std::vector<std::uint32_t> point_counts;
    std::vector<float> previous, current;
};

// What the call throws, as a line.
template <typename Call> static void refused(const char *what, Call call) {
    try {
        call();
        std::printf("%s: accepted\n", what);
    } catch (const rigidformer::error &error) {
        std::printf("%s: error %d, %s\n", what, error.detail.code, error.what());
    }
}

static int run(const char *model_path, const char *scene_path) {
    aligned_bytes model = read_file(model_path);
    const recorded scene(read_file(scene_path));
    const rf_units units = scene.units();
    const auto limits = [&](std::uint8_t *model, std::size_t bytes) {
        return rf_config{RF_ABI_VERSION, static_cast<std::uint32_t>(units.unit_count),
                         static_cast<std::uint32_t>(units.point_count), 0, model, bytes};
    };
    aligned_bytes other = read_file(scene_path);
    refused("no model", [&] { simulator(limits(other.data(), other.size())); });
    refused("half a model", [&] { simulator(limits(model.data(), model.size() / 2)); });

    // Moved, to show that it can be.
    simulator first(limits(model.data(), model.size()));
    simulator world = std::move(first);
    refused("nothing seen yet", [&] { world.step(); });
    rf_units more = units;
    const std::vector<rf_physics> physics(units.unit_count + 1, scene.physics[0]);
    const std::vector<std::uint32_t> counts(units.unit_count + 1, scene.point_counts[0]);
    more.unit_count = physics.size();
    more.physics = physics.data();
    more.point_counts = counts.data();
    more.point_count += counts[0];
    std::vector<float> frame = scene.previous;
    frame.insert(frame.end(), frame.begin(), frame.begin() + 3 * counts[0]);
    refused("too many units", [&] { world.observe(scene.dt_s, more, frame.data(), frame.data()); });
    std::vector<float> current = scene.current;
    current[3 * (3 * 64 + 7) + 1] = std::numeric_limits<float>::quiet_NaN();
    refused("not a number",
            [&] { world.observe(scene.dt_s, units, scene.previous.data(), current.data()); });

    constexpr int steps = 100;
    world.observe(scene.dt_s, units, scene.previous.data(), scene.current.data());
    std::uint64_t sum = UINT64_C(0xcbf29ce484222325);
    std::uint32_t active = 0;
    std::vector<rf_internal_pose> poses;
    for (int step = 0; step < steps; step++) {
        active += world.step().active_units;
        poses = world.internal_poses();
        sum = fnv1a(sum, poses.data(), poses.size() * sizeof poses[0]);
    }
    for (std::size_t unit = 0; unit < poses.size(); unit++) {
        std::printf("contact: unit %zu [", unit);
        std::uint32_t bits[12];
        static_assert(sizeof bits == sizeof(rf_internal_pose));
        std::memcpy(bits, &poses[unit], sizeof bits);
        for (int i = 0; i < 12; i++) std::printf("%s%08" PRIx32, i ? ", " : "", bits[i]);
        std::printf("]\n");
    }
    std::printf("contact: %d steps, active %" PRIu32 ", poses %016" PRIx64 "\n", steps, active, sum);
    return 0;
}

int main(int count, char **arguments) {
    if (count != 3) {
        std::fprintf(stderr, "usage: %s MODEL SCENE\n", arguments[0]);
        return 2;
    }
    try {
        return run(arguments[1], arguments[2]);
    } catch (const std::exception &error) {
        std::fprintf(stderr, "%s\n", error.what());
        return 1;
    }
}
