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
//!    [`observe_poses`](Simulator::observe_poses) known poses; [`Simulator::add`] takes one unit more. Units have a
//!    [`Role`] and a body; the scene has [planes](Plane), gravity and a time step.
//! 4. [`Simulator::step`] encodes each unit's points to a token, lets tokens attend to each
//!    other, lets anchors attend to tokens, integrates the anchors and fits the poses. Driven units go where
//!    [`Simulator::drive`] told them.
//! 5. [`Simulator::unit`] and [`Simulator::pose`] have the answer.
//!
//! Coordinates are right-handed, z up, SI units; the ground is the plane z = 0 unless [`Simulator::set_planes`] says
//! otherwise. A failed call leaves the scene as it was. `docs/MODEL.md` in the repository is the definition of
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

mod contact;
mod error;
pub mod geometry;
pub mod kernels;
mod limits;
pub mod math;
mod measure;
mod model;
mod network;
pub mod quant;
#[cfg(rigidformer_dsp)]
mod root;
mod scene;
mod share;
mod simulator;
mod sizes;
mod slabs;
mod slices;
mod stand_in;
mod structure;
mod trace;
mod workspace;

pub use contact::ground::Plane;
#[cfg(feature = "terrain")]
pub use contact::height_field::{HeightField, HeightFieldError, MAX_HEIGHTS};
pub use contact::law::{ContactLaw, FrictionLimit, NoContactLaw};
pub use contact::pieces::Pieces;
#[cfg(feature = "deform")]
pub use error::BondError;
#[cfg(feature = "robot")]
pub use error::JoinError;
pub use error::{
    CommandError, EditError, LoadError, ObserveError, SnapshotError, StepError, TensorId,
    WorkspaceError,
};
pub use kernels::{Kernels, Native, Portable, Schedule, Serial};
pub use limits::{
    ANCHORS, Layout, Limits, MAX_BLOCKS, MAX_COMMAND, MAX_COORDINATE_M, MAX_DRIVEN_M_S, MAX_PIECES,
    MAX_PLANES, MAX_SCALES, MAX_SUB_STEPS, POOL_LEVELS, SHORTEST_SOFT_STEP_S, SHORTEST_STEP_S,
    Tiles,
};
pub use model::Model;
pub use nalgebra;
pub use rigidformer_weights as weights;
#[cfg(feature = "deform")]
pub use scene::Soft;
pub use scene::{Compliance, Physics, Role, Unit, UnitId, UnitSlot};
#[cfg(rigidformer_host)]
pub use simulator::Uncorrected;
#[cfg(feature = "health")]
pub use simulator::{Excess, Health, HealthReport, InnovationError};
pub use simulator::{Observation, Observed, Posed, Simulator, StepReport, UnitView, Velocity};
pub use slabs::{Memory, SlabSizes, Slabs};
#[cfg(feature = "deform")]
pub use structure::bonds::Bond;
#[cfg(feature = "robot")]
pub use structure::joints::{Joint, JointAxis, JointKind};
pub use trace::{Layer, NoTrace, Stage, Trace};

/// Numbers of the f32 slab that each unit's room for bonds takes, in models whose motion is by impulses.
#[cfg(feature = "deform")]
pub const BOND_ROOM: usize = structure::bonds::ROOM;
