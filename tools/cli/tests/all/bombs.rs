//! Short files that ask for much memory: each is refused within a child process that has twice the budget and no more.
//!
//! `BOMBS=1000 cargo test -p rigidformer-cli --features full bombs` tries so many of each kind instead of a few.
#![cfg(target_os = "linux")]
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)]

use std::fs;
use std::path::Path;
use std::process::{Command, Output, Stdio};

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

/// Runs the program with an address space of twice the budget.
fn run(folder: &Path, arguments: &[&str]) -> Output {
    let limited = format!("ulimit -v {}; exec \"$0\" \"$@\"", 2 * BUDGET * 1024);
    let mut shell = Command::new("sh");
    shell.arg("-c").arg(limited).arg(env!("CARGO_BIN_EXE_rigidformer"));
    shell.args(arguments).arg("--memory").arg(format!("{BUDGET}M"));
    // An arena of the allocator takes address space that nobody uses.
    shell.env("MALLOC_ARENA_MAX", "1").env("RAYON_NUM_THREADS", "1");
    shell.current_dir(folder).stdin(Stdio::null()).output().unwrap()
}

/// Tries bombs of a kind: `make` writes one into a folder, and the command must fail with code 1.
fn refused(make: impl Fn(&Path, &mut Numbers), arguments: &[&str]) {
    let count = std::env::var("BOMBS").ok().and_then(|text| text.parse().ok()).unwrap_or(4);
    let mut numbers = Numbers(7);
    for bomb in 0..count {
        let folder = tempfile::tempdir().unwrap();
        make(folder.path(), &mut numbers);
        let output = run(folder.path(), arguments);
        let text = String::from_utf8_lossy(&output.stderr);
        assert_eq!(output.status.code(), Some(1), "bomb {bomb} of {arguments:?}: {text}");
        assert!(text.contains("error:") && text.len() < 2000, "bomb {bomb}: {text}");
        assert!(!text.contains('\u{1b}'), "bomb {bomb} steers a terminal");
    }
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

#[test]
fn scenes() {
    let make = |folder: &Path, numbers: &mut Numbers| {
        let points = numbers.next(20_000, 60_000) as usize;
        let units = numbers.next(1500, 4000) as usize;
        let frames = numbers.next(1, 3) as usize;
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
