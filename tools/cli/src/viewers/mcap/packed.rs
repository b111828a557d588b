//! MCAP files whose chunks are packed. The crate that writes them packs by libraries of C alone, so that this is done to the whole file.

use std::collections::BTreeMap;
use std::io::Write;

use ::mcap::MAGIC;
use ::mcap::records::op;
use anyhow::Context;
use lz4_flex::frame::{BlockSize, FrameEncoder, FrameInfo};

const COMPRESSION: &str = "lz4";
/// Bytes of a chunk's record before its records where they are not packed, and of those the ones that stay: times, size and checksum.
const CHUNK_HEAD: usize = 40;
const CHUNK_KEPT: usize = 28;

/// What is left to read of a record.
struct Rest<'b>(&'b [u8]);

impl<'b> Rest<'b> {
    fn take(&mut self, count: usize) -> anyhow::Result<&'b [u8]> {
        let (taken, rest) = self.0.split_at_checked(count).context("a record ends early")?;
        self.0 = rest;
        Ok(taken)
    }

    fn number(&mut self) -> anyhow::Result<u64> {
        Ok(u64::from_le_bytes(self.take(8)?.try_into()?))
    }

    fn short(&mut self) -> anyhow::Result<usize> {
        Ok(u32::from_le_bytes(self.take(4)?.try_into()?) as usize)
    }
}

/// The file that grows, and where the records of the other one are in it.
struct Packed {
    file: Vec<u8>,
    /// By where a record began: where it begins now.
    starts: BTreeMap<u64, u64>,
    /// By where a chunk begins now: bytes of its record, and of what is packed.
    chunks: BTreeMap<u64, [u64; 2]>,
    /// Where the summary begins.
    summary: usize,
}

/// The same file with packed chunks; `whole` has chunks that are not, and a summary.
pub(super) fn packed(whole: &[u8]) -> anyhow::Result<Vec<u8>> {
    let records = whole.strip_prefix(MAGIC).and_then(|rest| rest.strip_suffix(MAGIC));
    let mut rest = Rest(records.context("no whole file")?);
    let (starts, chunks) = (BTreeMap::new(), BTreeMap::new());
    let mut packed = Packed { file: MAGIC.to_vec(), starts, chunks, summary: 0 };
    while !rest.0.is_empty() {
        let start = (whole.len() - MAGIC.len() - rest.0.len()) as u64;
        packed.starts.insert(start, packed.file.len() as u64);
        let code = *rest.take(1)?.first().context("no record")?;
        let length = usize::try_from(rest.number()?)?;
        packed.add(code, rest.take(length)?)?;
    }
    packed.file.extend(MAGIC);
    Ok(packed.file)
}

impl Packed {
    fn add(&mut self, code: u8, body: &[u8]) -> anyhow::Result<()> {
        let start = self.file.len() as u64;
        let body = match code {
            op::CHUNK => {
                let (kept, records) = (body.get(..CHUNK_KEPT), body.get(CHUNK_HEAD..));
                let (kept, records) = kept.zip(records).context("a chunk ends early")?;
                let info = FrameInfo::new().block_size(BlockSize::Max1MB);
                let mut encoder = FrameEncoder::with_frame_info(info, Vec::new());
                encoder.write_all(records)?;
                let data = encoder.finish()?;
                let mut chunk = [kept, &name(), &(data.len() as u64).to_le_bytes()].concat();
                chunk.extend(&data);
                self.chunks.insert(start, [9 + chunk.len() as u64, data.len() as u64]);
                chunk
            }
            op::CHUNK_INDEX => self.chunk_index(Rest(body))?,
            op::METADATA_INDEX => {
                let mut rest = Rest(body);
                [&self.moved(rest.number()?)?.to_le_bytes(), rest.0].concat()
            }
            op::SUMMARY_OFFSET => {
                let mut rest = Rest(body);
                let (kind, first, length) = (rest.take(1)?, rest.number()?, rest.number()?);
                let (from, to) = (self.moved(first)?, self.moved(first + length)?);
                [kind, &from.to_le_bytes(), &(to - from).to_le_bytes()].concat()
            }
            op::DATA_END => crc32fast::hash(&self.file).to_le_bytes().to_vec(),
            op::FOOTER => return self.footer(Rest(body)),
            _ => body.to_vec(),
        };
        self.record(code, &body);
        if code == op::DATA_END {
            self.summary = self.file.len();
        }
        Ok(())
    }

    fn record(&mut self, code: u8, body: &[u8]) {
        self.file.push(code);
        self.file.extend((body.len() as u64).to_le_bytes());
        self.file.extend(body);
    }

    /// Where the record is that began there.
    fn moved(&self, start: u64) -> anyhow::Result<u64> {
        self.starts.get(&start).copied().context("an index of no record")
    }

    fn chunk_index(&self, mut rest: Rest<'_>) -> anyhow::Result<Vec<u8>> {
        let mut index = rest.take(16)?.to_vec();
        let start = self.moved(rest.number()?)?;
        rest.number()?;
        let [record, data] = *self.chunks.get(&start).context("an index of no chunk")?;
        index.extend(start.to_le_bytes());
        index.extend(record.to_le_bytes());
        let bytes = rest.take(4)?;
        index.extend(bytes);
        for _ in 0..Rest(bytes).short()? / 10 {
            index.extend(rest.take(2)?);
            index.extend(self.moved(rest.number()?)?.to_le_bytes());
        }
        index.extend(rest.take(8)?);
        let named = rest.short()?;
        rest.take(named)?;
        index.extend(name());
        rest.number()?;
        index.extend(data.to_le_bytes());
        index.extend(rest.0);
        Ok(index)
    }

    fn footer(&mut self, mut rest: Rest<'_>) -> anyhow::Result<()> {
        let starts = [self.moved(rest.number()?)?, self.moved(rest.number()?)?];
        let body = starts.map(u64::to_le_bytes).concat();
        self.record(op::FOOTER, &[&body[..], &[0; 4]].concat());
        let checked = self.file.len() - 4;
        let sum = crc32fast::hash(self.file.get(self.summary..checked).unwrap_or_default());
        self.file.truncate(checked);
        self.file.extend(sum.to_le_bytes());
        Ok(())
    }
}

/// The name of the compression, with its length.
fn name() -> Vec<u8> {
    [&(COMPRESSION.len() as u32).to_le_bytes(), COMPRESSION.as_bytes()].concat()
}
