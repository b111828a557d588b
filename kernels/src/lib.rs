//! Kernels of this processor, found at run time. Each equals the portable ones of the core bit by bit, so a choice
//! among them is one of speed alone.
//!
//! A value of a kernel type is the proof that the processor can run it: only `detect` makes one.
//!
//! | module | for |
//! |---|---|
//! | `x86` | x86-64: AVX2, AVX-VNNI, AVX-512 VNNI, AMX |
//! | `aarch64` | Armv8: NEON, SDOT, SMMLA |

#[cfg(all(target_arch = "aarch64", target_endian = "little"))]
pub mod aarch64;
mod choice;
mod columns;
mod host;
mod panels;
mod single;
#[cfg(target_arch = "x86_64")]
pub mod x86;

pub use choice::{Kernel, KernelError, Run, VARIABLE};
pub use columns::Columns;
pub use host::{HostKernels, Quantised};
pub use panels::{PanelsError, has_rows, panels, to_panels};
pub use single::{Single, TILES};
