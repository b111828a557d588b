//! How a layer's weights are stored: data, not code, so that the float reference and the
//! quantised models share one forward pass. A new type is a variant here and a method of
//! [`Kernels`]; nothing else in this crate knows the types.

use super::{Kernels, Rows};
use crate::config::QUANT_TILE;
use crate::quant::Scratch;
use half::f16;
use rigidformer_weights::TensorData;

/// Weights of a linear layer, borrowed from the file.
#[derive(Clone, Copy, Debug)]
pub(crate) enum Storage<'w> {
    /// (outputs, inputs)
    F32(&'w [f32]),
    /// (outputs, inputs)
    F16(&'w [f16]),
    /// (outputs, inputs) and a scale per output
    I8(Rows<'w>),
}

impl<'w> From<TensorData<'w>> for Storage<'w> {
    fn from(data: TensorData<'w>) -> Self {
        match data {
            TensorData::F32(values) => Storage::F32(values),
            TensorData::F16(values) => Storage::F16(values),
            TensorData::I8 { values, scales } => Storage::I8(Rows { values, scales }),
        }
    }
}

impl Storage<'_> {
    /// x (rows, inputs) -> out (rows, outputs)
    pub(crate) fn apply<K: Kernels>(
        &self,
        kernels: K,
        x: &[f32],
        bias: &[f32],
        inputs: usize,
        out: &mut [f32],
        scratch: &mut Scratch<'_>,
    ) {
        match self {
            Storage::F32(weight) => kernels.linear_f32(x, weight, bias, inputs, out),
            Storage::F16(weight) => kernels.linear_f16(x, weight, bias, inputs, out),
            Storage::I8(weight) => {
                // Never zero, and so that the compiler knows.
                let tile = |width: usize| width.saturating_mul(QUANT_TILE).max(1);
                let outputs = weight.scales.len();
                let tiles = x.chunks(tile(inputs)).zip(out.chunks_mut(tile(outputs)));
                for (x, out) in tiles {
                    let rows = quantise_tile(kernels, x, inputs, scratch);
                    kernels.linear_i8(rows, *weight, bias, inputs, out);
                }
            }
        }
    }
}

/// Quantises up to [`QUANT_TILE`] rows into the scratch.
fn quantise_tile<'s, K: Kernels>(
    kernels: K,
    x: &[f32],
    inputs: usize,
    scratch: &'s mut Scratch<'_>,
) -> Rows<'s> {
    let inputs = inputs.max(1);
    let slots = scratch.values.chunks_exact_mut(inputs).zip(scratch.scales.iter_mut());
    let mut count = 0;
    for (row, (values, scale)) in x.chunks_exact(inputs).zip(slots) {
        *scale = kernels.quantise_row(row, values);
        count += 1;
    }
    Rows {
        values: scratch.values.get(..count * inputs).unwrap_or_default(),
        scales: scratch.scales.get(..count).unwrap_or_default(),
    }
}
