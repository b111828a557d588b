//! What each fuzz target does with an input. libFuzzer makes inputs in `fuzz`; tests/replay.rs hands in those that are kept.
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic, clippy::missing_panics_doc)]

pub mod c_calls;
pub mod export_file;
#[cfg(feature = "files")]
mod files;
#[cfg(feature = "program")]
pub mod identify;
pub mod kernels_step;
pub mod model_file;
pub mod observe_step;
#[cfg(feature = "program")]
pub mod own_files;
#[cfg(feature = "program")]
pub mod pieces;
#[cfg(feature = "files")]
pub mod recording;
#[cfg(feature = "files")]
pub mod robot;
pub mod scene_file;
#[cfg(feature = "program")]
pub mod shown;
pub mod snapshot;
pub mod soft_step;
mod structured;
#[cfg(feature = "files")]
pub mod trace_file;
#[cfg(feature = "files")]
pub mod tracker;
