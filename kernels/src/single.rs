//! One thread of a host: its kernels, and buffers as large as its caches like them.

use rigidformer_core::quant::Scratch;
use rigidformer_core::weights::Panels;
use rigidformer_core::{Layout, Schedule, Tiles};

use crate::columns::Columns;
use crate::host::{HostKernels, Quantised};

/// Rows that hosts take at a time, on one thread.
// Caches of hosts are large, so weights are read from memory once for many rows.
pub const TILES: Tiles = Tiles { points: 128, anchor_units: 256, rows: 256, workers: 1 };

/// Kernels `K` on the calling thread. [`Kernel::run`](crate::Kernel::run) gives a value of `K`.
///
/// ```
/// use rigidformer_core::Schedule;
/// use rigidformer_kernels::{HostKernels, Kernel, Run, Single};
///
/// struct Queries;
/// impl Run for Queries {
///     type Output = usize;
///     fn run<K: HostKernels>(self, _: K) -> usize {
///         Single::<K>::LAYOUT.queries
///     }
/// }
/// assert_eq!(Kernel::Portable.run(Queries), Some(1));
/// ```
#[derive(Clone, Copy, Debug)]
pub struct Single<K>(pub K);

impl<K: HostKernels> Schedule for Single<K> {
    type Kernels = K;
    const LAYOUT: Layout = Layout { tiles: TILES, queries: K::QUERIES, index: true };

    fn kernels(self) -> K {
        self.0
    }

    fn linear_panels(
        self,
        scratch: &mut Scratch<'_>,
        weight: Panels<'_>,
        bias: &[f32],
        inputs: usize,
        out: &mut [f32],
    ) {
        let x = Quantised { values: scratch.values, scales: scratch.scales, inputs };
        self.0.multiply(x, weight, bias, Columns::new(out, weight.scales.len()));
    }

    fn skips(self) -> bool {
        true
    }
}
