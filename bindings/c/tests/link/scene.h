/* A model from a file, and a cube above another that fall for a sixth of a second. */
#include <rigidformer.h>
#include <stdio.h>
#include <stdlib.h>

static rf_status run(const uint8_t *model, size_t bytes, void *memory, size_t size, float *height) {
    static const float CORNERS[8][3] = {{-.2f, -.2f, -.2f}, {-.2f, -.2f, .2f}, {-.2f, .2f, -.2f}, {-.2f, .2f, .2f},
                                        {.2f, -.2f, -.2f},  {.2f, -.2f, .2f},  {.2f, .2f, -.2f},  {.2f, .2f, .2f}};
    const rf_config config = {RF_ABI_VERSION, 2, 16, 0, model, bytes};
    const rf_unit cube = {{1, .5f, .4f}, RF_ROLE_FREE, RF_OWN_BODY, &CORNERS[0][0], 8, {0, 0, 0}, NULL, NULL, 0};
    const rf_pose low = {{0, 0, .25f}, {0, 0, 0, 1}}, high = {{.05f, 0, .7f}, {0, 0, 0, 1}};
    rf_simulator *simulator;
    rf_pose poses[2];
    rf_status status = rf_init(&config, memory, size, &simulator, NULL);
    if (!status) status = rf_set_dt(simulator, 1 / 24.f);
    if (!status) status = rf_add(simulator, &cube, &low, &low, NULL);
    if (!status) status = rf_add(simulator, &cube, &high, &high, NULL);
    for (int i = 0; i < 4 && !status; i++) status = rf_step(simulator, NULL);
    if (!status) status = rf_poses(simulator, poses, 2);
    *height = poses[1].position[2];
    return status;
}

/* Memory for the model at a path and its workspace. */
typedef struct {
    uint8_t *model;
    size_t bytes;
    void *memory;
    size_t size;
} rooms;

static int make_room(const char *path, rooms *of) {
    FILE *file = fopen(path, "rb");
    if (!file) return fprintf(stderr, "cannot read %s\n", path), 1;
    fseek(file, 0, SEEK_END);
    of->bytes = (size_t)ftell(file);
    rewind(file);
    of->model = aligned_alloc(64, (of->bytes + 63) / 64 * 64);
    if (fread(of->model, 1, of->bytes, file) != of->bytes) return 1;
    fclose(file);
    const rf_config config = {RF_ABI_VERSION, 2, 16, 0, of->model, of->bytes};
    const rf_status status = rf_workspace_bytes(&config, &of->size);
    if (status) return fprintf(stderr, "%s\n", rf_error_string(status)), 1;
    of->memory = aligned_alloc(64, (of->size + 63) / 64 * 64);
    return of->memory == NULL;
}

static inline int fall(const char *path, float *height) {
    rooms of;
    if (make_room(path, &of)) return 1;
    const rf_status status = run(of.model, of.bytes, of.memory, of.size, height);
    if (status) fprintf(stderr, "%s\n", rf_error_string(status));
    return status != RF_OK;
}
