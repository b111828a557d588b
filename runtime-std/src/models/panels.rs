//! int8 matrices in the order in which wide registers multiply them.

use std::path::Path;

use super::error::ModelError;
use super::loaded::LoadedModel;
use crate::kernels::{self, PanelsError};

/// The same model with all int8 matrices in panels: the form that hosts run fastest, and that microcontrollers cannot read.
/// What it predicts is the same, bit by bit. Errors call it `name`.
///
/// # Errors
/// [`ModelError`] when the bytes are no packed model.
pub fn to_panels(name: &Path, packed: &[u8]) -> Result<Vec<u8>, ModelError> {
    kernels::to_panels(packed).map_err(|error| match error {
        PanelsError::Write(source) => ModelError::Write { path: name.into(), source },
        PanelsError::Format(source) => {
            ModelError::Load { path: name.into(), source: source.into() }
        }
    })
}

impl LoadedModel {
    /// The same model in the form that this machine runs fastest, with the same results to the bit: int8 matrices in
    /// panels. A model that has them already is not copied.
    ///
    /// # Errors
    /// [`ModelError`], which a model that was loaded does not cause.
    pub fn for_host(self) -> Result<Self, ModelError> {
        if !kernels::has_rows(self.model().file()) {
            return Ok(self);
        }
        let packed = to_panels(self.path(), self.bytes())?;
        Self::copy_of(self.path(), &packed)
    }
}
