//! Copies of a scene that go on from step to step.

use std::collections::BTreeMap;
use std::sync::atomic::Ordering;
use std::sync::{Mutex, PoisonError};

use nalgebra::{Isometry3, Vector3};
use numpy::PyArrayDyn;
use pyo3::intern;
use pyo3::prelude::*;
use pyo3::types::PyBytes;
use rigidformer_runtime::futures::{self, ChangeError, CopyError, End, FutureScene};
use rigidformer_runtime::world::Snapshot;

use crate::arrays::{self, Floats, POSE};
use crate::errors::{OrRaise, input, text_of};
use crate::futures::{BatchSimulator, Rows, Start, VELOCITY};
use crate::locked::Locked;
use crate::whole;
use crate::world::velocity_row;

/// Copies of a simulator, at most.
// Numbers beyond it are mistakes.
const MOST_COPIES: usize = 1 << 16;
/// Units whose step no caller waits for at Ctrl-C.
const UNITS_AT_ONCE: usize = 512;

/// Copies of one scene that go on from step to step and begin anew one by one: environments of reinforcement learning. Each goes on
/// bit for bit as the scene alone. ``BatchSimulator.copies`` makes them.
///
/// Source: ``runtime-std/src/futures/copies.rs``.
///
/// >>> import numpy as np, rigidformer as rf
/// >>> corners = 0.1 * np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)], np.float32)
/// >>> start = rf.Start(1 / 24, [rf.Unit(corners)], [[0, 0, .5, 1, 0, 0, 0]], [[0, 0, .5, 1, 0, 0, 0]])
/// >>> copies = rf.BatchSimulator(rf.Model("nano")).copies(start, 100)
/// >>> bool(copies.step().all())
/// True
/// >>> copies.reset([3, 4])
/// >>> heights = copies.poses()[:, 0, 2]
/// >>> bool(heights[3] == np.float32(.5)), bool(heights[5] < .5)
/// (True, True)
#[pyclass(frozen, module = "rigidformer")]
pub(crate) struct Copies {
    copies: Locked<futures::Copies>,
    /// Why copies did not take the last step.
    problems: Mutex<BTreeMap<usize, String>>,
    count: usize,
    units: usize,
    command_size: usize,
}

impl Copies {
    pub(crate) fn new(
        py: Python<'_>,
        simulator: &BatchSimulator,
        start: &Start,
        count: usize,
    ) -> PyResult<Self> {
        if !(1..=MOST_COPIES).contains(&count) {
            return Err(input(format!("{count} copies; give 1 to {MOST_COPIES}")));
        }
        let posed = start.posed();
        let begin = start.view(&posed);
        let simulator = &simulator.simulator;
        let copies = crate::interrupt::interruptible(py, |cancelled| {
            simulator.copies_until(&begin, count, &|| cancelled.load(Ordering::Relaxed))
        });
        let copies = copies?.or_raise()?;
        Ok(Copies {
            count,
            units: copies.units(),
            command_size: simulator.model().config().command_size as usize,
            copies: Locked::new(copies),
            problems: Mutex::default(),
        })
    }

    /// Changes some copies, or none where one change is refused.
    fn change(
        &self,
        py: Python<'_>,
        which: &[usize],
        change: impl Fn(usize, &mut FutureScene<'_>) -> Result<(), ChangeError> + Sync,
    ) -> PyResult<()> {
        let change = |copies: &mut futures::Copies| {
            let mut before: Vec<(usize, Snapshot)> = Vec::new();
            for (row, copy) in which.iter().copied().enumerate() {
                before.push((copy, copies.snapshot(copy)?));
                if let Err(error) = copies.edit(copy, |scene| change(row, scene)) {
                    // A copy may be named twice, so the oldest state comes last.
                    for (copy, state) in before.iter().rev() {
                        copies.restore(*copy, state)?;
                    }
                    return Err(error);
                }
            }
            Ok::<_, CopyError>(())
        };
        self.copies.freely(py, change)?.or_raise()
    }

    /// Numbers of copies, from numbers or from a truth each.
    fn which(&self, which: &Bound<'_, PyAny>) -> PyResult<Vec<usize>> {
        let py = which.py();
        let numpy = py.import(intern!(py, "numpy"))?;
        arrays::refuse_masked(which, "which")?;
        let array = numpy.call_method1(intern!(py, "asarray"), (which,));
        let array = array.map_err(|error| input(format!("which: {}", error.value(py))))?;
        let shape: Vec<usize> = array.getattr(intern!(py, "shape"))?.extract()?;
        let kind: String =
            array.getattr(intern!(py, "dtype"))?.getattr(intern!(py, "kind"))?.extract()?;
        let numbers = match (kind.as_str(), shape.as_slice()) {
            ("b", [count]) if *count == self.count => {
                numpy.call_method1(intern!(py, "flatnonzero"), (array,))?
            }
            ("b", found) => return Err(arrays::misshapen("which", found, &[Some(self.count)])),
            // A list of none has no type of its own.
            ("i" | "u", [_]) | (_, [0]) => array,
            _ => return Err(input("which is a truth a copy, or numbers of copies")),
        };
        let numbers: Vec<usize> = whole::which(&numbers.call_method0(intern!(py, "tolist"))?)?;
        match numbers.iter().find(|copy| **copy >= self.count) {
            Some(copy) => Err(CopyError::NoSuchCopy { copy: *copy, copies: self.count }).or_raise(),
            None => Ok(numbers),
        }
    }

    /// Rows of all units of all copies as an array, in the caller's own one if there is one.
    fn all<'py, const N: usize>(
        &self,
        py: Python<'py>,
        out: Option<Bound<'py, PyAny>>,
        row: impl Fn(&futures::Copies, usize, usize) -> [f32; N],
    ) -> PyResult<Bound<'py, PyAny>> {
        let copies = self.copies.lock(py)?;
        let pairs = (0..self.count).flat_map(|copy| (0..self.units).map(move |unit| (copy, unit)));
        let rows = pairs.map(|(copy, unit)| row(&copies, copy, unit));
        arrays::rows(py, rows, &[self.count, self.units, N], out)
    }
}

#[pymethods]
impl Copies {
    /// Advances all copies by a step. The interpreter is free meanwhile.
    ///
    /// Parameters
    /// ----------
    /// targets : dict of int to array of float32, (copies, 7), optional
    ///     Where driven units, by their number from 0, are after the step. Without one, and where a row is NaN, they stay.
    /// commands : array of float32, (copies, model.command_size), optional
    ///     Of this step and those after it.
    ///
    /// Returns
    /// -------
    /// array of bool, (copies,)
    ///     Whether each took the step; ``problems`` says why others are where they were.
    ///
    /// Raises
    /// ------
    /// InputError, TypeError
    ///     An array has another shape, or there is no such unit; no copy took the step.
    /// KeyboardInterrupt
    ///     Ctrl-C. Copies that had not begun are where they were, and in ``problems``.
    #[pyo3(signature = (*, targets = None, commands = None))]
    fn step<'py>(
        &self,
        py: Python<'py>,
        #[pyo3(from_py_with = whole::targets)] targets: Option<BTreeMap<usize, Bound<'_, PyAny>>>,
        commands: Option<&Bound<'_, PyAny>>,
    ) -> PyResult<Bound<'py, PyArrayDyn<bool>>> {
        let copies = Some(self.count);
        let mut driven = Vec::new();
        for (unit, poses) in targets.unwrap_or_default() {
            if unit >= self.units {
                let units = self.units;
                return Err(input(format!(
                    "targets: there is no unit {unit} of {units}; they are counted from 0"
                )));
            }
            driven.push((unit, arrays::poses(&poses, "targets", copies)?));
        }
        let size = self.command_size;
        let commands = commands.map(|commands| {
            Floats::of(commands, "commands", &[copies, Some(size)])?.slice().map(<[f32]>::to_vec)
        });
        let commands = commands.transpose()?;
        let steer = |copy: usize, scene: &mut FutureScene<'_>| {
            if let Some(commands) = &commands {
                scene.set_command(
                    commands.get(copy * size..(copy + 1) * size).unwrap_or_default(),
                )?;
            }
            for (unit, poses) in &driven {
                // One that is out of play goes nowhere.
                if let Some(pose) = poses.get(copy).filter(|pose| !is_nan(pose)) {
                    scene.drive(*unit, pose)?;
                }
            }
            Ok(())
        };
        let problem = |(copy, end): (usize, &Option<End>)| match end.as_ref()? {
            End::Failed(error) => Some((copy, text_of(error))),
            End::Refused(error) => Some((copy, text_of(error))),
            End::Cut => Some((copy, "interrupted before its step".to_owned())),
            _ => None,
        };
        // Noted within: an interrupted call returns nothing.
        let note = |ends: &[Option<End>]| {
            let problems = ends.iter().enumerate().filter_map(problem).collect();
            *self.problems.lock().unwrap_or_else(PoisonError::into_inner) = problems;
        };
        let ends = if self.count * self.units > UNITS_AT_ONCE {
            self.copies.interruptibly(py, |copies, cancelled| {
                let is_cut = || cancelled.load(Ordering::Relaxed);
                copies.step_until(&steer, &is_cut).inspect(|ends| note(ends))
            })
        } else {
            // A short step is not worth a thread that looks for signals.
            self.copies.freely(py, |copies| copies.step(&steer).inspect(|ends| note(ends)))
        };
        let ends = ends?.or_raise()?;
        arrays::array(py, ends.iter().map(Option::is_none).collect(), &[self.count])
    }

    /// dict of int to str: why copies did not take the last step.
    #[getter]
    fn problems(&self) -> BTreeMap<usize, String> {
        self.problems.lock().unwrap_or_else(PoisonError::into_inner).clone()
    }

    /// Puts copies where all began.
    ///
    /// Parameters
    /// ----------
    /// which : array of bool, (copies,), or sequence of int, optional
    ///     A truth a copy, or numbers of copies from 0. None: all.
    ///
    /// Raises
    /// ------
    /// InputError
    ///     There is no such copy; none was reset.
    #[pyo3(signature = (which = None))]
    fn reset(&self, py: Python<'_>, which: Option<&Bound<'_, PyAny>>) -> PyResult<()> {
        let which = match which {
            Some(which) => self.which(which)?,
            None => (0..self.count).collect(),
        };
        let reset =
            |copies: &mut futures::Copies| which.iter().try_for_each(|copy| copies.reset(*copy));
        self.copies.freely(py, reset)?.or_raise()
    }

    /// Says where units of some copies were a step ago and are now. A unit whose row in both is NaN is out of play in that copy: it is
    /// nowhere, and ``poses`` has NaN for it, until it is given poses again. The others go on bit for bit as if it had never been there,
    /// with edge; nano, whose network sees all units, sees it as scenery far away.
    ///
    /// Parameters
    /// ----------
    /// which
    ///     As of ``reset``.
    /// previous, current : arrays of float32, (copies of which, units, 7)
    /// units : sequence of int, optional
    ///     Which units these are, by number from 0. None: all.
    ///
    /// Raises
    /// ------
    /// InputError, TypeError
    ///     There is no such copy or unit, or a pose cannot be; a unit out of play would be soft, or hold to another by a joint or a
    ///     bond; all copies are what they were.
    ///
    /// >>> import numpy as np, rigidformer as rf
    /// >>> corners = 0.1 * np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)], np.float32)
    /// >>> poses = [[0, 0, .5, 1, 0, 0, 0], [0, 0, .1, 1, 0, 0, 0]]
    /// >>> start = rf.Start(1 / 24, [rf.Unit(corners)] * 2, poses, poses)
    /// >>> copies = rf.BatchSimulator(rf.Model("nano")).copies(start, 100)
    /// >>> out = np.full((2, 1, 7), np.nan)
    /// >>> copies.set_poses([3, 4], out, out, units=[1])  # two copies without the lower cube
    /// >>> bool(copies.step().all()), np.isnan(copies.poses()[:, 1, 0]).nonzero()[0].tolist()
    /// (True, [3, 4])
    #[pyo3(signature = (which, previous, current, *, units = None))]
    fn set_poses(
        &self,
        py: Python<'_>,
        which: &Bound<'_, PyAny>,
        previous: &Bound<'_, PyAny>,
        current: &Bound<'_, PyAny>,
        #[pyo3(from_py_with = whole::units)] units: Option<Vec<usize>>,
    ) -> PyResult<()> {
        let which = self.which(which)?;
        let units = self.numbers(units)?;
        let shape = [Some(which.len()), Some(units.len()), Some(POSE)];
        let [previous, current] =
            [Rows::given(previous, "previous", shape)?, Rows::given(current, "current", shape)?];
        self.change(py, &which, |row, scene| {
            units.iter().enumerate().try_for_each(|(place, unit)| {
                let poses: [Isometry3<f32>; 2] =
                    [&previous, &current].map(|poses| arrays::pose_of(poses.row(row, place)));
                match poses.iter().all(is_nan) {
                    true => scene.take_out(*unit),
                    false => scene.set_poses(*unit, &poses[0], &poses[1]),
                }
            })
        })
    }

    /// Says how units of some copies move from now on.
    ///
    /// Parameters
    /// ----------
    /// which
    ///     As of ``reset``.
    /// velocities : array of float32, (copies of which, units, 6)
    ///     As ``velocities`` returns them; those of units that are out of play are not looked at.
    /// units
    ///     As of ``set_poses``.
    ///
    /// Raises
    /// ------
    /// InputError, TypeError
    ///     There is no such copy or unit, or a velocity cannot be; all copies are what they were.
    #[pyo3(signature = (which, velocities, *, units = None))]
    fn set_velocities(
        &self,
        py: Python<'_>,
        which: &Bound<'_, PyAny>,
        velocities: &Bound<'_, PyAny>,
        #[pyo3(from_py_with = whole::units)] units: Option<Vec<usize>>,
    ) -> PyResult<()> {
        let which = self.which(which)?;
        let units = self.numbers(units)?;
        let shape = [Some(which.len()), Some(units.len()), Some(VELOCITY)];
        let rows = Rows::given(velocities, "velocities", shape)?;
        self.change(py, &which, |row, scene| {
            units.iter().enumerate().try_for_each(|(place, unit)| match *rows.row(row, place) {
                [x, y, z, a, b, c] if !scene.is_out(*unit) => {
                    scene.set_velocity(*unit, &Vector3::new(x, y, z), &Vector3::new(a, b, c))
                }
                _ => Ok(()),
            })
        })
    }

    /// Where all units of all copies are; NaN where one is out of play.
    ///
    /// Parameters
    /// ----------
    /// out : array of float32, (copies, units, 7), optional
    ///     C-contiguous: is written and returned.
    ///
    /// Returns
    /// -------
    /// array of float32, (copies, units, 7)
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
        self.all(py, out, |copies, copy, unit| {
            copies.pose(copy, unit).map_or([f32::NAN; POSE], |pose| arrays::row_of(&pose))
        })
    }

    /// How all units of all copies move now; NaN where one is out of play.
    ///
    /// Parameters
    /// ----------
    /// out : array of float32, (copies, units, 6), optional
    ///     C-contiguous: is written and returned.
    ///
    /// Returns
    /// -------
    /// array of float32, (copies, units, 6)
    ///     Of each unit its linear velocity, m/s, then its angular one, rad/s.
    ///
    /// Raises
    /// ------
    /// InputError, TypeError
    ///     ``out`` has another shape, type or layout, or cannot be written.
    #[pyo3(signature = (out = None))]
    fn velocities<'py>(
        &self,
        py: Python<'py>,
        out: Option<Bound<'py, PyAny>>,
    ) -> PyResult<Bound<'py, PyAny>> {
        self.all(py, out, |copies, copy, unit| {
            copies.velocity(copy, unit).map_or([f32::NAN; VELOCITY], |own| velocity_row(&own))
        })
    }

    /// The whole state of a copy, to go on from by ``restore`` with the same bits.
    ///
    /// Parameters
    /// ----------
    /// copy : int
    ///     From 0.
    ///
    /// Returns
    /// -------
    /// bytes
    ///
    /// Raises
    /// ------
    /// InputError
    ///     There is no such copy.
    fn snapshot<'py>(
        &self,
        py: Python<'py>,
        #[pyo3(from_py_with = whole::copy)] copy: usize,
    ) -> PyResult<Bound<'py, PyBytes>> {
        let snapshot = self.copies.lock(py)?.snapshot(copy).or_raise()?;
        Ok(PyBytes::new(py, snapshot.as_bytes()))
    }

    /// Goes on with a copy from a snapshot of any copy of this scene.
    ///
    /// Parameters
    /// ----------
    /// copy : int
    ///     From 0.
    /// snapshot : bytes
    ///     As ``snapshot`` returned it. They are checked, wherever they come from.
    ///
    /// Raises
    /// ------
    /// InputError
    ///     There is no such copy, or the bytes are no state of this scene; the copy is what it was.
    fn restore(
        &self,
        py: Python<'_>,
        #[pyo3(from_py_with = whole::copy)] copy: usize,
        snapshot: &[u8],
    ) -> PyResult<()> {
        let snapshot = Snapshot::from_bytes(snapshot.to_vec());
        self.copies.freely(py, |copies| copies.restore(copy, &snapshot))?.or_raise()
    }

    fn __len__(&self) -> usize {
        self.count
    }

    fn __repr__(&self) -> String {
        format!("Copies({} copies, {} units)", self.count, self.units)
    }
}

impl Copies {
    /// Numbers of units, or those of all.
    fn numbers(&self, units: Option<Vec<usize>>) -> PyResult<Vec<usize>> {
        let units = units.unwrap_or_else(|| (0..self.units).collect());
        match units.iter().find(|unit| **unit >= self.units) {
            Some(unit) => Err(input(format!(
                "units: there is no unit {unit} of {}; they are counted from 0",
                self.units
            ))),
            None => Ok(units),
        }
    }
}

/// Whether no number of it is one.
fn is_nan(pose: &Isometry3<f32>) -> bool {
    let (place, turn) = (pose.translation.vector, pose.rotation.coords);
    place.iter().chain(turn.iter()).all(|number| number.is_nan())
}
