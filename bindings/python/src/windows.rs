//! What training learns from.

use pyo3::prelude::*;
use pyo3::types::PyDict;
use rigidformer_core::weights::{IMPACT_FEATURES, Motion};
use rigidformer_evaluation::windows::{self, Seen, Window};
use rigidformer_runtime::engine::Engine;

use crate::arrays::{self, Floats, POSE};
use crate::errors::{OrRaise, input};
use crate::interrupt::free;
use crate::model::Model;
use crate::scene::Scene;

/// Windows of a call, at most: it is not interrupted.
const MOST_WINDOWS: usize = 1 << 16;

/// Numbers of a row of ``uncorrected``: the centre, the rotation by rows, way, turn, share.
const UNCORRECTED: usize = 3 + 9 + 3 + 3 + 1;

/// What the network of a model sees in single steps of a recorded scene, and where these steps end without it: what training learns
/// from. A window of ``(first, step)`` observes the frames ``first`` and ``first + step``, and steps to ``first + 2 * step``. The
/// interpreter is free meanwhile, and a call takes one thread: many scenes go to many threads of Python.
///
/// Parameters
/// ----------
/// model : Model
///     One that moves units by impulses. Its configuration and its normalisation count, its other weights do not.
/// scene : Scene
/// windows : sequence of tuple (int, int)
///     At most 65,536.
/// points : sequence of sequence of int, optional
///     For each unit the numbers of the points to tell of, in the model's order, where each is farthest from those before; None: all.
///     All units are told of as many.
/// starts : array of float32, (windows, 2, units, 7), optional
///     Poses that windows observe in place of their two frames of the record.
///
/// Returns
/// -------
/// dict of arrays, a row for each unit that the network sees in each window:
///     ``window`` and ``unit``, uint32; ``features``, (rows, points, inputs), normalised; ``impacts``, (rows, most impacts, inputs),
///     normalised, and ``impact_count``; ``uncorrected``, float64 (rows, 19): the unit's centre, metres, the rotation of its internal frame by
///     rows, the way of its centre and its turn (radians) in a step at the velocity and the spin of the end, and what a correction of 1 is,
///     m/s (0: nothing touches the unit, below 0: it rests).
///
/// Raises
/// ------
/// InputError
///     A frame is not recorded, the model does not move units by impulses, or ``points`` or ``starts`` does not fit.
/// StepError
///     A step diverged.
///
/// Source: ``evaluation/src/windows.rs``.
///
/// >>> import rigidformer as rf
/// >>> scene = rf.Dataset.embedded().scene(0)
/// >>> seen = rf.network_inputs(rf.Model("edge"), scene, [(0, 10), (60, 10)])
/// >>> seen["features"].shape[0] == len(seen["window"])
/// True
#[pyfunction]
#[pyo3(signature = (model, scene, windows, *, points = None, starts = None))]
pub(crate) fn network_inputs<'py>(
    py: Python<'py>,
    model: &Model,
    scene: &Scene,
    windows: Vec<(u32, u32)>,
    points: Option<Vec<Vec<usize>>>,
    starts: Option<&Bound<'py, PyAny>>,
) -> PyResult<Bound<'py, PyDict>> {
    let config = model.loaded.model().config();
    if config.motion != Motion::Impulses {
        return Err(input(
            "the model does not move units by impulses; give edge or nano, or one of their kind",
        ));
    }
    if windows.len() > MOST_WINDOWS || windows.iter().any(|(_, step)| *step == 0) {
        return Err(input(format!(
            "windows: give at most {MOST_WINDOWS}, with steps of 1 frame or more"
        )));
    }
    let units = scene.scene.units().len();
    let told = points.as_ref().and_then(|points| points.first()).map(Vec::len);
    let misfits = |points: &Vec<Vec<usize>>| {
        points.len() != units || points.iter().any(|own| Some(own.len()) != told)
    };
    if points.as_ref().is_some_and(misfits) {
        return Err(input(format!(
            "points: give as many numbers for each of the scene's {units} units"
        )));
    }
    let width = config.features.len();
    let asked: Vec<_> = windows.iter().map(|&(first, step)| Window { first, step }).collect();
    let starts = match starts {
        Some(starts) => {
            let shape = [Some(windows.len()), Some(2), Some(units), Some(POSE)];
            let poses = Floats::of(starts, "starts", &shape)?;
            let poses: Vec<_> = poses.slice()?.chunks_exact(POSE).map(arrays::pose_of).collect();
            // A scene has units.
            let pairs = poses.chunks_exact(2 * units.max(1)).map(|pair| pair.split_at(units));
            pairs.map(|(before, then)| [before.to_vec(), then.to_vec()]).collect()
        }
        None => Vec::new(),
    };
    let engine = Engine::new().or_raise()?.single();
    let found =
        free(py, || windows::network_inputs(engine, &model.loaded, &scene.scene, &asked, &starts))?;
    let found = found.or_raise()?;
    let rows: Vec<(usize, &Seen)> = found
        .iter()
        .enumerate()
        .flat_map(|(window, seen)| seen.iter().map(move |s| (window, s)))
        .collect();
    let each = told
        .unwrap_or_else(|| rows.iter().map(|(_, s)| s.features.len() / width).max().unwrap_or(0));
    let most =
        rows.iter().map(|(_, s)| s.impacts.len() / IMPACT_FEATURES).max().unwrap_or(0).max(1);
    let mut features = vec![0.0_f32; rows.len() * each * width];
    let mut impacts = vec![0.0_f32; rows.len() * most * IMPACT_FEATURES];
    let mut uncorrected = Vec::with_capacity(rows.len() * UNCORRECTED);
    for (row, (_, seen)) in rows.iter().enumerate() {
        let room = &mut features[row * each * width..(row + 1) * each * width];
        match points.as_ref().and_then(|points| points.get(seen.unit)) {
            Some(own) => {
                for (to, number) in room.chunks_exact_mut(width).zip(own) {
                    let from = seen.features.chunks_exact(width).nth(*number).ok_or_else(|| {
                        let count = seen.features.len() / width;
                        input(format!(
                            "points: unit {} has {count} points, and {number} is asked for",
                            seen.unit
                        ))
                    })?;
                    to.copy_from_slice(from);
                }
            }
            // The last point again: the maximum over points stays what it is.
            None => {
                let count = seen.features.len() / width;
                for (number, to) in room.chunks_exact_mut(width).enumerate() {
                    let from = number.min(count.saturating_sub(1)) * width;
                    to.copy_from_slice(&seen.features[from..from + width]);
                }
            }
        }
        let start = row * most * IMPACT_FEATURES;
        impacts[start..start + seen.impacts.len()].copy_from_slice(&seen.impacts);
        let end = &seen.uncorrected;
        uncorrected.extend(end.centre.coords.iter());
        uncorrected.extend(end.rotation.transpose().iter().map(|v| f64::from(*v)));
        uncorrected.extend(end.way_m.iter().chain(&end.turn_rad).map(|v| f64::from(*v)));
        uncorrected.push(f64::from(end.share_m_s));
    }
    let numbers = |of: &dyn Fn(&(usize, &Seen)) -> usize| -> Vec<u32> {
        rows.iter().map(|row| of(row) as u32).collect()
    };
    let count = rows.len();
    let out = PyDict::new(py);
    out.set_item("window", arrays::array(py, numbers(&|(window, _)| *window), &[count])?)?;
    out.set_item("unit", arrays::array(py, numbers(&|(_, s)| s.unit), &[count])?)?;
    out.set_item("features", arrays::array(py, features, &[count, each, width])?)?;
    out.set_item("impacts", arrays::array(py, impacts, &[count, most, IMPACT_FEATURES])?)?;
    let counts = numbers(&|(_, s)| s.impacts.len() / IMPACT_FEATURES);
    out.set_item("impact_count", arrays::array(py, counts, &[count])?)?;
    out.set_item("uncorrected", arrays::array(py, uncorrected, &[count, UNCORRECTED])?)?;
    Ok(out)
}
