//! Folders and files for the targets that read them.

use lz4_flex::frame::FrameEncoder;
use mcap::WriteOptions;
use mcap::records::MessageHeader;
use ruzstd::encoding::{CompressionLevel, compress_to_vec};
use std::collections::BTreeMap;
use std::io::{Cursor, Write};
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicUsize, Ordering};

/// What folders of fuzzers are called, before the numbers of the process and of the folder.
const PREFIX: &str = "rigidformer-fuzz-";

/// A folder that goes with its thread.
struct Folder(PathBuf);

impl Folder {
    /// Makes a folder, in memory where the system has such a place. A fuzzer ends without a word, so the next one removes the folders of
    /// those that have gone.
    fn new() -> Folder {
        static NUMBER: AtomicUsize = AtomicUsize::new(0);
        let memory = Path::new("/dev/shm");
        let parent: PathBuf = if memory.is_dir() { memory.into() } else { std::env::temp_dir() };
        for entry in std::fs::read_dir(&parent).into_iter().flatten().flatten() {
            let name = entry.file_name();
            let numbers = name.to_str().and_then(|name| name.strip_prefix(PREFIX));
            let process = numbers.and_then(|numbers| numbers.split('-').next());
            // Without /proc nobody knows who has gone.
            if process.is_some_and(|id| {
                Path::new("/proc/self").exists() && !Path::new("/proc").join(id).exists()
            }) {
                let _ = std::fs::remove_dir_all(entry.path());
            }
        }
        let number = NUMBER.fetch_add(1, Ordering::Relaxed);
        let folder = parent.join(format!("{PREFIX}{}-{number}", std::process::id()));
        std::fs::create_dir_all(&folder).expect("a folder for files");
        Folder(folder)
    }
}

impl Drop for Folder {
    fn drop(&mut self) {
        let _ = std::fs::remove_dir_all(&self.0);
    }
}

/// The folder for this thread's files.
pub(crate) fn folder() -> PathBuf {
    thread_local!(static FOLDER: Folder = Folder::new());
    FOLDER.with(|folder| folder.0.clone())
}

/// Writes a file of that folder.
pub(crate) fn written(name: &str, bytes: &[u8]) -> PathBuf {
    let path = folder().join(name);
    std::fs::write(&path, bytes).expect("room for a file");
    path
}

/// A small sound model's file.
#[cfg(feature = "program")]
pub(crate) fn model_file() -> PathBuf {
    use rigidformer_tests::hostile::{SMALLEST_IMPACT, random_model};
    let path = folder().join("sound.rfm");
    if !path.exists() {
        std::fs::write(&path, &*random_model(SMALLEST_IMPACT, 3)).expect("room for a file");
    }
    path
}

/// Runs a command of the program: plain words, then paths behind their options, or alone.
#[cfg(feature = "program")]
pub(crate) fn command(words: &[&str], paths: &[(&str, &PathBuf)]) -> Result<(), String> {
    // What the commands say would hide what tests and fuzzers say.
    rigidformer_cli::silence();
    let mut line: Vec<std::ffi::OsString> = vec!["rigidformer".into()];
    line.extend(words.iter().map(Into::into));
    for (option, path) in paths {
        if !option.is_empty() {
            line.push(option.into());
        }
        line.push(path.as_os_str().to_owned());
    }
    rigidformer_cli::run(line).map_err(|error| {
        assert!(!error.is::<clap::Error>(), "the target's own command line: {error}");
        format!("{error:#}")
    })
}

/// Cuts `data` at its first `count` lengths of two bytes each; the last part is what is left.
pub(crate) fn parts(mut data: &[u8], count: usize) -> Vec<&[u8]> {
    let mut parts = Vec::new();
    for _ in 0..count {
        let Some((length, rest)) = data.split_first_chunk() else { break };
        let length = usize::from(u16::from_le_bytes(*length)).min(rest.len());
        let (part, rest) = rest.split_at(length);
        parts.push(part);
        data = rest;
    }
    parts.push(data);
    parts
}

const SCHEMAS: [&str; 11] = [
    "foxglove.PointCloud",
    "foxglove.RawImage",
    "foxglove.CameraCalibration",
    "foxglove.FrameTransform",
    "sensor_msgs/msg/PointCloud2",
    "another",
    "foxglove.FrameTransforms",
    "foxglove.PoseInFrame",
    "tf2_msgs/msg/TFMessage",
    "geometry_msgs/msg/PoseStamped",
    "geometry_msgs/msg/TransformStamped",
];
const ENCODINGS: [&str; 3] = ["json", "protobuf", "cdr"];

/// A sound MCAP file around messages of unknown quality: each has a byte for schema and encoding, and one for its time.
pub(crate) fn mcap(data: &[u8]) -> Vec<u8> {
    let mut bytes = Vec::new();
    let options = WriteOptions::new().compression(None);
    let mut writer = options.create(Cursor::new(&mut bytes)).expect("memory");
    let mut time = 0;
    for (sequence, message) in (0..).zip(parts(data, 6)) {
        let [kind, step, payload @ ..] = message else { break };
        let (kind, nothing) = (usize::from(*kind), BTreeMap::new());
        let schema = SCHEMAS[kind % SCHEMAS.len()];
        let encoding = ENCODINGS[kind / SCHEMAS.len() % ENCODINGS.len()];
        let schema = writer.add_schema(schema, "", b"").expect("a schema");
        let topic = format!("/{}", kind % 16);
        let channel_id = writer.add_channel(schema, &topic, encoding, &nothing).expect("a channel");
        time += u64::from(*step) * 1_000_000;
        let header = MessageHeader { channel_id, sequence, log_time: time, publish_time: time };
        writer.write_to_known_channel(&header, payload).expect("a message");
    }
    writer.finish().expect("memory");
    drop(writer);
    bytes
}

/// How chunks are packed.
#[derive(Clone, Copy)]
pub(crate) enum Packing {
    Zstd,
    Lz4,
}

/// An MCAP file of one chunk that is packed so, of as many bytes as it says, or as the first three bytes of `data` say. Without a
/// checksum, so that what comes out of a decoder is read.
pub(crate) fn packed_mcap(data: &[u8], packing: Packing, is_packed: bool) -> Vec<u8> {
    let name = match packing {
        Packing::Zstd => "zstd",
        Packing::Lz4 => "lz4",
    };
    let (size, packed) = if is_packed {
        let Some((size, rest)) = data.split_first_chunk() else { return Vec::new() };
        let [low, middle, high]: [u8; 3] = *size;
        (u64::from(u32::from_le_bytes([low, middle, high, 0])), rest.to_vec())
    } else {
        let plain = chunk_of(&mcap(data));
        let packed = match packing {
            Packing::Zstd => compress_to_vec(&plain[..], CompressionLevel::Fastest),
            Packing::Lz4 => {
                let mut encoder = FrameEncoder::new(Vec::new());
                encoder.write_all(&plain).expect("memory");
                encoder.finish().expect("memory")
            }
        };
        (plain.len() as u64, packed)
    };
    let mut body = vec![0; 16];
    body.extend(size.to_le_bytes());
    body.extend([0; 4]);
    body.extend((name.len() as u32).to_le_bytes());
    body.extend(name.bytes());
    body.extend((packed.len() as u64).to_le_bytes());
    body.extend(packed);
    let mut file = mcap::MAGIC.to_vec();
    for (code, body) in [(1, &[0; 8][..]), (6, &body), (15, &[0; 4]), (2, &[0; 20])] {
        file.push(code);
        file.extend((body.len() as u64).to_le_bytes());
        file.extend(body);
    }
    file.extend(mcap::MAGIC);
    file
}

/// Records of the first chunk, which is not packed.
fn chunk_of(file: &[u8]) -> Vec<u8> {
    let mut at = mcap::MAGIC.len();
    while let Some([code, length @ ..]) = file.get(at..).and_then(|rest| rest.first_chunk::<9>()) {
        let body = at + 9..at + 9 + u64::from_le_bytes(*length) as usize;
        if *code == 6 {
            return file[body][40..].to_vec();
        }
        at = body.end;
    }
    Vec::new()
}

/// Makes the checksum of each part of a PNG file fit, so that what is behind it is reached.
pub(crate) fn repair_png(file: &mut [u8]) {
    let mut at = 8;
    while let Some(length) = file.get(at..at + 4) {
        let length = u32::from_be_bytes([length[0], length[1], length[2], length[3]]) as usize;
        let Some(end) = length.checked_add(at + 8) else { return };
        let Some(part) = file.get(at + 4..end) else { return };
        let checksum = rigidformer_tests::hostile::crc32(part).to_be_bytes();
        let Some(slot) = file.get_mut(end..end + 4) else { return };
        slot.copy_from_slice(&checksum);
        at = end + 4;
    }
}
