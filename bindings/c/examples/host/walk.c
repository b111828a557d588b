/* A Unitree G1 of 31 links walks under command: walk g1.rfm walk.bin. The scene has two frames of the robot, a third of a second
   apart, and the pivots at which its links hang together; firmware-sim/firmware/src/walk.rs has its layout. */
#include <rigidformer.h>

#include <inttypes.h>
#include <math.h>
#include <stdio.h>
#include <stdlib.h>

enum { STEPS = 10, MOST_LINKS = 64 };

/* A whole file in memory that begins where a model must; NULL without one. */
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

/* A pose in the file has the quaternion's w first. */
static rf_pose pose(const float n[7]) {
    const rf_pose pose = {{n[0], n[1], n[2]}, {n[4], n[5], n[6], n[3]}};
    return pose;
}

/* The scene in place. */
typedef struct {
    uint32_t step, rate, links, points, joints;
    const float *ground, *physics, *cloud, *previous, *current, *pivots;
    const uint32_t *pairs;
} walk;

/* Whether the file is as long as it says, and its joints are between its links; there must be one to show a circle with. */
static int parse(const uint8_t *file, size_t bytes, walk *walk) {
    const uint32_t *words = (const uint32_t *)(const void *)file;
    const float *numbers = (const float *)(const void *)file;
    if (bytes < 28) return 0;
    walk->step = words[0], walk->rate = words[1], walk->links = words[2], walk->points = words[3], walk->joints = words[4];
    if (!walk->rate || walk->links > MOST_LINKS || walk->points > 1024 || walk->joints > MOST_LINKS) return 0;
    const size_t links = walk->links, joints = walk->joints;
    if (bytes != 4 * (7 + links * (3 + 3 * (size_t)walk->points + 14) + joints * 8)) return 0;
    walk->ground = numbers + 5;
    walk->physics = walk->ground + 2;
    walk->cloud = walk->physics + 3 * links;
    walk->previous = walk->cloud + 3 * links * walk->points;
    walk->current = walk->previous + 7 * links;
    walk->pairs = (const uint32_t *)(const void *)(walk->current + 7 * links);
    walk->pivots = (const float *)(const void *)(walk->pairs + 2 * joints);
    /* They index arrays. */
    for (size_t i = 0; i < 2 * joints; i++)
        if (walk->pairs[i] >= links) return 0;
    return joints > 0;
}

/* What a controller may get wrong. Each is refused, and the robot walks on as if it had not been. */
static int refuses(rf_simulator *simulator, const rf_unit_id *ids, const walk *walk) {
    const float few[2] = {0.5f, 0.0f}, odd[3] = {0.5f, NAN, 0.0f};
    const rf_status found[3] = {
        rf_set_command(simulator, few, 2), rf_set_command(simulator, odd, 3),
        rf_join(simulator, ids[walk->pairs[1]], ids[walk->pairs[0]], walk->pivots, walk->pivots)};
    const rf_status expected[3] = {RF_ERROR_COMMAND_SIZE, RF_ERROR_COMMAND_NUMBER, RF_ERROR_BAD_JOINT};
    for (int i = 0; i < 3; i++) {
        if (found[i] != expected[i]) return 0;
        printf("refused: error %d, %s\n", (int)found[i], rf_error_string(found[i]));
    }
    return 1;
}

static rf_status go(rf_simulator *simulator, const walk *walk) {
    static rf_physics physics[MOST_LINKS];
    static rf_pose poses[2][MOST_LINKS];
    static uint32_t counts[MOST_LINKS];
    static int32_t bodies[MOST_LINKS]; /* all of body 0 */
    static rf_unit_id ids[MOST_LINKS];
    for (uint32_t i = 0; i < walk->links; i++) {
        const rf_physics of = {walk->physics[3 * i], walk->physics[3 * i + 1], walk->physics[3 * i + 2]};
        physics[i] = of, counts[i] = walk->points;
        poses[0][i] = pose(walk->previous + 7 * i), poses[1][i] = pose(walk->current + 7 * i);
    }
    const rf_units units = {.unit_count = walk->links, .physics = physics, .point_counts = counts,
                            .point_count = (size_t)walk->links * walk->points, .bodies = bodies};
    const rf_plane ground = {{0.0f, 0.0f, 1.0f}, 0.0f, walk->ground[0], walk->ground[1]};
    const float dt_s = (float)walk->step / (float)walk->rate;
    rf_status status = rf_set_planes(simulator, &ground, 1);
    if (!status) status = rf_observe_poses(simulator, dt_s, &units, walk->cloud, poses[0], poses[1], NULL);
    if (!status) status = rf_unit_ids(simulator, ids, walk->links);
    for (uint32_t j = 0; j < walk->joints && !status; j++) {
        const float *pivot = walk->pivots + 6 * j;
        status = rf_join(simulator, ids[walk->pairs[2 * j]], ids[walk->pairs[2 * j + 1]], pivot, pivot + 3);
    }

    uint64_t sum = UINT64_C(0xcbf29ce484222325);
    uint32_t active = 0;
    static rf_internal_pose internal[MOST_LINKS];
    for (int step = 0; step < STEPS && !status; step++) {
        /* Forward and left, m/s, and turn, rad/s, in the robot's heading. */
        static const float commands[2][3] = {{0.5f, 0.0f, 0.25f}, {0.25f, 0.125f, -0.5f}};
        status = rf_set_command(simulator, commands[step / (STEPS / 2)], 3);
        if (!status && step == 1 && !refuses(simulator, ids, walk)) return RF_ERROR_OTHER;
        rf_step_report report;
        if (!status) status = rf_step(simulator, &report);
        if (!status) active += report.active_units;
        if (!status) status = rf_internal_poses(simulator, internal, MOST_LINKS);
        if (!status) sum = hash(sum, internal, walk->links * sizeof *internal);
        rf_pose pelvis;
        if (!status) status = rf_unit_pose(simulator, ids[0], &pelvis);
        if (!status)
            printf("%.2f s: the pelvis is at (%.3f, %.3f) m and looks %.0f degrees from x\n", (double)(dt_s * (float)(step + 1)),
                   (double)pelvis.position[0], (double)pelvis.position[1],
                   2.0 * atan2((double)pelvis.quaternion[2], (double)pelvis.quaternion[3]) * 57.29577951308232);
    }
    if (!status) printf("walk: %d steps, active %" PRIu32 ", poses %016" PRIx64 "\n", STEPS, active, sum);
    return status;
}

int main(int count, char **arguments) {
    if (count != 3) return fprintf(stderr, "usage: walk MODEL SCENE\n"), 2;
    size_t model_bytes = 0, scene_bytes = 0, bytes = 0;
    uint8_t *model = whole(arguments[1], &model_bytes), *scene = whole(arguments[2], &scene_bytes);
    walk walk;
    if (!model || !scene || !parse(scene, scene_bytes, &walk)) {
        fprintf(stderr, "%s cannot be read or is no model, or %s is no walk\n", arguments[1], arguments[2]);
        return free(model), free(scene), 1;
    }
    const rf_config config = {RF_ABI_VERSION, walk.links, walk.links * walk.points, 0, model, model_bytes};
    rf_status status = rf_workspace_bytes(&config, &bytes);
    void *memory = status ? NULL : aligned_alloc(RF_ALIGNMENT, (bytes + RF_ALIGNMENT - 1) / RF_ALIGNMENT * RF_ALIGNMENT);
    if (!status && !memory) fprintf(stderr, "no memory\n");
    rf_simulator *simulator = NULL;
    if (memory) status = rf_init(&config, memory, bytes, &simulator, NULL);
    if (memory && !status) status = go(simulator, &walk);
    if (status) fprintf(stderr, "%s\n", rf_error_string(status));
    free(memory), free(model), free(scene);
    return status || !memory;
}
