//! The simulator: a scene and the model that advances it.
//!
//! | file | does |
//! |---|---|
//! | `state` | what a simulator holds, how it is made, and how its units are looked at |
//! | `observe` | a scene from two frames |
//! | `measure` | what a scene is measured in |
//! | `command` | changes between steps: units, commands, planes, gravity, time |
//! | `correction` | whether the network corrects motion, and what it corrects |
//! | `law` | how contacts bounce |
//! | `terrain` | ground of varying height |
//! | `velocity` | velocities of units, read and set |
//! | `bond` | bonds between units |
//! | `join` | joints between units |
//! | `step` | the forward pass and the rollout: the only file that composes blocks |
//! | `prepare`, `integrate` | its first stage, and the one that takes units where the network says |
//! | `report` | what a step did |
//! | `substeps` | steps longer than the model knows, in equal substeps |
//! | `quarantine` | units that diverge, held while the others go on |
//! | `health` | how far a unit is from what training saw |
//! | `copies` | copies of a scene that advance in lockstep |
//! | `hold` | units of single copies that are held where they are put |
//! | `snapshot` | the whole state as bytes, and back |

#[cfg(feature = "deform")]
mod bond;
mod command;
mod copies;
mod correction;
#[cfg(feature = "health")]
mod health;
#[cfg(feature = "health")]
mod hold;
mod integrate;
#[cfg(feature = "robot")]
mod join;
mod law;
mod measure;
mod observe;
mod prepare;
mod quarantine;
mod report;
mod snapshot;
mod state;
mod step;
mod substeps;
#[cfg(feature = "terrain")]
mod terrain;
mod units;
mod velocity;

#[cfg(rigidformer_host)]
pub use correction::Uncorrected;
#[cfg(feature = "health")]
pub use health::{Excess, Health, HealthReport, InnovationError};
pub use observe::{Observation, Observed, Posed};
pub use report::StepReport;
pub use state::Simulator;
pub use units::UnitView;
pub use velocity::Velocity;
