//! `rigidformer controls`: videos that decode to the frames that were drawn, and for every mistake its text and exit code.
//!
//! A crate reads the container. The decoder below knows no more of H.264 than our encoder writes; `cargo xtask controls` asks FFmpeg.
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)]

use std::fs;
use std::path::Path;
use std::process::{Command, Output, Stdio};

use nalgebra::{Isometry3, Point3, Vector3};
use re_mp4::{Mp4, StsdBoxContent};
use rigidformer_core::Physics;
use rigidformer_evaluation::scenes::{
    RecordedScene, RecordedUnit, SceneNotes, Split, Velocity, write_scene,
};
use serde_json::Value;
use tempfile::TempDir;

const NANO: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/../../weights/models/nano.rfm");
const SOFT: &str =
    concat!(env!("CARGO_MANIFEST_DIR"), "/../../tests/data/tiny-soft.scene.safetensors");

const SHELL: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/../../weights/models/shell.rfm");
const PHYSICS: Physics = Physics { mass_kg: 1.0, friction: 0.4, restitution: 0.3 };

/// In a folder of its own.
fn run(folder: &TempDir, arguments: &[&str]) -> Output {
    let mut program = Command::new(env!("CARGO_BIN_EXE_rigidformer"));
    program.arg("controls").args(arguments).current_dir(folder).stdin(Stdio::null());
    program.output().unwrap()
}

fn works(folder: &TempDir, arguments: &[&str]) -> String {
    let output = run(folder, arguments);
    let stderr = String::from_utf8(output.stderr).unwrap();
    assert!(output.status.success(), "{arguments:?}: {stderr}");
    String::from_utf8(output.stdout).unwrap()
}

fn fails(folder: &TempDir, arguments: &[&str], code: i32, expected: &[&str]) {
    let output = run(folder, arguments);
    let stderr = String::from_utf8(output.stderr).unwrap();
    assert_eq!(output.status.code(), Some(code), "{arguments:?}: {stderr}");
    for part in expected {
        assert!(stderr.contains(part), "{arguments:?}: no {part:?} in: {stderr}");
    }
    assert!(!stderr.contains("panicked"), "{stderr}");
}

/// Writes `scene.safetensors`, with one unit.
fn save(folder: &TempDir, unit: RecordedUnit) {
    let gravity = Vector3::new(0.0, 0.0, -9.81);
    let scene = RecordedScene::new("one", 1, Split::Test, 148.0, gravity, vec![unit])
        .unwrap()
        .with_planes(vec![rigidformer_core::Plane::ground(0.4, 0.3)])
        .unwrap();
    let text = || "a test".to_owned();
    let notes = SceneNotes { dataset: text(), provenance: text(), licence: "none".into() };
    write_scene(&folder.path().join("scene.safetensors"), &scene, &notes).unwrap();
}

/// Corners of a box, metres, whose lower face is at z = 0.
fn corners([x, y, z]: [f32; 3]) -> Vec<Point3<f32>> {
    let half = |bit: bool, side: f32| if bit { side / 2.0 } else { -side / 2.0 };
    let corner = |i: u8| {
        Point3::new(half(i & 1 > 0, x), half(i & 2 > 0, y), if i & 4 > 0 { z } else { 0.0 })
    };
    (0..8).map(corner).collect()
}

/// Red, green, blue; row by row.
fn png(path: &Path) -> Vec<[u8; 3]> {
    let file = std::io::BufReader::new(fs::File::open(path).unwrap());
    let mut reader = png::Decoder::new(file).read_info().unwrap();
    let mut bytes = vec![0; reader.output_buffer_size().unwrap()];
    reader.next_frame(&mut bytes).unwrap();
    bytes.as_chunks::<3>().0.to_vec()
}

fn names(folder: &Path) -> Vec<String> {
    let entries = fs::read_dir(folder).unwrap();
    let mut names: Vec<_> =
        entries.map(|entry| entry.unwrap().file_name().into_string().unwrap()).collect();
    names.sort();
    names
}

/// Reads what an encoder wrote.
struct Bits {
    bytes: Vec<u8>,
    at: usize,
}

impl Bits {
    /// Of a unit without its header.
    fn new(unit: &[u8]) -> Bits {
        let (mut bytes, mut zeros) = (Vec::new(), 0);
        for byte in unit {
            if zeros >= 2 && *byte == 3 {
                zeros = 0;
                continue;
            }
            assert!(zeros < 2 || *byte > 3, "the start of a unit within one");
            zeros = if *byte == 0 { zeros + 1 } else { 0 };
            bytes.push(*byte);
        }
        Bits { bytes, at: 0 }
    }

    fn bits(&mut self, count: usize) -> usize {
        let bits = (self.at..self.at + count)
            .fold(0, |all, at| 2 * all + (self.bytes[at / 8] >> (7 - at % 8) & 1) as usize);
        self.at += count;
        bits
    }

    fn number(&mut self) -> usize {
        let mut zeros = 0;
        while self.bits(1) == 0 {
            zeros += 1;
        }
        (1 << zeros) - 1 + self.bits(zeros)
    }

    /// Whether anything but the 1 at the end is left.
    fn has_more(&self) -> bool {
        let last = self.bytes.len() * 8 - 1 - self.bytes.last().unwrap().trailing_zeros() as usize;
        self.at < last
    }
}

/// Samples of one kind: a row's, a macroblock's side, and all.
struct Plane(usize, usize, Vec<u8>);

struct Decoder {
    columns: usize,
    rows: usize,
    is_exact: bool,
    planes: [Plane; 3],
}

impl Decoder {
    fn new([width, height]: [usize; 2], is_exact: bool) -> Decoder {
        let (columns, rows) = (width.div_ceil(16), height.div_ceil(16));
        let plane =
            |side: usize| Plane(columns * side, side, vec![0; columns * rows * side * side]);
        let chroma = if is_exact { 16 } else { 8 };
        Decoder { columns, rows, is_exact, planes: [plane(16), plane(chroma), plane(chroma)] }
    }

    fn decode(&mut self, unit: &[u8]) {
        let is_first = unit[0] == 0x65;
        assert!(is_first || unit[0] == 0x41);
        let mut bits = Bits::new(&unit[1..]);
        assert_eq!((bits.number(), bits.number()), (0, if is_first { 7 } else { 5 }));
        bits.number();
        bits.bits(8);
        assert_eq!(if is_first { bits.number() + bits.bits(2) } else { bits.bits(3) }, 0);
        assert_eq!((bits.number(), bits.number()), (0, 1), "nothing is deblocked");
        let mut stored = vec![false; self.columns * self.rows];
        let mut at = 0;
        while bits.has_more() {
            at += if is_first { 0 } else { bits.number() };
            if !bits.has_more() {
                break;
            }
            let kind = bits.number() - if is_first { 0 } else { 5 };
            let (column, row) = (at % self.columns, at / self.columns);
            if kind == 25 {
                bits.at = bits.at.next_multiple_of(8);
                stored[at] = true;
                for Plane(width, side, samples) in &mut self.planes {
                    for y in 0..*side {
                        let start = (row * *side + y) * *width + column * *side;
                        let bytes = &bits.bytes[bits.at / 8..][..*side];
                        samples[start..][..*side].copy_from_slice(bytes);
                        bits.at += 8 * *side;
                    }
                }
            } else {
                let luma = kind - 1;
                let chroma = if self.is_exact { luma } else { [9, 1, 0][bits.number()] };
                assert_eq!(bits.number(), 0, "the quantiser stays");
                let near = (column > 0 && stored[at - 1]) || (row > 0 && stored[at - self.columns]);
                for _ in 0..if self.is_exact { 3 } else { 1 } {
                    assert_eq!(bits.bits(if near { 6 } else { 1 }), if near { 3 } else { 1 });
                }
                for (Plane(width, side, samples), mode) in
                    self.planes.iter_mut().zip([luma, chroma, chroma])
                {
                    for y in 0..*side {
                        for x in 0..*side {
                            let place = (row * *side + y) * *width + column * *side + x;
                            let back = [(y + 1) * *width, x + 1][mode];
                            samples[place] = samples[place - back];
                        }
                    }
                }
            }
            at += 1;
        }
        assert!(at <= self.columns * self.rows);
    }
}

/// (frames) The planes of a video, after a look at its container.
fn decoded(path: &Path, size: [usize; 2], frames: usize, ticks: u64) -> Vec<[Vec<u8>; 3]> {
    let (mp4, bytes) = Mp4::read_file(path).unwrap();
    let track = mp4.tracks().values().next().unwrap();
    assert_eq!(mp4.tracks().len(), 1);
    assert_eq!([track.width, track.height].map(usize::from), size);
    assert_eq!(track.samples.len(), frames);
    for (number, sample) in track.samples.iter().enumerate() {
        assert_eq!((sample.timescale, sample.duration), (ticks, 1000));
        assert_eq!(sample.composition_timestamp, 1000 * number as i64);
        assert_eq!(sample.is_sync, number == 0);
    }
    let end = track.samples.last().unwrap().byte_range().end;
    assert_eq!(end, bytes.len(), "frames go to the end of the file");
    let StsdBoxContent::Avc1(avc1) = &track.trak(&mp4).mdia.minf.stbl.stsd.contents else {
        panic!("no H.264")
    };
    let is_exact = avc1.avcc.avc_profile_indication == 244;
    assert!(is_exact || avc1.avcc.avc_profile_indication == 66);
    let mut decoder = Decoder::new(size, is_exact);
    let frame = |sample: &re_mp4::Sample| {
        let sample = &bytes[sample.byte_range()];
        let length = u32::from_be_bytes(sample[..4].try_into().unwrap()) as usize;
        assert_eq!(length + 4, sample.len());
        decoder.decode(&sample[4..]);
        [0, 1, 2].map(|k| {
            // Without what fills up macroblocks.
            let Plane(width, side, samples) = &decoder.planes[k];
            let [wide, high] = size.map(|pixels| pixels * side / 16);
            samples.chunks(*width).take(high).flat_map(|row| &row[..wide]).copied().collect()
        })
    };
    track.samples.iter().map(frame).collect()
}

#[test]
fn exact_videos_are_the_frames_bit_for_bit() {
    let folder = tempfile::tempdir().unwrap();
    // An empty folder makes room for the frames.
    fs::create_dir(folder.path().join("png")).unwrap();
    // Not whole macroblocks, so the pictures are cut.
    let all = ["--model", NANO, "--mesh", "--exact", "--size", "90x52", "--frames", "7"];
    let more = ["--fps", "29.97", "--rendered", "r.mp4", "--png", "png"];
    works(&folder, &[&all[..], &more].concat());
    for (file, what) in [("tracking.mp4", "tracking"), ("r.mp4", "rendered")] {
        let frames = decoded(&folder.path().join(file), [90, 52], 7, 29_970);
        for (number, [green, blue, red]) in frames.into_iter().enumerate() {
            let pixels = png(&folder.path().join(format!("png/{number:05}-{what}.png")));
            assert_eq!(pixels.len(), 90 * 52);
            for (at, pixel) in pixels.into_iter().enumerate() {
                assert_eq!([red[at], green[at], blue[at]], pixel, "{what} {number} {at}");
            }
        }
    }
    assert_eq!(names(folder.path()), ["png", "r.mp4", "tracking.mp4"], "nothing temporary");
    assert_eq!(names(&folder.path().join("png")).len(), 14);
    #[cfg(unix)]
    {
        use std::os::unix::fs::PermissionsExt;
        // Of whatever umask the tests run with.
        let other = folder.path().join("other");
        fs::create_dir(&other).unwrap();
        let rights = |path: &Path| fs::metadata(path).unwrap().permissions().mode();
        assert_eq!(rights(&folder.path().join("png")), rights(&other));
    }
}

#[test]
fn usual_videos_are_the_frames_but_for_shared_chroma() {
    let folder = tempfile::tempdir().unwrap();
    let size = [96, 64];
    works(&folder, &["--model", NANO, "--size", "96x64", "--frames", "5", "--png", "png"]);
    let frames = decoded(&folder.path().join("tracking.mp4"), size, 5, 8000);
    for (number, [luma, blue, red]) in frames.into_iter().enumerate() {
        let pixels = png(&folder.path().join(format!("png/{number:05}-tracking.png")));
        let pixel = |at: usize| pixels[at].map(|channel| f32::from(channel) / 255.0);
        for (at, luma) in luma.into_iter().enumerate() {
            let [r, g, b] = pixel(at);
            let expected = 16.0 + 65.481 * r + 128.553 * g + 24.966 * b;
            assert!((f32::from(luma) - expected).abs() < 0.51, "{number} {at}");
        }
        for (at, (blue, red)) in blue.into_iter().zip(red).enumerate() {
            let first = at / 48 * 2 * 96 + at % 48 * 2;
            let four = [first, first + 1, first + 96, first + 97].map(pixel);
            let mean = |k: usize| four.iter().map(|pixel| pixel[k]).sum::<f32>() / 4.0;
            let [r, g, b] = [0, 1, 2].map(mean);
            let expected = [
                128.0 - 37.797 * r - 74.203 * g + 112.0 * b,
                128.0 + 112.0 * r - 93.786 * g - 18.214 * b,
            ];
            for (found, expected) in [blue, red].into_iter().zip(expected) {
                assert!((f32::from(found) - expected).abs() < 0.51, "{number} {at}");
            }
        }
    }
}

#[test]
fn the_first_frame_has_the_colours_of_places_and_is_the_recorded_one() {
    let folder = tempfile::tempdir().unwrap();
    let usual = ["--size", "240x160", "--frames", "3", "--mesh"];
    let seen = ["--eye", "1,-6,6", "--look-at", "-1.6,0.2,1.5", "--seconds", "0.5"];
    let frame = |name: &str, number: usize| {
        png(&folder.path().join(format!("{name}/{number:05}-tracking.png")))
    };
    works(&folder, &[&usual[..], &seen, &["--model", NANO, "--png", "a"]].concat());
    works(&folder, &[&usual[..], &seen, &["--recorded", "--png", "b"]].concat());
    let first = frame("a", 0);
    let lit = first.iter().enumerate().filter(|(_, pixel)| **pixel != [0; 3]);
    let mut count = 0;
    for (at, [red, green, _]) in lit {
        let part = |at: usize, side: f32| 255.0 * (at as f32 + 0.5) / side;
        assert!((f32::from(*red) - part(at % 240, 240.0)).abs() < 1.0, "{at}");
        assert!((f32::from(*green) - part(at / 240, 160.0)).abs() < 1.0, "{at}");
        count += 1;
    }
    assert!(count > 1000, "{count} pixels");
    // Frame 0 is observed; later ones are predicted.
    assert_eq!(first, frame("b", 0));
    assert_ne!(frame("a", 2), frame("b", 2));
    assert_ne!(frame("a", 0), frame("a", 2));
}

#[test]
fn the_summary_says_what_was_made() {
    let folder = tempfile::tempdir().unwrap();
    let usual = ["--model", NANO, "--size", "96x64", "--frames", "2"];
    let printed = works(&folder, &[&usual[..], &["--json", "--seconds", "0.25"]].concat());
    let made: Value = serde_json::from_str(&printed).unwrap();
    let expected = [("frames", 2.0), ("rate_hz", 8.0), ("span_s", 0.25), ("points", 296.0)];
    for (name, value) in expected {
        assert_eq!(made[name], value, "{name}");
    }
    let bytes = fs::metadata(folder.path().join("tracking.mp4")).unwrap().len();
    assert_eq!(made["bytes"], bytes);
    assert_eq!(made["poses"], "predicted by nano, step 10");
    assert!(made["rendered"].is_null());
    let printed = works(&folder, &usual);
    for part in ["2 frames of 96 x 64 pixels over 0.500 s", "camera at", "wrote tracking.mp4"] {
        assert!(printed.contains(part), "no {part:?} in {printed}");
    }
}

#[test]
fn numbers_are_those_that_were_given() {
    let folder = tempfile::tempdir().unwrap();
    let usual = ["--recorded", "--size", "32x16", "--frames", "2", "--fps", "29.97"];
    let printed = works(&folder, &[&usual[..], &["--json", "--seconds", "0.1"]].concat());
    let made: Value = serde_json::from_str(&printed).unwrap();
    assert_eq!((&made["rate_hz"], &made["span_s"]), (&29.97.into(), &0.1.into()));
    let printed = works(&folder, &usual);
    assert!(printed.contains("at 29.97 frames a second"), "{printed}");
}

#[test]
fn surfaces_that_reach_behind_the_camera_are_in_both_videos() {
    let folder = tempfile::tempdir().unwrap();
    save(
        &folder,
        RecordedUnit::new(
            "slab",
            corners([10.0, 10.0, 0.2]),
            PHYSICS,
            vec![Isometry3::identity(); 3],
        ),
    );
    let usual = ["scene.safetensors", "--recorded", "--mesh", "--size", "240x160", "--frames", "1"];
    // None of its corners is in the picture.
    let seen = ["--view", "50", "--eye", "0,-3,1", "--look-at", "0,0,.8"];
    let output = run(
        &folder,
        &[&usual[..], &seen, &["--png", "png", "--rendered", "rendered.mp4"]].concat(),
    );
    let stderr = String::from_utf8(output.stderr).unwrap();
    assert!(output.status.success() && !stderr.contains("nothing is in"), "{stderr}");
    let frame = |what: &str| png(&folder.path().join(format!("png/00000-{what}.png")));
    let (tracking, rendered) = (frame("tracking"), frame("rendered"));
    let lit: Vec<_> = tracking.iter().zip(&rendered).filter(|(lit, _)| **lit != [0; 3]).collect();
    assert!(lit.len() > 240 * 60, "{}", lit.len());
    // Units have colours, the ground has none to speak of. Edges are mixed with what is beside them.
    let is_coloured =
        |pixel: &[u8; 3]| pixel.iter().max().unwrap().abs_diff(*pixel.iter().min().unwrap()) > 40;
    let coloured = lit.iter().filter(|(_, pixel)| is_coloured(pixel)).count();
    assert!(coloured + 2 * 240 > lit.len(), "{coloured} of {}", lit.len());

    let away = ["--eye", "0,-3,1", "--look-at", "0,-3,9", "--out", "away.mp4", "--png", "away"];
    fails(&folder, &[&usual[..], &away].concat(), 2, &["sees no unit", "--look-at 0.00,0.00,0.10"]);
    assert!(!names(folder.path()).iter().any(|name| name.starts_with(['a', '.'])));
}

#[test]
fn blue_is_in_the_middle_where_depths_do_not_differ() {
    let folder = tempfile::tempdir().unwrap();
    let points = [[0.0, 0.0, 0.5], [9.0, 0.0, 0.5], [0.0, 0.0, 9.0], [9.0, 9.0, 9.0]];
    let points = points.into_iter().map(Point3::from).collect();
    save(&folder, RecordedUnit::new("points", points, PHYSICS, vec![Isometry3::identity(); 3]));
    let usual = ["scene.safetensors", "--recorded", "--size", "32x16", "--frames", "1"];
    let seen = ["--eye", "0,-3,.5", "--look-at", "0,0,.5", "--view", "30"];
    let printed = works(&folder, &[&usual[..], &seen].concat());
    assert!(printed.contains("blue is 128 throughout") && !printed.contains("inf"), "{printed}");
}

#[test]
fn scenes_with_velocities_are_rolled_out() {
    let folder = tempfile::tempdir().unwrap();
    let velocity = Velocity {
        linear_m_s: Vector3::new(1.0, 0.5, 0.25),
        angular_rad_s: Vector3::new(0.0, 0.0, 3.0),
    };
    let pose = |frame: u8| {
        let t = f32::from(frame) / 148.0;
        let fall = Vector3::new(0.0, 0.0, 2.0 - 0.5 * 9.81 * t * t);
        Isometry3::new(fall + velocity.linear_m_s * t, velocity.angular_rad_s * t)
    };
    let poses = (0..=40).map(pose).collect();
    let unit = RecordedUnit::new("cube", corners([0.1; 3]), PHYSICS, poses);
    save(&folder, unit.with_velocity(velocity));
    let usual = ["scene.safetensors", "--model", NANO, "--size", "32x16", "--frames", "3"];
    for more in [&[][..], &["--join"]] {
        let printed = works(&folder, &[&usual[..], more].concat());
        assert!(printed.contains("predicted by nano"), "{printed}");
    }
}

#[test]
fn points_without_bounds_are_refused() {
    let folder = tempfile::tempdir().unwrap();
    let far = Isometry3::translation(3e38, 0.0, 0.0);
    save(&folder, RecordedUnit::new("box", corners([1.0; 3]), PHYSICS, vec![far; 3]));
    let arguments = ["scene.safetensors", "--recorded", "--frames", "1"];
    fails(&folder, &arguments, 1, &["seed 1: the record", "1000000 m away", "--index"]);
}

#[test]
fn soft_units_bend() {
    let folder = tempfile::tempdir().unwrap();
    let usual = [SOFT, "--recorded", "--size", "96x64", "--frames", "3", "--mesh"];
    works(&folder, &[&usual[..], &["--rendered", "r.mp4", "--png", "png"]].concat());
    let frame = |number: usize| png(&folder.path().join(format!("png/{number:05}-tracking.png")));
    let lit = |number: usize| frame(number).iter().filter(|pixel| **pixel != [0; 3]).count();
    assert!(lit(0) > 500 && lit(2) > 500);
    assert_ne!(frame(0), frame(2));
    let printed = works(&folder, &[SOFT, "--model", SHELL, "--size", "96x64", "--frames", "3"]);
    assert!(printed.contains("predicted by"), "{printed}");
}

#[test]
fn mistakes_have_names_and_remedies() {
    let folder = tempfile::tempdir().unwrap();
    fs::create_dir_all(folder.path().join("used/full")).unwrap();
    let away = ["--eye", "3,0,1", "--look-at", "9,0,1"];
    fs::create_dir(folder.path().join("empty")).unwrap();
    #[cfg(unix)]
    std::os::unix::fs::symlink("empty", folder.path().join("link")).unwrap();
    let whole = folder.path().join("tracking.mp4").display().to_string();
    let here = folder.path().display().to_string();
    let cases: &[(&[&str], i32, &[&str])] = &[
        (&["--size", "721x480"], 2, &["721x480", "give 722x480"]),
        (&["--size", "big"], 2, &["640x480"]),
        (&["--size", "9000x100"], 2, &["9000x100", "16 to 4096"]),
        (&["--frames", "0"], 2, &["--frames"]),
        (&["--index", "7"], 1, &["scene 7 of 1"]),
        (&["--seconds", "3"], 2, &["--seconds 3", "0.500 s", "give less"]),
        (&["--seconds", "0.6"], 2, &["--seconds 0.6:"]),
        (&["--step", "70"], 2, &["frame 140", "121 frames", "smaller step"]),
        (&away, 2, &["sees no unit", "--look-at -1."]),
        (&["--eye", "1,1,1", "--look-at", "1,1,1"], 2, &["two places"]),
        (&["--eye", "1,1"], 2, &["three numbers"]),
        (&["--out", "none/x.mp4"], 2, &["none/x.mp4", "make it first"]),
        (&["--out", "used"], 2, &["name a file in it"]),
        (&["--rendered", "tracking.mp4"], 2, &["give two names"]),
        (&["--rendered", "./tracking.mp4"], 2, &["./tracking.mp4", "give two names"]),
        (&["--rendered", &whole], 2, &["give two names"]),
        (&["--rendered", "used/../tracking.mp4"], 2, &["give two names"]),
        (&["--png", "./tracking.mp4"], 2, &["give two names"]),
        (&["--png", "used"], 2, &["empty it"]),
        (&["--png", "."], 2, &["--png .", "folder that you are in"]),
        (&["--png", &here], 2, &["folder that you are in"]),
        #[cfg(unix)]
        (&["--png", "link"], 2, &["--png link", "is a link"]),
        #[cfg(unix)]
        (&["--png", "link/"], 2, &["is a link"]),
        (&["--out", "empty/x.mp4", "--png", "empty"], 2, &["a video goes into this folder"]),
        (&["--out", "new/"], 2, &["--out new/", "ends like a folder"]),
        (&["--rendered", "new/"], 2, &["--rendered new/", "ends like a folder"]),
        (&["--recorded", "--step", "5"], 2, &["--recorded"]),
    ];
    for (arguments, code, expected) in cases {
        fails(&folder, arguments, *code, expected);
    }
    let kept = names(folder.path());
    assert_eq!(kept.iter().filter(|name| *name != "link").collect::<Vec<_>>(), ["empty", "used"]);
}

#[test]
#[cfg(target_os = "linux")]
fn ctrl_c_leaves_no_file() {
    use std::time::{Duration, Instant};

    let folder = tempfile::tempdir().unwrap();
    let mut command = Command::new(env!("CARGO_BIN_EXE_rigidformer"));
    command.args(["controls", "--model", NANO, "--frames", "5000", "--png", "png"]);
    command.args(["--rendered", "r.mp4"]).current_dir(&folder);
    let child = command.stdout(Stdio::piped()).stderr(Stdio::piped()).spawn().unwrap();
    let start = Instant::now();
    // The temporary files come after the handler.
    while names(folder.path()).len() < 3 {
        assert!(start.elapsed() < Duration::from_secs(120), "it does not begin");
        std::thread::sleep(Duration::from_millis(2));
    }
    let process = rustix::process::Pid::from_child(&child);
    rustix::process::kill_process(process, rustix::process::Signal::INT).unwrap();
    let output = child.wait_with_output().unwrap();
    let stderr = String::from_utf8(output.stderr).unwrap();
    assert_eq!(output.status.code(), Some(130), "{stderr}");
    assert!(stderr.contains("interrupted; nothing was written"), "{stderr}");
    assert!(names(folder.path()).is_empty());
}
