/* Prints the bits of the example's poses, then runs the example itself against stand-ins for ESP-IDF. */
#include <stddef.h>
#include <stdint.h>

#include "esp_heap_caps.h"
#include "esp_log.h"
#include "esp_system.h"
#include "esp_timer.h"
#include "fall.h"

#ifdef __linux__
#include <stdio.h>
static void write_out(const char *text, size_t length) { fwrite(text, 1, length, stdout); }
#else
void write_out(const char *text, size_t length);
#endif

extern const uint8_t rf_model[], rf_model_end[];
void app_main(void);

#ifndef MEMORY_BYTES
#define MEMORY_BYTES (256 * 1024)
#endif
static _Alignas(RF_ALIGNMENT) uint8_t memory[MEMORY_BYTES];
static int failures;
static int lines;

static void text(const char *from) {
    size_t length = 0;
    while (from[length] != 0) length++;
    write_out(from, length);
}

static void hex(uint32_t bits) {
    char digits[9];
    for (int i = 0; i < 8; i++) digits[i] = "0123456789abcdef"[bits >> (28 - 4 * i) & 15];
    digits[8] = ' ';
    write_out(digits, sizeof digits);
}

static void say(int step, const rf_pose poses[FALL_UNITS]) {
    text("fall: ");
    hex((uint32_t)step);
    const unsigned char *bytes = (const unsigned char *)poses;
    for (size_t i = 0; i < FALL_UNITS * sizeof(rf_pose); i += 4) {
        hex((uint32_t)bytes[i] | (uint32_t)bytes[i + 1] << 8 | (uint32_t)bytes[i + 2] << 16 |
            (uint32_t)bytes[i + 3] << 24);
    }
    text("\n");
}

void stub_log(const char *level, const char *tag, const char *format, ...) {
    lines++;
    if (level[0] != 'E') return;
    failures++;
    text(tag);
    text(": ");
    text(format);
    text("\n");
}

void *heap_caps_aligned_alloc(size_t alignment, size_t size, uint32_t caps) {
    (void)caps;
    return alignment <= RF_ALIGNMENT && size <= sizeof memory ? memory : NULL;
}

void heap_caps_free(void *pointer) { failures += pointer != memory; }

void esp_system_abort(const char *details) {
    text(details);
    for (;;) {
    }
}

int64_t esp_timer_get_time(void) { return 0; }

int run(void) {
    const size_t model_bytes = (size_t)(rf_model_end - rf_model);
    const size_t bytes = fall_bytes(rf_model, model_bytes);
    if (bytes == 0 || bytes > sizeof memory) return 2;
    const rf_status status = fall_run(rf_model, model_bytes, memory, bytes, say);
    if (status != RF_OK) return 3;
    /* A simulator says what is wrong, here as there. */
    if (fall_run(rf_model, model_bytes - 1, memory, bytes, say) != RF_ERROR_MODEL_LENGTH) return 4;
    if (fall_run(rf_model, model_bytes, memory, bytes - 16, say) != RF_ERROR_MEMORY) return 5;
    app_main();
    return failures == 0 && lines == FALL_STEPS ? 0 : 6;
}

#ifdef __linux__
int main(void) { return run(); }
#endif
