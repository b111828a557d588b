//! Rollouts of recorded scenes.

use numpy::PyArrayDyn;
use pyo3::prelude::*;
use pyo3::types::PyDict;
use rigidformer_evaluation::free_fall;
use rigidformer_evaluation::metrics::{FrameErrors, frame_errors};
use rigidformer_evaluation::pivots;
use rigidformer_evaluation::predicted::{self, PointTrajectory, Predicted};
use rigidformer_evaluation::rollout as samples;
use rigidformer_runtime::progress::Progress;

use crate::arrays::{self, Floats, POSE};
use crate::errors::{OrRaise, input};
use crate::interrupt::{free, interruptible};
use crate::model::Model;
use crate::pickle::Arguments;
use crate::scene::{Scene, last_frame};
use crate::whole;
use crate::world::engine;

/// Poses of all units at evenly spaced frames: what a rollout predicted. The first two are the observed ones.
///
/// Parameters
/// ----------
/// poses : array of float32, (samples, units, 7)
///     At least one.
/// frames : sequence of int
///     The frame of each sample; they rise by the same step.
/// points : array of float32, (samples, soft points, 3), optional
///     Where the points of soft units are, metres.
/// holding : sequence of sequence of bool, optional
///     Whether each bond holds at each sample.
///
/// Raises
/// ------
/// InputError, TypeError
///     Shapes do not go together, frames are not evenly spaced, or ``holding`` is not of as many samples, each of as many bonds.
///
/// Source: ``evaluation/src/predicted.rs``.
#[pyclass(frozen, module = "rigidformer")]
pub(crate) struct Trajectory {
    predicted: Predicted,
}

#[pymethods]
impl Trajectory {
    #[new]
    #[pyo3(signature = (poses, frames, *, points = None, holding = None))]
    fn new(
        poses: &Bound<'_, PyAny>,
        #[pyo3(from_py_with = whole::frames)] frames: Vec<u32>,
        points: Option<&Bound<'_, PyAny>>,
        holding: Option<Vec<Vec<bool>>>,
    ) -> PyResult<Self> {
        let samples = frames.len();
        let poses = Floats::of(poses, "poses", &[Some(samples), None, Some(POSE)])?;
        let units = poses.side(1);
        let first_frame = frames.first().copied().unwrap_or(0);
        let step = frames.get(1).map_or(1, |second| second.saturating_sub(first_frame));
        let even = |(a, b): (&u32, &u32)| b.checked_sub(*a) == Some(step);
        // Between frames that are not evenly spaced nothing could be told.
        if step == 0
            || !frames.iter().zip(frames.iter().skip(1)).all(even)
            || units == 0
            || samples == 0
        {
            return Err(input(
                "frames must rise by one step from sample to sample, and there must be a sample of a unit",
            ));
        }
        let rows: Vec<_> = poses.slice()?.chunks_exact(POSE).map(arrays::pose_of).collect();
        let mut rows = rows.chunks_exact(units).map(<[_]>::to_vec);
        let mut all = samples::Trajectory::new(first_frame, step, rows.next().unwrap_or_default());
        rows.for_each(|sample| all.push(sample));
        let points = match points {
            Some(points) => {
                let points = Floats::of(points, "points", &[Some(samples), None, Some(3)])?;
                let count = points.side(1);
                // Points of no soft unit are as none given: they would be no samples.
                let rows = (count > 0).then(|| points.points()).transpose()?;
                rows.map(|rows| PointTrajectory {
                    first_frame,
                    step,
                    samples: rows.chunks_exact(count).map(<[_]>::to_vec).collect(),
                })
            }
            None => None,
        };
        let holding = match holding {
            Some(holding) => {
                let bonds = holding.first().map_or(0, Vec::len);
                if holding.len() != samples || holding.iter().any(|each| each.len() != bonds) {
                    let found = holding.len();
                    return Err(input(format!(
                        "holding has {found} samples for {samples} poses; give a truth of each bond at each sample"
                    )));
                }
                holding
            }
            None => Vec::new(),
        };
        Ok(Trajectory { predicted: Predicted { poses: all, points, holding } })
    }

    fn __getnewargs_ex__<'py>(&self, py: Python<'py>) -> PyResult<Arguments<'py>> {
        let more = PyDict::new(py);
        more.set_item("points", self.points(py)?)?;
        more.set_item("holding", self.holding())?;
        Ok(((self.poses(py)?, self.frames(py)?).into_pyobject(py)?, more))
    }

    /// float32 (samples, units, 7): poses. Read-only.
    #[getter]
    fn poses<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyArrayDyn<f32>>> {
        let poses = &self.predicted.poses;
        let rows = poses.iter().flat_map(|(_, poses)| poses);
        arrays::read_only(arrays::array_of_poses(py, rows, &[poses.samples(), poses.units()])?)
    }

    /// uint32 (samples,): the frame of each sample. Read-only.
    #[getter]
    fn frames<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyArrayDyn<u32>>> {
        let frames: Vec<u32> = self.predicted.poses.iter().map(|(frame, _)| frame).collect();
        let count = frames.len();
        arrays::read_only(arrays::array(py, frames, &[count])?)
    }

    /// Frames between samples.
    #[getter]
    fn step(&self) -> u32 {
        self.predicted.poses.step()
    }

    /// float32 (samples, soft points, 3): where the points of soft units are, metres; None in a scene without soft units.
    #[getter]
    fn points<'py>(&self, py: Python<'py>) -> PyResult<Option<Bound<'py, PyArrayDyn<f32>>>> {
        let Some(points) = &self.predicted.points else { return Ok(None) };
        let count = points.samples.first().map_or(0, Vec::len);
        let all = points.samples.concat();
        arrays::array_of_points(py, &all, &[points.samples.len(), count])
            .and_then(arrays::read_only)
            .map(Some)
    }

    /// list of list of bool, or None: whether each bond of the scene holds at each sample; None where the rollout held none.
    #[getter]
    fn holding(&self) -> Option<Vec<Vec<bool>>> {
        let holding = &self.predicted.holding;
        // No bonds held differs from bonds that are all broken.
        (!holding.is_empty()).then(|| holding.clone())
    }

    /// How far the units are from where they were recorded at a frame. Between samples poses are interpolated.
    ///
    /// Parameters
    /// ----------
    /// scene : Scene
    ///     That was rolled out.
    /// frame : int
    ///
    /// Returns
    /// -------
    /// tuple of float
    ///     Position error, metres, and orientation error, degrees; root mean square over units.
    ///
    /// Raises
    /// ------
    /// InputError
    ///     The frame is not predicted, or not recorded.
    ///
    /// Source: ``evaluation/src/metrics.rs``.
    fn errors(
        &self,
        scene: &Scene,
        #[pyo3(from_py_with = whole::frame)] frame: u32,
    ) -> PyResult<(f64, f64)> {
        let found = frame_errors(&self.predicted.poses, &scene.scene, frame);
        let FrameErrors { position_m, orientation_rms_deg, .. } = found
            .ok_or_else(|| input(format!("frame {frame} is not predicted, or not recorded")))?;
        Ok((position_m, orientation_rms_deg))
    }

    // An object without entries is an object: `world or other` is the world.
    fn __bool__(&self) -> bool {
        true
    }

    fn __len__(&self) -> usize {
        self.predicted.poses.samples()
    }

    fn __repr__(&self) -> String {
        let poses = &self.predicted.poses;
        format!(
            "Trajectory({} samples, {} units, step {})",
            poses.samples(),
            poses.units(),
            poses.step()
        )
    }
}

/// Predicts a recorded scene: observes its frames 0 and ``step``, then predicts every ``step`` frames. The scene's planes, gravity,
/// driven units and commands count. The interpreter is free meanwhile.
///
/// Parameters
/// ----------
/// model : Model
/// scene : Scene
///     With at least ``step`` + 1 frames.
/// step : int
///     Frames of the scene that a prediction is ahead, at least 1.
/// last_frame : int, optional
///     Where it ends, or the first sample behind that; None: with the record.
/// join : bool
///     Holds links of a body together at the pivots that frames 0 to ``step`` show.
/// threads, kernel
///     As of ``World``.
///
/// Returns
/// -------
/// Trajectory
///     Bit for bit that of ``rigidformer rollout``.
///
/// Raises
/// ------
/// InputError
///     The scene has too few frames, or the model cannot move its units.
/// StepError
///     A prediction diverged.
/// KeyboardInterrupt
///     Ctrl-C, within a step.
///
/// Source: ``evaluation/src/rollout.rs``.
///
/// >>> import rigidformer as rf
/// >>> scene = rf.Dataset.embedded().scene(0)
/// >>> predicted = rf.rollout(rf.Model("edge"), scene, step=10, last_frame=120)
/// >>> predicted.poses.shape == (13, len(scene.units), 7)
/// True
/// >>> metres, degrees = predicted.errors(scene, 100)
#[pyfunction]
#[pyo3(signature = (model, scene, step = 10, last_frame = None, *, join = false, threads = None, kernel = None))]
#[expect(clippy::too_many_arguments, reason = "Python's are named")]
pub(crate) fn rollout(
    py: Python<'_>,
    model: &Model,
    scene: &Scene,
    #[pyo3(from_py_with = whole::step)] step: u32,
    #[pyo3(from_py_with = whole::last_frame)] last_frame: Option<u32>,
    join: bool,
    #[pyo3(from_py_with = whole::threads)] threads: Option<usize>,
    kernel: Option<&str>,
) -> PyResult<Trajectory> {
    let engine = engine(threads, kernel)?;
    let last = self::last_frame(&scene.scene, step, last_frame)?;
    // Pivots are read off the frames that are observed, and off no later one.
    let joined = match join {
        true => Some(pivots::joined(scene.scene.clone(), step as usize).or_raise()?),
        false => None,
    };
    let scene = joined.as_ref().unwrap_or(&scene.scene);
    let predicted = interruptible(py, |cancelled| {
        let progress = Progress { cancelled, ..Progress::none() };
        predicted::predict(engine, &model.loaded, scene, step, last, progress)
    })?;
    Ok(Trajectory { predicted: predicted.or_raise()? })
}

/// Poses of free fall, at most: 224 MiB, within a second.
// An allocation that fails ends the process, and Python expects an exception.
const MOST_POSES: usize = 1 << 23;

/// The baseline that knows gravity and inertia and nothing else: free motion from frames 0 and ``step`` on, through everything.
///
/// Parameters
/// ----------
/// scene : Scene
/// step, last_frame : int
///     As of ``rollout``; at most 8,388,608 poses.
///
/// Returns
/// -------
/// Trajectory
///
/// Raises
/// ------
/// InputError
///     The scene has too few frames, or there would be too many poses.
///
/// Source: ``evaluation/src/free_fall.rs``.
///
/// >>> import rigidformer as rf
/// >>> len(rf.free_fall(rf.Dataset.embedded().scene(0), step=10, last_frame=120))
/// 13
#[pyfunction]
#[pyo3(name = "free_fall", signature = (scene, step = 10, last_frame = None))]
pub(crate) fn falling(
    py: Python<'_>,
    scene: &Scene,
    #[pyo3(from_py_with = whole::step)] step: u32,
    #[pyo3(from_py_with = whole::last_frame)] last_frame: Option<u32>,
) -> PyResult<Trajectory> {
    let last = self::last_frame(&scene.scene, step, last_frame)?;
    // A count that wraps round would pass the check.
    let (samples, units) = (last / step.max(1), scene.scene.units().len());
    if (samples as usize).saturating_mul(units.max(1)) > MOST_POSES {
        return Err(input(format!(
            "last_frame {last}: {samples} samples of {units} units; give at most {MOST_POSES} poses"
        )));
    }
    let too_few = || input(format!("{}: free fall needs frames 0 and {step}", scene.scene.name()));
    // The bound above keeps it within a second, so it needs no signals.
    let poses = free(py, || free_fall::trajectory(&scene.scene, 0, step, last))?;
    let poses = poses.ok_or_else(too_few)?;
    Ok(Trajectory { predicted: Predicted { poses, points: None, holding: Vec::new() } })
}
