//! Gated attention of many queries side by side, for wide registers.

use super::arithmetic::Kernels;
use super::attention::{Attention, Lanes, TOGETHER};
use crate::slices::{rows, rows_mut, slice_at, slice_at_mut};

/// [`Kernels::attend`] with [`TOGETHER`] queries side by side: each lane does what the default of [`Kernels::attend`] does, in
/// its order, and no operation waits for the one before it in the same reduction. For inlining
/// into functions that may use wide registers. `scratch` has [`scratch_numbers`](super::scratch_numbers).
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
    let rows_of = |stride: usize| stride.saturating_mul(TOGETHER).max(1);
    // No channel of a query is behind the last query.
    let inner = a.inner.min(a.queries.len());
    let blocks = a.queries.chunks(rows_of(a.query_stride));
    for (block, out) in blocks.zip(out.chunks_mut(rows_of(a.out_stride))) {
        for start in (0..inner).step_by(head_dim) {
            // Lanes without a query keep what they have; nobody reads what comes of it.
            for (lane, own) in rows(block, a.query_stride).enumerate() {
                for (query, x) in queries.iter_mut().zip(slice_at(own, start, head_dim)) {
                    if let Some(slot) = query.get_mut(lane) {
                        *slot = *x;
                    }
                }
            }
            let keys = a.tokens.get(a.key.saturating_add(start)..).unwrap_or_default();
            let values = a.tokens.get(a.value.saturating_add(start)..).unwrap_or_default();
            let totals = kernels.mix_lanes(queries, scores, keys, values, a.stride, a.scale());
            let shares = totals.map(|total| 1.0 / total);
            for mixture in queries.iter_mut() {
                for (mixture, share) in mixture.iter_mut().zip(&shares) {
                    *mixture *= share;
                }
            }
            for (lane, out) in rows_mut(out, a.out_stride).enumerate() {
                let out = slice_at_mut(out, a.out_start.saturating_add(start), head_dim);
                for (out, mixture) in out.iter_mut().zip(queries.iter()) {
                    *out = mixture.get(lane).copied().unwrap_or_default();
                }
            }
        }
        // All heads at once: numbers that were just written one by one are slow to load together.
        for (out, own) in rows_mut(out, a.out_stride).zip(rows(block, a.query_stride)) {
            let out = slice_at_mut(out, a.out_start, a.inner);
            kernels.gate(out, 1.0, slice_at(own, a.gate, a.inner));
        }
    }
}
