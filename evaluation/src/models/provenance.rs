//! What a packed model says beside its tensors: where it comes from, which units it sees, and what its training saw.

use std::path::Path;

use rigidformer_runtime::models::{LoadedModel, ModelError};
use rigidformer_weights::{AlignedBuffer, ModelConfig, ModelFile, ModelWriter, Ranges, Scope};

use super::error::{PackError, SourceProblem};

/// A packed model with more provenance; errors call it `name`. An entry whose key the model has replaces that one in
/// its place, others follow in their order. Everything else stays, tensors byte for byte.
///
/// # Errors
/// [`PackError`] when the input is no model, an entry breaks a rule of the format, or the tensors lie in the file in
/// another way than this program writes them.
///
/// ```
/// use rigidformer_evaluation::models::with_provenance;
/// use rigidformer_runtime::models::LoadedModel;
/// let entries = [("run 1".to_owned(), "seeds 1-1200, 92 min".to_owned())];
/// let file = with_provenance("nano.rfm".as_ref(), rigidformer_weights::EDGE, &entries)?;
/// let loaded = LoadedModel::copy_of("nano.rfm", &file)?;
/// let model = loaded.model();
/// assert!(model.file().provenance().any(|entry| entry == ("run 1", "seeds 1-1200, 92 min")));
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
pub fn with_provenance(
    name: &Path,
    packed: &[u8],
    entries: &[(String, String)],
) -> Result<Vec<u8>, PackError> {
    rewritten(name, packed, entries, |config| config, kept)
}

/// A packed model whose network sees other units of a scene; errors call it `name`. Everything else stays, tensors byte for byte.
///
/// # Errors
/// As [`with_provenance`]; [`PackError::Write`] where the model's motion or its bonds do not go with the scope.
///
/// ```
/// use rigidformer_evaluation::models::with_scope;
/// use rigidformer_runtime::models::LoadedModel;
/// use rigidformer_weights::Scope;
/// let file = with_scope("edge.rfm".as_ref(), rigidformer_weights::EDGE, Scope::All)?;
/// let loaded = LoadedModel::copy_of("edge.rfm", &file)?;
/// assert_eq!(loaded.model().config().scope, Scope::All);
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
pub fn with_scope(name: &Path, packed: &[u8], scope: Scope) -> Result<Vec<u8>, PackError> {
    rewritten(name, packed, &[], |config| ModelConfig { scope, ..config }, kept)
}

/// A packed model with another number of units up to which it corrects, 0 for any; errors call it `name`. Everything else stays,
/// tensors byte for byte.
///
/// # Errors
/// As [`with_provenance`]; [`PackError::Write`] where the model's motion or its bonds do not go with that.
///
/// ```
/// use rigidformer_evaluation::models::with_rules;
/// use rigidformer_runtime::models::LoadedModel;
/// let file = with_rules("edge.rfm".as_ref(), rigidformer_weights::EDGE, 8)?;
/// assert_eq!(LoadedModel::copy_of("edge.rfm", &file)?.model().config().most_units, 8);
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
pub fn with_rules(name: &Path, packed: &[u8], most_units: u32) -> Result<Vec<u8>, PackError> {
    rewritten(name, packed, &[], |config| ModelConfig { most_units, ..config }, kept)
}

/// A packed model that says what training saw; errors call it `name`. Everything else stays, tensors byte for byte.
///
/// # Errors
/// As [`with_provenance`]; [`PackError::Write`] where a range is none.
pub fn with_ranges(name: &Path, packed: &[u8], ranges: &Ranges) -> Result<Vec<u8>, PackError> {
    rewritten(name, packed, &[], |config| config, |_| Some(*ranges))
}

/// What training saw, as the file says.
fn kept(file: &ModelFile<'_>) -> Option<Ranges> {
    file.ranges().copied()
}

/// A packed model with these figures in place of its own, such as errors and what they are without the network: those of before may
/// be of other code. Of two of one name the last counts. Errors call the model `name`. Everything else stays, tensors byte for byte.
///
/// # Errors
/// As [`with_provenance`]; [`PackError::Write`] where a figure is not finite.
pub fn with_metrics(
    name: &Path,
    packed: &[u8],
    metrics: &[(String, f32)],
) -> Result<Vec<u8>, PackError> {
    written(name, packed, Changes { entries: &[], metrics: Some(metrics) }, |config| config, kept)
}

/// The same model with more provenance, another configuration and other ranges.
fn rewritten(
    name: &Path,
    packed: &[u8],
    entries: &[(String, String)],
    change: impl Fn(ModelConfig) -> ModelConfig,
    ranges: impl Fn(&ModelFile<'_>) -> Option<Ranges>,
) -> Result<Vec<u8>, PackError> {
    written(name, packed, Changes { entries, metrics: None }, change, ranges)
}

/// What a model is to say.
struct Changes<'a> {
    /// Besides its own.
    entries: &'a [(String, String)],
    /// In place of its own.
    metrics: Option<&'a [(String, f32)]>,
}

/// As [`rewritten`], with other figures too.
fn written(
    name: &Path,
    packed: &[u8],
    Changes { entries, metrics }: Changes<'_>,
    change: impl Fn(ModelConfig) -> ModelConfig,
    ranges: impl Fn(&ModelFile<'_>) -> Option<Ranges>,
) -> Result<Vec<u8>, PackError> {
    // Tensors are read in place, which needs an alignment that the caller's bytes may lack.
    let buffer = AlignedBuffer::copy_of(packed);
    let unreadable = |source: rigidformer_weights::FormatError| {
        PackError::Model(ModelError::Load { path: name.into(), source: source.into() })
    };
    let file = ModelFile::parse(&buffer).map_err(unreadable)?;
    let mut writer = ModelWriter::new(file.name(), change(*file.config())).ranges(ranges(&file));
    for (key, value) in file.provenance() {
        // Of two entries with one key the last counts, as in a dictionary.
        let newer = entries.iter().rev().find(|(newer, _)| newer == key);
        writer = writer.provenance(key, newer.map_or(value, |(_, value)| value));
    }
    for (key, value) in entries {
        if !file.provenance().any(|(known, _)| known == key) {
            writer = writer.provenance(key, value);
        }
    }
    let own = || file.metrics().map(|(metric, value)| (metric.to_owned(), value)).collect();
    let metrics: Vec<(String, f32)> = metrics.map_or_else(own, <[_]>::to_vec);
    for (number, (metric, value)) in metrics.iter().enumerate() {
        let later = metrics.iter().skip(number + 1).any(|(later, _)| later == metric);
        if !later {
            writer = writer.metric(metric, *value);
        }
    }
    for tensor in file.tensors() {
        writer = writer.tensor(tensor.name, tensor.shape, tensor.data);
    }
    let out = writer.finish().map_err(|source| PackError::Write { path: name.into(), source })?;
    let loaded = LoadedModel::copy_of(name, &out)?;
    // Equal checksums prove that no weight has changed on the way.
    if loaded.model().file().payload_crc() != file.payload_crc() {
        let source = SourceProblem::OtherLayout;
        return Err(PackError::Source { path: name.into(), source });
    }
    Ok(out)
}
