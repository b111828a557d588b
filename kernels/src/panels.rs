//! int8 matrices in panels: the order in which wide registers multiply them.

use rigidformer_core::weights::{
    FormatError, ModelFile, ModelWriter, PANEL, PANEL_DEPTH, Panels, Shape, TensorData, WriteError,
};

/// Why a model is not put in panels.
#[derive(Clone, Debug, thiserror::Error)]
pub enum PanelsError {
    /// The bytes are no packed model.
    #[error(transparent)]
    Format(#[from] FormatError),
    /// The model cannot be written in this form.
    #[error(transparent)]
    Write(#[from] WriteError),
}

/// Whether a model has int8 matrices that are not in panels.
pub fn has_rows(file: &ModelFile<'_>) -> bool {
    file.tensors().any(|tensor| matches!(tensor.data, TensorData::I8 { .. }))
}

/// The same packed model with all int8 matrices in panels: the form that hosts run fastest, and that microcontrollers cannot read.
/// What it predicts is the same, bit by bit.
///
/// # Errors
/// [`PanelsError`] when the bytes are no packed model.
pub fn to_panels(packed: &[u8]) -> Result<Vec<u8>, PanelsError> {
    let file = ModelFile::parse(packed)?;
    let matrices: Vec<_> = file
        .tensors()
        .map(|tensor| match (tensor.data, tensor.shape) {
            (TensorData::I8 { values, .. }, Shape::Matrix { rows, columns }) => {
                Some(panels(values, rows as usize, columns as usize))
            }
            _ => None,
        })
        .collect();
    let mut writer = ModelWriter::new(file.name(), *file.config()).ranges(file.ranges().copied());
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
    Ok(writer.finish()?)
}

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
