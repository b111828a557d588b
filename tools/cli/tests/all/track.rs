//! `rigidformer track`: recordings are followed and scored, and for every mistake its text and exit code.
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)]

use std::fs;
use std::path::Path;
use std::process::{Command, Output, Stdio};

use rigidformer_evaluation::scenes::Dataset;
use rigidformer_runtime::hull::ConvexHull;
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
fn the_network_is_left_out_of_predictions() {
    let predictions = |more: &[&str]| {
        let track = ["track", SCENE, "--render", "--rate", "15", "--json"];
        let document: Value = serde_json::from_str(&works(&[&track[..], more].concat())).unwrap();
        document["scores"]["predictions"].clone()
    };
    let (with, without) = (predictions(&[]), predictions(&["--no-network"]));
    // The tracker's, and those of the model that is told the truth.
    for error in ["position_m", "position_told_all_m"] {
        assert_ne!(with[0][error], without[0][error], "{error}");
    }
}

/// The hulls of the scene's units as OBJ files.
fn meshes(folder: &Path) -> Vec<String> {
    let scene = Dataset::open(SCENE.as_ref()).unwrap().scene(0, None).unwrap();
    let write = |(number, unit): (usize, &rigidformer_evaluation::scenes::RecordedUnit)| {
        let hull = ConvexHull::new(&unit.points).unwrap();
        let corners = unit.points.iter().map(|p| format!("v {} {} {}\n", p.x, p.y, p.z));
        let faces =
            hull.faces().iter().map(|[a, b, c]| format!("f {} {} {}\n", a + 1, b + 1, c + 1));
        let path = folder.join(format!("unit{number}.obj"));
        fs::write(&path, corners.chain(faces).collect::<String>()).unwrap();
        path.to_str().unwrap().to_owned()
    };
    scene.units().iter().enumerate().map(write).collect()
}

#[test]
fn known_objects_are_found_and_named() {
    let folder = tempfile::tempdir().unwrap();
    let out = folder.path().join("out");
    let meshes = meshes(folder.path());
    let objects = meshes.iter().flat_map(|mesh| ["--object", mesh]);
    let render = ["track", SCENE, "--render", "--rate", "10", "--cameras", "2", "--json"];
    let line: Vec<&str> = render.into_iter().chain(objects).chain(["--out", path(&out)]).collect();
    let document: Value = serde_json::from_str(&works(&line)).unwrap();
    let units = document["units"].as_array().unwrap();
    let known: Vec<&str> = units.iter().filter_map(|unit| unit["object"].as_str()).collect();
    assert!(known.len() >= 2 && known.iter().all(|name| name.starts_with("unit")), "{units:?}");

    let line: Vec<&str> = render.into_iter().chain(["--known"]).collect();
    let document: Value = serde_json::from_str(&works(&line)).unwrap();
    let units = document["units"].as_array().unwrap();
    assert!(units.iter().filter(|unit| unit["object"].is_string()).count() >= 2, "{units:?}");
    fails(&["track", SCENE, "--known"], 2, &["--render"]);

    let odd = format!("{}=-1", meshes[0]);
    fails(&["track", SCENE, "--render", "--object", &odd], 2, &["--object", "FILE=KG"]);
    let none = path(&folder.path().join("none.stl")).to_owned();
    fails(&["track", SCENE, "--render", "--object", &none], 1, &["none.stl"]);
    let flat = folder.path().join("flat.obj");
    fs::write(&flat, "v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n").unwrap();
    fails(&["track", SCENE, "--render", "--object", path(&flat)], 1, &["flat.obj", "one plane"]);
}

#[test]
fn a_mask_of_the_first_image_begins_units() {
    let folder = tempfile::tempdir().unwrap();
    let seen = folder.path().join("seen");
    works(&["render", SCENE, "--seconds", "0.3", "--size", "320x240", "--out", path(&seen)]);
    let images = fs::read_dir(&seen).unwrap().map(|entry| entry.unwrap().path());
    let mut masks: Vec<_> = images.filter(|p| path(p).ends_with("-labels.png")).collect();
    masks.sort();
    let line = ["track", path(&seen), "--json", "--mask", path(&masks[0])];
    let document: Value = serde_json::from_str(&works(&line)).unwrap();
    assert!(document["units"].as_array().unwrap().len() >= 2, "{document}");
    fails(&["track", path(&seen), "--mask", path(&seen.join("none.png"))], 1, &["none.png"]);
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
    fails(&["track", path(&clouds)], 1, &["--rate", "frames.json"]);
    fails(&["track", path(&clouds), "--rate", "10"], 1, &["a.ply"]);
    fails(&["track", SCENE, "--render", "--up", "0,0,0"], 2, &["--up"]);
    fails(&["track", "-", "--out", path(&clouds)], 2, &["--out"]);
    fails(&["track", "-"], 1, &["no frame came"]);
}

/// A folder of clouds of a cube of .2 m that slides over a floor, ten a second; all lengths times `scale`.
fn write_clouds(folder: &Path, scale: f32, has_cube: bool) {
    fs::create_dir(folder).unwrap();
    for frame in 0..4 {
        let at = 0.06 * frame as f32;
        let mut points: Vec<[f32; 3]> = (0..80 * 80)
            .map(|k| [(k % 80) as f32 * 0.025 - 1.0, (k / 80) as f32 * 0.025 - 1.0, 0.0])
            .filter(|[x, y, _]| !has_cube || (x - at).abs() > 0.1 || y.abs() > 0.1)
            .collect();
        let grid = (0..21 * 21).map(|k| [(k % 21) as f32 * 0.01 - 0.1, (k / 21) as f32 * 0.01]);
        for [u, v] in grid.filter(|_| has_cube) {
            let sides = [[at + u, v - 0.1, 0.2], [at + u, -0.1, v], [at - 0.1, u, v]];
            points.extend(sides);
        }
        let mut file = format!(
            "ply\nformat ascii 1.0\nelement vertex {}\nproperty float x\nproperty float y\nproperty float z\nend_header\n",
            points.len()
        );
        for [x, y, z] in points {
            file += &format!("{} {} {}\n", x * scale, y * scale, z * scale);
        }
        fs::write(folder.join(format!("{frame}.ply")), file).unwrap();
    }
}

fn document(arguments: &[&str]) -> Value {
    serde_json::from_str(&works(&[arguments, &["--json"]].concat())).unwrap()
}

fn notes(document: &Value) -> String {
    document["notes"].to_string()
}

#[test]
fn what_is_odd_about_a_recording_is_told() {
    let folder = tempfile::tempdir().unwrap();
    let [small, large, empty] = ["m", "mm", "floor"].map(|name| folder.path().join(name));
    write_clouds(&small, 1.0, true);
    write_clouds(&large, 1000.0, true);
    write_clouds(&empty, 1.0, false);

    let sound = document(&["track", path(&small), "--rate", "10"]);
    assert_eq!(sound["input"], "m", "where a recording lies is in no result");
    assert_eq!(sound["units"].as_array().unwrap().len(), 1, "{sound}");
    assert_eq!(sound["facts"]["gravity_known"], "assumed");
    assert!(sound["facts"]["level_plane_tilt_deg"].as_f64().unwrap() < 0.1);

    let odd = document(&["track", path(&large), "--rate", "10"]);
    assert!(notes(&odd).contains("millimetres? use --scale .001"), "{odd}");
    assert!(notes(&odd).contains("nothing was followed"), "{odd}");
    let right = document(&["track", path(&large), "--rate", "10", "--scale", "0.001"]);
    assert_eq!(right["units"].as_array().unwrap().len(), 1, "{right}");

    let nothing = document(&["track", path(&empty), "--rate", "10", "--up", "0,0,1"]);
    assert!(nothing["units"].as_array().unwrap().is_empty());
    assert!(notes(&nothing).contains("nothing was followed: "), "{nothing}");
    assert_eq!(nothing["facts"]["gravity_known"], "given");
}

#[test]
fn frames_of_a_pipe_are_followed_as_they_come() {
    use std::io::{BufRead, BufReader, Write};
    let mut program = Command::new(env!("CARGO_BIN_EXE_rigidformer"))
        .args(["track", "-", "--up", "0,0,1"])
        .stdin(Stdio::piped())
        .stdout(Stdio::piped())
        .spawn()
        .unwrap();
    let mut stdin = program.stdin.take().unwrap();
    let mut lines = BufReader::new(program.stdout.take().unwrap()).lines();
    for frame in 0..4 {
        let is_box = |at: usize| (40..90).contains(&(at % 160)) && (40..90).contains(&(at / 160));
        let depths = (0..160 * 120).map(|at| if is_box(at) { 300_u16 } else { 500 });
        let bytes: Vec<u8> = depths.flat_map(u16::to_le_bytes).collect();
        let head = format!(
            r#"{{"time_s":{},"width":160,"height":120,"fx":140,"fy":140,"cx":80,"cy":60,"depth_scale_m":0.001,"pose":[0,0,0.5,0,1,0,0]}}"#,
            f64::from(frame) / 30.0
        );
        writeln!(stdin, "{head}").unwrap();
        stdin.write_all(&bytes).unwrap();
        stdin.flush().unwrap();
        // Its line comes before the next frame goes.
        let line: Value = serde_json::from_str(&lines.next().unwrap().unwrap()).unwrap();
        let units = line["units"].as_array().unwrap();
        assert_eq!(units.len(), usize::from(frame > 0), "{line}");
        assert_eq!(line["planes"].as_array().unwrap().len(), 1);
        for unit in units {
            assert_eq!(unit["rest"], "supported");
            assert_eq!(unit["covariance"].as_array().map(Vec::len), Some(6));
        }
        assert_eq!(line["predicted"].as_array().map(Vec::len), Some(4));
        assert_eq!(line["gravity_known"], "given");
    }
    drop(stdin);
    assert!(lines.next().is_none());
    assert!(program.wait().unwrap().success());
}

#[test]
fn what_cannot_be_read_is_told_and_the_rest_is_followed() {
    let folder = tempfile::tempdir().unwrap();
    let clouds = folder.path().join("clouds");
    fs::create_dir(&clouds).unwrap();
    let header = "ply\nformat ascii 1.0\nelement vertex 2\nproperty float x\nproperty float y\n\
        property float z\nend_header\n";
    for number in [1, 2, 10, 11] {
        fs::write(clouds.join(format!("{number}.ply")), format!("{header}0 0 1\nnan 0 1\n"))
            .unwrap();
    }
    fs::write(clouds.join("2.ply"), "ply\n").unwrap();
    fs::write(clouds.join("._1.ply"), [0; 9]).unwrap();
    let told = run(&["track", path(&clouds), "--rate", "10", "--no-model", "--json"]);
    let stderr = String::from_utf8(told.stderr).unwrap();
    assert!(told.status.success(), "{stderr}");
    for part in ["2.ply", "hidden files", "._1.ply"] {
        assert!(stderr.contains(part), "{stderr}");
    }
    let document: Value = serde_json::from_slice(&told.stdout).unwrap();
    assert_eq!(document["captures"], 3);
    let notes = document["notes"].as_array().unwrap();
    assert!(notes.iter().any(|note| note.as_str().unwrap().contains("2.ply")), "{notes:?}");
    fails(&["track", path(&clouds), "--latency", "11"], 2, &["--latency"]);
    fs::write(folder.path().join("a.db3"), b"SQLite format 3\0").unwrap();
    fails(&["track", path(&folder.path().join("a.db3"))], 1, &["a.db3", "mcap convert"]);
}
