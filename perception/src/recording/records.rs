//! Messages of an MCAP file, as they come. Every length that the file says is checked against what is there before it is used.

use std::collections::HashMap;
use std::fs::File;
use std::io::{BufReader, Read};
use std::ops::Range;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use lz4_flex::frame::FrameDecoder as Lz4;
use mcap::records::{ChunkHeader, Record, op};
use mcap::{MAGIC, parse_record};
use ruzstd::decoding::FrameDecoder as Zstd;

use super::error::{CaptureError, CaptureProblem};
use super::points::shortened;

/// Bytes of a record, and of a chunk's records, at most: an image of 8192 x 8192 pixels.
const MAX_RECORD_BYTES: u64 = 160 << 20;
/// Bytes that a chunk's records may have in a short file, and largest ratio of them to the file.
// A chunk is compressed, so that it may be longer than the file. The ratio bounds what a hostile file makes the reader allocate.
const MIN_RECORD_BYTES: u64 = 1 << 20;
const MAX_GROWTH: u64 = 64;
/// Bytes that all chunks of a short file may have together; those of a longer one, [`MAX_GROWTH`] times its own.
// It bounds the time that a hostile file takes.
const MIN_UNPACKED_BYTES: u64 = 256 << 20;
/// Bytes of zstd's window that every decoder is to have.
const MIN_WINDOW_BYTES: u64 = 8 << 20;
/// Bytes of the names of topics, types and encodings, at most.
const MAX_NAME_BYTES: usize = 16 << 20;
/// Bytes before a record: what it is, and its length.
const HEAD_BYTES: usize = 9;

const LONGER: &str = "a record is longer than its chunk";
const WITHIN: &str = "it ends within a record";

/// Where messages come from.
#[derive(Debug, PartialEq)]
pub(super) struct Channel {
    pub(super) topic: String,
    pub(super) encoding: String,
    /// Name of the messages' type.
    pub(super) schema: Option<Arc<str>>,
}

/// A message, with the chunk that holds it.
pub(super) struct Message {
    pub(super) channel: Arc<Channel>,
    pub(super) sequence: u32,
    /// Nanoseconds since 1970.
    pub(super) log_time: u64,
    records: Arc<Vec<u8>>,
    data: Range<usize>,
}

impl Message {
    pub(super) fn data(&self) -> &[u8] {
        self.records.get(self.data.clone()).unwrap_or_default()
    }
}

/// The messages of a file. Nothing comes after an error.
pub(super) struct Messages {
    path: PathBuf,
    /// None once nothing more can be read.
    file: Option<BufReader<File>>,
    /// Bytes of the file.
    length: u64,
    /// Records of a chunk, or one of the file itself; and where the next one starts.
    records: Arc<Vec<u8>>,
    at: usize,
    zstd: Zstd,
    /// Bytes of records in the chunks so far.
    unpacked_bytes: u64,
    schemas: HashMap<u16, Arc<str>>,
    channels: HashMap<u16, Arc<Channel>>,
    name_bytes: usize,
}

/// Opens a file and checks its first bytes.
pub(super) fn messages(path: &Path) -> Result<Messages, CaptureError> {
    let unreadable = |error| CaptureError::of(path, CaptureProblem::Unreadable(error));
    let file = File::open(path).map_err(unreadable)?;
    let length = file.metadata().map_err(unreadable)?.len();
    let mut messages = Messages {
        path: path.into(),
        file: None,
        length,
        records: Arc::default(),
        at: 0,
        zstd: Zstd::new(),
        unpacked_bytes: 0,
        schemas: HashMap::new(),
        channels: HashMap::new(),
        name_bytes: 0,
    };
    let mut file = BufReader::new(file);
    messages.magic(&mut file).map_err(|why| messages.error(why))?;
    messages.file = Some(file);
    Ok(messages)
}

impl Messages {
    fn error(&self, why: String) -> CaptureError {
        CaptureError::of(self.path.as_path(), CaptureProblem::Mcap(shortened(why)))
    }

    fn magic(&self, file: &mut impl Read) -> Result<(), String> {
        let mut magic = [0; MAGIC.len()];
        file.read_exact(&mut magic).map_err(ends_early)?;
        if magic == MAGIC { Ok(()) } else { Err("its first or last bytes are others".into()) }
    }

    fn read(&mut self) -> Result<Option<Message>, String> {
        loop {
            if let Some((code, body)) = self.record()? {
                if let Some(message) = self.take(code, body)? {
                    return Ok(Some(message));
                }
            } else if !self.load()? {
                return Ok(None);
            }
        }
    }

    /// The next record of those that are loaded: what it is, and where.
    fn record(&mut self) -> Result<Option<(u8, Range<usize>)>, String> {
        let found = next_record(&self.records, self.at)?;
        self.at = found.as_ref().map_or(self.at, |(_, body)| body.end);
        Ok(found)
    }

    /// Takes what a record says.
    fn take(&mut self, code: u8, body: Range<usize>) -> Result<Option<Message>, String> {
        if !is_taken(code) {
            return Ok(None);
        }
        let records = Arc::clone(&self.records);
        let bytes = records.get(body.clone()).ok_or(LONGER)?;
        match parse_record(code, bytes).map_err(|error| error.to_string())? {
            Record::Schema { header, .. } => self.add_schema(header.id, &header.name)?,
            Record::Channel(channel) => {
                let schema = match channel.schema_id {
                    0 => None,
                    id => Some(self.schemas.get(&id).cloned().ok_or_else(|| {
                        format!("the topic {:?} has a type that is not there", channel.topic)
                    })?),
                };
                let (topic, encoding) = (channel.topic, channel.message_encoding);
                self.add_channel(channel.id, Channel { topic, encoding, schema })?;
            }
            Record::Message { header, data } => {
                let channel = self.channels.get(&header.channel_id).cloned();
                let channel = channel.ok_or_else(|| {
                    format!("message {} has a topic that is not there", header.sequence)
                })?;
                let data = body.end.saturating_sub(data.len())..body.end;
                let (sequence, log_time) = (header.sequence, header.log_time);
                return Ok(Some(Message { channel, sequence, log_time, records, data }));
            }
            _ => {}
        }
        Ok(None)
    }

    fn add_schema(&mut self, id: u16, name: &str) -> Result<(), String> {
        match self.schemas.get(&id) {
            _ if id == 0 => Err("a type has the number 0".into()),
            Some(known) if **known == *name => Ok(()),
            Some(_) => Err(format!("the type {id} has two names")),
            None => {
                self.count_name(name.len())?;
                self.schemas.insert(id, name.into());
                Ok(())
            }
        }
    }

    fn add_channel(&mut self, id: u16, channel: Channel) -> Result<(), String> {
        match self.channels.get(&id) {
            Some(known) if **known == channel => Ok(()),
            Some(_) => Err(format!("the topic {id} is said in two ways")),
            None => {
                self.count_name(channel.topic.len().saturating_add(channel.encoding.len()))?;
                self.channels.insert(id, Arc::new(channel));
                Ok(())
            }
        }
    }

    fn count_name(&mut self, bytes: usize) -> Result<(), String> {
        self.name_bytes = self.name_bytes.saturating_add(bytes);
        match self.name_bytes <= MAX_NAME_BYTES {
            true => Ok(()),
            false => Err(format!("its names take more than {MAX_NAME_BYTES} bytes")),
        }
    }

    /// Loads the next chunk, or the next record that is in none; false at the end of the file.
    fn load(&mut self) -> Result<bool, String> {
        // What is dropped first makes room for what is read.
        (self.records, self.at) = (Arc::default(), 0);
        let Some(mut file) = self.file.take() else { return Ok(false) };
        // Behind the messages is a summary, which says again what was read.
        let mut is_summary = false;
        loop {
            let mut head = [0; HEAD_BYTES];
            file.read_exact(&mut head).map_err(ends_early)?;
            let [code, length @ ..] = head;
            let length = u64::from_le_bytes(length);
            let is_chunk = code == op::CHUNK;
            if is_summary || !(is_chunk || is_taken(code)) {
                let passed = std::io::copy(&mut file.by_ref().take(length), &mut std::io::sink());
                if passed.map_err(ends_early)? != length {
                    return Err(WITHIN.into());
                }
                is_summary |= code == op::DATA_END;
                if code == op::FOOTER {
                    return self.magic(&mut file).map(|()| false);
                }
                continue;
            }
            if length > MAX_RECORD_BYTES.min(self.length) {
                let most = MAX_RECORD_BYTES.min(self.length);
                return Err(format!("a record has {length} bytes, more than {most}"));
            }
            let mut bytes = if is_chunk { Vec::new() } else { head.to_vec() };
            let read = file.by_ref().take(length).read_to_end(&mut bytes).map_err(ends_early)?;
            if read as u64 != length {
                return Err(WITHIN.into());
            }
            if is_chunk {
                bytes = self.unpacked(&bytes)?;
                // All of a chunk is looked at before any of it is taken.
                let mut at = 0;
                while let Some((_, body)) = next_record(&bytes, at)? {
                    at = body.end;
                }
            }
            self.records = Arc::new(bytes);
            self.file = Some(file);
            return Ok(true);
        }
    }

    /// Records of a chunk: as many bytes as it says, whose checksum fits where there is one.
    fn unpacked(&mut self, chunk: &[u8]) -> Result<Vec<u8>, String> {
        let parsed = parse_record(op::CHUNK, chunk).map_err(|error| error.to_string())?;
        let Record::Chunk { header, data } = parsed else { return Err("a chunk is none".into()) };
        let most = self.length.saturating_mul(MAX_GROWTH).clamp(MIN_RECORD_BYTES, MAX_RECORD_BYTES);
        let size = header.uncompressed_size;
        if size > most {
            return Err(format!("a chunk has {size} bytes of records, more than {most}"));
        }
        let most_of_all = self.length.saturating_mul(MAX_GROWTH).max(MIN_UNPACKED_BYTES);
        self.unpacked_bytes = self.unpacked_bytes.saturating_add(size);
        if self.unpacked_bytes > most_of_all {
            return Err(format!("its chunks have more than {most_of_all} bytes of records"));
        }
        let records = self.decompressed(&header, &data, most)?;
        if records.len() as u64 != size {
            return Err("a chunk has more or fewer bytes than it says".into());
        }
        if header.uncompressed_crc != 0 && crc32fast::hash(&records) != header.uncompressed_crc {
            return Err("the checksum of a chunk is another one".into());
        }
        Ok(records)
    }

    /// No more bytes than one above what the header says, which is at most `most`.
    fn decompressed(
        &mut self,
        header: &ChunkHeader,
        data: &[u8],
        most: u64,
    ) -> Result<Vec<u8>, String> {
        let size = usize::try_from(header.uncompressed_size).map_err(|error| error.to_string())?;
        match header.compression.as_str() {
            "" => Ok(data.to_vec()),
            "zstd" => {
                let mut records = vec![0; size];
                self.zstd.set_max_window_size(most.max(MIN_WINDOW_BYTES));
                let written = self.zstd.decode_all(data, &mut records);
                records.truncate(written.map_err(|error| format!("zstd: {error}"))?);
                Ok(records)
            }
            "lz4" => {
                let mut records = Vec::new();
                let mut lz4 = Lz4::new(data).take(header.uncompressed_size.saturating_add(1));
                // It stops behind each frame.
                while lz4.read_to_end(&mut records).map_err(|error| format!("lz4: {error}"))? > 0 {}
                Ok(records)
            }
            other => Err(format!("a chunk is compressed as {other:?}, not as zstd or lz4")),
        }
    }
}

fn is_taken(code: u8) -> bool {
    matches!(code, op::SCHEMA | op::CHANNEL | op::MESSAGE)
}

/// What a record is, and where; none behind the last one.
fn next_record(records: &[u8], at: usize) -> Result<Option<(u8, Range<usize>)>, String> {
    let Some((head, rest)) = records.get(at..).and_then(|left| left.split_first_chunk()) else {
        return if at == records.len() { Ok(None) } else { Err(LONGER.into()) };
    };
    let [code, length @ ..]: [u8; HEAD_BYTES] = *head;
    let length = usize::try_from(u64::from_le_bytes(length)).map_err(|_| LONGER)?;
    if length > rest.len() {
        return Err(LONGER.into());
    }
    let start = records.len() - rest.len();
    Ok(Some((code, start..start + length)))
}

fn ends_early(error: std::io::Error) -> String {
    match error.kind() {
        std::io::ErrorKind::UnexpectedEof => "it ends early".into(),
        _ => error.to_string(),
    }
}

impl Iterator for Messages {
    type Item = Result<Message, CaptureError>;

    fn next(&mut self) -> Option<Self::Item> {
        let read = self.read();
        if read.is_err() {
            (self.file, self.records, self.at) = (None, Arc::default(), 0);
        }
        read.map_err(|why| self.error(why)).transpose()
    }
}
