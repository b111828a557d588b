//! int8 matrix product by SMLAD over operands widened to 16 bits.
//!
//! Four inputs k..k+4 of a row or channel are a group of two words, (k, k + 2) and
//! (k + 1, k + 3): the order that SXTB16 leaves. Inputs that a row does not have are zeros.
//! Two rows make a panel, group by group: both words of the one, both words of the other,
//! and behind the last group the rows' two scales. Two channels make a panel likewise,
//! without scales; what stands in it for inputs that are not there meets zeros.

use super::super::arithmetic::Rows;
use crate::quant;
use core::arch::naked_asm;
use core::mem::offset_of;

/// Inputs of a group.
const GROUP: usize = 4;
/// Words of a group of two rows or channels.
const PAIR_WORDS: usize = 4;
/// Groups that the inner loop is unrolled by, in the assembly below.
const UNROLLED: usize = 16;
/// Bytes of code that one of them takes: ten instructions of four.
const GROUP_CODE: usize = 40;
/// Where there is no bias.
static NO_BIAS: [f32; 2] = [0.0; 2];

/// Words of a panel of two channels.
fn channel_words(inputs: usize) -> usize {
    inputs.div_ceil(GROUP).saturating_mul(PAIR_WORDS)
}

/// Words of a panel of two rows.
pub(super) fn row_words(inputs: usize) -> usize {
    channel_words(inputs).saturating_add(2)
}

/// What the assembly reads, at the offsets that it knows.
#[repr(C)]
struct Job {
    /// 0, 4: panels of rows.
    x: *const u32,
    x_end: *const u32,
    /// 8, 12: panel of channels.
    w: *const u32,
    w_end: *const u32,
    /// 16: bytes of the unrolled loop to pass over at first; its place, in the assembly.
    entry: usize,
    /// 20: out of the pair of channels.
    out: *mut f32,
    /// 24: bytes from one row of `out` to the next.
    stride: usize,
    /// 28: out of the row; for the assembly's own use.
    out_row: usize,
    /// 32: weights of the pair of channels, or null where the panel is filled already.
    weights: *const i8,
    /// 36: inputs, bytes of a channel.
    inputs: usize,
    /// 40, 44: of the pair of channels.
    scales: *const f32,
    bias: *const f32,
    /// 48: bytes from one pair's biases to the next: 8, or 0.
    bias_step: usize,
    /// 52: pairs of channels.
    pairs: usize,
    /// 56: 1 where the last panel's second row is none.
    odd: usize,
    /// 60
    unused: usize,
}

// What the assembly takes for granted.
const _: () = assert!(offset_of!(Job, x) == 0 && offset_of!(Job, x_end) == 4);
const _: () = assert!(offset_of!(Job, w) == 8 && offset_of!(Job, w_end) == 12);
const _: () = assert!(offset_of!(Job, entry) == 16 && offset_of!(Job, out) == 20);
const _: () = assert!(offset_of!(Job, stride) == 24 && offset_of!(Job, out_row) == 28);
const _: () = assert!(offset_of!(Job, weights) == 32 && offset_of!(Job, inputs) == 36);
const _: () = assert!(offset_of!(Job, scales) == 40 && offset_of!(Job, bias) == 44);
const _: () = assert!(offset_of!(Job, bias_step) == 48 && offset_of!(Job, pairs) == 52);
const _: () = assert!(offset_of!(Job, odd) == 56 && size_of::<Job>() == 64);
const _: () = assert!(GROUP == 4 && PAIR_WORDS == 4 && UNROLLED == 16);

/// Pairs of channels times all panels of rows.
///
/// # Safety
/// The job's panels of rows lie whole and aligned from `x` to `x_end`, the panel of channels from
/// `w` to `w_end`, of as many groups as fit `inputs`, at least one; `pairs` is at least 1, and
/// there are as many channels, scales and biases; `weights` may be read to the end of the last
/// group of the last channel. Two numbers may be written at each row of `out`, and at those
/// behind them for further pairs.
#[allow(unsafe_code)]
#[unsafe(naked)]
unsafe extern "C" fn multiply(job: *const Job) {
    naked_asm!(
        target!(),
        "push {{r4-r11, lr}}",
        "sub sp, sp, #68",
        "ldmia r0!, {{r1-r8}}",
        "mov r12, sp",
        "stmia r12!, {{r1-r8}}",
        "ldmia r0!, {{r1-r8}}",
        "stmia r12!, {{r1-r8}}",
        "ldr r0, [sp, #16]",
        "adr.w r2, 30f",
        "add r2, r2, r0",
        "orr r2, r2, #1",
        "str r2, [sp, #16]",
        // Two channels: widen them.
        "10:",
        "ldrd r8, r9, [sp, #8]",
        "ldrd r10, r11, [sp, #32]",
        "ldrd r0, r1, [sp, #40]",
        "ldr r2, [sp, #48]",
        "vldmia r0!, {{s2, s3}}",
        "vldmia r1, {{s0, s1}}",
        "add r1, r1, r2",
        "strd r0, r1, [sp, #40]",
        "cmp r10, #0",
        "beq 19f",
        "add r12, r10, r11",
        "add r0, r12, r11",
        "str r0, [sp, #32]",
        "sub r0, r9, r8",
        "tst r0, #16",
        "beq 11f",
        "ldr r1, [r10], #4",
        "ldr r3, [r12], #4",
        "sxtb16 r0, r1",
        "sxtb16 r1, r1, ror #8",
        "sxtb16 r2, r3",
        "sxtb16 r3, r3, ror #8",
        "stmia r8!, {{r0-r3}}",
        "cmp r8, r9",
        "beq 19f",
        "11:",
        "ldr r1, [r10], #4",
        "ldr r3, [r12], #4",
        "ldr r5, [r10], #4",
        "ldr r7, [r12], #4",
        "sxtb16 r0, r1",
        "sxtb16 r1, r1, ror #8",
        "sxtb16 r2, r3",
        "sxtb16 r3, r3, ror #8",
        "sxtb16 r4, r5",
        "sxtb16 r5, r5, ror #8",
        "sxtb16 r6, r7",
        "sxtb16 r7, r7, ror #8",
        "stmia r8!, {{r0-r7}}",
        "cmp r8, r9",
        "bne 11b",
        "19:",
        "ldr r12, [sp, #0]",
        "ldr r5, [sp, #20]",
        "str r5, [sp, #28]",
        "add r5, r5, #8",
        "str r5, [sp, #20]",
        // Two rows: r0, r1 sum the first's products, r2, r3 the second's.
        "20:",
        "ldr lr, [sp, #8]",
        "ldmia r12!, {{r8-r11}}",
        "ldmia lr!, {{r4-r7}}",
        "smuad r0, r8, r4",
        "smuad r1, r8, r6",
        "smuad r2, r10, r4",
        "smuad r3, r10, r6",
        "smlad r0, r9, r5, r0",
        "smlad r1, r9, r7, r1",
        "smlad r2, r11, r5, r2",
        "smlad r3, r11, r7, r3",
        "ldr pc, [sp, #16]",
        ".p2align 2",
        "30:",
        ".rept 16",
        "ldmia.w r12!, {{r8-r11}}",
        "ldmia.w lr!, {{r4-r7}}",
        "smlad r0, r8, r4, r0",
        "smlad r1, r8, r6, r1",
        "smlad r2, r10, r4, r2",
        "smlad r3, r10, r6, r3",
        "smlad r0, r9, r5, r0",
        "smlad r1, r9, r7, r1",
        "smlad r2, r11, r5, r2",
        "smlad r3, r11, r7, r3",
        ".endr",
        "ldr r4, [sp, #12]",
        "cmp lr, r4",
        "bne.w 30b",
        // sum as f32 * (row scale * channel scale) + bias
        "vldmia r12!, {{s8, s9}}",
        "vmov s4, s5, r0, r1",
        "vmov s6, s7, r2, r3",
        "vmul.f32 s10, s8, s2",
        "vmul.f32 s11, s8, s3",
        "vmul.f32 s12, s9, s2",
        "vmul.f32 s13, s9, s3",
        "vcvt.f32.s32 s4, s4",
        "vcvt.f32.s32 s5, s5",
        "vcvt.f32.s32 s6, s6",
        "vcvt.f32.s32 s7, s7",
        "vmul.f32 s4, s4, s10",
        "vmul.f32 s5, s5, s11",
        "vmul.f32 s6, s6, s12",
        "vmul.f32 s7, s7, s13",
        "vadd.f32 s4, s4, s0",
        "vadd.f32 s5, s5, s1",
        "vadd.f32 s6, s6, s0",
        "vadd.f32 s7, s7, s1",
        "ldrd r6, r5, [sp, #24]",
        "ldr r4, [sp, #4]",
        "vstmia r5, {{s4, s5}}",
        "add r5, r5, r6",
        "cmp r12, r4",
        "beq 40f",
        "vstmia r5, {{s6, s7}}",
        "add r5, r5, r6",
        "str r5, [sp, #28]",
        "b.w 20b",
        "40:",
        "ldrd r0, r1, [sp, #52]",
        "cbnz r1, 41f",
        "vstmia r5, {{s6, s7}}",
        "41:",
        "subs r0, r0, #1",
        "str r0, [sp, #52]",
        "bne.w 10b",
        "add sp, sp, #68",
        "pop {{r4-r11, pc}}",
    )
}

/// As [`multiply`] for one row: a weight is used once, so it is widened in registers.
///
/// # Safety
/// As for [`multiply`], with one panel of rows.
#[allow(unsafe_code)]
#[unsafe(naked)]
unsafe extern "C" fn multiply_one(job: *const Job) {
    naked_asm!(
        target!(),
        "push {{r4-r11, lr}}",
        "sub sp, sp, #20",
        "ldr r1, [r0, #0]",
        "ldrd r4, r5, [r0, #8]",
        "sub r5, r5, r4",
        "add r12, r1, r5",
        "ldr r9, [r0, #20]",
        "ldrd r2, r8, [r0, #32]",
        "ldrd r6, r7, [r0, #40]",
        "ldr lr, [r0, #52]",
        "add r3, r2, r8",
        // From behind a channel to the one after the next: two channels less the groups read.
        "lsl r8, r8, #1",
        "sub r8, r8, r5, lsr #2",
        "strd r8, r6, [sp, #0]",
        "strd r7, r9, [sp, #8]",
        "1:",
        "ldr r1, [r0, #0]",
        "mov r4, #0",
        "mov r5, #0",
        "2:",
        "ldr r8, [r2], #4",
        "ldr r10, [r3], #4",
        "ldrd r6, r7, [r1], #16",
        "sxtb16 r9, r8",
        "sxtb16 r8, r8, ror #8",
        "sxtb16 r11, r10",
        "sxtb16 r10, r10, ror #8",
        "smlad r4, r9, r6, r4",
        "smlad r5, r11, r6, r5",
        "smlad r4, r8, r7, r4",
        "smlad r5, r10, r7, r5",
        "cmp r1, r12",
        "bne 2b",
        // sum as f32 * (row scale * channel scale) + bias
        "ldrd r8, r6, [sp, #0]",
        "ldrd r7, r9, [sp, #8]",
        "add r2, r2, r8",
        "add r3, r3, r8",
        "vldr s8, [r1]",
        "vldmia r6!, {{s2, s3}}",
        "vldmia r7, {{s0, s1}}",
        "ldr r8, [r0, #48]",
        "vmov s4, s5, r4, r5",
        "vmul.f32 s2, s8, s2",
        "vmul.f32 s3, s8, s3",
        "vcvt.f32.s32 s4, s4",
        "vcvt.f32.s32 s5, s5",
        "vmla.f32 s0, s4, s2",
        "vmla.f32 s1, s5, s3",
        "add r7, r7, r8",
        "vstmia r9!, {{s0, s1}}",
        "str r6, [sp, #4]",
        "strd r7, r9, [sp, #8]",
        "subs lr, lr, #1",
        "bne 1b",
        "add sp, sp, #20",
        "pop {{r4-r11, pc}}",
    )
}

/// The product of `rows` quantised rows at the front of `words` with all channels; behind the
/// rows is room for two channels.
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
    let panel = row_words(inputs);
    let Some((x, w)) = words.split_at_mut_checked(rows.div_ceil(2).saturating_mul(panel)) else {
        return;
    };
    let Some(w) = w.get_mut(..channel_words(inputs)) else { return };
    let whole = inputs.checked_mul(outputs) == Some(weight.values.len())
        && (bias.len() == outputs || bias.is_empty());
    if inputs == 0 || outputs == 0 || rows == 0 || !whole {
        return;
    }
    // The first group stands before the loop; an incomplete round of the loop comes first.
    let rest = inputs.div_ceil(GROUP) - 1;
    let skip = match rest % UNROLLED {
        0 if rest == 0 => UNROLLED,
        0 => 0,
        incomplete => UNROLLED - incomplete,
    };
    // A last group reaches at most three bytes beyond its channel, which must be weights: of one
    // channel more, or, where a channel is a byte, of more than can be spared.
    let pairs = match inputs {
        1 => 0,
        _ if inputs.is_multiple_of(GROUP) => outputs / 2,
        _ => (outputs - 1) / 2,
    };
    let (x, wide) = (x.as_ptr_range(), w.as_mut_ptr_range());
    let mut job = Job {
        x: x.start,
        x_end: x.end,
        w: wide.start,
        w_end: wide.end,
        entry: skip * GROUP_CODE,
        out: out.as_mut_ptr(),
        stride: size_of_val(weight.scales),
        out_row: 0,
        weights: weight.values.as_ptr(),
        inputs,
        scales: weight.scales.as_ptr(),
        bias: if bias.is_empty() { NO_BIAS.as_ptr() } else { bias.as_ptr() },
        bias_step: if bias.is_empty() { 0 } else { 2 * size_of::<f32>() },
        pairs,
        odd: rows % 2,
        unused: 0,
    };
    if pairs > 0 {
        // SAFETY: the lengths of panels, weights, scales and biases were tested, and out has
        // `outputs` numbers for each of the rows; behind the pairs is a channel of at least as many
        // bytes as a group reaches beyond its own.
        unsafe {
            match rows {
                1 => multiply_one(&raw const job),
                _ => multiply(&raw const job),
            }
        }
    }
    // What is left: pairs of channels, or one.
    let mut done = 2 * pairs;
    while done < outputs {
        let last = (done + 1).min(outputs - 1);
        let channel =
            |n: usize| weight.values.get(n * inputs..(n + 1) * inputs).unwrap_or_default();
        widen(channel(done), channel(last), w);
        let wide = w.as_mut_ptr_range();
        (job.w, job.w_end) = (wide.start, wide.end);
        let two = |list: &[f32]| [done, last].map(|n| list.get(n).copied().unwrap_or_default());
        let (scales, biases) = (two(weight.scales), two(bias));
        job.weights = core::ptr::null();
        job.scales = scales.as_ptr();
        job.bias = biases.as_ptr();
        job.pairs = 1;
        if last > done {
            job.out = out.as_mut_ptr().wrapping_add(done);
            // SAFETY: as before, with the panel of channels filled.
            unsafe { multiply(&raw const job) };
        } else {
            single(&mut job, x.start, panel, done, outputs, out);
        }
        done += 2;
    }
}

/// The last channel, alone, into column `done` of `out`; the job's panel of channels is filled.
#[allow(unsafe_code)]
fn single(
    job: &mut Job,
    x: *const u32,
    panel: usize,
    done: usize,
    outputs: usize,
    out: &mut [f32],
) {
    job.odd = 0;
    job.stride = 2 * size_of::<f32>();
    for (n, out) in out.chunks_mut(outputs.saturating_mul(2).max(2)).enumerate() {
        let mut both = [[0.0; 2]; 2];
        job.x = x.wrapping_add(n * panel);
        job.x_end = job.x.wrapping_add(panel);
        job.out = both.as_mut_ptr().cast();
        // SAFETY: one panel of rows, the panel of channels that was filled, two scales, two biases
        // and two rows of two numbers.
        unsafe { multiply(&raw const *job) };
        for (row, [value, _]) in out.chunks_exact_mut(outputs.max(1)).zip(both) {
            if let Some(slot) = row.get_mut(done) {
                *slot = value;
            }
        }
    }
}

/// Widens two channels of equal length into a panel.
fn widen(first: &[i8], second: &[i8], panel: &mut [u32]) {
    let groups = first.chunks(GROUP).zip(second.chunks(GROUP));
    for (slots, (first, second)) in panel.chunks_exact_mut(PAIR_WORDS).zip(groups) {
        let words = [first, second].map(|group| group_words(group.iter().map(|w| i32::from(*w))));
        slots.copy_from_slice(words.as_flattened());
    }
}

/// The two words of a group of four or fewer.
fn group_words(values: impl Iterator<Item = i32>) -> [u32; 2] {
    let mut group = [0_u32; GROUP];
    for (slot, value) in group.iter_mut().zip(values) {
        *slot = value as u32 & 0xffff;
    }
    let [a, b, c, d] = group;
    [a | c << 16, b | d << 16]
}

/// Quantises a row into its half of a panel of two rows, `second` telling which, as
/// [`quant::quantise_row`] does.
#[allow(unsafe_code)]
pub(super) fn quantise(row: &[f32], panel: &mut [u32], second: bool) {
    let words = channel_words(row.len());
    let half = usize::from(second);
    if panel.len() <= words + half {
        return;
    }
    let panel = panel.as_mut_ptr();
    let (pairs, slot) = (panel.wrapping_add(2 * half), panel.wrapping_add(words + half));
    let whole = row.len() / GROUP * GROUP;
    let end = row.as_ptr().wrapping_add(whole);
    // SAFETY: the whole groups of the row and what is left of it; the panel has two words in every
    // four for each and a scale behind them, which is inside.
    unsafe { quantise_row(row.as_ptr(), end, pairs, row.len() - whole, slot) };
}

/// The largest magnitude is found among bits shifted left by one: they compare as magnitudes do,
/// NaN above infinity above all numbers.
///
/// # Safety
/// Groups, or none, lie from `start` to `end`, and `rest` numbers, fewer than a group, behind; two
/// words in every four may be written at `pairs` for each of them, and one at `scale`.
#[allow(unsafe_code)]
#[unsafe(naked)]
unsafe extern "C" fn quantise_row(
    start: *const f32,
    end: *const f32,
    pairs: *mut u32,
    rest: usize,
    scale: *mut u32,
) {
    naked_asm!(
        target!(),
        "push {{r4-r9, lr}}",
        "mov lr, r0",
        "mov r12, #0",
        "cbz r3, 11f",
        "mov r9, r1",
        "add r8, r1, r3, lsl #2",
        "10:",
        "ldr r4, [r9], #4",
        "cmp r12, r4, lsl #1",
        "it lo",
        "lsllo r12, r4, #1",
        "cmp r9, r8",
        "bne 10b",
        "11:",
        "cmp r0, r1",
        "beq 3f",
        "sub r4, r1, r0",
        "tst r4, #16",
        "beq 2f",
        "ldmia lr!, {{r4, r5, r6, r7}}",
        ".irp x, r4, r5, r6, r7",
        "cmp r12, \\x, lsl #1",
        "it lo",
        "lsllo r12, \\x, #1",
        ".endr",
        "cmp lr, r1",
        "beq 3f",
        "2:",
        "ldmia lr!, {{r4, r5, r6, r7, r8, r9}}",
        ".irp x, r4, r5, r6, r7, r8, r9",
        "cmp r12, \\x, lsl #1",
        "it lo",
        "lsllo r12, \\x, #1",
        ".endr",
        "ldmia lr!, {{r4, r5}}",
        ".irp x, r4, r5",
        "cmp r12, \\x, lsl #1",
        "it lo",
        "lsllo r12, \\x, #1",
        ".endr",
        "cmp lr, r1",
        "bne 2b",
        "3:",
        // `quant::quantum`: s0 what one quantum stands for, s8 its inverse.
        "lsr r12, r12, #1",
        "adr.w r4, 90f",
        "ldmia r4, {{r5, r6, r7}}",
        "vldr s0, [r4, #12]",
        "vldr s8, [r4, #12]",
        "cmp r12, r5",
        "blo 4f",
        "vmov s1, r6",
        "vmov s2, r12",
        "vdiv.f32 s0, s2, s1",
        "vdiv.f32 s8, s1, s2",
        "cmp r12, #0x7f800000",
        "blo 4f",
        "vmov s0, r7",
        "vldr s8, [r4, #12]",
        "4:",
        "ldr r5, [sp, #28]",
        "vstr s0, [r5]",
        "cmp r0, r1",
        "beq 7f",
        "sub r4, r1, r0",
        "tst r4, #16",
        "beq 6f",
        "vldmia r0!, {{s0-s3}}",
        "vmul.f32 s0, s0, s8",
        "vmul.f32 s1, s1, s8",
        "vmul.f32 s2, s2, s8",
        "vmul.f32 s3, s3, s8",
        ".irp x, s0, s1, s2, s3",
        "vcvtr.s32.f32 \\x, \\x",
        ".endr",
        "vmov r4, r5, s0, s1",
        "vmov r6, r7, s2, s3",
        "pkhbt r4, r4, r6, lsl #16",
        "pkhbt r5, r5, r7, lsl #16",
        "strd r4, r5, [r2], #16",
        "cmp r0, r1",
        "beq 7f",
        "6:",
        "vldmia r0!, {{s0-s7}}",
        ".irp x, s0, s1, s2, s3, s4, s5, s6, s7",
        "vmul.f32 \\x, \\x, s8",
        ".endr",
        // To nearest, ties to even.
        ".irp x, s0, s1, s2, s3, s4, s5, s6, s7",
        "vcvtr.s32.f32 \\x, \\x",
        ".endr",
        "vmov r4, r5, s0, s1",
        "vmov r6, r7, s2, s3",
        "pkhbt r4, r4, r6, lsl #16",
        "pkhbt r5, r5, r7, lsl #16",
        "strd r4, r5, [r2], #16",
        "vmov r4, r5, s4, s5",
        "vmov r6, r7, s6, s7",
        "pkhbt r4, r4, r6, lsl #16",
        "pkhbt r5, r5, r7, lsl #16",
        "strd r4, r5, [r2], #16",
        "cmp r0, r1",
        "bne 6b",
        "7:",
        "cbz r3, 8f",
        "mov r6, #0",
        "mov r7, #0",
        "vldr s0, [r0]",
        "vmul.f32 s0, s0, s8",
        "vcvtr.s32.f32 s0, s0",
        "vmov r4, s0",
        "uxth r4, r4",
        "cmp r3, #2",
        "blo 12f",
        "vldr s0, [r0, #4]",
        "vmul.f32 s0, s0, s8",
        "vcvtr.s32.f32 s0, s0",
        "vmov r7, s0",
        "uxth r7, r7",
        "beq 12f",
        "vldr s0, [r0, #8]",
        "vmul.f32 s0, s0, s8",
        "vcvtr.s32.f32 s0, s0",
        "vmov r6, s0",
        "12:",
        "pkhbt r4, r4, r6, lsl #16",
        "strd r4, r7, [r2]",
        "8:",
        "pop {{r4-r9, pc}}",
        ".p2align 2",
        "90: .word {dust}, {limit}, {nan}, 0",
        dust = const quant::DUST.to_bits(),
        limit = const quant::LIMIT.to_bits(),
        nan = const f32::NAN.to_bits(),
    )
}
