//! The structs and numbers that cross the border. Their names are those of the header.
#![allow(non_camel_case_types)]

/// Version of this interface: pass it to rf_init. It rises when something is removed or changes
/// its meaning; functions and error codes are only ever added within a version.
pub const RF_ABI_VERSION: u32 = 5;

/// Alignment in bytes of a workspace and of a model: rf_init checks both.
pub const RF_ALIGNMENT: usize = 16;

/// What rf_detail says in `unit` and `index` where there is none.
pub const RF_NONE: u32 = 0xffff_ffff;

/// Kind of a joint: the unit turns about the pivot.
pub const RF_JOINT_BALL: u32 = 0;

/// The unit turns about an axis through the pivot.
pub const RF_JOINT_REVOLUTE: u32 = 1;

/// The unit slides along an axis, and does not turn.
pub const RF_JOINT_PRISMATIC: u32 = 2;

/// The unit stays where it is in its parent's frame.
pub const RF_JOINT_FIXED: u32 = 3;

/// Role of a unit that the model moves.
pub const RF_ROLE_FREE: u32 = 0;

/// Role of a unit that goes exactly where rf_drive sends it in the next step. The model sees that
/// motion and never changes it.
pub const RF_ROLE_DRIVEN: u32 = 1;

/// Role of scenery: the unit never moves.
pub const RF_ROLE_FIXED: u32 = 2;

/// Body of a unit that is a body of its own.
pub const RF_OWN_BODY: i32 = -1;

/// The largest number of a body.
pub const RF_MAX_BODY: i32 = 65534;

/// Planes of a scene, at most.
pub const RF_MAX_PLANES: usize = 8;

/// Threads that may share a step.
pub const RF_MAX_THREADS: u32 = 16;

/// Convex pieces of a unit, at most.
pub const RF_MAX_PIECES: usize = 32;

/// Quantities that rf_health looks at.
pub const RF_QUANTITIES: u32 = 14;

/// Name of a unit within its simulator. It stays valid until that unit is removed or another scene
/// is observed, and is never given to another unit of that simulator. 0 is no unit's.
pub type rf_unit_id = u64;

/// What a call came to: RF_OK, or why it was refused. A refused call changes nothing but the
/// detail of the last error. These numbers are never renumbered and never reused: 6 and 72 are
/// retired, they were codes of version 1.
#[repr(i32)]
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum rf_status {
    /// Done.
    RF_OK = 0,
    /// A pointer is NULL that must not be.
    RF_ERROR_NULL = 1,
    /// A pointer is not aligned: to RF_ALIGNMENT for a workspace, otherwise to its type.
    RF_ERROR_ALIGNMENT = 2,
    /// The workspace is too small. Detail: `found` and `expected` bytes.
    RF_ERROR_MEMORY = 3,
    /// No simulator that rf_init made is there: never made, released, moved or overwritten.
    RF_ERROR_HANDLE = 4,
    /// Another call on this simulator has not returned: a thread or an interrupt handler got in.
    RF_ERROR_BUSY = 5,
    // 6, RF_ERROR_CAPACITY of version 1, is retired: the library holds any number of units.
    /// The header has another RF_ABI_VERSION than the library. Detail: `found`, `expected`.
    RF_ERROR_ABI = 7,
    /// An output array is too short. Detail: elements `found` and `expected`.
    RF_ERROR_BUFFER = 8,
    /// There is no unit of that number. Detail: `unit`, and `expected` units.
    RF_ERROR_NO_SUCH_UNIT = 9,
    /// A length is beyond what the processor can address.
    RF_ERROR_LENGTH = 10,
    /// An array of the caller lies within the workspace.
    RF_ERROR_OVERLAP = 11,
    /// The counts of points do not add up to the points given, or those of pieces to the pieces.
    /// Detail: sum `found`, points or pieces `expected`.
    RF_ERROR_POINT_COUNTS = 12,
    /// The environment variable RIGIDFORMER_KERNEL names kernels that do not exist or that this
    /// processor cannot run: unset it. Of libraries for Linux.
    RF_ERROR_KERNEL = 13,
    /// More threads than RF_MAX_THREADS, or than one in a library without them (the feature `threads`).
    /// Detail: `found`, `expected`. Of libraries for Linux.
    RF_ERROR_THREADS = 14,

    /// The bytes are not a RigidFormer model.
    RF_ERROR_MODEL_MAGIC = 32,
    /// The model is of a format version that this library does not read, or needs a feature that it
    /// was built without: edge needs `host` (docs/C.md). Detail:
    /// `found`, `expected`; where `found` is not above `expected`, it is a feature.
    RF_ERROR_MODEL_VERSION = 33,
    /// The model's first byte is not aligned to RF_ALIGNMENT. Detail: `found` bytes beyond.
    RF_ERROR_MODEL_ALIGNMENT = 34,
    /// The model has been cut off, or something follows it. Detail: `found`, `expected` bytes.
    RF_ERROR_MODEL_LENGTH = 35,
    /// A checksum does not fit: the model is damaged. Detail: checksums `found`, `expected`.
    RF_ERROR_MODEL_CHECKSUM = 36,
    /// The model's header or tensor directory contradicts itself. Detail: tensor `index`, if any.
    RF_ERROR_MODEL_STRUCTURE = 37,
    /// The model's configuration is outside its limits.
    RF_ERROR_MODEL_CONFIG = 38,
    /// A tensor is missing, or has another shape or type than the configuration calls for.
    RF_ERROR_MODEL_TENSOR = 39,
    /// A weight or a scale is not finite or out of its range. Detail: tensor `index`, element
    /// `found`.
    RF_ERROR_MODEL_NUMBER = 40,
    /// The model has more blocks, scales or command numbers than this library has room for.
    /// Detail: `found`, `expected`.
    RF_ERROR_MODEL_SIZE = 41,

    /// The observation has no units.
    RF_ERROR_NO_UNITS = 64,
    /// More units than rf_init was told. Detail: `found`, `expected`.
    RF_ERROR_TOO_MANY_UNITS = 65,
    /// More points in all than rf_init was told. Detail: `found`, `expected`.
    RF_ERROR_TOO_MANY_POINTS = 66,
    /// A unit has fewer than 4 points. Detail: `unit`, `found`, `expected`.
    RF_ERROR_TOO_FEW_POINTS = 67,
    /// A coordinate is NaN, infinite or beyond 1e6 m. Detail: `unit`, and its point `index`.
    RF_ERROR_BAD_POINT = 68,
    /// A pose is NaN, infinite or beyond 1e6 m, or its quaternion is not of length 1 within
    /// 5e-4. Detail: `unit`. Of rf_drive also: the unit would have to go over 100 m/s. Detail: its
    /// id, in `found`.
    RF_ERROR_BAD_POSE = 69,
    /// All points of a unit lie within 1e-6 m of its first. Detail: `unit`.
    RF_ERROR_COINCIDENT = 70,
    /// A mass is outside 1e-9 to 1e9 kg, or friction or restitution outside 0 to 1000. Detail:
    /// `unit`.
    RF_ERROR_BAD_PHYSICS = 71,
    // 72, RF_ERROR_ZERO_STEP of version 1, is retired: time is given in seconds.
    /// The time step is NaN, infinite, not above 0, or longer than the model takes in that scene
    /// (rf_observe). Of rf_set_dt, rf_set_gravity and rf_add also: a unit would come from beyond 1e6 m.
    RF_ERROR_BAD_TIMESTEP = 73,
    /// A moment of inertia is outside 1e-18 to 1e18 kg m^2 or greater than the sum of the other two;
    /// three zeros mean those of the box. Detail: `unit`.
    RF_ERROR_BAD_INERTIA = 74,
    /// A unit has more convex pieces than RF_MAX_PIECES. Detail: `unit`, `found`, `expected`.
    RF_ERROR_TOO_MANY_PIECES = 75,
    /// A convex piece has fewer than 4 or more than 255 points, or one of them is NaN, infinite or
    /// beyond 1e6 m. Detail: `unit`, and its piece `index`.
    RF_ERROR_BAD_PIECE = 76,
    /// A soft unit for a model, or a library, that moves rigid ones alone; of rf_soft_points: the unit
    /// is rigid, rf_poses says where it is. Detail: `unit`.
    RF_ERROR_NOT_SOFT = 77,
    /// A soft unit that cannot be: its points at rest are NaN, infinite, beyond 1e6 m, twice in one
    /// place or all within 1e-6 m, Young's modulus is outside 1e-3 to 1e15 Pa, its role is not
    /// RF_ROLE_FREE, or it has pieces. Detail: `unit`.
    RF_ERROR_BAD_SOFT = 78,
    /// A soft unit that was given by poses, which say nothing of its points: rf_observe takes it.
    /// Detail: `unit`.
    RF_ERROR_SOFT_POSE = 79,

    /// No unit of the scene has that id: it was removed, or is of another scene or simulator.
    /// Detail: the id `found`.
    RF_ERROR_NO_SUCH_ID = 80,
    /// Only driven units can be sent somewhere: rf_set_role first, or rf_set_poses. Detail: the id
    /// `found`.
    RF_ERROR_NOT_DRIVEN = 81,
    /// The scene has no time step yet: rf_set_dt or an observation first.
    RF_ERROR_NO_TIMESTEP = 82,
    /// More planes than RF_MAX_PLANES. Detail: `found`, `expected`.
    RF_ERROR_TOO_MANY_PLANES = 83,
    /// A plane's normal is not of length 1 within 0.001, its offset is beyond 1e6 m, or its friction
    /// or restitution is outside 0 to 1000. Detail: which plane, in `index`.
    RF_ERROR_BAD_PLANE = 84,
    /// Gravity is NaN, infinite or beyond 1e4 m/s^2 along an axis.
    RF_ERROR_BAD_GRAVITY = 85,
    /// A role is none of RF_ROLE_FREE, RF_ROLE_DRIVEN and RF_ROLE_FIXED. Detail: `unit`, where the
    /// call gives units, and the role `found`.
    RF_ERROR_BAD_ROLE = 86,
    /// A body is neither RF_OWN_BODY nor from 0 to RF_MAX_BODY. Detail: `unit`, and the number
    /// `found`, converted to uint64_t.
    RF_ERROR_BAD_BODY = 87,
    /// A unit cannot hang from another that is it or hangs from it; a pivot, axis, limit, force or target
    /// is out of range; the model knows ball joints alone; or the unit hangs by no joint with an axis.
    /// Detail: the id `found`, and of a circle the parent's in `expected`.
    RF_ERROR_BAD_JOINT = 88,
    /// The library was built without joints: the feature `robot` of rigidformer-capi, which `std`
    /// has.
    RF_ERROR_NO_JOINTS = 89,
    /// A change that soft units do not take: units of their scene are neither added nor removed, and a
    /// soft unit has no pose and no pivot and is always free. Observe the scene anew.
    RF_ERROR_DEFORMS = 90,
    /// A unit that a bond holds stays free and hangs from nothing: rf_break_bond first. Detail: the id
    /// `found`.
    RF_ERROR_BONDED = 91,
    /// The model does not move units that hold together: its motion is not by impulses.
    RF_ERROR_BOND_MOTION = 92,
    /// The library was built without bonds: the feature `deform` of rigidformer-capi, which `std` has.
    RF_ERROR_NO_BONDS = 93,
    /// The library was built without health: the feature `health` of rigidformer-capi, which `std`
    /// has.
    RF_ERROR_NO_HEALTH = 94,
    /// A variance is not above 0 and at most 1e12. Detail: which, in `index`.
    RF_ERROR_BAD_VARIANCE = 95,

    /// rf_step in a scene without units: before an observation, or after all were removed.
    RF_ERROR_NOT_OBSERVED = 96,
    /// The model takes commands and none was set. Detail: `expected` numbers.
    RF_ERROR_NO_COMMAND = 97,
    /// The prediction is not finite or beyond 1e6 m: a scene unlike the training data. Detail:
    /// `unit`.
    RF_ERROR_DIVERGED = 98,
    /// The bytes are no state that rf_save wrote, or they were damaged. Detail: bytes `found` and
    /// `expected` where their number is wrong, or the byte `index` of what cannot be.
    RF_ERROR_STATE = 104,
    /// The state is of another version of the library. Detail: `found`, `expected`.
    RF_ERROR_STATE_VERSION = 105,
    /// The state is of another model, or of other weights of it.
    RF_ERROR_STATE_MODEL = 106,
    /// The state has joints, bonds, soft units, a quarantine or several copies of a scene, which this
    /// library was built without.
    RF_ERROR_STATE_FEATURE = 107,
    /// The state is of a scene on another height field, or on none: rf_set_height_field first.
    RF_ERROR_STATE_HEIGHT_FIELD = 108,

    /// The library was built without height fields (the feature `terrain` of rigidformer-capi, which `std` has), or
    /// the model does not move units by impulses, as edge and nano do.
    RF_ERROR_NO_HEIGHT_FIELD = 110,

    /// The command has another length than the model's. Detail: `found`, `expected`.
    RF_ERROR_COMMAND_SIZE = 112,
    /// A number of the command is not finite. Detail: its `index`.
    RF_ERROR_COMMAND_NUMBER = 113,
    /// A unit would turn more than half a turn in a step, or there is not one velocity a unit. Detail: the
    /// id `found`, or velocities `found` and `expected`.
    RF_ERROR_BAD_VELOCITY = 114,

    /// A contact stiffness is neither 0 (rigid) nor from 1e-3 to 1e12 N/m, or a dissipation is outside 0 to
    /// 1e6 s/m. Detail: `unit`, or which plane, in `index`.
    RF_ERROR_BAD_COMPLIANCE = 115,
    /// The scene has no plane of that number. Detail: the number `found`, planes in `expected`.
    RF_ERROR_NO_SUCH_PLANE = 116,
    /// The library was built without compliance: the feature `compliance` of rigidformer-capi, which `std`
    /// has.
    RF_ERROR_NO_COMPLIANCE = 117,
    /// The restitution offset of a contact law is NaN or outside 0 to 1.
    RF_ERROR_BAD_CONTACT_LAW = 118,
    /// A height field has fewer than 2 rows or columns or more than 4,194,304 heights, or a number of it is not
    /// finite or out of range. Detail: the `index` of the height, or RF_NONE.
    RF_ERROR_BAD_HEIGHT_FIELD = 119,

    /// A unit cannot be bonded to itself. Detail: the id `found`.
    RF_ERROR_BOND_ITSELF = 120,
    /// Only free rigid units hold together. Detail: the id `found`.
    RF_ERROR_BOND_NOT_FREE = 121,
    /// A unit that hangs from another, or from which another hangs, cannot be bonded: rf_unjoin first.
    /// Detail: the id `found`.
    RF_ERROR_BOND_JOINED = 122,
    /// Only units of one body hold together: the two are of different bodies, or not of one any more.
    /// Detail: the ids, in `found` and `expected`.
    RF_ERROR_BOND_APART = 123,
    /// The pair has a bond already, or had one: broken bonds stay broken. Detail: the ids, in `found`
    /// and `expected`.
    RF_ERROR_BOND_TWICE = 124,
    /// More bonds than there is room for: 8 for each unit of rf_config. Detail: `found`, `expected`.
    RF_ERROR_TOO_MANY_BONDS = 125,
    /// The pair has no bond. Detail: the ids, in `found` and `expected`.
    RF_ERROR_NO_SUCH_BOND = 126,

    /// An error that this version of the interface has no code for.
    RF_ERROR_OTHER = 127,

    /// An option of a tracker cannot be: rf_tracker_create's message says which, and its range.
    RF_ERROR_TRACKER_OPTION = 128,
    /// A model file cannot be read: see rf_tracker_create's message.
    RF_ERROR_MODEL_FILE = 129,
    /// A capture's time is not finite, or not above that of the capture before: give captures in the
    /// order of their times, each once.
    RF_ERROR_CAPTURE_TIME = 130,
    /// A capture has neither images nor clouds: leave it out.
    RF_ERROR_CAPTURE_EMPTY = 131,
    /// The size, the focal lengths, the principal point or the pose of a depth camera cannot be:
    /// rf_tracker_message says which of which camera.
    RF_ERROR_CAPTURE_CAMERA = 132,
    /// A scale of depths is outside 1e-6 to 10 m: give metres a step, such as 0.001.
    RF_ERROR_CAPTURE_SCALE = 133,
    /// A point of a cloud, or its sensor, is not finite or beyond 1e6 m: drop it.
    RF_ERROR_CAPTURE_POINT = 134,
    /// A horizon is not above 0 and at most RF_MAX_HORIZON_S.
    RF_ERROR_HORIZON = 135,
    /// The model of a tracker does not take the scene: rf_tracker_message says why.
    RF_ERROR_FORECAST = 136,
    /// No unit of a tracker has that number: its track ended, or never was.
    RF_ERROR_NO_SUCH_TRACK = 137,
    /// There is no memory for a capture: give smaller images, or fewer points.
    RF_ERROR_NO_MEMORY = 138,
    /// A defect of the library ended a call of a tracker: destroy it and make another. Please report
    /// what standard error says.
    RF_ERROR_DEFECT = 139,
}

/// Numbers of the last error. What is not said is RF_NONE (`unit`, `index`) or 0.
#[repr(C)]
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct rf_detail {
    /// The error; RF_OK where there was none yet.
    pub code: rf_status,
    /// Which unit, from 0.
    pub unit: u32,
    /// Which point, piece, number or tensor, from 0.
    pub index: u32,
    /// Zero.
    pub reserved: u32,
    /// What there was.
    pub found: u64,
    /// What there should have been, or at most.
    pub expected: u64,
}

/// What a unit is made of. Nothing moves a driven or fixed unit, whatever its mass.
#[repr(C)]
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct rf_physics {
    /// Mass, kg, from 1e-9 to 1e9.
    pub mass_kg: f32,
    /// Friction coefficient, from 0 to 1000.
    pub friction: f32,
    /// Restitution coefficient, from 0 to 1000.
    pub restitution: f32,
}

/// How contact with a unit or a plane gives way: at a depth d that changes by d' a second, each contact
/// point pushes with `stiffness d (1 + dissipation d')` newtons, and never pulls. Two that touch give way in
/// series. Where one gives way, restitution counts for nothing.
#[repr(C)]
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct rf_compliance {
    /// At a contact point, N/m, from 1e-3 to 1e12; 0 or infinite: rigid.
    pub stiffness_n_m: f32,
    /// s/m, from 0 to 1e6.
    pub dissipation_s_m: f32,
}

/// A pose, whose quaternion has w last: x = rotate(quaternion, reference point) + position. Poses of
/// Python, scene files and recordings have w first: rf_pose_from_wxyz.
#[repr(C)]
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct rf_pose {
    /// x, y, z in metres, world frame (right-handed, z up).
    pub position: [f32; 3],
    /// x, y, z, w; of length 1. w is not negative in what the library writes.
    pub quaternion: [f32; 4],
}

/// What holds a unit to another. Its position is 0 as the two are when they are joined.
#[repr(C)]
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct rf_joint {
    /// RF_JOINT_BALL, RF_JOINT_REVOLUTE, RF_JOINT_PRISMATIC or RF_JOINT_FIXED.
    pub kind: u32,
    /// One place in the frame of the unit's reference points, metres.
    pub pivot: [f32; 3],
    /// And in the frame of the parent's.
    pub parent_pivot: [f32; 3],
    /// Of revolute and prismatic joints, in the frame of the unit's reference points: not 0.
    pub axis: [f32; 3],
    /// Least and greatest position: radians within half a turn to either side, or metres. Both 0: none.
    pub limits: [f32; 2],
    /// The most that takes it to a target, N m or N. 0: whatever that takes.
    pub max_force: f32,
}

/// How a unit moves now, at the end of its last step.
#[repr(C)]
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct rf_velocity {
    /// Of the origin of the unit's reference points, m/s.
    pub linear_m_s: [f32; 3],
    /// Along the world's axes, rad/s.
    pub angular_rad_s: [f32; 3],
}

/// A pose as the simulator keeps it, about the unit's own centre: for comparing two targets bit
/// for bit. rf_poses is what an application wants.
#[repr(C)]
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct rf_internal_pose {
    /// Rotation matrix, row by row.
    pub rotation: [f32; 9],
    /// The unit's centre in the world, metres.
    pub centre: [f32; 3],
}

/// A unit's centre of mass in the world, metres, with all digits that the simulator keeps.
#[repr(C)]
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct rf_centre {
    /// Along x.
    pub x: f64,
    /// Along y.
    pub y: f64,
    /// Along z.
    pub z: f64,
}

/// What an accepted observation was like.
#[repr(C)]
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct rf_observation {
    /// Largest distance of a point from the rigid fit of its unit, metres; 0 where poses were
    /// given. Far above the sensor's noise, a unit was not rigid or its points were not the same in
    /// both frames.
    pub residual_m: f32,
    /// Units whose points left their rotation open: all on a line.
    pub degenerate_units: u32,
    /// Zero.
    pub reserved: [u32; 2],
}

/// What a step did.
#[repr(C)]
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct rf_step_report {
    /// Units whose motion the network predicted; the others can touch nothing within the step and
    /// moved freely, exactly, or are driven or fixed.
    pub active_units: u32,
    /// Units whose anchors left their rotation open.
    pub degenerate_units: u32,
    /// Units in quarantine after the step (rf_set_quarantine).
    pub quarantined_units: u32,
    /// Zero.
    pub reserved: u32,
}

/// What can be said of how far a unit's prediction may be believed.
#[repr(C)]
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct rf_health {
    /// 1 where the model says what training saw; else 0, and what follows is zeros but for
    /// `quarantined`.
    pub known: u32,
    /// Quantities that are outside of what training saw: bit k for quantity k of rf_quantity_string.
    pub outside: u32,
    /// Of all quantities the one that is farthest outside, or nearest to its end where none is.
    pub quantity: u32,
    /// What that is.
    pub value: f32,
    /// How far that is beyond its range, in widths of the range; below 0 inside.
    pub beyond: f32,
    /// 1 where the unit diverged and waits for a pose (rf_set_quarantine).
    pub quarantined: u32,
    /// Zero.
    pub reserved: [u32; 2],
}

/// A simulator in the caller's memory. Only its address is of use.
pub struct rf_simulator {
    _opaque: [u8; 0],
}

/// What rf_workspace_bytes and rf_init are told.
#[repr(C)]
#[derive(Clone, Copy, Debug)]
pub struct rf_config {
    /// RF_ABI_VERSION.
    pub abi_version: u32,
    /// Units, at most.
    pub max_units: u32,
    /// Points of all units together, at most. A unit of several pieces takes as many as it has, or as
    /// its pieces have and two a piece more, whichever are more.
    pub max_points: u32,
    /// Threads that share a step, up to RF_MAX_THREADS; 0 and 1: the caller's alone. They are the process's, made at the first
    /// step, and bits do not depend on them. Libraries for microcontrollers do not look at it.
    pub threads: u32,
    /// A packed model (.rfm), aligned to RF_ALIGNMENT; read in place, so it may be in flash.
    pub model: *const u8,
    /// Its length, bytes.
    pub model_bytes: usize,
}

/// The units of an observation.
#[repr(C)]
#[derive(Clone, Copy, Debug)]
pub struct rf_units {
    /// How many units.
    pub unit_count: usize,
    /// (unit_count) what each is made of.
    pub physics: *const rf_physics,
    /// (unit_count) how many points each has, at least 4: unit 0 has the first `point_counts[0]`
    /// points of an array of points, unit 1 the next `point_counts[1]`, and so on.
    pub point_counts: *const u32,
    /// The sum of point_counts: how many points each array of points has.
    pub point_count: usize,
    /// (unit_count) who moves each: RF_ROLE_FREE, RF_ROLE_DRIVEN or RF_ROLE_FIXED. NULL: all are
    /// free.
    pub roles: *const u32,
    /// (unit_count) the body that each is a part of, from 0 to RF_MAX_BODY, or RF_OWN_BODY. Units of
    /// one body do not collide with each other. NULL: each is a body of its own.
    pub bodies: *const i32,
    /// (unit_count, 3) principal moments of inertia of each, as in rf_unit. NULL: those of boxes.
    pub inertias_kg_m2: *const f32,
    /// (unit_count) how many convex pieces each has, as in rf_unit, or 0: unit 0 has the first
    /// `unit_pieces[0]` pieces, unit 1 the next `unit_pieces[1]`, and so on. NULL: none has any.
    pub unit_pieces: *const u16,
    /// (piece_count) how many points each piece has, from 4 to 255, all units' pieces one after
    /// another. May be NULL where piece_count is 0.
    pub piece_counts: *const u16,
    /// The sum of unit_pieces: how many pieces all units have.
    pub piece_count: usize,
    /// (piece_point_count, 3) x, y, z in metres of the points of all pieces, one piece after
    /// another, in the frame of the unit's reference points. May be NULL where piece_point_count is
    /// 0.
    pub piece_points: *const f32,
    /// The sum of piece_counts: how many points all pieces have.
    pub piece_point_count: usize,
    /// (unit_count) Young's modulus of each soft unit, Pa, from 1e-3 to 1e15; 0 for rigid units. A soft
    /// unit is a patch of a body that deforms: patches with one number in `bodies` are one body. Models
    /// of soft bodies move it, such as shell.rfm. NULL: all are rigid.
    pub young_pa: *const f32,
    /// (point_count, 3) x, y, z in metres: where the points of soft units are at rest, in the order of
    /// the points that are observed, all patches of a body in one frame. Points of two patches that are
    /// in one place there are one point of the body. Those of rigid units are not looked at. May be
    /// NULL where young_pa is.
    pub rest_points: *const f32,
}

/// A pair of units that hold together, or did.
#[repr(C)]
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct rf_bonded {
    /// The two, in the order of rf_poses.
    pub units: [rf_unit_id; 2],
    /// 1 while the bond holds; 0 once it is broken, which is for good.
    pub holds: u32,
    /// Zero.
    pub reserved: u32,
}

/// A unit that is added to a scene; soft units are observed (rf_units).
#[repr(C)]
#[derive(Clone, Copy, Debug)]
pub struct rf_unit {
    /// What it is made of.
    pub physics: rf_physics,
    /// Who moves it: RF_ROLE_FREE, RF_ROLE_DRIVEN or RF_ROLE_FIXED.
    pub role: u32,
    /// The body that it is a part of, from 0 to RF_MAX_BODY, or RF_OWN_BODY.
    pub body: i32,
    /// (point_count, 3) x, y, z in metres, in the unit's own reference frame, in any order.
    pub points: *const f32,
    /// How many points, at least 4.
    pub point_count: usize,
    /// Principal moments of inertia, kg m^2, through the unit's centre about axes along x, y, z of
    /// its reference frame: each from 1e-18 to 1e18 and at most the sum of the other two. All zeros:
    /// those of a uniform box around the points, or of a uniform ball for about 120 points or more on
    /// a sphere. rf_set_physics changes them as it does the mass.
    pub inertia_kg_m2: [f32; 3],
    /// (sum of piece_counts, 3) x, y, z in metres, in the frame of `points`: the points of its convex
    /// pieces, one piece after another. They may overlap. The unit's centre is that of its pieces.
    /// Where the model moves units by impulses, it touches with them instead of the hull of its
    /// points. May be NULL where there are none.
    pub piece_points: *const f32,
    /// (piece_count) how many points each piece has, from 4 to 255. May be NULL where piece_count is 0.
    pub piece_counts: *const u16,
    /// How many pieces, at most RF_MAX_PIECES. 0: it touches with the hull of its points.
    pub piece_count: usize,
}

/// Unmoving ground of varying height: a grid of heights, in rows along y and columns along x. Units stay above it; beyond
/// its borders there is nothing. A cell between four heights is two triangles, which share the diagonal from its corner of
/// least x and y.
#[repr(C)]
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct rf_height_field {
    /// (rows, columns) heights above the corner, metres. The simulator reads them in each step: they stay where they
    /// are, and as they are, until rf_set_height_field takes another field or the simulator is gone.
    pub heights_m: *const f32,
    /// At least 2; rows times columns is at most 4,194,304.
    pub rows: u32,
    /// At least 2.
    pub columns: u32,
    /// Between columns along x and between rows along y, metres, from 1e-4 to 1e4.
    pub spacing_m: [f32; 2],
    /// The place of a first height of zero, metres.
    pub corner_m: [f32; 3],
    /// Friction coefficient, from 0 to 1000.
    pub friction: f32,
    /// Restitution coefficient, from 0 to 1000.
    pub restitution: f32,
}

/// An unmoving plane: the points x with normal . x = offset_m. Units stay on the side that the
/// normal points to.
#[repr(C)]
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct rf_plane {
    /// Unit vector towards the free side, of length 1 within 0.001.
    pub normal: [f32; 3],
    /// Distance of the plane from the origin along the normal, metres.
    pub offset_m: f32,
    /// Friction coefficient, from 0 to 1000.
    pub friction: f32,
    /// Restitution coefficient, from 0 to 1000.
    pub restitution: f32,
}
