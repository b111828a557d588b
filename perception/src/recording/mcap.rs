//! Captures of an MCAP file, as they come.

use std::collections::{BTreeSet, HashMap, HashSet};
use std::path::{Path, PathBuf};

use nalgebra::{Isometry3, Point3};
use rigidformer_runtime::memory::Budget;

use super::error::{CaptureError, CaptureProblem};
use super::manifest::MAX_CAPTURE_SPAN_S;
use super::messages::{
    CameraCalibration, PointCloud, PointCloud2, RawImage, SCALE_M, decode, is_transform, transforms,
};
use super::points::shortened;
use super::records::{Message, Messages, messages};
use crate::camera::Camera;
use crate::capture::{Capture, Cloud, DepthView, View};

/// Unread topics that are remembered, at most.
const MAX_NAMES: usize = 32;
/// Cameras, and frames, that a file may have, and bytes of a frame's name, at most.
// They bound memory, whatever a file contains.
const MAX_FRAMES: usize = 1 << 16;
const MAX_NAME_BYTES: usize = 1024;
/// Frames from a sensor to the world, at most.
// Transforms of a hostile file may form a cycle.
const MAX_LINKS: usize = 32;

/// Captures that are read one at a time.
pub(super) struct McapCaptures {
    path: PathBuf,
    messages: Messages,
    cameras: HashMap<String, Camera>,
    transforms: Transforms,
    /// Of the first message, nanoseconds since 1970.
    start: Option<i128>,
    /// What has been read of the next capture, and the topics.
    pending: Option<(Capture, HashSet<String>)>,
    /// What may still be read of the next capture.
    budget: Budget,
    /// The first capture, which `open` reads to find whether there is one.
    first: Option<Capture>,
    unread: BTreeSet<String>,
}

/// Of a frame, its parent and the pose in that.
type Transforms = HashMap<String, (String, Isometry3<f32>)>;

/// Remembers what is known of a frame, whatever was known before.
fn remember<T>(
    known: &mut HashMap<String, T>,
    name: String,
    value: T,
) -> Result<(), CaptureProblem> {
    if let Some(before) = known.get_mut(&name) {
        *before = value;
        return Ok(());
    }
    if known.len() >= MAX_FRAMES || name.len() > MAX_NAME_BYTES {
        return Err(CaptureProblem::TooManyFrames);
    }
    known.insert(name, value);
    Ok(())
}

/// The first transform of each frame: it holds before its time too. A frame that never moves is often said once, and late.
fn first_transforms(path: &Path) -> Result<Transforms, CaptureError> {
    let mut first = Transforms::new();
    // What is wrong here is told when it is read again, in its place.
    for message in messages(path)?.map_while(Result::ok) {
        let channel = &message.channel;
        let Some(schema) = channel.schema.as_deref().filter(|name| is_transform(name)) else {
            continue;
        };
        let found = transforms(&channel.encoding, schema, message.data());
        for found in found.ok().flatten().into_iter().flatten() {
            if let Some(child) = found.child.filter(|child| !first.contains_key(child)) {
                let _ = remember(&mut first, child, (found.parent, found.pose.cast()));
            }
        }
    }
    Ok(first)
}

/// Content of a message.
enum Content {
    View(i128, View),
    /// A calibration or a transform.
    Known,
    Unread,
}

impl McapCaptures {
    /// Reads up to the first capture.
    pub(super) fn open(path: &Path) -> Result<Self, CaptureError> {
        let mut captures = McapCaptures {
            path: path.into(),
            messages: messages(path)?,
            cameras: HashMap::new(),
            transforms: first_transforms(path)?,
            start: None,
            pending: None,
            budget: Budget::default(),
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
            let topic = message.channel.topic.as_str();
            // What it decodes to is no longer than two copies of it, and both are there with the capture before.
            let room = Budget::new(self.budget.left()).take(2 * message.data().len() as u64);
            if let Err(large) = room {
                let location =
                    format!("message {} of {}", message.sequence, shortened(topic.into()));
                return Some(Err(CaptureError::at(self.path.as_path(), &location, large)));
            }
            let added = self.decode_message(&message).and_then(|content| match content {
                Content::View(time, view) => self.add(time, view, topic),
                Content::Known => Ok(None),
                Content::Unread => {
                    let schema = message.channel.schema.as_deref().unwrap_or("no type");
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
                    let location =
                        format!("message {} of {}", message.sequence, shortened(topic.into()));
                    return Some(Err(CaptureError::at(self.path.as_path(), &location, problem)));
                }
            }
        }
    }

    fn decode_message(&mut self, message: &Message) -> Result<Content, CaptureProblem> {
        let channel = &message.channel;
        let Some(schema) = channel.schema.as_deref() else { return Ok(Content::Unread) };
        let (encoding, data) = (channel.encoding.as_str(), message.data());
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
                remember(&mut self.cameras, read.frame_id, camera)?;
                Ok(Content::Known)
            }
            _ if is_transform(schema) => {
                for found in transforms(encoding, schema, data)?.into_iter().flatten() {
                    if let Some(child) = found.child {
                        let known = (found.parent, found.pose.cast());
                        remember(&mut self.transforms, child, known)?;
                    }
                }
                Ok(Content::Known)
            }
            // Poses of objects are no transforms of sensors, so errors in them do no harm here.
            _ => Ok(Content::Unread),
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
                if topics.contains(topic) {
                    return Err(CaptureProblem::Duplicate(time_s));
                }
                self.budget.take(bytes_of(&view, topic))?;
                capture.views.push(view);
                topics.insert(topic.to_owned());
                return Ok(None);
            }
        }
        self.budget = Budget::default();
        self.budget.take(bytes_of(&view, topic))?;
        let next = (Capture { time_s, views: vec![view] }, [topic.to_owned()].into());
        Ok(self.pending.replace(next).map(|(capture, _)| capture))
    }
}

/// What a view and its topic take in memory.
fn bytes_of(view: &View, topic: &str) -> u64 {
    let pixels = |numbers: &Vec<u16>| size_of::<u16>() * numbers.len();
    let own = match view {
        View::Depth(view) => pixels(&view.depth) + view.labels.as_ref().map_or(0, pixels),
        View::Cloud(cloud) => {
            size_of::<Point3<f32>>() * cloud.points.len() + cloud.labels.as_ref().map_or(0, pixels)
        }
    };
    (own + size_of::<View>() + size_of::<String>() + topic.len()) as u64
}

impl Iterator for McapCaptures {
    type Item = Result<Capture, CaptureError>;

    fn next(&mut self) -> Option<Self::Item> {
        self.first.take().map(Ok).or_else(|| self.read())
    }
}

#[cfg(test)]
mod tests;
