//! The fixed part of a file, and the rules for padding: shared by reader and writer (see
//! `FORMAT.md`).

#[cfg(not(feature = "std"))]
use crc::{CRC_32_ISO_HDLC, Crc};

use crate::{FormatError, Section};

/// The first eight bytes of every model file.
pub const MAGIC: [u8; 8] = *b"RFMODEL\0";

/// The newest format version that this crate reads. Without the feature `host` it does not read versions 2 and 8, without
/// `deform` not 6 and 7, without `health` not 9, and without `host` none of version 10 whose network reads near units alone. A file is of the oldest version that can hold it.
pub const VERSION: u32 = 10;

/// The version whose files name the one that their model is of without its ranges.
#[cfg(feature = "health")]
pub(crate) const RANGED: u32 = 9;

/// The version of models with a limit of what they correct.
pub(crate) const RULED: u32 = 10;

/// Bytes that such files keep free.
pub(crate) const RESERVED: [u8; 5] = [0; 5];

/// The version whose header has the fields of one: what sets version 8 apart from 4 is its number.
pub(crate) const fn fields_of(version: u32) -> u32 {
    if cfg!(feature = "host") && version == 8 { 4 } else { version }
}

/// Whether a version up to 8 is one that this build leaves out.
pub(crate) const fn is_left_out(version: u32) -> bool {
    (cfg!(not(feature = "host")) && (version == 2 || version == 8))
        || (cfg!(not(feature = "deform")) && (version == 6 || version == 7))
}

/// Alignment of the payload and of every tensor from the start of the file, in bytes: one cache
/// line.
pub const TENSOR_ALIGNMENT: usize = 64;

/// Alignment in memory that [`ModelFile::parse`](crate::ModelFile::parse) asks of its bytes: one
/// 128-bit register.
pub const SLICE_ALIGNMENT: usize = 16;

/// The most tensors in one file.
pub const MAX_TENSORS: u32 = 4096;

/// The longest name of a model, tensor, metric or provenance key, in bytes of UTF-8.
pub const MAX_NAME_BYTES: usize = 256;

/// Length of [`Prefix`] in a file.
pub(crate) const PREFIX_BYTES: usize = 64;

/// Where the prefix's own checksum stands; it covers all bytes before.
const PREFIX_CRC_AT: usize = 60;

/// One table of 1 KiB: firmware pays for it in flash.
#[cfg(not(feature = "std"))]
static CRC32: Crc<u32> = Crc::<u32>::new(&CRC_32_ISO_HDLC);

/// CRC-32 as in zip and PNG.
#[cfg(not(feature = "std"))]
pub(crate) fn crc32(bytes: &[u8]) -> u32 {
    CRC32.checksum(bytes)
}

/// CRC-32 as in zip and PNG, with the processor's instructions for it.
#[cfg(feature = "std")]
pub(crate) fn crc32(bytes: &[u8]) -> u32 {
    crc32fast::hash(bytes)
}

/// `length` with its zero padding.
pub(crate) fn padded(length: u64) -> Option<u64> {
    length.checked_next_multiple_of(TENSOR_ALIGNMENT as u64)
}

/// The fixed first 64 bytes.
#[derive(Clone, Copy)]
pub(crate) struct Prefix {
    pub(crate) version: u32,
    pub(crate) header_length: u32,
    pub(crate) payload_offset: u64,
    pub(crate) payload_length: u64,
    pub(crate) header_crc: u32,
    pub(crate) payload_crc: u32,
}

impl Prefix {
    /// The prefix as it stands in a file.
    #[cfg(feature = "std")]
    pub(crate) fn encode(&self) -> std::vec::Vec<u8> {
        let mut out = std::vec::Vec::with_capacity(PREFIX_BYTES);
        out.extend_from_slice(&MAGIC);
        out.extend_from_slice(&self.version.to_le_bytes());
        out.extend_from_slice(&self.header_length.to_le_bytes());
        out.extend_from_slice(&self.payload_offset.to_le_bytes());
        out.extend_from_slice(&self.payload_length.to_le_bytes());
        out.extend_from_slice(&self.header_crc.to_le_bytes());
        out.extend_from_slice(&self.payload_crc.to_le_bytes());
        out.resize(PREFIX_CRC_AT, 0);
        let own = crc32(&out);
        out.extend_from_slice(&own.to_le_bytes());
        out
    }

    /// Checks magic, version, checksum and reserved bytes; not yet the lengths.
    pub(crate) fn decode(bytes: &[u8]) -> Result<Self, FormatError> {
        foreign(bytes)?;
        let short =
            FormatError::Truncated { expected: PREFIX_BYTES as u64, found: bytes.len() as u64 };
        let mut rest = bytes;
        take::<8>(&mut rest).ok_or(short)?;
        let version = take(&mut rest).map(u32::from_le_bytes).ok_or(short)?;
        let left_out = is_left_out(version) || (cfg!(not(feature = "health")) && version == 9);
        if !(1..=VERSION).contains(&version) || left_out {
            return Err(FormatError::Version { found: version, supported: VERSION });
        }
        let prefix = bytes.first_chunk::<PREFIX_BYTES>().ok_or(short)?;
        let (covered, mut own) = prefix.split_at_checked(PREFIX_CRC_AT).ok_or(short)?;
        let expected = take(&mut own).map(u32::from_le_bytes).ok_or(short)?;
        verify(Section::Prefix, covered, expected)?;

        let decoded = Prefix {
            version,
            header_length: take(&mut rest).map(u32::from_le_bytes).ok_or(short)?,
            payload_offset: take(&mut rest).map(u64::from_le_bytes).ok_or(short)?,
            payload_length: take(&mut rest).map(u64::from_le_bytes).ok_or(short)?,
            header_crc: take(&mut rest).map(u32::from_le_bytes).ok_or(short)?,
            payload_crc: take(&mut rest).map(u32::from_le_bytes).ok_or(short)?,
        };
        let reserved: [u8; 20] = take(&mut rest).ok_or(short)?;
        if reserved != [0; 20] {
            return Err(FormatError::Padding { section: Section::Prefix });
        }
        Ok(decoded)
    }

    /// Checks lengths and padding; the header and the payload, neither of them verified.
    pub(crate) fn split<'a>(&self, bytes: &'a [u8]) -> Result<(&'a [u8], &'a [u8]), FormatError> {
        let header_end = u64::from(self.header_length).saturating_add(PREFIX_BYTES as u64);
        match padded(header_end) {
            Some(expected) if expected == self.payload_offset => {}
            expected => {
                return Err(FormatError::PayloadOffset {
                    expected: expected.unwrap_or(u64::MAX),
                    found: self.payload_offset,
                });
            }
        }
        let found = bytes.len() as u64;
        let expected = self.payload_offset.saturating_add(self.payload_length);
        if found < expected {
            return Err(FormatError::Truncated { expected, found });
        }
        if found > expected {
            return Err(FormatError::TrailingBytes { expected, found });
        }
        // All three fit into usize now: none exceeds the length of `bytes`.
        let whole = FormatError::Truncated { expected, found };
        let (front, payload) = bytes.split_at_checked(self.payload_offset as usize).ok_or(whole)?;
        let (front, padding) = front.split_at_checked(header_end as usize).ok_or(whole)?;
        let (_, header) = front.split_at_checked(PREFIX_BYTES).ok_or(whole)?;
        if padding.iter().any(|&byte| byte != 0) {
            return Err(FormatError::Padding { section: Section::Header });
        }
        Ok((header, payload))
    }
}

/// Rejects files of other kinds, also those shorter than the magic.
fn foreign(bytes: &[u8]) -> Result<(), FormatError> {
    let start = bytes.get(..MAGIC.len()).unwrap_or(bytes);
    if MAGIC.starts_with(start) {
        return Ok(());
    }
    let mut found = [0; 8];
    for (to, from) in found.iter_mut().zip(start) {
        *to = *from;
    }
    Err(FormatError::NotAModel { found })
}

/// Compares the checksum of a section.
pub(crate) fn verify(section: Section, bytes: &[u8], expected: u32) -> Result<(), FormatError> {
    let found = crc32(bytes);
    if found == expected {
        return Ok(());
    }
    Err(FormatError::Checksum { section, expected, found })
}

/// Removes the first `N` bytes.
fn take<const N: usize>(rest: &mut &[u8]) -> Option<[u8; N]> {
    let (first, after) = rest.split_first_chunk::<N>()?;
    *rest = after;
    Some(*first)
}
