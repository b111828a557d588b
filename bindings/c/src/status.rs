//! Errors of the core as codes and numbers.

use crate::types::rf_status::{self, *};
use crate::types::{RF_NONE, rf_detail};
use core::ffi::CStr;
#[cfg(feature = "terrain")]
use rigidformer_core::HeightFieldError;
#[cfg(feature = "robot")]
use rigidformer_core::JoinError;
#[cfg(feature = "deform")]
use rigidformer_core::{BondError, UnitId};
use rigidformer_core::{
    CommandError, EditError, LoadError, ObserveError, SnapshotError, StepError,
};
use rigidformer_weights::FormatError;

impl rf_detail {
    /// Nothing but a code.
    pub(crate) const fn of(code: rf_status) -> Self {
        rf_detail { code, unit: RF_NONE, index: RF_NONE, reserved: 0, found: 0, expected: 0 }
    }

    /// What there was and should have been.
    pub(crate) const fn numbers(code: rf_status, found: u64, expected: u64) -> Self {
        rf_detail { found, expected, ..Self::of(code) }
    }

    pub(crate) const fn at(self, unit: usize) -> Self {
        rf_detail { unit: unit as u32, ..self }
    }

    const fn index(self, index: u32) -> Self {
        rf_detail { index, ..self }
    }
}

impl From<rf_status> for rf_detail {
    fn from(code: rf_status) -> Self {
        Self::of(code)
    }
}

impl From<FormatError> for rf_detail {
    fn from(error: FormatError) -> Self {
        let detail = match error {
            FormatError::NotAModel { .. } => Self::of(RF_ERROR_MODEL_MAGIC),
            FormatError::Version { found, supported } => {
                Self::numbers(RF_ERROR_MODEL_VERSION, found.into(), supported.into())
            }
            FormatError::Misaligned { remainder } => {
                Self::numbers(RF_ERROR_MODEL_ALIGNMENT, remainder.into(), 0)
            }
            FormatError::Truncated { expected, found }
            | FormatError::TrailingBytes { expected, found } => {
                Self::numbers(RF_ERROR_MODEL_LENGTH, found, expected)
            }
            FormatError::Checksum { expected, found, .. } => {
                Self::numbers(RF_ERROR_MODEL_CHECKSUM, found.into(), expected.into())
            }
            FormatError::Config(_) => Self::of(RF_ERROR_MODEL_CONFIG),
            FormatError::NotFinite { element, .. } | FormatError::Asymmetric { element, .. } => {
                Self::numbers(RF_ERROR_MODEL_NUMBER, element, 0)
            }
            FormatError::Scale { channel, .. } => Self::numbers(RF_ERROR_MODEL_NUMBER, channel, 0),
            FormatError::TooManyTensors { found, maximum } => {
                Self::numbers(RF_ERROR_MODEL_STRUCTURE, found.into(), maximum.into())
            }
            // What is left are contradictions of the header and the directory.
            _ => Self::of(RF_ERROR_MODEL_STRUCTURE),
        };
        detail.index(error.tensor().unwrap_or(RF_NONE))
    }
}

impl From<LoadError> for rf_detail {
    fn from(error: LoadError) -> Self {
        match error {
            LoadError::Format(error) => error.into(),
            LoadError::MissingTensor(_) | LoadError::Shape { .. } | LoadError::Dtype(_) => {
                Self::of(RF_ERROR_MODEL_TENSOR)
            }
            LoadError::Blocks { found, limit }
            | LoadError::Command { found, limit }
            | LoadError::Scales { found, limit } => {
                Self::numbers(RF_ERROR_MODEL_SIZE, found.into(), limit.into())
            }
            LoadError::Heading | LoadError::Soft | LoadError::Bonds => {
                Self::of(RF_ERROR_MODEL_VERSION)
            }
            #[cfg(feature = "host")]
            LoadError::PointHidden => Self::of(RF_ERROR_MODEL_VERSION),
            _ => Self::of(RF_ERROR_OTHER),
        }
    }
}

impl From<ObserveError> for rf_detail {
    fn from(error: ObserveError) -> Self {
        match error {
            ObserveError::NoUnits => Self::of(RF_ERROR_NO_UNITS),
            ObserveError::TooManyUnits { found, limit } => {
                Self::numbers(RF_ERROR_TOO_MANY_UNITS, found as u64, limit as u64)
            }
            ObserveError::TooManyPoints { found, limit } => {
                Self::numbers(RF_ERROR_TOO_MANY_POINTS, found as u64, limit as u64)
            }
            ObserveError::TooFewPoints { unit, found } => {
                let minimum = rigidformer_core::ANCHORS as u64;
                Self::numbers(RF_ERROR_TOO_FEW_POINTS, found as u64, minimum).at(unit)
            }
            ObserveError::BadPoint { unit, point } => {
                Self::of(RF_ERROR_BAD_POINT).at(unit).index(point as u32)
            }
            ObserveError::BadPose { unit } => Self::of(RF_ERROR_BAD_POSE).at(unit),
            ObserveError::Coincident { unit } => Self::of(RF_ERROR_COINCIDENT).at(unit),
            ObserveError::BadPhysics { unit } => Self::of(RF_ERROR_BAD_PHYSICS).at(unit),
            #[cfg(feature = "compliance")]
            ObserveError::BadCompliance { unit } => Self::of(RF_ERROR_BAD_COMPLIANCE).at(unit),
            ObserveError::BadInertia { unit } => Self::of(RF_ERROR_BAD_INERTIA).at(unit),
            ObserveError::TooManyPieces { unit, found, limit } => {
                Self::numbers(RF_ERROR_TOO_MANY_PIECES, found as u64, limit as u64).at(unit)
            }
            ObserveError::BadPiece { unit, piece } => {
                Self::of(RF_ERROR_BAD_PIECE).at(unit).index(piece as u32)
            }
            #[cfg(feature = "deform")]
            ObserveError::NotSoft { unit } => Self::of(RF_ERROR_NOT_SOFT).at(unit),
            #[cfg(feature = "deform")]
            ObserveError::BadSoft { unit } => Self::of(RF_ERROR_BAD_SOFT).at(unit),
            #[cfg(feature = "deform")]
            ObserveError::SoftPose { unit } => Self::of(RF_ERROR_SOFT_POSE).at(unit),
            ObserveError::BadTimestep
            | ObserveError::LongTimestep { .. }
            | ObserveError::ShortTimestep { .. } => Self::of(RF_ERROR_BAD_TIMESTEP),
            // One count of units and one of points serve both frames here.
            _ => Self::of(RF_ERROR_OTHER),
        }
    }
}

impl From<EditError> for rf_detail {
    fn from(error: EditError) -> Self {
        match error {
            EditError::NoSuchUnit { id } => Self::numbers(RF_ERROR_NO_SUCH_ID, id.to_bits(), 0),
            EditError::NotDriven { id } => Self::numbers(RF_ERROR_NOT_DRIVEN, id.to_bits(), 0),
            EditError::Jump { id, .. } => Self::numbers(RF_ERROR_BAD_POSE, id.to_bits(), 0),
            EditError::Spin { id, .. } => Self::numbers(RF_ERROR_BAD_VELOCITY, id.to_bits(), 0),
            EditError::Velocities { found, units } => {
                Self::numbers(RF_ERROR_BAD_VELOCITY, found as u64, units as u64)
            }
            EditError::Bonded { id } => Self::numbers(RF_ERROR_BONDED, id.to_bits(), 0),
            #[cfg(feature = "deform")]
            EditError::Deforms => Self::of(RF_ERROR_DEFORMS),
            EditError::Unit(error) => error.into(),
            EditError::NoTimestep => Self::of(RF_ERROR_NO_TIMESTEP),
            EditError::TooManyPlanes { found, limit } => {
                Self::numbers(RF_ERROR_TOO_MANY_PLANES, found as u64, limit as u64)
            }
            EditError::BadPlane { plane } => Self::of(RF_ERROR_BAD_PLANE).index(plane as u32),
            #[cfg(feature = "compliance")]
            EditError::BadPlaneCompliance { plane } => {
                Self::of(RF_ERROR_BAD_COMPLIANCE).index(plane as u32)
            }
            #[cfg(feature = "compliance")]
            EditError::NoSuchPlane { plane, planes } => {
                Self::numbers(RF_ERROR_NO_SUCH_PLANE, plane as u64, planes as u64)
            }
            #[cfg(feature = "terrain")]
            EditError::HeightField(HeightFieldError::Model) => Self::of(RF_ERROR_NO_HEIGHT_FIELD),
            #[cfg(feature = "terrain")]
            EditError::HeightField(HeightFieldError::Height { height }) => {
                Self::of(RF_ERROR_BAD_HEIGHT_FIELD).index(height as u32)
            }
            #[cfg(feature = "terrain")]
            EditError::HeightField(_) => Self::of(RF_ERROR_BAD_HEIGHT_FIELD),
            EditError::BadContactLaw => Self::of(RF_ERROR_BAD_CONTACT_LAW),
            EditError::BadGravity => Self::of(RF_ERROR_BAD_GRAVITY),
            // A simulator of this interface has one copy of its scene.
            _ => Self::of(RF_ERROR_OTHER),
        }
    }
}

#[cfg(feature = "robot")]
impl From<JoinError> for rf_detail {
    fn from(error: JoinError) -> Self {
        match error {
            JoinError::NoSuchUnit { id } => Self::numbers(RF_ERROR_NO_SUCH_ID, id.to_bits(), 0),
            JoinError::Circle { id, parent } => {
                Self::numbers(RF_ERROR_BAD_JOINT, id.to_bits(), parent.to_bits())
            }
            #[cfg(feature = "deform")]
            JoinError::Deforms { id } => Self::numbers(RF_ERROR_DEFORMS, id.to_bits(), 0),
            JoinError::Bonded { id } => Self::numbers(RF_ERROR_BONDED, id.to_bits(), 0),
            JoinError::BadPivot { id }
            | JoinError::NotByImpulses { id }
            | JoinError::BadAxis { id }
            | JoinError::BadLimits { id }
            | JoinError::BadForce { id }
            | JoinError::BadRest { id }
            | JoinError::NoAxis { id }
            | JoinError::BadTarget { id } => Self::numbers(RF_ERROR_BAD_JOINT, id.to_bits(), 0),
            _ => Self::of(RF_ERROR_OTHER),
        }
    }
}

#[cfg(feature = "deform")]
impl From<BondError> for rf_detail {
    fn from(error: BondError) -> Self {
        let unit = |code, id: UnitId| Self::numbers(code, id.to_bits(), 0);
        let pair = |code, pair: [UnitId; 2]| {
            let [found, expected] = pair.map(UnitId::to_bits);
            Self::numbers(code, found, expected)
        };
        match error {
            BondError::Motion => Self::of(RF_ERROR_BOND_MOTION),
            BondError::NoSuchUnit { id } => unit(RF_ERROR_NO_SUCH_ID, id),
            BondError::Itself { id } => unit(RF_ERROR_BOND_ITSELF, id),
            BondError::NotFree { id } => unit(RF_ERROR_BOND_NOT_FREE, id),
            BondError::Joined { id } => unit(RF_ERROR_BOND_JOINED, id),
            BondError::Apart { pair: ids } => pair(RF_ERROR_BOND_APART, ids),
            BondError::Twice { pair: ids } => pair(RF_ERROR_BOND_TWICE, ids),
            BondError::TooMany { found, limit } => {
                Self::numbers(RF_ERROR_TOO_MANY_BONDS, found as u64, limit as u64)
            }
            BondError::NoSuchBond { pair: ids } => pair(RF_ERROR_NO_SUCH_BOND, ids),
            // A simulator of this interface has one copy of its scene.
            _ => Self::of(RF_ERROR_OTHER),
        }
    }
}

impl From<StepError> for rf_detail {
    fn from(error: StepError) -> Self {
        match error {
            StepError::NoUnits => Self::of(RF_ERROR_NOT_OBSERVED),
            StepError::NoCommand { size } => Self::numbers(RF_ERROR_NO_COMMAND, 0, size as u64),
            StepError::Diverged { unit } => Self::of(RF_ERROR_DIVERGED).at(unit),
            _ => Self::of(RF_ERROR_OTHER),
        }
    }
}

impl From<SnapshotError> for rf_detail {
    fn from(error: SnapshotError) -> Self {
        match error {
            SnapshotError::Room { needed, found } => {
                Self::numbers(RF_ERROR_BUFFER, found as u64, needed as u64)
            }
            SnapshotError::NotASnapshot | SnapshotError::Checksum => Self::of(RF_ERROR_STATE),
            SnapshotError::Length { found, expected } => {
                Self::numbers(RF_ERROR_STATE, found as u64, expected as u64)
            }
            SnapshotError::Unsound { byte } => Self::of(RF_ERROR_STATE).index(byte as u32),
            SnapshotError::Version { found, supported } => {
                Self::numbers(RF_ERROR_STATE_VERSION, found.into(), supported.into())
            }
            SnapshotError::OtherHeightField => Self::of(RF_ERROR_STATE_HEIGHT_FIELD),
            SnapshotError::OtherModel => Self::of(RF_ERROR_STATE_MODEL),
            SnapshotError::LeftOut | SnapshotError::TooManyCopies { .. } => {
                Self::of(RF_ERROR_STATE_FEATURE)
            }
            SnapshotError::TooManyUnits { found, limit } => {
                Self::numbers(RF_ERROR_TOO_MANY_UNITS, found as u64, limit as u64)
            }
            SnapshotError::TooManyPoints { found, limit } => {
                Self::numbers(RF_ERROR_TOO_MANY_POINTS, found as u64, limit as u64)
            }
            #[cfg(feature = "deform")]
            SnapshotError::TooManyBonds { found, limit } => {
                Self::numbers(RF_ERROR_TOO_MANY_BONDS, found as u64, limit as u64)
            }
            // A simulator of this interface has one copy of its scene.
            _ => Self::of(RF_ERROR_OTHER),
        }
    }
}

impl From<CommandError> for rf_detail {
    fn from(error: CommandError) -> Self {
        match error {
            CommandError::Size { expected, found } => {
                Self::numbers(RF_ERROR_COMMAND_SIZE, found as u64, expected as u64)
            }
            CommandError::NotFinite { index } => {
                Self::of(RF_ERROR_COMMAND_NUMBER).index(index as u32)
            }
            _ => Self::of(RF_ERROR_OTHER),
        }
    }
}

/// Every code, and what rf_error_string says about it.
pub(crate) const TEXTS: &[(rf_status, &CStr)] = &[
    (RF_OK, c"ok"),
    (RF_ERROR_NULL, c"a pointer is NULL that must not be"),
    (RF_ERROR_ALIGNMENT, c"a pointer is not aligned (workspace: RF_ALIGNMENT; else its type)"),
    (RF_ERROR_MEMORY, c"the workspace is too small; rf_workspace_bytes tells how large it must be"),
    (RF_ERROR_HANDLE, c"no simulator is there: never made, released, moved or overwritten"),
    (RF_ERROR_BUSY, c"another call on this simulator has not returned"),
    (RF_ERROR_ABI, c"header and library are of different RF_ABI_VERSION; rebuild with one of them"),
    (RF_ERROR_BUFFER, c"an output array is too short"),
    (RF_ERROR_NO_SUCH_UNIT, c"there is no unit of that number"),
    (RF_ERROR_LENGTH, c"a length is beyond what the processor can address"),
    (RF_ERROR_OVERLAP, c"an array lies within the workspace"),
    (RF_ERROR_POINT_COUNTS, c"the counts of points or pieces do not add up to those given"),
    #[cfg(feature = "std")]
    (
        RF_ERROR_KERNEL,
        c"the variable RIGIDFORMER_KERNEL names kernels that this processor cannot run; unset it",
    ),
    #[cfg(feature = "std")]
    (RF_ERROR_THREADS, c"more threads than RF_MAX_THREADS, or than this library can share a step among"),
    (RF_ERROR_MODEL_MAGIC, c"the bytes are not a RigidFormer model"),
    (
        RF_ERROR_MODEL_VERSION,
        c"the model is of a format version that this library does not read, or needs a feature that it was built without",
    ),
    (RF_ERROR_MODEL_ALIGNMENT, c"the model is not aligned to RF_ALIGNMENT"),
    (RF_ERROR_MODEL_LENGTH, c"the model has been cut off, or something follows it"),
    (RF_ERROR_MODEL_CHECKSUM, c"the model is damaged: a checksum does not fit"),
    (RF_ERROR_MODEL_STRUCTURE, c"the model's header or tensor directory contradicts itself"),
    (RF_ERROR_MODEL_CONFIG, c"the model's configuration is outside its limits"),
    (RF_ERROR_MODEL_TENSOR, c"a tensor of the model is missing, or has a wrong shape or type"),
    (RF_ERROR_MODEL_NUMBER, c"a weight or scale of the model is out of its range"),
    (RF_ERROR_MODEL_SIZE, c"the model is larger than this library has room for"),
    (RF_ERROR_NO_UNITS, c"the observation has no units"),
    (RF_ERROR_TOO_MANY_UNITS, c"more units observed than rf_init was told"),
    (RF_ERROR_TOO_MANY_POINTS, c"more points observed than rf_init was told"),
    (RF_ERROR_TOO_FEW_POINTS, c"a unit has fewer than 4 points"),
    (RF_ERROR_BAD_POINT, c"a coordinate is NaN, infinite or beyond 1e6 m"),
    (RF_ERROR_BAD_POSE, c"a pose is not finite, beyond 1e6 m, its quaternion not of length 1, or a driven unit is told to go over 100 m/s"),
    (RF_ERROR_COINCIDENT, c"all points of a unit coincide"),
    (RF_ERROR_BAD_PHYSICS, c"a mass, friction or restitution is out of its range"),
    (
        RF_ERROR_BAD_TIMESTEP,
        c"the time step is not a finite number of seconds, below 1 us (of soft bodies 1 ms), or longer than the model takes",
    ),
    (
        RF_ERROR_BAD_INERTIA,
        c"a moment of inertia is out of its range or above the sum of the others; zeros mean the box",
    ),
    (RF_ERROR_TOO_MANY_PIECES, c"a unit has more convex pieces than RF_MAX_PIECES"),
    (
        RF_ERROR_BAD_PIECE,
        c"a convex piece has not 4 to 255 points, or a coordinate is NaN, infinite or beyond 1e6 m",
    ),
    (RF_ERROR_NOT_SOFT, c"the model, the library or the unit is for rigid motion alone"),
    (
        RF_ERROR_BAD_SOFT,
        c"a soft unit's points at rest, Young's modulus, role or pieces do not go with a soft unit",
    ),
    (RF_ERROR_SOFT_POSE, c"a soft unit has no pose; observe its points in both frames"),
    (RF_ERROR_NO_SUCH_ID, c"no unit of the scene has that id"),
    (RF_ERROR_NOT_DRIVEN, c"only driven units can be sent somewhere; rf_set_role makes one driven"),
    (RF_ERROR_NO_TIMESTEP, c"the scene has no time step yet; call rf_set_dt or observe first"),
    (RF_ERROR_TOO_MANY_PLANES, c"more planes than RF_MAX_PLANES"),
    (RF_ERROR_BAD_PLANE, c"a plane's normal is not of length 1, or its numbers are out of range"),
    (RF_ERROR_BAD_GRAVITY, c"gravity is not finite or beyond 1e4 m/s^2 along an axis"),
    (RF_ERROR_BAD_ROLE, c"a role is none of RF_ROLE_FREE, RF_ROLE_DRIVEN and RF_ROLE_FIXED"),
    (RF_ERROR_BAD_BODY, c"a body is neither RF_OWN_BODY nor from 0 to RF_MAX_BODY"),
    (
        RF_ERROR_BAD_JOINT,
        c"a unit cannot hang from itself or from what hangs from it, or a number of its joint is out of range",
    ),
    (RF_ERROR_NO_JOINTS, c"this library was built without joints"),
    (RF_ERROR_DEFORMS, c"soft units do not take this change; observe the scene anew"),
    (RF_ERROR_BONDED, c"a bond holds the unit: break it first"),
    (RF_ERROR_BOND_MOTION, c"the model does not move units that hold together"),
    (RF_ERROR_NO_BONDS, c"this library was built without bonds"),
    (RF_ERROR_NO_HEALTH, c"this library was built without health"),
    (RF_ERROR_BAD_VARIANCE, c"a variance is not above 0 and at most 1e12"),
    (RF_ERROR_NOT_OBSERVED, c"nothing to step; observe a scene or add units first"),
    (RF_ERROR_NO_COMMAND, c"the model takes commands and none was set"),
    (RF_ERROR_DIVERGED, c"the prediction is not finite or beyond 1e6 m"),
    (RF_ERROR_STATE, c"the bytes are no state that rf_save wrote, or are damaged"),
    (RF_ERROR_STATE_VERSION, c"the state is of another version of the library"),
    (RF_ERROR_STATE_MODEL, c"the state is of another model"),
    (RF_ERROR_STATE_FEATURE, c"the state has what this library was built without"),
    (RF_ERROR_STATE_HEIGHT_FIELD, c"the state is of a scene on another height field, or on none"),
    (RF_ERROR_NO_HEIGHT_FIELD, c"this library was built without height fields, or the model does not move units by impulses"),
    (RF_ERROR_COMMAND_SIZE, c"the command has another length than the model's"),
    (RF_ERROR_COMMAND_NUMBER, c"a number of the command is not finite"),
    (RF_ERROR_BAD_VELOCITY, c"a unit would turn over half a turn a step, or there is not one velocity a unit"),
    (RF_ERROR_BAD_COMPLIANCE, c"a contact stiffness or dissipation is out of its range"),
    (RF_ERROR_NO_SUCH_PLANE, c"the scene has no plane of that number"),
    (RF_ERROR_NO_COMPLIANCE, c"this library was built without compliance"),
    (RF_ERROR_BAD_CONTACT_LAW, c"the restitution offset of a contact law is not from 0 to 1"),
    (RF_ERROR_BAD_HEIGHT_FIELD, c"the shape, the place or a number of a height field is out of its range"),
    (RF_ERROR_BOND_ITSELF, c"a unit cannot be bonded to itself"),
    (RF_ERROR_BOND_NOT_FREE, c"only free rigid units hold together"),
    (RF_ERROR_BOND_JOINED, c"a unit that is joined to another cannot be bonded"),
    (RF_ERROR_BOND_APART, c"only units of one body hold together"),
    (RF_ERROR_BOND_TWICE, c"the pair has a bond already, or had one"),
    (RF_ERROR_TOO_MANY_BONDS, c"more bonds than there is room for: 8 for each unit of rf_config"),
    (RF_ERROR_NO_SUCH_BOND, c"the pair has no bond"),
    (RF_ERROR_OTHER, c"an error that this interface has no code for"),
];

/// The same for trackers, of which libraries for microcontrollers know nothing.
#[cfg(feature = "tracker")]
pub(crate) const OF_TRACKERS: &[(rf_status, &CStr)] = &[
    (RF_ERROR_TRACKER_OPTION, c"an option of a tracker is out of its range"),
    (RF_ERROR_MODEL_FILE, c"the model file cannot be read"),
    (
        RF_ERROR_CAPTURE_TIME,
        c"a capture's time is not finite, or not above that of the capture before",
    ),
    (RF_ERROR_CAPTURE_EMPTY, c"a capture has neither images nor clouds; leave it out"),
    (RF_ERROR_CAPTURE_CAMERA, c"the intrinsics or the pose of a depth camera cannot be"),
    (
        RF_ERROR_CAPTURE_SCALE,
        c"a scale of depths is outside 1e-6 to 10 m; give metres a step, such as 0.001",
    ),
    (
        RF_ERROR_CAPTURE_POINT,
        c"a point of a cloud, or its sensor, is not finite or beyond 1e6 m; drop it",
    ),
    (RF_ERROR_HORIZON, c"a horizon is not above 0 and at most RF_MAX_HORIZON_S"),
    (RF_ERROR_FORECAST, c"the model of the tracker does not take the scene"),
    (RF_ERROR_NO_SUCH_TRACK, c"no unit of the tracker has that number; its track ended"),
    (
        RF_ERROR_NO_MEMORY,
        c"there is no memory for the capture; give smaller images or fewer points",
    ),
    (
        RF_ERROR_DEFECT,
        c"a defect of the library ended a call; destroy the tracker and make another",
    ),
];

/// The text of a code. Any number may be asked about.
pub(crate) fn text(code: i32) -> &'static CStr {
    let find = |texts: &[(rf_status, &'static CStr)]| {
        texts.iter().find(|(known, _)| *known as i32 == code).map(|(_, text)| *text)
    };
    let known = find(TEXTS);
    #[cfg(feature = "tracker")]
    let known = known.or_else(|| find(OF_TRACKERS));
    known.unwrap_or(c"unknown error code")
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The numbers that programs in the field were compiled with. A number may be added or retired;
    /// none may ever change or come back.
    #[test]
    fn codes_are_never_renumbered() {
        let codes = [
            0, 1, 2, 3, 4, 5, 7, 8, 9, 10, 11, 12, 13, 14, // calls; 6 is retired
            32, 33, 34, 35, 36, 37, 38, 39, 40, 41, // model
            64, 65, 66, 67, 68, 69, 70, 71, 73, 74, 75, 76, 77, 78,
            79, // observation; 72 is retired
            80, 81, 82, 83, 84, 85, 86, 87, 88, 89, 90, 91, 92, 93, // changes of the scene
            94, 95, // health
            96, 97, 98, // step
            104, 105, 106, 107, 108, // state
            110, // no height fields
            112, 113, 114, // command, velocity
            115, 116, 117, // compliance
            118, 119, // contact law, height field
            120, 121, 122, 123, 124, 125, 126, // bonds
            127,
        ];
        // Without `std` there is nothing to be said about kernels and threads.
        let codes =
            codes.into_iter().filter(|code| cfg!(feature = "std") || ![13, 14].contains(code));
        assert!(TEXTS.iter().map(|(code, _)| *code as i32).eq(codes));
        #[cfg(feature = "tracker")]
        assert!(OF_TRACKERS.iter().map(|(code, _)| *code as i32).eq(128..=139));
        assert_eq!(RF_ERROR_OVERLAP as i32, 11);
        assert_eq!(RF_ERROR_MODEL_CHECKSUM as i32, 36);
        assert_eq!(RF_ERROR_BAD_POINT as i32, 68);
        assert_eq!(RF_ERROR_DIVERGED as i32, 98);
    }

    /// Of a library for microcontrollers it is the feature, more often than not.
    #[test]
    fn a_model_that_needs_a_feature_says_so() {
        let without = [
            rf_detail::from(LoadError::Heading),
            FormatError::Version { found: 9, supported: 9 }.into(),
        ];
        for detail in without {
            assert_eq!(detail.code, RF_ERROR_MODEL_VERSION);
            let text = TEXTS.iter().find(|(code, _)| *code == detail.code).map(|(_, text)| *text);
            let text = text.and_then(|text| text.to_str().ok()).unwrap_or_default();
            assert!(text.contains("a feature that it was built without"), "{text}");
            // What the header says of the numbers.
            assert!(detail.found <= detail.expected);
        }
    }

    #[test]
    fn texts_differ() {
        for (at, (_, text)) in TEXTS.iter().enumerate() {
            assert!(!text.is_empty());
            assert!(TEXTS.iter().skip(at + 1).all(|(_, other)| other != text), "{text:?}");
        }
    }
}
