//! The planner for pushing.

use std::sync::Mutex;
use std::sync::atomic::Ordering;

use nalgebra::{Isometry3, Vector3};
use numpy::PyArrayDyn;
use pyo3::prelude::*;
use pyo3::types::{PyDict, PyTuple};
use rigidformer_core::{self as core, Role};
use rigidformer_planning::planner::pushing::{self, ModelPredictor, Observation, Pushed, Pushing};
use rigidformer_planning::planner::{self, Control};

use crate::arrays::{self, Floats};
use crate::errors::{OrRaise, input};
use crate::futures::BatchSimulator;
use crate::interrupt::{held, interruptible};
use crate::pickle::Arguments;
use crate::planner::{AnyMethod, Plan, deadline, lock_planner, numbers};
use crate::unit::{Plane, Unit, planes_of, role_name};
use crate::whole;

/// Pushes that an iteration tries, at most.
// An allocation that fails ends the process, and Python expects an exception.
const MOST_FUTURES: usize = 1 << 16;

/// Where a body shall be pushed to.
///
/// Parameters
/// ----------
/// place_m : array, (2,)
///     On the ground, metres.
/// yaw_rad : float
///     Which way its x axis shall point, radians from x towards y.
/// lever_m : float
///     Metres that a radian of error is worth, at least 0.
/// haste_m_s : float
///     Metres that a second of the pusher's path is worth, its way around the body included; at least 0.
///
/// Raises
/// ------
/// InputError, TypeError
///     The place is no array of two numbers, or a number is out of range: places and yaw go to 1e6.
///
/// Source: ``planning/src/planner/pushing.rs``.
///
/// >>> import rigidformer as rf
/// >>> goal = rf.PushGoal([0.3, 0.0])
/// >>> goal.errors([0.0, 0.4, 0.025, 1, 0, 0, 0])  # metres, radians
/// (0.5, 0.0)
#[pyclass(frozen, module = "rigidformer")]
pub(crate) struct PushGoal {
    goal: pushing::Goal,
}

#[pymethods]
impl PushGoal {
    #[new]
    #[pyo3(signature = (place_m, yaw_rad = 0.0, *, lever_m = 0.1, haste_m_s = 0.005))]
    fn new(
        place_m: &Bound<'_, PyAny>,
        yaw_rad: f32,
        lever_m: f32,
        haste_m_s: f32,
    ) -> PyResult<Self> {
        let place_m = arrays::pair(place_m, "place_m")?;
        let goal = pushing::Goal { place_m, yaw_rad, lever_m, haste_m_s };
        held(|| goal.check())?.or_raise()?;
        Ok(PushGoal { goal })
    }

    /// float32 (2,): on the ground, metres. Read-only.
    #[getter]
    fn place_m<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyArrayDyn<f32>>> {
        arrays::read_only(numbers(py, &self.goal.place_m)?)
    }

    /// Which way its x axis shall point, radians from x towards y.
    #[getter]
    fn yaw_rad(&self) -> f32 {
        self.goal.yaw_rad
    }

    /// Metres that a radian of error is worth.
    #[getter]
    fn lever_m(&self) -> f32 {
        self.goal.lever_m
    }

    /// Metres that a second of the pusher's path is worth.
    #[getter]
    fn haste_m_s(&self) -> f32 {
        self.goal.haste_m_s
    }

    /// How far a body is from there.
    ///
    /// Parameters
    /// ----------
    /// pose : array of float32, (7,)
    ///
    /// Returns
    /// -------
    /// tuple of float and float
    ///     Metres over the ground, and radians of yaw.
    ///
    /// Raises
    /// ------
    /// InputError, TypeError
    ///     It has another shape or no real numbers.
    fn errors(&self, pose: &Bound<'_, PyAny>) -> PyResult<(f32, f32)> {
        let pose = arrays::pose(pose, "pose")?;
        held(|| self.goal.errors(&pose))
    }

    fn __getnewargs_ex__<'py>(&self, py: Python<'py>) -> PyResult<Arguments<'py>> {
        let more = PyDict::new(py);
        more.set_item("lever_m", self.goal.lever_m)?;
        more.set_item("haste_m_s", self.goal.haste_m_s)?;
        Ok(((self.place_m(py)?, self.goal.yaw_rad).into_pyobject(py)?, more))
    }

    fn __repr__(&self) -> String {
        let pushing::Goal { place_m: [x, y], yaw_rad, lever_m, haste_m_s } = self.goal;
        format!("PushGoal([{x}, {y}], {yaw_rad}, lever_m={lever_m}, haste_m_s={haste_m_s})")
    }
}

/// Plans how a driven pusher brings a free body to a place over a plane z = const. A push is a straight line: its heading, how far it
/// passes beside the body's centre, and how far it goes on after touching. Plan anew whenever the two are seen, and say by ``passed``
/// how much of the last plan was carried out: what is left of it is tried first. The same calls in the same order give the same plans,
/// to the bit, on any number of threads, unless a deadline cut one.
///
/// Parameters
/// ----------
/// body, pusher : Unit
///     What is pushed and what pushes, rigid and of two bodies, with their points in their own reference frames. The body is free; the
///     pusher is driven, whatever its role.
/// radius_m : float
///     The pusher's outline is a circle of this radius about its frame's origin, metres.
/// dt_s : float
///     Seconds between two places of a path, and between the two poses that are seen.
/// push_m_s, travel_m_s : float
///     Speed of the pusher while it pushes, and on its way around the body, m/s.
/// room_m : float
///     So much room at least is left to the body on that way, metres.
/// longest_m : float
///     The longest push after touching, metres; at least 0.002.
/// settle_s : float
///     Seconds that a prediction goes on after the pusher has stopped.
/// planes : sequence of Plane, optional
///     None: the model's ground.
/// gravity_m_s2 : array, (3,), optional
///     None: the model's.
/// method : Mppi or Cem, optional
///     None: ``Mppi(0.002, 0.5)``.
/// futures, iterations : int
///     Pushes an iteration, at most 65,536, and iterations; each at least 1. Pushes times the steps of the longest one are at most
///     4,194,304.
/// seed : int
///     Another seed, other samples.
/// heading_rad, offset, length_m : float
///     Deviations of the first samples: of headings, of offsets as a part of the outline's reach, and of lengths.
///
/// Raises
/// ------
/// InputError, TypeError
///     Something is out of range.
///
/// Source: ``planning/src/planner/pushing.rs``, ``docs/PLANNING.md``.
///
/// >>> import numpy as np, rigidformer as rf
/// >>> corners = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)], np.float32)
/// >>> cube, stick = rf.Unit(0.025 * corners, 0.1), rf.Unit(0.01 * corners, 0.1)
/// >>> planner = rf.PushPlanner(cube, stick, 0.01, planes=[rf.Plane([0, 0, 1], friction=1.0)], iterations=1)
/// >>> seen = np.array([[0, 0, 0.025, 1, 0, 0, 0], [0.1, 0, 0.02, 1, 0, 0, 0]], np.float32)  # both at rest
/// >>> plan = planner.plan(rf.BatchSimulator(rf.Model("edge")), seen, seen, rf.PushGoal([-0.06, 0]))
/// >>> plan.cost < plan.stay, bool(plan.poses[-1, 0] < -0.02)
/// (True, True)
/// >>> planner.passed(plan, len(plan.path_m) // 2)  # then look again and plan anew
#[pyclass(frozen, module = "rigidformer")]
pub(crate) struct PushPlanner {
    planner: Mutex<pushing::PushPlanner<'static>>,
    body: Py<Unit>,
    pusher: Py<Unit>,
    step_s: f32,
    planes: Option<Vec<core::Plane>>,
    gravity_m_s2: Option<Vector3<f32>>,
}

#[pymethods]
impl PushPlanner {
    #[new]
    #[pyo3(signature = (body, pusher, radius_m, *, dt_s = 1.0 / 60.0, push_m_s = 0.2, travel_m_s = 0.4, room_m = 0.008, longest_m = 0.12, settle_s = 0.05, planes = None, gravity_m_s2 = None, method = None, futures = 8, iterations = 2, seed = 1, heading_rad = 0.25, offset = 0.25, length_m = 0.03))]
    #[expect(clippy::too_many_arguments, reason = "Python's are named")]
    fn new(
        body: Py<Unit>,
        pusher: Py<Unit>,
        radius_m: f32,
        dt_s: f32,
        push_m_s: f32,
        travel_m_s: f32,
        room_m: f32,
        longest_m: f32,
        settle_s: f32,
        planes: Option<Vec<Bound<'_, Plane>>>,
        gravity_m_s2: Option<&Bound<'_, PyAny>>,
        method: Option<AnyMethod<'_>>,
        #[pyo3(from_py_with = whole::futures)] futures: usize,
        #[pyo3(from_py_with = whole::iterations)] iterations: usize,
        #[pyo3(from_py_with = whole::seed)] seed: u64,
        heading_rad: f32,
        offset: f32,
        length_m: f32,
    ) -> PyResult<Self> {
        // A wish for more than there is memory would end the process.
        if futures > MOST_FUTURES {
            return Err(input(format!("{futures} futures; give at most {MOST_FUTURES}")));
        }
        // Rust calls it `step_s`, and an error must name what the caller gave.
        if !(dt_s.is_finite() && dt_s > 0.0) {
            return Err(input(format!("dt_s is {dt_s}; it must be finite and above 0")));
        }
        // Checked on construction, so that a mistake does not wait for the first plan.
        pair(&body.get().view(), &pusher.get().view())?;
        let usual = pushing::PushSettings::default();
        let settings = pushing::PushSettings {
            method: method.map_or(usual.method, Into::into),
            futures,
            iterations,
            seed,
            heading_rad,
            offset,
            length_m,
        };
        let pushing = Pushing {
            step_s: dt_s,
            push_m_s,
            travel_m_s,
            room_m,
            longest_m,
            settle_s,
            // The planner owns the points, because Python's objects may be gone before it.
            ..Pushing::new(body.get().view().points.to_vec(), radius_m)
        };
        let planner = held(|| pushing::PushPlanner::new(settings, pushing))?;
        Ok(PushPlanner {
            planner: Mutex::new(planner.or_raise()?),
            body,
            pusher,
            step_s: dt_s,
            planes: planes.map(|planes| planes_of(&planes)),
            gravity_m_s2: gravity_m_s2.map(|g| arrays::vector(g, "gravity_m_s2")).transpose()?,
        })
    }

    /// Searches for the push that costs least.
    ///
    /// Parameters
    /// ----------
    /// simulator : BatchSimulator
    ///     With the model that predicts.
    /// previous, current : arrays of float32, (2, 7)
    ///     Where the body and the pusher were a step ago, and where they are: the body first.
    /// goal : PushGoal
    ///     Its distance is the cost, and pushes towards it are tried first.
    /// cost : callable, optional
    ///     Another cost: gets a push (heading rad, offset m, length m), the seconds that its whole path takes and the body's poses,
    ///     (n, 7), both arrays float32; returns a number, less is better. The first pose is the one before the push, and the only one of
    ///     no push at all, which ``stay`` costs. It is called from another thread.
    /// deadline_s : float, optional
    ///     Seconds from now. No step is predicted after it; the costs of what was predicted until then are still found, and the best
    ///     of them is the plan.
    ///
    /// Returns
    /// -------
    /// PushPlan
    ///
    /// Raises
    /// ------
    /// InputError, TypeError
    ///     The observation is refused, the body has no outline, no push gets to it or has a finite cost, or the deadline came before the first.
    /// KeyboardInterrupt
    ///     Ctrl-C, within a step.
    /// Exception
    ///     Whatever ``cost`` raises.
    #[pyo3(signature = (simulator, previous, current, goal, *, cost = None, deadline_s = None))]
    #[expect(clippy::too_many_arguments, reason = "Python's are named")]
    fn plan(
        &self,
        py: Python<'_>,
        simulator: &BatchSimulator,
        previous: &Bound<'_, PyAny>,
        current: &Bound<'_, PyAny>,
        goal: &PushGoal,
        cost: Option<Py<PyAny>>,
        deadline_s: Option<f64>,
    ) -> PyResult<PushPlan> {
        let observation = observation(previous, current)?;
        let deadline = deadline(deadline_s)?;
        let mut predictor = ModelPredictor {
            simulator: simulator.simulator.clone(),
            body: self.body.get().view(),
            pusher: self.pusher.get().view(),
            planes: self.planes.as_deref(),
            gravity_m_s2: self.gravity_m_s2,
            step_s: self.step_s,
        };
        let goal = goal.goal;
        let plan = interruptible(py, |cancelled| {
            let raised = Mutex::new(None);
            let measured = |pushed: &Pushed<'_>| {
                // Without a cost of the caller's no call needs the interpreter.
                let Some(cost) = &cost else { return goal.cost(pushed) };
                if cancelled.load(Ordering::Relaxed) {
                    return f32::INFINITY;
                }
                called(cost, pushed).unwrap_or_else(|error| {
                    cancelled.store(true, Ordering::Relaxed);
                    if let Ok(mut raised) = raised.lock() {
                        raised.get_or_insert(error);
                    }
                    f32::INFINITY
                })
            };
            let control = Control { deadline, cancelled, watch: &mut |_| {} };
            let plan = lock_planner(&self.planner)?.plan(
                &observation,
                &mut predictor,
                &goal,
                &measured,
                control,
            );
            match raised.into_inner() {
                Ok(Some(error)) => Err(error),
                _ => plan.or_raise(),
            }
        })??;
        Ok(PushPlan { plan })
    }

    /// So many steps of a plan's path were carried out: the next plan begins with what is left of it.
    ///
    /// Raises
    /// ------
    /// InputError
    ///     The planner is planning.
    fn passed(
        &self,
        plan: &PushPlan,
        #[pyo3(from_py_with = whole::steps)] steps: usize,
    ) -> PyResult<()> {
        let mut planner = lock_planner(&self.planner)?;
        held(|| planner.passed(&plan.plan, steps))
    }

    /// Forgets what is left of the last plan.
    ///
    /// Raises
    /// ------
    /// InputError
    ///     The planner is planning.
    fn forget(&self) -> PyResult<()> {
        lock_planner(&self.planner)?.forget();
        Ok(())
    }

    /// Seconds between two places of a path.
    #[getter]
    fn dt_s(&self) -> f32 {
        self.step_s
    }
}

/// Whether one can push the other.
fn pair(body: &core::Unit<'_>, pusher: &core::Unit<'_>) -> PyResult<()> {
    if body.role != Role::Free {
        let role = role_name(body.role);
        return Err(input(format!("the body is {role}; give a free unit, which can be pushed")));
    }
    for (what, unit) in [("body", body), ("pusher", pusher)] {
        if unit.soft.is_some() {
            return Err(input(format!("the {what} is soft; give a rigid unit")));
        }
    }
    // Units of one body do not collide, so no push would move the other.
    match body.body {
        Some(one) if pusher.body == Some(one) => Err(input(format!(
            "body and pusher are both of body {one}, whose units do not collide; give two bodies"
        ))),
        _ => Ok(()),
    }
}

/// The body's and the pusher's last two poses.
fn observation(previous: &Bound<'_, PyAny>, current: &Bound<'_, PyAny>) -> PyResult<Observation> {
    let previous = arrays::poses(previous, "previous", Some(2))?;
    let current = arrays::poses(current, "current", Some(2))?;
    let (&[body_before, pusher_before], &[body, pusher]) =
        (previous.as_slice(), current.as_slice())
    else {
        return Err(input("previous and current are two poses each, the body's and the pusher's"));
    };
    Ok(Observation { body_before, body, pusher_before, pusher })
}

/// What a push costs by a function of the caller's.
fn called(cost: &Py<PyAny>, pushed: &Pushed<'_>) -> PyResult<f32> {
    Python::attach(|py| {
        let pushing::Push { heading_rad, offset_m, length_m } = pushed.push;
        let push = numbers(py, &[heading_rad, offset_m, length_m])?;
        // The pose before the push lets a cost measure how far the body went.
        let poses: Vec<&Isometry3<f32>> =
            std::iter::once(pushed.before).chain(pushed.poses).collect();
        let count = poses.len();
        let poses = arrays::array_of_poses(py, poses, &[count])?;
        cost.bind(py).call1((push, pushed.seconds, poses))?.extract::<f32>()
    })
}

/// What to do next. Also made of its attributes, in this order.
///
/// Attributes
/// ----------
/// heading_rad, offset_m, length_m : float
///     The best push: which way, radians from x towards y; how far to the left of the body's centre it passes; how far the pusher
///     goes on after touching.
/// cost, stay : float
///     What it costs, and what leaving the body where it is costs.
/// path_m : array of float32, (steps, 2)
///     Where the pusher is after each step: around the body, then the push.
/// approach : int
///     So many steps of the path lead around the body.
/// poses : array of float32, (n, 7)
///     Predicted poses of the body, from ``path_m[approach]`` on and while it settles.
/// search : Plan
///     The plan of the search; its parameters are the push, and it has no poses of its own.
#[pyclass(frozen, module = "rigidformer")]
pub(crate) struct PushPlan {
    plan: pushing::PushPlan,
}

#[pymethods]
impl PushPlan {
    #[new]
    #[expect(clippy::too_many_arguments, reason = "a plan has as many")]
    fn new(
        py: Python<'_>,
        heading_rad: f32,
        offset_m: f32,
        length_m: f32,
        cost: f32,
        stay: f32,
        path_m: &Bound<'_, PyAny>,
        #[pyo3(from_py_with = whole::approach)] approach: usize,
        poses: &Bound<'_, PyAny>,
        search: &Bound<'_, Plan>,
    ) -> PyResult<Self> {
        let path = Floats::of(path_m, "path_m", &[None, Some(2)])?;
        let places = path.slice()?.chunks_exact(2);
        let path_m = places.map(|place| [0, 1].map(|axis| place.get(axis).copied().unwrap_or(0.0)));
        let push = pushing::Push { heading_rad, offset_m, length_m };
        let (search, _) = search.get().found(py)?;
        let plan = pushing::PushPlan {
            push,
            cost,
            stay,
            path_m: path_m.collect(),
            approach,
            poses: arrays::poses(poses, "poses", None)?,
            search: planner::Plan { poses: Vec::new(), ..search },
        };
        Ok(PushPlan { plan })
    }

    fn __getnewargs__<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyTuple>> {
        let pushing::Push { heading_rad, offset_m, length_m } = self.plan.push;
        let (path_m, poses, search) = (self.path_m(py)?, self.poses(py)?, self.search(py)?);
        let (cost, stay, approach) = (self.plan.cost, self.plan.stay, self.plan.approach);
        (heading_rad, offset_m, length_m, cost, stay, path_m, approach, poses, search)
            .into_pyobject(py)
    }

    #[getter]
    fn heading_rad(&self) -> f32 {
        self.plan.push.heading_rad
    }

    #[getter]
    fn offset_m(&self) -> f32 {
        self.plan.push.offset_m
    }

    #[getter]
    fn length_m(&self) -> f32 {
        self.plan.push.length_m
    }

    #[getter]
    fn cost(&self) -> f32 {
        self.plan.cost
    }

    #[getter]
    fn stay(&self) -> f32 {
        self.plan.stay
    }

    #[getter]
    fn path_m<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyArrayDyn<f32>>> {
        let path = &self.plan.path_m;
        arrays::read_only(arrays::array(py, path.as_flattened().to_vec(), &[path.len(), 2])?)
    }

    #[getter]
    fn approach(&self) -> usize {
        self.plan.approach
    }

    #[getter]
    fn poses<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyArrayDyn<f32>>> {
        arrays::read_only(arrays::array_of_poses(py, &self.plan.poses, &[self.plan.poses.len()])?)
    }

    #[getter]
    fn search(&self, py: Python<'_>) -> PyResult<Plan> {
        Plan::new(py, &self.plan.search, 0)
    }

    fn __repr__(&self) -> String {
        let pushing::PushPlan { push, cost, stay, path_m, .. } = &self.plan;
        let pushing::Push { heading_rad, offset_m, length_m } = push;
        format!(
            "PushPlan(heading_rad={heading_rad}, offset_m={offset_m}, length_m={length_m}, cost={cost}, stay={stay}, {} steps)",
            path_m.len()
        )
    }
}
