//! A table of hostile inputs, a row a kind: what the program does with them, its peak memory and the processor time that it takes.
//!
//! ```sh
//! cargo build --release -p rigidformer-cli --features full
//! RIGIDFORMER_PROGRAM=$PWD/target/release/rigidformer CASES=FOLDER cargo test -p rigidformer-cli --test all hostile -- --ignored --nocapture
//! ```
//!
//! `CASES` names a folder of recorded cases, which are tried beside those that are made here; it may be left out. What came of it last is in
//! `../hostile-inputs.csv`, beside the kinds that other tests try.
#![cfg(target_os = "linux")]
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)]

use std::fs;
use std::io::Read;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};
use std::time::Duration;

use crate::bombs::{Collada, npz, program, record, scene_bomb, zstd_of_one_byte};

/// Address space of each, MiB: twice the usual budget.
const ADDRESS_SPACE: u64 = 2048;

struct Run {
    code: Option<i32>,
    text: String,
    seconds: f64,
    peak_mib: f64,
}

/// Runs the program where memory is limited. Its peak and its time are what Linux last said of it: time on a processor, since others may
/// use it too.
fn run(folder: &Path, arguments: &[&str]) -> Run {
    let limited = format!("ulimit -v {}; exec \"$0\" \"$@\"", ADDRESS_SPACE * 1024);
    let mut shell = Command::new("sh");
    shell.arg("-c").arg(limited).arg(program()).args(arguments).current_dir(folder);
    shell.stdin(Stdio::null()).stdout(Stdio::piped()).stderr(Stdio::piped());
    let mut child = shell.spawn().unwrap();
    let mut pipes: Vec<Box<dyn Read + Send>> =
        vec![Box::new(child.stdout.take().unwrap()), Box::new(child.stderr.take().unwrap())];
    let readers: Vec<_> = pipes
        .drain(..)
        .map(|mut pipe| {
            std::thread::spawn(move || {
                let mut bytes = Vec::new();
                pipe.read_to_end(&mut bytes).unwrap();
                bytes
            })
        })
        .collect();
    let [status, stat] = ["status", "stat"].map(|name| format!("/proc/{}/{name}", child.id()));
    let (mut peak_kib, mut ticks) = (0.0_f64, 0.0_f64);
    let code = loop {
        let said = fs::read_to_string(&status).unwrap_or_default();
        let peak = said.lines().find_map(|line| line.strip_prefix("VmHWM:"));
        let peak = peak.and_then(|text| text.trim().strip_suffix(" kB")?.trim().parse().ok());
        peak_kib = peak_kib.max(peak.unwrap_or_default());
        let said = fs::read_to_string(&stat).unwrap_or_default();
        // Behind the name, which may have spaces: of the program and of the system for it, in hundredths.
        let fields = said.rsplit(')').next().unwrap_or_default().split_whitespace();
        let both = fields.skip(11).take(2).filter_map(|field| field.parse::<f64>().ok());
        ticks = ticks.max(both.sum());
        if let Some(status) = child.try_wait().unwrap() {
            break status.code();
        }
        std::thread::sleep(Duration::from_millis(1));
    };
    let seconds = ticks / 100.0;
    let bytes: Vec<u8> = readers.into_iter().flat_map(|reader| reader.join().unwrap()).collect();
    let text = String::from_utf8_lossy(&bytes).into_owned();
    Run { code, text, seconds, peak_mib: peak_kib / 1024.0 }
}

/// What makes an input of its own, in an empty folder.
type Make<'a> = Box<dyn Fn(&Path) + 'a>;

struct Kind<'a> {
    name: &'a str,
    /// What the program did before there was a budget, from the recorded case.
    before: &'a str,
    /// Recorded files and folders, below `CASES`.
    recorded: &'a [&'a str],
    made: Vec<Make<'a>>,
    /// The name that recorded inputs have in the folder, and the command, which names it.
    input: &'a str,
    line: &'a [&'a str],
    code: i32,
}

impl Kind<'_> {
    fn row(&self, cases: Option<&Path>) -> String {
        let recorded = cases.map(|cases| self.recorded.iter().map(|name| cases.join(name)));
        let recorded = recorded.into_iter().flatten().map(|from| -> Make<'_> {
            Box::new(move |folder: &Path| copy(&from, &folder.join(self.input)))
        });
        let (mut seconds, mut peak, mut inputs) = (0.0_f64, 0.0_f64, 0);
        let recorded: Vec<Make<'_>> = recorded.collect();
        for make in recorded.iter().chain(&self.made) {
            let folder = tempfile::tempdir().unwrap();
            make(folder.path());
            let run = run(folder.path(), self.line);
            let shown: String = run.text.chars().take(2000).collect();
            assert_eq!(run.code, Some(self.code), "{} {inputs}: {shown}", self.name);
            assert!(!run.text.contains('\u{1b}'), "{} {inputs}: {shown:?}", self.name);
            assert!(run.text.len() < 20_000, "{} {inputs}: {}", self.name, run.text.len());
            (seconds, peak) = (seconds.max(run.seconds), peak.max(run.peak_mib));
            inputs += 1;
        }
        let now = if self.code == 0 { "is read" } else { "is refused" };
        let Kind { name, before, .. } = self;
        format!("{name},{inputs},\"{before}\",{now},{peak:.0},{seconds:.2}")
    }
}

fn copy(from: &Path, to: &Path) {
    if from.is_dir() {
        fs::create_dir_all(to).unwrap();
        for entry in fs::read_dir(from).unwrap() {
            let entry = entry.unwrap();
            copy(&entry.path(), &to.join(entry.file_name()));
        }
    } else {
        fs::copy(from, to).unwrap();
    }
}

fn boxed<'a>(make: impl Fn(&Path) + 'a) -> Make<'a> {
    Box::new(make)
}

/// A list of depth images that all are one file.
fn depth_images(folder: &Path, cameras: usize, side: u32, scale_m: f64) {
    let folder = folder.join("depth");
    fs::create_dir_all(&folder).unwrap();
    let mut encoder =
        png::Encoder::new(fs::File::create(folder.join("a.png")).unwrap(), side, side);
    encoder.set_color(png::ColorType::Grayscale);
    encoder.set_depth(png::BitDepth::Sixteen);
    let mut writer = encoder.write_header().unwrap();
    writer.write_image_data(&vec![0; 2 * (side * side) as usize]).unwrap();
    writer.finish().unwrap();
    let camera = |k: usize| {
        serde_json::json!({ "name": k.to_string(), "width": side, "height": side, "fx": side, "fy": side,
            "cx": side / 2, "cy": side / 2, "depth_scale_m": scale_m, "pose": [0, 0, 1, 0, 1, 0, 0] })
    };
    let frame =
        |k: usize| serde_json::json!({ "time_s": 0, "camera": k.to_string(), "depth": "a.png" });
    let manifest = serde_json::json!({
        "format": "rigidformer-depth", "version": 1,
        "cameras": (0..cameras).map(camera).collect::<Vec<_>>(),
        "frames": (0..cameras).map(frame).collect::<Vec<_>>(),
    });
    fs::write(folder.join("frames.json"), manifest.to_string()).unwrap();
}

fn ply(folder: &Path, elements: usize, entries: u64) {
    let list: String = (0..elements).map(|k| format!("element e{k} {entries}\n")).collect();
    let vertex = "element vertex 1\nproperty float x\nproperty float y\nproperty float z\n";
    let text = format!("ply\nformat binary_little_endian 1.0\n{list}{vertex}end_header\n");
    fs::write(folder.join("a.ply"), text).unwrap();
}

fn csv(folder: &Path, unit: &str, number: &str) {
    let row = format!("0,{unit},{number},0,0,1,0,0,0\n");
    fs::write(folder.join("a.csv"), format!("time_s,unit,x,y,z,qw,qx,qy,qz\n{row}")).unwrap();
}

fn mcap(folder: &Path, compression: &str, packed: &[u8], said: u64) {
    mcap_chunks(folder, compression, packed, (said, 1));
}

/// So many equal chunks, each of which says how long it is.
fn mcap_chunks(folder: &Path, compression: &str, packed: &[u8], (said, count): (u64, usize)) {
    let mut body = vec![0; 16];
    body.extend(said.to_le_bytes());
    body.extend([0; 4]);
    body.extend((compression.len() as u32).to_le_bytes());
    body.extend(compression.bytes());
    body.extend((packed.len() as u64).to_le_bytes());
    body.extend(packed);
    let file =
        [&b"\x89MCAP0\r\n"[..], &record(1, &[0; 8]), &record(6, &body).repeat(count)].concat();
    fs::write(folder.join("a.mcap"), file).unwrap();
}

/// A message that says that it is longer than what holds it.
fn longer_message(length: u64) -> Vec<u8> {
    [&[5][..], &length.to_le_bytes(), &[0; 40]].concat()
}

fn evil_scene(folder: &Path, name: &str) {
    let of_program = concat!(env!("CARGO_MANIFEST_DIR"), "/scenes/default.safetensors");
    let bytes = fs::read(of_program).unwrap();
    let old = u64::from_le_bytes(bytes[..8].try_into().unwrap()) as usize;
    let mut header: serde_json::Value = serde_json::from_slice(&bytes[8..8 + old]).unwrap();
    header["__metadata__"]["dataset"] = name.into();
    let mut header = header.to_string();
    while !header.len().is_multiple_of(8) {
        header.push(' ');
    }
    let length = (header.len() as u64).to_le_bytes();
    let scene = [&length[..], header.as_bytes(), &bytes[8 + old..]].concat();
    fs::write(folder.join("a.safetensors"), scene).unwrap();
}

#[test]
#[ignore = "prints a table; takes a minute"]
fn hostile_inputs() {
    let cases = std::env::var_os("CASES").map(PathBuf::from);
    let of = |count: usize, make: fn(&Path, usize)| -> Vec<Make<'static>> {
        (0..count).map(|number| boxed(move |folder| make(folder, number))).collect()
    };
    let importing = ["import", "a.csv", "--out", "o.safetensors", "--box", "*=1,1,1"];
    let kinds = [
        Kind {
            name: "a shape that many units share",
            before: "24 GB",
            recorded: &["scene-bomb/bomb-100000x20000.safetensors"],
            made: of(3, |folder, k| {
                scene_bomb(folder, [50_000, 100_000, 400_000][k], [8000, 4000, 1000][k], 1 + k);
            }),
            input: "bomb.safetensors",
            line: &["inspect", "bomb.safetensors"],
            code: 1,
        },
        Kind {
            name: "a PNG that many cameras share",
            before: "6 GB, abort",
            recorded: &["capture-bomb/depth"],
            made: of(3, |folder, k| {
                depth_images(folder, [40, 200, 3000][k], [8192, 4000, 1024][k], 0.001);
            }),
            input: "depth",
            line: &["track", "depth", "--no-model", "--json"],
            code: 1,
        },
        Kind {
            name: "a chunk of an MCAP file that unpacks to gigabytes",
            before: "not recorded",
            recorded: &[],
            made: of(3, |folder, k| {
                let packed = zstd_of_one_byte([1 << 30, 3 << 30, 6 << 30][k]);
                mcap(folder, "zstd", &packed, [1 << 30, 3 << 30, 1000][k]);
            }),
            input: "a.mcap",
            line: &["track", "a.mcap", "--no-model", "--json"],
            code: 1,
        },
        Kind {
            name: "an MCAP file of a hundred views or many chunks",
            before: "4 GB after 183 s",
            recorded: &["capture-bomb/bomb.mcap"],
            made: of(3, |folder, k| {
                let (count, bytes) = ([30, 300, 20_000][k], [128 << 20, 16 << 20, 1 << 20][k]);
                mcap_chunks(folder, "zstd", &zstd_of_one_byte(bytes), (bytes, count));
            }),
            input: "a.mcap",
            line: &["track", "a.mcap", "--no-model", "--json"],
            code: 1,
        },
        Kind {
            name: "a message longer than its chunk",
            before: "is read",
            recorded: &["mcap-record-beyond-chunk/beyond.mcap"],
            made: of(3, |folder, k| {
                let message = longer_message([41, 1 << 32, u64::MAX][k]);
                mcap(folder, "", &message, message.len() as u64);
            }),
            input: "a.mcap",
            line: &["track", "a.mcap", "--no-model", "--json"],
            code: 1,
        },
        Kind {
            name: "PLY elements without properties",
            before: "44 s for 4 kB",
            recorded: &["ply-empty-elements/a.ply"],
            made: of(3, |folder, k| {
                ply(folder, [10, 1000, 10_000][k], [u64::from(u32::MAX), 4_000_000, 1_000_000][k]);
            }),
            input: "a.ply",
            line: &["track", "a.ply", "--no-model", "--json"],
            code: 1,
        },
        Kind {
            name: "numbers of half the size",
            before: "5 GB",
            recorded: &["npz-bomb/bomb-f2.npz", "npz-bomb/bomb.npz"],
            made: of(3, |folder, k| {
                let (frames, units) = ([20_000, 2000, 60_000][k], [2000, 20_000, 1000][k]);
                let shape = format!("({frames}, {units}, 7)");
                let dtype = ["<f2", "<f4", "<f2"][k];
                let bytes = frames * units * 7 * [2, 4, 2][k];
                npz(&folder.join("a.npz"), &[("poses", dtype, shape, bytes)]);
            }),
            input: "a.npz",
            line: &["import", "a.npz", "--out", "o.safetensors", "--box", "*=1,1,1"],
            code: 1,
        },
        Kind {
            name: "a field of 10 MB",
            before: "is printed",
            recorded: &[],
            made: of(4, |folder, k| {
                let long = ["1", "x", "\u{1b}]0;", "9"][k].repeat(10_000_000);
                if k == 3 { csv(folder, &long, "x") } else { csv(folder, "a", &long) }
            }),
            input: "a.csv",
            line: &importing,
            code: 1,
        },
        Kind {
            name: "names that steer a terminal",
            before: "reach it",
            recorded: &["terminal-escape/evil.safetensors"],
            made: of(3, |folder, k| {
                let name = ["\u{1b}[2J", "\u{1b}]52;c;eA==\u{7}", "\u{9b}31m\u{202e}"][k];
                evil_scene(folder, name);
            }),
            input: "a.safetensors",
            line: &["inspect", "a.safetensors"],
            code: 0,
        },
        Kind {
            name: "units that steer a terminal",
            before: "reach it",
            recorded: &["terminal-escape/evil.csv"],
            made: of(3, |folder, k| {
                let name = ["\u{1b}[2J", "\u{1b}]52;c;eA==\u{7}", "\u{9b}31m\u{202e}"][k];
                csv(folder, name, "0");
            }),
            input: "a.csv",
            line: &importing,
            code: 1,
        },
        Kind {
            name: "depths of absurd scales",
            before: "not recorded",
            recorded: &[
                "depth-scale/1e+09",
                "depth-scale/1e+38",
                "depth-scale/1e+06",
                "depth-scale/1e-38",
                "depth-scale/1e+15",
                "depth-scale/3e+38",
                "depth-scale/1e+33",
                "depth-scale/1e-45",
                "depth-scale/1e+30",
                "depth-scale/1e+20",
            ],
            made: of(3, |folder, k| depth_images(folder, 1, 64, [11.0, 1e-7, -1.0][k])),
            input: "depth",
            line: &["track", "depth", "--no-model", "--json"],
            code: 1,
        },
        Kind {
            name: "attributes and namespaces of COLLADA",
            before: "hours",
            recorded: &[],
            made: of(3, |folder, k| {
                let mut mesh = Collada::sound();
                match k {
                    0 => mesh.attributes = (0..300_000).map(|k| format!("a{k}='' ")).collect(),
                    1 => mesh.attributes = (0..60_000).map(|k| format!("xmlns:a{k}='' ")).collect(),
                    _ => {
                        mesh.nodes = (0..20_000).map(|k| format!("<x xmlns:x{k}='{k}'>")).collect()
                    }
                }
                fs::write(folder.join("a.dae"), mesh.text()).unwrap();
            }),
            input: "a.dae",
            line: &["pieces", "a.dae"],
            code: 1,
        },
        Kind {
            name: "STL solids without faces",
            before: "abort",
            recorded: &[],
            made: of(3, |folder, k| {
                let text = "solid \nendsolid\n".repeat([100_000, 1_000_000, 5_000_000][k]);
                fs::write(folder.join("a.stl"), text).unwrap();
            }),
            input: "a.stl",
            line: &["pieces", "a.stl"],
            code: 1,
        },
    ];
    println!("kind,inputs,before,now,peak MiB,processor s");
    for kind in kinds.iter().filter(|kind| cases.is_some() || !kind.made.is_empty()) {
        println!("{}", kind.row(cases.as_deref()));
    }
}
