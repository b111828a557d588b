//! The nearest point by brute force, four points at a time.

use super::super::{arithmetic::Kernels, portable::Portable};
use super::flags::{FLUSHED, watched};
use crate::geometry::Pose;
use core::arch::naked_asm;
use core::mem::offset_of;
use nalgebra::{Point3, Vector3};

// What the assembly takes for granted.
const _: () = assert!(size_of::<Point3<f32>>() == 12 && size_of::<Vector3<f32>>() == 12);
const _: () = assert!(size_of::<nalgebra::Matrix3<f32>>() == 36);
const _: () = assert!(offset_of!(Pose, rotation) == 0 && offset_of!(Pose, centre) == 36);

/// `Pose::local` of the query s0, s1, s2 and the pose r2, into r2, r3, r12; the addresses of four points into q0, less
/// those of a round. Scalar instructions, which keep subnormal numbers.
macro_rules! begin {
    () => {
        "vldmia r2, {{s4-s15}}
        vsub.f32 s13, s0, s13
        vsub.f32 s14, s1, s14
        vsub.f32 s15, s2, s15
        vmul.f32 s0, s4, s13
        vmul.f32 s1, s7, s13
        vmul.f32 s2, s10, s13
        vmla.f32 s0, s5, s14
        vmla.f32 s1, s8, s14
        vmla.f32 s2, s11, s14
        vmla.f32 s0, s6, s15
        vmla.f32 s1, s9, s15
        vmla.f32 s2, s12, s15
        vmov r2, r3, s0, s1
        vmov r12, s2
        vldr d0, 9f
        vldr d1, 9f + 8
        vadd.i32 q0, q0, r0"
    };
}
/// Squared distances of four points in q1, q2, q3, in the order of `geometry::dot`, into q1.
macro_rules! distances {
    () => {
        "vsub.f32 q1, q1, r2
        vsub.f32 q2, q2, r3
        vsub.f32 q3, q3, r12
        vmul.f32 q1, q1, q1
        vmul.f32 q2, q2, q2
        vmul.f32 q3, q3, q3
        vadd.f32 q1, q1, q2
        vadd.f32 q1, q1, q3"
    };
}
/// The lesser of each of q4 and the squared distances of the next four points.
macro_rules! four {
    () => {
        concat!(
            "vldrw.u32 q1, [q0, #48]!
            vldrw.u32 q2, [q0, #4]
            vldrw.u32 q3, [q0, #8]
            ",
            distances!(),
            "
            vmin.u32 q4, q4, q1"
        )
    };
}
/// Bytes from one of four points to the next, less a round of four.
macro_rules! offsets {
    () => {
        ".p2align 3
        9: .word -48, -36, -24, -12"
    };
}

/// [`Kernels::nearest`]: all points may be where to look for the nearest.
#[allow(unsafe_code)]
#[inline]
pub(super) fn nearest(
    points: &[Point3<f32>],
    pose: &Pose,
    query: &Vector3<f32>,
    distance2: f32,
) -> Option<(usize, f32)> {
    // SAFETY: the slice's points.
    let both = unsafe { scan(points.as_ptr(), points.len(), pose, query.x, query.y, query.z) };
    if (both >> 32) as u32 & FLUSHED != 0 {
        return again(points, pose, query, distance2);
    }
    // No number where there is no point, or none at a distance.
    let least = f32::from_bits(both as u32);
    (least < distance2).then_some((0, least))
}

/// Once more, or as the definition does it.
#[allow(unsafe_code)]
#[cold]
fn again(
    points: &[Point3<f32>],
    pose: &Pose,
    query: &Vector3<f32>,
    distance2: f32,
) -> Option<(usize, f32)> {
    // SAFETY: the slice's points.
    match watched(|| unsafe {
        scan(points.as_ptr(), points.len(), pose, query.x, query.y, query.z)
    }) {
        Some(bits) => {
            let least = f32::from_bits(bits);
            (least < distance2).then_some((0, least))
        }
        None => Portable.nearest(points, pose, query, distance2),
    }
}

/// [`Kernels::first_at`].
#[allow(unsafe_code)]
pub(super) fn first_at(
    points: &[Point3<f32>],
    pose: &Pose,
    query: &Vector3<f32>,
    from: usize,
    distance2: f32,
) -> usize {
    let behind = points.get(from..).unwrap_or_default();
    let (at, bits) = (behind.as_ptr(), distance2.to_bits());
    // SAFETY: the slice's points.
    match watched(|| unsafe { find(at, behind.len(), pose, bits, query.x, query.y, query.z) }) {
        Some(index) => from.saturating_add(index as usize),
        None => Portable.first_at(points, pose, query, from, distance2),
    }
}

/// The least squared distance, as bits, below FPSCR. Bits compare as the distances do, since those are not negative,
/// and what is no number is above all of them.
///
/// # Safety
/// `count` points lie from `points` on.
#[allow(unsafe_code)]
#[unsafe(naked)]
unsafe extern "C" fn scan(
    points: *const Point3<f32>,
    count: usize,
    pose: &Pose,
    x: f32,
    y: f32,
    z: f32,
) -> u64 {
    naked_asm!(
        target!(),
        "push {{r4, lr}}",
        "vpush {{d8-d9}}",
        begin!(),
        "vmov.i8 q4, #0xff",
        "lsr r4, r1, #4",
        "wls lr, r4, 2f",
        "1:",
        ".rept 4",
        four!(),
        ".endr",
        "le lr, 1b",
        "2:",
        "ands r1, r1, #15",
        "beq 4f",
        "dlstp.32 lr, r1",
        "3:",
        four!(),
        "letp lr, 3b",
        "4:",
        "mov r0, #-1",
        "vminv.u32 r0, q4",
        "vmrs r1, fpscr",
        "vpop {{d8-d9}}",
        "pop {{r4, pc}}",
        offsets!(),
    )
}

/// The index of the first point at the squared distance `bits`, or 0, below FPSCR.
///
/// # Safety
/// `count` points lie from `points` on.
#[allow(unsafe_code)]
#[unsafe(naked)]
unsafe extern "C" fn find(
    points: *const Point3<f32>,
    count: usize,
    pose: &Pose,
    bits: u32,
    x: f32,
    y: f32,
    z: f32,
) -> u64 {
    naked_asm!(
        target!(),
        "push {{r4-r6, lr}}",
        "mov r4, r3",
        begin!(),
        "lsrs r5, r1, #2",
        "beq 3f",
        "2:",
        "vldrw.u32 q1, [q0, #48]!",
        "vldrw.u32 q2, [q0, #4]",
        "vldrw.u32 q3, [q0, #8]",
        distances!(),
        "vcmp.i32 eq, q1, r4",
        "vmrs r6, p0",
        "cbnz r6, 5f",
        "subs r5, r5, #1",
        "bne 2b",
        "3:",
        "ands r6, r1, #3",
        "beq 4f",
        "vctp.32 r6",
        "vpsttt",
        "vldrwt.u32 q1, [q0, #48]!",
        "vldrwt.u32 q2, [q0, #4]",
        "vldrwt.u32 q3, [q0, #8]",
        distances!(),
        "vctp.32 r6",
        "vpst",
        "vcmpt.i32 eq, q1, r4",
        "vmrs r6, p0",
        "cmp r6, #0",
        "beq 4f",
        "5:",
        // Four bits of the predicate are a point.
        "rbit r6, r6",
        "clz r6, r6",
        "lsr r0, r1, #2",
        "sub r0, r0, r5",
        "lsl r0, r0, #2",
        "add r0, r0, r6, lsr #2",
        "6:",
        "vmrs r1, fpscr",
        "pop {{r4-r6, pc}}",
        "4:",
        "mov r0, #0",
        "b 6b",
        offsets!(),
    )
}
