//! The tracker on depth cameras whose errors are smooth: one support, and still bodies that stay.

use nalgebra::{Isometry3, Point3, Vector3};
use rigidformer_core::{Physics, Plane};
use rigidformer_evaluation::render::{DepthNoise, Renderer, SmoothErrors, cameras};
use rigidformer_evaluation::scenes::{RecordedScene, RecordedUnit, Split};
use rigidformer_perception::capture::{Capture, View};
use rigidformer_perception::tracker::{Tracker, TrackerOptions};

const CAPTURES: usize = 8;
/// Half of a cube's edge.
const HALF_M: f32 = 0.1;

/// Two boxes on the ground, half a metre apart, that lie still.
fn scene() -> RecordedScene {
    let physics = Physics { mass_kg: 1.0, friction: 0.5, restitution: 0.2 };
    let corner = |k: usize, axis: usize| if k >> axis & 1 == 0 { -HALF_M } else { HALF_M };
    let cube: Vec<_> =
        (0..8).map(|k| Point3::from([0, 1, 2].map(|axis| corner(k, axis)))).collect();
    let unit = |x: f32, turn: f32| {
        let pose = Isometry3::new(Vector3::new(x, 0.0, HALF_M), Vector3::z() * turn);
        RecordedUnit::new("cube", cube.clone(), physics, vec![pose; 2 * CAPTURES])
    };
    let units = vec![unit(-0.25, 0.3), unit(0.25, 1.1)];
    RecordedScene::new("still", 1, Split::Test, 30.0, Vector3::new(0.0, 0.0, -9.81), units)
        .unwrap()
        .with_planes(vec![Plane::ground(0.5, 0.2)])
        .unwrap()
}

/// Follows the scene under these errors and checks what the tracker says of it.
fn follow(smooth: &SmoothErrors) {
    let scene = scene();
    let renderer = Renderer::new(&scene).unwrap();
    let camera = cameras(&scene, [320, 240], 1).unwrap()[0];
    let noise = DepthNoise { deviation_at_1m_m: 0.0005, edge_loss: 0.3, seed: 1 };
    let mut tracker = Tracker::new(TrackerOptions::default()).unwrap();
    for capture in 0..CAPTURES {
        let time_s = capture as f64 / 30.0;
        let errors = (&noise, smooth);
        let view = renderer.view_with(&camera, time_s, 0.001, errors, capture as u64).unwrap();
        tracker.observe(&Capture { time_s, views: vec![View::Depth(view)] }).unwrap();
    }
    assert_eq!(tracker.planes().len(), 1, "the ground alone is a plane");
    let ground = tracker.planes()[0];
    assert!(ground.normal.z > 0.99 && ground.offset_m.abs() < 0.03, "{ground:?}");
    let estimate = tracker.estimate();
    assert_eq!(estimate.units.len(), 2, "two boxes");
    for unit in &estimate.units {
        let velocity = unit.velocity.fixed_rows::<3>(0).norm();
        assert!(velocity < 0.15, "a still box goes at {velocity} m/s");
    }
}

#[test]
fn still_boxes_are_followed_without_smooth_errors() {
    follow(&SmoothErrors::default());
}

#[test]
fn still_boxes_are_followed_by_a_camera_with_a_bowl() {
    follow(&SmoothErrors { bowl: 0.005, ..SmoothErrors::default() });
}

#[test]
fn still_boxes_are_followed_by_a_camera_with_steps() {
    // A Kinect has steps of 2.9 mm at 1 m.
    follow(&SmoothErrors { step_at_1m_m: 0.0029, ..SmoothErrors::default() });
}

#[test]
fn still_boxes_are_followed_by_a_camera_with_a_wave() {
    follow(&SmoothErrors { wave_at_1m_m: 0.001, seed: 3, ..SmoothErrors::default() });
}
