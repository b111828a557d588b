//! What training saw: version 9 of the format.
#![allow(clippy::unwrap_used, clippy::panic, unreachable_pub)]

use crate::common::{error, repair, visit};
use rigidformer_weights::{
    AlignedBuffer, FeatureSet, FormatError, Hidden, ModelConfig, ModelFile, ModelWriter, Motion,
    Quantity, Ranges, Scope, Shape, Similarity, TensorData, WriteError,
};

/// As long as all versions from 1 to 8 have fields behind the configuration.
const CONFIGS: [ModelConfig; 5] = [
    ModelConfig::TINY,
    ModelConfig { hidden: Hidden { point: [3, 0], fuse: 2 }, ..ModelConfig::TINY },
    ModelConfig {
        similarity: Similarity { length_m: 0.5, longest_step: 10.0 },
        ..ModelConfig::TINY
    },
    ModelConfig { features: FeatureSet::Impact, motion: Motion::Impulses, ..ModelConfig::TINY },
    ModelConfig {
        features: FeatureSet::Impact,
        motion: Motion::Impulses,
        scope: Scope::Near,
        ..ModelConfig::TINY
    },
];

fn ranges() -> Ranges {
    let mut ranges = Ranges { of: [[0.0, 1.0]; Quantity::COUNT] };
    for (number, range) in ranges.of.iter_mut().enumerate() {
        *range = [number as f32 - 0.5, number as f32 + 2.0];
    }
    ranges
}

fn packed(config: ModelConfig, ranges: Option<Ranges>) -> Vec<u8> {
    let weights = [1.0, 2.0];
    let writer = ModelWriter::new("ranged", config).provenance("key", "value").ranges(ranges);
    writer.tensor("t", Shape::Vector(2), TensorData::F32(&weights)).finish().unwrap()
}

/// Where the ranges begin in a file.
fn place(bytes: &[u8]) -> usize {
    let first: Vec<u8> = ranges().of[..2].iter().flatten().flat_map(|v| v.to_le_bytes()).collect();
    bytes.windows(first.len()).position(|window| window == first).unwrap()
}

#[test]
fn ranges_come_back_and_change_nothing_else() {
    for config in CONFIGS {
        let (plain, ranged) = (packed(config, None), packed(config, Some(ranges())));
        assert_eq!(ranged[8], 9);
        assert!(plain[8] < 9);
        let (plain, ranged) = (AlignedBuffer::copy_of(&plain), AlignedBuffer::copy_of(&ranged));
        let (plain, ranged) =
            (ModelFile::parse(&plain).unwrap(), ModelFile::parse(&ranged).unwrap());
        visit(&ranged);
        assert_eq!((plain.ranges(), ranged.ranges()), (None, Some(&ranges())));
        assert_eq!((plain.config(), plain.payload_crc()), (ranged.config(), ranged.payload_crc()));
        assert!(plain.tensors().eq(ranged.tensors()));
        assert!(plain.provenance().eq(ranged.provenance()));
    }
}

#[test]
fn hostile_ranges_are_refused() {
    let bytes = packed(ModelConfig::TINY, Some(ranges()));
    let start = place(&bytes);
    for (number, quantity) in Quantity::ALL.iter().enumerate() {
        for [low, high] in [
            [f32::NAN, 1.0],
            [0.0, f32::NAN],
            [f32::NEG_INFINITY, 1.0],
            [0.0, f32::INFINITY],
            [1.0, 1.0],
            [2.0, 1.0],
            [-f32::MAX, f32::MAX],
        ] {
            let mut hostile = bytes.clone();
            let at = start + 8 * number;
            hostile[at..at + 4].copy_from_slice(&low.to_le_bytes());
            hostile[at + 4..at + 8].copy_from_slice(&high.to_le_bytes());
            assert!(repair(&mut hostile));
            assert_eq!(error(&hostile), FormatError::Range { index: number as u32 });
            let mut bad = ranges();
            bad.of[*quantity as usize] = [low, high];
            let writer = ModelWriter::new("x", ModelConfig::TINY).ranges(Some(bad));
            assert!(matches!(
                writer.finish(),
                Err(WriteError::Format(FormatError::Range { index })) if index == number as u32
            ));
        }
    }
}

#[test]
fn the_version_without_ranges_is_one_that_the_model_needs() {
    let bytes = packed(ModelConfig::TINY, Some(ranges()));
    // Right before the ranges, as version 1 has no more fields.
    let at = place(&bytes) - 1;
    assert_eq!(bytes[at], 1);
    for version in [0, 9, 11, 127] {
        let mut hostile = bytes.clone();
        hostile[at] = version;
        assert!(repair(&mut hostile));
        let found = u32::from(version);
        assert_eq!(error(&hostile), FormatError::Version { found, supported: 10 });
    }
    // Such a model needs no other version; its fields are not there either.
    for version in (2..9).chain([10]) {
        let mut hostile = bytes.clone();
        hostile[at] = version;
        assert!(repair(&mut hostile));
        error(&hostile);
    }
    // An older file with ranges, and one of version 9 without.
    let mut older = bytes.clone();
    older[8] = 1;
    assert!(repair(&mut older));
    error(&older);
    let mut bare = packed(ModelConfig::TINY, None);
    bare[8] = 9;
    assert!(repair(&mut bare));
    error(&bare);
}

#[test]
fn cut_and_changed_files_are_refused() {
    let bytes = packed(CONFIGS[4], Some(ranges()));
    for length in 0..bytes.len() {
        error(&bytes[..length]);
    }
    // Whatever stands in the header, with a checksum that fits: refused or read, without a panic.
    for at in 64..place(&bytes) + 8 * Quantity::COUNT {
        for value in [0, 1, 9, 0x7f, 0x80, 0xff] {
            let mut changed = bytes.clone();
            changed[at] = value;
            assert!(repair(&mut changed));
            if let Ok(model) = ModelFile::parse(&AlignedBuffer::copy_of(&changed)) {
                visit(&model);
            }
        }
    }
}
