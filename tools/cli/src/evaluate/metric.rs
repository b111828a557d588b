//! What `rigidformer evaluate` needs of whoever measures scenes of one kind.

use rigidformer_evaluation::scenes::{Dataset, RecordedScene, Split};
use rigidformer_runtime::models::LoadedModel;
use rigidformer_runtime::progress::Progress;
use serde_json::Value;

use crate::arguments::Evaluate;
use crate::loading::load_scenes;

/// Scenes, and the model that predicts them.
#[derive(Clone, Copy)]
pub(super) struct Task<'t> {
    pub(super) arguments: &'t Evaluate,
    pub(super) dataset: &'t Dataset,
    pub(super) split: Split,
    pub(super) scenes: &'t [RecordedScene],
    pub(super) loaded: &'t LoadedModel,
    /// Step codes, at least one.
    pub(super) steps: &'t [u32],
}

impl Task<'_> {
    /// The model's name.
    pub(super) fn model_name(&self) -> &str {
        self.loaded.model().file().name()
    }
}

/// A figure by which a model is compared with the same motion without its network.
pub(super) struct Headline {
    pub(super) step: u32,
    /// With its unit.
    pub(super) name: &'static str,
    /// As JSON and models call it.
    pub(super) key: &'static str,
    pub(super) value: f64,
}

/// The figures of scenes of one kind.
pub(super) trait Metric: Sized {
    /// Step codes where none are given.
    const STEPS: &'static [u32];

    /// Whether the scenes of a file are of this kind.
    fn applies(dataset: &Dataset) -> bool;

    /// The scenes that are measured.
    fn load(
        dataset: &Dataset,
        split: Split,
        limit: Option<u32>,
        _: Progress<'_>,
    ) -> anyhow::Result<Vec<RecordedScene>> {
        load_scenes(dataset, split, limit, None)
    }

    /// Refuses options, steps and models that do not go with such scenes.
    fn check(task: &Task<'_>) -> anyhow::Result<()>;

    /// How often `measure` tells of progress.
    fn calls(task: &Task<'_>) -> u64;

    /// Predicts all scenes, and compares them with the record.
    fn measure(task: &Task<'_>, progress: Progress<'_>) -> anyhow::Result<Self>;

    /// What the model is compared by with the same motion without its network, of each step code.
    fn headlines(&self) -> Vec<Headline>;

    /// Prints the figures.
    fn print(&self, task: &Task<'_>) -> anyhow::Result<()>;

    /// The figures as a JSON document.
    fn json(&self, task: &Task<'_>) -> Value;

    /// The picture of --picture, a PNG file. `check` refuses the option where there is none.
    fn picture(&self, _: &Task<'_>) -> anyhow::Result<Vec<u8>> {
        anyhow::bail!("--picture: such scenes are not drawn")
    }
}
