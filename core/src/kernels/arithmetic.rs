//! The arithmetic that targets may replace. [`Portable`](crate::Portable) is the definition; every other
//! implementation must equal it bit for bit.

use super::attention::{Attention, Lanes, TOGETHER};
#[cfg(rigidformer_host)]
use super::goal::Goal;
#[cfg(rigidformer_host)]
use super::sweep::{Block, Motion};
use crate::geometry::{Index, Pose};
use crate::limits::ANCHORS;
use crate::math;
use crate::quant::Scratch;
use crate::slices::{rows, rows_mut, slice_at, slice_at_mut};
use half::f16;
use nalgebra::{Point3, Vector3};
#[cfg(rigidformer_host)]
use rigidformer_weights::Panels;

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

/// Matrix products and other inner loops.
///
/// A value of an implementation is the proof that the processor has what it needs.
pub trait Kernels: Copy + Sync {
    /// Name for tables and traces, such as `portable`.
    const NAME: &'static str;

    /// Whether the search for the nearest point passes over units that are too far away: less
    /// work, but how much depends on the scene. The answer does not.
    const CULL: bool = true;

    /// Queries that [`attend`](Self::attend) takes together; scratch grows with it.
    const QUERIES: usize = 1;

    /// Whether [`sweep`](Self::sweep) over blocks is faster than impulses one after the other. The bits are the same.
    #[cfg(rigidformer_host)]
    const SWEEPS: bool = false;

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
    /// the rows of a [tile](crate::Tiles).
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

    /// Sum of products of two slices of equal length, in the order of [`LANES`].
    fn dot_f32(self, lhs: &[f32], rhs: &[f32]) -> f32;

    /// Gated attention: for each query and head, `sigmoid(gate) * softmax(query keysᵀ /
    /// sqrt(head_dim)) values`. `scratch` has as many numbers as tokens, or
    /// [`scratch_numbers`](super::scratch_numbers) for [`QUERIES`](Self::QUERIES) above 1.
    fn attend(self, a: &Attention<'_>, scores: &mut [f32], out: &mut [f32]) {
        // One query after another, one head after another.
        let (scale, head_dim) = (a.scale(), a.head_dim);
        let scores = scores.get_mut(..a.count()).unwrap_or_default();
        for (own, out) in rows(a.queries, a.query_stride).zip(rows_mut(out, a.out_stride)) {
            let (query, gate) = (slice_at(own, 0, a.inner), slice_at(own, a.gate, a.inner));
            let out = slice_at_mut(out, a.out_start, a.inner);
            let heads =
                rows(query, head_dim).zip(rows(gate, head_dim)).zip(rows_mut(out, head_dim));
            for (h, ((query, gate), out)) in heads.enumerate() {
                let from = |start: usize| a.tokens.get(start + h * head_dim..).unwrap_or_default();
                self.scores(query, from(a.key), a.stride, scale, scores);
                let total = self.softmax(scores);
                self.mix(scores, from(a.value), a.stride, out);
                self.gate(out, 1.0 / total, gate);
            }
        }
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
        let mut largest = [f32::NEG_INFINITY; TOGETHER];
        for (key, score) in keys.chunks(stride.max(1)).zip(scores.iter_mut()) {
            let key = slice_at(key, 0, queries.len());
            for (lane, (score, largest)) in score.iter_mut().zip(&mut largest).enumerate() {
                let mut sums = [0.0_f32; LANES];
                for (index, (k, query)) in key.iter().zip(queries.iter()).enumerate() {
                    let q = query.get(lane).copied().unwrap_or_default();
                    if let Some(sum) = sums.get_mut(index % LANES) {
                        *sum += q * k;
                    }
                }
                *score = add_lanes(sums) * scale;
                *largest = largest.max(*score);
            }
        }
        for score in scores.iter_mut() {
            for (score, largest) in score.iter_mut().zip(&largest) {
                *score -= largest;
            }
        }
        self.exp(scores.as_flattened_mut());
        let mut totals = [0.0; TOGETHER];
        for score in scores.iter() {
            for (total, e) in totals.iter_mut().zip(score) {
                *total += e;
            }
        }
        queries.as_flattened_mut().fill(0.0);
        for (value, weights) in values.chunks(stride.max(1)).zip(scores.iter()) {
            for (mixture, value) in queries.iter_mut().zip(value) {
                for (mixture, weight) in mixture.iter_mut().zip(weights) {
                    *mixture += weight * value;
                }
            }
        }
        totals
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
    /// schedules with an index.
    ///
    /// All of it is inlined here, so that kernels which call it with their processor's
    /// instructions enabled get it compiled to those.
    #[inline(always)]
    fn nearest_of_leaf(self, index: &Index<'_>, row: usize, answers: &mut [f32]) {
        crate::geometry::index::nearest(index, row, answers);
    }

    /// A sweep of impulses over blocks of contacts, upwards or downwards. Whether any contact had one.
    #[cfg(rigidformer_host)]
    fn sweep(self, blocks: &mut [Block], motions: &mut [Motion], aim: (Goal, bool)) -> bool {
        super::sweep::sweep::<f32>(blocks, motions, aim)
    }
}

/// The sums of all lanes, in the one order.
pub(super) fn add_lanes(sum: [f32; LANES]) -> f32 {
    let [a, b, c, d, e, f, g, h] = sum;
    ((a + e) + (c + g)) + ((b + f) + (d + h))
}
