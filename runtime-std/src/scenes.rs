//! Recorded scenes: what the model is measured against.
//!
//! A scene file (`SCENES.md`) is one safetensors file with the scenes of one data set. [`Dataset::open`] reads it and
//! checks everything but the poses; [`Dataset::scene`] gives one scene as a [`RecordedScene`] after checking its poses.
//! [`write_scene`] writes a file with a single scene.

mod check;
mod dataset;
mod error;
mod read;
mod recorded;
mod write;

pub use dataset::Dataset;
pub use error::{Problem, SceneError};
pub use recorded::{RecordedScene, RecordedUnit, Split};
pub use write::{SceneNotes, write_scene};
