#include "fall.h"

/* Half an edge of each box, m. */
static const float HALF[FALL_UNITS] = {0.1f, 0.08f};

static rf_config config_of(const uint8_t *model, size_t model_bytes) {
    const rf_config config = {RF_ABI_VERSION, FALL_UNITS, FALL_POINTS, 0, model, model_bytes};
    return config;
}

size_t fall_bytes(const uint8_t *model, size_t model_bytes) {
    const rf_config config = config_of(model, model_bytes);
    size_t bytes = 0;
    return rf_workspace_bytes(&config, &bytes) == RF_OK ? bytes : 0;
}

rf_status fall_run(const uint8_t *model, size_t model_bytes, void *memory, size_t bytes,
                   void (*say)(int step, const rf_pose poses[FALL_UNITS])) {
    static const rf_physics physics[FALL_UNITS] = {{2.0f, 0.5f, 0.1f}, {0.5f, 0.5f, 0.3f}};
    static const uint32_t counts[FALL_UNITS] = {8, 8};
    float points[FALL_POINTS][3];
    for (int i = 0; i < FALL_POINTS; i++) {
        const float half = HALF[i / 8];
        for (int axis = 0; axis < 3; axis++) points[i][axis] = i >> axis & 1 ? half : -half;
    }
    /* One stands; the other is above its edge, and has fallen 5 cm in the last step. */
    const rf_pose before[FALL_UNITS] = {{{0, 0, 0.1f}, {0, 0, 0, 1}},
                                        {{0.06f, 0, 0.55f}, {0, 0, 0, 1}}};
    const rf_pose now[FALL_UNITS] = {{{0, 0, 0.1f}, {0, 0, 0, 1}},
                                     {{0.06f, 0, 0.5f}, {0, 0, 0, 1}}};
    rf_units units = {0};
    units.unit_count = FALL_UNITS;
    units.physics = physics;
    units.point_counts = counts;
    units.point_count = FALL_POINTS;

    const rf_config config = config_of(model, model_bytes);
    rf_simulator *simulator = NULL;
    rf_status status = rf_init(&config, memory, bytes, &simulator, NULL);
    if (status == RF_OK) {
        status = rf_observe_poses(simulator, 1.0f / 24.0f, &units, points[0], before, now, NULL);
    }
    for (int step = 1; step <= FALL_STEPS && status == RF_OK; step++) {
        rf_pose poses[FALL_UNITS];
        status = rf_step(simulator, NULL);
        if (status == RF_OK) status = rf_poses(simulator, poses, FALL_UNITS);
        if (status == RF_OK) say(step, poses);
    }
    return status;
}
