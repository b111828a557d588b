//! Captures of MCAP files and streams, in the order of their times.

use std::collections::{BTreeMap, BTreeSet};
use std::io::Read;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use nalgebra::{Isometry3, Point3};
use rigidformer_runtime::memory::{self, Budget};

use super::error::{CaptureError, CaptureProblem};
use super::manifest::MAX_CAPTURE_SPAN_S;
use super::messages::{PointCloud, RawImage, SCALE_M, Steps, decode, stamp};
use super::notes::{LeftOut, Note, Notes};
use super::options::Options;
use super::order::{Look, Ordered};
use super::points::{Origin, cloud_of, count, drop_no_returns, shortened};
use super::records::{Channel, Message, Messages};
use super::ros;
use super::topics::{Survey, What, at, what};
use crate::capture::{Capture, Cloud, DepthView, View};

/// How long a view waits for others that are older, of a file and of a stream, nanoseconds of log time.
const WAIT_NS: i128 = 1_000_000_000;
const WAIT_LIVE_NS: i128 = 100_000_000;
/// Views that wait at once, at most. Their bytes are at most a quarter of a budget.
const MAX_WAITING: usize = 4096;
/// Transforms are kept for this long before the views that wait, beside the latency, nanoseconds.
const KEPT_NS: i128 = 2_000_000_000;
/// Largest time, nanoseconds: beyond, seconds do not resolve milliseconds.
const MAX_TIME_NS: i128 = 1_000_000_000_000_000_000_000;
/// Times within this are of one capture, nanoseconds.
const SPAN_NS: i128 = (MAX_CAPTURE_SPAN_S * 1e9) as i128;

/// Captures that are read one at a time.
pub(super) struct McapCaptures {
    path: PathBuf,
    messages: Box<dyn Iterator<Item = Result<Message, CaptureError>> + Send>,
    survey: Survey,
    /// Topics that are read; none of a stream, which chooses as they come.
    chosen: Option<BTreeSet<String>>,
    notes: Notes,
    latency: i128,
    wait: i128,
    /// Log time of the last message.
    now: i128,
    /// By time, and by the order in which they came.
    waiting: BTreeMap<(i128, u64), Waiting>,
    waiting_bytes: usize,
    came: u64,
    /// Of the first capture, nanoseconds since 1970.
    start: Option<i128>,
    /// Of the last capture, and its topics.
    last: Option<(i128, BTreeSet<Arc<str>>)>,
    world: Option<Arc<str>>,
    origin: Origin,
    is_ended: bool,
}

/// A view that waits for older ones.
struct Waiting {
    message: Message,
    what: What,
    log: i128,
}

impl Waiting {
    fn bytes(&self) -> usize {
        self.message.data().len()
    }
}

impl McapCaptures {
    /// Reads files once, to learn what they have; several are parts of one recording.
    pub(super) fn open(paths: &[PathBuf], options: &Options) -> Result<Self, CaptureError> {
        let path = paths.first().cloned().unwrap_or_default();
        let mut survey = Survey::new(&options.topics);
        let mut notes = Notes::default();
        let messages = Ordered::scan(paths, &mut survey, &mut notes)?;
        let chosen = survey.choose(&mut notes).map_err(|why| CaptureError::of(&path, why))?;
        if chosen.is_empty() {
            let names = survey.unread().collect::<Vec<_>>().join(", ");
            let names = if names.is_empty() { "none at all".into() } else { names };
            return Err(CaptureError::of(path, CaptureProblem::NoMessages(names)));
        }
        Ok(Self::new(path, Box::new(messages), survey, Some(chosen), notes, options))
    }

    /// Reads a stream as it comes.
    pub(super) fn stream(
        from: impl Read + Send + 'static,
        options: &Options,
    ) -> Result<Self, CaptureError> {
        let path = Path::new("-");
        let messages = Box::new(Messages::new(path, from, None)?);
        let survey = Survey::new(&options.topics);
        Ok(Self::new(path.into(), messages, survey, None, Notes::default(), options))
    }

    fn new(
        path: PathBuf,
        messages: Box<dyn Iterator<Item = Result<Message, CaptureError>> + Send>,
        survey: Survey,
        chosen: Option<BTreeSet<String>>,
        notes: Notes,
        options: &Options,
    ) -> Self {
        McapCaptures {
            path,
            messages,
            survey,
            wait: if chosen.is_some() { WAIT_NS } else { WAIT_LIVE_NS },
            chosen,
            notes,
            latency: (options.latency_s * 1e9) as i128,
            now: 0,
            waiting: BTreeMap::new(),
            waiting_bytes: 0,
            came: 0,
            start: None,
            last: None,
            world: None,
            origin: Origin::default(),
            is_ended: false,
        }
    }

    /// Topics that are passed over, each with its type.
    pub(super) fn unread(&self) -> impl Iterator<Item = &str> {
        self.survey.unread()
    }

    /// What is to be said so far.
    pub(super) fn notes(&self) -> &Notes {
        &self.notes
    }

    /// The way up, by an inertial sensor.
    pub(super) fn up(&self) -> Option<nalgebra::Vector3<f32>> {
        self.survey.up()
    }

    /// Takes the next message; an error ends a stream.
    fn take(&mut self, message: Message) -> Result<(), CaptureError> {
        let log = i128::from(message.log_time);
        self.now = self.now.max(log);
        let is_stream = self.chosen.is_none();
        if is_stream && !self.survey.look(&self.path, &message, &mut self.notes)? {
            return Ok(());
        }
        let done = match what(&message.channel) {
            what @ (What::Cloud | What::Image | What::Packed) => {
                self.wait_for_older(message, what);
                return Ok(());
            }
            What::Calibration => self.survey.calibration(&message),
            What::Transform => {
                let first = self.waiting.keys().next().map(|(time, _)| *time);
                let before = first.unwrap_or_else(|| self.survey.clocks.logged(log));
                let before = before - self.latency.abs() - KEPT_NS - self.wait;
                self.survey.transforms(&message, false, Some(before))
            }
            What::Acceleration | What::Other => Ok(()),
        };
        if let Err(problem) = done {
            self.notes.leave_out(&at(&self.path, &message, problem));
        }
        Ok(())
    }

    fn wait_for_older(&mut self, message: Message, what: What) {
        let channel = Arc::clone(&message.channel);
        let topic = channel.topic.as_str();
        let is_chosen = match &self.chosen {
            Some(chosen) => chosen.contains(topic),
            None => self.survey.takes(topic),
        };
        if !is_chosen {
            return;
        }
        let log = i128::from(message.log_time);
        let schema = channel.schema.as_deref().unwrap_or_default();
        // A message whose stamp cannot be read is told when it is decoded.
        let stamp = stamp(&channel.encoding, schema, message.data()).unwrap_or_default();
        let time = self.survey.clocks.time(topic, stamp, log, &mut self.notes);
        if time.abs() > MAX_TIME_NS {
            let problem = CaptureProblem::Time(time as f64 / 1e9);
            return self.notes.leave_out(&at(&self.path, &message, problem));
        }
        if let Some((last, topics)) = &self.last
            && time < last + SPAN_NS
        {
            let topic = shortened(topic.to_owned());
            let is_again = (time - last).abs() < SPAN_NS && topics.contains(&*channel.topic);
            self.notes.add(if is_again { Note::Duplicate(topic) } else { Note::Late(topic) });
            return;
        }
        // A copy: the block may be large, and others wait in it no longer.
        let data = message.data().to_vec();
        let message = Message { data: 0..data.len(), records: Arc::new(data), ..message };
        let waiting = Waiting { message, what, log };
        self.waiting_bytes += waiting.bytes();
        self.waiting.insert((time, self.came), waiting);
        self.came += 1;
    }

    /// Views of the next capture, once none of it can come any more.
    fn due(&mut self) -> Option<(i128, Vec<Waiting>)> {
        let (&(time, _), first) = self.waiting.first_key_value()?;
        let is_full =
            self.waiting.len() > MAX_WAITING || self.waiting_bytes as u64 > memory::limit() / 4;
        if !(self.is_ended || is_full || first.log + self.wait <= self.now) {
            return None;
        }
        let later = self.waiting.split_off(&(time + SPAN_NS, 0));
        let views: Vec<Waiting> =
            std::mem::replace(&mut self.waiting, later).into_values().collect();
        self.waiting_bytes -= views.iter().map(Waiting::bytes).sum::<usize>();
        Some((time, views))
    }

    fn capture(&mut self, time: i128, waiting: Vec<Waiting>) -> Result<Capture, CaptureError> {
        let start = *self.start.get_or_insert(time);
        let time_s = (time - start) as f64 / 1e9;
        let mut budget = Budget::default();
        let (mut topics, mut views, mut left) = (BTreeSet::new(), Vec::new(), LeftOut::default());
        for Waiting { message, what, .. } in waiting {
            let topic = message.channel.topic.as_str();
            // One sensor has one view in a capture: two messages of a time contradict each other.
            if !topics.insert(Arc::from(topic)) {
                self.notes.add(Note::Duplicate(shortened(topic.to_owned())));
                continue;
            }
            match self.view(&message, what, time, &mut budget) {
                Ok(view) => views.push(view),
                Err(problem) => left.add(at(&self.path, &message, problem), &mut self.notes),
            }
        }
        self.last = Some((time, topics));
        left.of(Capture { time_s, views }, &mut self.notes)
    }

    fn view(
        &mut self,
        message: &Message,
        what: What,
        time: i128,
        budget: &mut Budget,
    ) -> Result<View, CaptureProblem> {
        let (channel, data) = (&message.channel, message.data());
        // What it decodes to is no longer than two copies of it, which are gone when the next one is read.
        let mut meanwhile = budget.clone();
        meanwhile.take(2 * data.len() as u64)?;
        let view = match what {
            What::Cloud => View::Cloud(self.cloud(channel, data, time, &mut meanwhile)?),
            _ => View::Depth(self.image(channel, data, time, &mut meanwhile)?),
        };
        budget.take(bytes_of(&view, &channel.topic))?;
        Ok(view)
    }

    fn cloud(
        &mut self,
        channel: &Channel,
        data: &[u8],
        time: i128,
        budget: &mut Budget,
    ) -> Result<Cloud, CaptureProblem> {
        let (encoding, schema) =
            (channel.encoding.as_str(), channel.schema.as_deref().unwrap_or_default());
        let (frame, mut points, is_labelled, own) = if schema.starts_with("foxglove.") {
            let read: PointCloud = decode(encoding, schema, data)?;
            let (points, is_labelled) = read.points(budget)?;
            let own = read.pose()?;
            (read.frame_id, points, is_labelled, own)
        } else {
            let (frame, points, is_labelled) = ros::cloud(encoding, schema, data, budget)?;
            (frame, points, is_labelled, Isometry3::identity())
        };
        count(budget, points.len())?;
        let place = self.place(&frame, time);
        let pose = place.unwrap_or_default() * own;
        drop_no_returns(&mut points, &mut self.notes);
        points.iter_mut().for_each(|(point, _)| *point = pose * *point);
        let (origin, notes) = (&mut self.origin, &mut self.notes);
        let cloud = cloud_of(&points, is_labelled, false, origin, notes)?;
        // The sensor is at the origin of its frame, unless that is the world.
        let sensor = place.map(|place| self.origin.moved(place * Point3::origin()));
        Ok(Cloud { sensor, ..cloud })
    }

    fn image(
        &mut self,
        channel: &Channel,
        data: &[u8],
        time: i128,
        budget: &mut Budget,
    ) -> Result<DepthView, CaptureProblem> {
        let (encoding, schema) =
            (channel.encoding.as_str(), channel.schema.as_deref().unwrap_or_default());
        let (frame, Steps { size, depths }) = match schema {
            "foxglove.RawImage" => {
                let read: RawImage = decode(encoding, schema, data)?;
                let steps = read.steps()?;
                (read.frame_id, steps)
            }
            _ if schema.ends_with("CompressedImage") => {
                ros::compressed(encoding, schema, data, budget)?
            }
            _ => ros::image(encoding, schema, data)?,
        };
        let lens = self.survey.cameras.of(channel, &frame)?;
        if lens.camera.size() != size {
            return Err(CaptureProblem::ImageSize { found: size, camera: lens.camera.size() });
        }
        if lens.model.is_some() {
            self.notes.add(Note::Straightened(shortened(frame.clone())));
        }
        let depths = lens.straightened(depths);
        let place = self.place(&frame, time).unwrap_or_default();
        let at = self.origin.settled(place * Point3::origin(), &mut self.notes);
        let pose = Isometry3::from_parts(at.into(), place.rotation.cast());
        Ok(DepthView::new(lens.camera.moved(pose)?, SCALE_M, depths, None)?)
    }

    /// Where a sensor's frame was; none for the world itself, and where nothing is known of it.
    fn place(&mut self, frame: &str, time: i128) -> Option<Isometry3<f64>> {
        let tree = &self.survey.tree;
        let Some(place) = tree.place(frame, time - self.latency) else {
            if !tree.is_empty() && !tree.knows(frame) {
                self.notes.add(Note::UnknownFrame(shortened(frame.to_owned())));
            }
            return None;
        };
        if frame.starts_with('/') {
            self.notes.add(Note::Slash(shortened(frame.to_owned())));
        }
        if let Some(ended) = place.ended {
            self.notes.add(Note::Ended(shortened(ended)));
        }
        match &self.world {
            Some(world) if *world != place.world => {
                let both = format!("{:?} and {:?}", &**world, &*place.world);
                self.notes.add(Note::Apart(shortened(both)));
            }
            Some(_) => {}
            None => self.world = Some(place.world),
        }
        Some(place.pose)
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
        loop {
            if let Some((time, views)) = self.due() {
                return Some(self.capture(time, views));
            }
            if self.is_ended {
                return None;
            }
            let taken = match self.messages.next() {
                Some(Ok(message)) => self.take(message),
                // A file was read once, so this is the end of a stream, or one that has changed since.
                Some(Err(error)) => {
                    self.is_ended = true;
                    self.notes.add(Note::Unfinished(shortened(error.to_string())));
                    Ok(())
                }
                None => {
                    self.is_ended = true;
                    Ok(())
                }
            };
            if let Err(error) = taken {
                return Some(Err(error));
            }
        }
    }
}

#[cfg(test)]
mod tests;
