//! What calibration refuses.

use rigidformer_evaluation::contact::ContactError;
use rigidformer_evaluation::rollout::RolloutError;

/// Why numbers are not fitted. Its text says what to do.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum CalibrateError {
    /// The caller asked to stop.
    #[error("cancelled")]
    Cancelled,
    /// A setting that is not allowed.
    #[error("{name}: is {value}, not {range}")]
    Setting {
        /// The setting.
        name: &'static str,
        /// What it is.
        value: String,
        /// What it may be.
        range: &'static str,
    },
    /// There is nothing to fit to.
    #[error("there are no scenes to fit to; give at least one")]
    NoScenes,
    /// A scene that tells nothing.
    #[error("{scene}: {what}")]
    Scene {
        /// The scene.
        scene: String,
        /// What is wrong, and the remedy.
        what: &'static str,
    },
    /// A scene that cannot take the numbers.
    #[error(transparent)]
    Contact(#[from] ContactError),
    /// A scene that cannot be rolled out.
    #[error(transparent)]
    Rollout(RolloutError),
}

impl From<RolloutError> for CalibrateError {
    fn from(error: RolloutError) -> Self {
        match error {
            RolloutError::Cancelled => CalibrateError::Cancelled,
            other => CalibrateError::Rollout(other),
        }
    }
}
