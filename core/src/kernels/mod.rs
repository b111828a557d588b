//! Arithmetic and who does it: [`Kernels`] compute, a [`Schedule`] shares work out.

mod arithmetic;
mod attention;
#[cfg(all(rigidformer_dsp, not(rigidformer_helium)))]
mod cortex_m;
mod environment;
mod goal;
#[cfg(rigidformer_helium)]
mod helium;
mod portable;
mod schedule;
mod storage;
#[cfg(rigidformer_host)]
mod sweep;
mod together;

pub use arithmetic::{Kernels, LANES, Rows};
pub use attention::{Attention, Lanes, TOGETHER, scratch_numbers};
#[cfg(all(rigidformer_dsp, not(rigidformer_helium)))]
pub use cortex_m::CortexM;
/// The fastest kernels of this crate that the target this is compiled for is sure to have.
#[cfg(all(rigidformer_dsp, not(rigidformer_helium)))]
pub use cortex_m::CortexM as Native;
pub use environment::in_own_environment;
pub use goal::Goal;
#[cfg(rigidformer_helium)]
pub use helium::Helium;
/// The fastest kernels of this crate that the target this is compiled for is sure to have.
#[cfg(rigidformer_helium)]
pub use helium::Helium as Native;
pub use portable::Portable;
/// The fastest kernels of this crate that the target this is compiled for is sure to have.
#[cfg(not(rigidformer_dsp))]
pub use portable::Portable as Native;
pub use schedule::{Divisible, Schedule, Serial};
pub(crate) use storage::Storage;
#[cfg(rigidformer_host)]
pub use sweep::{Block, Lane, Motion, Vector, WIDE, sweep};
#[cfg(rigidformer_host)]
pub(crate) use sweep::{FIELDS, NOBODY, at, put};
pub use together::attend_together;
