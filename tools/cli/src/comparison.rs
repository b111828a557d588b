//! What `rigidformer rollout` shows: a prediction, the record and a baseline.

use nalgebra::Point3;
use rigidformer_evaluation::metrics::{FrameErrors, frame_errors};
use rigidformer_evaluation::predicted::Predicted;
use rigidformer_evaluation::predicted::recorded;
use rigidformer_evaluation::rollout::Trajectory;
use rigidformer_evaluation::scenes::RecordedScene;
use rigidformer_evaluation::soft::{Baseline, vertex_error_m};

/// A scene's prediction beside free fall from the same two observed frames.
pub(crate) struct Comparison<'s> {
    pub(crate) scene: &'s RecordedScene,
    pub(crate) model_name: String,
    pub(crate) predicted: Predicted,
    pub(crate) free_fall: Trajectory,
}

/// The errors of both at a frame.
pub(crate) struct ErrorsAt {
    pub(crate) frame: u32,
    pub(crate) model: FrameErrors,
    pub(crate) free_fall: FrameErrors,
}

/// How far soft points are from where they were recorded, metres.
#[derive(Clone, Copy)]
pub(crate) struct PointErrors {
    pub(crate) mean_m: f64,
    pub(crate) most_m: f64,
}

/// The errors of soft points at a frame, beside those of the rigid motion of each body that fits the record best.
pub(crate) struct PointErrorsAt {
    pub(crate) frame: u32,
    pub(crate) model: PointErrors,
    pub(crate) rigid: PointErrors,
}

impl Comparison<'_> {
    /// Errors at a frame of the record.
    pub(crate) fn row(&self, frame: u32) -> Option<ErrorsAt> {
        let model = frame_errors(&self.predicted.poses, self.scene, frame)?;
        let free_fall = frame_errors(&self.free_fall, self.scene, frame)?;
        Some(ErrorsAt { frame, model, free_fall })
    }

    /// Whether the scene has soft units: then errors are those of their points.
    pub(crate) fn is_soft(&self) -> bool {
        self.predicted.points.is_some()
    }

    /// Errors of the soft points at a frame of the record; `None` in a scene without soft units.
    pub(crate) fn points_row(&self, frame: u32) -> Option<PointErrorsAt> {
        let truth = recorded(self.scene, frame as usize)?;
        let model = errors(&self.predicted.points.as_ref()?.between(frame)?, &truth)?;
        let step = self.predicted.poses.step();
        let rigid = Baseline::BestRigid.points(self.scene, step, frame)?;
        Some(PointErrorsAt { frame, model, rigid: errors(&rigid, &truth)? })
    }

    /// Seconds since frame 0.
    pub(crate) fn time_s(&self, frame: u32) -> f64 {
        f64::from(frame) / f64::from(self.scene.frame_rate_hz())
    }
}

fn errors(points: &[Point3<f32>], truth: &[Point3<f32>]) -> Option<PointErrors> {
    let apart = points.iter().zip(truth).map(|(a, b)| f64::from((a - b).norm()));
    Some(PointErrors { mean_m: vertex_error_m(points, truth)?, most_m: apart.fold(0.0, f64::max) })
}
