//! The equivalence harness: is a quantised model its float model, and do two targets compute the same bits?
//!
//! | module | answers |
//! |---|---|
//! | [`check()`] | how far a quantised model is from its float model: rollouts, single steps, layers; [`Tolerances`] decide |
//! | [`trace`] | where two runs of the forward pass first differ, bit by bit |
//!
//! `rigidformer check`, `rigidformer trace` and `rigidformer diff` are the same from the command line.
//!
//! A test of your own:
//!
//! ```no_run
//! use rigidformer_firmware_sim::{Options, Tolerances, check};
//! use rigidformer_runtime::models::LoadedModel;
//! use rigidformer_runtime::progress::Progress;
//! use rigidformer_evaluation::scenes::{Dataset, Split};
//!
//! let float = LoadedModel::open("edge.rfm".as_ref())?;
//! let quantised = LoadedModel::open("edge-i8.rfm".as_ref())?;
//! let dataset = Dataset::open("movi-a.safetensors".as_ref())?;
//! let indices = dataset.scenes_of(Split::Test).into_iter().take(20);
//! let scenes = indices.map(|index| dataset.scene(index, Some(101))).collect::<Result<Vec<_>, _>>()?;
//!
//! let report = check(&float, &quantised, &scenes, &Options::default(), Progress::none())?;
//! let violations = report.verdict(&Tolerances::I8);
//! assert!(violations.is_empty(), "{violations:#?}");
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```
#![cfg_attr(test, allow(clippy::unwrap_used, clippy::expect_used, clippy::panic))]

mod check;
mod drift;
mod one_step;
mod pair;
mod report;
mod tolerances;
pub mod trace;

pub use check::{CheckError, Options, check};
pub use report::{
    Bonds, Difference, Drift, LayerNoise, MetricChange, ModelSummary, OneStep, PointChange,
    PointDrift, Report, Spread, StepFigures,
};
pub use tolerances::{ToleranceError, Tolerances, Violation};
