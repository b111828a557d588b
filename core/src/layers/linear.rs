//! Linear layers over any storage, and the small networks made of them.

use crate::kernels::{Kernels, Storage};
use crate::quant::Scratch;

/// y = x Wᵀ + b
#[derive(Clone, Copy, Debug)]
pub(crate) struct Linear<'w> {
    pub(crate) weight: Storage<'w>,
    /// (outputs), or empty
    pub(crate) bias: &'w [f32],
    pub(crate) inputs: usize,
}

impl Linear<'_> {
    /// (rows, inputs) -> (rows, outputs)
    pub(crate) fn apply<K: Kernels>(
        &self,
        kernels: K,
        x: &[f32],
        out: &mut [f32],
        scratch: &mut Scratch<'_>,
    ) {
        self.weight.apply(kernels, x, self.bias, self.inputs.max(1), out, scratch);
    }
}

/// Linear, SiLU, linear.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Mlp<'w> {
    pub(crate) first: Linear<'w>,
    pub(crate) second: Linear<'w>,
}

impl Mlp<'_> {
    /// (rows, inputs) -> (rows, outputs), with the hidden rows in `hidden`.
    pub(crate) fn apply<K: Kernels>(
        &self,
        kernels: K,
        x: &[f32],
        hidden: &mut [f32],
        out: &mut [f32],
        scratch: &mut Scratch<'_>,
    ) {
        self.first.apply(kernels, x, hidden, scratch);
        kernels.silu(hidden);
        self.second.apply(kernels, hidden, out, scratch);
    }
}

/// Feature-wise modulation: its network gives gains, then biases.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Film<'w> {
    pub(crate) mlp: Mlp<'w>,
}
