//! Version 3 of the format: what scenes are measured in, and the longest step.
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic, unreachable_pub)]

use crate::common::{error, repair};
use rigidformer_weights::{
    AlignedBuffer, FormatError, Hidden, ModelConfig, ModelFile, ModelWriter, Similarity,
};

const SIMILARITY: Similarity = Similarity { length_m: 0.3, longest_step: 10.5 };

fn packed(similarity: Similarity, hidden: Hidden) -> Vec<u8> {
    ModelWriter::new("x", ModelConfig { similarity, hidden, ..ModelConfig::TINY }).finish().unwrap()
}

/// The same file with other numbers in it, which no writer would write.
fn with(length_m: f32, longest_step: f32) -> Vec<u8> {
    let mut bytes = packed(SIMILARITY, Hidden::DEFAULT);
    // Before three counts of zero.
    let end = 64 + u32::from_le_bytes(bytes[12..16].try_into().unwrap()) as usize - 3;
    let numbers = [length_m.to_le_bytes(), longest_step.to_le_bytes()].concat();
    bytes[end - 8..end].copy_from_slice(&numbers);
    assert!(repair(&mut bytes));
    bytes
}

#[test]
fn everything_comes_back() {
    let hidden = Hidden { point: [12, 0], fuse: 0 };
    for (similarity, hidden) in [
        (SIMILARITY, Hidden::DEFAULT),
        (SIMILARITY, hidden),
        (Similarity { longest_step: 0.0, ..SIMILARITY }, Hidden::DEFAULT),
        (Similarity { length_m: 0.0, ..SIMILARITY }, Hidden::DEFAULT),
    ] {
        let bytes = packed(similarity, hidden);
        assert_eq!(bytes[8], 3);
        let bytes = AlignedBuffer::copy_of(&bytes);
        let file = ModelFile::parse(&bytes).unwrap();
        assert_eq!((file.config().similarity, file.config().hidden), (similarity, hidden));
    }
    assert_eq!(with(0.3, 10.5), packed(SIMILARITY, Hidden::DEFAULT));
    assert_eq!(packed(Similarity::OFF, Hidden::DEFAULT)[8], 1);
}

#[test]
fn numbers_out_of_range_are_refused() {
    for (length_m, longest_step, field) in [
        (f32::NAN, 0.0, "length_m` is NaN"),
        (-0.3, 0.0, "length_m` is -0.3"),
        (1e9, 0.0, "length_m` is 1000000000"),
        (1e-7, 0.0, "length_m` is 0.0000001"),
        (f32::INFINITY, 0.0, "length_m` is inf"),
        (0.3, f32::NAN, "longest_step` is NaN"),
        (0.0, -1.0, "longest_step` is -1"),
        (0.3, 1e7, "longest_step` is 10000000"),
    ] {
        let message =
            format!("configuration: `similarity.{field}; a model has 0.000001 to 1000000");
        assert_eq!(error(&with(length_m, longest_step)).to_string(), message);
    }
}

#[test]
fn version_3_is_for_what_older_ones_lack() {
    assert_eq!(error(&with(0.0, 0.0)), FormatError::NeedlessVersion);
    assert_eq!(error(&with(-0.0, 0.0)), FormatError::NeedlessVersion);
    let mut older = packed(SIMILARITY, Hidden::DEFAULT);
    older[8] = 2;
    assert!(repair(&mut older));
    assert!(matches!(error(&older), FormatError::Header { .. } | FormatError::Text { .. }));
}
