//! Kinematics from poses alone, without a model: free fall, previous poses, and headings.

use nalgebra::{Isometry3, Translation3, UnitQuaternion, Vector3};
use rigidformer_core::Role;
use rigidformer_core::kernels::in_own_environment;

/// Pose in free fall after `gaps` more gaps of `gap_s` seconds each, given two poses that are one gap apart.
pub fn free_fall(
    previous: &Isometry3<f32>,
    current: &Isometry3<f32>,
    gravity_m_s2: &Vector3<f32>,
    gap_s: f64,
    gaps: f64,
) -> Isometry3<f32> {
    in_own_environment(|| free_fall_here(previous, current, gravity_m_s2, gap_s, gaps))
}

fn free_fall_here(
    previous: &Isometry3<f32>,
    current: &Isometry3<f32>,
    gravity_m_s2: &Vector3<f32>,
    gap_s: f64,
    gaps: f64,
) -> Isometry3<f32> {
    let (before, now): (Isometry3<f64>, Isometry3<f64>) = (previous.cast(), current.cast());
    let gained = now.translation.vector - before.translation.vector;
    // Verlet's sum over gaps: 1 + 2 + ... + n times the gain of a gap.
    let fallen = gravity_m_s2.cast::<f64>() * (gap_s * gap_s * gaps * (gaps + 1.0) / 2.0);
    let position = now.translation.vector + gained * gaps + fallen;
    // The product of two unit quaternions loses its length to rounding, and powers of it would scale.
    let turn =
        UnitQuaternion::new_normalize((now.rotation * before.rotation.inverse()).into_inner());
    let rotation = UnitQuaternion::from_scaled_axis(turn.scaled_axis() * gaps) * now.rotation;
    Isometry3::from_parts(Translation3::from(position.cast::<f32>()), rotation.cast())
}

/// Pose of a step ago of a unit with these velocities.
pub fn a_step_before(
    current: &Isometry3<f32>,
    linear_m_s: &Vector3<f32>,
    angular_rad_s: &Vector3<f32>,
    dt_s: f32,
) -> Isometry3<f32> {
    in_own_environment(|| {
        let back = UnitQuaternion::from_scaled_axis(angular_rad_s * -dt_s);
        let position = current.translation.vector - linear_m_s * dt_s;
        Isometry3::from_parts(Translation3::from(position), back * current.rotation)
    })
}

/// Number of the heaviest free unit, the first of equals, from their roles and masses.
pub fn heaviest_free(units: impl Iterator<Item = (Role, f32)>) -> Option<usize> {
    let heavier =
        |best: (usize, f32), next: (usize, f32)| if next.1 > best.1 { next } else { best };
    let free = units.enumerate().filter(|(_, (role, _))| *role == Role::Free);
    free.map(|(number, (_, mass))| (number, mass)).reduce(heavier).map(|(number, _)| number)
}

/// The heading of a link: its rotation about the vertical, and its position on the ground.
///
/// ```
/// use nalgebra::{Isometry3, Vector3};
/// use rigidformer_runtime::poses::heading;
/// let leaning = Isometry3::rotation(Vector3::z() * 0.5) * Isometry3::rotation(Vector3::x() * 0.2);
/// let pose = Isometry3::translation(1.0, 2.0, 0.8) * leaning;
/// assert!((heading(&pose).rotation.angle() - 0.5).abs() < 1e-6);
/// assert_eq!(heading(&pose).translation.vector, Vector3::new(1.0, 2.0, 0.0));
/// ```
pub fn heading(pose: &Isometry3<f32>) -> Isometry3<f32> {
    in_own_environment(|| {
        let yaw = 2.0 * pose.rotation.k.atan2(pose.rotation.w);
        let position = Vector3::new(pose.translation.x, pose.translation.y, 0.0);
        let turn = UnitQuaternion::from_axis_angle(&Vector3::z_axis(), yaw);
        Isometry3::from_parts(Translation3::from(position), turn)
    })
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
            let closed: Isometry3<f64> =
                free_fall(&before, &now, &gravity, h, f64::from(gaps)).cast();
            assert!((closed.translation.vector - b.translation.vector).norm() < 1e-4);
            assert!(closed.rotation.angle_to(&b.rotation) < 1e-4);
        }
    }
}
