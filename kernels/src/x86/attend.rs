//! Attention of sixteen queries side by side: a lane is a query, so that no reduction crosses lanes.
// Loops over registers by index keep them in registers.
#![allow(clippy::needless_range_loop)]
// The assembly has no instruction: it hides the origin of pointers, and reads nothing through them.
#![allow(clippy::pointers_in_nomem_asm_block)]

use rigidformer_core::kernels::{LANES, Lanes, TOGETHER};

use super::smooth;
use super::wide::Wide;

/// Channels of a pass over the tokens, whose mixtures fit into 16 registers.
const CHANNELS_16_REGISTERS: usize = 8;
/// The same for 32 registers.
const CHANNELS_32_REGISTERS: usize = 16;

/// As `Kernels::mix_lanes`.
///
/// # Safety
/// The processor has the instructions of `V`.
#[inline(always)]
pub(super) unsafe fn mix_lanes<V: Wide>(
    queries: &mut [Lanes],
    scores: &mut [Lanes],
    keys: &[f32],
    values: &[f32],
    stride: usize,
    scale: f32,
) -> Lanes {
    const { assert!(TOGETHER.is_multiple_of(V::WIDTH)) };
    let mut totals = [0.0; TOGETHER];
    let channels = queries.len();
    // Rows that are whole in both.
    let whole = |from: &[f32]| match from.len().checked_sub(channels) {
        Some(rest) => rest.checked_div(stride).map_or(1, |rows| rows + 1),
        None => 0,
    };
    let tokens = scores.len().min(whole(keys)).min(whole(values));
    let scores = &mut scores[..tokens];
    let (keys, values) = (keys.as_ptr(), values.as_ptr());
    // SAFETY: the instructions by this function's contract. `tokens` is at most `whole` of `keys`
    // and of `values`: row i begins at `i * stride`, and its `channels` numbers are inside both.
    // `lane` takes steps of a register, so that `lane + V::WIDTH` is at most `TOGETHER`, the length
    // of each score and of `totals`. `at` and as many channels as `mix` takes are at most
    // `channels`.
    unsafe {
        // One register holds all queries, so the largest is subtracted on the way into the exponential.
        if V::WIDTH == TOGETHER {
            let largest = scores_of::<V, 6>(queries, scores, keys, stride, scale, 0);
            smooth::exponential_less::<V>(scores.as_flattened_mut(), largest);
        } else {
            for lane in (0..TOGETHER).step_by(V::WIDTH) {
                let largest = scores_of::<V, 3>(queries, scores, keys, stride, scale, lane);
                for score in scores.iter_mut() {
                    let score = score.as_mut_ptr().add(lane);
                    V::load(score).sub(largest).store(score);
                }
            }
            smooth::exponential::<V>(scores.as_flattened_mut());
        }
        for lane in (0..TOGETHER).step_by(V::WIDTH) {
            // Each pass sums the same weights: the first total suffices.
            let mut total = None;
            let mut at = 0;
            // AVX-512 has 32 registers.
            while V::WIDTH == TOGETHER && at + CHANNELS_32_REGISTERS <= channels {
                let here =
                    mix::<V, CHANNELS_32_REGISTERS>(queries, scores, values, stride, at, lane);
                total = total.or(Some(here));
                at += CHANNELS_32_REGISTERS;
            }
            while at + CHANNELS_16_REGISTERS <= channels {
                let here =
                    mix::<V, CHANNELS_16_REGISTERS>(queries, scores, values, stride, at, lane);
                total = total.or(Some(here));
                at += CHANNELS_16_REGISTERS;
            }
            while at < channels {
                let here = mix::<V, 1>(queries, scores, values, stride, at, lane);
                total = total.or(Some(here));
                at += 1;
            }
            if let Some(total) = total {
                total.store(totals.as_mut_ptr().add(lane));
            }
        }
    }
    totals
}

/// Scores of all tokens, and the largest of each query. `N` keys share the loads of queries.
///
/// # Safety
/// The processor has the instructions of `V`. For each i less than `scores.len()`, `queries.len()`
/// numbers may be read from `keys + i * stride` on; `lane + V::WIDTH` is at most [`TOGETHER`].
#[inline(always)]
unsafe fn scores_of<V: Wide, const N: usize>(
    queries: &[Lanes],
    scores: &mut [Lanes],
    keys: *const f32,
    stride: usize,
    scale: f32,
    lane: usize,
) -> V {
    let tokens = scores.len();
    // SAFETY: by this function's contract the instructions, the lanes and `tokens` keys. The one
    // that begins at `token` is less than `tokens`, and so are the `N` from `first` on, as `first`
    // is at most `tokens - N`.
    unsafe {
        let mut largest = V::splat(&f32::NEG_INFINITY);
        let mut token = 0;
        while token < tokens {
            // Fewer tokens than a group cannot overlap it.
            if tokens < N {
                let [sum] = dots::<V, 1>(queries, lane, keys.add(token * stride), stride);
                largest = keep::<V>(sum, scale, largest, &mut scores[token], lane);
                token += 1;
                continue;
            }
            // The last keys are computed with some before them, whose scores have the same bits again.
            let first = token.min(tokens - N);
            let sums = dots::<V, N>(queries, lane, keys.add(first * stride), stride);
            for n in 0..N {
                largest = keep::<V>(sums[n], scale, largest, &mut scores[first + n], lane);
            }
            token = first + N;
        }
        largest
    }
}

/// Stores a score; the larger of it and of the largest before.
///
/// # Safety
/// The processor has the instructions of `V`; `lane + V::WIDTH` is at most [`TOGETHER`].
#[inline(always)]
unsafe fn keep<V: Wide>(sum: V, scale: f32, largest: V, score: &mut Lanes, lane: usize) -> V {
    // SAFETY: the instructions by this function's contract; `score` has `TOGETHER` numbers, a
    // register's from `lane` on.
    unsafe {
        let score_of = sum.mul(V::splat(&scale));
        score_of.store(score.as_mut_ptr().add(lane));
        largest.most(score_of)
    }
}

/// Products of keys with queries, summed in the order of the core's lanes: one lane at a time, so that the sums of `N` keys
/// are in registers and share the loads of queries.
///
/// Without closures: they lack the target's instructions, so that intrinsics in them are not inlined.
///
/// # Safety
/// The processor has the instructions of `V`. For each n less than `N`, `queries.len()` numbers may
/// be read from `key + n * stride` on; `lane + V::WIDTH` is at most [`TOGETHER`].
#[inline(always)]
unsafe fn dots<V: Wide, const N: usize>(
    queries: &[Lanes],
    lane: usize,
    key: *const f32,
    stride: usize,
) -> [V; N] {
    let mut keys = [key; N];
    // SAFETY: by this function's contract the instructions and the lanes, and `queries.len()`
    // numbers at each of `keys`: what `lane_sums` asks for. The assembly has no instruction.
    unsafe {
        for n in 0..N {
            keys[n] = key.add(n * stride);
            // Hides the origin of the pointer: it stays in a register instead of being computed for each load.
            std::arch::asm!("/* {0} */", inout(reg) keys[n], options(pure, nomem, nostack, preserves_flags));
        }
        let mut even = lane_sums::<V, N>(queries, lane, keys, 0);
        add::<V, N>(&mut even, lane_sums::<V, N>(queries, lane, keys, 4));
        let mut sums = lane_sums::<V, N>(queries, lane, keys, 2);
        add::<V, N>(&mut sums, lane_sums::<V, N>(queries, lane, keys, 6));
        add::<V, N>(&mut even, sums);
        let mut odd = lane_sums::<V, N>(queries, lane, keys, 1);
        add::<V, N>(&mut odd, lane_sums::<V, N>(queries, lane, keys, 5));
        let mut sums = lane_sums::<V, N>(queries, lane, keys, 3);
        add::<V, N>(&mut sums, lane_sums::<V, N>(queries, lane, keys, 7));
        add::<V, N>(&mut odd, sums);
        add::<V, N>(&mut even, odd);
        even
    }
}

/// Adds to each sum.
///
/// # Safety
/// The processor has the instructions of `V`.
#[inline(always)]
unsafe fn add<V: Wide, const N: usize>(sums: &mut [V; N], more: [V; N]) {
    for n in 0..N {
        // SAFETY: the instructions by this function's contract.
        sums[n] = unsafe { sums[n].add(more[n]) };
    }
}

/// One of the eight lanes of those products.
///
/// It begins with the first product instead of adding that to 0. A sum that would be 0 may be -0 then, which e to the
/// power of a score's difference from the largest does not show.
///
/// # Safety
/// The processor has the instructions of `V`. From each of `keys` on, `queries.len()` numbers may
/// be read; `lane + V::WIDTH` is at most [`TOGETHER`].
#[inline(always)]
unsafe fn lane_sums<V: Wide, const N: usize>(
    queries: &[Lanes],
    lane: usize,
    keys: [*const f32; N],
    from: usize,
) -> [V; N] {
    // SAFETY: the instructions by this function's contract. `from` and `at` are less than
    // `queries.len()` where they are used, and so inside `queries` and each of `keys`. A query's
    // row has `TOGETHER` numbers, a register's from `lane` on.
    unsafe {
        let mut sums = [V::zero(); N];
        if from < queries.len() {
            let query = V::load(queries.as_ptr().add(from).cast::<f32>().add(lane));
            for n in 0..N {
                sums[n] = query.mul(V::splat(keys[n].add(from)));
            }
        }
        let mut at = from + LANES;
        while at < queries.len() {
            let query = V::load(queries.as_ptr().add(at).cast::<f32>().add(lane));
            for n in 0..N {
                sums[n] = sums[n].add(query.mul(V::splat(keys[n].add(at))));
            }
            at += LANES;
        }
        sums
    }
}

/// Mixtures of `N` channels from `at` on, into the rows of `out`; returns the sums of the weights.
///
/// # Safety
/// The processor has the instructions of `V`. For each i less than `weights.len()`, `N` numbers may
/// be read from `values + i * stride + at` on; `lane + V::WIDTH` is at most [`TOGETHER`].
#[inline(always)]
unsafe fn mix<V: Wide, const N: usize>(
    out: &mut [Lanes],
    weights: &[Lanes],
    values: *const f32,
    stride: usize,
    at: usize,
    lane: usize,
) -> V {
    // SAFETY: the instructions by this function's contract. `value` is the place of channel `at` of
    // a token whose weight is at hand, with `N` numbers. A row of `weights` and one of `out`, which
    // is indexed, has `TOGETHER` numbers, a register's from `lane` on.
    unsafe {
        let mut sums = [V::zero(); N];
        let mut total = V::zero();
        // Without tokens there may be no value at all.
        let mut value = values.wrapping_add(at);
        for weight in weights {
            let weight = V::load(weight.as_ptr().add(lane));
            total = total.add(weight);
            for channel in 0..N {
                sums[channel] = sums[channel].add(weight.mul(V::splat(value.add(channel))));
            }
            // The last row may end sooner than a stride later.
            value = value.wrapping_add(stride);
        }
        for channel in 0..N {
            sums[channel].store(out[at + channel].as_mut_ptr().add(lane));
        }
        total
    }
}
