/* The scene of ../push.c on a computer, in memory of the size that the library asks for. */
#include "../push.h"

#include <inttypes.h>
#include <stdio.h>
#include <stdlib.h>

extern const uint8_t rf_model[], rf_model_end[]; /* share/rigidformer/model.S */

int main(void) {
    const rf_config config = {RF_ABI_VERSION, PUSH_UNITS, PUSH_UNITS * PUSH_POINTS, 0, rf_model,
                              (size_t)(rf_model_end - rf_model)};
    size_t bytes = 0;
    rf_status status = rf_workspace_bytes(&config, &bytes);
    void *memory = status ? NULL : aligned_alloc(RF_ALIGNMENT, bytes);
    if (!status && !memory) return fprintf(stderr, "no memory\n"), 1;
    rf_simulator *simulator = NULL;
    uint64_t sum = 0;
    rf_pose box;
    if (!status) status = rf_init(&config, memory, bytes, &simulator, NULL);
    if (!status) status = push(simulator, &sum, &box);
    free(memory);
    if (status) return fprintf(stderr, "%s\n", rf_error_string(status)), 1;
    printf("roles: %d steps, poses %016" PRIx64 "\n", PUSH_STEPS, sum);
    printf("the box is at (%.3f, %.3f, %.3f) m\n", (double)box.position[0], (double)box.position[1],
           (double)box.position[2]);
}
