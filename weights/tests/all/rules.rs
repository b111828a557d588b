//! Version 10 of the format: the most units that a model corrects.
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic, unreachable_pub)]

use crate::common::{error, repair};
use rigidformer_weights::{
    AlignedBuffer, FeatureSet, FormatError, ModelConfig, ModelFile, ModelWriter, Motion, Ranges,
    Scope,
};

const IMPULSES: ModelConfig =
    ModelConfig { features: FeatureSet::Impact, motion: Motion::Impulses, ..ModelConfig::TINY };

fn packed(config: ModelConfig) -> Vec<u8> {
    ModelWriter::new("x", config).finish().unwrap()
}

#[test]
fn everything_comes_back() {
    for (most_units, scope) in [(32, Scope::Near), (1, Scope::All), (u32::MAX, Scope::All)] {
        let config = ModelConfig { most_units, scope, ..IMPULSES };
        let bytes = packed(config);
        assert_eq!(bytes[8], 10);
        assert_eq!(*ModelFile::parse(&AlignedBuffer::copy_of(&bytes)).unwrap().config(), config);
        let ranges = Some(Ranges { of: [[0.0, 1.0]; 14] });
        let ranged = ModelWriter::new("x", config).ranges(ranges).finish().unwrap();
        assert_eq!(ranged[8], 9);
        let ranged = AlignedBuffer::copy_of(&ranged);
        assert_eq!(*ModelFile::parse(&ranged).unwrap().config(), config);
    }
    assert_eq!(packed(IMPULSES)[8], 4);
}

#[test]
fn rules_go_with_impulses() {
    for config in [
        ModelConfig { most_units: 3, ..ModelConfig::TINY },
        ModelConfig { most_units: 3, bonds: 8, ..IMPULSES },
    ] {
        let error = ModelWriter::new("x", config).finish().unwrap_err().to_string();
        assert!(error.contains("`most_units` goes with `motion` Impulses"), "{error}");
    }
}

/// The same file with other reserved bytes and another number of units, which no writer would write.
fn with(reserved: [u8; 5], most_units: u8) -> Vec<u8> {
    let mut bytes = packed(ModelConfig { most_units: 5, ..IMPULSES });
    // Before three counts of zero.
    let end = 64 + u32::from_le_bytes(bytes[12..16].try_into().unwrap()) as usize - 3;
    assert_eq!(bytes[end - 6..end], [0, 0, 0, 0, 0, 5]);
    bytes[end - 6..end - 1].copy_from_slice(&reserved);
    bytes[end - 1] = most_units;
    assert!(repair(&mut bytes));
    bytes
}

/// Models had a contact law there, which scenes have now.
#[test]
fn reserved_bytes_are_0() {
    for number in [0.03, -0.0, f32::NAN, f32::MIN_POSITIVE / 2.0] {
        let [a, b, c, d] = f32::to_le_bytes(number);
        let error = error(&with([a, b, c, d, 0], 5));
        assert_eq!(error, FormatError::Reserved);
        assert!(error.to_string().contains("reserved bytes are not 0"), "{error}");
    }
    assert_eq!(error(&with([0, 0, 0, 0, 1], 5)), FormatError::Reserved);
    // What an older version holds is of that.
    assert_eq!(error(&with([0; 5], 0)), FormatError::NeedlessVersion);
}
