//! The baseline: gravity and inertia, no contacts.
//!
//! From two poses a unit keeps its spin and moves on as a body in free fall would: over a gap of `h` seconds
//! `p[t+1] = 2 p[t] - p[t-1] + g h²` and `q[t+1] = (q[t] q[t-1]⁻¹) q[t]`, here in closed form, so that long runs
//! gather no rounding.

use rigidformer_core::Role;
use rigidformer_runtime::poses::free_fall;

use crate::rollout::Trajectory;
use crate::scenes::RecordedScene;

/// Frames that the published-split baseline of this project starts from.
pub const TABLE_FRAMES: (u32, u32) = (2, 3);

/// Free fall of a scene's units from two of its frames until `last_frame` is reached or passed, sampled as far apart
/// as those two frames are. Driven and fixed units are where they are recorded, after the last frame where they were
/// then. `None` if the two frames are not recorded, or not in order.
pub fn trajectory(
    scene: &RecordedScene,
    previous: u32,
    current: u32,
    last_frame: u32,
) -> Option<Trajectory> {
    // A gap of 0 has no velocity.
    let gap = current.checked_sub(previous).filter(|gap| *gap > 0)?;
    let (before, now) = (scene.poses_at(previous as usize)?, scene.poses_at(current as usize)?);
    let gap_s = f64::from(gap) / f64::from(scene.frame_rate_hz());
    let mut trajectory = Trajectory::new(previous, gap, before.clone());
    trajectory.push(now.iter().copied());
    let mut gaps = 0.0;
    while trajectory.last_frame() < last_frame {
        // Each pose follows from the first two, so rounding does not add up over the frames.
        gaps += 1.0;
        let frame = trajectory.last_frame().saturating_add(gap) as usize;
        let poses = before.iter().zip(&now).zip(scene.units());
        trajectory.push(poses.map(|((before, now), unit)| match unit.role {
            Role::Free => free_fall(before, now, &scene.gravity_m_s2(), gap_s, gaps),
            // Commanded units do not fall: their motion is given, to the model as well.
            _ => *unit.poses.get(frame).or(unit.poses.last()).unwrap_or(now),
        }));
    }
    Some(trajectory)
}
