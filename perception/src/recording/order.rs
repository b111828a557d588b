//! Messages of MCAP files in the order in which they were logged, whatever their order in the files.

use std::cmp::Reverse;
use std::collections::{BinaryHeap, HashMap};
use std::fs::File;
use std::io::{Read, Seek, SeekFrom};
use std::path::{Path, PathBuf};
use std::sync::Arc;

use mcap::records::op;
use rigidformer_runtime::memory::{self, Budget};

use super::blocks::{Blocks, Broken, Place, Unpacker, next_record};
use super::error::{CaptureError, CaptureProblem};
use super::notes::{Note, Notes};
use super::points::shortened;
use super::records::{Message, Names, broken};

/// Bytes of blocks that are held while earlier messages may still come, at most: a quarter of a budget.
// It bounds memory where blocks overlap in time; what comes later than that is out of order.
fn most_held_bytes() -> u64 {
    memory::limit() / 4
}

/// A block of a file that has messages which are wanted.
struct Known {
    file: usize,
    place: Place,
    /// Log time of its first message.
    first: u64,
}

/// One file.
struct Opened {
    path: PathBuf,
    file: File,
    unpacker: Unpacker,
    names: Names,
}

/// Messages by log time.
pub(super) struct Ordered {
    files: Vec<Opened>,
    /// By log time of their first messages.
    blocks: Vec<Known>,
    next: usize,
    waiting: BinaryHeap<Reverse<Waiting>>,
    /// Of each block that is held: messages that are left, and its bytes.
    held: HashMap<usize, (usize, u64)>,
    held_bytes: u64,
}

/// A message that waits until none before it can come.
struct Waiting {
    message: Message,
    block: usize,
    at: usize,
}

impl Waiting {
    fn key(&self) -> (u64, usize, usize) {
        (self.message.log_time, self.block, self.at)
    }
}

impl PartialEq for Waiting {
    fn eq(&self, other: &Self) -> bool {
        self.key() == other.key()
    }
}

impl Eq for Waiting {}

impl PartialOrd for Waiting {
    fn partial_cmp(&self, other: &Self) -> Option<std::cmp::Ordering> {
        Some(self.cmp(other))
    }
}

impl Ord for Waiting {
    fn cmp(&self, other: &Self) -> std::cmp::Ordering {
        self.key().cmp(&other.key())
    }
}

/// What looks at all messages before they are read in order; whether a message is wanted then.
pub(super) trait Look {
    /// Looks at a message of the first pass.
    fn look(
        &mut self,
        path: &Path,
        message: &Message,
        notes: &mut Notes,
    ) -> Result<bool, CaptureError>;
}

impl Ordered {
    /// Reads files once, in their own order.
    pub(super) fn scan(
        paths: &[PathBuf],
        look: &mut impl Look,
        notes: &mut Notes,
    ) -> Result<Self, CaptureError> {
        let mut scan = Scan { blocks: Vec::new(), damaged: None, budget: Budget::default() };
        let mut files = Vec::new();
        for path in paths {
            let opened = scan.file(files.len(), path, look, notes)?;
            files.push(opened);
        }
        // Where nothing can be read, the reason is all there is to say.
        if let Some(damaged) = scan.damaged.filter(|_| scan.blocks.is_empty()) {
            return Err(damaged);
        }
        let mut blocks = scan.blocks;
        if !blocks.is_sorted_by_key(|block| block.first) {
            notes.add(Note::Reordered);
            blocks.sort_by_key(|block| block.first);
        }
        let (waiting, held) = (BinaryHeap::new(), HashMap::new());
        Ok(Ordered { files, blocks, next: 0, waiting, held, held_bytes: 0 })
    }

    /// Loads the next block; what is damaged there was told when it was scanned.
    fn load(&mut self) -> Result<(), CaptureError> {
        let index = self.next;
        self.next += 1;
        let Some(known) = self.blocks.get(index) else { return Ok(()) };
        let Some(opened) = self.files.get_mut(known.file) else { return Ok(()) };
        let records = opened.records(known.place)?;
        let (mut at, mut count) = (0, 0);
        while let Ok(Some((code, body))) = next_record(&records, at) {
            at = body.end;
            if code != op::MESSAGE {
                continue;
            }
            if let Ok(Some(message)) = opened.names.take(&records, code, body) {
                self.waiting.push(Reverse(Waiting { message, block: index, at }));
                count += 1;
            }
        }
        if count > 0 {
            let size = records.len() as u64;
            self.held.insert(index, (count, size));
            self.held_bytes += size;
        }
        Ok(())
    }

    fn pop(&mut self) -> Option<Message> {
        let Reverse(Waiting { message, block, .. }) = self.waiting.pop()?;
        if let Some((left, bytes)) = self.held.get_mut(&block) {
            *left -= 1;
            if *left == 0 {
                self.held_bytes -= *bytes;
                self.held.remove(&block);
            }
        }
        Some(message)
    }
}

impl Iterator for Ordered {
    type Item = Result<Message, CaptureError>;

    fn next(&mut self) -> Option<Self::Item> {
        while let Some(known) = self.blocks.get(self.next) {
            let is_due = self.waiting.peek().is_some_and(|Reverse(first)| {
                first.message.log_time <= known.first || self.held_bytes > most_held_bytes()
            });
            if is_due {
                break;
            }
            if let Err(error) = self.load() {
                return Some(Err(error));
            }
        }
        self.pop().map(Ok)
    }
}

/// The first reading.
struct Scan {
    blocks: Vec<Known>,
    damaged: Option<CaptureError>,
    budget: Budget,
}

impl Scan {
    fn file(
        &mut self,
        number: usize,
        path: &Path,
        look: &mut impl Look,
        notes: &mut Notes,
    ) -> Result<Opened, CaptureError> {
        let unreadable = |error| CaptureError::of(path, CaptureProblem::Unreadable(error));
        let file = File::open(path).map_err(unreadable)?;
        let length = Some(file.metadata().map_err(unreadable)?.len());
        let again = File::open(path).map_err(unreadable)?;
        let names = Names::default();
        let mut opened = Opened { path: path.into(), file, unpacker: Unpacker::new(length), names };
        let mut blocks = Blocks::new(again, length, true).map_err(|why| broken(path, why))?;
        // Topics may be said behind their messages, where chunks were moved: those blocks are looked at again.
        let mut unsettled = Vec::new();
        loop {
            match blocks.next() {
                Ok(None) => break,
                Ok(Some(block)) => {
                    let records = Arc::new(block.records);
                    opened.names.take_names(&records);
                    match homeless(&records, &opened.names) {
                        true => unsettled.push(block.place),
                        false => {
                            self.block((number, block.place), &mut opened, &records, look, notes)?
                        }
                    }
                }
                Err(Broken { most_unpacked: Some(most), .. }) => {
                    return Err(CaptureError::of(path, CaptureProblem::Unpacked { most }));
                }
                Err(failed) => {
                    let is_end = failed.is_end;
                    self.note(path, failed, notes);
                    if is_end {
                        break;
                    }
                }
            }
        }
        for place in unsettled {
            let records = opened.records(place)?;
            self.block((number, place), &mut opened, &records, look, notes)?;
        }
        // The second reading has as much to unpack as the first one.
        opened.unpacker = Unpacker::new(length);
        Ok(opened)
    }

    /// Says what is wrong with a file.
    fn note(&mut self, path: &Path, failed: Broken, notes: &mut Notes) {
        let name = path.file_name().unwrap_or_default().to_string_lossy().into_owned();
        match failed.is_cut {
            true => notes.add(Note::Unfinished(shortened(name))),
            false => notes.add(Note::Damaged(shortened(failed.why.clone()))),
        }
        self.damaged.get_or_insert_with(|| broken(path, failed.why));
    }

    /// Looks at the messages of a block.
    fn block(
        &mut self,
        (file, place): (usize, Place),
        opened: &mut Opened,
        records: &Arc<Vec<u8>>,
        look: &mut impl Look,
        notes: &mut Notes,
    ) -> Result<(), CaptureError> {
        let (mut at, mut first) = (0, None::<u64>);
        while let Ok(Some((code, body))) = next_record(records, at) {
            at = body.end;
            match opened.names.take(records, code, body) {
                Ok(Some(message)) => {
                    if look.look(&opened.path, &message, notes)? {
                        let before = first.unwrap_or(message.log_time);
                        first = Some(before.min(message.log_time));
                    }
                }
                Ok(None) => {}
                Err(why) => self.note(&opened.path, Broken::part(why), notes),
            }
        }
        if let Some(first) = first {
            let large = |large| CaptureError::of(&opened.path, CaptureProblem::Memory(large));
            self.budget.take_all::<Known>(1).map_err(large)?;
            self.blocks.push(Known { file, place, first });
        }
        Ok(())
    }
}

/// Whether a block has a message whose topic has not been said.
fn homeless(records: &[u8], names: &Names) -> bool {
    let mut at = 0;
    while let Ok(Some((code, body))) = next_record(records, at) {
        at = body.end;
        let id =
            records.get(body).and_then(|body| body.first_chunk()).map(|id| u16::from_le_bytes(*id));
        if code == op::MESSAGE && id.is_some_and(|id| !names.knows(id)) {
            return true;
        }
    }
    false
}

impl Opened {
    /// Reads a block again.
    fn records(&mut self, place: Place) -> Result<Arc<Vec<u8>>, CaptureError> {
        let unreadable = |error| CaptureError::of(&self.path, CaptureProblem::Unreadable(error));
        let mut bytes = Vec::new();
        self.file.seek(SeekFrom::Start(place.start)).map_err(unreadable)?;
        (&self.file).take(place.bytes).read_to_end(&mut bytes).map_err(unreadable)?;
        let records = self.unpacker.records(place, &bytes);
        Ok(Arc::new(records.map_err(|why| broken(&self.path, why))?))
    }
}
