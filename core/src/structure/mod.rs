//! Structure: what holds units together, or lets one deform.
//!
//! | file | does |
//! |---|---|
//! | `stage` | what a structure does in a step |
//! | `heading` | the heading that a model of a robot sees a scene from |
//! | `joints`, `link`, `hinge` | units that share a joint, what a unit keeps of that, and where it is |
//! | `articulation` | inertia of what hangs together, for the solver |
//! | `bonds`, `member` | units that move as one body, and what a unit keeps of that |
//! | `breaking` | which bonds break in a step |
//! | `soft`, `soft_points` | units that deform, and their state |

pub(crate) mod heading;
mod stage;

#[cfg(feature = "robot")]
pub(crate) mod articulation;
#[cfg(feature = "deform")]
pub(crate) mod bonds;
#[cfg(feature = "deform")]
pub(crate) mod breaking;
#[cfg(feature = "robot")]
pub(crate) mod hinge;
#[cfg(feature = "robot")]
pub(crate) mod joints;
#[cfg(feature = "robot")]
pub(crate) mod link;
#[cfg(feature = "deform")]
pub(crate) mod member;
#[cfg(feature = "deform")]
pub(crate) mod soft;
#[cfg(feature = "deform")]
pub(crate) mod soft_points;

#[cfg(feature = "robot")]
pub(crate) use joints::Joints;
#[cfg(not(feature = "robot"))]
pub(crate) use stage::Absent as Joints;
#[cfg(not(feature = "deform"))]
pub(crate) use stage::{Absent as Bonds, Absent as SoftBodies};
pub(crate) use stage::{Attempt, Structure};
#[cfg(feature = "deform")]
pub(crate) use {bonds::Bonds, soft::SoftBodies};
