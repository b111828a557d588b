//! From the lab's export to the packed format.

use std::path::{Path, PathBuf};

use rigidformer_weights::{ModelWriter, TensorData, WriteError};

use super::export::{Export, ExportError};
use super::{LoadedModel, ModelError};
use crate::files::{FileError, read_whole, write_whole};

/// Why a model was not packed; nothing was written. Its text names the file, the field and the remedy.
#[derive(Debug, thiserror::Error)]
pub enum PackError {
    /// A file cannot be read or written.
    #[error(transparent)]
    File(#[from] FileError),
    /// The exported file is at fault.
    #[error(transparent)]
    Export(#[from] ExportError),
    /// Its contents break a rule of the packed format.
    #[error("{}: {source}", .path.display())]
    Write {
        /// The exported file.
        path: PathBuf,
        /// The rule.
        source: WriteError,
    },
    /// The result is no model: a tensor is missing or has another shape than the configuration wants.
    #[error(transparent)]
    Model(#[from] ModelError),
}

/// Packs the exported model in `input` into `output` (f32). The packed model has been loaded before it is written, so a
/// missing or misshapen tensor is an error here. Returns the packed file's length in bytes.
///
/// ```no_run
/// rigidformer_runtime::models::pack("edge.safetensors".as_ref(), "edge.rfm".as_ref())?;
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
pub fn pack(input: &Path, output: &Path) -> Result<usize, PackError> {
    let bytes = pack_bytes(input, &read_whole(input)?)?;
    write_whole(output, &bytes)?;
    Ok(bytes.len())
}

/// Packs an exported model that is in memory; errors call it `name`.
pub fn pack_bytes(name: &Path, bytes: &[u8]) -> Result<Vec<u8>, PackError> {
    let export = Export::parse(name, bytes)?;
    let mut writer = ModelWriter::new(&export.name, export.config);
    for (key, value) in &export.provenance {
        writer = writer.provenance(key, value);
    }
    for (metric, value) in &export.metrics {
        writer = writer.metric(metric, *value);
    }
    for (tensor, (shape, values)) in &export.tensors {
        writer = writer.tensor(tensor, *shape, TensorData::F32(values));
    }
    let packed =
        writer.finish().map_err(|source| PackError::Write { path: name.into(), source })?;
    LoadedModel::copy_of(name, &packed)?;
    Ok(packed)
}
