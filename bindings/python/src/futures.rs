//! Many futures of one scene.

use std::collections::BTreeMap;
use std::sync::atomic::{AtomicBool, Ordering};

use nalgebra::{Isometry3, Vector3};
use numpy::{PyArrayDyn, PyUntypedArrayMethods};
use pyo3::prelude::*;
use pyo3::types::{PyBytes, PyDict, PyTuple};
use rigidformer_core::{self as core, Limits, Physics, Posed};
use rigidformer_planning::planner::SettingsError;
use rigidformer_runtime::futures::{
    self, ChangeError, End, FutureScene, Outcome, StartState, USUAL_MEMORY, Variation,
};
use rigidformer_runtime::memory::Budget;
use rigidformer_runtime::pivots::Pivot;
use rigidformer_runtime::terrain::HeightFieldBuf;
use rigidformer_runtime::world::Snapshot;

use crate::arrays::{self, Floats, POSE, Side};
use crate::bonds;
use crate::copies::Copies;
use crate::errors::{OrRaise, input, memory as too_much, raise, text_of};
use crate::interrupt::{held, interruptible};
use crate::model::Model;
use crate::pickle::Arguments;
use crate::scene::Scene;
use crate::unit::{HeightField, Plane, Unit, array_of_vector, law_of, law_pair, planes, planes_of};
use crate::whole;
use crate::world::engine;

/// Numbers of a velocity: linear in m/s, then angular in rad/s.
pub(crate) const VELOCITY: usize = 6;
/// As the runtime has it, and as numpy does.
const BYTES_A_POSE: u64 = 56;
/// Poses that are written before the caller is looked at.
const POSES_AT_ONCE: usize = 1 << 17;
/// Numbers of a unit's physics: mass, friction, restitution.
const PHYSICS: usize = 3;

/// The scene that futures start from.
///
/// Parameters
/// ----------
/// dt_s : float
///     Seconds between the two poses, and between predictions. Above 0.
/// units : sequence of Unit
///     With their points in their own reference frames.
/// previous, current : arrays of float32, (units, 7)
///     Where they were a step ago, and where they are.
/// command : array of float32, (model.command_size,), optional
///     For models that take one.
/// planes : sequence of Plane, optional
///     None: the model's ground.
/// plane_compliance : sequence of (float, float)
///     Stiffness, N/m, and dissipation, s/m, of contact with each plane. None given: all are rigid.
/// contact_law : tuple of float and str, optional
///     As ``World.contact_law``. None: contacts are rigid, or as the state has it.
/// height_field : HeightField, optional
///     None: there is none, or as the state has it.
/// gravity_m_s2 : array, (3,), optional
///     None: the model's.
/// pivots : sequence of Pivot
///     Where units hang together, by their numbers in ``units``.
/// state : (bytes, int, int), optional
///     ``World.snapshot``, its units, and points that they have room in: what pickle makes ``World.start`` of, with ``height_field``.
///     There are then no ``units``.
///
/// Raises
/// ------
/// InputError, TypeError
///     An array has another shape or no real numbers. Ranges are checked where futures start.
///
/// Source: ``runtime-std/src/futures.rs``.
///
/// >>> import rigidformer as rf
/// >>> start = rf.Start.of_scene(rf.Dataset.embedded().scene(0), step=10)
/// >>> start
/// Start(5 units, dt_s=0.041666668)
#[pyclass(frozen, module = "rigidformer")]
pub(crate) struct Start {
    /// Of a world: there are then no units.
    state: Option<StartState>,
    dt_s: f32,
    units: Vec<Py<Unit>>,
    previous: Vec<Isometry3<f32>>,
    current: Vec<Isometry3<f32>>,
    command: Vec<f32>,
    planes: Option<Vec<core::Plane>>,
    plane_compliance: Vec<core::Compliance>,
    contact_law: Option<core::ContactLaw>,
    height_field: Option<HeightFieldBuf>,
    gravity_m_s2: Option<Vector3<f32>>,
    pivots: Vec<Pivot>,
}

impl Start {
    /// (units) What simulators take.
    pub(crate) fn posed(&self) -> Vec<Posed<'_>> {
        let poses = self.previous.iter().zip(&self.current);
        let posed = self.units.iter().zip(poses);
        let posed = posed.map(|(unit, (previous, current))| Posed {
            unit: unit.get().view(),
            previous: *previous,
            current: *current,
        });
        posed.collect()
    }

    /// As the runtime has it.
    pub(crate) fn view<'s>(&'s self, units: &'s [Posed<'s>]) -> futures::Start<'s> {
        futures::Start {
            state: self.state.as_ref(),
            dt_s: self.dt_s,
            units,
            command: &self.command,
            planes: self.planes.as_deref(),
            plane_compliance: &self.plane_compliance,
            contact_law: self.contact_law,
            height_field: self.height_field.as_ref(),
            gravity_m_s2: self.gravity_m_s2,
            pivots: &self.pivots,
        }
    }

    pub(crate) fn units(&self) -> usize {
        self.state.as_ref().map_or(self.units.len(), StartState::units)
    }

    /// A world as it is.
    pub(crate) fn of_state(state: StartState) -> Self {
        Start {
            dt_s: state.dt_s(),
            state: Some(state),
            units: Vec::new(),
            previous: Vec::new(),
            current: Vec::new(),
            command: Vec::new(),
            planes: None,
            plane_compliance: Vec::new(),
            contact_law: None,
            height_field: None,
            gravity_m_s2: None,
            pivots: Vec::new(),
        }
    }
}

#[pymethods]
impl Start {
    #[new]
    #[pyo3(signature = (dt_s, units, previous, current, *, command = None, planes = None, plane_compliance = Vec::new(), contact_law = None, height_field = None, gravity_m_s2 = None, pivots = Vec::new(), state = None))]
    #[expect(clippy::too_many_arguments, reason = "Python's are named")]
    fn new(
        dt_s: f32,
        units: Vec<Py<Unit>>,
        previous: &Bound<'_, PyAny>,
        current: &Bound<'_, PyAny>,
        command: Option<&Bound<'_, PyAny>>,
        planes: Option<Vec<Bound<'_, Plane>>>,
        plane_compliance: Vec<(f32, f32)>,
        contact_law: Option<(f32, String)>,
        height_field: Option<Bound<'_, HeightField>>,
        gravity_m_s2: Option<&Bound<'_, PyAny>>,
        pivots: Vec<Bound<'_, bonds::Pivot>>,
        state: Option<(Vec<u8>, usize, usize)>,
    ) -> PyResult<Self> {
        let count = Some(units.len());
        let height_field = height_field.map(|field| field.get().field.clone());
        let state = state.map(|(snapshot, units, points)| {
            let snapshot = Snapshot::from_bytes(snapshot);
            StartState::new(snapshot, Limits { units, points }, dt_s)
                .on_height_field(height_field.clone())
        });
        if state.is_some() && !(units.is_empty() && pivots.is_empty()) {
            return Err(input("a state has units and joints of its own; give none beside it"));
        }
        let command = match command {
            Some(command) => Floats::of(command, "command", &[None])?.slice()?.to_vec(),
            None => Vec::new(),
        };
        Ok(Start {
            state,
            dt_s,
            previous: arrays::poses(previous, "previous", count)?,
            current: arrays::poses(current, "current", count)?,
            units,
            command,
            planes: planes.map(|planes| planes_of(&planes)),
            plane_compliance: plane_compliance
                .into_iter()
                .map(|(stiffness_n_m, dissipation_s_m)| core::Compliance {
                    stiffness_n_m,
                    dissipation_s_m,
                })
                .collect(),
            contact_law: contact_law.map(|given| law_of(Some(given))).transpose()?,
            height_field,
            gravity_m_s2: gravity_m_s2.map(|g| arrays::vector(g, "gravity_m_s2")).transpose()?,
            pivots: pivots.iter().map(|pivot| pivot.get().found()).collect(),
        })
    }

    /// From a recorded scene, with its planes, contact law, gravity and commands.
    ///
    /// Parameters
    /// ----------
    /// scene : Scene
    /// step : int
    ///     Frames between the two poses, and between predictions.
    /// frame : int, optional
    ///     Where the units are; None: ``step``.
    /// join : bool
    ///     Holds links of a body together at the pivots that the frames to ``frame`` show.
    ///
    /// Returns
    /// -------
    /// Start
    ///
    /// Raises
    /// ------
    /// InputError
    ///     A frame was not recorded, or a unit is soft.
    #[staticmethod]
    #[pyo3(signature = (scene, step = 10, *, frame = None, join = false))]
    fn of_scene(
        py: Python<'_>,
        scene: &Scene,
        #[pyo3(from_py_with = whole::step)] step: usize,
        #[pyo3(from_py_with = whole::frame)] frame: Option<usize>,
        join: bool,
    ) -> PyResult<Self> {
        let scene = &scene.scene;
        let frame = frame.unwrap_or(step);
        let name = scene.name();
        // Futures start from poses, which say nothing of soft points.
        if scene.units().iter().any(|unit| unit.soft.is_some()) {
            return Err(input(format!("{name}: has soft units; futures are of rigid ones")));
        }
        // A step of 0 has no velocity.
        let before = frame.checked_sub(step).filter(|_| step > 0);
        let poses = before.and_then(|before| scene.poses_at(before)).zip(scene.poses_at(frame));
        let missing = || {
            let frames = scene.frames();
            input(format!(
                "{name}: has {frames} frames; frame {frame} and the one {step} before it are needed"
            ))
        };
        let (previous, current) = poses.ok_or_else(missing)?;
        let pivots = match join {
            true => rigidformer_evaluation::pivots::joined(scene.clone(), frame)
                .or_raise()?
                .pivots()
                .to_vec(),
            false => Vec::new(),
        };
        let units = scene.units().iter().map(|unit| Py::new(py, Unit::of(unit)));
        Ok(Start {
            state: None,
            dt_s: held(|| step as f32 / scene.frame_rate_hz())?,
            units: units.collect::<PyResult<_>>()?,
            previous,
            current,
            command: scene.command_of_step(frame, frame.saturating_add(step)).unwrap_or_default(),
            planes: scene.planes().map(<[core::Plane]>::to_vec),
            plane_compliance: scene.plane_compliance().to_vec(),
            contact_law: Some(scene.contact_law()),
            height_field: scene.height_field().cloned(),
            gravity_m_s2: Some(scene.gravity_m_s2()),
            pivots,
        })
    }

    /// Seconds of a step.
    #[getter]
    fn dt_s(&self) -> f32 {
        self.dt_s
    }

    fn __getnewargs_ex__<'py>(&self, py: Python<'py>) -> PyResult<Arguments<'py>> {
        let array = |poses: &[Isometry3<f32>]| arrays::array_of_poses(py, poses, &[poses.len()]);
        let units: Vec<_> = self.units.iter().map(|unit| unit.clone_ref(py)).collect();
        let own = self.planes.as_ref().map(|own| planes(py, own)).transpose()?;
        let gravity = self.gravity_m_s2.map(|gravity| array_of_vector(py, &gravity)).transpose()?;
        let pivots: Vec<bonds::Pivot> = self.pivots.iter().copied().map(Into::into).collect();
        let command = arrays::array(py, self.command.clone(), &[self.command.len()])?;
        let more = PyDict::new(py);
        more.set_item("command", command)?;
        more.set_item("planes", own)?;
        let compliance = |own: &core::Compliance| (own.stiffness_n_m, own.dissipation_s_m);
        let compliance: Vec<_> = self.plane_compliance.iter().map(compliance).collect();
        more.set_item("plane_compliance", compliance)?;
        // Of a rigid one as well: it may stand beside a state that has another.
        let law = self.contact_law.as_ref().map(law_pair);
        more.set_item("contact_law", law)?;
        let of_state = self.state.as_ref().and_then(StartState::height_field);
        let field = self.height_field.as_ref().or(of_state).cloned();
        more.set_item("height_field", field.map(|field| HeightField { field }))?;
        more.set_item("gravity_m_s2", gravity)?;
        more.set_item("pivots", pivots)?;
        if let Some(state) = &self.state {
            let Limits { units, points } = state.limits();
            let snapshot = PyBytes::new(py, state.snapshot().as_bytes());
            more.set_item("state", (snapshot, units, points))?;
        }
        let (previous, current) = (array(&self.previous)?, array(&self.current)?);
        Ok(((self.dt_s, units, previous, current).into_pyobject(py)?, more))
    }

    fn __repr__(&self) -> String {
        format!("Start({} units, dt_s={})", self.units(), self.dt_s)
    }
}

/// Normal noise on the velocities of all units, by seed and future.
///
/// Parameters
/// ----------
/// seed : int
///     Another seed, other futures.
/// linear_m_s, angular_rad_s : float
///     Deviation of each component.
///
/// Source: ``runtime-std/src/futures.rs``.
#[pyclass(frozen, get_all, module = "rigidformer")]
pub(crate) struct VelocityNoise {
    seed: u64,
    linear_m_s: f32,
    angular_rad_s: f32,
}

#[pymethods]
impl VelocityNoise {
    #[new]
    #[pyo3(signature = (seed, linear_m_s = 0.0, angular_rad_s = 0.0))]
    fn new(
        #[pyo3(from_py_with = whole::seed)] seed: u64,
        linear_m_s: f32,
        angular_rad_s: f32,
    ) -> Self {
        VelocityNoise { seed, linear_m_s, angular_rad_s }
    }

    fn __getnewargs__(&self) -> (u64, f32, f32) {
        (self.seed, self.linear_m_s, self.angular_rad_s)
    }

    fn __repr__(&self) -> String {
        let VelocityNoise { seed, linear_m_s, angular_rad_s } = self;
        format!("VelocityNoise({seed}, linear_m_s={linear_m_s}, angular_rad_s={angular_rad_s})")
    }
}

/// Rolls out many futures of a scene in lockstep, so that each layer's weights are read once for all of them.
///
/// Parameters
/// ----------
/// model : Model
/// threads, kernel
///     As of ``World``.
/// memory : int
///     Bytes that the poses of a ``run``, or all ``copies`` of a call, may take: 4 GiB. What would take more is refused before it is
///     begun.
///
/// Raises
/// ------
/// InputError
///     There is no such kernel, or number of threads.
///
/// Source: ``runtime-std/src/futures.rs``.
///
/// >>> import numpy as np, rigidformer as rf
/// >>> start = rf.Start.of_scene(rf.Dataset.embedded().scene(0), step=10)
/// >>> simulator = rf.BatchSimulator(rf.Model("nano"))
/// >>> futures = simulator.run(start, 16, 6, noise=rf.VelocityNoise(1, linear_m_s=0.3))
/// >>> futures.poses.shape
/// (16, 6, 5, 7)
/// >>> futures.ends.count(None)
/// 16
#[pyclass(frozen, module = "rigidformer")]
pub(crate) struct BatchSimulator {
    pub(crate) simulator: futures::BatchSimulator,
    /// The caller's own.
    model: Py<Model>,
    threads: usize,
    memory: u64,
}

#[pymethods]
impl BatchSimulator {
    #[new]
    #[pyo3(signature = (model, *, threads = None, kernel = None, memory = USUAL_MEMORY))]
    fn new(
        model: Bound<'_, Model>,
        #[pyo3(from_py_with = whole::threads)] threads: Option<usize>,
        kernel: Option<&str>,
        #[pyo3(from_py_with = whole::memory)] memory: u64,
    ) -> PyResult<Self> {
        let engine = engine(threads, kernel)?;
        let simulator = futures::BatchSimulator::new(engine, &model.get().loaded);
        let (simulator, threads) = (simulator.with_memory(memory), engine.threads.count());
        Ok(BatchSimulator { simulator, model: model.unbind(), threads, memory })
    }

    // Kernels are those of the process that reads it.
    fn __getnewargs_ex__<'py>(&self, py: Python<'py>) -> PyResult<Arguments<'py>> {
        let more = PyDict::new(py);
        more.set_item("threads", self.threads)?;
        more.set_item("memory", self.memory)?;
        Ok(((self.model.clone_ref(py),).into_pyobject(py)?, more))
    }

    /// Copies of a start that go on from step to step, such as environments of reinforcement learning.
    ///
    /// Parameters
    /// ----------
    /// start : Start
    ///     Where all begin.
    /// count : int
    ///     1 to 65,536. Copies take about 32 KiB a unit, within ``memory``.
    ///
    /// Returns
    /// -------
    /// Copies
    ///
    /// Raises
    /// ------
    /// InputError
    ///     The start cannot be.
    /// MemoryLimitError
    ///     All copies would take more than ``memory``; none was made.
    /// KeyboardInterrupt
    ///     Ctrl-C.
    ///
    /// Source: ``runtime-std/src/futures/copies.rs``.
    fn copies(
        &self,
        py: Python<'_>,
        start: &Start,
        #[pyo3(from_py_with = whole::count)] count: usize,
    ) -> PyResult<Copies> {
        Copies::new(py, self, start, count)
    }

    /// Rolls out futures that differ by what is given. The arrays are copied; the interpreter is free meanwhile.
    ///
    /// Parameters
    /// ----------
    /// start : Start
    ///     What all begin with.
    /// futures, steps : int
    ///     How many, at least 0, and how far, at least 1.
    /// previous, current : arrays of float32, (futures, units, 7), optional
    ///     Where the units of each future were a step ago, and where they are, instead of the start's poses; both or none.
    /// velocities : array of float32, (futures, units, 6), optional
    ///     What units begin with: linear m/s of their frames' origins, angular rad/s in the world's axes,
    ///     both of now.
    /// pushes : array of float32, (futures, units, 6), optional
    ///     The same, added to the velocities that they have.
    /// noise : VelocityNoise, optional
    ///     Added to velocities, too.
    /// physics : array of float32, (futures, units, 3), optional
    ///     Mass kg, friction, restitution.
    /// commands : array of float32, (futures, steps, model.command_size), optional
    ///     Of each step.
    /// targets : dict of int to array of float32, (futures, steps, 7), optional
    ///     Where driven units, by their number from 0, are after each step.
    ///
    /// Returns
    /// -------
    /// Futures
    ///
    /// Raises
    /// ------
    /// InputError, TypeError
    ///     The start or an array cannot be. A future that fails alone ends alone.
    /// MemoryLimitError
    ///     The poses would take more than ``memory``.
    /// KeyboardInterrupt
    ///     Ctrl-C, within a step.
    #[pyo3(signature = (start, futures, steps, *, previous = None, current = None, velocities = None, pushes = None, noise = None, physics = None, commands = None, targets = None))]
    #[expect(clippy::too_many_arguments, reason = "Python's are named")]
    fn run(
        &self,
        py: Python<'_>,
        start: &Start,
        #[pyo3(from_py_with = whole::futures)] futures: usize,
        #[pyo3(from_py_with = whole::steps)] steps: usize,
        previous: Option<&Bound<'_, PyAny>>,
        current: Option<&Bound<'_, PyAny>>,
        velocities: Option<&Bound<'_, PyAny>>,
        pushes: Option<&Bound<'_, PyAny>>,
        noise: Option<&VelocityNoise>,
        physics: Option<&Bound<'_, PyAny>>,
        commands: Option<&Bound<'_, PyAny>>,
        #[pyo3(from_py_with = whole::targets)] targets: Option<BTreeMap<usize, Bound<'_, PyAny>>>,
    ) -> PyResult<Futures> {
        let units = start.units();
        // numpy's shapes cannot tell an empty answer from a mistake.
        for (what, count) in [("steps", steps), ("start.units", units)] {
            if count == 0 {
                return Err(raise(SettingsError::Zero { what }));
            }
        }
        let of_units = |width| [Some(futures), Some(units), Some(width)];
        let size = self.simulator.model().config().command_size as usize;
        if previous.is_some() != current.is_some() {
            return Err(input(
                "previous and current say together where units are; give both or none",
            ));
        }
        let mut variation = ArrayVariation {
            previous: Rows::of(previous, "previous", of_units(POSE))?,
            current: Rows::of(current, "current", of_units(POSE))?,
            velocities: Rows::of(velocities, "velocities", of_units(VELOCITY))?,
            pushes: Rows::of(pushes, "pushes", of_units(VELOCITY))?,
            physics: Rows::of(physics, "physics", of_units(PHYSICS))?,
            commands: Rows::of(commands, "commands", [Some(futures), Some(steps), Some(size)])?,
            targets: Vec::new(),
            noise: noise.map(|noise| futures::VelocityNoise {
                seed: noise.seed,
                linear_m_s: noise.linear_m_s,
                angular_rad_s: noise.angular_rad_s,
            }),
        };
        for (unit, poses) in targets.unwrap_or_default() {
            let shape = [Some(futures), Some(steps), Some(POSE)];
            // All futures would end alike before their first step.
            if unit >= units {
                return Err(input(format!(
                    "targets: there is no unit {unit} of {units}; they are counted from 0"
                )));
            }
            if let Some(rows) = Rows::of(Some(&poses), "targets", shape)? {
                variation.targets.push((unit, rows));
            }
        }
        let all = futures.checked_mul(steps).and_then(|poses| poses.checked_mul(units));
        let needed = (all.unwrap_or(usize::MAX) as u64).saturating_mul(BYTES_A_POSE);
        let too_many = || {
            let memory = self.memory;
            too_much(format!(
                "{futures} futures of {steps} steps of {units} units take {needed} bytes, and may take {memory}; ask for fewer, or allow more by BatchSimulator(memory=)"
            ))
        };
        if Budget::new(self.memory).take(needed).is_err() {
            return Err(too_many());
        }
        let mut poses = Vec::new();
        // An allocation that fails ends the process, and a question to the system does not.
        let room = all.filter(|all| poses.try_reserve_exact(*all).is_ok());
        let all = room.ok_or_else(too_many)?;
        let posed = start.posed();
        let begin = start.view(&posed);
        let run = interruptible(py, |cancelled| {
            let cancellable = Cancellable { variation: &variation, cancelled };
            // The room is reserved, so this cannot fail. It may be gigabytes, which take a while to write.
            while poses.len() < all && !cancellable.is_cut() {
                poses.resize(all.min(poses.len() + POSES_AT_ONCE), Isometry3::identity());
            }
            if cancellable.is_cut() {
                return Ok((Vec::new(), Vec::new()));
            }
            let outcomes = self.simulator.run(&begin, steps, &cancellable, &mut poses)?;
            let mut rows: Vec<f32> = Vec::new();
            // As many numbers as poses have, so that there is room only where the system gives it.
            if rows.try_reserve_exact(all * POSE).is_err() {
                return Ok((Vec::new(), Vec::new()));
            }
            for poses in poses.chunks(POSES_AT_ONCE) {
                // Looked at first: a caller that is gone waits for no copies.
                if cancellable.is_cut() {
                    break;
                }
                rows.extend(poses.iter().flat_map(arrays::row_of));
            }
            Ok::<_, futures::BatchError>((outcomes, rows))
        })?;
        let (outcomes, rows) = run.or_raise()?;
        if rows.len() != all * POSE || outcomes.len() != futures {
            return Err(too_many());
        }
        let poses = arrays::array(py, rows, &[futures, steps, units, POSE])?.unbind();
        let steps = outcomes.iter().map(|outcome| u32::try_from(outcome.steps).unwrap_or(u32::MAX));
        Ok(Futures {
            poses,
            steps: arrays::array(py, steps.collect(), &[futures])?.unbind(),
            ends: outcomes.iter().map(end).collect(),
        })
    }
}

/// Why a future ended before its last step, if it did.
fn end(outcome: &Outcome) -> Option<String> {
    match &outcome.end {
        End::Complete => None,
        End::Stopped | End::Cut => Some("stopped".into()),
        End::Failed(error) => Some(text_of(error)),
        End::Refused(error) => Some(text_of(error)),
    }
}

/// Futures that were rolled out. Also made of its attributes, in this order.
///
/// Attributes
/// ----------
/// poses : array of float32, (futures, steps, units, 7)
///     After each step; a future that ended early repeats its last.
/// steps : array of uint32, (futures,)
///     Steps that each took.
/// ends : list of str or None
///     Why each took no more; None: it took all.
#[pyclass(frozen, module = "rigidformer")]
pub(crate) struct Futures {
    poses: Py<PyArrayDyn<f32>>,
    steps: Py<PyArrayDyn<u32>>,
    #[pyo3(get)]
    ends: Vec<Option<String>>,
}

#[pymethods]
impl Futures {
    #[new]
    fn new(
        poses: Bound<'_, PyArrayDyn<f32>>,
        steps: Bound<'_, PyArrayDyn<u32>>,
        ends: Vec<Option<String>>,
    ) -> PyResult<Self> {
        let found = poses.shape();
        let fits = matches!(*found, [futures, _, _, POSE] if futures == ends.len());
        if !fits {
            let shape = [Some(ends.len()), None, None, Some(POSE)];
            return Err(arrays::misshapen("poses", found, &shape));
        }
        if *steps.shape() != [ends.len()] {
            return Err(arrays::misshapen("steps", steps.shape(), &[Some(ends.len())]));
        }
        Ok(Futures { poses: poses.unbind(), steps: steps.unbind(), ends })
    }

    fn __getnewargs__<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyTuple>> {
        (self.poses(py), self.steps(py), self.ends.clone()).into_pyobject(py)
    }

    #[getter]
    fn poses(&self, py: Python<'_>) -> Py<PyArrayDyn<f32>> {
        self.poses.clone_ref(py)
    }

    #[getter]
    fn steps(&self, py: Python<'_>) -> Py<PyArrayDyn<u32>> {
        self.steps.clone_ref(py)
    }

    // An object without entries is an object: `world or other` is the world.
    fn __bool__(&self) -> bool {
        true
    }

    fn __len__(&self) -> usize {
        self.ends.len()
    }

    fn __repr__(&self) -> String {
        let complete = self.ends.iter().filter(|end| end.is_none()).count();
        format!("Futures({} futures, {complete} complete)", self.ends.len())
    }
}

/// (futures, rows, width) numbers.
pub(crate) struct Rows {
    numbers: Vec<f32>,
    rows: usize,
    width: usize,
}

impl Rows {
    fn of(
        value: Option<&Bound<'_, PyAny>>,
        name: &'static str,
        shape: [Side; 3],
    ) -> PyResult<Option<Self>> {
        value.map(|value| Rows::given(value, name, shape)).transpose()
    }

    pub(crate) fn given(
        value: &Bound<'_, PyAny>,
        name: &'static str,
        shape: [Side; 3],
    ) -> PyResult<Self> {
        let numbers = Floats::of(value, name, &shape)?;
        let (rows, width) = (numbers.side(1), numbers.side(2));
        Ok(Rows { numbers: numbers.slice()?.to_vec(), rows, width })
    }

    pub(crate) fn row(&self, future: usize, row: usize) -> &[f32] {
        let start = (future * self.rows + row) * self.width;
        self.numbers.get(start..start + self.width).unwrap_or_default()
    }
}

/// What the caller's arrays say of each future.
struct ArrayVariation {
    previous: Option<Rows>,
    current: Option<Rows>,
    velocities: Option<Rows>,
    pushes: Option<Rows>,
    physics: Option<Rows>,
    commands: Option<Rows>,
    /// By number of the driven unit.
    targets: Vec<(usize, Rows)>,
    noise: Option<futures::VelocityNoise>,
}

impl Variation for ArrayVariation {
    fn begin(&self, future: usize, scene: &mut FutureScene<'_>) -> Result<(), ChangeError> {
        let vectors = |row: &[f32]| match *row {
            [x, y, z, a, b, c] => (Vector3::new(x, y, z), Vector3::new(a, b, c)),
            _ => (Vector3::zeros(), Vector3::zeros()),
        };
        for unit in 0..scene.units() {
            if let (Some(previous), Some(current)) = (&self.previous, &self.current) {
                let [previous, current] =
                    [previous, current].map(|poses| arrays::pose_of(poses.row(future, unit)));
                scene.set_poses(unit, &previous, &current)?;
            }
            if let Some(physics) = &self.physics
                && let &[mass_kg, friction, restitution] = physics.row(future, unit)
            {
                scene.set_physics(unit, Physics { mass_kg, friction, restitution })?;
            }
            if let Some(velocities) = &self.velocities {
                let (linear, angular) = vectors(velocities.row(future, unit));
                scene.set_velocity(unit, &linear, &angular)?;
            }
            if let Some(pushes) = &self.pushes {
                let (linear, angular) = vectors(pushes.row(future, unit));
                scene.push(unit, &linear, &angular)?;
            }
        }
        // Noise comes last, on top of the velocities that were given.
        match &self.noise {
            Some(noise) => noise.begin(future, scene),
            None => Ok(()),
        }
    }

    fn steer(
        &self,
        future: usize,
        step: usize,
        scene: &mut FutureScene<'_>,
    ) -> Result<(), ChangeError> {
        if let Some(commands) = &self.commands {
            scene.set_command(commands.row(future, step))?;
        }
        for (unit, poses) in &self.targets {
            scene.drive(*unit, &arrays::pose_of(poses.row(future, step)))?;
        }
        Ok(())
    }
}

/// A variation whose futures end when the caller does not want them any more.
struct Cancellable<'w> {
    variation: &'w ArrayVariation,
    cancelled: &'w AtomicBool,
}

impl Variation for Cancellable<'_> {
    fn begin(&self, future: usize, scene: &mut FutureScene<'_>) -> Result<(), ChangeError> {
        self.variation.begin(future, scene)
    }

    fn steer(
        &self,
        future: usize,
        step: usize,
        scene: &mut FutureScene<'_>,
    ) -> Result<(), ChangeError> {
        self.variation.steer(future, step, scene)
    }

    fn is_cut(&self) -> bool {
        // A flag alone crosses threads here, so no order with other memory is needed.
        self.cancelled.load(Ordering::Relaxed)
    }
}
