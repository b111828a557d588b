//! Loops that the compiler vectorises: the definitions of `Kernels`, in a shape that suits it. They are inlined into functions with the
//! processor's instructions. They are unsafe functions because those call all kernels alike.

use rigidformer_core::geometry::Index;
use rigidformer_core::{Kernels, Portable};

/// Rows that are pooled while a channel's maximum and sum are in registers.
// Eight rows load and store maximum and sum once.
const ROWS_AT_ONCE: usize = 8;

/// As `Kernels::rotate`.
///
/// # Safety
/// The caller has no obligation.
#[inline(always)]
pub(super) unsafe fn rotate(head: &mut [f32], cos: &[f32], sin: &[f32]) {
    let (pairs, _) = head.as_chunks_mut::<2>();
    for ((pair, cos), sin) in pairs.iter_mut().zip(cos).zip(sin) {
        let [even, odd] = *pair;
        *pair = [even * cos - odd * sin, odd * cos + even * sin];
    }
}

/// As `Kernels::nearest_of_leaf`.
///
/// # Safety
/// The caller has no obligation.
#[inline(always)]
pub(super) unsafe fn nearest_of_leaf(index: &Index<'_>, row: usize, answers: &mut [f32]) {
    Portable.nearest_of_leaf(index, row, answers);
}

/// As `Kernels::normalise`.
///
/// # Safety
/// The caller has no obligation.
#[inline(always)]
pub(super) unsafe fn normalise(x: &mut [f32], mean: &[f32], scale: &[f32], limit: f32) {
    for ((x, mean), scale) in x.iter_mut().zip(mean).zip(scale) {
        let y = (*x - mean) * scale;
        // `clamp` would panic where the limit is negative or not a number.
        let y = if y < -limit { -limit } else { y };
        *x = if y > limit { limit } else { y };
    }
}

/// As `Kernels::pool`.
///
/// # Safety
/// The caller has no obligation.
#[inline(always)]
pub(super) unsafe fn pool(x: &[f32], largest: &mut [f32], sum: &mut [f32]) {
    let channels = largest.len().max(1);
    for rows in x.chunks(channels.saturating_mul(ROWS_AT_ONCE)) {
        let mut each = rows.chunks_exact(channels);
        // A constant number of rows lets the compiler unroll the loop.
        if rows.len() / channels == ROWS_AT_ONCE {
            // `each` has exactly as many rows, by the condition above.
            let rows: [&[f32]; ROWS_AT_ONCE] =
                std::array::from_fn(|_| each.next().unwrap_or_default());
            pool_rows(rows, largest, sum);
        } else {
            for row in each {
                pool_rows([row], largest, sum);
            }
        }
    }
}

#[inline(always)]
fn pool_rows<const N: usize>(rows: [&[f32]; N], largest: &mut [f32], sum: &mut [f32]) {
    // Equal lengths that the compiler knows remove the checks of bounds.
    let channels = largest.len().min(sum.len());
    let rows = rows.map(|row| &row[..channels.min(row.len())]);
    if rows.iter().any(|row| row.len() != channels) {
        return;
    }
    let (largest, sum) = (&mut largest[..channels], &mut sum[..channels]);
    for channel in 0..channels {
        let (mut most, mut total) = (largest[channel], sum[channel]);
        for row in rows {
            most = most.max(row[channel]);
            total += row[channel];
        }
        (largest[channel], sum[channel]) = (most, total);
    }
}
