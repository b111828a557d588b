//! Sampling-based planners: they roll out a future for each sample of parameters, and search around the best.
//!
//! [`Planner::plan`] searches the parameters of an [`Action`] (a throw's velocity, a command a step) for the least of a
//! [`Cost`], with MPPI or the cross-entropy method ([`Method`]). docs/PLANNING.md shows a throw over a wall.
//!
//! The same seed gives the same plan, to the bit, on any number of threads and in chunks of any size, unless a deadline
//! or a cancellation cut it: how far it got then depends on the time.

pub mod pushing;
mod search;
mod settings;
pub mod walking;

use std::ops::ControlFlow;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Instant;

use nalgebra::{Isometry3, Vector3};
use rayon::prelude::*;
use rigidformer_core::kernels::in_own_environment;
use rigidformer_runtime::futures::{
    BatchError, BatchSimulator, ChangeError, End, FutureScene, Outcome, Start, Variation,
};
use rigidformer_runtime::pool;

use search::Search;

pub use settings::{Method, Parameter, Settings, SettingsError};

/// Units of a batch's futures for each thread.
// Enough to fill the lockstep, and few enough to report often.
const UNITS_PER_THREAD: usize = 512;
/// Futures for each thread in the first batch before a deadline.
// The duration of a future is not known yet, so the first batch is small.
const FIRST_FUTURES_PER_THREAD: usize = 4;
/// Largest ratio of a batch to the one before, under a deadline.
// Small batches are a poor estimate of the duration of large ones.
const MAX_GROWTH: usize = 4;

/// Applies parameters to a future. Called from any thread; its effect may depend on its arguments alone.
pub trait Action: Sync {
    /// Changes a future before its first step, such as by a velocity.
    ///
    /// # Errors
    /// [`ChangeError`] makes this future worse than all others.
    fn begin(&self, parameters: &[f32], scene: &mut FutureScene<'_>) -> Result<(), ChangeError> {
        let _ = (parameters, scene);
        Ok(())
    }

    /// Changes a future before its step `step`, from 0, such as by a command.
    ///
    /// # Errors
    /// As [`begin`](Self::begin).
    fn steer(
        &self,
        parameters: &[f32],
        step: usize,
        scene: &mut FutureScene<'_>,
    ) -> Result<(), ChangeError> {
        let _ = (parameters, step, scene);
        Ok(())
    }
}

/// Ignores the parameters.
impl Action for () {}

/// A unit is let go with a velocity: three parameters, m/s in the world frame, or six, with its spin in rad/s.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Launch {
    /// Which unit.
    pub unit: usize,
}

impl Action for Launch {
    fn begin(&self, parameters: &[f32], scene: &mut FutureScene<'_>) -> Result<(), ChangeError> {
        let (linear, angular) = match *parameters {
            [x, y, z] => (Vector3::new(x, y, z), Vector3::zeros()),
            [x, y, z, a, b, c] => (Vector3::new(x, y, z), Vector3::new(a, b, c)),
            _ => {
                let found = parameters.len();
                let text = format!("a launch has 3 parameters, or 6 with spin, not {found}");
                return Err(ChangeError::Other(text));
            }
        };
        scene.set_velocity(self.unit, &linear, &angular)
    }
}

/// A command a step, for models that take one: parameters are (steps, `size`). After the last the scene keeps it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Commands {
    /// Numbers in a command.
    pub size: usize,
}

impl Action for Commands {
    fn steer(
        &self,
        parameters: &[f32],
        step: usize,
        scene: &mut FutureScene<'_>,
    ) -> Result<(), ChangeError> {
        let first = step.saturating_mul(self.size);
        match parameters.get(first..first.saturating_add(self.size)) {
            Some(command) => scene.set_command(command),
            None => Ok(()),
        }
    }
}

/// As [`Commands`], each held for so many steps: parameters are (commands, `size`).
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct HeldCommands {
    /// Numbers in a command.
    pub size: usize,
    /// Steps that one lasts; 0 counts as 1.
    pub steps: usize,
}

impl Action for HeldCommands {
    fn steer(
        &self,
        parameters: &[f32],
        step: usize,
        scene: &mut FutureScene<'_>,
    ) -> Result<(), ChangeError> {
        let steps = self.steps.max(1);
        match step.is_multiple_of(steps) {
            true => Commands { size: self.size }.steer(parameters, step / steps, scene),
            false => Ok(()),
        }
    }
}

/// The cost of a future. Called from any thread, unless it [is serial](Self::is_serial); the result may depend on its arguments alone. Any
/// `Fn(&Trial<'_>) -> f32` is one.
pub trait Cost: Sync {
    /// The cost of a future that has ended; less is better. One that is not finite is worse than all others.
    fn cost(&self, trial: &Trial<'_>) -> f32;

    /// Observes a future after its step `step`, from 0. [`ControlFlow::Break`] ends it there, where its cost is clear, and its share of the
    /// work goes to the others.
    fn watch(&self, step: usize, poses: &[Isometry3<f32>]) -> ControlFlow<()> {
        let _ = (step, poses);
        ControlFlow::Continue(())
    }

    /// Whether [`cost`](Self::cost) is called on the thread that plans, one future after the other: for costs that wait for each
    /// other, or for rayon's threads.
    fn is_serial(&self) -> bool {
        false
    }
}

impl<F: Fn(&Trial<'_>) -> f32 + Sync> Cost for F {
    fn cost(&self, trial: &Trial<'_>) -> f32 {
        self(trial)
    }
}

/// Parameters, and the future that they led to.
#[derive(Clone, Copy, Debug)]
pub struct Trial<'t> {
    /// What was tried.
    pub parameters: &'t [f32],
    /// (steps taken, units) poses after each step; at least one step was taken.
    pub poses: &'t [Isometry3<f32>],
    /// Units of the scene.
    pub units: usize,
    /// Whether [`Cost::watch`] ended it before its last step.
    pub stopped: bool,
}

impl<'t> Trial<'t> {
    /// Steps taken.
    pub fn steps(&self) -> usize {
        self.poses.len() / self.units.max(1)
    }

    /// (units) Poses after each step.
    pub fn iter(&self) -> impl DoubleEndedIterator<Item = &'t [Isometry3<f32>]> + use<'t> {
        self.poses.chunks_exact(self.units.max(1))
    }

    /// A unit's poses, step by step; none for a unit that is not there.
    pub fn path(&self, unit: usize) -> impl Iterator<Item = &'t Isometry3<f32>> + use<'t> {
        self.iter().filter_map(move |poses| poses.get(unit))
    }

    /// (units) Poses after the last step.
    pub fn last(&self) -> &'t [Isometry3<f32>] {
        self.iter().next_back().unwrap_or_default()
    }
}

/// When planning ends early, and who watches it.
pub struct Control<'c> {
    /// By then it ends, to within a step of one batch.
    pub deadline: Option<Instant>,
    /// Once true it ends after the step under way.
    pub cancelled: &'c AtomicBool,
    /// Called between batches and between iterations.
    pub watch: &'c mut dyn FnMut(Event<'_>),
}

impl Control<'_> {
    /// Planning runs to its end, unwatched.
    ///
    /// ```
    /// use std::time::{Duration, Instant};
    /// use rigidformer_planning::planner::Control;
    /// let soon = Some(Instant::now() + Duration::from_millis(20));
    /// # let mut watch = |_: rigidformer_planning::planner::Event<'_>| {};
    /// let control = Control { deadline: soon, ..Control::none(&mut watch) };
    /// ```
    pub fn none(watch: &mut dyn FnMut(Event<'_>)) -> Control<'_> {
        static NEVER: AtomicBool = AtomicBool::new(false);
        Control { deadline: None, cancelled: &NEVER, watch }
    }

    /// Why to end now, if there is a reason.
    fn cut(&self) -> Option<Cut> {
        cut(self.deadline, self.cancelled)
    }
}

fn cut(deadline: Option<Instant>, cancelled: &AtomicBool) -> Option<Cut> {
    if cancelled.load(Ordering::Relaxed) {
        return Some(Cut::Cancelled);
    }
    deadline.filter(|deadline| Instant::now() >= *deadline).map(|_| Cut::Deadline)
}

/// Progress of a planner.
#[derive(Clone, Copy, Debug)]
#[non_exhaustive]
pub enum Event<'e> {
    /// So many more futures were evaluated.
    Batch(usize),
    /// An iteration is complete.
    Iteration(Iteration<'e>),
}

/// A complete iteration.
#[derive(Clone, Copy, Debug)]
pub struct Iteration<'i> {
    /// From 0.
    pub index: usize,
    /// (futures, parameters) what was tried.
    pub samples: &'i [f32],
    /// (futures) what it cost; infinite where a future is of no use.
    pub costs: &'i [f32],
    /// The least cost of all iterations so far; infinite until there is one.
    pub best_cost: f32,
    /// (parameters) around which the next iteration tries.
    pub mean: &'i [f32],
    /// (parameters) how far around, as standard deviations.
    pub deviations: &'i [f32],
}

/// Why planning ended before its last iteration.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub enum Cut {
    /// The deadline.
    #[error("the deadline passed")]
    Deadline,
    /// The caller's flag.
    #[error("cancelled")]
    Cancelled,
}

/// What a planner found.
#[derive(Clone, Debug, PartialEq)]
pub struct Plan {
    /// (parameters) the best that was tried.
    pub best: Vec<f32>,
    /// Its cost.
    pub cost: f32,
    /// (steps taken, units) its future.
    pub poses: Vec<Isometry3<f32>>,
    /// (parameters) the mean after the last iteration. It was not tried itself.
    pub mean: Vec<f32>,
    /// (parameters) the deviations then.
    pub deviations: Vec<f32>,
    /// Complete iterations.
    pub iterations: usize,
    /// Futures evaluated, those of an incomplete iteration too.
    pub futures: usize,
    /// Those of them that failed, were refused, or cost no finite number.
    pub unusable: usize,
    /// Why it is not the plan of all iterations, if it is not.
    pub cut: Option<Cut>,
}

/// Why there is no plan.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum PlanError {
    /// Nothing could be rolled out.
    #[error(transparent)]
    Batch(#[from] BatchError),
    /// Planning was cut before the first future was evaluated.
    #[error("{0} before the first future was evaluated; allow more time, or plan fewer steps")]
    Cut(Cut),
    /// No future was of any use.
    #[error(
        "none of {futures} futures has a finite cost; the first: {why}; widen or move the parameters, or mend the cost"
    )]
    NoneUsable {
        /// Futures evaluated.
        futures: usize,
        /// What was wrong with the first.
        why: String,
    },
}

/// Plans, and keeps its buffers from one plan to the next.
///
/// A cube is let go such that it passes a place half a metre away:
///
/// ```
/// use nalgebra::{Isometry3, Point3};
/// use rigidformer_runtime::core::{Physics, Posed, Unit};
/// use rigidformer_runtime::futures::{BatchSimulator, Start};
/// use rigidformer_planning::planner::{Control, Launch, Parameter, Planner, Settings, Trial};
/// use rigidformer_runtime::engine::Engine;
/// use rigidformer_runtime::models::LoadedModel;
///
/// let loaded = LoadedModel::embedded("edge", rigidformer_weights::EDGE)?;
/// let corner = |i: usize, bit| if i & bit == 0 { -0.2 } else { 0.2 };
/// let points: Vec<_> = (0..8).map(|i| Point3::new(corner(i, 1), corner(i, 2), corner(i, 4))).collect();
/// let cube = Unit::new(&points, Physics { mass_kg: 1.0, friction: 0.4, restitution: 0.3 });
/// let rest = Isometry3::translation(0.0, 0.0, 1.5);
/// let units = [Posed { unit: cube, previous: rest, current: rest }];
/// let start = Start { dt_s: 1.0 / 24.0, units: &units, ..Start::default() };
///
/// let goal = Point3::new(0.3, 0.0, 1.4);
/// let cost = |trial: &Trial<'_>| {
///     let distances = trial.path(0).map(|pose| (pose.translation.vector - goal.coords).norm());
///     distances.fold(f32::INFINITY, f32::min)
/// };
/// let velocity = [Parameter::new(0.0, 2.0).within(-4.0, 4.0); 3]; // m/s
/// let settings = Settings { futures: 32, iterations: 3, steps: 4, ..Settings::default() };
/// let mut planner = Planner::new(settings, &velocity)?;
/// let simulator = BatchSimulator::new(Engine::new()?, &loaded);
/// let plan = planner.plan(&simulator, &start, &Launch { unit: 0 }, &cost, Control::none(&mut |_| {}))?;
/// assert!(plan.cost < 0.15, "{plan:?}");
/// assert_eq!((plan.iterations, plan.futures, plan.cut), (3, 96, None));
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
#[derive(Clone, Debug)]
pub struct Planner {
    settings: Settings,
    parameters: Vec<Parameter>,
    /// (parameters) where the next plan begins.
    initial: Vec<f32>,
    /// Plans so far: each has other noise.
    round: u64,
    search: Search,
    /// (samples, parameters) what the next plan tries first.
    proposed: Vec<f32>,
    /// (futures, parameters) of an iteration.
    samples: Vec<f32>,
    /// (futures) of an iteration.
    costs: Vec<f32>,
    /// (futures, steps, units) of a batch.
    poses: Vec<Isometry3<f32>>,
}

impl Planner {
    /// A planner for so many parameters.
    ///
    /// # Errors
    /// [`SettingsError`] says what is out of range.
    pub fn new(settings: Settings, parameters: &[Parameter]) -> Result<Self, SettingsError> {
        settings.check(parameters)?;
        let initial: Vec<f32> = parameters.iter().map(|parameter| parameter.mean).collect();
        let mut search = Search::default();
        search.begin(&initial, parameters);
        Ok(Planner {
            initial,
            parameters: parameters.to_vec(),
            settings,
            round: 0,
            search,
            proposed: Vec::new(),
            samples: Vec::new(),
            costs: Vec::new(),
            poses: Vec::new(),
        })
    }

    /// What it was made with.
    pub fn settings(&self) -> &Settings {
        &self.settings
    }

    /// (parameters) The mean that the next plan begins with.
    pub fn mean(&self) -> &[f32] {
        &self.initial
    }

    /// The next plan begins with this mean (and the deviations that the planner was made with), and with noise that no
    /// plan before it had.
    ///
    /// # Errors
    /// [`SettingsError`] for a mean of another size, or outside its bounds; the planner is what it was.
    pub fn set_mean(&mut self, mean: &[f32]) -> Result<(), SettingsError> {
        if mean.len() != self.parameters.len() {
            let (expected, found) = (self.parameters.len(), mean.len());
            return Err(SettingsError::Length { expected, found });
        }
        for (index, (mean, parameter)) in mean.iter().zip(&self.parameters).enumerate() {
            Parameter { mean: *mean, ..*parameter }.check(index)?;
        }
        self.initial.copy_from_slice(mean);
        self.search.mean.copy_from_slice(mean);
        self.round += 1;
        Ok(())
    }

    /// Receding horizon: `passed` steps of the last plan were carried out, so the next begins with its mean moved
    /// forward by as many, where parameters are (steps, `a_step`). What comes in at the end has the mean that the
    /// planner was made with. Deviations and noise are as after [`set_mean`](Self::set_mean).
    ///
    /// # Errors
    /// [`SettingsError::Length`] where the parameters are not a multiple of `a_step`; the planner is what it was.
    pub fn shift(&mut self, passed: usize, a_step: usize) -> Result<(), SettingsError> {
        let count = self.parameters.len();
        if a_step == 0 || !count.is_multiple_of(a_step) {
            let expected = count.next_multiple_of(a_step.max(1));
            return Err(SettingsError::Length { expected, found: count });
        }
        let moved = passed.saturating_mul(a_step);
        for (index, parameter) in self.parameters.iter().enumerate() {
            let from = index.checked_add(moved).and_then(|from| self.search.mean.get(from));
            let moved = from.copied().unwrap_or(parameter.mean);
            self.search.mean[index] = moved.clamp(parameter.low, parameter.high);
        }
        self.initial.copy_from_slice(&self.search.mean);
        self.round += 1;
        Ok(())
    }

    /// Searches for the parameters whose future from `start` costs least. The first future of each iteration tries the
    /// mean itself. Twice the same call gives the same plan; [`shift`](Self::shift) and [`set_mean`](Self::set_mean)
    /// move on.
    ///
    /// Where [`Control`] cuts it, the plan is the best so far, the mean that of the batches that were complete.
    ///
    /// # Errors
    /// [`PlanError`]
    pub fn plan(
        &mut self,
        simulator: &BatchSimulator,
        start: &Start<'_>,
        action: &impl Action,
        cost: &impl Cost,
        mut control: Control<'_>,
    ) -> Result<Plan, PlanError> {
        let futures = self.settings.futures;
        let mut run = Run {
            simulator,
            start,
            action,
            cost,
            steps: self.settings.steps,
            batches: Batches::new(start.count()),
            best: Best::default(),
            evaluated: 0,
            unusable: 0,
            why: None,
        };
        let mut poses = std::mem::take(&mut self.poses);
        let found = self.iterate(&mut control, |samples, costs, control| {
            let cut = run.iteration(samples, futures, costs, &mut poses, control)?;
            Ok::<_, PlanError>((cut, run.best.cost()))
        });
        self.poses = poses;
        let (iterations, cut) = found?;
        let Run { best, evaluated, unusable, why, .. } = run;
        if let (Some(cut), 0) = (cut, evaluated) {
            return Err(PlanError::Cut(cut));
        }
        let Some((cost, best, poses)) = best.0 else {
            let why = why.unwrap_or_default();
            return Err(PlanError::NoneUsable { futures: evaluated, why });
        };
        Ok(Plan {
            best,
            cost,
            poses,
            mean: self.search.mean.clone(),
            deviations: self.search.deviations.clone(),
            iterations,
            futures: evaluated,
            unusable,
            cut,
        })
    }

    /// As [`plan`](Self::plan), where the caller finds the costs: from another simulator, a model of its own or the
    /// world itself. `evaluate` gets (futures, parameters) samples and appends a cost for each, in order, infinite where
    /// a sample is of no use. It may say why it ends early, with fewer costs. [`Plan::poses`] is empty.
    ///
    /// ```
    /// use rigidformer_planning::planner::{Control, Parameter, PlanError, Planner, Settings};
    ///
    /// let mut planner = Planner::new(Settings::default(), &[Parameter::new(0.0, 1.0)])?;
    /// let plan = planner.plan_by(Control::none(&mut |_| {}), |samples, costs| {
    ///     costs.extend(samples.iter().map(|x| (x - 0.7) * (x - 0.7)));
    ///     Ok::<_, PlanError>(None)
    /// })?;
    /// assert!((plan.best[0] - 0.7).abs() < 0.01);
    /// # Ok::<(), Box<dyn std::error::Error>>(())
    /// ```
    ///
    /// # Errors
    /// [`PlanError`] where no sample was of use, or those of `evaluate`.
    pub fn plan_by<E: From<PlanError>>(
        &mut self,
        mut control: Control<'_>,
        mut evaluate: impl FnMut(&[f32], &mut Vec<f32>) -> Result<Option<Cut>, E>,
    ) -> Result<Plan, E> {
        let (width, futures) = (self.parameters.len(), self.settings.futures);
        let (mut best, mut evaluated, mut unusable) = (Best::default(), 0, 0);
        let (iterations, cut) = self.iterate(&mut control, |samples, costs, control| {
            if let Some(cut) = control.cut() {
                return Ok((Some(cut), best.cost()));
            }
            let cut = evaluate(samples, costs)?;
            costs.truncate(futures);
            for (parameters, cost) in samples.chunks_exact(width).zip(&mut *costs) {
                evaluated += 1;
                if !cost.is_finite() {
                    *cost = f32::INFINITY;
                    unusable += 1;
                }
                best.offer(*cost, parameters, &[]);
            }
            (control.watch)(Event::Batch(costs.len()));
            // Fewer costs than samples are a cut iteration, even where `evaluate` gives no reason.
            let cut = cut.or((costs.len() < futures).then_some(Cut::Cancelled));
            Ok::<_, E>((cut, best.cost()))
        })?;
        if let (Some(cut), 0) = (cut, evaluated) {
            return Err(PlanError::Cut(cut).into());
        }
        let Some((cost, best, poses)) = best.0 else {
            let why = "its cost is not finite".into();
            return Err(PlanError::NoneUsable { futures: evaluated, why }.into());
        };
        Ok(Plan {
            best,
            cost,
            poses,
            mean: self.search.mean.clone(),
            deviations: self.search.deviations.clone(),
            iterations,
            futures: evaluated,
            unusable,
            cut,
        })
    }

    /// The first iteration of the next plan tries these too, (samples, parameters), instead of as many of its own, after
    /// the mean: what is known to be worth a try, where one mean with deviations cannot say it. They hold for one plan;
    /// those that the futures have no room for are not tried.
    ///
    /// # Errors
    /// [`SettingsError`] for samples of another size or out of bounds; none are proposed then.
    pub fn propose(&mut self, samples: &[f32]) -> Result<(), SettingsError> {
        let width = self.parameters.len();
        if !samples.len().is_multiple_of(width) {
            let (expected, found) = (samples.len().next_multiple_of(width), samples.len());
            return Err(SettingsError::Length { expected, found });
        }
        for sample in samples.chunks_exact(width) {
            for (index, (mean, parameter)) in sample.iter().zip(&self.parameters).enumerate() {
                Parameter { mean: *mean, ..*parameter }.check(index)?;
            }
        }
        self.proposed.clear();
        self.proposed.extend_from_slice(samples);
        Ok(())
    }

    /// Samples and updates, iteration by iteration. `evaluate` gets (futures, parameters) samples, appends costs, and returns a reason to end
    /// and the least cost so far. Returns the complete iterations, and why there are no more.
    fn iterate<E>(
        &mut self,
        control: &mut Control<'_>,
        evaluate: impl FnMut(&[f32], &mut Vec<f32>, &mut Control<'_>) -> Result<(Option<Cut>, f32), E>,
    ) -> Result<(usize, Option<Cut>), E> {
        in_own_environment(|| self.search_by(control, evaluate))
    }

    fn search_by<E>(
        &mut self,
        control: &mut Control<'_>,
        mut evaluate: impl FnMut(
            &[f32],
            &mut Vec<f32>,
            &mut Control<'_>,
        ) -> Result<(Option<Cut>, f32), E>,
    ) -> Result<(usize, Option<Cut>), E> {
        let futures = self.settings.futures;
        self.search.begin(&self.initial, &self.parameters);
        let proposed = std::mem::take(&mut self.proposed);
        let (mut iterations, mut cut) = (0, None);
        while iterations < self.settings.iterations && cut.is_none() {
            let round = self.round.wrapping_mul(self.settings.iterations as u64);
            // Each future of each iteration of each plan has a stream of its own.
            let stream = round.wrapping_add(iterations as u64).wrapping_mul(futures as u64);
            let (seed, parameters) = (self.settings.seed, &self.parameters);
            self.search.sample(seed, stream, futures, parameters, &mut self.samples);
            // Later iterations have a mean that the proposals have already moved.
            if iterations == 0 {
                let own = self.samples.iter_mut().skip(parameters.len());
                own.zip(&proposed).for_each(|(sample, proposed)| *sample = *proposed);
            }
            self.costs.clear();
            let best_cost;
            (cut, best_cost) = match evaluate(&self.samples, &mut self.costs, control) {
                Ok(done) => done,
                // A failed plan keeps the proposals for the next one.
                Err(error) => {
                    self.proposed = proposed;
                    return Err(error);
                }
            };
            self.search.update(self.settings.method, &self.samples, &self.costs, parameters);
            if cut.is_none() {
                let iteration = Iteration {
                    index: iterations,
                    samples: &self.samples,
                    costs: &self.costs,
                    best_cost,
                    mean: &self.search.mean,
                    deviations: &self.search.deviations,
                };
                (control.watch)(Event::Iteration(iteration));
                iterations += 1;
            }
        }
        Ok((iterations, cut))
    }
}

/// Cost, parameters and poses of the best future.
#[derive(Default)]
struct Best(Option<(f32, Vec<f32>, Vec<Isometry3<f32>>)>);

impl Best {
    fn cost(&self) -> f32 {
        self.0.as_ref().map_or(f32::INFINITY, |(cost, ..)| *cost)
    }

    fn offer(&mut self, cost: f32, parameters: &[f32], poses: &[Isometry3<f32>]) {
        // Strictly less: of equal costs the first wins, whatever the order of batches.
        if cost < self.cost() {
            let (_, best, path) = self.0.take().unwrap_or_default();
            self.0 = Some((cost, refilled(best, parameters), refilled(path, poses)));
        }
    }
}

fn refilled<T: Clone>(mut vec: Vec<T>, with: &[T]) -> Vec<T> {
    vec.clear();
    vec.extend_from_slice(with);
    vec
}

/// A plan in the making.
struct Run<'r, A, C> {
    simulator: &'r BatchSimulator,
    start: &'r Start<'r>,
    action: &'r A,
    cost: &'r C,
    steps: usize,
    batches: Batches,
    best: Best,
    evaluated: usize,
    unusable: usize,
    /// What was wrong with the first that is of no use.
    why: Option<String>,
}

impl<A: Action, C: Cost> Run<'_, A, C> {
    /// Evaluates (futures, parameters) samples, batch by batch; `costs` are those of all complete batches.
    fn iteration(
        &mut self,
        samples: &[f32],
        futures: usize,
        costs: &mut Vec<f32>,
        poses: &mut Vec<Isometry3<f32>>,
        control: &mut Control<'_>,
    ) -> Result<Option<Cut>, PlanError> {
        let width = samples.len() / futures.max(1);
        while costs.len() < futures {
            if let Some(cut) = control.cut() {
                return Ok(Some(cut));
            }
            let Some(batch) = self.batches.next(futures - costs.len(), control.deadline) else {
                return Ok(Some(Cut::Deadline));
            };
            let began = Instant::now();
            let samples = &samples[costs.len() * width..][..batch * width];
            let (found, cut) = self.batch(samples, batch, poses, control)?;
            let complete = found.iter().flatten().count();
            (control.watch)(Event::Batch(complete));
            // The update uses complete batches alone.
            if complete < batch {
                return Ok(cut.or(Some(Cut::Cancelled)));
            }
            costs.extend(found.into_iter().flatten());
            self.batches.took(batch, began.elapsed().as_secs_f64());
        }
        Ok(None)
    }

    /// The cost of each sample of a batch, none for those that were cut, and why they were.
    fn batch(
        &mut self,
        samples: &[f32],
        batch: usize,
        poses: &mut Vec<Isometry3<f32>>,
        control: &Control<'_>,
    ) -> Result<(Vec<Option<f32>>, Option<Cut>), PlanError> {
        let width = samples.len() / batch.max(1);
        let units = self.start.count();
        let row = self.steps.saturating_mul(units);
        poses.clear();
        poses.resize(batch.saturating_mul(row), Isometry3::identity());
        let sampled = Sampled {
            action: self.action,
            cost: self.cost,
            samples,
            width,
            steps: self.steps,
            deadline: control.deadline,
            cancelled: control.cancelled,
            cut: (0..batch).map(|_| AtomicBool::new(false)).collect(),
        };
        let outcomes = self.simulator.run(self.start, self.steps, &sampled, poses)?;
        let cost_of = |(future, outcome): (usize, &Outcome)| {
            let stopped = match outcome.end {
                End::Failed(_) | End::Refused(_) => return Some(f32::INFINITY),
                End::Cut => return None,
                _ if sampled.cut[future].load(Ordering::Relaxed) => return None,
                End::Stopped => true,
                End::Complete => false,
            };
            let parameters = sampled.parameters(future);
            let poses = &poses[future * row..][..outcome.steps * units];
            let cost = self.cost.cost(&Trial { parameters, poses, units, stopped });
            Some(if cost.is_finite() { cost } else { f32::INFINITY })
        };
        let costs: Vec<Option<f32>> = if self.cost.is_serial() || !pool::is_there() {
            outcomes.iter().enumerate().map(cost_of).collect()
        } else {
            let cost_of = |outcome| in_own_environment(|| cost_of(outcome));
            pool::enter(|| outcomes.par_iter().enumerate().map(cost_of).collect())
        };
        for (future, (cost, outcome)) in costs.iter().zip(&outcomes).enumerate() {
            let Some(cost) = *cost else { continue };
            self.evaluated += 1;
            if cost == f32::INFINITY {
                self.unusable += 1;
                // One reason suffices for the error, and a text for each future would be slow.
                self.why.get_or_insert_with(|| reason(outcome));
            }
            let poses = &poses[future * row..][..outcome.steps * units];
            self.best.offer(cost, &samples[future * width..][..width], poses);
        }
        Ok((costs, control.cut()))
    }
}

/// Why a future has no finite cost.
fn reason(outcome: &Outcome) -> String {
    match &outcome.end {
        End::Failed(error) => format!("after {} steps: {error}", outcome.steps),
        End::Refused(error) => format!("its action was refused: {error}"),
        End::Complete | End::Stopped | End::Cut => "its cost is not finite".into(),
    }
}

/// Futures of a batch of samples.
struct Sampled<'s, A, C> {
    action: &'s A,
    cost: &'s C,
    /// (futures, width)
    samples: &'s [f32],
    width: usize,
    steps: usize,
    deadline: Option<Instant>,
    cancelled: &'s AtomicBool,
    /// (futures) Whether the deadline ended it, rather than its cost.
    cut: Vec<AtomicBool>,
}

impl<A, C> Sampled<'_, A, C> {
    fn parameters(&self, future: usize) -> &[f32] {
        &self.samples[future * self.width..][..self.width]
    }
}

impl<A: Action, C: Cost> Variation for Sampled<'_, A, C> {
    fn begin(&self, future: usize, scene: &mut FutureScene<'_>) -> Result<(), ChangeError> {
        self.action.begin(self.parameters(future), scene)
    }

    fn steer(
        &self,
        future: usize,
        step: usize,
        scene: &mut FutureScene<'_>,
    ) -> Result<(), ChangeError> {
        self.action.steer(self.parameters(future), step, scene)
    }

    fn is_cut(&self) -> bool {
        cut(self.deadline, self.cancelled).is_some()
    }

    fn watch(&self, future: usize, step: usize, poses: &[Isometry3<f32>]) -> ControlFlow<()> {
        // The cost's own end comes first, so that it does not count as cut.
        self.cost.watch(step, poses)?;
        if step + 1 < self.steps && cut(self.deadline, self.cancelled).is_some() {
            self.cut[future].store(true, Ordering::Relaxed);
            return ControlFlow::Break(());
        }
        ControlFlow::Continue(())
    }
}

/// Sizes of batches.
struct Batches {
    largest: usize,
    next: usize,
    /// Of one future, in the last batch.
    seconds: f64,
}

impl Batches {
    fn new(units: usize) -> Self {
        let threads = pool::size();
        let largest = (UNITS_PER_THREAD / units.max(1)).max(1) * threads;
        Batches { largest, next: (FIRST_FUTURES_PER_THREAD * threads).min(largest), seconds: 0.0 }
    }

    /// Size of the next batch, of `left` futures; none where it would miss the deadline.
    fn next(&self, left: usize, deadline: Option<Instant>) -> Option<usize> {
        let Some(deadline) = deadline else { return Some(left.min(self.largest)) };
        let time_left = deadline.saturating_duration_since(Instant::now()).as_secs_f64();
        let fitting = if self.seconds > 0.0 { (time_left / self.seconds) as usize } else { left };
        Some(left.min(self.next).min(fitting)).filter(|batch| *batch > 0)
    }

    fn took(&mut self, batch: usize, seconds: f64) {
        // The latest batch has the present speed of the machine.
        self.seconds = seconds / batch.max(1) as f64;
        self.next = self.next.max(batch.saturating_mul(MAX_GROWTH)).min(self.largest);
    }
}
