/* A box falls on another: what the example shows, without ESP-IDF. */
#pragma once

#include <rigidformer.h>

#ifdef __cplusplus
extern "C" {
#endif

enum { FALL_UNITS = 2, FALL_POINTS = 16, FALL_STEPS = 12 };

/* Bytes that fall_run needs; 0 where the model is none. */
size_t fall_bytes(const uint8_t *model, size_t model_bytes);

/* Predicts half a second. Memory is aligned to RF_ALIGNMENT. Gives the poses of both units after each step to `say`. */
rf_status fall_run(const uint8_t *model, size_t model_bytes, void *memory, size_t bytes,
                   void (*say)(int step, const rf_pose poses[FALL_UNITS]));

#ifdef __cplusplus
}
#endif
