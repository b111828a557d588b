//! The arithmetic that targets may replace. [`Portable`] is the definition; every other
//! implementation must equal it bit for bit.

pub mod attention;
#[cfg(rigidformer_dsp)]
pub(crate) mod cortex_m;
mod storage;

use attention::{Attention, Lanes};
#[cfg(rigidformer_dsp)]
pub use cortex_m::CortexM;
pub(crate) use storage::Storage;

use crate::config::{ANCHORS, Tiles};
use crate::geometry::{Index, Pose};
use crate::math;
use crate::quant::Scratch;
use half::f16;
use nalgebra::{Point3, Vector3};
#[cfg(rigidformer_host)]
use rigidformer_weights::{PANEL, PANEL_DEPTH, Panels};

/// Lanes of every f32 reduction: lane j adds the elements j, j + 8, j + 16, ... in order,
/// then the lanes are added as ((0+4)+(2+6))+((1+5)+(3+7)).
pub const LANES: usize = 8;

/// int8 rows and what one quantum of each stands for.
#[derive(Clone, Copy, Debug)]
pub struct Rows<'a> {
    /// (rows, columns)
    pub values: &'a [i8],
    /// (rows)
    pub scales: &'a [f32],
}

/// Work that has parts which do not depend on each other, for [`Kernels::share`].
pub trait Divisible: Sized + Send {
    /// A part of `left` shares, and one of the rest of `of`; either may be empty.
    fn split(self, left: usize, of: usize) -> [Self; 2];
}

/// Matrix products and other inner loops.
///
/// A value of an implementation is the proof that the processor has what it needs.
pub trait Kernels: Copy + Sync {
    /// Name for tables and traces, such as `portable`.
    const NAME: &'static str;

    /// How much they take at a time.
    const TILES: Tiles = Tiles::SMALL;

    /// Whether the search for the nearest point passes over units that are too far away: less
    /// work, but how much depends on the scene. The answer does not.
    const CULL: bool = true;

    /// Whether the search for the nearest point goes through an [`Index`] of the points: far less
    /// work where there are many, for memory that [`SlabSizes::of`](crate::SlabSizes::of) counts.
    /// The answer is the same. Without one, [`nearest`](Self::nearest) looks at all points.
    const INDEX: bool = false;

    /// Queries that [`attend`](Self::attend) takes together; scratch grows with it.
    const QUERIES: usize = 1;

    /// out = x wᵀ + bias.
    ///
    /// - `x`: (rows, inputs) row-major
    /// - `weight`: (outputs, inputs) row-major
    /// - `bias`: (outputs), or empty
    /// - `out`: (rows, outputs) row-major
    ///
    /// Each element is one reduction over the inputs as [`LANES`] describes, then the bias.
    fn linear_f32(self, x: &[f32], weight: &[f32], bias: &[f32], inputs: usize, out: &mut [f32]);

    /// As [`linear_f32`](Self::linear_f32) with f16 weights, each widened exactly.
    fn linear_f16(self, x: &[f32], weight: &[f16], bias: &[f32], inputs: usize, out: &mut [f32]);

    /// Quantises the rows of `x` (rows, inputs) as
    /// [`quant::quantise_row`](crate::quant::quantise_row) does, for the
    /// [`linear_i8`](Self::linear_i8) of the same kernels: the layout is their own. Rows that
    /// the scratch has no room for are left out.
    fn quantise(self, x: &[f32], inputs: usize, scratch: &mut Scratch<'_>);

    /// out = x wᵀ + bias with int8 weights and the rows that were quantised last
    /// ([`quant`](crate::quant)), as many as `out` (rows, outputs) has: at most
    /// [`TILES`](Self::TILES)' rows.
    ///
    /// The products are summed exactly in i32 (inputs are at most 16,384 · 8, far from
    /// overflow); each element is `sum as f32 * (row scale * weight.scales) + bias`.
    fn linear_i8(
        self,
        scratch: &mut Scratch<'_>,
        weight: Rows<'_>,
        bias: &[f32],
        inputs: usize,
        out: &mut [f32],
    );

    /// As [`linear_i8`](Self::linear_i8) with weights in panels.
    #[cfg(rigidformer_host)]
    fn linear_panels(
        self,
        scratch: &mut Scratch<'_>,
        weight: Panels<'_>,
        bias: &[f32],
        inputs: usize,
        out: &mut [f32],
    );

    /// Calls `fill` with the index, the row and scratch of its own for each row of `matrix`
    /// (rows, width; the last may be shorter), in any order and on any thread. `scratch` has a part for each of
    /// [`TILES`](Self::TILES)' workers; `cost` is about how many multiplications a row takes, for
    /// kernels that share rows out.
    fn each_row(
        self,
        matrix: &mut [f32],
        width: usize,
        cost: usize,
        scratch: &mut [f32],
        fill: impl Fn(usize, &mut [f32], &mut [f32]) + Sync,
    ) {
        let _ = cost;
        for (index, row) in matrix.chunks_mut(width.max(1)).enumerate() {
            fill(index, row, scratch);
        }
    }

    /// Whether [`share`](Self::share) is worth calling: on one thread there is nothing to share.
    fn shares(self) -> bool {
        false
    }

    /// Runs `run` on `whole`, or on parts of it on several threads, and merges what comes back; `work`
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

    /// Sum of products of two slices of equal length, in the order of [`LANES`].
    fn dot_f32(self, lhs: &[f32], rhs: &[f32]) -> f32;

    /// Gated attention: for each query and head, `sigmoid(gate) * softmax(query keysᵀ /
    /// sqrt(head_dim)) values`. `scratch` has as many numbers as tokens, or
    /// [`scratch_numbers`](attention::scratch_numbers) for [`QUERIES`](Self::QUERIES) above 1.
    fn attend(self, attention: &Attention<'_>, scratch: &mut [f32], out: &mut [f32]) {
        attention::attend_each(self, attention, scratch, out);
    }

    /// Sum of products of two slices, times `scale`, for every row of `keys`: the rows begin
    /// `stride` numbers apart and are as wide as `query`; as many as `out` has.
    fn scores(self, query: &[f32], keys: &[f32], stride: usize, scale: f32, out: &mut [f32]) {
        for (out, key) in out.iter_mut().zip(keys.chunks(stride.max(1))) {
            *out = self.dot_f32(query, key.get(..query.len()).unwrap_or_default()) * scale;
        }
    }

    /// Sum of the rows of `values`, each times its weight, in order, into `out`: the rows begin
    /// `stride` numbers apart and are as wide as `out`.
    fn mix(self, weights: &[f32], values: &[f32], stride: usize, out: &mut [f32]) {
        out.fill(0.0);
        for (weight, value) in weights.iter().zip(values.chunks(stride.max(1))) {
            for (out, value) in out.iter_mut().zip(value) {
                *out += weight * value;
            }
        }
    }

    /// x becomes x divided by its root mean square, times `weight`: `(x * scale) * weight` with
    /// `scale = 1 / sqrt(mean of squares + eps)`.
    fn rms_norm(self, x: &mut [f32], weight: &[f32], eps: f32) {
        let mean = self.dot_f32(x, x) / weight.len() as f32;
        let scale = 1.0 / math::sqrt(mean + eps);
        for (x, w) in x.iter_mut().zip(weight) {
            *x = (*x * scale) * w;
        }
    }

    /// Rotates the channel pairs (2j, 2j + 1) of a head by the angles whose cosines and sines are
    /// given; channels beyond them stay.
    fn rotate(self, head: &mut [f32], cos: &[f32], sin: &[f32]) {
        for ((pair, cos), sin) in head.chunks_exact_mut(2).zip(cos).zip(sin) {
            if let [even, odd] = pair {
                (*even, *odd) = (*even * cos - *odd * sin, *odd * cos + *even * sin);
            }
        }
    }

    /// x becomes (x * share) * sigmoid(gate)
    fn gate(self, x: &mut [f32], share: f32, gate: &[f32]) {
        for (x, gate) in x.iter_mut().zip(gate) {
            *x = (*x * share) * math::sigmoid(*gate);
        }
    }

    /// Attention of one head of queries side by side, but for the division by the sums that it
    /// returns: `queries` (head_dim) become the sums of values, each times e to its key's score
    /// less the largest of the query's; `scores` (tokens) is scratch. Keys and values are rows of
    /// head_dim numbers, `stride` apart.
    fn mix_lanes(
        self,
        queries: &mut [Lanes],
        scores: &mut [Lanes],
        keys: &[f32],
        values: &[f32],
        stride: usize,
        scale: f32,
    ) -> Lanes {
        attention::mix_lanes(self, queries, scores, (keys, values), stride, scale)
    }

    /// x becomes e to the x
    fn exp(self, x: &mut [f32]) {
        for x in x {
            *x = math::exp(*x);
        }
    }

    /// x becomes x * sigmoid(x)
    fn silu(self, x: &mut [f32]) {
        for x in x {
            *x = math::silu(*x);
        }
    }

    /// x becomes (x - mean) * scale, clamped to +-limit. Where that is not a number, NaN or any
    /// number within the limit will do: observations are finite, and so are a model's constants.
    fn normalise(self, x: &mut [f32], mean: &[f32], scale: &[f32], limit: f32) {
        for ((x, mean), scale) in x.iter_mut().zip(mean).zip(scale) {
            *x = ((*x - mean) * scale).clamp(-limit, limit);
        }
    }

    /// Each score becomes e to its difference from the largest; returns their sum, in order.
    fn softmax(self, scores: &mut [f32]) -> f32 {
        let largest = scores.iter().fold(f32::NEG_INFINITY, |most, score| most.max(*score));
        let mut total = 0.0;
        for score in scores {
            *score = math::exp(*score - largest);
            total += *score;
        }
        total
    }

    /// Running maximum (channels) and sum (at least channels) of each channel over the rows of
    /// `x` (rows, channels), in order.
    /// Of a zero, the maximum's sign is left open.
    fn pool(self, x: &[f32], largest: &mut [f32], sum: &mut [f32]) {
        for row in x.chunks_exact(largest.len().max(1)) {
            for ((largest, sum), x) in largest.iter_mut().zip(sum.iter_mut()).zip(row) {
                *largest = largest.max(*x);
                *sum += x;
            }
        }
    }

    /// Adds the rows of `x` (rows, channels), each times its weight for an anchor, to that
    /// anchor's row of `out` (anchors, channels), in order; a weight for every row.
    fn weigh(self, x: &[f32], weights: &[[f32; ANCHORS]], out: &mut [f32]) {
        let channels = (out.len() / ANCHORS).max(1);
        for (row, weights) in x.chunks_exact(channels).zip(weights) {
            for (out, weight) in out.chunks_exact_mut(channels).zip(weights) {
                for (out, x) in out.iter_mut().zip(row) {
                    *out += weight * x;
                }
            }
        }
    }

    /// The squared distance of the point (local to `pose`) that is nearest to `query` (world),
    /// where one is nearer than the root of `distance2`, and where to look for it: the first
    /// point at that distance is at or behind that index. [`first_at`](Self::first_at) looks.
    fn nearest(
        self,
        points: &[Point3<f32>],
        pose: &Pose,
        query: &Vector3<f32>,
        mut distance2: f32,
    ) -> Option<(usize, f32)> {
        let local = pose.local(query);
        let mut found = None;
        for (i, point) in points.iter().enumerate() {
            let d = point.coords - local;
            let here = crate::geometry::dot(&d, &d);
            if here < distance2 {
                distance2 = here;
                found = Some((i, here));
            }
        }
        found
    }

    /// The first point from `from` on whose squared distance is `distance2`: what
    /// [`nearest`](Self::nearest) found. Apart from it because most of what it finds is beaten
    /// by another unit.
    fn first_at(
        self,
        points: &[Point3<f32>],
        pose: &Pose,
        query: &Vector3<f32>,
        from: usize,
        distance2: f32,
    ) -> usize {
        let local = pose.local(query);
        let is_it = |point: &Point3<f32>| {
            let d = point.coords - local;
            crate::geometry::dot(&d, &d) == distance2
        };
        let behind = points.iter().skip(from).position(is_it).unwrap_or_default();
        from.saturating_add(behind)
    }

    /// What is nearest to each point of a leaf of `index`, into row `row` of the answers. For
    /// kernels with an [`INDEX`](Self::INDEX).
    ///
    /// All of it is inlined here, so that kernels which call it with their processor's
    /// instructions enabled get it compiled to those.
    #[inline(always)]
    fn nearest_of_leaf(self, index: &Index<'_>, row: usize, answers: &mut [f32]) {
        crate::geometry::index::nearest(index, row, answers);
    }
}

/// Plain Rust, for every target.
#[derive(Clone, Copy, Debug, Default)]
pub struct Portable;

/// The fastest kernels of this crate that the target this is compiled for is sure to have.
#[cfg(not(rigidformer_dsp))]
pub type Native = Portable;
/// The fastest kernels of this crate that the target this is compiled for is sure to have.
#[cfg(rigidformer_dsp)]
pub type Native = CortexM;

/// Rows of x that one pass over a weight row serves.
const ROW_TILE: usize = 4;

fn add_lanes(sum: [f32; LANES]) -> f32 {
    let [a, b, c, d, e, f, g, h] = sum;
    ((a + e) + (c + g)) + ((b + f) + (d + h))
}

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
