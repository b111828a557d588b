//! What difference is allowed.

use std::fmt;
use std::path::{Path, PathBuf};

use rigidformer_evaluation::figures::LAST_FRAME;
use rigidformer_evaluation::scenes::Split;
use rigidformer_runtime::core::Model;
use rigidformer_runtime::core::weights::DType;
use rigidformer_runtime::files::{FileError, read_whole};
use serde::{Deserialize, Deserializer, Serialize};
use serde_json::{Value, json};

use crate::report::Report;

/// Limits of a [`Report`]. A limit that is none is not looked at.
///
/// As a file it is a JSON object of these fields, all of them:
///
/// ```
/// let text = r#"{
///     "metric_change": 0.03,
///     "one_step_ratio": 0.1,
///     "bonds_apart": 0.03,
///     "drift_step": 10,
///     "median_drift_m": 0.005,
///     "median_drift_deg": 0.5,
///     "rigidity": 1e-5,
///     "layer_sqnr_db": null
/// }"#;
/// let tolerances = rigidformer_firmware_sim::Tolerances::parse("tolerances.json".as_ref(), text.as_bytes())?;
/// assert_eq!(tolerances, rigidformer_firmware_sim::Tolerances::I8);
/// # Ok::<(), rigidformer_firmware_sim::ToleranceError>(())
/// ```
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Tolerances {
    /// Relative change of each position and orientation RMSE, and of the mean error of soft points, at frames 50, 75 and 100, up or
    /// down.
    #[serde(deserialize_with = "given")]
    pub metric_change: Option<f64>,
    /// [`OneStep::ratio`](crate::OneStep::ratio): difference over the float model's own error, after one step.
    #[serde(deserialize_with = "given")]
    pub one_step_ratio: Option<f64>,
    /// [`Bonds::share`](crate::Bonds::share): share of bonds that one model breaks in a step and the other does not. A file without it
    /// has that of [`Tolerances::I8`].
    #[serde(default = "bonds_apart")]
    pub bonds_apart: Option<f64>,
    /// The one step code that limits on drift apply to; none: all that were measured.
    #[serde(deserialize_with = "given")]
    pub drift_step: Option<u32>,
    /// Median position drift at frame 100, of rigid units and of soft points, metres.
    #[serde(deserialize_with = "given")]
    pub median_drift_m: Option<f64>,
    /// Median orientation drift at frame 100, degrees.
    #[serde(deserialize_with = "given")]
    pub median_drift_deg: Option<f64>,
    /// Largest relative change of a length within a unit.
    #[serde(deserialize_with = "given")]
    pub rigidity: Option<f64>,
    /// Least signal to noise of any layer, decibels.
    #[serde(deserialize_with = "given")]
    pub layer_sqnr_db: Option<f64>,
}

impl Tolerances {
    /// For int8 weights.
    pub const I8: Tolerances = Tolerances {
        metric_change: Some(0.03),
        one_step_ratio: Some(0.1),
        bonds_apart: Some(0.03),
        drift_step: Some(10),
        median_drift_m: Some(0.005),
        median_drift_deg: Some(0.5),
        rigidity: Some(1e-5),
        layer_sqnr_db: None,
    };
    /// For f16 weights.
    pub const F16: Tolerances = Tolerances { metric_change: Some(0.003), ..Tolerances::I8 };
    /// For the float model again: no difference.
    pub const EXACT: Tolerances = Tolerances {
        metric_change: Some(0.0),
        one_step_ratio: Some(0.0),
        bonds_apart: Some(0.0),
        drift_step: None,
        median_drift_m: Some(0.0),
        median_drift_deg: Some(0.0),
        ..Tolerances::I8
    };

    /// The limits above for a model's narrowest weights.
    pub fn of(model: &Model<'_>) -> Self {
        let has = |dtype| model.file().tensors().any(|tensor| tensor.data.dtype() == dtype);
        // The narrowest weights decide, because they bring the greatest errors.
        if has(DType::I8) {
            Tolerances::I8
        } else if has(DType::F16) {
            Tolerances::F16
        } else {
            Tolerances::EXACT
        }
    }

    /// Reads a file.
    ///
    /// # Errors
    /// [`ToleranceError`] names the file and the field.
    pub fn open(path: &Path) -> Result<Self, ToleranceError> {
        Self::parse(path, &read_whole(path)?)
    }

    /// A file that is in memory; errors call it `name`.
    ///
    /// # Errors
    /// [`ToleranceError::Malformed`].
    pub fn parse(name: &Path, bytes: &[u8]) -> Result<Self, ToleranceError> {
        serde_json::from_slice(bytes)
            .map_err(|source| ToleranceError::Malformed { path: name.into(), source })
    }
}

/// Serde takes an option that is left out for none; a limit that was forgotten shall not pass.
fn given<'de, D: Deserializer<'de>, T: Deserialize<'de>>(field: D) -> Result<Option<T>, D::Error> {
    Option::deserialize(field)
}

/// Why a tolerance file cannot be used.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum ToleranceError {
    /// It cannot be read.
    #[error(transparent)]
    File(#[from] FileError),
    /// It is not what it should be.
    #[error(
        "{}: {source}; a tolerance file is a JSON object such as {}", .path.display(), example()
    )]
    Malformed {
        /// The file.
        path: PathBuf,
        /// What is wrong with it.
        source: serde_json::Error,
    },
}

fn bonds_apart() -> Option<f64> {
    Tolerances::I8.bonds_apart
}

fn example() -> String {
    serde_json::to_string(&Tolerances::I8).unwrap_or_default()
}

/// A limit that is broken.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Violation {
    /// The quantity, with its unit.
    pub what: &'static str,
    /// Step code and frame, or layer.
    pub place: String,
    /// What was measured.
    pub measured: f64,
    /// The limit.
    pub allowed: f64,
}

impl fmt::Display for Violation {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { what, place, measured, allowed } = self;
        write!(f, "{place}: {what} is {measured:.4}, allowed is {allowed}")
    }
}

impl Report {
    /// All of it for machines, with the verdict: what `rigidformer check --json` prints.
    ///
    /// # Errors
    /// That of `serde_json`, which a report does not cause.
    pub fn document(
        &self,
        tolerances: &Tolerances,
        dataset: &str,
        split: Split,
    ) -> Result<Value, serde_json::Error> {
        let violations = self.verdict(tolerances);
        let mut document = serde_json::to_value(self)?;
        if let Some(object) = document.as_object_mut() {
            object.insert("dataset".into(), json!(dataset));
            object.insert("split".into(), json!(split.to_string()));
            object.insert("tolerances".into(), serde_json::to_value(tolerances)?);
            object.insert("violations".into(), serde_json::to_value(&violations)?);
            object.insert("pass".into(), json!(violations.is_empty()));
        }
        Ok(document)
    }

    /// Every limit that is broken; none for a model that passes. What is no number breaks every limit.
    pub fn verdict(&self, tolerances: &Tolerances) -> Vec<Violation> {
        let mut found = Vec::new();
        let mut at_most = |what, place: &str, measured: f64, allowed: Option<f64>| {
            // NaN compares with nothing and must not pass.
            let broken = allowed.filter(|allowed| measured.is_nan() || measured > *allowed);
            found.extend(broken.map(|allowed| Violation {
                what,
                place: place.into(),
                measured,
                allowed,
            }));
        };
        for figures in &self.steps {
            let step = figures.step;
            for metric in &figures.metrics {
                let place = format!("step {step}, frame {}", metric.frame);
                let (position, orientation) = (metric.position_m, metric.orientation_rms_deg);
                let allowed = tolerances.metric_change;
                at_most("relative change of position RMSE", &place, position.change.abs(), allowed);
                let change = orientation.change.abs();
                at_most("relative change of orientation RMSE", &place, change, allowed);
            }
            for metric in &figures.point_metrics {
                let place = format!("step {step}, frame {}", metric.frame);
                let change = metric.vertex_m.change.abs();
                let allowed = tolerances.metric_change;
                at_most("relative change of the mean error of points", &place, change, allowed);
            }
            let place = format!("step {step}");
            let ratio = figures.one_step.ratio;
            at_most("one-step ratio", &place, ratio, tolerances.one_step_ratio);
            if let Some(bonds) = figures.one_step.bonds {
                let allowed = tolerances.bonds_apart;
                at_most("share of bonds that one model alone breaks", &place, bonds.share, allowed);
            }
            let rigidity = figures.quantised_rigidity;
            at_most("relative change of a length", &place, rigidity, tolerances.rigidity);
            // Drift depends on the number of steps, so its limits are those of one step code.
            if tolerances.drift_step.is_some_and(|only| only != step) {
                continue;
            }
            if let Some(drift) = figures.point_drift_at(LAST_FRAME) {
                let place = format!("step {step}, frame {LAST_FRAME}");
                let median = drift.distance_m.median;
                at_most("median drift of points, m,", &place, median, tolerances.median_drift_m);
            }
            if let Some(drift) = figures.drift_at(LAST_FRAME) {
                let place = format!("step {step}, frame {LAST_FRAME}");
                // Units that nothing touches are equal to the bit and pull the median to 0. So the
                // median of the units that differ counts too.
                let all = (drift.position_m.median, drift.orientation_deg.median);
                let apart = (drift.apart_median_m, drift.apart_median_deg);
                let (position, orientation) = (all.0.max(apart.0), all.1.max(apart.1));
                at_most("median position drift, m,", &place, position, tolerances.median_drift_m);
                let allowed = tolerances.median_drift_deg;
                at_most("median orientation drift, degrees,", &place, orientation, allowed);
            }
        }
        for layer in &self.layers {
            // A layer without noise has no ratio and passes.
            let too_low = tolerances.layer_sqnr_db.zip(layer.sqnr_db);
            let too_low = too_low.filter(|(least, db)| db.is_nan() || db < least);
            found.extend(too_low.map(|(allowed, measured)| Violation {
                what: "signal to noise, dB,",
                place: format!("layer {}", layer.layer),
                measured,
                allowed,
            }));
        }
        found
    }
}
