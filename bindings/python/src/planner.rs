//! Planners.

use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Mutex, MutexGuard, TryLockError};
use std::time::{Duration, Instant};

use numpy::PyArrayDyn;
use pyo3::prelude::*;
use pyo3::types::PyTuple;
use rigidformer_planning::planner::{
    self, Action, Control, Cost, Method, PlanError, Settings, Trial,
};
use rigidformer_runtime::futures::{ChangeError, FutureScene};

use crate::arrays::{self, Floats, POSE};
use crate::errors::{OrRaise, input, raise};
use crate::futures::{BatchSimulator, Start};
use crate::interrupt::{held, interruptible};
use crate::whole;

/// One number to choose.
///
/// Parameters
/// ----------
/// mean : float
///     Around which the first iteration tries; within the bounds.
/// deviation : float
///     How far around, as a standard deviation; 0 keeps the parameter at its mean.
/// low, high : float
///     Bounds; samples beyond one are put on it.
///
/// Source: ``planning/src/planner/settings.rs``.
#[pyclass(frozen, get_all, module = "rigidformer")]
pub(crate) struct Parameter {
    mean: f32,
    deviation: f32,
    low: f32,
    high: f32,
}

#[pymethods]
impl Parameter {
    #[new]
    #[pyo3(signature = (mean, deviation, low = f32::NEG_INFINITY, high = f32::INFINITY))]
    fn new(mean: f32, deviation: f32, low: f32, high: f32) -> Self {
        Parameter { mean, deviation, low, high }
    }

    fn __getnewargs__(&self) -> (f32, f32, f32, f32) {
        (self.mean, self.deviation, self.low, self.high)
    }

    fn __repr__(&self) -> String {
        let Parameter { mean, deviation, low, high } = self;
        format!("Parameter({mean}, {deviation}, low={low}, high={high})")
    }
}

/// Model predictive path integral control: the mean of all samples, weighted by exp(-cost / temperature).
///
/// Parameters
/// ----------
/// temperature : float
///     In the cost's own measure, above 0: what a difference of cost matters.
/// narrowing : float
///     Deviations are multiplied by it after each iteration; above 0, at most 1.
///
/// Source: ``planning/src/planner/settings.rs``.
#[pyclass(frozen, get_all, module = "rigidformer")]
pub(crate) struct Mppi {
    temperature: f32,
    narrowing: f32,
}

#[pymethods]
impl Mppi {
    #[new]
    #[pyo3(signature = (temperature, narrowing = 0.7))]
    fn new(temperature: f32, narrowing: f32) -> Self {
        Mppi { temperature, narrowing }
    }

    fn __getnewargs__(&self) -> (f32, f32) {
        (self.temperature, self.narrowing)
    }
}

/// The cross-entropy method: mean and deviations of the elite, those that cost least.
///
/// Parameters
/// ----------
/// elite : float
///     Which share of the futures is the elite, above 0, at most 1.
/// smoothing : float
///     What share of the old mean and deviations stays, from 0 to below 1.
///
/// Source: ``planning/src/planner/settings.rs``.
#[pyclass(frozen, get_all, module = "rigidformer")]
pub(crate) struct Cem {
    elite: f32,
    smoothing: f32,
}

#[pymethods]
impl Cem {
    #[new]
    #[pyo3(signature = (elite = 0.1, smoothing = 0.2))]
    fn new(elite: f32, smoothing: f32) -> Self {
        Cem { elite, smoothing }
    }

    fn __getnewargs__(&self) -> (f32, f32) {
        (self.elite, self.smoothing)
    }
}

/// An action: a unit is let go with a velocity: three parameters, m/s in the world's axes, or six, with its spin in rad/s.
///
/// Parameters
/// ----------
/// unit : int
///     By its number in the start, from 0.
#[pyclass(frozen, get_all, module = "rigidformer")]
pub(crate) struct Launch {
    unit: usize,
}

#[pymethods]
impl Launch {
    #[new]
    fn new(#[pyo3(from_py_with = whole::unit)] unit: usize) -> Self {
        Launch { unit }
    }

    fn __getnewargs__(&self) -> (usize,) {
        (self.unit,)
    }
}

/// An action: commands for models that take one: parameters are (commands, size). After the last the scene keeps it.
///
/// Parameters
/// ----------
/// size : int
///     Numbers in a command.
/// hold : int
///     Steps that one lasts, at least 1.
#[pyclass(frozen, get_all, module = "rigidformer")]
pub(crate) struct Commands {
    size: usize,
    hold: usize,
}

#[pymethods]
impl Commands {
    #[new]
    #[pyo3(signature = (size, hold = 1))]
    fn new(
        #[pyo3(from_py_with = whole::size)] size: usize,
        #[pyo3(from_py_with = whole::hold)] hold: usize,
    ) -> Self {
        Commands { size, hold }
    }

    fn __getnewargs__(&self) -> (usize, usize) {
        (self.size, self.hold)
    }
}

/// One of the actions.
#[derive(FromPyObject)]
enum AnyAction<'py> {
    Launch(Bound<'py, Launch>),
    Commands(Bound<'py, Commands>),
}

/// The same without the interpreter.
#[derive(Clone, Copy)]
enum OwnedAction {
    Launch(planner::Launch),
    Commands(planner::HeldCommands),
}

impl From<AnyAction<'_>> for OwnedAction {
    fn from(action: AnyAction<'_>) -> Self {
        match action {
            AnyAction::Launch(launch) => {
                OwnedAction::Launch(planner::Launch { unit: launch.get().unit })
            }
            AnyAction::Commands(commands) => {
                let Commands { size, hold } = *commands.get();
                OwnedAction::Commands(planner::HeldCommands { size, steps: hold })
            }
        }
    }
}

impl Action for OwnedAction {
    fn begin(&self, parameters: &[f32], scene: &mut FutureScene<'_>) -> Result<(), ChangeError> {
        match self {
            OwnedAction::Launch(launch) => launch.begin(parameters, scene),
            OwnedAction::Commands(commands) => commands.begin(parameters, scene),
        }
    }

    fn steer(
        &self,
        parameters: &[f32],
        step: usize,
        scene: &mut FutureScene<'_>,
    ) -> Result<(), ChangeError> {
        match self {
            OwnedAction::Launch(launch) => launch.steer(parameters, step, scene),
            OwnedAction::Commands(commands) => commands.steer(parameters, step, scene),
        }
    }
}

/// A cost in Python. The first exception ends the planning.
struct PythonCost<'c> {
    cost: Py<PyAny>,
    raised: Mutex<Option<PyErr>>,
    cancelled: &'c AtomicBool,
}

impl Cost for PythonCost<'_> {
    fn cost(&self, trial: &Trial<'_>) -> f32 {
        // After the first exception no further cost is asked for.
        if self.cancelled.load(Ordering::Relaxed) {
            return f32::INFINITY;
        }
        let cost = Python::attach(|py| {
            let parameters =
                arrays::array(py, trial.parameters.to_vec(), &[trial.parameters.len()])?;
            let shape = [trial.steps(), trial.units];
            let poses = arrays::array_of_poses(py, trial.poses, &shape)?;
            self.cost.bind(py).call1((parameters, poses))?.extract::<f32>()
        });
        // An infinite cost is never chosen, and the exception ends the planning.
        cost.unwrap_or_else(|error| {
            self.cancelled.store(true, Ordering::Relaxed);
            if let Ok(mut raised) = self.raised.lock() {
                // The first exception is the cause, and later ones may follow from it.
                raised.get_or_insert(error);
            }
            f32::INFINITY
        })
    }

    // The interpreter runs one at a time anyway. A cost that predicts waits for rayon's threads,
    // which it must not hold.
    fn is_serial(&self) -> bool {
        true
    }
}

/// Chooses parameters by trying them in the model: samples them, rolls a future out for each, and samples again around those that
/// cost little. The same seed gives the same plan, to the bit, on any number of threads, unless a deadline cut it.
///
/// Parameters
/// ----------
/// parameters : sequence of Parameter
///     What to choose.
/// method : Mppi or Cem, optional
///     How the next iteration follows from the last; None: ``Cem()``.
/// futures, iterations, steps : int
///     Futures an iteration, iterations, and steps that each future is followed, at most 16,384; each at least 1.
/// seed : int
///     Another seed, other samples.
///
/// Raises
/// ------
/// InputError
///     Something is out of range.
///
/// Source: ``planning/src/planner.rs``, ``docs/PLANNING.md``.
///
/// >>> import numpy as np, rigidformer as rf
/// >>> corners = 0.2 * np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)], np.float32)
/// >>> rest = [[0, 0, 1.5, 1, 0, 0, 0]]
/// >>> start = rf.Start(1 / 24, [rf.Unit(corners)], rest, rest)
/// >>> goal = np.array([0.3, 0.0, 1.4])
/// >>> def cost(parameters, poses):  # how near the cube comes
/// ...     return np.linalg.norm(poses[:, 0, :3] - goal, axis=1).min()
/// >>> planner = rf.Planner([rf.Parameter(0, 2, -4, 4)] * 3, futures=32, iterations=3, steps=4)
/// >>> plan = planner.plan(rf.BatchSimulator(rf.Model("edge")), start, rf.Launch(0), cost)
/// >>> plan.cost < 0.15, plan.futures
/// (True, 96)
#[pyclass(frozen, module = "rigidformer")]
pub(crate) struct Planner {
    planner: Mutex<planner::Planner>,
}

/// Parameters of all futures of an iteration, at most: 256 MiB.
// An allocation that fails ends the process, and Python expects an exception.
pub(crate) const MOST_NUMBERS: usize = 1 << 26;
/// Steps of a future, at most: 230 MiB a thread for the poses of those that are rolled out together.
// An allocation that fails ends the process, and Python expects an exception.
const MOST_STEPS: usize = 1 << 14;

/// An error where futures are followed farther than there is memory for, which would end the process.
pub(crate) fn within_room(steps: usize) -> PyResult<()> {
    match steps > MOST_STEPS {
        true => Err(input(format!("futures of {steps} steps; give at most {MOST_STEPS} steps"))),
        false => Ok(()),
    }
}

/// A planner that is free. Not waited for: a cost that called its own planner would wait for good.
pub(crate) fn lock_planner<T>(planner: &Mutex<T>) -> PyResult<MutexGuard<'_, T>> {
    // Not waited for: a cost that calls its own planner would wait for ever.
    planner.try_lock().map_err(|error| match error {
        TryLockError::WouldBlock => input("the planner is planning; use one a thread"),
        TryLockError::Poisoned(_) => {
            input("a call on this planner failed with a fault of the library; make a new one")
        }
    })
}

/// One of the methods.
#[derive(FromPyObject)]
pub(crate) enum AnyMethod<'py> {
    Mppi(Bound<'py, Mppi>),
    Cem(Bound<'py, Cem>),
}

impl From<AnyMethod<'_>> for Method {
    fn from(search: AnyMethod<'_>) -> Self {
        match search {
            AnyMethod::Mppi(mppi) => {
                let Mppi { temperature, narrowing } = *mppi.get();
                Method::Mppi { temperature, narrowing }
            }
            AnyMethod::Cem(cem) => {
                let Cem { elite, smoothing } = *cem.get();
                Method::Cem { elite, smoothing }
            }
        }
    }
}

/// An instant so far ahead.
pub(crate) fn deadline(seconds: Option<f64>) -> PyResult<Option<Instant>> {
    let Some(seconds) = seconds else { return Ok(None) };
    let ahead = Duration::try_from_secs_f64(seconds).ok();
    // Seconds from Python may be negative, NaN or beyond what a clock holds.
    let instant = ahead.and_then(|ahead| Instant::now().checked_add(ahead));
    let instant = instant.ok_or_else(|| {
        input(format!("deadline_s is {seconds}; give seconds from now, at least 0"))
    })?;
    Ok(Some(instant))
}

#[pymethods]
impl Planner {
    #[new]
    #[pyo3(signature = (parameters, *, method = None, futures = 256, iterations = 4, steps = 10, seed = 1))]
    fn new(
        parameters: Vec<Bound<'_, Parameter>>,
        method: Option<AnyMethod<'_>>,
        #[pyo3(from_py_with = whole::futures)] futures: usize,
        #[pyo3(from_py_with = whole::iterations)] iterations: usize,
        #[pyo3(from_py_with = whole::steps)] steps: usize,
        #[pyo3(from_py_with = whole::seed)] seed: u64,
    ) -> PyResult<Self> {
        // An allocation that fails ends the process, and Python expects an exception.
        let numbers = futures.checked_mul(parameters.len().max(1));
        if numbers.is_none_or(|numbers| numbers > MOST_NUMBERS) {
            return Err(input(format!(
                "{futures} futures of {} parameters; give at most {MOST_NUMBERS} numbers",
                parameters.len()
            )));
        }
        within_room(steps)?;
        let method = method.map_or_else(Method::cem, Method::from);
        let settings = Settings { method, futures, iterations, steps, seed };
        let parameters = parameters.iter().map(|parameter| {
            let Parameter { mean, deviation, low, high } = *parameter.get();
            planner::Parameter { mean, deviation, low, high }
        });
        let parameters: Vec<_> = parameters.collect();
        let planner = held(|| planner::Planner::new(settings, &parameters))?;
        Ok(Planner { planner: Mutex::new(planner.or_raise()?) })
    }

    /// Searches for the parameters whose future from ``start`` costs least. Twice the same call gives the same plan; ``shift`` and
    /// ``set_mean`` move on.
    ///
    /// Parameters
    /// ----------
    /// simulator : BatchSimulator
    /// start : Start
    /// action : Launch or Commands
    ///     What parameters do to a future.
    /// cost : callable
    ///     Gets parameters (p,) and poses (steps taken, units, 7), both float32, and returns a number; less is better. It is called
    ///     from one other thread, for one future after the other, and may predict. A cost that is not finite is worse than all others.
    /// deadline_s : float, optional
    ///     Seconds from now by which it ends, with the best so far.
    ///
    /// Returns
    /// -------
    /// Plan
    ///
    /// Raises
    /// ------
    /// InputError
    ///     The start cannot be, no future has a finite cost, or the deadline came before the first.
    /// KeyboardInterrupt
    ///     Ctrl-C, within a step.
    /// Exception
    ///     Whatever ``cost`` raises.
    #[pyo3(signature = (simulator, start, action, cost, *, deadline_s = None))]
    fn plan(
        &self,
        py: Python<'_>,
        simulator: &BatchSimulator,
        start: &Start,
        action: AnyAction<'_>,
        cost: Py<PyAny>,
        deadline_s: Option<f64>,
    ) -> PyResult<Plan> {
        let action = OwnedAction::from(action);
        let deadline = deadline(deadline_s)?;
        let posed = start.posed();
        let begin = start.view(&posed);
        let units = start.units();
        let found = interruptible(py, |cancelled| {
            let cost = PythonCost { cost, raised: Mutex::new(None), cancelled };
            let control = Control { deadline, cancelled, watch: &mut |_| {} };
            let plan = lock_planner(&self.planner)?.plan(
                &simulator.simulator,
                &begin,
                &action,
                &cost,
                control,
            );
            // The exception of a cost comes before the planner's, which says only that it was
            // stopped.
            match cost.raised.into_inner() {
                Ok(Some(error)) => Err(error),
                _ => plan.or_raise(),
            }
        })??;
        Plan::new(py, &found, units)
    }

    /// As ``plan``, where you find the costs: from another simulator, a model of your own or the world itself.
    ///
    /// Parameters
    /// ----------
    /// evaluate : callable
    ///     Gets samples (futures, parameters), float32, and returns (futures,) costs, infinite where a sample is of no use.
    /// deadline_s : float, optional
    ///     Looked at between iterations.
    ///
    /// Returns
    /// -------
    /// Plan
    ///     Without poses.
    ///
    /// Raises
    /// ------
    /// InputError
    ///     No cost is finite, or there are not as many costs as samples.
    /// Exception
    ///     Whatever ``evaluate`` raises.
    ///
    /// >>> import rigidformer as rf
    /// >>> planner = rf.Planner([rf.Parameter(0, 1)])
    /// >>> plan = planner.plan_by(lambda samples: (samples[:, 0] - 0.7) ** 2)
    /// >>> abs(float(plan.best[0]) - 0.7) < 0.01
    /// True
    #[pyo3(signature = (evaluate, *, deadline_s = None))]
    fn plan_by(
        &self,
        py: Python<'_>,
        evaluate: &Bound<'_, PyAny>,
        deadline_s: Option<f64>,
    ) -> PyResult<Plan> {
        let mut planner = lock_planner(&self.planner)?;
        let (futures, width) = (planner.settings().futures, planner.mean().len());
        let mut watch = |_: planner::Event<'_>| {};
        let control = Control { deadline: deadline(deadline_s)?, ..Control::none(&mut watch) };
        let found = planner.plan_by(control, |samples, costs| {
            // A copy: the caller may keep it, and the planner reuses its memory.
            let samples = arrays::array(py, samples.to_vec(), &[futures, width])?;
            let found = evaluate.call1((samples,))?;
            costs.extend_from_slice(Floats::of(&found, "costs", &[Some(futures)])?.slice()?);
            Ok::<_, PlanFault>(None)
        });
        Plan::new(py, &found.map_err(|fault| fault.0)?, 0)
    }

    /// Receding horizon: ``passed`` steps of the last plan were carried out; the next begins with its mean moved forward by as many,
    /// where parameters are (steps, ``a_step``).
    ///
    /// Raises
    /// ------
    /// InputError
    ///     The parameters are not a multiple of ``a_step``.
    fn shift(
        &self,
        #[pyo3(from_py_with = whole::passed)] passed: usize,
        #[pyo3(from_py_with = whole::a_step)] a_step: usize,
    ) -> PyResult<()> {
        let mut planner = lock_planner(&self.planner)?;
        held(|| planner.shift(passed, a_step))?.or_raise()
    }

    /// The next plan begins with this mean.
    ///
    /// Raises
    /// ------
    /// InputError
    ///     It has another size, or is out of bounds.
    fn set_mean(&self, mean: &Bound<'_, PyAny>) -> PyResult<()> {
        let mean = Floats::of(mean, "mean", &[None])?;
        let (mean, mut planner) = (mean.slice()?, lock_planner(&self.planner)?);
        held(|| planner.set_mean(mean))?.or_raise()
    }

    /// The first iteration of the next plan tries these samples, (n, parameters), too.
    ///
    /// Raises
    /// ------
    /// InputError
    ///     They have another size, or are out of bounds.
    fn propose(&self, samples: &Bound<'_, PyAny>) -> PyResult<()> {
        let mut planner = lock_planner(&self.planner)?;
        let samples = Floats::of(samples, "samples", &[None, Some(planner.mean().len())])?;
        let samples = samples.slice()?;
        held(|| planner.propose(samples))?.or_raise()
    }

    /// float32 (parameters,): the mean that the next plan begins with.
    #[getter]
    fn mean<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyArrayDyn<f32>>> {
        arrays::read_only(numbers(py, lock_planner(&self.planner)?.mean())?)
    }
}

/// An exception of the caller's, or of the planner.
struct PlanFault(PyErr);

impl From<PyErr> for PlanFault {
    fn from(error: PyErr) -> Self {
        PlanFault(error)
    }
}

impl From<PlanError> for PlanFault {
    fn from(error: PlanError) -> Self {
        PlanFault(raise(error))
    }
}

pub(crate) fn numbers<'py>(
    py: Python<'py>,
    numbers: &[f32],
) -> PyResult<Bound<'py, PyArrayDyn<f32>>> {
    arrays::array(py, numbers.to_vec(), &[numbers.len()])
}

/// What a planner found. Also made of its attributes, in this order.
///
/// Attributes
/// ----------
/// best : array of float32, (parameters,)
///     The best that was tried.
/// cost : float
///     Its cost.
/// poses : array of float32, (steps taken, units, 7), or None
///     Its future, where the planner rolled it out.
/// mean, deviations : arrays of float32, (parameters,)
///     After the last iteration; the mean was not tried itself.
/// iterations : int
///     Complete ones.
/// futures : int
///     Evaluated, those of an incomplete iteration too.
/// unusable : int
///     Those of them that failed, were refused, or cost no finite number.
/// cut : str or None
///     Why it is not the plan of all iterations, if it is not.
#[pyclass(frozen, get_all, module = "rigidformer")]
pub(crate) struct Plan {
    best: Py<PyArrayDyn<f32>>,
    cost: f32,
    poses: Option<Py<PyArrayDyn<f32>>>,
    mean: Py<PyArrayDyn<f32>>,
    deviations: Py<PyArrayDyn<f32>>,
    iterations: usize,
    futures: usize,
    unusable: usize,
    cut: Option<String>,
}

impl Plan {
    pub(crate) fn new(py: Python<'_>, plan: &planner::Plan, units: usize) -> PyResult<Self> {
        let poses = match plan.poses.len().checked_div(units) {
            Some(steps) => Some(arrays::array_of_poses(py, &plan.poses, &[steps, units])?.unbind()),
            None => None,
        };
        Ok(Plan {
            best: numbers(py, &plan.best)?.unbind(),
            cost: plan.cost,
            poses,
            mean: numbers(py, &plan.mean)?.unbind(),
            deviations: numbers(py, &plan.deviations)?.unbind(),
            iterations: plan.iterations,
            futures: plan.futures,
            unusable: plan.unusable,
            cut: plan.cut.map(|cut| cut.to_string()),
        })
    }
}

impl Plan {
    /// As Rust has it, with its poses and their units.
    pub(crate) fn found(&self, py: Python<'_>) -> PyResult<(planner::Plan, usize)> {
        let numbers = |array: &Py<PyArrayDyn<f32>>, name| {
            Ok::<_, PyErr>(Floats::of(array.bind(py), name, &[None])?.slice()?.to_vec())
        };
        let (poses, units) = match &self.poses {
            Some(poses) => {
                let poses = Floats::of(poses.bind(py), "poses", &[None, None, Some(POSE)])?;
                let rows = poses.slice()?.chunks_exact(POSE).map(arrays::pose_of).collect();
                (rows, poses.side(1))
            }
            None => (Vec::new(), 0),
        };
        let plan = planner::Plan {
            best: numbers(&self.best, "best")?,
            cost: self.cost,
            poses,
            mean: numbers(&self.mean, "mean")?,
            deviations: numbers(&self.deviations, "deviations")?,
            iterations: self.iterations,
            futures: self.futures,
            unusable: self.unusable,
            cut: self.cut.as_deref().map(cut_of).transpose()?,
        };
        Ok((plan, units))
    }
}

/// Why a plan ended early, by what it says.
fn cut_of(text: &str) -> PyResult<planner::Cut> {
    let all = [planner::Cut::Deadline, planner::Cut::Cancelled];
    let found = all.into_iter().find(|cut| cut.to_string() == text);
    found.ok_or_else(|| {
        input(format!("cut is {text:?}; give one of {:?} or None", all.map(|cut| cut.to_string())))
    })
}

#[pymethods]
impl Plan {
    #[new]
    #[expect(clippy::too_many_arguments, reason = "a plan has as many")]
    fn made(
        py: Python<'_>,
        best: Bound<'_, PyArrayDyn<f32>>,
        cost: f32,
        poses: Option<Bound<'_, PyArrayDyn<f32>>>,
        mean: Bound<'_, PyArrayDyn<f32>>,
        deviations: Bound<'_, PyArrayDyn<f32>>,
        #[pyo3(from_py_with = whole::iterations)] iterations: usize,
        #[pyo3(from_py_with = whole::futures)] futures: usize,
        #[pyo3(from_py_with = whole::unusable)] unusable: usize,
        cut: Option<String>,
    ) -> PyResult<Self> {
        let (best, mean, deviations) = (best.unbind(), mean.unbind(), deviations.unbind());
        let poses = poses.map(Bound::unbind);
        let plan = Plan { best, cost, poses, mean, deviations, iterations, futures, unusable, cut };
        let (found, _) = plan.found(py)?;
        let width = Some(found.best.len());
        for (name, numbers) in [("mean", &found.mean), ("deviations", &found.deviations)] {
            if Some(numbers.len()) != width {
                return Err(arrays::misshapen(name, &[numbers.len()], &[width]));
            }
        }
        Ok(plan)
    }

    fn __getnewargs__<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyTuple>> {
        let clone = |array: &Py<PyArrayDyn<f32>>| array.clone_ref(py);
        (
            clone(&self.best),
            self.cost,
            self.poses.as_ref().map(clone),
            clone(&self.mean),
            clone(&self.deviations),
            self.iterations,
            self.futures,
            self.unusable,
            self.cut.clone(),
        )
            .into_pyobject(py)
    }

    fn __repr__(&self) -> String {
        format!(
            "Plan(cost={}, {} futures, {} iterations)",
            self.cost, self.futures, self.iterations
        )
    }
}
