//! A scene that is known exactly: boxes and balls over a floor, seen by ray casting.

mod objects;
mod rest;

use nalgebra::{Isometry3, Point3, Translation3, UnitQuaternion, Vector3};
use rigidformer_runtime::noise::Noise;

use super::*;
use crate::camera::Camera;
use crate::capture::{Cloud, DepthView};

#[derive(Clone, Copy)]
enum Body {
    Box([f32; 3]),
    Ball(f32),
}

/// Distance along a ray of length 1 to a body in its own frame.
fn hit(body: Body, eye: &Point3<f32>, ray: &Vector3<f32>) -> Option<f32> {
    match body {
        Body::Ball(radius) => {
            let (b, c) = (eye.coords.dot(ray), eye.coords.norm_squared() - radius * radius);
            let root = b * b - c;
            (root > 0.0).then(|| -b - root.sqrt()).filter(|t| *t > 0.0)
        }
        Body::Box(half) => {
            let (mut near, mut far) = (0.0f32, f32::MAX);
            for k in 0..3 {
                let (a, b) = ((-half[k] - eye[k]) / ray[k], (half[k] - eye[k]) / ray[k]);
                near = near.max(a.min(b));
                far = far.min(a.max(b));
            }
            (near < far && near > 0.0).then_some(near)
        }
    }
}

fn camera(eye: [f32; 3]) -> Camera {
    let pose =
        Isometry3::face_towards(&Point3::from(eye), &Point3::new(0.0, 0.0, 0.05), &-Vector3::z());
    Camera::new([320, 240], [277.0; 2], [160.0, 120.0], pose).unwrap()
}

fn see(
    camera: &Camera,
    bodies: &[(Body, Isometry3<f32>)],
    noise: &mut Noise,
    deviation_m: f32,
) -> DepthView {
    let [width, height] = camera.size();
    let eye = Point3::from(camera.pose().translation.vector);
    let forward = camera.pose().rotation * Vector3::z();
    let (mut depth, mut labels) = (Vec::new(), Vec::new());
    for v in 0..height {
        for u in 0..width {
            let ray = (camera.point([u as f32, v as f32], 1.0) - eye).normalize();
            let floor = if ray.z < 0.0 { -eye.z / ray.z } else { f32::MAX };
            let (mut best, mut label) = (floor, 0);
            for (number, (body, pose)) in bodies.iter().enumerate() {
                let local =
                    (pose.inverse_transform_point(&eye), pose.inverse_transform_vector(&ray));
                if let Some(t) = hit(*body, &local.0, &local.1).filter(|t| *t < best) {
                    (best, label) = (t, number as u16 + 1);
                }
            }
            let z = best * ray.dot(&forward) + noise.normal() * deviation_m;
            depth.push(if z < 10.0 { (z * 1000.0).round() as u16 } else { 0 });
            labels.push(label);
        }
    }
    DepthView::new(*camera, 0.001, depth, Some(labels)).unwrap()
}

const G: f32 = -9.81;

/// A box that is thrown and spins, and a ball that rolls, `t` seconds on.
fn thrown(t: f32) -> Vec<(Body, Isometry3<f32>)> {
    let place = Vector3::new(-0.25 + 0.9 * t, 0.1, 0.25 + 1.2 * t + 0.5 * G * t * t);
    let turn = UnitQuaternion::from_scaled_axis(
        Vector3::new(1.0, 2.0, 1.5) * t + Vector3::new(0.3, 0.1, 0.0),
    );
    let ball = Vector3::new(0.2 - 0.3 * t, -0.2 + 0.2 * t, 0.05);
    vec![
        (Body::Box([0.06, 0.05, 0.04]), Isometry3::from_parts(Translation3::from(place), turn)),
        (Body::Ball(0.05), Isometry3::translation(ball.x, ball.y, ball.z)),
    ]
}

const EYES: [[f32; 3]; 2] = [[0.1, -0.9, 0.6], [-0.8, 0.6, 0.7]];

fn follow(
    options: TrackerOptions,
    eyes: &[[f32; 3]],
    frames: u32,
    scene: impl Fn(f32) -> Vec<(Body, Isometry3<f32>)>,
) -> (Tracker, Vec<Estimate>) {
    let mut tracker = Tracker::new(options).unwrap();
    let mut noise = Noise::new(5, 5);
    let mut estimates = Vec::new();
    for frame in 0..frames {
        let t = frame as f32 / 30.0;
        let views =
            eyes.iter().map(|eye| View::Depth(see(&camera(*eye), &scene(t), &mut noise, 0.001)));
        let capture = Capture { time_s: f64::from(frame) / 30.0, views: views.collect() };
        estimates.push(tracker.observe(&capture).unwrap().clone());
    }
    (tracker, estimates)
}

/// How a unit moved from one instant to another, beside how a body did: metres at the body's centre, radians.
fn off(from: &UnitEstimate, to: &UnitEstimate, body: [Isometry3<f32>; 2]) -> (f32, f32) {
    let moved = to.pose * from.pose.inverse();
    let centre = Point3::from(body[0].translation.vector);
    let truth = body[1] * body[0].inverse();
    ((moved * centre - truth * centre).norm(), (moved.rotation * truth.rotation.inverse()).angle())
}

#[test]
fn a_thrown_box_and_a_rolling_ball_are_followed() {
    for (count, segmentation) in
        [(1, Segmentation::Found), (2, Segmentation::Found), (2, Segmentation::Given)]
    {
        let options = TrackerOptions { segmentation, ..TrackerOptions::default() };
        let (tracker, estimates) = follow(options, &EYES[..count], 11, thrown);
        let (first, last) = (&estimates[4], &estimates[10]);
        assert_eq!(first.units.len(), 2, "{count} {segmentation:?}");
        assert_eq!(last.units.len(), 2);
        assert_eq!(tracker.planes().len(), 1);
        let (before, after) = (thrown(4.0 / 30.0), thrown(10.0 / 30.0));
        for (a, b) in first.units.iter().zip(&last.units) {
            assert_eq!(a.id, b.id);
            let near = |body: &&(Body, Isometry3<f32>)| {
                (body.1.translation.vector - b.pose.translation.vector).norm() < 0.06
            };
            let at = after.iter().position(|body| near(&body)).unwrap();
            let (place, turn) = off(a, b, [before[at].1, after[at].1]);
            eprintln!(
                "{count} {segmentation:?} body {at}: {:.2} mm {:.2} deg",
                place * 1e3,
                turn.to_degrees()
            );
            let velocity = b.velocity.fixed_rows::<3>(0).into_owned();
            let truth = match at {
                0 => Vector3::new(0.9, 0.0, 1.2 + G / 3.0),
                _ => Vector3::new(-0.3, 0.2, 0.0),
            };
            eprintln!("   velocity off {:.1} cm/s", (velocity - truth).norm() * 100.0);
            assert!(place < 0.004, "{place}");
            if at == 0 {
                assert!(turn < 0.05, "{turn}");
                let spin = b.velocity.fixed_rows::<3>(3).into_owned();
                assert!((spin - Vector3::new(1.0, 2.0, 1.5)).norm() < 0.7, "{spin}");
            }
            assert!((velocity - truth).norm() < 0.15, "{velocity} {truth}");
        }
    }
}

#[test]
fn the_same_captures_give_the_same_bits() {
    let [a, b] = [(); 2].map(|()| follow(TrackerOptions::default(), &EYES, 6, thrown).1);
    assert_eq!(a, b);
}

/// Two boxes that come to touch, and go apart again.
fn meeting(t: f32) -> Vec<(Body, Isometry3<f32>)> {
    let gap = (0.14 - 0.5 * t).abs();
    [-0.5, 0.5]
        .map(|side| {
            let x = side * (0.1 + gap);
            (Body::Box([0.05, 0.06, 0.05]), Isometry3::translation(x, 0.0, 0.05))
        })
        .into()
}

#[test]
fn boxes_that_touch_stay_two() {
    let (_, estimates) = follow(TrackerOptions::default(), &EYES, 18, meeting);
    let ids: Vec<u32> = estimates[4].units.iter().map(|unit| unit.id).collect();
    assert_eq!(ids.len(), 2);
    for (frame, estimate) in estimates.iter().enumerate().skip(4) {
        let now: Vec<u32> = estimate.units.iter().map(|unit| unit.id).collect();
        assert_eq!(now, ids, "frame {frame}");
        let x = estimate.units.iter().map(|unit| unit.pose.translation.x);
        let mut x: Vec<f32> = x.collect();
        x.sort_by(f32::total_cmp);
        let truth = meeting(frame as f32 / 30.0)[1].1.translation.x;
        assert!(
            (x[1] - truth).abs() < 0.025 && (x[0] + truth).abs() < 0.025,
            "{frame} {x:?} {truth}"
        );
    }
}

/// A low box whose top is large enough for a tabletop, and a tall one that stands on the floor beside and behind it.
fn low_and_tall() -> Vec<(Body, Isometry3<f32>)> {
    let turned = UnitQuaternion::from_scaled_axis(Vector3::z() * 0.7);
    vec![
        (
            Body::Box([0.1, 0.08, 0.04]),
            Isometry3::from_parts(Translation3::new(0.0, -0.1, 0.04), turned),
        ),
        (Body::Box([0.04, 0.04, 0.12]), Isometry3::translation(0.03, 0.05, 0.12)),
    ]
}

#[test]
fn a_face_that_others_stand_beside_cuts_none_of_them() {
    let (tracker, estimates) = follow(TrackerOptions::default(), &EYES[..1], 3, |_| low_and_tall());
    assert!(!tracker.planes.tabletops().is_empty());
    assert_eq!(estimates[2].units.len(), 2);
    assert_eq!(tracker.segments(0).into_iter().max(), Some(2));
}

/// A table, and small boxes on it that meet it in no crease which is seen.
fn laid() -> Vec<(Body, Isometry3<f32>)> {
    let small = [[-0.12, 0.05], [0.1, -0.08], [0.05, 0.12]];
    let small =
        small.map(|[x, y]| (Body::Box([0.03, 0.025, 0.012]), Isometry3::translation(x, y, 0.112)));
    let table = (Body::Box([0.25, 0.2, 0.05]), Isometry3::translation(0.0, 0.0, 0.05));
    small.into_iter().chain([table]).collect()
}

#[test]
fn what_stands_on_a_table_is_apart_from_it() {
    for eye in EYES {
        let (tracker, estimates) = follow(TrackerOptions::default(), &[eye], 3, |_| laid());
        assert_eq!(estimates[2].units.len(), 4, "{eye:?}");
        assert_eq!(tracker.segments(0).into_iter().max(), Some(4), "{eye:?}");
    }
}

/// A box that slides behind a large one and out again.
fn behind(t: f32) -> Vec<(Body, Isometry3<f32>)> {
    vec![
        (Body::Box([0.15, 0.02, 0.15]), Isometry3::translation(0.0, -0.2, 0.15)),
        (Body::Box([0.04, 0.04, 0.04]), Isometry3::translation(-0.45 + 0.8 * t, 0.1, 0.04)),
    ]
}

#[test]
fn what_goes_behind_something_is_hidden_and_comes_back() {
    let options = TrackerOptions { gravity_m_s2: Vector3::zeros(), ..TrackerOptions::default() };
    let (_, estimates) = follow(options, &EYES[..1], 34, behind);
    let small = estimates[5]
        .units
        .iter()
        .min_by(|a, b| a.pose.translation.x.total_cmp(&b.pose.translation.x));
    let id = small.unwrap().id;
    let sights: Vec<Option<Visibility>> = estimates
        .iter()
        .map(|e| e.units.iter().find(|unit| unit.id == id).map(|unit| unit.visibility))
        .collect();
    assert!(sights.contains(&Some(Visibility::Hidden)));
    assert_eq!(sights[33], Some(Visibility::Seen));
    assert_eq!(estimates[33].units.len(), 2);
}

fn flat(depth: Vec<u16>) -> Capture {
    let view = DepthView::new(camera(EYES[0]), 0.001, depth, None).unwrap();
    Capture { time_s: 0.0, views: vec![View::Depth(view)] }
}

#[test]
fn foul_captures_are_refused_or_flagged_and_change_nothing() {
    let mut tracker = follow(TrackerOptions::default(), &EYES[..1], 4, thrown).0;
    let before = tracker.estimate().clone();
    let mut noise = Noise::new(1, 2);
    let sound = View::Depth(see(&camera(EYES[0]), &thrown(0.1), &mut noise, 0.001));
    let at = |time_s: f64, view: &View| Capture { time_s, views: vec![view.clone()] };
    assert!(matches!(tracker.observe(&at(0.1, &sound)), Err(TrackError::Order { .. })));
    assert!(matches!(tracker.observe(&at(0.05, &sound)), Err(TrackError::Order { .. })));
    assert_eq!(tracker.observe(&at(f64::NAN, &sound)), Err(TrackError::Time));
    let none = Capture { time_s: 1.0, views: Vec::new() };
    assert_eq!(tracker.observe(&none), Err(TrackError::Empty { time_s: 1.0 }));
    let points = vec![Point3::origin(), Point3::new(0.0, f32::NAN, 0.0)];
    let cloud = View::Cloud(Cloud { points, ..Cloud::default() });
    assert_eq!(tracker.observe(&at(1.0, &cloud)), Err(TrackError::Point { view: 0, point: 1 }));
    let cut =
        View::Depth(DepthView { depth: vec![1; 7], ..see(&camera(EYES[0]), &[], &mut noise, 0.0) });
    assert!(matches!(tracker.observe(&at(1.0, &cut)), Err(TrackError::Size { .. })));
    let scale =
        View::Depth(DepthView { scale_m: -1.0, ..see(&camera(EYES[0]), &[], &mut noise, 0.0) });
    assert!(matches!(tracker.observe(&at(1.0, &scale)), Err(TrackError::Scale { .. })));
    // Each image is allowed; what is made of all of them together takes more than a capture may.
    let lens = Camera::new([2048; 2], [2000.0; 2], [1024.0; 2], Isometry3::identity()).unwrap();
    let blank = || DepthView::new(lens, 0.001, vec![0; 2048 * 2048], None).unwrap();
    let many = Capture { time_s: 1.0, views: (0..4).map(|_| View::Depth(blank())).collect() };
    let refused = tracker.observe(&many).unwrap_err();
    assert!(matches!(refused, TrackError::Memory { needed: 1_174_405_120, .. }), "{refused}");
    assert!(refused.to_string().contains("--memory"), "{refused}");
    assert_eq!(tracker.estimate(), &before);
    // What it had is not lost.
    let next = View::Depth(see(&camera(EYES[0]), &thrown(4.0 / 30.0), &mut noise, 0.001));
    assert_eq!(tracker.observe(&at(4.0 / 30.0, &next)).unwrap().units.len(), 2);
}

#[test]
fn empty_saturated_and_noisy_images_give_no_units() {
    let pixels = 320 * 240;
    let mut noise = Noise::new(9, 9);
    let images = [
        vec![0; pixels],
        vec![u16::MAX; pixels],
        (0..pixels).map(|_| (noise.uniform() * 65535.0) as u16).collect(),
        vec![1; pixels],
    ];
    for (number, image) in images.into_iter().enumerate() {
        let mut tracker = Tracker::new(TrackerOptions::default()).unwrap();
        for frame in 0..4 {
            let capture = Capture { time_s: f64::from(frame), ..flat(image.clone()) };
            let estimate = tracker.observe(&capture).unwrap();
            assert!(estimate.units.is_empty(), "{number}");
        }
        assert_eq!(tracker.report().is_blind(), number < 2, "{number}");
    }
}

#[test]
fn ten_thousand_clusters_are_cut_down_and_reported() {
    // 20,000 posts of 6 by 6 pixels, .3 m in front of a wall.
    let is_post = |at: usize| (at % 1400) % 7 < 6 && (at / 1400) % 7 < 6;
    let image = (0..1400 * 700).map(|at| if is_post(at) { 700 } else { 1000 }).collect();
    let labels = None;
    let camera =
        Camera::new([1400, 700], [1200.0; 2], [700.0, 350.0], Isometry3::identity()).unwrap();
    let view = DepthView::new(camera, 0.001, image, labels).unwrap();
    let mut tracker = Tracker::new(TrackerOptions::default()).unwrap();
    for frame in 0..3 {
        let capture = Capture { time_s: f64::from(frame), views: vec![View::Depth(view.clone())] };
        tracker.observe(&capture).unwrap();
        assert!(tracker.report().clusters_left_out > 15_000, "{:?}", tracker.report());
        assert!(tracker.report().clusters <= 128);
    }
}

#[test]
fn rotated_images_and_wrong_intrinsics_do_no_harm() {
    let mut noise = Noise::new(1, 2);
    let wrong =
        Camera::new([320, 240], [2000.0; 2], [10.0, 400.0], *camera(EYES[0]).pose()).unwrap();
    let mut tracker = Tracker::new(TrackerOptions::default()).unwrap();
    let mut upside = Tracker::new(TrackerOptions::default()).unwrap();
    for frame in 0..6 {
        let t = frame as f32 / 30.0;
        let view = see(&camera(EYES[0]), &thrown(t), &mut noise, 0.001);
        let other = DepthView { camera: wrong, ..view.clone() };
        let time_s = f64::from(t);
        tracker.observe(&Capture { time_s, views: vec![View::Depth(other)] }).unwrap();
        let depth = view.depth.iter().rev().copied().collect();
        let turned = DepthView { depth, ..view };
        upside.observe(&Capture { time_s, views: vec![View::Depth(turned)] }).unwrap();
    }
    for tracker in [&tracker, &upside] {
        let poses = tracker.estimate().units.iter().map(|unit| unit.pose.to_homogeneous());
        assert!(
            poses.flat_map(|pose| pose.iter().copied().collect::<Vec<_>>()).all(f32::is_finite)
        );
    }
}

#[test]
fn options_out_of_range_are_refused() {
    let usual = TrackerOptions::default;
    let tilted = Plane { normal: Vector3::new(0.0, 0.0, 2.0), ..Plane::ground(0.5, 0.5) };
    for options in [
        TrackerOptions { planes: Some(vec![tilted]), ..usual() },
        TrackerOptions { planes: Some(vec![Plane::ground(0.5, 0.5); 9]), ..usual() },
        TrackerOptions { model_points: 3, ..usual() },
        TrackerOptions { confirm: 0, ..usual() },
        TrackerOptions { extents_m: [1.0, 0.5], ..usual() },
        TrackerOptions { hidden_s: f64::NAN, ..usual() },
        TrackerOptions { gravity_m_s2: Vector3::new(f32::NAN, 0.0, 0.0), ..usual() },
    ] {
        assert!(matches!(Tracker::new(options), Err(TrackError::Options { .. })));
    }
}

/// What comes and goes: a large box that stands, a small one that goes behind it and out of view, one that falls from above and a ball that
/// rolls by, over and over.
fn come_and_go(t: f32) -> Vec<(Body, Isometry3<f32>)> {
    let fall = (t - 1.0).clamp(0.0, 1.5);
    let height = (0.9 - 4.9 * fall * fall).max(0.04);
    let turn = UnitQuaternion::from_euler_angles(0.5 * t, 0.3 * t, 0.2 * t);
    let falling = Translation3::new(0.3, 0.0, height + 0.05);
    vec![
        (Body::Box([0.15, 0.02, 0.15]), Isometry3::translation(0.0, -0.2, 0.15)),
        (Body::Box([0.04, 0.04, 0.04]), Isometry3::translation(-0.9 + 0.6 * t, 0.1, 0.04)),
        (Body::Box([0.05, 0.04, 0.06]), Isometry3::from_parts(falling, turn)),
        (Body::Ball(0.05), Isometry3::translation(-0.3, 1.2 - 0.8 * t, 0.05)),
    ]
}

#[cfg(target_os = "linux")]
#[test]
#[ignore = "a measurement: ten minutes of captures"]
fn ten_minutes_of_captures_take_no_more_memory() {
    let resident_kb = || {
        let status = std::fs::read_to_string("/proc/self/status").unwrap();
        let line = status.lines().find(|line| line.starts_with("VmRSS")).unwrap();
        line.split_whitespace().nth(1).unwrap().parse::<u64>().unwrap()
    };
    let mut noise = Noise::new(9, 9);
    // Four seconds, which come again and again; between them all units jump.
    let recorded: Vec<Vec<View>> = (0..120)
        .map(|frame| come_and_go(frame as f32 / 30.0))
        .map(|scene| {
            let seen = EYES.iter().map(|eye| see(&camera(*eye), &scene, &mut noise, 0.001));
            seen.map(View::Depth).collect()
        })
        .collect();
    let model =
        rigidformer_runtime::models::LoadedModel::embedded("edge", rigidformer_weights::EDGE)
            .unwrap();
    let mut tracker =
        Tracker::new(TrackerOptions { model: Some(model), ..TrackerOptions::default() }).unwrap();
    let (mut appeared, mut given_up) = (0, 0);
    let started = std::time::Instant::now();
    let mut after_a_minute = 0;
    for frame in 0..18_000 {
        let views = recorded[frame % recorded.len()].clone();
        tracker.observe(&Capture { time_s: frame as f64 / 30.0, views }).unwrap();
        appeared += tracker.report().appeared.len();
        given_up += tracker.report().given_up.len();
        if frame % 30 == 0 {
            tracker.predict(0.4).unwrap();
        }
        if (frame + 1) % 1800 == 0 {
            let kb = resident_kb();
            eprintln!(
                "minute {}: {kb} kB, {appeared} appeared, {given_up} given up, {:?}",
                (frame + 1) / 1800,
                started.elapsed()
            );
            after_a_minute = if after_a_minute == 0 { kb } else { after_a_minute };
            assert!(kb < after_a_minute + 4096, "{kb} kB");
        }
    }
}
