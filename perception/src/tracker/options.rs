//! Options, reports and errors of a tracker.

use nalgebra::{Isometry3, Vector3};
use rigidformer_core::{Physics, Plane};
use rigidformer_runtime::models::LoadedModel;

use crate::forecast::ForecastError;
use crate::known::KnownObject;
use crate::sampling::Segmentation;
use crate::shape::Completion;

/// Options of a tracker.
///
/// ```
/// use rigidformer_perception::tracker::{Segmentation, TrackerOptions};
/// let mut options = TrackerOptions::default();
/// options.segmentation = Segmentation::Given;
/// assert!(options.model.is_none() && options.confirm == 2);
/// ```
#[derive(Clone)]
#[non_exhaustive]
pub struct TrackerOptions {
    /// The motion model. Without one, units fly or lie, whichever fits better.
    pub model: Option<LoadedModel>,
    /// Whether the model's network corrects its motion. Without it impulses alone predict.
    pub network: bool,
    /// What separates bodies.
    pub segmentation: Segmentation,
    /// The scene's planes, at most 8; `None`: up to four are found.
    pub planes: Option<Vec<Plane>>,
    /// Friction and restitution of planes that are found.
    pub plane_physics: [f32; 2],
    /// Assumed density of units: mass over the volume of the hull. Only ratios of masses matter, between units that collide.
    pub density_kg_m3: f32,
    /// Assumed friction and restitution of units.
    pub unit_physics: [f32; 2],
    /// Acceleration of free fall, m/s^2.
    pub gravity_m_s2: Vector3<f32>,
    /// How the hidden sides of a unit are completed.
    pub completion: Completion,
    /// Points of a unit that the model gets, at most: 8 to 256.
    pub model_points: usize,
    /// Captures that show a unit before it is reported, at least 1.
    pub confirm: u32,
    /// Consecutive captures that may miss a unit before its track ends.
    pub missed: u32,
    /// Seconds that a unit may be hidden before its track ends.
    pub hidden_s: f64,
    /// Clusters of a capture, at most. The report says how many are left out.
    pub clusters: usize,
    /// Units that are tracked, at most.
    pub units: usize,
    /// Least and largest diameter of a unit, metres: larger clusters are scenery, and smaller ones noise.
    pub extents_m: [f32; 2],
    /// Standard deviation of a new unit's velocity, m/s, and spin, rad/s.
    pub first_velocity: [f32; 2],
    /// Seed of RANSAC's draws.
    pub seed: u64,
    /// Bodies whose shape is known, at most 64. Each is one body: two alike are there twice. The frame of its unit is that of its mesh.
    pub objects: Vec<KnownObject>,
}

impl Default for TrackerOptions {
    fn default() -> Self {
        TrackerOptions {
            model: None,
            network: true,
            segmentation: Segmentation::Found,
            planes: None,
            plane_physics: [0.5, 0.4],
            density_kg_m3: 1000.0,
            unit_physics: [0.5, 0.4],
            gravity_m_s2: Vector3::new(0.0, 0.0, -9.81),
            completion: Completion::Fitted,
            model_points: 96,
            confirm: 2,
            missed: 5,
            hidden_s: 3.0,
            clusters: 128,
            units: 64,
            extents_m: [0.01, 5.0],
            first_velocity: [2.0, 4.0],
            seed: 1,
            objects: Vec::new(),
        }
    }
}

impl TrackerOptions {
    /// Assumed physics of a unit of this volume.
    pub fn physics_of(&self, volume_m3: f32) -> Physics {
        let [friction, restitution] = self.unit_physics;
        let mass_kg = (self.density_kg_m3 * volume_m3).clamp(1e-6, 1e6);
        Physics { mass_kg, friction, restitution }
    }
}

/// Why a capture or options are refused. The tracker is unchanged.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum TrackError {
    /// An option out of range.
    #[error("options: {what}")]
    Options {
        /// Which, and its range.
        what: &'static str,
    },
    /// A capture that is not later than the one before.
    #[error(
        "a capture at {time_s} s after one at {before_s} s: give captures in the order of their times, each time once"
    )]
    Order {
        /// Its time.
        time_s: f64,
        /// Of the capture before.
        before_s: f64,
    },
    /// A time that is no number.
    #[error("a capture's time is not finite: give seconds since any instant")]
    Time,
    /// The system lets this process have no threads.
    #[error(
        "the system gives this process no threads: raise the limit of processes (ulimit -u, or the container's pids) or of memory"
    )]
    Threads,
    /// A capture of no sensor.
    #[error("the capture at {time_s} s has no views: leave it out")]
    Empty {
        /// Its time.
        time_s: f64,
    },
    /// A point that is no point.
    #[error("point {point} of view {view} is not finite or beyond 1e6 m: drop it")]
    Point {
        /// The view.
        view: usize,
        /// Its point.
        point: usize,
    },
    /// Views that take more memory than a capture may, with what the tracker makes of them.
    #[error(
        "the views of the capture at {time_s} s take {needed} bytes of memory with what is made of them, and may take {most}: give smaller or fewer images, or allow more with --memory, such as --memory 4G (memory::set_limit)"
    )]
    Memory {
        /// Its time.
        time_s: f64,
        /// Bytes that were counted.
        needed: u64,
        /// Bytes that there may be.
        most: u64,
    },
    /// An image or labels of another size than they should have.
    #[error(
        "view {view}: {given} depths or labels where {expected} are expected; image, labels and camera must be of one size"
    )]
    Size {
        /// The view.
        view: usize,
        /// As many as there should be.
        expected: usize,
        /// As many as there are.
        given: usize,
    },
    /// A depth scale that is not in [`SCALES_M`](crate::capture::SCALES_M).
    #[error(
        "view {view}: a depth scale of {scale_m:e} m; give metres a step, from 1e-6 to 10, such as 0.001"
    )]
    Scale {
        /// The view.
        view: usize,
        /// As given.
        scale_m: f32,
    },
}

/// Report of a capture.
#[derive(Clone, Debug, Default, PartialEq)]
#[non_exhaustive]
pub struct Report {
    /// Clusters that were used.
    pub clusters: usize,
    /// Clusters that were left out because there were too many.
    pub clusters_left_out: usize,
    /// Clusters too large or too small to be units.
    pub clusters_of_other_sizes: usize,
    /// Samples of all clusters.
    pub samples: usize,
    /// Share of each depth image's pixels that had a depth; 1 for clouds.
    pub measured: Vec<f32>,
    /// Units that the capture shows, with unconfirmed ones.
    pub seen: usize,
    /// Numbers of units that this capture confirms.
    pub appeared: Vec<u32>,
    /// Numbers of units whose tracks end.
    pub given_up: Vec<u32>,
    /// Why the model predicted nothing; free motion stood in for it.
    pub forecast: Option<ForecastError>,
}

impl Report {
    /// Whether a view measures too little: below a hundredth of its pixels have a depth.
    pub fn is_blind(&self) -> bool {
        self.measured.iter().any(|share| *share < 0.01)
    }
}

/// Predicted poses of units.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Forecast {
    /// Seconds between samples.
    pub step_s: f64,
    /// (samples) Each unit's number and the pose of its reference points; the first sample is a step after the last capture.
    pub poses: Vec<Vec<(u32, Isometry3<f32>)>>,
    /// Units without a prediction, and why.
    pub left_out: Vec<(u32, LeftOut)>,
}

/// Why a unit has no prediction.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[non_exhaustive]
pub enum LeftOut {
    /// A model needs four points of a unit.
    #[error("fewer than 4 of its points have been seen")]
    TooFewPoints,
    /// Its pose is unknown.
    #[error("it was not seen for so long that its place is not known to within its own size")]
    Lost,
    /// Its velocity is unknown.
    #[error(
        "its velocity is not known well enough to say where it is in a fifth of a second, to within half its radius"
    )]
    Uncertain,
}
