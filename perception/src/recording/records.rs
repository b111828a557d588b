//! Messages of an MCAP file, as they come.

use std::collections::HashMap;
use std::fs::File;
use std::io::Read;
use std::ops::Range;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use mcap::parse_record;
use mcap::records::{Record, op};

use super::blocks::{Block, Blocks, LONGER, is_taken, next_record};
use super::error::{CaptureError, CaptureProblem};
use super::points::shortened;

/// Bytes of the names of topics, types and encodings, at most.
const MAX_NAME_BYTES: usize = 16 << 20;

/// Where messages come from.
#[derive(Debug, PartialEq)]
pub(super) struct Channel {
    pub(super) topic: String,
    pub(super) encoding: String,
    /// Name of the messages' type.
    pub(super) schema: Option<Arc<str>>,
}

/// A message, with the block that holds it.
#[derive(Clone)]
pub(super) struct Message {
    pub(super) channel: Arc<Channel>,
    pub(super) sequence: u32,
    /// Nanoseconds since 1970.
    pub(super) log_time: u64,
    pub(super) records: Arc<Vec<u8>>,
    pub(super) data: Range<usize>,
}

impl Message {
    pub(super) fn data(&self) -> &[u8] {
        self.records.get(self.data.clone()).unwrap_or_default()
    }
}

/// Topics and types of a file.
#[derive(Default)]
pub(super) struct Names {
    schemas: HashMap<u16, Arc<str>>,
    channels: HashMap<u16, Arc<Channel>>,
    name_bytes: usize,
}

impl Names {
    /// Takes what a record says: the message, where it is one.
    pub(super) fn take(
        &mut self,
        records: &Arc<Vec<u8>>,
        code: u8,
        body: Range<usize>,
    ) -> Result<Option<Message>, String> {
        if !is_taken(code) {
            return Ok(None);
        }
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
                let records = Arc::clone(records);
                return Ok(Some(Message { channel, sequence, log_time, records, data }));
            }
            _ => {}
        }
        Ok(None)
    }

    /// Whether a channel has been said.
    pub(super) fn knows(&self, id: u16) -> bool {
        self.channels.contains_key(&id)
    }

    /// Takes what a block says about names, and none of its messages. What is wrong there is told with its messages.
    pub(super) fn take_names(&mut self, records: &Arc<Vec<u8>>) {
        let mut at = 0;
        while let Ok(Some((code, body))) = next_record(records, at) {
            at = body.end;
            if code != op::MESSAGE {
                let _ = self.take(records, code, body);
            }
        }
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
}

/// An error of a whole MCAP file.
pub(super) fn broken(path: &Path, why: String) -> CaptureError {
    CaptureError::of(path, CaptureProblem::Mcap(shortened(why)))
}

/// The messages of a file in its own order. Nothing comes after an error.
pub(super) struct Messages<R: Read> {
    path: PathBuf,
    /// None once nothing more can be read.
    blocks: Option<Blocks<R>>,
    names: Names,
    /// Records of a block, and where the next one starts.
    records: Arc<Vec<u8>>,
    at: usize,
}

/// Opens a file and checks its first bytes.
pub(super) fn messages(path: &Path) -> Result<Messages<File>, CaptureError> {
    let unreadable = |error| CaptureError::of(path, CaptureProblem::Unreadable(error));
    let file = File::open(path).map_err(unreadable)?;
    let length = file.metadata().map_err(unreadable)?.len();
    Messages::new(path, file, Some(length))
}

impl<R: Read> Messages<R> {
    /// Checks the first bytes; a stream has no length.
    pub(super) fn new(path: &Path, file: R, length: Option<u64>) -> Result<Self, CaptureError> {
        let blocks = Blocks::new(file, length, false).map_err(|why| broken(path, why))?;
        Ok(Messages {
            path: path.into(),
            blocks: Some(blocks),
            names: Names::default(),
            records: Arc::default(),
            at: 0,
        })
    }

    fn read(&mut self) -> Result<Option<Message>, String> {
        loop {
            if let Some((code, body)) = next_record(&self.records, self.at)? {
                self.at = body.end;
                if let Some(message) = self.names.take(&self.records, code, body)? {
                    return Ok(Some(message));
                }
                continue;
            }
            // What is dropped first makes room for what is read.
            (self.records, self.at) = (Arc::default(), 0);
            let Some(blocks) = &mut self.blocks else { return Ok(None) };
            match blocks.next().map_err(|broken| broken.why)? {
                Some(Block { records, .. }) => self.records = Arc::new(records),
                None => return Ok(None),
            }
        }
    }
}

impl<R: Read> Iterator for Messages<R> {
    type Item = Result<Message, CaptureError>;

    fn next(&mut self) -> Option<Self::Item> {
        let read = self.read();
        if read.is_err() {
            (self.blocks, self.records, self.at) = (None, Arc::default(), 0);
        }
        read.map_err(|why| broken(&self.path, why)).transpose()
    }
}
