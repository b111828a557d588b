//! Every layer of a few steps, kept and compared bit by bit.
//!
//! [`record`] runs a model on a scene; [`Recording::write`] puts the result into a file, on whatever target that was;
//! [`compare`] names the first step, layer, unit and element in which two recordings differ.
//!
//! A trace file is a safetensors file. Its tensors are f32 matrices called `STEP/POSITION/LAYER/INDEX` (such as
//! `0003/0002/tokens/1`), so that the order of names is that of the computation; step 0 holds the observed poses. The
//! metadata says `format` = `rigidformer-trace`, `version`, `model`, `scene` and `step` (the step code). The same run
//! gives the same bytes.

mod compare;
mod file;

use rigidformer_runtime::core::{ANCHORS, Layer, Model, POOL_LEVELS, Trace};
use rigidformer_runtime::rollout::{Control, RolloutError};
use rigidformer_runtime::scenes::RecordedScene;

use crate::simulation::{observe, with_simulator};
use rigidformer_runtime::engine::Stepping;

pub use compare::{Comparison, FirstDifference, Incomparable, LayerDifference, compare};
pub use file::TraceError;

/// A stage of the computation, in the order of the forward pass.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum Stage {
    /// (points, features) of a unit.
    Features,
    /// (points, point width) of a unit.
    PointFeatures,
    /// (units, 8 point width).
    Pooled,
    /// (units, width) at a scale.
    Tokens,
    /// (registers, width) at a scale.
    Registers,
    /// (units, then registers, width) of a block, after its attention.
    Attention,
    /// (units x anchors, width).
    AnchorQueries,
    /// (units x anchors, scales x heads x head_dim).
    Seen,
    /// (units x anchors, width).
    AnchorTokens,
    /// (units, 3 x anchors).
    Head,
    /// (anchors, 3) of a unit.
    Advanced,
    /// (units, 12): rotation matrix by columns, then centre, after the projection.
    Poses,
    /// A layer that this crate does not know.
    Other,
}

impl Stage {
    const ALL: [Stage; 13] = [
        Stage::Features,
        Stage::PointFeatures,
        Stage::Pooled,
        Stage::Tokens,
        Stage::Registers,
        Stage::Attention,
        Stage::AnchorQueries,
        Stage::Seen,
        Stage::AnchorTokens,
        Stage::Head,
        Stage::Advanced,
        Stage::Poses,
        Stage::Other,
    ];

    /// As files and tables call it.
    pub fn name(self) -> &'static str {
        match self {
            Stage::Features => "features",
            Stage::PointFeatures => "point_features",
            Stage::Pooled => "pooled",
            Stage::Tokens => "tokens",
            Stage::Registers => "registers",
            Stage::Attention => "attention",
            Stage::AnchorQueries => "anchor_queries",
            Stage::Seen => "seen",
            Stage::AnchorTokens => "anchor_tokens",
            Stage::Head => "head",
            Stage::Advanced => "advanced",
            Stage::Poses => "poses",
            Stage::Other => "other",
        }
    }

    fn from_name(name: &str) -> Option<Stage> {
        Stage::ALL.into_iter().find(|stage| stage.name() == name)
    }

    fn of(layer: Layer) -> Stage {
        match layer {
            Layer::Features => Stage::Features,
            Layer::PointFeatures => Stage::PointFeatures,
            Layer::Pooled => Stage::Pooled,
            Layer::Tokens => Stage::Tokens,
            Layer::Registers => Stage::Registers,
            Layer::Attention => Stage::Attention,
            Layer::AnchorQueries => Stage::AnchorQueries,
            Layer::Seen => Stage::Seen,
            Layer::AnchorTokens => Stage::AnchorTokens,
            Layer::Head => Stage::Head,
            Layer::Advanced => Stage::Advanced,
            _ => Stage::Other,
        }
    }

    /// Whether the index is a scale or a block.
    pub fn is_by_scale(self) -> bool {
        matches!(self, Stage::Tokens | Stage::Registers | Stage::Attention)
    }

    /// Rows that belong to one unit, for stages whose rows are units or their anchors.
    pub fn rows_of_a_unit(self) -> usize {
        match self {
            Stage::AnchorQueries | Stage::Seen | Stage::AnchorTokens => ANCHORS,
            _ => 1,
        }
    }

    /// Its name, with the scale or block where it has one.
    pub fn label(self, index: usize) -> String {
        if self.is_by_scale() { format!("{} {index}", self.name()) } else { self.name().into() }
    }

    /// Whether the index is a unit and a row one of its points or anchors; otherwise a row is a unit.
    pub fn is_by_unit(self) -> bool {
        matches!(self, Stage::Features | Stage::PointFeatures | Stage::Advanced)
    }
}

/// One layer of one step.
#[derive(Clone, Debug, PartialEq)]
pub struct Part {
    /// 0 for the observation, n for the n-th step.
    pub step: u32,
    /// Which stage.
    pub stage: Stage,
    /// The unit for stages that are [by unit](Stage::is_by_unit), the scale for tokens, else 0.
    pub index: usize,
    /// Numbers of a row.
    pub columns: usize,
    /// (rows, columns)
    pub values: Vec<f32>,
}

/// All layers of a few steps, in the order in which they were computed.
#[derive(Clone, Debug, PartialEq)]
pub struct Recording {
    /// Name of the model.
    pub model: String,
    /// Name of the scene.
    pub scene: String,
    /// Step code.
    pub step: u32,
    /// The layers.
    pub parts: Vec<Part>,
}

/// Gathers layers; tiles of a unit are put together.
pub(crate) struct Gathering {
    columns: Columns,
    step: u32,
    pub(crate) parts: Vec<Part>,
    /// Where the parts of the current step begin.
    start: usize,
}

/// Numbers of a row, by stage.
struct Columns {
    features: usize,
    points: usize,
    width: usize,
    seen: usize,
}

impl Gathering {
    pub(crate) fn new(model: &Model<'_>) -> Self {
        let config = model.config();
        let (features, points, width) =
            (config.features.len(), config.point_width as usize, config.width as usize);
        let seen = (config.heads * config.head_dim) as usize * config.scales.len();
        let columns = Columns { features, points, width, seen };
        Self { columns, step: 0, parts: Vec::new(), start: 0 }
    }

    /// What comes now is another step's.
    pub(crate) fn next_step(&mut self) {
        self.step += 1;
        self.start = self.parts.len();
    }

    /// Forgets all parts.
    pub(crate) fn clear(&mut self) {
        (self.step, self.start) = (0, 0);
        self.parts.clear();
    }

    fn poses(&mut self, simulator: &dyn Stepping, units: usize) {
        let poses = (0..units).filter_map(|unit| simulator.internal_pose(unit));
        let values = poses
            .flat_map(|pose| pose.rotation.iter().chain(&pose.centre).copied().collect::<Vec<_>>());
        self.push(Stage::Poses, 0, &values.collect::<Vec<_>>());
    }

    fn push(&mut self, stage: Stage, index: usize, values: &[f32]) {
        let this_step = self.parts.get_mut(self.start..).unwrap_or_default();
        let known = this_step.iter_mut().find(|part| part.stage == stage && part.index == index);
        if let Some(part) = known {
            part.values.extend_from_slice(values);
            return;
        }
        let columns = match stage {
            Stage::Features => self.columns.features,
            Stage::PointFeatures => self.columns.points,
            Stage::Pooled => 2 * POOL_LEVELS * self.columns.points,
            Stage::Tokens
            | Stage::Registers
            | Stage::Attention
            | Stage::AnchorQueries
            | Stage::AnchorTokens => self.columns.width,
            Stage::Seen => self.columns.seen,
            Stage::Head => 3 * ANCHORS,
            Stage::Advanced => 3,
            Stage::Poses => 12,
            Stage::Other => values.len().max(1),
        };
        self.parts.push(Part { step: self.step, stage, index, columns, values: values.to_vec() });
    }
}

impl Trace for Gathering {
    fn record(&mut self, layer: Layer, index: usize, values: &[f32]) {
        self.push(Stage::of(layer), index, values);
    }
}

/// Observes frames 0 and `step` of the scene, then keeps every layer of `steps` steps.
///
/// ```no_run
/// use rigidformer_firmware_sim::trace::{Recording, compare, record};
/// use rigidformer_runtime::{models::LoadedModel, rollout::Control, scenes::Dataset};
/// let loaded = LoadedModel::open("edge.rfm".as_ref())?;
/// let scene = Dataset::open("movi-a.safetensors".as_ref())?.scene(0, Some(11))?;
/// let here = record(&loaded.model()?, &scene, 10, 3, Control::none())?;
/// let there = Recording::open("from-the-robot.trace".as_ref())?;
/// assert!(compare(&here, &there)?.first.is_none());
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
///
/// # Errors
/// As those of [`rollout`](rigidformer_runtime::rollout::rollout).
pub fn record(
    model: &Model<'_>,
    scene: &RecordedScene,
    step: u32,
    steps: u32,
    control: Control<'_>,
) -> Result<Recording, RolloutError> {
    let mut gathering = Gathering::new(model);
    let units = scene.units().len();
    with_simulator(model, scene, |simulator| {
        observe(simulator, scene, step, step)?;
        gathering.poses(simulator, units);
        for done in 1..=steps {
            if control.cancelled.load(std::sync::atomic::Ordering::Relaxed) {
                return Err(RolloutError::Cancelled);
            }
            gathering.next_step();
            simulator.step_traced(&mut gathering).map_err(|source| RolloutError::Step {
                scene: scene.name().into(),
                frame: step.saturating_mul(done.saturating_add(1)),
                source,
            })?;
            gathering.poses(simulator, units);
            (control.stepped)();
        }
        Ok(())
    })?;
    let (model, scene) = (model.file().name().into(), scene.name().into());
    Ok(Recording { model, scene, step, parts: gathering.parts })
}
