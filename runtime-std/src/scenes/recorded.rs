//! One recorded scene, in memory.

use std::fmt;
use std::path::PathBuf;
use std::str::FromStr;

use nalgebra::{Isometry3, Point3, Vector3};
use rigidformer_core::Physics;

use super::{Problem, SceneError};

/// What a scene may be used for.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum Split {
    /// Models learn from it.
    Train,
    /// Training looks at it to choose between models.
    Validation,
    /// Only `evaluate` looks at it.
    Test,
    /// Beyond the published benchmark; models may learn from it.
    Extra,
}

impl Split {
    /// All of them, in the order of their codes in a file.
    pub const ALL: [Split; 4] = [Split::Train, Split::Validation, Split::Test, Split::Extra];

    /// The split of a code in a scene file.
    pub fn from_code(code: u8) -> Option<Split> {
        Split::ALL.get(usize::from(code)).copied()
    }

    /// Its code in a scene file.
    pub fn code(self) -> u8 {
        match self {
            Split::Train => 0,
            Split::Validation => 1,
            Split::Test => 2,
            Split::Extra => 3,
        }
    }
}

impl fmt::Display for Split {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.pad(match self {
            Split::Train => "train",
            Split::Validation => "validation",
            Split::Test => "test",
            Split::Extra => "extra",
        })
    }
}

/// A name that is no split.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("there is no split {0:?}; use train, validation, test or extra")]
pub struct UnknownSplit(pub String);

impl FromStr for Split {
    type Err = UnknownSplit;

    fn from_str(name: &str) -> Result<Split, UnknownSplit> {
        Split::ALL
            .into_iter()
            .find(|split| split.to_string() == name)
            .ok_or_else(|| UnknownSplit(name.into()))
    }
}

/// One rigid body of a scene.
#[derive(Clone, Debug, PartialEq)]
pub struct RecordedUnit {
    /// Name of its shape.
    pub shape: String,
    /// (points) Surface points in the body frame, metres.
    pub points: Vec<Point3<f32>>,
    /// Mass in kg, friction, restitution.
    pub physics: Physics,
    /// (frames) Body frame to world.
    pub poses: Vec<Isometry3<f32>>,
}

/// One scene with its recorded motion: at least one unit, at least one frame, the same frames for all units, all
/// numbers finite.
#[derive(Clone, Debug, PartialEq)]
pub struct RecordedScene {
    name: String,
    seed: i64,
    split: Split,
    frame_rate_hz: f32,
    gravity_m_s2: Vector3<f32>,
    units: Vec<RecordedUnit>,
    frames: usize,
    ground: Option<[f32; 2]>,
}

impl RecordedScene {
    /// A scene from its parts. `name` is what errors and tables call it.
    pub fn new(
        name: impl Into<String>,
        seed: i64,
        split: Split,
        frame_rate_hz: f32,
        gravity_m_s2: Vector3<f32>,
        units: Vec<RecordedUnit>,
    ) -> Result<Self, SceneError> {
        let name = name.into();
        let frames = units.first().map_or(0, |unit| unit.poses.len());
        let problem = if units.is_empty() {
            Some("has no units")
        } else if frames == 0 || units.iter().any(|unit| unit.poses.len() != frames) {
            Some("needs the same number of poses for every unit, at least one")
        } else if !(frame_rate_hz.is_finite()
            && frame_rate_hz > 0.0
            && gravity_m_s2.iter().all(|g| g.is_finite()))
        {
            Some("needs a frame rate above 0 and a finite gravity")
        } else if !units.iter().all(finite_unit) {
            Some(
                "needs finite points and poses, a mass above 0, friction and restitution of at least 0",
            )
        } else {
            None
        };
        if let Some(problem) = problem {
            let problem = Problem::Inconsistent(problem);
            return Err(SceneError { path: PathBuf::from("<memory>"), field: name, problem });
        }
        Ok(Self { name, seed, split, frame_rate_hz, gravity_m_s2, units, frames, ground: None })
    }

    /// The same scene with its ground's friction and restitution known, which a model must then share.
    pub fn with_ground(self, friction: f32, restitution: f32) -> Self {
        Self { ground: Some([friction, restitution]), ..self }
    }

    /// Friction and restitution of the ground, where they are known.
    pub fn ground(&self) -> Option<[f32; 2]> {
        self.ground
    }

    /// What errors and tables call it, such as `movi-a seed 1019`.
    pub fn name(&self) -> &str {
        &self.name
    }

    /// The seed it was generated from.
    pub fn seed(&self) -> i64 {
        self.seed
    }

    /// What it may be used for.
    pub fn split(&self) -> Split {
        self.split
    }

    /// Frames per second of the recording.
    pub fn frame_rate_hz(&self) -> f32 {
        self.frame_rate_hz
    }

    /// Gravity, m/s².
    pub fn gravity_m_s2(&self) -> Vector3<f32> {
        self.gravity_m_s2
    }

    /// Its units, at least one.
    pub fn units(&self) -> &[RecordedUnit] {
        &self.units
    }

    /// Recorded frames, at least one; the last one is this minus 1.
    pub fn frames(&self) -> usize {
        self.frames
    }

    /// Points of all units together.
    pub fn points(&self) -> usize {
        self.units.iter().map(|unit| unit.points.len()).sum()
    }

    /// Recorded pose of a unit at a frame.
    pub fn pose(&self, frame: usize, unit: usize) -> Option<&Isometry3<f32>> {
        self.units.get(unit)?.poses.get(frame)
    }

    /// (units) Recorded poses at a frame, if it was recorded.
    pub fn poses_at(&self, frame: usize) -> Option<Vec<Isometry3<f32>>> {
        self.units.iter().map(|unit| unit.poses.get(frame).copied()).collect()
    }

    /// The same scene with its first `frames` frames only, at least one; unchanged if it has no more.
    pub fn truncated(mut self, frames: usize) -> Self {
        self.frames = self.frames.min(frames.max(1));
        for unit in &mut self.units {
            unit.poses.truncate(self.frames);
        }
        self
    }
}

fn finite_unit(unit: &RecordedUnit) -> bool {
    let Physics { mass_kg, friction, restitution } = unit.physics;
    mass_kg.is_finite()
        && mass_kg > 0.0
        && [friction, restitution].iter().all(|v| v.is_finite() && *v >= 0.0)
        && unit.points.iter().all(|point| point.iter().all(|v| v.is_finite()))
        && unit.poses.iter().all(|pose| {
            pose.translation.vector.iter().all(|v| v.is_finite())
                && pose.rotation.coords.iter().all(|v| v.is_finite())
        })
}
