//! Groups: several worlds in one space.

use std::time::Instant;

use numpy::PyArrayDyn;
use pyo3::intern;
use pyo3::prelude::*;
use pyo3::types::{PyDict, PyTuple};
use rigidformer_core::UnitId;
use rigidformer_runtime::group::{self, GroupError, MemberId, MemberReport};
use rigidformer_runtime::threads::Threads;

use crate::arrays::{self, Floats};
use crate::errors::{OrRaise, input};
use crate::interrupt::{TICK, free};
use crate::locked::Locked;
use crate::model::Model;
use crate::whole;
use crate::world::{Report, World};

/// How far two units of different members of a group are apart.
///
/// Attributes
/// ----------
/// members : tuple of two str
///     Names.
/// units : tuple of two int
///     Ids, each in its member's world.
/// gap_m : float
///     Metres between their convex hulls; negative where they overlap: the shortest way that would take them apart.
/// share : float
///     When in the step, from 0 at its start to 1 at its end.
#[pyclass(frozen, get_all, eq, module = "rigidformer")]
#[derive(PartialEq)]
pub(crate) struct Gap {
    members: (String, String),
    units: (u64, u64),
    gap_m: f32,
    share: f32,
}

#[pymethods]
impl Gap {
    #[new]
    #[pyo3(signature = (members, units, gap_m, share = 1.0))]
    fn new(
        members: (String, String),
        #[pyo3(from_py_with = whole::units)] units: (u64, u64),
        gap_m: f32,
        share: f32,
    ) -> Self {
        Gap { members, units, gap_m, share }
    }

    fn __getnewargs__(&self) -> ((String, String), (u64, u64), f32, f32) {
        (self.members.clone(), self.units, self.gap_m, self.share)
    }

    fn __repr__(&self) -> String {
        let Gap { members: (one, other), units: (a, b), gap_m, share } = self;
        format!("Gap(({one:?}, {other:?}), ({a}, {b}), gap_m={gap_m}, share={share})")
    }
}

/// Several worlds in one space that step together: robots, each with its model and command, and the boxes that they push.
///
/// Each member keeps its model, command, units, planes and network. All have one time step. A member's world takes in its neighbours,
/// units of others within its neighbour distance, as driven units, in the step alone: nothing pushes back. Members whose model takes a
/// command move first; the others then have them as neighbours where the step takes them, without delay. Within these two orders driven
/// neighbours go where they are told to, and others go on as in the last step. Bodies that push each other both ways belong in one world.
///
/// Robots have no neighbours unless ``set_neighbour_distance`` says so: their models are trained alone, and walk worse beside others. They
/// do not avoid each other, and walk through each other; ``gaps`` says who touches whom. A neighbour is the hull of its points.
///
/// Parameters
/// ----------
/// threads : int, optional
///     That share a step, 1 to 16; None: those of the machine. No result depends on it.
///
/// Raises
/// ------
/// InputError
///     There are no so many threads.
///
/// Source: ``runtime-std/src/group.rs``, ``docs/ROBOTS.md``.
///
/// >>> import numpy as np, rigidformer as rf
/// >>> corners = 0.1 * np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)], np.float32)
/// >>> hand, table = rf.World(rf.Model("edge")), rf.World(rf.Model("edge"))
/// >>> hand.dt_s = table.dt_s = 1 / 24
/// >>> pusher = hand.add(rf.Unit(corners, role="driven"), [-0.3, 0, 0.1, 1, 0, 0, 0])
/// >>> cube = table.add(rf.Unit(corners), [0, 0, 0.1, 1, 0, 0, 0])
/// >>> group = rf.Group()
/// >>> group.add("hand", hand)
/// >>> group.add("table", table)
/// >>> for step in range(1, 13):
/// ...     group.drive("hand", pusher, [-0.3 + 0.02 * step, 0, 0.1, 1, 0, 0, 0])
/// ...     reports = group.step()
/// >>> {name: neighbours for name, (report, neighbours) in reports.items()}
/// {'hand': 1, 'table': 1}
/// >>> bool(group.poses("table")[0, 0] > 0.1)  # pushed
/// True
/// >>> [gap.units == (pusher, cube) for gap in group.gaps(0.05)]
/// [True]
#[pyclass(frozen, module = "rigidformer")]
pub(crate) struct Group {
    group: Locked<Members>,
}

struct Members {
    group: group::Group,
    threads: Option<usize>,
    /// The caller's own models.
    models: Vec<(MemberId, Py<Model>)>,
}

impl Members {
    fn find(&self, name: &str) -> PyResult<MemberId> {
        let missing = || {
            let names = self.names().join(", ");
            input(format!("no member is called {name:?}; there are: {names}"))
        };
        self.group.find(name).ok_or_else(missing)
    }

    fn names(&self) -> Vec<String> {
        let names = self.group.ids().filter_map(|id| self.group.name(id));
        names.map(str::to_owned).collect()
    }

    fn model(&self, py: Python<'_>, id: MemberId) -> PyResult<Py<Model>> {
        let model = self.models.iter().find(|(of, _)| *of == id);
        model.map(|(_, model)| model.clone_ref(py)).ok_or_else(|| input("the member is gone"))
    }

    /// Makes an id's model this one.
    fn keep(&mut self, id: MemberId, model: Py<Model>) {
        self.models.retain(|(of, _)| *of != id);
        self.models.push((id, model));
    }
}

fn threads_of(threads: Option<usize>) -> PyResult<Threads> {
    match threads {
        Some(count @ 1..=16) => Ok(Threads::new(count)),
        Some(count) => Err(input(format!("{count} threads; give 1 to 16"))),
        None => Ok(Threads::all()),
    }
}

#[pymethods]
impl Group {
    #[new]
    #[pyo3(signature = (*, threads = None))]
    fn new(#[pyo3(from_py_with = whole::threads)] threads: Option<usize>) -> PyResult<Self> {
        let group = group::Group::on(threads_of(threads)?);
        Ok(Group { group: Locked::new(Members { group, threads, models: Vec::new() }) })
    }

    /// Takes a copy of a world in as a member, behind the others. One whose model takes a command has no neighbours, nor one of soft
    /// bodies; others have those that they may touch.
    ///
    /// Parameters
    /// ----------
    /// name : str
    ///     Of the member, which no other one has.
    /// world : World
    ///     With a time step, that of the others.
    ///
    /// Raises
    /// ------
    /// InputError
    ///     The name is taken, or the world has no time step or another one.
    fn add(&self, py: Python<'_>, name: &str, world: &Bound<'_, World>) -> PyResult<()> {
        let (world, model) = world.get().copied(py)?;
        let mut members = self.group.lock(py)?;
        let id = members.group.add(name, world).or_raise()?;
        members.keep(id, model);
        Ok(())
    }

    /// Takes a member out; the others go on as if it had never been there.
    ///
    /// Parameters
    /// ----------
    /// name : str
    ///
    /// Returns
    /// -------
    /// World
    ///     The member's.
    ///
    /// Raises
    /// ------
    /// InputError
    ///     No member has this name.
    fn remove(&self, py: Python<'_>, name: &str) -> PyResult<World> {
        let mut members = self.group.lock(py)?;
        let id = members.find(name)?;
        let model = members.model(py, id)?;
        let world = members.group.remove(id).or_raise()?;
        members.models.retain(|(of, _)| *of != id);
        Ok(World::new_of(world, model))
    }

    /// A copy of a member's world, with its own units alone.
    ///
    /// Parameters
    /// ----------
    /// name : str
    ///
    /// Returns
    /// -------
    /// World
    ///
    /// Raises
    /// ------
    /// InputError
    ///     No member has this name.
    fn world(&self, py: Python<'_>, name: &str) -> PyResult<World> {
        let name = name.to_owned();
        let (id, model) = {
            let members = self.group.lock(py)?;
            let id = members.find(&name)?;
            (id, members.model(py, id)?)
        };
        let copy = self
            .group
            .freely(py, |members| members.group.world(id).map(|world| world.try_clone()))?;
        let copy = copy.ok_or_else(|| input("the member is gone"))?.or_raise()?;
        Ok(World::new_of(copy, model))
    }

    /// Gives a member another world: a copy of this one.
    ///
    /// Parameters
    /// ----------
    /// name : str
    /// world : World
    ///     Such as one of ``world(name)`` that was changed since.
    ///
    /// Raises
    /// ------
    /// InputError
    ///     No member has this name, or the world has no time step or another one; the member keeps its world.
    fn set_world(&self, py: Python<'_>, name: &str, world: &Bound<'_, World>) -> PyResult<()> {
        let (world, model) = world.get().copied(py)?;
        let mut members = self.group.lock(py)?;
        let id = members.find(name)?;
        members.group.set_world(id, world).or_raise()?;
        members.keep(id, model);
        Ok(())
    }

    /// Gives a member the command of all following steps.
    ///
    /// Parameters
    /// ----------
    /// name : str
    /// command : array of float32
    ///     As many numbers as its model takes.
    ///
    /// Raises
    /// ------
    /// InputError, TypeError
    ///     No member has this name, or its model takes no such command; the command is what it was.
    fn command(&self, py: Python<'_>, name: &str, command: &Bound<'_, PyAny>) -> PyResult<()> {
        let mut members = self.group.lock(py)?;
        let id = members.find(name)?;
        let command = Floats::of(command, "command", &[None])?;
        members.group.set_command(id, command.slice()?).or_raise()
    }

    /// Tells a driven unit of a member where to be after the next step.
    ///
    /// Parameters
    /// ----------
    /// name : str
    /// id : int
    ///     Of a unit of that member whose role is "driven".
    /// pose : array of float32, (7,)
    ///
    /// Raises
    /// ------
    /// InputError, TypeError
    ///     No member has this name, the unit is not driven, or the pose cannot be; the unit is what it was.
    fn drive(
        &self,
        py: Python<'_>,
        name: &str,
        #[pyo3(from_py_with = whole::id)] id: u64,
        pose: &Bound<'_, PyAny>,
    ) -> PyResult<()> {
        let pose = arrays::pose(pose, "pose")?;
        let mut members = self.group.lock(py)?;
        let member = members.find(name)?;
        let world = members.group.world_mut(member).ok_or_else(|| input("the member is gone"))?;
        world.drive(UnitId::from_bits(id), &pose).or_raise()
    }

    /// Says which units of others are a member's neighbours, from the next step on. Its world needs room for them, and each costs more
    /// than one of its own.
    ///
    /// Parameters
    /// ----------
    /// name : str
    /// within_m : float, optional
    ///     Those whose bounding balls come so near its own units' in a step, metres. None: it has no neighbours.
    ///
    /// Raises
    /// ------
    /// InputError
    ///     No member has this name, the distance is none, or the member's model moves soft bodies.
    fn set_neighbour_distance(
        &self,
        py: Python<'_>,
        name: &str,
        within_m: Option<f32>,
    ) -> PyResult<()> {
        let mut members = self.group.lock(py)?;
        let id = members.find(name)?;
        members.group.set_neighbour_distance(id, within_m).or_raise()
    }

    /// Within which distance units of others are a member's neighbours.
    ///
    /// Parameters
    /// ----------
    /// name : str
    ///
    /// Returns
    /// -------
    /// float or None
    ///     Metres; None: it has no neighbours.
    ///
    /// Raises
    /// ------
    /// InputError
    ///     No member has this name.
    fn neighbour_distance(&self, py: Python<'_>, name: &str) -> PyResult<Option<f32>> {
        let members = self.group.lock(py)?;
        members.group.neighbour_distance(members.find(name)?).or_raise()
    }

    /// Advances all members.
    ///
    /// Parameters
    /// ----------
    /// steps : int
    ///     How many times.
    ///
    /// Returns
    /// -------
    /// dict of str to tuple of StepReport and int
    ///     Of the last step: what each member's world reports, and how many neighbours it had.
    ///
    /// Raises
    /// ------
    /// InputError
    ///     A member's world has another time step, or no room for its neighbours; all members are as before that step.
    /// StepError
    ///     A member cannot step: it has no command or no units, or a unit goes nowhere. All members are as before that step.
    /// KeyboardInterrupt
    ///     Ctrl-C, between two steps.
    #[pyo3(signature = (steps = 1))]
    fn step<'py>(
        &self,
        py: Python<'py>,
        #[pyo3(from_py_with = whole::steps)] steps: usize,
    ) -> PyResult<Bound<'py, PyDict>> {
        let (mut left, mut last) = (steps, Vec::new());
        while left > 0 {
            let (done, reports, names) = self
                .group
                .freely(py, |members| {
                    let (begin, mut done, mut reports) = (Instant::now(), 0, Vec::new());
                    while done < left && (done == 0 || begin.elapsed() < TICK) {
                        reports = members.group.step()?;
                        done += 1;
                    }
                    Ok::<_, GroupError>((done, reports, members.names()))
                })?
                .or_raise()?;
            last = names.into_iter().zip(reports).collect();
            left = left.saturating_sub(done);
            if left > 0 {
                py.check_signals()?;
            }
        }
        let all = PyDict::new(py);
        for (name, MemberReport { report, neighbours, .. }) in last {
            all.set_item(name, (Report::from(report), neighbours))?;
        }
        Ok(all)
    }

    /// Poses of all units of a member, in the order of its world.
    ///
    /// Parameters
    /// ----------
    /// name : str
    ///
    /// Returns
    /// -------
    /// array of float32, (units, 7)
    ///
    /// Raises
    /// ------
    /// InputError
    ///     No member has this name.
    fn poses<'py>(&self, py: Python<'py>, name: &str) -> PyResult<Bound<'py, PyArrayDyn<f32>>> {
        let members = self.group.lock(py)?;
        let world = members.group.world(members.find(name)?);
        let world = world.ok_or_else(|| input("the member is gone"))?;
        let poses: Vec<_> = world.simulator().units().map(|unit| unit.pose()).collect();
        arrays::array_of_poses(py, &poses, &[poses.len()])
    }

    /// Ids of all units of a member, in the order of ``poses``.
    ///
    /// Parameters
    /// ----------
    /// name : str
    ///
    /// Returns
    /// -------
    /// list of int
    ///
    /// Raises
    /// ------
    /// InputError
    ///     No member has this name.
    fn ids(&self, py: Python<'_>, name: &str) -> PyResult<Vec<u64>> {
        let members = self.group.lock(py)?;
        let world = members.group.world(members.find(name)?);
        let world = world.ok_or_else(|| input("the member is gone"))?;
        Ok(world.simulator().units().map(|unit| unit.id().to_bits()).collect())
    }

    /// All pairs of units of different members that are near each other, the nearest first.
    ///
    /// Parameters
    /// ----------
    /// within_m : float
    ///     The greatest gap between their hulls, metres; 0: those that touch or overlap.
    /// in_step : bool
    ///     The least gap in all of the last step, at looks 2 cm of motion apart, and not that of now.
    ///
    /// Returns
    /// -------
    /// list of Gap
    ///
    /// Raises
    /// ------
    /// InputError
    ///     The distance is none.
    #[pyo3(signature = (within_m = 0.0, *, in_step = false))]
    fn gaps(&self, py: Python<'_>, within_m: f32, in_step: bool) -> PyResult<Vec<Gap>> {
        let found = self.group.freely(py, |members| {
            let group = &members.group;
            let gaps = match in_step {
                true => group.gaps_in_step(within_m),
                false => group.gaps(within_m),
            }?;
            let name = |id| group.name(id).unwrap_or_default().to_owned();
            let named = gaps.into_iter().map(|gap| Gap {
                members: gap.members.map(name).into(),
                units: gap.units.map(UnitId::to_bits).into(),
                gap_m: gap.gap_m,
                share: gap.share,
            });
            Ok::<_, GroupError>(named.collect::<Vec<_>>())
        })?;
        found.or_raise()
    }

    /// Another group in the same state, which goes on by itself: to look ahead in.
    ///
    /// Returns
    /// -------
    /// Group
    ///
    /// Raises
    /// ------
    /// MemoryLimitError
    ///     There is no memory for it.
    fn copy(&self, py: Python<'_>) -> PyResult<Self> {
        let members = self.group.lock(py)?;
        let group = free(py, || members.group.try_clone())?.or_raise()?;
        let models = members.models.iter().map(|(id, model)| (*id, model.clone_ref(py)));
        let (models, threads) = (models.collect(), members.threads);
        drop(members);
        Ok(Group { group: Locked::new(Members { group, threads, models }) })
    }

    fn __copy__(&self, py: Python<'_>) -> PyResult<Self> {
        self.copy(py)
    }

    fn __deepcopy__(&self, py: Python<'_>, _memo: &Bound<'_, PyAny>) -> PyResult<Self> {
        self.copy(py)
    }

    fn __reduce__<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyTuple>> {
        // Of one time, whatever other threads step meanwhile.
        let group = self.copy(py)?;
        let (names, threads) = {
            let members = group.group.lock(py)?;
            (members.names(), members.threads)
        };
        let member = |name: String| {
            Ok((
                name.clone(),
                group.world(py, &name)?.into_pyobject(py)?,
                group.neighbour_distance(py, &name)?,
            ))
        };
        let members = names.into_iter().map(member).collect::<PyResult<Vec<_>>>()?;
        let again = py.import(intern!(py, "rigidformer._state"))?.getattr(intern!(py, "group"))?;
        (again, (threads, members)).into_pyobject(py)
    }

    /// list of str: names of the members, in the order in which they came.
    #[getter]
    fn names(&self, py: Python<'_>) -> PyResult<Vec<String>> {
        Ok(self.group.lock(py)?.names())
    }

    /// float or None: seconds of a step; None before there is a member.
    #[getter]
    fn dt_s(&self, py: Python<'_>) -> PyResult<Option<f32>> {
        Ok(self.group.lock(py)?.group.dt_s())
    }

    // An object without entries is an object: `group or other` is the group.
    fn __bool__(&self) -> bool {
        true
    }

    fn __len__(&self, py: Python<'_>) -> PyResult<usize> {
        Ok(self.group.lock(py)?.group.len())
    }

    fn __repr__(&self, py: Python<'_>) -> PyResult<String> {
        Ok(format!("Group({})", self.group.lock(py)?.names().join(", ")))
    }
}
