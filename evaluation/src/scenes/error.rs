//! What can be wrong with a scene file.

use std::path::PathBuf;

use rigidformer_core::HeightFieldError;
use rigidformer_runtime::memory::TooLarge;

use super::split::Split;

/// A scene file, or a scene in it, that cannot be used. Its text names the file, the field and the remedy.
#[derive(Debug, thiserror::Error)]
#[error("{}: {field}: {problem}; {}", .path.display(), .problem.remedy())]
pub struct SceneError {
    /// The file, or a name in angle brackets for one that is not on disk.
    pub path: PathBuf,
    /// The metadata entry, tensor or scene at fault.
    pub field: String,
    /// What is wrong with it.
    pub problem: Problem,
}

/// What is wrong with a field of a scene file.
#[derive(Debug, thiserror::Error)]
pub enum Problem {
    /// The file cannot be read.
    #[error("cannot be read ({0})")]
    Unreadable(std::io::Error),
    /// A file or a scene that takes more memory than it may.
    #[error(transparent)]
    Memory(#[from] TooLarge),
    /// Not a safetensors file, or a damaged one.
    #[error("is not a whole safetensors file ({0})")]
    NotSafetensors(String),
    /// A safetensors file with other contents.
    #[error("is {found:?}, not {expected:?}")]
    Foreign {
        /// What the file says.
        found: String,
        /// What a scene file says.
        expected: &'static str,
    },
    /// A metadata entry or tensor is not there.
    #[error("is missing")]
    Missing,
    /// A metadata entry that does not parse.
    #[error("is {found:?}, not {expected}")]
    Unparsable {
        /// The entry.
        found: String,
        /// What it must be.
        expected: &'static str,
    },
    /// A tensor of another type or shape.
    #[error("is {found}, not {expected}")]
    WrongTensor {
        /// Type and shape in the file.
        found: String,
        /// Type and shape that the format asks for.
        expected: String,
    },
    /// Offsets that do not partition what they index.
    #[error("does not rise from 0 to {total}")]
    NotRising {
        /// How many rows there are to partition.
        total: usize,
    },
    /// A value that is not allowed, at a row.
    #[error("row {row} is {value}, not {expected}")]
    BadValue {
        /// Row in the tensor.
        row: usize,
        /// The value.
        value: String,
        /// What it must be.
        expected: &'static str,
    },
    /// A pose that is no pose.
    #[error("unit {unit} at frame {frame} has {what}")]
    BadPose {
        /// Unit within the scene.
        unit: usize,
        /// Frame.
        frame: usize,
        /// What is wrong with it.
        what: &'static str,
    },
    /// Offsets that go back, or beyond what they index.
    #[error("row {row} is {value}; offsets start at 0, never go back and end at {total}")]
    NotAscending {
        /// Row in the tensor.
        row: usize,
        /// The offset.
        value: i64,
        /// How many rows there are to index.
        total: usize,
    },
    /// A scene with more planes than can be simulated.
    #[error("row {scene} gives its scene {planes} planes, more than 8")]
    TooManyPlanes {
        /// The scene, which is the row in the tensor.
        scene: usize,
        /// Its planes.
        planes: usize,
    },
    /// A fixed unit that is not recorded at one pose.
    #[error("unit {unit} is fixed and is elsewhere at frame {frame} than at frame 0")]
    FixedMoves {
        /// Unit within the scene.
        unit: usize,
        /// Frame.
        frame: usize,
    },
    /// Soft points that are more or fewer than the soft units have.
    #[error(
        "has {found} rows, the shapes of the units that unit_soft marks have {expected} points"
    )]
    SoftPoints {
        /// Rows in the file.
        found: usize,
        /// Points of the soft units' shapes.
        expected: usize,
    },
    /// A unit put together wrongly.
    #[error("unit {unit} {what}")]
    BadUnit {
        /// Unit within the scene.
        unit: usize,
        /// What is wrong with it.
        what: &'static str,
    },
    /// A plane put together wrongly.
    #[error(
        "plane {plane} needs finite numbers, a normal of length 1, friction and restitution from 0 to 1000"
    )]
    BadPlane {
        /// Plane within the scene.
        plane: usize,
    },
    /// A plane that gives way by numbers out of range.
    #[error(
        "plane {plane} needs a stiffness from 1e-3 to 1e12 N/m, or 0 (rigid), and a dissipation from 0 to 1e6 s/m"
    )]
    BadPlaneCompliance {
        /// Plane within the scene.
        plane: usize,
    },
    /// A contact law out of range.
    #[error("needs a contact law whose restitution_offset is from 0 to 1")]
    BadContactLaw,
    /// A height field that is none.
    #[error("{0}")]
    BadHeightField(HeightFieldError),
    /// Heights that no height field has.
    #[error("has {found} numbers, the height fields have {expected}")]
    Heights {
        /// Numbers in the file.
        found: usize,
        /// Rows times columns of all fields.
        expected: usize,
    },
    /// More than one height field in a scene.
    #[error("scene {scene} has {fields} height fields")]
    TooManyHeightFields {
        /// Which scene.
        scene: usize,
        /// How many it has.
        fields: usize,
    },
    /// A row of a soft body's mesh put together wrongly.
    #[error("row {row} of {list} {what}")]
    BadMesh {
        /// `faces`, `edges` or `tetrahedra`.
        list: &'static str,
        /// Row in the list.
        row: usize,
        /// What is wrong with it.
        what: &'static str,
    },
    /// A bond put together wrongly.
    #[error("bond {bond} {what}")]
    BadBond {
        /// Bond within the scene.
        bond: usize,
        /// What is wrong with it.
        what: &'static str,
    },
    /// A scene to be written whose planes are not known.
    #[error("has planes that are not known")]
    UnknownPlanes,
    /// A scene that the file does not have.
    #[error("asks for scene {index} of {scenes}")]
    NoSuchScene {
        /// The index asked for, from 0.
        index: usize,
        /// Scenes in the file.
        scenes: usize,
    },
    /// More frames asked for than recorded.
    #[error("has {recorded} frames, {asked} are needed")]
    TooFewFrames {
        /// Frames in the file.
        recorded: usize,
        /// Frames asked for.
        asked: usize,
    },
    /// A scene put together with units of different lengths, or none.
    #[error("{0}")]
    Inconsistent(&'static str),
    /// A split that no scene is in.
    #[error("no scene is in the split {0}")]
    NoneInSplit(Split),
}

impl Problem {
    /// What the user can do about it.
    pub fn remedy(&self) -> &'static str {
        match self {
            Problem::Memory(_) => TooLarge::REMEDY,
            Problem::Unreadable(_) => "give the path of a scene file that you may read",
            Problem::NotSafetensors(_) | Problem::Foreign { .. } => {
                "give a scene file (made by rigidformer_lab.movi), or make it again"
            }
            Problem::NoSuchScene { .. } => "give an index below the number of scenes",
            Problem::NoneInSplit(_) => "choose another split",
            Problem::TooFewFrames { .. } => "ask for fewer frames, or record more",
            Problem::Inconsistent(_)
            | Problem::BadUnit { .. }
            | Problem::BadPlane { .. }
            | Problem::BadPlaneCompliance { .. }
            | Problem::BadContactLaw
            | Problem::BadHeightField(_)
            | Problem::BadMesh { .. }
            | Problem::BadBond { .. } => "correct the scene before using it",
            Problem::Heights { .. } => {
                "write the heights of each field once, in the order of height_fields"
            }
            Problem::TooManyHeightFields { .. } => "keep at most one height field a scene",
            Problem::TooManyPlanes { .. } => "keep at most 8 planes a scene",
            Problem::FixedMoves { .. } => {
                "give the unit one pose in all frames, or role 1 (driven) in unit_role"
            }
            Problem::SoftPoints { .. } => {
                "write a row for every point of every soft unit, in the order of the units"
            }
            Problem::UnknownPlanes => "say them with RecordedScene::with_planes",
            Problem::Missing
            | Problem::Unparsable { .. }
            | Problem::WrongTensor { .. }
            | Problem::NotRising { .. }
            | Problem::NotAscending { .. }
            | Problem::BadValue { .. }
            | Problem::BadPose { .. } => {
                "correct it in the program that wrote the file, or make the file again with rigidformer_lab.movi"
            }
        }
    }
}
