//! From the lab's export to the packed format.

use std::path::{Path, PathBuf};

use rigidformer_weights::{MAGIC, ModelWriter, TensorData, WriteError};

use super::export::{Export, ExportError};
use super::quantise::{Policy, Quantised, SourceProblem, quantise};
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
    /// A packed model cannot be quantised as asked.
    #[error("{}: {source}", .path.display())]
    Source {
        /// The packed file.
        path: PathBuf,
        /// Why.
        source: SourceProblem,
    },
    /// The result is no model: a tensor is missing or has another shape than the configuration wants.
    #[error(transparent)]
    Model(#[from] ModelError),
}

/// Packs the model in `input`, the lab's export or a packed f32 model, into `output`. The packed model has been loaded
/// before it is written, so a missing or misshapen tensor is an error here.
///
/// ```no_run
/// use rigidformer_runtime::models::{Precision, pack};
/// let packed = pack("edge.safetensors".as_ref(), "edge-i8.rfm".as_ref(), &Precision::I8.into())?;
/// println!("{:.2} bytes a parameter", packed.bytes_per_parameter());
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
pub fn pack(input: &Path, output: &Path, policy: &Policy) -> Result<Quantised, PackError> {
    let bytes = read_whole(input)?;
    let packed = if bytes.starts_with(&MAGIC) { bytes } else { pack_bytes(input, &bytes)? };
    let quantised = quantise(input, &packed, policy)?;
    write_whole(output, &quantised.file)?;
    Ok(quantised)
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
