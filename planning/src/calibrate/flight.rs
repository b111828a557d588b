//! How far off the velocities are that recorded scenes begin with: free flight needs no contact to tell.

use nalgebra::{UnitQuaternion, Vector3};
use rigidformer_core::Role;
use rigidformer_core::kernels::in_own_environment;
use rigidformer_evaluation::contact::size_m;
use rigidformer_evaluation::scenes::{RecordedScene, RecordedUnit};

/// Frames that a velocity is told by, at most: later ones turn by more than they began with.
const MOST_FRAMES: usize = 12;
/// Frames that it is told by, at least.
const LEAST_FRAMES: usize = 3;
/// What is nearer to a plane than this share of its size may touch it.
const CLEAR: f32 = 0.05;
/// From a median of amounts to a standard deviation.
const OF_MEDIAN: f64 = 1.4826;

/// How far off recorded velocities are, a standard deviation of each coordinate.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct StartNoise {
    /// Units that flew for long enough.
    pub units: usize,
    /// Metres a second.
    pub linear_m_s: f64,
    /// Radians a second.
    pub angular_rad_s: f64,
}

/// Compares the velocities of scenes at frame 0 with the free flight after it; none where nothing flies for three frames.
pub fn start_noise(scenes: &[RecordedScene]) -> Option<StartNoise> {
    in_own_environment(|| {
        let (mut linear, mut angular, mut units) = (Vec::new(), Vec::new(), 0);
        for scene in scenes {
            let free = scene.units().iter().filter(|unit| unit.role == Role::Free);
            for [way, turn] in free.filter_map(|unit| of_unit(scene, unit)) {
                linear.extend(way.iter().map(|off| f64::from(off.abs())));
                angular.extend(turn.iter().map(|off| f64::from(off.abs())));
                units += 1;
            }
        }
        let [linear_m_s, angular_rad_s] = [deviation(linear)?, deviation(angular)?];
        Some(StartNoise { units, linear_m_s, angular_rad_s })
    })
}

fn deviation(mut amounts: Vec<f64>) -> Option<f64> {
    amounts.sort_by(f64::total_cmp);
    Some(OF_MEDIAN * amounts.get(amounts.len() / 2)?)
}

/// What is to be added to a unit's velocity and spin, so that it flies as recorded.
fn of_unit(scene: &RecordedScene, unit: &RecordedUnit) -> Option<[Vector3<f32>; 2]> {
    let (velocity, first) = (unit.velocity?, unit.poses.first()?);
    let clear = CLEAR * size_m(scene) as f32;
    let flies = |frame: &usize| {
        let points = unit.points_at(*frame).unwrap_or_default();
        let over = |plane: &rigidformer_core::Plane| {
            points.iter().all(|point| plane.normal.dot(&point.coords) - plane.offset_m > clear)
        };
        scene.planes().unwrap_or_default().iter().all(over)
    };
    let frames = (1..unit.poses.len().min(MOST_FRAMES)).take_while(flies).count();
    if frames < LEAST_FRAMES || !flies(&0) {
        return None;
    }
    let (mut way, mut turn, mut weight) = (Vector3::zeros(), Vector3::zeros(), 0.0);
    for (frame, pose) in unit.poses.iter().enumerate().take(frames + 1).skip(1) {
        let t = frame as f32 / scene.frame_rate_hz();
        let flown = velocity.linear_m_s * t + scene.gravity_m_s2() * (0.5 * t * t);
        way += (pose.translation.vector - first.translation.vector - flown) * t;
        let turned = UnitQuaternion::from_scaled_axis(velocity.angular_rad_s * t) * first.rotation;
        turn += (pose.rotation * turned.inverse()).scaled_axis() * t;
        weight += t * t;
    }
    Some([way / weight, turn / weight])
}
