//! Pooling of point features, some channels at a time over all rows.

use super::super::{arithmetic::Kernels, portable::Portable};
use super::flags::{FLUSHED, watched};
use crate::limits::ANCHORS;
use core::arch::naked_asm;

/// Channels of a strip.
const STRIP: usize = 8;
/// Channels of a strip where each has a sum an anchor.
const NARROW: usize = 4;
// What the assembly takes for granted.
const _: () = assert!(ANCHORS == 4 && STRIP == 8 && NARROW == 4);

/// [`Kernels::pool`].
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
        let to = (largest.as_mut_ptr(), sum.as_mut_ptr());
        // SAFETY: a strip of each row, which is inside, of the maxima and of the sums.
        if watched(|| unsafe { pool_strip(at, stride, rows, to.0, to.1) }).is_none() {
            pool_from(x, channels, column, largest, sum);
        }
        column += STRIP;
    }
    pool_from(x, channels, column, rest, rest_of_sums);
}

/// The channels from one on, as many as there are maxima and sums.
fn pool_from(x: &[f32], channels: usize, column: usize, largest: &mut [f32], sum: &mut [f32]) {
    if largest.is_empty() {
        return;
    }
    for row in x.chunks_exact(channels.max(1)) {
        let both = largest.iter_mut().zip(sum.iter_mut());
        for ((largest, sum), x) in both.zip(row.get(column..).unwrap_or_default()) {
            *largest = largest.max(*x);
            *sum += x;
        }
    }
}

/// Returns FPSCR in the high half; where [`FLUSHED`] is raised, maxima and sums are as they were.
///
/// # Safety
/// Eight numbers may be read at `x` and every `stride` bytes behind it, `rows` times, at least
/// once, and written at `largest` and `sum`.
#[allow(unsafe_code)]
#[unsafe(naked)]
unsafe extern "C" fn pool_strip(
    x: *const f32,
    stride: usize,
    rows: usize,
    largest: *mut f32,
    sum: *mut f32,
) -> u64 {
    naked_asm!(
        target!(),
        "ldr r12, [sp]",
        "push {{r4, lr}}",
        "vpush {{d8-d11}}",
        "vldrw.u32 q0, [r3]",
        "vldrw.u32 q1, [r3, #16]",
        "vldrw.u32 q2, [r12]",
        "vldrw.u32 q3, [r12, #16]",
        "dls lr, r2",
        "2:",
        "vldrw.u32 q4, [r0]",
        "vmaxnm.f32 q0, q0, q4",
        "vldrw.u32 q5, [r0, #16]",
        "vadd.f32 q2, q2, q4",
        "add r0, r0, r1",
        "vmaxnm.f32 q1, q1, q5",
        "vadd.f32 q3, q3, q5",
        "le lr, 2b",
        "vmrs r1, fpscr",
        "tst r1, #{flushed}",
        "bne 3f",
        "vstrw.32 q0, [r3]",
        "vstrw.32 q1, [r3, #16]",
        "vstrw.32 q2, [r12]",
        "vstrw.32 q3, [r12, #16]",
        "3:",
        "vpop {{d8-d11}}",
        "pop {{r4, pc}}",
        flushed = const FLUSHED,
    )
}

/// [`Kernels::weigh`].
#[allow(unsafe_code)]
pub(super) fn weigh(x: &[f32], weights: &[[f32; ANCHORS]], out: &mut [f32]) {
    let channels = out.len() / ANCHORS;
    let rows = x.len() / channels.max(1);
    if rows == 0 {
        return;
    }
    if weights.len() < rows || !out.len().is_multiple_of(ANCHORS) {
        return Portable.weigh(x, weights, out);
    }
    let stride = channels * size_of::<f32>();
    let mut column = 0;
    while column + NARROW <= channels {
        let at = (x.as_ptr().wrapping_add(column), out.as_mut_ptr().wrapping_add(column));
        // SAFETY: a strip of each row and of each row of out, which is inside, and as many weights
        // as there are rows.
        if watched(|| unsafe { weigh_strip(at.0, weights.as_ptr(), at.1, stride, rows) }).is_none()
        {
            weigh_from(x, weights, out, channels, column..column + NARROW);
        }
        column += NARROW;
    }
    weigh_from(x, weights, out, channels, column..channels);
}

/// Some of the channels, one by one.
fn weigh_from(
    x: &[f32],
    weights: &[[f32; ANCHORS]],
    out: &mut [f32],
    channels: usize,
    some: core::ops::Range<usize>,
) {
    if some.is_empty() {
        return;
    }
    for (row, weights) in x.chunks_exact(channels.max(1)).zip(weights) {
        for (out, weight) in out.chunks_exact_mut(channels.max(1)).zip(weights) {
            let out = out.get_mut(some.clone()).unwrap_or_default();
            for (out, x) in out.iter_mut().zip(row.iter().skip(some.start)) {
                *out += weight * x;
            }
        }
    }
}

/// Returns FPSCR in the high half; where [`FLUSHED`] is raised, `out` is as it was.
///
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
) -> u64 {
    naked_asm!(
        target!(),
        "ldr r12, [sp]",
        "push {{r4-r8, lr}}",
        "vpush {{d8-d13}}",
        "add r8, r2, r3",
        "vldrw.u32 q0, [r2]",
        "vldrw.u32 q1, [r8]",
        "add r8, r8, r3",
        "vldrw.u32 q2, [r8]",
        "add r8, r8, r3",
        "vldrw.u32 q3, [r8]",
        "dls lr, r12",
        "2:",
        "vldrw.u32 q4, [r0]",
        "ldmia r1!, {{r4-r7}}",
        "add r0, r0, r3",
        "vmul.f32 q5, q4, r4",
        "vmul.f32 q6, q4, r5",
        "vadd.f32 q0, q0, q5",
        "vmul.f32 q5, q4, r6",
        "vadd.f32 q1, q1, q6",
        "vmul.f32 q6, q4, r7",
        "vadd.f32 q2, q2, q5",
        "vadd.f32 q3, q3, q6",
        "le lr, 2b",
        "vmrs r1, fpscr",
        "tst r1, #{flushed}",
        "bne 3f",
        "vstrw.32 q3, [r8]",
        "sub r8, r8, r3",
        "vstrw.32 q2, [r8]",
        "sub r8, r8, r3",
        "vstrw.32 q1, [r8]",
        "vstrw.32 q0, [r2]",
        "3:",
        "vpop {{d8-d13}}",
        "pop {{r4-r8, pc}}",
        flushed = const FLUSHED,
    )
}
