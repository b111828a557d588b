//! Files for viewers: read again by other programs, they have the bits of poses.csv.
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)]

use std::collections::{BTreeMap, BTreeSet};
use std::fs;
use std::io::{Cursor, Read};
use std::path::{Path, PathBuf};
use std::process::{Command, Output, Stdio};

use base64::Engine;
use base64::engine::general_purpose::STANDARD;
use gltf::animation::util::ReadOutputs;
use mcap::sans_io::LinearReaderOptions;
use mcap::sans_io::decompressor::DecompressResult;
use prost::Message;
use prost_types::FileDescriptorSet;
use serde_json::Value;
use tempfile::TempDir;

const NANO: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/../../weights/models/nano.rfm");
const SCENE: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/scenes/default.safetensors");

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
}

/// x, y, z, then the quaternion's x, y, z, w.
type Pose = [f32; 7];

/// A folder with a rollout in it.
struct Rollout {
    folder: TempDir,
    times: Vec<f64>,
    /// (frames, units)
    predicted: Vec<Vec<Pose>>,
    truth: Vec<Vec<Pose>>,
}

impl Rollout {
    fn new(more: &[&str]) -> Rollout {
        let folder = tempfile::tempdir().unwrap();
        let file = |name: &str| folder.path().join(name).to_str().unwrap().to_owned();
        let (out, mcap, glb, html) =
            (file("out"), file("scene.mcap"), file("scene.glb"), file("scene.html"));
        let files = ["--out", &out, "--mcap", &mcap, "--gltf", &glb, "--html", &html];
        let printed = works(&[&["rollout", "--model", NANO], more, &files[..]].concat());
        for name in ["scene.mcap", "scene.glb", "scene.html"] {
            assert!(printed.contains(name), "no {name} in {printed}");
        }
        let mut rollout =
            Rollout { folder, times: Vec::new(), predicted: Vec::new(), truth: Vec::new() };
        let csv = fs::read_to_string(rollout.path("out/poses.csv")).unwrap();
        for line in csv.lines().skip(1) {
            let cells: Vec<&str> = line.split(',').collect();
            let pose = |first: usize| {
                let [x, y, z, w, i, j, k]: [f32; 7] =
                    std::array::from_fn(|at| cells[first + at].parse().unwrap());
                [x, y, z, i, j, k, w]
            };
            if cells[2] == "0" {
                rollout.times.push(cells[1].parse().unwrap());
                rollout.predicted.push(Vec::new());
                rollout.truth.push(Vec::new());
            }
            rollout.predicted.last_mut().unwrap().push(pose(3));
            rollout.truth.last_mut().unwrap().push(pose(10));
        }
        rollout
    }

    fn path(&self, name: &str) -> PathBuf {
        self.folder.path().join(name)
    }
}

fn bits(numbers: impl IntoIterator<Item = f32>) -> Vec<u32> {
    numbers.into_iter().map(f32::to_bits).collect()
}

#[test]
fn gltf_is_valid_and_moves_by_the_bits_of_the_rollout() {
    let rollout = Rollout::new(&["--frames", "60"]);
    let bytes = fs::read(rollout.path("scene.glb")).unwrap();
    // Reading validates everything.
    let file = gltf::Gltf::from_slice(&bytes).unwrap();
    let binary = file.blob.clone().unwrap();
    let animation = file.animations().next().unwrap();
    let mut found: BTreeMap<(String, bool), (Vec<f32>, Vec<f32>)> = BTreeMap::new();
    for channel in animation.channels() {
        assert_eq!(channel.sampler().interpolation(), gltf::animation::Interpolation::Linear);
        let reader = channel.reader(|_| Some(&binary));
        let times: Vec<f32> = reader.read_inputs().unwrap().collect();
        let (is_turn, values) = match reader.read_outputs().unwrap() {
            ReadOutputs::Translations(values) => (false, values.flatten().collect()),
            ReadOutputs::Rotations(values) => (true, values.into_f32().flatten().collect()),
            _ => panic!("something else is animated"),
        };
        let name = channel.target().node().name().unwrap().to_owned();
        found.insert((name, is_turn), (times, values));
    }
    let units = rollout.predicted[0].len();
    assert_eq!(found.len(), 4 * units);
    for ((name, is_turn), (times, values)) in found {
        let unit: usize = name.split(' ').next().unwrap().parse().unwrap();
        let known = if name.ends_with("(recorded)") { &rollout.truth } else { &rollout.predicted };
        let part = if is_turn { 3..7 } else { 0..3 };
        let expected = known.iter().flat_map(|poses| poses[unit][part.clone()].iter().copied());
        assert_eq!(bits(values), bits(expected), "{name}");
        assert!(times.iter().zip(&rollout.times).all(|(a, b)| (f64::from(*a) - b).abs() < 1e-5));
        assert_eq!(times.len(), rollout.times.len());
    }
    // A root that turns z up, and below it all others; normals that are flat.
    let root = file.default_scene().unwrap().nodes().next().unwrap();
    assert_eq!(root.children().count(), 2 * units + 1);
    for mesh in file.meshes() {
        let primitive = mesh.primitives().next().unwrap();
        let reader = primitive.reader(|_| Some(&binary));
        let normals: Vec<_> = reader.read_normals().unwrap().collect();
        assert_eq!(normals.len(), reader.read_positions().unwrap().count());
        assert!(normals.chunks(3).all(|three| three[0] == three[1] && three[1] == three[2]));
    }
}

#[derive(Clone, PartialEq, Message)]
struct Vector {
    #[prost(double, tag = "1")]
    x: f64,
    #[prost(double, tag = "2")]
    y: f64,
    #[prost(double, tag = "3")]
    z: f64,
    #[prost(double, tag = "4")]
    w: f64,
}

#[derive(Clone, PartialEq, Message)]
struct Transform {
    #[prost(message, optional, tag = "1")]
    timestamp: Option<prost_types::Timestamp>,
    #[prost(string, tag = "2")]
    parent: String,
    #[prost(string, tag = "3")]
    child: String,
    #[prost(message, optional, tag = "4")]
    translation: Option<Vector>,
    #[prost(message, optional, tag = "5")]
    rotation: Option<Vector>,
}

#[derive(Clone, PartialEq, Message)]
struct Transforms {
    #[prost(message, repeated, tag = "1")]
    transforms: Vec<Transform>,
}

#[derive(Clone, PartialEq, Message)]
struct Contact {
    #[prost(string, tag = "1")]
    unit: String,
    #[prost(string, tag = "2")]
    other: String,
    #[prost(double, tag = "3")]
    time_s: f64,
    #[prost(double, tag = "4")]
    distance_m: f64,
}

#[derive(Clone, PartialEq, Message)]
struct TimeToContact {
    #[prost(message, repeated, tag = "2")]
    contacts: Vec<Contact>,
}

/// Unpacks chunks, which the crate does by libraries of C alone.
#[derive(Default)]
struct Lz4 {
    packed: Vec<u8>,
    /// What is unpacked, last byte first.
    left: Vec<u8>,
}

impl mcap::sans_io::decompressor::Decompressor for Lz4 {
    fn next_read_size(&self) -> usize {
        0
    }

    fn decompress(&mut self, from: &[u8], to: &mut [u8]) -> mcap::McapResult<DecompressResult> {
        self.packed.extend(from);
        if !self.packed.is_empty() {
            let mut all = Vec::new();
            let read = lz4_flex::frame::FrameDecoder::new(&self.packed[..]).read_to_end(&mut all);
            // The rest of the frame is still to come where this fails.
            if read.is_ok() {
                all.reverse();
                (self.packed, self.left) = (Vec::new(), all);
            }
        }
        let wrote = to.len().min(self.left.len());
        to[..wrote].fill_with(|| self.left.pop().unwrap());
        Ok(DecompressResult { consumed: from.len(), wrote })
    }

    fn reset(&mut self) -> mcap::McapResult<()> {
        assert!(self.packed.is_empty() && self.left.is_empty());
        Ok(())
    }

    fn name(&self) -> &'static str {
        "lz4"
    }
}

/// Messages of a file all of whose checksums are right.
fn messages(bytes: &[u8]) -> impl Iterator<Item = mcap::Message<'static>> {
    let options = LinearReaderOptions::default()
        .with_prevalidate_chunk_crcs(true)
        .with_validate_data_section_crc(true)
        .with_validate_summary_section_crc(true);
    let mut reader = mcap::io::MessageReader::new_with_options(Cursor::new(bytes), options);
    reader.add_decompressor(Lz4::default()).unwrap();
    reader.map(Result::unwrap)
}

#[test]
fn mcap_has_looks_once_and_the_bits_of_the_rollout() {
    // So many frames that some see units touch.
    let rollout = Rollout::new(&["--step", "1"]);
    let bytes = fs::read(rollout.path("scene.mcap")).unwrap();
    let summary = mcap::Summary::read(&bytes).unwrap().unwrap();
    assert!(!summary.chunk_indexes.is_empty() && !summary.metadata_indexes.is_empty());
    for chunk in &summary.chunk_indexes {
        assert_eq!(chunk.compression, "lz4");
        // Indexes are where they are said to be.
        let start = chunk.chunk_start_offset as usize;
        assert_eq!(bytes[start], 6);
        assert_eq!(bytes[start + chunk.chunk_length as usize], 7);
        assert!(chunk.message_index_offsets.values().all(|at| bytes[*at as usize] == 7));
        assert_eq!(
            chunk.compressed_data_offset().unwrap() + chunk.compressed_size,
            chunk.chunk_start_offset + chunk.chunk_length
        );
        assert!(chunk.compressed_size * 3 < chunk.uncompressed_size);
    }
    assert!(summary.metadata_indexes.iter().all(|index| bytes[index.offset as usize] == 12));
    let (mut counts, mut contacts, mut frame) = (BTreeMap::new(), Vec::new(), 0);
    for message in messages(&bytes) {
        let schema = message.channel.schema.clone().unwrap();
        let files = FileDescriptorSet::decode(&*schema.data).unwrap();
        let names: BTreeSet<_> = files
            .file
            .iter()
            .flat_map(|f| f.message_type.iter().map(|m| format!("{}.{}", f.package(), m.name())))
            .collect();
        assert!(names.contains(&schema.name), "{}", schema.name);
        *counts.entry(message.channel.topic.clone()).or_insert(0) += 1;
        match message.channel.topic.as_str() {
            "/tf" => {}
            "/time_to_contact" => {
                assert_eq!(schema.name, "rigidformer.TimeToContact");
                let now = TimeToContact::decode(&*message.data).unwrap().contacts;
                contacts.push((message.log_time as f64 / 1e9, now));
                continue;
            }
            "/contacts" => continue,
            _ => {
                assert_eq!((schema.name.as_str(), message.log_time), ("foxglove.SceneUpdate", 0));
                continue;
            }
        }
        assert!((message.log_time as f64 / 1e9 - rollout.times[frame]).abs() < 1e-6);
        let transforms = Transforms::decode(&*message.data).unwrap().transforms;
        assert_eq!(transforms.len(), 2 * rollout.predicted[frame].len());
        for transform in transforms {
            assert_eq!(transform.parent, "world");
            let (kind, label) = transform.child.split_once('/').unwrap();
            let unit: usize = label.split(' ').next().unwrap().parse().unwrap();
            let known = if kind == "truth" { &rollout.truth } else { &rollout.predicted };
            let (t, r) = (transform.translation.unwrap(), transform.rotation.unwrap());
            let read = [t.x, t.y, t.z, r.x, r.y, r.z, r.w].map(|number| number as f32);
            assert_eq!(bits(read), bits(known[frame][unit]), "{}", transform.child);
        }
        frame += 1;
    }
    let once = ["/planes", "/points", "/predicted", "/truth"].map(|topic| (topic.to_owned(), 1));
    let steps = rollout.times.len();
    let each = ["/tf", "/contacts", "/time_to_contact"].map(|topic| (topic.to_owned(), steps));
    assert_eq!(counts, BTreeMap::from(once).into_iter().chain(each).collect());

    let all = || contacts.iter().flat_map(|(_, contacts)| contacts);
    let touching: Vec<_> = all().filter(|contact| contact.time_s == 0.0).collect();
    assert!(touching.iter().all(|contact| contact.distance_m <= 1.001e-3), "{touching:?}");
    // Whoever waits for a contact waits for the same instant in the next frame, until it is there.
    let mut waits = 0;
    for pair in contacts.windows(2) {
        let [(now_s, now), (then_s, then)] = pair else { unreachable!() };
        for contact in now.iter().filter(|contact| contact.time_s != 0.0) {
            waits += 1;
            let names = |contact: &Contact| (contact.unit.clone(), contact.other.clone());
            let due_s = now_s + contact.time_s;
            if (*now_s..=*then_s + 1e-6).contains(&due_s) {
                // They may have parted again.
                continue;
            }
            let later = then.iter().find(|other| names(other) == names(contact)).unwrap();
            let still_due_s = then_s + later.time_s;
            assert!((due_s - still_due_s).abs() < 1e-6, "{contact:?} {later:?}");
        }
    }
    assert!(waits > 0 && !touching.is_empty(), "{waits} {touching:?}");
}

/// A reader that shares nothing with ours.
const READ: &str = r#"
import sys
try:
    from mcap.reader import make_reader
    from mcap_protobuf.decoder import DecoderFactory
except ImportError as error:
    print("skip", error)
    sys.exit(0)
counts, spheres, lines = {}, 0, 0
with open(sys.argv[1], "rb") as file:
    reader = make_reader(file, validate_crcs=True, decoder_factories=[DecoderFactory()])
    for schema, channel, message, decoded in reader.iter_decoded_messages():
        counts[channel.topic] = counts.get(channel.topic, 0) + 1
        if schema.name == "foxglove.SceneUpdate":
            assert decoded.deletions[0].type == 1
            assert all(entity.frame_locked for entity in decoded.entities)
            spheres += sum(len(entity.spheres) for entity in decoded.entities)
            lines += sum(len(entity.lines) for entity in decoded.entities)
            assert all(text.text.endswith(" s") for entity in decoded.entities for text in entity.texts)
        elif schema.name == "rigidformer.TimeToContact":
            assert all(contact.time_s >= 0 and contact.unit and contact.other for contact in decoded.contacts)
        else:
            assert all(transform.parent_frame_id == "world" for transform in decoded.transforms)
print("read", counts["/tf"], counts["/time_to_contact"], counts["/predicted"], spheres, lines)
"#;

#[test]
fn mcap_is_read_by_python() {
    let rollout = Rollout::new(&[]);
    let python = std::env::var_os("RIGIDFORMER_PYTHON").unwrap_or_else(|| "python3".into());
    let path = rollout.path("scene.mcap");
    let Ok(output) = Command::new(&python).args(["-c", READ]).arg(&path).output() else {
        println!(
            "skipped: {} cannot be started; name one with RIGIDFORMER_PYTHON",
            python.display()
        );
        return;
    };
    let printed = String::from_utf8(output.stdout).unwrap();
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    if printed.starts_with("skip") {
        println!(
            "skipped: {} has no mcap: {printed}; install mcap-protobuf-support",
            python.display()
        );
        return;
    }
    let steps = rollout.times.len();
    assert!(
        printed.starts_with(&format!("read {steps} {steps} 1 ")) && !printed.contains(" 0"),
        "{printed}"
    );
}

/// What stands between two texts.
fn between<'t>(text: &'t str, before: &str, after: &str) -> &'t str {
    text.split_once(before).unwrap().1.split_once(after).unwrap().0
}

#[test]
fn the_page_needs_nothing_else_and_has_the_bits_of_the_rollout() {
    let rollout = Rollout::new(&["--frames", "60"]);
    let page = fs::read_to_string(rollout.path("scene.html")).unwrap();
    let lower = page.to_lowercase();
    for word in
        ["http:", "https:", "src=", "import ", "fetch(", "xmlhttprequest", "@import", "url("]
    {
        assert!(!lower.contains(word), "{word}");
    }
    let scene = between(&page, r#"<script type="application/json" id="scene">"#, "</script>");
    let scene: Value = serde_json::from_str(scene).unwrap();
    let data = between(&page, r#"id="data">"#, "</script>");
    assert!(page.len() - data.len() - scene.to_string().len() < 25_000);
    let data = STANDARD.decode(data).unwrap();
    let numbers: Vec<f32> =
        data.chunks_exact(4).map(|four| f32::from_le_bytes(four.try_into().unwrap())).collect();
    let part = |name: &str| {
        let at = |end: usize| scene[name][end].as_u64().unwrap() as usize;
        numbers[at(0)..at(0) + at(1)].to_vec()
    };
    let flat = |all: &[Vec<Pose>]| bits(all.iter().flatten().flatten().copied());
    assert_eq!(bits(part("poses")), flat(&rollout.predicted));
    assert_eq!(bits(part("truth")), flat(&rollout.truth));
    assert_eq!(part("times").len(), rollout.times.len());
}

/// A browser without a window, if this machine has one.
fn browser() -> Option<PathBuf> {
    let names = ["chromium", "chromium-browser", "google-chrome"];
    let folders = std::env::var_os("PATH")?;
    let all = std::env::split_paths(&folders);
    all.flat_map(|folder| names.map(|name| folder.join(name))).find(|path| path.is_file())
}

/// Colours of a screenshot.
fn colours(png: &Path) -> usize {
    let decoder = png::Decoder::new(std::io::BufReader::new(fs::File::open(png).unwrap()));
    let mut reader = decoder.read_info().unwrap();
    let mut pixels = vec![0; reader.output_buffer_size().unwrap()];
    let info = reader.next_frame(&mut pixels).unwrap();
    let (width, bytes) = (info.width as usize, info.color_type.samples());
    // Right of the legend and above the bar there is nothing but the canvas.
    let rows = pixels.chunks(info.line_size).take(info.height as usize * 3 / 4);
    let pixel = |row: &[u8], x: usize| row[x * bytes..x * bytes + 3].to_vec();
    let of_row = |row: &[u8]| (width * 2 / 5..width).map(|x| pixel(row, x)).collect::<Vec<_>>();
    rows.flat_map(of_row).collect::<BTreeSet<_>>().len()
}

#[test]
fn a_browser_draws_the_page() {
    let Some(browser) = browser() else {
        println!("skipped: no Chromium is installed; install chromium");
        return;
    };
    let rollout = Rollout::new(&["--frames", "60"]);
    let (page, shot) = (rollout.path("scene.html"), rollout.path("shot.png"));
    let output = Command::new(&browser)
        .args(["--headless", "--no-sandbox", "--hide-scrollbars", "--window-size=1000,640"])
        .args(["--use-gl=angle", "--use-angle=swiftshader", "--enable-unsafe-swiftshader"])
        .arg(format!("--user-data-dir={}", rollout.path("profile").display()))
        .arg(format!("--screenshot={}", shot.display()))
        .args(["--virtual-time-budget=2000"])
        .arg(format!("file://{}#t=0.1", page.display()))
        .output()
        .unwrap();
    if !shot.is_file() {
        let words = String::from_utf8_lossy(&output.stderr);
        println!("skipped: {} takes no screenshot here: {words}", browser.display());
        return;
    }
    let colours = colours(&shot);
    assert!(colours > 100, "{colours} colours are in the canvas: nothing is drawn");
}

#[test]
fn one_frame_beyond_the_observed_ones_is_enough() {
    let rollout = Rollout::new(&["--step", "10", "--frames", "20"]);
    assert_eq!(rollout.times.len(), 3);
    gltf::Gltf::from_slice(&fs::read(rollout.path("scene.glb")).unwrap()).unwrap();
}

#[test]
fn an_evaluated_scene_is_shown_to_the_end_of_its_record() {
    let folder = tempfile::tempdir().unwrap();
    let mcap = folder.path().join("scene.mcap");
    let few = ["evaluate", SCENE, "--model", NANO, "--steps", "10", "--index", "0", "--json"];
    works(&[&few[..], &["--mcap", mcap.to_str().unwrap()]].concat());
    let bytes = fs::read(&mcap).unwrap();
    let times: Vec<u64> =
        messages(&bytes).filter(|m| m.channel.topic == "/tf").map(|m| m.log_time).collect();
    assert_eq!((times.len(), times.last()), (13, Some(&500_000_000)));
}

#[test]
fn what_is_tracked_comes_and_goes() {
    let folder = tempfile::tempdir().unwrap();
    let file = |name: &str| folder.path().join(name).to_str().unwrap().to_owned();
    let (mcap, glb, html) = (file("t.mcap"), file("t.glb"), file("t.html"));
    let track = ["track", SCENE, "--render", "--rate", "15", "--no-model", "--json"];
    works(&[&track[..], &["--mcap", &mcap, "--gltf", &glb, "--html", &html]].concat());
    let read = gltf::Gltf::from_slice(&fs::read(&glb).unwrap()).unwrap();
    let names: Vec<_> = read.nodes().filter_map(|node| node.name().map(str::to_owned)).collect();
    assert!(names.iter().any(|name| name.contains("track-")), "{names:?}");
    assert!(names.iter().any(|name| name.ends_with("(true)")), "{names:?}");
    let bytes = fs::read(&mcap).unwrap();
    assert!(messages(&bytes).count() > 0);
    assert!(fs::read_to_string(&html).unwrap().contains("track-"));
}

#[test]
fn mistakes_are_named_before_anything_is_computed() {
    let folder = tempfile::tempdir().unwrap();
    let missing = folder.path().join("missing/scene.mcap");
    let missing = missing.to_str().unwrap();
    fails(&["rollout", "--mcap", missing], 2, &["--mcap", missing, "make it first"]);
    let here = folder.path().to_str().unwrap();
    fails(&["rollout", "--html", here], 2, &["--html", here, "is a folder"]);
    let one = folder.path().join("one").to_str().unwrap().to_owned();
    fails(&["rollout", "--html", &one, "--gltf", &one], 2, &["two options", "two names"]);
    fails(&["evaluate", SCENE, "--index", "0"], 2, &["--index", "--mcap"]);
    fails(&["evaluate", SCENE, "--index", "99", "--html", &one], 1, &["99"]);
    assert_eq!(fs::read_dir(folder.path()).unwrap().count(), 0);
}
