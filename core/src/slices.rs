//! Slices of the workspace: rows of matrices, and parts of them by offsets that its sizes prove to fit.
//!
//! A part that does not fit is a fault of this crate. Builds with debug assertions, tests among them, stop at it; others go on with
//! nothing, since the crate has no code that panics.

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

/// The `length` numbers of a slice from `start` on.
#[cfg_attr(rigidformer_dsp, inline(never))] // called from a hundred places: flash counts there
pub(crate) fn slice_at(slice: &[f32], start: usize, length: usize) -> &[f32] {
    let end = start.saturating_add(length);
    debug_assert!(end <= slice.len(), "{length} numbers from {start} on of {}", slice.len());
    slice.get(start..end).unwrap_or_default()
}

/// As [`slice_at`], mutable.
#[cfg_attr(rigidformer_dsp, inline(never))]
pub(crate) fn slice_at_mut(slice: &mut [f32], start: usize, length: usize) -> &mut [f32] {
    let end = start.saturating_add(length);
    debug_assert!(end <= slice.len(), "{length} numbers from {start} on of {}", slice.len());
    slice.get_mut(start..end).unwrap_or_default()
}

/// Copies a slice over another one of the same length.
#[cfg_attr(rigidformer_dsp, inline(never))]
pub(crate) fn copy_slice(from: &[f32], to: &mut [f32]) {
    debug_assert_eq!(from.len(), to.len(), "a slice over one of another length");
    // Not `copy_from_slice`, which panics.
    for (to, from) in to.iter_mut().zip(from) {
        *to = *from;
    }
}
