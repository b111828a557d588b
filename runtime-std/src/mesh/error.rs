//! Why a mesh is not read.

use crate::files::shown;
use crate::memory::TooLarge;

/// Characters of a name or of another's error that an error shows, at most.
const SHOWN: usize = 80;

/// Why a mesh is not read.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[non_exhaustive]
pub enum MeshError {
    /// Another format, or a broken file.
    #[error("is no {format} mesh ({problem}); export it again, as OBJ, STL or COLLADA")]
    Broken {
        /// Which format it was taken for.
        format: &'static str,
        /// What the reader says.
        problem: String,
    },
    /// Fewer triangles than a binary STL says of itself.
    #[error("has {found} of {said} triangles; it was cut off: copy or export it again")]
    CutOff {
        /// In the file.
        found: u64,
        /// In its header.
        said: u64,
    },
    /// An index or a number that makes no corner.
    #[error(
        "group {:?} has a corner that is not finite, or a face with a corner that is not there; export the mesh again",
        shown(group, SHOWN)
    )]
    Corner {
        /// Name of the group.
        group: String,
    },
    /// Points alone, or nothing.
    #[error("has no faces; export the mesh with its faces")]
    NoFaces,
    /// More memory than it may take.
    #[error("{0}; thin the mesh out, or allow more with --memory")]
    TooLarge(#[from] TooLarge),
}

impl MeshError {
    /// A broken file, in another's words.
    pub(super) fn broken(format: &'static str, problem: impl ToString) -> Self {
        MeshError::Broken { format, problem: shown(&problem.to_string(), SHOWN) }
    }
}
