//! Poses of a recorded scene between its frames.

use nalgebra::{Isometry3, Translation3};

use super::RecordedScene;

/// A time that is so near to a frame is that frame's, in frames.
// Times in seconds times the frame rate miss whole frames by rounding, and the last frame would be
// outside.
const ROUNDING: f64 = 1e-4;

impl RecordedScene {
    /// Seconds from the first recorded frame to the last.
    pub fn duration_s(&self) -> f64 {
        (self.frames() - 1) as f64 / f64::from(self.frame_rate_hz())
    }

    /// The pose of a unit so many seconds after the first frame; between two frames the one that lies as far between them. `None`
    /// outside of the record, and for a unit that is not there.
    ///
    /// ```
    /// # use nalgebra::{Isometry3, Point3, Vector3};
    /// # use rigidformer_core::Physics;
    /// # use rigidformer_evaluation::scenes::{RecordedScene, RecordedUnit, Split};
    /// # let physics = Physics { mass_kg: 1.0, friction: 0.4, restitution: 0.3 };
    /// # let poses = (0..3).map(|frame| Isometry3::translation(frame as f32, 0.0, 0.0)).collect();
    /// # let unit = RecordedUnit::new("x", vec![Point3::origin(); 4], physics, poses);
    /// # let scene = RecordedScene::new("slide", 1, Split::Test, 10.0, Vector3::zeros(), vec![unit])?;
    /// // A unit that moves 1 m a frame, at 10 Hz.
    /// assert_eq!(scene.pose_at(0.15, 0), Some(Isometry3::translation(1.5, 0.0, 0.0)));
    /// assert_eq!(scene.pose_at(0.21, 0), None);
    /// # Ok::<(), Box<dyn std::error::Error>>(())
    /// ```
    pub fn pose_at(&self, time_s: f64, unit: usize) -> Option<Isometry3<f32>> {
        let at = time_s * f64::from(self.frame_rate_hz());
        let nearest = at.round();
        let at = if (at - nearest).abs() < ROUNDING { nearest } else { at };
        if !(0.0..=(self.frames() - 1) as f64).contains(&at) {
            return None;
        }
        let (frame, share) = (at as usize, at.fract() as f32);
        let before = self.pose(frame, unit)?;
        // A recorded pose is returned bit for bit, and the last one has no successor.
        if share == 0.0 {
            return Some(*before);
        }
        let after = self.pose(frame + 1, unit)?;
        let position = before.translation.vector.lerp(&after.translation.vector, share);
        // Half a turn between frames has no shortest way, so the nearer frame stands for it.
        let nearer = if share < 0.5 { before.rotation } else { after.rotation };
        let rotation = before.rotation.try_slerp(&after.rotation, share, 1e-6).unwrap_or(nearer);
        Some(Isometry3::from_parts(Translation3::from(position), rotation))
    }
}
