//! What goes out of the program: exit codes when nobody reads, files and what is in their place, and names that files have.
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)]

use std::fs::{self, File};
use std::os::unix::fs::{FileTypeExt, PermissionsExt, symlink};
use std::path::Path;
use std::process::{Command, Output, Stdio};

use tempfile::TempDir;

const NANO: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/../../weights/models/nano.rfm");
const NANO_F32: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/../../weights/models/nano-f32.rfm");
const SCENE: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/scenes/default.safetensors");

const ROLLOUT: [&str; 5] = ["rollout", "--model", NANO, "--frames", "20"];

fn program(folder: &Path) -> Command {
    let mut program = Command::new(env!("CARGO_BIN_EXE_rigidformer"));
    program.stdin(Stdio::null()).current_dir(folder);
    program
}

fn run(folder: &Path, arguments: &[&str]) -> Output {
    program(folder).args(arguments).output().unwrap()
}

fn text(bytes: &[u8]) -> String {
    String::from_utf8(bytes.to_vec()).unwrap()
}

#[track_caller]
fn works(folder: &Path, arguments: &[&str]) -> String {
    let output = run(folder, arguments);
    assert!(output.status.success(), "{arguments:?}: {}", text(&output.stderr));
    text(&output.stdout)
}

#[track_caller]
fn fails(folder: &Path, arguments: &[&str], code: i32, expected: &[&str]) {
    let output = run(folder, arguments);
    let stderr = text(&output.stderr);
    assert_eq!(output.status.code(), Some(code), "{arguments:?}: {stderr}");
    for part in expected {
        assert!(stderr.contains(part), "{arguments:?}: no {part:?} in: {stderr}");
    }
}

/// Runs with a pipe for stdout that nobody reads; the exit code and stderr.
fn unread(folder: &Path, arguments: &[&str]) -> (Option<i32>, String) {
    let mut child = program(folder)
        .args(arguments)
        .stdout(Stdio::piped())
        .stderr(Stdio::piped())
        .spawn()
        .unwrap();
    drop(child.stdout.take());
    let output = child.wait_with_output().unwrap();
    (output.status.code(), text(&output.stderr))
}

fn folder() -> TempDir {
    tempfile::tempdir().unwrap()
}

fn names(folder: &Path) -> Vec<String> {
    let entries = fs::read_dir(folder).unwrap();
    let mut names: Vec<_> =
        entries.map(|entry| entry.unwrap().file_name().into_string().unwrap()).collect();
    names.sort();
    names
}

/// The scene of the program, with another text in an entry of its header, or as the name of all shapes.
fn renamed(entry: &str, to: &str) -> Vec<u8> {
    let bytes = fs::read(SCENE).unwrap();
    let length = u64::from_le_bytes(bytes[..8].try_into().unwrap()) as usize;
    let mut header: serde_json::Value = serde_json::from_slice(&bytes[8..8 + length]).unwrap();
    let shapes: Vec<_> = (0..5).map(|shape| format!("{to}{shape}")).collect();
    header["__metadata__"][entry] = match entry {
        SHAPES => serde_json::to_string(&shapes).unwrap().into(),
        _ => to.into(),
    };
    let mut header = header.to_string();
    while !header.len().is_multiple_of(8) {
        header.push(' ');
    }
    [&(header.len() as u64).to_le_bytes()[..], header.as_bytes(), &bytes[8 + length..]].concat()
}

/// A CSV recording whose unit has this name.
fn csv(name: &str) -> String {
    let mut text = "time_s,unit,x,y,z,qw,qx,qy,qz\n".to_owned();
    for frame in 0..4 {
        text.push_str(&format!("{},\"{name}\",0,0,1,1,0,0,0\n", f64::from(frame) / 100.0));
    }
    text
}

#[test]
fn a_failure_stays_one_when_nobody_reads() {
    let folder = folder();
    let at = folder.path();
    fs::write(at.join("impossible.json"), IMPOSSIBLE).unwrap();
    let check = ["check", "--float", NANO_F32, "--quantised", NANO, SCENE, "--split", "test"];
    for more in [
        &["--tolerances", "impossible.json"][..],
        &["--tolerances", "impossible.json", "--json"],
        &["--tolerances", "impossible.json", "--out", "d"],
    ] {
        let line = [&check[..], more].concat();
        let (code, stderr) = unread(at, &line);
        assert_eq!(code, Some(1), "{stderr}");
        assert!(stderr.contains("of the tolerances"), "{stderr}");
    }
    assert_eq!(names(&at.join("d")), ["drift.png"]);
    let (code, stderr) = unread(at, &["inspect", "none.rfm"]);
    assert_eq!(code, Some(1), "{stderr}");
    let (code, _) = unread(at, &["rollout", "--model"]);
    assert_eq!(code, Some(2));
    for (number, step) in ["5", "6"].iter().enumerate() {
        let name = format!("{number}.trace");
        works(at, &["trace", "--model", NANO, "--steps", "2", "--step", step, "--out", &name]);
    }
    let (code, stderr) = unread(at, &["diff", "0.trace", "1.trace"]);
    assert_eq!(code, Some(1), "{stderr}");
}

const IMPOSSIBLE: &str = r#"{"metric_change": 0.0, "one_step_ratio": 0.0, "bonds_apart": 0.0, "drift_step": 10, "median_drift_m": 0.0, "median_drift_deg": 0.0, "rigidity": 0.0, "layer_sqnr_db": 200}"#;

#[test]
fn results_are_written_when_nobody_reads() {
    let folder = folder();
    let at = folder.path();
    let (code, stderr) = unread(
        at,
        &[&ROLLOUT[..], &["--out", "d", "--html", "page.html", "--gltf", "a.glb"]].concat(),
    );
    assert_eq!(code, Some(0), "{stderr}");
    assert_eq!(names(&at.join("d")), ["errors.png", "poses.csv", "strip.png"]);
    let (code, stderr) = unread(at, &["pack", NANO, "--header", "--out", "model.h"]);
    assert_eq!(code, Some(0), "{stderr}");
    let (code, stderr) =
        unread(at, &["trace", "--model", NANO, "--steps", "2", "--out", "a.trace"]);
    assert_eq!(code, Some(0), "{stderr}");
    for help in [&["--help"][..], &["rollout", "--help"], &["--version"]] {
        assert_eq!(unread(at, help).0, Some(0), "{help:?}");
    }
    assert_eq!(names(at), ["a.glb", "a.trace", "d", "model.h", "page.html"]);
}

#[test]
#[cfg(target_os = "linux")]
fn a_full_disk_is_a_failure_and_results_are_written() {
    let folder = folder();
    let at = folder.path();
    let out = [&ROLLOUT[..], &["--out", "d"]].concat();
    for line in [&out[..], &["inspect", NANO], &["inspect", "--json", SCENE], &["--help"]] {
        let full = File::options().write(true).open("/dev/full").unwrap();
        let output = program(at).args(line).stdout(full).output().unwrap();
        let stderr = text(&output.stderr);
        assert_eq!(output.status.code(), Some(1), "{line:?}: {stderr}");
        assert!(stderr.contains("standard output cannot be written to"), "{stderr}");
    }
    assert_eq!(names(&at.join("d")), ["errors.png", "poses.csv", "strip.png"]);
    // A full stderr changes no exit code.
    let full = File::options().write(true).open("/dev/full").unwrap();
    let status = program(at).args(["inspect", "none"]).stderr(full).status().unwrap();
    assert_eq!(status.code(), Some(1));
}

#[test]
fn devices_and_pipes_are_written_into() {
    let folder = folder();
    let at = folder.path();
    let header = ["pack", NANO, "--header", "--out"];
    works(at, &[&header[..], &["/dev/null"]].concat());
    assert!(fs::metadata("/dev/null").unwrap().file_type().is_char_device());
    works(at, &["rollout", "--model", NANO, "--frames", "20", "--out", "d", "--html", "/dev/null"]);
    // All of the file and nothing else, from a pipe, and from the start of a file.
    let piped = run(at, &[&header[..], &["/dev/stdout"]].concat());
    assert!(piped.status.success() && text(&piped.stderr).contains("CRC-32"));
    let path = at.join("redirected.h");
    let file = File::create(&path).unwrap();
    let status =
        program(at).args(header).arg("/dev/stdout").stdout(file).stderr(Stdio::null()).status();
    assert!(status.unwrap().success());
    works(at, &[&header[..], &["model.h"]].concat());
    assert_eq!(fs::read(&path).unwrap(), fs::read(at.join("model.h")).unwrap());
    assert_eq!(piped.stdout, fs::read(&path).unwrap());
    // A named pipe that is read, and one whose reader leaves.
    let fifo = at.join("fifo");
    let made = Command::new("mkfifo").arg(&fifo).status().unwrap();
    assert!(made.success());
    let child = program(at).args(header).arg(&fifo).stdout(Stdio::null()).spawn().unwrap();
    assert_eq!(fs::read(&fifo).unwrap(), fs::read(&path).unwrap());
    assert!(child.wait_with_output().unwrap().status.success());
    let mut child = program(at).args(header).arg(&fifo).stderr(Stdio::null()).spawn().unwrap();
    drop(File::open(&fifo).unwrap());
    assert_eq!(child.wait().unwrap().code(), Some(1));
    assert!(fs::symlink_metadata(&fifo).unwrap().file_type().is_fifo());
    fails(at, &[&header[..], &["/dev/full"]].concat(), 1, &["/dev/full: cannot be written"]);
}

#[test]
fn links_stay_and_modes_survive() {
    let folder = folder();
    let at = folder.path();
    fs::create_dir(at.join("elsewhere")).unwrap();
    let mode = |name: &str| fs::metadata(at.join(name)).unwrap().permissions().mode() & 0o777;
    for (bits, name) in [(0o600, "private.h"), (0o664, "group.h"), (0o755, "run.h")] {
        fs::write(at.join(name), "old").unwrap();
        fs::set_permissions(at.join(name), fs::Permissions::from_mode(bits)).unwrap();
        works(at, &["pack", NANO, "--header", "--out", name]);
        assert_eq!(mode(name), bits, "{name}");
    }
    for (link, to) in [("a.csv", "elsewhere/a"), ("b.html", "elsewhere/b"), ("c.trace", "a.csv")] {
        symlink(to, at.join(link)).unwrap();
    }
    works(at, &["trace", "--model", NANO, "--steps", "2", "--out", "c.trace"]);
    works(at, &[&ROLLOUT[..], &["--out", "d", "--html", "b.html"]].concat());
    for link in ["a.csv", "b.html", "c.trace"] {
        assert!(fs::symlink_metadata(at.join(link)).unwrap().is_symlink(), "{link}");
    }
    assert_eq!(names(&at.join("elsewhere")), ["a", "b"]);
}

#[test]
fn two_results_of_one_name_are_refused() {
    let folder = folder();
    let at = folder.path();
    symlink("x.html", at.join("link.mcap")).unwrap();
    symlink(".", at.join("here")).unwrap();
    let two = "two options name this file";
    for more in [
        &["--mcap", "x", "--html", "x"][..],
        &["--mcap", "x", "--html", "./x"],
        &["--mcap", "link.mcap", "--html", "x.html"],
        &["--gltf", "here/x", "--html", "x"],
        &["--out", "d", "--html", "d/poses.csv"],
        &["--out", "here", "--mcap", "strip.png"],
    ] {
        fs::create_dir_all(at.join("d")).unwrap();
        fails(at, &[&ROLLOUT[..], more].concat(), 2, &[two]);
    }
    let evaluate = ["evaluate", SCENE, "--model", NANO, "--picture", "x", "--html", "x"];
    fails(at, &evaluate, 2, &[two]);
    assert_eq!(names(&at.join("d")), [""; 0]);
}

#[test]
fn results_are_no_inputs() {
    let folder = folder();
    let at = folder.path();
    fs::copy(NANO, at.join("walk.png")).unwrap();
    fs::copy(SCENE, at.join("strip.png")).unwrap();
    symlink("strip.png", at.join("link")).unwrap();
    let read = "is what this command reads";
    fails(at, &["rollout", "strip.png", "--model", NANO, "--out", "."], 2, &[read]);
    fails(at, &["rollout", "--model", "walk.png", "--out", "."], 2, &[read]);
    fails(at, &["rollout", "link", "--out", "d", "--html", "strip.png"], 2, &[read]);
    fails(at, &["evaluate", "strip.png", "--picture", "link"], 2, &[read]);
}

#[test]
fn all_files_or_none() {
    let folder = folder();
    let at = folder.path();
    // A folder in the place of a file.
    for name in ["errors.png", "strip.png"] {
        fs::create_dir_all(at.join("d").join(name)).unwrap();
        fs::write(at.join("d/poses.csv"), "old").unwrap();
        fails(at, &[&ROLLOUT[..], &["--out", "d"]].concat(), 1, &[name, "cannot be written"]);
        assert_eq!(fs::read(at.join("d/poses.csv")).unwrap(), b"old");
        assert_eq!(names(&at.join("d")).len(), 2);
        fs::remove_dir(at.join("d").join(name)).unwrap();
    }
    // Viewers belong to the same files.
    fs::write(at.join("d/poses.csv"), "old").unwrap();
    let more = ["--out", "d", "--html", "/dev/full"];
    if cfg!(target_os = "linux") {
        fails(at, &[&ROLLOUT[..], &more].concat(), 1, &["/dev/full"]);
        assert_eq!(names(&at.join("d")), ["poses.csv"]);
    }
}

/// Runs with a limit on the size of files: the file system then refuses what is behind it.
fn limited(folder: &Path, bytes: u64, arguments: &[&str]) -> Output {
    let mut shell = Command::new("bash");
    // In blocks of 1,024 bytes; the signal would end the program.
    let script = format!("trap '' XFSZ; ulimit -f {}; exec \"$0\" \"$@\"", bytes / 1024);
    shell.args(["-c", &script, env!("CARGO_BIN_EXE_rigidformer")]).args(arguments);
    shell.current_dir(folder).stdin(Stdio::null()).output().unwrap()
}

#[test]
fn a_disk_that_is_full_halfway_leaves_the_old_files() {
    let mesh = "v 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\nf 1 3 2\nf 1 2 4\nf 2 3 4\nf 3 1 4\n";
    let small = ["--size", "64x48", "--seconds", "0.1"];
    let render = [&["render", SCENE, "--out", "d/seen"][..], &small].concat();
    let writers: [(&[&str], &[&str]); 12] = [
        (
            &["rollout", "--model", NANO, "--frames", "40", "--out", "."],
            &["poses.csv", "errors.png", "strip.png"],
        ),
        (
            &["rollout", "--model", NANO, "--frames", "20", "--out", "d", "--mcap", "a.mcap"],
            &["a.mcap"],
        ),
        (
            &["rollout", "--model", NANO, "--frames", "20", "--out", "d", "--gltf", "a.glb"],
            &["a.glb"],
        ),
        (
            &["rollout", "--model", NANO, "--frames", "20", "--out", "d", "--html", "a.html"],
            &["a.html"],
        ),
        (&["pack", NANO, "--header", "--out", "model.h"], &["model.h"]),
        (&["pack", NANO, "--scope", "near", "--out", "model.rfm"], &["model.rfm"]),
        (&["trace", "--model", NANO, "--steps", "2", "--out", "a.trace"], &["a.trace"]),
        (
            &["import", "in.csv", "--box", "*=1,1,1", "--out", "out.safetensors"],
            &["out.safetensors"],
        ),
        (&["pieces", "mesh.obj", "--out", "pieces.json"], &["pieces.json"]),
        (
            &["evaluate", SCENE, "--model", NANO, "--steps", "10", "--picture", "errors.png"],
            &["errors.png"],
        ),
        (
            &[
                "check",
                "--float",
                NANO_F32,
                "--quantised",
                NANO,
                SCENE,
                "--steps",
                "10",
                "--out",
                "d",
            ],
            &[],
        ),
        (&render, &[]),
    ];
    for (arguments, files) in writers {
        let folder = folder();
        let at = folder.path();
        fs::write(at.join("in.csv"), csv("a")).unwrap();
        fs::write(at.join("mesh.obj"), mesh).unwrap();
        fs::create_dir(at.join("d")).unwrap();
        for file in files {
            fs::write(at.join(file), "old").unwrap();
        }
        let before = names(at);
        let mut failures = 0;
        for bytes in [0, 1024, 4096, 16384] {
            let output = limited(at, bytes, arguments);
            let stderr = text(&output.stderr);
            if output.status.success() {
                break;
            }
            failures += 1;
            assert_eq!(output.status.code(), Some(1), "{arguments:?}: {stderr}");
            assert!(stderr.contains("cannot be written"), "{arguments:?}: {stderr}");
            assert_eq!(names(at), before, "{arguments:?}");
            assert_eq!(names(&at.join("d")), [""; 0], "{arguments:?}");
            for file in files {
                assert_eq!(fs::read(at.join(file)).unwrap(), b"old", "{arguments:?}: {file}");
            }
        }
        assert!(failures > 0, "{arguments:?}");
    }
}

/// Whether text has nothing that a terminal acts upon.
#[track_caller]
fn is_plain(output: &Output) -> String {
    let all = text(&output.stdout) + &text(&output.stderr);
    assert!(!all.contains("panicked"), "{all}");
    let unsafe_one = all.chars().find(|c| {
        (c.is_control() && *c != '\n' && *c != '\t')
            || matches!(c, '\u{202a}'..='\u{202e}' | '\u{2066}'..='\u{2069}')
    });
    assert_eq!(unsafe_one, None, "{all:?}");
    all
}

/// OSC 52, CSI, C1 controls, DEL, a bell and a right-to-left override.
const EVIL: &str = "\u{1b}]52;c;eA==\u{7}\u{1b}[2J\u{9b}31m\u{7f}\u{202e}evil";

#[test]
fn names_from_files_are_printed_as_text() {
    let folder = folder();
    let at = folder.path();
    fs::write(at.join("evil.safetensors"), renamed("dataset", EVIL)).unwrap();
    fs::write(at.join("shapes.safetensors"), renamed(SHAPES, EVIL)).unwrap();
    fs::write(at.join("evil.csv"), csv(EVIL)).unwrap();
    fs::write(at.join("header.csv"), format!("time_s,{EVIL}\n0,0\n")).unwrap();
    fs::write(at.join("evil.json"), format!("{{\"{EVIL}\": 1}}")).unwrap();
    fs::write(at.join("evil.toml"), format!("[{EVIL}")).unwrap();
    let evil_path = format!("{EVIL}.rfm");
    let lines: [&[&str]; 15] = [
        &["inspect", "evil.safetensors"],
        &["inspect", "evil.safetensors", "--json"],
        &["inspect", "shapes.safetensors"],
        &["rollout", "evil.safetensors", "--model", NANO, "--frames", "20", "--out", "d"],
        &["evaluate", "evil.safetensors", "--model", NANO, "--limit", "1"],
        &["evaluate", "evil.safetensors", "--model", NANO, "--limit", "1", "--json"],
        &["import", "evil.csv", "--out", "o.safetensors", "--box", "*=1,1,1"],
        &["import", "header.csv", "--out", "o.safetensors", "--box", "*=1,1,1"],
        &["check", "--float", NANO_F32, "--quantised", NANO, SCENE, "--tolerances", "evil.json"],
        &["pack", NANO, "--provenance", "evil.toml", "--out", "p.rfm"],
        &["inspect", &evil_path],
        &["inspect", SCENE, &evil_path],
        &[&evil_path],
        &["rollout", "--step", EVIL],
        &["trace", "evil.safetensors", "--model", NANO, "--steps", "2", "--out", "a.trace"],
    ];
    for line in lines {
        let output = run(at, line);
        is_plain(&output);
    }
    let shown = is_plain(&run(at, lines[0]));
    assert!(shown.contains("\\u{1b}]52;c;eA==\\u{7}"), "{shown}");
    let json: serde_json::Value = serde_json::from_slice(&run(at, lines[1]).stdout).unwrap();
    assert!(json["dataset"].as_str().unwrap().contains(EVIL));
}

#[test]
fn no_name_is_too_long_to_print() {
    let folder = folder();
    let at = folder.path();
    let long = "x".repeat(100_000);
    fs::write(at.join("long.safetensors"), renamed("dataset", &long)).unwrap();
    fs::write(at.join("shape.safetensors"), renamed(SHAPES, &long)).unwrap();
    fs::write(at.join("long.csv"), csv(&long)).unwrap();
    let mut lines: Vec<Vec<&str>> = vec![
        vec!["import", "long.csv", "--out", "long-unit.safetensors", "--box", "*=1,1,1"],
        vec!["import", "long.csv", "--out", "none.safetensors", "--box", "other=1,1,1"],
        vec!["inspect", "long-unit.safetensors"],
    ];
    for file in ["long.safetensors", "shape.safetensors"] {
        lines.push(vec!["inspect", file]);
        lines.push(vec![
            "rollout", file, "--model", NANO, "--frames", "20", "--out", "d", "--html", "a.html",
            "--gltf", "a.glb", "--mcap", "a.mcap",
        ]);
        lines.push(vec!["evaluate", file, "--model", NANO, "--limit", "1", "--picture", "p.png"]);
        lines.push(vec!["render", file, "--out", "r", "--seconds", "0", "--size", "32x24"]);
        lines.push(vec!["trace", file, "--model", NANO, "--steps", "2", "--out", "a.trace"]);
        lines.push(vec![
            "check",
            "--float",
            NANO_F32,
            "--quantised",
            NANO,
            file,
            "--out",
            "c",
            "--limit",
            "1",
        ]);
    }
    for line in lines {
        let all = is_plain(&run(at, &line));
        assert!(all.len() < 20_000, "{line:?}: {} bytes", all.len());
    }
}

/// The entry with the names of shapes.
const SHAPES: &str = "shape_names";

#[test]
fn a_page_stays_one_whatever_names_are() {
    let folder = folder();
    let at = folder.path();
    let evil = "</script><script>alert(1)</script><!--<script>";
    fs::write(at.join("evil.safetensors"), renamed("dataset", evil)).unwrap();
    let line = ["rollout", "evil.safetensors", "--model", NANO, "--frames", "20", "--out", "d"];
    works(at, &[&line[..], &["--html", "a.html", "--gltf", "a.glb", "--mcap", "a.mcap"]].concat());
    works(at, &[&ROLLOUT[..], &["--out", "d", "--html", "b.html"]].concat());
    let count =
        |name: &str, what: &str| fs::read_to_string(at.join(name)).unwrap().matches(what).count();
    for tag in ["<script", "</script", "<!--"] {
        assert_eq!(count("a.html", tag), count("b.html", tag), "{tag}");
    }
}
