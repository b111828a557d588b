//! A second, naive writer, from FORMAT.md: it packs what the real one refuses, with checksums that
//! fit.
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic, unreachable_pub)]

use std::ops::Range;

use rigidformer_weights::{AlignedBuffer, FormatError, ModelConfig, ModelFile};
use serde::Serialize;

/// Wire form of a tensor in the directory; `shape` is (rank, sizes).
#[derive(Clone, Debug)]
pub struct Entry {
    pub name: String,
    pub dtype: u8,
    pub shape: Vec<u32>,
    pub offset: u64,
    pub byte_length: u64,
    pub scales_offset: Option<u64>,
}

impl Entry {
    pub fn f32(name: &str, length: u32, offset: u64) -> Self {
        Entry {
            name: name.into(),
            dtype: 0,
            shape: vec![length],
            offset,
            byte_length: u64::from(length) * 4,
            scales_offset: None,
        }
    }

    pub fn i8(name: &str, rows: u32, columns: u32, offset: u64, scales_offset: u64) -> Self {
        Entry {
            name: name.into(),
            dtype: 2,
            shape: vec![rows, columns],
            offset,
            byte_length: u64::from(rows) * u64::from(columns),
            scales_offset: Some(scales_offset),
        }
    }
}

/// A header, piece by piece.
#[derive(Clone, Debug)]
pub struct Header {
    pub name: String,
    pub config: ModelConfig,
    pub provenance: Vec<(String, String)>,
    pub metrics: Vec<(String, f32)>,
    pub entries: Vec<Entry>,
}

impl Header {
    pub fn new(entries: Vec<Entry>) -> Self {
        Header {
            name: "m".into(),
            config: ModelConfig::TINY,
            provenance: vec![],
            metrics: vec![],
            entries,
        }
    }

    pub fn encode(&self) -> Vec<u8> {
        let mut out = wire(&self.name);
        out.extend(wire(&self.config));
        out.extend(varint(self.provenance.len() as u64));
        self.provenance.iter().for_each(|pair| out.extend(wire(pair)));
        out.extend(varint(self.metrics.len() as u64));
        self.metrics.iter().for_each(|pair| out.extend(wire(pair)));
        out.extend(varint(self.entries.len() as u64));
        for entry in &self.entries {
            out.extend(wire(&entry.name));
            out.push(entry.dtype);
            out.push(entry.shape.len() as u8);
            entry.shape.iter().for_each(|&size| out.extend(varint(u64::from(size))));
            out.extend(varint(entry.offset));
            out.extend(varint(entry.byte_length));
            match entry.scales_offset {
                None => out.push(0),
                Some(offset) => {
                    out.push(1);
                    out.extend(varint(offset));
                }
            }
        }
        out
    }
}

/// A file around a header and a payload, with checksums that fit.
pub fn file(header: &[u8], payload: &[u8]) -> Vec<u8> {
    let payload_offset = (64 + header.len()).next_multiple_of(64);
    let mut out = b"RFMODEL\0".to_vec();
    out.extend(1u32.to_le_bytes());
    out.extend((header.len() as u32).to_le_bytes());
    out.extend((payload_offset as u64).to_le_bytes());
    out.extend((payload.len() as u64).to_le_bytes());
    out.extend(crc32(header).to_le_bytes());
    out.extend(crc32(payload).to_le_bytes());
    out.extend([0; 20]);
    out.extend(crc32(&out).to_le_bytes());
    out.extend(header);
    out.resize(payload_offset, 0);
    out.extend(payload);
    out
}

/// Makes all three checksums fit again; `false` where the lengths leave the file.
pub fn repair(file: &mut [u8]) -> bool {
    let Some(lengths) = file.get(12..32) else { return false };
    let header_length = u32::from_le_bytes(lengths[..4].try_into().unwrap()) as usize;
    let payload = u64::from_le_bytes(lengths[4..12].try_into().unwrap()) as usize;
    let sections: [(usize, Range<usize>); 2] =
        [(32, 64..header_length.saturating_add(64)), (36, payload..file.len())];
    for (at, range) in sections {
        let Some(section) = file.get(range) else { return false };
        let crc = crc32(section).to_le_bytes();
        file[at..at + 4].copy_from_slice(&crc);
    }
    let crc = crc32(&file[..60]).to_le_bytes();
    file[60..64].copy_from_slice(&crc);
    true
}

/// Bit by bit, independent of the crate under test.
pub fn crc32(bytes: &[u8]) -> u32 {
    !bytes.iter().fold(!0u32, |crc, &byte| {
        (0..8).fold(crc ^ u32::from(byte), |crc, _| {
            if crc & 1 == 1 { (crc >> 1) ^ 0xedb8_8320 } else { crc >> 1 }
        })
    })
}

/// LEB128, as postcard writes integers.
pub fn varint(mut value: u64) -> Vec<u8> {
    let mut out = Vec::new();
    while value >= 0x80 {
        out.push(value as u8 | 0x80);
        value >>= 7;
    }
    out.push(value as u8);
    out
}

fn wire<T: Serialize>(value: &T) -> Vec<u8> {
    postcard::to_stdvec(value).unwrap()
}

/// Little-endian bytes, padded to the next boundary.
pub fn f32_bytes(values: &[f32]) -> Vec<u8> {
    let mut out: Vec<u8> = values.iter().flat_map(|value| value.to_le_bytes()).collect();
    out.resize(out.len().next_multiple_of(64), 0);
    out
}

/// The error of parsing bytes that are aligned.
pub fn error(bytes: &[u8]) -> FormatError {
    match ModelFile::parse(&AlignedBuffer::copy_of(bytes)) {
        Ok(model) => panic!("accepted: {model:?}"),
        Err(error) => {
            assert!(!error.to_string().is_empty());
            error
        }
    }
}

/// Visits everything that a parsed model lends out.
pub fn visit(model: &ModelFile<'_>) {
    assert_eq!(model.tensors().len(), model.tensors().count());
    for tensor in model.tensors() {
        assert_eq!(tensor.data.len() as u64, tensor.shape.elements());
        assert_eq!(model.tensor(tensor.name), Some(tensor));
    }
    assert_eq!(model.provenance().len(), model.provenance().count());
    assert_eq!(model.metrics().len(), model.metrics().count());
    assert_eq!(model.config().validate(), Ok(()));
}

/// Small numbers that look random (SplitMix64).
pub struct Random(pub u64);

impl Random {
    pub fn below(&mut self, limit: usize) -> usize {
        self.0 = self.0.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let mut z = self.0;
        z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        ((z ^ (z >> 31)) % limit as u64) as usize
    }
}
