//! What the harness measured.

use rigidformer_evaluation::metrics::FrameErrors;
use serde::Serialize;

/// How far a quantised model is from its float model.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Report {
    /// The reference.
    pub float: ModelSummary,
    /// The model that was measured.
    pub quantised: ModelSummary,
    /// Scenes.
    pub scenes: usize,
    /// Frames a second.
    pub frame_rate_hz: f32,
    /// A row a step code.
    pub steps: Vec<StepFigures>,
    /// Noise of layers in single steps, in the order of the forward pass.
    pub layers: Vec<LayerNoise>,
}

/// A model, for the record.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct ModelSummary {
    /// Its name.
    pub name: String,
    /// Its file.
    pub path: String,
    /// Bytes of the file.
    pub bytes: usize,
    /// Parameters by type, such as `1024 i8, 96 f32`.
    pub weights: String,
}

/// Figures at one step code.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct StepFigures {
    /// The step code.
    pub step: u32,
    /// Distance of the rollouts over time, from frame 0 to 100.
    pub drift: Vec<Drift>,
    /// The same of the points of soft units; empty where all are rigid.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub point_drift: Vec<PointDrift>,
    /// Errors of the points of soft units at frames 50, 75 and 100; empty where all are rigid.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub point_metrics: Vec<PointChange>,
    /// Benchmark metrics at frames 50, 75 and 100.
    pub metrics: Vec<MetricChange>,
    /// Largest relative change of a length within a unit, of the float model's rollouts.
    pub float_rigidity: f64,
    /// The same, of the quantised model's.
    pub quantised_rigidity: f64,
    /// Single steps from the same recorded states.
    pub one_step: OneStep,
}

impl StepFigures {
    /// Drift of soft points at a frame.
    pub fn point_drift_at(&self, frame: u32) -> Option<&PointDrift> {
        self.point_drift.iter().find(|drift| drift.frame == frame)
    }

    /// Drift at a frame.
    pub fn drift_at(&self, frame: u32) -> Option<&Drift> {
        self.drift.iter().find(|drift| drift.frame == frame)
    }
}

/// Distance between the two models' soft points at a frame, over all soft units of all scenes.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct PointDrift {
    /// The frame.
    pub frame: u32,
    /// Soft points of all scenes.
    pub points: usize,
    /// Those that are not in the same place to the bit.
    pub apart: usize,
    /// Of the points, metres.
    pub distance_m: Spread,
}

/// The mean distance of soft points from where they were recorded, of both models at a frame: mean over a scene's points, then over
/// scenes.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct PointChange {
    /// The frame.
    pub frame: u32,
    /// Metres.
    pub vertex_m: Difference,
}

/// Distance between the two models' poses at a frame, over all rigid units of all scenes.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Drift {
    /// The frame.
    pub frame: u32,
    /// Rigid units of all scenes.
    pub units: usize,
    /// Those whose poses differ at all: a unit that has touched nothing yet does not drift.
    pub apart: usize,
    /// Of the origins of the body frames, metres.
    pub position_m: Spread,
    /// Of the orientations, degrees.
    pub orientation_deg: Spread,
    /// Median position drift of the units that are apart, metres.
    pub apart_median_m: f64,
    /// Median orientation drift of the units that are apart, degrees.
    pub apart_median_deg: f64,
}

/// Spread of a quantity.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize)]
pub struct Spread {
    /// Half are below.
    pub median: f64,
    /// 95 % are below.
    pub p95: f64,
    /// All are at most this.
    pub max: f64,
}

/// A benchmark metric of both models.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Difference {
    /// Of the float model.
    pub float: f64,
    /// Of the quantised model.
    pub quantised: f64,
    /// `(quantised - float) / float`.
    pub change: f64,
}

impl Difference {
    pub(crate) fn new(float: f64, quantised: f64) -> Self {
        // Equal errors do not change, though both be 0. The floor keeps the quotient finite.
        let change = if float == quantised { 0.0 } else { (quantised - float) / float.max(1e-9) };
        Self { float, quantised, change }
    }
}

/// HopNet's metrics of both models at a frame: root mean square over units, mean over scenes.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct MetricChange {
    /// The frame.
    pub frame: u32,
    /// Position error, metres.
    pub position_m: Difference,
    /// Orientation error, degrees.
    pub orientation_rms_deg: Difference,
}

impl MetricChange {
    pub(crate) fn new(frame: u32, float: FrameErrors, quantised: FrameErrors) -> Self {
        let of = |value: fn(&FrameErrors) -> f64| Difference::new(value(&float), value(&quantised));
        Self {
            frame,
            position_m: of(|errors| errors.position_m),
            orientation_rms_deg: of(|errors| errors.orientation_rms_deg),
        }
    }
}

/// Anchors after one step from the same recorded states, those of soft units among them; root mean squares over anchors, units and states.
///
/// Units that can touch nothing move freely and exactly in both models. They would dilute the figures, so all but
/// `ratio_all` are over *active* units: those that the two models do not put at the same place, bit for bit.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct OneStep {
    /// Units, counted once a state.
    pub units: u64,
    /// Those that are active.
    pub active_units: u64,
    /// Distance between the models, metres.
    pub difference_m: f64,
    /// The largest distance of an anchor between the models, metres.
    pub largest_difference_m: f64,
    /// Distance of the float model from the record, metres.
    pub float_error_m: f64,
    /// `difference_m / float_error_m`.
    pub ratio: f64,
    /// The same over all units.
    pub ratio_all: f64,
    /// Median over active units of the unit's own ratio, which a few large errors of the float model do not flatter.
    pub median_ratio: f64,
    /// Of bonds, where scenes have some: units of clusters of which the models break different bonds are in no other figure of this.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub bonds: Option<Bonds>,
}

/// Bonds in single steps from the same recorded states.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Bonds {
    /// Those that held before a step, counted once a state.
    pub held: u64,
    /// Those that one model broke in the step and the other did not.
    pub apart: u64,
    /// `apart / held`.
    pub share: f64,
    /// Units of the clusters of the bonds that are apart, counted once a state.
    pub units: u64,
}

/// Quantisation noise of a layer in single steps from recorded states: what the layers before it brought included.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct LayerNoise {
    /// `features`, `point_features`, `pooled`, `tokens 0` and so on, `head`.
    pub layer: String,
    /// Power of the float model's values to that of the differences, decibels; none where all are equal.
    pub sqnr_db: Option<f64>,
}
