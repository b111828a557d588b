//! The portable kernels: the definition of all others, in plain Rust.

use super::arithmetic::{Kernels, LANES, Rows, add_lanes};
use crate::quant::Scratch;
use half::f16;
#[cfg(rigidformer_host)]
use rigidformer_weights::{PANEL, PANEL_DEPTH, Panels};

/// Plain Rust, for every target.
#[derive(Clone, Copy, Debug, Default)]
pub struct Portable;

/// Rows of x that one pass over a weight row serves.
const ROW_TILE: usize = 4;

fn accumulate(sum: &mut [f32; LANES], lhs: &[f32], rhs: &[f32]) {
    for ((s, a), b) in sum.iter_mut().zip(lhs).zip(rhs) {
        *s += a * b;
    }
}

/// A stored weight and its exact value.
trait Weight: Copy {
    fn widen(self) -> f32;
}

impl Weight for f32 {
    fn widen(self) -> f32 {
        self
    }
}

impl Weight for f16 {
    fn widen(self) -> f32 {
        self.to_f32()
    }
}

/// Products of `N` rows of x with one weight row.
#[inline(always)]
fn dot_rows<const N: usize, W: Weight>(rows: [&[f32]; N], weight: &[W]) -> [f32; N] {
    let mut sums = [[0.0_f32; LANES]; N];
    let mut chunks = rows.map(|row| row.chunks_exact(LANES));
    let mut weights = weight.chunks_exact(LANES);
    for w in weights.by_ref() {
        let mut wide = [0.0_f32; LANES];
        for (wide, w) in wide.iter_mut().zip(w) {
            *wide = w.widen();
        }
        for (sum, chunk) in sums.iter_mut().zip(chunks.iter_mut()) {
            if let Some(x) = chunk.next() {
                accumulate(sum, x, &wide);
            }
        }
    }
    let mut wide = [0.0_f32; LANES];
    for (wide, w) in wide.iter_mut().zip(weights.remainder()) {
        *wide = w.widen();
    }
    for (sum, chunk) in sums.iter_mut().zip(chunks.iter()) {
        accumulate(sum, chunk.remainder(), &wide);
    }
    sums.map(add_lanes)
}

/// The definition of `linear_f32` and `linear_f16`.
#[inline(always)]
fn linear_wide<W: Weight>(x: &[f32], weight: &[W], bias: &[f32], inputs: usize, out: &mut [f32]) {
    let inputs = inputs.max(1);
    let outputs = (weight.len() / inputs).max(1);
    let bias_of = |n: usize| bias.get(n).copied().unwrap_or(0.0);
    // Saturating, so that the compiler knows that no length is zero.
    let tile = |width: usize| width.saturating_mul(ROW_TILE);
    let tiles = x.chunks(tile(inputs)).zip(out.chunks_mut(tile(outputs)));
    for (x, out) in tiles {
        let mut rows = x.chunks_exact(inputs);
        if let (Some(a), Some(b), Some(c), Some(d)) =
            (rows.next(), rows.next(), rows.next(), rows.next())
        {
            let (out_a, rest) = out.split_at_mut(outputs.min(out.len()));
            let (out_b, rest) = rest.split_at_mut(outputs.min(rest.len()));
            let (out_c, out_d) = rest.split_at_mut(outputs.min(rest.len()));
            let outs = out_a.iter_mut().zip(out_b).zip(out_c).zip(out_d);
            for (n, (w, (((oa, ob), oc), od))) in weight.chunks_exact(inputs).zip(outs).enumerate()
            {
                let bias = bias_of(n);
                let [ra, rb, rc, rd] = dot_rows([a, b, c, d], w);
                *oa = ra + bias;
                *ob = rb + bias;
                *oc = rc + bias;
                *od = rd + bias;
            }
        } else {
            for (row, out) in x.chunks_exact(inputs).zip(out.chunks_mut(outputs)) {
                for (n, (w, o)) in weight.chunks_exact(inputs).zip(out).enumerate() {
                    let [r] = dot_rows([row], w);
                    *o = r + bias_of(n);
                }
            }
        }
    }
}

/// The definition of `linear_panels`.
#[cfg(rigidformer_host)]
#[inline(always)]
fn linear_panels(
    scratch: &Scratch<'_>,
    weight: Panels<'_>,
    bias: &[f32],
    inputs: usize,
    out: &mut [f32],
) {
    let (inputs, outputs) = (inputs.max(1), weight.scales.len().max(1));
    let (groups, _) = weight.values.as_chunks::<{ PANEL * PANEL_DEPTH }>();
    let rows = scratch.values.chunks_exact(inputs).zip(scratch.scales.iter());
    for ((row, row_scale), out) in rows.zip(out.chunks_exact_mut(outputs)) {
        let panels = groups.chunks(inputs.div_ceil(PANEL_DEPTH));
        let columns = out.chunks_mut(PANEL).zip(weight.scales.chunks(PANEL));
        for (n, (panel, (out, scales))) in panels.zip(columns).enumerate() {
            let mut sums = [0_i32; PANEL];
            for (group, x) in panel.iter().zip(row.chunks(PANEL_DEPTH)) {
                let (lanes, _) = group.as_chunks::<PANEL_DEPTH>();
                for (sum, lane) in sums.iter_mut().zip(lanes) {
                    for (w, x) in lane.iter().zip(x) {
                        *sum += i32::from(*w) * i32::from(*x);
                    }
                }
            }
            for (lane, ((o, sum), scale)) in out.iter_mut().zip(sums).zip(scales).enumerate() {
                let bias = bias.get(n * PANEL + lane).copied().unwrap_or(0.0);
                *o = sum as f32 * (row_scale * scale) + bias;
            }
        }
    }
}

/// Exact sum of products of two int8 slices.
fn dot_i8(lhs: &[i8], rhs: &[i8]) -> i32 {
    lhs.iter().zip(rhs).fold(0_i32, |sum, (a, b)| sum + i32::from(*a) * i32::from(*b))
}

impl Kernels for Portable {
    const NAME: &'static str = "portable";
    #[cfg(rigidformer_host)]
    // One lane at a time is slower than contacts alone; tests compare both.
    const SWEEPS: bool = cfg!(test);

    fn linear_f32(self, x: &[f32], weight: &[f32], bias: &[f32], inputs: usize, out: &mut [f32]) {
        linear_wide(x, weight, bias, inputs, out);
    }

    fn linear_f16(self, x: &[f32], weight: &[f16], bias: &[f32], inputs: usize, out: &mut [f32]) {
        linear_wide(x, weight, bias, inputs, out);
    }

    fn quantise(self, x: &[f32], inputs: usize, scratch: &mut Scratch<'_>) {
        let inputs = inputs.max(1);
        let slots = scratch.values.chunks_exact_mut(inputs).zip(scratch.scales.iter_mut());
        for (row, (values, scale)) in x.chunks_exact(inputs).zip(slots) {
            *scale = crate::quant::quantise_row(row, values);
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
        let inputs = inputs.max(1);
        let outputs = weight.scales.len().max(1);
        let rows = scratch.values.chunks_exact(inputs).zip(scratch.scales.iter());
        for ((row, row_scale), out) in rows.zip(out.chunks_exact_mut(outputs)) {
            let channels = weight.values.chunks_exact(inputs).zip(weight.scales);
            for (n, ((w, scale), o)) in channels.zip(out).enumerate() {
                let bias = bias.get(n).copied().unwrap_or(0.0);
                *o = dot_i8(row, w) as f32 * (row_scale * scale) + bias;
            }
        }
    }

    #[cfg(rigidformer_host)]
    fn linear_panels(
        self,
        scratch: &mut Scratch<'_>,
        weight: Panels<'_>,
        bias: &[f32],
        inputs: usize,
        out: &mut [f32],
    ) {
        linear_panels(scratch, weight, bias, inputs, out);
    }

    fn dot_f32(self, lhs: &[f32], rhs: &[f32]) -> f32 {
        let [sum] = dot_rows([lhs], rhs);
        sum
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::quant::{self, TILE, scratch_bytes};

    fn series(n: usize, seed: u32) -> heapless::Vec<f32, 4096> {
        let mut state = seed;
        (0..n)
            .map(|_| {
                state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
                (state >> 8) as f32 / (1 << 23) as f32 - 1.0
            })
            .collect()
    }

    /// Sizes straddle each tile; the oracle is a triple loop in f64.
    #[test]
    fn linear_matches_a_triple_loop() {
        for m in [0, 1, 3, 4, 5, 8, 9] {
            for k in [1, 7, 8, 9, 34, 64] {
                for n in [1, 3, 8, 13] {
                    let x = series(m * k, 1);
                    let w = series(n * k, 2);
                    let bias = series(n, 3);
                    let mut out = [f32::NAN; 128];
                    Portable.linear_f32(&x, &w, &bias, k, &mut out[..m * n]);
                    for i in 0..m {
                        for j in 0..n {
                            let exact: f64 = (0..k)
                                .map(|p| f64::from(x[i * k + p]) * f64::from(w[j * k + p]))
                                .sum::<f64>()
                                + f64::from(bias[j]);
                            let error = (f64::from(out[i * n + j]) - exact).abs();
                            assert!(error < 1e-5, "{m}x{k}x{n} at {i},{j}: {error}");
                        }
                    }
                }
            }
        }
    }

    /// A row's result does not depend on which rows it is computed with.
    #[test]
    fn tiles_do_not_change_bits() {
        let (k, n) = (34, 13);
        let x = series(7 * k, 4);
        let w = series(n * k, 5);
        let mut together = [0.0; 7 * 13];
        Portable.linear_f32(&x, &w, &[], k, &mut together);
        for i in 0..7 {
            let mut alone = [0.0; 13];
            Portable.linear_f32(&x[i * k..(i + 1) * k], &w, &[], k, &mut alone);
            assert_eq!(
                alone.map(f32::to_bits),
                core::array::from_fn(|j| together[i * n + j].to_bits())
            );
        }
    }

    /// f16 weights compute what their widened values compute, bit for bit.
    #[test]
    fn f16_equals_its_widened_weights() {
        let (m, k, n) = (5, 34, 7);
        let x = series(m * k, 6);
        let half: heapless::Vec<f16, 4096> =
            series(n * k, 7).iter().map(|w| f16::from_f32(*w)).collect();
        let wide: heapless::Vec<f32, 4096> = half.iter().map(|w| w.to_f32()).collect();
        let bias = series(n, 8);
        let (mut a, mut b) = ([0.0; 35], [1.0; 35]);
        Portable.linear_f16(&x, &half, &bias, k, &mut a);
        Portable.linear_f32(&x, &wide, &bias, k, &mut b);
        assert_eq!(a.map(f32::to_bits), b.map(f32::to_bits));
    }

    /// int8 products are exact: the same epilogue on an i64 triple loop gives the same bits.
    #[test]
    fn int8_matches_a_triple_loop() {
        for (m, k, n) in [(0, 8, 3), (1, 1, 1), (3, 7, 5), (4, 64, 13), (5, 130, 9)] {
            let rows = series(m * k, 9);
            let weights = series(n * k, 10);
            let bias = series(n, 11);
            let (mut x, mut w) = ([0_i8; 4096], [0_i8; 4096]);
            let (mut x_scales, mut w_scales) = ([0.0; 16], [0.0; 16]);
            for (i, scale) in x_scales.iter_mut().enumerate().take(m) {
                let at = i * k..(i + 1) * k;
                *scale = quant::quantise_row(&rows[at.clone()], &mut x[at]);
            }
            for (j, scale) in w_scales.iter_mut().enumerate().take(n) {
                let at = j * k..(j + 1) * k;
                *scale = quant::quantise_row(&weights[at.clone()], &mut w[at]);
            }
            let mut out = [f32::NAN; 256];
            let (mut values, mut scales) = ([0; scratch_bytes(130, TILE)], [0.0; TILE]);
            let mut scratch = Scratch { values: &mut values, scales: &mut scales };
            Portable.quantise(&rows, k, &mut scratch);
            let weight = Rows { values: &w[..n * k], scales: &w_scales[..n] };
            Portable.linear_i8(&mut scratch, weight, &bias, k, &mut out[..m * n]);
            for i in 0..m {
                for j in 0..n {
                    let products =
                        (0..k).map(|p| i64::from(x[i * k + p]) * i64::from(w[j * k + p]));
                    let sum: i64 = products.sum();
                    let expected = sum as f32 * (x_scales[i] * w_scales[j]) + bias[j];
                    assert_eq!(out[i * n + j].to_bits(), expected.to_bits(), "{m}x{k}x{n}");
                }
            }
        }
    }
}
