//! Pivots are found from poses, and hold units together in rollouts and futures.

use nalgebra::{Isometry3, Point3, UnitQuaternion, Vector3};
use rigidformer_evaluation::figures;
use rigidformer_evaluation::metrics::apart;
use rigidformer_evaluation::pivots;
use rigidformer_evaluation::rollout::{RolloutError, rollout, rollout_on};
use rigidformer_evaluation::scenes::{RecordedScene, RecordedUnit, Split};
use rigidformer_runtime::core::{JoinError, Limits, Physics, Role};
use rigidformer_runtime::engine::Engine;
use rigidformer_runtime::futures::{BatchError, BatchSimulator, Start};
use rigidformer_runtime::models::LoadedModel;
use rigidformer_runtime::pivots::{Link, Pivot, PivotError, find, hold};
use rigidformer_runtime::progress::Progress;
use rigidformer_runtime::threads::Threads;
use rigidformer_runtime::world::World;

const WOOD: Physics = Physics { mass_kg: 1.0, friction: 0.4, restitution: 0.3 };
/// Half of the length of a bar, metres.
const HALF_M: f32 = 0.2;
const FRAMES: usize = 121;

fn bar() -> Vec<Point3<f32>> {
    let corner = |i: i32, bit| if i & bit == 0 { -1.0 } else { 1.0 };
    let place = |i| [HALF_M * corner(i, 1), 0.04 * corner(i, 2), 0.04 * corner(i, 4)];
    (0..8).map(|i| Point3::from(place(i))).collect()
}

fn end(sign: f32) -> Point3<f32> {
    Point3::new(sign * HALF_M, 0.0, 0.0)
}

/// A chain of bars that folds while it falls; where `slides`, the last one slips along the one before.
fn chain(slides: bool) -> RecordedScene {
    let mut poses = vec![Vec::new(); 4];
    for frame in 0..FRAMES {
        let time = frame as f32 / 240.0;
        let mut at = Point3::new(time, 0.0, 1.5 - 5.0 * time * time);
        for (part, poses) in poses.iter_mut().enumerate() {
            let turn =
                Vector3::new(0.3 * part as f32, 1.0 - part as f32, 0.4 * (1.0 + part as f32));
            let turn = UnitQuaternion::from_scaled_axis(turn * (2.0 * time));
            let slip = if slides && part == 3 { time } else { 0.0 };
            let pose = Isometry3::from_parts((at - turn * end(-1.0)).into(), turn);
            poses.push(pose * Isometry3::translation(slip, 0.0, 0.0));
            at = pose * end(1.0);
        }
    }
    let unit = |poses| RecordedUnit::new("bar", bar(), WOOD, poses).with_body(2);
    let units = poses.into_iter().map(unit).collect();
    let gravity = Vector3::new(0.0, 0.0, -10.0);
    RecordedScene::new("chain", 1, Split::Test, 240.0, gravity, units).unwrap()
}

#[test]
fn the_ends_of_a_chain_are_found() {
    let scene = chain(false);
    for (frames, tolerance) in [(0..FRAMES, 1e-4), (0..11, 3e-4)] {
        let found = pivots::of_scene(&scene, frames).unwrap();
        let pairs: Vec<_> = found.iter().map(|pivot| (pivot.unit, pivot.parent)).collect();
        assert_eq!(pairs, [(1, 0), (2, 1), (3, 2)]);
        for pivot in &found {
            assert!((pivot.pivot - end(-1.0)).norm() < tolerance, "{pivot:?}");
            assert!((pivot.parent_pivot - end(1.0)).norm() < tolerance, "{pivot:?}");
            assert!(pivot.residual_m < 1e-5, "{pivot:?}");
        }
    }
}

/// Any pivot fits parts that do not turn about each other; it should be between them.
#[test]
fn of_parts_that_do_not_turn_the_pivot_is_where_they_are_nearest() {
    let still = |x: f32| vec![Isometry3::translation(x, 0.0, 0.0); 3];
    let (points, places) = (bar(), [still(0.0), still(0.4), still(0.8)]);
    let part = |poses| Link { points: &points, body: Some(0), poses };
    let [first, second, third] = &places;
    let found = find(&[part(first), part(third), part(second)]).unwrap();
    let pairs: Vec<_> = found.iter().map(|pivot| (pivot.unit, pivot.parent)).collect();
    assert_eq!(pairs, [(2, 0), (1, 2)]);
    for pivot in &found {
        assert!((pivot.parent_pivot - end(1.0)).norm() < 0.03, "{pivot:?}");
    }
}

#[test]
fn parts_that_slide_are_not_joined() {
    let found = pivots::of_scene(&chain(true), 0..FRAMES).unwrap();
    let pairs: Vec<_> = found.iter().map(|pivot| (pivot.unit, pivot.parent)).collect();
    assert_eq!(pairs, [(1, 0), (2, 1)]);
}

#[test]
fn what_shows_no_pivots_is_named() {
    let scene = chain(false);
    let too_few = |found| Err(PivotError::TooFewFrames { found });
    assert_eq!(pivots::of_scene(&scene, 0..1), too_few(1));
    assert_eq!(pivots::of_scene(&scene, 0..FRAMES + 1), too_few(0));
    assert_eq!(find(&[]), too_few(0));
    let (points, poses) = (bar(), vec![Isometry3::identity(); 3]);
    let part = |points, poses| Link { points, body: Some(0), poses };
    let found_with = |second| find(&[part(&points, &poses), second]);
    let frames = PivotError::Frames { link: 1, found: 2, expected: 3 };
    assert_eq!(found_with(part(&points, &poses[1..])), Err(frames));
    assert_eq!(found_with(part(&[], &poses)), Err(PivotError::NoPoints { link: 1 }));
    let nowhere = vec![Isometry3::translation(0.0, f32::NAN, 0.0); 3];
    assert_eq!(found_with(part(&points, &nowhere)), Err(PivotError::NotFinite { link: 1 }));
}

#[test]
fn rollouts_hold_parts_together_and_figures_say_how_far_they_come_apart() {
    let edge = LoadedModel::embedded("edge", rigidformer_weights::EDGE).unwrap();
    let scene = chain(false);
    let joined = scene.clone().with_pivots(pivots::of_scene(&scene, 0..11).unwrap()).unwrap();
    let measure = pivots::recorded(&scene);
    let [alone, held] = [&scene, &joined].map(|scene| {
        let predicted = rollout(&edge, scene, 10, 100, Progress::none()).unwrap();
        apart(&predicted, &measure, 11, 100).into_iter().fold(0.0, f64::max)
    });
    assert!(alone > 0.02, "{alone}");
    assert!(held < 1e-3, "{held}");
    let [alone, held] = [scene, joined]
        .map(|scene| figures::model(&edge, &[scene], 10, Progress::none()).unwrap().apart.unwrap());
    assert!(alone.max_m > 0.02 && held.max_m < 1e-3, "{alone:?} {held:?}");
}

#[test]
fn bits_do_not_depend_on_the_threads() {
    let edge = LoadedModel::embedded("edge", rigidformer_weights::EDGE).unwrap();
    let scene = chain(false);
    let scene = scene.clone().with_pivots(pivots::of_scene(&scene, 0..11).unwrap()).unwrap();
    let [one, two] = [1, 2].map(|threads| {
        let engine = Engine { threads: Threads::new(threads), ..Engine::new().unwrap() };
        rollout_on(engine, &edge, &scene, 10, 100, Progress::none()).unwrap()
    });
    assert_eq!(one, two);
}

#[test]
fn futures_hold_their_parts_together() {
    let edge = LoadedModel::embedded("edge", rigidformer_weights::EDGE).unwrap();
    let scene = chain(false);
    let found = pivots::of_scene(&scene, 0..11).unwrap();
    let posed = |unit: usize| rigidformer_runtime::core::Posed {
        unit: scene.units()[unit].as_unit(),
        previous: scene.units()[unit].poses[0],
        current: scene.units()[unit].poses[10],
    };
    let units = [0, 1, 2, 3].map(posed);
    let gravity_m_s2 = Some(scene.gravity_m_s2());
    let start = Start {
        dt_s: 10.0 / 240.0,
        units: &units,
        pivots: &found,
        gravity_m_s2,
        ..Start::default()
    };
    let (futures, steps) = (3, 9);
    let mut out = vec![Isometry3::identity(); futures * steps * 4];
    let simulator = BatchSimulator::new(Engine::new().unwrap(), &edge);
    simulator.run(&start, steps, &(), &mut out).unwrap();
    let scene = scene.clone().with_pivots(found.clone()).unwrap();
    let alone = rollout(&edge, &scene, 10, 100, Progress::none()).unwrap();
    let alone: Vec<_> = alone.iter().skip(2).flat_map(|(_, poses)| poses.to_vec()).collect();
    for future in out.chunks(steps * 4) {
        assert_eq!(future, alone);
    }
    let circle = [found[0], Pivot { unit: 0, parent: 1, ..found[0] }];
    let refused = simulator.run(&Start { pivots: &circle, ..start }, steps, &(), &mut out);
    assert!(matches!(refused, Err(BatchError::Join(JoinError::Circle { .. }))), "{refused:?}");
    let limits = Limits { units: 4, points: units.iter().map(|seen| seen.unit.room()).sum() };
    let mut world = World::new(&edge, limits).unwrap();
    world.edit(|simulator| {
        simulator.observe_poses(start.dt_s, units).unwrap();
        hold(simulator, &found[1..]).unwrap();
        let before: Vec<_> = simulator.joints().collect();
        assert!(matches!(hold(simulator, &circle), Err(JoinError::Circle { .. })));
        assert_eq!(simulator.joints().collect::<Vec<_>>(), before, "a refusal changes nothing");
    });
    let circular = scene.clone().with_pivots(circle.to_vec()).unwrap();
    let refused = rollout(&edge, &circular, 10, 100, Progress::none());
    assert!(matches!(refused, Err(RolloutError::Join { .. })), "{refused:?}");
    let nobody = vec![Pivot { unit: 4, ..found[0] }];
    assert!(scene.with_pivots(nobody).unwrap_err().to_string().contains("of units that it has"));
}

/// Where the caller moves both parts, there is nothing to hold or to measure.
#[test]
fn pivots_between_driven_units_are_no_measure() {
    let scene = chain(false);
    let units = scene.units().iter().cloned().map(|unit| unit.with_role(Role::Driven)).collect();
    let gravity = scene.gravity_m_s2();
    let driven = RecordedScene::new("driven", 1, Split::Test, 240.0, gravity, units).unwrap();
    assert!(pivots::has_links(&driven));
    assert_eq!(pivots::recorded(&driven), []);
    assert_eq!(pivots::recorded(&scene).len(), 3);
}
