//! Scenes and models of the command line, and rollouts of one on the other.

use rayon::prelude::*;
use rigidformer_evaluation::scenes::{Dataset, RecordedScene, Split};
use rigidformer_runtime::models::LoadedModel;

use crate::arguments::{Model, Scenes};

/// Scenes of a split, with their first `frames` frames or all of them.
pub(crate) fn load_scenes(
    dataset: &Dataset,
    wanted: &Scenes,
    frames: Option<usize>,
) -> anyhow::Result<Vec<RecordedScene>> {
    let split = Split::from(wanted.split);
    let mut indices = dataset.scenes_of(split);
    // Means over no scenes would print as dashes, without a reason.
    if indices.is_empty() {
        let path = dataset.path().display();
        anyhow::bail!(
            "{path}: scene_split: no scene is in the split {split}; choose another with --split"
        );
    }
    if let Some(limit) = wanted.limit {
        indices.truncate(limit as usize);
    }
    let scenes = indices.into_iter().map(|index| dataset.scene(index, frames));
    Ok(scenes.collect::<Result<_, _>>()?)
}

/// The given model, or the embedded one, in the form that runs fastest here.
pub(crate) fn load_model(model: &Model) -> anyhow::Result<LoadedModel> {
    let loaded = match &model.path {
        Some(path) => LoadedModel::open(path)?,
        None => LoadedModel::embedded("<default model>", rigidformer_weights::EDGE)?,
    };
    Ok(loaded.for_host()?)
}

/// `one` of every scene, in parallel; results in the order of the scenes, whatever the threads did.
pub(crate) fn each_scene<T: Send>(
    scenes: &[RecordedScene],
    one: impl Fn(&RecordedScene) -> anyhow::Result<T> + Send + Sync,
) -> anyhow::Result<Vec<T>> {
    let results: Vec<anyhow::Result<T>> = scenes.par_iter().map(one).collect();
    results.into_iter().collect()
}
