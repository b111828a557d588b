//! Short files that ask for much memory: each is refused within a child process that has twice the budget and no more.
//!
//! `BOMBS=1000 cargo test -p rigidformer-cli --features full bombs -- --nocapture` tries so many of each kind instead of a
//! few, and prints the slowest of each. `RIGIDFORMER_PROGRAM` names a program that is not the one of these tests.
#![cfg(target_os = "linux")]
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)]

use std::ffi::OsString;
use std::fs;
use std::io::Write;
use std::path::Path;
use std::process::{Command, Output, Stdio};
use std::time::{Duration, Instant};

use serde_json::{Value, json};

/// Of the budget, MiB.
const BUDGET: u64 = 256;

/// A small generator: the same bombs on every machine.
struct Numbers(u64);

impl Numbers {
    /// From `least` to `most`.
    fn next(&mut self, least: u64, most: u64) -> u64 {
        self.0 = self.0.wrapping_mul(6364136223846793005).wrapping_add(1442695040888963407);
        least + (self.0 >> 33) % (most - least + 1)
    }
}

/// The one that was built with these tests, or another, such as one of the release profile.
pub(crate) fn program() -> OsString {
    std::env::var_os("RIGIDFORMER_PROGRAM").unwrap_or(env!("CARGO_BIN_EXE_rigidformer").into())
}

/// Runs the program with an address space of twice the budget.
fn run(folder: &Path, arguments: &[&str]) -> Output {
    let limited = format!("ulimit -v {}; exec \"$0\" \"$@\"", 2 * BUDGET * 1024);
    let mut shell = Command::new("sh");
    shell.arg("-c").arg(limited).arg(program());
    shell.args(arguments).arg("--memory").arg(format!("{BUDGET}M"));
    // An arena of the allocator takes address space that nobody uses.
    shell.env("MALLOC_ARENA_MAX", "1").env("RAYON_NUM_THREADS", "1");
    shell.current_dir(folder).stdin(Stdio::null()).output().unwrap()
}

/// Tries bombs of a kind: `make` writes one into a folder, and the command must fail with code 1.
fn refused(make: impl Fn(&Path, &mut Numbers), arguments: &[&str]) {
    let count = std::env::var("BOMBS").ok().and_then(|text| text.parse().ok()).unwrap_or(4);
    let mut numbers = Numbers(7);
    let mut slowest = Duration::ZERO;
    for bomb in 0..count {
        let folder = tempfile::tempdir().unwrap();
        make(folder.path(), &mut numbers);
        let start = Instant::now();
        let output = run(folder.path(), arguments);
        slowest = slowest.max(start.elapsed());
        let text = String::from_utf8_lossy(&output.stderr);
        assert_eq!(output.status.code(), Some(1), "bomb {bomb} of {arguments:?}: {text}");
        assert!(text.contains("error:") && text.len() < 2000, "bomb {bomb}: {text}");
        assert!(!text.contains('\u{1b}'), "bomb {bomb} steers a terminal");
    }
    println!("{count} of {arguments:?}: the slowest took {} ms", slowest.as_millis());
}

/// A safetensors file: name, type, shape and payload of each tensor.
fn safetensors(path: &Path, metadata: Value, tensors: &[(&str, &str, Vec<usize>, Vec<u8>)]) {
    let mut header = serde_json::Map::from_iter([("__metadata__".to_owned(), metadata)]);
    let mut payload: Vec<u8> = Vec::new();
    for (name, dtype, shape, bytes) in tensors {
        let start = payload.len();
        payload.extend(bytes);
        let offsets = [start, payload.len()];
        let entry = json!({ "dtype": dtype, "shape": shape, "data_offsets": offsets });
        header.insert((*name).into(), entry);
    }
    let mut header = Value::Object(header).to_string();
    while !header.len().is_multiple_of(8) {
        header.push(' ');
    }
    let mut bytes = (header.len() as u64).to_le_bytes().to_vec();
    bytes.extend(header.bytes());
    bytes.extend(payload);
    fs::write(path, bytes).unwrap();
}

/// A scene whose units share one shape.
pub(crate) fn scene_bomb(folder: &Path, points: usize, units: usize, frames: usize) {
    let i64s = |values: &[i64]| values.iter().flat_map(|v| v.to_le_bytes()).collect::<Vec<_>>();
    let f32s = |values: &[f32]| values.iter().flat_map(|v| v.to_le_bytes()).collect::<Vec<_>>();
    let pose = [0.0, 0.0, 1.0, 1.0, 0.0, 0.0, 0.0];
    let tensors = [
        ("scene_seed", "I64", vec![1], i64s(&[1])),
        ("scene_units", "I64", vec![2], i64s(&[0, units as i64])),
        ("shape_offsets", "I64", vec![2], i64s(&[0, points as i64])),
        ("shape_points", "F32", vec![points, 3], f32s(&vec![0.5; 3 * points])),
        ("unit_physics", "F32", vec![units, 3], f32s(&vec![1.0; 3 * units])),
        ("unit_poses", "F32", vec![units, frames, 7], f32s(&pose.repeat(units * frames))),
        ("unit_scale", "F32", vec![units], f32s(&vec![1.0; units])),
        ("unit_shape", "I32", vec![units], vec![0; 4 * units]),
        ("scene_split", "U8", vec![1], vec![2]),
    ];
    let metadata = json!({
        "format": "rigidformer-scenes", "version": "1", "dataset": "bomb", "frame_rate_hz": "60",
        "gravity_m_s2": "0 0 -9.81", "ground_friction": "0.5", "ground_restitution": "0.4",
        "shape_names": "[\"a\"]", "provenance": "a test", "licence": "none",
    });
    safetensors(&folder.join("bomb.safetensors"), metadata, &tensors);
}

#[test]
fn scenes() {
    let make = |folder: &Path, numbers: &mut Numbers| {
        let points = numbers.next(20_000, 60_000) as usize;
        let units = numbers.next(1500, 4000) as usize;
        scene_bomb(folder, points, units, numbers.next(1, 3) as usize);
    };
    refused(make, &["inspect", "bomb.safetensors"]);
}

#[test]
fn captures_of_depth_images() {
    let make = |folder: &Path, numbers: &mut Numbers| {
        let (count, side) = (numbers.next(8, 200), numbers.next(5000, 8192));
        fs::write(folder.join("a.png"), b"").unwrap();
        let names = || (0..count).map(|number| number.to_string());
        let cameras = names().map(|name| {
            json!({ "name": name, "width": side, "height": side, "fx": side, "fy": side, "cx": side / 2,
                "cy": side / 2, "depth_scale_m": 0.001, "pose": [0, 0, 1, 0, 1, 0, 0] })
        });
        let frames = names().map(|name| json!({ "time_s": 0, "camera": name, "depth": "a.png" }));
        let manifest = json!({
            "format": "rigidformer-depth", "version": 1,
            "cameras": cameras.collect::<Vec<_>>(), "frames": frames.collect::<Vec<_>>(),
        });
        fs::write(folder.join("frames.json"), manifest.to_string()).unwrap();
    };
    refused(make, &["track", ".", "--no-model", "--json"]);
}

#[test]
fn clouds_of_empty_elements() {
    let make = |folder: &Path, numbers: &mut Numbers| {
        let (count, entries) = (numbers.next(2, 2000), numbers.next(1_000_000, 4_000_000));
        let elements: String = (0..count).map(|k| format!("element e{k} {entries}\n")).collect();
        let vertex = "element vertex 1\nproperty float x\nproperty float y\nproperty float z\n";
        let header =
            format!("ply\nformat binary_little_endian 1.0\n{elements}{vertex}end_header\n");
        fs::write(folder.join("a.ply"), header).unwrap();
    };
    refused(make, &["track", "a.ply", "--no-model", "--json"]);
}

#[test]
fn tables() {
    let make = |folder: &Path, numbers: &mut Numbers| {
        let digits = numbers.next(100_000, 2_000_000) as usize;
        // Three kinds: too large a number, none, and one that steers a terminal.
        let text = ["1", "x", "\u{1b}[2J"][numbers.next(0, 2) as usize];
        let row = format!("0,a,{},0,0,1,0,0,0\n", text.repeat(digits));
        fs::write(folder.join("a.csv"), format!("time_s,unit,x,y,z,qw,qx,qy,qz\n{row}")).unwrap();
    };
    refused(make, &["import", "a.csv", "--out", "out.safetensors", "--box", "*=1,1,1"]);
}

#[test]
fn meshes_of_many_groups() {
    let make = |folder: &Path, numbers: &mut Numbers| {
        let groups = numbers.next(600, 20_000);
        let corners = "v 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\n";
        let group = |k: u64| format!("o g{k}\nf 1 2 3\nf 1 2 4\nf 1 3 4\nf 2 3 4\n");
        let text: String = (0..groups).map(group).collect();
        fs::write(folder.join("a.obj"), format!("{corners}{text}")).unwrap();
    };
    refused(make, &["pieces", "a.obj"]);
}

#[test]
fn meshes_of_obj() {
    let make = |folder: &Path, numbers: &mut Numbers| {
        let count = numbers.next(1000, 4_000_000) as usize;
        let corners = "v 0 0 0\nv 1 0 0\nv 0 1 0\n";
        let text = match numbers.next(0, 5) {
            // A face of many corners, groups without faces, points of one plane, and groups that repeat the longest name.
            0 => format!("{corners}f {}\n", "1 2 ".repeat(count)),
            1 => format!("{corners}{}", "g\n".repeat(count)),
            2 => format!("{corners}{}", "f 1 2 3\n".repeat(count)),
            3 => format!("{corners}{}", "g\nf 1 2 3\n".repeat(count)),
            4 => format!("{corners}g {}\nf 1 2 {}\n", "x".repeat(count), u64::MAX),
            _ => format!("{corners}v {} 0 0\nf 1 2 4\n", "9".repeat(count)),
        };
        fs::write(folder.join("a.obj"), text).unwrap();
    };
    refused(make, &["pieces", "a.obj"]);
}

#[test]
fn meshes_of_stl() {
    let make = |folder: &Path, numbers: &mut Numbers| {
        let count = numbers.next(1000, 500_000);
        let facet = |word: &str| {
            let corner = format!("vertex 0 0 {word}\n");
            format!("facet normal 0 0 0\nouter loop\n{}endloop\nendfacet\n", corner.repeat(3))
        };
        let binary = |said: u64, number: f32| {
            let mut bytes = vec![b' '; 80];
            bytes.extend((said as u32).to_le_bytes());
            let mut triangle: Vec<u8> = (0..12).flat_map(|_| number.to_le_bytes()).collect();
            triangle.extend([0, 0]);
            bytes.extend(triangle.repeat(count as usize));
            bytes
        };
        let text = |body: String| format!("solid x\n{body}endsolid x\n").into_bytes();
        let bytes = match numbers.next(0, 7) {
            // More triangles than there are, none that is a number, and all in one place.
            0 => binary(numbers.next(count + 1, u64::from(u32::MAX)), 1.0),
            1 => binary(count, f32::NAN),
            2 => binary(count, 0.5),
            // Solids without faces, and with one.
            3 => "solid \nendsolid\n".repeat(4 * count as usize).into_bytes(),
            4 => text(facet("0")).repeat(count as usize / 4),
            5 => text(facet("0").repeat(count as usize / 4)),
            // One number, one name and one line without an end.
            6 => text(facet(&"9".repeat(10 * count as usize))),
            _ => format!("solid {}", "x".repeat(20 * count as usize)).into_bytes(),
        };
        fs::write(folder.join("a.stl"), bytes).unwrap();
    };
    refused(make, &["pieces", "a.stl"]);
}

/// A COLLADA mesh in parts, all of which a bomb may replace.
pub(crate) struct Collada {
    pub(crate) attributes: String,
    name: String,
    vertices: String,
    faces: String,
    pub(crate) nodes: String,
    scene: String,
}

impl Collada {
    pub(crate) fn sound() -> Self {
        Collada {
            attributes: String::new(),
            name: "a".into(),
            vertices: String::new(),
            faces: "<triangles><input semantic=\"VERTEX\" source=\"#v\"/><p>0 1 2</p></triangles>"
                .into(),
            nodes: String::new(),
            scene: "<instance_geometry url=\"#a\"/>".into(),
        }
    }

    pub(crate) fn text(&self) -> String {
        let Collada { attributes, name, vertices, faces, nodes, scene } = self;
        format!(
            "<COLLADA {attributes}><geometry id=\"a\" name=\"{name}\"><mesh><source id=\"p\">\
             <float_array>0 0 0 1 0 0 0 1 0</float_array></source>\
             <vertices id=\"v\">{vertices}<input semantic=\"POSITION\" source=\"#p\"/></vertices>\
             {faces}</mesh></geometry>{nodes}<visual_scene id=\"s\">{scene}</visual_scene>\
             <instance_visual_scene url=\"#s\"/></COLLADA>"
        )
    }
}

#[test]
fn meshes_of_collada() {
    let make = |folder: &Path, numbers: &mut Numbers| {
        let mut mesh = Collada::sound();
        let few = numbers.next(100, 5000) as usize;
        let many = numbers.next(10_000, 300_000) as usize;
        let instances = mesh.scene.repeat(few);
        match numbers.next(0, 12) {
            // What parsers compare with all before it, or copy to all behind it.
            0 => mesh.attributes = (0..many).map(|k| format!("a{k}=\"\" ")).collect(),
            1 => mesh.nodes = (0..few).map(|k| format!("<x xmlns:x{k}=\"{k}\">")).collect(),
            2 => mesh.attributes = (0..many).map(|k| format!("xmlns:a{k}='' ")).collect(),
            // What many instances read or copy.
            3 => {
                mesh.name = "x".repeat(many);
                mesh.scene = instances + &mesh.scene.repeat(3000);
            }
            4 => {
                mesh.faces = mesh.faces.repeat(few);
                mesh.scene = instances;
            }
            5 => {
                mesh.vertices = "<x/>".repeat(many);
                mesh.faces = mesh.faces.repeat(few);
            }
            6 => {
                let places = "0 1 2 ".repeat(many);
                mesh.faces = mesh.faces.replace("0 1 2", &places);
                mesh.scene = instances;
            }
            // Strips have a triangle for each corner.
            7 => {
                let places = "0 ".repeat(10 * many);
                mesh.faces = mesh.faces.replace("0 1 2", &places).replace("triangles", "tristrips");
            }
            // Nodes that double, that are deep, and whose places are read again by each instance.
            8 => {
                let twice = |k| {
                    let next = format!("<instance_node url=\"#n{}\"/>", k + 1);
                    format!("<node id=\"n{k}\">{next}{next}</node>")
                };
                mesh.nodes = (0..few.min(60)).map(twice).collect();
                mesh.nodes += &format!("<node id=\"n{}\"/>", few.min(60));
                mesh.scene = "<instance_node url=\"#n0\"/>".into();
            }
            9 => mesh.scene = "<node>".repeat(few + 300) + &"</node>".repeat(few + 300),
            10 => mesh.nodes = "xmlns".repeat(many),
            11 => {
                let place = "0 ".repeat(10 * many);
                mesh.nodes = format!("<node id=\"n\"><translate>{place}</translate></node>");
                mesh.scene = "<instance_node url=\"#n\"/>".repeat(few);
            }
            _ => {
                mesh.nodes = format!("<node id=\"n\">{}</node>", "<x/>".repeat(many));
                mesh.scene = "<instance_node url=\"#n\"/>".repeat(few);
            }
        }
        fs::write(folder.join("a.dae"), mesh.text()).unwrap();
    };
    refused(make, &["pieces", "a.dae"]);
}

/// An npz file of compressed arrays: name, type, shape and bytes of each.
pub(crate) fn npz(path: &Path, arrays: &[(&str, &str, String, u64)]) {
    let mut archive = zip::ZipWriter::new(fs::File::create(path).unwrap());
    let options = zip::write::SimpleFileOptions::default()
        .compression_method(zip::CompressionMethod::Deflated)
        .compression_level(Some(1));
    for (name, dtype, shape, bytes) in arrays {
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
        std::io::copy(&mut std::io::Read::take(std::io::repeat(0), *bytes), &mut archive).unwrap();
    }
    archive.finish().unwrap();
}

#[test]
fn arrays() {
    let make = |folder: &Path, numbers: &mut Numbers| {
        // Two bytes of the file's are four or eight in memory.
        let (dtype, size) = [("<f2", 2), ("<f4", 4), ("<f8", 8)][numbers.next(0, 2) as usize];
        let (frames, units) = (numbers.next(1000, 3000), numbers.next(1000, 2000));
        // Some say more than they hold.
        let held = frames * units * 7 * size / numbers.next(1, 8);
        let shape = format!("({frames}, {units}, 7)");
        npz(&folder.join("a.npz"), &[("poses", dtype, shape, held)]);
    };
    refused(make, &["import", "a.npz", "--out", "out.safetensors", "--box", "*=1,1,1"]);
}

/// A record of an MCAP file.
pub(crate) fn record(code: u8, body: &[u8]) -> Vec<u8> {
    [&[code][..], &(body.len() as u64).to_le_bytes(), body].concat()
}

/// A zstd frame of so many equal bytes: each four of the file make 128 KiB.
pub(crate) fn zstd_of_one_byte(bytes: u64) -> Vec<u8> {
    // A window of 8 MiB, no checksum, no length.
    let mut frame = vec![0x28, 0xb5, 0x2f, 0xfd, 0x00, 13 << 3];
    let blocks = bytes.div_ceil(128 << 10).max(1);
    for block in 0..blocks {
        let last = u32::from(block + 1 == blocks);
        let head = last | 1 << 1 | (128 << 10) << 3;
        frame.extend(&head.to_le_bytes()[..3]);
        frame.push(0);
    }
    frame
}

#[test]
fn recordings() {
    let make = |folder: &Path, numbers: &mut Numbers| {
        let mut file = b"\x89MCAP0\r\n".to_vec();
        file.extend(record(1, &[0; 8]));
        for _ in 0..numbers.next(1, 20) {
            let bytes = numbers.next(1 << 20, 400 << 20);
            // Half of the chunks say what they hold, half say less.
            let said = bytes >> (8 * numbers.next(0, 1));
            let (name, packed) = match numbers.next(0, 2) {
                0 => ("zstd", zstd_of_one_byte(bytes)),
                1 => ("lz4", zstd_of_one_byte(bytes)),
                _ => ("", vec![0; 100]),
            };
            let mut body = vec![0; 16];
            body.extend(said.to_le_bytes());
            body.extend([0; 4]);
            body.extend((name.len() as u32).to_le_bytes());
            body.extend(name.bytes());
            body.extend((packed.len() as u64).to_le_bytes());
            body.extend(packed);
            file.extend(record(6, &body));
        }
        fs::write(folder.join("a.mcap"), file).unwrap();
    };
    refused(make, &["track", "a.mcap", "--no-model", "--json"]);
}

#[test]
fn clouds_of_many_points() {
    let make = |folder: &Path, numbers: &mut Numbers| {
        let points = numbers.next(1 << 20, 1 << 33);
        let data = ["ascii", "binary", "binary_compressed"][numbers.next(0, 2) as usize];
        let count = numbers.next(1, 4000);
        let mut file = format!(
            "VERSION .7\nFIELDS x y z w\nSIZE 4 4 4 4\nTYPE F F F F\nCOUNT 1 1 1 {count}\n\
             WIDTH {points}\nHEIGHT 1\nPOINTS {points}\nDATA {data}\n"
        )
        .into_bytes();
        let length = numbers.next(0, 1 << 20) as u32;
        file.extend(length.to_le_bytes());
        file.extend((points as u32).wrapping_mul(12 + 4 * count as u32).to_le_bytes());
        file.resize(file.len() + length as usize, 0xff);
        fs::write(folder.join("a.pcd"), file).unwrap();
    };
    refused(make, &["track", "a.pcd", "--no-model", "--json"]);
}

#[test]
fn models() {
    let model = fs::read(concat!(env!("CARGO_MANIFEST_DIR"), "/../../weights/models/nano.rfm"));
    let model = model.unwrap();
    let make = |folder: &Path, numbers: &mut Numbers| {
        let mut model = model.clone();
        // Lengths, widths and counts of the header become large, with sound checksums.
        let length = u32::from_le_bytes(model[12..16].try_into().unwrap()) as usize;
        for _ in 0..numbers.next(1, 4) {
            let at = 64 + numbers.next(0, length as u64 - 5) as usize;
            model[at..at + 5].copy_from_slice(&[0xff, 0xff, 0xff, 0xff, 0x0f]);
        }
        let header = crc32fast::hash(&model[64..64 + length]);
        model[32..36].copy_from_slice(&header.to_le_bytes());
        let prefix = crc32fast::hash(&model[..60]);
        model[60..64].copy_from_slice(&prefix.to_le_bytes());
        fs::write(folder.join("a.rfm"), model).unwrap();
    };
    refused(make, &["inspect", "a.rfm"]);
}

#[test]
fn traces() {
    let make = |folder: &Path, numbers: &mut Numbers| {
        let metadata = json!({
            "format": "rigidformer-trace", "version": "1", "model": "m", "scene": "s", "step": "5",
        });
        // A name costs more in memory than in the file, and an entry without numbers costs nothing there.
        let count = numbers.next(1, 20_000);
        let names: Vec<_> = (0..count).map(|k| format!("{:04}/0000/poses/{k}", k % 9999)).collect();
        let rows = numbers.next(0, 1 << 40) as usize;
        let tensors: Vec<_> =
            names.iter().map(|name| (&**name, "F32", vec![rows, 12], vec![])).collect();
        safetensors(&folder.join("a.trace"), metadata, &tensors);
    };
    refused(make, &["diff", "a.trace", "a.trace"]);
}

#[test]
fn lists_of_captures() {
    let make = |folder: &Path, numbers: &mut Numbers| {
        let depth = numbers.next(1000, 200_000) as usize;
        let text = match numbers.next(0, 2) {
            0 => "[".repeat(depth),
            1 => format!(
                "{{\"format\": \"rigidformer-depth\", \"frames\": [{}]}}",
                "0,".repeat(depth)
            ),
            _ => format!("{{\"format\": \"{}\"}}", "\u{1b}".repeat(depth)),
        };
        fs::write(folder.join("frames.json"), text).unwrap();
    };
    refused(make, &["track", ".", "--no-model", "--json"]);
}
