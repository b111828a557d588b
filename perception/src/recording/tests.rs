use std::fs;
use std::path::Path;

use nalgebra::{Isometry3, Point3, Vector3};
use rigidformer_runtime::memory::Budget;
use serde_json::{Value, json};
use tempfile::TempDir;

use super::*;
use crate::camera::Camera;
use crate::capture::{DepthView, View};

const SIZE: [u32; 2] = [8, 6];

fn camera(x: f32) -> Camera {
    let pose = Isometry3::new(Vector3::new(x, 0.0, 1.0), Vector3::new(0.1, -0.2, 0.3));
    Camera::new(SIZE, [7.0, 7.5], [3.5, 2.5], pose).unwrap()
}

fn view(camera: Camera, first: u16, labelled: bool) -> DepthView {
    let pixels: Vec<u16> = (0..48).map(|at| first + at).collect();
    let labels = labelled.then(|| pixels.iter().map(|depth| depth % 3).collect());
    DepthView::new(camera, 0.001, pixels, labels).unwrap()
}

/// A recording by two cameras, of which the right one moves and has no labels, `captures` long.
fn recorded(folder: &Path, captures: usize) -> Vec<Capture> {
    let mut recorder = Recorder::new(folder, Some(Vector3::new(0.0, 0.0, -9.81))).unwrap();
    let left = recorder.camera("left", &camera(0.0), 0.001).unwrap();
    let right = recorder.camera("right", &camera(1.0), 0.001).unwrap();
    let capture = |index: usize| {
        let time_s = index as f64 / 30.0;
        let one = view(camera(0.0), 1000 + index as u16, true);
        let other = view(camera(1.0 + index as f32), 2000, false);
        recorder.add(time_s, left, &one).unwrap();
        recorder.add(time_s + 0.0004, right, &other).unwrap();
        Capture { time_s, views: vec![View::Depth(one), View::Depth(other)] }
    };
    let captures = (0..captures).map(capture).collect();
    recorder.finish().unwrap();
    captures
}

fn folder() -> (TempDir, std::path::PathBuf) {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("recording");
    (folder, path)
}

fn manifest(path: &Path) -> Value {
    serde_json::from_slice(&fs::read(path.join("frames.json")).unwrap()).unwrap()
}

/// The error of opening a recording whose `frames.json` was changed.
fn refused(change: impl FnOnce(&mut Value)) -> String {
    let (_folder, path) = folder();
    recorded(&path, 3);
    let mut json = manifest(&path);
    change(&mut json);
    fs::write(path.join("frames.json"), json.to_string()).unwrap();
    open(&path).err().expect("it was opened").to_string()
}

#[test]
fn what_is_written_is_read_again() {
    let (parent, path) = folder();
    let written = recorded(&path, 3);
    let captures = open(&path).unwrap();
    assert_eq!(captures.count_left(), Some(3));
    assert_eq!(captures.size_hint(), (3, Some(3)));
    assert_eq!(captures.gravity_m_s2(), Some(Vector3::new(0.0, 0.0, -9.81)));
    let read: Vec<Capture> = captures.map(Result::unwrap).collect();
    for (read, written) in read.iter().zip(&written) {
        assert_eq!(read.time_s, written.time_s);
        for (read, written) in read.views.iter().zip(&written.views) {
            let (View::Depth(read), View::Depth(written)) = (read, written) else { panic!() };
            assert_eq!((&read.depth, &read.labels), (&written.depth, &written.labels));
            let apart =
                read.camera.pose().to_homogeneous() - written.camera.pose().to_homogeneous();
            assert!(apart.amax() < 1e-5, "{apart}");
        }
    }
    assert_eq!(manifest(&path)["frames"][1].get("pose"), None, "the camera has not moved yet");
    assert!(manifest(&path)["frames"][3].get("pose").is_some());
    assert_eq!(fs::read_dir(parent.path()).unwrap().count(), 1, "nothing temporary stays");
}

#[test]
fn ten_thousand_frames_are_read_one_at_a_time() {
    let (_folder, path) = folder();
    recorded(&path, 1);
    let mut json = manifest(&path);
    let frame = json["frames"][0].clone();
    let frames = (0..10_000).map(|index| {
        let mut frame = frame.clone();
        frame["time_s"] = json!(f64::from(index) / 30.0);
        frame
    });
    json["frames"] = frames.collect();
    fs::write(path.join("frames.json"), json.to_string()).unwrap();
    let captures = open(&path).unwrap();
    assert_eq!(captures.count_left(), Some(10_000));
    assert_eq!(captures.filter(Result::is_ok).count(), 10_000);
}

#[test]
fn a_recorder_that_is_given_up_leaves_nothing() {
    let (parent, path) = folder();
    let mut recorder = Recorder::new(&path, None).unwrap();
    let left = recorder.camera("left", &camera(0.0), 0.001).unwrap();
    recorder.add(0.0, left, &view(camera(0.0), 1, true)).unwrap();
    assert_eq!(fs::read_dir(parent.path()).unwrap().count(), 1);
    drop(recorder);
    assert_eq!(fs::read_dir(parent.path()).unwrap().count(), 0);
    let empty = Recorder::new(&path, None).unwrap().finish().unwrap_err();
    assert!(matches!(empty.problem, CaptureProblem::Empty));
    assert_eq!(fs::read_dir(parent.path()).unwrap().count(), 0);
}

#[test]
fn recorders_refuse_what_cannot_be_read_again() {
    let (_parent, path) = folder();
    let mut recorder = Recorder::new(&path, None).unwrap();
    let left = recorder.camera("left", &camera(0.0), 0.001).unwrap();
    let problem = |error: Result<(), CaptureError>| error.unwrap_err().problem;
    assert!(matches!(
        recorder.camera("left", &camera(0.0), 0.001).unwrap_err().problem,
        CaptureProblem::DuplicateCamera
    ));
    for name in ["", "a/b", "..", "ä"] {
        let error = recorder.camera(name, &camera(0.0), 0.001).unwrap_err();
        assert!(matches!(error.problem, CaptureProblem::Outside(_)), "{name}");
    }
    let one = view(camera(0.0), 5, true);
    recorder.add(1.0, left, &one).unwrap();
    assert!(matches!(problem(recorder.add(1.0005, left, &one)), CaptureProblem::Duplicate(_)));
    assert!(matches!(problem(recorder.add(0.5, left, &one)), CaptureProblem::Backwards { .. }));
    assert!(matches!(problem(recorder.add(f64::NAN, left, &one)), CaptureProblem::Time(_)));
    assert!(matches!(problem(recorder.add(2.0, 7, &one)), CaptureProblem::UnknownCamera(_)));
    let other = Camera::new(SIZE, [9.0, 9.0], [3.5, 2.5], Isometry3::identity()).unwrap();
    let other = view(other, 5, true);
    assert!(matches!(problem(recorder.add(2.0, left, &other)), CaptureProblem::ImageSize { .. }));
    assert!(matches!(problem(recorder.extra("../x", b"")), CaptureProblem::Outside(_)));
    recorder.extra("note.txt", b"by hand").unwrap();
    // None of what was refused has left a trace.
    recorder.add(1.1, left, &one).unwrap();
    recorder.finish().unwrap();
    assert_eq!(open(&path).unwrap().filter(Result::is_ok).count(), 2);
    let again = Recorder::new(&path, None).unwrap_err().to_string();
    assert!(again.contains("is there already") && again.contains("another folder"), "{again}");
    let nowhere = Recorder::new(&path.join("no/such"), None).unwrap_err().to_string();
    assert!(nowhere.contains("such") && nowhere.contains("may write"), "{nowhere}");
}

#[test]
fn a_wrong_frames_json_is_refused_by_name() {
    let expect = |change: fn(&mut Value), parts: &[&str]| {
        let text = refused(change);
        assert!(text.contains("frames.json"), "{text}");
        for part in parts {
            assert!(text.contains(part), "no {part:?} in {text}");
        }
    };
    expect(|json| json["format"] = json!("tum"), &["\"tum\"", "rigidformer-depth", "SENSORS.md"]);
    expect(|json| json["version"] = json!(2), &["version 2", "version 1"]);
    expect(|json| json["frames"] = json!([]), &["no frames"]);
    expect(|json| json["cameras"][0]["fx"] = json!(-1), &["camera \"left\"", "focal"]);
    expect(|json| json["cameras"][0]["fx"] = json!(1e60), &["camera \"left\"", "focal"]);
    expect(|json| json["cameras"][1]["width"] = json!(100_000), &["camera \"right\"", "100000"]);
    expect(|json| json["cameras"][1]["cx"] = json!(900), &["principal point", "resolution"]);
    expect(|json| json["cameras"][0]["depth_scale_m"] = json!(0), &["depth scale", "left"]);
    expect(|json| json["cameras"][1]["name"] = json!("left"), &["name of another"]);
    expect(|json| json["cameras"][0]["pose"][3] = json!(0.1), &["quaternion", "length"]);
    expect(|json| json["cameras"][0]["pose"] = json!([0, 0, 0]), &["does not parse"]);
    expect(|json| json["gravity_m_s2"] = json!([0, 0, 1e300]), &["gravity"]);
    expect(|json| json["frames"][2]["time_s"] = json!(-1), &["frame 2", "goes back", "order"]);
    expect(|json| json["frames"][2]["time_s"] = json!(1e300), &["frame 2", "seconds"]);
    expect(|json| json["frames"][1]["camera"] = json!("left"), &["frame 1", "second one at"]);
    expect(|json| json["frames"][1]["camera"] = json!("top"), &["frame 1", "\"top\""]);
    expect(|json| json["frames"][1]["pose"] = json!([0, 0, 0, 0, 0, 0, 0]), &["frame 1", "pose"]);
    expect(|json| json["frames"][1]["lables"] = json!("x.png"), &["lables"]);
    for name in ["../x.png", "/etc/passwd", "", "a/../../x.png"] {
        let text = refused(|json| json["frames"][0]["depth"] = json!(name));
        assert!(text.contains("not in the recording's folder"), "{text}");
    }
    let text = refused(|json| json["frames"][0]["depth"] = json!("no.png"));
    assert!(text.contains("no.png") && text.contains("is not there"), "{text}");
}

#[test]
fn json_that_is_none_and_folders_that_are_none() {
    let (parent, path) = folder();
    let text = |path: &Path| open(path).err().unwrap().to_string();
    assert!(text(&path).contains("cannot be read"));
    fs::create_dir(&path).unwrap();
    assert!(text(&path).contains("neither frames.json nor"));
    for (name, first) in [("a_0.db3", &b"SQLite format 3\0"[..]), ("a.bag", b"#ROSBAG V2.0\n")] {
        fs::write(path.join(name), first).unwrap();
        for given in [path.clone(), path.join(name)] {
            assert!(text(&given).contains("mcap convert"), "{}", text(&given));
        }
        fs::remove_file(path.join(name)).unwrap();
    }
    fs::write(path.join("frames.json"), "{\"format\": ").unwrap();
    assert!(text(&path).contains("does not parse"));
    fs::write(path.join("frames.json"), "[".repeat(100_000)).unwrap();
    assert!(text(&path).contains("does not parse"));
    fs::write(path.join("frames.json"), [0xff; 9]).unwrap();
    assert!(text(&path).contains("does not parse"));
    let file = parent.path().join("film.mp4");
    fs::write(&file, "x").unwrap();
    assert!(text(&file).contains("film.mp4"));
    for rate in [0.0, -1.0, f64::NAN, f64::INFINITY] {
        assert!(matches!(open_at(&path, rate).err().unwrap().problem, CaptureProblem::Rate(_)));
    }
}

/// Writes an image of another kind in the place of the first depth image; the error of reading it.
fn image_refused(bytes: &[u8]) -> CaptureError {
    let (_folder, path) = folder();
    recorded(&path, 2);
    // The left camera alone: else the capture would have a view left.
    let mut json = manifest(&path);
    json["frames"].as_array_mut().unwrap().retain(|frame| frame["camera"] == "left");
    fs::write(path.join("frames.json"), json.to_string()).unwrap();
    fs::write(path.join("00000-left.png"), bytes).unwrap();
    let mut captures = open(&path).unwrap();
    let error = captures.next().unwrap().unwrap_err();
    assert!(error.to_string().contains("00000-left.png"), "{error}");
    assert!(captures.next().unwrap().is_ok(), "the next one is whole");
    assert!(captures.next().is_none());
    error
}

fn png_of(size: [u32; 2], kind: png::ColorType, depth: png::BitDepth, bytes: &[u8]) -> Vec<u8> {
    let mut encoded = Vec::new();
    let mut encoder = png::Encoder::new(&mut encoded, size[0], size[1]);
    encoder.set_color(kind);
    encoder.set_depth(depth);
    encoder.write_header().unwrap().write_image_data(bytes).unwrap();
    encoded
}

#[test]
fn images_of_another_kind_or_size_are_refused() {
    use png::{BitDepth, ColorType};
    let wide = png_of([9, 6], ColorType::Grayscale, BitDepth::Sixteen, &[0; 108]);
    let error = image_refused(&wide).to_string();
    assert!(error.contains("9 x 6") && error.contains("8 x 6"), "{error}");
    let flat = png_of([8, 6], ColorType::Grayscale, BitDepth::Eight, &[0; 48]);
    let error = image_refused(&flat).to_string();
    assert!(error.contains("Grayscale with 8 bits") && error.contains("16-bit"), "{error}");
    let colours = png_of([8, 6], ColorType::Rgb, BitDepth::Sixteen, &[0; 288]);
    assert!(image_refused(&colours).to_string().contains("Rgb with 16 bits"));
    assert!(matches!(image_refused(b"").problem, CaptureProblem::Png(_)));
    assert!(matches!(image_refused(b"GIF89a").problem, CaptureProblem::Png(_)));
}

#[test]
fn cut_images_are_refused_and_flipped_bits_never_panic() {
    let pixels: Vec<u16> = (0..48).map(|at| 900 + at * 7).collect();
    let whole = image::encode(&pixels, SIZE).unwrap();
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("x.png");
    let read = |bytes: &[u8]| {
        fs::write(&path, bytes).unwrap();
        image::read(&path, SIZE)
    };
    assert_eq!(read(&whole).unwrap(), pixels);
    for length in 0..whole.len() {
        assert!(read(&whole[..length]).is_err(), "cut to {length} of {}", whole.len());
    }
    for at in 0..whole.len() * 8 {
        let mut foul = whole.clone();
        foul[at / 8] ^= 1 << (at % 8);
        // Bits of no meaning, such as the case of a chunk's name, may be flipped.
        if let Ok(read) = read(&foul) {
            assert_eq!(read, pixels, "bit {at}");
        }
    }
}

const PLY: &str = "ply\nformat ascii 1.0\ncomment by hand\nelement vertex 3\nproperty float x\nproperty float y\n\
    property float z\nproperty uchar label\nelement face 1\nproperty list uchar int vertex_indices\nend_header\n\
    0 0 1 1\n0 0.5 1e99 2\n0.25 0.5 1 3\n3 0 1 2\n";

/// The same points in binary, with a list before them.
fn binary_ply() -> Vec<u8> {
    let header = "ply\nformat binary_little_endian 1.0\nelement thing 1\nproperty list uchar ushort ids\n\
        element vertex 2\nproperty double x\nproperty float y\nproperty float z\nend_header\n";
    let mut bytes = header.as_bytes().to_vec();
    bytes.extend([2, 7, 0, 9, 0]);
    for [x, y, z] in [[0.0_f32, 0.0, 1.0], [0.25, 0.5, 1.0]] {
        bytes.extend(f64::from(x).to_le_bytes());
        bytes.extend(y.to_le_bytes());
        bytes.extend(z.to_le_bytes());
    }
    bytes
}

const PCD: &str = "# .PCD v0.7\nVERSION 0.7\nFIELDS x y z rgb label\nSIZE 4 4 4 4 2\nTYPE F F F F U\nCOUNT 1 1 1 1 1\n\
    WIDTH 2\nHEIGHT 1\nVIEWPOINT 0 0 2 1 0 0 0\nPOINTS 2\n";

fn ascii_pcd() -> Vec<u8> {
    format!("{PCD}DATA ascii\n0 0 1 5 1\n0.25 0.5 1 5 3\n").into_bytes()
}

fn binary_pcd() -> Vec<u8> {
    let mut bytes = format!("{PCD}DATA binary\n").into_bytes();
    for ([x, y, z], label) in [([0.0_f32, 0.0, 1.0], 1_u16), ([0.25, 0.5, 1.0], 3)] {
        for number in [x, y, z, 5.0] {
            bytes.extend(number.to_le_bytes());
        }
        bytes.extend(label.to_le_bytes());
    }
    bytes
}

/// By fields, in literals of at most 32 bytes.
fn compressed_pcd() -> Vec<u8> {
    let mut columns = Vec::new();
    for column in [[0.0_f32, 0.25], [0.0, 0.5], [1.0, 1.0], [5.0, 5.0]] {
        columns.extend(column.iter().flat_map(|number| number.to_le_bytes()));
    }
    columns.extend([1, 0, 3, 0]);
    let packed: Vec<u8> = columns
        .chunks(32)
        .flat_map(|run| std::iter::once(run.len() as u8 - 1).chain(run.iter().copied()))
        .collect();
    let mut bytes = format!("{PCD}DATA binary_compressed\n").into_bytes();
    bytes.extend((packed.len() as u32).to_le_bytes());
    bytes.extend((columns.len() as u32).to_le_bytes());
    bytes.extend(packed);
    bytes
}

fn cloud(bytes: &[u8]) -> Result<crate::capture::Cloud, CaptureError> {
    let folder = tempfile::tempdir().unwrap();
    // What it is is told from its contents.
    let path = folder.path().join("cloud.pcd");
    fs::write(&path, bytes).unwrap();
    let mut captures = open(&path).unwrap();
    let capture = captures.next().unwrap()?;
    let [View::Cloud(cloud)] = capture.views.as_slice() else { panic!() };
    Ok(cloud.clone())
}

#[test]
fn clouds_of_all_encodings_have_the_same_points() {
    let points = [Point3::new(0.0, 0.0, 1.0), Point3::new(0.25, 0.5, 1.0)];
    let ascii = cloud(PLY.as_bytes()).unwrap();
    assert_eq!((ascii.points.as_slice(), ascii.labels), (&points[..], Some(vec![1, 3])));
    let binary = cloud(&binary_ply()).unwrap();
    assert_eq!((binary.points.as_slice(), binary.labels), (&points[..], None));
    for bytes in [ascii_pcd(), binary_pcd(), compressed_pcd()] {
        let cloud = cloud(&bytes).unwrap();
        assert_eq!((cloud.points.as_slice(), cloud.labels), (&points[..], Some(vec![1, 3])));
        assert_eq!(cloud.sensor, Some(Point3::new(0.0, 0.0, 2.0)));
    }
}

#[test]
fn damaged_clouds_are_refused_or_harmless() {
    let all = [PLY.as_bytes().to_vec(), binary_ply(), ascii_pcd(), binary_pcd(), compressed_pcd()];
    for (kind, whole) in all.iter().enumerate() {
        for length in 0..whole.len() {
            // A cut in the last number of a text, or behind the vertices, cannot be seen.
            if let Ok(cut) = cloud_of(&whole[..length]) {
                assert!(cut.points.len() <= 2 && matches!(kind, 0 | 2), "{kind} cut to {length}");
            }
        }
        for at in 0..whole.len() * 8 {
            let mut foul = whole.clone();
            foul[at / 8] ^= 1 << (at % 8);
            if let Ok(cloud) = cloud_of(&foul) {
                assert!(cloud.points.len() <= 100, "{kind} bit {at}: {}", cloud.points.len());
                assert!(cloud.points.iter().flat_map(|point| point.iter()).all(|v| v.is_finite()));
            }
        }
    }
}

fn cloud_of(bytes: &[u8]) -> Result<crate::capture::Cloud, CaptureProblem> {
    let mut budget = Budget::default();
    let read = match bytes.starts_with(b"ply") {
        true => ply::read(bytes, &mut budget),
        false => pcd::read(bytes, &mut budget),
    }?;
    let mut origin = points::Origin::default();
    let (is_labelled, is_single) = (read.is_labelled, read.is_single);
    points::cloud_of(&read.points, is_labelled, is_single, &mut origin, &mut Notes::default())
}

#[test]
fn images_of_a_capture_count_together() {
    let folder = tempfile::tempdir().unwrap();
    // One file for all: nothing of it is read before all of them are counted.
    fs::write(folder.path().join("a.png"), b"").unwrap();
    let cameras: Vec<Value> = (0..100)
        .map(|number| {
            json!({ "name": number.to_string(), "width": 8192, "height": 8192, "fx": 8000, "fy": 8000,
                "cx": 4096, "cy": 4096, "depth_scale_m": 0.001, "pose": [0, 0, 0, 1, 0, 0, 0] })
        })
        .collect();
    let frames: Vec<Value> = (0..100)
        .map(|number| json!({ "time_s": 0, "camera": number.to_string(), "depth": "a.png" }))
        .collect();
    let manifest = json!({ "format": "rigidformer-depth", "version": 1, "cameras": cameras, "frames": frames });
    fs::write(folder.path().join("frames.json"), manifest.to_string()).unwrap();
    let error = open(folder.path()).unwrap().next().unwrap().unwrap_err();
    assert!(matches!(error.problem, CaptureProblem::Memory(_)), "{error}");
    assert!(error.to_string().contains("--memory"), "{error}");
}

#[test]
fn elements_without_properties_are_refused() {
    let header = "ply\nformat binary_little_endian 1.0\n";
    let vertex = "element vertex 0\nproperty float x\nproperty float y\nproperty float z\n";
    let many: String = (0..200).map(|k| format!("element e{k} 4000000\n")).collect();
    let error = cloud_of(format!("{header}{many}{vertex}end_header\n").as_bytes()).unwrap_err();
    assert!(error.to_string().contains("no properties"), "{error}");
    // Many elements count together, too.
    let many: String =
        (0..200).map(|k| format!("element e{k} 40000\nproperty uchar a\n")).collect();
    let mut bytes = format!("{header}{many}{vertex}end_header\n").into_bytes();
    bytes.resize(bytes.len() + 200 * 40_000, 0);
    let error = cloud_of(&bytes).unwrap_err();
    assert!(matches!(error, CaptureProblem::TooManyPoints { .. }), "{error}");
    let long = "comment x\n".repeat(10_000);
    assert!(cloud_of(format!("{header}{long}{vertex}end_header\n").as_bytes()).is_err());
}

#[test]
fn depth_scales_that_no_sensor_has_are_refused() {
    for scale in [1e-45, 1e-38, 1e-7, 11.0, 1e6, 1e9, 1e20, 3e38] {
        let folder = tempfile::tempdir().unwrap();
        let manifest = json!({ "format": "rigidformer-depth", "version": 1, "cameras": [{
            "name": "c", "width": 64, "height": 48, "fx": 60, "fy": 60, "cx": 32, "cy": 24,
            "depth_scale_m": scale, "pose": [0, 0, 1.5, 0, 1, 0, 0] }],
            "frames": [{ "time_s": 0, "camera": "c", "depth": "a.png" }] });
        fs::write(folder.path().join("frames.json"), manifest.to_string()).unwrap();
        let error = open(folder.path()).map(|_| ()).unwrap_err().to_string();
        assert!(error.contains("1e-6 to 10"), "{error}");
    }
}

#[test]
fn hostile_headers_of_clouds_are_refused() {
    let fails = |text: &str, part: &str| {
        let error = cloud(text.as_bytes()).unwrap_err().to_string();
        assert!(error.contains("cloud.pcd") && error.contains(part), "no {part:?} in {error}");
        assert!(error.len() < 600, "{} characters", error.len());
    };
    fails(&PLY.replace("vertex 3", "vertex 99999999999"), "99999999999 points");
    fails(&PLY.replace("vertex 3", "vertex 9"), "PLY");
    fails(&PLY.replace("float z", "float w"), "no x, y and z");
    fails(&PLY.replace("element vertex", "element corner"), "no element `vertex`");
    let nothing = "ply\nformat binary_little_endian 1.0\nelement air 9999999999999\nelement vertex 0\n\
        property float x\nproperty float y\nproperty float z\nend_header\n";
    fails(nothing, "no properties");
    fails(&format!("ply\n{}", "x".repeat(100_000)), "PLY");
    let pcd = String::from_utf8(ascii_pcd()).unwrap();
    fails(&pcd.replace("POINTS 2", "POINTS 3"), "WIDTH times HEIGHT");
    fails(
        &pcd.replace("WIDTH 2", "WIDTH 99999999").replace("POINTS 2", "POINTS 99999999"),
        "99999999 points",
    );
    fails(&pcd.replace("FIELDS x y z rgb", "FIELDS x y w rgb"), "no x, y and z");
    fails(&pcd.replace("SIZE 4 4 4 4 2", "SIZE 4 4 4 4"), "equally many");
    fails(&pcd.replace("SIZE 4 4 4", "SIZE 4 4 3"), "size 3");
    fails(&pcd.replace("COUNT 1", "COUNT 99999"), "count 99999");
    fails(&pcd.replace("DATA ascii", "DATA zip"), "zip");
    fails(&pcd.replace("0.25 0.5", "0.25 north"), "point 1");
    fails("", "no header");
    let mut short = compressed_pcd();
    let at = short.windows(8).position(|part| part == b"ressed\n\x26").unwrap() + 11;
    short[at..at + 4].copy_from_slice(&u32::MAX.to_le_bytes());
    assert!(cloud(&short).is_err());
}

#[test]
fn a_folder_of_clouds_has_times_of_its_own_or_a_rate() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path();
    fs::write(path.join("b.pcd"), binary_pcd()).unwrap();
    fs::write(path.join("a.PLY"), PLY).unwrap();
    fs::write(path.join("readme.txt"), "x").unwrap();
    let error = open(path).err().unwrap().to_string();
    assert!(error.contains("how many clouds"), "{error}");
    let captures: Vec<_> = open_at(path, 20.0).unwrap().map(Result::unwrap).collect();
    assert_eq!(captures.iter().map(|capture| capture.time_s).collect::<Vec<_>>(), [0.0, 0.05]);

    let json = |clouds: Value| {
        let json = json!({"format": "rigidformer-clouds", "version": 1, "clouds": clouds});
        fs::write(path.join("frames.json"), json.to_string()).unwrap();
    };
    json(json!([
        {"time_s": 3.0, "file": "b.pcd", "sensor": [1, 2, 3]},
        {"time_s": 3.0005, "file": "a.PLY"},
        {"time_s": 4.0, "file": "b.pcd"},
    ]));
    let captures: Vec<_> = open(path).unwrap().map(Result::unwrap).collect();
    let sizes: Vec<_> =
        captures.iter().map(|capture| (capture.time_s, capture.views.len())).collect();
    assert_eq!(sizes, [(3.0, 2), (4.0, 1)]);
    let View::Cloud(first) = &captures[0].views[0] else { panic!() };
    assert_eq!(first.sensor, Some(Point3::new(1.0, 2.0, 3.0)));

    let fails = |clouds: Value, part: &str| {
        json(clouds);
        let error = open(path).err().unwrap().to_string();
        assert!(error.contains(part), "no {part:?} in {error}");
    };
    fails(json!([]), "no frames");
    fails(json!([{"time_s": 0, "file": "../b.pcd"}]), "cloud 0");
    fails(json!([{"time_s": 0, "file": "c.pcd"}]), "c.pcd");
    fails(json!([{"time_s": 1, "file": "b.pcd"}, {"time_s": 0, "file": "b.pcd"}]), "goes back");
    fails(json!([{"time_s": 0, "file": "b.pcd", "sensor": [0, 0, 1e99]}]), "finite");
}

mod oddities;
