//! What is scored, and the figures.

use nalgebra::Isometry3;
use rigidformer_perception::capture::{Capture, View};
use serde::Serialize;

/// How many pixels of a capture show each unit.
#[derive(Clone, Debug, PartialEq)]
pub struct Seen {
    /// Of the capture, seconds.
    pub time_s: f64,
    /// (units) Pixels or points of all views together that show the unit.
    pub pixels: Vec<u32>,
}

impl Seen {
    /// Counts a capture's labels, of which 1 is the first unit's; `None` where a view has no labels.
    ///
    /// ```
    /// use nalgebra::Point3;
    /// use rigidformer_perception::capture::{Capture, Cloud, View};
    /// use rigidformer_evaluation::score::Seen;
    /// let labels = Some(vec![0, 2, 2]);
    /// let cloud = Cloud { points: vec![Point3::origin(); 3], sensor: None, labels };
    /// let capture = Capture { time_s: 0.5, views: vec![View::Cloud(cloud)] };
    /// assert_eq!(Seen::of(&capture, 2), Some(Seen { time_s: 0.5, pixels: vec![0, 2] }));
    /// ```
    pub fn of(capture: &Capture, units: usize) -> Option<Seen> {
        let mut pixels = vec![0_u32; units];
        for view in &capture.views {
            let labels = match view {
                View::Depth(view) => view.labels.as_ref()?,
                View::Cloud(cloud) => cloud.labels.as_ref()?,
            };
            for label in labels {
                // 0 is the label of what is no unit.
                let unit = usize::from(*label).checked_sub(1);
                if let Some(count) = unit.and_then(|unit| pixels.get_mut(unit)) {
                    *count += 1;
                }
            }
        }
        Some(Seen { time_s: capture.time_s, pixels })
    }
}

/// Where tracks were predicted to be.
#[derive(Clone, Debug, PartialEq)]
pub struct Prediction {
    /// When it was made: no capture after this time was known, seconds.
    pub made_at_s: f64,
    /// The time that it is for, seconds.
    pub time_s: f64,
    /// Of each track, its number and the pose of its reference frame in the world.
    pub poses: Vec<(u32, Isometry3<f32>)>,
}

/// What counts as found.
///
/// ```
/// use rigidformer_evaluation::score::Settings;
/// let strict = Settings { near: 0.1, ..Settings::default() };
/// assert_eq!(strict.findable_pixels, 100);
/// ```
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Settings {
    /// Pixels that show a unit which is expected to be found, at least 1.
    pub findable_pixels: u32,
    /// How far a track's point may be from the surface of the unit that it is counted to, in parts of the unit's radius: above 0, at
    /// most 1.
    pub near: f32,
}

impl Default for Settings {
    fn default() -> Self {
        Settings { findable_pixels: 100, near: 0.25 }
    }
}

/// Why nothing was scored.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum ScoreError {
    /// Settings out of range.
    #[error("settings: {what}")]
    Settings {
        /// Which, and its range.
        what: &'static str,
    },
    /// Estimates or counts of pixels whose times do not rise.
    #[error(
        "{what} at {time_s} s come after later ones: give them in the order of their times, each time once"
    )]
    Order {
        /// Estimates or pixels.
        what: &'static str,
        /// Of the one at fault.
        time_s: f64,
    },
    /// Estimates of which none lies in the record.
    #[error(
        "no estimate lies within the {duration_s} s of the scene's record: do both count seconds from the same instant?"
    )]
    NoneWithin {
        /// Of the record.
        duration_s: f64,
    },
    /// A pose that is no pose.
    #[error("track {id} at {time_s} s has a pose that is not finite")]
    Pose {
        /// The track.
        id: u32,
        /// The time.
        time_s: f64,
    },
}

/// How well a scene was followed.
#[derive(Clone, Debug, PartialEq, Serialize)]
#[non_exhaustive]
pub struct Score {
    /// Estimates that were scored: those within the record.
    pub captures: usize,
    /// True units: rigid ones.
    pub units: usize,
    /// Pairs of a unit and a capture that shows enough of it.
    pub findable: usize,
    /// Those of them with a track of their own.
    pub found: usize,
    /// `found / findable`, from 0 to 1; none where nothing could be found.
    pub found_share: Option<f64>,
    /// Why pairs were not found, and what was found that should not have been.
    pub losses: Losses,
    /// Errors of tracks that were seen in the capture.
    pub seen: PoseErrors,
    /// Errors of tracks that were not: their poses are predicted by the tracker.
    pub unseen: PoseErrors,
    /// Share of the positions, of seen tracks and unseen ones, whose error is within the 95 % region of the covariance that the track
    /// claims: .95 where claims are right. None without errors.
    pub expected_share: Option<f64>,
    /// By unit, in the order of the scene.
    pub by_unit: Vec<UnitScore>,
    /// By time ahead, rising.
    pub predictions: Vec<PredictionScore>,
}

/// What went wrong. `merged`, `lost` and `swapped` are pairs of a unit and a capture, and sum to `findable - found`.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize)]
#[non_exhaustive]
pub struct Losses {
    /// Pairs in which too little of the unit is visible. They do not count as findable.
    pub unseen: usize,
    /// Another unit's track has some of its points on this one, which has none of its own.
    pub merged: usize,
    /// No track is on it.
    pub lost: usize,
    /// The track on it has been another unit's.
    pub swapped: usize,
    /// Found, but by another track than last time: captures in which that happened. They count as found.
    pub renewed: usize,
    /// Tracks on a unit that has one: pairs of a track and a capture.
    pub split: usize,
    /// Tracks that were seen on no unit: pairs of a track and a capture.
    pub false_tracks: usize,
}

/// A number of errors.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize)]
pub struct Spread {
    /// How many there are; all else is 0 where there are none.
    pub count: usize,
    /// Root of their mean square.
    pub rms: f64,
    /// Half of them are no greater.
    pub median: f64,
    /// 95 of 100 are no greater.
    pub p95: f64,
    /// The greatest.
    pub max: f64,
}

impl Spread {
    /// Of numbers in any order, none of them NaN.
    pub(super) fn of(mut errors: Vec<f64>) -> Spread {
        errors.sort_by(f64::total_cmp);
        let count = errors.len();
        // The smallest error of which so many of a hundred are no greater.
        let percentile = |percent: usize| {
            let rank = (count * percent).div_ceil(100).max(1);
            errors.get(rank - 1).copied().unwrap_or_default()
        };
        let squares = errors.iter().fold(0.0, |sum, error| sum + error * error);
        let rms = (squares / count.max(1) as f64).sqrt();
        Spread { count, rms, median: percentile(50), p95: percentile(95), max: percentile(100) }
    }
}

/// How far poses are from the true ones.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize)]
pub struct PoseErrors {
    /// Distance of the unit's centre from where it truly is, metres.
    pub translation_m: Spread,
    /// Angle of the turn that is left, as far as the unit's shape shows it, degrees: none of balls, the axis' of a body of
    /// revolution.
    pub rotation_deg: Spread,
    /// Mean distance of the unit's points, carried by the error, from its surface, metres. What no eye could see is no error here.
    pub surface_m: Spread,
}

/// How well a unit was followed.
#[derive(Clone, Debug, PartialEq, Serialize)]
#[non_exhaustive]
pub struct UnitScore {
    /// Its number in the scene.
    pub unit: usize,
    /// Its shape's name.
    pub shape: String,
    /// Captures that show enough of it.
    pub findable: usize,
    /// Those of them in which it was found.
    pub found: usize,
    /// Tracks that found it, in the order in which they did.
    pub tracks: Vec<u32>,
    /// Errors where the track was seen.
    pub seen: PoseErrors,
}

/// How far predictions are off, so long after they were made.
#[derive(Clone, Debug, PartialEq, Serialize)]
#[non_exhaustive]
pub struct PredictionScore {
    /// Time ahead, seconds, to the millisecond.
    pub ahead_s: f64,
    /// Pairs of a prediction and a track that are not scored, because the track was never found to be a unit's.
    pub unknown: usize,
    /// Errors.
    pub errors: PoseErrors,
}
