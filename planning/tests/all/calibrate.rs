//! Numbers that a recording was made with are found again.

use std::cell::Cell;
use std::sync::atomic::{AtomicBool, Ordering};

use nalgebra::{Isometry3, Point3, UnitQuaternion, Vector3};
use rigidformer_core::{Physics, Plane};
use rigidformer_evaluation::contact::Contact;
use rigidformer_evaluation::models::random;
use rigidformer_evaluation::rollout::open_loop_on;
use rigidformer_evaluation::scenes::{RecordedScene, RecordedUnit, Split, Velocity};
use rigidformer_planning::calibrate::{
    CalibrateError, Calibration, Memo, MemoError, Settings, Weights, figures, number, start_noise,
};
use rigidformer_runtime::engine::Engine;
use rigidformer_runtime::models::LoadedModel;
use rigidformer_runtime::noise::Noise;
use rigidformer_runtime::progress::Progress;

const RATE_HZ: f32 = 120.0;
const FRAMES: usize = 60;
const TRUE: [(&str, f32); 3] =
    [("friction", 0.2), ("restitution", 0.35), ("table_height_m", 0.001)];
/// Of contact that gives way.
const SOFT: [(&str, f32); 3] =
    [("friction", 0.2), ("stiffness_n_m", 5_000.0), ("dissipation_s_m", 1.5)];

/// Impulses alone.
fn impulses() -> LoadedModel {
    let edge = LoadedModel::embedded("edge", rigidformer_weights::EDGE).unwrap();
    let packed = random::without_network(edge.model().config()).unwrap().unwrap();
    LoadedModel::copy_of("impulses.rfm", &packed).unwrap()
}

fn of(numbers: &[(&str, f32)]) -> Contact {
    let with = |contact: Contact, (name, value): &(&str, f32)| {
        contact.with(number(name).unwrap(), Some(*value))
    };
    numbers.iter().fold(Contact::default(), with)
}

/// Cubes that are thrown, as they move with the true numbers and are seen with noise; the file has other numbers.
fn tosses(model: &LoadedModel, count: u64, noise_m: f32) -> Vec<RecordedScene> {
    tosses_of(&TRUE, model, count, noise_m)
}

/// As [`tosses`], of other true numbers.
fn tosses_of(
    truth: &[(&str, f32)],
    model: &LoadedModel,
    count: u64,
    noise_m: f32,
) -> Vec<RecordedScene> {
    let toss = |seed: u64| {
        let mut noise = Noise::new(5, seed);
        let mut normal = |deviation: f32| Vector3::from_fn(|_, _| deviation * noise.normal());
        let corner =
            |i: i32| Point3::from([1, 2, 4].map(|bit| if i & bit == 0 { -0.05 } else { 0.05 }));
        let guess = Physics { mass_kg: 0.4, friction: 0.5, restitution: 0.15 };
        let start = Isometry3::from_parts(
            (Vector3::new(0.0, 0.0, 0.15) + normal(0.02)).into(),
            UnitQuaternion::from_scaled_axis(normal(1.0)),
        );
        let velocity = Velocity {
            linear_m_s: Vector3::new(1.2, 0.0, -0.5) + normal(0.4),
            angular_rad_s: normal(3.0),
        };
        let points = (0..8).map(corner).collect();
        let cube =
            RecordedUnit::new("cube", points, guess, vec![start; FRAMES]).with_velocity(velocity);
        let gravity = Vector3::new(0.0, 0.0, -9.81);
        let scene = |unit: RecordedUnit| {
            let name = format!("toss {seed}");
            let scene =
                RecordedScene::new(name, seed as i64, Split::Train, RATE_HZ, gravity, vec![unit]);
            scene.unwrap().with_planes(vec![Plane::ground(1.0, 1.0)]).unwrap()
        };
        let truth = of(truth).applied(&scene(cube.clone())).unwrap();
        let engine = Engine::new().unwrap().single();
        let moved = open_loop_on(engine, model, &truth, 2, Progress::none()).unwrap();
        let native = f64::from(model.model().config().frame_rate_hz / RATE_HZ);
        let mut noise = Noise::new(6, seed);
        let poses = (0..FRAMES).map(|frame| {
            let mut pose = moved.pose_at(frame as f64 * native, 0).unwrap();
            pose.translation.vector += Vector3::from_fn(|_, _| noise_m * noise.normal());
            pose
        });
        scene(RecordedUnit { poses: poses.collect(), ..cube })
    };
    (0..count).map(toss).collect()
}

fn settings(evaluations: usize, resamples: usize) -> Settings {
    let fit = TRUE.iter().map(|(name, _)| number(name).unwrap()).collect();
    Settings { fit, starts: 2, evaluations, resamples, ..Settings::default() }
}

#[test]
fn what_a_recording_was_made_with_is_found() {
    let model = impulses();
    let mut scenes = tosses(&model, 24, 2e-4);
    let validation = scenes.split_off(18);
    let none = AtomicBool::new(false);
    let cost = |contact: &Contact| {
        let found = figures(&model, &validation, contact, 2, Weights::default(), &none);
        found.unwrap().unwrap().cost
    };
    let calibration = Calibration::new(&model, &scenes, &validation, settings(200, 200)).unwrap();
    let found = calibration.calibrate(&mut Memo::default(), &mut |_| (), Progress::none()).unwrap();
    assert_eq!(
        found.given,
        of(&[("friction", 0.5), ("restitution", 0.15), ("table_height_m", 0.0)])
    );
    let (given, fitted, truth) =
        (cost(&Contact::default()), cost(&found.contact), cost(&of(&TRUE)));
    assert!(fitted < 0.3 * given, "{given} {fitted} {truth}: {found:?}");
    for ((name, truth), bounds) in TRUE.iter().zip(&found.bounds) {
        let (value, bounds) = (found.contact.get(name).unwrap(), bounds.unwrap());
        assert!(bounds.low <= *truth && *truth <= bounds.high, "{name}: {value} {bounds:?}");
        assert!(bounds.low <= value && value <= bounds.high, "{name}: {value} {bounds:?}");
    }
    let worth: Vec<f64> = found.starts.iter().map(|start| start.validation.unwrap()).collect();
    assert!(worth.iter().all(|of| *of >= worth[found.chosen]), "{worth:?}");
}

#[test]
fn how_contact_gives_way_is_found_from_what_is_rigid() {
    let model = impulses();
    let scenes = tosses_of(&SOFT, &model, 16, 1e-4);
    let fit = SOFT.iter().map(|(name, _)| number(name).unwrap()).collect();
    let settings = Settings { fit, ..settings(150, 0) };
    let calibration = Calibration::new(&model, &scenes, &[], settings).unwrap();
    let found = calibration.calibrate(&mut Memo::default(), &mut |_| (), Progress::none()).unwrap();
    assert_eq!(found.given.get("stiffness_n_m"), Some(1e9));
    let of = |name| found.contact.get(name).unwrap();
    assert!((of("friction") / 0.2 - 1.0).abs() < 0.05, "{found:?}");
    assert!((of("stiffness_n_m") / 5_000.0 - 1.0).abs() < 0.25, "{found:?}");
    assert!((of("dissipation_s_m") - 1.5).abs() < 0.5, "{found:?}");
}

#[test]
fn restitution_and_stiffness_are_not_fitted_together() {
    let model = impulses();
    let scenes = tosses(&model, 2, 0.0);
    let fit: Vec<usize> =
        ["restitution", "stiffness_n_m"].iter().map(|name| number(name).unwrap()).collect();
    assert!(!fit.iter().all(|at| Settings::default().fit.contains(at)));
    let made = Calibration::new(&model, &scenes, &[], Settings { fit, ..Settings::default() });
    let error = made.err().unwrap().to_string();
    assert!(error.contains("restitution") && error.contains("counts for nothing"), "{error}");
    let soft: Vec<_> =
        scenes.iter().map(|scene| of(&[("stiffness_n_m", 1e4)]).applied(scene).unwrap()).collect();
    let fit = vec![number("restitution").unwrap()];
    let made = Calibration::new(&model, &soft, &[], Settings { fit, ..Settings::default() });
    let error = made.err().unwrap().to_string();
    assert!(error.contains("toss 0") && error.contains("fit stiffness"), "{error}");
}

#[test]
fn threads_change_no_bit() {
    let model = impulses();
    let on = |threads: usize| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| {
            let scenes = tosses(&model, 7, 0.0);
            let calibration = Calibration::new(&model, &scenes, &[], settings(12, 20)).unwrap();
            let mut memo = Memo::default();
            let found = calibration.calibrate(&mut memo, &mut |_| (), Progress::none()).unwrap();
            (found, memo)
        })
    };
    let one = on(1);
    assert_eq!(one, on(3));
    assert_ne!(one.0.contact, one.0.given);
}

#[test]
fn what_was_stopped_ends_as_if_it_had_not_been() {
    let model = impulses();
    let scenes = tosses(&model, 6, 0.0);
    let calibration = Calibration::new(&model, &scenes, &[], settings(10, 20)).unwrap();
    let steps = Cell::new(0);
    let mut whole = Memo::default();
    let mut kept = |_: &Memo| steps.set(steps.get() + 1);
    let expected = calibration.calibrate(&mut whole, &mut kept, Progress::none()).unwrap();
    assert_eq!(steps.get(), whole.len());
    // In the first search, in the second, and among the places of the quadratic.
    for stop in [4, 13, 27] {
        let stopped = AtomicBool::new(false);
        let mut memo = Memo::default();
        let mut kept = |memo: &Memo| stopped.store(memo.len() >= stop, Ordering::Relaxed);
        let progress = Progress { cancelled: &stopped, ..Progress::none() };
        let cut = calibration.calibrate(&mut memo, &mut kept, progress);
        assert!(matches!(cut, Err(CalibrateError::Cancelled)), "{cut:?}");
        assert_eq!(memo.len(), stop);
        let mut memo = Memo::parse(&memo.text(3), 3).unwrap();
        assert_eq!(Memo::parse(&memo.text(3), 4), Err(MemoError::Other));
        let found = calibration.calibrate(&mut memo, &mut |_| (), Progress::none()).unwrap();
        assert_eq!((&found, &memo), (&expected, &whole));
        let mut again = |_: &Memo| panic!("all is known");
        assert_eq!(
            calibration.calibrate(&mut memo, &mut again, Progress::none()).unwrap(),
            expected
        );
    }
}

#[test]
fn what_cannot_be_fitted_is_named() {
    let model = impulses();
    let refused = |scenes: Vec<RecordedScene>, settings: Settings| {
        let calibration = Calibration::new(&model, &scenes, &[], settings);
        calibration.map(|_| ()).unwrap_err().to_string()
    };
    let scenes = tosses(&model, 1, 0.0);
    let [toss] = scenes.as_slice() else { panic!("one scene") };
    assert!(refused(Vec::new(), Settings::default()).contains("no scenes"));
    let long = Settings { step: 101, ..Settings::default() };
    assert!(refused(vec![toss.clone()], long).contains("step: is 101, not from 1 to 100"));
    let twice = Settings { fit: vec![0, 0], ..Settings::default() };
    assert!(refused(vec![toss.clone()], twice).contains("fit"));
    let short = refused(vec![toss.clone().truncated(1)], Settings::default());
    assert!(short.contains("toss 0") && short.contains("too few frames"), "{short}");
    // Without a plane there is no table to lift.
    let loose = toss.clone().with_planes(Vec::new()).unwrap();
    let failed = refused(vec![loose.clone()], Settings::default());
    assert!(failed.contains("toss 0") && failed.contains("table_height_m"), "{failed}");
    // Nor may one of a test lack it, which is measured at the end.
    let calibration = Calibration::new(&model, &scenes, &[], Settings::default()).unwrap();
    let untaken = calibration.takes(std::slice::from_ref(&loose)).unwrap_err().to_string();
    assert_eq!(untaken, failed);
    calibration.takes(&scenes).unwrap();
}

#[test]
fn without_intervals_the_numbers_are_the_same() {
    let model = impulses();
    let scenes = tosses(&model, 6, 2e-4);
    let [none, some] = [0, 20].map(|resamples| {
        let calibration = Calibration::new(&model, &scenes, &[], settings(12, resamples)).unwrap();
        calibration.calibrate(&mut Memo::default(), &mut |_| (), Progress::none()).unwrap()
    });
    assert_eq!((none.contact, none.starts), (some.contact, some.starts));
    assert!(none.bounds.iter().all(Option::is_none) && some.bounds.iter().all(Option::is_some));
}

/// The moments that a factor is of are the solver's own, also of a body that is round in few directions.
#[test]
fn a_factor_near_1_changes_nearly_nothing() {
    let model = impulses();
    let numbers = || [-1.0_f32, 0.0, 1.0].into_iter();
    let all =
        numbers().flat_map(|x| numbers().flat_map(move |y| numbers().map(move |z| [x, y, z])));
    let away = all.map(Vector3::from).filter(|along| along.norm() > 0.5);
    let points: Vec<_> = away.map(|along| Point3::from(along.normalize() * 0.1)).collect();
    for scene in tosses(&model, 3, 0.0) {
        let round = RecordedUnit { points: points.clone(), ..scene.units()[0].clone() };
        let gravity = scene.gravity_m_s2();
        let round = RecordedScene::new("round", 1, Split::Train, RATE_HZ, gravity, vec![round])
            .unwrap()
            .with_planes(scene.planes().unwrap().to_vec())
            .unwrap();
        let cost = |contact: &Contact| {
            let none = AtomicBool::new(false);
            let scenes = std::slice::from_ref(&round);
            figures(&model, scenes, contact, 2, Weights::default(), &none).unwrap().unwrap().cost
        };
        let [own, near, less] =
            [1.0, 1.0 + 1e-6, 0.6].map(|factor| cost(&of(&[("inertia_factor", factor)])));
        assert_eq!(own, cost(&Contact::default()));
        assert!((near - own).abs() < 1e-3 * own, "{own} {near}");
        assert!((less - own).abs() > 1e-2 * own, "{own} {less}");
    }
}

/// Without velocities the first two frames say where things go.
#[test]
fn poses_alone_are_enough() {
    let model = impulses();
    let mut scenes = tosses(&model, 6, 0.0);
    for scene in &mut scenes {
        let mut unit = scene.units()[0].clone();
        unit.velocity = None;
        let gravity = scene.gravity_m_s2();
        let new = RecordedScene::new(
            scene.name(),
            scene.seed(),
            Split::Train,
            RATE_HZ,
            gravity,
            vec![unit],
        );
        *scene = new.unwrap().with_planes(scene.planes().unwrap().to_vec()).unwrap();
    }
    let settings = Settings { step: 1, starts: 1, ..settings(60, 0) };
    let calibration = Calibration::new(&model, &scenes, &[], settings).unwrap();
    let found = calibration.calibrate(&mut Memo::default(), &mut |_| (), Progress::none()).unwrap();
    let off = found.contact.get("friction").unwrap() - 0.2;
    assert!(off.abs() < 0.04, "{off}");
    assert_eq!(found.bounds, [None, None, None]);
}

#[test]
fn flight_tells_how_far_off_velocities_are() {
    let model = impulses();
    let high = |mut unit: RecordedUnit, off: Vector3<f32>| {
        let lifted = |pose: &Isometry3<f32>| Isometry3::translation(0.0, 0.0, 2.0) * pose;
        unit.poses = unit.poses.iter().take(9).map(lifted).collect();
        let velocity = unit.velocity.as_mut().unwrap();
        velocity.linear_m_s += 0.1 * off;
        velocity.angular_rad_s += off;
        unit
    };
    // They touch nothing where they are thrown from high up.
    let mut noise = Noise::new(8, 8);
    let flights = tosses(&model, 60, 0.0).into_iter().map(|scene| {
        let mut unit = scene.units()[0].clone();
        let (pose, velocity) = (unit.poses[0], unit.velocity.unwrap());
        unit.poses = (0..9)
            .map(|frame| {
                let t = frame as f32 / RATE_HZ;
                let way = velocity.linear_m_s * t + scene.gravity_m_s2() * (0.5 * t * t);
                let turn = UnitQuaternion::from_scaled_axis(velocity.angular_rad_s * t);
                Isometry3::from_parts((pose.translation.vector + way).into(), turn * pose.rotation)
            })
            .collect();
        let unit = high(unit, Vector3::from_fn(|_, _| noise.normal()));
        let gravity = scene.gravity_m_s2();
        let new = RecordedScene::new(scene.name(), 1, Split::Train, RATE_HZ, gravity, vec![unit])
            .unwrap();
        new.with_planes(scene.planes().unwrap().to_vec()).unwrap()
    });
    let found = start_noise(&flights.collect::<Vec<_>>()).unwrap();
    assert_eq!(found.units, 60);
    assert!((0.08..0.12).contains(&found.linear_m_s), "{found:?}");
    assert!((0.8..1.2).contains(&found.angular_rad_s), "{found:?}");
    assert_eq!(start_noise(&[]), None);
}
