//! Wrong usage.

use rigidformer_evaluation::scenes::RecordedScene;

/// A mistake in how options go together, which clap cannot see.
#[derive(Debug)]
pub struct Usage(pub String);

impl std::fmt::Display for Usage {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str(&self.0)
    }
}

impl std::error::Error for Usage {}

/// Tells of a command or an option that needs a feature of the program.
#[cfg_attr(feature = "full", allow(dead_code))]
pub(crate) fn missing(what: &str, feature: &str) -> Usage {
    Usage(format!(
        "`{what}` needs the feature `{feature}`: put `--features full` after `cargo run --release` or `cargo install --path tools/cli`"
    ))
}

/// Refuses step codes whose first prediction is behind the end of a scene.
pub(crate) fn check_steps(steps: &[u32], scenes: &[RecordedScene]) -> Result<(), Usage> {
    let recorded = scenes.iter().map(RecordedScene::frames).min().unwrap_or_default();
    match steps.iter().find(|step| recorded <= 2 * **step as usize) {
        None => Ok(()),
        Some(step) => Err(Usage(format!(
            "--steps {step}: the shortest scene has {recorded} frames; the first prediction is frame {}",
            step.saturating_mul(2)
        ))),
    }
}
