/**
 * @file rigidformer.h
 *
 * RigidFormer: predicts how rigid bodies move from two observations of their points.
 *
 * C and C++11. A simulator lives in memory that you hand to rf_init, and reads the model in place, for
 * example in flash. Libraries for microcontrollers allocate nothing. All functions but the first few
 * return an rf_status; a refused call changes nothing. Coordinates are right-handed, z up, SI units; the ground is z = 0
 * unless rf_set_planes changes it. Units are free, driven or fixed (RF_ROLE_...).
 *
 *     static _Alignas(RF_ALIGNMENT) unsigned char memory[1024 * 1024];  // rf_workspace_bytes tells
 *     rf_config config = {RF_ABI_VERSION, 2, 128, 0, model, model_bytes};
 *     rf_simulator *simulator;
 *     rf_status status = rf_init(&config, memory, sizeof memory, &simulator, NULL);
 *     if (!status) status = rf_observe(simulator, dt_s, &units, &before[0][0], &now[0][0], NULL);
 *     for (int i = 0; i < 8 && !status; i++) status = rf_step(simulator, NULL);
 *     rf_pose poses[2];
 *     if (!status) status = rf_poses(simulator, poses, 2);
 *     if (status) puts(rf_error_string(status));
 *
 * Threads and interrupts: different simulators are independent of each other, and one model may
 * serve many. At most one call may be in a simulator at a time; a second one, from a thread or an
 * interrupt handler, returns RF_ERROR_BUSY and does nothing.
 *
 * The same model and observation give the same bits on every supported processor, in every build.
 * Floating point must be in its default mode: round to nearest, subnormal numbers not flushed.
 *
 * Generated from bindings/c/src by `cargo xtask header --bless`; do not edit. docs/C.md has the rest.
 */

#ifndef RIGIDFORMER_H
#define RIGIDFORMER_H

#include <stddef.h>
#include <stdint.h>

/**
 * Version of this interface: pass it to rf_init. It rises when something is removed or changes
 * its meaning; functions and error codes are only ever added within a version.
 */
#define RF_ABI_VERSION 5U

/**
 * Alignment in bytes of a workspace and of a model: rf_init checks both.
 */
#define RF_ALIGNMENT 16U

/**
 * What rf_detail says in `unit` and `index` where there is none.
 */
#define RF_NONE 4294967295U

/**
 * Kind of a joint: the unit turns about the pivot.
 */
#define RF_JOINT_BALL 0U

/**
 * The unit turns about an axis through the pivot.
 */
#define RF_JOINT_REVOLUTE 1U

/**
 * The unit slides along an axis, and does not turn.
 */
#define RF_JOINT_PRISMATIC 2U

/**
 * The unit stays where it is in its parent's frame.
 */
#define RF_JOINT_FIXED 3U

/**
 * Role of a unit that the model moves.
 */
#define RF_ROLE_FREE 0U

/**
 * Role of a unit that goes exactly where rf_drive sends it in the next step. The model sees that
 * motion and never changes it.
 */
#define RF_ROLE_DRIVEN 1U

/**
 * Role of scenery: the unit never moves.
 */
#define RF_ROLE_FIXED 2U

/**
 * Body of a unit that is a body of its own.
 */
#define RF_OWN_BODY -1

/**
 * The largest number of a body.
 */
#define RF_MAX_BODY 65534

/**
 * Planes of a scene, at most.
 */
#define RF_MAX_PLANES 8U

/**
 * Threads that may share a step.
 */
#define RF_MAX_THREADS 16U

/**
 * Convex pieces of a unit, at most.
 */
#define RF_MAX_PIECES 32U

/**
 * Quantities that rf_health looks at.
 */
#define RF_QUANTITIES 14U

/**
 * What a call came to: RF_OK, or why it was refused. A refused call changes nothing but the
 * detail of the last error. These numbers are never renumbered and never reused: 6 and 72 are
 * retired, they were codes of version 1.
 */
enum rf_status
#if defined(__cplusplus) || __STDC_VERSION__ >= 202311L
  : int32_t
#endif /* defined(__cplusplus) || __STDC_VERSION__ >= 202311L */
 {
  /**
   * Done.
   */
  RF_OK = 0,
  /**
   * A pointer is NULL that must not be.
   */
  RF_ERROR_NULL = 1,
  /**
   * A pointer is not aligned: to RF_ALIGNMENT for a workspace, otherwise to its type.
   */
  RF_ERROR_ALIGNMENT = 2,
  /**
   * The workspace is too small. Detail: `found` and `expected` bytes.
   */
  RF_ERROR_MEMORY = 3,
  /**
   * No simulator that rf_init made is there: never made, released, moved or overwritten.
   */
  RF_ERROR_HANDLE = 4,
  /**
   * Another call on this simulator has not returned: a thread or an interrupt handler got in.
   */
  RF_ERROR_BUSY = 5,
  /**
   * The header has another RF_ABI_VERSION than the library. Detail: `found`, `expected`.
   */
  RF_ERROR_ABI = 7,
  /**
   * An output array is too short. Detail: elements `found` and `expected`.
   */
  RF_ERROR_BUFFER = 8,
  /**
   * There is no unit of that number. Detail: `unit`, and `expected` units.
   */
  RF_ERROR_NO_SUCH_UNIT = 9,
  /**
   * A length is beyond what the processor can address.
   */
  RF_ERROR_LENGTH = 10,
  /**
   * An array of the caller lies within the workspace.
   */
  RF_ERROR_OVERLAP = 11,
  /**
   * The counts of points do not add up to the points given, or those of pieces to the pieces.
   * Detail: sum `found`, points or pieces `expected`.
   */
  RF_ERROR_POINT_COUNTS = 12,
  /**
   * The environment variable RIGIDFORMER_KERNEL names kernels that do not exist or that this
   * processor cannot run: unset it. Of libraries for Linux.
   */
  RF_ERROR_KERNEL = 13,
  /**
   * More threads than RF_MAX_THREADS, or than one in a library without them (the feature `threads`).
   * Detail: `found`, `expected`. Of libraries for Linux.
   */
  RF_ERROR_THREADS = 14,
  /**
   * The bytes are not a RigidFormer model.
   */
  RF_ERROR_MODEL_MAGIC = 32,
  /**
   * The model is of a format version that this library does not read, or needs a feature that it
   * was built without: edge needs `host` (docs/C.md). Detail:
   * `found`, `expected`; where `found` is not above `expected`, it is a feature.
   */
  RF_ERROR_MODEL_VERSION = 33,
  /**
   * The model's first byte is not aligned to RF_ALIGNMENT. Detail: `found` bytes beyond.
   */
  RF_ERROR_MODEL_ALIGNMENT = 34,
  /**
   * The model has been cut off, or something follows it. Detail: `found`, `expected` bytes.
   */
  RF_ERROR_MODEL_LENGTH = 35,
  /**
   * A checksum does not fit: the model is damaged. Detail: checksums `found`, `expected`.
   */
  RF_ERROR_MODEL_CHECKSUM = 36,
  /**
   * The model's header or tensor directory contradicts itself. Detail: tensor `index`, if any.
   */
  RF_ERROR_MODEL_STRUCTURE = 37,
  /**
   * The model's configuration is outside its limits.
   */
  RF_ERROR_MODEL_CONFIG = 38,
  /**
   * A tensor is missing, or has another shape or type than the configuration calls for.
   */
  RF_ERROR_MODEL_TENSOR = 39,
  /**
   * A weight or a scale is not finite or out of its range. Detail: tensor `index`, element
   * `found`.
   */
  RF_ERROR_MODEL_NUMBER = 40,
  /**
   * The model has more blocks, scales or command numbers than this library has room for.
   * Detail: `found`, `expected`.
   */
  RF_ERROR_MODEL_SIZE = 41,
  /**
   * The observation has no units.
   */
  RF_ERROR_NO_UNITS = 64,
  /**
   * More units than rf_init was told. Detail: `found`, `expected`.
   */
  RF_ERROR_TOO_MANY_UNITS = 65,
  /**
   * More points in all than rf_init was told. Detail: `found`, `expected`.
   */
  RF_ERROR_TOO_MANY_POINTS = 66,
  /**
   * A unit has fewer than 4 points. Detail: `unit`, `found`, `expected`.
   */
  RF_ERROR_TOO_FEW_POINTS = 67,
  /**
   * A coordinate is NaN, infinite or beyond 1e6 m. Detail: `unit`, and its point `index`.
   */
  RF_ERROR_BAD_POINT = 68,
  /**
   * A pose is NaN, infinite or beyond 1e6 m, or its quaternion is not of length 1 within
   * 5e-4. Detail: `unit`. Of rf_drive also: the unit would have to go over 100 m/s. Detail: its
   * id, in `found`.
   */
  RF_ERROR_BAD_POSE = 69,
  /**
   * All points of a unit lie within 1e-6 m of its first. Detail: `unit`.
   */
  RF_ERROR_COINCIDENT = 70,
  /**
   * A mass is outside 1e-9 to 1e9 kg, or friction or restitution outside 0 to 1000. Detail:
   * `unit`.
   */
  RF_ERROR_BAD_PHYSICS = 71,
  /**
   * The time step is NaN, infinite, not above 0, or longer than the model takes in that scene
   * (rf_observe). Of rf_set_dt, rf_set_gravity and rf_add also: a unit would come from beyond 1e6 m.
   */
  RF_ERROR_BAD_TIMESTEP = 73,
  /**
   * A moment of inertia is outside 1e-18 to 1e18 kg m^2 or greater than the sum of the other two;
   * three zeros mean those of the box. Detail: `unit`.
   */
  RF_ERROR_BAD_INERTIA = 74,
  /**
   * A unit has more convex pieces than RF_MAX_PIECES. Detail: `unit`, `found`, `expected`.
   */
  RF_ERROR_TOO_MANY_PIECES = 75,
  /**
   * A convex piece has fewer than 4 or more than 255 points, or one of them is NaN, infinite or
   * beyond 1e6 m. Detail: `unit`, and its piece `index`.
   */
  RF_ERROR_BAD_PIECE = 76,
  /**
   * A soft unit for a model, or a library, that moves rigid ones alone; of rf_soft_points: the unit
   * is rigid, rf_poses says where it is. Detail: `unit`.
   */
  RF_ERROR_NOT_SOFT = 77,
  /**
   * A soft unit that cannot be: its points at rest are NaN, infinite, beyond 1e6 m, twice in one
   * place or all within 1e-6 m, Young's modulus is outside 1e-3 to 1e15 Pa, its role is not
   * RF_ROLE_FREE, or it has pieces. Detail: `unit`.
   */
  RF_ERROR_BAD_SOFT = 78,
  /**
   * A soft unit that was given by poses, which say nothing of its points: rf_observe takes it.
   * Detail: `unit`.
   */
  RF_ERROR_SOFT_POSE = 79,
  /**
   * No unit of the scene has that id: it was removed, or is of another scene or simulator.
   * Detail: the id `found`.
   */
  RF_ERROR_NO_SUCH_ID = 80,
  /**
   * Only driven units can be sent somewhere: rf_set_role first, or rf_set_poses. Detail: the id
   * `found`.
   */
  RF_ERROR_NOT_DRIVEN = 81,
  /**
   * The scene has no time step yet: rf_set_dt or an observation first.
   */
  RF_ERROR_NO_TIMESTEP = 82,
  /**
   * More planes than RF_MAX_PLANES. Detail: `found`, `expected`.
   */
  RF_ERROR_TOO_MANY_PLANES = 83,
  /**
   * A plane's normal is not of length 1 within 0.001, its offset is beyond 1e6 m, or its friction
   * or restitution is outside 0 to 1000. Detail: which plane, in `index`.
   */
  RF_ERROR_BAD_PLANE = 84,
  /**
   * Gravity is NaN, infinite or beyond 1e4 m/s^2 along an axis.
   */
  RF_ERROR_BAD_GRAVITY = 85,
  /**
   * A role is none of RF_ROLE_FREE, RF_ROLE_DRIVEN and RF_ROLE_FIXED. Detail: `unit`, where the
   * call gives units, and the role `found`.
   */
  RF_ERROR_BAD_ROLE = 86,
  /**
   * A body is neither RF_OWN_BODY nor from 0 to RF_MAX_BODY. Detail: `unit`, and the number
   * `found`, converted to uint64_t.
   */
  RF_ERROR_BAD_BODY = 87,
  /**
   * A unit cannot hang from another that is it or hangs from it; a pivot, axis, limit, force or target
   * is out of range; the model knows ball joints alone; or the unit hangs by no joint with an axis.
   * Detail: the id `found`, and of a circle the parent's in `expected`.
   */
  RF_ERROR_BAD_JOINT = 88,
  /**
   * The library was built without joints: the feature `robot` of rigidformer-capi, which `std`
   * has.
   */
  RF_ERROR_NO_JOINTS = 89,
  /**
   * A change that soft units do not take: units of their scene are neither added nor removed, and a
   * soft unit has no pose and no pivot and is always free. Observe the scene anew.
   */
  RF_ERROR_DEFORMS = 90,
  /**
   * A unit that a bond holds stays free and hangs from nothing: rf_break_bond first. Detail: the id
   * `found`.
   */
  RF_ERROR_BONDED = 91,
  /**
   * The model does not move units that hold together: its motion is not by impulses.
   */
  RF_ERROR_BOND_MOTION = 92,
  /**
   * The library was built without bonds: the feature `deform` of rigidformer-capi, which `std` has.
   */
  RF_ERROR_NO_BONDS = 93,
  /**
   * The library was built without health: the feature `health` of rigidformer-capi, which `std`
   * has.
   */
  RF_ERROR_NO_HEALTH = 94,
  /**
   * A variance is not above 0 and at most 1e12. Detail: which, in `index`.
   */
  RF_ERROR_BAD_VARIANCE = 95,
  /**
   * rf_step in a scene without units: before an observation, or after all were removed.
   */
  RF_ERROR_NOT_OBSERVED = 96,
  /**
   * The model takes commands and none was set. Detail: `expected` numbers.
   */
  RF_ERROR_NO_COMMAND = 97,
  /**
   * The prediction is not finite or beyond 1e6 m: a scene unlike the training data. Detail:
   * `unit`.
   */
  RF_ERROR_DIVERGED = 98,
  /**
   * The bytes are no state that rf_save wrote, or they were damaged. Detail: bytes `found` and
   * `expected` where their number is wrong, or the byte `index` of what cannot be.
   */
  RF_ERROR_STATE = 104,
  /**
   * The state is of another version of the library. Detail: `found`, `expected`.
   */
  RF_ERROR_STATE_VERSION = 105,
  /**
   * The state is of another model, or of other weights of it.
   */
  RF_ERROR_STATE_MODEL = 106,
  /**
   * The state has joints, bonds, soft units, a quarantine or several copies of a scene, which this
   * library was built without.
   */
  RF_ERROR_STATE_FEATURE = 107,
  /**
   * The state is of a scene on another height field, or on none: rf_set_height_field first.
   */
  RF_ERROR_STATE_HEIGHT_FIELD = 108,
  /**
   * The library was built without height fields (the feature `terrain` of rigidformer-capi, which `std` has), or
   * the model does not move units by impulses, as edge and nano do.
   */
  RF_ERROR_NO_HEIGHT_FIELD = 110,
  /**
   * The command has another length than the model's. Detail: `found`, `expected`.
   */
  RF_ERROR_COMMAND_SIZE = 112,
  /**
   * A number of the command is not finite. Detail: its `index`.
   */
  RF_ERROR_COMMAND_NUMBER = 113,
  /**
   * A unit would turn more than half a turn in a step, or there is not one velocity a unit. Detail: the
   * id `found`, or velocities `found` and `expected`.
   */
  RF_ERROR_BAD_VELOCITY = 114,
  /**
   * A contact stiffness is neither 0 (rigid) nor from 1e-3 to 1e12 N/m, or a dissipation is outside 0 to
   * 1e6 s/m. Detail: `unit`, or which plane, in `index`.
   */
  RF_ERROR_BAD_COMPLIANCE = 115,
  /**
   * The scene has no plane of that number. Detail: the number `found`, planes in `expected`.
   */
  RF_ERROR_NO_SUCH_PLANE = 116,
  /**
   * The library was built without compliance: the feature `compliance` of rigidformer-capi, which `std`
   * has.
   */
  RF_ERROR_NO_COMPLIANCE = 117,
  /**
   * The restitution offset of a contact law is NaN or outside 0 to 1.
   */
  RF_ERROR_BAD_CONTACT_LAW = 118,
  /**
   * A height field has fewer than 2 rows or columns or more than 4,194,304 heights, or a number of it is not
   * finite or out of range. Detail: the `index` of the height, or RF_NONE.
   */
  RF_ERROR_BAD_HEIGHT_FIELD = 119,
  /**
   * A unit cannot be bonded to itself. Detail: the id `found`.
   */
  RF_ERROR_BOND_ITSELF = 120,
  /**
   * Only free rigid units hold together. Detail: the id `found`.
   */
  RF_ERROR_BOND_NOT_FREE = 121,
  /**
   * A unit that hangs from another, or from which another hangs, cannot be bonded: rf_unjoin first.
   * Detail: the id `found`.
   */
  RF_ERROR_BOND_JOINED = 122,
  /**
   * Only units of one body hold together: the two are of different bodies, or not of one any more.
   * Detail: the ids, in `found` and `expected`.
   */
  RF_ERROR_BOND_APART = 123,
  /**
   * The pair has a bond already, or had one: broken bonds stay broken. Detail: the ids, in `found`
   * and `expected`.
   */
  RF_ERROR_BOND_TWICE = 124,
  /**
   * More bonds than there is room for: 8 for each unit of rf_config. Detail: `found`, `expected`.
   */
  RF_ERROR_TOO_MANY_BONDS = 125,
  /**
   * The pair has no bond. Detail: the ids, in `found` and `expected`.
   */
  RF_ERROR_NO_SUCH_BOND = 126,
  /**
   * An error that this version of the interface has no code for.
   */
  RF_ERROR_OTHER = 127,
  /**
   * An option of a tracker cannot be: rf_tracker_create's message says which, and its range.
   */
  RF_ERROR_TRACKER_OPTION = 128,
  /**
   * A model file cannot be read: see rf_tracker_create's message.
   */
  RF_ERROR_MODEL_FILE = 129,
  /**
   * A capture's time is not finite, or not above that of the capture before: give captures in the
   * order of their times, each once.
   */
  RF_ERROR_CAPTURE_TIME = 130,
  /**
   * A capture has neither images nor clouds: leave it out.
   */
  RF_ERROR_CAPTURE_EMPTY = 131,
  /**
   * The size, the focal lengths, the principal point or the pose of a depth camera cannot be:
   * rf_tracker_message says which of which camera.
   */
  RF_ERROR_CAPTURE_CAMERA = 132,
  /**
   * A scale of depths is outside 1e-6 to 10 m: give metres a step, such as 0.001.
   */
  RF_ERROR_CAPTURE_SCALE = 133,
  /**
   * A point of a cloud, or its sensor, is not finite or beyond 1e6 m: drop it.
   */
  RF_ERROR_CAPTURE_POINT = 134,
  /**
   * A horizon is not above 0 and at most RF_MAX_HORIZON_S.
   */
  RF_ERROR_HORIZON = 135,
  /**
   * The model of a tracker does not take the scene: rf_tracker_message says why.
   */
  RF_ERROR_FORECAST = 136,
  /**
   * No unit of a tracker has that number: its track ended, or never was.
   */
  RF_ERROR_NO_SUCH_TRACK = 137,
  /**
   * There is no memory for a capture: give smaller images, or fewer points.
   */
  RF_ERROR_NO_MEMORY = 138,
  /**
   * A defect of the library ended a call of a tracker: destroy it and make another. Please report
   * what standard error says.
   */
  RF_ERROR_DEFECT = 139
};
#ifndef __cplusplus
#if __STDC_VERSION__ >= 202311L
typedef enum rf_status rf_status;
#else
typedef int32_t rf_status;
#endif /* __STDC_VERSION__ >= 202311L */
#endif /* __cplusplus */

/**
 * A simulator in the caller's memory. Only its address is of use.
 */
typedef struct rf_simulator rf_simulator;

/**
 * A pose, whose quaternion has w last: x = rotate(quaternion, reference point) + position. Poses of
 * Python, scene files and recordings have w first: rf_pose_from_wxyz.
 */
typedef struct rf_pose {
  /**
   * x, y, z in metres, world frame (right-handed, z up).
   */
  float position[3];
  /**
   * x, y, z, w; of length 1. w is not negative in what the library writes.
   */
  float quaternion[4];
} rf_pose;

/**
 * What rf_workspace_bytes and rf_init are told.
 */
typedef struct rf_config {
  /**
   * RF_ABI_VERSION.
   */
  uint32_t abi_version;
  /**
   * Units, at most.
   */
  uint32_t max_units;
  /**
   * Points of all units together, at most. A unit of several pieces takes as many as it has, or as
   * its pieces have and two a piece more, whichever are more.
   */
  uint32_t max_points;
  /**
   * Threads that share a step, up to RF_MAX_THREADS; 0 and 1: the caller's alone. They are the process's, made at the first
   * step, and bits do not depend on them. Libraries for microcontrollers do not look at it.
   */
  uint32_t threads;
  /**
   * A packed model (.rfm), aligned to RF_ALIGNMENT; read in place, so it may be in flash.
   */
  const uint8_t *model;
  /**
   * Its length, bytes.
   */
  size_t model_bytes;
} rf_config;

/**
 * Numbers of the last error. What is not said is RF_NONE (`unit`, `index`) or 0.
 */
typedef struct rf_detail {
  /**
   * The error; RF_OK where there was none yet.
   */
  rf_status code;
  /**
   * Which unit, from 0.
   */
  uint32_t unit;
  /**
   * Which point, piece, number or tensor, from 0.
   */
  uint32_t index;
  /**
   * Zero.
   */
  uint32_t reserved;
  /**
   * What there was.
   */
  uint64_t found;
  /**
   * What there should have been, or at most.
   */
  uint64_t expected;
} rf_detail;

/**
 * What a unit is made of. Nothing moves a driven or fixed unit, whatever its mass.
 */
typedef struct rf_physics {
  /**
   * Mass, kg, from 1e-9 to 1e9.
   */
  float mass_kg;
  /**
   * Friction coefficient, from 0 to 1000.
   */
  float friction;
  /**
   * Restitution coefficient, from 0 to 1000.
   */
  float restitution;
} rf_physics;

/**
 * The units of an observation.
 */
typedef struct rf_units {
  /**
   * How many units.
   */
  size_t unit_count;
  /**
   * (unit_count) what each is made of.
   */
  const struct rf_physics *physics;
  /**
   * (unit_count) how many points each has, at least 4: unit 0 has the first `point_counts[0]`
   * points of an array of points, unit 1 the next `point_counts[1]`, and so on.
   */
  const uint32_t *point_counts;
  /**
   * The sum of point_counts: how many points each array of points has.
   */
  size_t point_count;
  /**
   * (unit_count) who moves each: RF_ROLE_FREE, RF_ROLE_DRIVEN or RF_ROLE_FIXED. NULL: all are
   * free.
   */
  const uint32_t *roles;
  /**
   * (unit_count) the body that each is a part of, from 0 to RF_MAX_BODY, or RF_OWN_BODY. Units of
   * one body do not collide with each other. NULL: each is a body of its own.
   */
  const int32_t *bodies;
  /**
   * (unit_count, 3) principal moments of inertia of each, as in rf_unit. NULL: those of boxes.
   */
  const float *inertias_kg_m2;
  /**
   * (unit_count) how many convex pieces each has, as in rf_unit, or 0: unit 0 has the first
   * `unit_pieces[0]` pieces, unit 1 the next `unit_pieces[1]`, and so on. NULL: none has any.
   */
  const uint16_t *unit_pieces;
  /**
   * (piece_count) how many points each piece has, from 4 to 255, all units' pieces one after
   * another. May be NULL where piece_count is 0.
   */
  const uint16_t *piece_counts;
  /**
   * The sum of unit_pieces: how many pieces all units have.
   */
  size_t piece_count;
  /**
   * (piece_point_count, 3) x, y, z in metres of the points of all pieces, one piece after
   * another, in the frame of the unit's reference points. May be NULL where piece_point_count is
   * 0.
   */
  const float *piece_points;
  /**
   * The sum of piece_counts: how many points all pieces have.
   */
  size_t piece_point_count;
  /**
   * (unit_count) Young's modulus of each soft unit, Pa, from 1e-3 to 1e15; 0 for rigid units. A soft
   * unit is a patch of a body that deforms: patches with one number in `bodies` are one body. Models
   * of soft bodies move it, such as shell.rfm. NULL: all are rigid.
   */
  const float *young_pa;
  /**
   * (point_count, 3) x, y, z in metres: where the points of soft units are at rest, in the order of
   * the points that are observed, all patches of a body in one frame. Points of two patches that are
   * in one place there are one point of the body. Those of rigid units are not looked at. May be
   * NULL where young_pa is.
   */
  const float *rest_points;
} rf_units;

/**
 * What an accepted observation was like.
 */
typedef struct rf_observation {
  /**
   * Largest distance of a point from the rigid fit of its unit, metres; 0 where poses were
   * given. Far above the sensor's noise, a unit was not rigid or its points were not the same in
   * both frames.
   */
  float residual_m;
  /**
   * Units whose points left their rotation open: all on a line.
   */
  uint32_t degenerate_units;
  /**
   * Zero.
   */
  uint32_t reserved[2];
} rf_observation;

/**
 * What a step did.
 */
typedef struct rf_step_report {
  /**
   * Units whose motion the network predicted; the others can touch nothing within the step and
   * moved freely, exactly, or are driven or fixed.
   */
  uint32_t active_units;
  /**
   * Units whose anchors left their rotation open.
   */
  uint32_t degenerate_units;
  /**
   * Units in quarantine after the step (rf_set_quarantine).
   */
  uint32_t quarantined_units;
  /**
   * Zero.
   */
  uint32_t reserved;
} rf_step_report;

/**
 * Name of a unit within its simulator. It stays valid until that unit is removed or another scene
 * is observed, and is never given to another unit of that simulator. 0 is no unit's.
 */
typedef uint64_t rf_unit_id;

/**
 * How a unit moves now, at the end of its last step.
 */
typedef struct rf_velocity {
  /**
   * Of the origin of the unit's reference points, m/s.
   */
  float linear_m_s[3];
  /**
   * Along the world's axes, rad/s.
   */
  float angular_rad_s[3];
} rf_velocity;

/**
 * A unit's centre of mass in the world, metres, with all digits that the simulator keeps.
 */
typedef struct rf_centre {
  /**
   * Along x.
   */
  double x;
  /**
   * Along y.
   */
  double y;
  /**
   * Along z.
   */
  double z;
} rf_centre;

/**
 * A pose as the simulator keeps it, about the unit's own centre: for comparing two targets bit
 * for bit. rf_poses is what an application wants.
 */
typedef struct rf_internal_pose {
  /**
   * Rotation matrix, row by row.
   */
  float rotation[9];
  /**
   * The unit's centre in the world, metres.
   */
  float centre[3];
} rf_internal_pose;

/**
 * A unit that is added to a scene; soft units are observed (rf_units).
 */
typedef struct rf_unit {
  /**
   * What it is made of.
   */
  struct rf_physics physics;
  /**
   * Who moves it: RF_ROLE_FREE, RF_ROLE_DRIVEN or RF_ROLE_FIXED.
   */
  uint32_t role;
  /**
   * The body that it is a part of, from 0 to RF_MAX_BODY, or RF_OWN_BODY.
   */
  int32_t body;
  /**
   * (point_count, 3) x, y, z in metres, in the unit's own reference frame, in any order.
   */
  const float *points;
  /**
   * How many points, at least 4.
   */
  size_t point_count;
  /**
   * Principal moments of inertia, kg m^2, through the unit's centre about axes along x, y, z of
   * its reference frame: each from 1e-18 to 1e18 and at most the sum of the other two. All zeros:
   * those of a uniform box around the points, or of a uniform ball for about 120 points or more on
   * a sphere. rf_set_physics changes them as it does the mass.
   */
  float inertia_kg_m2[3];
  /**
   * (sum of piece_counts, 3) x, y, z in metres, in the frame of `points`: the points of its convex
   * pieces, one piece after another. They may overlap. The unit's centre is that of its pieces.
   * Where the model moves units by impulses, it touches with them instead of the hull of its
   * points. May be NULL where there are none.
   */
  const float *piece_points;
  /**
   * (piece_count) how many points each piece has, from 4 to 255. May be NULL where piece_count is 0.
   */
  const uint16_t *piece_counts;
  /**
   * How many pieces, at most RF_MAX_PIECES. 0: it touches with the hull of its points.
   */
  size_t piece_count;
} rf_unit;

/**
 * How contact with a unit or a plane gives way: at a depth d that changes by d' a second, each contact
 * point pushes with `stiffness d (1 + dissipation d')` newtons, and never pulls. Two that touch give way in
 * series. Where one gives way, restitution counts for nothing.
 */
typedef struct rf_compliance {
  /**
   * At a contact point, N/m, from 1e-3 to 1e12; 0 or infinite: rigid.
   */
  float stiffness_n_m;
  /**
   * s/m, from 0 to 1e6.
   */
  float dissipation_s_m;
} rf_compliance;

/**
 * An unmoving plane: the points x with normal . x = offset_m. Units stay on the side that the
 * normal points to.
 */
typedef struct rf_plane {
  /**
   * Unit vector towards the free side, of length 1 within 0.001.
   */
  float normal[3];
  /**
   * Distance of the plane from the origin along the normal, metres.
   */
  float offset_m;
  /**
   * Friction coefficient, from 0 to 1000.
   */
  float friction;
  /**
   * Restitution coefficient, from 0 to 1000.
   */
  float restitution;
} rf_plane;

/**
 * Unmoving ground of varying height: a grid of heights, in rows along y and columns along x. Units stay above it; beyond
 * its borders there is nothing. A cell between four heights is two triangles, which share the diagonal from its corner of
 * least x and y.
 */
typedef struct rf_height_field {
  /**
   * (rows, columns) heights above the corner, metres. The simulator reads them in each step: they stay where they
   * are, and as they are, until rf_set_height_field takes another field or the simulator is gone.
   */
  const float *heights_m;
  /**
   * At least 2; rows times columns is at most 4,194,304.
   */
  uint32_t rows;
  /**
   * At least 2.
   */
  uint32_t columns;
  /**
   * Between columns along x and between rows along y, metres, from 1e-4 to 1e4.
   */
  float spacing_m[2];
  /**
   * The place of a first height of zero, metres.
   */
  float corner_m[3];
  /**
   * Friction coefficient, from 0 to 1000.
   */
  float friction;
  /**
   * Restitution coefficient, from 0 to 1000.
   */
  float restitution;
} rf_height_field;

/**
 * A pair of units that hold together, or did.
 */
typedef struct rf_bonded {
  /**
   * The two, in the order of rf_poses.
   */
  rf_unit_id units[2];
  /**
   * 1 while the bond holds; 0 once it is broken, which is for good.
   */
  uint32_t holds;
  /**
   * Zero.
   */
  uint32_t reserved;
} rf_bonded;

/**
 * What holds a unit to another. Its position is 0 as the two are when they are joined.
 */
typedef struct rf_joint {
  /**
   * RF_JOINT_BALL, RF_JOINT_REVOLUTE, RF_JOINT_PRISMATIC or RF_JOINT_FIXED.
   */
  uint32_t kind;
  /**
   * One place in the frame of the unit's reference points, metres.
   */
  float pivot[3];
  /**
   * And in the frame of the parent's.
   */
  float parent_pivot[3];
  /**
   * Of revolute and prismatic joints, in the frame of the unit's reference points: not 0.
   */
  float axis[3];
  /**
   * Least and greatest position: radians within half a turn to either side, or metres. Both 0: none.
   */
  float limits[2];
  /**
   * The most that takes it to a target, N m or N. 0: whatever that takes.
   */
  float max_force;
} rf_joint;

/**
 * What can be said of how far a unit's prediction may be believed.
 */
typedef struct rf_health {
  /**
   * 1 where the model says what training saw; else 0, and what follows is zeros but for
   * `quarantined`.
   */
  uint32_t known;
  /**
   * Quantities that are outside of what training saw: bit k for quantity k of rf_quantity_string.
   */
  uint32_t outside;
  /**
   * Of all quantities the one that is farthest outside, or nearest to its end where none is.
   */
  uint32_t quantity;
  /**
   * What that is.
   */
  float value;
  /**
   * How far that is beyond its range, in widths of the range; below 0 inside.
   */
  float beyond;
  /**
   * 1 where the unit diverged and waits for a pose (rf_set_quarantine).
   */
  uint32_t quarantined;
  /**
   * Zero.
   */
  uint32_t reserved[2];
} rf_health;

#ifdef __cplusplus
extern "C" {
#endif /* __cplusplus */

/**
 * Version of the library, such as "0.2.0"; a text that is never freed.
 */
const char *rf_version(void);

/**
 * RF_ABI_VERSION of the library; rf_init compares it with the header's.
 */
uint32_t rf_abi_version(void);

/**
 * What a code means, in English: a text that is never freed. Any number may be asked about.
 */
const char *rf_error_string(int32_t code);

/**
 * Takes a pose from seven numbers whose quaternion has w first, as those of Python, scene files and
 * recordings. Nothing is checked: the function that takes the pose does that.
 *
 * @param numbers  x, y, z in metres, then w, x, y, z
 * @param pose     out: the pose
 * @return RF_OK, RF_ERROR_NULL or RF_ERROR_ALIGNMENT
 */
rf_status rf_pose_from_wxyz(const float *numbers, struct rf_pose *pose);

/**
 * Writes a pose as seven numbers whose quaternion has w first.
 *
 * @param pose     the pose
 * @param numbers  out: x, y, z in metres, then w, x, y, z
 * @return as rf_pose_from_wxyz
 */
rf_status rf_pose_to_wxyz(const struct rf_pose *pose, float *numbers);

/**
 * How large a workspace rf_init needs, exactly, in bytes: a multiple of RF_ALIGNMENT.
 *
 * It depends on the model's sizes, the limits, the pointer size and this version of the library; of
 * libraries for Linux also on the kernels (RIGIDFORMER_KERNEL), on whether threads share a step, and where the model is int8 on its
 * weights, which the workspace then holds in another order. On processors with AMX, Linux refuses the
 * process signal stacks below about 11 kB from then on; RIGIDFORMER_KERNEL=avx512-vnni prevents that. Reads the whole model once (its
 * checksums); any thread may call it. Libraries for Linux allocate meanwhile.
 *
 * @param config  the model and the limits
 * @param bytes   out: the size
 * @return RF_OK, RF_ERROR_NULL, RF_ERROR_ALIGNMENT, RF_ERROR_ABI, RF_ERROR_LENGTH,
 *         RF_ERROR_KERNEL, RF_ERROR_THREADS or one of RF_ERROR_MODEL_...
 */
rf_status rf_workspace_bytes(const struct rf_config *config,
                             size_t *bytes);

/**
 * Checks a model completely and makes a simulator in memory of the caller.
 *
 * Nothing need be freed: what libraries for Linux allocate here, they free before this call returns. The workspace belongs to the simulator, and the
 * model is read in place: both must stay where they are, unchanged and mapped, until the last call
 * with the simulator (or rf_release). A workspace must not be copied or moved. Where this call
 * fails, the workspace is untouched, so a simulator that was there before goes on. Where it
 * succeeds, that one is gone: make sure that no call with it is under way, since this call is
 * how a workspace is recovered whose caller was stopped in the middle.
 *
 * @param config           the model and the limits
 * @param workspace        memory aligned to RF_ALIGNMENT; need not be initialised
 * @param workspace_bytes  its size, at least that of rf_workspace_bytes
 * @param simulator        out: the handle, or NULL where the call fails
 * @param detail           out: the numbers of the error; may be NULL
 * @return RF_OK, RF_ERROR_NULL, RF_ERROR_ALIGNMENT, RF_ERROR_ABI, RF_ERROR_MEMORY,
 *         RF_ERROR_LENGTH, RF_ERROR_OVERLAP, RF_ERROR_KERNEL, RF_ERROR_THREADS or one of
 *         RF_ERROR_MODEL_...
 */
rf_status rf_init(const struct rf_config *config,
                  void *workspace,
                  size_t workspace_bytes,
                  struct rf_simulator **simulator,
                  struct rf_detail *detail);

/**
 * Ends a simulator: later calls with the handle give RF_ERROR_HANDLE while the workspace is not
 * used for something else. Only needed to have that; nothing is freed.
 *
 * @return RF_OK, RF_ERROR_NULL, RF_ERROR_HANDLE or RF_ERROR_BUSY
 */
rf_status rf_release(struct rf_simulator *simulator);

/**
 * Starts from two frames of points: the same points of the same units, in the same order, dt_s
 * seconds apart. Every step then takes as long. The previous frame becomes the reference of
 * rf_poses. Planes and gravity stay what they were; the ids and bonds of earlier units end. Soft
 * units deform: rf_soft_points says where their points are.
 *
 * @param simulator    the simulator
 * @param dt_s         seconds between the two frames, and of a step; from 1 us (soft: 1 ms) and no longer
 *                     than the model takes. nano and edge take 16 x 16/240 s in the scene's own time:
 *                     1.07 s where the mean radius of free units is 0.7 m and gravity is the model's,
 *                     and less by a square root where units are smaller or gravity is stronger. Models
 *                     of soft bodies take 4096 of their sub-steps. The models that come with this
 *                     project were trained with 1/240 to 40/240 s
 * @param units        the units
 * @param previous     (units->point_count, 3) x, y, z in metres, world frame
 * @param current      (units->point_count, 3) likewise
 * @param observation  out: what the observation was like; may be NULL
 * @return RF_OK, an error of the call (below 32), of the observation (64 to 79),
 *         RF_ERROR_BAD_ROLE or RF_ERROR_BAD_BODY. Where it is refused, the scene is what it was
 */
rf_status rf_observe(struct rf_simulator *simulator,
                     float dt_s,
                     const struct rf_units *units,
                     const float *previous,
                     const float *current,
                     struct rf_observation *observation);

/**
 * Starts from known poses, dt_s seconds apart. Each carries the unit's reference points to the
 * world; nothing is fitted.
 *
 * @param simulator    the simulator
 * @param dt_s         seconds, as for rf_observe
 * @param units        the units
 * @param points       (units->point_count, 3) x, y, z in metres, each unit in its own reference
 *                     frame, in any order
 * @param previous     (units->unit_count) poses of the previous frame
 * @param current      (units->unit_count) poses of the current frame
 * @param observation  out: all zeros; may be NULL
 * @return as rf_observe
 */
rf_status rf_observe_poses(struct rf_simulator *simulator,
                           float dt_s,
                           const struct rf_units *units,
                           const float *points,
                           const struct rf_pose *previous,
                           const struct rf_pose *current,
                           struct rf_observation *observation);

/**
 * Sets the command that conditions all following steps, for models that take one.
 *
 * @param simulator  the simulator
 * @param numbers    (count) finite numbers in the model's units
 * @param count      how many; the model's command size
 * @return RF_OK, an error of the call, RF_ERROR_COMMAND_SIZE or RF_ERROR_COMMAND_NUMBER. Where it
 *         is refused, the previous command stays
 */
rf_status rf_set_command(struct rf_simulator *simulator, const float *numbers, size_t count);

/**
 * Advances the scene by one step. The model moves free units, driven units go where rf_drive sends
 * them, and fixed units stay.
 *
 * @param simulator  the simulator
 * @param report     out: what the step did; may be NULL
 * @return RF_OK, an error of the call, RF_ERROR_NOT_OBSERVED, RF_ERROR_NO_COMMAND or
 *         RF_ERROR_DIVERGED. Where it is refused, the scene is what it was
 */
rf_status rf_step(struct rf_simulator *simulator, struct rf_step_report *report);

/**
 * Units in the scene: 0 before an observation or rf_add.
 *
 * @param simulator  the simulator
 * @param count      out: how many
 * @return RF_OK or an error of the call
 */
rf_status rf_unit_count(const struct rf_simulator *simulator, uint32_t *count);

/**
 * Ids of all units, in the order of rf_poses: that of the observation, then of rf_add.
 *
 * @param simulator  the simulator
 * @param ids        out: (rf_unit_count) ids
 * @param capacity   how many there is room for
 * @return RF_OK, an error of the call, or RF_ERROR_BUFFER, which writes nothing
 */
rf_status rf_unit_ids(const struct rf_simulator *simulator, rf_unit_id *ids, size_t capacity);

/**
 * Pose of one unit in the current frame, as rf_poses gives it.
 *
 * @param simulator  the simulator
 * @param id         which unit
 * @param pose       out: its pose
 * @return RF_OK, an error of the call or RF_ERROR_NO_SUCH_ID
 */
rf_status rf_unit_pose(const struct rf_simulator *simulator, rf_unit_id id, struct rf_pose *pose);

/**
 * Poses of all units in the current frame: each carries the unit's reference points (rf_observe:
 * its points of the previous frame; rf_observe_poses, rf_add: `points`) to the world.
 *
 * @param simulator  the simulator
 * @param poses      out: (rf_unit_count) poses, unit by unit
 * @param capacity   how many there is room for
 * @return RF_OK, an error of the call, or RF_ERROR_BUFFER, which writes nothing
 */
rf_status rf_poses(const struct rf_simulator *simulator, struct rf_pose *poses, size_t capacity);

/**
 * How one unit moves now, at the end of its last step, in which gravity has acted to the end.
 *
 * @param simulator  the simulator
 * @param id         which unit
 * @param velocity   out: its velocity
 * @return RF_OK, an error of the call or RF_ERROR_NO_SUCH_ID
 */
rf_status rf_unit_velocity(const struct rf_simulator *simulator,
                           rf_unit_id id,
                           struct rf_velocity *velocity);

/**
 * How all units move now, in the order of rf_poses.
 *
 * @param simulator   the simulator
 * @param velocities  out: (rf_unit_count) velocities, unit by unit
 * @param capacity    how many there is room for
 * @return RF_OK, an error of the call, or RF_ERROR_BUFFER, which writes nothing
 */
rf_status rf_velocities(const struct rf_simulator *simulator,
                        struct rf_velocity *velocities,
                        size_t capacity);

/**
 * Centres of all units with all digits that the simulator keeps, in the order of rf_poses. Floats hold
 * no more than 6 cm at 1000 km.
 *
 * @param simulator  the simulator
 * @param centres    out: (rf_unit_count) centres, x, y and z in the world, metres
 * @param capacity   how many there is room for
 * @return as rf_poses
 */
rf_status rf_centres(const struct rf_simulator *simulator,
                     struct rf_centre *centres,
                     size_t capacity);

/**
 * Poses of all units as the simulator keeps them, about the units' own centres: the bits by which
 * two targets are compared.
 *
 * @param simulator  the simulator
 * @param poses      out: (rf_unit_count) poses, unit by unit
 * @param capacity   how many there is room for
 * @return as rf_poses
 */
rf_status rf_internal_poses(const struct rf_simulator *simulator,
                            struct rf_internal_pose *poses,
                            size_t capacity);

/**
 * World positions of a unit's points in the current frame, in the simulator's own order, which is
 * not that of the observation: each next point is the one farthest from those before.
 *
 * @param simulator  the simulator
 * @param unit       which unit, from 0, in the order of rf_poses
 * @param points     out: (count, 3) x, y, z in metres; may be NULL where capacity is 0
 * @param capacity   how many points there is room for
 * @param count      out: how many points the unit has, also where RF_ERROR_BUFFER says that they do
 *                   not fit
 * @return RF_OK, an error of the call, RF_ERROR_NO_SUCH_UNIT or RF_ERROR_BUFFER
 */
rf_status rf_points(const struct rf_simulator *simulator,
                    uint32_t unit,
                    float *points,
                    size_t capacity,
                    size_t *count);

/**
 * World positions of a soft unit's points in the current frame, in the order in which rf_observe was
 * given them. A soft unit's pose is the place of the points' mean, without a turn.
 *
 * @param simulator  the simulator
 * @param unit       which unit, from 0, in the order of rf_poses
 * @param points     out: (count, 3) x, y, z in metres; may be NULL where capacity is 0
 * @param capacity   how many points there is room for
 * @param count      out: how many points the unit has, also where RF_ERROR_BUFFER says that they do
 *                   not fit
 * @return RF_OK, an error of the call, RF_ERROR_NO_SUCH_UNIT, RF_ERROR_NOT_SOFT or RF_ERROR_BUFFER
 */
rf_status rf_soft_points(const struct rf_simulator *simulator,
                         uint32_t unit,
                         float *points,
                         size_t capacity,
                         size_t *count);

/**
 * Numbers of the last error of a simulator's calls: which unit and point, what was found and what
 * would do. Errors that find no simulator (RF_ERROR_HANDLE, RF_ERROR_BUSY) are not kept.
 *
 * @param simulator  the simulator
 * @param detail     out: the numbers; its code is RF_OK where no call was refused yet
 * @return RF_OK or an error of the call
 */
rf_status rf_last_error_detail(const struct rf_simulator *simulator, struct rf_detail *detail);

/**
 * Adds a unit behind the others, given its poses a step ago and now: twice the same for a unit at
 * rest. The motion of the other units goes on. The scene needs a time step, from an observation or
 * rf_set_dt.
 *
 * @param simulator  the simulator
 * @param unit       the unit
 * @param previous   its pose a step ago: carries `unit->points` to the world
 * @param current    its pose now
 * @param id         out: its id; may be NULL
 * @return RF_OK, an error of the call, of the unit (64 to 76; `unit` in the detail is the number
 *         that it would have had), RF_ERROR_NO_TIMESTEP, RF_ERROR_BAD_ROLE, RF_ERROR_BAD_BODY or
 *         RF_ERROR_DEFORMS. Where it is refused, the scene is what it was
 */
rf_status rf_add(struct rf_simulator *simulator,
                 const struct rf_unit *unit,
                 const struct rf_pose *previous,
                 const struct rf_pose *current,
                 rf_unit_id *id);

/**
 * Removes a unit. The others keep their ids and their order, and their motion goes on.
 *
 * @param simulator  the simulator
 * @param id         which unit
 * @return RF_OK, an error of the call, RF_ERROR_NO_SUCH_ID or RF_ERROR_DEFORMS. Where it is
 *         refused, the scene is what it was
 */
rf_status rf_remove(struct rf_simulator *simulator, rf_unit_id id);

/**
 * Sends a driven unit to where it will be after the next step. It then stays there until it is sent
 * somewhere else.
 *
 * @param simulator  the simulator
 * @param id         which unit, of RF_ROLE_DRIVEN
 * @param pose       where to: carries the unit's reference points to the world
 * @return RF_OK, an error of the call, RF_ERROR_NO_SUCH_ID, RF_ERROR_NOT_DRIVEN or
 *         RF_ERROR_BAD_POSE. Where it is refused, the unit goes where it would have gone
 */
rf_status rf_drive(struct rf_simulator *simulator, rf_unit_id id, const struct rf_pose *pose);

/**
 * Changes where a unit was a step ago and is now, such as after a new measurement: a free unit goes
 * on with the motion from one to the other.
 *
 * @param simulator  the simulator
 * @param id         which unit
 * @param previous   its pose a step ago: carries the unit's reference points to the world
 * @param current    its pose now
 * @return RF_OK, an error of the call, RF_ERROR_NO_SUCH_ID, RF_ERROR_BAD_POSE or RF_ERROR_DEFORMS.
 *         Where it is refused, the unit is what it was
 */
rf_status rf_set_poses(struct rf_simulator *simulator,
                       rf_unit_id id,
                       const struct rf_pose *previous,
                       const struct rf_pose *current);

/**
 * Changes how a unit moves from now on: without contact it flies as a thrown body does. A driven unit
 * forgets where it was sent.
 *
 * @param simulator  the simulator
 * @param id         which unit
 * @param velocity   its velocity now; at most half a turn a step
 * @return RF_OK, an error of the call, RF_ERROR_NO_SUCH_ID, RF_ERROR_BAD_VELOCITY, RF_ERROR_DEFORMS or
 *         RF_ERROR_BAD_POSE, where it would come from beyond 1e6 m. Where it is refused, the unit is
 *         what it was
 */
rf_status rf_set_velocity(struct rf_simulator *simulator,
                          rf_unit_id id,
                          const struct rf_velocity *velocity);

/**
 * Changes how all units move from now on, in the order of rf_poses: as rf_set_velocity.
 *
 * @param simulator   the simulator
 * @param velocities  (count) velocities, unit by unit
 * @param count       how many: as many as there are units
 * @return as rf_set_velocity; where it is refused, all units are what they were
 */
rf_status rf_set_velocities(struct rf_simulator *simulator,
                            const struct rf_velocity *velocities,
                            size_t count);

/**
 * Changes what a unit is made of.
 *
 * @param simulator  the simulator
 * @param id         which unit
 * @param physics    what it is made of from now on
 * @return RF_OK, an error of the call, RF_ERROR_NO_SUCH_ID or RF_ERROR_BAD_PHYSICS. Where it is
 *         refused, the unit is what it was
 */
rf_status rf_set_physics(struct rf_simulator *simulator,
                         rf_unit_id id,
                         const struct rf_physics *physics);

/**
 * Changes how contact with a unit gives way; without this call it is rigid. rf_observe makes it rigid again.
 *
 * @param simulator   the simulator
 * @param id          which unit
 * @param compliance  how contact with it gives way from now on
 * @return RF_OK, an error of the call, RF_ERROR_NO_SUCH_ID, RF_ERROR_BAD_COMPLIANCE or
 *         RF_ERROR_NO_COMPLIANCE. Where it is refused, the unit is what it was
 */
rf_status rf_set_compliance(struct rf_simulator *simulator,
                            rf_unit_id id,
                            const struct rf_compliance *compliance);

/**
 * Changes how contact with a plane gives way; it lasts until rf_set_planes, which makes all rigid.
 *
 * @param simulator   the simulator
 * @param plane       which plane, from 0, in the order of rf_set_planes
 * @param compliance  how contact with it gives way from now on
 * @return RF_OK, an error of the call, RF_ERROR_NO_SUCH_PLANE, RF_ERROR_BAD_COMPLIANCE or
 *         RF_ERROR_NO_COMPLIANCE. Where it is refused, the plane is what it was
 */
rf_status rf_set_plane_compliance(struct rf_simulator *simulator,
                                  uint32_t plane,
                                  const struct rf_compliance *compliance);

/**
 * Changes who moves a unit. A unit that becomes free goes on with the motion of its last step. A
 * unit that becomes driven stays where it is until rf_drive sends it somewhere.
 *
 * @param simulator  the simulator
 * @param id         which unit
 * @param role       RF_ROLE_FREE, RF_ROLE_DRIVEN or RF_ROLE_FIXED
 * @return RF_OK, an error of the call, RF_ERROR_NO_SUCH_ID, RF_ERROR_BAD_ROLE, RF_ERROR_BONDED or
 *         RF_ERROR_DEFORMS. Where it is refused, the unit is what it was
 */
rf_status rf_set_role(struct rf_simulator *simulator, rf_unit_id id, uint32_t role);

/**
 * Changes the planes that the scene stands on or between. Without this call that is the ground,
 * z = 0 with the friction and restitution of the model. They last beyond observations.
 *
 * @param simulator  the simulator
 * @param planes     (count) planes
 * @param count      how many, at most RF_MAX_PLANES; 0 for none
 * @return RF_OK, an error of the call, RF_ERROR_TOO_MANY_PLANES or RF_ERROR_BAD_PLANE. Where it is
 *         refused, the planes are what they were
 */
rf_status rf_set_planes(struct rf_simulator *simulator,
                        const struct rf_plane *planes,
                        size_t count);

/**
 * Puts the scene on ground of varying height, besides its planes. It lasts beyond observations, and rf_save does not
 * hold it. Impulses alone move units there: no network has seen such ground. Contact with it is rigid on its side.
 *
 * @param simulator  the simulator
 * @param field      the ground, whose heights the simulator goes on reading; NULL takes it away
 * @return RF_OK, an error of the call, RF_ERROR_BAD_HEIGHT_FIELD or RF_ERROR_NO_HEIGHT_FIELD. Where it is
 *         refused, the ground is what it was
 */
rf_status rf_set_height_field(struct rf_simulator *simulator,
                              const struct rf_height_field *field);

/**
 * Lets the network correct motion, as it does at first, or leaves it out. Without it units move as the model moves them
 * before its network corrects that. It lasts beyond observations.
 *
 * @param simulator  the simulator
 * @param corrects   1 or 0
 * @return RF_OK or an error of the call
 */
rf_status rf_set_network(struct rf_simulator *simulator,
                         uint32_t corrects);

/**
 * Says how contacts that bounce differ from rigid ones: the law of whatever recorded the scene. Without this call they are
 * rigid. It holds with the network and without it, and lasts beyond observations. It is for models that move units by impulses;
 * with others it has no effect.
 *
 * @param simulator           the simulator
 * @param restitution_offset  is added to the restitution of each pair, up to 1: from 0 to 1
 * @param pyramid             1: friction is limited along the sliding and across it apart, as Bullet does; 0: together
 * @return RF_OK, an error of the call or RF_ERROR_BAD_CONTACT_LAW. Where it is refused, the law is what it was
 */
rf_status rf_set_contact_law(struct rf_simulator *simulator,
                             float restitution_offset,
                             uint32_t pyramid);

/**
 * How contacts that bounce differ from rigid ones, as rf_set_contact_law said.
 *
 * @param simulator           the simulator
 * @param restitution_offset  out: what is added to the restitution of each pair
 * @param pyramid             out: 1 or 0
 * @return RF_OK or an error of the call
 */
rf_status rf_contact_law(const struct rf_simulator *simulator,
                         float *restitution_offset,
                         uint32_t *pyramid);

/**
 * Changes gravity; without this call it is the model's. It lasts beyond observations.
 *
 * @param simulator     the simulator
 * @param gravity_m_s2  (3) x, y, z in m/s^2, each at most 1e4
 * @return RF_OK, an error of the call, RF_ERROR_BAD_GRAVITY or, in a scene with units,
 *         RF_ERROR_BAD_TIMESTEP: models such as nano and edge measure time by gravity, so that a
 *         time step can be too long for a stronger one. Where it is refused, gravity is what it was
 */
rf_status rf_set_gravity(struct rf_simulator *simulator, const float *gravity_m_s2);

/**
 * Changes the time that a step takes. Units keep their velocities and spins. Before an observation,
 * this gives the scene a time step, so that rf_add can build it unit by unit.
 *
 * @param simulator  the simulator
 * @param dt_s       seconds, as for rf_observe. In a scene without units rf_add finds out whether
 *                   nano, edge and models like them take it
 * @return RF_OK, an error of the call or RF_ERROR_BAD_TIMESTEP. Where it is refused, the time step
 *         is what it was
 */
rf_status rf_set_dt(struct rf_simulator *simulator, float dt_s);

/**
 * Hangs a unit from another by a pivot, a place that is fixed in the frames of both: after each step
 * the two images of it are one. Joints make trees; a unit that hangs already hangs from the new
 * parent then. They end with rf_unjoin, with the removal of one of the two and with another
 * observation. Libraries for microcontrollers have no joints unless they are built with the feature
 * `robot`.
 *
 * @param simulator     the simulator
 * @param id            the unit that hangs
 * @param parent        the unit that it hangs from
 * @param pivot         (3) x, y, z in the frame of the unit's reference points, metres
 * @param parent_pivot  (3) the same place in the frame of the parent's reference points
 * @return RF_OK, an error of the call, RF_ERROR_NO_SUCH_ID, RF_ERROR_BAD_JOINT, RF_ERROR_BONDED,
 *         RF_ERROR_DEFORMS or RF_ERROR_NO_JOINTS. Where it is refused, the joints are what they were
 */
rf_status rf_join(struct rf_simulator *simulator,
                  rf_unit_id id,
                  rf_unit_id parent,
                  const float *pivot,
                  const float *parent_pivot);

/**
 * Lets a unit go from the one that it hangs from.
 *
 * @param simulator  the simulator
 * @param id         the unit; it need not hang
 * @return RF_OK, an error of the call, RF_ERROR_NO_SUCH_ID or RF_ERROR_NO_JOINTS
 */
rf_status rf_unjoin(struct rf_simulator *simulator, rf_unit_id id);

/**
 * Makes pairs of units hold together rigidly from the next step on, where they are then: free units of
 * one body (`bodies`, `body`). Units that bonds connect, directly or through others, move as one rigid
 * body. A bond holds until rf_break_bond, until one of the two is removed or until another observation.
 * Models of format version 7, such as fragments.rfm, break bonds in rf_step too; rf_bonds says which hold.
 * There is room for 8 bonds for each unit of rf_config. Libraries for microcontrollers have no bonds
 * unless they are built with the feature `deform`.
 *
 * @param simulator  the simulator
 * @param pairs      (pair_count, 2) ids
 * @param pair_count how many pairs; each is bonded once
 * @return RF_OK, an error of the call, RF_ERROR_NO_SUCH_ID, RF_ERROR_BOND_MOTION, RF_ERROR_NO_BONDS
 *         or one of RF_ERROR_BOND_ITSELF to RF_ERROR_TOO_MANY_BONDS. Where one pair is refused, all
 *         are, and the bonds are what they were
 */
rf_status rf_bond(struct rf_simulator *simulator,
                  const rf_unit_id *pairs,
                  size_t pair_count);

/**
 * Breaks the bond of a pair for good. Of a cluster that parts by that, what holds together with its
 * first unit keeps the body; the rest is a body of its own from then on, which touches the others.
 *
 * @param simulator  the simulator
 * @param id         one unit of the pair
 * @param other      the other one
 * @param held       out: 1 where the bond held until then, else 0; may be NULL
 * @return RF_OK, an error of the call, RF_ERROR_NO_SUCH_ID, RF_ERROR_BOND_ITSELF,
 *         RF_ERROR_NO_SUCH_BOND or RF_ERROR_NO_BONDS. Where it is refused, the bonds are what they
 *         were
 */
rf_status rf_break_bond(struct rf_simulator *simulator,
                        rf_unit_id id,
                        rf_unit_id other,
                        uint32_t *held);

/**
 * All bonds in the order in which they were made, broken ones among them.
 *
 * @param simulator  the simulator
 * @param bonds      out: (count) bonds; may be NULL where capacity is 0
 * @param capacity   how many there is room for
 * @param count      out: how many bonds there are, also where RF_ERROR_BUFFER says that they do not fit
 * @return RF_OK, an error of the call, RF_ERROR_NO_BONDS or RF_ERROR_BUFFER
 */
rf_status rf_bonds(const struct rf_simulator *simulator,
                   struct rf_bonded *bonds,
                   size_t capacity,
                   size_t *count);

/**
 * Hangs a unit from another, as rf_join, by a joint of any kind. Models that move units by impulses know
 * all kinds, others RF_JOINT_BALL alone. A joint with an axis is free until rf_set_joint_target.
 *
 * @param simulator  the simulator
 * @param id         the unit that hangs
 * @param parent     the unit that it hangs from
 * @param joint      what holds it
 * @return RF_OK, an error of the call, RF_ERROR_NO_SUCH_ID, RF_ERROR_BAD_JOINT, RF_ERROR_BONDED,
 *         RF_ERROR_DEFORMS or RF_ERROR_NO_JOINTS. Where it is refused, the joints are what they were
 */
rf_status rf_join_by(struct rf_simulator *simulator,
                     rf_unit_id id,
                     rf_unit_id parent,
                     const struct rf_joint *joint);

/**
 * Takes a joint to a position by the end of the next step, and holds it there. Beyond a limit that is the
 * limit. A joint with a `max_force` may come later.
 *
 * @param simulator  the simulator
 * @param id         the unit that hangs by it
 * @param target     radians, the shorter way round, or metres; infinite: it is free from now on
 * @return RF_OK, an error of the call, RF_ERROR_NO_SUCH_ID, RF_ERROR_BAD_JOINT or RF_ERROR_NO_JOINTS.
 *         Where it is refused, the target is what it was
 */
rf_status rf_set_joint_target(struct rf_simulator *simulator,
                              rf_unit_id id,
                              float target);

/**
 * Writes the position of the joint that a unit hangs by.
 *
 * @param simulator  the simulator
 * @param id         the unit
 * @param position   out: radians from minus half a turn to half a turn, or metres
 * @return RF_OK, an error of the call, RF_ERROR_NO_SUCH_ID, RF_ERROR_BAD_JOINT or RF_ERROR_NO_JOINTS
 */
rf_status rf_joint_position(struct rf_simulator *simulator,
                            rf_unit_id id,
                            float *position);

/**
 * Bytes that rf_save writes now: about 300 for each unit and 12 for each point.
 *
 * @param simulator  the simulator
 * @param bytes      out: how many
 * @return RF_OK or an error of the call
 */
rf_status rf_state_bytes(const struct rf_simulator *simulator, size_t *bytes);

/**
 * Writes the whole state of a simulator: units with their points, poses, velocities and targets, joints,
 * bonds, soft points, the command, planes, gravity and the time step. Going on from it by rf_load gives
 * the same bits, in this simulator or in another one with the same model, on any processor.
 *
 * @param simulator  the simulator
 * @param state      out: (rf_state_bytes) bytes
 * @param capacity   how many there is room for
 * @param bytes      out: how many were written; may be NULL
 * @return RF_OK, an error of the call, or RF_ERROR_BUFFER, which writes nothing
 */
rf_status rf_save(const struct rf_simulator *simulator,
                  uint8_t *state,
                  size_t capacity,
                  size_t *bytes);

/**
 * Goes on from a state that rf_save wrote: units have the ids that they had, and ids that were given since
 * then are given to no other unit. The bytes are checked completely, wherever they come from.
 *
 * @param simulator  the simulator
 * @param state      (bytes) what rf_save wrote
 * @param bytes      how many
 * @return RF_OK, an error of the call, RF_ERROR_TOO_MANY_UNITS, RF_ERROR_TOO_MANY_POINTS,
 *         RF_ERROR_TOO_MANY_BONDS or one of RF_ERROR_STATE to RF_ERROR_STATE_FEATURE. Where it is
 *         refused, the scene is what it was
 */
rf_status rf_load(struct rf_simulator *simulator,
                  const uint8_t *state,
                  size_t bytes);

/**
 * Name of a quantity that rf_health looks at, by its number below RF_QUANTITIES: a text that is never
 * freed. Any number may be asked about.
 */
const char *rf_quantity_string(uint32_t quantity);

/**
 * How far a unit is from what the model's training saw, as it is now. This measures the unit when
 * asked, which costs about as much as observing it does; a step does none of it.
 *
 * @param simulator  the simulator
 * @param id         which unit
 * @param health     out: its health
 * @return RF_OK, an error of the call, RF_ERROR_NO_SUCH_ID or RF_ERROR_NO_HEALTH
 */
rf_status rf_unit_health(const struct rf_simulator *simulator,
                         rf_unit_id id,
                         struct rf_health *health);

/**
 * How far an observed pose is from a predicted one, in standard deviations: the Mahalanobis distance
 * over the way between the two, m, and the turn from one to the other, rad, along the world's axes.
 * Of a right prediction it is above 4.1 once in a hundred times. It needs no simulator; any thread may
 * call it.
 *
 * @param predicted  what rf_poses said
 * @param observed   what a sensor says
 * @param variances  (6) of prediction and observation together: x, y, z, m^2, and turns about x, y, z,
 *                   rad^2; each above 0 and at most 1e12
 * @param distance   out: the distance
 * @return RF_OK, RF_ERROR_NULL, RF_ERROR_ALIGNMENT, RF_ERROR_LENGTH, RF_ERROR_BAD_POSE where a pose
 *         is not finite, RF_ERROR_BAD_VARIANCE or RF_ERROR_NO_HEALTH
 */
rf_status rf_innovation(const struct rf_pose *predicted,
                        const struct rf_pose *observed,
                        const float *variances,
                        float *distance);

/**
 * Says what becomes of a free unit that diverges. At first, and with 0, rf_step fails then
 * (RF_ERROR_DIVERGED). With 1 the unit is held where it was and the others go on: they see it as
 * they do a fixed one. It is held until rf_set_poses gives it poses, or rf_set_role another role. Units that a
 * bond holds, and scenes with soft units, fail as ever.
 *
 * @param simulator  the simulator
 * @param holds      1 or 0
 * @return RF_OK, an error of the call or RF_ERROR_NO_HEALTH
 */
rf_status rf_set_quarantine(struct rf_simulator *simulator,
                            uint32_t holds);

#ifdef __cplusplus
}  /* extern "C" */
#endif  /* __cplusplus */

#endif  /* RIGIDFORMER_H */
