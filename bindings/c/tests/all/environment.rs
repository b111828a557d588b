//! The C functions give the same bits whatever rounding, flush of subnormal numbers and traps the caller has set.
#![cfg(all(target_arch = "x86_64", not(miri)))]
// Handles live here, and arrays are as long as they say.
#![allow(unsafe_code, clippy::undocumented_unsafe_blocks)]
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)]

use crate::common::*;
use crate::tracker;
use nalgebra::{Isometry3, Matrix3, Point3, Vector3};
use rigidformer_capi::edit::*;
use rigidformer_capi::ffi::*;
use rigidformer_capi::state::*;
use rigidformer_capi::tracker::ffi::*;
use rigidformer_capi::tracker::types::*;
use rigidformer_capi::types::rf_status::*;
use rigidformer_capi::types::*;
use rigidformer_perception::capture::{Capture, DepthView, View};
use rigidformer_perception::gravity::Gravity;
use rigidformer_perception::known::{KnownObject, ObjectMesh};
use rigidformer_perception::tracker::{Tracker, volume_m3};
use rigidformer_weights::{FeatureSet, ModelConfig, Motion};
use std::arch::asm;
use std::ptr::null_mut;

/// Runs `body` where MXCSR is `word`, and says whether it is `word` behind it, flags and all.
#[inline(never)]
fn under<R>(word: u32, body: impl FnOnce() -> R) -> (R, bool) {
    let set = |word: u32| unsafe { asm!("ldmxcsr [{}]", in(reg) &raw const word) };
    set(word);
    let result = body();
    let mut behind = 0;
    unsafe { asm!("stmxcsr [{}]", in(reg) &raw mut behind) };
    set(0x1f80);
    (result, behind == word)
}

/// Four roundings, flush of results, operands that count as zeros, traps; one raised flag, which must stay.
fn environments() -> impl Iterator<Item = u32> {
    (0..32_u32).map(|number| {
        let rounding = (number & 3) << 13;
        let (flush, zeros) = ((number >> 2 & 1) << 15, (number >> 3 & 1) << 6);
        let masks = if number >> 4 == 0 { 0x1f80 } else { 0 };
        rounding | flush | zeros | masks | (number & 1) << 5
    })
}

/// All poses of a rollout, each call of which is made in the caller's environment.
fn rollout(model: &[u8], threads: u32, scene: &Scene, gravity: &[f32; 3]) -> Vec<[u32; 12]> {
    let config = rf_config { threads, ..config(model, 3, 15) };
    let mut workspace = Workspace::of(&config);
    let handle = workspace.init(&config);
    assert_eq!(unsafe { rf_set_gravity(handle, gravity.as_ptr()) }, RF_OK);
    assert_eq!(scene.observe(handle), RF_OK);
    let mut all = Vec::new();
    for _ in 0..2 {
        assert_eq!(step(handle), RF_OK);
        all.extend(poses(handle));
        let mut handed = [rf_pose { position: [0.0; 3], quaternion: [0.0; 4] }; 3];
        assert_eq!(unsafe { rf_poses(handle, handed.as_mut_ptr(), 3) }, RF_OK);
        all.extend(handed.map(|pose| {
            let mut row = [0; 12];
            let numbers = pose.position.iter().chain(&pose.quaternion);
            row.iter_mut().zip(numbers).for_each(|(to, number)| *to = number.to_bits());
            row
        }));
    }
    all
}

#[test]
fn a_rollout_has_the_same_bits_in_every_environment() {
    let scene = Scene::new(3);
    for model in [rigidformer_weights::EDGE, smallest()] {
        let rolled = |threads| rollout(model, threads, &scene, &[0.1, 0.0, -9.81]);
        let run = || rolled(1);
        let expected = run();
        let threads: &[u32] = if cfg!(feature = "threads") { &[1, 2] } else { &[1] };
        for (word, &threads) in
            environments().flat_map(|word| threads.iter().map(move |n| (word, n)))
        {
            let found = under(word, || rolled(threads));
            assert_eq!(found, (expected.clone(), true), "{word:#x}, {threads} threads");
        }
        // A thread begins with what the one has that makes it. All roundings are among these.
        for word in environments().step_by(5) {
            let (of_thread, _) =
                under(word, || std::thread::scope(|scope| scope.spawn(run).join().unwrap()));
            assert_eq!(of_thread, expected, "{word:#x}");
        }
    }
}

#[test]
fn innovations_have_the_same_bits_in_every_environment() {
    let pose = |x, y| rf_pose { position: [x, y, 0.3], quaternion: [0.1, 0.2, 0.3, 0.9273618] };
    let run = || {
        let mut distance = 0.0;
        let (predicted, observed) = (pose(0.1, 0.7), pose(0.3, 0.7));
        let variances = [0.3, 0.7, 0.11, 0.13, 0.17, 0.19];
        let status = unsafe {
            rigidformer_capi::health::rf_innovation(
                &predicted,
                &observed,
                variances.as_ptr(),
                &mut distance,
            )
        };
        (status, distance.to_bits())
    };
    let expected = run();
    assert_eq!(expected.0, RF_OK);
    for word in environments() {
        assert_eq!(under(word, run), (expected, true), "{word:#x}");
    }
}

/// What all calls that change a scene come to, those that are refused among them: statuses, and the poses and state behind each.
fn edits(model: &[u8], scene: &Scene) -> Vec<u64> {
    const SIGNALS: f32 = f32::from_bits(0x7f80_0001);
    let limits = config(model, 4, 20);
    let mut workspace = Workspace::of(&limits);
    let handle = workspace.init(&limits);
    let units = rf_units { bodies: [0, 0, RF_OWN_BODY].as_ptr(), ..scene.units() };
    let frames = [&scene.previous, &scene.current].map(|frame| frame.as_ptr().cast());
    let none = null_mut();
    let mut found = Vec::new();
    let mut did = |status: rf_status| {
        let numbers = poses(handle).into_iter().flatten().map(u64::from);
        found.extend(numbers.chain([status as u64]));
    };
    unsafe {
        did(rf_observe(handle, DT_S, &units, frames[0], frames[1], none));
        let [one, other, last] = ids(handle)[..] else { panic!("three units") };
        let odd = rf_pose { position: [SIGNALS, 0.0, 0.0], ..at(0.0, 0.0, 1.0) };
        let tiny = rf_pose { quaternion: [1e-41, 0.0, 0.0, 1.0], ..at(0.7, 1e-40, 1.3) };
        let zero = rf_pose { quaternion: [1e-41; 4], ..tiny };
        let corners = &scene.previous[..5];
        let more = rf_unit {
            physics: scene.physics[0],
            role: RF_ROLE_DRIVEN,
            body: RF_OWN_BODY,
            points: corners.as_ptr().cast(),
            point_count: 5,
            inertia_kg_m2: [2e-3, 3e-3, 4e-3],
            piece_points: std::ptr::null(),
            piece_counts: std::ptr::null(),
            piece_count: 0,
        };
        let mut added = 0;
        for pose in [odd, zero, tiny] {
            did(rf_add(handle, &more, &pose, &pose, &mut added));
        }
        for pose in [odd, zero, at(0.71, 0.1, 1.3)] {
            did(rf_drive(handle, added, &pose));
            did(rf_set_poses(handle, other, &at(0.12, 0.1, 0.31), &pose));
        }
        for number in [SIGNALS, -1e-41, 1e-41, 0.7] {
            let physics = rf_physics { mass_kg: number, friction: 0.3, restitution: 0.1 };
            did(rf_set_physics(handle, one, &physics));
            let plane = [number, 0.0, 0.0];
            let plane = rf_plane { normal: plane, offset_m: 0.1, friction: 0.5, restitution: 0.2 };
            did(rf_set_planes(handle, &plane, 1));
            did(rf_set_gravity(handle, [0.1, number, -9.81].as_ptr()));
            did(rf_set_dt(handle, number));
            let velocity =
                rf_velocity { linear_m_s: [0.1, number, 0.0], angular_rad_s: [number; 3] };
            did(rf_set_velocity(handle, last, &velocity));
            did(rf_set_velocities(handle, [velocity; 4].as_ptr(), 4));
            let pivot = [number, 0.03, 1e-40];
            did(rf_join(handle, last, added, pivot.as_ptr(), [0.01, 0.0, 0.3].as_ptr()));
        }
        did(rf_set_dt(handle, DT_S));
        did(rf_bond(handle, [one, other].as_ptr(), 1));
        let mut bytes = 0;
        assert_eq!(rf_state_bytes(handle, &mut bytes), RF_OK);
        let mut state = vec![0; bytes];
        did(rf_save(handle, state.as_mut_ptr(), bytes, null_mut()));
        for _ in 0..2 {
            did(rf_step(handle, null_mut()));
            did(rf_load(handle, state.as_ptr(), bytes));
            did(rf_break_bond(handle, one, other, null_mut()));
            did(rf_step(handle, null_mut()));
        }
        did(rf_unjoin(handle, last));
        did(rf_set_role(handle, added, RF_ROLE_FREE));
        did(rf_step(handle, null_mut()));
        let still = rf_velocity { linear_m_s: [0.0; 3], angular_rad_s: [0.0; 3] };
        let mut velocities = [still; 4];
        did(rf_velocities(handle, velocities.as_mut_ptr(), 4));
        let mut centres = [rf_centre::default(); 4];
        did(rf_centres(handle, centres.as_mut_ptr(), 4));
        let numbers = velocities.iter().flat_map(|v| v.linear_m_s.iter().chain(&v.angular_rad_s));
        found.extend(numbers.map(|number| u64::from(number.to_bits())));
        found.extend(centres.iter().flat_map(|at| [at.x, at.y, at.z]).map(f64::to_bits));
        found.extend(state.into_iter().map(u64::from));
    }
    found
}

#[test]
fn edits_have_the_same_bits_in_every_environment() {
    let impulses =
        ModelConfig { features: FeatureSet::Impact, motion: Motion::Impulses, ..SMALLEST };
    let (scene, file) = (Scene::new(3), model(impulses));
    let run = || edits(&file, &scene);
    let expected = run();
    for word in environments() {
        assert_eq!(under(word, run), (expected.clone(), true), "{word:#x}");
    }
}

/// The tracker of Rust and that of C: bits of all that they estimate and predict.
#[test]
fn trackers_have_the_same_bits_in_every_environment() {
    let camera = tracker::camera();
    let images = [0, 1, 2].map(tracker::image);
    // What the test computes itself is computed here.
    let views = images.each_ref().map(|image| tracker::view(&camera, image));
    let times_s = [0.0, 1.0 / 30.0, 2.0 / 30.0];
    let sides = [[0, 1, 3], [0, 3, 2], [4, 6, 7], [4, 7, 5], [0, 4, 5], [0, 5, 1]];
    let sides = [sides, [[2, 3, 7], [2, 7, 6], [0, 2, 6], [0, 6, 4], [1, 5, 7], [1, 7, 3]]];
    let corners = (0..8).map(|k| [k >> 2 & 1, k >> 1 & 1, k & 1].map(|side| 0.11 * side as f32));
    let corners: Vec<_> = corners.map(Point3::from).collect();
    let mesh = ObjectMesh {
        name: "cube",
        points: &corners,
        triangles: sides.as_flattened(),
        pieces: &[],
        mass_kg: 0.7,
        centre_m: Point3::new(0.055, 0.055, 0.055),
        inertia_kg_m2: Matrix3::identity() * 1e-3,
    };
    let mut options = tracker::rust_options(true);
    options.gravity_m_s2 = Vector3::new(0.1, 0.0, -9.8);
    let of = |pose: &Isometry3<f32>| {
        let numbers = pose.translation.vector.iter().chain(pose.rotation.coords.iter());
        numbers.map(|number| number.to_bits()).collect::<Vec<_>>()
    };
    let rust = || {
        let camera = camera.moved(*camera.pose()).unwrap();
        let mut options = options.clone();
        options.objects = vec![KnownObject::new(&mesh).unwrap()];
        let mut tracker = Tracker::new(options).unwrap();
        let mut bits = Vec::new();
        for (time_s, image) in times_s.into_iter().zip(&images) {
            let depth = DepthView::new(camera, 0.001, image.clone(), None).unwrap();
            let capture = Capture { time_s, views: vec![View::Depth(depth)] };
            tracker.observe(&capture).unwrap();
            bits.extend(Gravity::seen(&capture).m_s2.iter().map(|number| number.to_bits()));
        }
        bits.push(volume_m3(&corners).to_bits());
        for unit in &tracker.estimate().units {
            bits.extend(of(&unit.pose));
            bits.extend(unit.velocity.iter().map(|number| number.to_bits()));
            let physics = tracker.physics(unit.id);
            bits.extend(physics.map(|physics| physics.mass_kg.to_bits()));
            bits.extend(unit.points.iter().flat_map(Point3::iter).map(|number| number.to_bits()));
        }
        let forecast = tracker.predict(0.3).unwrap();
        bits.extend(forecast.poses.iter().flatten().flat_map(|(_, pose)| of(pose)));
        bits
    };
    let c = || {
        let made = tracker::made(&tracker::with_model());
        for (time_s, view) in times_s.into_iter().zip(views) {
            assert_eq!(tracker::observe(made.0, time_s, &[view], &[]), RF_OK);
        }
        let mut bits = Vec::new();
        for track in tracker::units(made.0) {
            let numbers = track.pose.position.iter().chain(&track.pose.quaternion);
            let numbers = numbers.chain(&track.velocity).chain(&track.centre);
            bits.extend(numbers.map(|number| number.to_bits()));
            bits.extend(track.pose_covariance.map(f32::to_bits));
        }
        let mut forecast = rf_forecast::default();
        assert_eq!(unsafe { rf_tracker_predict(made.0, 0.3, &mut forecast) }, RF_OK);
        bits.extend([forecast.steps, forecast.units, forecast.step_s.to_bits() as u32]);
        bits
    };
    let expected = [rust(), c()];
    assert!(expected.iter().all(|bits| bits.len() > 100));
    for word in environments().step_by(3) {
        let (found, is_restored) = under(word, || [rust(), c()]);
        assert!(is_restored, "{word:#x}");
        assert!(found == expected, "{word:#x}");
    }
}
