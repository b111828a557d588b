//! Linear layers over any storage, and the small networks made of them.

use super::silu_in_place;
use crate::config::QUANT_TILE;
use crate::kernels::{Kernels, Rows};
use crate::quant::Scratch;
use half::f16;

/// How a layer's weights are stored: data, not code, so that the float reference and the
/// quantised models share one forward pass.
#[derive(Clone, Copy, Debug)]
pub(crate) enum Storage<'w> {
    /// (outputs, inputs)
    F32(&'w [f32]),
    /// (outputs, inputs)
    F16(&'w [f16]),
    /// (outputs, inputs) and a scale per output
    I8(Rows<'w>),
}

/// y = x Wᵀ + b
#[derive(Clone, Copy, Debug)]
pub(crate) struct Linear<'w> {
    pub(crate) weight: Storage<'w>,
    /// (outputs), or empty
    pub(crate) bias: &'w [f32],
    pub(crate) inputs: usize,
    pub(crate) outputs: usize,
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
        let inputs = self.inputs.max(1);
        match self.weight {
            Storage::F32(weight) => kernels.linear_f32(x, weight, self.bias, inputs, out),
            Storage::F16(weight) => kernels.linear_f16(x, weight, self.bias, inputs, out),
            Storage::I8(weight) => {
                let tiles = x.chunks(inputs * QUANT_TILE);
                for (x, out) in tiles.zip(out.chunks_mut(self.outputs.max(1) * QUANT_TILE)) {
                    let slots =
                        scratch.values.chunks_exact_mut(inputs).zip(scratch.scales.iter_mut());
                    let mut count = 0;
                    for (row, (values, scale)) in x.chunks_exact(inputs).zip(slots) {
                        *scale = kernels.quantise_row(row, values);
                        count += 1;
                    }
                    let rows = Rows {
                        values: scratch.values.get(..count * inputs).unwrap_or_default(),
                        scales: scratch.scales.get(..count).unwrap_or_default(),
                    };
                    kernels.linear_i8(rows, weight, self.bias, inputs, out);
                }
            }
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
        scratch: &mut Scratch<'_>,
    ) {
        self.first.apply(kernels, x, hidden, scratch);
        silu_in_place(hidden);
        self.second.apply(kernels, hidden, out, scratch);
    }
}

/// Feature-wise modulation: its network gives gains, then biases.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Film<'w> {
    pub(crate) mlp: Mlp<'w>,
}
