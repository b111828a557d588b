//! One small error per phase; its numbers say what to change.

use crate::scene::UnitId;
use rigidformer_weights::{AtMost, Decimal, FormatError};
use thiserror::Error;

/// Name of a tensor inside a model, such as `blocks.2.attention.qkvg.weight`.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct TensorId {
    /// The name up to its index, or all of it.
    pub prefix: &'static str,
    /// The index, where the name has one.
    pub index: Option<u32>,
    /// The name after the index.
    pub suffix: &'static str,
}

impl core::fmt::Display for TensorId {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        f.write_str(self.prefix)?;
        if let Some(index) = self.index {
            write!(f, "{index}")?;
        }
        f.write_str(self.suffix)
    }
}

/// Why a model file cannot be used.
#[derive(Clone, Copy, Debug, PartialEq, Error)]
#[non_exhaustive]
pub enum LoadError {
    /// The file is not a sound packed model.
    #[error(transparent)]
    Format(#[from] FormatError),
    /// A tensor that the configuration calls for is not in the file.
    #[error("tensor {0} is missing; pack the model again from a complete export")]
    MissingTensor(TensorId),
    /// A tensor has other sizes than the configuration calls for.
    #[error(
        "tensor {tensor} has shape {found:?}, its configuration wants {expected:?}; pack the model again"
    )]
    Shape {
        /// Which tensor.
        tensor: TensorId,
        /// (rows, columns) wanted; a vector has 1 column.
        expected: [u32; 2],
        /// (rows, columns) in the file.
        found: [u32; 2],
    },
    /// A tensor is stored in a type that this layer cannot read.
    #[error(
        "tensor {0} must be f32: only the weights of linear layers may be i8 or f16; pack the model again"
    )]
    Dtype(TensorId),
    /// More blocks than this build has room for.
    #[error("the model has {found} blocks, this build holds at most {limit}")]
    Blocks {
        /// Blocks in the file.
        found: u32,
        /// `MAX_BLOCKS`.
        limit: u32,
    },
    /// The model sees robots from their heading, and this build leaves that out.
    #[error(
        "the model sees robots from their heading; build rigidformer-core with the feature `robot`"
    )]
    Heading,
    /// The model moves soft bodies, and this build leaves that out.
    #[error("the model moves soft bodies; build rigidformer-core with the feature `deform`")]
    Soft,
    /// The model's point network has hidden widths, and kernels of this processor have none.
    #[cfg(feature = "host")]
    #[error(
        "the point network has hidden widths, which builds for Cortex-M with DSP leave out; use a model whose `hidden.point` is [0, 0]"
    )]
    PointHidden,
    /// The model breaks bonds between units, and this build leaves that out.
    #[error(
        "the model breaks bonds between units; build rigidformer-core with the feature `deform`"
    )]
    Bonds,
    /// A longer command than this build has room for.
    #[error("the model takes commands of {found} numbers, this build holds at most {limit}")]
    Command {
        /// Numbers in a command.
        found: u32,
        /// `MAX_COMMAND`.
        limit: u32,
    },
    /// More scales than this build has room for.
    #[error("the model has {found} attention scales, this build holds at most {limit}")]
    Scales {
        /// Scales in the file.
        found: u32,
        /// `MAX_SCALES`.
        limit: u32,
    },
}

/// Why a workspace cannot be carved from the slabs.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Error)]
#[non_exhaustive]
pub enum WorkspaceError {
    /// The f32 slab is too short.
    #[error("the f32 slab holds {found} numbers, these limits need {needed} (SlabSizes::new)")]
    F32Slab {
        /// Numbers needed.
        needed: usize,
        /// Numbers given.
        found: usize,
    },
    /// The i8 slab is too short.
    #[error("the i8 slab holds {found} numbers, these limits need {needed} (SlabSizes::new)")]
    I8Slab {
        /// Numbers needed.
        needed: usize,
        /// Numbers given.
        found: usize,
    },
    /// The point slab is too short.
    #[error("the point slab holds {found} points, these limits need {needed} (SlabSizes::new)")]
    PointSlab {
        /// Points needed.
        needed: usize,
        /// Points given.
        found: usize,
    },
    /// The slab of units is too short.
    #[error("the unit slab holds {found} units, these limits need {needed} (SlabSizes::new)")]
    UnitSlab {
        /// Units needed.
        needed: usize,
        /// Units given.
        found: usize,
    },
}

/// Why an observation was refused; the scene is what it was.
#[derive(Clone, Copy, Debug, PartialEq, Error)]
#[non_exhaustive]
pub enum ObserveError {
    /// No unit was given.
    #[error("the observation has no units; give at least one")]
    NoUnits,
    /// More units than the limits allow.
    #[error("{found} units observed, the limits allow {limit}; raise Limits::units")]
    TooManyUnits {
        /// Units given.
        found: usize,
        /// Units allowed.
        limit: usize,
    },
    /// More points in all than the limits allow.
    #[error(
        "{found} points observed, the limits allow {limit} in all; raise Limits::points or thin them"
    )]
    TooManyPoints {
        /// Points given.
        found: usize,
        /// Points allowed.
        limit: usize,
    },
    /// A unit with fewer than four points.
    #[error("unit {unit} has {found} points; a unit needs at least 4")]
    TooFewPoints {
        /// Which unit.
        unit: usize,
        /// Its points.
        found: usize,
    },
    /// A unit has a different number of points in the two frames.
    #[error(
        "unit {unit} has {previous} points in the previous frame and {current} in the current; give the same points in the same order"
    )]
    PointMismatch {
        /// Which unit.
        unit: usize,
        /// Its points in the previous frame.
        previous: usize,
        /// Its points in the current frame.
        current: usize,
    },
    /// A coordinate is NaN, infinite or beyond 1e6 m.
    #[error("point {point} of unit {unit} is not finite or beyond 1e6 m; drop it or the unit")]
    BadPoint {
        /// Which unit.
        unit: usize,
        /// Which of its points.
        point: usize,
    },
    /// A pose is NaN, infinite or beyond 1e6 m, or its quaternion is not of unit length.
    #[error(
        "a pose of unit {unit} is not finite, beyond 1e6 m, or its quaternion is not normalised"
    )]
    BadPose {
        /// Which unit.
        unit: usize,
    },
    /// All points of a unit lie within a micrometre of each other, in one of the frames.
    #[error("all points of unit {unit} coincide (within 1e-6 m); a unit needs extent")]
    Coincident {
        /// Which unit.
        unit: usize,
    },
    /// A mass, friction or restitution outside its range.
    #[error(
        "physics of unit {unit}: mass must be from 1e-9 to 1e9 kg, friction and restitution from 0 to 1000"
    )]
    BadPhysics {
        /// Which unit.
        unit: usize,
    },
    /// A contact stiffness or dissipation outside its range.
    #[cfg(feature = "compliance")]
    #[error(
        "compliance of unit {unit}: stiffness must be from 1e-3 to 1e12 N/m, or 0 (rigid), dissipation from 0 to 1e6 s/m"
    )]
    BadCompliance {
        /// Which unit.
        unit: usize,
    },
    /// A moment of inertia outside its range, or greater than the sum of the other two, which no body has.
    #[error(
        "inertia of unit {unit}: moments must be from 1e-18 to 1e18 kg m^2, none greater than the sum of the other two; correct them, or give none for those of the box around the points"
    )]
    BadInertia {
        /// Which unit.
        unit: usize,
    },
    /// A unit of more convex pieces than there may be.
    #[error(
        "unit {unit} has {found} convex pieces, at most {limit} are possible; merge some (`rigidformer pieces` does)"
    )]
    TooManyPieces {
        /// Which unit.
        unit: usize,
        /// Its pieces.
        found: usize,
        /// [`MAX_PIECES`](crate::MAX_PIECES).
        limit: usize,
    },
    /// A convex piece that does not have 4 to 255 points, all finite and within 1e6 m, or as many as its count says. A
    /// number behind the last piece's: there are more points than the counts say.
    #[error(
        "convex piece {piece} of unit {unit} must have from 4 to 255 points, as many as its count says, all finite and within 1e6 m; the counts of all pieces must add up to the points"
    )]
    BadPiece {
        /// Which unit.
        unit: usize,
        /// Which of its pieces.
        piece: usize,
    },
    /// A soft unit for a model that moves rigid ones alone.
    #[cfg(feature = "deform")]
    #[error(
        "unit {unit} is soft, the model moves rigid units alone; give it a model of elastic motion, such as shell.rfm"
    )]
    NotSoft {
        /// Which unit.
        unit: usize,
    },
    /// Points at rest that do not go with a soft unit's points, or a stiffness out of range.
    #[cfg(feature = "deform")]
    #[error(
        "soft unit {unit}: its points at rest must be as many as its points, finite, within 1e6 m, in places of their own and not all within 1e-6 m, Young's modulus from 1e-3 to 1e15 Pa, its role Free, without pieces"
    )]
    BadSoft {
        /// Which unit.
        unit: usize,
    },
    /// A soft unit that was given by poses, which say nothing of its points.
    #[cfg(feature = "deform")]
    #[error("unit {unit} is soft: give its points in both frames (observe), not poses")]
    SoftPose {
        /// Which unit.
        unit: usize,
    },
    /// The time step is not finite or not above 0.
    #[error("the time step must be a finite number of seconds above 0")]
    BadTimestep,
    /// The time step is longer than [`MAX_SUB_STEPS`](crate::MAX_SUB_STEPS) of the model's longest steps.
    #[error(
        "a step of {} s would take {} of the longest steps that the model knows; take steps of {} s at most",
        Decimal(*.dt_s),
        Decimal(*.substeps),
        AtMost(*.longest_s)
    )]
    LongTimestep {
        /// Seconds of the step.
        dt_s: f32,
        /// The longest steps that it would take.
        substeps: f32,
        /// Seconds of the longest step in this scene.
        longest_s: f32,
    },
    /// The time step is shorter than [`SHORTEST_STEP_S`](crate::SHORTEST_STEP_S), or for models of soft bodies than
    /// [`SHORTEST_SOFT_STEP_S`](crate::SHORTEST_SOFT_STEP_S).
    #[error(
        "steps of {} s are too short for this model; take steps of {} s or more",
        Decimal(*.dt_s),
        Decimal(*.shortest_s)
    )]
    ShortTimestep {
        /// Seconds of the step.
        dt_s: f32,
        /// Seconds of the shortest step.
        shortest_s: f32,
    },
}

/// Why a change of the scene was refused; the scene is what it was.
#[derive(Clone, Copy, Debug, PartialEq, Error)]
#[non_exhaustive]
pub enum EditError {
    /// No unit of the scene has that name.
    #[error(
        "{id} names no unit of this scene: it was removed, or is of another scene or simulator"
    )]
    NoSuchUnit {
        /// The name.
        id: UnitId,
    },
    /// The scene has fewer copies.
    #[error("there is no copy {copy}, the scene has {copies}; call replicate first")]
    NoSuchCopy {
        /// The copy asked for, from 0.
        copy: usize,
        /// Copies.
        copies: usize,
    },
    /// Only driven units can be told where to go.
    #[error("{id} is not driven: give it Role::Driven, or set its poses")]
    NotDriven {
        /// The unit.
        id: UnitId,
    },
    /// A driven unit cannot go so far in one step.
    #[error(
        "{id} would jump: over {} m/s; give a nearer pose, or set its poses where it was put elsewhere",
        Decimal(*.limit_m_s)
    )]
    Jump {
        /// The unit.
        id: UnitId,
        /// `MAX_DRIVEN_M_S`.
        limit_m_s: f32,
    },
    /// A unit cannot turn so fast: poses of two steps do not tell it from a turn the other way.
    #[error(
        "{id} would turn too fast: over {} rad/s, half a turn a step; give less, or take shorter steps",
        Decimal(*.limit_rad_s)
    )]
    Spin {
        /// The unit.
        id: UnitId,
        /// Radians a second that it can turn.
        limit_rad_s: f32,
    },
    /// Velocities of all units were given, but not one a unit.
    #[error("{found} velocities given for {units} units; give one a unit, in their order")]
    Velocities {
        /// Velocities given.
        found: usize,
        /// Units of the scene.
        units: usize,
    },
    /// What a bond holds stays free.
    #[error("{id} is held by a bond, which holds free units alone: break its bonds first")]
    Bonded {
        /// The unit.
        id: UnitId,
    },
    /// Scenes with soft units are observed whole: their points lie beside each other, and a patch has no pose and is free.
    #[cfg(feature = "deform")]
    #[error("the scene has soft units: observe it anew, with the unit as it is to be")]
    Deforms,
    /// Something is wrong with the unit, its poses, its physics or the time step.
    #[error(transparent)]
    Unit(#[from] ObserveError),
    /// Units cannot be added to a scene that has no time step.
    #[error("the scene has no time step yet: call set_dt or observe first")]
    NoTimestep,
    /// Units come and go in scenes of one copy alone.
    #[error("the scene has {copies} copies: add and remove units before replicate")]
    Replicated {
        /// Copies.
        copies: usize,
    },
    /// More planes than a scene has room for.
    #[error("{found} planes given, a scene holds at most {limit}")]
    TooManyPlanes {
        /// Planes given.
        found: usize,
        /// `MAX_PLANES`.
        limit: usize,
    },
    /// A plane's normal is not of unit length, or a number is not finite or out of range.
    #[error(
        "plane {plane}: its normal must be of length 1 within 0.001, its offset within 1e6 m, friction and restitution from 0 to 1000"
    )]
    BadPlane {
        /// Which plane.
        plane: usize,
    },
    /// There is no such plane.
    #[cfg(feature = "compliance")]
    #[error("the scene has {planes} planes, none with the number {plane}")]
    NoSuchPlane {
        /// Which plane.
        plane: usize,
        /// How many there are.
        planes: usize,
    },
    /// A contact stiffness or dissipation of a plane outside its range.
    #[cfg(feature = "compliance")]
    #[error(
        "compliance of plane {plane}: stiffness must be from 1e-3 to 1e12 N/m, or 0 (rigid), dissipation from 0 to 1e6 s/m"
    )]
    BadPlaneCompliance {
        /// Which plane.
        plane: usize,
    },
    /// Something is wrong with a height field.
    #[cfg(feature = "terrain")]
    #[error(transparent)]
    HeightField(#[from] crate::contact::height_field::HeightFieldError),
    /// A contact law's number is out of range, or none.
    #[error("contact law: restitution_offset must be from 0 to 1")]
    BadContactLaw,
    /// Gravity is not finite or too large.
    #[error("gravity must be finite and at most 1e4 m/s^2 along each axis")]
    BadGravity,
}

/// Why two units were not joined; the joints are what they were.
#[cfg(feature = "robot")]
#[derive(Clone, Copy, Debug, PartialEq, Eq, Error)]
#[non_exhaustive]
pub enum JoinError {
    /// No unit of the scene has that name.
    #[error(
        "{id} names no unit of this scene: it was removed, or is of another scene or simulator"
    )]
    NoSuchUnit {
        /// The name.
        id: UnitId,
    },
    /// A pivot is not a place.
    #[error("{id}: both pivots must be finite and within 1e6 m along each axis")]
    BadPivot {
        /// The unit that was to hang.
        id: UnitId,
    },
    /// The parent hangs from the unit, or is it.
    #[error(
        "{id} cannot hang from {parent}, which is it or hangs from it: join them the other way round, or unjoin {parent}"
    )]
    Circle {
        /// The unit that was to hang.
        id: UnitId,
        /// The unit that it was to hang from.
        parent: UnitId,
    },
    /// The unit or the parent is soft: a patch has no frame for a pivot.
    #[cfg(feature = "deform")]
    #[error("{id} is soft: rigid units alone hang by pivots")]
    Deforms {
        /// The unit.
        id: UnitId,
    },
    /// A bond holds the unit or the parent.
    #[error("{id} is held by a bond: what hangs holds to nothing else; break its bonds first")]
    Bonded {
        /// The unit.
        id: UnitId,
    },
    /// The model knows ball joints alone.
    #[error("{id}: this model does not move units by impulses, and knows ball joints alone")]
    NotByImpulses {
        /// The unit that was to hang.
        id: UnitId,
    },
    /// An axis has no direction.
    #[error("{id}: the axis must be finite and not 0")]
    BadAxis {
        /// The unit that was to hang.
        id: UnitId,
    },
    /// Limits are in the wrong order, or out of range.
    #[error("{id}: limits must rise, within half a turn to either side or 1e6 m")]
    BadLimits {
        /// The unit that was to hang.
        id: UnitId,
    },
    /// A force is none.
    #[error("{id}: the force must be finite and above 0")]
    BadForce {
        /// The unit that was to hang.
        id: UnitId,
    },
    /// The rotation at position 0 is none.
    #[error("{id}: the rotation at position 0 must be finite and not 0")]
    BadRest {
        /// The unit that was to hang.
        id: UnitId,
    },
    /// The unit hangs by no joint with an axis.
    #[error("{id} hangs by no revolute or prismatic joint: it has no position")]
    NoAxis {
        /// The unit.
        id: UnitId,
    },
    /// A target is no position.
    #[error("{id}: the target must be finite and within 1e6")]
    BadTarget {
        /// The unit.
        id: UnitId,
    },
}

/// Why units were not bonded, or a bond was not broken; the bonds are what they were.
#[cfg(feature = "deform")]
#[derive(Clone, Copy, Debug, PartialEq, Eq, Error)]
#[non_exhaustive]
pub enum BondError {
    /// The model's motion is not by impulses.
    #[error(
        "the model does not move units that hold together; take one whose motion is impulses, such as edge"
    )]
    Motion,
    /// No unit of the scene has that name.
    #[error(
        "{id} names no unit of this scene: it was removed, or is of another scene or simulator"
    )]
    NoSuchUnit {
        /// The name.
        id: UnitId,
    },
    /// A unit was to be bonded to itself.
    #[error("{id} cannot be bonded to itself: name two units")]
    Itself {
        /// The unit.
        id: UnitId,
    },
    /// Only free units hold together.
    #[error("{id} is driven or fixed, or soft: only free rigid units hold together")]
    NotFree {
        /// The unit.
        id: UnitId,
    },
    /// A unit hangs from another, or another from it.
    #[error("{id} is joined to another unit: unjoin it before it is bonded")]
    Joined {
        /// The unit.
        id: UnitId,
    },
    /// The units are of different bodies, or bodies of their own.
    #[error("{0} and {1} are not of one body, or not any more: give both the same body", pair[0], pair[1])]
    Apart {
        /// The units.
        pair: [UnitId; 2],
    },
    /// The pair has a bond already, maybe a broken one: broken bonds stay broken.
    #[error("{0} and {1} have a bond already, or had one: each pair is bonded once", pair[0], pair[1])]
    Twice {
        /// The units.
        pair: [UnitId; 2],
    },
    /// More bonds than there is room for.
    #[error("{found} bonds, the limits have room for {limit}: 8 a unit; raise Limits::units")]
    TooMany {
        /// Bonds that there would be.
        found: usize,
        /// Bonds that there is room for.
        limit: usize,
    },
    /// The pair has no bond.
    #[error("{0} and {1} have no bond", pair[0], pair[1])]
    NoSuchBond {
        /// The units.
        pair: [UnitId; 2],
    },
    /// The scene has fewer copies.
    #[error("there is no copy {copy}, the scene has {copies}; call replicate first")]
    NoSuchCopy {
        /// The copy asked for, from 0.
        copy: usize,
        /// Copies.
        copies: usize,
    },
}

/// Why a step was refused; the scene is what it was.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Error)]
#[non_exhaustive]
pub enum StepError {
    /// The scene has no units.
    #[error("there is nothing to step: observe a scene or add units first")]
    NoUnits,
    /// The simulator was made for another layout.
    #[error(
        "the simulator was made for schedules of another layout; make it with Simulator::with_layout of this one's LAYOUT"
    )]
    Layout,
    /// The model takes a command and none was set.
    #[error("the model wants a command of {size} numbers: call set_command first")]
    NoCommand {
        /// Numbers in a command.
        size: usize,
    },
    /// The model predicted a pose that is not finite or beyond 1e6 m.
    #[error(
        "the prediction for unit {unit} is not finite or beyond 1e6 m; the scene is unlike the training data"
    )]
    Diverged {
        /// Which unit.
        unit: usize,
    },
}

/// Why a command was refused; the previous one stays.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Error)]
#[non_exhaustive]
pub enum CommandError {
    /// The command has another size than the model's.
    #[error("the command has {found} numbers, the model wants {expected}")]
    Size {
        /// Numbers wanted.
        expected: usize,
        /// Numbers given.
        found: usize,
    },
    /// A number is NaN or infinite.
    #[error("command number {index} is not finite")]
    NotFinite {
        /// Which number.
        index: usize,
    },
}

/// Why a snapshot was not written or not taken; the scene is what it was.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Error)]
#[non_exhaustive]
pub enum SnapshotError {
    /// There is no room for the snapshot.
    #[error(
        "the snapshot takes {needed} bytes, {found} were given (snapshot_bytes tells how many)"
    )]
    Room {
        /// Bytes needed.
        needed: usize,
        /// Bytes given.
        found: usize,
    },
    /// The bytes are not a snapshot.
    #[error("the bytes are no snapshot of a RigidFormer scene, or were cut off")]
    NotASnapshot,
    /// A snapshot of another version of the library.
    #[error("the snapshot has version {found}, this library reads {supported}")]
    Version {
        /// Version of the snapshot.
        found: u32,
        /// Version that this build reads.
        supported: u32,
    },
    /// More or fewer bytes than its counts say.
    #[error("the snapshot has {found} bytes, by its counts it should have {expected}")]
    Length {
        /// Bytes given.
        found: usize,
        /// Bytes that the counts call for.
        expected: usize,
    },
    /// The bytes have changed since they were written.
    #[error("the snapshot is damaged: its checksum does not fit")]
    Checksum,
    /// A snapshot of another model.
    #[error("the snapshot is of another model, or of other weights of this one")]
    OtherModel,
    /// A snapshot of a scene on another height field, or on none.
    #[error(
        "the snapshot is of a scene on another height field, or on none: put the scene on that one first"
    )]
    OtherHeightField,
    /// A part that this build leaves out: joints, soft units, bonds, a height field, or units in quarantine.
    #[error(
        "the snapshot has joints, bonds, soft units, a height field or a quarantine, which this build leaves out"
    )]
    LeftOut,
    /// More units than the limits allow.
    #[error("the snapshot has {found} units, the limits allow {limit}; raise Limits::units")]
    TooManyUnits {
        /// Units of a copy.
        found: usize,
        /// Units allowed.
        limit: usize,
    },
    /// More points than the limits allow.
    #[error(
        "the snapshot has {found} points or more, the limits allow {limit}; raise Limits::points"
    )]
    TooManyPoints {
        /// Points of a copy so far.
        found: usize,
        /// Points allowed.
        limit: usize,
    },
    /// More copies than there is room for.
    #[error("the snapshot has {found} copies, there is room for {limit} of such a scene")]
    TooManyCopies {
        /// Copies.
        found: usize,
        /// Copies allowed.
        limit: usize,
    },
    /// More bonds than there is room for.
    #[cfg(feature = "deform")]
    #[error("the snapshot has {found} bonds, there is room for {limit}; raise Limits::units")]
    TooManyBonds {
        /// Bonds of a copy.
        found: usize,
        /// Bonds allowed.
        limit: usize,
    },
    /// A number that no simulator writes there.
    #[error("the snapshot is damaged: what it has at byte {byte} cannot be")]
    Unsound {
        /// Where it begins.
        byte: usize,
    },
    /// One copy goes on from a snapshot of one copy of the same scene alone.
    #[error("the snapshot is not one copy of this scene: restore the whole scene instead")]
    OtherScene,
    /// The scene has fewer copies.
    #[error("there is no copy {copy}, the scene has {copies}; call replicate first")]
    NoSuchCopy {
        /// The copy asked for, from 0.
        copy: usize,
        /// Copies.
        copies: usize,
    },
}
