//! Errors of rollouts from one pose and velocity, the protocol of the recorded cube tosses (Acosta et al., arXiv 2110.00541).
//!
//! The errors of a toss are means over all frames after frame 0: of the distance `|p - p*|` of the body's origin, and of the
//! angle between the orientations. Figures of a file are means over its tosses.

use rayon::prelude::*;
use rigidformer_core::Role;
use rigidformer_runtime::engine::Engine;
use rigidformer_runtime::models::LoadedModel;
use rigidformer_runtime::progress::Progress;

use crate::metrics::{Apart, angle_deg, apart};
use crate::pivots;
use crate::rollout::{RolloutError, Trajectory, open_loop_frames, open_loop_on};
use crate::scenes::RecordedScene;

/// Edge of the cube of the recorded tosses, metres: published position errors are shares of it.
pub const CUBE_EDGE_M: f64 = 0.1048;
/// What scene files with these tosses are called.
// Published figures stand beside those of files with this name alone.
pub const CUBE_TOSSES: &str = "cube-tosses";

/// A published engine on the recorded cube tosses, its parameters fitted to them.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PublishedEngine {
    /// Its name.
    pub name: &'static str,
    /// Mean over tosses and its standard deviation, per cent of the cube's edge.
    pub position_percent: (f64, f64),
    /// Likewise, degrees.
    pub rotation_deg: (f64, f64),
}

const fn engine(
    name: &'static str,
    position_percent: (f64, f64),
    rotation_deg: (f64, f64),
) -> PublishedEngine {
    PublishedEngine { name, position_percent, rotation_deg }
}

/// Acosta et al., arXiv 2110.00541.
pub const PUBLISHED: [PublishedEngine; 3] = [
    engine("Drake", (13.5, 8.2), (16.5, 20.0)),
    engine("Bullet", (14.9, 8.9), (16.5, 20.2)),
    engine("MuJoCo", (25.1, 10.8), (21.7, 21.4)),
];

/// Errors of one scene: means over its frames after frame 0 and over its free units.
#[derive(Clone, Debug, PartialEq)]
pub struct SceneErrors {
    /// Its seed; of a recorded toss its published number.
    pub seed: i64,
    /// Frames that were compared.
    pub frames: usize,
    /// Distance of the bodies' origins, metres.
    pub position_m: f64,
    /// Angle between the orientations, degrees.
    pub rotation_deg: f64,
}

/// Figures over scenes.
#[derive(Clone, Debug, PartialEq)]
pub struct Figures {
    /// Mean over scenes and its standard deviation, metres.
    pub position_m: (f64, f64),
    /// Likewise, degrees.
    pub rotation_deg: (f64, f64),
    /// How far links of a body come apart, by pivots of all recorded frames ([`pivots::recorded`]); `None` where no body has
    /// several free parts.
    pub apart: Option<Apart>,
    /// In the order of the scenes.
    pub by_scene: Vec<SceneErrors>,
}

/// Steps that a scene takes.
pub fn steps(model: &LoadedModel, scene: &RecordedScene, step: u32) -> u64 {
    (open_loop_frames(model, scene) / f64::from(step.max(1))).ceil() as u64
}

/// Figures of the model at a step of so many of its native frames, scenes in parallel.
///
/// # Errors
/// [`RolloutError::OpenLoop`] for a scene without velocities at frame 0, or with only that frame.
pub fn model(
    model: &LoadedModel,
    scenes: &[RecordedScene],
    step: u32,
    progress: Progress<'_>,
) -> Result<Figures, RolloutError> {
    let engine = Engine::new()?.single();
    let native = f64::from(model.model().config().frame_rate_hz);
    // Scenes run side by side, so each takes one thread.
    let one = |scene: &RecordedScene| {
        let predicted = open_loop_on(engine, model, scene, step, progress)?;
        let errors = errors(&predicted, scene, native).ok_or_else(|| RolloutError::OpenLoop {
            scene: scene.name().to_owned(),
            what: "has no frame after frame 0 to compare with; leave the scene out",
        });
        Ok((errors?, apart(&predicted, &pivots::recorded(scene), 1, u32::MAX)))
    };
    let results: Vec<_> = scenes.par_iter().map(one).collect();
    // The order of the scenes fixes the order of the sums, whatever the threads do.
    let (by_scene, distances): (Vec<_>, Vec<_>) =
        results.into_iter().collect::<Result<Vec<_>, RolloutError>>()?.into_iter().unzip();
    let position_m = mean_and_sd(by_scene.iter().map(|scene| scene.position_m));
    let rotation_deg = mean_and_sd(by_scene.iter().map(|scene| scene.rotation_deg));
    Ok(Figures { position_m, rotation_deg, apart: Apart::of(distances.concat()), by_scene })
}

/// Errors of a prediction in frames of `native_hz` against all frames of a record but the first; `None` where it ends before
/// the record, or there is nothing to compare.
pub fn errors(
    predicted: &Trajectory,
    scene: &RecordedScene,
    native_hz: f64,
) -> Option<SceneErrors> {
    let (mut position, mut angle, mut count) = (0.0, 0.0, 0usize);
    for (number, unit) in scene.units().iter().enumerate() {
        // The others go where they are recorded, without error.
        if unit.role != Role::Free {
            continue;
        }
        // Frame 0 is given to the model.
        for (frame, truth) in unit.poses.iter().enumerate().skip(1) {
            // The record's frames (148 Hz) fall between the model's (240 Hz).
            let at = frame as f64 * native_hz / f64::from(scene.frame_rate_hz());
            let found = predicted.pose_at(at, number)?;
            let away =
                found.translation.vector.cast::<f64>() - truth.translation.vector.cast::<f64>();
            position += away.norm();
            angle += angle_deg(&found, truth);
            count += 1;
        }
    }
    let mean = |sum: f64| sum / count as f64;
    (count > 0).then(|| SceneErrors {
        seed: scene.seed(),
        frames: scene.frames() - 1,
        position_m: mean(position),
        rotation_deg: mean(angle),
    })
}

/// Mean and standard deviation of a sample.
fn mean_and_sd(values: impl ExactSizeIterator<Item = f64> + Clone) -> (f64, f64) {
    let count = values.len().max(1) as f64;
    let mean = values.clone().sum::<f64>() / count;
    let squares = values.map(|value| (value - mean) * (value - mean)).sum::<f64>();
    // One value has no spread: 0, not 0 / 0.
    (mean, (squares / (count - 1.0).max(1.0)).sqrt())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scenes::{RecordedUnit, Split, Velocity};
    use nalgebra::{Isometry3, Point3, UnitQuaternion, Vector3};
    use rigidformer_core::{Physics, Plane};

    const RATE_HZ: f32 = 148.0;
    const NATIVE_HZ: f64 = 240.0;
    const GRAVITY: f32 = -9.81;

    fn flight(velocity: Option<Velocity>, frames: usize) -> RecordedScene {
        let Velocity { linear_m_s, angular_rad_s } = velocity.unwrap_or_default();
        let corner =
            |i: i32| Point3::from([1, 2, 4].map(|bit| if i & bit == 0 { -0.05 } else { 0.05 }));
        let pose = |frame: usize| {
            let t = frame as f32 / RATE_HZ;
            let fall = Vector3::new(0.0, 0.0, 0.5 * GRAVITY * t * t);
            let position = Vector3::new(0.1, -0.2, 1.5) + linear_m_s * t + fall;
            Isometry3::from_parts(
                position.into(),
                UnitQuaternion::from_scaled_axis(angular_rad_s * t),
            )
        };
        let physics = Physics { mass_kg: 0.37, friction: 0.4, restitution: 0.3 };
        let points = (0..8).map(corner).collect();
        let mut unit = RecordedUnit::new("cube", points, physics, (0..frames).map(pose).collect());
        unit.velocity = velocity;
        let gravity = Vector3::new(0.0, 0.0, GRAVITY);
        RecordedScene::new("toss", 7, Split::Test, RATE_HZ, gravity, vec![unit])
            .unwrap()
            .with_planes(vec![Plane::ground(0.4, 0.3)])
            .unwrap()
    }

    fn spinning() -> Velocity {
        Velocity {
            linear_m_s: Vector3::new(1.0, 0.5, 0.7),
            angular_rad_s: Vector3::new(2.0, -3.0, 1.0),
        }
    }

    #[test]
    fn a_body_that_touches_nothing_flies_as_recorded() {
        let edge = LoadedModel::embedded("edge", rigidformer_weights::EDGE).unwrap();
        let scene = flight(Some(spinning()), 60);
        for (step, tolerance_m) in [(1, 1e-4), (4, 5e-4), (10, 3e-3)] {
            let found = model(&edge, std::slice::from_ref(&scene), step, Progress::none()).unwrap();
            let by_scene = &found.by_scene[0];
            assert_eq!((by_scene.seed, by_scene.frames), (7, 59));
            // Frames between steps lie on a chord of the parabola.
            assert!(by_scene.position_m < tolerance_m, "step {step}: {by_scene:?}");
            assert!(by_scene.rotation_deg < 0.05, "step {step}: {by_scene:?}");
            assert_eq!(found.position_m, (by_scene.position_m, 0.0));
        }
    }

    #[test]
    fn what_cannot_be_rolled_out_is_named() {
        let edge = LoadedModel::embedded("edge", rigidformer_weights::EDGE).unwrap();
        let refused = |scene: RecordedScene| {
            let error = model(&edge, &[scene], 1, Progress::none()).unwrap_err().to_string();
            assert!(error.starts_with("toss: has "), "{error}");
            error
        };
        assert!(refused(flight(None, 5)).contains("no unit_velocity"));
        assert!(refused(flight(Some(spinning()), 1)).contains("no frame after frame 0"));
        let commanded = flight(Some(spinning()), 5).with_commands(1, vec![0.0; 5]).unwrap();
        assert!(refused(commanded).contains("commands"));
    }

    #[test]
    fn errors_are_means_over_frames() {
        let scene = flight(Some(Velocity::default()), 3);
        let first = scene.poses_at(0).unwrap();
        let mut moved = first.clone();
        moved[0].translation.x += 0.3;
        let mut still = Trajectory::new(0, 4, first);
        still.push(moved);
        let found = errors(&still, &scene, NATIVE_HZ).unwrap();
        let expected = [1.0f64, 2.0].map(|frame| {
            let fall = 0.5 * f64::from(GRAVITY) * (frame / 148.0).powi(2);
            fall.hypot(0.3 * frame * 240.0 / 148.0 / 4.0)
        });
        assert!((found.position_m - (expected[0] + expected[1]) / 2.0).abs() < 1e-6, "{found:?}");
        assert_eq!(found.rotation_deg, 0.0);
        let short = Trajectory::new(0, 3, scene.poses_at(0).unwrap());
        assert_eq!(errors(&short, &scene, NATIVE_HZ), None);
        let (mean, sd) = mean_and_sd([1.0, 2.0, 3.0].into_iter());
        assert_eq!((mean, sd), (2.0, 1.0));
    }
}
