//! Files as robots make them: late transforms, stamps that say nothing, killed recorders, images of ROS.

use super::*;
use crate::recording::{Note, stream};

/// How ROS packs numbers.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Dialect {
    Little,
    Big,
    One,
}

const DIALECTS: [Dialect; 3] = [Dialect::Little, Dialect::Big, Dialect::One];

impl Dialect {
    fn encoding(self) -> &'static str {
        if self == Dialect::One { "ros1" } else { "cdr" }
    }
}

/// A message of ROS.
struct Ros(Dialect, Vec<u8>);

impl Ros {
    fn new(dialect: Dialect, stamp_ms: u64, frame: &str) -> Self {
        let ros = Ros(dialect, Vec::new());
        let ros = if dialect == Dialect::One { ros.word(7) } else { ros };
        let ros = ros.word((stamp_ms / 1000) as u32).word((stamp_ms % 1000) as u32 * 1_000_000);
        ros.text(frame)
    }

    fn put<const N: usize>(mut self, mut little: [u8; N]) -> Self {
        while self.0 != Dialect::One && !self.1.len().is_multiple_of(N) {
            self.1.push(0);
        }
        if self.0 == Dialect::Big {
            little.reverse();
        }
        self.1.extend(little);
        self
    }

    fn word(self, word: u32) -> Self {
        self.put(word.to_le_bytes())
    }

    fn byte(self, byte: u8) -> Self {
        self.put([byte])
    }

    fn doubles(self, numbers: &[f64]) -> Self {
        numbers.iter().fold(self, |ros, number| ros.put(number.to_le_bytes()))
    }

    fn text(self, text: &str) -> Self {
        let end: &[u8] = if self.0 == Dialect::One { b"" } else { b"\0" };
        self.blob(&[text.as_bytes(), end].concat())
    }

    fn blob(self, bytes: &[u8]) -> Self {
        let mut ros = self.word(bytes.len() as u32);
        ros.1.extend(bytes);
        ros
    }

    fn bytes(self) -> Vec<u8> {
        let head: &[u8] = match self.0 {
            Dialect::Little => &[0, 1, 0, 0],
            Dialect::Big => &[0; 4],
            Dialect::One => &[],
        };
        [head, &self.1].concat()
    }
}

/// A cloud in a frame, with a stamp.
fn scan(stamp_ms: u64, frame: &str) -> Vec<u8> {
    let ros = Ros::new(Dialect::Little, stamp_ms, frame).word(1).word(3).word(4);
    let fields = [("x", 0, 7), ("y", 8, 7), ("z", 12, 7), ("label", 16, 4)];
    let ros = fields
        .iter()
        .fold(ros, |ros, (name, offset, kind)| ros.text(name).word(*offset).byte(*kind).word(1));
    ros.byte(0).word(20).word(60).blob(&packed()).byte(1).bytes()
}

fn logged(log_ms: u64, stamp_ms: u64) -> Written {
    (log_ms, "/scan", ROS, "cdr", scan(stamp_ms, "lidar"))
}

fn moved(log_ms: u64, topic: &'static str, stamp_ms: u64, frames: &[&str; 2], x: f64) -> Written {
    let list = Cdr::new().put(&1_u32.to_le_bytes()).stamped(stamp_ms, frames, x).bytes();
    (log_ms, topic, TF, "cdr", list)
}

fn times(captures: &[Capture]) -> Vec<u64> {
    captures.iter().map(|capture| (capture.time_s * 1000.0).round() as u64).collect()
}

fn firsts(captures: &[Capture]) -> Vec<f32> {
    let first = |capture: &Capture| match capture.views.as_slice() {
        [View::Cloud(cloud)] => cloud.points[0].x,
        other => panic!("{} views", other.len()),
    };
    captures.iter().map(first).collect()
}

/// The same file with its chunks in another order, and without a summary.
fn reordered(bytes: &[u8], order: impl Fn(&mut Vec<Vec<u8>>)) -> Vec<u8> {
    let all = records(bytes, 8);
    let mut chunks: Vec<Vec<u8>> = all
        .into_iter()
        .filter(|(code, _)| *code == 6)
        .map(|(_, body)| record(6, &bytes[body]))
        .collect();
    order(&mut chunks);
    with_chunk(&chunks.concat())
}

#[test]
fn messages_come_in_the_order_in_which_they_were_logged() {
    // Some were logged before an older one.
    let logs = [1000, 1100, 1200, 1300, 1400, 1500];
    let stamps = [990, 1090, 1250, 1190, 1390, 1490];
    let messages: Vec<_> =
        logs.iter().zip(stamps).map(|(log, stamp)| logged(*log, stamp)).collect();
    let whole = file(&messages, None);
    let wanted = [0, 100, 200, 260, 400, 500];
    assert_eq!(times(&noted(&whole).0), wanted);
    assert_eq!(noted(&whole).1, [""; 0]);
    for turn in 1..5 {
        let bytes = reordered(&whole, |chunks| {
            assert!(chunks.len() >= 2, "{}", chunks.len());
            match turn {
                1 => chunks.reverse(),
                turn => chunks.rotate_left(turn - 1),
            }
        });
        let (captures, notes) = noted(&bytes);
        assert_eq!(times(&captures), wanted, "{turn}");
        assert!(notes.is_empty() || notes[0].contains("order of their times"), "{notes:?}");
    }
}

#[test]
fn a_static_transform_holds_for_the_whole_file() {
    for at in [0_usize, 3, 6] {
        let mut messages: Vec<_> = (0..6).map(|k| logged(1000 + 100 * k, 1000 + 100 * k)).collect();
        let log = 1000 + 100 * at as u64;
        messages.insert(at, moved(log, "/tf_static", 0, &["base", "lidar"], 2.0));
        messages.insert(at, moved(log, "/tf_static", 9_000_000, &["map", "base"], 1.0));
        let (captures, notes) = noted(&file(&messages, Some(Compression::Zstd)));
        assert_eq!((firsts(&captures), notes), (vec![3.0; 6], vec![]), "{at}");
    }
}

#[test]
fn moving_frames_are_where_they_were_at_the_stamp_less_the_latency() {
    // The base moves by 1 m/s; transforms come at 10 Hz, and late.
    let mut messages: Vec<_> = (0..40_u64)
        .map(|k| {
            let x = k as f64 / 10.0;
            moved(1030 + 100 * k, "/tf", 1000 + 100 * k, &["map", "lidar"], x)
        })
        .collect();
    messages.extend((0..30_u64).map(|k| logged(1550 + 77 * k, 1500 + 77 * k)));
    messages.sort_by_key(|message| message.0);
    for latency_s in [0.0, 0.04, -0.04] {
        let options = Options { latency_s, ..Options::default() };
        let (captures, _, notes) = read_with(&file(&messages, None), &options).unwrap();
        let captures: Vec<_> = captures.into_iter().map(Result::unwrap).collect();
        assert_eq!(captures.len(), 30);
        for (k, x) in firsts(&captures).into_iter().enumerate() {
            let wanted = 0.5 + 0.077 * k as f64 - latency_s;
            assert!((f64::from(x) - wanted).abs() < 1e-5, "{k}: {x} for {wanted}");
        }
        assert_eq!(notes, [""; 0]);
    }
    let far = Options { latency_s: 11.0, ..Options::default() };
    let error = read_with(&file(&messages, None), &far).err().unwrap().to_string();
    assert!(error.contains("latency of 11 s"), "{error}");
}

#[test]
fn transforms_never_stand_still_and_their_end_is_told() {
    let mut messages: Vec<_> = (0..9000_u64)
        .map(|k| moved(1000 + k, "/tf", 1000 + k, &["map", "lidar"], k as f64 / 1000.0))
        .collect();
    messages.extend([2000, 9000, 12_000].map(|time| logged(time, time)));
    messages.sort_by_key(|message| message.0);
    let (captures, notes) = noted(&file(&messages, Some(Compression::Lz4)));
    assert_eq!(firsts(&captures), [1.0, 8.0, 8.999]);
    assert_eq!(notes, ["1 transforms of the frame \"lidar\" end early: its last pose holds on"]);
}

#[test]
fn stamps_that_say_nothing_give_way_to_log_times() {
    for frozen in [0, 77_000] {
        let messages: Vec<_> = (0..4).map(|k| logged(50_000 + 100 * k, frozen)).collect();
        let (captures, notes) = noted(&file(&messages, None));
        assert_eq!(times(&captures), [0, 100, 200, 300]);
        assert!(
            notes.len() == 1 && notes[0].starts_with("4 the stamps of /scan are 0"),
            "{notes:?}"
        );
    }
    // One that is said twice is left out, and so is one that comes far too late.
    let mut messages: Vec<_> = (0..4).map(|k| logged(50_000 + 100 * k, 50_000 + 100 * k)).collect();
    messages.insert(2, logged(50_120, 50_100));
    messages.push(logged(58_000, 58_000));
    messages.push(logged(59_500, 50_150));
    let (captures, notes) = noted(&file(&messages, None));
    assert_eq!(times(&captures), [0, 100, 200, 300, 8000]);
    let [again, late] = &notes[..] else { panic!("{notes:?}") };
    assert!(again.starts_with("1 /scan has two messages of one time"), "{again}");
    assert!(late.starts_with("1 messages of /scan came too late"), "{late}");
}

#[test]
fn frames_with_a_slash_are_the_same_and_unknown_ones_are_told() {
    let base = moved(0, "/tf_static", 0, &["map", "lidar"], 2.0);
    let scan_in = |frame: &str| (5, "/scan", ROS, "cdr", scan(5, frame));
    let (captures, notes) = noted(&file(&[base.clone(), scan_in("/lidar")], None));
    assert_eq!(firsts(&captures), [2.0]);
    assert_eq!(
        notes,
        ["1 no transform knows the frame \"/lidar\": that of the one without the slash is taken"]
    );
    let (captures, notes) = noted(&file(&[base.clone(), scan_in("velodyne")], None));
    assert_eq!(firsts(&captures), [0.0]);
    assert!(notes[0].contains("no transform knows the frame \"velodyne\""), "{notes:?}");
    let (_, notes) = noted(&file(&[base, scan_in("map")], None));
    assert_eq!(notes, [""; 0], "the world itself");
}

#[test]
fn what_a_killed_recorder_left_is_read() {
    let messages: Vec<_> = (0..8).map(|k| logged(1000 + 100 * k, 1000 + 100 * k)).collect();
    for compression in [None, Some(Compression::Zstd), Some(Compression::Lz4)] {
        let whole = file(&messages, compression);
        let all = records(&whole, 8);
        let ends: Vec<usize> =
            all.iter().filter(|(code, _)| *code == 6).map(|(_, body)| body.end).collect();
        // All chunks and no footer; and all but the last one.
        let (captures, notes) = noted(&whole[..*ends.last().unwrap()]);
        assert_eq!(captures.len(), 8);
        assert_eq!(
            notes,
            ["1 drive.mcap: the recorder did not finish it, so what is before its end is read"]
        );
        let last = &ends[ends.len() - 2..];
        let mut before = 0;
        for cut in last[0] + 1..last[1] {
            let (captures, notes) = noted(&whole[..cut]);
            assert!(captures.len() >= before && captures.len() <= 8, "{cut}");
            before = captures.len();
            assert_eq!(notes.len(), 1);
        }
        assert!(before >= 5, "{before}");
        // A chunk in the middle that is damaged costs itself.
        let mut foul = whole.clone();
        foul[ends[1] - 30] ^= 0x55;
        let (captures, notes) = noted(&foul);
        assert!(captures.len() < 8 && captures.len() >= 5, "{}", captures.len());
        assert!(notes[0].contains("damaged part"), "{notes:?}");
    }
}

#[test]
fn messages_without_chunks_are_read_up_to_where_they_end() {
    let mut bytes = Vec::new();
    let options = WriteOptions::new().compression(None).use_chunks(false);
    let mut writer = options.create(Cursor::new(&mut bytes)).unwrap();
    let schema = writer.add_schema(ROS, "", b"").unwrap();
    let channel_id = writer.add_channel(schema, "/scan", "cdr", &BTreeMap::new()).unwrap();
    for k in 0..6_u32 {
        let time = 1_000_000_000 + 100_000_000 * u64::from(k);
        let header = MessageHeader { channel_id, sequence: k, log_time: time, publish_time: time };
        writer.write_to_known_channel(&header, &scan(time / 1_000_000, "lidar")).unwrap();
    }
    writer.finish().unwrap();
    drop(writer);
    assert_eq!(noted(&bytes).0.len(), 6);
    let ends: Vec<usize> = records(&bytes, 8)
        .iter()
        .filter(|(code, _)| *code == 5)
        .map(|(_, body)| body.end)
        .collect();
    for (count, end) in ends.iter().enumerate() {
        let (captures, notes) = noted(&bytes[..end + 5]);
        assert_eq!((captures.len(), notes.len()), (count + 1, 1));
    }
}

const ROS_IMAGE: [&str; 2] = ["sensor_msgs/msg/Image", "sensor_msgs/Image"];
const ROS_INFO: [&str; 2] = ["sensor_msgs/msg/CameraInfo", "sensor_msgs/CameraInfo"];

fn ros_image(
    dialect: Dialect,
    stamp_ms: u64,
    encoding: &str,
    is_big: bool,
    data: &[u8],
) -> Vec<u8> {
    let step = data.len() as u32 / 2;
    let ros = Ros::new(dialect, stamp_ms, "optical").word(2).word(3).text(encoding);
    ros.byte(is_big.into()).word(step).blob(data).bytes()
}

fn ros_info(dialect: Dialect, d: &[f64]) -> Vec<u8> {
    let ros = Ros::new(dialect, 3, "optical").word(2).word(3).text("plumb_bob");
    let ros = ros.word(d.len() as u32).doubles(d);
    let ros = ros.doubles(&[4.0, 0.0, 1.0, 0.0, 5.0, 0.5, 0.0, 0.0, 1.0]);
    let ros = ros.doubles(&[1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0]);
    let p = [8.0, 0.0, 1.0, 0.0, 0.0, 8.0, 0.5, 0.0, 0.0, 0.0, 1.0, 0.0];
    ros.doubles(&p).word(0).word(0).bytes()
}

fn depth_views(captures: Vec<Capture>) -> Vec<DepthView> {
    let views = captures.into_iter().flat_map(|capture| capture.views);
    views.map(|view| if let View::Depth(view) = view { view } else { panic!("a cloud") }).collect()
}

#[test]
fn images_of_ros_are_read_in_all_dialects() {
    let steps = [1000_u16, 2000, 0, 4000, 5000, 65_535];
    let metres = [1.0_f32, 2.0, f32::NAN, 4.0, 5.0, 65.535];
    // Rows of three pixels, with two bytes or four that mean nothing.
    let rows = |bytes: Vec<Vec<u8>>| -> Vec<u8> {
        let padding = vec![7; bytes[0].len()];
        bytes.chunks(3).flat_map(|row| [&row.concat()[..], &padding].concat()).collect()
    };
    for dialect in DIALECTS {
        for (name, info) in ROS_IMAGE.into_iter().zip(ROS_INFO) {
            let kinds = [
                ("16UC1", false, rows(steps.iter().map(|v| v.to_le_bytes().to_vec()).collect())),
                ("mono16", true, rows(steps.iter().map(|v| v.to_be_bytes().to_vec()).collect())),
                ("32FC1", false, rows(metres.iter().map(|v| v.to_le_bytes().to_vec()).collect())),
                ("32FC1", true, rows(metres.iter().map(|v| v.to_be_bytes().to_vec()).collect())),
            ];
            let encoding = dialect.encoding();
            let mut messages: Vec<Written> = kinds
                .iter()
                .zip(0..)
                .map(|((kind, is_big, data), k)| {
                    let bytes = ros_image(dialect, 100 * k + 5, kind, *is_big, data);
                    (100 * k + 9, "/camera/depth/image", name, encoding, bytes)
                })
                .collect();
            // Behind the first image.
            let known = ros_info(dialect, &[0.0; 5]);
            messages.insert(1, (10, "/camera/depth/camera_info", info, encoding, known));
            let (captures, notes) = noted(&file(&messages, None));
            assert_eq!((times(&captures), notes), (vec![0, 100, 200, 300], vec![]), "{dialect:?}");
            for view in depth_views(captures) {
                assert_eq!(view.depth, steps, "{dialect:?}");
                assert_eq!((view.camera.focal(), view.camera.centre()), ([4.0, 5.0], [1.0, 0.5]));
            }
        }
    }
}

/// A `CompressedImage` as image_transport's compressedDepth packs it.
fn packed_depths(format: &str, head: [f32; 2], pixels: &[u16; 6]) -> Vec<u8> {
    let png = crate::recording::image::encode(pixels, [3, 2]).unwrap();
    let numbers = head.map(f32::to_le_bytes).concat();
    let data = [&0_u32.to_le_bytes()[..], &numbers, &png].concat();
    Ros::new(Dialect::Little, 5, "optical").text(format).blob(&data).bytes()
}

#[test]
fn packed_depths_are_read() {
    let schema = "sensor_msgs/msg/CompressedImage";
    let topic = "/camera/depth/image_rect/compressedDepth";
    let info =
        (0, "/camera/depth/camera_info", ROS_INFO[0], "cdr", ros_info(Dialect::Little, &[0.1; 5]));
    let read = |bytes: Vec<u8>| {
        let messages = [info.clone(), (5, topic, schema, "cdr", bytes)];
        let (captures, notes) = noted(&file(&messages, None));
        assert_eq!(notes, [""; 0]);
        let views = depth_views(captures);
        // Rectified images have the projection's numbers and no distortion.
        assert_eq!(views[0].camera.focal(), [8.0, 8.0]);
        views[0].depth.clone()
    };
    let steps = [1000, 2000, 0, 4000, 5000, 65_535];
    assert_eq!(read(packed_depths("16UC1; compressedDepth png", [0.0; 2], &steps)), steps);
    assert_eq!(read(packed_depths("16UC1; compressedDepth", [0.0; 2], &steps)), steps);
    // As the transport does it: A = quantisation x (quantisation + 1), B = 1 - A / largest depth.
    let (a, largest) = (100.0_f32 * 101.0, 10.0_f32);
    let b = 1.0 - a / largest;
    let metres = [0.5_f32, 1.0, 1.5, 2.0, 5.0, f32::NAN];
    let inverse = metres.map(|depth| if depth.is_nan() { 0 } else { (a / depth + b) as u16 });
    let found = read(packed_depths("32FC1; compressedDepth png", [a, b], &inverse));
    for (found, metres) in found.iter().zip(metres) {
        let wanted = if metres.is_nan() { 0.0 } else { metres * 1000.0 };
        assert!((f32::from(*found) - wanted).abs() <= 4.0, "{found} for {wanted}");
    }
    let colour =
        Ros::new(Dialect::Little, 5, "optical").text("rgb8; jpeg compressed bgr8").blob(&[1; 9]);
    let messages = [info.clone(), (5, "/camera/colour/compressed", schema, "cdr", colour.bytes())];
    assert!(refused(&messages).contains("/camera/colour/compressed"));
    for length in [0, 11, 12, 40] {
        let whole = packed_depths("16UC1; compressedDepth png", [0.0; 2], &steps);
        let cut = Ros::new(Dialect::Little, 5, "optical").text("16UC1; compressedDepth png");
        let data = &whole[whole.len() - 90..][..length];
        let messages = [info.clone(), (5, topic, schema, "cdr", cut.blob(data).bytes())];
        assert!(refused(&messages).contains("compressedDepth"), "{length}");
    }
}

#[test]
fn distorted_images_are_made_straight_and_told() {
    let data: Vec<u8> = [1000_u16; 6].iter().flat_map(|v| v.to_le_bytes()).collect();
    let image = ros_image(Dialect::Little, 5, "16UC1", false, &data);
    let of = |d: &[f64]| {
        let info = (0, "/cam/camera_info", ROS_INFO[0], "cdr", ros_info(Dialect::Little, d));
        file(&[info, (5, "/cam/image_raw", ROS_IMAGE[0], "cdr", image.clone())], None)
    };
    let (captures, notes) = noted(&of(&[-0.1, 0.01, 0.0, 0.0, 0.0]));
    assert!(depth_views(captures)[0].depth.contains(&1000));
    assert!(notes[0].contains("made straight"), "{notes:?}");
    // Another camera's calibration beside it is of another frame.
    let other = Ros::new(Dialect::Little, 3, "colour").word(9).word(9).text("").word(0);
    let other = other.doubles(&[9.0; 9]).doubles(&[9.0; 9]).doubles(&[9.0; 12]).bytes();
    let own = (1, "/cam/depth_info", ROS_INFO[0], "cdr", ros_info(Dialect::Little, &[]));
    let messages = [
        (0, "/cam/colour_info", ROS_INFO[0], "cdr", other),
        own,
        (5, "/cam/image_raw", ROS_IMAGE[0], "cdr", image.clone()),
    ];
    assert_eq!(depth_views(noted(&file(&messages, None)).0)[0].camera.focal(), [4.0, 5.0]);
    let (captures, _) = read(&of(&[0.1; 3])).unwrap();
    let error = captures[0].as_ref().unwrap_err().to_string();
    assert!(error.contains("/cam/camera_info") && error.contains("rectified"), "{error}");
}

#[test]
fn topics_are_chosen_and_those_that_are_not_are_told() {
    let data: Vec<u8> = [1000_u16; 6].iter().flat_map(|v| v.to_le_bytes()).collect();
    let image = |topic| {
        (5, topic, ROS_IMAGE[0], "cdr", ros_image(Dialect::Little, 5, "16UC1", false, &data))
    };
    let info = |topic| (0, topic, ROS_INFO[0], "cdr", ros_info(Dialect::Little, &[]));
    let messages = [
        info("/camera/depth/camera_info"),
        info("/camera/aligned_depth_to_color/camera_info"),
        info("/camera/infra1/camera_info"),
        image("/camera/depth/image_rect_raw"),
        image("/camera/aligned_depth_to_color/image_raw"),
        image("/camera/infra1/image_rect_raw"),
        logged(5, 5),
    ];
    let bytes = file(&messages, None);
    let read = |topics: &[&str]| {
        let topics = topics.iter().map(|topic| (*topic).to_owned()).collect();
        let options = Options { topics, ..Options::default() };
        read_with(&bytes, &options).map(|(captures, _, notes)| {
            let captures: Vec<_> = captures.into_iter().map(Result::unwrap).collect();
            (captures[0].views.len(), notes)
        })
    };
    let (views, notes) = read(&[]).unwrap();
    assert_eq!((views, notes.len()), (1, 2), "{notes:?}");
    assert!(notes[0].contains("/camera/aligned_depth_to_color/image_raw"), "{notes:?}");
    assert!(notes[1].contains("/scan (sensor_msgs/msg/PointCloud2)"), "{notes:?}");
    assert_eq!(read(&["scan"]).unwrap(), (1, vec![]));
    assert_eq!(read(&["/scan", "camera/infra1/image_rect_raw"]).unwrap().0, 2);
    let error = read(&["/lidar"]).unwrap_err().to_string();
    assert!(error.contains("\"/lidar\"") && error.contains("/scan"), "{error}");
}

#[test]
fn one_broken_message_costs_itself_alone() {
    let mut messages: Vec<_> = (0..4).map(|k| logged(1000 + 100 * k, 1000 + 100 * k)).collect();
    messages[2].4.truncate(90);
    messages.push((1500, "/tf", TF, "cdr", vec![0, 1, 0, 0, 9]));
    let (captures, _, notes) = read_with(&file(&messages, None), &Options::default()).unwrap();
    let sound: Vec<bool> = captures.iter().map(Result::is_ok).collect();
    assert_eq!(sound, [true, true, false, true]);
    assert!(notes.len() == 1 && notes[0].contains("message 4 of /tf"), "{notes:?}");
}

#[test]
fn a_stream_gives_what_the_file_gives() {
    let mut messages = vec![moved(900, "/tf_static", 0, &["map", "lidar"], 2.0)];
    messages.extend((0..9).map(|k| logged(1000 + 100 * k, 990 + 100 * k)));
    for compression in [None, Some(Compression::Lz4)] {
        let bytes = file(&messages, compression);
        let (wanted, _) = noted(&bytes);
        let mut captures = stream(Cursor::new(bytes.clone()), &Options::default()).unwrap();
        let read: Vec<_> = captures.by_ref().map(Result::unwrap).collect();
        assert_eq!(read, wanted);
        assert!(captures.notes().is_empty());
        let cut = bytes[..bytes.len() / 2].to_vec();
        let mut captures = stream(Cursor::new(cut), &Options::default()).unwrap();
        let read = captures.by_ref().map(Result::unwrap).count();
        assert!((1..9).contains(&read), "{read}");
        let notes: Vec<_> = captures.notes().iter().collect();
        assert!(matches!(notes[..], [(Note::Unfinished(_), 1)]), "{notes:?}");
    }
    assert!(stream(Cursor::new(b"{}".to_vec()), &Options::default()).is_err());
}

#[test]
fn an_inertial_sensor_tells_the_way_up() {
    let imu = |k: u64| {
        let ros = Ros::new(Dialect::Little, 1000 + k, "imu").doubles(&[0.0; 25]);
        let bytes = ros.doubles(&[0.05 * (k as f64).sin(), -9.81, 0.0]).doubles(&[0.0; 9]).bytes();
        (1000 + k, "/imu", "sensor_msgs/msg/Imu", "cdr", bytes)
    };
    let mut messages = vec![logged(1000, 1000), moved(900, "/tf_static", 0, &["map", "imu"], 2.0)];
    messages.extend((0..50).map(imu));
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("drive.mcap");
    fs::write(&path, file(&messages, None)).unwrap();
    let up = super::super::super::open(&path).unwrap().measured_up().unwrap();
    assert!((up - Vector3::new(0.0, -1.0, 0.0)).norm() < 0.01, "{up}");
}

#[test]
fn a_folder_of_files_is_one_recording() {
    let folder = tempfile::tempdir().unwrap();
    let part = |from: u64, with: Option<Written>| {
        let scans = (from..from + 3).map(|k| logged(1000 + 100 * k, 1000 + 100 * k));
        file(&with.into_iter().chain(scans).collect::<Vec<_>>(), None)
    };
    let known = moved(900, "/tf_static", 0, &["map", "lidar"], 2.0);
    for (name, bytes) in [
        ("drive_0.mcap", part(0, Some(known))),
        ("drive_2.mcap", part(3, None)),
        ("drive_10.mcap", part(6, None)),
        ("metadata.yaml", b"x".to_vec()),
        ("._drive_0.mcap", b"x".to_vec()),
    ] {
        fs::write(folder.path().join(name), bytes).unwrap();
    }
    let captures = super::super::super::open(folder.path()).unwrap();
    let captures: Vec<_> = captures.map(Result::unwrap).collect();
    assert_eq!(times(&captures), [0, 100, 200, 300, 400, 500, 600, 700, 800]);
    assert_eq!(firsts(&captures), [2.0; 9]);
}

#[test]
fn sensors_far_from_the_origin_have_an_offset_taken_from_them() {
    let mut messages = vec![moved(900, "/tf_static", 0, &["map", "lidar"], 512_345.25)];
    messages.extend((0..3).map(|k| logged(1000 + 100 * k, 1000 + 100 * k)));
    let (captures, notes) = noted(&file(&messages, None));
    assert_eq!(firsts(&captures), [45.25; 3]);
    assert!(notes[0].contains("512300, 0, 0 m are subtracted"), "{notes:?}");
    let View::Cloud(cloud) = &captures[2].views[0] else { panic!() };
    assert_eq!(cloud.sensor, Some(Point3::new(45.25, 0.0, 1.0)));
}
