//! Who does the work: one thread, or several that share it out. No schedule divides a sum, so none changes a bit.

use super::arithmetic::Kernels;
use crate::limits::Layout;
use crate::quant::Scratch;
use half::f16;
#[cfg(rigidformer_host)]
use rigidformer_weights::Panels;

/// Work whose parts do not depend on each other, for [`Schedule::share`].
pub trait Divisible: Sized + Send {
    /// A part of `left` shares, and one of the rest of `of`; either may be empty.
    fn split(self, left: usize, of: usize) -> [Self; 2];
}

/// Runs the forward pass on kernels: all of it on one thread ([`Serial`]), or parts of it on several.
///
/// Operations that a schedule may share out are methods here; all others are called on its [`kernels`](Self::kernels).
pub trait Schedule: Copy + Sync {
    /// The arithmetic.
    type Kernels: Kernels;

    /// What it needs of a simulator's memory.
    const LAYOUT: Layout;

    /// The arithmetic.
    fn kernels(self) -> Self::Kernels;

    /// [`Kernels::linear_f32`]
    fn linear_f32(self, x: &[f32], weight: &[f32], bias: &[f32], inputs: usize, out: &mut [f32]) {
        self.kernels().linear_f32(x, weight, bias, inputs, out);
    }

    /// [`Kernels::linear_f16`]
    fn linear_f16(self, x: &[f32], weight: &[f16], bias: &[f32], inputs: usize, out: &mut [f32]) {
        self.kernels().linear_f16(x, weight, bias, inputs, out);
    }

    /// [`Kernels::quantise`]
    fn quantise(self, x: &[f32], inputs: usize, scratch: &mut Scratch<'_>) {
        self.kernels().quantise(x, inputs, scratch);
    }

    /// [`Kernels::linear_panels`]
    #[cfg(rigidformer_host)]
    fn linear_panels(
        self,
        scratch: &mut Scratch<'_>,
        weight: Panels<'_>,
        bias: &[f32],
        inputs: usize,
        out: &mut [f32],
    ) {
        self.kernels().linear_panels(scratch, weight, bias, inputs, out);
    }

    /// [`Kernels::silu`]
    fn silu(self, x: &mut [f32]) {
        self.kernels().silu(x);
    }

    /// Calls `fill` with the index, the row and scratch of its own for each row of `matrix`
    /// (rows, width; the last may be shorter), in any order and on any thread. `scratch` has a part for each of the
    /// [`LAYOUT`](Self::LAYOUT)'s workers; `cost` is about how many multiplications a row takes.
    fn each_row(
        self,
        matrix: &mut [f32],
        width: usize,
        cost: usize,
        scratch: &mut [f32],
        fill: impl Fn(usize, &mut [f32], &mut [f32]) + Sync,
    ) {
        let _ = cost;
        let (mut index, mut rest) = (0, matrix);
        while !rest.is_empty() {
            let width = width.clamp(1, rest.len());
            let (row, others) = rest.split_at_mut(width);
            fill(index, row, scratch);
            (index, rest) = (index + 1, others);
        }
    }

    /// Whether a step of a model whose motion is by impulses leaves out what nobody would read of it: the whole network where it
    /// corrects no unit of any copy, else the anchors of units that it does not correct. It corrects what something touches while it moves. Poses have the same bits. A step's time depends on the scene then; without, it
    /// takes about the same time for all.
    fn skips(self) -> bool {
        false
    }

    /// Whether [`share`](Self::share) is worth calling: on one thread there is nothing to share.
    fn shares(self) -> bool {
        false
    }

    /// Runs `run` on `whole`, or on parts of it on several threads, and merges the results; `work`
    /// is about how many multiplications it is.
    fn share<P: Divisible, R: Send>(
        self,
        work: usize,
        whole: P,
        run: &(impl Fn(Self, P) -> R + Sync),
        merge: &(impl Fn(R, R) -> R + Sync),
    ) -> R {
        let _ = (work, merge);
        run(self, whole)
    }
}

/// One thread.
#[derive(Clone, Copy, Debug, Default)]
pub struct Serial<K>(pub K);

impl<K: Kernels> Schedule for Serial<K> {
    type Kernels = K;
    const LAYOUT: Layout = Layout { queries: K::QUERIES, ..Layout::SMALL };

    fn kernels(self) -> K {
        self.0
    }
}
