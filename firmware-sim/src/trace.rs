//! Every layer of a few steps, kept and compared bit by bit.
//!
//! [`record`] runs a model on a scene; [`Recording::write`] puts the result into a file, on whatever target that was;
//! [`compare`] names the first step, layer, unit and element in which two recordings differ.
//!
//! A trace file is a safetensors file. Its tensors are f32 matrices called `STEP/POSITION/LAYER/INDEX` (such as
//! `0003/0002/tokens/1`), so that the order of names is that of the computation; step 0 holds the observed poses. Layers are
//! called as [`Layer::name`](rigidformer_runtime::core::Layer::name) says, poses `poses`, and the points of a soft unit
//! `soft_points`, with the unit as index. The metadata says `format` = `rigidformer-trace`, `version`, `model`, `scene` and `step` (the step code). The same run
//! gives the same bytes.

mod compare;
mod file;

use rigidformer_evaluation::rollout::{Replay, RolloutError};
use rigidformer_evaluation::scenes::RecordedScene;
use rigidformer_runtime::core::weights::ModelConfig;
use rigidformer_runtime::core::{Layer, Model, Trace};
use rigidformer_runtime::engine::Engine;
use rigidformer_runtime::models::LoadedModel;
use rigidformer_runtime::progress::Progress;
use rigidformer_runtime::world::World;

pub use compare::{Comparison, FirstDifference, Incomparable, LayerDifference, compare};
pub use file::TraceError;

/// What a record holds: a layer of the forward pass, or what came out of it. The order is that of the computation.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum Content {
    /// A layer; [`Layer`] says what its rows and columns are.
    Layer(Layer),
    /// (units, 12): rotation matrix by columns, then centre, after the projection.
    Poses,
    /// (points, 3) of a soft unit: where its points are, in their own order, metres.
    SoftPoints,
}

impl Content {
    /// As files and tables call it.
    pub const fn name(self) -> &'static str {
        match self {
            Content::Layer(layer) => layer.name(),
            Content::Poses => "poses",
            Content::SoftPoints => "soft_points",
        }
    }

    fn from_name(name: &str) -> Option<Content> {
        let mut outcomes = [Content::Poses, Content::SoftPoints].into_iter();
        let outcome = outcomes.find(|content| content.name() == name);
        Layer::from_name(name).map(Content::Layer).or(outcome)
    }

    fn columns(self, config: &ModelConfig) -> usize {
        match self {
            Content::Layer(layer) => layer.columns(config),
            // Nine numbers of a matrix and three of a centre: what the core keeps, so that no
            // conversion hides a bit.
            Content::Poses => 12,
            Content::SoftPoints => 3,
        }
    }

    fn rows_vary(self) -> bool {
        matches!(self, Content::Layer(layer) if layer.rows_vary())
    }

    /// Its scale or block: the index where that is one, else 0.
    pub(crate) fn scale(self, index: usize) -> usize {
        if matches!(self, Content::Layer(layer) if layer.is_by_scale()) { index } else { 0 }
    }

    /// Its name, with the scale or block where it has one.
    pub(crate) fn label(self, index: usize) -> String {
        match self {
            Content::Layer(layer) if layer.is_by_scale() => format!("{} {index}", layer.name()),
            content => content.name().into(),
        }
    }

    /// The unit that a row belongs to.
    fn unit(self, index: usize, row: usize) -> usize {
        match self {
            Content::Layer(layer) if layer.is_by_unit() => index,
            Content::Layer(layer) => row / layer.rows_of_a_unit(),
            Content::Poses => row,
            Content::SoftPoints => index,
        }
    }
}

/// One layer of one step.
#[derive(Clone, Debug, PartialEq)]
pub struct Record {
    /// 0 for the observation, n for the n-th step.
    pub step: u32,
    /// What it holds.
    pub content: Content,
    /// The unit for layers that are [by unit](Layer::is_by_unit), the scale for those [by scale](Layer::is_by_scale),
    /// else 0.
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
    pub records: Vec<Record>,
}

/// Records layers; tiles of a unit are put together.
pub(crate) struct Recorder {
    config: ModelConfig,
    step: u32,
    pub(crate) records: Vec<Record>,
    /// Where the records of the current step begin.
    start: usize,
}

impl Recorder {
    pub(crate) fn new(model: &Model<'_>) -> Self {
        Self { config: *model.config(), step: 0, records: Vec::new(), start: 0 }
    }

    /// What comes now is another step's.
    pub(crate) fn next_step(&mut self) {
        self.step += 1;
        self.start = self.records.len();
    }

    /// Forgets all records.
    pub(crate) fn clear(&mut self) {
        (self.step, self.start) = (0, 0);
        self.records.clear();
    }

    fn poses(&mut self, world: &World) {
        let poses = world.simulator().units().map(|unit| unit.internal_pose());
        let values = poses
            .flat_map(|pose| pose.rotation.iter().chain(&pose.centre).copied().collect::<Vec<_>>());
        self.push(Content::Poses, 0, &values.collect::<Vec<_>>());
        for (number, unit) in world.simulator().units().enumerate().filter(|(_, u)| u.is_soft()) {
            let mut points: Vec<_> = unit.soft_points().collect();
            // Users know points in the order in which they gave them.
            points.sort_by_key(|(number, _)| *number);
            let values: Vec<f32> = points.iter().flat_map(|(_, p)| [p.x, p.y, p.z]).collect();
            self.push(Content::SoftPoints, number, &values);
        }
    }

    fn push(&mut self, content: Content, index: usize, values: &[f32]) {
        let this_step = self.records.get_mut(self.start..).unwrap_or_default();
        // The core records a unit tile by tile, and tiles of other sizes must give equal records.
        let known =
            this_step.iter_mut().find(|record| record.content == content && record.index == index);
        if let Some(record) = known {
            record.values.extend_from_slice(values);
            return;
        }
        let columns = content.columns(&self.config);
        let (step, values) = (self.step, values.to_vec());
        self.records.push(Record { step, content, index, columns, values });
    }
}

impl Trace for Recorder {
    fn record(&mut self, layer: Layer, index: usize, values: &[f32]) {
        self.push(Content::Layer(layer), index, values);
    }

    fn begin_again(&mut self) {
        // A step in which bonds break runs again, and its first layers are void.
        self.records.truncate(self.start);
    }
}

/// Observes frames 0 and `step` of the scene, then keeps every layer of `steps` steps.
///
/// ```no_run
/// use rigidformer_firmware_sim::trace::{Recording, compare, record};
/// use rigidformer_evaluation::scenes::Dataset;
/// use rigidformer_runtime::models::LoadedModel;
/// use rigidformer_runtime::progress::Progress;
/// let loaded = LoadedModel::open("edge.rfm".as_ref())?;
/// let scene = Dataset::open("movi-a.safetensors".as_ref())?.scene(0, Some(11))?;
/// let here = record(&loaded, &scene, 10, 3, Progress::none())?;
/// let there = Recording::open("from-the-robot.trace".as_ref())?;
/// assert!(compare(&here, &there)?.first.is_none());
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
///
/// # Errors
/// As those of [`rollout`](rigidformer_evaluation::rollout::rollout).
pub fn record(
    model: &LoadedModel,
    scene: &RecordedScene,
    step: u32,
    steps: u32,
    progress: Progress<'_>,
) -> Result<Recording, RolloutError> {
    let mut recorder = Recorder::new(model.model());
    // On one thread layers come in the order of the computation.
    let mut replay = Replay::new(Engine::new()?.single(), model, scene)?;
    replay.observe(step, step)?;
    recorder.poses(&replay.world);
    for done in 1..=steps {
        if progress.cancelled.load(std::sync::atomic::Ordering::Relaxed) {
            return Err(RolloutError::Cancelled);
        }
        recorder.next_step();
        replay.command(step.saturating_mul(done), step)?;
        replay.world.step_traced(&mut recorder).map_err(|source| RolloutError::Step {
            scene: scene.name().into(),
            frame: step.saturating_mul(done.saturating_add(1)),
            source,
        })?;
        recorder.poses(&replay.world);
        (progress.stepped)();
    }
    let (model, scene) = (model.model().file().name().into(), scene.name().into());
    Ok(Recording { model, scene, step, records: recorder.records })
}
