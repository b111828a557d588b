/* Follows a box that falls, in depth images, and says where it will be in a second: track model.rfm */
#include <rigidformer_tracker.h>
#include <math.h>
#include <stdio.h>

#define WIDTH 320
#define HEIGHT 240
#define FRAMES 9
#define MOST 8

static const float FOCAL = 300, CENTRE[2] = {159.5f, 119.5f};
static const float EYE[3] = {-2, 0, 1};
static const float EDGES[3] = {0.25f, 0.3f, 0.2f};
/* Forward and down by 12 degrees; the image's x is -y of the world. */
static const float COS = 0.9781476f, SIN = 0.2079117f;

/* Height of the box's centre, metres. */
static float height(float seconds) { return 0.95f - 4.905f * seconds * seconds; }

/* What a camera sees: the box in the air, and the floor. Millimetres along the camera's axis. */
static void see(float z, uint16_t depth[HEIGHT][WIDTH]) {
    for (int row = 0; row < HEIGHT; row++) {
        for (int column = 0; column < WIDTH; column++) {
            const float u = ((float)column - CENTRE[0]) / FOCAL, v = ((float)row - CENTRE[1]) / FOCAL;
            const float ray[3] = {COS - v * SIN, -u, -SIN - v * COS};
            const float box[3] = {0, 0, z};
            float best = ray[2] < 0 ? -EYE[2] / ray[2] : 0, from = 0, to = 1e9f;
            for (int axis = 0; axis < 3; axis++) {
                float a = (box[axis] - EDGES[axis] / 2 - EYE[axis]) / ray[axis];
                float b = (box[axis] + EDGES[axis] / 2 - EYE[axis]) / ray[axis];
                from = fmaxf(from, fminf(a, b)), to = fminf(to, fmaxf(a, b));
            }
            if (from < to && (best == 0 || from < best)) best = from;
            depth[row][column] = best < 6 ? (uint16_t)(1000 * best + 0.5f) : 0;
        }
    }
}

int main(int count, char **words) {
    static uint16_t depth[HEIGHT][WIDTH];
    static rf_prediction predictions[24 * MOST];
    rf_tracker_options options;
    rf_tracker *tracker = NULL;
    rf_track units[MOST];
    rf_plane planes[RF_MAX_PLANES];
    rf_forecast forecast;
    char why[256];
    size_t found, predicted, levels;
    rf_status status = rf_tracker_defaults(RF_ABI_VERSION, &options);
    options.model_path = count > 1 ? words[1] : "edge.rfm";
    options.max_units = MOST;
    if (!status) status = rf_tracker_create(&options, &tracker, why, sizeof why);
    if (status) return fprintf(stderr, "%s\n", why), 1;

    /* The camera's x, y, z in the world, as a quaternion x, y, z, w. */
    const float a = sqrtf((1 + SIN) / 2) / sqrtf(2), b = sqrtf((1 - SIN) / 2) / sqrtf(2);
    rf_depth_view view = {WIDTH, HEIGHT, {FOCAL, FOCAL}, {CENTRE[0], CENTRE[1]}, {{EYE[0], EYE[1], EYE[2]}, {-a, a, -b, b}},
                          0.001f, 0, &depth[0][0], NULL};
    float seconds = 0;
    for (int frame = 0; frame < FRAMES && !status; frame++) {
        seconds = (float)frame / 30;
        see(height(seconds), depth);
        const rf_capture capture = {seconds, &view, 1, NULL, 0};
        status = rf_tracker_observe(tracker, &capture, NULL);
    }
    if (!status) status = rf_tracker_units(tracker, units, MOST, &found);
    if (!status) status = rf_tracker_planes(tracker, planes, RF_MAX_PLANES, &levels);
    if (!status) status = rf_tracker_predict(tracker, 1, &forecast);
    if (!status) status = rf_tracker_predictions(tracker, predictions, 24 * MOST, &predicted);
    if (status) return rf_tracker_message(tracker, why, sizeof why), fprintf(stderr, "%s\n", why), 1;

    printf("track: %d unit, %d plane, %d steps\n", (int)found, (int)levels, (int)forecast.steps);
    if (found != 1 || levels != 1 || predicted != forecast.steps) return fprintf(stderr, "one of each was to be seen\n"), 1;
    /* A frame is where the unit was seen first: its centre tells where it is. */
    const rf_track *unit = &units[0];
    const float speed = -9.81f * seconds;
    printf("track: it falls at %.2f m/s, and in truth at %.2f\n", (double)unit->velocity[2], (double)speed);
    const float fall = predictions[predicted - 1].pose.position[2] - unit->pose.position[2];
    const float truth = EDGES[2] / 2 - height(seconds);
    printf("track: in a second it will be %.2f m lower, on the floor %.2f\n", (double)-fall, (double)-truth);
    if (fabsf(unit->velocity[2] - speed) > 0.2f || fabsf(fall - truth) > 0.08f) return fprintf(stderr, "that is wrong\n"), 1;

    /* Nonsense is refused, with a remedy. */
    const rf_capture again = {0, &view, 1, NULL, 0};
    status = rf_tracker_observe(tracker, &again, NULL);
    if (status == RF_OK) return fprintf(stderr, "a capture was taken twice\n"), 1;
    rf_tracker_message(tracker, why, sizeof why);
    printf("refused: error %d, %s\n", (int)status, why);
    if (rf_tracker_destroy(tracker)) return 1;
    if (rf_tracker_destroy(tracker) == RF_OK) return fprintf(stderr, "a tracker was destroyed twice\n"), 1;
    printf("refused: error %d, %s\n", (int)rf_tracker_destroy(tracker), rf_error_string(rf_tracker_destroy(tracker)));
    return 0;
}
