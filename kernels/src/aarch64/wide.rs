//! Products of f32 and f16 matrices, and other loops that hold sums in registers.
//!
//! Two registers hold the eight lanes of a sum in the order of `LANES`; registers of four sums are added across at the
//! end.
#![allow(unsafe_code)]

use std::arch::aarch64::*;

use half::f16;
use rigidformer_core::ANCHORS;
use rigidformer_core::kernels::LANES;

/// Numbers of a register.
const WIDTH: usize = 4;
/// Rows of x of a tile.
// With three the compiler runs out of registers.
const ROWS: usize = 2;
/// Rows of weights of a tile.
const OUTPUTS: usize = 4;

/// A stored weight.
pub(super) trait Weight: Copy {
    /// The number that fills a partial load.
    const ZERO: Self;

    /// Four of them, widened.
    ///
    /// # Safety
    /// The processor has NEON, and four weights may be read from `from` on, which is aligned for
    /// `Self`.
    unsafe fn load(from: *const Self) -> float32x4_t;
}

impl Weight for f32 {
    const ZERO: f32 = 0.0;

    #[inline(always)]
    unsafe fn load(from: *const f32) -> float32x4_t {
        // SAFETY: `Weight::load` asks for NEON and four numbers at `from`.
        unsafe { vld1q_f32(from) }
    }
}

impl Weight for f16 {
    const ZERO: f16 = f16::ZERO;

    #[inline(always)]
    unsafe fn load(from: *const f16) -> float32x4_t {
        // SAFETY: `Weight::load` asks for NEON and four weights at `from`, of two bytes each.
        unsafe { vcvt_f32_f16(vreinterpret_f16_u16(vld1_u16(from.cast()))) }
    }
}

// `load` takes eight bytes.
const _: () = assert!(size_of::<f16>() == 2);

/// The eight lanes of a sum.
type Lanes = [float32x4_t; 2];

/// Adds each of four sums across, in the order of `LANES`.
///
/// # Safety
/// The processor has NEON.
#[inline(always)]
unsafe fn add_across(sums: [Lanes; OUTPUTS]) -> float32x4_t {
    // SAFETY: NEON by this function's contract; registers alone.
    unsafe {
        // [0+4 1+5 2+6 3+7]
        let [a, b, c, d] = sums.map(|[low, high]| vaddq_f32(low, high));
        // Two sums: [(0+4)+(2+6) (1+5)+(3+7)] of each.
        let halves = |x: float32x4_t, y: float32x4_t| {
            let (x, y) = (vreinterpretq_f64_f32(x), vreinterpretq_f64_f32(y));
            vaddq_f32(
                vreinterpretq_f32_f64(vtrn1q_f64(x, y)),
                vreinterpretq_f32_f64(vtrn2q_f64(x, y)),
            )
        };
        vpaddq_f32(halves(a, b), halves(c, d))
    }
}

/// Numbers, at most eight, and zeros behind them.
///
/// # Safety
/// `count` numbers, or the first eight of more, may be read from `from` on, which is aligned for
/// `W`.
#[inline(always)]
unsafe fn some<W: Weight>(from: *const W, count: usize) -> [W; LANES] {
    let mut eight = [W::ZERO; LANES];
    // SAFETY: as many numbers are at `from` by this function's contract, and `eight` has room for
    // `LANES`.
    unsafe { std::ptr::copy_nonoverlapping(from, eight.as_mut_ptr(), count.min(LANES)) };
    eight
}

/// Products of rows with `N` others, all of them `inputs` wide.
///
/// # Safety
/// The processor has NEON. From each of `x` and of `others` on, `inputs` numbers may be read.
#[inline(always)]
unsafe fn dots<W: Weight, const ROWS: usize, const N: usize>(
    x: [*const f32; ROWS],
    others: [*const W; N],
    inputs: usize,
) -> [[Lanes; N]; ROWS] {
    // SAFETY: NEON by this function's contract. `at + LANES` is at most `whole`, which is at most
    // `inputs`, as is what is read behind it; what `some` returns has `LANES` numbers.
    unsafe {
        let mut sums = [[[vdupq_n_f32(0.0); 2]; N]; ROWS];
        let add = |sums: &mut [[Lanes; N]; ROWS], x: [*const f32; ROWS], others: [*const W; N]| {
            for half in 0..2 {
                let x = x.map(|x| vld1q_f32(x.add(half * WIDTH)));
                for (n, other) in others.into_iter().enumerate() {
                    let other = W::load(other.add(half * WIDTH));
                    for (sums, x) in sums.iter_mut().zip(x) {
                        sums[n][half] = vaddq_f32(sums[n][half], vmulq_f32(x, other));
                    }
                }
            }
        };
        let whole = inputs / LANES * LANES;
        let mut at = 0;
        while at < whole {
            add(&mut sums, x.map(|x| x.add(at)), others.map(|other| other.add(at)));
            at += LANES;
        }
        if whole < inputs {
            // A lane is never -0, so adding 0 x 0 leaves it as it is.
            let x = x.map(|x| some(x.add(whole), inputs - whole));
            let others = others.map(|other| some(other.add(whole), inputs - whole));
            let (x, others) = (x.each_ref(), others.each_ref());
            add(&mut sums, x.map(|x| x.as_ptr()), others.map(|other| other.as_ptr()));
        }
        sums
    }
}

/// As `Kernels::dot_f32`.
///
/// # Safety
/// The processor has NEON.
#[inline(always)]
pub(super) unsafe fn dot(lhs: &[f32], rhs: &[f32]) -> f32 {
    // SAFETY: NEON by this function's contract; both slices have as many numbers as the shorter
    // one.
    unsafe {
        let [[sum]] = dots([lhs.as_ptr()], [rhs.as_ptr()], lhs.len().min(rhs.len()));
        vgetq_lane_f32::<0>(add_across([sum; OUTPUTS]))
    }
}

/// As `Kernels::linear_f32` and `Kernels::linear_f16`.
///
/// # Safety
/// The processor has NEON.
#[inline(always)]
pub(super) unsafe fn linear<W: Weight>(
    x: &[f32],
    weight: &[W],
    bias: &[f32],
    inputs: usize,
    out: &mut [f32],
) {
    let inputs = inputs.max(1);
    let outputs = weight.len() / inputs;
    let rows = (x.len() / inputs).min(out.len().checked_div(outputs).unwrap_or(0));
    if rows == 0 {
        return;
    }
    let tiles = rows.div_ceil(ROWS);
    for first in (0..outputs).step_by(OUTPUTS) {
        let here = OUTPUTS.min(outputs - first);
        let mut biases = [0.0; OUTPUTS];
        for (to, bias) in biases.iter_mut().zip(bias.iter().skip(first)) {
            *to = *bias;
        }
        // SAFETY: NEON by this function's contract. `weight` has `outputs` rows of `inputs`
        // numbers; `first + i` is less than `outputs`, as `i` is less than `here`: the last stands
        // in for those that are missing. `x` has `rows` rows of `inputs` numbers, `out` as many of
        // `outputs`, in which `first + here` is at most `outputs`; it is borrowed mutably. `count`
        // is 1 or `ROWS` = 2, and `row + count` at most `rows`.
        unsafe {
            let weight: [*const W; OUTPUTS] =
                std::array::from_fn(|i| weight.as_ptr().add((first + i.min(here - 1)) * inputs));
            let bias = vld1q_f32(biases.as_ptr());
            let mut row = 0;
            for tile in 0..tiles {
                let count = (rows - row).div_ceil(tiles - tile);
                let x = x.as_ptr().add(row * inputs);
                let to = out.as_mut_ptr().add(row * outputs + first);
                match count {
                    1 => rows_of::<W, 1>(x, weight, bias, inputs, (to, outputs, here)),
                    _ => rows_of::<W, ROWS>(x, weight, bias, inputs, (to, outputs, here)),
                }
                row += count;
            }
        }
    }
}

/// A tile, into the first numbers of rows that begin so far apart.
///
/// # Safety
/// The processor has NEON. `ROWS * inputs` numbers may be read from `x` on, `inputs` from each of
/// `weight` on. For each i less than `ROWS`, `count` numbers, at most four, may be written from `to
/// + i * stride` on, none of which is one of those that are read.
#[inline(always)]
unsafe fn rows_of<W: Weight, const ROWS: usize>(
    x: *const f32,
    weight: [*const W; OUTPUTS],
    bias: float32x4_t,
    inputs: usize,
    (to, stride, count): (*mut f32, usize, usize),
) {
    // SAFETY: by this function's contract NEON, a row of `inputs` numbers at each of `x` and of
    // `weight`, and room for `count` numbers in each row of `to`.
    unsafe {
        let x: [*const f32; ROWS] = std::array::from_fn(|i| x.add(i * inputs));
        for (i, sums) in dots(x, weight, inputs).into_iter().enumerate() {
            store_some(vaddq_f32(add_across(sums), bias), to.add(i * stride), count);
        }
    }
}

/// The first numbers of a register to memory.
///
/// # Safety
/// The processor has NEON. `count` numbers, or four where it is more, may be written from `to` on.
#[inline(always)]
unsafe fn store_some(x: float32x4_t, to: *mut f32, count: usize) {
    // SAFETY: by this function's contract NEON, and room for as many numbers; `four` has four.
    unsafe {
        if count == WIDTH {
            vst1q_f32(to, x);
        } else {
            let mut four = [0.0; WIDTH];
            vst1q_f32(four.as_mut_ptr(), x);
            std::ptr::copy_nonoverlapping(four.as_ptr(), to, count.min(WIDTH));
        }
    }
}

/// As `Kernels::scores`.
///
/// # Safety
/// The processor has NEON.
#[inline(always)]
pub(super) unsafe fn scores(
    query: &[f32],
    keys: &[f32],
    stride: usize,
    scale: f32,
    out: &mut [f32],
) {
    let (stride, width) = (stride.max(1), query.len());
    // Rows that overlap are short ones to the definition.
    let whole = match keys.len().checked_sub(width) {
        Some(spare) if stride >= width => {
            (spare / stride + 1).min(keys.len().div_ceil(stride)).min(out.len())
        }
        _ => 0,
    };
    let (done, rest) = out.split_at_mut(whole);
    for (group, out) in done.chunks_mut(OUTPUTS).enumerate() {
        // SAFETY: NEON by this function's contract. Key i begins at `i * stride`, and for i less
        // than `whole` its `width` numbers are inside `keys`; there is a group only where `whole`
        // is not 0. The last key stands in for those that are missing. `store_some` writes no more
        // than four numbers of `out`, which has at most `OUTPUTS` = 4 here and is borrowed mutably.
        unsafe {
            let keys: [*const f32; OUTPUTS] = std::array::from_fn(|i| {
                keys.as_ptr().add((group * OUTPUTS + i).min(whole - 1) * stride)
            });
            let [sums] = dots([query.as_ptr()], keys, width);
            let sums = vmulq_n_f32(add_across(sums), scale);
            store_some(sums, out.as_mut_ptr(), out.len());
        }
    }
    for (out, key) in rest.iter_mut().zip(keys.chunks(stride).skip(whole)) {
        // SAFETY: NEON by this function's contract; `dot` reads no further than its slices.
        *out = unsafe { dot(query, key.get(..width).unwrap_or_default()) } * scale;
    }
}

/// As `Kernels::mix`.
///
/// # Safety
/// The processor has NEON.
#[inline(always)]
pub(super) unsafe fn mix(weights: &[f32], values: &[f32], stride: usize, out: &mut [f32]) {
    let stride = stride.max(1);
    let count = weights.len().min(values.len().div_ceil(stride));
    let width = out.len();
    let whole = count == 0 || (width <= stride && (count - 1) * stride + width <= values.len());
    let done = if whole { width / WIDTH * WIDTH } else { 0 };
    let mut at = 0;
    // SAFETY: NEON by this function's contract. Where `done` is not 0, `whole` holds: value i
    // begins at `i * stride`, and for i less than `count` its `width` numbers are inside `values`;
    // without weights none is read. `at` and as many registers as `mix_columns` takes stay within
    // `done`, which is at most `width`. `out` is borrowed mutably.
    unsafe {
        while at < done {
            // Without weights there may be no value at all.
            let (from, to) = (values.as_ptr().wrapping_add(at), out.as_mut_ptr().add(at));
            // Eight registers hide the latency of their additions.
            if done - at >= 8 * WIDTH {
                mix_columns::<8>(&weights[..count], from, stride, to);
                at += 8 * WIDTH;
            } else {
                mix_columns::<1>(&weights[..count], from, stride, to);
                at += WIDTH;
            }
        }
    }
    let out = &mut out[done..];
    out.fill(0.0);
    for (weight, value) in weights.iter().zip(values.chunks(stride)) {
        for (out, value) in out.iter_mut().zip(value.get(done..).unwrap_or_default()) {
            *out += weight * value;
        }
    }
}

/// Mixes `N` registers of columns of all values.
///
/// # Safety
/// The processor has NEON. For each i less than `weights.len()`, `N * WIDTH` numbers may be read
/// from `values + i * stride` on; as many may be written from `out` on. None of the latter is one
/// of the values or of the weights.
#[inline(always)]
unsafe fn mix_columns<const N: usize>(
    weights: &[f32],
    values: *const f32,
    stride: usize,
    out: *mut f32,
) {
    // SAFETY: by this function's contract NEON, and `N` registers' numbers at each value and at
    // `out`.
    unsafe {
        let mut sums = [vdupq_n_f32(0.0); N];
        for (row, weight) in weights.iter().enumerate() {
            let from = values.add(row * stride);
            for (i, sum) in sums.iter_mut().enumerate() {
                *sum = vaddq_f32(*sum, vmulq_n_f32(vld1q_f32(from.add(i * WIDTH)), *weight));
            }
        }
        for (i, sum) in sums.into_iter().enumerate() {
            vst1q_f32(out.add(i * WIDTH), sum);
        }
    }
}

/// As `Kernels::weigh`.
///
/// # Safety
/// The processor has NEON.
#[inline(always)]
pub(super) unsafe fn weigh(x: &[f32], weights: &[[f32; ANCHORS]], out: &mut [f32]) {
    let channels = (out.len() / ANCHORS).max(1);
    let rows = (x.len() / channels).min(weights.len());
    let weights = &weights[..rows];
    let mut at = 0;
    if out.len() >= ANCHORS {
        // SAFETY: NEON by this function's contract. `x` has `rows` rows of `channels` numbers, as
        // many as `weights`, and `out` has `ANCHORS`; it is borrowed mutably. `at` and as many
        // registers as `weigh_columns` takes stay within `channels`.
        unsafe {
            while at + WIDTH <= channels {
                // Without weights there may be no row at all.
                let (from, to) = (x.as_ptr().wrapping_add(at), out.as_mut_ptr().add(at));
                // Four registers for each of four anchors fill half of the register file.
                if at + 4 * WIDTH <= channels {
                    weigh_columns::<4>(from, weights, channels, to);
                    at += 4 * WIDTH;
                } else {
                    weigh_columns::<1>(from, weights, channels, to);
                    at += WIDTH;
                }
            }
        }
    }
    for (row, weights) in x.chunks_exact(channels).zip(weights) {
        for (out, weight) in out.chunks_exact_mut(channels).zip(weights) {
            for (out, x) in out[at..].iter_mut().zip(&row[at..]) {
                *out += weight * x;
            }
        }
    }
}

/// Weighs `N` registers of channels of all rows.
///
/// # Safety
/// The processor has NEON. For each i less than `weights.len()`, `N * WIDTH` numbers may be read
/// from `x + i * channels` on. For each i less than `ANCHORS`, as many may be read and written from
/// `out + i * channels` on, none of which is one of `x` or of the weights.
#[inline(always)]
unsafe fn weigh_columns<const N: usize>(
    x: *const f32,
    weights: &[[f32; ANCHORS]],
    channels: usize,
    out: *mut f32,
) {
    // SAFETY: by this function's contract NEON, and `N` registers' numbers at each row of `x`,
    // which are as many as the weights, and at each of the `ANCHORS` rows of `out`.
    unsafe {
        let mut sums: [[float32x4_t; N]; ANCHORS] = std::array::from_fn(|anchor| {
            std::array::from_fn(|i| vld1q_f32(out.add(anchor * channels + i * WIDTH)))
        });
        for (row, weights) in weights.iter().enumerate() {
            let x: [float32x4_t; N] =
                std::array::from_fn(|i| vld1q_f32(x.add(row * channels + i * WIDTH)));
            for (sums, weight) in sums.iter_mut().zip(weights) {
                for (sum, x) in sums.iter_mut().zip(x) {
                    *sum = vaddq_f32(*sum, vmulq_n_f32(x, *weight));
                }
            }
        }
        for (anchor, sums) in sums.into_iter().enumerate() {
            for (i, sum) in sums.into_iter().enumerate() {
                vst1q_f32(out.add(anchor * channels + i * WIDTH), sum);
            }
        }
    }
}
