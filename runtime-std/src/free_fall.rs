//! The baseline: gravity and inertia, no contacts.
//!
//! From two poses a unit keeps its spin and moves on as a body in free fall would: over a gap of `h` seconds
//! `p[t+1] = 2 p[t] - p[t-1] + g h²` and `q[t+1] = (q[t] q[t-1]⁻¹) q[t]`, here in closed form, so that long runs
//! gather no rounding.

use nalgebra::{Isometry3, Translation3, UnitQuaternion, Vector3};
use rigidformer_core::Role;

use crate::rollout::Trajectory;
use crate::scenes::RecordedScene;

/// Frames that the published-split baseline of this project starts from.
pub const TABLE_FRAMES: (u32, u32) = (2, 3);

/// Pose after `gaps` more gaps of `gap_s` seconds each, given two poses that are one gap apart.
pub fn pose(
    previous: &Isometry3<f32>,
    current: &Isometry3<f32>,
    gravity_m_s2: &Vector3<f32>,
    gap_s: f64,
    gaps: f64,
) -> Isometry3<f32> {
    let (before, now): (Isometry3<f64>, Isometry3<f64>) = (previous.cast(), current.cast());
    let gained = now.translation.vector - before.translation.vector;
    let fallen = gravity_m_s2.cast::<f64>() * (gap_s * gap_s * gaps * (gaps + 1.0) / 2.0);
    let position = now.translation.vector + gained * gaps + fallen;
    let turn =
        UnitQuaternion::new_normalize((now.rotation * before.rotation.inverse()).into_inner());
    let rotation = UnitQuaternion::from_scaled_axis(turn.scaled_axis() * gaps) * now.rotation;
    Isometry3::from_parts(Translation3::from(position.cast::<f32>()), rotation.cast())
}

/// Free fall of a scene's units from two of its frames until `last_frame` is reached or passed, sampled as far apart
/// as those two frames are. Driven and fixed units are where they are recorded, after the last frame where they were
/// then. `None` if the two frames are not recorded, or not in order.
pub fn trajectory(
    scene: &RecordedScene,
    previous: u32,
    current: u32,
    last_frame: u32,
) -> Option<Trajectory> {
    let gap = current.checked_sub(previous).filter(|gap| *gap > 0)?;
    let (before, now) = (scene.poses_at(previous as usize)?, scene.poses_at(current as usize)?);
    let gap_s = f64::from(gap) / f64::from(scene.frame_rate_hz());
    let mut trajectory = Trajectory::new(previous, gap, before.clone());
    trajectory.push(now.iter().copied());
    let mut gaps = 0.0;
    while trajectory.last_frame() < last_frame {
        gaps += 1.0;
        let frame = trajectory.last_frame().saturating_add(gap) as usize;
        let poses = before.iter().zip(&now).zip(scene.units());
        trajectory.push(poses.map(|((before, now), unit)| match unit.role {
            Role::Free => pose(before, now, &scene.gravity_m_s2(), gap_s, gaps),
            _ => *unit.poses.get(frame).or(unit.poses.last()).unwrap_or(now),
        }));
    }
    Some(trajectory)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn equals_the_step_by_step_recurrence() {
        let turn = |x, y, z| UnitQuaternion::from_scaled_axis(Vector3::new(x, y, z));
        let before = Isometry3::from_parts(Translation3::new(0.1, -2.0, 3.0), turn(0.3, 0.2, -0.9));
        let now = Isometry3::from_parts(
            Translation3::new(0.15, -2.1, 3.2),
            turn(0.1, 0.05, 0.2) * before.rotation,
        );
        let gravity = Vector3::new(0.0, 0.0, -10.0);
        let h = 10.0 / 240.0;
        let (mut a, mut b): (Isometry3<f64>, Isometry3<f64>) = (before.cast(), now.cast());
        for gaps in 1..=40 {
            let position =
                b.translation.vector * 2.0 - a.translation.vector + gravity.cast() * h * h;
            let rotation = UnitQuaternion::new_normalize(
                (b.rotation * a.rotation.inverse() * b.rotation).into_inner(),
            );
            (a, b) = (b, Isometry3::from_parts(Translation3::from(position), rotation));
            let closed: Isometry3<f64> = pose(&before, &now, &gravity, h, f64::from(gaps)).cast();
            assert!((closed.translation.vector - b.translation.vector).norm() < 1e-4);
            assert!(closed.rotation.angle_to(&b.rotation) < 1e-4);
        }
    }
}
