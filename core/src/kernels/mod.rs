//! Arithmetic and who does it: [`Kernels`] compute, a [`Schedule`] shares work out.

mod arithmetic;
mod attention;
#[cfg(rigidformer_dsp)]
mod cortex_m;
mod portable;
mod schedule;
mod storage;
mod together;

pub use arithmetic::{Kernels, LANES, Rows};
pub use attention::{Attention, Lanes, TOGETHER, scratch_numbers};
#[cfg(rigidformer_dsp)]
pub use cortex_m::CortexM;
/// The fastest kernels of this crate that the target this is compiled for is sure to have.
#[cfg(rigidformer_dsp)]
pub use cortex_m::CortexM as Native;
pub use portable::Portable;
/// The fastest kernels of this crate that the target this is compiled for is sure to have.
#[cfg(not(rigidformer_dsp))]
pub use portable::Portable as Native;
pub use schedule::{Divisible, Schedule, Serial};
pub(crate) use storage::Storage;
pub use together::attend_together;
