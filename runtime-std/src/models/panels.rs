//! int8 matrices in the order in which wide registers multiply them.

use std::path::Path;

use rigidformer_weights::{ModelFile, ModelWriter, Panels, Shape, TensorData};

use super::error::ModelError;
use super::loaded::LoadedModel;
use crate::kernels::panels;

/// Whether a model has int8 matrices that are not in panels.
pub(super) fn has_rows(file: &ModelFile<'_>) -> bool {
    file.tensors().any(|tensor| matches!(tensor.data, TensorData::I8 { .. }))
}

/// The same model with all int8 matrices in panels: the form that hosts run fastest, and that microcontrollers cannot read.
/// What it predicts is the same, bit by bit. Errors call it `name`.
///
/// # Errors
/// [`ModelError`] when the bytes are no packed model.
pub fn to_panels(name: &Path, packed: &[u8]) -> Result<Vec<u8>, ModelError> {
    let file = ModelFile::parse(packed)
        .map_err(|source| ModelError::Load { path: name.into(), source: source.into() })?;
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
    writer.finish().map_err(|source| ModelError::Write { path: name.into(), source })
}

impl LoadedModel {
    /// The same model in the form that this machine runs fastest, with the same results to the bit: int8 matrices in
    /// panels. A model that has them already is not copied.
    ///
    /// # Errors
    /// [`ModelError`], which a model that was loaded does not cause.
    pub fn for_host(self) -> Result<Self, ModelError> {
        if !has_rows(self.model().file()) {
            return Ok(self);
        }
        let packed = to_panels(self.path(), self.bytes())?;
        Self::copy_of(self.path(), &packed)
    }
}
