//! Captures of an MCAP file, as they come.

use std::collections::{BTreeSet, HashMap};
use std::fs::File;
use std::io::BufReader;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::path::{Path, PathBuf};

use mcap::io::MessageReader;
use mcap::sans_io::LinearReaderOptions;
use nalgebra::{Isometry3, Point3};

use super::error::{CaptureError, CaptureProblem};
use super::manifest::MAX_CAPTURE_SPAN_S;
use super::messages::{
    CameraCalibration, PointCloud, PointCloud2, RawImage, SCALE_M, decode, transforms,
};
use super::points::shortened;
use crate::camera::Camera;
use crate::capture::{Capture, Cloud, DepthView, View};

/// Bytes of a record, at most: an image of 8192 x 8192 pixels.
const MAX_RECORD_BYTES: u64 = 160 << 20;
/// Bytes that a record may have in a short file, and largest ratio of a record to the file.
// A chunk is compressed, so that it may be longer than the file. The ratio bounds what a hostile file makes the reader allocate.
const MIN_RECORD_BYTES: u64 = 1 << 20;
const MAX_GROWTH: u64 = 64;
/// Unread topics that are remembered, at most.
const MAX_NAMES: usize = 32;
/// Cameras and frames that are remembered, at most.
// It bounds memory, whatever a file contains.
const MAX_FRAMES: usize = 1024;
/// Frames from a sensor to the world, at most.
// Transforms of a hostile file may form a cycle.
const MAX_LINKS: usize = 32;

/// Captures that are read one at a time.
pub(super) struct McapCaptures {
    path: PathBuf,
    messages: Messages,
    cameras: HashMap<String, Camera>,
    /// Of a frame, its parent and the pose in that.
    transforms: HashMap<String, (String, Isometry3<f32>)>,
    /// Of the first message, nanoseconds since 1970.
    start: Option<i128>,
    /// What has been read of the next capture, and the topics.
    pending: Option<(Capture, Vec<String>)>,
    /// The first capture, which `open` reads to find whether there is one.
    first: Option<Capture>,
    unread: BTreeSet<String>,
}

/// Content of a message.
enum Content {
    View(i128, View),
    /// A calibration or a transform.
    Known,
    Unread,
}

/// The messages of a file.
pub(super) struct Messages {
    path: PathBuf,
    /// None once nothing more can be read.
    reader: Option<MessageReader<BufReader<File>>>,
}

impl Iterator for Messages {
    type Item = Result<mcap::Message<'static>, CaptureError>;

    fn next(&mut self) -> Option<Self::Item> {
        let reader = self.reader.as_mut()?;
        // mcap 0.26 subtracts without a check where a record is longer than the rest of its chunk, and panics where overflows are checked.
        let next = catch_unwind(AssertUnwindSafe(|| reader.next()));
        let why = match next {
            Ok(message) => match message? {
                Ok(message) => return Some(Ok(message)),
                Err(error) => error.to_string(),
            },
            Err(_) => {
                self.reader = None;
                "a record is longer than its chunk".into()
            }
        };
        Some(Err(CaptureError::of(self.path.as_path(), CaptureProblem::Mcap(shortened(why)))))
    }
}

/// The messages of a file, with checked sums and a limit on the length of records.
pub(super) fn messages(path: &Path) -> Result<Messages, CaptureError> {
    let unreadable = |error| CaptureError::of(path, CaptureProblem::Unreadable(error));
    let file = File::open(path).map_err(unreadable)?;
    let length = file.metadata().map_err(unreadable)?.len();
    let most = length.saturating_mul(MAX_GROWTH).clamp(MIN_RECORD_BYTES, MAX_RECORD_BYTES);
    let options = LinearReaderOptions {
        prevalidate_chunk_crcs: true,
        record_length_limit: usize::try_from(most).ok(),
        ..LinearReaderOptions::default()
    };
    let reader = MessageReader::new_with_options(BufReader::new(file), options);
    Ok(Messages { path: path.into(), reader: Some(reader) })
}

impl McapCaptures {
    /// Reads up to the first capture.
    pub(super) fn open(path: &Path) -> Result<Self, CaptureError> {
        let mut captures = McapCaptures {
            path: path.into(),
            messages: messages(path)?,
            cameras: HashMap::new(),
            transforms: HashMap::new(),
            start: None,
            pending: None,
            first: None,
            unread: BTreeSet::new(),
        };
        match captures.read() {
            Some(Ok(first)) => captures.first = Some(first),
            Some(Err(error)) => return Err(error),
            None => {
                let names =
                    captures.unread.iter().map(String::as_str).collect::<Vec<_>>().join(", ");
                let names = if names.is_empty() { "none at all".into() } else { names };
                return Err(CaptureError::of(path, CaptureProblem::NoMessages(names)));
            }
        }
        Ok(captures)
    }

    /// Topics that have been passed over so far, each with its type.
    pub(super) fn unread(&self) -> impl Iterator<Item = &str> {
        self.unread.iter().map(String::as_str)
    }

    /// The next capture is complete when a message of a later one has come.
    fn read(&mut self) -> Option<Result<Capture, CaptureError>> {
        loop {
            let message = match self.messages.next() {
                Some(Ok(message)) => message,
                Some(Err(error)) => return Some(Err(error)),
                None => return self.pending.take().map(|(capture, _)| Ok(capture)),
            };
            let topic = message.channel.topic.clone();
            let added = self.decode_message(&message).and_then(|content| match content {
                Content::View(time, view) => self.add(time, view, &topic),
                Content::Known => Ok(None),
                Content::Unread => {
                    let schema = message.channel.schema.as_ref();
                    let schema = schema.map_or("no type", |schema| schema.name.as_str());
                    // The list is for people, and memory is bounded.
                    if self.unread.len() < MAX_NAMES {
                        self.unread.insert(shortened(format!("{topic} ({schema})")));
                    }
                    Ok(None)
                }
            });
            match added {
                Ok(None) => {}
                Ok(Some(capture)) => return Some(Ok(capture)),
                Err(problem) => {
                    let location = format!("message {} of {topic}", message.sequence);
                    return Some(Err(CaptureError::at(self.path.as_path(), &location, problem)));
                }
            }
        }
    }

    fn decode_message(&mut self, message: &mcap::Message<'_>) -> Result<Content, CaptureProblem> {
        let channel = &message.channel;
        let Some(schema) = channel.schema.as_ref().map(|schema| schema.name.as_str()) else {
            return Ok(Content::Unread);
        };
        let (encoding, data) = (channel.message_encoding.as_str(), message.data.as_ref());
        let logged = i128::from(message.log_time);
        match schema {
            "foxglove.PointCloud" => {
                let read: PointCloud = decode(encoding, schema, data)?;
                let time = read.timestamp.map_or(logged, |stamp| stamp.nanoseconds());
                let cloud = self.placed(&read.frame_id, read.cloud()?);
                Ok(Content::View(time, View::Cloud(cloud)))
            }
            "sensor_msgs/msg/PointCloud2" => {
                let read = PointCloud2::decode(encoding, schema, data)?;
                let cloud = self.placed(&read.frame_id, read.cloud);
                Ok(Content::View(read.timestamp.nanoseconds(), View::Cloud(cloud)))
            }
            "foxglove.RawImage" => {
                let read: RawImage = decode(encoding, schema, data)?;
                // Colour images, which most recordings have beside depths.
                if !read.is_depth() {
                    return Ok(Content::Unread);
                }
                let time = read.timestamp.map_or(logged, |stamp| stamp.nanoseconds());
                let camera = self.cameras.get(&read.frame_id);
                let camera = camera.ok_or_else(|| {
                    CaptureProblem::NoCalibration(shortened(read.frame_id.clone()))
                })?;
                let pose = self.to_world(&read.frame_id).unwrap_or_default();
                let view = DepthView::new(camera.moved(pose)?, SCALE_M, read.depths()?, None)?;
                Ok(Content::View(time, View::Depth(view)))
            }
            "foxglove.CameraCalibration" => {
                let read: CameraCalibration = decode(encoding, schema, data)?;
                let camera = read.camera()?;
                if self.cameras.len() < MAX_FRAMES {
                    self.cameras.insert(read.frame_id, camera);
                }
                Ok(Content::Known)
            }
            // Poses of objects are no transforms of sensors, so errors in them do no harm here.
            "foxglove.PoseInFrame" | "geometry_msgs/msg/PoseStamped" => Ok(Content::Unread),
            _ => {
                let Some(found) = transforms(encoding, schema, data)? else {
                    return Ok(Content::Unread);
                };
                for found in found {
                    if let (Some(child), true) = (found.child, self.transforms.len() < MAX_FRAMES) {
                        self.transforms.insert(child, (found.parent, found.pose.cast()));
                    }
                }
                Ok(Content::Known)
            }
        }
    }

    /// Carries a frame to the one that has no parent; none for that one itself.
    fn to_world(&self, frame: &str) -> Option<Isometry3<f32>> {
        let (parent, pose) = self.transforms.get(frame)?;
        let (mut frame, mut pose) = (parent, *pose);
        for _ in 0..MAX_LINKS {
            let Some((parent, next)) = self.transforms.get(frame) else { break };
            pose = next * pose;
            frame = parent;
        }
        Some(pose)
    }

    /// A cloud in the world; the sensor is at the origin of its frame, unless that is the world.
    fn placed(&self, frame: &str, mut cloud: Cloud) -> Cloud {
        if let Some(pose) = self.to_world(frame) {
            cloud.points.iter_mut().for_each(|point| *point = pose * *point);
            cloud.sensor = Some(pose * Point3::origin());
        }
        cloud
    }

    /// Adds a view to its capture; the one before, if that is complete.
    fn add(
        &mut self,
        time: i128,
        view: View,
        topic: &str,
    ) -> Result<Option<Capture>, CaptureProblem> {
        let start = *self.start.get_or_insert(time);
        let time_s = (time - start) as f64 / 1e9;
        if let Some((capture, topics)) = &mut self.pending {
            let before_s = capture.time_s;
            if time_s < before_s {
                return Err(CaptureProblem::Backwards { time_s, before_s });
            }
            if time_s - before_s < MAX_CAPTURE_SPAN_S {
                // One sensor has one view in a capture: two messages of a time contradict each other.
                if topics.iter().any(|known| known == topic) {
                    return Err(CaptureProblem::Duplicate(time_s));
                }
                capture.views.push(view);
                topics.push(topic.to_owned());
                return Ok(None);
            }
        }
        let next = (Capture { time_s, views: vec![view] }, vec![topic.to_owned()]);
        Ok(self.pending.replace(next).map(|(capture, _)| capture))
    }
}

impl Iterator for McapCaptures {
    type Item = Result<Capture, CaptureError>;

    fn next(&mut self) -> Option<Self::Item> {
        self.first.take().map(Ok).or_else(|| self.read())
    }
}

#[cfg(test)]
mod tests;
