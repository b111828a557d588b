//! Packing models, and saying more about packed ones.

use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicBool, Ordering};

use pyo3::exceptions::PyTypeError;
use pyo3::prelude::*;
use pyo3::types::{PyDict, PyMapping};
use rigidformer_evaluation::health::Seen;
use rigidformer_evaluation::models::{self, PackError, Policy, Precision};
use rigidformer_evaluation::scenes::{Dataset, Split};
use rigidformer_runtime::files::{read_whole, write_whole};
use rigidformer_runtime::models::{LoadedModel, to_panels};
use rigidformer_weights::{AlignedBuffer, MAGIC, Quantity, Ranges, Scope};
use serde_json::{Map, Value, json};

use crate::errors::{OrRaise, input};
use crate::interrupt::{free, shared};
use crate::json::to_python;
use crate::model::precision;

/// Packs a model: the lab's export (``*.safetensors``) or a packed f32 model, into a file that everything here loads. With one of
/// ``provenance``, ``scope`` and ``ranges`` a packed model stays as it is, weights byte for byte, but for what these say. The
/// interpreter is free meanwhile.
///
/// Parameters
/// ----------
/// source, out : str, os.PathLike
///     Read, and written whole or not at all.
/// dtype : str
///     What the weights of linear layers become: "f32", "f16", "i8" or "mixed".
/// wide, narrow : sequence of str
///     Layers to keep at f16, and layers to make int8 all the same, by name.
/// panels : bool
///     Lays int8 matrices out as hosts multiply them: loading lays out nothing; microcontrollers cannot read it.
/// provenance : mapping of str to str, optional
///     Where the model comes from, at least one entry; an entry replaces one of the same key.
/// scope : str, optional
///     Which units of a scene its network sees: "all", or those that it corrects and those that may touch one of them within the
///     step, "near"; of models that move by impulses alone.
/// ranges : sequence of str, os.PathLike, optional
///     Scene files, whose splits train and extra say what training saw; or one packed model, whose ranges are taken over.
///
/// Returns
/// -------
/// dict
///     As ``rigidformer pack --json``: layers, parameters, bytes, bytes_per_parameter; with one of the last three bytes,
///     payload_crc, and what the file says now.
///
/// Raises
/// ------
/// FileError
///     A file cannot be read or written.
/// InputError, TypeError
///     The source is no such model, is quantised already, or lacks a named layer; something else cannot be said, or not
///     together; nothing was written.
/// KeyboardInterrupt
///     Ctrl-C, between scenes of ``ranges``; nothing was written.
///
/// Source: ``evaluation/src/models/pack.rs``, ``evaluation/src/models/provenance.rs``, ``evaluation/src/health.rs``.
#[pyfunction]
#[pyo3(signature = (source, out, *, dtype = "f32", wide = Vec::new(), narrow = Vec::new(), panels = false, provenance = None, scope = None, ranges = None))]
#[expect(clippy::too_many_arguments, reason = "Python's are named")]
pub(crate) fn pack<'py>(
    py: Python<'py>,
    source: PathBuf,
    out: PathBuf,
    dtype: &str,
    wide: Vec<String>,
    narrow: Vec<String>,
    panels: bool,
    provenance: Option<Bound<'py, PyMapping>>,
    scope: Option<&str>,
    ranges: Option<Vec<PathBuf>>,
) -> PyResult<Bound<'py, PyAny>> {
    let policy = Policy { precision: precision(dtype)?, wide, narrow };
    let given = [
        ("provenance", provenance.is_some()),
        ("scope", scope.is_some()),
        ("ranges", ranges.is_some()),
        ("dtype", policy.precision != Precision::F32),
        ("wide", !policy.wide.is_empty()),
        ("narrow", !policy.narrow.is_empty()),
        ("panels", panels),
    ];
    // Any second option contradicts the first three, which keep the weights byte for byte.
    let mut given = given.into_iter().filter_map(|(name, is_given)| is_given.then_some(name));
    let more =
        provenance.map(|entries| self::entries(&entries)).transpose()?.map(Metadata::Entries);
    let more = more.or(scope.map(self::scope).transpose()?.map(Metadata::Scope));
    let document = match more.or(ranges.map(Metadata::Ranges)) {
        None => free(py, || packed(&source, &out, &policy, panels))?,
        Some(more) => match (given.next(), given.next()) {
            (Some(one), Some(other)) => {
                Err(input(format!("{one} cannot be used with {other}; give one of them")))
            }
            // Measuring ranges reads whole sets of scenes, so Ctrl-C must end it.
            _ => shared(py, |cancelled| rewritten(&source, &out, &more, cancelled))?,
        },
    };
    to_python(py, &document?)
}

fn packed(source: &Path, out: &Path, policy: &Policy, panels: bool) -> PyResult<Value> {
    let mut packed = models::packed(source, policy).or_raise()?;
    if panels {
        // Panels last: reports and quantisation know rows.
        packed.file = to_panels(source, &AlignedBuffer::copy_of(&packed.file)).or_raise()?;
    }
    write_whole(out, &packed.file).or_raise()?;
    let mut document = serde_json::to_value(&packed).or_raise()?;
    if let Some(object) = document.as_object_mut() {
        object.insert("bytes".into(), json!(packed.file.len()));
        object.insert("bytes_per_parameter".into(), json!(packed.bytes_per_parameter()));
    }
    Ok(document)
}

/// What a packed model is to say beside its tensors.
enum Metadata {
    Entries(Vec<(String, String)>),
    Scope(Scope),
    Ranges(Vec<PathBuf>),
}

impl Metadata {
    /// As the program calls it.
    fn option(&self) -> &'static str {
        match self {
            Metadata::Entries(_) => "provenance",
            Metadata::Scope(_) => "scope",
            Metadata::Ranges(_) => "ranges",
        }
    }
}

/// Writes a packed model that says more. What the program says of it.
fn rewritten(
    source: &Path,
    out: &Path,
    more: &Metadata,
    cancelled: &AtomicBool,
) -> PyResult<Value> {
    let packed = read_whole(source).or_raise()?;
    // An export has no header to say more in.
    if !packed.starts_with(&MAGIC) {
        return Err(input(format!(
            "{}: is no packed model; pack it first, without {}",
            source.display(),
            more.option()
        )));
    }
    let write = |file: Result<Vec<u8>, PackError>| {
        let file = file.or_raise()?;
        write_whole(out, &file).or_raise()?;
        // Read back from what is written, so that the answer is what the file says.
        Ok::<_, PyErr>((LoadedModel::copy_of(out, &file).or_raise()?, file.len()))
    };
    let ((loaded, bytes), said) = match more {
        Metadata::Entries(entries) => {
            let written = write(models::with_provenance(source, &packed, entries))?;
            let said: Map<_, _> = written
                .0
                .model()
                .file()
                .provenance()
                .map(|(key, value)| (key.to_owned(), json!(value)))
                .collect();
            (written, vec![("provenance", json!(said))])
        }
        Metadata::Scope(scope) => {
            let written = write(models::with_scope(source, &packed, *scope))?;
            (written, vec![("scope", json!(if scope.is_near() { "near" } else { "all" }))])
        }
        Metadata::Ranges(paths) => {
            let before = LoadedModel::copy_of(source, &packed).or_raise()?;
            let (ranges, from) = measured(paths, &before, cancelled)?;
            let written = write(models::with_ranges(source, &packed, &ranges))?;
            let of = Quantity::ALL.iter().zip(ranges.of);
            let of: Map<_, _> =
                of.map(|(quantity, range)| (quantity.name().to_owned(), json!(range))).collect();
            (written, vec![("from", json!(from)), ("ranges", json!(of))])
        }
    };
    let payload = loaded.model().file().payload_crc();
    let first = [("bytes", json!(bytes)), ("payload_crc", json!(format!("{payload:08x}")))];
    let entries = first.into_iter().chain(said).map(|(key, value)| (key.to_owned(), value));
    Ok(Value::Object(entries.collect()))
}

/// What training saw: as a packed model says, or as scenes are. And where that is from.
fn measured(
    paths: &[PathBuf],
    loaded: &LoadedModel,
    cancelled: &AtomicBool,
) -> PyResult<(Ranges, String)> {
    let mut seen = Seen::default();
    for path in paths {
        let shown = path.display();
        // The contents tell the two kinds apart, and names of files need not.
        if read_whole(path).or_raise()?.starts_with(&MAGIC) {
            // Ranges of a model and of scenes cannot be joined: percentiles need all values.
            if paths.len() > 1 {
                return Err(input(format!(
                    "ranges: {shown} is a model, whose ranges are taken over; give it alone, or scene files alone"
                )));
            }
            let other = LoadedModel::open(path).or_raise()?;
            let ranges = other.model().file().ranges().copied();
            let ranges = ranges.ok_or_else(|| {
                input(format!("{shown}: does not say what its training saw; give scene files"))
            })?;
            return Ok((ranges, format!("ranges of {shown}")));
        }
        let dataset = Dataset::open(path).or_raise()?;
        let mut scenes = Vec::new();
        // Models must not know the other splits, and neither must their ranges.
        for split in [Split::Train, Split::Extra] {
            for index in dataset.scenes_of(split) {
                // The exception of the interrupt takes this one's place.
                if cancelled.load(Ordering::Relaxed) {
                    return Err(input("cancelled"));
                }
                scenes.push(dataset.scene(index, None).or_raise()?);
            }
        }
        if scenes.is_empty() {
            return Err(input(format!(
                "{shown}: scene_split: no scene is in the splits train and extra; give scenes that the model learnt from"
            )));
        }
        seen.look(loaded, &scenes).or_raise()?;
    }
    let ranges = seen.ranges().ok_or_else(|| {
        input("ranges: the scenes have no free units at frame 15; give longer ones")
    })?;
    Ok((ranges, format!("ranges of {} looks at a unit", seen.len())))
}

/// Texts, in their order.
fn entries(entries: &Bound<'_, PyMapping>) -> PyResult<Vec<(String, String)>> {
    let example = r#"give texts such as {"run 1": "seeds 1-1200, 92 min"}"#;
    // Nothing to say is a mistake in the call.
    if entries.is_empty()? {
        return Err(input(format!("provenance: has no entries; {example}")));
    }
    let text = |value: &Bound<'_, PyAny>, what: &str| {
        value.extract::<String>().map_err(|_| match value.get_type().name() {
            Ok(kind) => {
                PyTypeError::new_err(format!("{what}: is of type {kind}, not a text; {example}"))
            }
            Err(error) => error,
        })
    };
    // Mappings have views of their own kinds, and a dictionary has one.
    let copy = PyDict::new(entries.py());
    copy.update(entries)?;
    let texts = copy.iter().map(|(key, value)| {
        let key = text(&key, "provenance: a key")?;
        let value = text(&value, &format!("provenance: {key}"))?;
        Ok((key, value))
    });
    texts.collect()
}

/// Which units a network sees, by name.
fn scope(name: &str) -> PyResult<Scope> {
    match name {
        "all" => Ok(Scope::All),
        "near" => Ok(Scope::Near),
        _ => Err(input(format!("there is no scope {name:?}; give all or near"))),
    }
}
