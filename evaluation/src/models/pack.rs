//! From the lab's export to the packed format.

use std::path::Path;

use rigidformer_core::kernels::in_own_environment;
use rigidformer_runtime::files::{read_whole, write_whole};
use rigidformer_runtime::models::LoadedModel;
use rigidformer_weights::{MAGIC, ModelWriter, TensorData};

use super::error::PackError;
use super::export::Export;
use super::quantise::{Policy, Quantised, quantise};

/// Packs the model in `input`, the lab's export or a packed f32 model, into `output`. The packed model has been loaded
/// before it is written, so a missing or misshapen tensor is an error here.
///
/// ```no_run
/// use rigidformer_evaluation::models::{Precision, pack};
/// let packed = pack("edge.safetensors".as_ref(), "edge-i8.rfm".as_ref(), &Precision::I8.into())?;
/// println!("{:.2} bytes a parameter", packed.bytes_per_parameter());
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
pub fn pack(input: &Path, output: &Path, policy: &Policy) -> Result<Quantised, PackError> {
    // All is in memory before the output is touched, which may be the input.
    let quantised = packed(input, policy)?;
    write_whole(output, &quantised.file)?;
    Ok(quantised)
}

/// As [`pack`], and writes nothing.
///
/// # Errors
/// Those of [`pack`].
pub fn packed(input: &Path, policy: &Policy) -> Result<Quantised, PackError> {
    let bytes = read_whole(input)?;
    // The contents tell the two kinds apart, and names of files need not.
    let packed = if bytes.starts_with(&MAGIC) { bytes } else { pack_bytes(input, &bytes)? };
    quantise(input, &packed, policy)
}

/// Packs an exported model that is in memory; errors call it `name`.
pub fn pack_bytes(name: &Path, bytes: &[u8]) -> Result<Vec<u8>, PackError> {
    in_own_environment(|| pack_here(name, bytes))
}

fn pack_here(name: &Path, bytes: &[u8]) -> Result<Vec<u8>, PackError> {
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
    // Loading checks every tensor, so that no file is written that does not load.
    LoadedModel::copy_of(name, &packed)?;
    Ok(packed)
}
