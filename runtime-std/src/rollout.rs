//! From a recorded scene's first frames to predicted poses.

use std::sync::atomic::{AtomicBool, Ordering};

use nalgebra::{Isometry3, Translation3};
use rayon::prelude::*;
use rigidformer_core::{Limits, Model, ObserveError, StepError, Unit};

use crate::engine::{Engine, EngineError, Stepping};
use crate::kernels::KernelError;
use crate::scenes::RecordedScene;

pub use crate::engine::MAX_UNITS;

/// Poses of all units at evenly spaced frames.
#[derive(Clone, Debug, PartialEq)]
pub struct Trajectory {
    first_frame: u32,
    step: u32,
    units: usize,
    /// (samples, units)
    poses: Vec<Isometry3<f32>>,
}

impl Trajectory {
    /// A trajectory that so far has one sample: the poses at `first_frame`. `step` frames lie between samples, at
    /// least 1.
    pub fn new(first_frame: u32, step: u32, poses: Vec<Isometry3<f32>>) -> Self {
        Self { first_frame, step: step.max(1), units: poses.len(), poses }
    }

    /// Adds the next sample. Units that `poses` lacks keep their last pose; those in excess are left out.
    pub fn push(&mut self, poses: impl IntoIterator<Item = Isometry3<f32>>) {
        let start = self.poses.len();
        self.poses.extend(poses.into_iter().take(self.units));
        while self.poses.len() < start + self.units {
            self.poses.push(self.poses[self.poses.len() - self.units]);
        }
    }

    /// Frames between samples.
    pub fn step(&self) -> u32 {
        self.step
    }

    /// Units.
    pub fn units(&self) -> usize {
        self.units
    }

    /// Samples, at least one.
    pub fn samples(&self) -> usize {
        self.poses.len().checked_div(self.units).unwrap_or(0)
    }

    /// First frame.
    pub fn first_frame(&self) -> u32 {
        self.first_frame
    }

    /// Last frame.
    pub fn last_frame(&self) -> u32 {
        let gaps = u32::try_from(self.samples().saturating_sub(1)).unwrap_or(u32::MAX);
        self.first_frame.saturating_add(gaps.saturating_mul(self.step))
    }

    /// Frame and poses, (units), of every sample in turn.
    pub fn iter(&self) -> impl Iterator<Item = (u32, &[Isometry3<f32>])> {
        let frame = |sample: u32| self.first_frame.saturating_add(sample.saturating_mul(self.step));
        (0..).map(frame).zip(self.poses.chunks_exact(self.units.max(1)))
    }

    /// Pose of a unit at a frame. Between samples it is interpolated: linearly in position, along the shortest turn
    /// in orientation. `None` outside the trajectory.
    pub fn pose(&self, frame: u32, unit: usize) -> Option<Isometry3<f32>> {
        let since = frame.checked_sub(self.first_frame)?;
        if unit >= self.units {
            return None;
        }
        let (sample, rest) = ((since / self.step) as usize, since % self.step);
        let at = |sample: usize| self.poses.get(sample * self.units + unit).copied();
        let before = at(sample)?;
        if rest == 0 {
            return Some(before);
        }
        let (after, part) = (at(sample + 1)?, rest as f32 / self.step as f32);
        let position = before.translation.vector.lerp(&after.translation.vector, part);
        // Half a turn between samples has no shortest way: stay with the nearer sample.
        let nearer = if part < 0.5 { before.rotation } else { after.rotation };
        let rotation = before.rotation.try_slerp(&after.rotation, part, 1e-6).unwrap_or(nearer);
        Some(Isometry3::from_parts(Translation3::from(position), rotation))
    }
}

/// How a rollout is watched and stopped.
#[derive(Clone, Copy)]
pub struct Control<'a> {
    /// Looked at before every step: once true, rollouts end with [`RolloutError::Cancelled`].
    pub cancelled: &'a AtomicBool,
    /// Called after every step of every scene, from any thread.
    pub stepped: &'a (dyn Fn() + Sync),
}

impl Control<'static> {
    /// Neither watched nor stopped.
    pub fn none() -> Self {
        static NEVER: AtomicBool = AtomicBool::new(false);
        Control { cancelled: &NEVER, stepped: &|| {} }
    }
}

/// Why a scene could not be rolled out. Its text names the scene and the remedy.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum RolloutError {
    /// The caller asked to stop.
    #[error("cancelled")]
    Cancelled,
    /// The scene has too few recorded frames to start from.
    #[error(
        "{scene}: step {step} starts from frames 0 and {step}, {recorded} frames are recorded; use a smaller step"
    )]
    TooFewFrames {
        /// The scene.
        scene: String,
        /// Step code asked for.
        step: u32,
        /// Frames recorded.
        recorded: usize,
    },
    /// The scene has more units than any simulator of this build.
    #[error("{scene}: has {units} units, at most {MAX_UNITS} can be simulated; split the scene")]
    TooManyUnits {
        /// The scene.
        scene: String,
        /// Its units.
        units: usize,
    },
    /// The model wants a command, which recorded scenes do not have.
    #[error(
        "the model wants a command of {size} numbers and recorded scenes have none; use a model without commands"
    )]
    NeedsCommand {
        /// Numbers in a command.
        size: u32,
    },
    /// The model was trained for another world.
    #[error(
        "{scene}: {what} is {found}, the model was trained for {expected}; use a model trained for this data"
    )]
    OtherPhysics {
        /// The scene.
        scene: String,
        /// `frame_rate_hz` or `gravity_m_s2`.
        what: &'static str,
        /// In the scene.
        found: String,
        /// In the model.
        expected: String,
    },
    /// No simulator could be made for the scene.
    #[error("{scene}: {source}")]
    Engine {
        /// The scene.
        scene: String,
        /// Why.
        source: EngineError,
    },
    /// The kernels that the environment asks for cannot be used.
    #[error(transparent)]
    Kernel(#[from] KernelError),
    /// The first frames were refused.
    #[error("{scene}: {source}")]
    Observe {
        /// The scene.
        scene: String,
        /// The simulator's answer.
        source: ObserveError,
    },
    /// A step was refused.
    #[error("{scene}: step to frame {frame}: {source}")]
    Step {
        /// The scene.
        scene: String,
        /// The frame that was not reached.
        frame: u32,
        /// The simulator's answer.
        source: StepError,
    },
}

/// Rolls one scene out: observes its frames 0 and `step`, then predicts every `step` frames until `last_frame` is
/// reached or passed. The trajectory starts with the two observed frames.
///
/// ```
/// use nalgebra::{Isometry3, Point3, Vector3};
/// use rigidformer_core::Physics;
/// use rigidformer_runtime::models::LoadedModel;
/// use rigidformer_runtime::rollout::{Control, rollout};
/// use rigidformer_runtime::scenes::{RecordedScene, RecordedUnit, Split};
///
/// let loaded = LoadedModel::embedded("edge", rigidformer_weights::EDGE)?;
/// // A recorded scene, usually from `Dataset::open(path)?.scene(index, None)?`.
/// let fall = |frame| Isometry3::translation(0.0, 0.0, 3.0 - 5.0 * (frame as f32 / 240.0).powi(2));
/// let corner = |i: i32| [1, 2, 4].map(|bit| if i & bit == 0 { -0.1 } else { 0.1 });
/// let points = (0..8).map(|i| Point3::from(corner(i))).collect();
/// let physics = Physics { mass_kg: 1.0, friction: 0.4, restitution: 0.3 };
/// let unit = RecordedUnit::new("cube", points, physics, (0..=100).map(fall).collect());
/// let gravity = Vector3::new(0.0, 0.0, -10.0);
/// let scene = RecordedScene::new("drop", 1, Split::Test, 240.0, gravity, vec![unit])?;
///
/// let predicted = rollout(&loaded.model()?, &scene, 10, 100, Control::none())?;
/// let pose = predicted.pose(100, 0).ok_or("not predicted")?;
/// assert!((pose.translation.z - fall(100).translation.z).abs() < 1e-4); // nothing to touch: exact
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
pub fn rollout(
    model: &Model<'_>,
    scene: &RecordedScene,
    step: u32,
    last_frame: u32,
    control: Control<'_>,
) -> Result<Trajectory, RolloutError> {
    rollout_on(Engine::new()?, model, scene, step, last_frame, control)
}

/// As [`rollout`] on kernels and threads of the caller's choice; the result is the same, bit by bit.
pub fn rollout_on(
    engine: Engine,
    model: &Model<'_>,
    scene: &RecordedScene,
    step: u32,
    last_frame: u32,
    control: Control<'_>,
) -> Result<Trajectory, RolloutError> {
    check_fit(model, scene)?;
    let units = scene.units().len();
    if units > MAX_UNITS {
        return Err(RolloutError::TooManyUnits { scene: scene.name().into(), units });
    }
    let limits = Limits { units, points: scene.points() };
    engine
        .simulate(model, limits, 1, |simulator| run(simulator, scene, step, last_frame, control))
        .map_err(|source| RolloutError::Engine { scene: scene.name().into(), source })?
}

/// Rolls scenes out on all threads; the results are in the order of the scenes and do not depend on the threads.
/// Ends with the error of the first scene, in that order, that has one.
pub fn rollout_many(
    model: &Model<'_>,
    scenes: &[RecordedScene],
    step: u32,
    last_frame: u32,
    control: Control<'_>,
) -> Result<Vec<Trajectory>, RolloutError> {
    let mut engine = Engine::new()?;
    if scenes.len() >= rayon::current_num_threads() {
        engine = engine.single();
    }
    let one = |scene| rollout_on(engine, model, scene, step, last_frame, control);
    let results: Vec<_> = scenes.par_iter().map(one).collect();
    results.into_iter().collect()
}

/// Whether the model was made for the scene's frame rate and gravity, and can do without a command; [`rollout`] asks this
/// first.
///
/// # Errors
/// [`RolloutError::OtherPhysics`] or [`RolloutError::NeedsCommand`].
pub fn check_fit(model: &Model<'_>, scene: &RecordedScene) -> Result<(), RolloutError> {
    let config = model.config();
    if config.command_size > 0 {
        return Err(RolloutError::NeedsCommand { size: config.command_size });
    }
    let other = |what, found: String, expected: String| {
        Err(RolloutError::OtherPhysics { scene: scene.name().into(), what, found, expected })
    };
    let differs = |a: f32, b: f32| (a - b).abs() > 1e-5 * a.abs().max(b.abs());
    if differs(scene.frame_rate_hz(), config.frame_rate_hz) {
        return other(
            "frame_rate_hz",
            scene.frame_rate_hz().to_string(),
            config.frame_rate_hz.to_string(),
        );
    }
    let gravity: [f32; 3] = scene.gravity_m_s2().into();
    if gravity.iter().zip(&config.gravity_m_s2).any(|(a, b)| differs(*a, *b)) {
        return other("gravity_m_s2", format!("{gravity:?}"), format!("{:?}", config.gravity_m_s2));
    }
    let Some(planes) = scene.planes() else { return Ok(()) };
    let Some(ground) = scene.ground() else {
        let expected = "the plane z = 0".to_owned();
        return other("planes", format!("{planes:?}"), expected);
    };
    let found = [ground.friction, ground.restitution];
    let expected = [config.ground_friction, config.ground_restitution];
    if found.iter().zip(&expected).any(|(a, b)| differs(*a, *b)) {
        return other(
            "ground_friction and ground_restitution",
            format!("{found:?}"),
            format!("{expected:?}"),
        );
    }
    Ok(())
}

fn run(
    simulator: &mut dyn Stepping,
    scene: &RecordedScene,
    step: u32,
    last_frame: u32,
    control: Control<'_>,
) -> Result<Trajectory, RolloutError> {
    let name = || scene.name().to_owned();
    let too_few = || RolloutError::TooFewFrames { scene: name(), step, recorded: scene.frames() };
    let previous = scene.poses_at(0).ok_or_else(too_few)?;
    let current = scene.poses_at(step as usize).ok_or_else(too_few)?;
    let units: Vec<Unit<'_>> = scene
        .units()
        .iter()
        .map(|unit| Unit { points: &unit.points, physics: unit.physics })
        .collect();

    simulator
        .observe_poses(step, &units, &previous, &current)
        .map_err(|source| RolloutError::Observe { scene: name(), source })?;

    let mut trajectory = Trajectory::new(0, step, previous);
    trajectory.push(current);
    while trajectory.last_frame() < last_frame {
        if control.cancelled.load(Ordering::Relaxed) {
            return Err(RolloutError::Cancelled);
        }
        let frame = trajectory.last_frame().saturating_add(step);
        simulator.step().map_err(|source| RolloutError::Step { scene: name(), frame, source })?;
        trajectory.push((0..units.len()).filter_map(|unit| simulator.pose(unit)));
        (control.stepped)();
    }
    Ok(trajectory)
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::{UnitQuaternion, Vector3};

    #[test]
    fn between_samples_a_pose_is_half_way() {
        let turn = |angle| UnitQuaternion::from_axis_angle(&Vector3::z_axis(), angle);
        let pose = |x, angle| Isometry3::from_parts(Translation3::new(x, 0.0, 0.0), turn(angle));
        let mut trajectory = Trajectory::new(0, 10, vec![pose(0.0, 0.0)]);
        trajectory.push([pose(1.0, 1.0)]);
        let middle = trajectory.pose(5, 0).unwrap();
        assert!((middle.translation.vector.x - 0.5).abs() < 1e-6);
        assert!((middle.rotation.angle() - 0.5).abs() < 1e-6);
        assert_eq!(trajectory.pose(10, 0), Some(pose(1.0, 1.0)));
        assert_eq!(trajectory.pose(11, 0), None);
        assert_eq!(trajectory.pose(5, 1), None);
    }
}
