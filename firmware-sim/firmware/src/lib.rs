//! What the images of this folder share: memory, scenes, an instruction counter, a report.
//!
//! The images are in `src/bin`; `cargo xtask firmware` builds them for four boards, runs them under
//! QEMU and compares what they print with `src/bin/<image>.out` (`docs/FIRMWARE.md`).
#![no_std]

pub mod counter;
#[cfg(feature = "drape")]
pub mod drape;
#[cfg(feature = "health")]
pub mod health;
pub mod image;
pub mod memory;
pub mod rollout;
pub mod scene;
pub mod snapshot;
pub mod stack;
pub mod stages;
#[cfg(feature = "walk")]
pub mod walk;
pub mod workcell;

/// The model of the image `rollout`: nano, or the file that `RIGIDFORMER_MODEL` named at the build.
#[cfg(own_model)]
pub static MODEL: &rigidformer_weights::Aligned<[u8]> =
    rigidformer_weights::include_model!(env!("RIGIDFORMER_MODEL"));
#[cfg(not(own_model))]
pub use rigidformer_weights::NANO as MODEL;
