//! Topics of MCAP files: what they have, which are read, and what is known of them before the first capture.

use std::collections::{BTreeMap, BTreeSet, HashMap};
use std::path::Path;

use nalgebra::Vector3;

use super::clocks::Clocks;
use super::error::{CaptureError, CaptureProblem};
use super::messages::{
    CameraCalibration, Framed, ImageKind, decode, is_transform, plain_name, stamp, transforms,
};
use super::notes::{Note, Notes};
use super::order::Look;
use super::points::shortened;
use super::records::{Channel, Message};
use super::ros;
use super::straight::Lens;
use super::tree::{Tree, plain};

/// Unread topics that are remembered, at most.
const MAX_NAMES: usize = 32;
/// Topics of clouds and images, at most; others are passed over.
// All are looked at for each message of a stream.
const MAX_TOPICS: usize = 256;
/// Cameras that are known at once, at most.
const MAX_CAMERAS: usize = 1 << 12;
/// Messages of an inertial sensor that tell which way is up.
const ACCELERATIONS: u32 = 200;

/// What messages of a type are.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum What {
    Cloud,
    Image,
    /// An image that may be a packed depth image.
    Packed,
    Calibration,
    Transform,
    Acceleration,
    Other,
}

pub(super) fn what(channel: &Channel) -> What {
    let Some(schema) = channel.schema.as_deref() else { return What::Other };
    match plain_name(schema).as_str() {
        "foxglove.PointCloud" | "sensor_msgs/PointCloud2" => What::Cloud,
        "foxglove.RawImage" | "sensor_msgs/Image" => What::Image,
        "sensor_msgs/CompressedImage" => What::Packed,
        "foxglove.CameraCalibration" | "sensor_msgs/CameraInfo" => What::Calibration,
        "sensor_msgs/Imu" => What::Acceleration,
        _ if is_transform(schema) => What::Transform,
        _ => What::Other,
    }
}

/// Where a message is, for errors.
pub(super) fn at(path: &Path, message: &Message, problem: CaptureProblem) -> CaptureError {
    let topic = shortened(message.channel.topic.clone());
    CaptureError::at(path, &format!("message {} of {topic}", message.sequence), problem)
}

/// A camera as its calibration says it: as its lens is, and as its rectified images are; or why not.
#[derive(Clone, Debug)]
pub(super) struct Calibrated {
    frame: String,
    raw: Result<Lens, String>,
    rectified: Result<Lens, String>,
}

/// Cameras by the frame, and by the part of the topic, that they share with their images.
#[derive(Debug, Default)]
pub(super) struct Cameras {
    by_frame: HashMap<String, Calibrated>,
    by_topic: HashMap<String, Calibrated>,
}

/// A topic without its last part: `/camera/depth` of `/camera/depth/image_raw`.
fn namespace(topic: &str) -> &str {
    topic.rsplit_once('/').map_or("", |(before, _)| before)
}

/// An image's topic without the transport that packs it.
fn base(topic: &str) -> &str {
    ["/compressedDepth", "/compressed"]
        .iter()
        .find_map(|end| topic.strip_suffix(end))
        .unwrap_or(topic)
}

impl Cameras {
    /// Keeps a calibration: the first one of its name, or the last one.
    fn keep(&mut self, message: &Message, is_first: bool) -> Result<(), CaptureProblem> {
        let (channel, data) = (&message.channel, message.data());
        let schema = channel.schema.as_deref().unwrap_or_default();
        let why = |problem: CaptureProblem| {
            let topic = shortened(channel.topic.clone());
            format!("message {} of {topic}: {problem}; {}", message.sequence, problem.remedy())
        };
        let known = if schema.starts_with("foxglove.") {
            let read: CameraCalibration = decode(&channel.encoding, schema, data)?;
            let lens = read.lens().map_err(why);
            Calibrated { frame: read.frame_id, raw: lens.clone(), rectified: lens }
        } else {
            let of = |is_rectified| ros::calibration(&channel.encoding, schema, data, is_rectified);
            let frame = ros::frame(&channel.encoding, schema, data)?;
            let [raw, rectified] =
                [false, true].map(|is| of(is).map(|(_, lens)| lens).map_err(why));
            Calibrated { frame, raw, rectified }
        };
        let topic = namespace(&channel.topic).to_owned();
        for (map, name) in
            [(&mut self.by_frame, plain(&known.frame).to_owned()), (&mut self.by_topic, topic)]
        {
            let is_new = !map.contains_key(&name);
            if is_new && map.len() < MAX_CAMERAS || !is_new && !is_first {
                map.insert(name, known.clone());
            }
        }
        Ok(())
    }

    /// The calibration of an image: of ROS by its topic, else by its frame.
    pub(super) fn of(&self, channel: &Channel, frame: &str) -> Result<Lens, CaptureProblem> {
        let is_ros =
            channel.schema.as_deref().is_some_and(|schema| !schema.starts_with("foxglove."));
        let topic = base(&channel.topic);
        let beside = is_ros.then(|| self.by_topic.get(namespace(topic))).flatten();
        // Other cameras may have their calibrations beside this one's.
        let same = beside.filter(|known| plain(&known.frame) == plain(frame));
        let known = same.or_else(|| self.by_frame.get(plain(frame))).or(beside);
        let known = known.ok_or_else(|| CaptureProblem::NoCalibration(shortened(frame.into())))?;
        let name = topic.rsplit('/').next().unwrap_or_default();
        let lens = if name.contains("rect") { &known.rectified } else { &known.raw };
        lens.clone().map_err(CaptureProblem::Uncalibrated)
    }

    fn knows(&self, topic: &str, frame: &str) -> bool {
        self.by_topic.contains_key(namespace(base(topic)))
            || self.by_frame.contains_key(plain(frame))
    }
}

/// A topic of clouds or images.
#[derive(Debug)]
struct Views {
    what: What,
    schema: String,
    frame: String,
    /// Whether images are of depths; none until one could be looked at.
    is_depth: Option<bool>,
}

/// What an inertial sensor measured first.
#[derive(Debug)]
struct Accelerations {
    frame: String,
    sum: Vector3<f64>,
    count: u32,
}

/// What is known of a recording.
#[derive(Debug, Default)]
pub(super) struct Survey {
    views: BTreeMap<String, Views>,
    pub(super) clocks: Clocks,
    pub(super) tree: Tree,
    pub(super) cameras: Cameras,
    unread: BTreeSet<String>,
    accelerations: Option<Accelerations>,
    /// Topics that the user named.
    asked: Vec<String>,
}

impl Survey {
    pub(super) fn new(asked: &[String]) -> Self {
        Survey { asked: asked.to_vec(), ..Survey::default() }
    }

    /// Topics that are passed over because their messages are of types that are not read.
    pub(super) fn unread(&self) -> impl Iterator<Item = &str> {
        self.unread.iter().map(String::as_str)
    }

    fn pass_over(&mut self, channel: &Channel) {
        let schema = channel.schema.as_deref().unwrap_or("no type");
        // The list is for people, and memory is bounded.
        if self.unread.len() < MAX_NAMES {
            self.unread.insert(shortened(format!("{} ({schema})", channel.topic)));
        }
    }

    fn is_asked(&self, topic: &str) -> bool {
        let is_same = |asked: &String| {
            let asked = asked.trim_start_matches('/');
            [topic, base(topic)].iter().any(|name| name.trim_start_matches('/') == asked)
        };
        self.asked.iter().any(is_same)
    }

    /// Looks at a cloud or an image; whether it may be read.
    fn view(&mut self, message: &Message, what: What) -> bool {
        let channel = &message.channel;
        let topic = channel.topic.as_str();
        let schema = channel.schema.as_deref().unwrap_or_default();
        let is_full = self.views.len() >= MAX_TOPICS && !self.views.contains_key(topic);
        if !is_full && self.views.get(topic).is_none_or(|known| known.is_depth.is_none()) {
            let (frame, is_depth) = first_look(message, what, self.is_asked(topic));
            let views = Views { what, schema: schema.into(), frame, is_depth };
            self.views.insert(topic.to_owned(), views);
        }
        let is_read = self.views.get(topic).is_some_and(|known| known.is_depth != Some(false));
        if !is_read {
            self.pass_over(channel);
            return false;
        }
        if let Ok(Some(stamp)) = stamp(&channel.encoding, schema, message.data()) {
            self.clocks.learn(topic, stamp, message.log_time.into(), false);
        }
        true
    }

    /// Keeps transforms: all of them, or the first of each frame, which holds before its time too.
    pub(super) fn transforms(
        &mut self,
        message: &Message,
        is_first: bool,
        before: Option<i128>,
    ) -> Result<(), CaptureProblem> {
        let channel = &message.channel;
        let schema = channel.schema.as_deref().unwrap_or_default();
        let found = transforms(&channel.encoding, schema, message.data())?;
        let is_static = channel.topic.ends_with("tf_static");
        let log = i128::from(message.log_time);
        for found in found.into_iter().flatten() {
            let Some(child) = found.child else { continue };
            let stamp = found.time.filter(|stamp| *stamp != 0);
            if let Some(stamp) = stamp.filter(|_| !is_static) {
                self.clocks.learn(&channel.topic, stamp, log, true);
            }
            if is_first && self.tree.has(&child) {
                continue;
            }
            let time = stamp.unwrap_or_else(|| self.clocks.logged(log));
            self.tree.add(&child, &found.parent, (!is_static).then_some(time), found.pose)?;
            if let Some(before) = before {
                self.tree.forget(&child, before);
            }
        }
        Ok(())
    }

    /// Takes a message that says how to read others.
    pub(super) fn calibration(&mut self, message: &Message) -> Result<(), CaptureProblem> {
        self.cameras.keep(message, false)
    }

    fn acceleration(&mut self, message: &Message) {
        let channel = &message.channel;
        let schema = channel.schema.as_deref().unwrap_or_default();
        let Ok((frame, [x, y, z])) = ros::acceleration(&channel.encoding, schema, message.data())
        else {
            return;
        };
        let known = self.accelerations.get_or_insert_with(|| Accelerations {
            frame: frame.clone(),
            sum: Vector3::zeros(),
            count: 0,
        });
        let measured = Vector3::new(x, y, z);
        if known.frame == frame
            && known.count < ACCELERATIONS
            && measured.iter().all(|v| v.is_finite())
        {
            known.sum += measured;
            known.count += 1;
        }
    }

    /// The way up in the world by an inertial sensor, which measured for a while from the beginning on; of length 1.
    pub(super) fn up(&self) -> Option<Vector3<f32>> {
        let known = self.accelerations.as_ref()?;
        // Before its time, the first transform holds.
        let place = self.tree.place(&known.frame, i128::MIN);
        if place.is_none() && !self.tree.is_empty() && !self.tree.knows(&known.frame) {
            return None;
        }
        let up = place.map_or(known.sum, |place| place.pose.rotation * known.sum);
        up.try_normalize(1e-6).map(|up| up.cast())
    }

    /// The topics that are read.
    pub(super) fn choose(&self, notes: &mut Notes) -> Result<BTreeSet<String>, CaptureProblem> {
        let mut chosen: BTreeSet<&str> = BTreeSet::new();
        let of = |is_wanted: &dyn Fn(&Views) -> bool| -> Vec<(&str, &Views)> {
            let all = self.views.iter().filter(|(_, views)| is_wanted(views));
            all.map(|(topic, views)| (topic.as_str(), views)).collect()
        };
        let readable = of(&|views| views.is_depth != Some(false));
        if !self.asked.is_empty() {
            chosen.extend(
                readable.iter().map(|(topic, _)| *topic).filter(|topic| self.is_asked(topic)),
            );
            if let Some(asked) =
                self.asked.iter().find(|asked| !chosen.iter().any(|topic| same(asked, topic)))
            {
                let all = readable.iter().map(|(topic, _)| *topic).collect::<Vec<_>>().join(", ");
                let all = if all.is_empty() { "none".into() } else { shortened(all) };
                return Err(CaptureProblem::NoTopic { asked: shortened(asked.clone()), all });
            }
            return Ok(chosen.into_iter().map(str::to_owned).collect());
        }
        let clouds = of(&|views| views.what == What::Cloud);
        let images = of(&|views| views.what != What::Cloud && views.is_depth != Some(false));
        let with_camera: Vec<_> = images
            .iter()
            .copied()
            .filter(|(topic, views)| self.cameras.knows(topic, &views.frame))
            .collect();
        match (with_camera.is_empty(), clouds.is_empty()) {
            (false, _) => chosen.extend(best_of_each(&with_camera)),
            (true, false) => {
                chosen.extend(clouds.iter().map(|(topic, _)| *topic));
                several(&clouds, notes);
            }
            (true, true) => chosen.extend(best_of_each(&images)),
        }
        for (topic, views) in &readable {
            if !chosen.contains(topic) {
                notes.add(Note::Unused(shortened(format!("{topic} ({})", views.schema))));
            }
        }
        Ok(chosen.into_iter().map(str::to_owned).collect())
    }

    /// Whether a message of a stream, whose later topics nobody knows, is read.
    pub(super) fn takes(&self, topic: &str) -> bool {
        if !self.asked.is_empty() {
            return self.is_asked(topic);
        }
        let has_depth = self
            .views
            .values()
            .any(|views| views.what != What::Cloud && views.is_depth == Some(true));
        self.views.get(topic).is_some_and(|views| (views.what == What::Cloud) != has_depth)
    }
}

fn same(asked: &str, topic: &str) -> bool {
    let plain = |name: &str| name.trim_start_matches('/').to_owned();
    plain(asked) == plain(topic) || plain(asked) == plain(base(topic))
}

/// Frame of a message, and whether it shows depths; a cloud always does.
fn first_look(message: &Message, what: What, is_asked: bool) -> (String, Option<bool>) {
    let channel = &message.channel;
    let (encoding, data) = (channel.encoding.as_str(), message.data());
    let schema = channel.schema.as_deref().unwrap_or_default();
    let is_foxglove = schema.starts_with("foxglove.");
    if what == What::Cloud {
        let frame = match is_foxglove {
            true => decode::<Framed>(encoding, schema, data).map(|read| read.frame_id),
            false => ros::frame(encoding, schema, data),
        };
        return (frame.unwrap_or_default(), Some(true));
    }
    let read = match is_foxglove {
        true => {
            decode::<ImageKind>(encoding, schema, data).map(|read| (read.frame_id, read.encoding))
        }
        false => ros::image_kind(encoding, schema, data),
    };
    match read {
        Ok((frame, pixels)) => {
            let topic = if is_asked { "" } else { channel.topic.as_str() };
            (frame, Some(ros::is_depth(&pixels, topic)))
        }
        Err(_) => (String::new(), None),
    }
}

/// One topic of each camera: those of one device, and those that are packed in several ways, show the same.
fn best_of_each<'t>(images: &[(&'t str, &Views)]) -> Vec<&'t str> {
    let mut best: BTreeMap<&str, &str> = BTreeMap::new();
    for (topic, _) in images {
        let own = best.entry(device(topic)).or_insert(topic);
        if worth(topic) < worth(own) {
            *own = topic;
        }
    }
    best.into_values().collect()
}

/// The part of a topic that all images of one device share: `/camera` of `/camera/depth/image_raw`.
fn device(topic: &str) -> &str {
    let (own, before) = (base(topic), namespace(base(topic)));
    let last = own.rsplit('/').next().unwrap_or_default();
    match before.rsplit('/').next() {
        Some(part) if part.contains("depth") => namespace(before),
        _ if last.starts_with("image") => before,
        // What is no image of something is a device of its own.
        _ => own,
    }
}

/// Order of the images of a device: the camera's own before those that were made to fit another, rectified ones first, packed ones last.
fn worth(topic: &str) -> (bool, bool, bool, &str) {
    let is_made = ["aligned", "registered", "_to_"].iter().any(|word| topic.contains(word));
    (is_made, base(topic) != topic, !topic.contains("rect"), topic)
}

/// Says where clouds of one frame come on several topics.
fn several(clouds: &[(&str, &Views)], notes: &mut Notes) {
    let mut by_frame: BTreeMap<&str, Vec<&str>> = BTreeMap::new();
    for (topic, views) in clouds {
        by_frame.entry(plain(&views.frame)).or_default().push(topic);
    }
    for topics in by_frame.values().filter(|topics| topics.len() > 1) {
        notes.add(Note::SeveralTopics(shortened(topics.join(", "))));
    }
}

impl Look for Survey {
    fn look(
        &mut self,
        path: &Path,
        message: &Message,
        _notes: &mut Notes,
    ) -> Result<bool, CaptureError> {
        match what(&message.channel) {
            what @ (What::Cloud | What::Image | What::Packed) => {
                return Ok(self.view(message, what));
            }
            What::Calibration => {
                // What is wrong here is told when it is read again, in its place.
                let _ = self.cameras.keep(message, true);
            }
            What::Transform => {
                let kept = self.transforms(message, true, None);
                if let Err(problem @ CaptureProblem::TooManyFrames) = kept {
                    return Err(at(path, message, problem));
                }
            }
            What::Acceleration => {
                self.acceleration(message);
                self.pass_over(&message.channel);
                return Ok(false);
            }
            What::Other => {
                self.pass_over(&message.channel);
                return Ok(false);
            }
        }
        Ok(true)
    }
}
