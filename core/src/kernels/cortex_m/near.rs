//! The nearest point by brute force, eight points at a time.

use core::arch::naked_asm;
use nalgebra::{Point3, Vector3};

/// Points of a chunk.
const CHUNK: usize = 8;

/// The least of eight squared distances, as bits, into r3. They are not negative, so their bits
/// compare as they do.
#[cfg(rigidformer_fpv5)]
macro_rules! least {
    () => {
        "vminnm.f32 s4, s4, s7
        vminnm.f32 s10, s10, s13
        vminnm.f32 s16, s16, s19
        vminnm.f32 s22, s22, s25
        vminnm.f32 s4, s4, s10
        vminnm.f32 s16, s16, s22
        vminnm.f32 s4, s4, s16
        vmov r3, s4"
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

/// [`Kernels::nearest`](super::super::Kernels::nearest).
#[allow(unsafe_code)]
pub(super) fn nearest(
    points: &[Point3<f32>],
    query: &Vector3<f32>,
    distance2: f32,
) -> Option<(usize, f32)> {
    // Neither NaN nor less than nothing, and no negative zero: its bits compare then.
    let distance2 = distance2 + 0.0;
    if !(distance2 >= 0.0) {
        return None;
    }
    let (chunks, rest) = points.as_chunks::<CHUNK>();
    let mut least = distance2.to_bits();
    let start = chunks.as_ptr();
    // Behind the chunk that holds the nearest point, or `start`.
    let mut behind = start;
    if !chunks.is_empty() {
        let end = chunks.as_ptr_range().end;
        // SAFETY: the whole chunks of points.
        let both = unsafe { scan(start, end, least, query.x, query.y, query.z) };
        least = both as u32;
        behind = start.with_addr((both >> 32) as usize);
    }
    let chunk = (behind.addr() - start.addr()) / size_of::<[Point3<f32>; CHUNK]>();
    let mut found = None;
    if let Some(points) = chunk.checked_sub(1).and_then(|chunk| chunks.get(chunk)) {
        let best = first_nearest(points, query, distance2);
        found = best.map(|(i, distance2)| ((chunk - 1) * CHUNK + i, distance2));
    }
    if rest.is_empty() {
        return found;
    }
    let best = first_nearest(rest, query, f32::from_bits(least));
    best.map(|(i, distance2)| (chunks.len() * CHUNK + i, distance2)).or(found)
}

/// The least squared distance, as bits, and where the chunk ends that has it, or `start` where
/// none is less than `least`.
///
/// # Safety
/// At least one chunk of points lies from `start` to `end`.
#[allow(unsafe_code)]
#[unsafe(naked)]
unsafe extern "C" fn scan(
    start: *const [Point3<f32>; CHUNK],
    end: *const [Point3<f32>; CHUNK],
    least: u32,
    x: f32,
    y: f32,
    z: f32,
) -> u64 {
    naked_asm!(
        target!(),
        "push {{r4, lr}}",
        "vpush {{s16-s27}}",
        "mov r12, r0",
        "2:",
        "vldmia r0!, {{s4-s15}}",
        "vldmia r0!, {{s16-s27}}",
        ".irp x, s4, s7, s10, s13, s16, s19, s22, s25",
        "vsub.f32 \\x, \\x, s0",
        ".endr",
        ".irp y, s5, s8, s11, s14, s17, s20, s23, s26",
        "vsub.f32 \\y, \\y, s1",
        ".endr",
        ".irp z, s6, s9, s12, s15, s18, s21, s24, s27",
        "vsub.f32 \\z, \\z, s2",
        ".endr",
        ".irp x, s4, s7, s10, s13, s16, s19, s22, s25",
        "vmul.f32 \\x, \\x, \\x",
        ".endr",
        "vmla.f32 s4, s5, s5",
        "vmla.f32 s7, s8, s8",
        "vmla.f32 s10, s11, s11",
        "vmla.f32 s13, s14, s14",
        "vmla.f32 s16, s17, s17",
        "vmla.f32 s19, s20, s20",
        "vmla.f32 s22, s23, s23",
        "vmla.f32 s25, s26, s26",
        "vmla.f32 s4, s6, s6",
        "vmla.f32 s7, s9, s9",
        "vmla.f32 s10, s12, s12",
        "vmla.f32 s13, s15, s15",
        "vmla.f32 s16, s18, s18",
        "vmla.f32 s19, s21, s21",
        "vmla.f32 s22, s24, s24",
        "vmla.f32 s25, s27, s27",
        least!(),
        "cmp r3, r2",
        "itt lo",
        "movlo r2, r3",
        "movlo r12, r0",
        "cmp r0, r1",
        "bne.w 2b",
        "mov r0, r2",
        "mov r1, r12",
        "vpop {{s16-s27}}",
        "pop {{r4, pc}}",
    )
}

/// The first of the nearest points of a chunk, where one is nearer than `distance2`.
fn first_nearest(
    points: &[Point3<f32>],
    query: &Vector3<f32>,
    mut distance2: f32,
) -> Option<(usize, f32)> {
    let mut found = None;
    for (i, point) in points.iter().enumerate() {
        let d = point.coords - query;
        let here = crate::geometry::dot(&d, &d);
        if here < distance2 {
            distance2 = here;
            found = Some((i, here));
        }
    }
    found
}
