//! Layers: slices in, slices out. Shapes are in the comments, rows first.

pub(crate) mod attention;
mod linear;
mod norm;

pub(crate) use linear::{Chain, Film, Linear, Mlp};
pub(crate) use norm::{add, modulate, rms_norm, rms_norm_in_place, swiglu};

/// Rows of a matrix; a width of 0 counts as 1.
pub(crate) fn rows(matrix: &[f32], width: usize) -> core::slice::ChunksExact<'_, f32> {
    matrix.chunks_exact(width.max(1))
}

/// Rows of a mutable matrix; a width of 0 counts as 1.
pub(crate) fn rows_mut(matrix: &mut [f32], width: usize) -> core::slice::ChunksExactMut<'_, f32> {
    matrix.chunks_exact_mut(width.max(1))
}

/// The part of a slice from `start`, `length` long; empty where that is not inside, which
/// the workspace's sizes rule out.
#[cfg_attr(rigidformer_dsp, inline(never))] // called from a hundred places: flash counts there
pub(crate) fn part(slice: &[f32], start: usize, length: usize) -> &[f32] {
    slice.get(start..start.saturating_add(length)).unwrap_or_default()
}

/// As [`part`], mutable.
#[cfg_attr(rigidformer_dsp, inline(never))]
pub(crate) fn part_mut(slice: &mut [f32], start: usize, length: usize) -> &mut [f32] {
    slice.get_mut(start..start.saturating_add(length)).unwrap_or_default()
}

/// Copies as much as fits.
#[cfg_attr(rigidformer_dsp, inline(never))]
pub(crate) fn copy(from: &[f32], to: &mut [f32]) {
    for (to, from) in to.iter_mut().zip(from) {
        *to = *from;
    }
}
