//! The rotations of ARoPE, and where tokens stand.

use crate::kernels::Kernels;
use crate::math;
use crate::slices::{copy_slice, rows_mut, slice_at_mut};

/// Cosines, then sines, of `frequency * coordinate`, axis by axis, into (2, angles).
pub(crate) fn turns(position: [f32; 3], frequencies: &[f32], out: &mut [f32]) {
    let (cos, sin) = out.split_at_mut(out.len() / 2);
    let angles = position.iter().flat_map(|p| frequencies.iter().map(move |w| p * w));
    for ((cos, sin), angle) in cos.iter_mut().zip(sin).zip(angles) {
        (*sin, *cos) = math::sin_cos(angle);
    }
}

/// Normalises each head of a row (heads, head_dim) and rotates its channel pairs
/// (2j, 2j + 1) by the angles of `turns` (2, angles); the other channels pass through.
pub(crate) fn norm_and_rotate<K: Kernels>(
    kernels: K,
    row: &mut [f32],
    weight: &[f32],
    turns: &[f32],
) {
    let (cos, sin) = turns.split_at(turns.len() / 2);
    for head in rows_mut(row, weight.len()) {
        super::rms_norm_in_place(kernels, head, weight);
        kernels.rotate(head, cos, sin);
    }
}

/// Copies rows of registers or tokens into a matrix, from a number on.
pub(crate) fn put_rows(rows: &[f32], start: usize, matrix: &mut [f32]) {
    copy_slice(rows, slice_at_mut(matrix, start, rows.len()));
}
