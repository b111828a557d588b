//! `rigidformer import-robot`: what it writes is read again, and nothing that it reads is lost.
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)]

use std::fs;
use std::path::{Path, PathBuf};
use std::process::{Command, Output, Stdio};

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

fn fails(arguments: &[&str], code: i32, expected: &str) {
    let output = run(arguments);
    let stderr = String::from_utf8(output.stderr).unwrap();
    assert_eq!(output.status.code(), Some(code), "{arguments:?}: {stderr}");
    assert!(stderr.contains(expected), "{arguments:?}: no {expected:?} in: {stderr}");
    assert!(output.stdout.is_empty(), "{arguments:?}");
}

const ARM: &str = r#"<mujoco model="arm"><include file="part.xml"/><asset><mesh name="m" file="m.obj"/></asset><worldbody>
  <body name="upper" pos="0 0 1"><freejoint/><geom type="mesh" mesh="m"/>
    <body name="lower" pos=".3 0 0"><joint name="elbow" axis="0 1 0" range="-90 90"/><geom size=".04"/></body>
  </body></worldbody></mujoco>"#;
const CUBE: &str = "v 0 0 0\nv 0 0 1\nv 0 1 0\nv 0 1 1\nv 1 0 0\nv 1 0 1\nv 1 1 0\nv 1 1 1\n\
                    f 1 2 4 3\nf 5 7 8 6\nf 1 5 6 2\nf 3 4 8 7\nf 1 3 7 5\nf 2 6 8 4\n";

/// Files of a robot, in a folder of their own.
fn files(folder: &Path) -> [PathBuf; 3] {
    let files = ["arm.xml", "part.xml", "m.obj"].map(|name| folder.join(name));
    for (file, text) in files.iter().zip([ARM, "<mujoco/>", CUBE]) {
        fs::write(file, text).unwrap();
    }
    files
}

fn path(path: &Path) -> &str {
    path.to_str().unwrap()
}

#[test]
fn a_robot_is_written_and_inspected() {
    let folder = tempfile::tempdir().unwrap();
    let [arm, ..] = files(folder.path());
    let out = folder.path().join("arm.safetensors");
    let told = works(&["import-robot", path(&arm), "--out", path(&out)]);
    assert!(told.contains("2 of 3 links are units") && told.contains("1 pivots"), "{told}");
    assert!(works(&["inspect", path(&out)]).contains("upper"));
    let json = works(&["import-robot", path(&arm), "--out", path(&out), "--json"]);
    let json: Value = serde_json::from_str(&json).unwrap();
    assert_eq!(json["bytes"].as_u64(), Some(fs::metadata(&out).unwrap().len()));
    assert_eq!(json["joints"][1]["name"], "elbow");
    let units = json["units"].as_array().unwrap();
    assert!((units[0]["mass_kg"].as_f64().unwrap() - 1000.0).abs() < 1e-2, "{units:?}");
}

#[test]
fn a_state_has_the_size_that_is_told() {
    let folder = tempfile::tempdir().unwrap();
    let [arm, ..] = files(folder.path());
    let (out, state) = (folder.path().join("arm.safetensors"), folder.path().join("arm.state"));
    let arguments = ["import-robot", path(&arm), "--out", path(&out), "--state", path(&state)];
    let json: Value =
        serde_json::from_str(&works(&[&arguments[..], &["--json"]].concat())).unwrap();
    assert_eq!(json["state"]["bytes"].as_u64(), Some(fs::metadata(&state).unwrap().len()));
    assert_eq!(json["state"]["units"], 2);
    assert!(works(&arguments).contains("limits of 2 units and "));
    fails(&[&arguments[..4], &["--model", "edge.rfm"]].concat(), 2, "--state; give both");
    fails(&[&arguments[..5], &[path(&out)]].concat(), 2, "--state");
    fails(&[&arguments[..5], &[path(&arm)]].concat(), 2, "--state");
    fails(&[&arguments[..], &["--model", "none.rfm"]].concat(), 1, "none.rfm");
}

#[test]
fn what_is_read_is_not_written_over() {
    let folder = tempfile::tempdir().unwrap();
    let files = files(folder.path());
    for file in &files {
        let before = fs::read(file).unwrap();
        fails(
            &["import-robot", path(&files[0]), "--out", path(file)],
            2,
            "what this command reads",
        );
        assert_eq!(fs::read(file).unwrap(), before);
    }
    let command = ["import-robot", path(folder.path()), "--out", path(&files[2])];
    fails(&command, 2, "what this command reads");
    assert_eq!(fs::read_to_string(&files[2]).unwrap(), CUBE);
}

#[test]
fn options_without_an_effect_are_refused() {
    let folder = tempfile::tempdir().unwrap();
    let [arm, ..] = files(folder.path());
    let out = folder.path().join("out.safetensors");
    let with = |input: &Path, options: &[&str], expected: &str| {
        let command = [&["import-robot", path(input), "--out", path(&out)][..], options].concat();
        fails(&command, 2, expected);
        assert!(!out.exists());
    };
    with(&arm, &["--density", "500"], "--density is for a folder of meshes");
    with(&arm, &["--scale", "2"], "--scale is for a folder of meshes");
    for option in [&["--balance"][..], &["--merge-fixed"], &["--fixed-base"], &["--skip-meshes"]] {
        with(folder.path(), option, &format!("{} is for a robot's file", option[0]));
    }
    with(folder.path(), &["--package-path", "."], "--package-path is for a robot's file");
    with(folder.path(), &["--scale", "0"], "--scale: give");
    fs::write(&arm, "\n\n<mujoco><worldbody>").unwrap();
    let text = run(&["import-robot", path(&arm), "--out", path(&out)]);
    let text = String::from_utf8(text.stderr).unwrap();
    assert!(text.contains("arm.xml:3:"), "{text}");
}
