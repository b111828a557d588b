//! The planner for walking.

use std::sync::Mutex;

use nalgebra::Isometry3;
use numpy::PyArrayDyn;
use pyo3::prelude::*;
use pyo3::types::PyTuple;
use rigidformer_planning::planner::Control;
use rigidformer_planning::planner::walking::{self, COMMAND, Goal, WalkSettings};

use crate::arrays::{self, Floats};
use crate::errors::{OrRaise, input};
use crate::futures::{BatchSimulator, Start};
use crate::interrupt::{held, interruptible};
use crate::planner::{AnyMethod, MOST_NUMBERS, Plan, deadline, lock_planner, numbers, within_room};
use crate::whole;

/// Plans by which commands (forward and left speed, m/s, and turn, rad/s, in its heading) a walking robot comes to a place. Plan anew
/// whenever the robot is seen, and say by ``passed`` how many steps went by: what is left of the last plan is tried first. The same calls
/// in the same order give the same plans, to the bit, on any number of threads, unless a deadline cut one.
///
/// Parameters
/// ----------
/// method : Mppi or Cem, optional
///     None: ``Mppi(0.01, 0.5)``.
/// futures, iterations : int
///     Futures an iteration, and iterations; each at least 1.
/// commands, hold : int
///     Commands of a plan, and steps that each lasts; each at least 1, at most 16,384 steps together.
/// seed : int
///     Another seed, other samples.
/// low, high : arrays, (3,), optional
///     Bounds of a command. None: those of the G1's walks, -0.7, -0.5, -1 and 0.9, 0.5, 1.
///
/// Raises
/// ------
/// InputError, TypeError
///     Something is out of range.
///
/// Source: ``planning/src/planner/walking.rs``, ``docs/PLANNING.md``.
///
/// With a robot that was seen twice, such as ``start = rf.Start.of_scene(scene, join=True)``::
///
///     simulator = rf.BatchSimulator(rf.Model("g1.rfm"))  # once
///     plan = planner.plan(simulator, start, [2.0, 1.0])  # each time that it is seen
///     robot.send(plan.command)                           # whatever carries it out
///     planner.passed(1)
///
/// >>> import rigidformer as rf
/// >>> planner = rf.WalkPlanner(futures=32, commands=2)
/// >>> planner.begin_with([[0.5, 0, 0]])  # straight on, to begin with
#[pyclass(frozen, module = "rigidformer")]
pub(crate) struct WalkPlanner {
    planner: Mutex<walking::WalkPlanner>,
}

#[pymethods]
impl WalkPlanner {
    #[new]
    #[pyo3(signature = (*, method = None, futures = 16, iterations = 2, commands = 3, hold = 3, seed = 1, low = None, high = None))]
    #[expect(clippy::too_many_arguments, reason = "Python's are named")]
    fn new(
        method: Option<AnyMethod<'_>>,
        #[pyo3(from_py_with = whole::futures)] futures: usize,
        #[pyo3(from_py_with = whole::iterations)] iterations: usize,
        #[pyo3(from_py_with = whole::commands)] commands: usize,
        #[pyo3(from_py_with = whole::hold)] hold: usize,
        #[pyo3(from_py_with = whole::seed)] seed: u64,
        low: Option<&Bound<'_, PyAny>>,
        high: Option<&Bound<'_, PyAny>>,
    ) -> PyResult<Self> {
        // An allocation that fails ends the process, and Python expects an exception.
        let numbers = commands.checked_mul(COMMAND).and_then(|width| width.checked_mul(futures));
        if numbers.is_none_or(|numbers| numbers > MOST_NUMBERS) {
            return Err(input(format!(
                "{futures} futures of {commands} commands; give at most {MOST_NUMBERS} numbers, three a command"
            )));
        }
        within_room(commands.saturating_mul(hold))?;
        let usual = WalkSettings::default();
        let bound = |value: Option<&Bound<'_, PyAny>>, name, usual| match value {
            Some(value) => arrays::vector(value, name).map(Into::into),
            None => Ok(usual),
        };
        let settings = WalkSettings {
            method: method.map_or(usual.method, Into::into),
            futures,
            iterations,
            commands,
            hold,
            seed,
            low: bound(low, "low", usual.low)?,
            high: bound(high, "high", usual.high)?,
        };
        let planner = held(|| walking::WalkPlanner::new(settings))?.or_raise()?;
        Ok(WalkPlanner { planner: Mutex::new(planner) })
    }

    /// Searches for the commands that bring the robot to a place soonest and keep it there.
    ///
    /// Parameters
    /// ----------
    /// simulator : BatchSimulator
    ///     With the model of a walking robot.
    /// start : Start
    ///     The robot's links as they were seen; the heaviest free one leads. Its command is not used.
    /// place_m : array, (2,)
    ///     On the ground, metres: where the heaviest link shall be above.
    /// heading_rad : float, optional
    ///     Which way it shall look there, radians from x towards y. None: any.
    /// deadline_s : float, optional
    ///     Seconds from now by which it ends, with the best so far.
    ///
    /// Returns
    /// -------
    /// WalkPlan
    ///
    /// Raises
    /// ------
    /// InputError, TypeError
    ///     The model takes no such commands, nothing is free, the place or the start cannot be, or the deadline came before the first
    ///     future.
    /// KeyboardInterrupt
    ///     Ctrl-C, within a step.
    #[pyo3(signature = (simulator, start, place_m, heading_rad = None, *, deadline_s = None))]
    fn plan(
        &self,
        py: Python<'_>,
        simulator: &BatchSimulator,
        start: &Start,
        place_m: &Bound<'_, PyAny>,
        heading_rad: Option<f32>,
        deadline_s: Option<f64>,
    ) -> PyResult<WalkPlan> {
        let goal = Goal { place_m: arrays::pair(place_m, "place_m")?, heading_rad };
        let deadline = deadline(deadline_s)?;
        let posed = start.posed();
        let begin = start.view(&posed);
        let plan = interruptible(py, |cancelled| {
            let control = Control { deadline, cancelled, watch: &mut |_| {} };
            lock_planner(&self.planner)?
                .plan(&simulator.simulator, &begin, &goal, control)
                .or_raise()
        })??;
        Ok(WalkPlan { plan, units: start.units() })
    }

    /// The next plan begins with these commands.
    ///
    /// Parameters
    /// ----------
    /// commands : array of float32, (n, 3)
    ///     At most as many as a plan has; its others stay as they are.
    ///
    /// Raises
    /// ------
    /// InputError, TypeError
    ///     They have another size, or are out of bounds.
    fn begin_with(&self, commands: &Bound<'_, PyAny>) -> PyResult<()> {
        let commands = Floats::of(commands, "commands", &[None, Some(COMMAND)])?;
        let mut planner = lock_planner(&self.planner)?;
        let (found, most) = (commands.side(0), planner.settings().commands);
        // The planner's own error counts numbers, and the caller gave rows.
        if found > most {
            return Err(input(format!("commands has {found} rows, a plan has {most} commands")));
        }
        let commands = commands.slice()?;
        held(|| planner.begin_with(commands))?.or_raise()
    }

    /// So many steps of the last plan were carried out: the next plan begins with what is left of it.
    ///
    /// Raises
    /// ------
    /// InputError
    ///     The planner is planning.
    fn passed(&self, #[pyo3(from_py_with = whole::steps)] steps: usize) -> PyResult<()> {
        let mut planner = lock_planner(&self.planner)?;
        held(|| planner.passed(steps))
    }

    /// Forgets the last plan and what ``begin_with`` said, as where the robot was carried elsewhere.
    ///
    /// Raises
    /// ------
    /// InputError
    ///     The planner is planning.
    fn forget(&self) -> PyResult<()> {
        lock_planner(&self.planner)?.forget();
        Ok(())
    }
}

/// What to do next. Also made of its attributes, in this order.
///
/// Attributes
/// ----------
/// command : array of float32, (3,)
///     What to command now; it holds for ``hold`` steps unless there is another plan before.
/// cost : float
///     Mean over the steps of how far the robot is from the place, metres. Near the place a radian from the heading that was asked for
///     counts as 0.3 m.
/// path : array of float32, (steps, 7)
///     Predicted poses of the heaviest link.
/// search : Plan
///     The plan of the search; its parameters are (commands, 3).
#[pyclass(frozen, module = "rigidformer")]
pub(crate) struct WalkPlan {
    plan: walking::WalkPlan,
    units: usize,
}

#[pymethods]
impl WalkPlan {
    #[new]
    fn new(
        py: Python<'_>,
        command: &Bound<'_, PyAny>,
        cost: f32,
        path: &Bound<'_, PyAny>,
        search: &Bound<'_, Plan>,
    ) -> PyResult<Self> {
        let command = arrays::vector(command, "command")?.into();
        let path = arrays::poses(path, "path", None)?;
        let (search, units) = search.get().found(py)?;
        Ok(WalkPlan { plan: walking::WalkPlan { command, cost, path, search }, units })
    }

    fn __getnewargs__<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyTuple>> {
        let (command, path, search) = (self.command(py)?, self.path(py)?, self.search(py)?);
        (command, self.plan.cost, path, search).into_pyobject(py)
    }

    #[getter]
    fn command<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyArrayDyn<f32>>> {
        arrays::read_only(numbers(py, &self.plan.command)?)
    }

    #[getter]
    fn cost(&self) -> f32 {
        self.plan.cost
    }

    #[getter]
    fn path<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyArrayDyn<f32>>> {
        let path: &[Isometry3<f32>] = &self.plan.path;
        arrays::read_only(arrays::array_of_poses(py, path, &[path.len()])?)
    }

    #[getter]
    fn search(&self, py: Python<'_>) -> PyResult<Plan> {
        Plan::new(py, &self.plan.search, self.units)
    }

    fn __repr__(&self) -> String {
        let walking::WalkPlan { command: [x, y, turn], cost, path, .. } = &self.plan;
        format!("WalkPlan([{x}, {y}, {turn}], cost={cost}, {} steps)", path.len())
    }
}
