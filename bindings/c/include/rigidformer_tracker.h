/**
 * @file rigidformer_tracker.h
 *
 * The tracker of RigidFormer: follows rigid bodies in depth images and clouds of points, and predicts
 * where they will be. Of libraries for Linux alone.
 *
 * C and C++11. A tracker is in memory of its own, until rf_tracker_destroy. A handle that is dead or
 * made up is refused. A refused call changes nothing, and rf_tracker_message has its text. Coordinates
 * are right-handed, SI units; the world's frame is yours, and options say where gravity is.
 *
 *     rf_tracker_options options;
 *     rf_tracker *tracker;
 *     char why[256];
 *     rf_status status = rf_tracker_defaults(RF_ABI_VERSION, &options);
 *     options.model_path = "edge.rfm";
 *     if (!status) status = rf_tracker_create(&options, &tracker, why, sizeof why);
 *     while (!status && camera(&view)) {
 *         const rf_capture capture = {seconds(), &view, 1, NULL, 0};
 *         status = rf_tracker_observe(tracker, &capture, NULL);
 *         if (!status) status = rf_tracker_units(tracker, units, 64, &count);
 *         if (!status) status = rf_tracker_predict(tracker, 1, &forecast);
 *         if (!status) status = rf_tracker_predictions(tracker, predictions, 64 * 24, &predicted);
 *     }
 *
 * Threads: trackers are independent of each other. At most one call may be in a tracker at a time; a
 * second one returns RF_ERROR_BUSY and does nothing. A call shares its work out to all cores.
 *
 * Generated from bindings/c/src/tracker by `cargo xtask header --bless`; do not edit.
 */

#ifndef RIGIDFORMER_TRACKER_H
#define RIGIDFORMER_TRACKER_H

#include "rigidformer.h"

/**
 * Planes and gaps between clusters of the other pixels separate bodies.
 */
#define RF_SEGMENTATION_FOUND 0U

/**
 * Labels of the capture separate bodies. Captures without labels are segmented as with
 * RF_SEGMENTATION_FOUND.
 */
#define RF_SEGMENTATION_GIVEN 1U

/**
 * The model gets the observed surface of a unit alone.
 */
#define RF_COMPLETION_SEEN 0U

/**
 * Hidden sides are those that are seen, reflected in a point.
 */
#define RF_COMPLETION_MIRRORED 1U

/**
 * A unit that four fifths of its surface make a box, a cylinder or a ball is that; others are
 * mirrored.
 */
#define RF_COMPLETION_FITTED 2U

/**
 * Points of the last capture are the unit's own.
 */
#define RF_TRACK_SEEN 1U

/**
 * The unit is out of view or occluded: its pose is predicted.
 */
#define RF_TRACK_HIDDEN 2U

/**
 * The unit should be visible and is not: its pose is predicted, and its track ends soon.
 */
#define RF_TRACK_MISSED 4U

/**
 * The unit rests on a plane, a tabletop or another unit.
 */
#define RF_TRACK_SUPPORTED 8U

/**
 * The unit rests, and nothing is seen that it stands on: it is held still, in predictions too.
 */
#define RF_TRACK_HELD 16U

/**
 * Fewer than 4 points of the unit have been seen.
 */
#define RF_LEFT_OUT_POINTS 1U

/**
 * The unit was not seen for so long that its place is not known to within its own size.
 */
#define RF_LEFT_OUT_LOST 2U

/**
 * The velocity of the unit is not known well enough.
 */
#define RF_LEFT_OUT_UNCERTAIN 3U

/**
 * The longest horizon of rf_tracker_predict, seconds.
 */
#define RF_MAX_HORIZON_S 10U

/**
 * A tracker in memory of its own. The handle is a number, and no address.
 */
typedef struct rf_tracker rf_tracker;

/**
 * What a tracker is made from. rf_tracker_defaults fills it.
 */
typedef struct rf_tracker_options {
  /**
   * As rf_tracker_defaults wrote it.
   */
  uint32_t abi_version;
  /**
   * RF_SEGMENTATION_...
   */
  uint32_t segmentation;
  /**
   * A packed model (.rfm) for rigid units, of any alignment; it is copied. NULL: that of
   * model_path, or without both none, and then nothing is predicted.
   */
  const uint8_t *model;
  /**
   * Its length, bytes.
   */
  size_t model_bytes;
  /**
   * Path of a packed model, a text that ends with a zero; or NULL.
   */
  const char *model_path;
  /**
   * (plane_count) the planes of the scene, at most RF_MAX_PLANES; they are copied. NULL: up to four
   * are found.
   */
  const rf_plane *planes;
  /**
   * How many. 0 with planes that are not NULL: the scene has none.
   */
  size_t plane_count;
  /**
   * Acceleration of free fall, m/s^2.
   */
  float gravity_m_s2[3];
  /**
   * Assumed density of units, kg/m^3, from 0.001 to 1e6. Ratios of masses alone matter.
   */
  float density_kg_m3;
  /**
   * Assumed friction of units, from 0 to 1000.
   */
  float unit_friction;
  /**
   * Assumed restitution of units, from 0 to 1000.
   */
  float unit_restitution;
  /**
   * Friction of planes that are found, from 0 to 1000.
   */
  float plane_friction;
  /**
   * Restitution of planes that are found, from 0 to 1000.
   */
  float plane_restitution;
  /**
   * Least diameter of a unit, metres: smaller clusters are noise.
   */
  float min_extent_m;
  /**
   * Largest diameter of a unit, metres: larger clusters are scenery.
   */
  float max_extent_m;
  /**
   * Standard deviation of a new unit's velocity, m/s.
   */
  float first_speed_m_s;
  /**
   * Standard deviation of a new unit's spin, rad/s.
   */
  float first_spin_rad_s;
  /**
   * Seconds that a unit may be hidden before its track ends, at least 0.
   */
  double hidden_s;
  /**
   * Captures that show a unit before it is reported, at least 1.
   */
  uint32_t confirm;
  /**
   * Consecutive captures that may miss a unit before its track ends.
   */
  uint32_t missed;
  /**
   * Units that are tracked, at most.
   */
  uint32_t max_units;
  /**
   * Clusters of a capture that are looked at, at most.
   */
  uint32_t max_clusters;
  /**
   * Points of a unit that the model gets, at most: 8 to 256.
   */
  uint32_t model_points;
  /**
   * How hidden sides are completed: RF_COMPLETION_...
   */
  uint32_t completion;
  /**
   * Seed of the search for planes.
   */
  uint64_t seed;
} rf_tracker_options;

/**
 * A depth image and its camera, a pinhole without distortion: x to the right, y down, z forward.
 * Pixel (0, 0) is the top left one, and its middle is at (0, 0).
 */
typedef struct rf_depth_view {
  /**
   * Pixels a row, from 1 to 8192.
   */
  uint32_t width;
  /**
   * Rows, from 1 to 8192.
   */
  uint32_t height;
  /**
   * Focal lengths along rows and columns, pixels, above 0.
   */
  float focal[2];
  /**
   * The principal point, pixels, within one image's size of the image.
   */
  float centre[2];
  /**
   * Carries the camera's frame to the world at that instant.
   */
  rf_pose camera;
  /**
   * Metres a step of `depth`, from 1e-6 to 10: 0.001 where depths are millimetres.
   */
  float scale_m;
  /**
   * Zero.
   */
  uint32_t reserved;
  /**
   * (height, width) distance of the visible surface from the camera's plane, by rows from the top;
   * 0: not measured.
   */
  const uint16_t *depth;
  /**
   * (height, width) label of the visible body, 0 for none. NULL: there are no labels.
   */
  const uint16_t *labels;
} rf_depth_view;

/**
 * Points of a scanner, or of several.
 */
typedef struct rf_cloud_view {
  /**
   * (point_count, 3) x, y, z in metres, in the world; each within 1e6 m.
   */
  const float *points;
  /**
   * How many points.
   */
  size_t point_count;
  /**
   * (point_count) label of each point's body, 0 for none. NULL: there are no labels.
   */
  const uint16_t *labels;
  /**
   * Where the sensor was, in the world, metres: surfaces face it.
   */
  float sensor[3];
  /**
   * 1 where `sensor` is known, else 0.
   */
  uint32_t has_sensor;
} rf_cloud_view;

/**
 * The measurements of all sensors at one instant: their times differ by less than a millisecond.
 */
typedef struct rf_capture {
  /**
   * Seconds since any instant that all captures share; above that of the capture before.
   */
  double time_s;
  /**
   * (depth_count) depth images.
   */
  const struct rf_depth_view *depths;
  /**
   * How many.
   */
  size_t depth_count;
  /**
   * (cloud_count) clouds.
   */
  const struct rf_cloud_view *clouds;
  /**
   * How many.
   */
  size_t cloud_count;
} rf_capture;

/**
 * What a capture was like.
 */
typedef struct rf_capture_report {
  /**
   * Units that are reported.
   */
  uint32_t units;
  /**
   * Units that the capture shows, with those that are not confirmed yet.
   */
  uint32_t seen;
  /**
   * Units that it confirmed.
   */
  uint32_t appeared;
  /**
   * Units whose tracks ended.
   */
  uint32_t given_up;
  /**
   * Clusters that were used.
   */
  uint32_t clusters;
  /**
   * Clusters that were left out because there were too many.
   */
  uint32_t clusters_left_out;
  /**
   * 1 where below a hundredth of an image's pixels have a depth.
   */
  uint32_t is_blind;
  /**
   * 1 where the model refused to predict the units, and free motion stood in for it.
   */
  uint32_t is_without_model;
} rf_capture_report;

/**
 * A unit that is followed. Matrices are by rows. Covariances are about the unit's centre.
 */
typedef struct rf_track {
  /**
   * Its own: no other unit of the tracker has it, or will have.
   */
  uint32_t id;
  /**
   * RF_TRACK_..., added up: one of the first three, and whether it rests.
   */
  uint32_t flags;
  /**
   * Carries its frame to the world.
   */
  rf_pose pose;
  /**
   * Its centre, in its frame, metres.
   */
  float centre[3];
  /**
   * Its mass by its shape and the assumed density, kg; 0 before it has a shape.
   */
  float mass_kg;
  /**
   * Of the centre, m/s, then the spin, rad/s, in the world's axes.
   */
  float velocity[6];
  /**
   * Of the pose: translation, metres, then rotation, radians, in the world's axes.
   */
  float pose_covariance[36];
  /**
   * Of the velocity.
   */
  float velocity_covariance[36];
} rf_track;

/**
 * A forecast from the last capture on.
 */
typedef struct rf_forecast {
  /**
   * Seconds between steps.
   */
  double step_s;
  /**
   * Steps; the last one ends at the horizon.
   */
  uint32_t steps;
  /**
   * Units that are predicted.
   */
  uint32_t units;
  /**
   * Units that are not.
   */
  uint32_t left_out;
  /**
   * Zero.
   */
  uint32_t reserved;
} rf_forecast;

/**
 * Where a unit will be.
 */
typedef struct rf_prediction {
  /**
   * Which unit.
   */
  uint32_t id;
  /**
   * After which step, from 1.
   */
  uint32_t step;
  /**
   * Carries the unit's frame to the world.
   */
  rf_pose pose;
} rf_prediction;

/**
 * A unit that is not predicted.
 */
typedef struct rf_left_out {
  /**
   * Which unit.
   */
  uint32_t id;
  /**
   * Why: RF_LEFT_OUT_...
   */
  uint32_t reason;
} rf_left_out;

#ifdef __cplusplus
extern "C" {
#endif /* __cplusplus */

/**
 * Fills options with their defaults: no model, planes and bodies are found, gravity of 9.81 m/s^2
 * downwards along z.
 *
 * @param abi_version  RF_ABI_VERSION of your header
 * @param options      out: the defaults
 * @return RF_OK, RF_ERROR_NULL, RF_ERROR_ALIGNMENT or RF_ERROR_ABI
 */
rf_status rf_tracker_defaults(uint32_t abi_version, struct rf_tracker_options *options);

/**
 * Makes a tracker without units, in memory that the library allocates until rf_tracker_destroy.
 *
 * @param options   what rf_tracker_defaults filled and you changed
 * @param tracker   out: the handle, or NULL where the call fails
 * @param message   out: what is wrong and its remedy, cut to the capacity, or ""; may be NULL
 * @param capacity  bytes of message, with the zero at its end
 * @return RF_OK, RF_ERROR_NULL, RF_ERROR_ALIGNMENT, RF_ERROR_LENGTH, RF_ERROR_ABI,
 *         RF_ERROR_TRACKER_OPTION, RF_ERROR_MODEL_FILE, RF_ERROR_DEFECT or one of
 *         RF_ERROR_MODEL_...
 */
rf_status rf_tracker_create(const struct rf_tracker_options *options,
                            struct rf_tracker **tracker,
                            char *message,
                            size_t capacity);

/**
 * Ends a tracker and frees its memory. Later calls with the handle give RF_ERROR_HANDLE.
 *
 * @return RF_OK, RF_ERROR_NULL, RF_ERROR_HANDLE, RF_ERROR_BUSY or RF_ERROR_DEFECT
 */
rf_status rf_tracker_destroy(struct rf_tracker *tracker);

/**
 * What the last refused call of a tracker was refused for, with its remedy.
 *
 * @param tracker   the tracker
 * @param message   out: the text, cut to the capacity, or "" where no call was refused
 * @param capacity  bytes of message, with the zero at its end
 * @return RF_OK, RF_ERROR_NULL, RF_ERROR_HANDLE, RF_ERROR_BUSY or RF_ERROR_DEFECT
 */
rf_status rf_tracker_message(const struct rf_tracker *tracker, char *message, size_t capacity);

/**
 * Updates a tracker with the next capture. Images and points are copied.
 *
 * The time of a call is bounded by the options' numbers of units and clusters and by the sizes of
 * the images. It shares work out to all cores.
 *
 * @param tracker  the tracker
 * @param capture  the capture
 * @param report   out: what it was like; may be NULL
 * @return RF_OK, an error of the call (below 32), RF_ERROR_NO_MEMORY, one of RF_ERROR_CAPTURE_...
 *         or RF_ERROR_DEFECT. Where it is refused, the tracker is what it was
 */
rf_status rf_tracker_observe(struct rf_tracker *tracker,
                             const struct rf_capture *capture,
                             struct rf_capture_report *report);

/**
 * The units that are followed, by ascending number, at the time of the last capture.
 *
 * @param tracker   the tracker
 * @param units     out: (count) units; may be NULL where capacity is 0
 * @param capacity  how many there is room for; of tracks, max_units suffices
 * @param count     out: how many there are, also where RF_ERROR_BUFFER says that they do not fit
 * @return RF_OK, an error of the call, RF_ERROR_BUFFER, which writes no unit, or RF_ERROR_DEFECT
 */
rf_status rf_tracker_units(const struct rf_tracker *tracker,
                           struct rf_track *units,
                           size_t capacity,
                           size_t *count);

/**
 * The observed surface of a unit, in its frame, metres.
 *
 * @param tracker   the tracker
 * @param id        which unit
 * @param points    out: (count, 3) x, y, z; may be NULL where capacity is 0
 * @param capacity  how many points there is room for
 * @param count     out: how many there are, also where RF_ERROR_BUFFER says that they do not fit
 * @return as rf_tracker_units, or RF_ERROR_NO_SUCH_TRACK
 */
rf_status rf_tracker_points(const struct rf_tracker *tracker,
                            uint32_t id,
                            float *points,
                            size_t capacity,
                            size_t *count);

/**
 * The points of a unit that the model gets, in its frame, metres: its surface, completed by hidden
 * sides. None before it has a shape.
 *
 * @param tracker   the tracker
 * @param id        which unit
 * @param points    out: (count, 3) x, y, z; may be NULL where capacity is 0
 * @param capacity  how many points there is room for
 * @param count     out: how many there are, also where RF_ERROR_BUFFER says that they do not fit
 * @return as rf_tracker_points
 */
rf_status rf_tracker_shape(const struct rf_tracker *tracker,
                           uint32_t id,
                           float *points,
                           size_t capacity,
                           size_t *count);

/**
 * The support planes: those of the options, or those that were found. At most RF_MAX_PLANES.
 *
 * @param tracker   the tracker
 * @param planes    out: (count) planes; may be NULL where capacity is 0
 * @param capacity  how many there is room for
 * @param count     out: how many there are, also where RF_ERROR_BUFFER says that they do not fit
 * @return as rf_tracker_units
 */
rf_status rf_tracker_planes(const struct rf_tracker *tracker,
                            rf_plane *planes,
                            size_t capacity,
                            size_t *count);

/**
 * Predicts the units from the last capture on, in equal steps of about 1/24 s. Read them by
 * rf_tracker_predictions. Without a model there are none.
 *
 * @param tracker    the tracker
 * @param horizon_s  seconds ahead, above 0 and at most RF_MAX_HORIZON_S
 * @param forecast   out: how many steps and units
 * @return RF_OK, an error of the call, RF_ERROR_HORIZON, RF_ERROR_FORECAST or RF_ERROR_DEFECT. Where it
 *         is refused, the forecast before stays
 */
rf_status rf_tracker_predict(struct rf_tracker *tracker,
                             double horizon_s,
                             struct rf_forecast *forecast);

/**
 * The predictions of the last rf_tracker_predict, step by step, and by ascending number within one.
 * A capture ends them.
 *
 * @param tracker      the tracker
 * @param predictions  out: (steps, units) predictions; may be NULL where capacity is 0
 * @param capacity     how many there is room for
 * @param count        out: how many there are, also where RF_ERROR_BUFFER says that they do not fit
 * @return as rf_tracker_units
 */
rf_status rf_tracker_predictions(const struct rf_tracker *tracker,
                                 struct rf_prediction *predictions,
                                 size_t capacity,
                                 size_t *count);

/**
 * The units that the last rf_tracker_predict did not predict, and why.
 *
 * @param tracker   the tracker
 * @param left_out  out: (count) units; may be NULL where capacity is 0
 * @param capacity  how many there is room for
 * @param count     out: how many there are, also where RF_ERROR_BUFFER says that they do not fit
 * @return as rf_tracker_units
 */
rf_status rf_tracker_left_out(const struct rf_tracker *tracker,
                              struct rf_left_out *left_out,
                              size_t capacity,
                              size_t *count);

#ifdef __cplusplus
}  /* extern "C" */
#endif  /* __cplusplus */

#endif  /* RIGIDFORMER_TRACKER_H */
