//! Products of int8 by SMMLA, in assembly: the intrinsics are not stable.
//!
//! SMMLA multiplies two rows with two channels, eight inputs each, where SDOT multiplies a row with four channels, four
//! inputs each: it does twice as much. Panels stay as files have them. Two groups of inputs are interleaved in registers, once for all rows
//! of a tile. Two rows are interleaved in memory, once for all panels.
#![allow(unsafe_code)]

use std::arch::aarch64::*;
use std::arch::asm;
use std::mem::MaybeUninit;
use std::ops::Range;

use rigidformer_core::weights::{PANEL, PANEL_DEPTH};

/// Inputs of an instruction: two groups.
const INPUTS: usize = 2 * PANEL_DEPTH;
/// Bytes of a register: the inputs of two rows or of two channels.
const REGISTER: usize = 2 * INPUTS;
/// Pairs of rows of a tile, at most: its sums take 24 registers.
const MAX_PAIRS: usize = 6;
/// Channels of a tile.
const CHANNELS: usize = PANEL / 2;
/// Bytes of interleaved rows at a time.
// They stay in the cache while all panels pass.
const BUFFER_BYTES: usize = 64 << 10;
/// Bytes of weights from which they come from memory.
// Rows in several blocks would read them again.
const MIN_MEMORY_BYTES: usize = 8 << 20;
/// Rows, groups of inputs and multiply-accumulates below which SDOT takes no more instructions.
// Counted under an emulator (docs/PERFORMANCE.md): interleaving rows costs as much as SMMLA saves.
const MIN_ROWS: usize = 4;
const MIN_GROUPS: usize = 4;
const MIN_WORK: usize = 32 << 10;

/// Whether a product of so many rows, groups of inputs and channels takes fewer instructions here than by SDOT.
pub(super) fn is_worth(rows: usize, groups: usize, channels: usize) -> bool {
    let weights = groups * PANEL_DEPTH * channels;
    let fit = pairs_that_fit(groups);
    // Each block of rows reads all weights.
    let fits = rows.div_ceil(2) <= fit || (fit >= MAX_PAIRS && weights < MIN_MEMORY_BYTES);
    fits && rows >= MIN_ROWS && groups >= MIN_GROUPS && rows * weights >= MIN_WORK
}

/// Pairs of rows that the buffer holds.
fn pairs_that_fit(groups: usize) -> usize {
    BUFFER_BYTES / (groups.div_ceil(2).max(1) * REGISTER)
}

/// A product of rows and panels.
#[derive(Clone, Copy)]
pub(super) struct Product<'a> {
    /// As many rows as `row_scales` has numbers, `row_bytes` apart, of which `groups * PANEL_DEPTH` bytes are activations.
    pub(super) x: *const i8,
    pub(super) row_bytes: usize,
    pub(super) row_scales: &'a [f32],
    pub(super) groups: usize,
    /// Whole panels for all channels, of `groups * PANEL * PANEL_DEPTH` bytes each.
    pub(super) weights: &'a [i8],
    /// As many numbers as there are channels.
    pub(super) scales: &'a [f32],
    /// Where biases are missing, zeros stand in.
    pub(super) bias: &'a [f32],
    /// First number of the first row, and numbers to the next. Each row has room for all channels, which nothing else overlaps.
    pub(super) out: *mut f32,
    pub(super) stride: usize,
}

/// Pairs of rows, tile after tile: (inputs / 8 rounded up, pairs of the tile, 2, 8).
#[repr(C, align(64))]
struct PairBuffer([MaybeUninit<i8>; BUFFER_BYTES]);

/// Multiplies.
///
/// # Safety
/// The processor has SMMLA. The fields of `product` point to what they say, and [`is_worth`] has said so of it.
#[target_feature(enable = "neon,i8mm")]
#[inline(never)]
pub(super) unsafe fn multiply(product: Product<'_>) {
    let Product { groups, row_scales, .. } = product;
    let (pairs, channels) = (row_scales.len().div_ceil(2), product.scales.len());
    let steps = groups.div_ceil(2);
    let mut buffer = PairBuffer([MaybeUninit::uninit(); BUFFER_BYTES]);
    let buffer = buffer.0.as_mut_ptr().cast::<i8>();
    let mut sums = Sums([[[0; 4]; CHANNELS / 2]; MAX_PAIRS]);
    let blocks = pairs.div_ceil(pairs_that_fit(groups).max(1));
    for block in 0..blocks {
        let block = share(0..pairs, block, blocks);
        let tiles = block.len().div_ceil(MAX_PAIRS);
        // SAFETY: a block has at most as many pairs as there is room for, of which `is_worth` has seen that one at least fits. Each
        // takes `steps` registers.
        let address = |tile: &Range<usize>| unsafe {
            buffer.add((tile.start - block.start) * steps * REGISTER)
        };
        for tile in (0..tiles).map(|tile| share(block.clone(), tile, tiles)) {
            for pair in tile.clone() {
                // SAFETY: the instructions by this function's contract; the pair is one of the product's, and one of the tile's,
                // which has room for `steps` registers of each.
                unsafe {
                    let to = address(&tile).add((pair - tile.start) * REGISTER);
                    interleave(&product, pair, to, tile.len() * REGISTER);
                }
            }
        }
        for first in (0..channels).step_by(CHANNELS) {
            // SAFETY: the instructions by this function's contract.
            let channels_here = unsafe { Channels::new(&product, first) };
            for tile in (0..tiles).map(|tile| share(block.clone(), tile, tiles)) {
                // SAFETY: the instructions by this function's contract. The registers of the tile's pairs are at its place; pairs and
                // channels are the product's.
                unsafe {
                    multiply_tile(&product, &channels_here, &tile, address(&tile), &mut sums)
                };
            }
        }
    }
}

/// One of `parts` sections of a range, all of about the same length.
fn share(all: Range<usize>, channels_here: usize, parts: usize) -> Range<usize> {
    let at = |channels_here: usize| all.start + all.len() * channels_here / parts;
    at(channels_here)..at(channels_here + 1)
}

/// Interleaves the inputs of two rows, eight of each. Where the second is missing, the first stands in.
///
/// # Safety
/// The processor has NEON. The fields of `product` point to what they say, and the pair is one of its rows'. For each i less than
/// half of the groups, rounded up, `REGISTER` bytes may be written from `to + i * stride` on.
#[inline(always)]
unsafe fn interleave(product: &Product<'_>, pair: usize, to: *mut i8, stride: usize) {
    let whole = product.groups / 2;
    let rows = [2 * pair, (2 * pair + 1).min(product.row_scales.len() - 1)];
    // SAFETY: NEON, the rows, of `groups * PANEL_DEPTH` bytes, and the room by this function's contract. `whole` registers take two
    // groups each, and one more the last group, if there is one.
    unsafe {
        let [one, other] = rows.map(|row| product.x.add(row * product.row_bytes));
        for step in 0..whole {
            let both =
                vcombine_s8(vld1_s8(one.add(step * INPUTS)), vld1_s8(other.add(step * INPUTS)));
            vst1q_s8(to.add(step * stride), both);
        }
        // An odd group is interleaved with zeros, which add nothing.
        if 2 * whole < product.groups {
            let four = |from: *const i8| {
                let from = from.add(whole * INPUTS).cast::<u32>();
                vcreate_s8(u64::from(from.read_unaligned()))
            };
            vst1q_s8(to.add(whole * stride), vcombine_s8(four(one), four(other)));
        }
    }
}

/// Sums of a tile: (pairs, pairs of channels, 2 rows, 2 channels).
#[repr(C, align(64))]
struct Sums([[[i32; 4]; CHANNELS / 2]; MAX_PAIRS]);

/// Channels that tiles share, with their scales and biases.
struct Channels {
    /// A multiple of [`CHANNELS`].
    first: usize,
    /// Those that are there, one to [`CHANNELS`]; others have zeros.
    count: usize,
    scales: [float32x4_t; 2],
    bias: [float32x4_t; 2],
}

impl Channels {
    /// The channels of a product from the first of them on.
    ///
    /// # Safety
    /// The processor has NEON.
    #[inline(always)]
    unsafe fn new(product: &Product<'_>, first: usize) -> Self {
        let count = CHANNELS.min(product.scales.len() - first);
        let [scales, bias] = [product.scales, product.bias].map(|all| {
            // Biases may be fewer than the channels: zeros replace the missing ones.
            let some = all.get(first..).unwrap_or_default();
            // SAFETY: NEON by this function's contract; four of eight numbers are read at 0 and at 4.
            let load = |eight: &[f32; CHANNELS]| unsafe {
                [vld1q_f32(eight.as_ptr()), vld1q_f32(eight.as_ptr().add(4))]
            };
            some.first_chunk().map_or_else(|| load(&beside_zeros(some)), load)
        });
        Channels { first, count, scales, bias }
    }
}

/// Fewer than eight numbers, and zeros behind them.
#[cold]
#[inline(never)]
fn beside_zeros(numbers: &[f32]) -> [f32; CHANNELS] {
    let mut eight = [0.0; CHANNELS];
    eight.iter_mut().zip(numbers).for_each(|(to, number)| *to = *number);
    eight
}

/// Multiplies pairs of rows with some channels.
///
/// # Safety
/// The processor has SMMLA. The fields of `product` point to what they say, and `channels_here` are some of it. The pairs are some of its rows',
/// two to [`MAX_PAIRS`], and their registers are at `x`, as [`PairBuffer`] has them.
#[inline(always)]
unsafe fn multiply_tile(
    product: &Product<'_>,
    channels_here: &Channels,
    pairs: &Range<usize>,
    x: *const i8,
    sums: &mut Sums,
) {
    let Product { groups, weights, row_scales, out, stride, .. } = *product;
    let Channels { first, count, .. } = *channels_here;
    let (panel, inside) = (first / PANEL * PANEL, first % PANEL);
    // SAFETY: the instructions, the pairs and their registers by this function's contract. Before a panel lie `groups * PANEL_DEPTH`
    // bytes of each channel, and in each of its groups `PANEL_DEPTH`. The panel is whole, so that [`CHANNELS`] channels are there.
    unsafe {
        let weights = weights.as_ptr().add((panel * groups + inside) * PANEL_DEPTH);
        walk(pairs.len(), x, weights, groups, sums);
    }
    let row = 2 * pairs.start;
    let scales = row_scales[row..].chunks(2);
    // SAFETY: NEON is among the instructions. There are pairs of scales as there are pairs of rows, of which `pairs` are some: `to` is
    // always in one of them, with room for `count` channels, and behind the last one it is not used.
    unsafe {
        let mut to = out.add(row * stride + first);
        for (sums, scales) in sums.0[..pairs.len()].iter().zip(scales) {
            for (sums, scale) in apart(sums).into_iter().zip(scales) {
                let x = scaled(sums, channels_here, *scale);
                if count == CHANNELS {
                    vst1q_f32(to, x[0]);
                    vst1q_f32(to.add(4), x[1]);
                } else {
                    store_some(x, to, count);
                }
                to = to.wrapping_add(stride);
            }
        }
    }
}

/// The first of eight numbers to memory.
///
/// # Safety
/// The processor has NEON, and `count` numbers, or eight where it is more, may be written from `to` on.
#[cold]
unsafe fn store_some(x: [float32x4_t; 2], to: *mut f32, count: usize) {
    let mut eight = [0.0; CHANNELS];
    // SAFETY: NEON and the room by this function's contract.
    unsafe {
        vst1q_f32(eight.as_mut_ptr(), x[0]);
        vst1q_f32(eight.as_mut_ptr().add(4), x[1]);
        to.copy_from_nonoverlapping(eight.as_ptr(), count.min(CHANNELS));
    }
}

/// The sums of the one row and of the other, channel by channel.
///
/// # Safety
/// The processor has NEON.
#[inline(always)]
unsafe fn apart(sums: &[[i32; 4]; CHANNELS / 2]) -> [[int32x4_t; 2]; 2] {
    // SAFETY: NEON by this function's contract; four numbers are read of each of four.
    unsafe {
        let [a, b, c, d] =
            sums.each_ref().map(|sums| vreinterpretq_s64_s32(vld1q_s32(sums.as_ptr())));
        [
            [vzip1q_s64(a, b), vzip1q_s64(c, d)].map(|four| vreinterpretq_s32_s64(four)),
            [vzip2q_s64(a, b), vzip2q_s64(c, d)].map(|four| vreinterpretq_s32_s64(four)),
        ]
    }
}

/// What a row's sums stand for, and biases.
///
/// # Safety
/// The processor has NEON.
#[inline(always)]
unsafe fn scaled(
    sums: [int32x4_t; 2],
    channels_here: &Channels,
    row_scale: f32,
) -> [float32x4_t; 2] {
    // SAFETY: NEON by this function's contract; registers alone.
    std::array::from_fn(|half| unsafe {
        let scales = vmulq_n_f32(channels_here.scales[half], row_scale);
        vaddq_f32(vmulq_f32(vcvtq_f32_s32(sums[half]), scales), channels_here.bias[half])
    })
}

/// Two rows, in register `$x`, by eight channels, in 28 to 31, added to four sums.
#[rustfmt::skip]
macro_rules! pair {
    ($x:literal: $a:literal $b:literal $c:literal $d:literal) => {
        concat!(
            "smmla v", $a, ".4s, v", $x, ".16b, v28.16b\n",
            "smmla v", $b, ".4s, v", $x, ".16b, v29.16b\n",
            "smmla v", $c, ".4s, v", $x, ".16b, v30.16b\n",
            "smmla v", $d, ".4s, v", $x, ".16b, v31.16b\n",
        )
    };
}

/// So many pairs of rows, one behind the other at `{x}`, which moves on.
#[rustfmt::skip]
macro_rules! pairs {
    (2) => { concat!("ldp q24, q25, [{x}], #32\n", pair!(24: 0 1 2 3), pair!(25: 4 5 6 7)) };
    (3) => { concat!(pairs!(2), "ldr q26, [{x}], #16\n", pair!(26: 8 9 10 11)) };
    (4) => { concat!(pairs!(2), "ldp q26, q27, [{x}], #32\n", pair!(26: 8 9 10 11), pair!(27: 12 13 14 15)) };
    (5) => { concat!(pairs!(4), "ldr q24, [{x}], #16\n", pair!(24: 16 17 18 19)) };
    (6) => { concat!(pairs!(4), "ldp q24, q25, [{x}], #32\n", pair!(24: 16 17 18 19), pair!(25: 20 21 22 23)) };
}

/// Sums of so many pairs before the first product.
#[rustfmt::skip]
macro_rules! zero {
    (1) => { "movi v0.2d, #0\n movi v1.2d, #0\n movi v2.2d, #0\n movi v3.2d, #0\n" };
    (2) => { concat!(zero!(1), "movi v4.2d, #0\n movi v5.2d, #0\n movi v6.2d, #0\n movi v7.2d, #0\n") };
    (3) => { concat!(zero!(2), "movi v8.2d, #0\n movi v9.2d, #0\n movi v10.2d, #0\n movi v11.2d, #0\n") };
    (4) => { concat!(zero!(3), "movi v12.2d, #0\n movi v13.2d, #0\n movi v14.2d, #0\n movi v15.2d, #0\n") };
    (5) => { concat!(zero!(4), "movi v16.2d, #0\n movi v17.2d, #0\n movi v18.2d, #0\n movi v19.2d, #0\n") };
    (6) => { concat!(zero!(5), "movi v20.2d, #0\n movi v21.2d, #0\n movi v22.2d, #0\n movi v23.2d, #0\n") };
}

/// Stores the sums of so many pairs at `{sums}`.
#[rustfmt::skip]
macro_rules! store {
    (1) => { "stp q0, q1, [{sums}]\n stp q2, q3, [{sums}, #32]\n" };
    (2) => { concat!(store!(1), "stp q4, q5, [{sums}, #64]\n stp q6, q7, [{sums}, #96]\n") };
    (3) => { concat!(store!(2), "stp q8, q9, [{sums}, #128]\n stp q10, q11, [{sums}, #160]\n") };
    (4) => { concat!(store!(3), "stp q12, q13, [{sums}, #192]\n stp q14, q15, [{sums}, #224]\n") };
    (5) => { concat!(store!(4), "stp q16, q17, [{sums}, #256]\n stp q18, q19, [{sums}, #288]\n") };
    (6) => { concat!(store!(5), "stp q20, q21, [{sums}, #320]\n stp q22, q23, [{sums}, #352]\n") };
}

/// Sums of pairs of rows and [`CHANNELS`] channels. The compiler, left to choose registers, would keep sums in memory.
///
/// # Safety
/// The processor has SMMLA. The pairs are two to [`MAX_PAIRS`]. At `weights` are `CHANNELS * PANEL_DEPTH` bytes of each of the groups,
/// whose bytes are `PANEL * PANEL_DEPTH` = 64, and at `x` the registers of the pairs, as [`PairBuffer`] has them.
#[inline(always)]
unsafe fn walk(pairs: usize, x: *const i8, weights: *const i8, groups: usize, sums: &mut Sums) {
    /// A loop over two groups at a time, and a last one beside zeros.
    macro_rules! walk {
        ($pairs:tt) => {
            asm!(
                zero!($pairs),
                "cbz {steps}, 3f",
                "2:",
                "ldp q24, q25, [{weights}], #64",
                "ldp q26, q27, [{weights}], #64",
                "zip1 v28.4s, v24.4s, v26.4s",
                "zip2 v29.4s, v24.4s, v26.4s",
                "zip1 v30.4s, v25.4s, v27.4s",
                "zip2 v31.4s, v25.4s, v27.4s",
                pairs!($pairs),
                "subs {steps}, {steps}, #1",
                "b.ne 2b",
                "3:",
                "cbz {rest}, 4f",
                "ldp q24, q25, [{weights}]",
                "movi v26.2d, #0",
                "zip1 v28.4s, v24.4s, v26.4s",
                "zip2 v29.4s, v24.4s, v26.4s",
                "zip1 v30.4s, v25.4s, v26.4s",
                "zip2 v31.4s, v25.4s, v26.4s",
                pairs!($pairs),
                "4:",
                store!($pairs),
                x = inout(reg) x => _,
                weights = inout(reg) weights => _,
                steps = inout(reg) groups / 2 => _,
                rest = in(reg) groups % 2,
                sums = in(reg) &raw mut *sums,
                out("v0") _, out("v1") _, out("v2") _, out("v3") _, out("v4") _, out("v5") _, out("v6") _, out("v7") _,
                out("v8") _, out("v9") _, out("v10") _, out("v11") _, out("v12") _, out("v13") _, out("v14") _, out("v15") _,
                out("v16") _, out("v17") _, out("v18") _, out("v19") _, out("v20") _, out("v21") _, out("v22") _, out("v23") _,
                out("v24") _, out("v25") _, out("v26") _, out("v27") _, out("v28") _, out("v29") _, out("v30") _, out("v31") _,
                options(nostack),
            )
        };
    }
    // SAFETY: the instructions by this function's contract. Each step reads `CHANNELS * PANEL_DEPTH` = 32 bytes of two groups, and a
    // register of each pair; a last one reads a single group. `sums` has room for four registers of each pair.
    unsafe {
        match pairs {
            2 => walk!(2),
            3 => walk!(3),
            4 => walk!(4),
            5 => walk!(5),
            _ => walk!(6),
        }
    }
}
