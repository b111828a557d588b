//! What can be wrong with a scene file.

use std::path::PathBuf;

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
}

impl Problem {
    /// What the user can do about it.
    pub fn remedy(&self) -> &'static str {
        match self {
            Problem::Unreadable(_) => "give the path of a scene file that you may read",
            Problem::NotSafetensors(_) | Problem::Foreign { .. } => {
                "give a scene file (made by rigidformer_lab.movi), or make it again"
            }
            Problem::NoSuchScene { .. } => "give an index below the number of scenes",
            Problem::TooFewFrames { .. } => "ask for fewer frames, or record more",
            Problem::Inconsistent(_) => "correct the scene before using it",
            Problem::Missing
            | Problem::Unparsable { .. }
            | Problem::WrongTensor { .. }
            | Problem::NotRising { .. }
            | Problem::BadValue { .. }
            | Problem::BadPose { .. } => "make the file again with rigidformer_lab.movi",
        }
    }
}
