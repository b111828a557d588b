//! Kernels of this processor, found at run time. Each equals the portable ones of the core bit by bit, so a choice
//! among them is one of speed alone.
//!
//! A value of a kernel type is the proof that the processor can run it: only `detect` makes one.

#[cfg(all(target_arch = "aarch64", target_endian = "little"))]
pub mod aarch64;
mod columns;
mod threads;
#[cfg(target_arch = "x86_64")]
pub mod x86;

use std::fmt;
use std::str::FromStr;

use rigidformer_core::quant::Scratch;
use rigidformer_core::weights::{PANEL, PANEL_DEPTH, Panels};
use rigidformer_core::{Kernels, Portable, Tiles};

pub use columns::Columns;
pub use threads::{Threaded, Threads};

/// Environment variable that forces a kernel, such as `RIGIDFORMER_KERNEL=portable`.
pub const VARIABLE: &str = "RIGIDFORMER_KERNEL";

/// What hosts take at a time: caches are large, reading weights again is not cheap.
pub const TILES: Tiles =
    Tiles { points: 128, anchor_units: 256, rows: 256, workers: threads::MOST };

/// Kernels by name, fastest last.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
#[non_exhaustive]
pub enum Kernel {
    /// Plain Rust, everywhere.
    Portable,
    /// x86-64 with AVX2 and F16C: products of 16-bit pairs.
    Avx2,
    /// x86-64 with AVX-VNNI.
    AvxVnni,
    /// x86-64 with AVX-512 VNNI.
    Avx512Vnni,
    /// Any aarch64.
    Neon,
    /// aarch64 with SDOT (Armv8.2 dot product).
    Sdot,
}

impl Kernel {
    /// All, on whatever processor.
    pub const ALL: [Kernel; 6] = [
        Kernel::Portable,
        Kernel::Avx2,
        Kernel::AvxVnni,
        Kernel::Avx512Vnni,
        Kernel::Neon,
        Kernel::Sdot,
    ];

    /// As in [`VARIABLE`].
    pub fn name(self) -> &'static str {
        match self {
            Kernel::Portable => "portable",
            Kernel::Avx2 => "avx2",
            Kernel::AvxVnni => "avx-vnni",
            Kernel::Avx512Vnni => "avx512-vnni",
            Kernel::Neon => "neon",
            Kernel::Sdot => "sdot",
        }
    }

    /// Those that this processor can run, fastest last.
    ///
    /// ```
    /// use rigidformer_runtime::kernels::Kernel;
    /// assert_eq!(Kernel::available()[0], Kernel::Portable);
    /// ```
    pub fn available() -> Vec<Kernel> {
        struct Probe;
        impl Run for Probe {
            type Output = ();
            fn run<K: HostKernels>(self, _: K) {}
        }
        Kernel::ALL.into_iter().filter(|kernel| kernel.run(Probe).is_some()).collect()
    }

    /// The one that [`VARIABLE`] names, else the fastest of this processor.
    ///
    /// # Errors
    /// [`KernelError`] where the variable names none, or one that this processor cannot run.
    pub fn chosen() -> Result<Kernel, KernelError> {
        let available = Kernel::available();
        let Some(name) = std::env::var_os(VARIABLE).filter(|name| !name.is_empty()) else {
            return Ok(available.last().copied().unwrap_or(Kernel::Portable));
        };
        let kernel: Kernel = name.to_string_lossy().parse()?;
        if available.contains(&kernel) { Ok(kernel) } else { Err(KernelError::Lacking { kernel }) }
    }

    /// Runs `task` with a value of these kernels, or returns `None` where the processor lacks them.
    pub fn run<R: Run>(self, task: R) -> Option<R::Output> {
        match self {
            Kernel::Portable => Some(task.run(Portable)),
            #[cfg(target_arch = "x86_64")]
            Kernel::Avx2 => Some(task.run(x86::Avx2::detect()?)),
            #[cfg(target_arch = "x86_64")]
            Kernel::AvxVnni => Some(task.run(x86::AvxVnni::detect()?)),
            #[cfg(target_arch = "x86_64")]
            Kernel::Avx512Vnni => Some(task.run(x86::Avx512Vnni::detect()?)),
            #[cfg(all(target_arch = "aarch64", target_endian = "little"))]
            Kernel::Neon => Some(task.run(aarch64::Neon::detect()?)),
            #[cfg(all(target_arch = "aarch64", target_endian = "little"))]
            Kernel::Sdot => Some(task.run(aarch64::Sdot::detect()?)),
            #[allow(unreachable_patterns)]
            _ => None,
        }
    }
}

impl fmt::Display for Kernel {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.pad(self.name())
    }
}

impl FromStr for Kernel {
    type Err = KernelError;

    fn from_str(name: &str) -> Result<Self, KernelError> {
        let unknown = || KernelError::Unknown { name: name.into() };
        Kernel::ALL.into_iter().find(|kernel| kernel.name() == name).ok_or_else(unknown)
    }
}

/// Does `rounds` rounds of int8 multiply-accumulates on registers alone, as fast as this processor can: what a product
/// may come to at most. How many a round has, or `None` where that is not known.
pub fn ceiling(rounds: u64) -> Option<u64> {
    #[cfg(target_arch = "x86_64")]
    return x86::ceiling(rounds);
    #[cfg(not(target_arch = "x86_64"))]
    {
        let _ = rounds;
        None
    }
}

/// Rows that kernels have quantised, in their own layout.
#[derive(Clone, Copy)]
pub struct Quantised<'a> {
    /// (rows, [`row_bytes`](HostKernels::row_bytes))
    pub values: &'a [i8],
    /// (rows) what one quantum stands for.
    pub scales: &'a [f32],
    /// Numbers in a row.
    pub inputs: usize,
}

/// Kernels whose int8 products can be shared out by output channel.
pub trait HostKernels: Kernels + Send {
    /// Bytes that a quantised row of so many inputs takes.
    fn row_bytes(self, inputs: usize) -> usize;

    /// [`Kernels::linear_panels`] for the output channels of `weight` and `bias` (all empty, or one a channel), into as
    /// many columns and for as many rows as `out` has.
    fn multiply(self, x: Quantised<'_>, weight: Panels<'_>, bias: &[f32], out: Columns<'_>);
}

impl HostKernels for Portable {
    fn row_bytes(self, inputs: usize) -> usize {
        inputs
    }

    fn multiply(self, x: Quantised<'_>, weight: Panels<'_>, bias: &[f32], mut out: Columns<'_>) {
        let rows = x.values.chunks_exact(x.inputs.max(1)).zip(x.scales);
        for (index, (values, scale)) in rows.enumerate().take(out.rows()) {
            let mut row = values.to_vec();
            let mut scratch = Scratch { values: &mut row, scales: &mut [*scale] };
            self.linear_panels(&mut scratch, weight, bias, x.inputs, out.row(index));
        }
    }
}

/// Puts a matrix (rows, columns) of int8 in [`Panels`]: the values as (rows / 16 rounded up, columns / 4 rounded up, 16,
/// 4) with zeros where there is no row or column, and the sum of each row. A last row that is not whole counts as none.
///
/// ```
/// let (values, sums) = rigidformer_runtime::kernels::panels(&[1, 2, 3, 4, 5, 6], 2, 3);
/// assert_eq!(values[..12], [1, 2, 3, 0, 4, 5, 6, 0, 0, 0, 0, 0]);
/// assert_eq!((values.len(), sums), (64, vec![6, 15]));
/// ```
pub fn panels(values: &[i8], rows: usize, columns: usize) -> (Vec<i8>, Vec<i32>) {
    let groups = columns.div_ceil(PANEL_DEPTH);
    let mut panels = vec![0; rows.div_ceil(PANEL) * groups * PANEL * PANEL_DEPTH];
    let mut sums = vec![0; rows];
    let each = values.chunks_exact(columns.max(1)).zip(&mut sums).enumerate();
    for (row, (values, sum)) in each {
        *sum = values.iter().map(|value| i32::from(*value)).sum();
        for (group, values) in values.chunks(PANEL_DEPTH).enumerate() {
            let at = ((row / PANEL * groups + group) * PANEL + row % PANEL) * PANEL_DEPTH;
            panels[at..at + values.len()].copy_from_slice(values);
        }
    }
    (panels, sums)
}

/// Something to do with kernels whose type is known only at run time.
pub trait Run {
    /// What comes of it.
    type Output;

    /// Does it.
    fn run<K: HostKernels>(self, kernels: K) -> Self::Output;
}

/// Why a kernel cannot be used.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[non_exhaustive]
pub enum KernelError {
    /// No kernel has that name.
    #[error("no kernel is called {name:?}; {VARIABLE} is one of {}, or not set", names(&Kernel::ALL))]
    Unknown {
        /// The name.
        name: String,
    },
    /// The processor has not what it needs.
    #[error("this processor cannot run {kernel} kernels; {VARIABLE} is one of {}, or not set", names(&Kernel::available()))]
    Lacking {
        /// The kernel.
        kernel: Kernel,
    },
}

fn names(kernels: &[Kernel]) -> String {
    kernels.iter().map(|kernel| kernel.name()).collect::<Vec<_>>().join(", ")
}
