//! Elementwise loops, four at a time.

use crate::math::{EXP, EXP_RANGE, LN_2_HIGH, LN_2_LOW, LOG2_E, SHIFT};
use core::arch::naked_asm;

/// Numbers of a group.
const GROUP: usize = 4;

/// Clamps each of s0-s3 to s8..s9 where it is a number; what is none may become any.
#[cfg(rigidformer_fpv5)]
macro_rules! clamp {
    () => {
        ".irp x, s0, s1, s2, s3
        vmaxnm.f32 \\x, \\x, s8
        .endr
        .irp x, s0, s1, s2, s3
        vminnm.f32 \\x, \\x, s9
        .endr"
    };
}
#[cfg(not(rigidformer_fpv5))]
macro_rules! clamp {
    () => {
        ".irp x, s0, s1, s2, s3
        vcmp.f32 \\x, s8
        vmrs APSR_nzcv, fpscr
        it mi
        vmovmi.f32 \\x, s8
        vcmp.f32 \\x, s9
        vmrs APSR_nzcv, fpscr
        it gt
        vmovgt.f32 \\x, s9
        .endr"
    };
}

/// [`Kernels::silu`](super::super::Kernels::silu).
#[allow(unsafe_code)]
pub(super) fn silu(x: &mut [f32]) {
    let (groups, rest) = x.as_chunks_mut::<GROUP>();
    if !groups.is_empty() {
        let at = groups.as_mut_ptr_range();
        // SAFETY: the whole groups of the slice.
        unsafe { silu_groups(at.start.cast(), at.end.cast()) };
    }
    for x in rest {
        *x /= 1.0 + crate::math::exp_once(-*x);
    }
}

/// `math::silu` with `math::exp` step by step. It takes the exponential of -x: with x where that
/// has -x, each step negates nothing but what is negated back.
///
/// # Safety
/// At least one group lies from `start` to `end`.
#[allow(unsafe_code)]
#[unsafe(naked)]
unsafe extern "C" fn silu_groups(start: *mut f32, end: *mut f32) {
    naked_asm!(
        target!(),
        "push {{r4-r6, lr}}",
        "vpush {{s16-s31}}",
        "adr.w r12, 9f",
        "vldmia r12, {{s8-s9}}",
        "add r12, r12, #8",
        "vldmia r12, {{s21-s31}}",
        "vmov r6, s31",
        // s0-s3 x clamped, then r; s4-s7 shifted; s10-s13 n, then p; s14-s17 p; s18-s20 spare
        "2:",
        "vldmia r0, {{s0-s3}}",
        clamp!(),
        ".irp x, s4, s5, s6, s7",
        "vmov.f32 \\x, s21",
        ".endr",
        "vmls.f32 s4, s0, s22",
        "vmls.f32 s5, s1, s22",
        "vmls.f32 s6, s2, s22",
        "vmls.f32 s7, s3, s22",
        "vsub.f32 s10, s4, s21",
        "vsub.f32 s11, s5, s21",
        "vsub.f32 s12, s6, s21",
        "vsub.f32 s13, s7, s21",
        // -x - n * high
        "vnmla.f32 s0, s10, s23",
        "vnmla.f32 s1, s11, s23",
        "vnmla.f32 s2, s12, s23",
        "vnmla.f32 s3, s13, s23",
        "vmls.f32 s0, s10, s24",
        "vmls.f32 s1, s11, s24",
        "vmls.f32 s2, s12, s24",
        "vmls.f32 s3, s13, s24",
        // The polynomial.
        "vmul.f32 s10, s0, s25",
        "vmul.f32 s11, s1, s25",
        "vmul.f32 s12, s2, s25",
        "vmul.f32 s13, s3, s25",
        ".irp c, s26, s27, s28, s29",
        "vadd.f32 s10, s10, \\c",
        "vadd.f32 s11, s11, \\c",
        "vadd.f32 s12, s12, \\c",
        "vadd.f32 s13, s13, \\c",
        "vmul.f32 s10, s10, s0",
        "vmul.f32 s11, s11, s1",
        "vmul.f32 s12, s12, s2",
        "vmul.f32 s13, s13, s3",
        ".endr",
        "vadd.f32 s10, s10, s31",
        "vadd.f32 s11, s11, s31",
        "vadd.f32 s12, s12, s31",
        "vadd.f32 s13, s13, s31",
        "vmul.f32 s10, s10, s0",
        "vmul.f32 s11, s11, s1",
        "vmul.f32 s12, s12, s2",
        "vmul.f32 s13, s13, s3",
        "vadd.f32 s10, s10, s31",
        "vadd.f32 s11, s11, s31",
        "vadd.f32 s12, s12, s31",
        "vadd.f32 s13, s13, s31",
        // The power of two.
        "vmov r2, r3, s4, s5",
        "vmov r4, r5, s6, s7",
        "add r2, r6, r2, lsl #23",
        "add r3, r6, r3, lsl #23",
        "add r4, r6, r4, lsl #23",
        "add r5, r6, r5, lsl #23",
        "vmov s4, s5, r2, r3",
        "vmov s6, s7, r4, r5",
        "vldmia r0, {{s0-s3}}",
        "vmul.f32 s4, s4, s10",
        "vmul.f32 s5, s5, s11",
        "vmul.f32 s6, s6, s12",
        "vmul.f32 s7, s7, s13",
        "vadd.f32 s4, s4, s31",
        "vadd.f32 s5, s5, s31",
        "vadd.f32 s6, s6, s31",
        "vadd.f32 s7, s7, s31",
        "vdiv.f32 s0, s0, s4",
        "vdiv.f32 s1, s1, s5",
        "vdiv.f32 s2, s2, s6",
        "vdiv.f32 s3, s3, s7",
        "vstmia r0!, {{s0-s3}}",
        "cmp r0, r1",
        "bne.w 2b",
        "vpop {{s16-s31}}",
        "pop {{r4-r6, pc}}",
        ".p2align 2",
        "9:",
        ".word {least}, {most}",
        ".word {shift}, {log2_e}, {high}, {low}, {c0}, {c1}, {c2}, {c3}, {c4}, 0, {one}",
        least = const (-EXP_RANGE.1).to_bits(),
        most = const (-EXP_RANGE.0).to_bits(),
        shift = const SHIFT.to_bits(),
        log2_e = const LOG2_E.to_bits(),
        high = const LN_2_HIGH.to_bits(),
        low = const LN_2_LOW.to_bits(),
        c0 = const EXP[0].to_bits(),
        c1 = const EXP[1].to_bits(),
        c2 = const EXP[2].to_bits(),
        c3 = const EXP[3].to_bits(),
        c4 = const EXP[4].to_bits(),
        one = const 1.0_f32.to_bits(),
    )
}

/// [`Kernels::normalise`](super::super::Kernels::normalise).
#[allow(unsafe_code)]
pub(super) fn normalise(x: &mut [f32], mean: &[f32], scale: &[f32], limit: f32) {
    let length = x.len().min(mean.len()).min(scale.len());
    let (groups, rest) = x.get_mut(..length).unwrap_or_default().as_chunks_mut::<GROUP>();
    let whole = groups.as_flattened().len();
    if whole > 0 {
        let at = groups.as_flattened_mut().as_mut_ptr_range();
        // SAFETY: the whole groups of all three slices.
        unsafe { normalise_groups(at.start, at.end, mean.as_ptr(), scale.as_ptr(), limit) };
    }
    let constants = mean.iter().zip(scale).skip(whole);
    for (x, (mean, scale)) in rest.iter_mut().zip(constants) {
        *x = ((*x - mean) * scale).clamp(-limit, limit);
    }
}

/// # Safety
/// At least one group lies from `start` to `end`, and as many at `mean` and `scale`.
#[allow(unsafe_code)]
#[unsafe(naked)]
unsafe extern "C" fn normalise_groups(
    start: *mut f32,
    end: *mut f32,
    mean: *const f32,
    scale: *const f32,
    limit: f32,
) {
    naked_asm!(
        target!(),
        "vmov.f32 s9, s0",
        "vneg.f32 s8, s0",
        "2:",
        "vldmia r0, {{s0-s3}}",
        "vldmia r2!, {{s4-s7}}",
        "vldmia r3!, {{s10-s13}}",
        "vsub.f32 s0, s0, s4",
        "vsub.f32 s1, s1, s5",
        "vsub.f32 s2, s2, s6",
        "vsub.f32 s3, s3, s7",
        "vmul.f32 s0, s0, s10",
        "vmul.f32 s1, s1, s11",
        "vmul.f32 s2, s2, s12",
        "vmul.f32 s3, s3, s13",
        clamp!(),
        "vstmia r0!, {{s0-s3}}",
        "cmp r0, r1",
        "bne 2b",
        "bx lr",
    )
}

/// x becomes (x * scale) * weight.
#[allow(unsafe_code)]
pub(super) fn scale(x: &mut [f32], weight: &[f32], scale: f32) {
    let length = x.len().min(weight.len());
    let (groups, rest) = x.get_mut(..length).unwrap_or_default().as_chunks_mut::<GROUP>();
    let whole = groups.as_flattened().len();
    if whole > 0 {
        let at = groups.as_flattened_mut().as_mut_ptr_range();
        // SAFETY: the whole groups of both slices.
        unsafe { scale_groups(at.start, at.end, weight.as_ptr(), scale) };
    }
    for (x, w) in rest.iter_mut().zip(weight.iter().skip(whole)) {
        *x = (*x * scale) * w;
    }
}

/// # Safety
/// At least one group lies from `start` to `end`, and as many at `weight`.
#[allow(unsafe_code)]
#[unsafe(naked)]
unsafe extern "C" fn scale_groups(start: *mut f32, end: *mut f32, weight: *const f32, scale: f32) {
    naked_asm!(
        target!(),
        "2:",
        "vldmia r0, {{s4-s7}}",
        "vldmia r2!, {{s8-s11}}",
        "vmul.f32 s4, s4, s0",
        "vmul.f32 s5, s5, s0",
        "vmul.f32 s6, s6, s0",
        "vmul.f32 s7, s7, s0",
        "vmul.f32 s4, s4, s8",
        "vmul.f32 s5, s5, s9",
        "vmul.f32 s6, s6, s10",
        "vmul.f32 s7, s7, s11",
        "vstmia r0!, {{s4-s7}}",
        "cmp r0, r1",
        "bne 2b",
        "bx lr",
    )
}
