//! f32 sums in the order of [`LANES`](super::super::arithmetic::LANES): two vectors of four lanes. A product is rounded
//! before it is added: VMUL, then VADD.

use super::super::{arithmetic::Kernels, portable::Portable};
use super::flags::watched;
use core::arch::naked_asm;
use core::mem::offset_of;
use half::f16;

const LANES: usize = super::super::arithmetic::LANES;
// What the assembly takes for granted.
const _: () = assert!(LANES == 8 && size_of::<f16>() == 2);

/// Sum of products of two slices of equal length.
#[allow(unsafe_code)]
pub(super) fn dot(lhs: &[f32], rhs: &[f32]) -> f32 {
    let length = lhs.len().min(rhs.len());
    // SAFETY: as many numbers as both slices have.
    let sum = watched(|| unsafe { dot_of(lhs.as_ptr(), rhs.as_ptr(), length) });
    sum.map_or_else(|| Portable.dot_f32(lhs, rhs), f32::from_bits)
}

/// The sum, as bits, below FPSCR.
///
/// # Safety
/// `count` numbers lie at `lhs` and `rhs`.
#[allow(unsafe_code)]
#[unsafe(naked)]
unsafe extern "C" fn dot_of(lhs: *const f32, rhs: *const f32, count: usize) -> u64 {
    naked_asm!(
        target!(),
        "push {{r4, lr}}",
        "vmov.i32 q0, #0",
        "vmov.i32 q1, #0",
        "lsr r3, r2, #3",
        "wls lr, r3, 3f",
        "2:",
        "vldrw.u32 q2, [r0], #16",
        "vldrw.u32 q3, [r1], #16",
        "vmul.f32 q2, q2, q3",
        "vadd.f32 q0, q0, q2",
        "vldrw.u32 q2, [r0], #16",
        "vldrw.u32 q3, [r1], #16",
        "vmul.f32 q2, q2, q3",
        "vadd.f32 q1, q1, q2",
        "le lr, 2b",
        "3:",
        "ands r2, r2, #7",
        "beq 4f",
        "vctp.32 r2",
        "vpsttt",
        "vldrwt.u32 q2, [r0], #16",
        "vldrwt.u32 q3, [r1], #16",
        "vmult.f32 q2, q2, q3",
        "vpst",
        "vaddt.f32 q0, q0, q2",
        "subs r2, r2, #4",
        "ble 4f",
        "vctp.32 r2",
        "vpsttt",
        "vldrwt.u32 q2, [r0], #16",
        "vldrwt.u32 q3, [r1], #16",
        "vmult.f32 q2, q2, q3",
        "vpst",
        "vaddt.f32 q1, q1, q2",
        "4:",
        "vadd.f32 q0, q0, q1",
        "vadd.f32 s0, s0, s2",
        "vadd.f32 s1, s1, s3",
        "vadd.f32 s0, s0, s1",
        "vmov r0, s0",
        "vmrs r1, fpscr",
        "pop {{r4, pc}}",
    )
}

/// What the assembly reads, in this order.
#[repr(C)]
struct Job {
    x: *const f32,
    /// Bytes from one row to the next.
    row: usize,
    w: *const f32,
    /// Whole eights of the weights, and numbers behind them.
    eights: usize,
    rest: usize,
    out: *mut f32,
    /// Bytes from one number of `out` to the next.
    stride: usize,
    pairs: usize,
}

// What the assembly takes for granted: eight words, read at once.
const _: () = assert!(offset_of!(Job, x) == 0 && offset_of!(Job, row) == 4);
const _: () = assert!(offset_of!(Job, w) == 8 && offset_of!(Job, eights) == 12);
const _: () = assert!(offset_of!(Job, rest) == 16 && offset_of!(Job, out) == 20);
const _: () = assert!(offset_of!(Job, stride) == 24 && offset_of!(Job, pairs) == 28);
const _: () = assert!(size_of::<Job>() == 32);

/// `out[stride * r] = (row r of x times w) * scale + bias` for as many rows as there are, `step` numbers apart; false
/// where it must be done again.
#[allow(unsafe_code)]
fn multiply(
    (x, step): (&[f32], usize),
    w: &[f32],
    (scale, bias): (f32, f32),
    (out, stride): (&mut [f32], usize),
    rows: usize,
) -> bool {
    let last = rows.saturating_sub(1);
    let reach = |step: usize, of: usize| last.saturating_mul(step).saturating_add(of);
    if w.is_empty() || rows == 0 || reach(step, w.len()) > x.len() || reach(stride, 1) > out.len() {
        return false;
    }
    let mut job = Job {
        x: x.as_ptr(),
        row: step * size_of::<f32>(),
        w: w.as_ptr(),
        eights: w.len() / LANES,
        rest: w.len() % LANES,
        out: out.as_mut_ptr(),
        stride: stride * size_of::<f32>(),
        pairs: rows / 2,
    };
    if job.pairs > 0 {
        // SAFETY: reads an even number of rows of x and all of w, and writes a number a row, which the test above
        // holds against the lengths.
        if watched(|| unsafe { multiply_pairs(&raw const job, scale, bias) }).is_none() {
            return false;
        }
    }
    if rows.is_multiple_of(2) {
        return true;
    }
    // The last row twice.
    job.x = x.as_ptr().wrapping_add(last * step);
    job.out = out.as_mut_ptr().wrapping_add(last * stride);
    (job.row, job.stride, job.pairs) = (0, 0, 1);
    // SAFETY: as before, the last row and its number.
    watched(|| unsafe { multiply_pairs(&raw const job, scale, bias) }).is_some()
}

/// One channel of an f32 product, into column n of `out`.
#[inline(never)]
pub(super) fn channel(x: &[f32], w: &[f32], bias: f32, n: usize, outputs: usize, out: &mut [f32]) {
    let rows = (out.len() / outputs.max(1)).min(x.len() / w.len().max(1));
    let column = out.get_mut(n..).unwrap_or_default();
    // Times 1 changes no bit.
    if rows > 0 && !multiply((x, w.len()), w, (1.0, bias), (column, outputs), rows) {
        for (row, out) in
            x.chunks_exact(w.len().max(1)).zip(column.iter_mut().step_by(outputs.max(1)))
        {
            *out = Portable.dot_f32(row, w) + bias;
        }
    }
}

/// [`Kernels::scores`].
pub(super) fn scores(query: &[f32], keys: &[f32], stride: usize, scale: f32, out: &mut [f32]) {
    let width = query.len();
    // Of the last row only what is wanted need be there.
    let rows = match keys.len().checked_sub(width) {
        Some(more) => more.checked_div(stride).map_or(0, |rows| rows + 1).min(out.len()),
        None => 0,
    };
    // Adding -0 changes no bit.
    let whole = rows == out.len().min(keys.len().div_ceil(stride.max(1)));
    if !whole || !multiply((keys, stride), query, (scale, -0.0), (out, 1), rows) {
        Portable.scores(query, keys, stride, scale, out);
    }
}

/// Returns FPSCR in the high half.
///
/// # Safety
/// Everything that the job says may be read and written; at least one pair.
#[allow(unsafe_code)]
#[unsafe(naked)]
unsafe extern "C" fn multiply_pairs(job: *const Job, scale: f32, bias: f32) -> u64 {
    naked_asm!(
        target!(),
        "push {{r4-r11, lr}}",
        "vpush {{d8-d15}}",
        "vmov.f32 s28, s0",
        "vmov.f32 s29, s1",
        "vldr s30, 9f",
        // r0 row, r1 bytes to the next, r2 weights, r3 eights, r4 rest, r5 out, r6 bytes to the
        // next, r7 pairs; r8 second row, r9 weight, r10 first row
        "ldmia r0, {{r0-r7}}",
        "sub r11, r3, #1",
        "1:",
        "mov r10, r0",
        "add r8, r0, r1",
        "add r0, r8, r1",
        "mov r9, r2",
        "cmp r3, #0",
        "beq.w 10f",
        "vldrw.u32 q4, [r9], #16",
        "vldrw.u32 q0, [r10], #16",
        "vmul.f32 q0, q0, q4",
        "vldrw.u32 q2, [r8], #16",
        "vmul.f32 q2, q2, q4",
        "vldrw.u32 q4, [r9], #16",
        "vldrw.u32 q1, [r10], #16",
        "vmul.f32 q1, q1, q4",
        "vldrw.u32 q3, [r8], #16",
        "vmul.f32 q3, q3, q4",
        "wls lr, r11, 3f",
        "2:",
        "vldrw.u32 q4, [r9], #16",
        "vldrw.u32 q5, [r10], #16",
        "vmul.f32 q5, q5, q4",
        "vldrw.u32 q6, [r8], #16",
        "vmul.f32 q6, q6, q4",
        "vadd.f32 q0, q0, q5",
        "vldrw.u32 q4, [r9], #16",
        "vadd.f32 q2, q2, q6",
        "vldrw.u32 q5, [r10], #16",
        "vmul.f32 q5, q5, q4",
        "vldrw.u32 q6, [r8], #16",
        "vmul.f32 q6, q6, q4",
        "vadd.f32 q1, q1, q5",
        "vadd.f32 q3, q3, q6",
        "le lr, 2b",
        "3:",
        "cbz r4, 4f",
        // What is not there is zero, and adding it changes at most -0 to 0.
        "vctp.32 r4",
        "vpsttt",
        "vldrwt.u32 q4, [r9], #16",
        "vldrwt.u32 q5, [r10], #16",
        "vldrwt.u32 q6, [r8], #16",
        "vmul.f32 q5, q5, q4",
        "vmul.f32 q6, q6, q4",
        "vadd.f32 q0, q0, q5",
        "vadd.f32 q2, q2, q6",
        "subs r12, r4, #4",
        "ble 4f",
        "vctp.32 r12",
        "vpsttt",
        "vldrwt.u32 q4, [r9]",
        "vldrwt.u32 q5, [r10]",
        "vldrwt.u32 q6, [r8]",
        "vmul.f32 q5, q5, q4",
        "vmul.f32 q6, q6, q4",
        "vadd.f32 q1, q1, q5",
        "vadd.f32 q3, q3, q6",
        "4:",
        "vadd.f32 q0, q0, q1",
        "vadd.f32 q2, q2, q3",
        "vadd.f32 s0, s0, s2",
        "vadd.f32 s1, s1, s3",
        "vadd.f32 s8, s8, s10",
        "vadd.f32 s9, s9, s11",
        "vadd.f32 s0, s0, s1",
        "vadd.f32 s8, s8, s9",
        // Sums that begin with 0 are never -0; these may be, where all products are.
        "vadd.f32 s0, s0, s30",
        "vadd.f32 s8, s8, s30",
        "vmul.f32 s0, s0, s28",
        "vmul.f32 s8, s8, s28",
        "vadd.f32 s0, s0, s29",
        "vadd.f32 s8, s8, s29",
        "vstr s0, [r5]",
        "add r5, r5, r6",
        "vstr s8, [r5]",
        "add r5, r5, r6",
        "subs r7, r7, #1",
        "bne 1b",
        "vmrs r1, fpscr",
        "vpop {{d8-d15}}",
        "pop {{r4-r11, pc}}",
        "10:",
        "vmov.i32 q0, #0",
        "vmov.i32 q1, #0",
        "vmov.i32 q2, #0",
        "vmov.i32 q3, #0",
        "b.w 3b",
        ".p2align 2",
        "9: .word 0",
    )
}

/// Widens as many as both slices have; exact.
#[allow(unsafe_code)]
pub(super) fn widen(half: &[f16], out: &mut [f32]) {
    let length = half.len().min(out.len());
    // SAFETY: as many as both slices have.
    unsafe { widen_each(half.as_ptr(), out.as_mut_ptr(), length) }
}

/// # Safety
/// `count` numbers may be read at `half` and written at `out`.
#[allow(unsafe_code)]
#[unsafe(naked)]
unsafe extern "C" fn widen_each(half: *const f16, out: *mut f32, count: usize) {
    naked_asm!(
        target!(),
        "push {{r4, lr}}",
        "wlstp.32 lr, r2, 3f",
        "2:",
        "vldrh.u32 q0, [r0], #8",
        "vcvtb.f32.f16 q0, q0",
        "vstrw.32 q0, [r1], #16",
        "letp lr, 2b",
        "3:",
        "pop {{r4, pc}}",
    )
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

/// Numbers of a strip of a sum of rows.
const STRIP: usize = 16;

/// [`Kernels::mix`].
#[allow(unsafe_code)]
pub(super) fn mix(weights: &[f32], values: &[f32], stride: usize, out: &mut [f32]) {
    let width = out.len();
    // Of the last row only what is wanted need be there.
    let rows = match values.len().checked_sub(width) {
        Some(more) => more.checked_div(stride).map_or(0, |rows| rows + 1).min(weights.len()),
        None => 0,
    };
    let weights = weights.get(..rows).unwrap_or_default();
    let (strips, rest) = out.as_chunks_mut::<STRIP>();
    let mut column = 0;
    for strip in strips {
        let from = values.get(column..).unwrap_or_default();
        let at = (weights.as_ptr(), from.as_ptr());
        let (step, to) = (stride * size_of::<f32>(), strip.as_mut_ptr());
        // SAFETY: sixteen numbers of each row from this column, which is inside, a weight a row.
        if watched(|| unsafe { mix_strip(at.0, rows, at.1, step, to) }).is_none() {
            Portable.mix(weights, from, stride, strip);
        }
        column += STRIP;
    }
    if !rest.is_empty() {
        Portable.mix(weights, values.get(column..).unwrap_or_default(), stride, rest);
    }
}

/// Returns FPSCR in the high half.
///
/// # Safety
/// `rows` numbers lie at `weights`, and for each sixteen at `values` and every `stride` bytes behind it; sixteen may be
/// written at `out`.
#[allow(unsafe_code)]
#[unsafe(naked)]
unsafe extern "C" fn mix_strip(
    weights: *const f32,
    rows: usize,
    values: *const f32,
    stride: usize,
    out: *mut f32,
) -> u64 {
    naked_asm!(
        target!(),
        "push {{r4, lr}}",
        "vpush {{d8-d11}}",
        "ldr r4, [sp, #40]",
        ".irp q, q0, q1, q2, q3",
        "vmov.i32 \\q, #0",
        ".endr",
        "wls lr, r1, 3f",
        "2:",
        "ldr r12, [r0], #4",
        "vldrw.u32 q4, [r2]",
        "vldrw.u32 q5, [r2, #16]",
        "vmul.f32 q4, q4, r12",
        "vmul.f32 q5, q5, r12",
        "vadd.f32 q0, q0, q4",
        "vldrw.u32 q4, [r2, #32]",
        "vadd.f32 q1, q1, q5",
        "vldrw.u32 q5, [r2, #48]",
        "vmul.f32 q4, q4, r12",
        "vmul.f32 q5, q5, r12",
        "vadd.f32 q2, q2, q4",
        "add r2, r2, r3",
        "vadd.f32 q3, q3, q5",
        "le lr, 2b",
        "3:",
        "vstrw.32 q0, [r4]",
        "vstrw.32 q1, [r4, #16]",
        "vstrw.32 q2, [r4, #32]",
        "vstrw.32 q3, [r4, #48]",
        "vmrs r1, fpscr",
        "vpop {{d8-d11}}",
        "pop {{r4, pc}}",
    )
}
