//! f32 sums in the order of [`LANES`](super::super::arithmetic::LANES): a lane a register. VMLA rounds the
//! product, then the sum, as a multiplication and an addition do.

use core::arch::naked_asm;
use core::mem::offset_of;
use half::f16;

const LANES: usize = super::super::arithmetic::LANES;
// What the assembly takes for granted.
const _: () = assert!(LANES == 8 && size_of::<f16>() == 2);

/// What the lanes start at.
static ZEROS: [f32; 2 * LANES] = [0.0; 2 * LANES];

/// Sum of products of two slices of equal length.
#[allow(unsafe_code)]
pub(super) fn dot(lhs: &[f32], rhs: &[f32]) -> f32 {
    let length = lhs.len().min(rhs.len());
    let whole = lhs.as_ptr().wrapping_add(length / LANES * LANES);
    // SAFETY: as many numbers as both slices have.
    unsafe { dot_of(lhs.as_ptr(), rhs.as_ptr(), whole, length % LANES) }
}

/// # Safety
/// Eights of numbers, or none, from `lhs` to `end`, then `rest`, fewer than eight, and as many at
/// `rhs`.
#[allow(unsafe_code)]
#[unsafe(naked)]
unsafe extern "C" fn dot_of(lhs: *const f32, rhs: *const f32, end: *const f32, rest: usize) -> f32 {
    naked_asm!(
        target!(),
        "adr.w r12, 9f",
        "vpush {{s16-s23}}",
        "vldmia r12, {{s0-s7}}",
        "cmp r0, r2",
        "beq 3f",
        "2:",
        "vldmia r0!, {{s8-s15}}",
        "vldmia r1!, {{s16-s23}}",
        "vmla.f32 s0, s8, s16",
        "vmla.f32 s1, s9, s17",
        "vmla.f32 s2, s10, s18",
        "vmla.f32 s3, s11, s19",
        "vmla.f32 s4, s12, s20",
        "vmla.f32 s5, s13, s21",
        "vmla.f32 s6, s14, s22",
        "vmla.f32 s7, s15, s23",
        "cmp r0, r2",
        "bne 2b",
        "3:",
        // The lanes of what is left over, the last first.
        "tbb [pc, r3]",
        "5:",
        ".byte (27f - 5b) / 2, (20f - 5b) / 2, (21f - 5b) / 2, (22f - 5b) / 2",
        ".byte (23f - 5b) / 2, (24f - 5b) / 2, (25f - 5b) / 2, (26f - 5b) / 2",
        "26: vldr s8, [r0, #24]",
        "vldr s16, [r1, #24]",
        "vmla.f32 s6, s8, s16",
        "25: vldr s8, [r0, #20]",
        "vldr s16, [r1, #20]",
        "vmla.f32 s5, s8, s16",
        "24: vldr s8, [r0, #16]",
        "vldr s16, [r1, #16]",
        "vmla.f32 s4, s8, s16",
        "23: vldr s8, [r0, #12]",
        "vldr s16, [r1, #12]",
        "vmla.f32 s3, s8, s16",
        "22: vldr s8, [r0, #8]",
        "vldr s16, [r1, #8]",
        "vmla.f32 s2, s8, s16",
        "21: vldr s8, [r0, #4]",
        "vldr s16, [r1, #4]",
        "vmla.f32 s1, s8, s16",
        "20: vldr s8, [r0]",
        "vldr s16, [r1]",
        "vmla.f32 s0, s8, s16",
        "27:",
        "vadd.f32 s0, s0, s4",
        "vadd.f32 s1, s1, s5",
        "vadd.f32 s2, s2, s6",
        "vadd.f32 s3, s3, s7",
        "vadd.f32 s0, s0, s2",
        "vadd.f32 s1, s1, s3",
        "vadd.f32 s0, s0, s1",
        "vpop {{s16-s23}}",
        "bx lr",
        ".p2align 2",
        "9: .space 32",
    )
}

/// What the assembly reads, in this order.
#[repr(C)]
struct Job {
    x: *const f32,
    /// Bytes of a row.
    row: usize,
    w: *const f32,
    /// Behind the last whole eight of the weights.
    w_end: *const f32,
    /// Numbers behind that.
    rest: usize,
    out: *mut f32,
    /// Bytes from one row of `out` to the next.
    stride: usize,
    pairs: usize,
    zeros: *const f32,
}

// What the assembly takes for granted: nine words, read at once.
const _: () = assert!(offset_of!(Job, x) == 0 && offset_of!(Job, row) == 4);
const _: () = assert!(offset_of!(Job, w) == 8 && offset_of!(Job, w_end) == 12);
const _: () = assert!(offset_of!(Job, rest) == 16 && offset_of!(Job, out) == 20);
const _: () = assert!(offset_of!(Job, stride) == 24 && offset_of!(Job, pairs) == 28);
const _: () = assert!(offset_of!(Job, zeros) == 32 && size_of::<Job>() == 36);

/// One channel times an even number of rows; `out` gets a number every `stride` numbers.
#[allow(unsafe_code)]
#[inline(never)]
pub(super) fn multiply(x: &[f32], w: &[f32], bias: f32, out: &mut [f32], stride: usize) {
    let inputs = w.len();
    let pairs = x.len() / (2 * inputs).max(1);
    let reach = (2 * pairs).saturating_sub(1).saturating_mul(stride).saturating_add(1);
    if inputs == 0 || pairs == 0 || out.len() < reach {
        return;
    }
    let job = Job {
        x: x.as_ptr(),
        row: size_of_val(w),
        w: w.as_ptr(),
        w_end: w.as_ptr().wrapping_add(inputs / LANES * LANES),
        rest: inputs % LANES,
        out: out.as_mut_ptr(),
        stride: stride * size_of::<f32>(),
        pairs,
        zeros: ZEROS.as_ptr(),
    };
    // SAFETY: reads pairs x 2 rows of x and all of w, and writes one number at each of 2 x pairs
    // strides of out, which the test above holds against its length.
    unsafe { multiply_pairs(&raw const job, bias) };
}

/// # Safety
/// Everything that the job says may be read and written; at least one pair.
#[allow(unsafe_code)]
#[unsafe(naked)]
unsafe extern "C" fn multiply_pairs(job: *const Job, bias: f32) {
    naked_asm!(
        target!(),
        "push {{r4-r11, lr}}",
        "vpush {{s16-s31}}",
        "vmov r12, s0",
        "mov r11, r0",
        "ldmia r11, {{r0, r1, r2, r3, r4, r5, r8, r9, r10}}",
        // r0 row, r1 bytes of a row, r2 weights, r3 their end, r4 rest, r5 out, r8 stride,
        // r9 pairs, r10 zeros, r7 next row, r11 weight
        "2:",
        "vldmia r10, {{s0-s15}}",
        "add r7, r0, r1",
        "mov r11, r2",
        "cmp r2, r3",
        "beq 4f",
        "3:",
        "vldmia r11!, {{s16-s23}}",
        "vldmia r0!, {{s24-s31}}",
        "vmla.f32 s0, s16, s24",
        "vmla.f32 s1, s17, s25",
        "vmla.f32 s2, s18, s26",
        "vmla.f32 s3, s19, s27",
        "vmla.f32 s4, s20, s28",
        "vmla.f32 s5, s21, s29",
        "vmla.f32 s6, s22, s30",
        "vmla.f32 s7, s23, s31",
        "vldmia r7!, {{s24-s31}}",
        "vmla.f32 s8, s16, s24",
        "vmla.f32 s9, s17, s25",
        "vmla.f32 s10, s18, s26",
        "vmla.f32 s11, s19, s27",
        "vmla.f32 s12, s20, s28",
        "vmla.f32 s13, s21, s29",
        "vmla.f32 s14, s22, s30",
        "vmla.f32 s15, s23, s31",
        "cmp r11, r3",
        "bne 3b",
        "4:",
        "tbb [pc, r4]",
        "5:",
        ".byte (27f - 5b) / 2, (20f - 5b) / 2, (21f - 5b) / 2, (22f - 5b) / 2",
        ".byte (23f - 5b) / 2, (24f - 5b) / 2, (25f - 5b) / 2, (26f - 5b) / 2",
        "26: vldr s16, [r11, #24]",
        "vldr s24, [r0, #24]",
        "vldr s25, [r7, #24]",
        "vmla.f32 s6, s16, s24",
        "vmla.f32 s14, s16, s25",
        "25: vldr s16, [r11, #20]",
        "vldr s24, [r0, #20]",
        "vldr s25, [r7, #20]",
        "vmla.f32 s5, s16, s24",
        "vmla.f32 s13, s16, s25",
        "24: vldr s16, [r11, #16]",
        "vldr s24, [r0, #16]",
        "vldr s25, [r7, #16]",
        "vmla.f32 s4, s16, s24",
        "vmla.f32 s12, s16, s25",
        "23: vldr s16, [r11, #12]",
        "vldr s24, [r0, #12]",
        "vldr s25, [r7, #12]",
        "vmla.f32 s3, s16, s24",
        "vmla.f32 s11, s16, s25",
        "22: vldr s16, [r11, #8]",
        "vldr s24, [r0, #8]",
        "vldr s25, [r7, #8]",
        "vmla.f32 s2, s16, s24",
        "vmla.f32 s10, s16, s25",
        "21: vldr s16, [r11, #4]",
        "vldr s24, [r0, #4]",
        "vldr s25, [r7, #4]",
        "vmla.f32 s1, s16, s24",
        "vmla.f32 s9, s16, s25",
        "20: vldr s16, [r11]",
        "vldr s24, [r0]",
        "vldr s25, [r7]",
        "vmla.f32 s0, s16, s24",
        "vmla.f32 s8, s16, s25",
        "27:",
        "vadd.f32 s0, s0, s4",
        "vadd.f32 s1, s1, s5",
        "vadd.f32 s2, s2, s6",
        "vadd.f32 s3, s3, s7",
        "vadd.f32 s8, s8, s12",
        "vadd.f32 s9, s9, s13",
        "vadd.f32 s10, s10, s14",
        "vadd.f32 s11, s11, s15",
        "vadd.f32 s0, s0, s2",
        "vadd.f32 s1, s1, s3",
        "vadd.f32 s8, s8, s10",
        "vadd.f32 s9, s9, s11",
        "vmov s16, r12",
        "vadd.f32 s0, s0, s1",
        "vadd.f32 s8, s8, s9",
        "vadd.f32 s0, s0, s16",
        "vadd.f32 s8, s8, s16",
        "vstr s0, [r5]",
        "add r5, r5, r8",
        "vstr s8, [r5]",
        "add r5, r5, r8",
        // r7 stands behind the whole eights of the second row.
        "add r0, r7, r4, lsl #2",
        "subs r9, r9, #1",
        "bne.w 2b",
        "vpop {{s16-s31}}",
        "pop {{r4-r11, pc}}",
    )
}

/// Widens as many as both slices have; exact.
#[allow(unsafe_code)]
pub(super) fn widen(half: &[f16], out: &mut [f32]) {
    let length = half.len().min(out.len());
    // SAFETY: as many as both slices have.
    unsafe { widen_each(half.as_ptr(), out.as_mut_ptr(), length / 4, length % 4) }
}

/// As [`dot`] with f16 weights, for rows that are too wide to widen them ahead.
#[inline(never)]
pub(super) fn dot_f16(x: &[f32], w: &[f16]) -> f32 {
    let mut sum = [0.0; LANES];
    for (x, w) in x.chunks(LANES).zip(w.chunks(LANES)) {
        let mut wide = [0.0; LANES];
        widen(w, &mut wide);
        for ((sum, x), w) in sum.iter_mut().zip(x).zip(wide) {
            *sum += x * w;
        }
    }
    super::super::arithmetic::add_lanes(sum)
}

/// # Safety
/// `fours` x 4 + `rest` numbers may be read at `half`, at any alignment, and written at `out`.
#[allow(unsafe_code)]
#[unsafe(naked)]
unsafe extern "C" fn widen_each(half: *const f16, out: *mut f32, fours: usize, rest: usize) {
    naked_asm!(
        target!(),
        "cbz r2, 3f",
        "push {{r4}}",
        "2:",
        "ldr r12, [r0], #4",
        "ldr r4, [r0], #4",
        "vmov s4, s5, r12, r4",
        "vcvtb.f32.f16 s0, s4",
        "vcvtt.f32.f16 s1, s4",
        "vcvtb.f32.f16 s2, s5",
        "vcvtt.f32.f16 s3, s5",
        "vstmia r1!, {{s0-s3}}",
        "subs r2, r2, #1",
        "bne 2b",
        "pop {{r4}}",
        "3:",
        "cbz r3, 5f",
        "4:",
        "ldrh r12, [r0], #2",
        "vmov s4, r12",
        "vcvtb.f32.f16 s0, s4",
        "vstmia r1!, {{s0}}",
        "subs r3, r3, #1",
        "bne 4b",
        "5:",
        "bx lr",
    )
}

/// Numbers of a strip of a sum of rows.
const STRIP: usize = 16;

/// [`Kernels::mix`](super::super::Kernels::mix).
#[allow(unsafe_code)]
pub(super) fn mix(weights: &[f32], values: &[f32], stride: usize, out: &mut [f32]) {
    let width = out.len();
    // Of the last row only what is wanted need be there.
    let rows = match values.len().checked_sub(width) {
        Some(more) => more.checked_div(stride).map_or(0, |rows| rows + 1).min(weights.len()),
        None => 0,
    };
    let (strips, rest) = out.as_chunks_mut::<STRIP>();
    rest.fill(0.0);
    let mut column = 0;
    for strip in strips {
        if rows == 0 {
            strip.fill(0.0);
            continue;
        }
        let values = values.as_ptr().wrapping_add(column);
        let step = stride * size_of::<f32>();
        let end = weights.as_ptr().wrapping_add(rows);
        // SAFETY: sixteen numbers of each row from this column, which is inside, a weight a row.
        unsafe { mix_strip(weights.as_ptr(), end, values, step, strip) };
        column += STRIP;
    }
    if !rest.is_empty() {
        for (weight, value) in weights.iter().zip(values.chunks(stride.max(1))).take(rows) {
            for (out, value) in rest.iter_mut().zip(value.iter().skip(column)) {
                *out += weight * value;
            }
        }
    }
}

/// # Safety
/// A number at `weights` up to `end`, at least one, and for each sixteen at `values` and every
/// `stride` bytes behind it.
#[allow(unsafe_code)]
#[unsafe(naked)]
unsafe extern "C" fn mix_strip(
    weights: *const f32,
    end: *const f32,
    values: *const f32,
    stride: usize,
    out: &mut [f32; STRIP],
) {
    naked_asm!(
        target!(),
        "vpush {{s16-s31}}",
        "adr.w r12, 9f",
        "vldmia r12, {{s16-s31}}",
        "2:",
        "vldmia r2, {{s1-s8}}",
        "vldmia r0!, {{s0}}",
        "vmla.f32 s16, s1, s0",
        "vmla.f32 s17, s2, s0",
        "vmla.f32 s18, s3, s0",
        "vmla.f32 s19, s4, s0",
        "vmla.f32 s20, s5, s0",
        "vmla.f32 s21, s6, s0",
        "vmla.f32 s22, s7, s0",
        "vmla.f32 s23, s8, s0",
        "add r12, r2, #32",
        "vldmia r12, {{s1-s8}}",
        "add r2, r2, r3",
        "vmla.f32 s24, s1, s0",
        "vmla.f32 s25, s2, s0",
        "vmla.f32 s26, s3, s0",
        "vmla.f32 s27, s4, s0",
        "vmla.f32 s28, s5, s0",
        "vmla.f32 s29, s6, s0",
        "vmla.f32 s30, s7, s0",
        "vmla.f32 s31, s8, s0",
        "cmp r0, r1",
        "bne 2b",
        "ldr r12, [sp, #64]",
        "vstmia r12, {{s16-s31}}",
        "vpop {{s16-s31}}",
        "bx lr",
        ".p2align 2",
        "9: .space 64",
    )
}
