//! Kernels for Cortex-M with Helium (Cortex-M55, M85): VMLADAV for int8, vectors of four for f32.
//! docs/CORTEX-M.md describes them and has the counts.

/// First line of each function in assembly: whole functions are assembled apart from the crate's flags. They follow
/// the procedure call standard for floats in registers.
macro_rules! target {
    () => {
        env!("RIGIDFORMER_ASSEMBLE_FOR")
    };
}

mod elementwise;
mod flags;
mod near;
mod pool;
mod product;
mod wide;

use super::arithmetic::{Kernels, Rows};
use super::portable::Portable;
use crate::geometry::Pose;
use crate::limits::ANCHORS;
use crate::math::sqrt;
use crate::quant::Scratch;
use half::f16;
use nalgebra::{Point3, Vector3};

/// Inputs up to which f16 weights are widened a channel at a time, on the stack.
const WIDENED: usize = 256;

/// Cortex-M with Helium for integers and floats.
#[derive(Clone, Copy, Debug, Default)]
pub struct Helium;

/// The scratch as whole words; as many as its alignment leaves.
#[allow(unsafe_code)]
fn words(values: &mut [i8]) -> &mut [u32] {
    // SAFETY: any four bytes are a u32 and the other way around.
    let (_, words, _) = unsafe { values.align_to_mut() };
    words
}

impl Kernels for Helium {
    const NAME: &'static str = "helium";
    const CULL: bool = false;

    fn linear_f32(self, x: &[f32], weight: &[f32], bias: &[f32], inputs: usize, out: &mut [f32]) {
        let inputs = inputs.max(1);
        let outputs = (weight.len() / inputs).max(1);
        for (n, w) in weight.chunks_exact(inputs).enumerate() {
            wide::channel(x, w, bias.get(n).copied().unwrap_or(0.0), n, outputs, out);
        }
    }

    fn linear_f16(self, x: &[f32], weight: &[f16], bias: &[f32], inputs: usize, out: &mut [f32]) {
        let inputs = inputs.max(1);
        let outputs = (weight.len() / inputs).max(1);
        if inputs > WIDENED {
            for (row, out) in x.chunks_exact(inputs).zip(out.chunks_exact_mut(outputs)) {
                for (n, (w, out)) in weight.chunks_exact(inputs).zip(out).enumerate() {
                    *out = wide::dot_f16(row, w) + bias.get(n).copied().unwrap_or(0.0);
                }
            }
            return;
        }
        let mut wide = [0.0; WIDENED];
        let wide = wide.get_mut(..inputs).unwrap_or_default();
        for (n, w) in weight.chunks_exact(inputs).enumerate() {
            wide::widen(w, wide);
            wide::channel(x, wide, bias.get(n).copied().unwrap_or(0.0), n, outputs, out);
        }
    }

    fn quantise(self, x: &[f32], inputs: usize, scratch: &mut Scratch<'_>) {
        if inputs < product::BLOCK {
            return Portable.quantise(x, inputs, scratch);
        }
        product::quantise(words(scratch.values), x, inputs);
    }

    fn linear_i8(
        self,
        scratch: &mut Scratch<'_>,
        weight: Rows<'_>,
        bias: &[f32],
        inputs: usize,
        out: &mut [f32],
    ) {
        if inputs < product::BLOCK {
            return Portable.linear_i8(scratch, weight, bias, inputs, out);
        }
        product::product(words(scratch.values), weight, bias, inputs, out);
    }

    fn dot_f32(self, lhs: &[f32], rhs: &[f32]) -> f32 {
        wide::dot(lhs, rhs)
    }

    fn scores(self, query: &[f32], keys: &[f32], stride: usize, scale: f32, out: &mut [f32]) {
        wide::scores(query, keys, stride, scale, out);
    }

    fn mix(self, weights: &[f32], values: &[f32], stride: usize, out: &mut [f32]) {
        wide::mix(weights, values, stride, out);
    }

    fn rms_norm(self, x: &mut [f32], weight: &[f32], eps: f32) {
        let mean = wide::dot(x, x) / weight.len() as f32;
        elementwise::scale(x, weight, 1.0 / sqrt(mean + eps));
    }

    fn rotate(self, head: &mut [f32], cos: &[f32], sin: &[f32]) {
        elementwise::rotate(head, cos, sin);
    }

    fn gate(self, x: &mut [f32], share: f32, gate: &[f32]) {
        elementwise::gate(x, share, gate);
    }

    fn silu(self, x: &mut [f32]) {
        elementwise::silu(x);
    }

    fn normalise(self, x: &mut [f32], mean: &[f32], scale: &[f32], limit: f32) {
        elementwise::normalise(x, mean, scale, limit);
    }

    fn softmax(self, scores: &mut [f32]) -> f32 {
        elementwise::softmax(scores)
    }

    fn pool(self, x: &[f32], largest: &mut [f32], sum: &mut [f32]) {
        pool::pool(x, largest, sum);
    }

    fn weigh(self, x: &[f32], weights: &[[f32; ANCHORS]], out: &mut [f32]) {
        pool::weigh(x, weights, out);
    }

    #[inline]
    fn nearest(
        self,
        points: &[Point3<f32>],
        pose: &Pose,
        query: &Vector3<f32>,
        distance2: f32,
    ) -> Option<(usize, f32)> {
        near::nearest(points, pose, query, distance2)
    }

    fn first_at(
        self,
        points: &[Point3<f32>],
        pose: &Pose,
        query: &Vector3<f32>,
        from: usize,
        distance2: f32,
    ) -> usize {
        near::first_at(points, pose, query, from, distance2)
    }
}
