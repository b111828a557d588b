//! What the program does with models: check, evaluate.

use std::path::PathBuf;

use pyo3::prelude::*;
use rigidformer_evaluation::figures;
use rigidformer_evaluation::scenes::Split;
use rigidformer_firmware_sim::{self as harness, Options, Tolerances};
use rigidformer_runtime::progress::Progress;

use crate::errors::{OrRaise, input};
use crate::interrupt::shared;
use crate::json::to_python;
use crate::model::Model;
use crate::scene::Dataset;
use crate::whole;

/// Measures how far a quantised model is from its float model, and judges it. The interpreter is free meanwhile.
///
/// Parameters
/// ----------
/// float_model, quantised : Model
///     Of the same architecture.
/// dataset : Dataset
///     Scenes of at least 101 frames.
/// steps : sequence of int
///     Step codes, each from 1 to 25.
/// split : str
///     "train", "validation", "test" or "extra".
/// limit : int, optional
///     Scenes, at most.
/// tolerances : str, os.PathLike, optional
///     A file of limits; None: those for the quantised model's types.
///
/// Returns
/// -------
/// dict
///     As ``rigidformer check --json``; "pass" says whether all is within the tolerances, "violations" what is not.
///
/// Raises
/// ------
/// FileError, InputError
///     A file, a model or a scene cannot be used.
/// KeyboardInterrupt
///     Ctrl-C, within a step.
///
/// Source: ``firmware-sim/src/check.rs``, ``docs/QUANTISATION.md``.
///
/// >>> import rigidformer as rf
/// >>> edge = rf.Model("edge")
/// >>> rf.check(edge, edge, rf.Dataset.embedded(), steps=[10])["pass"]
/// True
#[pyfunction]
#[pyo3(signature = (float_model, quantised, dataset, *, steps = vec![5, 10], split = "test", limit = None, tolerances = None))]
#[expect(clippy::too_many_arguments, reason = "Python's are named")]
pub(crate) fn check<'py>(
    py: Python<'py>,
    float_model: &Model,
    quantised: &Model,
    dataset: &Dataset,
    #[pyo3(from_py_with = whole::steps)] steps: Vec<u32>,
    split: &str,
    #[pyo3(from_py_with = whole::limit)] limit: Option<u32>,
    tolerances: Option<PathBuf>,
) -> PyResult<Bound<'py, PyAny>> {
    let split: Split = split.parse().or_raise()?;
    let (float, quantised) = (&float_model.as_read, &quantised.as_read);
    // Read before the check, which takes minutes.
    let tolerances = match tolerances {
        Some(path) => Tolerances::open(&path).or_raise()?,
        None => Tolerances::of(quantised.model()),
    };
    let dataset = &dataset.dataset;
    let options = Options { steps, ..Options::default() };
    let document = shared(py, |cancelled| {
        let progress = Progress { cancelled, ..Progress::none() };
        // The check looks at 100 frames, and the rest of a long record would cost memory.
        let frames = Some(figures::TO_LAST_FRAME);
        let scenes = figures::scenes_of(dataset, split, limit, frames, progress).or_raise()?;
        let report = harness::check(float, quantised, &scenes, &options, progress).or_raise()?;
        report.document(&tolerances, dataset.name(), split).or_raise()
    })??;
    to_python(py, &document)
}

/// The errors of a model over a split, beside free fall, the record and what is published. The interpreter is free meanwhile.
///
/// Parameters
/// ----------
/// model : Model
/// dataset : Dataset
///     Rigid bodies: scenes of soft units, bonds, tosses or commands have other figures, which ``rigidformer evaluate`` has.
/// steps : sequence of int
///     Step codes, each from 1 to 25: figures are of frames from 50 on, and two frames are observed.
/// split : str
///     "train", "validation", "test" or "extra".
/// limit : int, optional
///     Scenes, at most.
/// join : bool
///     Holds links of a body together at the pivots that the observed frames show.
///
/// Returns
/// -------
/// dict
///     As ``rigidformer evaluate --json``.
///
/// Raises
/// ------
/// InputError
///     A scene cannot be rolled out, or the data set is of another kind.
/// KeyboardInterrupt
///     Ctrl-C, within a step.
///
/// Source: ``evaluation/src/figures/split.rs``, ``docs/ACCURACY.md``.
///
/// >>> import rigidformer as rf
/// >>> figures = rf.evaluate(rf.Model("nano"), rf.Dataset.embedded(), steps=[10])
/// >>> [frame["frame"] for frame in figures["model"]["steps"][0]["figures"]["frames"]]
/// [50, 75, 100]
#[pyfunction]
#[pyo3(signature = (model, dataset, *, steps = vec![1, 5, 10], split = "test", limit = None, join = false))]
pub(crate) fn evaluate<'py>(
    py: Python<'py>,
    model: &Model,
    dataset: &Dataset,
    #[pyo3(from_py_with = whole::steps)] steps: Vec<u32>,
    split: &str,
    #[pyo3(from_py_with = whole::limit)] limit: Option<u32>,
    join: bool,
) -> PyResult<Bound<'py, PyAny>> {
    let split: Split = split.parse().or_raise()?;
    let dataset = &dataset.dataset;
    let kinds = [
        (dataset.soft_units() > 0, "soft units"),
        (dataset.bonds().0 > 0, "bonds"),
        (dataset.has_velocities(), "velocities of tosses"),
        (dataset.command_size() > 0, "commands"),
    ];
    // Figures of rigid bodies would come out for such scenes too, and mean nothing.
    if let Some((_, what)) = kinds.iter().find(|(is_so, _)| *is_so) {
        let path = dataset.path().display();
        return Err(input(format!(
            "{path}: has {what}; `rigidformer evaluate` has the figures of such scenes"
        )));
    }
    let document = shared(py, |cancelled| {
        let progress = Progress { cancelled, ..Progress::none() };
        let scenes = figures::scenes_to_evaluate(dataset, split, limit, progress).or_raise()?;
        let how = (steps.as_slice(), join);
        let figures = figures::evaluate(&model.loaded, dataset, split, &scenes, how, progress);
        Ok::<_, PyErr>(figures.or_raise()?.document())
    })??;
    to_python(py, &document)
}
