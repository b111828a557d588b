//! Worlds.

use std::sync::MutexGuard;
use std::time::Instant;

use nalgebra::{Isometry3, Point3, Vector3};
use numpy::PyArrayDyn;
use pyo3::intern;
use pyo3::prelude::*;
use pyo3::types::{PyBytes, PyTuple};
use rigidformer_core::{
    self as core, Compliance, JoinError, Limits, Observed, Physics, Posed, StepError, StepReport,
    UnitId, Velocity,
};
use rigidformer_runtime::engine::Engine;
use rigidformer_runtime::kernels::Kernel;
use rigidformer_runtime::threads::Threads;
use rigidformer_runtime::world;

use crate::arrays::{self, Floats, POSE};
use crate::bonds::{Bond, Joint, joint_kind};
use crate::errors::{OrRaise, input, raise};
use crate::futures::{Start, VELOCITY};
use crate::interrupt::{TICK, free, held};
use crate::locked::Locked;
use crate::model::Model;
use crate::unit::{
    HeightField, Plane, Unit, array_of_vector, law, law_of, planes, planes_of, role_name, role_of,
};
use crate::whole;

/// A scene that moves: units, planes, gravity and a time step, and the model that advances them.
///
/// A unit has an id, a number that stays valid until it is removed. A pose is seven float32: x, y, z in metres, then w, x, y, z
/// of a unit quaternion; it carries the unit's points to the world, right-handed with z up. A world starts on the model's ground,
/// z = 0, under its gravity. A soft unit has points instead: its pose carries their mean at rest to their mean now, without a turn.
/// Threads may share a world: their calls follow each other, but between two steps of one ``step`` or ``rollout`` that takes longer
/// than 20 ms another thread's call may come. Different worlds step at the same time.
///
/// Parameters
/// ----------
/// model : Model
///     Predicts.
/// units, points : int
///     The most units, and points of all units together, that it must hold: its memory.
/// threads : int, optional
///     That share a step, 1 to 16; None: those of the machine. No result depends on it.
/// kernel : str, optional
///     One of ``kernels()``; None: the fastest. No result depends on it.
///
/// Raises
/// ------
/// InputError
///     There is no memory for the limits, or no such kernel.
///
/// Source: ``runtime-std/src/world.rs``.
///
/// >>> import numpy as np, rigidformer as rf
/// >>> corners = 0.2 * np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)], np.float32)
/// >>> world = rf.World(rf.Model("edge"), units=8, points=512)
/// >>> world.dt_s = 1 / 24
/// >>> cube = world.add(rf.Unit(corners), [0, 0, 1, 1, 0, 0, 0])
/// >>> world.step(6)
/// StepReport(active_units=0, degenerate_units=0, quarantined_units=0)
/// >>> bool(world.pose(cube)[2] < 0.8)
/// True
#[pyclass(frozen, module = "rigidformer")]
pub(crate) struct World {
    world: Locked<world::World>,
    /// The caller's own: worlds of one model that are pickled together share it.
    model: Py<Model>,
}

impl World {
    pub(crate) fn new_of(world: world::World, model: Py<Model>) -> Self {
        World { world: Locked::new(world), model }
    }

    /// A copy of the world, and its model.
    pub(crate) fn copied(&self, py: Python<'_>) -> PyResult<(world::World, Py<Model>)> {
        let other = self.world.freely(py, |world| world.try_clone())?.or_raise()?;
        Ok((other, self.model.clone_ref(py)))
    }

    fn lock(&self, py: Python<'_>) -> PyResult<MutexGuard<'_, world::World>> {
        self.world.lock(py)
    }

    /// Steps until so many are done or a tick has passed, with the interpreter free: the steps that were done.
    fn some_steps(
        &self,
        py: Python<'_>,
        most: usize,
        seen: &mut (dyn FnMut(&world::World) + Send),
    ) -> PyResult<(usize, StepReport)> {
        let steps = |world: &mut world::World| {
            let begin = Instant::now();
            let engine = world.engine();
            // A single step is not worth waking a thread that hands work on.
            let mut body = || {
                let (mut done, mut report) = (0, StepReport::default());
                // At least one step, or a slow model would never advance.
                while done < most && (done == 0 || begin.elapsed() < TICK) {
                    report = world.step()?;
                    done += 1;
                    seen(world);
                }
                Ok::<_, StepError>((done, report))
            };
            if most == 1 { body() } else { engine.enter(body) }
        };
        self.world.freely(py, steps)?.or_raise()
    }

    /// So many steps; signals are looked for between them.
    fn all_steps(
        &self,
        py: Python<'_>,
        steps: usize,
        seen: &mut (dyn FnMut(&world::World) + Send),
    ) -> PyResult<StepReport> {
        let (mut left, mut report) = (steps, StepReport::default());
        while left > 0 {
            let (done, last) = self.some_steps(py, left, seen)?;
            (left, report) = (left.saturating_sub(done), last);
            if left > 0 {
                py.check_signals()?;
            }
        }
        Ok(report)
    }
}

pub(crate) fn velocity_row(velocity: &Velocity) -> [f32; VELOCITY] {
    let Velocity { linear_m_s: v, angular_rad_s: w } = velocity;
    [v.x, v.y, v.z, w.x, w.y, w.z]
}

fn velocity_of(&[x, y, z, a, b, c]: &[f32; VELOCITY]) -> Velocity {
    Velocity { linear_m_s: Vector3::new(x, y, z), angular_rad_s: Vector3::new(a, b, c) }
}

/// From so many points on, a scene is changed aside: they take longer to order than a caller waits at Ctrl-C.
const MANY_POINTS: usize = 4096;

fn copy_of(world: &mut world::World) -> Option<world::World> {
    world.try_clone().ok()
}

fn no_such(id: u64) -> PyErr {
    raise(rigidformer_core::EditError::NoSuchUnit { id: UnitId::from_bits(id) })
}

/// Kernels and threads by name and number.
pub(crate) fn engine(threads: Option<usize>, kernel: Option<&str>) -> PyResult<Engine> {
    let kernel = match kernel {
        Some(name) => {
            let kernel: Kernel = name.parse().or_raise()?;
            // A kernel of another processor ends the process with an illegal instruction.
            if !Kernel::available().contains(&kernel) {
                let lacking = rigidformer_runtime::kernels::KernelError::Lacking { kernel };
                return Err(raise(lacking));
            }
            kernel
        }
        None => Kernel::chosen().or_raise()?,
    };
    let threads = match threads {
        Some(count @ 1..=16) => Threads::new(count),
        Some(count) => return Err(input(format!("{count} threads; give 1 to 16"))),
        None => Threads::all(),
    };
    Ok(Engine { kernel, threads })
}

/// Names of the kernels that this processor can run, fastest last. They give the same bits.
///
/// Source: ``kernels/src/choice.rs``.
///
/// >>> import rigidformer as rf
/// >>> rf.kernels()[0]
/// 'portable'
#[pyfunction]
pub(crate) fn kernels() -> Vec<&'static str> {
    Kernel::available().into_iter().map(Kernel::name).collect()
}

/// What a step was like.
///
/// Attributes
/// ----------
/// active_units : int
///     Units whose motion the network predicted; the others can touch nothing within the step and moved freely, exactly, or are
///     driven or fixed.
/// degenerate_units : int
///     Units whose anchors left their rotation open.
/// quarantined_units : int
///     Units that diverged and are held until they are given poses.
#[pyclass(frozen, get_all, eq, name = "StepReport", module = "rigidformer")]
#[derive(PartialEq)]
pub(crate) struct Report {
    active_units: u32,
    degenerate_units: u32,
    quarantined_units: u32,
}

#[pymethods]
impl Report {
    #[new]
    #[pyo3(signature = (active_units, degenerate_units = 0, quarantined_units = 0))]
    fn new(
        #[pyo3(from_py_with = whole::active_units)] active_units: u32,
        #[pyo3(from_py_with = whole::degenerate_units)] degenerate_units: u32,
        #[pyo3(from_py_with = whole::quarantined_units)] quarantined_units: u32,
    ) -> Self {
        Report { active_units, degenerate_units, quarantined_units }
    }

    fn __getnewargs__(&self) -> (u32, u32, u32) {
        (self.active_units, self.degenerate_units, self.quarantined_units)
    }

    fn __repr__(&self) -> String {
        let Report { active_units, degenerate_units, quarantined_units } = self;
        format!(
            "StepReport(active_units={active_units}, degenerate_units={degenerate_units}, quarantined_units={quarantined_units})"
        )
    }
}

impl From<StepReport> for Report {
    fn from(report: StepReport) -> Self {
        let StepReport { active_units, degenerate_units, quarantined_units } = report;
        Report { active_units, degenerate_units, quarantined_units }
    }
}

/// What an accepted observation was like.
///
/// Attributes
/// ----------
/// residual_m : float
///     Largest distance of an observed point from the rigid fit of its unit, metres; 0 where poses were given. Far above the
///     sensor's noise, a unit was not rigid or its points were not the same in both frames.
/// degenerate_units : int
///     Units whose points left their rotation open: all on a line.
#[pyclass(frozen, get_all, eq, module = "rigidformer")]
#[derive(PartialEq)]
pub(crate) struct Observation {
    residual_m: f32,
    degenerate_units: u32,
}

#[pymethods]
impl Observation {
    #[new]
    #[pyo3(signature = (residual_m, degenerate_units = 0))]
    fn new(
        residual_m: f32,
        #[pyo3(from_py_with = whole::degenerate_units)] degenerate_units: u32,
    ) -> Self {
        Observation { residual_m, degenerate_units }
    }

    fn __getnewargs__(&self) -> (f32, u32) {
        (self.residual_m, self.degenerate_units)
    }

    fn __repr__(&self) -> String {
        let Observation { residual_m, degenerate_units } = self;
        format!("Observation(residual_m={residual_m}, degenerate_units={degenerate_units})")
    }
}

impl From<rigidformer_core::Observation> for Observation {
    fn from(seen: rigidformer_core::Observation) -> Self {
        let rigidformer_core::Observation { residual_m, degenerate_units } = seen;
        Observation { residual_m, degenerate_units }
    }
}

#[pymethods]
impl World {
    #[new]
    #[pyo3(signature = (model, *, units = 64, points = 8192, threads = None, kernel = None))]
    fn new(
        py: Python<'_>,
        model: Bound<'_, Model>,
        #[pyo3(from_py_with = whole::units)] units: usize,
        #[pyo3(from_py_with = whole::points)] points: usize,
        #[pyo3(from_py_with = whole::threads)] threads: Option<usize>,
        kernel: Option<&str>,
    ) -> PyResult<Self> {
        let engine = engine(threads, kernel)?;
        let limits = Limits { units, points };
        let loaded = &model.get().loaded;
        let world = free(py, || world::World::on(engine, loaded, limits, 1))?;
        Ok(World { world: Locked::new(world.or_raise()?), model: model.unbind() })
    }

    /// Starts from two frames of points. The previous frame becomes the reference frame of poses: a pose carries its points on.
    /// Bonds and joints of the scene before are gone. Scenes with soft units begin so alone, and take a model of them.
    ///
    /// Parameters
    /// ----------
    /// dt_s : float
    ///     Seconds between the frames, and of every step from then on. Above 0.
    /// units : sequence of Unit
    ///     With their points in the previous frame, in the world, metres.
    /// current : sequence of arrays of float32, (n, 3)
    ///     The same points in the same order, in the current frame. C-contiguous float32 arrays are read in place.
    ///
    /// Returns
    /// -------
    /// Observation
    ///
    /// Raises
    /// ------
    /// InputError, TypeError
    ///     Something is wrong with a unit or a point; the world is what it was.
    ///
    /// Source: ``core/src/simulator/observe.rs``.
    ///
    /// >>> import numpy as np, rigidformer as rf
    /// >>> before = np.array([[0, 0, 1], [.2, 0, 1], [0, .2, 1], [0, 0, 1.2]], np.float32)
    /// >>> world = rf.World(rf.Model("nano"))
    /// >>> seen = world.observe(1 / 24, [rf.Unit(before)], [before + np.float32([.1, 0, 0])])
    /// >>> seen.residual_m < 1e-6
    /// True
    /// >>> world.poses().shape
    /// (1, 7)
    ///
    /// Soft units are their points at rest, stiffness, and where they are:
    ///
    /// >>> soft = rf.Unit(before, rest=before, young_pa=1e4)
    /// >>> world.observe(1 / 24, [soft], [before])
    /// Traceback (most recent call last):
    /// rigidformer.InputError: unit 0 is soft, the model moves rigid units alone; give it a model of elastic motion, such as shell.rfm
    fn observe(
        &self,
        py: Python<'_>,
        dt_s: f32,
        units: Vec<Bound<'_, Unit>>,
        current: Vec<Bound<'_, PyAny>>,
    ) -> PyResult<Observation> {
        if units.len() != current.len() {
            let (given, found) = (units.len(), current.len());
            return Err(input(format!(
                "current has {found} arrays for {given} units; give one a unit"
            )));
        }
        if units.iter().map(|unit| unit.get().room()).sum::<usize>() > MANY_POINTS {
            let own: Vec<Unit> = units.iter().map(|unit| unit.get().clone()).collect();
            let points =
                |points| Ok(Floats::of(points, "current", &[None, Some(3)])?.points()?.to_vec());
            let current =
                current.iter().map(points).collect::<PyResult<Vec<Vec<Point3<f32>>>>>()?;
            let observe = move |world: &mut world::World| {
                let seen = own.iter().zip(&current);
                let seen = seen.map(|(unit, current)| Observed { unit: unit.view(), current });
                let seen: Vec<_> = seen.collect();
                world.edit(|simulator| simulator.observe(dt_s, &seen))
            };
            return Ok(self.world.aside(py, copy_of, observe)?.or_raise()?.into());
        }
        // The lock comes first: waiting for it lets others run, who may write into the arrays.
        let mut world = self.lock(py)?;
        let current = current.iter().map(|points| Floats::of(points, "current", &[None, Some(3)]));
        let current = current.collect::<PyResult<Vec<_>>>()?;
        let seen = units.iter().zip(&current).map(|(unit, current)| {
            Ok(Observed { unit: unit.get().view(), current: current.points()? })
        });
        let seen = seen.collect::<PyResult<Vec<_>>>()?;
        // The interpreter stays held, because the arrays are read in place and nobody may write
        // into them.
        let observation = held(|| world.edit(|simulator| simulator.observe(dt_s, &seen)));
        self.world.note(&observation);
        let observation = observation?;
        Ok(observation.or_raise()?.into())
    }

    /// Starts from known poses. Bonds and joints of the scene before are gone.
    ///
    /// Parameters
    /// ----------
    /// dt_s : float
    ///     Seconds between the two frames, and of every step from then on. Above 0.
    /// units : sequence of Unit
    ///     With their points in their own reference frames.
    /// previous, current : arrays of float32, (units, 7)
    ///     Their poses in the two frames.
    ///
    /// Returns
    /// -------
    /// Observation
    ///     All zeros: nothing was fitted.
    ///
    /// Raises
    /// ------
    /// InputError, TypeError
    ///     Something is wrong with a unit or a pose; the world is what it was.
    ///
    /// Source: ``core/src/simulator/observe.rs``.
    ///
    /// >>> import rigidformer as rf
    /// >>> scene = rf.Dataset.embedded().scene(0)
    /// >>> world = rf.World(rf.Model("edge"))
    /// >>> _ = world.observe_poses(10 / scene.frame_rate_hz, scene.units, scene.poses[0], scene.poses[10])
    /// >>> len(world) == len(scene.units)
    /// True
    fn observe_poses(
        &self,
        py: Python<'_>,
        dt_s: f32,
        units: Vec<Bound<'_, Unit>>,
        previous: &Bound<'_, PyAny>,
        current: &Bound<'_, PyAny>,
    ) -> PyResult<Observation> {
        let count = Some(units.len());
        let previous = arrays::poses(previous, "previous", count)?;
        let current = arrays::poses(current, "current", count)?;
        let poses: Vec<_> = previous.into_iter().zip(current).collect();
        let observe = move |world: &mut world::World, units: &[&Unit]| {
            let posed = units.iter().zip(&poses);
            let posed: Vec<Posed<'_>> = posed
                .map(|(unit, (previous, current))| Posed {
                    unit: unit.view(),
                    previous: *previous,
                    current: *current,
                })
                .collect();
            world.edit(|simulator| simulator.observe_poses(dt_s, &posed))
        };
        // Poses are copies, so other threads may run.
        let units: Vec<&Unit> = units.iter().map(|unit| unit.get()).collect();
        let seen = if units.iter().map(|unit| unit.room()).sum::<usize>() > MANY_POINTS {
            let own: Vec<Unit> = units.into_iter().cloned().collect();
            let units =
                move |world: &mut world::World| observe(world, &own.iter().collect::<Vec<_>>());
            self.world.aside(py, copy_of, units)?
        } else {
            self.world.freely(py, |world| observe(world, &units))?
        };
        Ok(seen.or_raise()?.into())
    }

    /// Adds a unit. ``dt_s`` must have been set, or a scene observed.
    ///
    /// Parameters
    /// ----------
    /// unit : Unit
    ///     With its points in its reference frame.
    /// pose : array of float32, (7,)
    ///     Where it is.
    /// previous : array of float32, (7,), optional
    ///     Where it was a step ago. None: it is at rest.
    ///
    /// Returns
    /// -------
    /// int
    ///     Its id.
    ///
    /// Raises
    /// ------
    /// InputError, TypeError
    ///     The unit or a pose cannot be; the world is what it was.
    /// KeyboardInterrupt
    ///     Ctrl-C, of a unit of more than 4,096 points; the world is what it was.
    ///
    /// Source: ``core/src/simulator/command.rs``.
    #[pyo3(signature = (unit, pose, previous = None))]
    fn add(
        &self,
        py: Python<'_>,
        unit: &Bound<'_, Unit>,
        pose: &Bound<'_, PyAny>,
        previous: Option<&Bound<'_, PyAny>>,
    ) -> PyResult<u64> {
        let pose = arrays::pose(pose, "pose")?;
        let previous = previous.map(|previous| arrays::pose(previous, "previous")).transpose()?;
        let (unit, previous) = (unit.get(), previous.unwrap_or(pose));
        let add = move |world: &mut world::World, unit: &Unit| {
            world.edit(|simulator| simulator.add(&unit.view(), &previous, &pose))
        };
        // Points are looked at for as long as there are many; other threads run meanwhile.
        let id = if unit.room() > MANY_POINTS {
            let unit = unit.clone();
            self.world.aside(py, copy_of, move |world| add(world, &unit))?
        } else {
            self.world.freely(py, |world| add(world, unit))?
        };
        Ok(id.or_raise()?.to_bits())
    }

    /// Removes a unit. The others keep their ids and their order.
    ///
    /// Raises
    /// ------
    /// InputError
    ///     No unit has this id.
    fn remove(&self, py: Python<'_>, #[pyo3(from_py_with = whole::id)] id: u64) -> PyResult<()> {
        self.lock(py)?.remove(UnitId::from_bits(id)).or_raise()
    }

    /// Tells a driven unit where to be after the next step. It stays there until it is told again.
    ///
    /// Parameters
    /// ----------
    /// id : int
    ///     Of a unit whose role is "driven".
    /// pose : array of float32, (7,)
    ///     Its target, at most 100 m/s away along each axis.
    ///
    /// Raises
    /// ------
    /// InputError, TypeError
    ///     The unit is not driven, or the pose cannot be; the unit is what it was.
    ///
    /// Source: ``core/src/simulator/command.rs``.
    ///
    /// >>> import numpy as np, rigidformer as rf
    /// >>> points = np.array([[0, 0, 0], [.1, 0, 0], [0, .1, 0], [0, 0, .1]], np.float32)
    /// >>> world = rf.World(rf.Model("edge")); world.dt_s = 1 / 24
    /// >>> hand = world.add(rf.Unit(points, role="driven"), [0, 0, 1, 1, 0, 0, 0])
    /// >>> world.drive(hand, [0.125, 0, 1, 1, 0, 0, 0])
    /// >>> _ = world.step()
    /// >>> float(world.pose(hand)[0])
    /// 0.125
    fn drive(
        &self,
        py: Python<'_>,
        #[pyo3(from_py_with = whole::id)] id: u64,
        pose: &Bound<'_, PyAny>,
    ) -> PyResult<()> {
        let pose = arrays::pose(pose, "pose")?;
        self.lock(py)?.drive(UnitId::from_bits(id), &pose).or_raise()
    }

    /// Sets the command of all following steps, for models that take one, such as those of robots.
    ///
    /// Parameters
    /// ----------
    /// command : array of float32, (model.command_size,)
    ///     In the units that the model was trained with, such as (forward m/s, left m/s, turn rad/s).
    ///
    /// Raises
    /// ------
    /// InputError, TypeError
    ///     It has another size, or a number that is not finite; the command before stays.
    ///
    /// Source: ``core/src/simulator/command.rs``.
    fn command(&self, py: Python<'_>, command: &Bound<'_, PyAny>) -> PyResult<()> {
        let mut world = self.lock(py)?;
        let command = Floats::of(command, "command", &[None])?;
        let numbers = command.slice()?;
        world.edit(|simulator| simulator.set_command(numbers)).or_raise()
    }

    /// Says where a unit was a step ago and is now. A driven unit forgets its target; a unit in quarantine is free again.
    ///
    /// Parameters
    /// ----------
    /// id : int
    /// previous, current : arrays of float32, (7,)
    ///
    /// Raises
    /// ------
    /// InputError, TypeError
    ///     No unit has this id, or a pose cannot be; the unit is what it was.
    fn set_poses(
        &self,
        py: Python<'_>,
        #[pyo3(from_py_with = whole::id)] id: u64,
        previous: &Bound<'_, PyAny>,
        current: &Bound<'_, PyAny>,
    ) -> PyResult<()> {
        let previous = arrays::pose(previous, "previous")?;
        let current = arrays::pose(current, "current")?;
        let id = UnitId::from_bits(id);
        self.lock(py)?.edit(|simulator| simulator.set_poses(id, &previous, &current)).or_raise()
    }

    /// Gives a unit velocities: without contact it flies as a thrown body does. A driven unit forgets its target.
    ///
    /// Parameters
    /// ----------
    /// id : int
    /// linear_m_s : array of float32, (3,)
    ///     Of its reference frame's origin, m/s.
    /// angular_rad_s : array of float32, (3,)
    ///     In the world's axes, rad/s, at most half a turn a step.
    ///
    /// Raises
    /// ------
    /// InputError, TypeError
    ///     No unit has this id, or a number is not finite or too large; the unit is what it was.
    ///
    /// Source: ``core/src/simulator/velocity.rs``.
    ///
    /// >>> import numpy as np, rigidformer as rf
    /// >>> corners = 0.1 * np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)], np.float32)
    /// >>> world = rf.World(rf.Model("edge"), units=2, points=16)
    /// >>> world.dt_s, world.gravity_m_s2 = 0.02, [0, 0, -9.81]
    /// >>> ball = world.add(rf.Unit(corners), [0, 0, 5, 1, 0, 0, 0])
    /// >>> world.set_velocity(ball, [1, 0, 2], [0, 0, 0])
    /// >>> _ = world.step(10)
    /// >>> bool(np.allclose(world.velocity(ball), [1, 0, 2 - 0.2 * 9.81, 0, 0, 0], atol=1e-3))
    /// True
    fn set_velocity(
        &self,
        py: Python<'_>,
        #[pyo3(from_py_with = whole::id)] id: u64,
        linear_m_s: &Bound<'_, PyAny>,
        angular_rad_s: &Bound<'_, PyAny>,
    ) -> PyResult<()> {
        let linear = arrays::vector(linear_m_s, "linear_m_s")?;
        let angular = arrays::vector(angular_rad_s, "angular_rad_s")?;
        self.lock(py)?.set_velocity(UnitId::from_bits(id), &linear, &angular).or_raise()
    }

    /// Gives all units velocities, in the order of ``ids``.
    ///
    /// Parameters
    /// ----------
    /// velocities : array of float32, (units, 6)
    ///     As ``velocities`` returns them.
    ///
    /// Raises
    /// ------
    /// InputError, TypeError
    ///     Another shape, or a number that is not finite or too large; all units are what they were.
    ///
    /// Source: ``core/src/simulator/velocity.rs``.
    fn set_velocities(&self, py: Python<'_>, velocities: &Bound<'_, PyAny>) -> PyResult<()> {
        let velocities = Floats::of(velocities, "velocities", &[None, Some(VELOCITY)])?;
        let rows = velocities.slice()?.as_chunks::<VELOCITY>().0;
        let rows: Vec<_> = rows.iter().map(velocity_of).collect();
        self.lock(py)?.set_velocities(&rows).or_raise()
    }

    /// How a unit moves now, at the end of its last step: what lies still has no velocity.
    ///
    /// Returns
    /// -------
    /// array of float32, (6,)
    ///     The linear velocity of its reference frame's origin, m/s, then the angular one along the world's axes, rad/s.
    ///
    /// Raises
    /// ------
    /// InputError
    ///     No unit has this id.
    ///
    /// Source: ``core/src/simulator/velocity.rs``.
    fn velocity<'py>(
        &self,
        py: Python<'py>,
        #[pyo3(from_py_with = whole::id)] id: u64,
    ) -> PyResult<Bound<'py, PyArrayDyn<f32>>> {
        let velocity = self.lock(py)?.velocity(UnitId::from_bits(id)).ok_or_else(|| no_such(id))?;
        arrays::array(py, velocity_row(&velocity).to_vec(), &[VELOCITY])
    }

    /// How all units move now, in the order of ``ids``.
    ///
    /// Parameters
    /// ----------
    /// out : array of float32, (units, 6), optional
    ///     C-contiguous: is written and returned, so that a loop makes no arrays.
    ///
    /// Returns
    /// -------
    /// array of float32, (units, 6)
    ///     Of each unit its linear velocity, m/s, then its angular one, rad/s.
    ///
    /// Raises
    /// ------
    /// InputError, TypeError
    ///     ``out`` has another shape, type or layout, or cannot be written.
    ///
    /// Source: ``core/src/simulator/velocity.rs``.
    ///
    /// >>> import numpy as np, rigidformer as rf
    /// >>> scene = rf.Dataset.embedded().scene(0)
    /// >>> world = rf.World(rf.Model("edge"))
    /// >>> _ = world.observe_poses(10 / scene.frame_rate_hz, scene.units, scene.poses[0], scene.poses[10])
    /// >>> now = world.velocities()
    /// >>> world.set_velocities(now)
    /// >>> now.shape == (len(world), 6), bool(np.allclose(world.velocities(), now, atol=1e-3))
    /// (True, True)
    #[pyo3(signature = (out = None))]
    fn velocities<'py>(
        &self,
        py: Python<'py>,
        out: Option<Bound<'py, PyAny>>,
    ) -> PyResult<Bound<'py, PyAny>> {
        let velocities = self.lock(py)?.velocities();
        arrays::rows(py, velocities.iter().map(velocity_row), &[velocities.len(), VELOCITY], out)
    }

    /// Centres of mass of all units, in the order of ``ids``, with all digits that the world keeps: float32 hold no more than 6 cm at
    /// 1000 km.
    ///
    /// Returns
    /// -------
    /// array of float64, (units, 3)
    ///     x, y, z in the world, metres.
    ///
    /// Source: ``core/src/simulator/units.rs``.
    ///
    /// >>> import numpy as np, rigidformer as rf
    /// >>> corners = 0.1 * np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)], np.float32)
    /// >>> world = rf.World(rf.Model("edge"), units=1, points=8)
    /// >>> world.dt_s = 1e-4
    /// >>> world.gravity_m_s2 = [0, 0, -10]
    /// >>> _ = world.add(rf.Unit(corners), [1e5, 0, 10, 1, 0, 0, 0])
    /// >>> before = world.centres()
    /// >>> _ = world.step(3)
    /// >>> fallen = (before - world.centres())[0, 2]
    /// >>> bool(abs(fallen - 10 * (3 * 1e-4) ** 2 / 2) < 1e-12)
    /// True
    fn centres<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyArrayDyn<f64>>> {
        let world = self.lock(py)?;
        let numbers: Vec<f64> =
            world.simulator().units().flat_map(|unit| unit.centre().coords.data.0[0]).collect();
        arrays::array(py, numbers, &[world.simulator().len(), 3])
    }

    /// The whole state of the world, to go on from by ``restore`` with the same bits: units, motion, joints, bonds, soft points, command,
    /// planes, gravity and time step.
    ///
    /// Returns
    /// -------
    /// bytes
    ///     The same on all machines; they may be kept in a file.
    ///
    /// Source: ``core/src/simulator/snapshot/mod.rs``.
    ///
    /// >>> import numpy as np, rigidformer as rf
    /// >>> corners = 0.1 * np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)], np.float32)
    /// >>> world = rf.World(rf.Model("edge"), units=2, points=16)
    /// >>> world.dt_s = 1 / 24
    /// >>> _ = world.add(rf.Unit(corners), [0, 0, .5, 1, 0, 0, 0])
    /// >>> _ = world.step(3)
    /// >>> then = world.snapshot()
    /// >>> first = world.rollout(10)
    /// >>> world.restore(then)
    /// >>> bool((world.rollout(10) == first).all())
    /// True
    fn snapshot<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyBytes>> {
        let snapshot = self.world.freely(py, |world| world.snapshot())?;
        Ok(PyBytes::new(py, snapshot.as_bytes()))
    }

    /// Goes on from a snapshot of a world of the same model. Units have the ids that they had; ids that were given since then are given
    /// to no other unit.
    ///
    /// Parameters
    /// ----------
    /// snapshot : bytes
    ///     As ``snapshot`` returned it, in this world or in another one. They are checked, wherever they come from.
    ///
    /// Raises
    /// ------
    /// InputError
    ///     No snapshot, a damaged one or one of another model, or the world is too small for it; the world is what it was.
    ///
    /// Source: ``core/src/simulator/snapshot/mod.rs``.
    fn restore(&self, py: Python<'_>, snapshot: &[u8]) -> PyResult<()> {
        let snapshot = world::Snapshot::from_bytes(snapshot.to_vec());
        self.world.freely(py, |world| world.restore(&snapshot))?.or_raise()
    }

    /// The world as it is, for futures, copies and planners to start from: its units with roles and velocities, joints, bonds, planes,
    /// gravity and command. They go on from it with the world's bits; the world itself stays where it is.
    ///
    /// Returns
    /// -------
    /// Start
    ///
    /// Raises
    /// ------
    /// InputError
    ///     The world has no units.
    ///
    /// Source: ``runtime-std/src/futures/state.rs``.
    ///
    /// >>> import numpy as np, rigidformer as rf
    /// >>> corners = 0.2 * np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)], np.float32)
    /// >>> world = rf.World(rf.Model("edge"))
    /// >>> world.dt_s = 1 / 24
    /// >>> cube = world.add(rf.Unit(corners), [0, 0, 1, 1, 0, 0, 0])
    /// >>> futures = rf.BatchSimulator(rf.Model("edge")).run(world.start(), 3, 12)
    /// >>> bool((futures.poses == world.rollout(12)).all())
    /// True
    fn start(&self, py: Python<'_>) -> PyResult<Start> {
        let state = self.world.freely(py, |world| world.start())?.or_raise()?;
        match state.units() {
            0 => Err(input("the world has no units; add one first")),
            _ => Ok(Start::of_state(state)),
        }
    }

    /// Another world in the same state, which goes on by itself. ``copy.copy``, ``copy.deepcopy`` and ``pickle`` give one, too.
    ///
    /// Returns
    /// -------
    /// World
    ///
    /// Raises
    /// ------
    /// InputError
    ///     There is no memory for it.
    ///
    /// Source: ``runtime-std/src/world.rs``.
    fn copy(&self, py: Python<'_>) -> PyResult<Self> {
        let (other, model) = self.copied(py)?;
        Ok(World::new_of(other, model))
    }

    fn __copy__(&self, py: Python<'_>) -> PyResult<Self> {
        self.copy(py)
    }

    fn __deepcopy__(&self, py: Python<'_>, _memo: &Bound<'_, PyAny>) -> PyResult<Self> {
        self.copy(py)
    }

    // Kernels are those of the process that reads it: its processor may lack others, and no result depends on them.
    fn __reduce__<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyTuple>> {
        let world = self.lock(py)?;
        let (limits, threads) = (world.simulator().limits(), world.engine().threads.count());
        let state = PyBytes::new(py, world.snapshot().as_bytes());
        let field = world.height_field().map(|field| HeightField { field });
        drop(world);
        let again = py.import(intern!(py, "rigidformer._state"))?.getattr(intern!(py, "world"))?;
        let arguments =
            (self.model.clone_ref(py), limits.units, limits.points, threads, state, field);
        (again, arguments).into_pyobject(py)
    }

    /// Makes pairs of units hold together rigidly, from the next step on: free units of one body. What bonds connect, directly or
    /// through others, moves as one rigid body, for models whose motion is by impulses. Units hold where they are: what is bonded
    /// while it moves goes on with the mean motion. A bond holds until it is broken, one of the two is removed or another scene is
    /// observed; models of fragments break bonds too, in a step. Each pair is bonded once.
    ///
    /// Parameters
    /// ----------
    /// pairs : sequence of (int, int)
    ///     Ids, 8 bonds a unit of the world's limit at most.
    ///
    /// Raises
    /// ------
    /// InputError
    ///     Two units cannot hold together; the bonds are what they were.
    ///
    /// Source: ``core/src/simulator/bond.rs``.
    ///
    /// >>> import numpy as np, rigidformer as rf
    /// >>> corners = 0.1 * np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)], np.float32)
    /// >>> half = rf.Unit(corners, body=1)
    /// >>> world = rf.World(rf.Model("edge"), units=2, points=16)
    /// >>> world.dt_s = 1 / 60
    /// >>> pair = [world.add(half, [x, 0, .5, 1, 0, 0, 0]) for x in (0, .2)]
    /// >>> world.bond([pair])
    /// >>> _ = world.step(30)  # they fall and land as one brick
    /// >>> world.bonds
    /// [Bond((1, 2), holds=True)]
    /// >>> world.break_bond(pair)
    /// True
    fn bond(
        &self,
        py: Python<'_>,
        #[pyo3(from_py_with = whole::pairs)] pairs: Vec<[u64; 2]>,
    ) -> PyResult<()> {
        let pairs: Vec<_> = pairs.into_iter().map(|pair| pair.map(UnitId::from_bits)).collect();
        self.world.freely(py, |world| world.edit(|simulator| simulator.bond(&pairs)))?.or_raise()
    }

    /// Breaks the bond of a pair for good. What parts from the cluster's first unit is a body of its own from then on.
    ///
    /// Parameters
    /// ----------
    /// pair : (int, int)
    ///     Ids.
    ///
    /// Returns
    /// -------
    /// bool
    ///     Whether the bond held until then.
    ///
    /// Raises
    /// ------
    /// InputError
    ///     The pair has no bond; the bonds are what they were.
    ///
    /// Source: ``core/src/simulator/bond.rs``.
    fn break_bond(
        &self,
        py: Python<'_>,
        #[pyo3(from_py_with = whole::pair)] pair: [u64; 2],
    ) -> PyResult<bool> {
        let pair = pair.map(UnitId::from_bits);
        self.world
            .freely(py, |world| world.edit(|simulator| simulator.break_bond(pair)))?
            .or_raise()
    }

    /// Hangs a unit from another by a joint: from the next step on the two stay together there. A unit that hangs already hangs from the new parent alone. Free units that hang together keep their centre of mass; driven and fixed ones
    /// stay, and the others hang from them. A joint holds until ``unjoin``, until one of the two is removed or another scene is
    /// observed.
    ///
    /// Parameters
    /// ----------
    /// unit, parent : int
    ///     Ids of rigid units, best parts of one body: those do not collide.
    /// pivot, parent_pivot : arrays of float32, (3,)
    ///     The same place in the reference frames of both, metres, within 1e6.
    /// kind : str, optional
    ///     ``"ball"``: it turns about the pivot. ``"revolute"``: about an axis through it. ``"prismatic"``: it slides along an axis.
    ///     ``"fixed"``: neither. Models that do not move units by impulses know balls alone.
    /// axis : array of float32, (3,), optional
    ///     Of revolute and prismatic joints, in the unit's reference frame, of any length but 0. Positions along it are 0 as the two
    ///     are now.
    /// limits : two floats, optional
    ///     Least and greatest position: radians within half a turn to either side, or metres.
    /// max_force : float, optional
    ///     The most that takes the joint to a target, N m or N, above 0. None: whatever that takes.
    ///
    /// Raises
    /// ------
    /// InputError, TypeError
    ///     The two cannot be joined; the joints are what they were.
    ///
    /// Source: ``core/src/simulator/join.rs``.
    ///
    /// >>> import numpy as np, rigidformer as rf
    /// >>> corners = 0.1 * np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)], np.float32)
    /// >>> world = rf.World(rf.Model("edge"), units=2, points=16)
    /// >>> world.dt_s = 1 / 24
    /// >>> hand = world.add(rf.Unit(corners, role="driven", body=1), [0, 0, 1, 1, 0, 0, 0])
    /// >>> link = world.add(rf.Unit(corners, body=1), [.2, 0, 1, 1, 0, 0, 0])
    /// >>> world.join(link, hand, [-.1, 0, 0], [.1, 0, 0])
    /// >>> _ = world.step(6)  # the link swings down from the hand
    /// >>> bool(world.pose(link)[2] < 1), world.joints[0].parent == hand
    /// (True, True)
    /// >>> world.network = False
    /// >>> world.join(link, hand, [-.1, 0, 0], [.1, 0, 0], kind="revolute", axis=[0, 1, 0], limits=(-1, 1))
    /// >>> world.set_joint_target(link, 0.25)
    /// >>> _ = world.step()
    /// >>> round(world.joint_position(link), 3)
    /// 0.25
    #[pyo3(signature = (unit, parent, pivot, parent_pivot, kind = "ball", axis = None, limits = None, max_force = None))]
    #[expect(clippy::too_many_arguments, reason = "Python's have names")]
    fn join(
        &self,
        py: Python<'_>,
        #[pyo3(from_py_with = whole::unit)] unit: u64,
        #[pyo3(from_py_with = whole::parent)] parent: u64,
        pivot: &Bound<'_, PyAny>,
        parent_pivot: &Bound<'_, PyAny>,
        kind: &str,
        axis: Option<&Bound<'_, PyAny>>,
        limits: Option<[f32; 2]>,
        max_force: Option<f32>,
    ) -> PyResult<()> {
        let kind = joint_kind(kind, axis, limits, max_force)?;
        let pivot = arrays::vector(pivot, "pivot")?.into();
        let parent_pivot = arrays::vector(parent_pivot, "parent_pivot")?.into();
        let [unit, parent] = [unit, parent].map(UnitId::from_bits);
        let joint = core::Joint::ball(unit, parent, pivot, parent_pivot).kind(kind);
        self.world.freely(py, |world| world.edit(|simulator| simulator.join(&joint)))?.or_raise()
    }

    /// Takes a joint to a position by the end of the next step, and holds it there; beyond a limit that is the limit.
    ///
    /// Parameters
    /// ----------
    /// id : int
    ///     The unit that hangs by a revolute or prismatic joint.
    /// target : float or None
    ///     Radians, the shorter way round, or metres. None: from then on the joint is free.
    ///
    /// Raises
    /// ------
    /// InputError
    ///     The unit has no such joint, or the target is out of range; it is what it was.
    ///
    /// Source: ``core/src/simulator/join.rs``. See ``join`` for an example.
    #[pyo3(signature = (id, target))]
    fn set_joint_target(
        &self,
        py: Python<'_>,
        #[pyo3(from_py_with = whole::id)] id: u64,
        target: Option<f32>,
    ) -> PyResult<()> {
        let id = UnitId::from_bits(id);
        self.lock(py)?.edit(|simulator| simulator.set_joint_target(id, target)).or_raise()
    }

    /// Position of the joint that a unit hangs by.
    ///
    /// Returns
    /// -------
    /// float
    ///     Radians from minus half a turn to half a turn, or metres.
    ///
    /// Raises
    /// ------
    /// InputError
    ///     The unit hangs by no revolute or prismatic joint.
    ///
    /// Source: ``core/src/simulator/join.rs``. See ``join`` for an example.
    fn joint_position(
        &self,
        py: Python<'_>,
        #[pyo3(from_py_with = whole::id)] id: u64,
    ) -> PyResult<f32> {
        let id = UnitId::from_bits(id);
        let world = self.lock(py)?;
        let known = world.simulator().number(id).is_some();
        let none = if known { JoinError::NoAxis { id } } else { JoinError::NoSuchUnit { id } };
        world.simulator().joint_position(id).ok_or(none).or_raise()
    }

    /// Lets a unit go from its parent.
    ///
    /// Returns
    /// -------
    /// Joint or None
    ///     The joint that it had, None if it hung from no unit.
    ///
    /// Raises
    /// ------
    /// InputError
    ///     No unit has this id.
    ///
    /// Source: ``core/src/simulator/join.rs``.
    fn unjoin(
        &self,
        py: Python<'_>,
        #[pyo3(from_py_with = whole::id)] id: u64,
    ) -> PyResult<Option<Joint>> {
        let id = UnitId::from_bits(id);
        let joint = self.lock(py)?.edit(|simulator| simulator.unjoin(id)).or_raise()?;
        Ok(joint.map(Joint::from))
    }

    /// Changes what a unit is made of: kilograms from 1e-9 to 1e9, coefficients from 0 to 1000.
    ///
    /// Raises
    /// ------
    /// InputError
    ///     No unit has this id, or a number is out of range; the unit is what it was.
    fn set_physics(
        &self,
        py: Python<'_>,
        #[pyo3(from_py_with = whole::id)] id: u64,
        mass_kg: f32,
        friction: f32,
        restitution: f32,
    ) -> PyResult<()> {
        let (id, physics) = (UnitId::from_bits(id), Physics { mass_kg, friction, restitution });
        self.lock(py)?.edit(|simulator| simulator.set_physics(id, physics)).or_raise()
    }

    /// Changes how contact with a unit gives way (``Unit``): N/m from 1e-3 to 1e12, or 0 (rigid), and s/m from 0 to 1e6.
    ///
    /// Raises
    /// ------
    /// InputError
    ///     No unit has this id, or a number is out of range; the unit is what it was.
    ///
    /// Source: ``core/src/simulator/command.rs``.
    #[pyo3(signature = (id, stiffness_n_m, dissipation_s_m = 0.0))]
    fn set_compliance(
        &self,
        py: Python<'_>,
        #[pyo3(from_py_with = whole::id)] id: u64,
        stiffness_n_m: f32,
        dissipation_s_m: f32,
    ) -> PyResult<()> {
        let compliance = Compliance { stiffness_n_m, dissipation_s_m };
        let id = UnitId::from_bits(id);
        self.lock(py)?.edit(|simulator| simulator.set_compliance(id, compliance)).or_raise()
    }

    /// As ``set_compliance``, of one of the ``planes``, by its number from 0. New planes are rigid.
    ///
    /// Raises
    /// ------
    /// InputError
    ///     There is no such plane, or a number is out of range; the plane is what it was.
    ///
    /// Source: ``core/src/simulator/command.rs``.
    #[pyo3(signature = (plane, stiffness_n_m, dissipation_s_m = 0.0))]
    fn set_plane_compliance(
        &self,
        py: Python<'_>,
        #[pyo3(from_py_with = whole::plane)] plane: usize,
        stiffness_n_m: f32,
        dissipation_s_m: f32,
    ) -> PyResult<()> {
        let compliance = Compliance { stiffness_n_m, dissipation_s_m };
        self.lock(py)?
            .edit(|simulator| simulator.set_plane_compliance(plane, compliance))
            .or_raise()
    }

    /// Changes who moves a unit: "free", "driven" or "fixed".
    ///
    /// Raises
    /// ------
    /// InputError
    ///     There is no such unit or role.
    fn set_role(
        &self,
        py: Python<'_>,
        #[pyo3(from_py_with = whole::id)] id: u64,
        role: &str,
    ) -> PyResult<()> {
        let (id, role) = (UnitId::from_bits(id), role_of(role)?);
        self.lock(py)?.edit(|simulator| simulator.set_role(id, role)).or_raise()
    }

    /// Who moves a unit.
    ///
    /// Raises
    /// ------
    /// InputError
    ///     No unit has this id.
    fn role(
        &self,
        py: Python<'_>,
        #[pyo3(from_py_with = whole::id)] id: u64,
    ) -> PyResult<&'static str> {
        let world = self.lock(py)?;
        let unit = world.simulator().get(UnitId::from_bits(id)).ok_or_else(|| no_such(id))?;
        Ok(role_name(unit.role()))
    }

    /// Advances the scene. The interpreter is free meanwhile.
    ///
    /// Parameters
    /// ----------
    /// steps : int
    ///     How many steps of ``dt_s``.
    ///
    /// Returns
    /// -------
    /// StepReport
    ///     Of the last step.
    ///
    /// Raises
    /// ------
    /// StepError
    ///     A step was refused. The world is where the step before left it.
    /// KeyboardInterrupt
    ///     Ctrl-C, looked for between steps. The world is where the last step left it.
    ///
    /// Source: ``core/src/simulator/step.rs``.
    #[pyo3(signature = (steps = 1))]
    fn step(
        &self,
        py: Python<'_>,
        #[pyo3(from_py_with = whole::steps)] steps: usize,
    ) -> PyResult<Report> {
        Ok(self.all_steps(py, steps, &mut |_| {})?.into())
    }

    /// Advances the scene and keeps the poses after each step. The interpreter is free meanwhile.
    ///
    /// Parameters
    /// ----------
    /// steps : int
    ///     How many steps of ``dt_s``.
    ///
    /// Returns
    /// -------
    /// array of float32, (steps, units, 7)
    ///
    /// Raises
    /// ------
    /// StepError, KeyboardInterrupt
    ///     As ``step``: the steps before were taken.
    ///
    /// >>> import rigidformer as rf
    /// >>> scene = rf.Dataset.embedded().scene(0)
    /// >>> world = rf.World(rf.Model("edge"))
    /// >>> _ = world.observe_poses(10 / scene.frame_rate_hz, scene.units, scene.poses[0], scene.poses[10])
    /// >>> world.rollout(5).shape == (5, len(scene.units), 7)
    /// True
    fn rollout<'py>(
        &self,
        py: Python<'py>,
        #[pyo3(from_py_with = whole::steps)] steps: usize,
    ) -> PyResult<Bound<'py, PyArrayDyn<f32>>> {
        let mut poses: Vec<Isometry3<f32>> = Vec::new();
        // Counted first, to see whether another thread changes it.
        let units = self.lock(py)?.simulator().len();
        self.all_steps(py, steps, &mut |world| {
            poses.extend(world.simulator().units().map(|unit| unit.pose()));
        })?;
        // Another thread may add units meanwhile.
        if poses.len() != steps.saturating_mul(units) {
            return Err(input("units came or went during the rollout; the steps were taken"));
        }
        arrays::array_of_poses(py, &poses, &[steps, units])
    }

    /// Where a unit is.
    ///
    /// Returns
    /// -------
    /// array of float32, (7,)
    ///     Its pose, metres and a unit quaternion: carries its reference points to the world.
    ///
    /// Raises
    /// ------
    /// InputError
    ///     No unit has this id.
    fn pose<'py>(
        &self,
        py: Python<'py>,
        #[pyo3(from_py_with = whole::id)] id: u64,
    ) -> PyResult<Bound<'py, PyArrayDyn<f32>>> {
        let pose = self.lock(py)?.pose(UnitId::from_bits(id)).ok_or_else(|| no_such(id))?;
        arrays::array_of_poses(py, [&pose], &[])
    }

    /// Where all units are, in the order of ``ids``.
    ///
    /// Parameters
    /// ----------
    /// out : array of float32, (units, 7), optional
    ///     C-contiguous: is written and returned, so that a loop makes no arrays.
    ///
    /// Returns
    /// -------
    /// array of float32, (units, 7)
    ///
    /// Raises
    /// ------
    /// InputError, TypeError
    ///     ``out`` has another shape, type or layout, or cannot be written.
    #[pyo3(signature = (out = None))]
    fn poses<'py>(
        &self,
        py: Python<'py>,
        out: Option<Bound<'py, PyAny>>,
    ) -> PyResult<Bound<'py, PyAny>> {
        let world = self.lock(py)?;
        let simulator = world.simulator();
        let units = simulator.units().map(|unit| arrays::row_of(&unit.pose()));
        arrays::rows(py, units, &[simulator.len(), POSE], out)
    }

    /// Where a unit was before the last step: float32 (7,). Of one whose pose or velocity is another since, and of worlds that were
    /// pickled, where its motion says that it was, as if it had flown. ``velocity`` says how a unit moves now; to go
    /// back to a state, take a ``snapshot``.
    ///
    /// Raises
    /// ------
    /// InputError
    ///     No unit has this id.
    fn previous_pose<'py>(
        &self,
        py: Python<'py>,
        #[pyo3(from_py_with = whole::id)] id: u64,
    ) -> PyResult<Bound<'py, PyArrayDyn<f32>>> {
        let world = self.lock(py)?;
        let pose = world.previous_pose(UnitId::from_bits(id)).ok_or_else(|| no_such(id))?;
        arrays::array_of_poses(py, [&pose], &[])
    }

    /// Where a unit's points are: float32 (n, 3), metres, in the world, in the simulator's own order (farthest points first).
    ///
    /// Raises
    /// ------
    /// InputError
    ///     No unit has this id.
    fn points<'py>(
        &self,
        py: Python<'py>,
        #[pyo3(from_py_with = whole::id)] id: u64,
    ) -> PyResult<Bound<'py, PyArrayDyn<f32>>> {
        let world = self.lock(py)?;
        let unit = world.simulator().get(UnitId::from_bits(id)).ok_or_else(|| no_such(id))?;
        let points: Vec<_> = unit.points().collect();
        arrays::array_of_points(py, &points, &[points.len()])
    }

    /// Where the points of a soft unit are.
    ///
    /// Returns
    /// -------
    /// array of float32, (n, 3)
    ///     Metres, in the world, in the order of the points that the unit was given by.
    ///
    /// Raises
    /// ------
    /// InputError
    ///     No unit has this id, or the unit is rigid.
    ///
    /// Source: ``core/src/simulator/units.rs``.
    fn soft_points<'py>(
        &self,
        py: Python<'py>,
        #[pyo3(from_py_with = whole::id)] id: u64,
    ) -> PyResult<Bound<'py, PyArrayDyn<f32>>> {
        let world = self.lock(py)?;
        let unit = world.simulator().get(UnitId::from_bits(id)).ok_or_else(|| no_such(id))?;
        // A rigid unit's points are in another order, which this call must not mix in.
        if !unit.is_soft() {
            let id = unit.id();
            return Err(input(format!("{id} is rigid; `pose` and `points` say where it is")));
        }
        let mut points = vec![Point3::origin(); unit.point_count()];
        for (number, point) in unit.soft_points() {
            if let Some(slot) = points.get_mut(number) {
                *slot = point;
            }
        }
        arrays::array_of_points(py, &points, &[points.len()])
    }

    /// Whether a unit is soft.
    ///
    /// Raises
    /// ------
    /// InputError
    ///     No unit has this id.
    fn is_soft(&self, py: Python<'_>, #[pyo3(from_py_with = whole::id)] id: u64) -> PyResult<bool> {
        let world = self.lock(py)?;
        let unit = world.simulator().get(UnitId::from_bits(id)).ok_or_else(|| no_such(id))?;
        Ok(unit.is_soft())
    }

    /// How far a unit is from what training saw.
    ///
    /// Returns
    /// -------
    /// tuple of str and float, or None
    ///     The quantity that is farthest outside of its range, and how far that is, in widths of the range; below 0: inside.
    ///     None where the model does not say what training saw.
    ///
    /// Raises
    /// ------
    /// InputError
    ///     No unit has this id.
    ///
    /// Source: ``core/src/simulator/health.rs``, ``docs/HEALTH.md``.
    fn health(
        &self,
        py: Python<'_>,
        #[pyo3(from_py_with = whole::id)] id: u64,
    ) -> PyResult<Option<(String, f32)>> {
        let world = self.lock(py)?;
        let health = world.simulator().health(UnitId::from_bits(id)).ok_or_else(|| no_such(id))?;
        Ok(health.farthest.map(|excess| (excess.quantity.name().to_owned(), excess.beyond)))
    }

    /// list of int: the units' ids, in the order in which they were observed and added.
    #[getter]
    fn ids(&self, py: Python<'_>) -> PyResult<Vec<u64>> {
        Ok(self.lock(py)?.simulator().units().map(|unit| unit.id().to_bits()).collect())
    }

    /// list of Bond: all that were made, in their order, and whether they hold.
    #[getter]
    fn bonds(&self, py: Python<'_>) -> PyResult<Vec<Bond>> {
        Ok(self.lock(py)?.simulator().bonds().map(Bond::from).collect())
    }

    /// list of Joint: in the order of the units that hang.
    #[getter]
    fn joints(&self, py: Python<'_>) -> PyResult<Vec<Joint>> {
        Ok(self.lock(py)?.simulator().joints().map(Joint::from).collect())
    }

    /// Seconds of a step; None before it was set or a scene observed. It must be set before units are added.
    #[getter]
    fn dt_s(&self, py: Python<'_>) -> PyResult<Option<f32>> {
        Ok(self.lock(py)?.simulator().dt_s())
    }

    #[setter]
    fn set_dt_s(&self, py: Python<'_>, dt_s: f32) -> PyResult<()> {
        self.lock(py)?.set_dt(dt_s).or_raise()
    }

    /// float32 (3,), read-only: gravity, m/s^2; the model's until it is set. At most 1e4 along each axis.
    #[getter]
    fn gravity_m_s2<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyArrayDyn<f32>>> {
        array_of_vector(py, &self.lock(py)?.simulator().gravity_m_s2())
    }

    #[setter]
    fn set_gravity_m_s2(&self, py: Python<'_>, gravity: &Bound<'_, PyAny>) -> PyResult<()> {
        let gravity = arrays::vector(gravity, "gravity_m_s2")?;
        self.lock(py)?.set_gravity(gravity).or_raise()
    }

    /// tuple of Plane: what units stand on and between, at most 8; the model's ground until they are set. None: an empty one.
    #[getter]
    fn planes<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyTuple>> {
        planes(py, self.lock(py)?.simulator().planes())
    }

    #[setter]
    fn set_planes(&self, py: Python<'_>, planes: Vec<Bound<'_, Plane>>) -> PyResult<()> {
        self.lock(py)?.set_planes(&planes_of(&planes)).or_raise()
    }

    /// HeightField or None: ground of varying height, besides the planes. Impulses alone move units on it.
    #[getter]
    fn height_field(&self, py: Python<'_>) -> PyResult<Option<HeightField>> {
        Ok(self.lock(py)?.height_field().map(|field| HeightField { field }))
    }

    #[setter]
    fn set_height_field(
        &self,
        py: Python<'_>,
        field: Option<Bound<'_, HeightField>>,
    ) -> PyResult<()> {
        let field = field.as_ref().map(|field| &field.get().field);
        self.lock(py)?.set_height_field(field).or_raise()
    }

    /// Whether a unit that diverges is held until it is given poses, instead of the step being refused.
    #[getter]
    fn quarantine(&self, py: Python<'_>) -> PyResult<bool> {
        Ok(self.lock(py)?.simulator().quarantine())
    }

    #[setter]
    fn set_quarantine(&self, py: Python<'_>, quarantine: bool) -> PyResult<()> {
        self.lock(py)?.edit(|simulator| simulator.set_quarantine(quarantine));
        Ok(())
    }

    /// tuple of float and str, or None: how contacts that bounce differ from rigid ones. What is added to the restitution of each pair,
    /// from 0 to 1, and where friction is limited, "cone" or "pyramid"; PyBullet's is (0.03, "pyramid"). None: contacts are rigid, as
    /// they are until it is set.
    #[getter]
    fn contact_law(&self, py: Python<'_>) -> PyResult<Option<(f32, &'static str)>> {
        Ok(law(&self.lock(py)?.simulator().contact_law()))
    }

    #[setter]
    fn set_contact_law(&self, py: Python<'_>, given: Option<(f32, String)>) -> PyResult<()> {
        let law = law_of(given)?;
        self.lock(py)?.set_contact_law(law).or_raise()
    }

    /// Whether the network corrects motion; False: units move as they do without it.
    #[getter]
    fn network(&self, py: Python<'_>) -> PyResult<bool> {
        Ok(self.lock(py)?.simulator().has_network())
    }

    #[setter]
    fn set_network(&self, py: Python<'_>, network: bool) -> PyResult<()> {
        self.lock(py)?.set_network(network);
        Ok(())
    }

    // An object without entries is an object: `world or other` is the world.
    fn __bool__(&self) -> bool {
        true
    }

    fn __len__(&self, py: Python<'_>) -> PyResult<usize> {
        Ok(self.lock(py)?.simulator().len())
    }

    fn __repr__(&self, py: Python<'_>) -> PyResult<String> {
        let world = self.lock(py)?;
        let name = world.model().model().file().name();
        Ok(format!("World({} units, model '{name}')", world.simulator().len()))
    }
}
