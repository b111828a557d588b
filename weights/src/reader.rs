//! Reading a model file in place.

use crate::header::{Entry, Header};
use crate::layout::{Prefix, verify};
use crate::{
    DType, FormatError, ModelConfig, SLICE_ALIGNMENT, Section, Tensor, TensorData, directory,
};

/// A checked model file; everything it returns borrows from the bytes it was parsed from.
///
/// ```
/// use rigidformer_weights::{ModelFile, include_model};
///
/// # fn main() -> Result<(), rigidformer_weights::FormatError> {
/// let model = ModelFile::parse(include_model!("../tests/data/tiny.rfm"))?;
/// for tensor in model.tensors() {
///     println!("{} {} {}", tensor.name, tensor.shape, tensor.data.dtype());
/// }
/// for (name, value) in model.metrics() {
///     println!("{name} {value}");
/// }
/// # Ok(())
/// # }
/// ```
#[derive(Clone, Copy, Debug)]
pub struct ModelFile<'a> {
    header: Header<'a>,
    payload: &'a [u8],
    payload_crc: u32,
    parameters: u64,
}

/// That bytes at some address were found to be a whole model, for reading them again without
/// looking at every tensor.
#[cfg(feature = "host")]
#[derive(Clone, Copy, Debug)]
pub struct Checked {
    address: usize,
    length: usize,
    payload_crc: u32,
    parameters: u64,
}

impl<'a> ModelFile<'a> {
    /// As [`parse`](Self::parse), without the time, where `checked` is of the same bytes; else the
    /// same. They must not have changed since.
    ///
    /// # Errors
    /// As [`parse`](Self::parse).
    #[cfg(feature = "host")]
    pub fn parse_again(bytes: &'a [u8], checked: &Checked) -> Result<Self, FormatError> {
        let prefix = Prefix::decode(bytes)?;
        let here = (bytes.as_ptr().addr(), bytes.len(), prefix.payload_crc);
        if here != (checked.address, checked.length, checked.payload_crc) {
            return Self::parse(bytes);
        }
        let (header, payload) = prefix.split(bytes)?;
        let header = Header::decode(header, prefix.version)?;
        let Prefix { payload_crc, .. } = prefix;
        Ok(ModelFile { header, payload, payload_crc, parameters: checked.parameters })
    }

    /// For [`parse_again`](Self::parse_again) of the same bytes.
    #[cfg(feature = "host")]
    pub fn checked(&self, bytes: &'a [u8]) -> Checked {
        Checked {
            address: bytes.as_ptr().addr(),
            length: bytes.len(),
            payload_crc: self.payload_crc,
            parameters: self.parameters,
        }
    }

    /// Checks a whole file; after this, nothing about it can fail.
    ///
    /// The bytes must start at a 16-byte boundary. Time is linear in their length, and nothing is
    /// allocated.
    ///
    /// # Errors
    /// The first fault found. All fields of the file are taken as hostile, also where checksums
    /// fit.
    pub fn parse(bytes: &'a [u8]) -> Result<Self, FormatError> {
        let prefix = Prefix::decode(bytes)?;
        let remainder = bytes.as_ptr().addr() % SLICE_ALIGNMENT;
        if remainder != 0 {
            return Err(FormatError::Misaligned { remainder: remainder as u32 });
        }
        let (header, payload) = prefix.split(bytes)?;
        verify(Section::Header, header, prefix.header_crc)?;
        verify(Section::Payload, payload, prefix.payload_crc)?;
        let header = Header::decode(header, prefix.version)?;
        let panels =
            cfg!(feature = "host") && { header.tensors }.any(|entry| entry.dtype == DType::Panels);
        let needed = header.config.version(panels);
        #[cfg(feature = "health")]
        let found = header.version;
        #[cfg(not(feature = "health"))]
        let found = prefix.version;
        if needed < found {
            return Err(FormatError::NeedlessVersion);
        }
        if needed > found {
            return Err(FormatError::Version { found, supported: needed });
        }
        let parameters = directory::check(header.tensors, payload)?;
        Ok(ModelFile { header, payload, payload_crc: prefix.payload_crc, parameters })
    }

    /// The model's name, for people.
    pub fn name(&self) -> &'a str {
        self.header.name
    }

    /// Sizes and physics, within their limits.
    pub fn config(&self) -> &ModelConfig {
        &self.header.config
    }

    /// What training saw, where the file says so: of version 9 of the format.
    #[cfg(feature = "health")]
    pub fn ranges(&self) -> Option<&crate::Ranges> {
        self.header.ranges.as_ref()
    }

    /// Where the model comes from: (key, value), in the order in which they were written.
    pub fn provenance(
        &self,
    ) -> impl ExactSizeIterator<Item = (&'a str, &'a str)> + Clone + use<'a> {
        self.header.provenance
    }

    /// What was measured in training: (name with its unit, value), in the order in which they were
    /// written.
    pub fn metrics(&self) -> impl ExactSizeIterator<Item = (&'a str, f32)> + Clone + use<'a> {
        self.header.metrics
    }

    /// All tensors, by ascending name.
    pub fn tensors(&self) -> impl ExactSizeIterator<Item = Tensor<'a>> + Clone + use<'a> {
        let payload = self.payload;
        self.header.tensors.map(move |entry| view(entry, payload))
    }

    /// The tensor of that name. Searches the directory from its start: look up once, then keep the
    /// view.
    pub fn tensor(&self, name: &str) -> Option<Tensor<'a>> {
        let mut entries = self.header.tensors;
        entries.find(|entry| entry.name == name).map(|entry| view(entry, self.payload))
    }

    /// Elements of all tensors, scales of int8 tensors not counted.
    pub fn parameters(&self) -> u64 {
        self.parameters
    }

    /// CRC-32 of all tensors: the identity of the weights, whatever the name says.
    pub fn payload_crc(&self) -> u32 {
        self.payload_crc
    }
}

fn view<'a>(entry: Entry<'a>, payload: &'a [u8]) -> Tensor<'a> {
    // `directory::check` has taken the same slice already.
    let data = entry.data(payload).unwrap_or(TensorData::F32(&[]));
    Tensor { name: entry.name, shape: entry.shape, data }
}
