//! Many futures of one scene: copies with commands, velocities or physics of their own that advance in lockstep, so
//! that each layer's weights are read once for all of them.

use std::ops::ControlFlow;

use nalgebra::{Isometry3, Translation3, UnitQuaternion, Vector3};
use rayon::prelude::*;
use rigidformer_core::{
    CommandError, Limits, Model, ObserveError, Physics, StepError, StepReport, Unit,
};

use crate::engine::{Engine, EngineError, MAX_UNITS, Stepping};
use crate::noise::Noise;

/// Units of all copies in one simulator, about: more make no product faster (docs/PERFORMANCE.md), and the buffers of
/// fewer stay in the cache.
const UNITS_A_CHUNK: usize = 64;

/// The scene that futures start from.
#[derive(Clone, Copy, Debug)]
pub struct Start<'a> {
    /// Native frames between the two poses, and between predictions.
    pub step: u32,
    /// (units)
    pub units: &'a [Unit<'a>],
    /// (units) where they were a step ago.
    pub previous: &'a [Isometry3<f32>],
    /// (units) where they are.
    pub current: &'a [Isometry3<f32>],
    /// For models that take one; empty for others.
    pub command: &'a [f32],
}

/// What makes futures differ, and what is wanted of them. Called from any thread; what it does may depend on its
/// arguments alone, then a future is the same in every batch and on any number of threads.
pub trait Variation: Sync {
    /// Changes a future before its first step.
    ///
    /// # Errors
    /// [`ChangeError`] ends this future before it begins; the others go on.
    fn begin(&self, future: usize, scene: &mut FutureScene<'_>) -> Result<(), ChangeError> {
        let _ = (future, scene);
        Ok(())
    }

    /// Changes a future before its step `step`, from 0: a command, or a push.
    ///
    /// # Errors
    /// As [`begin`](Self::begin).
    fn steer(
        &self,
        future: usize,
        step: usize,
        scene: &mut FutureScene<'_>,
    ) -> Result<(), ChangeError> {
        let _ = (future, step, scene);
        Ok(())
    }

    /// Looks at a future after its step `step`; [`ControlFlow::Break`] ends it there, and its share of the work goes to
    /// the others.
    fn watch(&self, future: usize, step: usize, poses: &[Isometry3<f32>]) -> ControlFlow<()> {
        let _ = (future, step, poses);
        ControlFlow::Continue(())
    }
}

/// Futures that do not differ.
impl Variation for () {}

/// Normal noise on the velocities of all units.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct VelocityNoise {
    /// Another seed, other futures.
    pub seed: u64,
    /// Deviation of each component, m/s.
    pub linear_m_s: f32,
    /// Deviation of each component, rad/s.
    pub angular_rad_s: f32,
}

impl Variation for VelocityNoise {
    fn begin(&self, future: usize, scene: &mut FutureScene<'_>) -> Result<(), ChangeError> {
        let mut noise = Noise::new(self.seed, future as u64);
        for unit in 0..scene.units() {
            let mut vector = |deviation| Vector3::from_fn(|_, _| deviation * noise.normal());
            let (linear, angular) = (vector(self.linear_m_s), vector(self.angular_rad_s));
            scene.push(unit, &linear, &angular)?;
        }
        Ok(())
    }
}

/// A future's scene, while it may be changed.
pub struct FutureScene<'s> {
    simulator: &'s mut dyn Stepping,
    copy: usize,
    /// Seconds of a step.
    dt: f32,
}

impl FutureScene<'_> {
    /// Units.
    pub fn units(&self) -> usize {
        self.simulator.units()
    }

    /// Where a unit is.
    pub fn pose(&self, unit: usize) -> Option<Isometry3<f32>> {
        self.simulator.pose(self.copy * self.units() + unit)
    }

    /// Puts a unit somewhere.
    ///
    /// # Errors
    /// [`ChangeError`]; the unit is what it was.
    pub fn set_poses(
        &mut self,
        unit: usize,
        previous: &Isometry3<f32>,
        current: &Isometry3<f32>,
    ) -> Result<(), ChangeError> {
        match self.simulator.set_poses(self.copy, unit, previous, current)? {
            true => Ok(()),
            false => Err(ChangeError::NoSuchUnit { unit, units: self.units() }),
        }
    }

    /// Gives a unit velocities: linear in m/s of its frame's origin, angular in rad/s in the world frame. They are means
    /// over the last step, so that without gravity the next step moves it by as much.
    ///
    /// # Errors
    /// [`ChangeError`]; the unit is what it was.
    pub fn set_velocity(
        &mut self,
        unit: usize,
        linear: &Vector3<f32>,
        angular: &Vector3<f32>,
    ) -> Result<(), ChangeError> {
        let no_such = ChangeError::NoSuchUnit { unit, units: self.units() };
        let current = self.pose(unit).ok_or(no_such)?;
        let back = UnitQuaternion::from_scaled_axis(angular * -self.dt);
        let place = current.translation.vector - linear * self.dt;
        let previous = Isometry3::from_parts(Translation3::from(place), back * current.rotation);
        self.set_poses(unit, &previous, &current)
    }

    /// Adds to the velocities of a unit, as [`set_velocity`](Self::set_velocity) gives them.
    ///
    /// # Errors
    /// [`ChangeError`]; the unit is what it was.
    pub fn push(
        &mut self,
        unit: usize,
        linear: &Vector3<f32>,
        angular: &Vector3<f32>,
    ) -> Result<(), ChangeError> {
        let no_such = ChangeError::NoSuchUnit { unit, units: self.units() };
        let current = self.pose(unit).ok_or(no_such.clone())?;
        let index = self.copy * self.units() + unit;
        let previous = self.simulator.previous_pose(index).ok_or(no_such)?;
        let back = UnitQuaternion::from_scaled_axis(angular * -self.dt);
        let place = previous.translation.vector - linear * self.dt;
        let previous = Isometry3::from_parts(Translation3::from(place), back * previous.rotation);
        self.set_poses(unit, &previous, &current)
    }

    /// Changes what a unit is made of.
    ///
    /// # Errors
    /// [`ChangeError`]; the unit is what it was.
    pub fn set_physics(&mut self, unit: usize, physics: Physics) -> Result<(), ChangeError> {
        match self.simulator.set_physics(self.copy, unit, physics)? {
            true => Ok(()),
            false => Err(ChangeError::NoSuchUnit { unit, units: self.units() }),
        }
    }

    /// The command of this future's following steps.
    ///
    /// # Errors
    /// [`ChangeError`]; the command is what it was.
    pub fn set_command(&mut self, command: &[f32]) -> Result<(), ChangeError> {
        self.simulator.set_copy_command(self.copy, command)?;
        Ok(())
    }
}

/// Why a future cannot be changed as asked.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum ChangeError {
    /// A pose or a physical property is out of range.
    #[error(transparent)]
    Unit(#[from] ObserveError),
    /// The command is not one of this model.
    #[error(transparent)]
    Command(#[from] CommandError),
    /// The scene has no such unit.
    #[error("unit {unit} of {units}; they are counted from 0")]
    NoSuchUnit {
        /// Asked for.
        unit: usize,
        /// In the scene.
        units: usize,
    },
    /// A reason of the caller's own.
    #[error("{0}")]
    Other(String),
}

/// How a future ended.
#[derive(Clone, Debug, Default, PartialEq)]
pub enum End {
    /// All steps were taken.
    #[default]
    Complete,
    /// [`Variation::watch`] ended it.
    Stopped,
    /// A step failed; the last pose before it stands.
    Failed(StepError),
    /// It could not be changed as [`Variation`] asked.
    Refused(ChangeError),
}

/// What became of a future.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Outcome {
    /// Steps taken: as many rows of the output are its own, the others repeat the last.
    pub steps: usize,
    /// Why no more.
    pub end: End,
}

/// Why no future was rolled out.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum BatchError {
    /// The output is not as long as futures x steps x units.
    #[error("the output holds {found} poses, {expected} are needed: futures x steps x units")]
    Output {
        /// Poses needed.
        expected: usize,
        /// Poses given.
        found: usize,
    },
    /// No simulator could be made.
    #[error(transparent)]
    Engine(#[from] EngineError),
    /// The start was refused.
    #[error(transparent)]
    Start(#[from] ObserveError),
    /// The command was refused.
    #[error(transparent)]
    Command(#[from] CommandError),
    /// The model takes a command and the start has none.
    #[error(transparent)]
    Step(#[from] StepError),
}

/// Rolls out futures of scenes with one model.
///
/// ```
/// use nalgebra::{Isometry3, Point3};
/// use rigidformer_runtime::core::{Physics, Unit};
/// use rigidformer_runtime::futures::{BatchSimulator, Outcome, Start, VelocityNoise};
/// use rigidformer_runtime::{engine::Engine, models::LoadedModel};
///
/// let loaded = LoadedModel::embedded("edge", rigidformer_weights::EDGE)?;
/// let model = loaded.model()?;
/// let corner = |i: usize, bit| if i & bit == 0 { -0.1 } else { 0.1 };
/// let points: Vec<_> = (0..8).map(|i| Point3::new(corner(i, 1), corner(i, 2), corner(i, 4))).collect();
/// let cube = Unit { points: &points, physics: Physics { mass_kg: 1.0, friction: 0.4, restitution: 0.3 } };
/// let at = |z| [Isometry3::translation(0.0, 0.0, z), Isometry3::translation(0.4, 0.0, z)];
/// let start =
///     Start { step: 10, units: &[cube, cube], previous: &at(0.92), current: &at(0.9), command: &[] };
///
/// let (futures, steps) = (16, 6);
/// let mut poses = vec![Isometry3::identity(); futures * steps * 2];
/// let noise = VelocityNoise { seed: 1, linear_m_s: 0.3, angular_rad_s: 1.0 };
/// let outcomes = BatchSimulator::new(Engine::new()?, &model).run(&start, steps, &noise, &mut poses)?;
/// assert_eq!(outcomes, vec![Outcome { steps, ..Outcome::default() }; futures]);
/// let last_of_future_3 = &poses[(3 * steps + steps - 1) * 2..][..2];
/// assert!(last_of_future_3[0].translation.z < 0.9);
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
#[derive(Clone, Copy)]
pub struct BatchSimulator<'m> {
    engine: Engine,
    model: &'m Model<'m>,
    units_a_chunk: usize,
}

impl<'m> BatchSimulator<'m> {
    /// Futures share their threads, or, where they are few, the work of each layer.
    pub fn new(engine: Engine, model: &'m Model<'m>) -> Self {
        BatchSimulator { engine, model, units_a_chunk: UNITS_A_CHUNK }
    }

    /// About so many units, at most [`MAX_UNITS`], advance in one lockstep; results do not depend on it.
    pub fn with_units_a_chunk(self, units: usize) -> Self {
        BatchSimulator { units_a_chunk: units.clamp(1, MAX_UNITS), ..self }
    }

    /// Rolls out as many futures as `out` (futures, steps, units) has room for, future by future: the poses after each
    /// step. What became of each, in order.
    ///
    /// # Errors
    /// [`BatchError`]; the output is then what it was.
    pub fn run(
        &self,
        start: &Start<'_>,
        steps: usize,
        variation: &impl Variation,
        out: &mut [Isometry3<f32>],
    ) -> Result<Vec<Outcome>, BatchError> {
        let units = start.units.len();
        let row = steps.saturating_mul(units).max(1);
        if !out.len().is_multiple_of(row) {
            let expected = out.len().next_multiple_of(row);
            return Err(BatchError::Output { expected, found: out.len() });
        }
        let futures = out.len() / row;
        // Any fault of the start shows before anything is written.
        self.begin(self.engine.single(), start, 1, |_| Ok(()))?;
        let threads = self.engine.threads.count();
        let fitting = (self.units_a_chunk / units.max(1)).max(1);
        // As many chunks as threads can share evenly.
        let chunks = futures.div_ceil(fitting).next_multiple_of(threads);
        let chunk = futures.div_ceil(chunks.max(1)).max(1);
        let engine = if futures < threads { self.engine } else { self.engine.single() };
        let chunk = if futures < threads { 1 } else { chunk };
        let mut outcomes = vec![Outcome::default(); futures];
        let tasks = out.par_chunks_mut(chunk * row).zip(outcomes.par_chunks_mut(chunk));
        tasks.enumerate().try_for_each(|(index, (out, outcomes))| {
            self.begin(engine, start, outcomes.len(), |simulator| {
                let dt = start.step as f32 / self.model.config().frame_rate_hz;
                let mut lockstep =
                    Lockstep { first: index * chunk, dt, variation, outcomes, out, row };
                lockstep.run(simulator, steps)
            })
        })?;
        Ok(outcomes)
    }

    /// A simulator with so many copies of the start.
    fn begin(
        &self,
        engine: Engine,
        start: &Start<'_>,
        copies: usize,
        body: impl FnOnce(&mut dyn Stepping) -> Result<(), BatchError> + Send,
    ) -> Result<(), BatchError> {
        let points = start.units.iter().map(|unit| unit.points.len()).sum();
        let limits = Limits { units: start.units.len(), points };
        engine.simulate(self.model, limits, copies, |simulator| {
            simulator.observe_poses(start.step, start.units, start.previous, start.current)?;
            if !start.command.is_empty() || self.model.config().command_size > 0 {
                simulator.set_command(start.command)?;
            }
            simulator.replicate(copies);
            body(simulator)
        })?
    }
}

/// Futures from `first` on that advance together.
struct Lockstep<'l, V> {
    first: usize,
    dt: f32,
    variation: &'l V,
    outcomes: &'l mut [Outcome],
    /// (futures, row)
    out: &'l mut [Isometry3<f32>],
    row: usize,
}

impl<V: Variation> Lockstep<'_, V> {
    fn run(&mut self, simulator: &mut dyn Stepping, steps: usize) -> Result<(), BatchError> {
        let units = simulator.units();
        // Which future each copy is.
        let mut futures: Vec<usize> = (0..self.outcomes.len()).collect();
        self.change(simulator, &mut futures, |variation, future, scene| {
            variation.begin(future, scene)
        });
        for step in 0..steps {
            self.change(simulator, &mut futures, |variation, future, scene| {
                variation.steer(future, step, scene)
            });
            if futures.is_empty() {
                break;
            }
            let mut failed: Vec<Option<StepError>> = vec![None; futures.len()];
            let mut note = |copy: usize, outcome: Result<StepReport, StepError>| {
                failed[copy] = outcome.err();
            };
            simulator.step_copies(&mut note)?;
            let mut alive = vec![true; futures.len()];
            for (copy, future) in futures.iter().copied().enumerate() {
                let outcome = &mut self.outcomes[future];
                if let Some(error) = failed[copy] {
                    outcome.end = End::Failed(error);
                    alive[copy] = false;
                    continue;
                }
                let poses = &mut self.out[future * self.row + step * units..][..units];
                for (unit, pose) in poses.iter_mut().enumerate() {
                    *pose = simulator.pose(copy * units + unit).unwrap_or_default();
                }
                outcome.steps = step + 1;
                if self.variation.watch(self.first + future, step, poses).is_break() {
                    outcome.end = if step + 1 < steps { End::Stopped } else { End::Complete };
                    alive[copy] = false;
                }
            }
            retain(simulator, &mut futures, &alive);
        }
        for (outcome, out) in self.outcomes.iter().zip(self.out.chunks_exact_mut(self.row)) {
            let taken = outcome.steps * units;
            if let Some(last) = taken.checked_sub(units) {
                for at in taken..out.len() {
                    out[at] = out[last + (at - taken) % units.max(1)];
                }
            }
        }
        Ok(())
    }

    /// Lets the caller change each future; those that it cannot change as it wants end.
    fn change(
        &mut self,
        simulator: &mut dyn Stepping,
        futures: &mut Vec<usize>,
        change: impl Fn(&V, usize, &mut FutureScene<'_>) -> Result<(), ChangeError>,
    ) {
        let mut alive = vec![true; futures.len()];
        for (copy, future) in futures.iter().copied().enumerate() {
            let mut scene = FutureScene { simulator: &mut *simulator, copy, dt: self.dt };
            if let Err(error) = change(self.variation, self.first + future, &mut scene) {
                self.outcomes[future].end = End::Refused(error);
                alive[copy] = false;
            }
        }
        retain(simulator, futures, &alive);
    }
}

fn retain(simulator: &mut dyn Stepping, futures: &mut Vec<usize>, alive: &[bool]) {
    if alive.iter().all(|alive| *alive) {
        return;
    }
    simulator.retain_copies(&mut |copy| alive[copy]);
    let mut alive = alive.iter();
    futures.retain(|_| alive.next().copied().unwrap_or(false));
}
