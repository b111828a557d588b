//! Reads recordings of sensors, one capture at a time, and writes depth recordings.
//!
//! [`open`] takes
//!
//! - a folder of 16-bit depth images with `frames.json`,
//! - a folder of PLY or PCD clouds with `frames.json`, or with a rate that the caller gives ([`open_at`]),
//! - a single PLY or PCD cloud,
//! - an MCAP file with depth images or clouds.
//!
//! [`poses`] reads the poses of an MCAP file.
//!
//! `docs/SENSORS.md` specifies the formats. Opening a recording checks everything but images and clouds. Those are read with their capture,
//! so memory does not grow with the length of a recording. An unreadable capture is an error, and the next one can be read all the same.
//!
//! This module is behind the feature `captures`.

mod clouds;
mod depth;
mod error;
mod image;
mod limited;
mod manifest;
mod mcap;
mod messages;
mod numbers;
mod pcd;
mod ply;
mod points;
mod poses;
mod records;
mod write;

use std::path::Path;

use nalgebra::Vector3;

use super::capture::Capture;
use clouds::CloudCaptures;
use depth::DepthCaptures;
use manifest::{KnownCloud, Manifest};
use mcap::McapCaptures;

pub use error::{CaptureError, CaptureProblem};
pub use poses::{FramePose, poses};
pub use write::Recorder;

/// First bytes of an MCAP file; a digit and more magic follow.
const MCAP: &[u8] = b"\x89MCAP";

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
    opened(path, None)
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
    // Captures are at least a millisecond apart, or they are one.
    if !(0.001..=1000.0).contains(&rate_hz) {
        return Err(CaptureError::of(path, CaptureProblem::Rate(rate_hz)));
    }
    opened(path, Some(rate_hz))
}

fn opened(path: &Path, rate_hz: Option<f64>) -> Result<Captures, CaptureError> {
    let fail = |problem| Err(CaptureError::of(path, problem));
    let metadata = std::fs::metadata(path)
        .map_err(|error| CaptureError::of(path, CaptureProblem::Unreadable(error)))?;
    if !metadata.is_dir() {
        if limited::begins_with(path, MCAP)? {
            let source = Source::Mcap(Box::new(McapCaptures::open(path)?));
            return Ok(Captures { source, gravity_m_s2: None });
        }
        if !clouds::is_cloud(path) {
            return fail(CaptureProblem::NoRecording("it is a file of another kind"));
        }
        let cloud = KnownCloud { time_s: 0.0, path: path.into(), sensor: None };
        return Captures::of_clouds(vec![cloud], None);
    }
    if path.join(manifest::NAME).exists() {
        return match manifest::read(path)? {
            Manifest::Depth { cameras, frames, gravity } => {
                let source = Source::Depth(DepthCaptures::new(cameras, frames)?);
                Ok(Captures { source, gravity_m_s2: gravity })
            }
            Manifest::Clouds { clouds, gravity } => Captures::of_clouds(clouds, gravity),
        };
    }
    if clouds::names(path)?.is_empty() {
        let what = "the folder has neither frames.json nor PLY or PCD files";
        return fail(CaptureProblem::NoRecording(what));
    }
    match rate_hz {
        Some(rate_hz) => Captures::of_clouds(clouds::by_name(path, rate_hz)?, None),
        None => fail(CaptureProblem::NoRate),
    }
}

impl Captures {
    fn of_clouds(
        clouds: Vec<KnownCloud>,
        gravity_m_s2: Option<Vector3<f32>>,
    ) -> Result<Self, CaptureError> {
        Ok(Captures { source: Source::Clouds(CloudCaptures::new(clouds)?), gravity_m_s2 })
    }

    /// Gravity in the recording's world, m/s^2, where it says so.
    pub fn gravity_m_s2(&self) -> Option<Vector3<f32>> {
        self.gravity_m_s2
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
mod tests;
