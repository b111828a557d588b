//! Reads recordings of sensors, one capture at a time, and writes depth recordings.
//!
//! [`open`] takes
//!
//! - a folder of 16-bit depth images with `frames.json`,
//! - a folder of PLY or PCD clouds with `frames.json`, or with a rate that the caller gives ([`open_at`]),
//! - a single PLY or PCD cloud,
//! - an MCAP file, or a folder of them, with depth images or clouds.
//!
//! [`stream`] reads MCAP from a pipe.
//!
//! [`poses`] reads the poses of an MCAP file.
//!
//! `docs/SENSORS.md` specifies the formats. Opening a recording checks everything but images and clouds. Those are read with their capture,
//! so memory does not grow with the length of a recording. An unreadable capture is an error, and the next one can be read all the same.
//!
//! Part of a recording that cannot be used costs itself alone: [`Captures::notes`] tells it.
//!
//! This module is behind the feature `captures`.

mod blocks;
mod cdr;
mod clocks;
mod clouds;
mod depth;
mod error;
mod image;
mod limited;
mod manifest;
mod mcap;
mod messages;
mod names;
mod notes;
mod numbers;
mod options;
mod order;
mod pcd;
mod ply;
mod points;
mod poses;
mod records;
mod ros;
mod straight;
mod topics;
mod tree;
mod write;

use std::io::Read;
use std::path::Path;

use nalgebra::Vector3;

use super::capture::Capture;
use clouds::CloudCaptures;
use depth::DepthCaptures;
use manifest::{KnownCloud, Manifest};
use mcap::McapCaptures;

pub use error::{CaptureError, CaptureProblem};
pub use notes::{Note, Notes};
pub use options::Options;
pub use poses::{FramePose, poses};
pub use write::Recorder;

/// First bytes of an MCAP file; a digit and more magic follow.
const MCAP: &[u8] = b"\x89MCAP";

/// First bytes of the files in which ROS 2 and ROS 1 keep bags beside MCAP.
const SQLITE: &[u8] = b"SQLite format 3\0";
const BAG: &[u8] = b"#ROSBAG V";

/// Captures of a recording, one at a time.
pub struct Captures {
    source: Source,
    gravity_m_s2: Option<Vector3<f32>>,
}

enum Source {
    Depth(DepthCaptures),
    Clouds(CloudCaptures),
    Mcap(Box<McapCaptures>),
}

/// Opens a recording whose times are known.
///
/// # Errors
/// [`CaptureError`] names the file, the place in it and the remedy.
///
/// ```
/// use rigidformer_perception::capture::View;
/// use rigidformer_perception::recording;
///
/// let folder = tempfile::tempdir()?;
/// let path = folder.path().join("cloud.ply");
/// let header = "ply\nformat ascii 1.0\nelement vertex 2\n";
/// let properties = "property float x\nproperty float y\nproperty float z\nend_header\n";
/// std::fs::write(&path, format!("{header}{properties}0 0 1\n0 0.5 1\n"))?;
///
/// let mut captures = recording::open(&path)?;
/// let capture = captures.next().ok_or("nothing")??;
/// let [View::Cloud(cloud)] = capture.views.as_slice() else { return Err("no cloud".into()) };
/// assert_eq!((capture.time_s, cloud.points.len()), (0.0, 2));
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
pub fn open(path: &Path) -> Result<Captures, CaptureError> {
    open_with(path, &Options::default())
}

/// Labels of an image, 0 for no body: PNG of grey of 1 to 16 bits or with a palette, of this width and height. (height * width)
///
/// # Errors
/// [`CaptureError`] where there is no such image, or one of another size or kind.
pub fn read_labels(path: &Path, size: [u32; 2]) -> Result<Vec<u16>, CaptureError> {
    image::read_labels(path, size)
}

/// Opens a recording; a folder of clouds without `frames.json` has so many a second, from 0 s on in the order of their names. Others
/// have times of their own, and no use for the rate.
///
/// # Errors
/// Those of [`open`], and [`CaptureProblem::Rate`] for a rate that is not from 0.001 to 1000.
///
/// ```
/// use rigidformer_perception::recording;
/// # let folder = tempfile::tempdir()?;
/// # let header = "ply\nformat ascii 1.0\nelement vertex 0\n";
/// # let properties = "property float x\nproperty float y\nproperty float z\nend_header\n";
/// for name in ["b.ply", "a.ply", "c.ply"] {
///     std::fs::write(folder.path().join(name), format!("{header}{properties}"))?;
/// }
/// assert!(recording::open(folder.path()).is_err_and(|error| error.to_string().contains("a second")));
/// let captures = recording::open_at(folder.path(), 10.0)?;
/// let times: Result<Vec<_>, _> = captures.map(|capture| capture.map(|capture| capture.time_s)).collect();
/// assert_eq!(times?, [0.0, 0.1, 0.2]);
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
pub fn open_at(path: &Path, rate_hz: f64) -> Result<Captures, CaptureError> {
    open_with(path, &Options { rate_hz: Some(rate_hz), ..Options::default() })
}

/// Reads an MCAP stream as it comes, such as that of a pipe. A view waits for others that are older until a message is there that was
/// logged .1 s later; static transforms and calibrations hold from their message on.
///
/// # Errors
/// [`CaptureError`] where its first bytes are not those of MCAP, and those of [`open_with`] for options.
pub fn stream(
    from: impl Read + Send + 'static,
    options: &Options,
) -> Result<Captures, CaptureError> {
    options.check(Path::new("-"))?;
    let source = Source::Mcap(Box::new(McapCaptures::stream(from, options)?));
    Ok(Captures { source, gravity_m_s2: None })
}

/// Opens a recording, with what it does not say itself.
///
/// # Errors
/// Those of [`open_at`], and [`CaptureProblem::Latency`] for a latency that is beyond 10 s.
pub fn open_with(path: &Path, options: &Options) -> Result<Captures, CaptureError> {
    options.check(path)?;
    opened(path, options)
}

fn opened(path: &Path, options: &Options) -> Result<Captures, CaptureError> {
    let fail = |problem| Err(CaptureError::of(path, problem));
    let metadata = std::fs::metadata(path)
        .map_err(|error| CaptureError::of(path, CaptureProblem::Unreadable(error)))?;
    if !metadata.is_dir() {
        if limited::begins_with(path, MCAP)? {
            let source = Source::Mcap(Box::new(McapCaptures::open(&[path.into()], options)?));
            return Ok(Captures { source, gravity_m_s2: None });
        }
        not_another_bag(path)?;
        if !clouds::is_cloud(path) {
            return fail(CaptureProblem::NoRecording("it is a file of another kind"));
        }
        let cloud = KnownCloud { time_s: 0.0, path: path.into(), sensor: None };
        return Captures::of_clouds(vec![cloud], None, Notes::default());
    }
    if path.join(manifest::NAME).exists() {
        return match manifest::read(path)? {
            Manifest::Depth { cameras, frames, gravity } => {
                let source = Source::Depth(DepthCaptures::new(cameras, frames)?);
                Ok(Captures { source, gravity_m_s2: gravity })
            }
            Manifest::Clouds { clouds, gravity } => {
                Captures::of_clouds(clouds, gravity, Notes::default())
            }
        };
    }
    let mut notes = Notes::default();
    if clouds::names(path, &mut Notes::default())?.is_empty() {
        return bag(path, options);
    }
    let clouds = clouds::by_name(path, options.rate_hz, &mut notes)?;
    Captures::of_clouds(clouds, None, notes)
}

/// A folder of MCAP files, which rosbag2 writes one after another.
fn bag(folder: &Path, options: &Options) -> Result<Captures, CaptureError> {
    let parts = clouds::files(folder, &mut Notes::default(), |path| clouds::has_end(path, "mcap"))?;
    if !parts.is_empty() {
        let source = Source::Mcap(Box::new(McapCaptures::open(&parts, options)?));
        return Ok(Captures { source, gravity_m_s2: None });
    }
    let others = clouds::files(folder, &mut Notes::default(), |path| {
        clouds::has_end(path, "db3") || clouds::has_end(path, "bag")
    })?;
    for other in others {
        not_another_bag(&other)?;
    }
    let what = "the folder has neither frames.json nor PLY, PCD or MCAP files";
    Err(CaptureError::of(folder, CaptureProblem::NoRecording(what)))
}

/// Says what is in a bag of ROS that is not read.
fn not_another_bag(path: &Path) -> Result<(), CaptureError> {
    for (first, what) in [(SQLITE, "a bag of ROS 2 in SQLite"), (BAG, "a bag of ROS 1")] {
        if limited::begins_with(path, first)? {
            return Err(CaptureError::of(path, CaptureProblem::OtherBag(what)));
        }
    }
    Ok(())
}

impl Captures {
    fn of_clouds(
        clouds: Vec<KnownCloud>,
        gravity_m_s2: Option<Vector3<f32>>,
        notes: Notes,
    ) -> Result<Self, CaptureError> {
        Ok(Captures { source: Source::Clouds(CloudCaptures::new(clouds, notes)?), gravity_m_s2 })
    }

    /// What is to be said about the recording so far: what was left out, or read otherwise than it says. A capture of which nothing is
    /// left is an error of the iterator and not in here.
    pub fn notes(&self) -> &Notes {
        match &self.source {
            Source::Depth(captures) => captures.notes(),
            Source::Clouds(captures) => captures.notes(),
            Source::Mcap(captures) => captures.notes(),
        }
    }

    /// Gravity in the recording's world, m/s^2, where it says so.
    pub fn gravity_m_s2(&self) -> Option<Vector3<f32>> {
        self.gravity_m_s2
    }

    /// The way up in the recording's world by an inertial sensor (`sensor_msgs/Imu`) that rested at the beginning; of length 1. None
    /// without one, and where no transform leads from its frame to the world.
    pub fn measured_up(&self) -> Option<Vector3<f32>> {
        match &self.source {
            Source::Mcap(captures) => captures.up(),
            Source::Depth(_) | Source::Clouds(_) => None,
        }
    }

    /// Leaves out the labels of depth recordings, whose files are then neither read nor checked.
    #[must_use]
    pub fn without_labels(mut self) -> Self {
        if let Source::Depth(captures) = &mut self.source {
            captures.ignore_labels();
        }
        self
    }

    /// How many captures are still to come, where that is known before they are read.
    pub fn count_left(&self) -> Option<usize> {
        match &self.source {
            Source::Depth(captures) => Some(captures.left()),
            Source::Clouds(captures) => Some(captures.left()),
            Source::Mcap(_) => None,
        }
    }

    /// Topics that have been passed over so far because their messages are of types that are not read, such as `/odom
    /// (nav_msgs/msg/Odometry)`; at most 32. Files of other kinds have none.
    pub fn unread(&self) -> Vec<&str> {
        match &self.source {
            Source::Depth(_) | Source::Clouds(_) => Vec::new(),
            Source::Mcap(captures) => captures.unread().collect(),
        }
    }
}

impl Iterator for Captures {
    type Item = Result<Capture, CaptureError>;

    fn next(&mut self) -> Option<Self::Item> {
        match &mut self.source {
            Source::Depth(captures) => captures.next(),
            Source::Clouds(captures) => captures.next(),
            Source::Mcap(captures) => captures.next(),
        }
    }

    fn size_hint(&self) -> (usize, Option<usize>) {
        let left = self.count_left();
        (left.unwrap_or(0), left)
    }
}

#[cfg(test)]
mod label_tests;
#[cfg(test)]
mod tests;
