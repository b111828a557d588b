//! What the writer packs, the reader returns; and the bytes never change.
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic, unreachable_pub)]

use crate::common;
use half::f16;
use rigidformer_weights::{
    AlignedBuffer, ConfigError, DType, FormatError, ModelConfig, ModelFile, ModelWriter, Scales,
    Shape, TensorData, WriteError, include_model, write_atomically,
};

const HALVES: [f16; 3] = [f16::from_f32_const(0.5), f16::NEG_ZERO, f16::MAX];

/// The model of `tests/data/tiny.rfm`.
fn tiny() -> ModelWriter<'static> {
    ModelWriter::new("tiny", ModelConfig::TINY)
        .provenance("data", "none: for tests")
        .provenance("commit", "0123abc")
        .metric("position_rmse_m", 0.25)
        .tensor(
            "weight",
            Shape::Matrix { rows: 2, columns: 3 },
            TensorData::F32(&[1.0, 2.0, 3.0, -4.0, 0.5, -0.0]),
        )
        .tensor("bias", Shape::Vector(3), TensorData::F16(&HALVES))
        .tensor("sigma", Shape::Scalar, TensorData::F32(&[0.1]))
        .tensor(
            "quantised",
            Shape::Matrix { rows: 2, columns: 2 },
            TensorData::I8 { values: &[-127, 0, 1, 127], scales: &[0.25, f32::MIN_POSITIVE] },
        )
}

#[test]
fn everything_comes_back() {
    let bytes = AlignedBuffer::copy_of(&tiny().finish().unwrap());
    let model = ModelFile::parse(&bytes).unwrap();
    common::visit(&model);
    assert_eq!(model.name(), "tiny");
    assert_eq!(model.config(), &ModelConfig::TINY);
    assert_eq!(model.parameters(), 6 + 3 + 1 + 4);
    assert!(model.provenance().eq([("data", "none: for tests"), ("commit", "0123abc")]));
    assert!(model.metrics().eq([("position_rmse_m", 0.25)]));
    assert!(model.tensors().map(|tensor| tensor.name).eq(["bias", "quantised", "sigma", "weight"]));
    assert_eq!(model.tensor("missing"), None);
    assert_eq!(model.tensor("bias").unwrap().data, TensorData::F16(&HALVES));
    let quantised = model.tensor("quantised").unwrap();
    assert_eq!(quantised.data.dtype(), DType::I8);
    assert_eq!(
        quantised.data,
        TensorData::I8 { values: &[-127, 0, 1, 127], scales: &[0.25, f32::MIN_POSITIVE] }
    );
    let weight = model.tensor("weight").unwrap();
    assert_eq!(weight.shape, Shape::Matrix { rows: 2, columns: 3 });
    let TensorData::F32(values) = weight.data else { panic!("{weight:?}") };
    assert!(values[5].is_sign_negative());
    assert!(values.as_ptr().addr().is_multiple_of(64));
    assert!(bytes.as_ptr_range().contains(&values.as_ptr().cast()));
}

/// A stored file is read by every later version: a change here is a new format version.
#[test]
fn the_stored_file_is_what_the_writer_writes() {
    let stored = include_model!("../data/tiny.rfm");
    assert!(**stored == *tiny().finish().unwrap());
    assert_eq!(
        ModelFile::parse(stored).unwrap().payload_crc(),
        common::crc32(&stored[stored.len() - 5 * 64..])
    );
}

#[test]
#[ignore = "makes tests/data/tiny.rfm anew, after a new format version"]
fn store() {
    let path = std::path::Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/data/tiny.rfm");
    write_atomically(&path, &tiny().finish().unwrap()).unwrap();
}

#[test]
fn the_second_writer_agrees() {
    let header = common::Header {
        name: "n".into(),
        metrics: vec![("loss".into(), 0.5)],
        provenance: vec![("key".into(), "value".into())],
        ..common::Header::new(vec![
            common::Entry::f32("a", 2, 0),
            common::Entry::i8("b", 1, 1, 64, 128),
        ])
    };
    let mut payload = common::f32_bytes(&[1.0, -2.0]);
    payload.push(5);
    payload.resize(128, 0);
    payload.extend(common::f32_bytes(&[0.5]));
    let written = ModelWriter::new("n", ModelConfig::TINY)
        .metric("loss", 0.5)
        .provenance("key", "value")
        .tensor(
            "b",
            Shape::Matrix { rows: 1, columns: 1 },
            TensorData::I8 { values: &[5], scales: &[0.5] },
        )
        .tensor("a", Shape::Vector(2), TensorData::F32(&[1.0, -2.0]))
        .finish()
        .unwrap();
    assert_eq!(written, common::file(&header.encode(), &payload));
}

#[test]
fn bytes_do_not_depend_on_the_order_of_tensors() {
    let ab = ModelWriter::new("m", ModelConfig::TINY)
        .tensor("a", Shape::Scalar, TensorData::F32(&[1.0]))
        .tensor("b", Shape::Scalar, TensorData::F32(&[2.0]));
    let ba = ModelWriter::new("m", ModelConfig::TINY)
        .tensor("b", Shape::Scalar, TensorData::F32(&[2.0]))
        .tensor("a", Shape::Scalar, TensorData::F32(&[1.0]));
    assert_eq!(ab.finish(), ba.finish());
}

#[test]
fn a_model_may_have_no_tensors() {
    let bytes = AlignedBuffer::copy_of(&ModelWriter::new("m", ModelConfig::TINY).finish().unwrap());
    let model = ModelFile::parse(&bytes).unwrap();
    assert_eq!((model.tensors().len(), model.parameters(), model.payload_crc()), (0, 0, 0));
}

#[test]
fn the_writer_refuses_what_the_reader_would() {
    let one = |shape, data| {
        ModelWriter::new("m", ModelConfig::TINY).tensor("t", shape, data).finish().unwrap_err()
    };
    let tensor = |error| WriteError::Tensor { name: "t".into(), error };
    let nan = [f32::NAN];
    assert_eq!(
        one(Shape::Scalar, TensorData::F32(&nan)),
        tensor(FormatError::NotFinite { tensor: 0, element: 0 })
    );
    assert_eq!(
        one(Shape::Vector(2), TensorData::F32(&[1.0])),
        tensor(FormatError::Size { tensor: 0, expected: 8, found: 4 })
    );
    assert_eq!(
        one(Shape::Vector(0), TensorData::F32(&[])),
        tensor(FormatError::Shape { tensor: 0 })
    );
    let vector = TensorData::I8 { values: &[1], scales: &[1.0] };
    assert_eq!(one(Shape::Vector(1), vector), tensor(FormatError::Shape { tensor: 0 }));
    let too_few_scales = TensorData::I8 { values: &[1, 2], scales: &[1.0] };
    assert_eq!(
        one(Shape::Matrix { rows: 2, columns: 1 }, too_few_scales),
        tensor(FormatError::Scale { tensor: 0, channel: 1 })
    );
    let lowest = TensorData::I8 { values: &[1, -128], scales: &[1.0] };
    assert_eq!(
        one(Shape::Matrix { rows: 1, columns: 2 }, lowest),
        tensor(FormatError::Asymmetric { tensor: 0, element: 1 })
    );
    let twice = tiny().tensor("bias", Shape::Scalar, TensorData::F32(&[1.0])).finish();
    assert_eq!(twice, Err(WriteError::Duplicate { name: "bias".into() }));
    assert!(matches!(
        ModelWriter::new("", ModelConfig::TINY).finish(),
        Err(WriteError::Format(FormatError::Text { field: "model name", .. }))
    ));
    let blind = ModelConfig { scales: Scales(0), ..ModelConfig::TINY };
    assert_eq!(
        ModelWriter::new("m", blind).finish(),
        Err(WriteError::Config(ConfigError::NoScales))
    );
}

#[test]
fn files_are_written_whole_or_not_at_all() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("model.rfm");
    write_atomically(&path, b"old").unwrap();
    write_atomically(&path, &tiny().finish().unwrap()).unwrap();
    assert!(ModelFile::parse(&AlignedBuffer::read(&path).unwrap()).is_ok());

    // A folder in the way: renaming fails after the bytes were written.
    let blocked = folder.path().join("blocked");
    std::fs::create_dir_all(blocked.join("full")).unwrap();
    let refused = write_atomically(&blocked, b"new").unwrap_err();
    assert_eq!(refused.path, blocked);
    assert!(refused.to_string().starts_with(&blocked.display().to_string()), "{refused}");
    assert!(write_atomically(&folder.path().join("missing/model.rfm"), b"new").is_err());
    let mut left: Vec<_> =
        std::fs::read_dir(folder.path()).unwrap().map(|entry| entry.unwrap().file_name()).collect();
    left.sort();
    assert_eq!(left, ["blocked", "model.rfm"]);
}

#[cfg(unix)]
#[test]
fn written_files_have_the_permissions_of_any_new_file() {
    use std::os::unix::fs::PermissionsExt;
    let folder = tempfile::tempdir().unwrap();
    let (plain, packed) = (folder.path().join("plain"), folder.path().join("packed"));
    std::fs::write(&plain, b"").unwrap();
    write_atomically(&packed, b"").unwrap();
    let mode = |path| std::fs::metadata(path).unwrap().permissions().mode();
    assert_eq!(mode(&packed), mode(&plain));
}
