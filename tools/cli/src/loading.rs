//! Scenes of a file.

use rigidformer_evaluation::figures::{self, SplitError};
use rigidformer_evaluation::scenes::{Dataset, RecordedScene, Split};
use rigidformer_runtime::progress::Progress;

use crate::interrupt;
use crate::usage::Usage;

/// The first scenes of a split, all of them without a limit; so many of their frames, all of them without a number.
pub(crate) fn load_scenes(
    dataset: &Dataset,
    split: Split,
    limit: Option<u32>,
    frames: Option<usize>,
) -> anyhow::Result<Vec<RecordedScene>> {
    let progress = Progress { cancelled: interrupt::flag(), ..Progress::none() };
    figures::scenes_of(dataset, split, limit, frames, progress).map_err(plain)
}

/// The error itself: by its type the program knows that Ctrl-C was pressed.
pub(crate) fn plain(error: SplitError) -> anyhow::Error {
    match error {
        SplitError::Rollout(error) => error.into(),
        SplitError::Step(_) => Usage(format!("--steps: {error}")).into(),
        other => other.into(),
    }
}
