use std::collections::BTreeMap;
use std::fs;
use std::io::{Cursor, Write};

use base64::Engine;
use base64::engine::general_purpose::STANDARD;
use lz4_flex::frame::FrameEncoder;
use mcap::WriteOptions;
use mcap::records::MessageHeader;
use nalgebra::Vector3;
use prost::Message;
use ruzstd::encoding::{CompressionLevel, compress_to_vec};
use serde_json::{Value, json};

use super::super::messages::{CameraCalibration, FrameTransform, FrameTransforms, PoseInFrame};
use super::super::poses;
use super::*;

/// A message to write: milliseconds, topic, schema, encoding, bytes.
type Written = (u64, &'static str, &'static str, &'static str, Vec<u8>);

/// How chunks are compressed.
#[derive(Clone, Copy, Debug)]
enum Compression {
    Zstd,
    Lz4,
}

fn file(messages: &[Written], compression: Option<Compression>) -> Vec<u8> {
    let mut bytes = Vec::new();
    let options = WriteOptions::new().compression(None).chunk_size(Some(512));
    let mut writer = options.create(Cursor::new(&mut bytes)).unwrap();
    for (sequence, (time_ms, topic, schema, encoding, data)) in messages.iter().enumerate() {
        let schema = writer.add_schema(schema, "", b"").unwrap();
        let channel_id = writer.add_channel(schema, topic, encoding, &BTreeMap::new()).unwrap();
        let time = time_ms * 1_000_000;
        let sequence = sequence as u32;
        let header = MessageHeader { channel_id, sequence, log_time: time, publish_time: time };
        writer.write_to_known_channel(&header, data).unwrap();
    }
    writer.finish().unwrap();
    drop(writer);
    match compression {
        Some(compression) => compressed(&bytes, compression),
        None => bytes,
    }
}

fn word(bytes: &[u8], at: usize) -> usize {
    u64::from_le_bytes(bytes[at..at + 8].try_into().unwrap()) as usize
}

/// Where records are: what they are, and their bytes.
fn records(bytes: &[u8], mut at: usize) -> Vec<(u8, std::ops::Range<usize>)> {
    let mut found = Vec::new();
    while bytes.len() > at + 9 {
        let body = at + 9..at + 9 + word(bytes, at + 1);
        found.push((bytes[at], body.clone()));
        at = body.end;
    }
    found
}

fn record(code: u8, body: &[u8]) -> Vec<u8> {
    [&[code][..], &(body.len() as u64).to_le_bytes(), body].concat()
}

/// A chunk's bytes before compression: behind two times, two lengths, a checksum and no name.
const CHUNK_HEAD: usize = 8 + 8 + 8 + 4 + 4 + 8;

/// A chunk's record around what is packed.
fn chunk(plain: &[u8], name: &str, packed: &[u8]) -> Vec<u8> {
    let mut body = [0; 16].to_vec();
    body.extend((plain.len() as u64).to_le_bytes());
    body.extend(crc32fast::hash(plain).to_le_bytes());
    body.extend((name.len() as u32).to_le_bytes());
    body.extend(name.bytes());
    body.extend((packed.len() as u64).to_le_bytes());
    body.extend(packed);
    record(6, &body)
}

fn pack(plain: &[u8], compression: Compression) -> (&'static str, Vec<u8>) {
    match compression {
        Compression::Zstd => ("zstd", compress_to_vec(plain, CompressionLevel::Fastest)),
        Compression::Lz4 => {
            let mut encoder = FrameEncoder::new(Vec::new());
            encoder.write_all(plain).unwrap();
            ("lz4", encoder.finish().unwrap())
        }
    }
}

/// The same file with compressed chunks, and without a summary.
fn compressed(bytes: &[u8], compression: Compression) -> Vec<u8> {
    let mut all = mcap::MAGIC.to_vec();
    for (code, body) in records(bytes, 8) {
        match code {
            6 => {
                let plain = &bytes[body][CHUNK_HEAD..];
                let (name, packed) = pack(plain, compression);
                all.extend(chunk(plain, name, &packed));
            }
            15 => {
                all.extend(record(15, &[0; 4]));
                all.extend(record(2, &[0; 20]));
                all.extend(mcap::MAGIC);
                break;
            }
            7 => {}
            _ => all.extend(record(code, &bytes[body])),
        }
    }
    all
}

/// Captures of a file, and the topics that were not read.
type Read = (Vec<Result<Capture, CaptureError>>, Vec<String>);

fn read(bytes: &[u8]) -> Result<Read, CaptureError> {
    read_with(bytes, &Options::default()).map(|(captures, unread, _)| (captures, unread))
}

/// Captures, unread topics and notes.
type WithNotes = (Vec<Result<Capture, CaptureError>>, Vec<String>, Vec<String>);

/// The same, and what is said about it.
fn read_with(bytes: &[u8], options: &Options) -> Result<WithNotes, CaptureError> {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("drive.mcap");
    fs::write(&path, bytes).unwrap();
    let mut captures = super::super::open_with(&path, options)?;
    assert_eq!(captures.count_left(), None);
    let read = captures.by_ref().collect();
    let notes = captures.notes().iter().map(|(note, count)| format!("{count} {note}")).collect();
    Ok((read, captures.unread().into_iter().map(str::to_owned).collect(), notes))
}

/// Whole captures, and what is said.
fn noted(bytes: &[u8]) -> (Vec<Capture>, Vec<String>) {
    let (captures, _, notes) = read_with(bytes, &Options::default()).unwrap();
    (captures.into_iter().map(Result::unwrap).collect(), notes)
}

fn whole(bytes: &[u8]) -> Vec<Capture> {
    read(bytes).unwrap().0.into_iter().map(Result::unwrap).collect()
}

fn stamp(time_ms: u64) -> Value {
    json!({"sec": time_ms / 1000, "nsec": time_ms % 1000 * 1_000_000})
}

/// Two points and one that is none, at x = 0 and 0.25, of 20 bytes each.
fn packed() -> Vec<u8> {
    let mut bytes = Vec::new();
    for ([x, y, z], label) in
        [([0.0_f32, 0.0, 1.0], 1_u16), ([0.0, f32::NAN, 1.0], 2), ([0.25, 0.5, 1.0], 3)]
    {
        bytes.extend(x.to_le_bytes());
        bytes.extend([9; 4]);
        bytes.extend(y.to_le_bytes());
        bytes.extend(z.to_le_bytes());
        bytes.extend(label.to_le_bytes());
        bytes.extend([9; 2]);
    }
    bytes
}

fn cloud_json(time_ms: u64) -> Value {
    let field =
        |name: &str, offset: u32, kind: u32| json!({"name": name, "offset": offset, "type": kind});
    json!({
        "timestamp": stamp(time_ms),
        "frame_id": "lidar",
        "pose": {"position": {"x": 0, "y": 0, "z": 0}, "orientation": {"x": 0, "y": 0, "z": 0, "w": 1}},
        "point_stride": 20,
        "fields": [field("x", 0, 7), field("y", 8, 7), field("z", 12, 7), field("label", 16, 3)],
        "data": STANDARD.encode(packed()),
    })
}

fn json_bytes(value: &Value) -> Vec<u8> {
    value.to_string().into_bytes()
}

/// The same message in protobuf.
fn protobuf<M: Message + Default + for<'de> serde::Deserialize<'de>>(value: &Value) -> Vec<u8> {
    serde_json::from_value::<M>(value.clone()).unwrap().encode_to_vec()
}

fn ros_cloud(time_ms: u64) -> Vec<u8> {
    fn word(bytes: &mut Vec<u8>, word: u32) {
        while !bytes.len().is_multiple_of(4) {
            bytes.push(0);
        }
        bytes.extend(word.to_le_bytes());
    }
    fn text(bytes: &mut Vec<u8>, text: &str) {
        word(bytes, text.len() as u32 + 1);
        bytes.extend(text.bytes());
        bytes.push(0);
    }
    let mut bytes = vec![0, 1, 0, 0];
    word(&mut bytes, (time_ms / 1000) as u32);
    word(&mut bytes, (time_ms % 1000) as u32 * 1_000_000);
    text(&mut bytes, "lidar");
    word(&mut bytes, 1);
    word(&mut bytes, 3);
    word(&mut bytes, 4);
    for (name, offset, kind) in [("x", 0, 7), ("y", 8, 7), ("z", 12, 7), ("label", 16, 4)] {
        text(&mut bytes, name);
        word(&mut bytes, offset);
        bytes.push(kind);
        word(&mut bytes, 1);
    }
    bytes.push(0);
    word(&mut bytes, 20);
    word(&mut bytes, 60);
    word(&mut bytes, 60);
    bytes.extend(packed());
    bytes.push(1);
    bytes
}

const CLOUD: &str = "foxglove.PointCloud";
const IMAGE: &str = "foxglove.RawImage";
const CALIBRATION: &str = "foxglove.CameraCalibration";
const TRANSFORM: &str = "foxglove.FrameTransform";
const ROS: &str = "sensor_msgs/msg/PointCloud2";

fn image_json(time_ms: u64, encoding: &str, step: u32, data: &[u8]) -> Value {
    json!({
        "timestamp": stamp(time_ms), "frame_id": "camera", "width": 3, "height": 2,
        "encoding": encoding, "step": step, "data": STANDARD.encode(data),
    })
}

fn calibration_json() -> Value {
    json!({
        "timestamp": stamp(0), "frame_id": "camera", "width": 3, "height": 2, "distortion_model": "plumb_bob",
        "D": [0, 0, 0, 0, 0], "K": [4, 0, 1, 0, 5, 0.5, 0, 0, 1], "R": [], "P": [],
    })
}

fn depths() -> Vec<u8> {
    // Rows of six bytes and two that mean nothing.
    [1000_u16, 2000, 0, 77, 4000, 5000, 65535, 77]
        .iter()
        .flat_map(|depth| depth.to_le_bytes())
        .collect()
}

#[test]
fn clouds_of_all_encodings_and_compressions_are_the_same() {
    for compression in [None, Some(Compression::Zstd), Some(Compression::Lz4)] {
        let messages = [
            (5000, "/json", CLOUD, "json", json_bytes(&cloud_json(5000))),
            (5100, "/proto", CLOUD, "protobuf", protobuf::<PointCloud>(&cloud_json(5100))),
            (5200, "/ros", ROS, "cdr", ros_cloud(5200)),
            // Within a millisecond: one capture.
            (5200, "/json", CLOUD, "json", json_bytes(&cloud_json(5200))),
        ];
        let captures = whole(&file(&messages, compression));
        let times: Vec<_> = captures.iter().map(|capture| capture.time_s).collect();
        assert_eq!(times, [0.0, 0.1, 0.2]);
        assert_eq!(captures[2].views.len(), 2);
        for view in captures.iter().flat_map(|capture| &capture.views) {
            let View::Cloud(cloud) = view else { panic!() };
            assert_eq!(cloud.points, [Point3::new(0.0, 0.0, 1.0), Point3::new(0.25, 0.5, 1.0)]);
            assert_eq!((&cloud.labels, cloud.sensor), (&Some(vec![1, 3]), None));
        }
    }
}

#[test]
fn depth_images_stand_where_transforms_put_them() {
    let transform = |parent: &str, child: &str, x: f64| {
        let turn = json!({"x": 0, "y": 0, "z": 0.5_f64.sqrt(), "w": 0.5_f64.sqrt()});
        json!({
            "timestamp": stamp(0), "parent_frame_id": parent, "child_frame_id": child,
            "translation": {"x": x, "y": 0, "z": 0}, "rotation": turn,
        })
    };
    let metres: Vec<u8> =
        [1.0_f32, 2.0, f32::NAN, 4.0, 5.0, 1e9].iter().flat_map(|m| m.to_le_bytes()).collect();
    let messages = [
        (0, "/tf", TRANSFORM, "json", json_bytes(&transform("world", "arm", 2.0))),
        (
            0,
            "/tf",
            TRANSFORM,
            "protobuf",
            protobuf::<FrameTransform>(&transform("arm", "camera", 1.0)),
        ),
        (0, "/info", CALIBRATION, "protobuf", protobuf::<CameraCalibration>(&calibration_json())),
        (1, "/pose", "nav_msgs/msg/Odometry", "cdr", vec![0; 9]),
        (1, "/colour", IMAGE, "json", json_bytes(&image_json(1, "rgb8", 9, &[0; 18]))),
        (
            10,
            "/depth",
            IMAGE,
            "protobuf",
            protobuf::<RawImage>(&image_json(10, "16UC1", 8, &depths())),
        ),
        (50, "/depth", IMAGE, "json", json_bytes(&image_json(50, "32FC1", 12, &metres))),
    ];
    let (captures, unread) = read(&file(&messages, None)).unwrap();
    assert_eq!(unread, ["/colour (foxglove.RawImage)", "/pose (nav_msgs/msg/Odometry)"]);
    let views: Vec<_> = captures.into_iter().flat_map(|capture| capture.unwrap().views).collect();
    let [View::Depth(steps), View::Depth(metres)] = views.as_slice() else { panic!() };
    assert_eq!(steps.depth, [1000, 2000, 0, 4000, 5000, 65535]);
    assert_eq!(metres.depth, [1000, 2000, 0, 4000, 5000, 0]);
    assert_eq!((steps.camera.focal(), steps.camera.centre()), ([4.0, 5.0], [1.0, 0.5]));
    // A quarter turn at the arm: the camera is 1 m beside it, and turned by half a turn in all.
    let place = steps.camera.pose().translation.vector;
    assert!((place - Vector3::new(2.0, 1.0, 0.0)).norm() < 1e-6, "{place}");
    let ahead = steps.camera.pose() * Vector3::x();
    assert!((ahead + Vector3::x()).norm() < 1e-6, "{ahead}");
}

fn refused(messages: &[Written]) -> String {
    match read(&file(messages, None)) {
        Err(error) => error.to_string(),
        Ok((captures, _)) => {
            captures.into_iter().find_map(Result::err).expect("it was read").to_string()
        }
    }
}

#[test]
fn what_cannot_be_read_is_named() {
    let expect = |messages: &[Written], parts: &[&str]| {
        let text = refused(messages);
        assert!(text.contains("drive.mcap"), "{text}");
        for part in parts {
            assert!(text.contains(part), "no {part:?} in {text}");
        }
    };
    let other = (0, "/pose", "nav_msgs/msg/Odometry", "cdr", vec![1, 2, 3]);
    expect(&[other], &["/pose (nav_msgs/msg/Odometry)", "record foxglove.PointCloud"]);
    expect(&[], &["none at all"]);
    let image = |encoding, data: &[u8]| {
        (5, "/depth", IMAGE, "json", json_bytes(&image_json(5, encoding, 8, data)))
    };
    let known = |change: fn(&mut Value)| {
        let mut json = calibration_json();
        change(&mut json);
        (0, "/info", CALIBRATION, "json", json_bytes(&json))
    };
    expect(
        &[image("16UC1", &depths())],
        &["message 0 of /depth", "\"camera\"", "foxglove.CameraCalibration with its frame_id"],
    );
    expect(
        &[known(|json| json["D"] = json!([0.1])), image("16UC1", &depths())],
        &["/info", "plumb_bob", "rectified"],
    );
    expect(&[known(|json| json["K"] = json!([4])), image("16UC1", &depths())], &["K has 1"]);
    expect(&[known(|json| json["K"][0] = json!(-4)), image("16UC1", &depths())], &["focal"]);
    expect(&[known(|_| ()), image("16UC1", &depths()[..9])], &["/depth", "too short"]);
    expect(&[known(|json| json["width"] = json!(9)), image("16UC1", &depths())], &["9 x 2"]);
    expect(&[(0, "/scan", CLOUD, "flatbuffer", vec![0])], &["\"flatbuffer\"", "JSON or protobuf"]);
    expect(&[(0, "/scan", CLOUD, "json", b"{\"data\": 7}".to_vec())], &["does not decode"]);
    expect(&[(0, "/scan", CLOUD, "protobuf", vec![0xff; 9])], &["does not decode"]);
    let cloud = |change: fn(&mut Value)| {
        let mut json = cloud_json(0);
        change(&mut json);
        (0, "/scan", CLOUD, "json", json_bytes(&json))
    };
    expect(&[cloud(|json| json["point_stride"] = json!(0))], &["whole number of points"]);
    expect(&[cloud(|json| json["point_stride"] = json!(19))], &["whole number of points"]);
    expect(&[cloud(|json| json["fields"][2]["offset"] = json!(17))], &["no x, y and z"]);
    expect(&[cloud(|json| json["fields"][2]["type"] = json!(77))], &["no x, y and z"]);
    expect(&[cloud(|json| json["pose"]["orientation"]["w"] = json!(3))], &["quaternion"]);
    expect(
        &[cloud(|json| json["pose"]["position"]["x"] = json!(-1.5e6))],
        &["more than 1000 km", "nearer frame"],
    );
    let mut listed = ros_cloud(0);
    listed[1] = 2;
    expect(&[(0, "/ros", ROS, "cdr", listed)], &["it is not plain CDR"]);
    for length in 0..ros_cloud(0).len() - 1 {
        let cut = ros_cloud(0)[..length].to_vec();
        let read = ros::cloud("cdr", ROS, &cut, &mut Budget::default());
        assert!(read.is_err(), "cut to {length}");
    }
}

#[test]
fn damaged_files_are_refused_or_harmless() {
    let messages: Vec<Written> = (0..6)
        .map(|index| {
            (
                index * 10,
                "/scan",
                CLOUD,
                "protobuf",
                protobuf::<PointCloud>(&cloud_json(index * 10)),
            )
        })
        .collect();
    for compression in [None, Some(Compression::Zstd), Some(Compression::Lz4)] {
        let whole = file(&messages, compression);
        // Packed files are cut and changed at every seventh place: a chunk's checksum is the same for all.
        let step = if compression.is_none() { 1 } else { 7 };
        // How many errors and notes there are, at least one where the file does not open.
        let check = |bytes: &[u8]| {
            let Ok((captures, _, notes)) = read_with(bytes, &Options::default()) else { return 1 };
            assert!(captures.len() <= 7);
            captures.iter().filter(|capture| capture.is_err()).count() + notes.len()
        };
        assert_eq!(check(&whole), 0);
        for length in (0..whole.len()).step_by(step) {
            assert!(check(&whole[..length]) > 0, "cut to {length} of {}", whole.len());
        }
        for at in (0..whole.len()).step_by(step) {
            let mut foul = whole.clone();
            foul[at] ^= 1 << (at % 8);
            check(&foul);
        }
    }
}

fn transform_json(time_ms: u64, parent: &str, child: &str, x: f64) -> Value {
    json!({
        "timestamp": stamp(time_ms), "parent_frame_id": parent, "child_frame_id": child,
        "translation": {"x": x, "y": 0, "z": 1}, "rotation": {"x": 0, "y": 0, "z": 0, "w": 1},
    })
}

/// Words of CDR, each aligned to its size.
struct Cdr(Vec<u8>);

impl Cdr {
    fn new() -> Self {
        Cdr(Vec::new())
    }

    fn put(mut self, number: &[u8]) -> Self {
        while !self.0.len().is_multiple_of(number.len()) {
            self.0.push(0);
        }
        self.0.extend(number);
        self
    }

    fn text(mut self, text: &str) -> Self {
        self = self.put(&(text.len() as u32 + 1).to_le_bytes());
        self.0.extend(text.bytes());
        self.0.push(0);
        self
    }

    fn stamped(self, time_ms: u64, frames: &[&str], x: f64) -> Self {
        let seconds = self.put(&((time_ms / 1000) as u32).to_le_bytes());
        let start = seconds.put(&((time_ms % 1000) as u32 * 1_000_000).to_le_bytes());
        let named = frames.iter().fold(start, |cdr, frame| cdr.text(frame));
        [x, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0].iter().fold(named, |cdr, n| cdr.put(&n.to_le_bytes()))
    }

    fn bytes(self) -> Vec<u8> {
        [vec![0, 1, 0, 0], self.0].concat()
    }
}

const TF: &str = "tf2_msgs/msg/TFMessage";
const POSE: &str = "geometry_msgs/msg/PoseStamped";

fn poses_of(bytes: &[u8]) -> Result<Vec<(f64, String, String, f64)>, CaptureError> {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("drive.mcap");
    fs::write(&path, bytes).unwrap();
    let told = poses(&path)?.into_iter();
    Ok(told.map(|p| (p.time_s, p.frame, p.parent, p.pose.translation.x)).collect())
}

#[test]
fn poses_come_of_every_type_of_message() {
    let pose = json!({
        "timestamp": stamp(1200), "frame_id": "map",
        "pose": {"position": {"x": 6, "y": 0, "z": 0}, "orientation": {"x": 0, "y": 0, "z": 0, "w": 1}},
    });
    let both = json!({"transforms": [transform_json(1100, "world", "a", 2.0), transform_json(1100, "a", "b", 3.0)]});
    let list = Cdr::new().put(&2_u32.to_le_bytes());
    let list = list.stamped(1000, &["world", "odd"], 4.0).stamped(1300, &["world", "c"], 5.0);
    let single = "geometry_msgs/msg/TransformStamped";
    let messages = [
        (0, "/tf", TRANSFORM, "json", json_bytes(&transform_json(1000, "world", "a", 1.0))),
        (0, "/tf", "foxglove.FrameTransforms", "json", json_bytes(&both)),
        (0, "/tf", "foxglove.FrameTransforms", "protobuf", protobuf::<FrameTransforms>(&both)),
        (0, "/ros/tf", TF, "cdr", list.bytes()),
        (0, "/cup", "foxglove.PoseInFrame", "protobuf", protobuf::<PoseInFrame>(&pose)),
        (0, "/robot/base", POSE, "cdr", Cdr::new().stamped(1400, &["map"], 7.0).bytes()),
        (0, "/one", single, "cdr", Cdr::new().stamped(1500, &["map", "d"], 8.0).bytes()),
        (0, "/other", "nav_msgs/msg/Odometry", "cdr", vec![1; 9]),
    ];
    let row =
        |time_s: f64, frame: &str, parent: &str, x: f64| (time_s, frame.into(), parent.into(), x);
    assert_eq!(
        poses_of(&file(&messages, None)).unwrap(),
        [
            row(0.0, "a", "world", 1.0),
            row(0.1, "a", "world", 2.0),
            row(0.1, "b", "a", 3.0),
            row(0.1, "a", "world", 2.0),
            row(0.1, "b", "a", 3.0),
            row(0.0, "odd", "world", 4.0),
            row(0.3, "c", "world", 5.0),
            row(0.2, "cup", "map", 6.0),
            row(0.4, "robot/base", "map", 7.0),
            row(0.5, "d", "map", 8.0),
        ]
    );
}

fn with_chunk(chunk: &[u8]) -> Vec<u8> {
    let end = [record(15, &[0; 4]), record(2, &[0; 20]), mcap::MAGIC.to_vec()].concat();
    [mcap::MAGIC.to_vec(), record(1, &[0; 8]), chunk.to_vec(), end].concat()
}

/// Found by fuzzing.
#[test]
fn a_record_longer_than_its_chunk_is_refused_before_any_capture() {
    let messages = [0, 20, 40]
        .map(|time_ms| (time_ms, "/scan", CLOUD, "json", json_bytes(&cloud_json(time_ms))));
    let bytes = file(&messages, None);
    let chunks = records(&bytes, 8).into_iter().filter(|(code, _)| *code == 6);
    let plain: Vec<u8> = chunks.flat_map(|(_, body)| bytes[body][CHUNK_HEAD..].to_vec()).collect();
    assert_eq!(whole(&with_chunk(&chunk(&plain, "", &plain))).len(), 3);
    let last = records(&plain, 0).pop().unwrap().1;
    let mut damaged: Vec<Vec<u8>> =
        [1, 30, 100].iter().map(|less| plain[..plain.len() - less].to_vec()).collect();
    for length in [plain.len() as u64, u64::MAX, u64::MAX - 8, 1 << 63] {
        let mut longer = plain.clone();
        longer[last.start - 8..last.start].copy_from_slice(&length.to_le_bytes());
        damaged.push(longer);
    }
    damaged.push([&plain[..], &[5; 8]].concat());
    for plain in damaged {
        let (zstd, lz4) = (pack(&plain, Compression::Zstd), pack(&plain, Compression::Lz4));
        for (name, packed) in [("", plain.clone()), zstd, lz4] {
            let bytes = with_chunk(&chunk(&plain, name, &packed));
            let errors = [read(&bytes).err().unwrap(), poses_of(&bytes).unwrap_err()];
            for text in errors.map(|error| error.to_string()) {
                assert!(text.contains("a record is longer than its chunk"), "{text}");
            }
        }
    }
}

#[test]
fn chunks_that_lie_about_their_size_are_refused() {
    let plain: Vec<u8> = [record(1, &[0; 8]), record(200, &[7; 3000])].concat();
    let refused = |chunk: &[u8]| read(&with_chunk(chunk)).err().unwrap().to_string();
    for (name, packed) in
        [("", plain.clone()), pack(&plain, Compression::Zstd), pack(&plain, Compression::Lz4)]
    {
        let sound = chunk(&plain, name, &packed);
        assert!(refused(&sound).contains("no messages"));
        for size in [0, 1, plain.len() as u64 - 1, plain.len() as u64 + 1, 1 << 20] {
            let mut lying = sound.clone();
            lying[9 + 16..9 + 24].copy_from_slice(&size.to_le_bytes());
            let text = refused(&lying);
            assert!(["than it says", "zstd: "].iter().any(|part| text.contains(part)), "{text}");
        }
        for size in [(1 << 20) + 1, 160 << 20, u64::MAX] {
            let mut lying = sound.clone();
            lying[9 + 16..9 + 24].copy_from_slice(&size.to_le_bytes());
            assert!(refused(&lying).contains("bytes of records, more than"), "{}", refused(&lying));
        }
        let mut foul = sound.clone();
        foul[9 + 24] ^= 1;
        assert!(refused(&foul).contains("checksum"));
        for length in 0..sound.len() {
            let cut = record(6, &sound[9.min(length)..length]);
            assert!(!refused(&cut).contains("no messages"), "{length}");
        }
    }
    assert!(refused(&chunk(&plain, "brotli", &plain)).contains("\"brotli\", not as zstd or lz4"));
    // A bomb: a thousand times as much as the chunk says.
    let bomb = vec![0; 1 << 20];
    for compression in [Compression::Zstd, Compression::Lz4] {
        let (name, packed) = pack(&bomb, compression);
        refused(&chunk(&bomb[..1000], name, &packed));
    }
    // Many chunks, each of which is allowed.
    let plain = record(200, &vec![0; (1 << 20) - 9]);
    let (name, packed) = pack(&plain, Compression::Lz4);
    let many = chunk(&plain, name, &packed).repeat(257);
    assert!(refused(&many).contains("its chunks have more than"), "{}", refused(&many));
    // What is sound before them makes no recording of it.
    let messages = [(0, "/scan", CLOUD, "json", json_bytes(&cloud_json(0)))];
    let sound = file(&messages, None);
    let end = records(&sound, 8).into_iter().find(|(code, _)| *code == 15).unwrap().1.start - 9;
    assert!(read(&sound).is_ok());
    let error = read(&[&sound[..end], &many, &sound[end..]].concat()).err().unwrap();
    assert!(matches!(error.problem, CaptureProblem::Unpacked { most: 0x1000_0000 }), "{error}");
    assert!(error.to_string().contains("--memory"), "{error}");
}

/// Frames of packed bytes may follow each other.
#[test]
fn chunks_of_several_frames_are_read() {
    let messages = [(0, "/scan", CLOUD, "json", json_bytes(&cloud_json(0)))];
    let bytes = file(&messages, None);
    let (_, body) = records(&bytes, 8).into_iter().find(|(code, _)| *code == 6).unwrap();
    let plain = &bytes[body][CHUNK_HEAD..];
    let (start, end) = plain.split_at(plain.len() / 3);
    for compression in [Compression::Zstd, Compression::Lz4] {
        let (name, mut packed) = pack(start, compression);
        packed.extend(pack(end, compression).1);
        assert_eq!(whole(&with_chunk(&chunk(plain, name, &packed))).len(), 1);
    }
}

fn first_points(bytes: &[u8]) -> Vec<f32> {
    let views = whole(bytes).into_iter().flat_map(|capture| capture.views);
    views
        .map(|view| if let View::Cloud(cloud) = view { cloud.points[0].x } else { f32::NAN })
        .collect()
}

/// However many frames came before it is known anew, and whenever it was known first.
#[test]
fn a_late_transform_moves_a_known_frame() {
    let cloud = |time_ms| (time_ms, "/scan", CLOUD, "json", json_bytes(&cloud_json(time_ms)));
    let placed = |time_ms, x| {
        (
            time_ms,
            "/tf",
            TRANSFORM,
            "json",
            json_bytes(&transform_json(time_ms, "world", "lidar", x)),
        )
    };
    let others = json!({"transforms": (0..2000).map(|n| transform_json(0, "world", &format!("f{n}"), 0.5)).collect::<Vec<_>>()});
    let others =
        (0, "/tf", "foxglove.FrameTransforms", "protobuf", protobuf::<FrameTransforms>(&others));
    let late =
        [placed(0, 1.0), others, cloud(1), placed(10, 2.0), cloud(20), placed(30, 3.0), cloud(40)];
    // Between two poses, at the stamp of the cloud.
    assert_eq!(first_points(&file(&late, None)), [1.1, 2.5, 3.0]);
    // One that comes after the first clouds holds for these too.
    let after = [cloud(1), cloud(20), placed(30, 4.0), cloud(40), placed(50, 5.0), cloud(60)];
    assert_eq!(first_points(&file(&after, Some(Compression::Zstd))), [4.0, 4.0, 4.5, 5.0]);
}

#[test]
fn no_frame_is_left_out_without_a_word() {
    let long = transform_json(0, "world", &"n".repeat(1025), 0.5);
    let many: Vec<Value> =
        (0..=1 << 16).map(|n| transform_json(0, "world", &n.to_string(), 0.5)).collect();
    let many = protobuf::<FrameTransforms>(&json!({"transforms": many}));
    for message in [
        (0, "/tf", TRANSFORM, "json", json_bytes(&long)),
        (0, "/tf", "foxglove.FrameTransforms", "protobuf", many),
    ] {
        assert!(refused(&[message]).contains("more than 65,536 frames"));
    }
}

#[test]
fn bad_poses_are_named() {
    let expect = |messages: &[Written], parts: &[&str]| {
        let error = poses_of(&file(messages, None)).expect_err("read");
        let text = format!("{error}; {}", error.problem.remedy());
        assert!(parts.iter().all(|part| text.contains(part)), "{text}: {parts:?}");
    };
    expect(
        &[(0, "/odom", "nav_msgs/msg/Odometry", "cdr", vec![0; 9])],
        &["no poses", "/odom", "TFMessage"],
    );
    expect(&[], &["no poses", "none at all"]);
    let whole = Cdr::new().put(&1_u32.to_le_bytes()).stamped(0, &["world", "a"], 1.0).bytes();
    for length in 0..whole.len() {
        expect(&[(0, "/tf", TF, "cdr", whole[..length].to_vec())], &["message 0 of /tf"]);
    }
    let mut many = whole.clone();
    many[4..8].copy_from_slice(&u32::MAX.to_le_bytes());
    expect(&[(0, "/tf", TF, "cdr", many)], &["ends early"]);
    expect(&[(0, "/tf", TF, "json", whole)], &["\"json\""]);
    let mut turned = transform_json(0, "world", "a", 1.0);
    turned["rotation"]["w"] = json!(3);
    expect(&[(0, "/tf", TRANSFORM, "json", json_bytes(&turned))], &["quaternion"]);
    let far = transform_json(0, "world", "a", 1.5e6);
    expect(
        &[(0, "/tf", TRANSFORM, "json", json_bytes(&far))],
        &["message 0 of /tf", "more than 1000 km", "nearer frame"],
    );
    let endless = Cdr::new().put(&1_u32.to_le_bytes()).stamped(0, &["world", "a"], f64::NAN);
    expect(&[(0, "/tf", TF, "cdr", endless.bytes())], &["not finite"]);
    let mut nameless = transform_json(0, "world", "a", 1.0);
    nameless.as_object_mut().unwrap().remove("child_frame_id");
    expect(
        &[(0, "/tf", TRANSFORM, "json", json_bytes(&nameless))],
        &["message 0 of /tf", "names no child frame", "child_frame_id"],
    );
    let nameless = Cdr::new().stamped(0, &["world", ""], 1.0).bytes();
    let single = "geometry_msgs/msg/TransformStamped";
    expect(&[(0, "/tf", single, "cdr", nameless)], &["names no child frame"]);
}

#[test]
fn broken_poses_of_things_do_not_keep_sensors_from_being_read() {
    let messages = [
        (0, "/cup", POSE, "cdr", vec![0; 9]),
        (0, "/goal", "foxglove.PoseInFrame", "json", b"{\"pose\": 7}".to_vec()),
        (1, "/scan", CLOUD, "json", json_bytes(&cloud_json(1))),
    ];
    let (captures, unread) = read(&file(&messages, None)).unwrap();
    assert_eq!(captures.into_iter().map(Result::unwrap).count(), 1);
    assert_eq!(unread, ["/cup (geometry_msgs/msg/PoseStamped)", "/goal (foxglove.PoseInFrame)"]);
}

#[test]
fn poses_keep_their_precision_far_from_the_origin() {
    let far = transform_json(0, "utm", "a", 512_345.678_9);
    let told = poses_of(&file(&[(0, "/tf", TRANSFORM, "json", json_bytes(&far))], None)).unwrap();
    assert_eq!(told[0].3, 512_345.678_9);
}

#[test]
fn sensors_are_placed_by_transforms_in_lists_and_of_ros() {
    let list = Cdr::new().put(&1_u32.to_le_bytes()).stamped(0, &["world", "arm"], 4.0).bytes();
    let rest = json!({"transforms": [transform_json(0, "arm", "lidar", 2.0)]});
    let messages = [
        (0, "/tf", TF, "cdr", list),
        (0, "/tf", "foxglove.FrameTransforms", "json", json_bytes(&rest)),
        (1, "/scan", CLOUD, "json", json_bytes(&cloud_json(1))),
    ];
    let captures = whole(&file(&messages, None));
    let [View::Cloud(cloud)] = captures[0].views.as_slice() else { panic!("no cloud") };
    assert_eq!(cloud.points[0], Point3::new(6.0, 0.0, 3.0));
}

mod robots;
