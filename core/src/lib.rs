//! RigidFormer from points to poses, without `std` or allocation, and without unsafe code but
//! for kernels in assembly.
//!
//! A transformer world model predicts how rigid bodies move from point sets (paper:
//! *RigidFormer: Learning Rigid Dynamics and Beyond with Transformers*). Each object or
//! robot part is one token; four anchors a unit carry the state; a rigid fit puts each unit
//! back on SE(3) after every step.
//!
//! The tour, in the order of the forward pass:
//!
//! 1. [`Model::load`] checks a packed file completely and views it in place.
//! 2. [`Simulator::new`] carves its buffers from slabs that the caller owns.
//! 3. [`Simulator::observe`] takes two frames of points, or
//!    [`observe_poses`](Simulator::observe_poses) known poses.
//! 4. [`Simulator::step`] encodes each unit's points to a token, lets tokens attend to each
//!    other, lets anchors attend to tokens, integrates the anchors and fits the poses.
//! 5. [`Simulator::pose`] is the answer.
//!
//! Coordinates are right-handed, z up, SI units; the ground is the plane z = 0. A failed
//! call leaves the scene as it was. `docs/MODEL.md` in the repository is the definition of
//! the model; section numbers in comments refer to it.
#![no_std]
#![deny(
    clippy::indexing_slicing,
    clippy::unwrap_used,
    clippy::expect_used,
    clippy::panic,
    clippy::unreachable
)]
#![cfg_attr(
    test,
    allow(clippy::indexing_slicing, clippy::unwrap_used, clippy::expect_used, clippy::panic)
)]

#[cfg(test)]
extern crate std;

mod anchors;
mod config;
mod encoder;
mod error;
mod features;
pub mod geometry;
mod ground;
mod impacts;
mod interaction;
pub mod kernels;
mod layers;
pub mod math;
mod model;
mod motion;
mod projection;
pub mod quant;
mod scene;
mod share;
mod simulator;
mod trace;
mod workspace;

pub use config::{
    ANCHORS, Limits, MAX_BLOCKS, MAX_COMMAND, MAX_COORDINATE_M, MAX_SCALES, POOL_LEVELS, SlabSizes,
    Tiles,
};
pub use error::{CommandError, LoadError, ObserveError, StepError, TensorId, WorkspaceError};
pub use ground::{MAX_PLANES, Plane};
pub use kernels::{Kernels, Native, Portable};
pub use model::Model;
pub use projection::{Projection, Rigid};
pub use rigidformer_weights as weights;
pub use scene::{Physics, Role, Unit};
pub use simulator::{Observation, Simulator, Slabs, StepReport};
pub use trace::{Layer, NoTrace, Stage, Trace};
