//! Products of int8 matrices.
//!
//! A tile of some rows by some panels stays in registers while all inputs go by: a load of weights serves all rows, four
//! activations of a row, in every lane of a register, serve all panels. Tiles of the same panels follow one another, so
//! that the panels are read from memory once; the next ones are prefetched meanwhile.

use std::arch::x86_64::{_MM_HINT_T1, _mm_prefetch};
use std::mem::MaybeUninit;

use rigidformer_core::kernels::Rows;
use rigidformer_core::quant::{self, Scratch};
use rigidformer_core::weights::{PANEL, PANEL_DEPTH, Panels};

use super::amx::{self, GROUP};
use crate::{Columns, Quantised};

/// Units of channels that a tile has at most.
const UNITS: usize = 8;
/// Largest distance of a prefetch of weights, bytes.
// A single tile reads all panels from memory, and a nearer prefetch arrives in time.
const PREFETCH_BYTES: usize = 4096;
/// Inputs from which rows begin at cache lines.
// A load across two lines costs as much as two loads.
const MIN_ALIGNED_INPUTS: usize = 1024;
/// Distance of rows that makes them compete for the same sets of a cache.
// A tile reads up to 13 rows at a time, and a set holds fewer lines.
const SET_BYTES: usize = 512;

/// Numbers that a tile has at most: 13 rows of two panels.
const TILE: usize = PANEL * 2 * 13;
/// Numbers, or bytes of activations, that a step has at most.
const MAX_STEP: usize = 64;

/// Instructions for products of int8.
///
/// Each implementation names its instructions, which are "the instructions of `I`" in contracts.
/// Pointers to f32 and i32 are aligned as these demand; those to bytes need not be.
pub(super) trait Int8 {
    /// Channels of a unit: [`PANEL`] or a half.
    const CHANNELS: usize;
    /// Bytes of an activation.
    const BYTES: usize;
    /// Bytes behind the activations of a row.
    const END: usize = 0;
    /// Whether 128 is added to activations.
    const OFFSET: bool;
    /// Whether AMX and AVX-512 are there beside the instructions: [`amx::is_there`] has said so.
    const MATRICES: bool = false;
    /// Rows of a tile, at most 13.
    const ROWS: usize;
    /// Sums of a tile, of which each has [`CHANNELS`](Self::CHANNELS) numbers: at most [`TILE`] numbers.
    const SUMS: usize;
    /// Inputs that [`dot`](Self::dot), [`magnitudes`](Self::magnitudes) and [`quantise`](Self::quantise) take: at most
    /// [`MAX_STEP`] numbers, and at most as many bytes.
    const STEP: usize;
    /// Sums of a unit.
    type Sums: Copy;
    /// Four inputs of a unit.
    type Weights: Copy;
    /// Four activations of a row.
    type X: Copy;
    /// Part of a product of rows, or integers.
    type Dot: Copy;

    /// The largest bits of magnitudes of [`STEP`](Self::STEP) numbers and those before: infinity and what is not a number are
    /// above all that is finite.
    ///
    /// # Safety
    /// The processor has the instructions of `Self`, and [`STEP`](Self::STEP) numbers may be read
    /// from `from` on.
    unsafe fn magnitudes(most: Self::Dot, from: *const f32) -> Self::Dot;
    /// The largest of all.
    ///
    /// # Safety
    /// The processor has the instructions of `Self`.
    unsafe fn most(most: Self::Dot) -> i32;
    /// Quantises [`STEP`](Self::STEP) finite numbers. None needs clamping: the largest product is 127 and less than a half.
    /// Adds to `correction` what [`write_correction`](Self::write_correction) takes.
    ///
    /// # Safety
    /// The processor has the instructions of `Self`. [`STEP`](Self::STEP) numbers may be read from
    /// `from` on, and `STEP * BYTES` bytes written from `to` on.
    unsafe fn quantise(
        correction: Self::Dot,
        from: *const f32,
        inverse: f32,
        to: *mut i8,
    ) -> Self::Dot;

    /// Writes behind a row's activations what each sum of its products lacks, where kernels need it.
    ///
    /// # Safety
    /// The processor has the instructions of `Self`, and [`END`](Self::END) bytes may be written from `end` on.
    #[inline(always)]
    unsafe fn write_correction(_correction: Self::Dot, _end: *mut i8) {}
    /// What each sum of a row's products lacks.
    ///
    /// # Safety
    /// [`END`](Self::END) bytes may be read from `end` on.
    #[inline(always)]
    unsafe fn correction(_end: *const i8) -> i32 {
        0
    }

    /// Sums of a unit before the first product, which make up for the offset; given are the sums of the weights, and what
    /// the row's [correction](Self::correction).
    ///
    /// # Safety
    /// The processor has the instructions of `Self`, and [`CHANNELS`](Self::CHANNELS) numbers may
    /// be read from `weights` on.
    unsafe fn start(weights: *const i32, correction: i32) -> Self::Sums;
    /// Four inputs of a unit.
    ///
    /// # Safety
    /// The processor has the instructions of `Self`, and `CHANNELS * PANEL_DEPTH` bytes may be read
    /// from `from` on.
    unsafe fn weights(from: *const i8) -> Self::Weights;
    /// Four activations.
    ///
    /// # Safety
    /// The processor has the instructions of `Self`, and `PANEL_DEPTH * BYTES` bytes may be read
    /// from `from` on.
    unsafe fn x(from: *const i8) -> Self::X;
    /// Adds products.
    ///
    /// # Safety
    /// The processor has the instructions of `Self`.
    unsafe fn add(sums: Self::Sums, x: Self::X, weights: Self::Weights) -> Self::Sums;
    /// Scales the sums of a unit.
    ///
    /// # Safety
    /// The processor has the instructions of `Self`. [`CHANNELS`](Self::CHANNELS) numbers may be
    /// read from `end.scales` and from `end.bias` on, and as many written from `out` on.
    unsafe fn finish(sums: Self::Sums, row_scale: f32, end: Epilogue, out: *mut f32);

    /// A product of rows before its first part.
    ///
    /// # Safety
    /// The processor has the instructions of `Self`.
    unsafe fn nothing() -> Self::Dot;
    /// Adds products of activations and weights.
    ///
    /// # Safety
    /// The processor has the instructions of `Self`. `STEP * BYTES` bytes may be read from `x` on,
    /// and [`STEP`](Self::STEP) bytes from `weights` on.
    unsafe fn dot(sums: Self::Dot, x: *const i8, weights: *const i8) -> Self::Dot;
    /// The whole products, less what the offset times the weights comes to, whose parts are given.
    ///
    /// # Safety
    /// The processor has the instructions of `Self`.
    unsafe fn across(sums: [Self::Dot; SERVED], weights: Self::Dot) -> [i32; SERVED];
}

/// Scales and biases of a unit's channels, or of those of several; contracts say how many.
#[derive(Clone, Copy)]
pub(super) struct Epilogue {
    pub(super) scales: *const f32,
    pub(super) bias: *const f32,
}

/// Bytes of a row: groups of four, and where rows are long whole cache lines, of which neighbours do not crowd out each
/// other.
#[inline(always)]
pub(super) fn row_bytes<I: Int8>(inputs: usize) -> usize {
    let bytes = end::<I>(inputs).saturating_add(I::END);
    // Two bytes an activation leave no room for alignment, and short rows gain little from it.
    if I::BYTES > 1 || inputs < MIN_ALIGNED_INPUTS {
        return bytes;
    }
    let bytes = bytes.div_ceil(GROUP).saturating_mul(GROUP);
    if bytes.is_multiple_of(SET_BYTES) { bytes.saturating_add(GROUP) } else { bytes }
}

/// Bytes of a row's activations, in groups of four.
#[inline(always)]
fn end<I: Int8>(inputs: usize) -> usize {
    // Saturated, a length that no memory has stays one: no row of it fits.
    inputs.div_ceil(PANEL_DEPTH).saturating_mul(PANEL_DEPTH * I::BYTES)
}

/// Numbers that are measured before they are quantised.
// 16 KiB, which the first-level cache keeps.
const NUMBERS_AHEAD: usize = 4096;
/// Rows of them, at most.
const ROWS_AHEAD: usize = 8;

/// As `Kernels::quantise`.
///
/// # Safety
/// The processor has the instructions of `I`.
#[inline(always)]
pub(super) unsafe fn quantise<I: Int8>(x: &[f32], inputs: usize, scratch: &mut Scratch<'_>) {
    let inputs = inputs.max(1);
    let row_bytes = row_bytes::<I>(inputs);
    let rows = (x.len() / inputs).min(scratch.scales.len()).min(scratch.values.len() / row_bytes);
    const { assert!(I::STEP <= MAX_STEP && I::STEP * I::BYTES <= MAX_STEP) };
    let whole = inputs / I::STEP * I::STEP;
    let end = end::<I>(inputs);
    // Several rows are measured before any is quantised, so that nothing waits for the maximum of one.
    let ahead = (NUMBERS_AHEAD / inputs).clamp(1, ROWS_AHEAD);
    let mut row = 0;
    while row < rows {
        let here = ahead.min(rows - row);
        let mut inverses = [0.0; ROWS_AHEAD];
        for (i, to) in inverses.iter_mut().enumerate().take(here) {
            let x = &x[(row + i) * inputs..(row + i + 1) * inputs];
            // SAFETY: the instructions by this function's contract. `at + STEP` is at most `whole`,
            // and so inside the row; `padded` has `MAX_STEP` numbers, no fewer than `STEP`.
            let largest = unsafe {
                let mut most = I::nothing();
                for at in (0..whole).step_by(I::STEP) {
                    most = I::magnitudes(most, x.as_ptr().add(at));
                }
                if whole < inputs {
                    most = I::magnitudes(most, padded(&x[whole..]).as_ptr());
                }
                f32::from_bits(I::most(most) as u32)
            };
            let (quantum, inverse) = quant::quantum(largest);
            // A row with infinity or NaN has no scale, and NaN marks its products.
            scratch.scales[row + i] = if largest.is_finite() { quantum } else { f32::NAN };
            *to = inverse;
        }
        for (i, inverse) in inverses.into_iter().enumerate().take(here) {
            let x = &x[(row + i) * inputs..(row + i + 1) * inputs];
            let values = &mut scratch.values[(row + i) * row_bytes..(row + i + 1) * row_bytes];
            // SAFETY: the instructions by this function's contract. `at + STEP` is at most `whole`,
            // which is inside the row and, times `BYTES`, inside `values`: `row_bytes` is no less
            // than `end + END`. `padded` has `MAX_STEP` numbers and `bytes` as many bytes, no
            // fewer than `STEP` and `STEP * BYTES`.
            unsafe {
                let mut correction = I::nothing();
                for at in (0..whole).step_by(I::STEP) {
                    let to = values.as_mut_ptr().add(at * I::BYTES);
                    correction = I::quantise(correction, x.as_ptr().add(at), inverse, to);
                }
                let rest = inputs - whole;
                if rest > 0 {
                    let mut bytes = [0_i8; MAX_STEP];
                    let from = padded(&x[whole..]);
                    correction =
                        I::quantise(correction, from.as_ptr(), inverse, bytes.as_mut_ptr());
                    // Whole groups: what is behind the last input multiplies weights of zero.
                    let rest = rest.div_ceil(PANEL_DEPTH) * PANEL_DEPTH * I::BYTES;
                    values[whole * I::BYTES..][..rest].copy_from_slice(&bytes[..rest]);
                }
                I::write_correction(correction, values.as_mut_ptr().add(end));
            }
        }
        row += here;
    }
}

/// Fewer than [`MAX_STEP`] numbers and zeros.
#[inline(always)]
fn padded(numbers: &[f32]) -> [f32; MAX_STEP] {
    let mut all = [0.0; MAX_STEP];
    all[..numbers.len()].copy_from_slice(numbers);
    all
}

/// What tiles of the same panels share.
#[derive(Clone, Copy)]
struct Block<'a> {
    /// As many rows as `row_scales` has numbers, each of `row_bytes` bytes, of which `groups * PANEL_DEPTH * I::BYTES`
    /// are activations, with `I::END` bytes behind them.
    x: *const i8,
    row_bytes: usize,
    row_scales: &'a [f32],
    groups: usize,
    /// First panel, or half of one where the block has a single unit. Panels take `groups * GROUP` bytes each; all that
    /// have a channel of the block's units are whole.
    weights: *const i8,
    /// As many as the channels of the block's units, as are the numbers of `end`.
    sums: *const i32,
    end: Epilogue,
    /// First channel's place in the first row, and numbers to the next. Each of the rows has room for `channels` numbers,
    /// which nothing else overlaps.
    out: *mut f32,
    stride: usize,
    /// Channels that are there, at most those of the block's units.
    channels: usize,
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
    let (groups, row_bytes) = (inputs.div_ceil(PANEL_DEPTH), row_bytes::<I>(inputs));
    let rows = out.rows().min(x.scales.len()).min(x.values.len() / row_bytes);
    // As in `row_bytes`: no panel of such a length fits.
    let whole = weight.values.len() / groups.saturating_mul(GROUP) * PANEL;
    let channels = out.width().min(weight.scales.len()).min(weight.sums.len()).min(whole);
    if rows == 0 || channels == 0 {
        return;
    }
    if I::MATRICES && amx::is_worth(rows, groups, channels) {
        let (start, stride) = out.origin_and_stride();
        let product = amx::Product {
            x: x.values.as_ptr(),
            row_bytes,
            row_scales: &x.scales[..rows],
            groups,
            weights: weight.values,
            sums: &weight.sums[..channels],
            scales: &weight.scales[..channels],
            bias,
            out: start,
            stride,
        };
        // SAFETY: `MATRICES` says that AMX and AVX-512 are there. `x` has `rows` rows of
        // `row_bytes`, of which the first `groups * PANEL_DEPTH` are activations; `values` has whole panels for all `channels`;
        // `is_worth` asks for enough groups; `out` has `rows` rows `stride` apart, of at least `channels` numbers, and is borrowed mutably.
        return unsafe { amx::multiply(product) };
    }
    const { assert!(I::ROWS <= 13 && I::ROWS <= I::SUMS && I::SUMS * I::CHANNELS <= TILE) };
    const { assert!(I::CHANNELS == PANEL || 2 * I::CHANNELS == PANEL) };
    let tiles = rows.div_ceil(I::ROWS);
    // Tiles of about equal height keep registers busy; a short last tile would not.
    let tallest = rows.div_ceil(tiles);
    let (start, stride) = out.origin_and_stride();
    let mut channel = 0;
    while channel < channels {
        let units = (channels - channel).div_ceil(I::CHANNELS);
        // The most units whose sums fit the registers at this height of tiles.
        let units = [8, 4, 2].into_iter().find(|n| *n <= units && n * tallest <= I::SUMS);
        let units = units.unwrap_or(1);
        let here = (units * I::CHANNELS).min(channels - channel);
        let columns = channel..channel + here;
        // Zeros stand in for channels that a unit lacks, and for missing biases.
        let (mut sums, mut scales, mut biases) =
            ([0; PANEL * UNITS], [0.0; PANEL * UNITS], [0.0; PANEL * UNITS]);
        let some = bias.get(channel.min(bias.len())..).unwrap_or_default();
        let (first, scales) = if here == units * I::CHANNELS {
            (weight.sums[columns.clone()].as_ptr(), weight.scales[columns].as_ptr())
        } else {
            sums[..here].copy_from_slice(&weight.sums[columns.clone()]);
            scales[..here].copy_from_slice(&weight.scales[columns]);
            (sums.as_ptr(), scales.as_ptr())
        };
        let bias = if some.len() >= units * I::CHANNELS {
            some.as_ptr()
        } else {
            for (to, bias) in biases.iter_mut().zip(some) {
                *to = *bias;
            }
            biases.as_ptr()
        };
        let end = Epilogue { scales, bias };
        let panel = channel / PANEL * groups * GROUP;
        // SAFETY: the instructions by this function's contract. The rest is what `Block` says. `x`
        // has `rows` rows of `row_bytes`, no less than `groups * PANEL_DEPTH * BYTES + END`. `values` has
        // whole panels for all `channels`, and for the last unit, which begins below `channels`. A
        // block begins at a panel, or has one unit: `units` is even until the last block, or always
        // 1. `sums` and `end` have `units * CHANNELS` numbers: slices that are as long, or arrays
        // of `PANEL * UNITS`. `out` has `rows` rows `stride` apart, in each of which `channel +
        // here` is at most its width, and is borrowed mutably. `tiles` is at most `rows`.
        unsafe {
            let block = Block {
                x: x.values.as_ptr(),
                row_bytes,
                row_scales: &x.scales[..rows],
                groups,
                weights: weight.values.as_ptr().add(panel + channel % PANEL * PANEL_DEPTH),
                sums: first,
                end,
                out: start.add(channel),
                stride,
                channels: here,
            };
            match units {
                8 => tiles_of::<I, 8>(block, tiles),
                4 => tiles_of::<I, 4>(block, tiles),
                2 => tiles_of::<I, 2>(block, tiles),
                _ => tiles_of::<I, 1>(block, tiles),
            }
        }
        channel += here;
    }
}

/// All rows of a block, in so many tiles of about as many rows.
///
/// # Safety
/// The processor has the instructions of `I`. The fields of `block` point to what they say, for
/// `UNITS` units. `tiles` is at most the block's rows, and large enough for tiles of no more than
/// 13 rows.
#[inline(always)]
unsafe fn tiles_of<I: Int8, const UNITS: usize>(block: Block<'_>, tiles: usize) {
    let rows = block.row_scales.len();
    let next = (UNITS * I::CHANNELS).div_ceil(PANEL) * block.groups * GROUP;
    let mut row = 0;
    for tile in 0..tiles {
        let here = (rows - row).div_ceil(tiles - tile);
        let ahead = match tile {
            // A single tile reads all panels from memory, so it prefetches a little ahead.
            0 if tiles == 1 => next.min(PREFETCH_BYTES),
            0 => next,
            _ => 0,
        };
        // SAFETY: by this function's contract the instructions and the block. `here` is 1 to 13,
        // and `row + here` at most the block's rows.
        unsafe {
            match here {
                1 => rows_of::<I, UNITS, 1>(block, row, ahead),
                2 => rows_of::<I, UNITS, 2>(block, row, ahead),
                3 => rows_of::<I, UNITS, 3>(block, row, ahead),
                4 => rows_of::<I, UNITS, 4>(block, row, ahead),
                5 => rows_of::<I, UNITS, 5>(block, row, ahead),
                6 => rows_of::<I, UNITS, 6>(block, row, ahead),
                7 => rows_of::<I, UNITS, 7>(block, row, ahead),
                8 => rows_of::<I, UNITS, 8>(block, row, ahead),
                9 => rows_of::<I, UNITS, 9>(block, row, ahead),
                10 => rows_of::<I, UNITS, 10>(block, row, ahead),
                11 => rows_of::<I, UNITS, 11>(block, row, ahead),
                12 => rows_of::<I, UNITS, 12>(block, row, ahead),
                _ => rows_of::<I, UNITS, 13>(block, row, ahead),
            }
        }
        row += here;
    }
}

/// A tile.
///
/// # Safety
/// The processor has the instructions of `I`. The fields of `block` point to what they say, for
/// `UNITS` units. `row + ROWS` is at most the block's rows.
#[inline(always)]
unsafe fn rows_of<I: Int8, const UNITS: usize, const ROWS: usize>(
    block: Block<'_>,
    row: usize,
    ahead: usize,
) {
    // `tiles_of` calls no others, so they need not be compiled.
    if ROWS * UNITS > I::SUMS || ROWS > I::ROWS {
        return;
    }
    // SAFETY: by this function's contract the instructions and the block. Its `sums` have the
    // channels of `UNITS` units. Row `row + ROWS - 1` is one of the block's, with `END` bytes behind its
    // activations, and group `group` of it is among these. A unit's weights are in a panel of the block, and in group
    // `group` of it; a request ahead reads nothing, so that it may miss. `to` is row `row` of
    // `out`, with room for `channels` numbers: either those of all units, or `finish` writes to
    // `all`, which has room for `ROWS * UNITS * CHANNELS` numbers, at most `SUMS * CHANNELS`, and
    // `channels` of each row are copied from there.
    unsafe {
        let x = block.x.add(row * block.row_bytes);
        let mut sums: [[I::Sums; UNITS]; ROWS] = std::array::from_fn(|row| {
            let end = block.groups * PANEL_DEPTH * I::BYTES;
            let correction = I::correction(x.add(row * block.row_bytes + end));
            std::array::from_fn(|unit| I::start(block.sums.add(unit * I::CHANNELS), correction))
        });
        let offsets: [usize; UNITS] = std::array::from_fn(|unit| {
            let channel = unit * I::CHANNELS;
            channel / PANEL * block.groups * GROUP + channel % PANEL * PANEL_DEPTH
        });
        for group in 0..block.groups {
            let x: [*const i8; ROWS] = std::array::from_fn(|row| {
                x.add(row * block.row_bytes + group * PANEL_DEPTH * I::BYTES)
            });
            let weights = offsets.map(|place| block.weights.add(place + group * GROUP));
            for (unit, weights) in weights.into_iter().enumerate() {
                // A panel's group is a cache line: one prefetch serves both halves.
                if unit * I::CHANNELS % PANEL == 0 {
                    _mm_prefetch::<_MM_HINT_T1>(weights.wrapping_add(ahead));
                }
            }
            // The smaller operand stays in registers: activations of few rows, or weights of few units.
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
        let row_scales = block.row_scales.as_ptr().add(row);
        let to = block.out.add(row * block.stride);
        // Whole units are stored directly. Others go through an array, so that nothing behind the channels is written.
        if block.channels == UNITS * I::CHANNELS {
            finish::<I, UNITS, ROWS>(sums, row_scales, block.end, to, block.stride);
        } else {
            let mut all = [const { MaybeUninit::<f32>::uninit() }; TILE];
            let all = all.as_mut_ptr().cast::<f32>();
            let width = UNITS * I::CHANNELS;
            finish::<I, UNITS, ROWS>(sums, row_scales, block.end, all, width);
            for i in 0..ROWS {
                let (from, to) = (all.add(i * width), to.add(i * block.stride));
                std::ptr::copy_nonoverlapping(from, to, block.channels);
            }
        }
    }
}

/// Scales all sums of a tile.
///
/// # Safety
/// The processor has the instructions of `I`. `ROWS` numbers may be read from `row_scales` on,
/// `UNITS * I::CHANNELS` from `end.scales` and from `end.bias` on. For each i less than `ROWS`,
/// `UNITS * I::CHANNELS` numbers may be written from `out + i * stride` on; none of them is one of
/// those that are read.
#[inline(always)]
unsafe fn finish<I: Int8, const UNITS: usize, const ROWS: usize>(
    sums: [[I::Sums; UNITS]; ROWS],
    row_scales: *const f32,
    end: Epilogue,
    out: *mut f32,
    stride: usize,
) {
    for (row, sums) in sums.iter().enumerate() {
        for (unit, sums) in sums.iter().enumerate() {
            let channel = unit * I::CHANNELS;
            // SAFETY: the instructions by this function's contract. `unit` is less than `UNITS`, so
            // that the `CHANNELS` numbers from `channel` on are inside `end` and inside row `row`
            // of `out`; `row` is less than `ROWS`.
            unsafe {
                let end = Epilogue { scales: end.scales.add(channel), bias: end.bias.add(channel) };
                let to = out.add(row * stride + channel);
                I::finish(*sums, *row_scales.add(row), end, to);
            }
        }
    }
}

/// Rows that a pass over a row of weights serves.
pub(super) const SERVED: usize = 4;

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
    let (row_bytes, end) = (row_bytes::<I>(inputs), end::<I>(inputs));
    let rows =
        (out.len() / outputs).min(scratch.scales.len()).min(scratch.values.len() / row_bytes);
    let channels = weight.values.chunks_exact(inputs).zip(weight.scales);
    for (n, (weights, scale)) in channels.enumerate() {
        let bias = bias.get(n).copied().unwrap_or(0.0);
        for row in (0..rows).step_by(SERVED) {
            let here = SERVED.min(rows - row);
            // The last row stands in for missing ones.
            // SAFETY: the instructions by this function's contract. `values` has `rows` rows of
            // `row_bytes`, no less than their groups; `weights` has `inputs` numbers, and `row
            // + i` is less than `rows`, as `i` is less than `here`.
            let sums = unsafe {
                let x: [*const i8; SERVED] = std::array::from_fn(|i| {
                    scratch.values.as_ptr().add((row + i.min(here - 1)) * row_bytes)
                });
                dots::<I>(x, weights)
            };
            for (i, sum) in sums.into_iter().enumerate().take(here) {
                let end = (row + i) * row_bytes + end;
                // SAFETY: `values` has `rows` rows of `row_bytes`, no less than `end + END`.
                let correction = unsafe { I::correction(scratch.values.as_ptr().add(end)) };
                let sum = sum.wrapping_add(correction);
                let scale = scratch.scales[row + i] * scale;
                out[(row + i) * outputs + n] = sum as f32 * scale + bias;
            }
        }
    }
}

/// Products of rows with one row of weights.
///
/// # Safety
/// The processor has the instructions of `I`. From each of `x` on, all groups of `weights.len()` activations
/// may be read.
#[inline(always)]
unsafe fn dots<I: Int8>(x: [*const i8; SERVED], weights: &[i8]) -> [i32; SERVED] {
    const { assert!(I::STEP <= MAX_STEP && I::STEP * I::BYTES <= MAX_STEP) };
    // Products with ones sum the weights, for the offset of 128.
    let ones = [1_i8; MAX_STEP];
    let whole = weights.len() / I::STEP * I::STEP;
    // SAFETY: the instructions by this function's contract. `at + STEP` is at most `whole`, which
    // is inside the weights and, times `BYTES`, inside each of `x`, as is the rest behind it.
    // `ones`, `some` and `last` have `MAX_STEP` bytes, no fewer than `STEP * BYTES`. The rest is copied in
    // whole groups, which each of `x` has.
    unsafe {
        let mut sums = [I::nothing(); SERVED];
        let mut offset = I::nothing();
        for at in (0..whole).step_by(I::STEP) {
            let weights = weights.as_ptr().add(at);
            for (sum, x) in sums.iter_mut().zip(x) {
                *sum = I::dot(*sum, x.add(at * I::BYTES), weights);
            }
            if I::OFFSET {
                offset = I::dot(offset, ones.as_ptr(), weights);
            }
        }
        let rest = weights.len() - whole;
        if rest > 0 {
            let mut last = [0_i8; MAX_STEP];
            last[..rest].copy_from_slice(&weights[whole..]);
            for (sum, x) in sums.iter_mut().zip(x) {
                let mut some = [0_i8; MAX_STEP];
                let from = x.add(whole * I::BYTES);
                let rest = rest.div_ceil(PANEL_DEPTH) * PANEL_DEPTH * I::BYTES;
                std::ptr::copy_nonoverlapping(from, some.as_mut_ptr(), rest);
                *sum = I::dot(*sum, some.as_ptr(), last.as_ptr());
            }
            if I::OFFSET {
                offset = I::dot(offset, ones.as_ptr(), last.as_ptr());
            }
        }
        I::across(sums, offset)
    }
}
