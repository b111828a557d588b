//! `rigidformer import` and `rigidformer pack --header` as a user meets them.
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)]

use std::io::Write;
use std::path::{Path, PathBuf};
use std::process::{Command, Output, Stdio};

use rigidformer_evaluation::scenes::{Dataset, Split};
use tempfile::TempDir;

const NANO: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/../../weights/models/nano.rfm");
const SCENE: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/scenes/default.safetensors");
const HEADER: &str = "time_s,unit,x,y,z,qw,qx,qy,qz\n";

fn run(folder: &Path, arguments: &[&str]) -> Output {
    let mut program = Command::new(env!("CARGO_BIN_EXE_rigidformer"));
    program.args(arguments).current_dir(folder).stdin(Stdio::null()).output().unwrap()
}

fn works(folder: &Path, arguments: &[&str]) -> String {
    let output = run(folder, arguments);
    let stderr = String::from_utf8_lossy(&output.stderr);
    assert!(output.status.success(), "{arguments:?}: {stderr}");
    String::from_utf8(output.stdout).unwrap()
}

/// Runs what must fail, say all of this, and write nothing.
fn fails(folder: &Path, arguments: &[&str], expected: &[&str]) {
    let output = run(folder, arguments);
    let stderr = String::from_utf8_lossy(&output.stderr);
    assert!(!output.status.success(), "{arguments:?} must fail");
    for part in expected {
        assert!(stderr.contains(part), "{arguments:?}: no {part:?} in: {stderr}");
    }
    assert!(!folder.join("out.safetensors").exists(), "{arguments:?} wrote a file");
}

/// x, y, z, qw, qx, qy, qz of unit `unit` at `frame`; every number is exact in f32.
fn pose(frame: usize, unit: usize) -> [f32; 7] {
    let half = 0.5 * 0.125 * frame as f32;
    let (sine, cosine) = half.sin_cos();
    [0.25 * frame as f32, unit as f32, 1.0 - 0.125 * frame as f32, cosine, 0.0, 0.0, sine]
}

fn csv(frames: usize) -> String {
    let mut text = HEADER.to_owned();
    for frame in 0..frames {
        for (unit, name) in ["cup", "table"].iter().enumerate() {
            let numbers = pose(frame, unit).map(|number| number.to_string()).join(",");
            text += &format!("{:.6},{name},{numbers}\n", frame as f64 / 30.0);
        }
    }
    text
}

/// An npz file of stored arrays: name, dtype, shape and bytes of each.
fn npz(path: &Path, arrays: &[(&str, &str, &str, Vec<u8>)]) {
    let mut archive = zip::ZipWriter::new(std::fs::File::create(path).unwrap());
    for (place, (name, dtype, shape, bytes)) in arrays.iter().enumerate() {
        let method = match place % 2 {
            0 => zip::CompressionMethod::Stored,
            _ => zip::CompressionMethod::Deflated,
        };
        let options = zip::write::SimpleFileOptions::default().compression_method(method);
        archive.start_file(format!("{name}.npy"), options).unwrap();
        let mut header =
            format!("{{'descr': '{dtype}', 'fortran_order': False, 'shape': {shape}, }}");
        while !(header.len() + 11).is_multiple_of(64) {
            header.push(' ');
        }
        header.push('\n');
        archive.write_all(b"\x93NUMPY\x01\x00").unwrap();
        archive.write_all(&(header.len() as u16).to_le_bytes()).unwrap();
        archive.write_all(header.as_bytes()).unwrap();
        archive.write_all(bytes).unwrap();
    }
    archive.finish().unwrap();
}

fn f32s(values: impl IntoIterator<Item = f32>) -> Vec<u8> {
    values.into_iter().flat_map(f32::to_le_bytes).collect()
}

fn f64s(values: impl IntoIterator<Item = f64>) -> Vec<u8> {
    values.into_iter().flat_map(f64::to_le_bytes).collect()
}

fn poses(frames: usize, units: usize) -> Vec<u8> {
    f32s((0..frames).flat_map(|frame| (0..units).flat_map(move |unit| pose(frame, unit))))
}

fn folder() -> TempDir {
    tempfile::tempdir().unwrap()
}

fn write(folder: &TempDir, name: &str, text: &str) -> PathBuf {
    let path = folder.path().join(name);
    std::fs::write(&path, text).unwrap();
    path
}

#[track_caller]
fn has_poses(path: &Path, frames: usize) {
    let dataset = Dataset::open(path).unwrap();
    let scene = dataset.scene(0, None).unwrap();
    assert_eq!(scene.frames(), frames);
    for (unit, recorded) in scene.units().iter().enumerate() {
        for (frame, found) in recorded.poses.iter().enumerate() {
            let expected = pose(frame, unit);
            let (t, q) = (found.translation.vector, found.rotation.quaternion());
            let found = [t.x, t.y, t.z, q.w, q.i, q.j, q.k];
            for (a, b) in found.iter().zip(expected) {
                assert!((a - b).abs() <= 1e-7, "frame {frame}: {found:?}, not {expected:?}");
            }
        }
    }
}

#[test]
fn poses_from_csv_come_back() {
    let folder = folder();
    write(&folder, "poses.csv", &csv(12));
    write(&folder, "points.csv", "unit,x,y,z\ncup,0,0,0\ncup,1,0,0\ncup,0,1,0\ncup,0,0,1\n");
    let arguments = [
        "import",
        "poses.csv",
        "--points",
        "points.csv",
        "--box",
        "*=1,2,0.5",
        "--physics",
        "cup=0.3,0.7,0.2",
        "--driven",
        "table",
        "--ground",
        "0.6,0.1",
        "--plane",
        "1,0,0,-2,0.5,0.5",
        "--gravity",
        "0,0,-9.8",
        "--out",
        "out.safetensors",
    ];
    let said = works(folder.path(), &arguments);
    assert!(said.contains("1 scenes of 12 to 12 frames at 30 Hz; 1 to learn from"), "{said}");
    let path = folder.path().join("out.safetensors");
    has_poses(&path, 12);
    let dataset = Dataset::open(&path).unwrap();
    assert_eq!((dataset.frame_rate_hz(), dataset.gravity_m_s2()), (30.0, [0.0, 0.0, -9.8]));
    let scene = dataset.scene(0, None).unwrap();
    let [cup, table] = scene.units() else { panic!("two units") };
    assert_eq!((cup.points.len(), table.points.len()), (4, 64));
    assert_eq!((cup.physics.mass_kg, cup.physics.friction, table.physics.mass_kg), (0.3, 0.7, 1.0));
    assert_eq!(table.role, rigidformer_core::Role::Driven);
    let planes = scene.planes().unwrap();
    assert_eq!((planes.len(), planes[0].friction, planes[1].offset_m), (2, 0.6, -2.0));
    // The same again gives the same bytes.
    let before = std::fs::read(&path).unwrap();
    works(folder.path(), &arguments);
    assert_eq!(std::fs::read(&path).unwrap(), before);
    assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 3, "no temporary file is left");
}

#[test]
fn poses_from_npz_come_back() {
    let folder = folder();
    let corners: Vec<f32> = (0..24).map(|k| if (k * 7) % 5 < 2 { 0.5 } else { -0.5 }).collect();
    npz(
        &folder.path().join("poses.npz"),
        &[
            ("poses", "<f4", "(9, 2, 7)", poses(9, 2)),
            ("fps", "<f8", "()", f64s([120.0])),
            ("points_cup", "<f4", "(8, 3)", f32s(corners.clone())),
            ("points_table", "<f8", "(8, 3)", f64s(corners.iter().copied().map(f64::from))),
        ],
    );
    works(folder.path(), &["import", "poses.npz", "--out", "out.safetensors"]);
    let path = folder.path().join("out.safetensors");
    has_poses(&path, 9);
    let dataset = Dataset::open(&path).unwrap();
    assert_eq!(dataset.frame_rate_hz(), 120.0);
    let scene = dataset.scene(0, None).unwrap();
    let names: Vec<&str> = scene.units().iter().map(|unit| unit.shape.as_str()).collect();
    assert_eq!(names, ["cup", "table"]);
    let found: Vec<f32> = scene.units()[1].points.iter().flat_map(|p| [p.x, p.y, p.z]).collect();
    assert_eq!(found, corners);
}

/// Runs what must work, and gives what it says on stderr.
fn notes(folder: &Path, arguments: &[&str]) -> String {
    let output = run(folder, arguments);
    let stderr = String::from_utf8_lossy(&output.stderr).into_owned();
    assert!(output.status.success(), "{arguments:?}: {stderr}");
    stderr
}

/// A cube that flies for 20 frames at 60 Hz, from .5 m in front of the origin and 1 m above: x, height.
fn flight(frame: usize) -> [f64; 2] {
    let time_s = frame as f64 / 60.0;
    [0.5 + 0.6 * time_s, 1.0 + 2.0 * time_s - 4.905 * time_s * time_s]
}

fn flight_csv(scale: f64, pose: impl Fn(usize) -> Option<[f64; 2]>) -> String {
    let row = |frame: usize| {
        let [x, z] = pose(frame)?;
        Some(format!("{},cube,{x},0,{z},1,0,0,0\n", frame as f64 / 60.0 * scale))
    };
    HEADER.to_owned() + &(0..20).filter_map(row).collect::<String>()
}

const CUBE: [&str; 4] = ["--box", "*=.1,.1,.1", "--out", "out.safetensors"];

fn import_cube<'a>(name: &'a str, more: &[&'a str]) -> Vec<&'a str> {
    [&["import", name], &CUBE[..], more].concat()
}

/// Whether the first unit of the file flies as `flight` says.
fn flies(folder: &TempDir, frames: usize) {
    let path = folder.path().join("out.safetensors");
    let dataset = Dataset::open(&path).unwrap();
    assert!((dataset.frame_rate_hz() - 60.0).abs() < 1e-3, "{}", dataset.frame_rate_hz());
    let scene = dataset.scene(0, None).unwrap();
    assert_eq!(scene.frames(), frames);
    for frame in 0..frames {
        let place = scene.poses_at(frame).unwrap()[0].translation.vector;
        let [x, z] = flight(frame);
        let off = place - nalgebra::Vector3::new(x as f32, 0.0, z as f32);
        // Lost frames lie on the chord of the parabola.
        assert!(off.norm() < 4e-3, "{frame}: {place}");
    }
    std::fs::remove_file(path).unwrap();
}

#[test]
fn lost_frames_at_the_origin_are_taken_out() {
    let folder = folder();
    for lost in [vec![12, 13], vec![3, 9, 17], vec![10]] {
        let at = |frame: usize| Some(if lost.contains(&frame) { [0.0; 2] } else { flight(frame) });
        write(&folder, "a.csv", &flight_csv(1.0, at));
        let note = notes(folder.path(), &import_cube("a.csv", &[]));
        let count = format!("{} poses of unit cube are the origin", lost.len());
        assert!(note.contains(&count) && note.contains("lost"), "{note}");
        flies(&folder, 20);
    }
    // What begins at the origin, and what lies there, is seen.
    for speed in [0.0, 0.01] {
        write(&folder, "a.csv", &flight_csv(1.0, |frame| Some([speed * frame as f64, 0.0])));
        let note = notes(folder.path(), &import_cube("a.csv", &[]));
        assert!(!note.contains("lost"), "{note}");
    }
    std::fs::remove_file(folder.path().join("out.safetensors")).unwrap();
    // Lost for too long is a gap.
    let at = |frame| Some(if (5..15).contains(&frame) { [0.0; 2] } else { flight(frame) });
    write(&folder, "a.csv", &flight_csv(1.0, at));
    fails(folder.path(), &import_cube("a.csv", &[]), &["lost", "has a gap of"]);
}

#[test]
fn other_units_of_time_and_length_are_doubted_and_converted() {
    let folder = folder();
    for (factor, unit, scale) in [
        (1e3, "milliseconds", "0.001"),
        (1e6, "microseconds", "1e-6"),
        (1e9, "nanoseconds", "1e-9"),
    ] {
        write(&folder, "a.csv", &flight_csv(factor, |frame| Some(flight(frame))));
        let note = notes(folder.path(), &import_cube("a.csv", &[]));
        assert!(note.contains(unit) && note.contains(&format!("--time-scale {scale}")), "{note}");
        let note = notes(folder.path(), &import_cube("a.csv", &["--time-scale", scale]));
        assert!(!note.contains("--time-scale"), "{note}");
        flies(&folder, 20);
    }
    write(&folder, "a.csv", &flight_csv(1.0, |frame| Some(flight(frame).map(|v| v * 1e3))));
    works(folder.path(), &import_cube("a.csv", &["--scale", ".001"]));
    flies(&folder, 20);
    fails(folder.path(), &import_cube("a.csv", &["--scale", "0"]), &["--scale"]);
    fails(folder.path(), &import_cube("a.csv", &["--time-scale", "0"]), &["--time-scale"]);
}

#[test]
fn rows_that_repeat_or_go_back_are_sorted_if_told() {
    let folder = folder();
    let whole = flight_csv(1.0, |frame| Some(flight(frame)));
    let mut lines: Vec<&str> = whole.lines().collect();
    lines.swap(5, 9);
    let foul = format!("{}cube", &lines[12][..lines[12].find("cube").unwrap()]) + ",7,7,7,1,0,0,0";
    lines.insert(13, &foul);
    write(&folder, "a.csv", &lines.join("\n"));
    fails(folder.path(), &import_cube("a.csv", &[]), &["line 7", "back", "--repeats keep-first"]);
    let note = notes(folder.path(), &import_cube("a.csv", &["--repeats", "keep-first"]));
    assert!(note.contains("rows of unit cube are not later"), "{note}");
    flies(&folder, 20);
    lines.swap(12, 13);
    write(&folder, "a.csv", &lines.join("\n"));
    works(folder.path(), &import_cube("a.csv", &["--repeats", "keep-last"]));
    flies(&folder, 20);
}

/// A take of a cube that flies, as Motive exports it, with a marker of it; rows that are told are blank.
fn motive(head: &str, scale: f64, blank: &[usize]) -> String {
    let columns = |first: &str, body: &str, marker: &str| {
        format!("{first},{}\n", [[body; 7].join(","), [marker; 3].join(",")].join(","))
    };
    let mut text = format!(
        "Format Version,1.23,Take Name,Take 1,Export Frame Rate,60.000000{head},Coordinate Space,Global\n\n"
    );
    text += &columns(",Type", "Rigid Body", "Rigid Body Marker");
    text += &columns(",Name", "cube", "cube:Marker1");
    text += &columns(",ID", "A1", "A2");
    text += ",,Rotation,Rotation,Rotation,Rotation,Position,Position,Position,Position,Position,Position\n";
    text += "Frame,Time (Seconds),X,Y,Z,W,X,Y,Z,X,Y,Z\n";
    for frame in 0..20 {
        let [x, up] = flight(frame).map(|v| v * scale);
        let pose = match blank.contains(&frame) {
            true => ",,,,,,".to_owned(),
            // A quarter turn about the vertical.
            false => format!("0,0.70710678,0,0.70710678,{x},{up},0"),
        };
        text += &format!("{frame},{:.6},{pose},,,\n", frame as f64 / 60.0);
    }
    text
}

#[test]
fn motive_is_read() {
    let folder = folder();
    let metres = ",Rotation Type,Quaternion,Length Units,Meters";
    for (head, scale, blank) in [
        (metres, 1.0, vec![]),
        (",Rotation Type,Quaternion,Length Units,Millimeters", 1e3, vec![7]),
        ("", 1.0, vec![2, 3, 11]),
    ] {
        write(&folder, "take.csv", &motive(head, scale, &blank));
        let note = notes(folder.path(), &import_cube("take.csv", &[]));
        assert!(note.contains("y up"), "{note}");
        let lost = format!("cube is not seen in {} frames", blank.len());
        assert_eq!(note.contains(&lost), !blank.is_empty(), "{note}");
        let out = Dataset::open(&folder.path().join("out.safetensors")).unwrap();
        let scene = out.scene(0, None).unwrap();
        assert_eq!(scene.units().len(), 1);
        let turn = scene.poses_at(4).unwrap()[0].rotation.scaled_axis();
        let quarter = nalgebra::Vector3::z() * std::f32::consts::FRAC_PI_2;
        assert!((turn - quarter).norm() < 1e-5, "{turn}");
        flies(&folder, 20);
    }
    let whole = motive(metres, 1.0, &[]);
    for (from, to, expected) in [
        ("Quaternion", "XYZ", "Rotation Type \"XYZ\""),
        ("Meters", "Furlongs", "Length Units \"furlongs\""),
        ("Global", "Local", "Coordinate Space \"Local\""),
        ("Frame,Time", "Time,Frame", "no row Frame"),
        ("Rigid Body,", "Marker,", "has no rigid bodies"),
        ("Rotation,Rotation", "Rotation,Quality", "cube lacks a column"),
        ("\n5,", "\n5,x", "line 13, column 2: \"x0.083333\" is not a number"),
    ] {
        let count = if from == "Rigid Body," { 9 } else { 1 };
        write(&folder, "take.csv", &whole.replacen(from, to, count));
        fails(folder.path(), &import_cube("take.csv", &[]), &["take.csv", expected]);
    }
    write(&folder, "take.csv", &motive(metres, 1.0, &(0..20).collect::<Vec<_>>()));
    fails(folder.path(), &import_cube("take.csv", &[]), &["no rigid body was seen"]);
    write(&folder, "take.c3d", "");
    fails(folder.path(), &import_cube("take.c3d", &[]), &["take.c3d", "markers", "CSV"]);
}

/// A transform in JSON, as `foxglove.FrameTransform` has it: seconds, parent, child, pose.
fn transform(time_s: f64, parent: &str, child: &str, pose: [f32; 7]) -> serde_json::Value {
    let [x, y, z, qw, qx, qy, qz] = pose.map(f64::from);
    let nanoseconds = (time_s.fract() * 1e9).round() as u64;
    serde_json::json!({
        "timestamp": {"sec": 100 + time_s as u64, "nsec": nanoseconds},
        "parent_frame_id": parent, "child_frame_id": child,
        "translation": {"x": x, "y": y, "z": z}, "rotation": {"x": qx, "y": qy, "z": qz, "w": qw},
    })
}

fn mcap(path: &Path, transforms: &[serde_json::Value]) {
    let mut writer =
        mcap::Writer::new(std::io::BufWriter::new(std::fs::File::create(path).unwrap())).unwrap();
    let schema = writer.add_schema("foxglove.FrameTransform", "jsonschema", b"").unwrap();
    let nothing = std::collections::BTreeMap::new();
    let channel_id = writer.add_channel(schema, "/tf", "json", &nothing).unwrap();
    for (sequence, transform) in (0..).zip(transforms) {
        let (log_time, publish_time) = (sequence.into(), sequence.into());
        let header = mcap::records::MessageHeader { channel_id, sequence, log_time, publish_time };
        writer.write_to_known_channel(&header, transform.to_string().as_bytes()).unwrap();
    }
    writer.finish().unwrap();
}

#[test]
fn poses_from_mcap_come_back() {
    let folder = folder();
    let mut transforms = Vec::new();
    for frame in 0..6 {
        for (unit, name) in ["cup", "table"].iter().enumerate() {
            let time_s = (f64::from(frame) / 30.0 * 1e6).round() / 1e6;
            transforms.push(transform(time_s, "world", name, pose(frame as usize, unit)));
        }
    }
    mcap(&folder.path().join("a.mcap"), &transforms);
    let boxes = ["--box", "*=0.1,0.1,0.1", "--out", "out.safetensors"];
    works(folder.path(), &[&["import", "a.mcap"], &boxes[..]].concat());
    has_poses(&folder.path().join("out.safetensors"), 6);
}

#[test]
fn frames_in_frames_are_carried_to_the_world() {
    let folder = folder();
    let still = |x: f32| [x, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0];
    // A robot drives, a hand on it lifts a cup, and a shelf stands where it always was.
    let mut transforms = vec![transform(0.0, "map", "shelf", still(9.0))];
    for frame in 0..8 {
        let time_s = f64::from(frame) / 10.0;
        transforms.push(transform(time_s, "map", "robot", still(frame as f32)));
        let lift = [0.5, 0.0, 0.125 * frame as f32, 1.0, 0.0, 0.0, 0.0];
        transforms.push(transform(time_s, "robot", "hand", lift));
    }
    transforms.push(transform(0.0, "hand", "cup", still(0.25)));
    mcap(&folder.path().join("a.mcap"), &transforms);
    let line = |units: &[&'static str]| -> Vec<&str> {
        let units = units.iter().flat_map(|unit| ["--unit", unit]);
        let rest = ["--box", "*=.1,.1,.1", "--fixed", "shelf", "--out", "out.safetensors"];
        ["import", "a.mcap"].into_iter().chain(units).chain(rest).collect()
    };
    works(folder.path(), &line(&["cup", "shelf"]));
    let out = folder.path().join("out.safetensors");
    let scene = Dataset::open(&out).unwrap().scene(0, None).unwrap();
    let names: Vec<&str> = scene.units().iter().map(|unit| unit.shape.as_str()).collect();
    assert_eq!(names, ["shelf", "cup"]);
    for frame in 0..8 {
        let poses = scene.poses_at(frame).unwrap();
        let place = |unit: usize| poses[unit].translation.vector;
        assert_eq!(place(0).x, 9.0);
        let wanted = nalgebra::Vector3::new(frame as f32 + 0.75, 0.0, 0.125 * frame as f32);
        assert!((place(1) - wanted).norm() < 1e-6, "{frame}: {}", place(1));
    }
    std::fs::remove_file(&out).unwrap();
    fails(folder.path(), &line(&["mug", "shelf"]), &["--unit", "unknown unit mug"]);
    fails(folder.path(), &line(&["mug"]), &["--unit", "cup, hand, robot, shelf"]);

    transforms.push(transform(0.0, "odom", "cart", still(0.0)));
    transforms.push(transform(0.1, "odom", "cart", still(0.0)));
    mcap(&folder.path().join("a.mcap"), &transforms);
    fails(folder.path(), &line(&["cup", "shelf", "cart"]), &["\"map\"", "\"odom\"", "--unit"]);
    transforms.push(transform(0.2, "map", "cart", still(0.0)));
    mcap(&folder.path().join("a.mcap"), &transforms);
    fails(folder.path(), &line(&["cup", "shelf"]), &["a.mcap", "cart", "two files"]);
    let circle = [("a", "b"), ("b", "a")].map(|(parent, child)| {
        [0.0, 0.1, 0.2].map(|time_s| transform(time_s, parent, child, still(1.0)))
    });
    mcap(&folder.path().join("a.mcap"), &circle.concat());
    let all = ["import", "a.mcap", "--box", "*=.1,.1,.1", "--out", "out.safetensors"];
    fails(folder.path(), &all, &["a.mcap", "tree of frames"]);
    mcap(&folder.path().join("a.mcap"), &[transform(0.0, "map", "shelf", still(9.0))]);
    fails(folder.path(), &all, &["nothing moves"]);
}

/// Ten frames of a cup on a robot that drives, each of whose transforms is `robot`.
fn cup_on_a_robot(robot: &[serde_json::Value]) -> Vec<serde_json::Value> {
    let cup = (0..10).map(|frame| {
        let time_s = f64::from(frame) / 10.0;
        transform(time_s, "robot", "cup", [0.25 * frame as f32, 0.0, 1.0, 1.0, 0.0, 0.0, 0.0])
    });
    robot.iter().cloned().chain(cup).collect()
}

const CUP: [&str; 8] =
    ["import", "a.mcap", "--unit", "cup", "--box", "*=.1,.1,.1", "--out", "out.safetensors"];

#[test]
fn a_static_transform_that_is_said_again_holds_always() {
    let folder = folder();
    let here = [1.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0];
    let twice = [0.0, 0.3].map(|time_s| transform(time_s, "map", "robot", here));
    mcap(&folder.path().join("a.mcap"), &cup_on_a_robot(&twice));
    let out = folder.path().join("out.safetensors");
    let all = ["import", "a.mcap", "--box", "*=.1,.1,.1", "--out", "out.safetensors"];
    for (line, units) in [(&CUP[..], 1), (&all[..], 2)] {
        works(folder.path(), line);
        let scene = Dataset::open(&out).unwrap().scene(0, None).unwrap();
        assert_eq!((scene.units().len(), scene.frames()), (units, 10));
        let place = scene.poses_at(9).unwrap()[units - 1].translation.vector;
        assert_eq!([place.x, place.z], [3.25, 1.0]);
    }
}

#[test]
fn poses_below_a_frame_that_is_not_known_then_are_counted() {
    let folder = folder();
    let robot = |times_s: [f64; 3]| {
        times_s.map(|s| transform(s, "map", "robot", [s as f32, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0]))
    };
    mcap(&folder.path().join("a.mcap"), &cup_on_a_robot(&robot([5.0, 5.1, 5.2])));
    let parts =
        ["a.mcap: unit cup: at none of its 10 instants", "record the transforms of robot over"];
    fails(folder.path(), &CUP, &parts);

    mcap(&folder.path().join("a.mcap"), &cup_on_a_robot(&robot([0.3, 0.5, 2.0])));
    let output = run(folder.path(), &CUP);
    let said = String::from_utf8_lossy(&output.stderr);
    assert!(output.status.success(), "{said}");
    assert!(said.contains("a.mcap: unit cup: 3 of 10 poses are left out"), "{said}");
    let scene =
        Dataset::open(&folder.path().join("out.safetensors")).unwrap().scene(0, None).unwrap();
    assert_eq!(scene.frames(), 7);
}

#[test]
fn a_frame_in_two_places_at_once_is_refused_where_a_unit_hangs_in_it() {
    let folder = folder();
    let robot = |parent: &str, name: &str, x: f32| {
        [0.0, 0.5, 1.0].map(|s| transform(s, parent, name, [x, s as f32, 0.0, 1.0, 0.0, 0.0, 0.0]))
    };
    let mut both = [robot("map", "robot", 0.0), robot("map", "robot", 1.0)].concat();
    mcap(&folder.path().join("a.mcap"), &cup_on_a_robot(&both));
    let parts = ["a.mcap: frame robot has two poses at 0.000000 s", "record one of them"];
    fails(folder.path(), &CUP, &parts);
    // One that no unit hangs in does no harm.
    both =
        [robot("map", "robot", 0.0), robot("map", "dog", 0.0), robot("map", "dog", 1.0)].concat();
    mcap(&folder.path().join("a.mcap"), &cup_on_a_robot(&both));
    works(folder.path(), &CUP);
}

#[test]
fn a_recording_without_the_units_asked_for_says_which_it_has() {
    let folder = folder();
    write(&folder, "a.csv", &csv(6));
    write(&folder, "b.csv", &csv(6).replace("cup", "mug"));
    let rest = ["--box", "*=.1,.1,.1", "--out", "out.safetensors"];
    let line = [&["import", "a.csv", "b.csv", "--unit", "cup"], &rest[..]].concat();
    fails(folder.path(), &line, &["b.csv: has none of the units of --unit", "mug, table"]);
    mcap(&folder.path().join("b.mcap"), &cup_on_a_robot(&[]));
    let line = [&["import", "a.csv", "b.mcap", "--unit", "table"], &rest[..]].concat();
    fails(folder.path(), &line, &["b.mcap: has none of the units of --unit", "it has cup"]);
}

/// What `rollout --mcap` wrote for a viewer is a recording.
#[test]
fn a_rollout_for_viewers_is_read_back() {
    let folder = folder();
    let rollout = ["rollout", "--step", "5", "--frames", "30", "--mcap", "seen.mcap"];
    works(folder.path(), &[&rollout[..], &["--model", NANO]].concat());
    let all = ["import", "seen.mcap", "--box", "*=.1,.1,.1", "--out", "out.safetensors"];
    works(folder.path(), &all);
    let scene =
        Dataset::open(&folder.path().join("out.safetensors")).unwrap().scene(0, None).unwrap();
    assert!(scene.units().len() >= 5 && scene.frames() >= 6);
}

#[test]
fn other_rates_are_interpolated_and_splits_come_from_the_seed() {
    let folder = folder();
    let names: Vec<String> = (0..10).map(|k| format!("{k}.csv")).collect();
    for name in &names {
        write(&folder, name, &csv(20));
    }
    let mut arguments = vec!["import"];
    arguments.extend(names.iter().map(String::as_str));
    arguments.extend([
        "--box",
        "*=1,1,1",
        "--fps",
        "45",
        "--open-loop",
        "--json",
        "--out",
        "out.safetensors",
    ]);
    let document: serde_json::Value =
        serde_json::from_str(&works(folder.path(), &arguments)).unwrap();
    let counts = ["train", "validation", "test"].map(|split| document[split].as_u64().unwrap());
    assert_eq!(counts, [7, 1, 2]);
    let dataset = Dataset::open(&folder.path().join("out.safetensors")).unwrap();
    assert_eq!(dataset.scenes_of(Split::Test).len(), 2);
    assert!(dataset.has_velocities());
    let scene = dataset.scene(0, None).unwrap();
    let pose = scene.pose(1, 0).unwrap(); // 1/45 s: two thirds of the way to frame 1
    assert!((pose.translation.x - 0.25 * 2.0 / 3.0).abs() < 1e-5, "{pose}");
    assert!((pose.rotation.angle() - 0.125 * 2.0 / 3.0).abs() < 1e-5, "{pose}");
    let again = document["scenes"].clone();
    arguments.extend(["--seed", "1"]);
    let other: serde_json::Value = serde_json::from_str(&works(folder.path(), &arguments)).unwrap();
    assert_ne!(again, other["scenes"], "another seed, other splits");
}

#[test]
fn mistakes_in_csv_are_named() {
    let good = "0.0,a,0,0,0,1,0,0,0\n0.1,a,0,0,0,1,0,0,0\n0.2,a,0,0,0,1,0,0,0\n";
    let cases: [(&str, String, &[&str]); 11] = [
        ("empty", String::new(), &["bad.csv: is empty"]),
        ("no rows", HEADER.into(), &["has a header and no rows"]),
        ("no column", "time_s,unit,x,y,z,qw,qx,qy\n".into(), &["line 1: has no column qz"]),
        (
            "no number",
            format!("{HEADER}0,a,0,zero,0,1,0,0,0\n"),
            &["line 2, column y: \"zero\" is not a number"],
        ),
        (
            "NaN",
            format!("{HEADER}{good}0.3,a,0,0,nan,1,0,0,0\n"),
            &["line 5, z: NaN is not a finite number", "leave out frames"],
        ),
        (
            "length",
            format!("{HEADER}0,a,0,0,0,1,1,0,0\n"),
            &["line 2: the quaternion of unit a has length 1.4142"],
        ),
        (
            "back",
            format!("{HEADER}{good}0.1,a,0,0,0,1,0,0,0\n"),
            &["line 5: time runs from 0.2 back to 0.1 s", "sort the rows"],
        ),
        (
            "gap",
            format!("{HEADER}{good}0.9,a,0,0,0,1,0,0,0\n"),
            &["unit a has a gap of 0.7000 s at 0.2 s", "--gap"],
        ),
        ("fields", format!("{HEADER}0,a,0\n"), &["line 2: has 3 fields, not the 9 of the header"]),
        ("one pose", format!("{HEADER}0,a,0,0,0,1,0,0,0\n"), &["unit a has a single pose"]),
        ("no name", format!("{HEADER}0,,0,0,0,1,0,0,0\n"), &["line 2, column unit: is empty"]),
    ];
    for (what, text, expected) in cases {
        let folder = folder();
        write(&folder, "bad.csv", &text);
        println!("{what}");
        fails(
            folder.path(),
            &["import", "bad.csv", "--box", "*=1,1,1", "--out", "out.safetensors"],
            expected,
        );
    }
    let folder = folder();
    write(&folder, "good.csv", &format!("{HEADER}{good}"));
    write(&folder, "points.csv", "unit,x,y,z\nb,0,0,0\n");
    write(&folder, "few.csv", "unit,x,y,z\na,0,0,0\n");
    write(&folder, "nan.csv", "unit,x,y,z\na,0,inf,0\n");
    let cases: [(&[&str], &[&str]); 10] = [
        (&[], &["unit a has no points", "--box a=A,B,C"]),
        (&["--points", "few.csv"], &["unit a has 1 points; a unit needs at least 4"]),
        (&["--points", "nan.csv"], &["nan.csv: line 2, column y: inf is not a finite number"]),
        (&["--points", "points.csv"], &["--points: unknown unit b", "they have a"]),
        (&["--box", "c=1,1,1"], &["--box: unknown unit c"]),
        (&["--box", "a=1,1"], &["--box 1,1: takes 3 finite numbers"]),
        (&["--box", "a=1,1,0"], &["give lengths above 0"]),
        (&["--box", "a=1,1,1", "--sphere", "a=1"], &["was given by --box already"]),
        (&["--box", "a=1,1,1", "--plane", "0,0,2,0,1,1"], &["normal of length 1"]),
        (
            &["--box", "a=1,1,1", "--test-share", "0.7", "--validation-share", "0.7"],
            &["more than 1 together"],
        ),
    ];
    for (more, expected) in cases {
        let mut arguments = vec!["import", "good.csv", "--out", "out.safetensors"];
        arguments.extend(more);
        fails(folder.path(), &arguments, expected);
    }
    fails(
        folder.path(),
        &["import", "none.csv", "--out", "out.safetensors"],
        &["none.csv: cannot be read"],
    );
    write(&folder, "cloud.ply", "");
    fails(
        folder.path(),
        &["import", "cloud.ply", "--out", "out.safetensors"],
        &["rigidformer track"],
    );
}

#[test]
fn mistakes_in_npz_are_named() {
    type Arrays<'a> = Vec<(&'a str, &'a str, &'a str, Vec<u8>)>;
    let points = || ("points", "<f4", "(4, 3)", f32s((0..12).map(|k| k as f32)));
    let fps = || ("fps", "<i8", "()", 30_i64.to_le_bytes().to_vec());
    let mut nan = poses(3, 1);
    nan[4..8].copy_from_slice(&f32::NAN.to_le_bytes());
    let cases: [(Arrays<'_>, &[&str]); 10] = [
        (vec![fps()], &["has no array poses"]),
        (
            vec![("poses", "<f4", "(3, 7)", poses(3, 1)), fps()],
            &["poses has shape [3, 7], not (frames, units, 7)"],
        ),
        (vec![("poses", "<f4", "(0, 1, 7)", vec![]), fps()], &["it is empty"]),
        (
            vec![("poses", "<c8", "(3, 1, 7)", poses(3, 2)), fps()],
            &["poses is of dtype <c8; save it as float32"],
        ),
        (vec![("poses", "|O", "(3, 1, 7)", poses(3, 1)), fps()], &["dtype |O"]),
        (
            vec![("poses", "<f4", "(4, 1, 7)", poses(3, 1)), fps()],
            &["poses is damaged or cut short"],
        ),
        (vec![("poses", "<f4", "(3, 1, 7)", poses(3, 1)), points()], &["has neither time nor fps"]),
        (
            vec![
                ("poses", "<f4", "(3, 1, 7)", poses(3, 1)),
                ("time", "<f8", "(2,)", f64s([0.0, 1.0])),
            ],
            &["time has shape [2], not (3,)"],
        ),
        (vec![("poses", "<f4", "(3, 1, 7)", nan), fps(), points()], &["poses[0, 0], y: NaN"]),
        (
            vec![
                ("poses", "<f4", "(3, 1, 7)", poses(3, 1)),
                fps(),
                ("points", "<f4", "(12,)", f32s((0..12).map(|k| k as f32))),
            ],
            &["points has shape [12], not (points, 3)"],
        ),
    ];
    for (arrays, expected) in cases {
        let folder = folder();
        npz(&folder.path().join("bad.npz"), &arrays);
        fails(folder.path(), &["import", "bad.npz", "--out", "out.safetensors"], expected);
    }
    let folder = folder();
    write(&folder, "text.npz", "time_s");
    fails(folder.path(), &["import", "text.npz", "--out", "out.safetensors"], &["is no npz file"]);
    write(&folder, "empty.npz", "");
    fails(folder.path(), &["import", "empty.npz", "--out", "out.safetensors"], &["is empty"]);
}

#[test]
fn a_model_becomes_a_header_that_compiles() {
    let folder = folder();
    let said =
        works(folder.path(), &["pack", NANO, "--header", "--name", "mine", "--out", "model.h"]);
    let bytes = std::fs::read(NANO).unwrap();
    assert!(said.contains(&format!("mine of {} bytes, aligned to 16", bytes.len())), "{said}");
    write(
        &folder,
        "main.c",
        "#include \"model.h\"\n#include <stdint.h>\n#include <stdio.h>\n\
         int main(void) { if ((uintptr_t)mine % 16) return 1; return fwrite(mine, 1, mine_bytes, stdout) != mine_bytes; }\n",
    );
    std::fs::copy(folder.path().join("main.c"), folder.path().join("main.cpp")).unwrap();
    let compilers: [&[&str]; 3] = [
        &["cc", "-std=c99", "main.c"],
        &["cc", "-std=c11", "main.c"],
        &["c++", "-std=c++11", "main.cpp"],
    ];
    for compiler in compilers {
        if Command::new(compiler[0]).arg("--version").output().is_err() {
            eprintln!("skipped: {compiler:?}: there is no {} here", compiler[0]);
            continue;
        }
        let mut command = Command::new(compiler[0]);
        command.args(&compiler[1..]).args(["-Wall", "-Wextra", "-Werror", "-o", "main"]);
        let built = command.current_dir(folder.path()).output().unwrap();
        assert!(built.status.success(), "{compiler:?}: {}", String::from_utf8_lossy(&built.stderr));
        let output = Command::new(folder.path().join("main")).output().unwrap();
        assert!(output.status.success() && output.stdout == bytes, "{compiler:?}");
    }
    write(&folder, "text.rfm", "no model");
    for (arguments, expected) in [
        (
            ["pack", "text.rfm", "--header", "--out", "out.safetensors"].as_slice(),
            "is no packed model",
        ),
        (
            &["pack", NANO, "--header", "--name", "1a", "--out", "out.safetensors"],
            "is no name in C",
        ),
    ] {
        fails(folder.path(), arguments, &[expected]);
    }
}

#[test]
fn nothing_that_is_read_is_written_over() {
    let folder = TempDir::new().unwrap();
    let place = folder.path();
    let poses = place.join("poses.csv");
    std::fs::write(&poses, csv(4)).unwrap();
    std::fs::copy(NANO, place.join("model.rfm")).unwrap();
    let nano = std::fs::read(NANO).unwrap();
    let again = "is what this command reads";
    fails(place, &["import", "poses.csv", "--box", "cup=1,1,1", "--out", "./poses.csv"], &[again]);
    assert_eq!(std::fs::read_to_string(&poses).unwrap(), csv(4));
    fails(place, &["pack", "model.rfm", "--header", "--out", "model.rfm"], &[again]);
    fails(place, &["rollout", "--model", "model.rfm", "--gltf", "model.rfm"], &[again]);
    std::fs::copy(SCENE, place.join("scene.safetensors")).unwrap();
    let model = ["--model", "model.rfm"];
    for out in ["model.rfm", "./scene.safetensors"] {
        let trace = ["trace", "scene.safetensors", "--steps", "1", "--out", out];
        fails(place, &[&trace[..], &model].concat(), &[again]);
        let evaluate = ["evaluate", "scene.safetensors", "--limit", "1", "--picture", out];
        fails(place, &[&evaluate[..], &model].concat(), &[again]);
    }
    std::fs::write(place.join("said.toml"), "run = \"one\"\n").unwrap();
    let said = ["pack", "model.rfm", "--provenance", "said.toml", "--out", "said.toml"];
    fails(place, &said, &[again]);
    let ranges =
        ["pack", "model.rfm", "--ranges", "scene.safetensors", "--out", "scene.safetensors"];
    fails(place, &ranges, &[again]);
    for out in ["model.rfm", "scene.safetensors"] {
        let identify = ["identify", "scene.safetensors", "--out", out];
        fails(place, &[&identify[..], &model].concat(), &[again]);
    }
    let predicted = place.join("predicted.safetensors");
    std::fs::copy(SCENE, &predicted).unwrap();
    fails(place, &["rollout", "predicted.safetensors", "--out", "."], &[again]);
    std::fs::remove_file(predicted).unwrap();
    std::fs::write(place.join("mesh.obj"), "v 0 0 0\n").unwrap();
    fails(place, &["pieces", "mesh.obj", "--out", "mesh.obj"], &[again]);
    assert_eq!(std::fs::read(place.join("model.rfm")).unwrap(), nano);
    let scene = std::fs::read(SCENE).unwrap();
    assert_eq!(std::fs::read(place.join("scene.safetensors")).unwrap(), scene);
}

#[test]
fn numbers_beyond_single_precision_and_impossible_moments_are_refused_by_name() {
    let folder = TempDir::new().unwrap();
    let place = folder.path();
    let far = csv(4).replacen("0.25", "1e39", 1);
    std::fs::write(place.join("far.csv"), far).unwrap();
    std::fs::write(place.join("poses.csv"), csv(4)).unwrap();
    let shapes = ["--box", "cup=1,1,1", "--box", "table=1,1,1", "--out", "out.safetensors"];
    let with = |more: &[&'static str]| [&["import"], more, &shapes].concat();
    fails(place, &with(&["far.csv"]), &["far.csv"]);
    for moments in ["cup=-1,1,1", "cup=0,0,0", "cup=1,1,3"] {
        fails(place, &with(&["poses.csv", "--inertia", moments]), &["--inertia", moments]);
    }
}

#[test]
fn a_rate_that_memory_has_no_room_for_is_refused_before_there_are_poses() {
    let folder = TempDir::new().unwrap();
    let place = folder.path();
    let names: Vec<String> = (0..180).map(|unit| format!("u{unit}")).collect();
    let rows = [0.0, 0.45, 0.9]
        .iter()
        .flat_map(|time| names.iter().map(move |name| format!("{time},{name},0,0,0,1,0,0,0\n")));
    std::fs::write(place.join("many.csv"), HEADER.to_owned() + &rows.collect::<String>()).unwrap();
    let boxes: Vec<String> = names.iter().map(|name| format!("{name}=1,1,1")).collect();
    let boxes = boxes.iter().flat_map(|shape| ["--box", shape]);
    let rate = ["import", "many.csv", "--gap", "1", "--fps", "1000000", "--out", "out.safetensors"];
    let arguments: Vec<&str> = rate.into_iter().chain(boxes).collect();
    fails(place, &arguments, &["180 units of up to 900001 frames", "bytes"]);
}
