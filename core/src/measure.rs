//! What a scene is measured in: SI units, or its own length, mass and time (docs/MODEL.md, section 1).

use crate::geometry::{Pose, norm};
use crate::math;
use nalgebra::Vector3;
use rigidformer_weights::ModelConfig;

/// What stands for a metre and for a kilogram in a scene. For models that are told lengths in those of the scene, metres
/// and kilograms in all that a scene holds are multiples of these, and seconds those of its [`Pace`].
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Measure {
    length: f32,
    mass: f32,
}

impl Measure {
    /// Metres and kilograms themselves.
    pub(crate) const SI: Measure = Measure { length: 1.0, mass: 1.0 };

    /// Of so many metres and kilograms.
    pub(crate) fn new(length: f32, mass: f32) -> Self {
        Measure { length, mass }
    }

    /// Metres.
    pub(crate) fn length(&self) -> f32 {
        self.length
    }

    /// Kilograms.
    pub(crate) fn mass(&self) -> f32 {
        self.mass
    }

    /// A pose in metres, in this measure.
    pub(crate) fn inward(&self, pose: &Pose) -> Pose {
        Pose { rotation: pose.rotation, centre: pose.centre / self.length() }
    }

    /// A pose in this measure, in metres.
    pub(crate) fn outward(&self, pose: &Pose) -> Pose {
        Pose { rotation: pose.rotation, centre: pose.centre * self.length() }
    }
}

/// Whether a model is told lengths in those of the scene.
pub(crate) fn is_similar(config: &ModelConfig) -> bool {
    config.similarity.length_m > 0.0
}

/// How fast time goes in a scene.
#[derive(Clone, Copy)]
pub(crate) struct Pace {
    /// Seconds that count as one.
    pub(crate) time: f32,
    /// What gravity is multiplied by.
    pub(crate) gravity_factor: f32,
}

impl Pace {
    /// In a scene of a measure, under a gravity in m/s^2.
    pub(crate) fn new(config: &ModelConfig, measure: &Measure, gravity: &Vector3<f32>) -> Self {
        if !is_similar(config) {
            return Pace { time: 1.0, gravity_factor: 1.0 };
        }
        let own = norm(&Vector3::from(config.gravity_m_s2));
        let here = norm(gravity);
        let gravity_factor = if own > 0.0 && here > 0.0 { own / here } else { 1.0 };
        Pace { time: math::sqrt(measure.length() * gravity_factor), gravity_factor }
    }
}
