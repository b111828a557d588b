//! Pooling of point features, eight channels at a time over all rows.

use crate::limits::ANCHORS;
use core::arch::naked_asm;

/// Channels of a strip.
const STRIP: usize = 8;
/// Channels of a strip where each has a sum an anchor.
const NARROW: usize = 4;
// What the assembly takes for granted.
const _: () = assert!(ANCHORS == 4 && STRIP == 8 && NARROW == 4);

/// The greater of each of s0-s7 and s16-s23.
#[cfg(rigidformer_fpv5)]
macro_rules! greater {
    () => {
        "vmaxnm.f32 s0, s0, s16
        vmaxnm.f32 s1, s1, s17
        vmaxnm.f32 s2, s2, s18
        vmaxnm.f32 s3, s3, s19
        vmaxnm.f32 s4, s4, s20
        vmaxnm.f32 s5, s5, s21
        vmaxnm.f32 s6, s6, s22
        vmaxnm.f32 s7, s7, s23"
    };
}
#[cfg(not(rigidformer_fpv5))]
macro_rules! greater {
    () => {
        ".macro rigidformer_greater a, b
        vcmp.f32 \\b, \\a
        vmrs APSR_nzcv, fpscr
        it gt
        vmovgt.f32 \\a, \\b
        .endm
        rigidformer_greater s0, s16
        rigidformer_greater s1, s17
        rigidformer_greater s2, s18
        rigidformer_greater s3, s19
        rigidformer_greater s4, s20
        rigidformer_greater s5, s21
        rigidformer_greater s6, s22
        rigidformer_greater s7, s23
        .purgem rigidformer_greater"
    };
}

/// [`Kernels::pool`](super::super::Kernels::pool).
#[allow(unsafe_code)]
pub(super) fn pool(x: &[f32], largest: &mut [f32], sum: &mut [f32]) {
    let channels = largest.len();
    let rows = x.len() / channels.max(1);
    let Some(sum) = sum.get_mut(..channels) else { return };
    if rows == 0 {
        return;
    }
    let stride = size_of_val(largest);
    let (strips, rest) = largest.as_chunks_mut::<STRIP>();
    let (sums, rest_of_sums) = sum.as_chunks_mut::<STRIP>();
    let mut column = 0;
    for (largest, sum) in strips.iter_mut().zip(sums) {
        let at = x.as_ptr().wrapping_add(column);
        // SAFETY: a strip of each row, which is inside, of the maxima and of the sums.
        unsafe { pool_strip(at, stride, rows, largest, sum) };
        column += STRIP;
    }
    for row in x.chunks_exact(channels.max(1)) {
        let rest = rest.iter_mut().zip(rest_of_sums.iter_mut());
        for ((largest, sum), x) in rest.zip(row.get(column..).unwrap_or_default()) {
            *largest = largest.max(*x);
            *sum += x;
        }
    }
}

/// # Safety
/// Eight numbers may be read at `x` and every `stride` bytes behind it, `rows` times, at least
/// once.
#[allow(unsafe_code)]
#[unsafe(naked)]
unsafe extern "C" fn pool_strip(
    x: *const f32,
    stride: usize,
    rows: usize,
    largest: &mut [f32; STRIP],
    sum: &mut [f32; STRIP],
) {
    naked_asm!(
        target!(),
        "ldr r12, [sp]",
        "vpush {{s16-s23}}",
        "vldmia r3, {{s0-s7}}",
        "vldmia r12, {{s8-s15}}",
        "2:",
        "vldmia r0, {{s16-s23}}",
        "add r0, r0, r1",
        "vadd.f32 s8, s8, s16",
        "vadd.f32 s9, s9, s17",
        "vadd.f32 s10, s10, s18",
        "vadd.f32 s11, s11, s19",
        "vadd.f32 s12, s12, s20",
        "vadd.f32 s13, s13, s21",
        "vadd.f32 s14, s14, s22",
        "vadd.f32 s15, s15, s23",
        greater!(),
        "subs r2, r2, #1",
        "bne 2b",
        "vstmia r3, {{s0-s7}}",
        "vstmia r12, {{s8-s15}}",
        "vpop {{s16-s23}}",
        "bx lr",
    )
}

/// # Safety
/// Four numbers may be read at `x` and every `stride` bytes behind it, `rows` times, at least
/// once, as many weights, and four numbers may be written likewise at `out` an anchor.
#[allow(unsafe_code)]
#[unsafe(naked)]
unsafe extern "C" fn weigh_strip(
    x: *const f32,
    weights: *const [f32; ANCHORS],
    out: *mut f32,
    stride: usize,
    rows: usize,
) {
    naked_asm!(
        target!(),
        "ldr r12, [sp]",
        "vpush {{s16-s23}}",
        "vldmia r2, {{s0-s3}}",
        "add r2, r2, r3",
        "vldmia r2, {{s4-s7}}",
        "add r2, r2, r3",
        "vldmia r2, {{s8-s11}}",
        "add r2, r2, r3",
        "vldmia r2, {{s12-s15}}",
        "2:",
        "vldmia r0, {{s16-s19}}",
        "vldmia r1!, {{s20-s23}}",
        "add r0, r0, r3",
        "vmla.f32 s0, s16, s20",
        "vmla.f32 s1, s17, s20",
        "vmla.f32 s2, s18, s20",
        "vmla.f32 s3, s19, s20",
        "vmla.f32 s4, s16, s21",
        "vmla.f32 s5, s17, s21",
        "vmla.f32 s6, s18, s21",
        "vmla.f32 s7, s19, s21",
        "vmla.f32 s8, s16, s22",
        "vmla.f32 s9, s17, s22",
        "vmla.f32 s10, s18, s22",
        "vmla.f32 s11, s19, s22",
        "vmla.f32 s12, s16, s23",
        "vmla.f32 s13, s17, s23",
        "vmla.f32 s14, s18, s23",
        "vmla.f32 s15, s19, s23",
        "subs r12, r12, #1",
        "bne 2b",
        "vstmia r2, {{s12-s15}}",
        "sub r2, r2, r3",
        "vstmia r2, {{s8-s11}}",
        "sub r2, r2, r3",
        "vstmia r2, {{s4-s7}}",
        "sub r2, r2, r3",
        "vstmia r2, {{s0-s3}}",
        "vpop {{s16-s23}}",
        "bx lr",
    )
}

/// [`Kernels::weigh`](super::super::Kernels::weigh).
#[allow(unsafe_code)]
pub(super) fn weigh(x: &[f32], weights: &[[f32; ANCHORS]], out: &mut [f32]) {
    let channels = out.len() / ANCHORS;
    let rows = x.len() / channels.max(1);
    if rows == 0 || weights.len() < rows || !out.len().is_multiple_of(ANCHORS) {
        return;
    }
    let stride = channels * size_of::<f32>();
    let mut column = 0;
    while column + NARROW <= channels {
        let (x, out) = (x.as_ptr().wrapping_add(column), out.as_mut_ptr().wrapping_add(column));
        // SAFETY: a strip of each row and of each row of out, which is inside, and as many weights
        // as there are rows.
        unsafe { weigh_strip(x, weights.as_ptr(), out, stride, rows) };
        column += NARROW;
    }
    for (row, weights) in x.chunks_exact(channels.max(1)).zip(weights) {
        for (out, weight) in out.chunks_exact_mut(channels.max(1)).zip(weights) {
            for (out, x) in out.iter_mut().zip(row).skip(column) {
                *out += weight * x;
            }
        }
    }
}
