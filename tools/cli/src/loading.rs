//! Scenes of a file.

use rigidformer_runtime::scenes::{Dataset, RecordedScene, Split};

use crate::interrupt;

/// The first scenes of a split, all of them without a limit; so many of their frames, all of them without a number.
pub(crate) fn load_scenes(
    dataset: &Dataset,
    split: Split,
    limit: Option<u32>,
    frames: Option<usize>,
) -> anyhow::Result<Vec<RecordedScene>> {
    let mut indices = dataset.scenes_of(split);
    if indices.is_empty() {
        let path = dataset.path().display();
        anyhow::bail!(
            "{path}: scene_split: no scene is in the split {split}; choose another with --split"
        );
    }
    if let Some(limit) = limit {
        indices.truncate(limit as usize);
    }
    let mut scenes = Vec::with_capacity(indices.len());
    for index in indices {
        interrupt::check()?;
        scenes.push(dataset.scene(index, frames)?);
    }
    Ok(scenes)
}
