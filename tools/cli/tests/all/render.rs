//! `rigidformer render`: recordings that can be read, and for every mistake its text and exit code.
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)]

use std::fs;
use std::path::{Path, PathBuf};
use std::process::{Command, Output, Stdio};

use rigidformer_perception::capture::View;
use rigidformer_perception::recording;
use serde_json::Value;
use tempfile::TempDir;

fn program() -> Command {
    let mut program = Command::new(env!("CARGO_BIN_EXE_rigidformer"));
    program.arg("render").stdin(Stdio::null());
    program
}

fn run(arguments: &[&str]) -> Output {
    program().args(arguments).output().unwrap()
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

fn folder() -> (TempDir, PathBuf) {
    let folder = tempfile::tempdir().unwrap();
    let out = folder.path().join("new/seen");
    (folder, out)
}

/// Small images of the scene that comes with the program.
fn small<'a>(out: &'a Path, more: &[&'a str]) -> Vec<&'a str> {
    let usual = ["--size", "96x64", "--seconds", "0.1", "--out", out.to_str().unwrap()];
    [&usual, more].concat()
}

#[test]
fn a_scene_is_recorded_with_labels_and_a_picture() {
    let (parent, out) = folder();
    let printed = works(&small(&out, &["--cameras", "2", "--rate", "20"]));
    for part in ["3 captures at 20 Hz by 2 cameras", "camera2 at", "0 box", "preview.png"] {
        assert!(printed.contains(part), "no {part:?} in {printed}");
    }
    let mut names: Vec<_> = fs::read_dir(&out)
        .unwrap()
        .map(|e| e.unwrap().file_name().into_string().unwrap())
        .collect();
    names.sort();
    assert_eq!(names.len(), 2 + 3 * 2 * 2, "{names:?}");
    assert_eq!(names[0], "00000-camera1-labels.png");
    assert!(fs::read(out.join("preview.png")).unwrap().starts_with(b"\x89PNG"));
    assert_eq!(fs::read_dir(parent.path().join("new")).unwrap().count(), 1, "nothing temporary");

    let captures = recording::open(&out).unwrap();
    assert_eq!(captures.gravity_m_s2().map(|gravity| gravity.z), Some(-10.0));
    let captures: Vec<_> = captures.map(Result::unwrap).collect();
    let times: Vec<_> = captures.iter().map(|capture| capture.time_s).collect();
    assert_eq!(times, [0.0, 0.05, 0.1]);
    for view in captures.iter().flat_map(|capture| &capture.views) {
        let View::Depth(view) = view else { panic!() };
        assert_eq!(view.camera.size(), [96, 64]);
        let labels = view.labels.as_ref().unwrap();
        let units = (1..=5).filter(|unit| labels.contains(unit)).count();
        assert!(units >= 3, "{units} of five units");
        // Most of the image is ground or unit.
        assert!(view.depth.iter().filter(|depth| **depth > 0).count() > 96 * 64 / 2);
    }
}

#[test]
fn the_same_seed_gives_the_same_files() {
    let (_parent, out) = folder();
    let image = |name: &str, seed: &str| {
        let out = out.with_file_name(name);
        let json = works(&small(&out, &["--deviation-mm", "3", "--seed", seed, "--json"]));
        let json: Value = serde_json::from_str(&json).unwrap();
        assert_eq!((&json["captures"], &json["units"][4]["unit"]), (&4.into(), &4.into()));
        let there_m = json["cameras"][0]["deviation_there_m"].as_f64().unwrap();
        assert!((there_m - 0.003).abs() < 1e-5, "{there_m}");
        fs::read(out.join("00003-camera1.png")).unwrap()
    };
    assert_eq!(image("a", "5"), image("b", "5"));
    assert_ne!(image("c", "5"), image("d", "6"));
}

#[test]
fn wrong_usage_is_named_and_leaves_nothing() {
    let (parent, out) = folder();
    let to = out.to_str().unwrap();
    fails(&[], 2, &["--out"]);
    fails(&["--out", to, "--size", "640"], 2, &["--size", "640x480"]);
    fails(&["--out", to, "--size", "9x9"], 2, &["16 to 8192"]);
    fails(&["--out", to, "--cameras", "4"], 2, &["--cameras"]);
    fails(&["--out", to, "--rate", "0"], 2, &["--rate", "0.01"]);
    fails(&["--out", to, "--deviation-mm", "-1"], 2, &["--deviation-mm", "from 0 to 1000"]);
    fails(&["--out", to, "--edge-loss", "1.5"], 2, &["--edge-loss", "from 0 to 1"]);
    fails(&["--out", to, "--seconds", "9"], 2, &["--seconds 9", "0.500 s"]);
    fails(&["--out", to, "--index", "7"], 1, &["scene 7 of 1"]);
    fails(&["no such file", "--out", to], 1, &["no such file"]);
    assert_eq!(fs::read_dir(parent.path()).unwrap().count(), 0);
    fs::create_dir_all(&out).unwrap();
    fs::write(out.join("mine.txt"), "x").unwrap();
    fails(&["--out", to], 1, &[to, "is there already", "another folder"]);
    assert_eq!(fs::read_dir(&out).unwrap().count(), 1);
}

#[test]
#[cfg(target_os = "linux")]
fn ctrl_c_leaves_no_half_folder() {
    use std::time::{Duration, Instant};

    let (parent, out) = folder();
    let mut command = program();
    // More images than are made before the signal comes.
    command.args(["--out", out.to_str().unwrap(), "--rate", "1000", "--size", "2000x1500"]);
    let child = command.stdout(Stdio::piped()).stderr(Stdio::piped()).spawn().unwrap();
    let begun = || {
        let entries = fs::read_dir(parent.path().join("new"));
        entries.is_ok_and(|mut entries| entries.next().is_some())
    };
    let start = Instant::now();
    while !begun() {
        assert!(start.elapsed() < Duration::from_secs(120), "it does not begin");
        std::thread::sleep(Duration::from_millis(2));
    }
    let process = rustix::process::Pid::from_child(&child);
    rustix::process::kill_process(process, rustix::process::Signal::INT).unwrap();
    let output = child.wait_with_output().unwrap();
    let stderr = String::from_utf8(output.stderr).unwrap();
    assert_eq!(output.status.code(), Some(130), "{stderr}");
    assert!(stderr.contains("interrupted; nothing was written"), "{stderr}");
    assert_eq!(fs::read_dir(parent.path().join("new")).unwrap().count(), 0);
}
