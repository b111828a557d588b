//! Kernels for Cortex-M7, M4F and M33: SMLAD for int8, VLDM and VMLA for f32. Which
//! instructions there are is for `build.rs` to say; docs/CORTEX-M.md describes the layouts and
//! has the counts.

/// First line of each function in assembly. Whole functions are assembled apart from the crate's
/// flags; they follow the procedure call standard for floats in registers. Blocks inside
/// functions would not do: rustc has no registers for an FPU without double precision.
macro_rules! target {
    () => {
        env!("RIGIDFORMER_ASSEMBLE_FOR")
    };
}

mod elementwise;
mod near;
mod pool;
mod product;
mod wide;

use super::arithmetic::{Kernels, Rows};
use crate::geometry::Pose;
use crate::limits::ANCHORS;
use crate::math::sqrt;
use crate::quant::Scratch;
use half::f16;
use nalgebra::{Point3, Vector3};

/// Inputs up to which f16 weights are widened a channel at a time, on the stack.
const WIDENED: usize = 256;

/// Cortex-M with the DSP extension and a single-precision FPU.
#[derive(Clone, Copy, Debug, Default)]
pub struct CortexM;

/// The scratch as whole words; as many as its alignment leaves.
#[allow(unsafe_code)]
fn words(values: &mut [i8]) -> &mut [u32] {
    // SAFETY: any four bytes are a u32 and the other way around.
    let (_, words, _) = unsafe { values.align_to_mut() };
    words
}

impl Kernels for CortexM {
    const NAME: &'static str = "cortex-m";
    const CULL: bool = false;

    fn linear_f32(self, x: &[f32], weight: &[f32], bias: &[f32], inputs: usize, out: &mut [f32]) {
        let inputs = inputs.max(1);
        let outputs = (weight.len() / inputs).max(1);
        for (n, w) in weight.chunks_exact(inputs).enumerate() {
            channel(x, w, bias.get(n).copied().unwrap_or(0.0), n, outputs, out);
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
            channel(x, wide, bias.get(n).copied().unwrap_or(0.0), n, outputs, out);
        }
    }

    fn quantise(self, x: &[f32], inputs: usize, scratch: &mut Scratch<'_>) {
        let inputs = inputs.max(1);
        let mut panels = words(scratch.values).chunks_exact_mut(product::row_words(inputs).max(1));
        for (pair, panel) in x.chunks(inputs.saturating_mul(2)).zip(panels.by_ref()) {
            let (first, second) = pair.split_at(inputs.min(pair.len()));
            product::quantise(first, panel, false);
            // Without a second row its half is what it was; nobody reads what comes of it.
            if !second.is_empty() {
                product::quantise(second, panel, true);
            }
        }
    }

    fn linear_i8(
        self,
        scratch: &mut Scratch<'_>,
        weight: Rows<'_>,
        bias: &[f32],
        inputs: usize,
        out: &mut [f32],
    ) {
        product::product(words(scratch.values), weight, bias, inputs, out);
    }

    fn dot_f32(self, lhs: &[f32], rhs: &[f32]) -> f32 {
        wide::dot(lhs, rhs)
    }

    fn mix(self, weights: &[f32], values: &[f32], stride: usize, out: &mut [f32]) {
        wide::mix(weights, values, stride, out);
    }

    fn rms_norm(self, x: &mut [f32], weight: &[f32], eps: f32) {
        let mean = wide::dot(x, x) / weight.len() as f32;
        elementwise::scale(x, weight, 1.0 / sqrt(mean + eps));
    }

    fn silu(self, x: &mut [f32]) {
        elementwise::silu(x);
    }

    fn normalise(self, x: &mut [f32], mean: &[f32], scale: &[f32], limit: f32) {
        elementwise::normalise(x, mean, scale, limit);
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
}

/// One channel of an f32 product, into column n of `out`.
fn channel(x: &[f32], w: &[f32], bias: f32, n: usize, outputs: usize, out: &mut [f32]) {
    let rows = (out.len() / outputs).min(x.len() / w.len().max(1));
    let (even, last) = x.split_at((rows / 2 * 2 * w.len()).min(x.len()));
    wide::multiply(even, w, bias, out.get_mut(n..).unwrap_or_default(), outputs);
    if !rows.is_multiple_of(2)
        && let Some(slot) = out.get_mut((rows - 1) * outputs + n)
    {
        *slot = wide::dot(last.get(..w.len()).unwrap_or_default(), w) + bias;
    }
}
