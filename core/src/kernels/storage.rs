//! How a layer's weights are stored: data, not code, so that the float reference and the
//! quantised models share one forward pass. A new type is a variant here and a method of
//! [`Kernels`](super::Kernels); nothing else in this crate knows the types.

use super::arithmetic::{Kernels, Rows};
use super::schedule::Schedule;
use crate::quant::Scratch;
use half::f16;
#[cfg(rigidformer_host)]
use rigidformer_weights::Panels;
use rigidformer_weights::TensorData;

/// Rows that are quantised together, and where their products go.
fn tiles<'t, S: Schedule>(
    x: &'t [f32],
    inputs: usize,
    out: &'t mut [f32],
    outputs: usize,
    scratch: &Scratch<'_>,
) -> impl Iterator<Item = (&'t [f32], &'t mut [f32])> + use<'t, S> {
    // Only parts of a host's workspace have less.
    let rows = if cfg!(rigidformer_host) { scratch.scales.len() } else { S::LAYOUT.tiles.rows };
    // Never zero, and so that the compiler knows.
    let tile = move |width: usize| width.saturating_mul(rows).max(1);
    x.chunks(tile(inputs)).zip(out.chunks_mut(tile(outputs)))
}

/// Weights of a linear layer, borrowed from the file.
#[derive(Clone, Copy, Debug)]
pub(crate) enum Storage<'w> {
    /// (outputs, inputs)
    F32(&'w [f32]),
    /// (outputs, inputs)
    F16(&'w [f16]),
    /// (outputs, inputs) and a scale per output
    I8(Rows<'w>),
    /// As `I8`, in panels
    #[cfg(rigidformer_host)]
    Panels(Panels<'w>),
}

impl<'w> Storage<'w> {
    /// Weights of a type that this build can read.
    pub(crate) fn new(data: TensorData<'w>) -> Option<Self> {
        Some(match data {
            TensorData::F32(values) => Storage::F32(values),
            TensorData::F16(values) => Storage::F16(values),
            TensorData::I8 { values, scales } => Storage::I8(Rows { values, scales }),
            #[cfg(rigidformer_host)]
            TensorData::Panels(panels) => Storage::Panels(panels),
            #[cfg(not(rigidformer_host))]
            TensorData::Panels(_) => return None,
        })
    }
}

impl Storage<'_> {
    /// x (rows, inputs) -> out (rows, outputs)
    pub(crate) fn apply<S: Schedule>(
        &self,
        schedule: S,
        x: &[f32],
        bias: &[f32],
        inputs: usize,
        out: &mut [f32],
        scratch: &mut Scratch<'_>,
    ) {
        match self {
            Storage::F32(weight) => schedule.linear_f32(x, weight, bias, inputs, out),
            Storage::F16(weight) => schedule.linear_f16(x, weight, bias, inputs, out),
            Storage::I8(weight) => {
                for (x, out) in tiles::<S>(x, inputs, out, weight.scales.len(), scratch) {
                    schedule.quantise(x, inputs, scratch);
                    schedule.kernels().linear_i8(scratch, *weight, bias, inputs, out);
                }
            }
            #[cfg(rigidformer_host)]
            Storage::Panels(weight) => {
                for (x, out) in tiles::<S>(x, inputs, out, weight.scales.len(), scratch) {
                    schedule.quantise(x, inputs, scratch);
                    schedule.linear_panels(scratch, *weight, bias, inputs, out);
                }
            }
        }
    }
}
