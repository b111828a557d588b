//! What a recording takes in memory.

use std::path::Path;

use rigidformer_runtime::memory::{Budget, TooLarge};

/// Counts what is about to be allocated for a file.
pub(super) fn counted(path: &Path, budget: &mut Budget, bytes: u64) -> anyhow::Result<()> {
    let (path, remedy) = (path.display(), TooLarge::REMEDY);
    budget.take(bytes).map_err(|large| anyhow::anyhow!("{path}: {large}; {remedy}"))
}
