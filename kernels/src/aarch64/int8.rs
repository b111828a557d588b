//! Products of int8 matrices.
//!
//! A tile of some rows by a panel stays in registers while all inputs go by: a load of weights serves all rows. Tiles of
//! the same panel follow one another, so that the panel is read from memory once, from end to end.
#![allow(unsafe_code)]

use std::arch::aarch64::*;

use rigidformer_core::kernels::Rows;
use rigidformer_core::quant::{self, Scratch};
use rigidformer_core::weights::{PANEL, PANEL_DEPTH, Panels};

use super::smmla;
use crate::{Columns, Quantised};

/// Bytes of a panel's group of inputs.
pub(super) const GROUP: usize = PANEL * PANEL_DEPTH;
/// Numbers of a register of 8-bit numbers.
const WIDTH: usize = 16;
/// Inputs from which rows begin at cache lines.
const MIN_ALIGNED_INPUTS: usize = 1024;
/// Distance of rows that makes them compete for the same sets of a cache.
const SET_BYTES: usize = 512;

/// Instructions for products of int8.
///
/// Each implementation names its instructions, which are "the instructions of `I`" in contracts;
/// NEON is among them.
pub(super) trait Int8 {
    /// Whether SMMLA is there beside the instructions.
    const MATRICES: bool = false;
    /// Rows of a tile, at most 6.
    const ROWS: usize;
    /// Whether one row or two need more sums than one of each row and channel, so that none waits for another.
    const CHAINED: bool;
    /// Groups of inputs of a step.
    const STEP: usize;
    /// Sums of a row and a panel.
    type Sums: Copy;
    /// Activations of a step.
    type X: Copy;

    /// Sums before the first product.
    ///
    /// # Safety
    /// The processor has the instructions of `Self`.
    unsafe fn zero() -> Self::Sums;
    /// Activations of a step.
    ///
    /// # Safety
    /// The processor has the instructions of `Self`, and `STEP * PANEL_DEPTH` bytes may be read
    /// from `from` on.
    unsafe fn x(from: *const i8) -> Self::X;
    /// Activations of a single group.
    ///
    /// # Safety
    /// The processor has the instructions of `Self`, and `PANEL_DEPTH` bytes may be read from
    /// `from` on.
    unsafe fn x_of_group(from: *const i8) -> Self::X;
    /// Adds the products of a step, to any of the chains.
    ///
    /// # Safety
    /// The processor has the instructions of `Self`, and `STEP * GROUP` bytes may be read from
    /// `weights` on.
    unsafe fn step<const ROWS: usize, const CHAINS: usize>(
        sums: &mut [[Self::Sums; ROWS]; CHAINS],
        x: [Self::X; ROWS],
        weights: *const i8,
    );
    /// Adds the products of a single group.
    ///
    /// # Safety
    /// The processor has the instructions of `Self`, and [`GROUP`] bytes may be read from `weights`
    /// on.
    unsafe fn group<const ROWS: usize>(
        sums: &mut [Self::Sums; ROWS],
        x: [Self::X; ROWS],
        weights: *const i8,
    );
    /// Sums of two chains.
    ///
    /// # Safety
    /// The processor has the instructions of `Self`.
    unsafe fn join(a: Self::Sums, b: Self::Sums) -> Self::Sums;
    /// A sum for each channel.
    ///
    /// # Safety
    /// The processor has the instructions of `Self`.
    unsafe fn finish(sums: Self::Sums) -> [int32x4_t; 4];

    /// Adds 16 products to four parts of a sum.
    ///
    /// # Safety
    /// The processor has the instructions of `Self`.
    unsafe fn dot(sum: int32x4_t, x: int8x16_t, weights: int8x16_t) -> int32x4_t;
}

/// Bytes of a row: groups of four, and where rows are long whole cache lines, of which neighbours do not crowd out each
/// other.
pub(super) fn row_bytes(inputs: usize) -> usize {
    // Saturated, a length that no memory has stays one: no row of it fits.
    let bytes = inputs.div_ceil(PANEL_DEPTH).saturating_mul(PANEL_DEPTH);
    if inputs < MIN_ALIGNED_INPUTS {
        return bytes;
    }
    let bytes = bytes.div_ceil(GROUP).saturating_mul(GROUP);
    if bytes.is_multiple_of(SET_BYTES) { bytes.saturating_add(GROUP) } else { bytes }
}

/// As `Kernels::quantise`.
///
/// # Safety
/// The processor has NEON.
#[inline(always)]
pub(super) unsafe fn quantise(x: &[f32], inputs: usize, scratch: &mut Scratch<'_>) {
    let inputs = inputs.max(1);
    let slots = scratch.values.chunks_exact_mut(row_bytes(inputs));
    let slots = slots.zip(scratch.scales.iter_mut());
    for (row, (values, scale)) in x.chunks_exact(inputs).zip(slots) {
        let (values, padding) = values.split_at_mut(inputs.min(values.len()));
        padding.fill(0);
        // SAFETY: NEON by this function's contract; `largest` reads no further than its slice.
        let largest = unsafe { largest(row) };
        // The portable path defines what infinity and NaN become.
        if !largest.is_finite() {
            *scale = quant::quantise_row(row, values);
            continue;
        }
        let (quantum, inverse) = quant::quantum(largest);
        *scale = quantum;
        let (chunks, rest) = row.as_chunks::<WIDTH>();
        let (to_chunks, to_rest) = values.as_chunks_mut::<WIDTH>();
        for (to, x) in to_chunks.iter_mut().zip(chunks) {
            // To nearest, ties to even, as `quant::round`; a finite row needs no clamping: its largest product is 127 and
            // less than a half.
            // SAFETY: NEON by this function's contract; `x` has 16 numbers, of which four are read
            // at 0, 4, 8 and 12, and `to` room for as many bytes.
            unsafe {
                let rounded = |at: usize| {
                    let x = vmulq_n_f32(vld1q_f32(x.as_ptr().add(at)), inverse);
                    vreinterpretq_s16_s32(vcvtnq_s32_f32(x))
                };
                let low = vuzp1q_s16(rounded(0), rounded(4));
                let high = vuzp1q_s16(rounded(8), rounded(12));
                let all = vuzp1q_s8(vreinterpretq_s8_s16(low), vreinterpretq_s8_s16(high));
                vst1q_s8(to.as_mut_ptr(), all);
            }
        }
        for (to, x) in to_rest.iter_mut().zip(rest) {
            *to = quant::round(x * inverse);
        }
    }
}

/// Largest magnitude, of which infinity is one, and what is not a number a larger one: bits compare as magnitudes do.
///
/// # Safety
/// The processor has NEON.
#[inline(always)]
unsafe fn largest(row: &[f32]) -> f32 {
    let (chunks, rest) = row.as_chunks::<WIDTH>();
    // SAFETY: NEON by this function's contract; each chunk has 16 numbers, of which four are read
    // at 0, 4, 8 and 12.
    let most = unsafe {
        let mut most = [vdupq_n_u32(0); 4];
        for chunk in chunks {
            for (i, most) in most.iter_mut().enumerate() {
                let x = vabsq_f32(vld1q_f32(chunk.as_ptr().add(4 * i)));
                *most = vmaxq_u32(*most, vreinterpretq_u32_f32(x));
            }
        }
        let [a, b, c, d] = most;
        vmaxvq_u32(vmaxq_u32(vmaxq_u32(a, b), vmaxq_u32(c, d)))
    };
    let most = rest.iter().fold(most, |most, x| most.max(x.to_bits() & 0x7fff_ffff));
    f32::from_bits(most)
}

/// What tiles of the same panel share.
struct Block<'a> {
    /// As many rows as `row_scales` has numbers, each of `row_bytes` bytes, of which `groups * PANEL_DEPTH` are activations.
    x: *const i8,
    row_bytes: usize,
    row_scales: &'a [f32],
    groups: usize,
    /// A panel: `groups * GROUP` bytes.
    weights: *const i8,
    /// First channel, of which so many are there.
    channel: usize,
    channels: usize,
    scales: [f32; PANEL],
    bias: [f32; PANEL],
}

/// As `HostKernels::multiply`.
///
/// # Safety
/// The processor has the instructions of `I`.
#[inline(always)]
pub(super) unsafe fn multiply<I: Int8>(
    x: Quantised<'_>,
    weight: Panels<'_>,
    bias: &[f32],
    mut out: Columns<'_>,
) {
    let inputs = x.inputs.max(1);
    let (groups, row_bytes) = (inputs.div_ceil(PANEL_DEPTH), row_bytes(inputs));
    let rows = out.rows().min(x.scales.len()).min(x.values.len() / row_bytes);
    // As in `row_bytes`: no panel of such a length fits.
    let whole = weight.values.len() / groups.saturating_mul(GROUP) * PANEL;
    let channels = out.width().min(weight.scales.len()).min(whole);
    if rows == 0 || channels == 0 {
        return;
    }
    if I::MATRICES && smmla::is_worth(rows, groups, channels) {
        let (start, stride) = out.origin_and_stride();
        let product = smmla::Product {
            x: x.values.as_ptr(),
            row_bytes,
            row_scales: &x.scales[..rows],
            groups,
            weights: weight.values,
            scales: &weight.scales[..channels],
            bias,
            out: start,
            stride,
        };
        // SAFETY: `MATRICES` says that SMMLA is there. `x` has `rows` rows of `row_bytes`, no less than
        // `groups * PANEL_DEPTH`, and `values` has whole panels for all `channels`. `out` has `rows` rows `stride` apart, of at
        // least `channels` numbers, and is borrowed mutably.
        return unsafe { smmla::multiply(product) };
    }
    const { assert!(I::ROWS <= 6) };
    let tiles = rows.div_ceil(I::ROWS);
    let panels = weight.values.chunks_exact(groups * GROUP);
    for (channel, panel) in (0..channels).step_by(PANEL).zip(panels) {
        let here = PANEL.min(channels - channel);
        let mut block = Block {
            x: x.values.as_ptr(),
            row_bytes,
            row_scales: &x.scales[..rows],
            groups,
            weights: panel.as_ptr(),
            channel,
            channels: here,
            scales: [0.0; PANEL],
            bias: [0.0; PANEL],
        };
        block.scales[..here].copy_from_slice(&weight.scales[channel..channel + here]);
        for (to, bias) in block.bias[..here].iter_mut().zip(bias.iter().skip(channel)) {
            *to = *bias;
        }
        let mut row = 0;
        for tile in 0..tiles {
            let here = (rows - row).div_ceil(tiles - tile);
            // SAFETY: the instructions by this function's contract. `x` has `rows` rows of
            // `row_bytes`, no less than `groups * PANEL_DEPTH`, and `panel` has `groups * GROUP`
            // bytes, as `Block` says. `here` is 1 to `I::ROWS`, at most 6, and `row + here` at most
            // `rows`.
            unsafe {
                match here {
                    // Few rows have few sums, whose latency would limit the loop: chains double or quadruple them.
                    1 if I::CHAINED => rows_of::<I, 1, 4>(&block, &mut out, row),
                    2 if I::CHAINED => rows_of::<I, 2, 2>(&block, &mut out, row),
                    1 => rows_of::<I, 1, 1>(&block, &mut out, row),
                    2 => rows_of::<I, 2, 1>(&block, &mut out, row),
                    3 => rows_of::<I, 3, 1>(&block, &mut out, row),
                    4 => rows_of::<I, 4, 1>(&block, &mut out, row),
                    5 => rows_of::<I, 5, 1>(&block, &mut out, row),
                    _ => rows_of::<I, 6, 1>(&block, &mut out, row),
                }
            }
            row += here;
        }
    }
}

/// A tile.
///
/// # Safety
/// The processor has the instructions of `I`. The fields of `block` point to what they say. `row +
/// ROWS` is at most the block's rows.
#[inline(always)]
unsafe fn rows_of<I: Int8, const ROWS: usize, const CHAINS: usize>(
    block: &Block<'_>,
    out: &mut Columns<'_>,
    row: usize,
) {
    // `multiply` calls no others, so they need not be compiled.
    if ROWS > I::ROWS || (CHAINS > 1) != (I::CHAINED && ROWS < 3) {
        return;
    }
    // SAFETY: the instructions by this function's contract. Row `row + i` is one of the block's.
    // `group + STEP` in the first loop and `group + 1` in the second are at most `groups`, so that
    // activations and weights of these groups are there. `scales`, `bias` and `direct` have `PANEL`
    // = 16 numbers, of which four are taken at 0, 4, 8 and 12.
    unsafe {
        let mut sums = [[I::zero(); ROWS]; CHAINS];
        let x: [*const i8; ROWS] =
            std::array::from_fn(|i| block.x.add((row + i) * block.row_bytes));
        let whole = block.groups / I::STEP * I::STEP;
        let mut group = 0;
        while group < whole {
            let x = x.map(|x| I::x(x.add(group * PANEL_DEPTH)));
            I::step(&mut sums, x, block.weights.add(group * GROUP));
            group += I::STEP;
        }
        while group < block.groups {
            let x = x.map(|x| I::x_of_group(x.add(group * PANEL_DEPTH)));
            I::group(&mut sums[0], x, block.weights.add(group * GROUP));
            group += 1;
        }
        // Sums move to an array of their own: the compiler keeps an array that is indexed in memory.
        let sums: [[int32x4_t; 4]; ROWS] = std::array::from_fn(|i| {
            let mut sum = sums[0][i];
            for chain in &sums[1..] {
                sum = I::join(sum, chain[i]);
            }
            I::finish(sum)
        });
        let quarters = [0, 4, 8, 12];
        let scales = quarters.map(|at| vld1q_f32(block.scales.as_ptr().add(at)));
        let bias = quarters.map(|at| vld1q_f32(block.bias.as_ptr().add(at)));
        for (i, sums) in sums.into_iter().enumerate() {
            let to = &mut out.row(row + i)[block.channel..block.channel + block.channels];
            let mut some = [0.0_f32; PANEL];
            // A partial panel goes through an array, so that nothing behind the row is written.
            let full = to.len() == PANEL;
            let direct = if full { to.as_mut_ptr() } else { some.as_mut_ptr() };
            for (quarter, sums) in sums.into_iter().enumerate() {
                let scales = vmulq_n_f32(scales[quarter], block.row_scales[row + i]);
                let numbers = vaddq_f32(vmulq_f32(vcvtq_f32_s32(sums), scales), bias[quarter]);
                vst1q_f32(direct.add(quarters[quarter]), numbers);
            }
            if !full {
                to.copy_from_slice(&some[..to.len()]);
            }
        }
    }
}

/// Rows, and rows of weights, that go through the registers together.
const SERVED: usize = 4;

/// As `Kernels::linear_i8`.
///
/// # Safety
/// The processor has the instructions of `I`.
#[inline(always)]
pub(super) unsafe fn linear<I: Int8>(
    scratch: &mut Scratch<'_>,
    weight: Rows<'_>,
    bias: &[f32],
    inputs: usize,
    out: &mut [f32],
) {
    let inputs = inputs.max(1);
    let outputs = weight.scales.len().max(1);
    let row_bytes = row_bytes(inputs);
    let rows =
        (out.len() / outputs).min(scratch.scales.len()).min(scratch.values.len() / row_bytes);
    let channels = weight.scales.len().min(weight.values.len() / inputs);
    for first in (0..channels).step_by(SERVED) {
        let here = SERVED.min(channels - first);
        let mut row = 0;
        while row < rows {
            // The last channel stands in for missing ones.
            // SAFETY: the instructions by this function's contract. `first + i` is less than
            // `channels`, as `i` is less than `here`: a row of `inputs` weights. `values` has
            // `rows` rows of `row_bytes`, no less than `inputs`, and `dots` takes no more than are
            // left.
            let (sums, count) = unsafe {
                let weights: [*const i8; SERVED] = std::array::from_fn(|i| {
                    weight.values.as_ptr().add((first + i.min(here - 1)) * inputs)
                });
                let x = scratch.values.as_ptr().add(row * row_bytes);
                if rows - row >= SERVED {
                    let x: [*const i8; SERVED] = std::array::from_fn(|i| x.add(i * row_bytes));
                    (dots::<I, SERVED>(x, weights, inputs), SERVED)
                } else {
                    let [sums] = dots::<I, 1>([x], weights, inputs);
                    ([sums; SERVED], 1)
                }
            };
            for (i, sums) in sums.into_iter().enumerate().take(count) {
                let out = &mut out[(row + i) * outputs + first..][..here];
                for (j, (out, sum)) in out.iter_mut().zip(sums).enumerate() {
                    let scale = scratch.scales[row + i] * weight.scales[first + j];
                    *out = sum as f32 * scale + bias.get(first + j).copied().unwrap_or(0.0);
                }
            }
            row += count;
        }
    }
}

/// Products of rows with rows of weights.
///
/// # Safety
/// The processor has the instructions of `I`. From each of `x` and of `weights` on, `inputs` bytes
/// may be read.
#[inline(always)]
unsafe fn dots<I: Int8, const ROWS: usize>(
    x: [*const i8; ROWS],
    weights: [*const i8; SERVED],
    inputs: usize,
) -> [[i32; SERVED]; ROWS] {
    let whole = inputs / WIDTH * WIDTH;
    // SAFETY: the instructions by this function's contract. `at + WIDTH` is at most `whole`, which
    // is at most `inputs`, as is what is read behind it; `some` has `WIDTH` numbers, no fewer than
    // are copied.
    unsafe {
        let mut sums = [[vdupq_n_s32(0); SERVED]; ROWS];
        for at in (0..whole).step_by(WIDTH) {
            let load = |from: *const i8| vld1q_s8(from.add(at));
            add_dots::<I, ROWS>(&mut sums, x.map(load), weights.map(load));
        }
        if whole < inputs {
            let load = |from: *const i8| {
                let mut some = [0_i8; WIDTH];
                std::ptr::copy_nonoverlapping(from.add(whole), some.as_mut_ptr(), inputs - whole);
                vld1q_s8(some.as_ptr())
            };
            add_dots::<I, ROWS>(&mut sums, x.map(load), weights.map(load));
        }
        sums.map(|[a, b, c, d]| {
            let mut four = [0; SERVED];
            let sums = vpaddq_s32(vpaddq_s32(a, b), vpaddq_s32(c, d));
            vst1q_s32(four.as_mut_ptr(), sums);
            four
        })
    }
}

/// Adds 16 products of each row with each row of weights.
///
/// # Safety
/// The processor has the instructions of `I`.
#[inline(always)]
unsafe fn add_dots<I: Int8, const ROWS: usize>(
    sums: &mut [[int32x4_t; SERVED]; ROWS],
    x: [int8x16_t; ROWS],
    weights: [int8x16_t; SERVED],
) {
    for (sums, x) in sums.iter_mut().zip(x) {
        for (sum, weights) in sums.iter_mut().zip(weights) {
            // SAFETY: the instructions by this function's contract.
            *sum = unsafe { I::dot(*sum, x, weights) };
        }
    }
}
