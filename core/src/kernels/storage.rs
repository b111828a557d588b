//! How a layer's weights are stored: data, not code, so that the float reference and the
//! quantised models share one forward pass. A new type is a variant here and a method of
//! [`Kernels`]; nothing else in this crate knows the types.

use super::{Kernels, Rows};
use crate::quant::{Scratch, TILE};
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
                let tile = |width: usize| width.saturating_mul(TILE).max(1);
                let outputs = weight.scales.len();
                let tiles = x.chunks(tile(inputs)).zip(out.chunks_mut(tile(outputs)));
                for (x, out) in tiles {
                    kernels.quantise(x, inputs, scratch);
                    kernels.linear_i8(scratch, *weight, bias, inputs, out);
                }
            }
        }
    }
}
