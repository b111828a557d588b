/* Loads a model from flash, is handed nonsense, and rolls a recorded scene out. Prints the last
   poses as bits, and a hash of all poses of all steps. Then runs the scene of roles in ../push.c. */
#include <rigidformer.h>
#include <string.h>

#include "../push.h"
#include "board.h"

enum { UNITS = 10, POINTS = 64, STEPS = 100 };

extern const uint8_t rf_model[], rf_model_end[]; /* share/rigidformer/model.S */

/* A scene of firmware-sim/firmware/scenes, embedded in the same way. */
typedef struct {
    uint32_t step, units, points;
    rf_physics physics[UNITS];
    float previous[UNITS][POINTS][3], current[UNITS][POINTS][3];
} recorded;
extern const recorded scene;

/* With SECTIONS=1 of the Makefile, each goes into a memory of its own: see sections.ld. */
#ifdef SECTIONS
__attribute__((section(".rf_fast")))
#endif
static _Alignas(RF_ALIGNMENT) uint8_t memory[WORKSPACE_BYTES];
static float frame[UNITS + 1][POINTS][3];

static void print_error(const char *what, const rf_detail *detail) {
    print(what), print(": error "), print_number((uint64_t)detail->code);
    print(", "), print(rf_error_string(detail->code));
    if (detail->unit != RF_NONE) print("; unit "), print_number(detail->unit);
    if (detail->index != RF_NONE) print(", index "), print_number(detail->index);
    if (detail->expected) {
        print("; found "), print_number(detail->found);
        print(", expected "), print_number(detail->expected);
    }
    print("\n");
}

/* FNV-1a with 64 bits, of the bytes as they lie in memory: the least significant first. */
static uint64_t hash(uint64_t sum, const void *data, size_t bytes) {
    const uint8_t *at = data;
    for (size_t i = 0; i < bytes; i++) sum = (sum ^ at[i]) * UINT64_C(0x00000100000001b3);
    return sum;
}

static void print_pose(uint32_t unit, const rf_internal_pose *pose) {
    print("contact: unit "), print_number(unit), print(" [");
    for (int i = 0; i < 12; i++) {
        uint32_t bits;
        memcpy(&bits, i < 9 ? &pose->rotation[i] : &pose->centre[i - 9], sizeof bits);
        print(i ? ", " : ""), print_hex(bits, 8);
    }
    print("]\n");
}

int main(void) {
    const uint32_t counts[UNITS + 1] = {64, 64, 64, 64, 64, 64, 64, 64, 64, 64, 64};
    const rf_units units = {.unit_count = UNITS, .physics = scene.physics, .point_counts = counts,
                            .point_count = UNITS * POINTS};
    const float dt_s = (float)scene.step / 240.0f;
    const float *previous = &scene.previous[0][0][0], *current = &scene.current[0][0][0];
    rf_config config = {RF_ABI_VERSION, UNITS, UNITS * POINTS, 0, rf_model,
                        (size_t)(rf_model_end - rf_model)};
    rf_simulator *simulator;
    rf_detail detail;
    size_t bytes = 0;

    /* A model that is none, and one that lost its end: said, and gone on from. */
    rf_config bad = config;
    bad.model = (const uint8_t *)&scene;
    if (rf_init(&bad, memory, sizeof memory, &simulator, &detail)) print_error("no model", &detail);
    bad = config;
    bad.model_bytes /= 2;
    if (rf_init(&bad, memory, sizeof memory, &simulator, &detail)) {
        detail.found = detail.expected = 0; /* other models have other lengths */
        print_error("half a model", &detail);
    }

    if (rf_workspace_bytes(&config, &bytes) != RF_OK) return 1;
#ifdef SECTIONS
    print("measured address of the workspace "), print_hex((uintptr_t)memory, 8), print("\n");
    print("measured address of the model "), print_hex((uintptr_t)rf_model, 8), print("\n");
#endif
    print("measured workspace "), print_number(bytes), print("\n");
    if (rf_init(&config, memory, bytes, &simulator, &detail)) {
        print_error("init", &detail);
        return 1;
    }
    if (rf_step(simulator, NULL) && !rf_last_error_detail(simulator, &detail))
        print_error("nothing seen yet", &detail);

    /* One unit too many, and a point that is not a number. */
    memcpy(frame, previous, sizeof scene.previous);
    memcpy(frame[UNITS], previous, sizeof frame[UNITS]);
    static rf_physics physics[UNITS + 1];
    memcpy(physics, scene.physics, sizeof scene.physics);
    physics[UNITS] = scene.physics[0];
    const rf_units more = {.unit_count = UNITS + 1, .physics = physics, .point_counts = counts,
                           .point_count = (UNITS + 1) * POINTS};
    if (rf_observe(simulator, dt_s, &more, &frame[0][0][0], &frame[0][0][0], NULL)
        && !rf_last_error_detail(simulator, &detail))
        print_error("too many units", &detail);
    const uint32_t nan = 0x7fc00000;
    memcpy(&frame[3][7][1], &nan, sizeof nan);
    if (rf_observe(simulator, dt_s, &units, previous, &frame[0][0][0], NULL)
        && !rf_last_error_detail(simulator, &detail))
        print_error("not a number", &detail);

    /* And now for what it is there for. */
    rf_status status = rf_observe(simulator, dt_s, &units, previous, current, NULL);
    static rf_internal_pose poses[UNITS];
    uint64_t sum = UINT64_C(0xcbf29ce484222325);
    uint32_t active = 0, most = 0;
    for (int step = 0; step < STEPS && !status; step++) {
        rf_step_report report = {0, 0, 0, 0};
        (void)instructions();
        status = rf_step(simulator, &report);
        const uint32_t took = instructions();
        if (took > most) most = took;
        if (!status) status = rf_internal_poses(simulator, poses, UNITS);
        active += report.active_units;
        sum = hash(sum, poses, sizeof poses);
    }
    if (status) {
        print("failed: "), print(rf_error_string(status)), print("\n");
        return 1;
    }
    for (uint32_t unit = 0; unit < UNITS; unit++) print_pose(unit, &poses[unit]);
    print("contact: "), print_number(STEPS), print(" steps, active "), print_number(active);
    print(", poses "), print_hex(sum, 16), print("\n");
    rf_pose box;
    status = push(simulator, &sum, &box);
    if (status) {
        print("failed: "), print(rf_error_string(status)), print("\n");
        return 1;
    }
    print("roles: "), print_number(PUSH_STEPS), print(" steps, poses "), print_hex(sum, 16);
    print("\n");
    print("measured instructions of a step, at most "), print_number(most), print("\n");
    print("measured stack "), print_number(stack_high_water()), print("\n");
    return 0;
}
