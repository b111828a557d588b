//! Some columns of a row-major matrix, for threads that each write their own.

use std::marker::PhantomData;

/// The same columns of every row of a matrix, borrowed mutably: no two such values share a number.
pub struct Columns<'m> {
    /// First column of the first row.
    start: *mut f32,
    rows: usize,
    /// Numbers from a row to the next.
    stride: usize,
    /// Columns.
    width: usize,
    matrix: PhantomData<&'m mut [f32]>,
}

// SAFETY: it is a mutable borrow of plain numbers, whose parts are disjoint.
#[allow(unsafe_code)]
unsafe impl Send for Columns<'_> {}

impl<'m> Columns<'m> {
    /// All columns of a matrix (rows, width); a last row that is not whole is left out.
    pub fn new(matrix: &'m mut [f32], width: usize) -> Self {
        let rows = matrix.len().checked_div(width).unwrap_or(0);
        Columns { start: matrix.as_mut_ptr(), rows, stride: width, width, matrix: PhantomData }
    }

    /// Rows.
    pub fn rows(&self) -> usize {
        self.rows
    }

    /// Columns.
    pub fn width(&self) -> usize {
        self.width
    }

    /// The first `columns` columns, at most all, and the others.
    pub fn split_at(self, columns: usize) -> (Columns<'m>, Columns<'m>) {
        let columns = columns.min(self.width);
        let rest = Columns {
            // Wrapping: the pointer may lie behind the matrix where no column is left, and is then not dereferenced.
            start: self.start.wrapping_add(columns),
            width: self.width - columns,
            ..self
        };
        (Columns { width: columns, ..self }, rest)
    }

    /// First column of the first row, and numbers from a row to the next.
    #[cfg(any(target_arch = "x86_64", all(target_arch = "aarch64", target_endian = "little")))]
    pub(super) fn origin_and_stride(&mut self) -> (*mut f32, usize) {
        (self.start, self.stride)
    }

    /// These columns of a row.
    ///
    /// # Panics
    /// Where the row does not exist.
    pub fn row(&mut self, row: usize) -> &mut [f32] {
        assert!(row < self.rows, "row {row} of {}", self.rows);
        // SAFETY: `start` is inside a matrix of `rows` rows of `stride` numbers that is borrowed mutably for 'm, at a
        // column from which `width` columns fit into a row; other values of this type have other columns.
        #[allow(unsafe_code)]
        unsafe {
            std::slice::from_raw_parts_mut(self.start.add(row * self.stride), self.width)
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn parts_are_disjoint_and_complete() {
        let mut matrix = [0.0; 12];
        let (mut left, rest) = Columns::new(&mut matrix, 4).split_at(1);
        let (mut middle, mut right) = rest.split_at(2);
        for row in 0..3 {
            left.row(row).fill(1.0);
            middle.row(row).fill(2.0);
            right.row(row).fill(3.0);
        }
        assert_eq!(right.split_at(9).1.width(), 0);
        assert_eq!(matrix, [1.0, 2.0, 2.0, 3.0].repeat(3)[..]);
    }
}
