#include "esp_heap_caps.h"
#include "esp_log.h"
#include "esp_system.h"
#include "esp_timer.h"

#include "fall.h"

static const char *TAG = "fall";

/* rigidformer_embed_model puts it into flash. */
extern const uint8_t rf_model[], rf_model_end[];

/* The library has no known way to panic; if it does, the chip restarts and tells where. */
void rf_panic(void) { esp_system_abort("rigidformer panicked"); }

static void say(int step, const rf_pose poses[FALL_UNITS]) {
    ESP_LOGI(TAG, "step %d, %ld ms: the upper box is at %.3f, %.3f, %.3f m", step, (long)(esp_timer_get_time() / 1000),
             (double)poses[1].position[0], (double)poses[1].position[1], (double)poses[1].position[2]);
}

void app_main(void) {
    const size_t model_bytes = (size_t)(rf_model_end - rf_model);
    const size_t bytes = fall_bytes(rf_model, model_bytes);
    if (bytes == 0) {
        ESP_LOGE(TAG, "the model is none that this library reads: embed another .rfm file");
        return;
    }
    void *memory = heap_caps_aligned_alloc(RF_ALIGNMENT, bytes, MALLOC_CAP_8BIT | MALLOC_CAP_INTERNAL);
    if (memory == NULL) {
        ESP_LOGE(TAG, "no %u bytes of memory are free: take a chip with more, or fewer units and points",
                 (unsigned)bytes);
        return;
    }
    const rf_status status = fall_run(rf_model, model_bytes, memory, bytes, say);
    if (status != RF_OK) ESP_LOGE(TAG, "error %d: %s", (int)status, rf_error_string(status));
    heap_caps_free(memory);
}
