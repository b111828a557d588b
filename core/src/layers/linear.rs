//! Linear layers over any storage, and the small networks made of them.

use super::silu_in_place;
use crate::kernels::Kernels;

/// How a layer's weights are stored: data, not code, so that the float reference and the
/// quantised models share one forward pass.
#[derive(Clone, Copy, Debug)]
pub(crate) enum Storage<'w> {
    /// (outputs, inputs) f32
    F32(&'w [f32]),
}

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
    pub(crate) fn apply<K: Kernels>(&self, kernels: K, x: &[f32], out: &mut [f32]) {
        match self.weight {
            Storage::F32(weight) => kernels.linear_f32(x, weight, self.bias, self.inputs, out),
        }
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
    ) {
        self.first.apply(kernels, x, hidden);
        silu_in_place(hidden);
        self.second.apply(kernels, hidden, out);
    }
}

/// Feature-wise modulation: its network gives gains, then biases.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Film<'w> {
    pub(crate) mlp: Mlp<'w>,
}
