//! Rest: what stands is held still, also where nothing carries it that is seen.

use rigidformer_runtime::models::LoadedModel;

use super::*;
use crate::estimate::Rest;

/// Labelled images of a scene at so many captures a second.
fn captures(
    rate_hz: f64,
    count: u32,
    (deviation_m, has_floor): (f32, bool),
    scene: impl Fn(f32) -> Vec<(Body, Isometry3<f32>)>,
) -> Vec<Capture> {
    let mut noise = Noise::new(7, 7);
    let one = |frame: u32| {
        let time_s = f64::from(frame) / rate_hz;
        let bodies = scene(time_s as f32);
        let views = EYES.iter().map(|eye| {
            let mut view = see(&camera(*eye), &bodies, &mut noise, deviation_m);
            if !has_floor {
                let labels = view.labels.iter().flatten();
                view.depth.iter_mut().zip(labels).for_each(|(depth, label)| {
                    *depth *= u16::from(*label > 0);
                });
            }
            View::Depth(view)
        });
        Capture { time_s, views: views.collect() }
    };
    (0..count).map(one).collect()
}

/// A box that stands, and a ball.
fn standing(_: f32) -> Vec<(Body, Isometry3<f32>)> {
    vec![
        (Body::Box([0.06, 0.05, 0.04]), Isometry3::translation(-0.15, 0.1, 0.04)),
        (Body::Ball(0.05), Isometry3::translation(0.15, -0.1, 0.05)),
    ]
}

/// No plane is seen, and bodies are told.
fn blind() -> TrackerOptions {
    TrackerOptions {
        planes: Some(Vec::new()),
        segmentation: Segmentation::Given,
        ..TrackerOptions::default()
    }
}

fn edge() -> LoadedModel {
    LoadedModel::embedded("edge", rigidformer_weights::EDGE).unwrap()
}

#[test]
fn what_stands_on_nothing_that_is_seen_is_held_still() {
    for model in [None, Some(edge())] {
        let has_model = model.is_some();
        let mut tracker = Tracker::new(TrackerOptions { model, ..blind() }).unwrap();
        let mut first: Option<Estimate> = None;
        for capture in captures(30.0, 16, (0.0015, false), standing) {
            let estimate = tracker.observe(&capture).unwrap().clone();
            for unit in &estimate.units {
                assert_eq!(unit.rest, Rest::Held, "{} s", estimate.time_s);
                assert_eq!(unit.velocity.norm(), 0.0);
            }
            if estimate.units.len() == 2 && first.is_none() {
                first = Some(estimate);
            }
        }
        let (first, last) = (first.unwrap(), tracker.estimate().clone());
        for (a, b) in first.units.iter().zip(&last.units) {
            let way = (b.pose.translation.vector - a.pose.translation.vector).norm();
            assert!(a.id == b.id && way < 0.005, "{way}");
        }
        let forecast = tracker.predict(1.0).unwrap();
        if !has_model {
            continue;
        }
        assert!(forecast.left_out.is_empty(), "{:?}", forecast.left_out);
        for (id, pose) in forecast.poses.last().unwrap() {
            let unit = last.units.iter().find(|unit| unit.id == *id).unwrap();
            let way = (pose.translation.vector - unit.pose.translation.vector).norm();
            assert!(way < 1e-4, "{way}");
        }
    }
}

#[test]
fn what_stands_on_a_floor_rests_from_its_first_estimate_on_at_any_rate() {
    for rate_hz in [5.0, 10.0, 30.0, 90.0] {
        let options = TrackerOptions { model: Some(edge()), ..TrackerOptions::default() };
        let mut tracker = Tracker::new(options).unwrap();
        for (number, capture) in captures(rate_hz, 6, (0.001, true), standing).iter().enumerate() {
            let estimate = tracker.observe(capture).unwrap();
            assert_eq!(estimate.units.len(), if number == 0 { 0 } else { 2 }, "{rate_hz} Hz");
            for unit in &estimate.units {
                assert_eq!(unit.rest, Rest::Supported, "{rate_hz} Hz, {number}");
                let deviations = unit.velocity[2] / unit.velocity_covariance[(2, 2)].sqrt();
                assert!(unit.velocity[2].abs() < 0.02 && deviations.abs() < 3.0);
            }
        }
    }
}

#[test]
fn what_stands_on_another_unit_is_carried() {
    let stacked = |_: f32| {
        vec![
            (Body::Box([0.1, 0.1, 0.05]), Isometry3::translation(0.0, 0.0, 0.05)),
            (Body::Box([0.05, 0.05, 0.04]), Isometry3::translation(0.0, 0.0, 0.14)),
        ]
    };
    let mut tracker = Tracker::new(blind()).unwrap();
    for capture in captures(30.0, 6, (0.001, false), stacked) {
        tracker.observe(&capture).unwrap();
    }
    let units = &tracker.estimate().units;
    let upper = units.iter().max_by(|a, b| a.pose.translation.z.total_cmp(&b.pose.translation.z));
    let rests: Vec<Rest> = units.iter().map(|unit| unit.rest).collect();
    assert_eq!(upper.unwrap().rest, Rest::Supported, "{rests:?}");
    assert!(rests.contains(&Rest::Held), "{rests:?}");
}

#[test]
fn rest_ends_where_motion_is_measured() {
    // The box stands for .3 s and is pushed; the ball is let go.
    let scene = |t: f32| {
        let since = (t - 0.3).max(0.0);
        let z = 0.6 + 0.5 * G * since * since;
        vec![
            (Body::Box([0.06, 0.05, 0.04]), Isometry3::translation(-0.25 + 0.2 * since, 0.1, 0.04)),
            (Body::Ball(0.05), Isometry3::translation(0.15, -0.1, z)),
        ]
    };
    let mut tracker = Tracker::new(blind()).unwrap();
    for capture in captures(30.0, 17, (0.001, false), scene) {
        let estimate = tracker.observe(&capture).unwrap().clone();
        let since = estimate.time_s - 0.3;
        for unit in &estimate.units {
            let is_ball = unit.pose.translation.x > 0.0;
            if since < 0.01 {
                assert_eq!(unit.rest, Rest::Held);
            } else if since > 0.1 {
                assert_eq!(unit.rest, Rest::Moving, "{since}");
                let truth = match is_ball {
                    true => Vector3::new(0.0, 0.0, G * since as f32),
                    false => Vector3::new(0.2, 0.0, 0.0),
                };
                let off = (unit.velocity.fixed_rows::<3>(0).into_owned() - truth).norm();
                assert!(off < 0.1, "{since} {is_ball} {off}");
            }
        }
    }
}

/// A tracker that has seen two units stand for a third of a second.
fn settled() -> Tracker {
    let mut tracker = Tracker::new(TrackerOptions::default()).unwrap();
    for capture in captures(15.0, 6, (0.001, true), standing) {
        tracker.observe(&capture).unwrap();
    }
    assert_eq!(tracker.estimate().units.len(), 2);
    tracker
}

#[test]
fn what_rests_stays_where_a_capture_does_not_show_it() {
    let mut tracker = settled();
    let down = Vector3::new(0.0, 0.0, G);
    for unit in &mut tracker.units {
        let before = unit.pose();
        unit.predict(1.0 / 15.0, 1.0 / 3.0, &down, FREE_MOTION_NOISE, None);
        // Its outline seems to have moved, and then nothing is found of it.
        unit.anchor.end(0.4);
        let other = unit.others.remove(0);
        unit.motion = other.motion;
        assert!((unit.pose().translation.vector - before.translation.vector).norm() > 0.02);
        unit.stay_unseen(0.0);
        assert_eq!(unit.pose(), before);
        assert!(unit.anchor.holds && unit.motion.velocity().norm() == 0.0);
    }
}

#[test]
fn what_is_slower_than_a_fall_stays_unseen_where_captures_are_far_apart() {
    let down = Vector3::new(0.0, 0.0, G);
    for (dt_s, speed_m_s, stays) in [(0.2, 0.1, true), (0.2, 2.0, false), (0.03, 0.1, false)] {
        let mut tracker = settled();
        for unit in &mut tracker.units {
            let before = unit.pose();
            unit.anchor.end(1.0 / 3.0);
            unit.motion.linear = Vector3::new(0.0, speed_m_s, 0.0);
            unit.predict(dt_s, 1.0 / 3.0, &down, FREE_MOTION_NOISE, None);
            unit.stay_unseen(0.0);
            assert_eq!(unit.pose() == before, stays, "{dt_s} s at {speed_m_s} m/s");
            assert_eq!(unit.anchor.holds, stays);
        }
    }
}

#[test]
fn what_rests_stays_where_a_camera_is_off_its_pose() {
    let mut tracker = Tracker::new(TrackerOptions::default()).unwrap();
    let mut first: Option<Estimate> = None;
    let offs_m = [0.0, 0.0, 0.004, -0.002, 0.004, -0.003, 0.004, -0.002];
    for (capture, off_m) in captures(8.0, 8, (0.001, true), standing).into_iter().zip(offs_m) {
        let views = capture.views.into_iter().map(|view| match view {
            View::Depth(view) => {
                let pose = Translation3::new(0.0, 0.0, off_m) * view.camera.pose();
                View::Depth(DepthView { camera: view.camera.moved(pose).unwrap(), ..view })
            }
            View::Cloud(cloud) => View::Cloud(cloud),
        });
        let capture = Capture { views: views.collect(), ..capture };
        let estimate = tracker.observe(&capture).unwrap().clone();
        for unit in &estimate.units {
            assert_eq!(unit.rest, Rest::Supported, "{} s", estimate.time_s);
        }
        if estimate.units.len() == 2 && first.is_none() {
            first = Some(estimate);
        }
    }
    let (first, last) = (first.unwrap(), tracker.estimate());
    assert_eq!(last.units.len(), 2);
    for (a, b) in first.units.iter().zip(&last.units) {
        let way = (b.pose.translation.vector - a.pose.translation.vector).norm();
        assert!(a.id == b.id && way < 0.003, "{way}");
    }
}

/// What stands, with a glitch in one capture: the box is seen elsewhere. The capture after it does not show the box.
#[test]
fn one_capture_that_is_off_ends_no_rest() {
    let glitch = |t: f32| {
        let mut bodies = standing(t);
        let frame = (t * 30.0).round() as u32;
        match frame {
            8 | 13 => bodies[0].1.translation.x += 0.02,
            9 => bodies[0].1.translation.x += 5.0,
            _ => {}
        }
        bodies
    };
    for model in [None, Some(edge())] {
        let mut tracker = Tracker::new(TrackerOptions { model, ..blind() }).unwrap();
        let mut first: Option<Estimate> = None;
        for capture in captures(30.0, 20, (0.001, false), glitch) {
            let estimate = tracker.observe(&capture).unwrap().clone();
            for unit in &estimate.units {
                assert_eq!(unit.rest, Rest::Held, "{} s", estimate.time_s);
                let first = first
                    .as_ref()
                    .and_then(|first| first.units.iter().find(|one| one.id == unit.id));
                let way = first.map_or(0.0, |first| {
                    (unit.pose.translation.vector - first.pose.translation.vector).norm()
                });
                assert!(way < 0.002, "{way} at {} s", estimate.time_s);
            }
            if estimate.units.len() == 2 && first.is_none() {
                first = Some(estimate);
            }
        }
        assert_eq!(tracker.estimate().units.len(), 2);
    }
}

#[test]
fn what_begins_to_creep_is_followed() {
    // Two centimetres a second: less than the errors of a capture from one to the next.
    let speed = 0.02;
    let scene = |t: f32| {
        let x = speed * (t - 0.3).max(0.0);
        vec![(Body::Box([0.06, 0.05, 0.04]), Isometry3::translation(x, 0.1, 0.04))]
    };
    let mut tracker = Tracker::new(TrackerOptions::default()).unwrap();
    let mut first: Option<Vector3<f32>> = None;
    for capture in captures(30.0, 45, (0.001, true), scene) {
        let estimate = tracker.observe(&capture).unwrap().clone();
        let Some(unit) = estimate.units.first() else { continue };
        let place = unit.pose.translation.vector;
        let first = *first.get_or_insert(place);
        let truth = speed * (estimate.time_s as f32 - 0.3).max(0.0);
        let off = (place - first - Vector3::new(truth, 0.0, 0.0)).norm();
        assert!(off < 0.005, "{off} at {} s", estimate.time_s);
    }
}
