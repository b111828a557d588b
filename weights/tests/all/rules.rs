//! Version 10 of the format: a contact law, and the most units that a model corrects.
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic, unreachable_pub)]

use crate::common::{error, repair};
use rigidformer_weights::{
    AlignedBuffer, ContactLaw, FeatureSet, FormatError, FrictionLimit, ModelConfig, ModelFile,
    ModelWriter, Motion, Ranges, Scope,
};

const LAW: ContactLaw = ContactLaw { restitution_offset: 0.25, friction: FrictionLimit::Pyramid };
const IMPULSES: ModelConfig =
    ModelConfig { features: FeatureSet::Impact, motion: Motion::Impulses, ..ModelConfig::TINY };

fn packed(config: ModelConfig) -> Vec<u8> {
    ModelWriter::new("x", config).finish().unwrap()
}

#[test]
fn everything_comes_back() {
    let offset = ContactLaw { friction: FrictionLimit::Cone, ..LAW };
    let pyramid = ContactLaw { restitution_offset: 0.0, ..LAW };
    for (contact_law, most_units, scope) in [
        (LAW, 32, Scope::Near),
        (LAW, 0, Scope::All),
        (offset, 0, Scope::All),
        (pyramid, 1, Scope::Near),
        (ContactLaw::RIGID, u32::MAX, Scope::All),
    ] {
        let config = ModelConfig { contact_law, most_units, scope, ..IMPULSES };
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
    for (config, field) in [
        (ModelConfig { contact_law: LAW, ..ModelConfig::TINY }, "contact_law"),
        (ModelConfig { most_units: 3, ..ModelConfig::TINY }, "most_units"),
        (ModelConfig { contact_law: LAW, bonds: 8, ..IMPULSES }, "contact_law"),
    ] {
        let error = ModelWriter::new("x", config).finish().unwrap_err().to_string();
        assert!(error.contains(&format!("`{field}` goes with `motion` Impulses")), "{error}");
    }
}

/// The same file with another offset and number of units, which no writer would write.
fn with(offset: f32, friction: u8, most_units: u8) -> Vec<u8> {
    let mut bytes = packed(ModelConfig { contact_law: LAW, most_units: 5, ..IMPULSES });
    // Before three counts of zero.
    let end = 64 + u32::from_le_bytes(bytes[12..16].try_into().unwrap()) as usize - 3;
    assert_eq!(bytes[end - 6..end], [&0.25_f32.to_le_bytes()[..], &[1, 5]].concat());
    bytes[end - 6..end - 2].copy_from_slice(&offset.to_le_bytes());
    bytes[end - 2..end].copy_from_slice(&[friction, most_units]);
    assert!(repair(&mut bytes));
    bytes
}

#[test]
fn hostile_laws_are_refused() {
    for offset in [f32::NAN, -0.1, 1.5, f32::INFINITY] {
        let message = error(&with(offset, 0, 0)).to_string();
        assert!(message.contains("`contact_law.restitution_offset` is"), "{message}");
    }
    assert!(matches!(error(&with(0.25, 2, 0)), FormatError::Header { .. }));
    // What an older version holds is of that.
    assert_eq!(error(&with(0.0, 0, 0)), FormatError::NeedlessVersion);
    assert_eq!(error(&with(-0.0, 0, 0)), FormatError::NeedlessVersion);
}
