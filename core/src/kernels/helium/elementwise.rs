//! Elementwise loops, four at a time; the last round masks what is not there.
//!
//! The exponential needs no look at the flags. Its argument is at most 88 in size, and one below 2^-25 gives 1 whatever
//! its digits are; all that comes of larger ones is far from subnormal, as is the result. Divisions, and what else
//! might be subnormal, are scalar instructions, which keep subnormal numbers.

use super::flags::{FLUSHED, lower};
use crate::math::{EXP, EXP_RANGE, LN_2_HIGH, LN_2_LOW, LOG2_E, SHIFT};
use core::arch::naked_asm;

/// What the exponential takes from its table: the clamp, then r2 to r12.
#[repr(C)]
struct Constants {
    range: [f32; 2],
    log2_e: f32,
    shift: f32,
    high: f32,
    low: f32,
    polynomial: [f32; 7],
}

// What the assembly takes for granted.
const _: () = assert!(size_of::<Constants>() == 52);

/// e to the x.
static OF_X: Constants = {
    let [a, b, c, d, e] = EXP;
    Constants {
        range: [EXP_RANGE.0, EXP_RANGE.1],
        log2_e: LOG2_E,
        shift: SHIFT,
        high: -LN_2_HIGH,
        low: -LN_2_LOW,
        polynomial: [a, b, c, d, e, 1.0, 1.0],
    }
};
/// e to the -x: the remainder has its sign changed, and so has each other step of the polynomial. Nothing rounds
/// otherwise for that.
static OF_MINUS_X: Constants = {
    let [a, b, c, d, e] = EXP;
    Constants {
        range: [-EXP_RANGE.1, -EXP_RANGE.0],
        log2_e: -LOG2_E,
        shift: SHIFT,
        high: LN_2_HIGH,
        low: LN_2_LOW,
        polynomial: [a, -b, c, -d, e, -1.0, 1.0],
    }
};

/// `math::exp` step by step of four clamped numbers in q0, into q2; q1 is scratch. The products with `high` are exact,
/// so that fusing them with the sum rounds once as before. A power of two times the polynomial is a normal number, so
/// it is a sum of exponents.
macro_rules! exp {
    () => {
        "vmul.f32 q1, q0, r2
        vadd.f32 q1, q1, r3
        vsub.f32 q2, q1, r3
        vfma.f32 q0, q2, r4
        vmul.f32 q2, q2, r5
        vshl.i32 q1, q1, #23
        vadd.f32 q0, q0, q2
        vmul.f32 q2, q0, r6
        vadd.f32 q2, q2, r7
        vmul.f32 q2, q2, q0
        vadd.f32 q2, q2, r8
        vmul.f32 q2, q2, q0
        vadd.f32 q2, q2, r9
        vmul.f32 q2, q2, q0
        vadd.f32 q2, q2, r10
        vmul.f32 q2, q2, q0
        vadd.f32 q2, q2, r11
        vmul.f32 q2, q2, q0
        vadd.f32 q2, q2, r12
        vadd.i32 q2, q2, q1"
    };
}

/// The next four numbers of [`silu_each`].
macro_rules! silu {
    () => {
        concat!(
            "vldrw.u32 q5, [r0]
            vmaxnm.f32 q0, q5, q3
            vminnm.f32 q0, q0, q4
            ",
            exp!(),
            "
            vadd.f32 q2, q2, r12
            vdiv.f32 s20, s20, s8
            vdiv.f32 s21, s21, s9
            vdiv.f32 s22, s22, s10
            vdiv.f32 s23, s23, s11
            vstrw.32 q5, [r0], #16"
        )
    };
}

/// [`Kernels::silu`](super::super::Kernels::silu).
#[allow(unsafe_code)]
pub(super) fn silu(x: &mut [f32]) {
    // SAFETY: the slice's numbers.
    unsafe { silu_each(x.as_mut_ptr(), x.len(), &OF_MINUS_X) };
}

/// # Safety
/// `count` numbers lie at `x`.
#[allow(unsafe_code)]
#[unsafe(naked)]
unsafe extern "C" fn silu_each(x: *mut f32, count: usize, constants: &Constants) {
    naked_asm!(
        target!(),
        "push {{r4-r12, lr}}",
        "vpush {{d8-d11}}",
        "ldmia r2!, {{r3, r4}}",
        "vdup.32 q3, r3",
        "vdup.32 q4, r4",
        "ldmia r2, {{r2-r12}}",
        "lsr lr, r1, #3",
        "wls lr, lr, 2f",
        "1:",
        silu!(),
        silu!(),
        "le lr, 1b",
        "2:",
        "ands r1, r1, #7",
        "beq 4f",
        "dlstp.32 lr, r1",
        "3:",
        silu!(),
        "letp lr, 3b",
        "4:",
        "vpop {{d8-d11}}",
        "pop {{r4-r12, pc}}",
    )
}

/// [`Kernels::gate`](super::super::Kernels::gate).
#[allow(unsafe_code)]
pub(super) fn gate(x: &mut [f32], share: f32, gate: &[f32]) {
    let count = x.len().min(gate.len());
    let at = (x.as_mut_ptr(), gate.as_ptr());
    // SAFETY: as many numbers as both slices have.
    unsafe { gate_each(at.0, count, &OF_MINUS_X, at.1, share) };
}

/// # Safety
/// `count` numbers lie at `x` and at `gate`.
#[allow(unsafe_code)]
#[unsafe(naked)]
unsafe extern "C" fn gate_each(
    x: *mut f32,
    count: usize,
    constants: &Constants,
    gate: *const f32,
    share: f32,
) {
    naked_asm!(
        target!(),
        "push {{r4-r12, lr}}",
        "vpush {{d8-d11}}",
        "vmov.f32 s20, s0",
        "vmov.f32 s21, #1.0",
        "mov lr, r1",
        "mov r1, r3",
        "ldmia r2!, {{r3, r4}}",
        "vdup.32 q3, r3",
        "vdup.32 q4, r4",
        "ldmia r2, {{r2-r12}}",
        "wlstp.32 lr, lr, 3f",
        "2:",
        "vldrw.u32 q0, [r1], #16",
        // What is no number stays none.
        "vpt.f32 gt, q3, q0",
        "vmovt q0, q3",
        "vpt.f32 gt, q0, q4",
        "vmovt q0, q4",
        exp!(),
        "vldrw.u32 q0, [r0]",
        "vadd.f32 q2, q2, r12",
        ".irp d, s8, s9, s10, s11",
        "vdiv.f32 \\d, s21, \\d",
        ".endr",
        ".irp d, s0, s1, s2, s3",
        "vmul.f32 \\d, \\d, s20",
        ".endr",
        "vmul.f32 s0, s0, s8",
        "vmul.f32 s1, s1, s9",
        "vmul.f32 s2, s2, s10",
        "vmul.f32 s3, s3, s11",
        "vstrw.32 q0, [r0], #16",
        "letp lr, 2b",
        "3:",
        "vpop {{d8-d11}}",
        "pop {{r4-r12, pc}}",
    )
}

/// [`Kernels::softmax`](super::super::Kernels::softmax).
#[allow(unsafe_code)]
pub(super) fn softmax(scores: &mut [f32]) -> f32 {
    // SAFETY: the slice's numbers.
    unsafe { softmax_each(scores.as_mut_ptr(), scores.len(), &OF_X) }
}

/// Differences from the largest are not positive, or no numbers, whose sign Helium leaves positive: as bits, those
/// below the clamp are above it, and none else is.
///
/// # Safety
/// `count` numbers lie at `scores`.
#[allow(unsafe_code)]
#[unsafe(naked)]
unsafe extern "C" fn softmax_each(scores: *mut f32, count: usize, constants: &Constants) -> f32 {
    naked_asm!(
        target!(),
        "push {{r4-r12, lr}}",
        "vpush {{d8}}",
        "mov r4, #0",
        "vmov s16, r4",
        "movt r4, #0xff80",
        "mov r5, r0",
        "wlstp.32 lr, r1, 2f",
        "1:",
        "vldrw.u32 q0, [r5], #16",
        "vmaxnmv.f32 r4, q0",
        "letp lr, 1b",
        "2:",
        "mov lr, r1",
        "mov r1, r4",
        "ldr r3, [r2], #8",
        "vdup.32 q3, r3",
        "ldmia r2, {{r2-r12}}",
        "wlstp.32 lr, lr, 4f",
        "3:",
        "vldrw.u32 q0, [r0]",
        "vsub.f32 q0, q0, r1",
        "vmin.u32 q0, q0, q3",
        exp!(),
        "vstrw.32 q2, [r0], #16",
        // What is not there is zero.
        "vldrw.u32 q2, [r0, #-16]",
        "vadd.f32 s16, s16, s8",
        "vadd.f32 s16, s16, s9",
        "vadd.f32 s16, s16, s10",
        "vadd.f32 s16, s16, s11",
        "letp lr, 3b",
        "4:",
        "vmov.f32 s0, s16",
        "vpop {{d8}}",
        "pop {{r4-r12, pc}}",
    )
}

/// [`Kernels::normalise`](super::super::Kernels::normalise).
#[allow(unsafe_code)]
pub(super) fn normalise(x: &mut [f32], mean: &[f32], scale: &[f32], limit: f32) {
    let count = x.len().min(mean.len()).min(scale.len());
    let at = (mean.as_ptr(), scale.as_ptr());
    // SAFETY: as many numbers as all three slices have.
    let done = unsafe { normalise_each(x.as_mut_ptr(), count, at.0, at.1, limit) };
    if done < count {
        normalise_from(done, x, mean, scale, limit);
    }
}

/// From a number on, one by one.
#[cold]
#[inline(never)]
fn normalise_from(done: usize, x: &mut [f32], mean: &[f32], scale: &[f32], limit: f32) {
    for (x, (mean, scale)) in x.iter_mut().zip(mean.iter().zip(scale)).skip(done) {
        *x = ((*x - mean) * scale).clamp(-limit, limit);
    }
    lower();
}

/// Returns how many numbers it did: fewer than all, by fours, where [`FLUSHED`] is raised.
///
/// # Safety
/// `count` numbers lie at `x`, `mean` and `scale`.
#[allow(unsafe_code)]
#[unsafe(naked)]
unsafe extern "C" fn normalise_each(
    x: *mut f32,
    count: usize,
    mean: *const f32,
    scale: *const f32,
    limit: f32,
) -> usize {
    naked_asm!(
        target!(),
        "push {{r4, lr}}",
        "vpush {{d8-d9}}",
        "vmov r12, s0",
        "vdup.32 q3, r12",
        "vneg.f32 q4, q3",
        "mov r12, r0",
        "wlstp.32 lr, r1, 3f",
        "2:",
        "vldrw.u32 q0, [r0]",
        "vldrw.u32 q1, [r2], #16",
        "vldrw.u32 q2, [r3], #16",
        "vsub.f32 q0, q0, q1",
        "vmul.f32 q0, q0, q2",
        "vmaxnm.f32 q0, q0, q4",
        "vminnm.f32 q0, q0, q3",
        "vmrs r4, fpscr",
        "tst r4, #{flushed}",
        "bne 4f",
        "vstrw.32 q0, [r0], #16",
        "letp lr, 2b",
        "3:",
        "mov r0, r1",
        "b 5f",
        "4:",
        "lctp",
        "sub r0, r0, r12",
        "lsr r0, r0, #2",
        "5:",
        "vpop {{d8-d9}}",
        "pop {{r4, pc}}",
        flushed = const FLUSHED,
    )
}

/// x becomes (x * scale) * weight.
#[allow(unsafe_code)]
pub(super) fn scale(x: &mut [f32], weight: &[f32], scale: f32) {
    let count = x.len().min(weight.len());
    // SAFETY: as many numbers as both slices have.
    let done = unsafe { scale_each(x.as_mut_ptr(), count, weight.as_ptr(), scale.to_bits()) };
    if done < count {
        scale_from(done, x, weight, scale);
    }
}

/// From a number on, one by one.
#[cold]
#[inline(never)]
fn scale_from(done: usize, x: &mut [f32], weight: &[f32], scale: f32) {
    for (x, w) in x.iter_mut().zip(weight).skip(done) {
        *x = (*x * scale) * w;
    }
    lower();
}

/// Returns how many numbers it did: fewer than all, by fours, where [`FLUSHED`] is raised.
///
/// # Safety
/// `count` numbers lie at `x` and `weight`.
#[allow(unsafe_code)]
#[unsafe(naked)]
unsafe extern "C" fn scale_each(
    x: *mut f32,
    count: usize,
    weight: *const f32,
    scale: u32,
) -> usize {
    naked_asm!(
        target!(),
        "push {{r4, lr}}",
        "mov r12, r0",
        "wlstp.32 lr, r1, 3f",
        "2:",
        "vldrw.u32 q0, [r0]",
        "vldrw.u32 q1, [r2], #16",
        "vmul.f32 q0, q0, r3",
        "vmul.f32 q0, q0, q1",
        "vmrs r4, fpscr",
        "tst r4, #{flushed}",
        "bne 4f",
        "vstrw.32 q0, [r0], #16",
        "letp lr, 2b",
        "3:",
        "mov r0, r1",
        "pop {{r4, pc}}",
        "4:",
        "lctp",
        "sub r0, r0, r12",
        "lsr r0, r0, #2",
        "pop {{r4, pc}}",
        flushed = const FLUSHED,
    )
}

/// [`Kernels::rotate`](super::super::Kernels::rotate).
#[allow(unsafe_code)]
pub(super) fn rotate(head: &mut [f32], cos: &[f32], sin: &[f32]) {
    let count = (head.len() / 2).min(cos.len()).min(sin.len());
    // SAFETY: as many pairs as all three slices have.
    let done = unsafe { rotate_each(head.as_mut_ptr(), count, cos.as_ptr(), sin.as_ptr()) };
    if done < count {
        rotate_from(done, head, cos, sin);
    }
}

/// From a pair on, one by one.
#[cold]
#[inline(never)]
fn rotate_from(done: usize, head: &mut [f32], cos: &[f32], sin: &[f32]) {
    let (pairs, _) = head.as_chunks_mut::<2>();
    for ([even, odd], (cos, sin)) in pairs.iter_mut().zip(cos.iter().zip(sin)).skip(done) {
        (*even, *odd) = (*even * cos - *odd * sin, *odd * cos + *even * sin);
    }
    lower();
}

/// Returns how many pairs it did, by fours: fewer than there are of those where [`FLUSHED`] is raised.
///
/// # Safety
/// `count` pairs lie at `head`, and as many numbers at `cos` and `sin`.
#[allow(unsafe_code)]
#[unsafe(naked)]
unsafe extern "C" fn rotate_each(
    head: *mut f32,
    count: usize,
    cos: *const f32,
    sin: *const f32,
) -> usize {
    naked_asm!(
        target!(),
        "push {{r4, lr}}",
        "vpush {{d8-d13}}",
        "mov r12, r0",
        "lsr r1, r1, #2",
        "wls lr, r1, 3f",
        "2:",
        "vld20.32 {{q0, q1}}, [r0]",
        "vld21.32 {{q0, q1}}, [r0]",
        "vldrw.u32 q2, [r2], #16",
        "vldrw.u32 q3, [r3], #16",
        "vmul.f32 q4, q0, q2",
        "vmul.f32 q6, q1, q3",
        "vmul.f32 q5, q1, q2",
        "vsub.f32 q4, q4, q6",
        "vmul.f32 q6, q0, q3",
        "vadd.f32 q5, q5, q6",
        "vmrs r4, fpscr",
        "tst r4, #{flushed}",
        "bne 3f",
        "vst20.32 {{q4, q5}}, [r0]",
        "vst21.32 {{q4, q5}}, [r0]!",
        "le lr, 2b",
        "3:",
        "sub r0, r0, r12",
        "lsr r0, r0, #3",
        "vpop {{d8-d13}}",
        "pop {{r4, pc}}",
        flushed = const FLUSHED,
    )
}
