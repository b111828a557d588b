/* A wall of four bricks that hold together falls on the ground, and its model says which bonds break: shatter fragments.rfm. */
#include <rigidformer.h>

#include <inttypes.h>
#include <stdio.h>
#include <stdlib.h>

enum { BRICKS = 4, POINTS = 64, BONDS = 4, STEPS = 20, LET_GO = 2 };

/* A whole model in memory that begins where it must; NULL without one. */
static uint8_t *whole(const char *path, size_t *bytes) {
    FILE *file = fopen(path, "rb");
    if (!file) return NULL;
    uint8_t *memory = NULL;
    if (!fseek(file, 0, SEEK_END)) {
        const long length = ftell(file);
        *bytes = length > 0 ? (size_t)length : 0;
        rewind(file);
        if (*bytes) memory = aligned_alloc(RF_ALIGNMENT, (*bytes + RF_ALIGNMENT - 1) / RF_ALIGNMENT * RF_ALIGNMENT);
        if (memory && fread(memory, 1, *bytes, file) != *bytes) free(memory), memory = NULL;
    }
    fclose(file);
    return memory;
}

static uint64_t hash(uint64_t sum, const void *data, size_t bytes) {
    const uint8_t *byte = data;
    for (size_t i = 0; i < bytes; i++) sum = (sum ^ byte[i]) * UINT64_C(0x00000100000001b3);
    return sum;
}

/* What a caller may get wrong. Each is refused, and the bonds are what they were. */
static int refuses(rf_simulator *simulator, const rf_unit_id ids[BRICKS]) {
    const rf_unit_id twice[2] = {ids[1], ids[0]}, itself[2] = {ids[2], ids[2]}, nowhere[2] = {ids[0], ids[3] + 1000};
    const rf_status found[4] = {rf_bond(simulator, twice, 1), rf_bond(simulator, itself, 1), rf_bond(simulator, nowhere, 1),
                                rf_break_bond(simulator, ids[0], ids[3], NULL)};
    const rf_status expected[4] = {RF_ERROR_BOND_TWICE, RF_ERROR_BOND_ITSELF, RF_ERROR_NO_SUCH_ID, RF_ERROR_NO_SUCH_BOND};
    for (int i = 0; i < 4; i++) {
        if (found[i] != expected[i]) return 0;
        printf("refused: error %d, %s\n", (int)found[i], rf_error_string(found[i]));
    }
    return 1;
}

static rf_status go(rf_simulator *simulator) {
    static float points[BRICKS][POINTS][3];
    static const float grid[4] = {-0.25f, -0.125f, 0.125f, 0.25f};
    /* They are one body, whose parts do not touch each other while bonds hold them. */
    static const int32_t bodies[BRICKS] = {1, 1, 1, 1};
    /* Two on two, turned about y so that the wall lands on an edge: x and height of each one's middle. */
    static const float places[BRICKS][2] = {{-0.35f, 1.95f}, {0.05f, 1.65f}, {-0.05f, 2.35f}, {0.35f, 2.05f}};
    rf_physics physics[BRICKS];
    rf_pose before[BRICKS], now[BRICKS];
    uint32_t counts[BRICKS];
    for (int brick = 0; brick < BRICKS; brick++) {
        const rf_physics of = {125.0f, 0.5f, 0.125f};
        const rf_pose here = {{places[brick][0], 0.0f, places[brick][1]}, {0.0f, 0.31622777f, 0.0f, 0.9486833f}};
        physics[brick] = of, counts[brick] = POINTS, now[brick] = before[brick] = here;
        /* Half a metre down in each step of a twelfth of a second. */
        before[brick].position[2] += 0.5f;
        for (int i = 0; i < POINTS; i++)
            points[brick][i][0] = grid[i % 4], points[brick][i][1] = grid[i / 4 % 4], points[brick][i][2] = grid[i / 16];
    }
    const rf_units units = {.unit_count = BRICKS, .physics = physics, .point_counts = counts,
                            .point_count = BRICKS * POINTS, .bodies = bodies};
    const rf_plane ground = {{0.0f, 0.0f, 1.0f}, 0.0f, 1.0f, 0.0f};
    rf_status status = rf_set_planes(simulator, &ground, 1);
    if (!status) status = rf_observe_poses(simulator, 1.0f / 12.0f, &units, points[0][0], before, now, NULL);
    rf_unit_id ids[BRICKS];
    if (!status) status = rf_unit_ids(simulator, ids, BRICKS);
    if (status) return status;
    /* Beside each other, and above each other. */
    const rf_unit_id pairs[2 * BONDS] = {ids[0], ids[1], ids[2], ids[3], ids[0], ids[2], ids[1], ids[3]};
    status = rf_bond(simulator, pairs, BONDS);
    if (!status && !refuses(simulator, ids)) return RF_ERROR_OTHER;

    uint64_t sum = UINT64_C(0xcbf29ce484222325);
    rf_bonded bonds[BONDS];
    rf_internal_pose poses[BRICKS];
    uint32_t held = BONDS;
    size_t many = 0;
    for (int step = 1; step <= STEPS && !status; step++) {
        /* A caller may break a bond too: it answers whether it held until then. */
        uint32_t let_go = 0;
        if (step == LET_GO) status = rf_break_bond(simulator, ids[0], ids[1], &let_go);
        if (let_go) printf("step %d: 0-1 is let go\n", step), held--;
        if (!status) status = rf_step(simulator, NULL);
        if (!status) status = rf_bonds(simulator, bonds, BONDS, &many);
        if (!status) status = rf_internal_poses(simulator, poses, BRICKS);
        if (status) break;
        uint32_t holding = 0;
        for (size_t i = 0; i < many; i++) holding += bonds[i].holds;
        if (holding != held) printf("step %d: %u of %d bonds break\n", step, (unsigned)(held - holding), BONDS);
        held = holding;
        sum = hash(sum, poses, sizeof poses);
        sum = hash(sum, &holding, sizeof holding);
    }
    if (!status) printf("shatter: %d steps, %u bonds hold, poses %016" PRIx64 "\n", STEPS, (unsigned)held, sum);
    return status;
}

int main(int count, char **arguments) {
    if (count != 2) return fprintf(stderr, "usage: shatter MODEL\n"), 2;
    size_t model_bytes = 0, bytes = 0;
    uint8_t *model = whole(arguments[1], &model_bytes);
    if (!model) return fprintf(stderr, "%s cannot be read or is no model\n", arguments[1]), 1;
    const rf_config config = {RF_ABI_VERSION, BRICKS, BRICKS * POINTS, 0, model, model_bytes};
    rf_status status = rf_workspace_bytes(&config, &bytes);
    void *memory = status ? NULL : aligned_alloc(RF_ALIGNMENT, (bytes + RF_ALIGNMENT - 1) / RF_ALIGNMENT * RF_ALIGNMENT);
    if (!status && !memory) fprintf(stderr, "no memory\n");
    rf_simulator *simulator = NULL;
    if (memory) status = rf_init(&config, memory, bytes, &simulator, NULL);
    if (memory && !status) status = go(simulator);
    if (status) fprintf(stderr, "%s\n", rf_error_string(status));
    free(memory), free(model);
    return status || !memory;
}
