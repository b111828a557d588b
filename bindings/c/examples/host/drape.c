/* A sheet of cloth of eight patches falls on a sphere and hangs from it: drape shell.rfm drape.bin. The scene has the sheet at rest and
   where it is held, and the sphere; firmware-sim/firmware/src/drape.rs has its layout. */
#include <rigidformer.h>

#include <inttypes.h>
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

enum { STEPS = 12, MOST_UNITS = 16, MOST_POINTS = 1024, MOST_OF_PATCH = 64 };

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

/* The scene in place. `points` are those of the patches, then of the sphere. */
typedef struct {
    uint32_t step, rate, patches, of_patch, of_sphere;
    const float *young_pa, *ground, *physics, *rest, *points;
} drape;

/* Whether the file is as long as it says. */
static int parse(const uint8_t *file, size_t bytes, drape *drape) {
    const uint32_t *words = (const uint32_t *)(const void *)file;
    const float *numbers = (const float *)(const void *)file;
    if (bytes < 32) return 0;
    drape->step = words[0], drape->rate = words[1], drape->patches = words[2], drape->of_patch = words[3];
    drape->of_sphere = words[4];
    if (!drape->rate || !drape->patches || drape->patches >= MOST_UNITS || drape->of_patch > MOST_OF_PATCH) return 0;
    const size_t of_sheet = (size_t)drape->patches * drape->of_patch;
    if (drape->of_sphere > MOST_POINTS || of_sheet + drape->of_sphere > MOST_POINTS) return 0;
    if (bytes != 4 * (8 + 3 * ((size_t)drape->patches + 1 + 2 * of_sheet + drape->of_sphere))) return 0;
    drape->young_pa = numbers + 5;
    drape->ground = numbers + 6;
    drape->physics = numbers + 8;
    drape->rest = drape->physics + 3 * ((size_t)drape->patches + 1);
    drape->points = drape->rest + 3 * of_sheet;
    return 1;
}

/* What a caller may get wrong. Each is refused, and the sheet falls on as if it had not been. */
static int refuses(rf_simulator *simulator, const drape *drape, float dt_s, const rf_units *units) {
    static float changed[3 * MOST_POINTS], young_pa[MOST_UNITS];
    const size_t bytes = 3 * sizeof(float) * units->point_count;
    rf_unit_id ids[MOST_UNITS];
    if (rf_unit_ids(simulator, ids, MOST_UNITS)) return 0;
    memcpy(changed, drape->points, bytes), changed[3 * 40 + 1] = NAN;
    const rf_status nowhere = rf_observe(simulator, dt_s, units, drape->points, changed, NULL);
    /* A patch whose points at rest are in one place has no shape. */
    memcpy(changed, units->rest_points, bytes), memset(changed, 0, 3 * sizeof(float) * drape->of_patch);
    rf_units bad = *units;
    bad.rest_points = changed;
    const rf_status shapeless = rf_observe(simulator, dt_s, &bad, drape->points, drape->points, NULL);
    memcpy(young_pa, units->young_pa, sizeof(float) * units->unit_count), young_pa[3] = -1.0f;
    bad = *units, bad.young_pa = young_pa;
    const rf_status limp = rf_observe(simulator, dt_s, &bad, drape->points, drape->points, NULL);
    const rf_status found[5] = {nowhere, shapeless, limp, rf_remove(simulator, ids[0]), rf_bond(simulator, ids, 1)};
    const rf_status expected[5] = {RF_ERROR_BAD_POINT, RF_ERROR_BAD_SOFT, RF_ERROR_BAD_SOFT, RF_ERROR_DEFORMS, RF_ERROR_BOND_MOTION};
    for (int i = 0; i < 5; i++) {
        if (found[i] != expected[i]) return 0;
        printf("refused: error %d, %s\n", (int)found[i], rf_error_string(found[i]));
    }
    return 1;
}

static rf_status go(rf_simulator *simulator, const drape *drape) {
    static rf_physics physics[MOST_UNITS];
    static uint32_t counts[MOST_UNITS], roles[MOST_UNITS];
    static int32_t bodies[MOST_UNITS];
    /* At rest the sphere's points are not looked at. */
    static float young_pa[MOST_UNITS], rest[3 * MOST_POINTS];
    const uint32_t patches = drape->patches;
    for (uint32_t i = 0; i <= patches; i++) {
        const rf_physics of = {drape->physics[3 * i], drape->physics[3 * i + 1], drape->physics[3 * i + 2]};
        const int is_patch = i < patches;
        physics[i] = of, counts[i] = is_patch ? drape->of_patch : drape->of_sphere;
        roles[i] = is_patch ? RF_ROLE_FREE : RF_ROLE_FIXED, bodies[i] = is_patch ? 0 : RF_OWN_BODY;
        young_pa[i] = is_patch ? *drape->young_pa : 0.0f;
    }
    const size_t of_sheet = (size_t)patches * drape->of_patch;
    memcpy(rest, drape->rest, 3 * sizeof(float) * of_sheet);
    const rf_units units = {.unit_count = (size_t)patches + 1, .physics = physics, .point_counts = counts,
                            .point_count = of_sheet + drape->of_sphere, .roles = roles, .bodies = bodies,
                            .young_pa = young_pa, .rest_points = rest};
    const rf_plane ground = {{0.0f, 0.0f, 1.0f}, 0.0f, drape->ground[0], drape->ground[1]};
    const float dt_s = (float)drape->step / (float)drape->rate;
    rf_status status = rf_set_planes(simulator, &ground, 1);
    /* It was held still: the same points twice. */
    if (!status) status = rf_observe(simulator, dt_s, &units, drape->points, drape->points, NULL);

    uint64_t sum = UINT64_C(0xcbf29ce484222325);
    static float points[3 * MOST_OF_PATCH];
    for (int step = 0; step < STEPS && !status; step++) {
        if (step == STEPS / 2 && !refuses(simulator, drape, dt_s, &units)) return RF_ERROR_OTHER;
        status = rf_step(simulator, NULL);
        float low = INFINITY, high = -INFINITY;
        for (uint32_t patch = 0; patch < patches && !status; patch++) {
            size_t count = 0;
            status = rf_soft_points(simulator, patch, points, MOST_OF_PATCH, &count);
            if (!status) sum = hash(sum, points, 3 * sizeof(float) * count);
            for (size_t i = 0; i < count && !status; i++) low = fminf(low, points[3 * i + 2]), high = fmaxf(high, points[3 * i + 2]);
        }
        if (!status)
            printf("%.2f s: the sheet is from %.3f to %.3f m high\n", (double)(dt_s * (float)(step + 1)), (double)low, (double)high);
    }
    if (!status) printf("drape: %d steps, points %016" PRIx64 "\n", STEPS, sum);
    return status;
}

int main(int count, char **arguments) {
    if (count != 3) return fprintf(stderr, "usage: drape MODEL SCENE\n"), 2;
    size_t model_bytes = 0, scene_bytes = 0, bytes = 0;
    uint8_t *model = whole(arguments[1], &model_bytes), *scene = whole(arguments[2], &scene_bytes);
    drape drape;
    if (!model || !scene || !parse(scene, scene_bytes, &drape)) {
        fprintf(stderr, "%s cannot be read or is no model, or %s is no sheet over a sphere\n", arguments[1], arguments[2]);
        return free(model), free(scene), 1;
    }
    const uint32_t points = drape.patches * drape.of_patch + drape.of_sphere;
    const rf_config config = {RF_ABI_VERSION, drape.patches + 1, points, 0, model, model_bytes};
    rf_status status = rf_workspace_bytes(&config, &bytes);
    void *memory = status ? NULL : aligned_alloc(RF_ALIGNMENT, (bytes + RF_ALIGNMENT - 1) / RF_ALIGNMENT * RF_ALIGNMENT);
    if (!status && !memory) fprintf(stderr, "no memory\n");
    rf_simulator *simulator = NULL;
    if (memory) status = rf_init(&config, memory, bytes, &simulator, NULL);
    if (memory && !status) status = go(simulator, &drape);
    if (status) fprintf(stderr, "%s\n", rf_error_string(status));
    free(memory), free(model), free(scene);
    return status || !memory;
}
