// push MODEL: the scene of ../push.c through the wrapper. Prints the same lines.
#include <cinttypes>
#include <cstdio>

#include "file.hpp"
#include "simulator.hpp"

using rigidformer::owned_unit;
using rigidformer::simulator;

// Points of a box about its centre: 4 x 4 x 4 at -1, -1/2, 1/2 and 1 times half its sides.
static std::vector<float> box_points(float x, float y, float z) {
    constexpr float grid[4] = {-1.0f, -0.5f, 0.5f, 1.0f};
    std::vector<float> points;
    for (int i = 0; i < 64; i++)
        points.insert(points.end(), {x * grid[i % 4], y * grid[i / 4 % 4], z * grid[i / 16]});
    return points;
}

static rf_pose at(float x, float y, float z) { return {{x, y, z}, {0.0f, 0.0f, 0.0f, 1.0f}}; }

static void run(const char *model_path) {
    rigidformer::aligned_bytes model = read_file(model_path);
    simulator world(model.data(), model.size(), 4, 4 * 64);
    // The ground, and a ramp that rises towards +x: the free side is above it.
    world.set_planes({{{0.0f, 0.0f, 1.0f}, 0.0f, 0.5f, 0.25f},
                      {{-0.6f, 0.0f, 0.8f}, -0.35f, 0.25f, 0.5f}});
    world.set_gravity({0.0f, 0.0f, -9.75f});
    world.set_dt(10.0f / 240.0f);

    // A scene can be built unit by unit; each is at rest.
    const rf_unit_id table = world.add(
        owned_unit(box_points(0.5f, 0.5f, 0.125f), {10.0f, 0.5f, 0.25f}).fixed(), at(0, 0, 0.125f));
    const rf_unit_id box =
        world.add(owned_unit(box_points(0.125f, 0.125f, 0.125f), {0.5f, 0.5f, 0.5f}), at(0, 0, 0.375f));
    const rf_unit_id pusher =
        world.add(owned_unit(box_points(0.0625f, 0.125f, 0.125f), {1.0f, 0.5f, 0.25f}).driven(),
                  at(-0.375f, 0, 0.4375f));

    constexpr int steps = 20;
    std::uint64_t sum = UINT64_C(0xcbf29ce484222325);
    for (int step = 0; step < steps; step++) {
        if (step == 8)
            world.add(owned_unit(box_points(0.0625f, 0.0625f, 0.0625f), {0.25f, 0.5f, 0.5f}),
                      at(0.25f, 0.25f, 0.75f));
        if (step == 14) world.remove(table);
        world.drive(pusher, at(-0.375f + 0.03125f * static_cast<float>(step + 1), 0, 0.4375f));
        world.step();
        const std::vector<rf_internal_pose> poses = world.internal_poses();
        sum = fnv1a(sum, poses.data(), poses.size() * sizeof poses[0]);
    }
    std::printf("roles: %d steps, poses %016" PRIx64 "\n", steps, sum);
    const rf_pose pose = world.pose(box);
    std::printf("the box is at (%.3f, %.3f, %.3f) m\n", static_cast<double>(pose.position[0]),
                static_cast<double>(pose.position[1]), static_cast<double>(pose.position[2]));
}

int main(int count, char **arguments) {
    if (count != 2) {
        std::fprintf(stderr, "usage: %s MODEL\n", arguments[0]);
        return 2;
    }
    try {
        run(arguments[1]);
        return 0;
    } catch (const std::exception &error) {
        std::fprintf(stderr, "%s\n", error.what());
        return 1;
    }
}
