//! Blocks of an MCAP file: its chunks, and the records between them. Every length that the file says is checked against what is there
//! before it is used.

use std::io::{BufReader, Read};
use std::ops::Range;

use lz4_flex::frame::FrameDecoder as Lz4;
use mcap::records::{ChunkHeader, Record, op};
use mcap::{MAGIC, parse_record};
use rigidformer_runtime::memory;
use ruzstd::decoding::FrameDecoder as Zstd;

/// Bytes of a record, and of a chunk's records, at most: an image of 8192 x 8192 pixels.
const MAX_RECORD_BYTES: u64 = 160 << 20;
/// Bytes that a chunk's records may have in a short file, and largest ratio of them to the file.
// A chunk is compressed, so that it may be longer than the file. The ratio bounds what a hostile file makes the reader allocate.
const MIN_RECORD_BYTES: u64 = 1 << 20;
const MAX_GROWTH: u64 = 64;
/// Bytes that all chunks of a short file may have together: a quarter of a budget. Those of a longer one have [`MAX_GROWTH`] times its
/// own.
// It bounds the time that a hostile file takes.
fn min_unpacked_bytes() -> u64 {
    memory::limit() / 4
}
/// Bytes of zstd's window that every decoder is to have.
const MIN_WINDOW_BYTES: u64 = 8 << 20;
/// Records between chunks are taken together up to so many bytes.
const TOGETHER_BYTES: usize = 1 << 20;
/// Bytes before a record: what it is, and its length.
const HEAD_BYTES: usize = 9;
/// Bytes of a chunk before the name of its compression: two times, a length and a checksum.
const CHUNK_HEAD_BYTES: usize = 8 + 8 + 8 + 4;

pub(super) const LONGER: &str = "a record is longer than its chunk";
const WITHIN: &str = "it ends within a record";

/// Records, and where in the file they are.
pub(super) struct Block {
    pub(super) records: Vec<u8>,
    pub(super) place: Place,
}

/// Where a block is, and how its bytes become records.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Place {
    /// First byte, behind the head of a chunk's record.
    pub(super) start: u64,
    pub(super) bytes: u64,
    pub(super) is_chunk: bool,
    /// Whether the file ends within it.
    pub(super) is_cut: bool,
}

/// Why a block cannot be had.
#[derive(Debug, PartialEq)]
pub(super) struct Broken {
    pub(super) why: String,
    /// Whether nothing behind it can be had either.
    pub(super) is_end: bool,
    /// Whether the file merely stops, as a recorder leaves it that was killed.
    pub(super) is_cut: bool,
    /// Bytes that its chunks may have together, where they have more.
    pub(super) most_unpacked: Option<u64>,
}

impl Broken {
    fn end(why: impl Into<String>) -> Self {
        Broken { why: why.into(), is_end: true, is_cut: false, most_unpacked: None }
    }

    fn cut(why: impl Into<String>) -> Self {
        Broken { is_cut: true, ..Broken::end(why) }
    }

    /// Of a block alone.
    pub(super) fn part(why: String) -> Self {
        Broken { is_end: false, ..Broken::end(why) }
    }
}

impl From<std::io::Error> for Broken {
    fn from(error: std::io::Error) -> Self {
        match error.kind() {
            std::io::ErrorKind::UnexpectedEof => Broken::cut("it ends early"),
            _ => Broken::end(error.to_string()),
        }
    }
}

/// The blocks of a file, one after another.
pub(super) struct Blocks<R: Read> {
    /// None once nothing more can be read.
    file: Option<BufReader<R>>,
    at: u64,
    /// A record's head that has been read ahead.
    head: Option<[u8; HEAD_BYTES]>,
    /// Behind the messages is a summary, which says again what was read.
    is_summary: bool,
    /// Whether records between chunks are taken together.
    together: bool,
    /// What the next call is to tell.
    failed: Option<Broken>,
    unpacker: Unpacker,
}

/// Undoes the compression of chunks.
pub(super) struct Unpacker {
    zstd: Zstd,
    /// Bytes of the file.
    length: u64,
    /// Bytes of records in the chunks so far.
    unpacked_bytes: u64,
    /// As many as they may have, once they have more.
    most_unpacked: Option<u64>,
}

impl<R: Read> Blocks<R> {
    /// Checks the first bytes. `length` is that of the file; a stream has none.
    pub(super) fn new(file: R, length: Option<u64>, together: bool) -> Result<Self, String> {
        let mut file = BufReader::new(file);
        magic(&mut file).map_err(|broken| broken.why)?;
        let unpacker = Unpacker::new(length);
        let at = MAGIC.len() as u64;
        Ok(Blocks {
            file: Some(file),
            at,
            head: None,
            is_summary: false,
            together,
            failed: None,
            unpacker,
        })
    }

    /// The next block; none at the end of the file. An error of a chunk costs this one alone.
    pub(super) fn next(&mut self) -> Result<Option<Block>, Broken> {
        let Some(mut file) = self.file.take() else { return Ok(None) };
        let read = match self.failed.take() {
            Some(failed) => Err(failed),
            None => self.read(&mut file),
        };
        let goes_on = match &read {
            Ok(block) => block.is_some(),
            Err(broken) => !broken.is_end,
        };
        if goes_on {
            self.file = Some(file);
        }
        read
    }

    fn head(&mut self, file: &mut impl Read) -> Result<[u8; HEAD_BYTES], Broken> {
        if let Some(head) = self.head.take() {
            return Ok(head);
        }
        let mut head = [0; HEAD_BYTES];
        file.read_exact(&mut head)?;
        self.at += HEAD_BYTES as u64;
        Ok(head)
    }

    fn read(&mut self, file: &mut BufReader<R>) -> Result<Option<Block>, Broken> {
        loop {
            let head = self.head(file)?;
            let (code, length) = split(head);
            if code == op::CHUNK && !self.is_summary {
                return self.chunk(file, length).map(Some);
            }
            // The summary says types and topics once more, which helps where they come late.
            if is_taken(code) && !(self.is_summary && code == op::MESSAGE) {
                return self.plain(file, head).map(Some);
            }
            let passed = std::io::copy(&mut file.by_ref().take(length), &mut std::io::sink())?;
            self.at = self.at.saturating_add(passed);
            if passed != length {
                return Err(Broken::cut(WITHIN));
            }
            self.is_summary |= code == op::DATA_END;
            if code == op::FOOTER {
                return magic(file).map(|()| None);
            }
        }
    }

    fn take(
        &mut self,
        file: &mut impl Read,
        length: u64,
        into: &mut Vec<u8>,
    ) -> Result<bool, Broken> {
        let most = MAX_RECORD_BYTES.min(self.unpacker.length);
        if length > most {
            return Err(Broken::end(format!("a record has {length} bytes, more than {most}")));
        }
        let read = file.take(length).read_to_end(into)? as u64;
        self.at += read;
        Ok(read == length)
    }

    fn chunk(&mut self, file: &mut BufReader<R>, length: u64) -> Result<Block, Broken> {
        let (start, mut bytes) = (self.at, Vec::new());
        let is_whole = self.take(file, length, &mut bytes)?;
        let place = Place { start, bytes: bytes.len() as u64, is_chunk: true, is_cut: !is_whole };
        let records = self.unpacker.records(place, &bytes);
        match records {
            Ok(records) => {
                // What is there of it is given first.
                self.failed = (!is_whole).then(|| Broken::cut(WITHIN));
                Ok(Block { records, place })
            }
            // Chunks behind it have more still.
            Err(why) if self.unpacker.most_unpacked.is_some() => {
                let most_unpacked = self.unpacker.most_unpacked;
                Err(Broken { most_unpacked, ..Broken::end(why) })
            }
            Err(_) if !is_whole => Err(Broken::cut(WITHIN)),
            Err(why) => Err(Broken::part(why)),
        }
    }

    fn plain(&mut self, file: &mut BufReader<R>, head: [u8; HEAD_BYTES]) -> Result<Block, Broken> {
        let start = self.at - HEAD_BYTES as u64;
        let mut records = Vec::new();
        let mut head = head;
        loop {
            records.extend(head);
            let (before, (_, length)) = (records.len(), split(head));
            let is_whole = match self.take(file, length, &mut records) {
                Ok(true) => Ok(()),
                Ok(false) => Err(Broken::cut(WITHIN)),
                Err(broken) => Err(broken),
            };
            // Records before the one that is wrong are sound, and that one is told by the next call.
            if let Err(broken) = is_whole {
                if before == HEAD_BYTES {
                    return Err(broken);
                }
                records.truncate(before - HEAD_BYTES);
                self.failed = Some(broken);
                break;
            }
            if !self.together || records.len() >= TOGETHER_BYTES || self.is_summary {
                break;
            }
            // The end of the file is told by the next call.
            let Ok(next) = self.head(file) else { break };
            let (code, length) = split(next);
            if !is_taken(code) || length > TOGETHER_BYTES as u64 {
                self.head = Some(next);
                break;
            }
            head = next;
        }
        let place = Place { start, bytes: records.len() as u64, is_chunk: false, is_cut: false };
        Ok(Block { records, place })
    }
}

fn magic(file: &mut impl Read) -> Result<(), Broken> {
    let mut magic = [0; MAGIC.len()];
    file.read_exact(&mut magic)?;
    if magic == MAGIC { Ok(()) } else { Err(Broken::end("its first or last bytes are others")) }
}

impl Unpacker {
    pub(super) fn new(length: Option<u64>) -> Self {
        Unpacker {
            zstd: Zstd::new(),
            length: length.unwrap_or(u64::MAX),
            unpacked_bytes: 0,
            most_unpacked: None,
        }
    }

    /// Records of a block's bytes.
    pub(super) fn records(&mut self, place: Place, bytes: &[u8]) -> Result<Vec<u8>, String> {
        let mut records = match (place.is_chunk, place.is_cut) {
            (false, _) => return Ok(bytes.to_vec()),
            (true, false) => self.unpacked(bytes)?,
            (true, true) => self.rescued(bytes).ok_or(WITHIN)?,
        };
        // All of a chunk is looked at before any of it is taken.
        let mut at = 0;
        loop {
            match next_record(&records, at) {
                Ok(Some((_, body))) => at = body.end,
                Ok(None) => return Ok(records),
                Err(_) if place.is_cut => {
                    records.truncate(at);
                    return Ok(records);
                }
                Err(why) => return Err(why),
            }
        }
    }

    fn room(&mut self, size: u64) -> Result<u64, String> {
        let most = self.length.saturating_mul(MAX_GROWTH).clamp(MIN_RECORD_BYTES, MAX_RECORD_BYTES);
        if size > most {
            return Err(format!("a chunk has {size} bytes of records, more than {most}"));
        }
        let most_of_all = self.length.saturating_mul(MAX_GROWTH).max(min_unpacked_bytes());
        self.unpacked_bytes = self.unpacked_bytes.saturating_add(size);
        if self.unpacked_bytes > most_of_all {
            self.most_unpacked = Some(most_of_all);
            return Err(format!("its chunks have more than {most_of_all} bytes of records"));
        }
        Ok(most)
    }

    /// Records of a chunk: as many bytes as it says, whose checksum fits where there is one.
    fn unpacked(&mut self, chunk: &[u8]) -> Result<Vec<u8>, String> {
        let parsed = parse_record(op::CHUNK, chunk).map_err(|error| error.to_string())?;
        let Record::Chunk { header, data } = parsed else { return Err("a chunk is none".into()) };
        let size = header.uncompressed_size;
        let most = self.room(size)?;
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

    /// What can be had of a chunk within which the file ends.
    fn rescued(&mut self, chunk: &[u8]) -> Option<Vec<u8>> {
        let long = |at: usize| -> Option<u64> {
            Some(u64::from_le_bytes(chunk.get(at..at + 8)?.try_into().ok()?))
        };
        let size = long(16)?;
        self.room(size).ok()?;
        let name_bytes: [u8; 4] =
            chunk.get(CHUNK_HEAD_BYTES..CHUNK_HEAD_BYTES + 4)?.try_into().ok()?;
        let name_end =
            (CHUNK_HEAD_BYTES + 4).checked_add(u32::from_le_bytes(name_bytes) as usize)?;
        let name = chunk.get(CHUNK_HEAD_BYTES + 4..name_end)?;
        let data = chunk.get(name_end.checked_add(8)?..)?;
        let mut records = Vec::new();
        // An error only says where it ends; what was decoded before stays.
        match name {
            b"" => records.extend(data),
            b"lz4" => {
                let _ = Lz4::new(data).take(size).read_to_end(&mut records);
            }
            // Its decoder gives nothing of a frame that is not whole.
            _ => return None,
        }
        Some(records)
    }
}

fn split([code, length @ ..]: [u8; HEAD_BYTES]) -> (u8, u64) {
    (code, u64::from_le_bytes(length))
}

/// Whether a record is read.
pub(super) fn is_taken(code: u8) -> bool {
    matches!(code, op::SCHEMA | op::CHANNEL | op::MESSAGE)
}

/// What a record is, and where; none behind the last one.
pub(super) fn next_record(records: &[u8], at: usize) -> Result<Option<(u8, Range<usize>)>, String> {
    let Some((head, rest)) = records.get(at..).and_then(|left| left.split_first_chunk()) else {
        return if at == records.len() { Ok(None) } else { Err(LONGER.into()) };
    };
    let (code, length) = split(*head);
    let length = usize::try_from(length).map_err(|_| LONGER)?;
    if length > rest.len() {
        return Err(LONGER.into());
    }
    let start = records.len() - rest.len();
    Ok(Some((code, start..start + length)))
}
