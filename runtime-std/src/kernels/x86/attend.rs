//! Attention of sixteen queries side by side: a lane is a query, so that no reduction crosses lanes.

use rigidformer_core::kernels::attention::{Lanes, TOGETHER};

use super::smooth;
use super::wide::Wide;

/// Channels whose mixtures are in registers during a pass over the tokens.
const CHANNELS: usize = 8;

/// As `Kernels::mix_lanes`.
#[inline(always)]
pub(super) unsafe fn mix_lanes<V: Wide>(
    queries: &mut [Lanes],
    scores: &mut [Lanes],
    keys: &[f32],
    values: &[f32],
    stride: usize,
    scale: f32,
) -> Lanes {
    let mut totals = [0.0; TOGETHER];
    let channels = queries.len();
    // Rows that are whole in both.
    let whole = |from: &[f32]| match from.len().checked_sub(channels) {
        Some(rest) => rest.checked_div(stride).map_or(1, |rows| rows + 1),
        None => 0,
    };
    let tokens = scores.len().min(whole(keys)).min(whole(values));
    let scores = &mut scores[..tokens];
    // SAFETY: `tokens` rows of `channels` numbers, `stride` apart, are in `keys` and in `values`. The caller has the
    // instructions of V.
    unsafe {
        for lane in (0..TOGETHER).step_by(V::WIDTH) {
            let mut largest = V::splat(&f32::NEG_INFINITY);
            for (token, score) in scores.iter_mut().enumerate() {
                let key = keys.as_ptr().add(token * stride);
                let score = score.as_mut_ptr().add(lane);
                let sum = dot::<V>(queries, lane, key).mul(V::splat(&scale));
                largest = largest.most(sum);
                sum.store(score);
            }
            for score in scores.iter_mut() {
                let score = score.as_mut_ptr().add(lane);
                V::load(score).sub(largest).store(score);
            }
        }
        smooth::exponential::<V>(scores.as_flattened_mut());
        for lane in (0..TOGETHER).step_by(V::WIDTH) {
            let mut total = V::zero();
            for score in scores.iter() {
                total = total.add(V::load(score.as_ptr().add(lane)));
            }
            total.store(totals.as_mut_ptr().add(lane));
            let mut at = 0;
            while at + CHANNELS <= channels {
                mix::<V, CHANNELS>(queries, scores, values.as_ptr(), stride, at, lane);
                at += CHANNELS;
            }
            while at < channels {
                mix::<V, 1>(queries, scores, values.as_ptr(), stride, at, lane);
                at += 1;
            }
        }
    }
    totals
}

/// Products of a key with queries, summed in the order of the core's lanes.
#[inline(always)]
unsafe fn dot<V: Wide>(queries: &[Lanes], lane: usize, key: *const f32) -> V {
    let (groups, rest) = queries.as_chunks::<8>();
    // SAFETY: the key has as many numbers as there are rows of queries. The caller has the instructions of V.
    unsafe {
        let mut sums = [V::zero(); 8];
        let product =
            |query: &Lanes, at: usize| V::load(query.as_ptr().add(lane)).mul(V::splat(key.add(at)));
        for (g, group) in groups.iter().enumerate() {
            for j in 0..8 {
                sums[j] = sums[j].add(product(&group[j], 8 * g + j));
            }
        }
        for (j, query) in rest.iter().enumerate() {
            sums[j] = sums[j].add(product(query, 8 * groups.len() + j));
        }
        let [a, b, c, d, e, f, g, h] = sums;
        let (even, odd) = (a.add(e).add(c.add(g)), b.add(f).add(d.add(h)));
        even.add(odd)
    }
}

/// Mixtures of `N` channels from `at` on, into the rows of `out`.
#[inline(always)]
unsafe fn mix<V: Wide, const N: usize>(
    out: &mut [Lanes],
    weights: &[Lanes],
    values: *const f32,
    stride: usize,
    at: usize,
    lane: usize,
) {
    // SAFETY: each token's values have `at + N` numbers, and `out` as many rows. The caller has the instructions of V.
    unsafe {
        let mut sums = [V::zero(); N];
        for (token, weight) in weights.iter().enumerate() {
            let weight = V::load(weight.as_ptr().add(lane));
            let value = values.add(token * stride + at);
            for (channel, sum) in sums.iter_mut().enumerate() {
                *sum = sum.add(weight.mul(V::splat(value.add(channel))));
            }
        }
        for (out, sum) in out[at..at + N].iter_mut().zip(sums) {
            sum.store(out.as_mut_ptr().add(lane));
        }
    }
}
