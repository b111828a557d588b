//! Version 2 of the format: hidden widths and int8 panels.
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic, unreachable_pub)]

use crate::common::{error, repair};
use rigidformer_weights::{
    AlignedBuffer, FeatureSet, FormatError, Hidden, ModelConfig, ModelFile, ModelWriter, Motion,
    Panels, Scope, Shape, TensorData, include_model, write_atomically,
};

const HIDDEN: Hidden = Hidden { point: [12, 20], fuse: 40 };
/// 17 rows of 5 columns: two panels of two groups.
const SHAPE: Shape = Shape::Matrix { rows: 17, columns: 5 };

/// Weight (row, column), from -42 to 42.
fn weight(row: usize, column: usize) -> i8 {
    if row < 17 && column < 5 { (row * 5 + column) as i8 - 42 } else { 0 }
}

fn values() -> Vec<i8> {
    let place = |i: usize| weight(i / 128 * 16 + i % 64 / 4, i % 128 / 64 * 4 + i % 4);
    (0..2 * 2 * 64).map(place).collect()
}

fn sums() -> Vec<i32> {
    (0..17).map(|row| (0..5).map(|column| i32::from(weight(row, column))).sum()).collect()
}

fn packed(config: ModelConfig, values: &[i8], sums: &[i32]) -> Result<Vec<u8>, FormatError> {
    let scales = [0.5; 17];
    let panels = Panels { values, scales: &scales, sums };
    ModelWriter::new("panels", config)
        .tensor("a.bias", Shape::Vector(2), TensorData::F32(&[1.0, -1.0]))
        .tensor("a.weight", SHAPE, TensorData::Panels(panels))
        .finish()
        .map_err(|problem| match problem {
            rigidformer_weights::WriteError::Tensor { error, .. } => error,
            other => panic!("{other}"),
        })
}

fn whole() -> Vec<u8> {
    packed(ModelConfig { hidden: HIDDEN, ..ModelConfig::TINY }, &values(), &sums()).unwrap()
}

#[test]
fn everything_comes_back() {
    let bytes = AlignedBuffer::copy_of(&whole());
    let file = ModelFile::parse(&bytes).unwrap();
    assert_eq!(file.config().hidden, HIDDEN);
    assert_eq!((file.config().point_hidden(), file.config().fuse_hidden()), ([12, 20], 40));
    assert_eq!(file.parameters(), 2 + 17 * 5, "padding is no parameter");
    let tensor = file.tensor("a.weight").unwrap();
    assert_eq!(tensor.shape, SHAPE);
    let (values, sums) = (values(), sums());
    let expected = Panels { values: &values, scales: &[0.5; 17], sums: &sums };
    assert_eq!(tensor.data, TensorData::Panels(expected));
}

#[test]
fn the_stored_file_is_what_the_writer_writes() {
    assert!(**include_model!("../data/panels.rfm") == *whole());
}

#[test]
#[ignore = "makes tests/data/panels.rfm anew, after a new format version"]
fn store() {
    let path = std::path::Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/data/panels.rfm");
    write_atomically(&path, &whole()).unwrap();
}

#[test]
fn a_file_is_of_the_oldest_version_that_holds_it() {
    let version = |bytes: &[u8]| u32::from_le_bytes(bytes[8..12].try_into().unwrap());
    assert_eq!(version(&whole()), 2);
    assert_eq!(version(&packed(ModelConfig::TINY, &values(), &sums()).unwrap()), 2);
    let hidden = ModelConfig { hidden: HIDDEN, ..ModelConfig::TINY };
    assert_eq!(version(&ModelWriter::new("hidden", hidden).finish().unwrap()), 2);
    let plain = ModelWriter::new("plain", ModelConfig::TINY).finish().unwrap();
    assert_eq!(version(&plain), 1);
    let solved =
        ModelConfig { motion: Motion::Impulses, features: FeatureSet::Impact, ..ModelConfig::TINY };
    let solved = ModelWriter::new("solved", solved).finish().unwrap();
    assert_eq!(version(&solved), 4);
    let breaks = ModelConfig {
        motion: Motion::Impulses,
        features: FeatureSet::Impact,
        bonds: 4,
        ..ModelConfig::TINY
    };
    let breaking = ModelWriter::new("breaking", breaks).finish().unwrap();
    assert_eq!(version(&breaking), 7);
    let carried = ModelConfig { motion: Motion::Robot, ..ModelConfig::TINY };
    let carried = ModelWriter::new("carried", carried).finish().unwrap();
    assert_eq!(version(&carried), 5);
    let near = ModelConfig { scope: Scope::Near, bonds: 0, ..breaks };
    let near = ModelWriter::new("near", near).finish().unwrap();
    assert_eq!(version(&near), 8);
    assert_eq!(
        ModelFile::parse(&AlignedBuffer::copy_of(&near)).unwrap().config().scope,
        Scope::Near
    );
    // Version 4 has the same fields.
    let solved_too = ModelWriter::new("near", ModelConfig { bonds: 0, ..breaks }).finish().unwrap();
    assert_eq!(near.len(), solved_too.len());
    for amiss in [
        ModelConfig { scope: Scope::Near, ..ModelConfig::TINY },
        ModelConfig { scope: Scope::Near, ..breaks },
    ] {
        let error = ModelWriter::new("near", amiss).finish().unwrap_err();
        assert!(error.to_string().contains("`scope` Near"), "{error}");
    }

    let mut older = whole();
    older[8] = 1;
    assert!(repair(&mut older));
    // Where version 1 has the number of provenance entries, version 2 has the hidden widths.
    assert!(matches!(error(&older), FormatError::Header { .. } | FormatError::Text { .. }));
    let mut panels = packed(ModelConfig::TINY, &values(), &sums()).unwrap();
    panels[8] = 11;
    assert!(repair(&mut panels));
    assert_eq!(error(&panels), FormatError::Version { found: 11, supported: 10 });
}

#[test]
fn version_2_is_for_what_version_1_lacks() {
    let plain = ModelConfig { hidden: Hidden { fuse: 1, ..Hidden::DEFAULT }, ..ModelConfig::TINY };
    let mut bytes = ModelWriter::new("x", plain).finish().unwrap();
    // The last of the three hidden widths, before three counts of zero.
    let header = 64 + u32::from_le_bytes(bytes[12..16].try_into().unwrap()) as usize;
    assert_eq!(bytes[header - 4], 1);
    bytes[header - 4] = 0;
    assert!(repair(&mut bytes));
    assert_eq!(error(&bytes), FormatError::NeedlessVersion);
}

#[test]
fn a_second_hidden_layer_follows_a_first() {
    let hidden = Hidden { point: [0, 8], fuse: 0 };
    let config = ModelConfig { hidden, ..ModelConfig::TINY };
    let problem = config.validate().unwrap_err().to_string();
    assert!(problem.contains("second hidden.point"), "{problem}");
}

#[test]
fn padding_is_zero_and_sums_are_true() {
    let wrong = |change: &dyn Fn(&mut Vec<i8>, &mut Vec<i32>)| {
        let (mut values, mut sums) = (values(), sums());
        change(&mut values, &mut sums);
        packed(ModelConfig::TINY, &values, &sums).unwrap_err()
    };
    let panel = |channel| FormatError::Panel { tensor: 1, channel };
    assert_eq!(wrong(&|_, sums| sums[3] += 1), panel(3));
    assert_eq!(wrong(&|values, _| values[0] += 1), panel(0));
    // Column 5 of row 2, whose sum is put right.
    assert_eq!(
        wrong(&|values, sums| {
            values[64 + 2 * 4 + 1] = 7;
            sums[2] += 7;
        }),
        panel(2)
    );
    // Rows 17 and 18, which add up to nothing.
    assert_eq!(
        wrong(&|values, _| {
            values[128 + 2 * 4] = 7;
            values[128 + 2 * 4 + 1] = -7;
        }),
        panel(18)
    );
    assert_eq!(
        wrong(&|values, sums| {
            values[1] = i8::MIN;
            sums[0] = 0;
        }),
        FormatError::Asymmetric { tensor: 1, element: 1 }
    );
}

#[test]
fn every_cut_and_every_changed_byte_is_refused() {
    let mut bytes = whole();
    for length in 0..bytes.len() {
        error(&bytes[..length]);
    }
    for at in 0..bytes.len() {
        for flip in [1, 2, 4, 8, 16, 32, 64, 128, 255] {
            bytes[at] ^= flip;
            error(&bytes);
            bytes[at] ^= flip;
        }
    }
}
