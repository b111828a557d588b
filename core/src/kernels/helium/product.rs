//! int8 matrix product by VMLADAV: sixteen multiplications and their sum.
//!
//! Sixteen inputs of a row are a block; inputs that the row does not have are zeros. Two rows make a panel: block by
//! block, that of the one, that of the other, and behind the last block the rows' two scales. Weights are read as the
//! file has them.

use super::super::arithmetic::Rows;
use super::flags::{INVALID, lower, watched};
use crate::quant;
use core::arch::naked_asm;
use core::mem::offset_of;

/// Inputs of a block. Narrower layers are not for these kernels.
pub(super) const BLOCK: usize = 16;
/// Words of a block of two rows.
const PAIR_WORDS: usize = 2 * BLOCK / 4;
/// Channels of a tile.
const CHANNELS: usize = 4;
/// Blocks that the inner loop is unrolled by, in the assembly below.
const UNROLLED: usize = 4;
/// Bytes of code that one of them takes: fourteen instructions of four.
const BLOCK_CODE: usize = 56;
/// Where there is no bias.
static NO_BIAS: [f32; CHANNELS] = [0.0; CHANNELS];

/// Words of a panel of two rows.
fn panel_words(inputs: usize) -> usize {
    inputs.div_ceil(BLOCK).saturating_mul(PAIR_WORDS).saturating_add(2)
}

/// What the assembly reads, at the offsets that it knows; it works on a copy.
#[repr(C)]
struct Job {
    /// 0, 4: panels of rows.
    x: *const u32,
    x_end: *const u32,
    /// 8: weights of the tile's channels.
    w: *const i8,
    /// 12: inputs, bytes of a channel.
    inputs: usize,
    /// 16: bytes of the unrolled loop to pass over at first; its place, in the assembly.
    entry: usize,
    /// 20: rounds of that loop.
    rounds: usize,
    /// 24: inputs behind the whole blocks.
    rest: usize,
    /// 28: tiles of channels.
    tiles: usize,
    /// 32, 36: of the tile.
    scales: *const f32,
    bias: *const f32,
    /// 40: bytes from one tile's biases to the next: 16, or 0.
    bias_step: usize,
    /// 44: 1 where the last panel's second row is none.
    odd: usize,
    /// 48: out of the tile of channels.
    out: *mut f32,
    /// 52: bytes from one row of `out` to the next.
    stride: usize,
    /// 56: out of the row; 60: what follows that loop. For the assembly's own use.
    out_row: usize,
    after: usize,
}

// What the assembly takes for granted.
const _: () = assert!(offset_of!(Job, x) == 0 && offset_of!(Job, x_end) == 4);
const _: () = assert!(offset_of!(Job, w) == 8 && offset_of!(Job, inputs) == 12);
const _: () = assert!(offset_of!(Job, entry) == 16 && offset_of!(Job, rounds) == 20);
const _: () = assert!(offset_of!(Job, rest) == 24 && offset_of!(Job, tiles) == 28);
const _: () = assert!(offset_of!(Job, scales) == 32 && offset_of!(Job, bias) == 36);
const _: () = assert!(offset_of!(Job, bias_step) == 40 && offset_of!(Job, odd) == 44);
const _: () = assert!(offset_of!(Job, out) == 48 && offset_of!(Job, stride) == 52);
const _: () = assert!(offset_of!(Job, out_row) == 56 && size_of::<Job>() == 64);
const _: () = assert!(BLOCK == 16 && PAIR_WORDS == 8 && CHANNELS == 4 && UNROLLED == 4);

/// Tiles of four channels times all panels of rows. Returns FPSCR in the high half.
///
/// The sums of the first row are r0, r2, r4, r6, those of the second r8, r10, r12, lr: VMLADAV takes even registers.
/// Odd ones are pointers: r1 rows, r3, r5, r7, r9 channels. q6 and q7 hold the channels' scales and biases.
///
/// # Safety
/// The job's panels of rows lie whole and aligned from `x` to `x_end`, of as many blocks as fit `inputs`, at least one
/// of them full; `tiles` is at least 1, and there are as many weights, scales and biases. Four numbers may be written
/// at each row of `out`, and at those behind them for further tiles.
#[allow(unsafe_code)]
#[unsafe(naked)]
unsafe extern "C" fn multiply(job: *const Job) -> u64 {
    naked_asm!(
        target!(),
        "push {{r4-r11, lr}}",
        "vpush {{d8-d15}}",
        // The job; behind it, at 64, the tile's channels; at 80 and 84 where to go in loops of more
        // rounds than one.
        "sub sp, sp, #92",
        "mov r12, sp",
        "ldmia r0!, {{r1-r8}}",
        "stmia r12!, {{r1-r8}}",
        "ldmia r0!, {{r1-r8}}",
        "stmia r12!, {{r1-r8}}",
        "ldrd r0, r1, [sp, #16]",
        "adr.w r2, 30f",
        "add r2, r2, r0",
        "orr r2, r2, #1",
        "adr.w r3, 31f",
        "ldr r0, [sp, #24]",
        "cbnz r0, 8f",
        "adr.w r3, 32f",
        "8:",
        "orr r3, r3, #1",
        "cmp r1, #1",
        "beq 9f",
        "strd r2, r3, [sp, #80]",
        "adr.w r2, 33f",
        "orr r2, r2, #1",
        "adr.w r3, 34f",
        "orr r3, r3, #1",
        "9:",
        "str r2, [sp, #16]",
        "str r3, [sp, #60]",
        // Four channels.
        "10:",
        "ldrd r0, r2, [sp, #32]",
        "ldr r4, [sp, #40]",
        "vldrw.u32 q6, [r0], #16",
        "vldrw.u32 q7, [r2]",
        "add r2, r2, r4",
        "strd r0, r2, [sp, #32]",
        "ldrd r0, r2, [sp, #8]",
        "add r4, r0, r2",
        "strd r0, r4, [sp, #64]",
        "add r0, r4, r2",
        "add r4, r0, r2",
        "strd r0, r4, [sp, #72]",
        "add r4, r4, r2",
        "str r4, [sp, #8]",
        "ldr r1, [sp, #0]",
        "ldr r0, [sp, #48]",
        "str r0, [sp, #56]",
        "add r0, r0, #16",
        "str r0, [sp, #48]",
        // Two rows.
        "20:",
        "ldrd r3, r5, [sp, #64]",
        "ldrd r7, r9, [sp, #72]",
        "vldrw.u32 q0, [r1], #16",
        "vldrb.u8 q2, [r3], #16",
        "vldrw.u32 q1, [r1], #16",
        "vmladav.s8 r0, q0, q2",
        "vldrb.u8 q3, [r5], #16",
        "vmladav.s8 r8, q1, q2",
        "vmladav.s8 r2, q0, q3",
        "vldrb.u8 q4, [r7], #16",
        "vmladav.s8 r10, q1, q3",
        "vmladav.s8 r4, q0, q4",
        "vldrb.u8 q5, [r9], #16",
        "vmladav.s8 r12, q1, q4",
        "vmladav.s8 r6, q0, q5",
        "vmladav.s8 lr, q1, q5",
        "ldr pc, [sp, #16]",
        ".p2align 2",
        "30:",
        ".rept 4",
        "vldrw.u32 q0, [r1], #16",
        "vldrb.u8 q2, [r3], #16",
        "vldrw.u32 q1, [r1], #16",
        "vmladava.s8 r0, q0, q2",
        "vldrb.u8 q3, [r5], #16",
        "vmladava.s8 r8, q1, q2",
        "vmladava.s8 r2, q0, q3",
        "vldrb.u8 q4, [r7], #16",
        "vmladava.s8 r10, q1, q3",
        "vmladava.s8 r4, q0, q4",
        "vldrb.u8 q5, [r9], #16",
        "vmladava.s8 r12, q1, q4",
        "vmladava.s8 r6, q0, q5",
        "vmladava.s8 lr, q1, q5",
        ".endr",
        "ldr pc, [sp, #60]",
        ".p2align 2",
        "33:",
        "ldr r11, [sp, #20]",
        "ldr pc, [sp, #80]",
        ".p2align 2",
        "34:",
        "subs r11, r11, #1",
        "bne.w 30b",
        "ldr pc, [sp, #84]",
        // The last inputs: nothing is read beyond a channel.
        ".p2align 2",
        "31:",
        "ldr r11, [sp, #24]",
        "vctp.8 r11",
        "vpstttt",
        "vldrbt.u8 q2, [r3]",
        "vldrbt.u8 q3, [r5]",
        "vldrbt.u8 q4, [r7]",
        "vldrbt.u8 q5, [r9]",
        "vldrw.u32 q0, [r1], #16",
        "vldrw.u32 q1, [r1], #16",
        "vmladava.s8 r0, q0, q2",
        "vmladava.s8 r8, q1, q2",
        "vmladava.s8 r2, q0, q3",
        "vmladava.s8 r10, q1, q3",
        "vmladava.s8 r4, q0, q4",
        "vmladava.s8 r12, q1, q4",
        "vmladava.s8 r6, q0, q5",
        "vmladava.s8 lr, q1, q5",
        ".p2align 2",
        "32:",
        // sum as f32 * (row scale * channel scale) + bias
        "ldrd r3, r5, [r1], #8",
        "ldrd r7, r9, [sp, #52]",
        "vmov q0[2], q0[0], r0, r4",
        "vmov q0[3], q0[1], r2, r6",
        "vmov q1[2], q1[0], r8, r12",
        "vmov q1[3], q1[1], r10, lr",
        "vmul.f32 q2, q6, r3",
        "vcvt.f32.s32 q0, q0",
        "vmul.f32 q3, q6, r5",
        "vcvt.f32.s32 q1, q1",
        "vmul.f32 q0, q0, q2",
        "ldr r4, [sp, #4]",
        "vmul.f32 q1, q1, q3",
        "vadd.f32 q0, q0, q7",
        "vadd.f32 q1, q1, q7",
        "vstrw.32 q0, [r9]",
        "add r9, r9, r7",
        "cmp r1, r4",
        "beq 40f",
        "vstrw.32 q1, [r9]",
        "add r9, r9, r7",
        "str r9, [sp, #56]",
        "b.w 20b",
        "40:",
        "ldr r0, [sp, #44]",
        "cbnz r0, 41f",
        "vstrw.32 q1, [r9]",
        "41:",
        "ldr r0, [sp, #28]",
        "subs r0, r0, #1",
        "str r0, [sp, #28]",
        "bne.w 10b",
        "vmrs r1, fpscr",
        "add sp, sp, #92",
        "vpop {{d8-d15}}",
        "pop {{r4-r11, pc}}",
    )
}

/// The product of the quantised rows at the front of `words` with all channels; for at least [`BLOCK`] inputs.
#[allow(unsafe_code)]
pub(super) fn product(
    words: &mut [u32],
    weight: Rows<'_>,
    bias: &[f32],
    inputs: usize,
    out: &mut [f32],
) {
    let outputs = weight.scales.len();
    let rows = out.len() / outputs.max(1);
    let panel = panel_words(inputs);
    let x = words.get(..rows.div_ceil(2).saturating_mul(panel)).unwrap_or_default();
    let whole = inputs.checked_mul(outputs) == Some(weight.values.len())
        && (bias.len() == outputs || bias.is_empty());
    if inputs < BLOCK || x.is_empty() || !whole {
        return;
    }
    // The first block stands before the loop; an incomplete round of the loop comes first.
    let blocks = inputs / BLOCK - 1;
    let skip = match blocks % UNROLLED {
        0 if blocks == 0 => UNROLLED,
        0 => 0,
        incomplete => UNROLLED - incomplete,
    };
    let at = x.as_ptr_range();
    let job = Job {
        x: at.start,
        x_end: at.end,
        w: weight.values.as_ptr(),
        inputs,
        entry: skip * BLOCK_CODE,
        rounds: blocks.div_ceil(UNROLLED).max(1),
        rest: inputs % BLOCK,
        tiles: outputs / CHANNELS,
        scales: weight.scales.as_ptr(),
        bias: if bias.is_empty() { NO_BIAS.as_ptr() } else { bias.as_ptr() },
        bias_step: if bias.is_empty() { 0 } else { CHANNELS * size_of::<f32>() },
        odd: rows % 2,
        out: out.as_mut_ptr(),
        stride: size_of_val(weight.scales),
        out_row: 0,
        after: 0,
    };
    let mut done = 0;
    if job.tiles > 0 {
        // SAFETY: the lengths of panels, weights, scales and biases were tested, and out has `outputs` numbers for
        // each of the rows.
        if watched(|| unsafe { multiply(&raw const job) }).is_some() {
            done = job.tiles * CHANNELS;
        }
    }
    if done < outputs {
        one_by_one((x, panel), weight, bias, (inputs, done), out);
    }
}

/// The channels from one on, one by one: those that are not whole tiles, or all where a product of scales is subnormal.
#[allow(unsafe_code)]
#[inline(never)]
fn one_by_one(
    (x, panel): (&[u32], usize),
    weight: Rows<'_>,
    bias: &[f32],
    (inputs, first): (usize, usize),
    out: &mut [f32],
) {
    let outputs = weight.scales.len().max(1);
    let channels = weight.values.chunks_exact(inputs.max(1)).zip(weight.scales).enumerate();
    for (n, (w, channel_scale)) in channels.skip(first) {
        let bias = bias.get(n).copied().unwrap_or(0.0);
        for (row, out) in out.chunks_exact_mut(outputs).enumerate() {
            let panel = x.get(row / 2 * panel..).and_then(|x| x.get(..panel)).unwrap_or_default();
            let half = row % 2;
            let (Some(scales), Some(out)) = (panel.last_chunk::<2>(), out.get_mut(n)) else {
                continue;
            };
            let [even, odd] = scales.map(f32::from_bits);
            let scale = if half == 0 { even } else { odd };
            let at = panel.as_ptr().wrapping_add(half * PAIR_WORDS / 2);
            // SAFETY: the channel's weights, and the row's blocks, which hold as many values.
            let sum = unsafe { dot(at, w.as_ptr(), w.len()) };
            *out = sum as f32 * (scale * channel_scale) + bias;
        }
    }
}

/// Sum of products of a row and a channel.
///
/// # Safety
/// `count` weights lie at `w`, at least one, and a block of sixteen values at `row` and every 32 bytes behind it for
/// each sixteen of them.
#[allow(unsafe_code)]
#[unsafe(naked)]
unsafe extern "C" fn dot(row: *const u32, w: *const i8, count: usize) -> i32 {
    naked_asm!(
        target!(),
        "push {{r4, lr}}",
        "mov r3, r0",
        "mov r0, #0",
        "dlstp.8 lr, r2",
        "1:",
        "vldrb.u8 q0, [r3], #32",
        "vldrb.u8 q1, [r1], #16",
        "vmladava.s8 r0, q0, q1",
        "letp lr, 1b",
        "pop {{r4, pc}}",
    )
}

/// Quantises the rows of `x`, as many as there is room for, as [`quant::quantise_row`] does; for at least [`BLOCK`]
/// inputs.
#[allow(unsafe_code)]
pub(super) fn quantise(words: &mut [u32], x: &[f32], inputs: usize) {
    let length = panel_words(inputs);
    for (n, row) in x.chunks_exact(inputs.max(BLOCK)).enumerate() {
        let half = n % 2;
        let panel = words.get_mut(n / 2 * length..).and_then(|words| words.get_mut(..length));
        let Some(panel) = panel else { return };
        let at = panel.as_mut_ptr();
        let Some(scales) = panel.last_chunk_mut::<2>() else { return };
        if half == 0 {
            // A second row that is not there is times zero.
            let [_, second] = scales;
            *second = 0;
        }
        let slot = scales.as_mut_ptr().wrapping_add(half);
        let values = at.wrapping_add(half * PAIR_WORDS / 2);
        // SAFETY: the row's numbers; the panel has a block in every two for each sixteen of them and a scale
        // behind.
        let flags = unsafe { quantise_row(row.as_ptr(), row.len(), values, slot) };
        if flags & INVALID != 0 {
            flaw(row, panel, half);
        }
    }
}

/// Marks a row that is not finite.
#[cold]
fn flaw(row: &[f32], panel: &mut [u32], half: usize) {
    if row.iter().any(|x| !x.is_finite())
        && let Some(scales) = panel.last_chunk_mut::<2>()
        && let Some(slot) = scales.get_mut(half)
    {
        *slot = f32::NAN.to_bits();
    }
    lower();
}

/// Returns FPSCR: a row with a NaN raises [`INVALID`], when it is rounded. Subnormal numbers are zeros to quantisation,
/// so that the other flags do not matter.
///
/// # Safety
/// `count` numbers, at least one, lie at `row`; four words in every eight may be written at `values` for each sixteen
/// of them, and one at `scale`.
#[allow(unsafe_code)]
#[unsafe(naked)]
unsafe extern "C" fn quantise_row(
    row: *const f32,
    count: usize,
    values: *mut u32,
    scale: *mut u32,
) -> u32 {
    naked_asm!(
        target!(),
        "push {{r4-r6, lr}}",
        "mov r12, r0",
        "vmov.i32 q0, #0",
        "lsr r4, r1, #4",
        "wls lr, r4, 11f",
        "10:",
        "vldrw.u32 q1, [r12], #16",
        "vldrw.u32 q2, [r12], #16",
        "vmaxnma.f32 q0, q1",
        "vldrw.u32 q3, [r12], #16",
        "vmaxnma.f32 q0, q2",
        "vldrw.u32 q1, [r12], #16",
        "vmaxnma.f32 q0, q3",
        "vmaxnma.f32 q0, q1",
        "le lr, 10b",
        "11:",
        "ands r5, r1, #15",
        "beq 1f",
        "dlstp.32 lr, r5",
        "12:",
        "vldrw.u32 q1, [r12], #16",
        "vmaxnma.f32 q0, q1",
        "letp lr, 12b",
        "1:",
        "mov r12, #0",
        "vmaxnmav.f32 r12, q0",
        // `quant::quantum`: s0 what one quantum stands for, s1 its inverse.
        "ldrd r5, r6, 9f",
        "vmov s2, s3, r12, r6",
        "cmp r12, r5",
        "blo 7f",
        "vdiv.f32 s0, s2, s3",
        "vdiv.f32 s1, s3, s2",
        "cmp r12, #0x7f800000",
        "bhs 8f",
        "2:",
        "vstr s0, [r3]",
        "vmov r12, s1",
        "wls lr, r4, 4f",
        "3:",
        "vldrw.u32 q0, [r0], #16",
        "vldrw.u32 q1, [r0], #16",
        "vmul.f32 q0, q0, r12",
        "vldrw.u32 q2, [r0], #16",
        "vmul.f32 q1, q1, r12",
        "vldrw.u32 q3, [r0], #16",
        "vmul.f32 q2, q2, r12",
        "vmul.f32 q3, q3, r12",
        // To nearest, ties to even.
        "vcvtn.s32.f32 q0, q0",
        "vcvtn.s32.f32 q1, q1",
        "vcvtn.s32.f32 q2, q2",
        "vcvtn.s32.f32 q3, q3",
        "vstrb.32 q0, [r2]",
        "vstrb.32 q1, [r2, #4]",
        "vstrb.32 q2, [r2, #8]",
        "vstrb.32 q3, [r2, #12]",
        "add r2, r2, #32",
        "le lr, 3b",
        "4:",
        "ands r1, r1, #15",
        "beq 6f",
        // What is not there is zero.
        "mov r4, #4",
        "5:",
        "vctp.32 r1",
        "vpst",
        "vldrwt.u32 q0, [r0], #16",
        "vmul.f32 q0, q0, r12",
        "vcvtn.s32.f32 q0, q0",
        "vstrb.32 q0, [r2], #4",
        "subs r1, r1, #4",
        "it lo",
        "movlo r1, #0",
        "subs r4, r4, #1",
        "bne 5b",
        "6:",
        "vmrs r0, fpscr",
        "pop {{r4-r6, pc}}",
        "7:",
        "vldr s0, 9f + 12",
        "vldr s1, 9f + 12",
        "b 2b",
        "8:",
        "vldr s0, 9f + 8",
        "vldr s1, 9f + 12",
        "b 2b",
        ".p2align 2",
        "9: .word {dust}, {limit}, {nan}, 0",
        dust = const quant::DUST.to_bits(),
        limit = const quant::LIMIT.to_bits(),
        nan = const f32::NAN.to_bits(),
    )
}
