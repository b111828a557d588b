//! Layers: slices in, slices out. Shapes are in the comments, rows first.

pub(crate) mod attention;
mod linear;
mod norm;

pub(crate) use linear::{Chain, Film, Linear, Mlp};
pub(crate) use norm::{add, modulate, rms_norm, rms_norm_in_place, swiglu};

/// Rows of a matrix; a width of 0 counts as 1.
pub(crate) fn rows(matrix: &[f32], width: usize) -> Rows<'_> {
    Rows { rest: matrix, width: width.max(1) }
}

/// Rows of a mutable matrix; a width of 0 counts as 1.
pub(crate) fn rows_mut(matrix: &mut [f32], width: usize) -> RowsMut<'_> {
    RowsMut { rest: matrix, width: width.max(1) }
}

/// As `ChunksExact`, which divides by the width ahead: that takes flash, and can panic where the compiler does not see
/// that the width is not 0.
#[derive(Clone)]
pub(crate) struct Rows<'a> {
    rest: &'a [f32],
    width: usize,
}

impl<'a> Iterator for Rows<'a> {
    type Item = &'a [f32];

    #[inline]
    fn next(&mut self) -> Option<&'a [f32]> {
        let (row, rest) = self.rest.split_at_checked(self.width)?;
        self.rest = rest;
        Some(row)
    }
}

/// As [`Rows`], mutable.
pub(crate) struct RowsMut<'a> {
    rest: &'a mut [f32],
    width: usize,
}

impl<'a> Iterator for RowsMut<'a> {
    type Item = &'a mut [f32];

    #[inline]
    fn next(&mut self) -> Option<&'a mut [f32]> {
        let (row, rest) = core::mem::take(&mut self.rest).split_at_mut_checked(self.width)?;
        self.rest = rest;
        Some(row)
    }
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
