//! Settings and errors of an identification.

use rigidformer_core::MAX_PLANES;
use rigidformer_runtime::futures::BatchError;
use rigidformer_runtime::kernels::KernelError;

/// Noise of an observed pose.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PoseNoise {
    /// Standard deviation of each coordinate, metres, from 0.
    pub position_m: f32,
    /// Standard deviation of the rotation about each axis, radians, from 0.
    pub rotation_rad: f32,
}

impl PoseNoise {
    pub(crate) fn is_sound(&self) -> bool {
        [self.position_m, self.rotation_rad].iter().all(|sd| sd.is_finite() && *sd >= 0.0)
    }
}

/// Prior distributions of the parameters.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Prior {
    /// Friction of a unit with a plane, the product of both coefficients, is uniform from 0 to this.
    pub friction_most: f32,
    /// Restitution of a unit with a plane, the product of both coefficients, is uniform from 0 to this.
    pub restitution_most: f32,
    /// A mass is within this factor of the given one in about half of the cases; above 1.
    pub mass_factor: f32,
}

impl Default for Prior {
    fn default() -> Self {
        Prior { friction_most: 1.2, restitution_most: 1.0, mass_factor: 3.0 }
    }
}

/// Errors of the model, as standard deviations of the parameters that would compensate for them.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ModelError {
    /// Relative, of friction in each window.
    pub friction: f32,
    /// Relative, of friction in each window with an impact.
    pub friction_at_impacts: f32,
    /// Relative, of friction in each window without an impact, for units with impacts in other windows: the friction of sliding differs from
    /// that of impacts.
    pub friction_of_hits: f32,
    /// Of restitution in each window.
    pub restitution: f32,
    /// Of the logarithm of a mass in each window.
    pub mass: f32,
    /// Relative, of friction in all windows alike.
    pub shared_friction: f32,
    /// The same for units with impacts.
    pub shared_friction_of_hits: f32,
    /// Of restitution in all windows alike.
    pub shared_restitution: f32,
    /// The same for units with impacts of a corner or an edge.
    pub shared_restitution_at_corners: f32,
    /// Of the logarithm of a mass ratio in all windows alike.
    pub shared_mass: f32,
}

impl ModelError {
    /// No error: the model made the motion.
    pub const NONE: ModelError = ModelError {
        friction: 0.0,
        friction_at_impacts: 0.0,
        friction_of_hits: 0.0,
        restitution: 0.0,
        mass: 0.0,
        shared_friction: 0.0,
        shared_friction_of_hits: 0.0,
        shared_restitution: 0.0,
        shared_restitution_at_corners: 0.0,
        shared_mass: 0.0,
    };
}

impl Default for ModelError {
    /// Of the committed models against PyBullet (docs/IDENTIFY.md).
    fn default() -> Self {
        ModelError {
            friction: 0.04,
            friction_at_impacts: 0.5,
            friction_of_hits: 0.3,
            restitution: 0.05,
            mass: 0.05,
            shared_friction: 0.045,
            shared_friction_of_hits: 0.1,
            shared_restitution: 0.03,
            shared_restitution_at_corners: 0.08,
            shared_mass: 0.03,
        }
    }
}

/// How parameters are identified.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Settings {
    /// Particles of a round, from 16 to 4096.
    pub particles: usize,
    /// Rounds of predicting all windows with new particles, at most; from 2 to 64. Settled posteriors end earlier.
    pub rounds: usize,
    /// Rounds of an update after each window of a [`Filter`](super::Filter), from 1 to 64.
    pub rounds_online: usize,
    /// Latest windows that are kept: from 1 to 4096. Time and memory of an update are proportional to them.
    pub windows: usize,
    /// Another seed, other particles.
    pub seed: u64,
    /// Seconds a step of the model, about; from 0.002 to 0.05. Steps are whole numbers of frames.
    pub step_s: f32,
    /// Noise of poses that come without; `None`: estimated from them.
    pub noise: Option<PoseNoise>,
    /// Prior distributions.
    pub prior: Prior,
    /// Errors of the model.
    pub model_error: ModelError,
}

impl Default for Settings {
    fn default() -> Self {
        Settings {
            particles: 64,
            rounds: 12,
            rounds_online: 3,
            windows: 256,
            seed: 1,
            step_s: 1.0 / 75.0,
            noise: None,
            prior: Prior::default(),
            model_error: ModelError::default(),
        }
    }
}

impl Settings {
    /// Returns the first setting that is out of range.
    pub(crate) fn check(&self) -> Result<(), IdentifyError> {
        let bad = |what| Err(IdentifyError::Setting { what });
        let is_deviation = |value: f32| (0.0..=10.0).contains(&value);
        let Prior { friction_most, restitution_most, mass_factor } = self.prior;
        let error = self.model_error;
        let errors = [
            error.friction,
            error.friction_at_impacts,
            error.friction_of_hits,
            error.restitution,
            error.mass,
            error.shared_friction,
            error.shared_friction_of_hits,
            error.shared_restitution,
            error.shared_restitution_at_corners,
            error.shared_mass,
        ];
        if !(16..=4096).contains(&self.particles) {
            bad("particles: give 16 to 4096")
        } else if !(2..=64).contains(&self.rounds) || !(1..=64).contains(&self.rounds_online) {
            bad("rounds: give 2 to 64, and 1 to 64 online")
        } else if !(1..=4096).contains(&self.windows) {
            bad("windows: give 1 to 4096")
        } else if !(0.002..=0.05).contains(&self.step_s) {
            bad("step_s: give 0.002 to 0.05 s")
        } else if self.noise.is_some_and(|noise| !noise.is_sound()) {
            bad("noise: give finite deviations from 0")
        } else if !((0.01..=100.0).contains(&friction_most)
            && (0.01..=100.0).contains(&restitution_most))
        {
            bad("prior: give the largest friction and restitution, from 0.01 to 100")
        } else if !(1.01..=1e4).contains(&mass_factor) {
            bad("prior: give a factor of masses from 1.01 to 10,000")
        } else if !errors.into_iter().all(is_deviation) {
            bad("model_error: give deviations from 0 to 10")
        } else {
            Ok(())
        }
    }
}

/// Why nothing can be identified, or why poses are refused.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum IdentifyError {
    /// A setting is out of range.
    #[error("settings: {what}")]
    Setting {
        /// Which one, and its range.
        what: &'static str,
    },
    /// The scene has a property that identification does not support.
    #[error("{scene}: {what}")]
    Scene {
        /// The scene.
        scene: String,
        /// What, and the remedy.
        what: &'static str,
    },
    /// Scenes that are to share their parameters have other units.
    #[error(
        "{scene}: has not the units of {first} (number, shapes, roles); identify scenes of other bodies one by one"
    )]
    OtherUnits {
        /// The scene.
        scene: String,
        /// The one that it is compared with.
        first: String,
    },
    /// Too many planes.
    #[error("{given} planes: a scene may have {MAX_PLANES}")]
    Planes {
        /// As given.
        given: usize,
    },
    /// Gravity that is not finite.
    #[error("gravity has a number that is not finite")]
    Gravity,
    /// An observation has not one pose a unit.
    #[error("{given} poses for {units} units: give one for each, none where a unit was not seen")]
    Poses {
        /// Units of the scene.
        units: usize,
        /// Given.
        given: usize,
    },
    /// A time that is not after the last one.
    #[error(
        "time {time_s} s is not after {last_s} s: give observations in the order of their times"
    )]
    Time {
        /// Given, seconds.
        time_s: f64,
        /// Of the last observation; NaN if there was none.
        last_s: f64,
    },
    /// A pose or its deviations are not finite.
    #[error(
        "pose of unit {unit} has a number that is not finite, or a deviation below 0; leave it out"
    )]
    Pose {
        /// The unit.
        unit: usize,
    },
    /// The caller asked to stop.
    #[error("cancelled")]
    Cancelled,
    /// Windows could not be predicted.
    #[error(transparent)]
    Batch(#[from] BatchError),
    /// The kernels that the environment asks for cannot be used.
    #[error(transparent)]
    Kernel(#[from] KernelError),
}
