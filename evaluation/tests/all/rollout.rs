//! Rollouts: the same on one thread and on many, stoppable, and refused where model and scene do not fit.

use std::path::Path;
use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};

use nalgebra::{Isometry3, Point3, Translation3, UnitQuaternion, Vector3};
use rigidformer_core::{Physics, Plane};
use rigidformer_evaluation::models::pack_bytes;
use rigidformer_evaluation::predicted::{predict, predict_many};
use rigidformer_evaluation::rollout::{RolloutError, Trajectory, rollout, rollout_many};
use rigidformer_evaluation::scenes::{RecordedBond, RecordedScene, RecordedUnit, Split};
use rigidformer_evaluation::{figures, metrics};
use rigidformer_runtime::engine::Engine;
use rigidformer_runtime::models::LoadedModel;
use rigidformer_runtime::progress::Progress;

/// An untrained model of the lab, packed here.
fn model(name: &str) -> LoadedModel {
    let path = Path::new(env!("CARGO_MANIFEST_DIR"))
        .join(format!("../tests/data/{name}.model.safetensors"));
    let packed = pack_bytes(&path, &std::fs::read(&path).unwrap()).unwrap();
    LoadedModel::copy_of("packed", &packed).unwrap()
}

fn scene(seed: i64, units: usize, frame_rate_hz: f32, gravity: f32) -> RecordedScene {
    let cube: Vec<Point3<f32>> = (0..8)
        .map(|i| {
            Point3::new((i & 1) as f32 - 0.5, (i >> 1 & 1) as f32 - 0.5, (i >> 2) as f32 - 0.5)
        })
        .collect();
    let unit = |k: usize| {
        let pose = |frame: usize| {
            let t = frame as f32 / frame_rate_hz;
            let turn =
                UnitQuaternion::from_scaled_axis(Vector3::new(0.3, seed as f32, k as f32) * t);
            let place = Translation3::new(1.1 * k as f32, seed as f32 * t, 3.0 - 5.0 * t * t);
            Isometry3::from_parts(place, turn)
        };
        let physics = Physics { mass_kg: 1.0, friction: 0.4, restitution: 0.3 };
        RecordedUnit::new("cube", cube.clone(), physics, (0..=100).map(pose).collect())
    };
    let gravity = Vector3::new(0.0, 0.0, gravity);
    let units = (0..units).map(unit).collect();
    RecordedScene::new(format!("seed {seed}"), seed, Split::Test, frame_rate_hz, gravity, units)
        .unwrap()
}

#[test]
fn many_equal_one_by_one_bit_for_bit() {
    let model = model("tiny-paper-inputs");
    let scenes: Vec<_> =
        (1..8).map(|seed| scene(seed, 1 + seed as usize % 3, 240.0, -10.0)).collect();
    let many = rollout_many(&model, &scenes, 10, 95, Progress::none()).unwrap();
    for (scene, together) in scenes.iter().zip(&many) {
        let alone = rollout(&model, scene, 10, 95, Progress::none()).unwrap();
        assert_eq!(&alone, together);
        assert_eq!(
            (alone.last_frame(), alone.samples(), alone.units()),
            (100, 11, scene.units().len())
        );
        assert_eq!(
            alone.pose(10, 0),
            scene.pose(10, 0).copied(),
            "observed frames are the record's"
        );
    }
    let figures = figures::model(&model, &scenes, 10, Progress::none()).unwrap();
    assert_eq!(figures, figures::model(&model, &scenes, 10, Progress::none()).unwrap());
    assert_eq!(figures.scenes, 7);
    assert!(figures.rigidity < 1e-5, "{}", figures.rigidity);
    // Means are those of the scenes' own figures, to the bit, and those are the same alone.
    assert_eq!(figures.by_scene.len(), 7);
    for frame in 0..3 {
        let errors: Vec<_> = figures.by_scene.iter().map(|scene| scene.errors[frame]).collect();
        assert_eq!(figures.errors[frame], metrics::mean(&errors));
    }
    for (scene, within) in scenes.iter().zip(&figures.by_scene) {
        let alone =
            figures::model(&model, std::slice::from_ref(scene), 10, Progress::none()).unwrap();
        assert_eq!(alone.by_scene, std::slice::from_ref(within));
    }
}

#[test]
fn larger_scenes_take_larger_simulators() {
    let model = model("tiny-paper-inputs");
    for units in [16, 65, 257, 600] {
        let predicted =
            rollout(&model, &scene(1, units, 240.0, -10.0), 10, 20, Progress::none()).unwrap();
        assert_eq!(predicted.units(), units);
    }
}

#[test]
fn cancelling_stops_within_a_step() {
    let model = model("tiny-paper-inputs");
    let (cancelled, steps) = (AtomicBool::new(false), AtomicUsize::new(0));
    let stepped = || {
        if steps.fetch_add(1, Ordering::Relaxed) == 3 {
            cancelled.store(true, Ordering::Relaxed);
        }
    };
    let progress = Progress { cancelled: &cancelled, stepped: &stepped };
    let stopped = rollout(&model, &scene(1, 2, 240.0, -10.0), 1, 100, progress);
    assert_eq!(stopped, Err(RolloutError::Cancelled));
    assert_eq!(steps.load(Ordering::Relaxed), 4);
}

#[test]
fn scenes_that_do_not_fit_are_refused() {
    let model = model("tiny-paper-inputs");
    let roll = |scene: &RecordedScene, step| {
        rollout(&model, scene, step, 100, Progress::none()).unwrap_err()
    };
    let error = roll(&scene(1, 2, 240.0, -10.0), 101);
    assert!(
        matches!(error, RolloutError::TooFewFrames { step: 101, recorded: 101, .. }),
        "{error}"
    );
    let error = roll(&scene(1, 2, 240.0, -10.0), 0);
    assert!(matches!(error, RolloutError::Observe { .. }), "{error}");

    let commanded = self::model("tiny");
    let error = rollout(&commanded, &scene(1, 2, 240.0, -10.0), 1, 100, Progress::none());
    let scene = String::from("seed 1");
    assert_eq!(error, Err(RolloutError::NeedsCommand { scene, size: 3, found: 0 }));
}

#[test]
fn the_scenes_own_frame_rate_counts() {
    // The same motion at the same times, recorded half as often.
    let (often, seldom) = (scene(2, 3, 240.0, -10.0), scene(2, 3, 120.0, -10.0));
    for model in [model("tiny-paper-inputs"), edge()] {
        let expected = rollout(&model, &often, 10, 100, Progress::none()).unwrap();
        let found = rollout(&model, &seldom, 5, 50, Progress::none()).unwrap();
        assert_eq!((found.step(), found.last_frame(), found.samples()), (5, 50, 11));
        for ((_, found), (_, expected)) in found.iter().zip(expected.iter()) {
            assert_eq!(found, expected);
        }
    }
    // Any rate will do, not only one that the model's is a multiple of.
    let odd = rollout(&edge(), &scene(2, 1, 59.94, -10.0), 3, 9, Progress::none()).unwrap();
    let expected = scene(2, 1, 59.94, -10.0).pose(9, 0).unwrap().translation.z;
    assert!((odd.pose(9, 0).unwrap().translation.z - expected).abs() < 1e-4, "{odd:?}");
}

fn edge() -> LoadedModel {
    LoadedModel::embedded("edge", rigidformer_weights::EDGE).unwrap()
}

/// A cube that flies freely from 3 m under some gravity, 240 frames a second.
fn flight(gravity: Vector3<f32>) -> RecordedScene {
    let made = scene(1, 1, 240.0, -10.0);
    let mut unit = made.units()[0].clone();
    for (frame, pose) in unit.poses.iter_mut().enumerate() {
        let t = frame as f32 / 240.0;
        let place = Vector3::new(0.5 * t, 0.0, 3.0) + gravity * (0.5 * t * t);
        *pose = Isometry3::from_parts(place.into(), UnitQuaternion::identity());
    }
    RecordedScene::new("flight", 1, Split::Test, 240.0, gravity, vec![unit]).unwrap()
}

fn height(path: &Trajectory, frame: u32) -> f32 {
    path.pose(frame, 0).unwrap().translation.z
}

#[test]
fn the_scenes_own_gravity_counts() {
    for gravity in [[0.0, 0.0, -3.7], [0.0, 0.0, 0.0], [0.0, 0.0, 1.5], [2.0, -1.0, -1.0]] {
        let scene = flight(gravity.into());
        let found = rollout(&edge(), &scene, 10, 100, Progress::none()).unwrap();
        for frame in [20, 60, 100] {
            let (found, expected) =
                (found.pose(frame, 0).unwrap(), scene.pose(frame as usize, 0).unwrap());
            let off = (found.translation.vector - expected.translation.vector).norm();
            assert!(off < 1e-4, "{gravity:?}, frame {frame}: {off} m");
            assert!(found.rotation.angle() < 1e-3);
        }
    }
}

#[test]
fn the_scenes_own_planes_count() {
    let plane = |offset_m| Plane { offset_m, ..Plane::ground(0.3, 0.5) };
    let fall = flight(Vector3::new(0.0, 0.0, -40.0));
    let roll = |planes: Option<Vec<Plane>>, last| {
        let scene = match planes {
            Some(planes) => fall.clone().with_planes(planes).unwrap(),
            None => fall.clone(),
        };
        rollout(&edge(), &scene, 10, last, Progress::none()).unwrap()
    };
    // Free fall is at -0.47 m by frame 100, with the lower face half a metre below that.
    let free = fall.pose(100, 0).unwrap().translation.z;
    assert!(free < -0.4, "{free}");
    for planes in [vec![], vec![plane(-20.0)]] {
        assert!((height(&roll(Some(planes), 100), 100) - free).abs() < 1e-4);
    }
    let grounded = roll(None, 100);
    assert!(height(&grounded, 100) > 0.0, "unknown planes are the model's ground");
    assert_eq!(roll(Some(vec![Plane::ground(0.3, 0.5)]), 100), grounded, "which is this one");
    assert!(height(&roll(Some(vec![plane(1.0)]), 100), 100) > 1.0);
    // A wall in the way of what flies sideways, whatever its direction.
    let wall = Plane { normal: Vector3::new(-1.0, 0.0, 0.0), offset_m: -0.52, ..plane(0.0) };
    let scene = flight(Vector3::new(4.0, 0.0, 0.0));
    let through =
        rollout(&edge(), &scene.clone().with_planes(vec![]).unwrap(), 10, 100, Progress::none());
    let stopped =
        rollout(&edge(), &scene.with_planes(vec![wall]).unwrap(), 10, 100, Progress::none());
    let x = |path: Trajectory| path.pose(100, 0).unwrap().translation.x;
    let (through, stopped) = (x(through.unwrap()), x(stopped.unwrap()));
    // The cube's face begins 2 cm before the wall.
    assert!(through > 0.55 && stopped < 0.05, "{through} m, {stopped} m");
}

#[test]
fn trajectories_at_their_limits() {
    let empty = Trajectory::new(u32::MAX, 0, Vec::new());
    assert_eq!((empty.samples(), empty.last_frame(), empty.iter().count()), (0, u32::MAX, 0));
    let mut one = Trajectory::new(u32::MAX - 1, 5, vec![Isometry3::identity()]);
    one.push([]);
    assert_eq!((one.samples(), one.last_frame(), one.iter().count()), (2, u32::MAX, 2));
}

/// Three cubes in a row that fall: two hold together to the end, one until frame 20.
fn bonded() -> RecordedScene {
    let fallen = scene(1, 3, 240.0, -10.0);
    let units = fallen.units().iter().map(|unit| unit.clone().with_body(4)).collect();
    let bond = |units, breaks_at| RecordedBond { units, breaks_at };
    let gravity = fallen.gravity_m_s2();
    RecordedScene::new("bonded", 1, Split::Test, 240.0, gravity, units)
        .unwrap()
        .with_planes(vec![Plane::ground(0.3, 0.5)])
        .unwrap()
        .with_bonds(vec![bond([1, 0], None), bond([1, 2], Some(25))])
        .unwrap()
}

#[test]
fn bonds_hold_until_the_record_breaks_them() {
    let edge = LoadedModel::embedded("edge", rigidformer_weights::EDGE).unwrap();
    let scene = bonded();
    let engine = Engine::new().unwrap();
    let roll = |scene| predict(engine, &edge, scene, 10, 60, Progress::none()).unwrap();
    let predicted = roll(&scene);
    // Frames 0, 10, 20, 30, 40: the step from frame 30 on is the first without the second bond.
    assert_eq!(predicted.holding[..4], vec![vec![true, true]; 4]);
    assert_eq!(predicted.holding[4..], vec![vec![true, false]; 3]);
    assert_eq!(predicted.clusters_at(&scene, 39), [0, 0, 0]);
    assert_eq!(predicted.clusters_at(&scene, 40), [0, 0, 2]);
    assert_eq!(scene.clusters_at(25), [0, 0, 2]);
    let between = |frame: u32, a: usize, b: usize| {
        let pose = |unit| predicted.poses.pose(frame, unit).unwrap();
        pose(a).inverse() * pose(b)
    };
    // The first two go on as one body; the other one turns about itself once it is alone.
    let drift =
        (between(60, 0, 1).translation.vector - between(10, 0, 1).translation.vector).norm();
    assert!(drift < 1e-4, "{drift}");
    assert_eq!(predicted.points, None);
    assert_eq!(predicted.poses, rollout(&edge, &scene, 10, 60, Progress::none()).unwrap());
    assert_eq!(
        predict_many(&edge, std::slice::from_ref(&scene), 10, 60, Progress::none()).unwrap(),
        std::slice::from_ref(&predicted)
    );

    let written = predicted.as_scene(&scene).unwrap();
    assert_eq!(
        (written.frames(), written.frame_rate_hz(), written.planes()),
        (7, 24.0, scene.planes())
    );
    let breaks: Vec<_> = written.bonds().iter().map(|bond| bond.breaks_at).collect();
    assert_eq!(breaks, [None, Some(4)]);
    assert_eq!(written.pose(6, 2).copied(), predicted.poses.pose(60, 2));

    // A model that cannot hold units together says nothing of bonds: then the record does.
    let predicted =
        predict(engine, &model("tiny-paper-inputs"), &scene, 10, 60, Progress::none()).unwrap();
    assert!(predicted.holding.is_empty());
    assert_eq!(predicted.clusters_at(&scene, 20), [0, 0, 0]);
    assert_eq!(predicted.clusters_at(&scene, 30), [0, 0, 2]);
    let breaks = predicted.as_scene(&scene).unwrap().bonds()[1].breaks_at;
    assert_eq!(breaks, Some(3));
}

#[test]
fn bonds_that_a_simulator_refuses_are_named() {
    let edge = LoadedModel::embedded("edge", rigidformer_weights::EDGE).unwrap();
    let bricks = bonded();
    let units = bricks.units().iter().map(|unit| RecordedUnit { body: None, ..unit.clone() });
    let scene =
        RecordedScene::new("apart", 1, Split::Test, 240.0, Vector3::zeros(), units.collect());
    let scene = scene.unwrap().with_bonds(bonded().bonds().to_vec()).unwrap();
    let error = rollout(&edge, &scene, 10, 60, Progress::none()).unwrap_err();
    assert!(matches!(error, RolloutError::Bond { .. }), "{error}");
    assert!(error.to_string().contains("give both the same body"), "{error}");
}
