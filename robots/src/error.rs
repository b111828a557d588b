//! Why a robot is not read.

use std::path::PathBuf;

use rigidformer_runtime::files::{FileError, shown};
use rigidformer_runtime::mesh::MeshError;

/// Characters of a text from a file that an error shows, at most.
pub(crate) const SHOWN: usize = 80;

/// Why a robot is not read. Its text names the file, the element with its line, and the remedy.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum RobotError {
    /// The file cannot be read.
    #[error(transparent)]
    File(#[from] FileError),
    /// A format that is not read.
    #[error("{}: is {found}, which is not read; {remedy}", .path.display())]
    Format {
        /// The file.
        path: PathBuf,
        /// What it is.
        found: &'static str,
        /// What the user can do about it.
        remedy: &'static str,
    },
    /// An element that says something impossible.
    #[error("{}:{line}: {element}: {problem}", .path.display())]
    Element {
        /// The file, also one that another includes.
        path: PathBuf,
        /// Its line, from 1; 0 for the whole file.
        line: u32,
        /// Its tag and name, such as `link "hand"`.
        element: String,
        /// What is wrong with it.
        problem: Box<Problem>,
    },
    /// Joint positions of another number than the robot has.
    #[error(
        "{found} joint positions are given; the robot {robot:?} has {expected}, see Robot::rest"
    )]
    Positions {
        /// The robot.
        robot: String,
        /// Given.
        found: usize,
        /// Needed.
        expected: usize,
    },
    /// A position that is no number, or a quaternion of length 0.
    #[error(
        "position {index} is no position of its joint; give finite numbers, and quaternions of length 1"
    )]
    Position {
        /// Which, from 0.
        index: usize,
    },
    /// The robot makes no scene.
    #[error("the robot {robot:?} makes no scene: {problem}")]
    Scene {
        /// The robot.
        robot: String,
        /// What it lacks, and the remedy.
        problem: String,
    },
}

/// What is wrong with an element of a robot's file.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum Problem {
    /// The file is no XML, or too large a one.
    #[error("the XML is not read ({0}); mend it, or make it smaller")]
    Xml(String),
    /// An attribute that must be there.
    #[error("has no {0}; add it")]
    Missing(&'static str),
    /// Text that is not the numbers expected.
    #[error("{attribute}=\"{found}\" is not {expected}; mend it")]
    Number {
        /// The attribute.
        attribute: String,
        /// Its text, shortened.
        found: String,
        /// What it should be.
        expected: &'static str,
    },
    /// A word that is not known there.
    #[error("{attribute}=\"{found}\" is not known here; give {expected}")]
    Word {
        /// The attribute.
        attribute: &'static str,
        /// Its text, shortened.
        found: String,
        /// What is known.
        expected: &'static str,
    },
    /// A name that nothing has.
    #[error("names the {kind} {name:?}, which is not there; mend the name, or add it")]
    Unknown {
        /// What kind of thing.
        kind: &'static str,
        /// Its name, shortened.
        name: String,
    },
    /// A name that two things have.
    #[error("a second {kind} has the name {name:?}; rename one")]
    Duplicate {
        /// What kind of thing.
        kind: &'static str,
        /// Its name, shortened.
        name: String,
    },
    /// A loop in the kinematic tree, which a tree of joints cannot have.
    #[error("{0}; links make a tree: remove the joint that closes the loop")]
    Loop(&'static str),
    /// Links without a root, or with several.
    #[error("has {found} root links ({names}); a robot has one: join them with fixed joints")]
    Roots {
        /// How many.
        found: usize,
        /// Some of them.
        names: String,
    },
    /// Mass or moments that no body has.
    #[error("{0}")]
    Inertia(&'static str),
    /// A mesh that is nowhere.
    #[error(
        "the mesh {uri:?} is not found; give its package's folder (--package-path), or read without its shape (--skip-meshes)"
    )]
    NoMesh {
        /// As the file has it, shortened.
        uri: String,
    },
    /// A mesh outside of the folders that may be read.
    #[error(
        "the mesh {uri:?} is outside of the robot's folders; give the folder that holds it (--package-path)"
    )]
    Outside {
        /// As the file has it, shortened.
        uri: String,
    },
    /// A mesh that is not read.
    #[error("the mesh {uri:?} {problem}")]
    Mesh {
        /// As the file has it, shortened.
        uri: String,
        /// Why.
        problem: MeshError,
    },
    /// A file that cannot be read.
    #[error("{0}")]
    Unreadable(String),
    /// What this reader does not take.
    #[error("{what} is not taken; {remedy}")]
    Unsupported {
        /// What.
        what: &'static str,
        /// What the user can do about it.
        remedy: &'static str,
    },
    /// More than a robot may have.
    #[error("more than {most} {what}; split the file")]
    TooMany {
        /// Of what.
        what: &'static str,
        /// At most.
        most: usize,
    },
}

impl Problem {
    pub(crate) fn unknown(kind: &'static str, name: &str) -> Self {
        Problem::Unknown { kind, name: shown(name, SHOWN) }
    }

    pub(crate) fn duplicate(kind: &'static str, name: &str) -> Self {
        Problem::Duplicate { kind, name: shown(name, SHOWN) }
    }

    pub(crate) fn word(attribute: &'static str, found: &str, expected: &'static str) -> Self {
        Problem::Word { attribute, found: shown(found, SHOWN), expected }
    }
}
