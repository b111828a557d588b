//! `rigidformer track`: recordings are followed and scored, and for every mistake its text and exit code.
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)]

use std::fs;
use std::path::Path;
use std::process::{Command, Output, Stdio};

use rigidformer_evaluation::scenes::Dataset;
use serde_json::Value;

fn run(arguments: &[&str]) -> Output {
    let mut program = Command::new(env!("CARGO_BIN_EXE_rigidformer"));
    program.stdin(Stdio::null()).args(arguments).output().unwrap()
}

fn works(arguments: &[&str]) -> String {
    let output = run(arguments);
    let stderr = String::from_utf8(output.stderr).unwrap();
    assert!(output.status.success(), "{arguments:?}: {stderr}");
    String::from_utf8(output.stdout).unwrap()
}

fn fails(arguments: &[&str], code: i32, expected: &[&str]) {
    let output = run(arguments);
    let stderr = String::from_utf8(output.stderr).unwrap();
    assert_eq!(output.status.code(), Some(code), "{arguments:?}: {stderr}");
    for part in expected {
        assert!(stderr.contains(part), "{arguments:?}: no {part:?} in: {stderr}");
    }
    assert!(!stderr.contains("panicked"), "{stderr}");
    assert!(output.stdout.is_empty(), "{arguments:?}");
}

fn path(path: &Path) -> &str {
    path.to_str().unwrap()
}

const SCENE: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/scenes/default.safetensors");

#[test]
fn a_recording_is_followed_written_and_scored() {
    let folder = tempfile::tempdir().unwrap();
    let (seen, out) = (folder.path().join("seen"), folder.path().join("new/tracked"));
    let render = ["render", SCENE, "--deviation-mm", "1", "--cameras", "2", "--seconds", "0.3"];
    works(&[&render[..], &["--size", "320x240", "--out", path(&seen)]].concat());

    let track = ["track", path(&seen), "--truth", SCENE, "--out", path(&out)];
    let printed = works(&track);
    for part in
        ["10 captures, 1 planes", "visible units", "told poses", "strip.png", "tracked.safetensors"]
    {
        assert!(printed.contains(part), "no {part:?} in {printed}");
    }
    let poses = fs::read_to_string(out.join("poses.csv")).unwrap();
    assert!(poses.starts_with("time_s,unit,x,y,z,qw,"));
    assert!(poses.lines().count() > 20, "{poses}");
    assert!(fs::read(out.join("strip.png")).unwrap().starts_with(b"\x89PNG"));
    let tracked = Dataset::open(&out.join("tracked.safetensors")).unwrap().scene(0, None).unwrap();
    assert!(tracked.units().len() >= 3 && tracked.frames() >= 5);
    assert!((tracked.frame_rate_hz() - 30.0).abs() < 0.01);
    assert_eq!(tracked.planes().map(<[_]>::len), Some(1));

    // The same captures give the same bytes.
    let again = folder.path().join("again");
    works(&["track", path(&seen), "--out", path(&again)]);
    assert_eq!(fs::read_to_string(again.join("poses.csv")).unwrap(), poses);
}

#[test]
fn a_scene_is_seen_and_scored_as_json() {
    let folder = tempfile::tempdir().unwrap();
    let arguments =
        ["track", SCENE, "--render", "--rate", "15", "--segmentation", "given", "--json"];
    let output = Command::new(env!("CARGO_BIN_EXE_rigidformer"))
        .current_dir(folder.path())
        .args(arguments)
        .output()
        .unwrap();
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    let document: Value = serde_json::from_slice(&output.stdout).unwrap();
    let scores = &document["scores"]["tracker"];
    assert!(scores["found_share"].as_f64().unwrap() > 0.5, "{scores}");
    assert!(!document["scores"]["predictions"].as_array().unwrap().is_empty());
    assert_eq!(
        fs::read_dir(folder.path()).unwrap().count(),
        0,
        "--json writes no files unless told where"
    );
}

#[test]
fn mistakes_are_named() {
    let folder = tempfile::tempdir().unwrap();
    let missing = folder.path().join("missing");
    fails(&["track", path(&missing)], 1, &["missing"]);
    fails(&["track", path(folder.path())], 1, &["frames.json"]);
    fails(&["track", SCENE], 1, &["default.safetensors"]);
    fails(&["track", SCENE, "--render", "--gravity", "0,0"], 2, &["--gravity"]);
    fails(&["track", SCENE, "--render", "--rate", "0"], 2, &["--rate"]);
    fails(&["track", SCENE, "--cameras", "2"], 2, &["--render"]);
    fails(&["track", SCENE, "--render", "--index", "9"], 1, &["scene"]);
    let clouds = folder.path().join("clouds");
    fs::create_dir(&clouds).unwrap();
    fs::write(clouds.join("a.ply"), "ply\n").unwrap();
    fails(&["track", path(&clouds)], 1, &["a.ply"]);
}
