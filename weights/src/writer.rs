//! Packing models. Nothing here is checked twice: the writer lays out, the reader judges.

use std::borrow::ToOwned;
use std::collections::BTreeMap;
use std::string::String;
use std::vec::Vec;

use crate::header::Entry;
use crate::layout::{PREFIX_BYTES, Prefix, RANGED, RESERVED, RULED, crc32, fields_of};
use crate::{
    AlignedBuffer, ConfigError, DType, FormatError, ModelConfig, ModelFile, Ranges, Shape,
    TENSOR_ALIGNMENT, TensorData,
};

/// Why a model cannot be packed.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum WriteError {
    /// The configuration is outside its limits.
    #[error("configuration: {0}")]
    Config(#[from] ConfigError),
    /// Two tensors have the same name.
    #[error("tensor `{name}` was added twice")]
    Duplicate {
        /// The name.
        name: String,
    },
    /// A tensor breaks a rule of the format.
    #[error("`{name}`: {error}")]
    Tensor {
        /// The tensor.
        name: String,
        /// The rule.
        error: FormatError,
    },
    /// Something else breaks a rule of the format.
    #[error(transparent)]
    Format(FormatError),
    /// The header does not encode: longer than 4 GiB.
    #[error("the header is too long")]
    Header,
}

/// Packs a model; the order of calls to [`tensor`](Self::tensor) does not change the bytes.
///
/// ```
/// use rigidformer_weights::{ModelConfig, ModelWriter, Shape, TensorData};
///
/// # fn main() -> Result<(), rigidformer_weights::WriteError> {
/// let bias = [0.5, -0.5];
/// let bytes = ModelWriter::new("example", ModelConfig::TINY)
///     .provenance("commit", "0123abc")
///     .metric("loss", 0.1)
///     .tensor("head.bias", Shape::Vector(2), TensorData::F32(&bias))
///     .tensor(
///         "head.weight",
///         Shape::Matrix { rows: 2, columns: 1 },
///         TensorData::I8 { values: &[-127, 64], scales: &[0.01, 0.02] },
///     )
///     .finish()?;
/// assert_eq!(bytes.len() % 64, 0);
/// # Ok(())
/// # }
/// ```
#[derive(Clone, Debug)]
#[must_use = "a writer does nothing until `finish`"]
pub struct ModelWriter<'a> {
    name: String,
    config: ModelConfig,
    ranges: Option<Ranges>,
    provenance: Vec<(String, String)>,
    metrics: Vec<(String, f32)>,
    tensors: BTreeMap<String, (Shape, TensorData<'a>)>,
    duplicate: Option<String>,
}

impl<'a> ModelWriter<'a> {
    /// A model without tensors.
    pub fn new(name: &str, config: ModelConfig) -> Self {
        ModelWriter {
            name: name.to_owned(),
            config,
            ranges: None,
            provenance: Vec::new(),
            metrics: Vec::new(),
            tensors: BTreeMap::new(),
            duplicate: None,
        }
    }

    /// Says what training saw, or that nobody knows. The file is of version 9 then.
    pub fn ranges(mut self, ranges: Option<Ranges>) -> Self {
        self.ranges = ranges;
        self
    }

    /// Adds where the model comes from, such as a commit, a data set or a seed.
    pub fn provenance(mut self, key: &str, value: &str) -> Self {
        self.provenance.push((key.to_owned(), value.to_owned()));
        self
    }

    /// Adds a measurement; the name carries its unit.
    pub fn metric(mut self, name: &str, value: f32) -> Self {
        self.metrics.push((name.to_owned(), value));
        self
    }

    /// Adds a tensor.
    pub fn tensor(mut self, name: &str, shape: Shape, data: TensorData<'a>) -> Self {
        if self.tensors.insert(name.to_owned(), (shape, data)).is_some() {
            self.duplicate.get_or_insert_with(|| name.to_owned());
        }
        self
    }

    /// The bytes of the file. They have been parsed: [`ModelFile::parse`] accepts them.
    ///
    /// # Errors
    /// The first rule of the format that the model breaks, with the tensor's name.
    pub fn finish(self) -> Result<Vec<u8>, WriteError> {
        self.config.validate()?;
        if let Some(name) = self.duplicate {
            return Err(WriteError::Duplicate { name });
        }
        let mut payload = Vec::new();
        let mut entries = Vec::with_capacity(self.tensors.len());
        for (name, (shape, data)) in &self.tensors {
            entries.push(place(&mut payload, name, *shape, *data));
        }
        let header = self.encode_header(&entries).map_err(|_| WriteError::Header)?;
        let header_length = u32::try_from(header.len()).map_err(|_| WriteError::Header)?;
        let front = PREFIX_BYTES.saturating_add(header.len()).next_multiple_of(TENSOR_ALIGNMENT);
        let prefix = Prefix {
            version: if self.ranges.is_some() { RANGED } else { self.version() },
            header_length,
            payload_offset: front as u64,
            payload_length: payload.len() as u64,
            header_crc: crc32(&header),
            payload_crc: crc32(&payload),
        };
        let mut out = prefix.encode();
        out.reserve_exact(front.saturating_add(payload.len()).saturating_sub(out.len()));
        out.extend_from_slice(&header);
        out.resize(front, 0);
        out.extend_from_slice(&payload);
        drop(payload);
        self.judge(&out)?;
        Ok(out)
    }

    /// The oldest that holds the model without its ranges.
    fn version(&self) -> u32 {
        let mut tensors = self.tensors.values();
        let panels = tensors.any(|(_, data)| data.dtype() == DType::Panels);
        self.config.version(panels)
    }

    fn encode_header(&self, entries: &[Entry<'_>]) -> postcard::Result<Vec<u8>> {
        let mut out = postcard::to_stdvec(&(&self.name, self.config))?;
        if self.ranges.is_some() {
            out = postcard::to_extend(&self.version(), out)?;
        }
        let version = fields_of(self.version());
        if version > 1 {
            out = postcard::to_extend(&self.config.hidden, out)?;
        }
        if version > 2 {
            out = postcard::to_extend(&self.config.similarity, out)?;
        }
        if version == RULED {
            let ModelConfig { scope, most_units, .. } = self.config;
            out = postcard::to_extend(&(scope.is_near(), RESERVED, most_units), out)?;
        } else {
            out = self.more_fields(version, out)?;
        }
        if let Some(ranges) = &self.ranges {
            out = postcard::to_extend(ranges, out)?;
        }
        out = counted(out, &self.provenance)?;
        out = counted(out, &self.metrics)?;
        counted(out, entries)
    }

    /// Appends what versions 5 to 8 add.
    fn more_fields(&self, version: u32, mut out: Vec<u8>) -> postcard::Result<Vec<u8>> {
        if version > 4 {
            out = postcard::to_extend(&self.config.directions, out)?;
        }
        if version > 5 {
            out = postcard::to_extend(&self.config.elastic, out)?;
        }
        if version > 6 {
            out = postcard::to_extend(&self.config.bonds, out)?;
        }
        Ok(out)
    }

    /// The reader's word on the result, with names.
    fn judge(&self, bytes: &[u8]) -> Result<(), WriteError> {
        let Err(error) = ModelFile::parse(&AlignedBuffer::copy_of(bytes)) else {
            return Ok(());
        };
        let name = error.tensor().and_then(|tensor| self.tensors.keys().nth(tensor as usize));
        Err(match name {
            Some(name) => WriteError::Tensor { name: name.clone(), error },
            None => WriteError::Format(error),
        })
    }
}

/// Appends a count and the items.
fn counted<T: serde::Serialize>(out: Vec<u8>, items: &[T]) -> postcard::Result<Vec<u8>> {
    let count =
        u32::try_from(items.len()).map_err(|_| postcard::Error::SerializeSeqLengthUnknown)?;
    let mut out = postcard::to_extend(&count, out)?;
    for item in items {
        out = postcard::to_extend(item, out)?;
    }
    Ok(out)
}

/// Appends a tensor's elements to the payload.
fn place<'n>(
    payload: &mut Vec<u8>,
    name: &'n str,
    shape: Shape,
    data: TensorData<'_>,
) -> Entry<'n> {
    let (values, scales): (&[u8], Option<&[f32]>) = match data {
        TensorData::F32(values) => (bytemuck::cast_slice(values), None),
        TensorData::F16(values) => (bytemuck::cast_slice(values), None),
        TensorData::I8 { values, scales } => (bytemuck::cast_slice(values), Some(scales)),
        TensorData::Panels(panels) => (bytemuck::cast_slice(panels.values), Some(panels.scales)),
    };
    let offset = append(payload, values);
    let scales_offset = scales.map(|scales| append(payload, bytemuck::cast_slice(scales)));
    if let TensorData::Panels(panels) = data {
        append(payload, bytemuck::cast_slice(panels.sums));
    }
    Entry {
        name,
        dtype: data.dtype(),
        shape,
        offset,
        byte_length: values.len() as u64,
        scales_offset,
    }
}

/// Appends bytes and their padding; where they begin.
fn append(payload: &mut Vec<u8>, bytes: &[u8]) -> u64 {
    let offset = payload.len() as u64;
    payload.extend_from_slice(bytes);
    payload.resize(payload.len().next_multiple_of(TENSOR_ALIGNMENT), 0);
    offset
}
