//! Gated attention of several queries to the same tokens.

use super::Kernels;
use crate::layers::{part, rows, rows_mut};
use crate::math;

/// Queries that [`attend_together`] takes side by side.
pub const TOGETHER: usize = 16;

/// Queries, and the keys and values that they attend to; all heads stand side by side.
#[derive(Clone, Copy, Debug)]
pub struct Attention<'a> {
    /// (queries, `query_stride`): a row's query begins at 0, its gate at `gate`.
    pub queries: &'a [f32],
    /// Numbers from a query to the next.
    pub query_stride: usize,
    /// Where the gate of a query begins.
    pub gate: usize,
    /// (tokens, `stride`): a row's keys begin at `key`, its values at `value`.
    pub tokens: &'a [f32],
    /// Numbers from a token to the next.
    pub stride: usize,
    /// Where the keys of a token begin.
    pub key: usize,
    /// Where the values of a token begin.
    pub value: usize,
    /// Channels of a head.
    pub head_dim: usize,
    /// Channels of all heads.
    pub inner: usize,
    /// Numbers from an output to the next; it is written from `out_start` on.
    pub out_stride: usize,
    /// Where an output's channels begin.
    pub out_start: usize,
}

impl Attention<'_> {
    fn count(&self) -> usize {
        self.tokens.len() / self.stride.max(1)
    }

    fn scale(&self) -> f32 {
        1.0 / math::sqrt(self.head_dim as f32)
    }
}

/// The definition: one query after another, one head after another. `scores` has a number for each token.
pub(super) fn attend_each<K: Kernels>(
    kernels: K,
    a: &Attention<'_>,
    scores: &mut [f32],
    out: &mut [f32],
) {
    let (scale, head_dim) = (a.scale(), a.head_dim);
    let scores = scores.get_mut(..a.count()).unwrap_or_default();
    for (own, out) in rows(a.queries, a.query_stride).zip(rows_mut(out, a.out_stride)) {
        let (query, gate) = (part(own, 0, a.inner), part(own, a.gate, a.inner));
        let out = crate::layers::part_mut(out, a.out_start, a.inner);
        let heads = rows(query, head_dim).zip(rows(gate, head_dim)).zip(rows_mut(out, head_dim));
        for (h, ((query, gate), out)) in heads.enumerate() {
            let from = |start: usize| a.tokens.get(start + h * head_dim..).unwrap_or_default();
            kernels.scores(query, from(a.key), a.stride, scale, scores);
            let total = kernels.softmax(scores);
            kernels.mix(scores, from(a.value), a.stride, out);
            kernels.gate(out, 1.0 / total, gate);
        }
    }
}

/// Numbers of scratch that [`attend_together`] needs.
pub const fn scratch_numbers(tokens: usize, head_dim: usize) -> usize {
    // One row more, so that the others can begin where a cache line does.
    tokens.saturating_add(head_dim).saturating_add(1).saturating_mul(TOGETHER)
}

/// A number for each of the queries that attend together.
pub type Lanes = [f32; TOGETHER];

/// The same with [`TOGETHER`] queries side by side: each lane does what the default of [`Kernels::attend`] does, in
/// its order, and no operation waits for the one before it in the same reduction. For inlining
/// into functions that may use wide registers. `scratch` has [`scratch_numbers`].
#[inline(always)]
pub fn attend_together<K: Kernels>(
    kernels: K,
    a: &Attention<'_>,
    scratch: &mut [f32],
    out: &mut [f32],
) {
    let head_dim = a.head_dim.max(1);
    let skipped = scratch.as_ptr().align_offset(size_of::<Lanes>()).min(scratch.len());
    let (lanes, _) = scratch.get_mut(skipped..).unwrap_or_default().as_chunks_mut::<TOGETHER>();
    let (queries, scores) = lanes.split_at_mut(head_dim.min(lanes.len()));
    let scores = scores.get_mut(..a.count()).unwrap_or_default();
    let blocks = a.queries.chunks((a.query_stride * TOGETHER).max(1));
    for (block, out) in blocks.zip(out.chunks_mut((a.out_stride * TOGETHER).max(1))) {
        for start in (0..a.inner).step_by(head_dim) {
            // Lanes without a query keep what they have; nobody reads what comes of it.
            for (lane, own) in rows(block, a.query_stride).enumerate() {
                for (query, x) in queries.iter_mut().zip(part(own, start, head_dim)) {
                    if let Some(slot) = query.get_mut(lane) {
                        *slot = *x;
                    }
                }
            }
            let keys = a.tokens.get(a.key + start..).unwrap_or_default();
            let values = a.tokens.get(a.value + start..).unwrap_or_default();
            let totals = kernels.mix_lanes(queries, scores, keys, values, a.stride, a.scale());
            let shares = totals.map(|total| 1.0 / total);
            for mixture in queries.iter_mut() {
                for (mixture, share) in mixture.iter_mut().zip(&shares) {
                    *mixture *= share;
                }
            }
            for (lane, out) in rows_mut(out, a.out_stride).enumerate() {
                let out = crate::layers::part_mut(out, a.out_start + start, head_dim);
                for (out, mixture) in out.iter_mut().zip(queries.iter()) {
                    *out = mixture.get(lane).copied().unwrap_or_default();
                }
            }
        }
        // All heads at once: numbers that were just written one by one are slow to load together.
        for (out, own) in rows_mut(out, a.out_stride).zip(rows(block, a.query_stride)) {
            let out = crate::layers::part_mut(out, a.out_start, a.inner);
            kernels.gate(out, 1.0, part(own, a.gate, a.inner));
        }
    }
}

/// The definition of [`Kernels::mix_lanes`].
pub(super) fn mix_lanes<K: Kernels>(
    kernels: K,
    queries: &mut [Lanes],
    scores: &mut [Lanes],
    (keys, values): (&[f32], &[f32]),
    stride: usize,
    scale: f32,
) -> Lanes {
    let mut largest = [f32::NEG_INFINITY; TOGETHER];
    for (key, score) in keys.chunks(stride.max(1)).zip(scores.iter_mut()) {
        let key = part(key, 0, queries.len());
        for (lane, (score, largest)) in score.iter_mut().zip(&mut largest).enumerate() {
            let mut sums = [0.0_f32; super::LANES];
            for (index, (k, query)) in key.iter().zip(queries.iter()).enumerate() {
                let q = query.get(lane).copied().unwrap_or_default();
                if let Some(sum) = sums.get_mut(index % super::LANES) {
                    *sum += q * k;
                }
            }
            *score = super::add_lanes(sums) * scale;
            *largest = largest.max(*score);
        }
    }
    for score in scores.iter_mut() {
        for (score, largest) in score.iter_mut().zip(&largest) {
            *score -= largest;
        }
    }
    kernels.exp(scores.as_flattened_mut());
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
