//! int8 matrices in the order in which wide registers multiply them.

use std::path::Path;

use rigidformer_weights::{ModelFile, ModelWriter, PANEL, PANEL_DEPTH, Panels, Shape, TensorData};

use super::{ModelError, PackError};

/// A row-major int8 matrix (rows, columns) in panels, and the sum of each row.
///
/// ```
/// use rigidformer_runtime::models::interleave;
/// let (panels, sums) = interleave(&[1, 2, 3, 4, 5, /* second row */ 6, 7, 8, 9, 10], 2, 5);
/// assert_eq!(panels[..8], [1, 2, 3, 4, 6, 7, 8, 9]); // four of each row, then zeros for 14 more rows
/// assert_eq!(panels[64..72], [5, 0, 0, 0, 10, 0, 0, 0]);
/// assert_eq!(sums, [15, 40]);
/// ```
pub fn interleave(values: &[i8], rows: usize, columns: usize) -> (Vec<i8>, Vec<i32>) {
    let depth = columns.next_multiple_of(PANEL_DEPTH);
    let mut panels = vec![0; rows.next_multiple_of(PANEL) * depth];
    for (index, row) in values.chunks_exact(columns.max(1)).enumerate().take(rows) {
        let start = index / PANEL * PANEL * depth + index % PANEL * PANEL_DEPTH;
        let slots = panels[start..].chunks_mut(PANEL * PANEL_DEPTH);
        for (four, slot) in row.chunks(PANEL_DEPTH).zip(slots) {
            slot[..four.len()].copy_from_slice(four);
        }
    }
    let sum = |row: &[i8]| row.iter().map(|value| i32::from(*value)).sum();
    (panels, values.chunks_exact(columns.max(1)).take(rows).map(sum).collect())
}

/// Whether a model has int8 matrices that are not in panels.
pub(super) fn has_rows(file: &ModelFile<'_>) -> bool {
    file.tensors().any(|tensor| matches!(tensor.data, TensorData::I8 { .. }))
}

/// The same model with all int8 matrices in panels: the form that hosts run fastest, and that microcontrollers cannot read.
/// What it predicts is the same, bit by bit. Errors call it `name`.
///
/// # Errors
/// [`PackError`] when the bytes are no packed model.
pub fn to_panels(name: &Path, packed: &[u8]) -> Result<Vec<u8>, PackError> {
    let file = ModelFile::parse(packed)
        .map_err(|source| ModelError::Load { path: name.into(), source: source.into() })?;
    let matrices: Vec<_> = file
        .tensors()
        .map(|tensor| match (tensor.data, tensor.shape) {
            (TensorData::I8 { values, .. }, Shape::Matrix { rows, columns }) => {
                Some(interleave(values, rows as usize, columns as usize))
            }
            _ => None,
        })
        .collect();
    let mut writer = ModelWriter::new(file.name(), *file.config());
    for (key, value) in file.provenance() {
        writer = writer.provenance(key, value);
    }
    for (metric, value) in file.metrics() {
        writer = writer.metric(metric, value);
    }
    for (tensor, matrix) in file.tensors().zip(&matrices) {
        let data = match (tensor.data, matrix) {
            (TensorData::I8 { scales, .. }, Some((values, sums))) => {
                TensorData::Panels(Panels { values, scales, sums })
            }
            (data, _) => data,
        };
        writer = writer.tensor(tensor.name, tensor.shape, data);
    }
    writer.finish().map_err(|source| PackError::Write { path: name.into(), source })
}
