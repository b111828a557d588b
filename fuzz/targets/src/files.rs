//! Folders and files for the targets that read them.

use mcap::records::MessageHeader;
use mcap::WriteOptions;
use std::collections::BTreeMap;
use std::io::Cursor;
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
