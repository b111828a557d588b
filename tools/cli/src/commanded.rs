//! What `rigidformer rollout --command` shows: a robot under one command.

use rigidformer_evaluation::robots::{self, Pace};
use rigidformer_evaluation::rollout::Trajectory;
use rigidformer_evaluation::scenes::RecordedScene;

/// A robot under one command.
pub(crate) struct Drive<'d> {
    pub(crate) scene: &'d RecordedScene,
    pub(crate) walk: &'d Trajectory,
    pub(crate) command: &'d [f32],
}

impl Drive<'_> {
    /// The part whose heading is the robot's.
    pub(crate) fn leader(&self) -> usize {
        robots::leader(self.scene).unwrap_or_default()
    }

    /// Seconds since frame 0.
    pub(crate) fn time_s(&self, frame: u32) -> f64 {
        f64::from(frame) / f64::from(self.scene.frame_rate_hz())
    }

    /// Mean pace between two frames.
    pub(crate) fn pace(&self, from: u32, to: u32) -> Pace {
        let rate = self.scene.frame_rate_hz();
        robots::pace(self.walk, self.leader(), from..to, rate).unwrap_or_default()
    }
}
