//! Recorded scenes: what the model is measured against.
//!
//! A scene file (`SCENES.md`) is one safetensors file with the scenes of one data set. [`Dataset::open`] reads it and
//! checks everything but poses and soft points; [`Dataset::scene`] gives one scene as a [`RecordedScene`] after checking those.
//! [`write_scene`] writes a file with a single scene.

mod between;
mod bonds;
mod check;
mod dataset;
mod error;
mod read;
mod recorded;
mod split;
mod write;

pub use bonds::{RecordedBond, clusters};
pub use dataset::Dataset;
pub use error::{Problem, SceneError};
pub use recorded::{RecordedScene, RecordedUnit, SoftMesh, Velocity};
pub use split::{Split, UnknownSplit};
pub use write::{SceneNotes, WriteError, scene_file, write_scene};
