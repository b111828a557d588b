/* Two models in one program. */
#include "scene.h"

extern const uint8_t rf_model[], rf_model_end[], second_model[], second_model_end[];

static int step(const char *name, const uint8_t *model, const uint8_t *end) {
    const size_t bytes = (size_t)(end - model);
    const rf_config config = {RF_ABI_VERSION, 2, 16, 0, model, bytes};
    size_t size = 0;
    float height = 0;
    rf_status status = rf_workspace_bytes(&config, &size);
    void *memory = aligned_alloc(64, (size + 63) / 64 * 64);
    if (!status) status = run(model, bytes, memory, size, &height);
    printf("models: %s, %zu bytes, %.4f m, %s\n", name, bytes, (double)height, rf_error_string(status));
    free(memory);
    return status != RF_OK;
}

int main(void) {
    return step("first", rf_model, rf_model_end) | step("second", second_model, second_model_end);
}
