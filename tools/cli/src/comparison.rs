//! What `rigidformer rollout` shows: a prediction, the record and free fall.

use rigidformer_runtime::metrics::{FrameErrors, frame_errors};
use rigidformer_runtime::rollout::Trajectory;
use rigidformer_runtime::scenes::RecordedScene;

/// A scene's prediction beside free fall from the same two observed frames.
pub(crate) struct Comparison<'s> {
    pub(crate) scene: &'s RecordedScene,
    pub(crate) model_name: String,
    pub(crate) predicted: Trajectory,
    pub(crate) free_fall: Trajectory,
}

/// The errors of both at a frame.
pub(crate) struct ErrorsAt {
    pub(crate) frame: u32,
    pub(crate) model: FrameErrors,
    pub(crate) free_fall: FrameErrors,
}

impl Comparison<'_> {
    /// Errors at a frame of the record.
    pub(crate) fn row(&self, frame: u32) -> Option<ErrorsAt> {
        let model = frame_errors(&self.predicted, self.scene, frame)?;
        let free_fall = frame_errors(&self.free_fall, self.scene, frame)?;
        Some(ErrorsAt { frame, model, free_fall })
    }

    /// Seconds since frame 0.
    pub(crate) fn time_s(&self, frame: u32) -> f64 {
        f64::from(frame) / f64::from(self.scene.frame_rate_hz())
    }
}
