//! Why bytes are no model.

use core::fmt;

use crate::ConfigError;

/// A part of a file that has its own checksum.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Section {
    /// The fixed first 64 bytes.
    Prefix,
    /// Name, configuration, provenance, metrics and tensor directory.
    Header,
    /// The tensors.
    Payload,
}

impl fmt::Display for Section {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Section::Prefix => "prefix",
            Section::Header => "header",
            Section::Payload => "payload",
        })
    }
}

/// Why bytes are no model that this crate reads. `tensor` counts from 0 in the order of the file,
/// which is that of names; lengths and offsets are in bytes.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum FormatError {
    /// The file is of another kind.
    #[error(
        "not a RigidFormer model: it starts with the bytes {found:02x?}; pack weights with `rigidformer pack`"
    )]
    NotAModel {
        /// Its first bytes, zeros after its end.
        found: [u8; 8],
    },
    /// The file is of a version that this reader does not know.
    #[error(
        "format version {found}, this reader knows {supported}; update the runtime or its features, or pack again"
    )]
    Version {
        /// Version of the file.
        found: u32,
        /// [`VERSION`](crate::VERSION).
        supported: u32,
    },
    /// A file of a newer version than what it holds needs.
    #[error("an older format version can hold this model; pack it again")]
    NeedlessVersion,
    /// Bytes that version 10 keeps free are not 0.
    #[error(
        "the header's reserved bytes are not 0: a contact law is a scene's, not a model's; pack the model again without it"
    )]
    Reserved,
    /// The bytes start at an address that tensors cannot be read from.
    #[error(
        "the bytes start {remainder} after a 16-byte boundary; embed them with `include_model!`, or put them into \
         `Aligned`, an `AlignedBuffer` or a memory map"
    )]
    Misaligned {
        /// Bytes after the last boundary.
        remainder: u32,
    },
    /// Bytes are missing at the end.
    #[error("{found} bytes of at least {expected}: cut off; copy the file again")]
    Truncated {
        /// Length that the file says it has.
        expected: u64,
        /// Length of the bytes.
        found: u64,
    },
    /// Bytes follow the end.
    #[error("{found} bytes, {expected} expected: something was appended; copy the file again")]
    TrailingBytes {
        /// Length that the file says it has.
        expected: u64,
        /// Length of the bytes.
        found: u64,
    },
    /// A section is damaged.
    #[error(
        "damaged {section}: checksum {found:08x}, {expected:08x} expected; copy the file again"
    )]
    Checksum {
        /// Which section.
        section: Section,
        /// Checksum in the file.
        expected: u32,
        /// Checksum of the bytes.
        found: u32,
    },
    /// Bytes that must be zero are not.
    #[error("padding of the {section} is not zero")]
    Padding {
        /// In or after which section.
        section: Section,
    },
    /// The payload is not where the header ends.
    #[error("payload at {found}, {expected} expected after the header")]
    PayloadOffset {
        /// End of the header, padded.
        expected: u64,
        /// Offset that the prefix gives.
        found: u64,
    },
    /// The header does not decode.
    #[error("the header does not decode at its byte {at}, in `{field}`")]
    Header {
        /// What was expected there.
        field: &'static str,
        /// Offset from the start of the header.
        at: u32,
    },
    /// A name is empty or longer than [`MAX_NAME_BYTES`](crate::MAX_NAME_BYTES), or a text has
    /// control characters.
    #[error("{field} {index}: a name must have 1 to 256 bytes and no control characters")]
    Text {
        /// Which kind of text.
        field: &'static str,
        /// Which one of its kind, from 0.
        index: u32,
    },
    /// The configuration is outside its limits.
    #[error("configuration: {0}")]
    Config(#[from] ConfigError),
    /// A range of what training saw is none.
    #[cfg(feature = "health")]
    #[error(
        "range {index} of what training saw: both ends must be finite and the lower one below the higher; measure the ranges again"
    )]
    Range {
        /// Of which of [`Quantity::ALL`](crate::Quantity::ALL).
        index: u32,
    },
    /// A metric is infinite or not a number.
    #[error("metric {index} is not finite")]
    Metric {
        /// Which one, from 0.
        index: u32,
    },
    /// More tensors than [`MAX_TENSORS`](crate::MAX_TENSORS).
    #[error("{found} tensors; a file has at most {maximum}")]
    TooManyTensors {
        /// Tensors that the file says it has.
        found: u32,
        /// [`MAX_TENSORS`](crate::MAX_TENSORS).
        maximum: u32,
    },
    /// A tensor's name does not come after the one before: unsorted or twice.
    #[error("tensor {tensor}: names must be unique and in ascending order")]
    Order {
        /// The later one of the two.
        tensor: u32,
    },
    /// A tensor has a dimension of zero or too many elements, or is int8 and no matrix.
    #[error("tensor {tensor}: its shape has a zero, is too large, or is no matrix although int8")]
    Shape {
        /// Which tensor.
        tensor: u32,
    },
    /// A tensor's length is not that of its shape and type.
    #[error("tensor {tensor}: {found} bytes, {expected} expected from its shape and type")]
    Size {
        /// Which tensor.
        tensor: u32,
        /// Length by shape and type.
        expected: u64,
        /// Length in the directory.
        found: u64,
    },
    /// A tensor begins inside the one before.
    #[error("tensor {tensor}: begins at {found} of the payload, where data until {free} is taken")]
    Overlap {
        /// Which tensor.
        tensor: u32,
        /// First free offset.
        free: u64,
        /// Its offset.
        found: u64,
    },
    /// A tensor leaves a gap before itself.
    #[error(
        "tensor {tensor}: begins at {found} of the payload, {free} is the next free 64-byte boundary"
    )]
    Gap {
        /// Which tensor.
        tensor: u32,
        /// First free offset.
        free: u64,
        /// Its offset.
        found: u64,
    },
    /// A tensor ends after the payload.
    #[error("tensor {tensor}: ends after the payload of {payload_length} bytes")]
    Beyond {
        /// Which tensor.
        tensor: u32,
        /// Length of the payload.
        payload_length: u64,
    },
    /// The payload continues after the last tensor.
    #[error("payload of {found} bytes; its tensors end at {expected}")]
    Unclaimed {
        /// End of the last tensor, padded.
        expected: u64,
        /// Length of the payload.
        found: u64,
    },
    /// An int8 tensor without an offset of its scales, or another one with it.
    #[error("tensor {tensor}: int8 tensors have scales, others have none")]
    ScalesOffset {
        /// Which tensor.
        tensor: u32,
    },
    /// A weight is infinite or not a number.
    #[error(
        "tensor {tensor}: element {element} is not finite; the training diverged or the export is broken"
    )]
    NotFinite {
        /// Which tensor.
        tensor: u32,
        /// Which element, from 0, row by row.
        element: u64,
    },
    /// Panels whose padding is not zero, or whose sums are not those of their weights.
    #[error("tensor {tensor}: padding or sum of channel {channel} is wrong; pack the model again")]
    Panel {
        /// Which tensor.
        tensor: u32,
        /// Which output channel, from 0; padding may be behind the last.
        channel: u64,
    },
    /// An int8 weight is -128: symmetric quantisation ends at -127.
    #[error("tensor {tensor}: element {element} is -128; symmetric int8 is -127 to 127")]
    Asymmetric {
        /// Which tensor.
        tensor: u32,
        /// Which element, from 0, row by row.
        element: u64,
    },
    /// A scale is zero, negative, infinite or not a number.
    #[error("tensor {tensor}: the scale of channel {channel} is not finite and positive")]
    Scale {
        /// Which tensor.
        tensor: u32,
        /// Which output channel, from 0.
        channel: u64,
    },
}

impl FormatError {
    /// The tensor at fault, by its place in the order of names, where there is one.
    pub fn tensor(&self) -> Option<u32> {
        match *self {
            FormatError::Order { tensor }
            | FormatError::Shape { tensor }
            | FormatError::Size { tensor, .. }
            | FormatError::Overlap { tensor, .. }
            | FormatError::Gap { tensor, .. }
            | FormatError::Beyond { tensor, .. }
            | FormatError::ScalesOffset { tensor }
            | FormatError::NotFinite { tensor, .. }
            | FormatError::Asymmetric { tensor, .. }
            | FormatError::Panel { tensor, .. }
            | FormatError::Scale { tensor, .. } => Some(tensor),
            _ => None,
        }
    }
}
