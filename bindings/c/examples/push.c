/* Roles: a table that is fixed, a pusher that goes where it is told, and a box that the model moves. */
#include "push.h"

enum { TABLE, BOX, PUSHER };

static float points[3][PUSH_POINTS][3], small[PUSH_POINTS][3];

/* Points of a box about its centre: 4 x 4 x 4 at -1, -1/2, 1/2 and 1 times half its sides. */
static void fill(float to[PUSH_POINTS][3], float x, float y, float z) {
    static const float grid[4] = {-1.0f, -0.5f, 0.5f, 1.0f};
    for (int i = 0; i < PUSH_POINTS; i++) {
        to[i][0] = x * grid[i % 4];
        to[i][1] = y * grid[i / 4 % 4];
        to[i][2] = z * grid[i / 16];
    }
}

static rf_pose at(float x, float y, float z) {
    const rf_pose pose = {{x, y, z}, {0.0f, 0.0f, 0.0f, 1.0f}};
    return pose;
}

/* FNV-1a with 64 bits, of the bytes as they lie in memory: the least significant first. */
static uint64_t hash(uint64_t sum, const void *data, size_t bytes) {
    const uint8_t *byte = data;
    for (size_t i = 0; i < bytes; i++) sum = (sum ^ byte[i]) * UINT64_C(0x00000100000001b3);
    return sum;
}

rf_status push(rf_simulator *simulator, uint64_t *sum, rf_pose *box) {
    /* The ground, and a ramp that rises towards +x: the free side is above it. */
    static const rf_plane planes[2] = {
        {{0.0f, 0.0f, 1.0f}, 0.0f, 0.5f, 0.25f},
        {{-0.6f, 0.0f, 0.8f}, -0.35f, 0.25f, 0.5f},
    };
    static const float gravity[3] = {0.0f, 0.0f, -9.75f};
    static const rf_physics physics[3] = {{10, 0.5f, 0.25f}, {0.5f, 0.5f, 0.5f}, {1, 0.5f, 0.25f}};
    static const uint32_t counts[3] = {PUSH_POINTS, PUSH_POINTS, PUSH_POINTS};
    static const uint32_t roles[3] = {RF_ROLE_FIXED, RF_ROLE_FREE, RF_ROLE_DRIVEN};
    const rf_units units = {.unit_count = 3, .physics = physics, .point_counts = counts,
                            .point_count = 3 * PUSH_POINTS, .roles = roles};
    const rf_pose poses[3] = {at(0, 0, 0.125f), at(0, 0, 0.375f), at(-0.375f, 0, 0.4375f)};
    fill(points[TABLE], 0.5f, 0.5f, 0.125f);
    fill(points[BOX], 0.125f, 0.125f, 0.125f);
    fill(points[PUSHER], 0.0625f, 0.125f, 0.125f);
    fill(small, 0.0625f, 0.0625f, 0.0625f);

    rf_status status = rf_set_planes(simulator, planes, 2);
    if (!status) status = rf_set_gravity(simulator, gravity);
    /* All at rest: the poses of a step ago are those of now. */
    if (!status)
        status = rf_observe_poses(simulator, 10.0f / 240.0f, &units, points[0][0], poses, poses, NULL);
    rf_unit_id ids[3];
    if (!status) status = rf_unit_ids(simulator, ids, 3);

    *sum = UINT64_C(0xcbf29ce484222325);
    static rf_internal_pose internal[PUSH_UNITS];
    for (int step = 0; step < PUSH_STEPS && !status; step++) {
        if (step == 8) {
            const rf_unit unit = {.physics = {0.25f, 0.5f, 0.5f}, .role = RF_ROLE_FREE, .body = RF_OWN_BODY,
                                  .points = small[0], .point_count = PUSH_POINTS};
            const rf_pose pose = at(0.25f, 0.25f, 0.75f);
            status = rf_add(simulator, &unit, &pose, &pose, NULL);
        }
        if (!status && step == 14) status = rf_remove(simulator, ids[TABLE]);
        /* 3 cm a step; the pusher is there exactly when the step is done. */
        const rf_pose target = at(-0.375f + 0.03125f * (float)(step + 1), 0, 0.4375f);
        if (!status) status = rf_drive(simulator, ids[PUSHER], &target);
        if (!status) status = rf_step(simulator, NULL);
        uint32_t count = 0;
        if (!status) status = rf_unit_count(simulator, &count);
        if (!status) status = rf_internal_poses(simulator, internal, PUSH_UNITS);
        if (!status) *sum = hash(*sum, internal, count * sizeof *internal);
    }
    return status ? status : rf_unit_pose(simulator, ids[BOX], box);
}
