#include <rigidformer.h>
#include <stdio.h>

extern const uint8_t rf_model[], rf_model_end[];            // share/rigidformer/model.S
static _Alignas(RF_ALIGNMENT) uint8_t memory[1024 * 1024];  // rf_workspace_bytes tells how much
void camera(float frame[2][64][3]);                         // yours: two objects, 64 points each

int main(void) {
    const rf_physics physics[2] = {{0.5f, 0.8f, 0.7f}, {2.0f, 0.3f, 0.1f}};   // kg, friction, restitution
    const rf_units units = {.unit_count = 2, .physics = physics,
                            .point_counts = (const uint32_t[]){64, 64}, .point_count = 128};
    const rf_config config = {RF_ABI_VERSION, 2, 128, 0, rf_model, (size_t)(rf_model_end - rf_model)};
    static float before[2][64][3], now[2][64][3];
    camera(before), camera(now);                            // 1/24 s apart, same points, same order
    rf_simulator *simulator;
    rf_status status = rf_init(&config, memory, sizeof memory, &simulator, NULL);
    if (!status) status = rf_observe(simulator, 1.0f / 24.0f, &units, before[0][0], now[0][0], NULL);
    for (int i = 0; i < 8 && !status; i++) status = rf_step(simulator, NULL);   // a third of a second
    rf_pose poses[2];
    if (!status) status = rf_poses(simulator, poses, 2);    // each carries before[i] ahead
    if (status) return fprintf(stderr, "%s\n", rf_error_string(status)), 1;
    printf("the first one has moved up by %g m\n", (double)poses[0].position[2]);
}
