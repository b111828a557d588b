//! Where units are at any time of a motion, predicted or recorded.

use nalgebra::{Isometry3, Point3};
use rigidformer_evaluation::predicted::PointTrajectory;
use rigidformer_evaluation::rollout::Trajectory;
use rigidformer_evaluation::scenes::RecordedScene;

/// A time that is so near to a sample is that sample's, in samples.
const ROUNDING: f64 = 1e-4;

pub(super) struct Motion {
    pub(super) scene: RecordedScene,
    pub(super) predicted: Option<Prediction>,
}

pub(super) struct Prediction {
    pub(super) poses: Trajectory,
    /// Of soft units.
    pub(super) points: Option<PointTrajectory>,
    /// Of the trajectory's frames.
    pub(super) rate_hz: f64,
}

/// Units at an instant.
pub(super) struct Instant {
    /// (units) Of soft ones the rigid poses that fit best.
    pub(super) poses: Vec<Isometry3<f32>>,
    /// (points) Of all soft units, in the world.
    pub(super) soft: Vec<Point3<f32>>,
}

impl Motion {
    /// Seconds from the first frame to the last.
    pub(super) fn duration_s(&self) -> f64 {
        match &self.predicted {
            None => self.scene.duration_s(),
            Some(predicted) => f64::from(predicted.poses.last_frame()) / predicted.rate_hz,
        }
    }

    /// So many seconds after the first frame; between samples on the way from one to the next. `None` outside of the motion.
    pub(super) fn at(&self, time_s: f64) -> Option<Instant> {
        let units = 0..self.scene.units().len();
        let Some(predicted) = &self.predicted else {
            let poses =
                units.map(|unit| self.scene.pose_at(time_s, unit)).collect::<Option<_>>()?;
            let at = time_s * f64::from(self.scene.frame_rate_hz());
            let soft = self.scene.units().iter().filter_map(|unit| unit.soft.as_ref());
            let soft = soft.map(|frames| lerp(frames, at)).collect::<Option<Vec<_>>>()?.concat();
            return Some(Instant { poses, soft });
        };
        let at = time_s * predicted.rate_hz;
        let poses = units.map(|unit| predicted.poses.pose_at(at, unit)).collect::<Option<_>>()?;
        let soft = match &predicted.points {
            None => Vec::new(),
            Some(points) => {
                let since = at - f64::from(points.first_frame);
                lerp(&points.samples, since / f64::from(points.step.max(1)))?
            }
        };
        Some(Instant { poses, soft })
    }
}

/// Points at a place among samples, on the straight ways between two.
fn lerp(samples: &[Vec<Point3<f32>>], at: f64) -> Option<Vec<Point3<f32>>> {
    let at = if (at - at.round()).abs() < ROUNDING { at.round() } else { at };
    if at < 0.0 {
        return None;
    }
    let (before, part) = (samples.get(at as usize)?, at.fract() as f32);
    if part == 0.0 {
        return Some(before.clone());
    }
    let after = samples.get(at as usize + 1)?;
    Some(before.iter().zip(after).map(|(a, b)| a + (b - a) * part).collect())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn points_between_samples_lie_between_them() {
        let at = |x: f32| vec![Point3::new(x, 0.0, 0.0)];
        let samples = [at(0.0), at(4.0), at(8.0)];
        assert_eq!(lerp(&samples, 0.25), Some(at(1.0)));
        assert_eq!(lerp(&samples, 2.000_01), Some(at(8.0)));
        assert_eq!(lerp(&samples, 2.5), None);
        assert_eq!(lerp(&samples, -0.5), None);
    }
}
