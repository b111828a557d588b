//! int8 matrices in panels.

use rigidformer_core::weights::{PANEL, PANEL_DEPTH};

/// Puts a matrix (rows, columns) of int8 in [`Panels`](rigidformer_core::weights::Panels): the values as (rows / 16
/// rounded up, columns / 4 rounded up, 16, 4) with zeros where there is no row or column, and the sum of each row. A
/// last row that is not whole counts as none.
///
/// ```
/// let (values, sums) = rigidformer_kernels::panels(&[1, 2, 3, 4, 5, 6], 2, 3);
/// assert_eq!(values[..12], [1, 2, 3, 0, 4, 5, 6, 0, 0, 0, 0, 0]);
/// assert_eq!((values.len(), sums), (64, vec![6, 15]));
/// ```
pub fn panels(values: &[i8], rows: usize, columns: usize) -> (Vec<i8>, Vec<i32>) {
    // Zeros pad the last group and the last panel, so that kernels need no remainder.
    let groups = columns.div_ceil(PANEL_DEPTH);
    let mut panels = vec![0; rows.div_ceil(PANEL) * groups * PANEL * PANEL_DEPTH];
    let mut sums = vec![0; rows];
    let each = values.chunks_exact(columns.max(1)).zip(&mut sums).enumerate();
    for (row, (values, sum)) in each {
        *sum = values.iter().map(|value| i32::from(*value)).sum();
        for (group, values) in values.chunks(PANEL_DEPTH).enumerate() {
            let at = ((row / PANEL * groups + group) * PANEL + row % PANEL) * PANEL_DEPTH;
            panels[at..at + values.len()].copy_from_slice(values);
        }
    }
    (panels, sums)
}
