//! The example `walk`.

use std::path::Path;

use nalgebra::{Isometry3, Point3, Vector3};
use rigidformer_core::{Physics, Plane};
use rigidformer_evaluation::scenes::{RecordedScene, RecordedUnit, SceneNotes, Split, write_scene};
use serde_json::Value;
use tempfile::TempDir;

use crate::examples::{Example, NANO, packed, path};

const WALK: Example = Example("walk");
/// An untrained model of a robot under a command of three numbers, as the lab exports it.
const CARRIED: &str =
    concat!(env!("CARGO_MANIFEST_DIR"), "/../tests/data/tiny-carried.model.safetensors");

/// A file with a robot of two parts on a circle, recorded so many frames at 30 Hz.
fn robot(folder: &TempDir, frames: u32) -> String {
    let corner = |i: i32| Point3::from([1, 2, 4].map(|bit| if i & bit == 0 { -0.1 } else { 0.1 }));
    let part = |name: &str, mass_kg: f32, height: f32| {
        let pose = |frame: u32| {
            let turn = Vector3::z() * (0.02 * frame as f32);
            Isometry3::new(Vector3::zeros(), turn) * Isometry3::translation(1.0, 0.0, height)
        };
        let physics = Physics { mass_kg, friction: 0.8, restitution: 0.0 };
        let points = (0..8).map(corner).collect();
        RecordedUnit::new(name, points, physics, (0..=frames).map(pose).collect()).with_body(0)
    };
    let units = vec![part("leg", 1.0, 0.3), part("trunk", 3.0, 0.8)];
    let gravity = Vector3::new(0.0, 0.0, -9.81);
    let scene = RecordedScene::new("robot", 5, Split::Test, 30.0, gravity, units)
        .unwrap()
        .with_planes(vec![Plane::ground(0.8, 0.0)])
        .unwrap()
        .with_commands(3, [0.6, 0.0, 0.6].repeat(frames as usize + 1))
        .unwrap();
    let path = path(folder, "robot.safetensors");
    let notes =
        SceneNotes { dataset: "g1".into(), provenance: "a test".into(), licence: "none".into() };
    write_scene(Path::new(&path), &scene, &notes).unwrap();
    path
}

#[test]
fn a_walk_to_a_place_is_planned() {
    let folder = tempfile::tempdir().unwrap();
    let (path, model) = (robot(&folder, 10), packed(&folder, CARRIED));
    let to = [path.as_str(), "--model", &model, "--to", "2,-1"];
    let table = WALK.works(&to);
    assert!(
        table.contains("to 2, -1 m, model tiny") && table.contains("32 futures of 9 steps"),
        "{table}"
    );
    let plan = |more: &[&str]| -> Value {
        let mut plan: Value =
            serde_json::from_str(&WALK.works(&[&to[..], &["--json"], more].concat())).unwrap();
        plan.as_object_mut().unwrap().remove("planning_s").unwrap();
        plan
    };
    let (first, again) = (plan(&[]), plan(&[]));
    assert_eq!(first, again, "the same seed gives the same plan");
    assert_eq!(first["path"].as_array().unwrap().len(), 9);
    assert_eq!(first["commands"].as_array().unwrap().len(), 9);
    assert_ne!(first["mean"], plan(&["--seed", "2"])["mean"]);
    let left = plan(&["--first", "0.5,0,0.1", "--join", "--heading", "90"]);
    assert!(left["path"][0]["turn_rad"].as_f64().unwrap() > 0.0, "{left}");

    let refused = |more: &[&str], code, expected: &[&str]| {
        WALK.fails(&[&[path.as_str(), "--model", &model], more].concat(), code, expected);
    };
    refused(&["--to", "2"], 2, &["--to has 1 numbers"]);
    refused(&["--to", "2,inf"], 2, &["inf", "metres"]);
    refused(&["--to", "2,1", "--first", "9,0,0"], 2, &["--first", "from -0.7 to 0.9"]);
    refused(&["--to", "2,1", "--step", "20"], 1, &["robot.safetensors", "11 frames", "21"]);
    refused(&["--to", "2,1", "--index", "4"], 1, &["robot.safetensors"]);
    WALK.fails(&[&path, "--model", NANO, "--to", "2,1"], 1, &["0 numbers", "walking robot"]);
    WALK.fails(&["no such file", "--to", "2,1"], 1, &["no such file"]);
}
