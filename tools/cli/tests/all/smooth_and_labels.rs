//! Rendered recordings with smooth errors, and recordings whose labels cannot be read.
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)]

use std::fs;
use std::path::Path;
use std::process::{Command, Output};

use serde_json::Value;

fn run(arguments: &[&str]) -> Output {
    Command::new(env!("CARGO_BIN_EXE_rigidformer")).args(arguments).output().unwrap()
}

/// Renders small images and returns what is printed.
fn rendered(out: &Path, more: &[&str]) -> Value {
    let out = out.to_str().unwrap();
    let size: &[&str] = if more.contains(&"--size") { &[] } else { &["--size", "96x64"] };
    let usual = ["render", "--seconds", "0.1", "--json", "--out", out];
    let output = run(&[&usual[..], size, more].concat());
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    serde_json::from_slice(&output.stdout).unwrap()
}

#[test]
fn smooth_errors_are_rendered_and_told() {
    let folder = tempfile::tempdir().unwrap();
    let smooth = ["--bowl", "0.005", "--step-mm", "2", "--wave-mm", "1"];
    let image = |name: &str| fs::read(folder.path().join(name).join("00000-camera1.png")).unwrap();
    let document = rendered(&folder.path().join("a"), &smooth);
    rendered(&folder.path().join("b"), &smooth);
    rendered(&folder.path().join("c"), &[]);
    assert!((document["noise"]["bowl"].as_f64().unwrap() - 0.005).abs() < 1e-6);
    for name in ["step_at_1m_m", "wave_at_1m_m"] {
        assert!(document["noise"][name].as_f64().unwrap() > 0.0, "{document}");
    }
    assert_eq!(image("a"), image("b"));
    assert_ne!(image("a"), image("c"));
    for wrong in [["--bowl", "1.5"], ["--step-mm", "nan"], ["--wave-mm", "x"]] {
        let output = run(&[&["render", "--out", "x"][..], &wrong].concat());
        assert_eq!(output.status.code(), Some(2), "{wrong:?}");
    }
}

#[test]
fn segments_are_scored_by_the_labels() {
    let folder = tempfile::tempdir().unwrap();
    let seen = folder.path().join("seen");
    rendered(&seen, &["--size", "320x240"]);
    let track = ["track", seen.to_str().unwrap(), "--no-model", "--truth-labels"];
    let output = run(&[&track[..], &["--json"]].concat());
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    let document: Value = serde_json::from_slice(&output.stdout).unwrap();
    let segments = &document["segments"];
    assert!(segments["images"].as_u64().unwrap() >= 2, "{segments}");
    assert!(segments["mean"]["overlap"]["f"].as_f64().unwrap() > 0.7, "{segments}");
    assert!(segments["found_share_75"].as_f64().unwrap() > 0.5, "{segments}");
    let given = run(&[&track[..], &["--segmentation", "given"]].concat());
    assert_eq!(given.status.code(), Some(2));
    // Without labels there is nothing to score.
    let frames = fs::read_to_string(seen.join("frames.json")).unwrap();
    let mut frames: Value = serde_json::from_str(&frames).unwrap();
    for frame in frames["frames"].as_array_mut().unwrap() {
        frame.as_object_mut().unwrap().remove("labels");
    }
    fs::write(seen.join("frames.json"), frames.to_string()).unwrap();
    let bare = run(&[&track[..], &["--json"]].concat());
    let stderr = String::from_utf8_lossy(&bare.stderr);
    assert!(!bare.status.success() && stderr.contains("labels"), "{stderr}");
}

#[test]
fn labels_that_cannot_be_read_matter_where_they_are_used() {
    let folder = tempfile::tempdir().unwrap();
    let seen = folder.path().join("seen");
    rendered(&seen, &[]);
    fs::write(seen.join("00000-camera1-labels.png"), b"GIF89a").unwrap();
    let track = ["track", seen.to_str().unwrap(), "--no-model", "--json"];
    let output = run(&track);
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    let given = run(&[&track[..], &["--segmentation", "given"]].concat());
    let stderr = String::from_utf8_lossy(&given.stderr);
    assert!(stderr.contains("labels: "), "{stderr}");
}
