//! The nearest point by brute force, sixteen points at a time.

use super::super::{arithmetic::Kernels, portable::Portable};
use crate::geometry::Pose;
use core::arch::naked_asm;
use core::mem::offset_of;
use nalgebra::{Point3, Vector3};

/// Points of a chunk.
const CHUNK: usize = 16;
// What the assembly takes for granted.
const _: () = assert!(size_of::<Point3<f32>>() == 12 && size_of::<Vector3<f32>>() == 12);
const _: () = assert!(size_of::<nalgebra::Matrix3<f32>>() == 36);

/// Squared distances of the eight points at r0, in the order of `geometry::dot`, into s4, s7 and so
/// on to s25.
macro_rules! eight {
    () => {
        "vldmia r0!, {{s4-s15}}
        vldmia r0!, {{s16-s27}}
        .irp x, s4, s7, s10, s13, s16, s19, s22, s25
        vsub.f32 \\x, \\x, s0
        .endr
        .irp y, s5, s8, s11, s14, s17, s20, s23, s26
        vsub.f32 \\y, \\y, s1
        .endr
        .irp z, s6, s9, s12, s15, s18, s21, s24, s27
        vsub.f32 \\z, \\z, s2
        .endr
        .irp x, s4, s7, s10, s13, s16, s19, s22, s25
        vmul.f32 \\x, \\x, \\x
        .endr
        vmla.f32 s4, s5, s5
        vmla.f32 s7, s8, s8
        vmla.f32 s10, s11, s11
        vmla.f32 s13, s14, s14
        vmla.f32 s16, s17, s17
        vmla.f32 s19, s20, s20
        vmla.f32 s22, s23, s23
        vmla.f32 s25, s26, s26
        vmla.f32 s4, s6, s6
        vmla.f32 s7, s9, s9
        vmla.f32 s10, s12, s12
        vmla.f32 s13, s15, s15
        vmla.f32 s16, s18, s18
        vmla.f32 s19, s21, s21
        vmla.f32 s22, s24, s24
        vmla.f32 s25, s27, s27"
    };
}
/// The least of the first eight into s28 or r3.
#[cfg(rigidformer_fpv5)]
macro_rules! least {
    () => {
        "vminnm.f32 s4, s4, s7
        vminnm.f32 s10, s10, s13
        vminnm.f32 s16, s16, s19
        vminnm.f32 s22, s22, s25
        vminnm.f32 s4, s4, s10
        vminnm.f32 s16, s16, s22
        vminnm.f32 s28, s4, s16"
    };
}
#[cfg(not(rigidformer_fpv5))]
macro_rules! least {
    () => {
        "vmov r3, s4
        .irp d, s7, s10, s13, s16, s19, s22, s25
        vmov r4, \\d
        cmp r4, r3
        it lo
        movlo r3, r4
        .endr"
    };
}
/// The least of all sixteen into r3, as bits: distances are not negative and compare as bits do.
#[cfg(rigidformer_fpv5)]
macro_rules! least_of_all {
    () => {
        "vminnm.f32 s4, s4, s7
        vminnm.f32 s10, s10, s13
        vminnm.f32 s16, s16, s19
        vminnm.f32 s22, s22, s25
        vminnm.f32 s4, s4, s28
        vminnm.f32 s10, s10, s16
        vminnm.f32 s4, s4, s22
        vminnm.f32 s4, s4, s10
        vmov r3, s4"
    };
}
#[cfg(not(rigidformer_fpv5))]
macro_rules! least_of_all {
    () => {
        ".irp d, s4, s7, s10, s13, s16, s19, s22, s25
        vmov r4, \\d
        cmp r4, r3
        it lo
        movlo r3, r4
        .endr"
    };
}

/// [`Kernels::nearest`].
#[allow(unsafe_code)]
#[inline]
pub(super) fn nearest(
    points: &[Point3<f32>],
    pose: &Pose,
    query: &Vector3<f32>,
    distance2: f32,
) -> Option<(usize, f32)> {
    let (chunks, rest) = points.as_chunks::<CHUNK>();
    let at = chunks.as_ptr_range();
    // SAFETY: the whole chunks of points.
    let both =
        unsafe { scan(at.start, at.end, distance2.to_bits(), pose, query.x, query.y, query.z) };
    let found = Found { least: both as u32, behind: (both >> 32) as u32 };
    // Numbers from zero on compare as their bits do; what else there is takes the long way.
    if found.behind == 0 && rest.is_empty() && distance2.to_bits() <= f32::INFINITY.to_bits() {
        return None;
    }
    resolve(points, pose, query, distance2, found)
}

/// The index of the chunk that a scan found, or of a point behind the chunks.
#[inline(never)]
fn resolve(
    points: &[Point3<f32>],
    pose: &Pose,
    query: &Vector3<f32>,
    distance2: f32,
    found: Found,
) -> Option<(usize, f32)> {
    let (chunks, rest) = points.as_chunks::<CHUNK>();
    let from = |points, first: usize, distance2| {
        let found = one_by_one(points, pose, query, distance2);
        found.map(|(i, distance2)| (first + i, distance2))
    };
    if distance2.to_bits() > f32::INFINITY.to_bits() {
        return from(points, 0, distance2);
    }
    let bytes = (found.behind as usize).wrapping_sub(chunks.as_ptr().addr());
    let chunk = (bytes / size_of::<[Point3<f32>; CHUNK]>()).wrapping_sub(1);
    let least = f32::from_bits(found.least);
    let in_chunk = (found.behind != 0 && chunk < chunks.len()).then_some((chunk * CHUNK, least));
    from(rest, chunks.len() * CHUNK, least).or(in_chunk)
}

/// As the definition does it; for a few.
#[inline(never)]
fn one_by_one(
    points: &[Point3<f32>],
    pose: &Pose,
    query: &Vector3<f32>,
    distance2: f32,
) -> Option<(usize, f32)> {
    Portable.nearest(points, pose, query, distance2)
}

/// What a scan found.
struct Found {
    /// Squared distance, as bits.
    least: u32,
    /// Address behind the chunk, or 0.
    behind: u32,
}

/// The least squared distance and where the chunk ends that has it first, or `least` and 0 where
/// none is less.
///
/// # Safety
/// Whole chunks of points, or none, lie from `start` to `end`.
#[allow(unsafe_code)]
#[unsafe(naked)]
unsafe extern "C" fn scan(
    start: *const [Point3<f32>; CHUNK],
    end: *const [Point3<f32>; CHUNK],
    least: u32,
    pose: &Pose,
    x: f32,
    y: f32,
    z: f32,
) -> u64 {
    naked_asm!(
        target!(),
        "push {{r4, lr}}",
        "vpush {{s16-s28}}",
        // `Pose::local`: columns of the rotation, times what the query is off the centre.
        "add r12, r3, #{rotation}",
        "vldmia r12, {{s4-s12}}",
        "add r12, r3, #{centre}",
        "vldmia r12, {{s13-s15}}",
        "vsub.f32 s13, s0, s13",
        "vsub.f32 s14, s1, s14",
        "vsub.f32 s15, s2, s15",
        "vmul.f32 s0, s4, s13",
        "vmul.f32 s1, s7, s13",
        "vmul.f32 s2, s10, s13",
        "vmla.f32 s0, s5, s14",
        "vmla.f32 s1, s8, s14",
        "vmla.f32 s2, s11, s14",
        "vmla.f32 s0, s6, s15",
        "vmla.f32 s1, s9, s15",
        "vmla.f32 s2, s12, s15",
        "mov r12, #0",
        "cmp r0, r1",
        "beq.w 3f",
        "2:",
        eight!(),
        least!(),
        eight!(),
        least_of_all!(),
        "cmp r3, r2",
        "itt lo",
        "movlo r2, r3",
        "movlo r12, r0",
        "cmp r0, r1",
        "bne.w 2b",
        "3:",
        "mov r0, r2",
        "mov r1, r12",
        "vpop {{s16-s28}}",
        "pop {{r4, pc}}",
        rotation = const offset_of!(Pose, rotation),
        centre = const offset_of!(Pose, centre),
    )
}
