//! Models of soft bodies: version 6 of the format.
#![allow(clippy::unwrap_used, clippy::panic, unreachable_pub)]

use crate::common::repair;
use rigidformer_weights::{
    AlignedBuffer, ConfigError, Elastic, FeatureSet, FormatError, ModelConfig, ModelFile,
    ModelWriter, Motion, Similarity,
};

const ELASTIC: Elastic = Elastic {
    neighbours: 8,
    falloff: 8,
    thickness_m: 2e-3,
    stiffness: 1.0,
    damping_s: 0.01,
    skin_m: 9e-3,
    rate_hz: 960.0,
    strain_sweeps: 8,
    strain_limit: 0.02,
};

const SOFT: ModelConfig = ModelConfig {
    features: FeatureSet::Soft,
    motion: Motion::Soft,
    gate: false,
    elastic: ELASTIC,
    ..ModelConfig::TINY
};

fn error(bytes: &[u8]) -> FormatError {
    ModelFile::parse(&AlignedBuffer::copy_of(bytes)).unwrap_err()
}

#[test]
fn a_model_of_soft_bodies_is_of_version_6_and_comes_back_as_it_was() {
    let bytes = ModelWriter::new("soft", SOFT).finish().unwrap();
    assert_eq!(bytes[8], 6);
    let buffer = AlignedBuffer::copy_of(&bytes);
    assert_eq!(*ModelFile::parse(&buffer).unwrap().config(), SOFT);
    // In an older version the springs' bytes stand where the provenance begins.
    let mut older = bytes.clone();
    older[8] = 5;
    assert!(repair(&mut older));
    assert!(matches!(
        error(&older),
        FormatError::Config(_) | FormatError::Header { .. } | FormatError::Text { .. }
    ));
}

#[test]
fn motion_inputs_and_springs_come_together() {
    let bad = |config: ModelConfig| {
        assert!(ModelWriter::new("x", config).finish().is_err());
        config.validate().unwrap_err()
    };
    let amiss = |field| ConfigError::Soft { field };
    assert_eq!(bad(ModelConfig { features: FeatureSet::Contact, ..SOFT }), amiss("features"));
    assert_eq!(bad(ModelConfig { motion: Motion::Free, ..SOFT }), amiss("features"));
    assert_eq!(bad(ModelConfig { gate: true, ..SOFT }), amiss("gate"));
    assert_eq!(bad(ModelConfig { command_size: 2, ..SOFT }), amiss("command_size"));
    let similarity = Similarity { length_m: 0.5, longest_step: 0.0 };
    assert_eq!(bad(ModelConfig { similarity, ..SOFT }), amiss("similarity"));
    let springs = |elastic| bad(ModelConfig { elastic, ..SOFT });
    for (elastic, field) in [
        (Elastic { neighbours: 0, ..ELASTIC }, "elastic.neighbours"),
        (Elastic { neighbours: 33, ..ELASTIC }, "elastic.neighbours"),
        (Elastic { falloff: 17, ..ELASTIC }, "elastic.falloff"),
        (Elastic { strain_sweeps: 65, ..ELASTIC }, "elastic.strain_sweeps"),
    ] {
        assert!(
            matches!(springs(elastic), ConfigError::Size { field: found, .. } if found == field)
        );
    }
    for (elastic, field) in [
        (Elastic { thickness_m: -1.0, ..ELASTIC }, "elastic.thickness_m"),
        (Elastic { stiffness: 0.0, ..ELASTIC }, "elastic.stiffness"),
        (Elastic { damping_s: f32::NAN, ..ELASTIC }, "elastic.damping_s"),
        (Elastic { skin_m: f32::INFINITY, ..ELASTIC }, "elastic.skin_m"),
        (Elastic { rate_hz: 0.5, ..ELASTIC }, "elastic.rate_hz"),
        (Elastic { strain_limit: f32::NAN, ..ELASTIC }, "elastic.strain_limit"),
    ] {
        assert!(
            matches!(springs(elastic), ConfigError::Number { field: found, .. } if found == field)
        );
    }
}

#[test]
fn models_of_rigid_bodies_have_no_springs() {
    let stray = ModelConfig { elastic: ELASTIC, ..ModelConfig::TINY };
    assert_eq!(stray.validate(), Err(ConfigError::Soft { field: "elastic" }));
}
