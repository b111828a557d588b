//! A recording as a file.

use std::collections::HashMap;
use std::path::{Path, PathBuf};

use rigidformer_runtime::files::{FileError, read_whole, write_whole};
use safetensors::{Dtype, SafeTensors};
use serde_json::{Map, Value, json};

use super::{Content, Record, Recording};

// Scene files and exported models are safetensors too, and only this entry tells them apart.
const FORMAT: &str = "rigidformer-trace";
/// Files of version 1 call impacts `other` and lack their width in pooled levels.
// Files of version 1 call impacts `other` and lack their width in pooled levels, so they cannot be
// compared.
const VERSION: &str = "2";

/// A trace file that cannot be read. Its text names the file, the field and the remedy.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum TraceError {
    /// The file cannot be read or written.
    #[error(transparent)]
    File(#[from] FileError),
    /// It is no trace, or a damaged one.
    #[error("{}: {field}: {problem}; give a file made by `rigidformer trace`", .path.display())]
    NotATrace {
        /// The file.
        path: PathBuf,
        /// Metadata entry or tensor at fault.
        field: String,
        /// What is wrong with it.
        problem: String,
    },
}

impl Recording {
    /// Bytes of a trace file; the same recording gives the same bytes.
    pub fn to_bytes(&self) -> Vec<u8> {
        let mut header = Map::new();
        let metadata = json!({
            "format": FORMAT,
            "version": VERSION,
            "model": self.model,
            "scene": self.scene,
            "step": self.step.to_string(),
        });
        header.insert("__metadata__".into(), metadata);
        let mut end = 0;
        let mut position = 0;
        let mut step = 0;
        for record in &self.records {
            if record.step != step {
                (step, position) = (record.step, 0);
            }
            let start = end;
            end += 4 * record.values.len();
            let columns = record.columns.max(1);
            let tensor = json!({
                "dtype": "F32",
                "shape": [record.values.len() / columns, columns],
                "data_offsets": [start, end],
            });
            let name =
                format!("{step:04}/{position:04}/{}/{}", record.content.name(), record.index);
            header.insert(name, tensor);
            position += 1;
        }
        let mut header = Value::Object(header).to_string();
        // Eight bytes align the first tensor, and safetensors allows blanks after the header.
        while !header.len().is_multiple_of(8) {
            header.push(' ');
        }
        let mut bytes = (header.len() as u64).to_le_bytes().to_vec();
        bytes.extend(header.as_bytes());
        let values = self.records.iter().flat_map(|record| &record.values);
        bytes.extend(values.flat_map(|value| value.to_le_bytes()));
        bytes
    }

    /// Reads a trace file that is in memory; errors call it `name`.
    ///
    /// # Errors
    /// [`TraceError::NotATrace`].
    pub fn from_bytes(name: &Path, bytes: &[u8]) -> Result<Self, TraceError> {
        let fail = |field: &str, problem: String| TraceError::NotATrace {
            path: name.into(),
            field: field.into(),
            problem,
        };
        let not_whole = |error| fail("file", format!("is not a whole safetensors file ({error})"));
        let (_, metadata) = SafeTensors::read_metadata(bytes).map_err(not_whole)?;
        let file = SafeTensors::deserialize(bytes).map_err(not_whole)?;
        let nothing = HashMap::new();
        let metadata = metadata.metadata().as_ref().unwrap_or(&nothing);
        let entry = |key: &str| {
            let field = format!("metadata {key}");
            metadata.get(key).cloned().ok_or_else(|| fail(&field, "is missing".into()))
        };
        for (key, expected) in [("format", FORMAT), ("version", VERSION)] {
            let found = entry(key)?;
            if found != expected {
                let field = format!("metadata {key}");
                return Err(fail(&field, format!("is {found:?}, not {expected:?}")));
            }
        }
        let step = entry("step")?;
        let step = step
            .parse()
            .map_err(|_| fail("metadata step", format!("is {step:?}, no step code")))?;

        // Step and position, by which records are sorted: above 9999 names are longer and sort
        // otherwise.
        let mut records: Vec<((u32, usize), Record)> = Vec::new();
        for (tensor, view) in file.tensors() {
            let field = format!("tensor {tensor}");
            let (order, content, index) = parse_name(&tensor)
                .ok_or_else(|| fail(&field, "is not called STEP/POSITION/LAYER/INDEX".into()))?;
            let ([_, columns], Dtype::F32) = (view.shape(), view.dtype()) else {
                return Err(fail(&field, "is no f32 matrix".into()));
            };
            let words = view.data().chunks_exact(4);
            let values = words
                .map(|word| word.try_into().map(f32::from_le_bytes).unwrap_or_default())
                .collect();
            records
                .push((order, Record { step: order.0, content, index, columns: *columns, values }));
        }
        records.sort_by_key(|(order, _)| *order);
        let records = records.into_iter().map(|(_, record)| record).collect();
        Ok(Recording { model: entry("model")?, scene: entry("scene")?, step, records })
    }

    /// Writes a trace file, whole or not at all.
    ///
    /// # Errors
    /// [`TraceError::File`].
    pub fn write(&self, path: &Path) -> Result<(), TraceError> {
        Ok(write_whole(path, &self.to_bytes())?)
    }

    /// Reads a trace file.
    ///
    /// # Errors
    /// [`TraceError`] names the file and what is wrong with it.
    pub fn open(path: &Path) -> Result<Self, TraceError> {
        Self::from_bytes(path, &read_whole(path)?)
    }
}

fn parse_name(name: &str) -> Option<((u32, usize), Content, usize)> {
    let mut words = name.split('/');
    let (step, position) = (words.next()?.parse().ok()?, words.next()?.parse().ok()?);
    let (content, index) = (Content::from_name(words.next()?)?, words.next()?.parse().ok()?);
    // A name with a fifth word is not ours.
    words.next().is_none().then_some(((step, position), content, index))
}
