//! Scene files: a written scene comes back unchanged, and every kind of damage has its own answer.
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)]

use std::path::Path;

use nalgebra::{Isometry3, Point3, UnitQuaternion, Vector3};
use rigidformer_core::Physics;
use rigidformer_runtime::scenes::{
    Dataset, Problem, RecordedScene, RecordedUnit, SceneNotes, Split, write_scene,
};

fn unit(offset: f32, points: usize) -> RecordedUnit {
    let pose = |frame: usize| {
        let turn = UnitQuaternion::from_scaled_axis(Vector3::new(0.1, 0.2, 0.3) * frame as f32);
        Isometry3::from_parts(Vector3::new(offset, 0.0, 5.0 - 0.01 * frame as f32).into(), turn)
    };
    RecordedUnit {
        shape: format!("shape {offset}"),
        points: (0..points).map(|i| Point3::new(i as f32, (i * i) as f32, -(i as f32))).collect(),
        physics: Physics { mass_kg: 1.0 + offset, friction: 0.4, restitution: 0.3 },
        poses: (0..12).map(pose).collect(),
    }
}

fn scene() -> RecordedScene {
    let gravity = Vector3::new(0.0, 0.0, -10.0);
    let units = vec![unit(0.0, 4), unit(2.5, 7)];
    RecordedScene::new("drop seed 42", 42, Split::Validation, 240.0, gravity, units)
        .unwrap()
        .with_ground(0.3, 0.5)
}

fn written() -> Vec<u8> {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("scene.safetensors");
    let notes = SceneNotes {
        dataset: "drop".into(),
        ground_friction: 0.3,
        ground_restitution: 0.5,
        provenance: "a test with a \"quote\"".into(),
        licence: "none".into(),
    };
    write_scene(&path, &scene(), &notes).unwrap();
    std::fs::read(path).unwrap()
}

/// The problem that opening `bytes`, or reading its first scene, ends in.
fn problem(bytes: Vec<u8>) -> (String, Problem) {
    let error = match Dataset::from_bytes("x.safetensors", bytes) {
        Err(error) => error,
        Ok(dataset) => dataset.scene(0, None).expect_err("damaged, and read all the same"),
    };
    assert!(error.to_string().starts_with("x.safetensors: "), "{error}");
    (error.field, error.problem)
}

fn replaced(from: &str, to: &str) -> Vec<u8> {
    assert_eq!(from.len(), to.len());
    let mut bytes = written();
    let at = bytes
        .windows(from.len())
        .position(|window| window == from.as_bytes())
        .expect("text to replace");
    bytes[at..at + to.len()].copy_from_slice(to.as_bytes());
    bytes
}

/// The file with an element of a tensor overwritten.
fn overwritten<const N: usize>(tensor: &str, element: usize, value: [u8; N]) -> Vec<u8> {
    let mut bytes = written();
    let header_bytes = u64::from_le_bytes(bytes[..8].try_into().unwrap()) as usize;
    let header: serde_json::Value = serde_json::from_slice(&bytes[8..8 + header_bytes]).unwrap();
    let start = header[tensor]["data_offsets"][0].as_u64().unwrap() as usize;
    let at = 8 + header_bytes + start + element * N;
    bytes[at..at + N].copy_from_slice(&value);
    bytes
}

#[test]
fn a_written_scene_comes_back_unchanged() {
    assert_eq!(written(), written(), "the same scene gives the same bytes");
    let dataset = Dataset::from_bytes("x", written()).unwrap();
    assert_eq!((dataset.name(), dataset.len(), dataset.frames()), ("drop", 1, 12));
    assert_eq!(dataset.provenance(), "a test with a \"quote\"");
    assert_eq!(dataset.scene(0, None).unwrap(), scene());
    assert_eq!(dataset.scene(0, Some(5)).unwrap(), scene().truncated(5));
    assert_eq!(dataset.scenes_of(Split::Validation), [0]);
    assert!(dataset.scenes_of(Split::Test).is_empty());
}

#[test]
fn every_truncation_is_refused() {
    let bytes = written();
    for length in 0..bytes.len() {
        let (field, problem) = problem(bytes[..length].to_vec());
        assert!(
            field == "file" && matches!(problem, Problem::NotSafetensors(_)),
            "{length}: {problem}"
        );
    }
    let longer = [bytes, vec![0]].concat();
    assert!(matches!(problem(longer), (_, Problem::NotSafetensors(_))));
}

#[test]
fn foreign_and_newer_files_are_named() {
    let (field, found) = problem(replaced("rigidformer-scenes", "rigidformer-sceneX"));
    assert!(field == "metadata format" && matches!(found, Problem::Foreign { .. }));
    let (field, found) = problem(replaced("\"version\":\"1\"", "\"version\":\"2\""));
    assert!(field == "metadata version" && matches!(found, Problem::Foreign { .. }));
    let (field, found) = problem(replaced("\"licence\"", "\"licenXX\""));
    assert!(field == "metadata licence" && matches!(found, Problem::Missing));
    let (field, found) = problem(replaced("unit_poses", "unit_posts"));
    assert!(field == "tensor unit_poses" && matches!(found, Problem::Missing));
    let (field, found) = problem(replaced("0 0 -10", "0 0  ten"[..7].into()));
    assert!(field == "metadata gravity_m_s2" && matches!(found, Problem::Unparsable { .. }));
    let (field, found) = problem(replaced("\"240\"", "\"-24\""));
    assert!(field == "metadata frame_rate_hz" && matches!(found, Problem::Unparsable { .. }));
    let (field, found) = problem(replaced("\"dtype\":\"I32\"", "\"dtype\":\"F32\""));
    assert!(field == "tensor unit_shape" && matches!(found, Problem::WrongTensor { .. }));
}

#[test]
fn bad_values_are_found_with_their_row() {
    let (field, found) = problem(overwritten("shape_points", 5, f32::NAN.to_le_bytes()));
    assert!(
        field == "tensor shape_points" && matches!(found, Problem::BadValue { row: 1, .. }),
        "{found}"
    );
    let (field, found) = problem(overwritten("shape_offsets", 1, (-4i64).to_le_bytes()));
    assert!(
        field == "tensor shape_offsets" && matches!(found, Problem::NotRising { .. }),
        "{found}"
    );
    let (field, found) = problem(overwritten("scene_units", 1, 3i64.to_le_bytes()));
    assert!(
        field == "tensor scene_units" && matches!(found, Problem::NotRising { total: 2 }),
        "{found}"
    );
    let (field, found) = problem(overwritten("unit_shape", 1, 2i32.to_le_bytes()));
    assert!(
        field == "tensor unit_shape" && matches!(found, Problem::BadValue { row: 1, .. }),
        "{found}"
    );
    let (field, found) = problem(overwritten("unit_scale", 0, 0f32.to_le_bytes()));
    assert!(
        field == "tensor unit_scale" && matches!(found, Problem::BadValue { row: 0, .. }),
        "{found}"
    );
    let (field, found) = problem(overwritten("unit_physics", 3, (-1f32).to_le_bytes()));
    assert!(
        field == "tensor unit_physics" && matches!(found, Problem::BadValue { row: 1, .. }),
        "{found}"
    );
    let (field, found) = problem(overwritten("scene_split", 0, [4]));
    assert!(
        field == "tensor scene_split" && matches!(found, Problem::BadValue { row: 0, .. }),
        "{found}"
    );
}

#[test]
fn bad_poses_are_found_with_unit_and_frame() {
    let at = |unit: usize, frame: usize, number: usize| (unit * 12 + frame) * 7 + number;
    let (field, found) =
        problem(overwritten("unit_poses", at(1, 3, 0), f32::INFINITY.to_le_bytes()));
    assert_eq!(field, "tensor unit_poses, scene 0 (seed 42)");
    assert!(matches!(found, Problem::BadPose { unit: 1, frame: 3, .. }), "{found}");
    let (_, found) = problem(overwritten("unit_poses", at(0, 11, 4), 2f32.to_le_bytes()));
    assert!(matches!(found, Problem::BadPose { unit: 0, frame: 11, .. }), "{found}");
}

#[test]
fn scenes_and_frames_that_are_not_there() {
    let dataset = Dataset::from_bytes("x", written()).unwrap();
    assert!(matches!(
        dataset.scene(1, None).unwrap_err().problem,
        Problem::NoSuchScene { index: 1, scenes: 1 }
    ));
    assert!(matches!(
        dataset.scene(usize::MAX, None).unwrap_err().problem,
        Problem::NoSuchScene { .. }
    ));
    let problem = dataset.scene(0, Some(13)).unwrap_err().problem;
    assert!(matches!(problem, Problem::TooFewFrames { recorded: 12, asked: 13 }));
    assert!(dataset.scene(0, Some(0)).is_err());
    let error = Dataset::open(Path::new("/nowhere/at all")).err().unwrap();
    assert!(error.to_string().contains("/nowhere/at all: file: cannot be read"), "{error}");
    let error = Dataset::open(&std::env::temp_dir()).err().unwrap();
    assert!(error.to_string().contains("directory"), "{error}");
}

#[test]
fn random_damage_never_panics() {
    let bytes = written();
    let mut state = 1u64;
    let mut next = |below: usize| {
        state = state.wrapping_mul(6364136223846793005).wrapping_add(1442695040888963407);
        (state >> 33) as usize % below
    };
    for _ in 0..20_000 {
        let mut damaged = bytes.clone();
        for _ in 0..=next(4) {
            let at = next(damaged.len());
            damaged[at] = next(256) as u8;
        }
        if let Ok(dataset) = Dataset::from_bytes("x", damaged) {
            let _ = (dataset.scene(0, None), dataset.scene(1, Some(1)));
        }
    }
}
