//! Products of int8 matrices.
//!
//! A tile of some rows by some panels stays in registers while all inputs go by: a load of weights serves all rows, four
//! activations of a row, in every lane of a register, serve all panels. Tiles of the same panels follow one another, so
//! that the panels are read from memory once; the next ones are asked for meanwhile.

use std::arch::x86_64::{_MM_HINT_T1, _mm_prefetch};

use rigidformer_core::kernels::Rows;
use rigidformer_core::quant::{self, Scratch};
use rigidformer_core::weights::{PANEL, PANEL_DEPTH, Panels};

use super::super::{Columns, Quantised};

/// Bytes of a panel's group of inputs.
const GROUP: usize = PANEL * PANEL_DEPTH;
/// Units of channels that a tile has at most.
const UNITS: usize = 8;
/// Bytes that weights are asked for ahead, where the next panels are not as close.
const AHEAD: usize = 4096;
/// Inputs from which rows begin at cache lines.
const LONG: usize = 1024;
/// Distances at which too many rows would share the lines of a cache.
const CROWDED: usize = 512;

/// Instructions for products of int8.
pub(super) trait Int8 {
    /// Channels of a unit: [`PANEL`] or a half.
    const CHANNELS: usize;
    /// Bytes of an activation.
    const BYTES: usize;
    /// What is added to activations.
    const OFFSET: i32;
    /// Rows of a tile, at most 13.
    const ROWS: usize;
    /// Sums of a tile.
    const SUMS: usize;
    /// Inputs that [`dot`](Self::dot) takes.
    const STEP: usize;
    /// Sums of a unit.
    type Sums: Copy;
    /// Four inputs of a unit.
    type Weights: Copy;
    /// Four activations of a row.
    type X: Copy;
    /// Part of a product of rows.
    type Dot: Copy;

    /// Sums of a unit before the first product; those given make up for the offset.
    unsafe fn start(from: *const i32) -> Self::Sums;
    /// Four inputs of a unit.
    unsafe fn weights(from: *const i8) -> Self::Weights;
    /// Four activations.
    unsafe fn x(from: *const i8) -> Self::X;
    /// Adds products.
    unsafe fn add(sums: Self::Sums, x: Self::X, weights: Self::Weights) -> Self::Sums;
    /// Scales `count` sums of a unit.
    unsafe fn finish(sums: Self::Sums, row_scale: f32, end: Epilogue, out: *mut f32, count: usize);

    /// A product of rows before its first part.
    unsafe fn nothing() -> Self::Dot;
    /// Adds products of activations and weights.
    unsafe fn dot(sums: Self::Dot, x: *const i8, weights: *const i8) -> Self::Dot;
    /// The whole product.
    unsafe fn across(sums: Self::Dot) -> i32;
}

/// Scales and biases of a unit's channels.
#[derive(Clone, Copy)]
pub(super) struct Epilogue {
    pub(super) scales: *const f32,
    pub(super) bias: *const f32,
}

/// Bytes of a row: groups of four, and where rows are long whole cache lines, of which neighbours do not crowd out each
/// other.
#[inline(always)]
pub(super) fn row_bytes<I: Int8>(inputs: usize) -> usize {
    let bytes = inputs.next_multiple_of(PANEL_DEPTH) * I::BYTES;
    if I::BYTES > 1 || inputs < LONG {
        return bytes;
    }
    let bytes = bytes.next_multiple_of(GROUP);
    if bytes.is_multiple_of(CROWDED) { bytes + GROUP } else { bytes }
}

/// As `Kernels::quantise`.
#[inline(always)]
pub(super) unsafe fn quantise<I: Int8>(x: &[f32], inputs: usize, scratch: &mut Scratch<'_>) {
    let inputs = inputs.max(1);
    let slots = scratch.values.chunks_exact_mut(row_bytes::<I>(inputs));
    let slots = slots.zip(scratch.scales.iter_mut());
    for (row, (values, scale)) in x.chunks_exact(inputs).zip(slots) {
        // Magnitudes compare as their bits do, and infinity and what is not a number are above all that is finite.
        let magnitude = |x: &f32| (x.to_bits() & 0x7fff_ffff) as i32;
        let largest = row.iter().map(magnitude).max().unwrap_or(0);
        let largest = f32::from_bits(largest as u32);
        let (quantum, inverse) = quant::quantum(largest);
        *scale = if largest.is_finite() { quantum } else { f32::NAN };
        // The last bits of the sum are the nearest integer, as in `quant::round`. A finite row needs no clamping: its
        // largest product is 127 and less than a half.
        let rounded = |x: &f32| (x * inverse + 12_582_912.0).to_bits();
        if I::BYTES == 1 {
            let (values, padding) = values.split_at_mut(inputs.min(values.len()));
            for (q, x) in values.iter_mut().zip(row) {
                *q = (rounded(x) as u8 ^ I::OFFSET as u8) as i8;
            }
            padding.fill(0);
        } else {
            let (values, _) = values.as_chunks_mut::<2>();
            let (values, padding) = values.split_at_mut(inputs.min(values.len()));
            for (q, x) in values.iter_mut().zip(row) {
                *q = (rounded(x) as u16).to_le_bytes().map(|byte| byte as i8);
            }
            padding.fill([0; 2]);
        }
    }
}

/// As `Kernels::linear_panels`.
#[inline(always)]
pub(super) unsafe fn linear_panels<I: Int8>(
    scratch: &mut Scratch<'_>,
    weight: Panels<'_>,
    bias: &[f32],
    inputs: usize,
    out: &mut [f32],
) {
    let x = Quantised { values: scratch.values, scales: scratch.scales, inputs };
    // SAFETY: as the caller says.
    unsafe { multiply::<I>(x, weight, bias, Columns::new(out, weight.scales.len())) }
}

/// What tiles of the same panels share.
struct Block<'a> {
    x: *const i8,
    row_bytes: usize,
    row_scales: &'a [f32],
    groups: usize,
    /// First panel, or half of one.
    weights: *const i8,
    /// First channel, of which so many are there.
    channel: usize,
    channels: usize,
    /// Of `UNITS` units.
    starts: [i32; PANEL * UNITS],
    scales: [f32; PANEL * UNITS],
    bias: [f32; PANEL * UNITS],
}

/// As `HostKernels::multiply`.
#[inline(always)]
pub(super) unsafe fn multiply<I: Int8>(
    x: Quantised<'_>,
    weight: Panels<'_>,
    bias: &[f32],
    mut out: Columns<'_>,
) {
    let inputs = x.inputs.max(1);
    let (groups, row_bytes) = (inputs.div_ceil(PANEL_DEPTH), row_bytes::<I>(inputs));
    let rows = out.rows().min(x.scales.len()).min(x.values.len() / row_bytes);
    let whole = weight.values.len() / (groups * GROUP) * PANEL;
    let channels = out.width().min(weight.scales.len()).min(weight.sums.len()).min(whole);
    if rows == 0 || channels == 0 {
        return;
    }
    let tiles = rows.div_ceil(I::ROWS);
    let tallest = rows.div_ceil(tiles);
    let mut block = Block {
        x: x.values.as_ptr(),
        row_bytes,
        row_scales: &x.scales[..rows],
        groups,
        weights: weight.values.as_ptr(),
        channel: 0,
        channels: 0,
        starts: [0; PANEL * UNITS],
        scales: [0.0; PANEL * UNITS],
        bias: [0.0; PANEL * UNITS],
    };
    let mut channel = 0;
    while channel < channels {
        let units = (channels - channel).div_ceil(I::CHANNELS);
        let units = [8, 4, 2].into_iter().find(|n| *n <= units && n * tallest <= I::SUMS);
        let units = units.unwrap_or(1);
        let here = (units * I::CHANNELS).min(channels - channel);
        let columns = channel..channel + here;
        (block.channel, block.channels) = (channel, here);
        for (to, sum) in block.starts.iter_mut().zip(&weight.sums[columns.clone()]) {
            *to = sum.wrapping_mul(-I::OFFSET);
        }
        block.scales[..here].copy_from_slice(&weight.scales[columns.clone()]);
        block.bias[..here].fill(0.0);
        for (to, bias) in
            block.bias.iter_mut().zip(bias.get(columns).or(bias.get(channel..)).unwrap_or_default())
        {
            *to = *bias;
        }
        let panel = channel / PANEL * groups * GROUP;
        // SAFETY: `values` has the panels of all `channels`, `x` has `rows` rows. The caller has the instructions of `I`.
        unsafe {
            block.weights = weight.values.as_ptr().add(panel + channel % PANEL * PANEL_DEPTH);
            match units {
                8 => tiles_of::<I, 8>(&block, &mut out, tiles),
                4 => tiles_of::<I, 4>(&block, &mut out, tiles),
                2 => tiles_of::<I, 2>(&block, &mut out, tiles),
                _ => tiles_of::<I, 1>(&block, &mut out, tiles),
            }
        }
        channel += here;
    }
}

/// All rows of a block, in so many tiles of about as many rows.
#[inline(always)]
unsafe fn tiles_of<I: Int8, const UNITS: usize>(
    block: &Block<'_>,
    out: &mut Columns<'_>,
    tiles: usize,
) {
    let rows = block.row_scales.len();
    let panels = (UNITS * I::CHANNELS).div_ceil(PANEL);
    let next = panels * block.groups * GROUP;
    let mut row = 0;
    for tile in 0..tiles {
        let here = (rows - row).div_ceil(tiles - tile);
        let ahead = match tile {
            // Alone the tile reads all panels from memory: it looks a little ahead.
            0 if tiles == 1 => next.min(AHEAD),
            0 => next,
            _ => 0,
        };
        // SAFETY: as the caller says.
        unsafe {
            match here {
                1 => rows_of::<I, UNITS, 1>(block, out, row, ahead),
                2 => rows_of::<I, UNITS, 2>(block, out, row, ahead),
                3 => rows_of::<I, UNITS, 3>(block, out, row, ahead),
                4 => rows_of::<I, UNITS, 4>(block, out, row, ahead),
                5 => rows_of::<I, UNITS, 5>(block, out, row, ahead),
                6 => rows_of::<I, UNITS, 6>(block, out, row, ahead),
                7 => rows_of::<I, UNITS, 7>(block, out, row, ahead),
                8 => rows_of::<I, UNITS, 8>(block, out, row, ahead),
                9 => rows_of::<I, UNITS, 9>(block, out, row, ahead),
                10 => rows_of::<I, UNITS, 10>(block, out, row, ahead),
                11 => rows_of::<I, UNITS, 11>(block, out, row, ahead),
                12 => rows_of::<I, UNITS, 12>(block, out, row, ahead),
                _ => rows_of::<I, UNITS, 13>(block, out, row, ahead),
            }
        }
        row += here;
    }
}

/// A tile.
#[inline(always)]
unsafe fn rows_of<I: Int8, const UNITS: usize, const ROWS: usize>(
    block: &Block<'_>,
    out: &mut Columns<'_>,
    row: usize,
    ahead: usize,
) {
    // Others are not asked for, and need not be compiled.
    if ROWS * UNITS > I::SUMS || ROWS > I::ROWS {
        return;
    }
    // SAFETY: the rows and panels are there, says the caller, who has the instructions of `I`; a request ahead may miss.
    unsafe {
        let mut sums = [[I::start(block.starts.as_ptr()); UNITS]; ROWS];
        for sums in &mut sums {
            for (unit, sum) in sums.iter_mut().enumerate() {
                *sum = I::start(block.starts.as_ptr().add(unit * I::CHANNELS));
            }
        }
        let places: [usize; UNITS] = std::array::from_fn(|unit| {
            let channel = unit * I::CHANNELS;
            channel / PANEL * block.groups * GROUP + channel % PANEL * PANEL_DEPTH
        });
        let x = block.x.add(row * block.row_bytes);
        for group in 0..block.groups {
            let x: [*const i8; ROWS] = std::array::from_fn(|row| {
                x.add(row * block.row_bytes + group * PANEL_DEPTH * I::BYTES)
            });
            let weights = places.map(|place| block.weights.add(place + group * GROUP));
            for (unit, weights) in weights.into_iter().enumerate() {
                if unit * I::CHANNELS % PANEL == 0 {
                    _mm_prefetch::<_MM_HINT_T1>(weights.wrapping_add(ahead));
                }
            }
            if ROWS < UNITS {
                let x = x.map(|x| I::x(x));
                for (unit, weights) in weights.into_iter().enumerate() {
                    let weights = I::weights(weights);
                    for (sums, x) in sums.iter_mut().zip(x) {
                        sums[unit] = I::add(sums[unit], x, weights);
                    }
                }
            } else {
                let weights = weights.map(|weights| I::weights(weights));
                for (sums, x) in sums.iter_mut().zip(x) {
                    let x = I::x(x);
                    for (sum, weights) in sums.iter_mut().zip(weights) {
                        *sum = I::add(*sum, x, weights);
                    }
                }
            }
        }
        for (i, sums) in sums.into_iter().enumerate() {
            let to = &mut out.row(row + i)[block.channel..block.channel + block.channels];
            for (unit, sums) in sums.into_iter().enumerate() {
                let channel = unit * I::CHANNELS;
                let count = block.channels.saturating_sub(channel).min(I::CHANNELS);
                let end = Epilogue {
                    scales: block.scales.as_ptr().add(channel),
                    bias: block.bias.as_ptr().add(channel),
                };
                let to = to.as_mut_ptr().add(channel.min(block.channels));
                I::finish(sums, block.row_scales[row + i], end, to, count);
            }
        }
    }
}

/// Rows that a pass over a row of weights serves.
const SERVED: usize = 4;

/// As `Kernels::linear_i8`.
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
    let row_bytes = row_bytes::<I>(inputs);
    let rows =
        (out.len() / outputs).min(scratch.scales.len()).min(scratch.values.len() / row_bytes);
    let channels = weight.values.chunks_exact(inputs).zip(weight.scales);
    for (n, (weights, scale)) in channels.enumerate() {
        let bias = bias.get(n).copied().unwrap_or(0.0);
        for row in (0..rows).step_by(SERVED) {
            let here = SERVED.min(rows - row);
            // Rows that are missing are computed as the last one again.
            // SAFETY: there are so many rows of so many bytes. The caller has the instructions of `I`.
            let sums = unsafe {
                let x: [*const i8; SERVED] = std::array::from_fn(|i| {
                    scratch.values.as_ptr().add((row + i.min(here - 1)) * row_bytes)
                });
                dots::<I>(x, weights)
            };
            for (i, sum) in sums.into_iter().enumerate().take(here) {
                let scale = scratch.scales[row + i] * scale;
                out[(row + i) * outputs + n] = sum as f32 * scale + bias;
            }
        }
    }
}

/// Products of rows with one row of weights.
#[inline(always)]
unsafe fn dots<I: Int8>(x: [*const i8; SERVED], weights: &[i8]) -> [i32; SERVED] {
    // The offset, as activations.
    let ones = [1_i8; 64];
    let whole = weights.len() / I::STEP * I::STEP;
    // SAFETY: each of `x` has as many activations as there are weights, says the caller, who has the instructions of `I`.
    unsafe {
        let mut sums = [I::nothing(); SERVED];
        let mut offset = I::nothing();
        for at in (0..whole).step_by(I::STEP) {
            let weights = weights.as_ptr().add(at);
            for (sum, x) in sums.iter_mut().zip(x) {
                *sum = I::dot(*sum, x.add(at * I::BYTES), weights);
            }
            if I::OFFSET != 0 {
                offset = I::dot(offset, ones.as_ptr(), weights);
            }
        }
        let rest = weights.len() - whole;
        if rest > 0 {
            let mut last = [0_i8; 64];
            last[..rest].copy_from_slice(&weights[whole..]);
            for (sum, x) in sums.iter_mut().zip(x) {
                let mut some = [0_i8; 64];
                let from = x.add(whole * I::BYTES);
                std::ptr::copy_nonoverlapping(from, some.as_mut_ptr(), rest * I::BYTES);
                *sum = I::dot(*sum, some.as_ptr(), last.as_ptr());
            }
            if I::OFFSET != 0 {
                offset = I::dot(offset, ones.as_ptr(), last.as_ptr());
            }
        }
        let offset = I::across(offset).wrapping_mul(I::OFFSET);
        sums.map(|sum| I::across(sum).wrapping_sub(offset))
    }
}
