/* The scene of roles in bindings/c/examples/push.c, on a board that Zephyr runs on. */
#include <push.h>
#include <zephyr/kernel.h>
#include <zephyr/sys/printk.h>

extern const uint8_t rf_model[], rf_model_end[]; /* rigidformer_embed_model */

/* What rf_workspace_bytes says for nano.rfm, four units and 256 points, and some more. */
#ifndef MEMORY_BYTES
#define MEMORY_BYTES (192 * 1024)
#endif
static _Alignas(RF_ALIGNMENT) uint8_t memory[MEMORY_BYTES];

/* Takes the place of the library's own, which stops in a loop. */
void rf_panic(void) { k_panic(); }

int main(void) {
    const rf_config config = {RF_ABI_VERSION, PUSH_UNITS, PUSH_UNITS * PUSH_POINTS, 0, rf_model,
                              (size_t)(rf_model_end - rf_model)};
    rf_simulator *simulator;
    rf_detail detail;
    rf_status status = rf_init(&config, memory, sizeof memory, &simulator, &detail);
    if (status) {
        printk("rf_init: %s; found %u, expected %u\n", rf_error_string(status), (unsigned)detail.found,
               (unsigned)detail.expected);
        return 1;
    }
    uint64_t sum;
    rf_pose box;
    status = push(simulator, &sum, &box);
    if (status) {
        printk("push: %s\n", rf_error_string(status));
        return 1;
    }
    printk("roles: %d steps, poses %08x%08x\n", PUSH_STEPS, (unsigned)(sum >> 32), (unsigned)sum);
    return 0;
}
