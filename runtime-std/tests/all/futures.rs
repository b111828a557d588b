//! Futures are what each would be alone, in any batch and on any number of threads.

use std::collections::HashSet;
use std::ops::ControlFlow;
use std::sync::Mutex;
use std::thread::{self, ThreadId};

use nalgebra::{Isometry3, Point3, Vector3};
use rigidformer_runtime::core::{Limits, Physics, Pieces, Posed, Unit};
use rigidformer_runtime::engine::Engine;
use rigidformer_runtime::futures::{
    self, BatchError, BatchSimulator, ChangeError, CopyError, End, FutureScene, Outcome, Start,
    Variation, VelocityNoise,
};
use rigidformer_runtime::models::LoadedModel;
use rigidformer_runtime::threads::Threads;
use rigidformer_runtime::world::{Snapshot, World};
use rigidformer_weights::{ModelConfig, ModelFile, ModelWriter, Similarity};

const STEPS: usize = 5;

fn cube() -> Vec<Point3<f32>> {
    let corner = |i: usize, bit| if i & bit == 0 { -0.1 } else { 0.1 };
    (0..8).map(|i| Point3::new(corner(i, 1), corner(i, 2), corner(i, 4))).collect()
}

/// Runs `body` with a heap of three cubes.
fn with_start<R>(body: impl FnOnce(&LoadedModel, &Start<'_>) -> R) -> R {
    let loaded = LoadedModel::embedded("edge", rigidformer_weights::EDGE).unwrap();
    let points = cube();
    let unit = Unit::new(&points, Physics { mass_kg: 1.0, friction: 0.4, restitution: 0.3 });
    let units = [0.0_f32, 0.15, 0.4].map(|x| {
        let at = |z: f32| Isometry3::translation(x, 0.0, z + 0.25 * (x * 6.0).floor());
        Posed { unit, previous: at(0.14), current: at(0.12) }
    });
    let start = Start { dt_s: 10.0 / 240.0, units: &units, ..Start::default() };
    body(&loaded, &start)
}

fn engine(threads: usize) -> Engine {
    Engine { threads: Threads::new(threads), ..Engine::new().unwrap() }
}

const NOISE: VelocityNoise = VelocityNoise { seed: 5, linear_m_s: 0.5, angular_rad_s: 2.0 };

/// The futures of a start, one after another.
fn run(
    simulator: BatchSimulator,
    start: &Start<'_>,
    futures: usize,
    variation: &impl Variation,
) -> (Vec<Isometry3<f32>>, Vec<Outcome>) {
    let mut out = vec![Isometry3::identity(); futures * STEPS * start.units.len()];
    let outcomes = simulator.run(start, STEPS, variation, &mut out).unwrap();
    (out, outcomes)
}

/// Pieces take more room than points.
#[test]
fn hollow_units_have_room() {
    with_start(|model, start| {
        let points = cube();
        let units = start.units.iter().map(|posed| {
            let unit = posed.unit.pieces(Pieces::new(&points, &[8]));
            Posed { unit, ..*posed }
        });
        let units: Vec<_> = units.collect();
        let start = Start { units: &units, ..*start };
        let (poses, outcomes) = run(BatchSimulator::new(engine(1), model), &start, 2, &NOISE);
        assert!(outcomes.iter().all(|outcome| outcome.end == End::Complete));
        assert!(poses.iter().all(|pose| pose.translation.vector.norm() < 5.0));
    });
}

#[test]
fn a_future_does_not_depend_on_its_batch_or_on_threads() {
    with_start(|model, start| {
        let (all, outcomes) = run(BatchSimulator::new(engine(1), model), start, 23, &NOISE);
        assert!(
            outcomes.iter().all(|outcome| outcome.steps == STEPS && outcome.end == End::Complete)
        );
        assert_ne!(all[..STEPS * 3], all[STEPS * 3..2 * STEPS * 3]);
        for (threads, units) in [(1, 3), (2, 1), (2, 30), (3, 1000)] {
            let simulator = BatchSimulator::new(engine(threads), model).with_units_a_chunk(units);
            assert_eq!(
                run(simulator, start, 23, &NOISE).0,
                all,
                "{threads} threads, {units} units"
            );
        }
        let (few, _) = run(BatchSimulator::new(engine(2), model), start, 4, &NOISE);
        assert_eq!(few, all[..few.len()]);
    });
}

#[test]
fn an_undisturbed_future_is_the_scene_alone() {
    with_start(|model, start| {
        let (all, _) = run(BatchSimulator::new(engine(2), model), start, 5, &());
        let limits = Limits { units: 3, points: 24 };
        let mut world = World::on(engine(1), model, limits, 1).unwrap();
        world.edit(|simulator| simulator.observe_poses(start.dt_s, start.units)).unwrap();
        let mut alone: Vec<Isometry3<f32>> = Vec::new();
        for _ in 0..STEPS {
            world.step().unwrap();
            alone.extend(world.simulator().units().map(|unit| unit.pose()));
        }
        for future in all.chunks_exact(alone.len()) {
            assert_eq!(future, alone);
        }
    });
}

/// Odd futures end after two steps; future 4 asks for what there is not.
struct Stopping;

impl Variation for Stopping {
    fn begin(&self, future: usize, scene: &mut FutureScene<'_>) -> Result<(), ChangeError> {
        NOISE.begin(future, scene)?;
        let unit = if future == 4 { 9 } else { 0 };
        scene.set_velocity(unit, &Vector3::new(0.5, 0.0, 0.0), &Vector3::zeros())
    }

    fn watch(&self, future: usize, step: usize, _: &[Isometry3<f32>]) -> ControlFlow<()> {
        if future % 2 == 1 && step == 1 {
            ControlFlow::Break(())
        } else {
            ControlFlow::Continue(())
        }
    }
}

#[test]
fn futures_end_on_their_own() {
    with_start(|model, start| {
        let (all, outcomes) = run(BatchSimulator::new(engine(1), model), start, 8, &Stopping);
        let (again, _) =
            run(BatchSimulator::new(engine(2), model).with_units_a_chunk(6), start, 8, &Stopping);
        assert_eq!(all, again);
        for (future, outcome) in outcomes.iter().enumerate() {
            let poses = &all[future * STEPS * 3..][..STEPS * 3];
            match future {
                4 => {
                    let refused = ChangeError::NoSuchUnit { unit: 9, units: 3 };
                    assert_eq!(*outcome, Outcome { steps: 0, end: End::Refused(refused) });
                }
                _ if future % 2 == 1 => {
                    assert_eq!(*outcome, Outcome { steps: 2, end: End::Stopped });
                    assert_eq!(poses[3..6], poses[12..15], "the last pose repeats");
                }
                _ => {
                    assert_eq!(*outcome, Outcome { steps: STEPS, end: End::Complete });
                    assert_ne!(poses[3..6], poses[12..15]);
                }
            }
        }
    });
}

#[test]
fn a_bad_call_changes_nothing() {
    with_start(|model, start| {
        let simulator = BatchSimulator::new(engine(2), model);
        let mut out = vec![Isometry3::identity(); 31];
        let short = simulator.run(start, STEPS, &(), &mut out);
        assert_eq!(short, Err(BatchError::Output { expected: 45, found: 31 }));
        let bad = Isometry3::translation(f32::NAN, 0.0, 0.0);
        let mut out = vec![Isometry3::identity(); 30];
        let units: Vec<_> =
            start.units.iter().map(|posed| Posed { current: bad, ..*posed }).collect();
        let refused = simulator.run(&Start { units: &units, ..*start }, STEPS, &(), &mut out);
        assert!(matches!(refused, Err(BatchError::Start(_))));
        assert!(out.iter().all(|pose| *pose == Isometry3::identity()));
        assert_eq!(simulator.run(start, STEPS, &(), &mut []), Ok(vec![]));
    });
}

/// Pushes every unit of a future by a speed of its own.
struct Push {
    speed: f32,
    turn: f32,
}

impl Variation for Push {
    fn begin(&self, future: usize, scene: &mut FutureScene<'_>) -> Result<(), ChangeError> {
        let way = Vector3::new(1.0, 0.5, 0.25) * (self.speed * future as f32);
        for unit in 0..scene.units() {
            scene.push(unit, &way, &Vector3::new(0.0, 0.0, self.turn * unit as f32))?;
        }
        Ok(())
    }
}

/// Of a model that measures scenes in their own length, and takes steps in two parts: poses are four times as far, in the
/// same bits.
#[test]
fn futures_of_a_larger_scene_are_larger() {
    let packed = ModelFile::parse(rigidformer_weights::EDGE).unwrap();
    let similarity = Similarity { length_m: 0.2, longest_step: 6.0 };
    let config = ModelConfig { similarity, ..*packed.config() };
    let mut writer = ModelWriter::new("similar", config);
    for tensor in packed.tensors() {
        writer = writer.tensor(tensor.name, tensor.shape, tensor.data);
    }
    let model = LoadedModel::copy_of("similar", &writer.finish().unwrap()).unwrap();
    let run = |length: f32, time: f32| {
        let corner = |i: usize, bit| if i & bit == 0 { -0.11 * length } else { 0.1 * length };
        let points: Vec<_> =
            (0..8).map(|i| Point3::new(corner(i, 1), corner(i, 2), corner(i, 4))).collect();
        let cube = Unit::new(&points, Physics { mass_kg: 1.0, friction: 0.4, restitution: 0.3 });
        let at = |x: f32, z: f32| Isometry3::translation(x * length, 0.0, z * length);
        let units = [0.0, 0.3].map(|x| Posed {
            unit: cube,
            previous: at(x, 0.32),
            current: at(x, 0.28 + 0.02 * x),
        });
        let start = Start { dt_s: time / 24.0, units: &units, ..Start::default() };
        let mut poses = vec![Isometry3::identity(); 4 * 8 * 2];
        let push = Push { speed: 0.125 * length / time, turn: 0.25 / time };
        let simulator = BatchSimulator::new(Engine::new().unwrap(), &model);
        let outcomes = simulator.run(&start, 8, &push, &mut poses).unwrap();
        assert!(outcomes.iter().all(|outcome| outcome.end == End::Complete));
        let bits = |pose: &Isometry3<f32>| {
            let place = pose.translation.vector / length;
            place.iter().chain(&pose.rotation.coords).map(|v| v.to_bits()).collect::<Vec<_>>()
        };
        poses.iter().flat_map(bits).collect::<Vec<_>>()
    };
    assert_eq!(run(4.0, 2.0), run(1.0, 1.0));
}

/// Remembers on which threads futures went on.
#[derive(Default)]
struct Watched(Mutex<HashSet<ThreadId>>);

impl Variation for Watched {
    fn begin(&self, future: usize, scene: &mut FutureScene<'_>) -> Result<(), ChangeError> {
        self.0.lock().unwrap().insert(thread::current().id());
        NOISE.begin(future, scene)
    }
}

#[test]
fn no_more_threads_work_than_are_asked_for() {
    with_start(|model, start| {
        let (all, _) = run(BatchSimulator::new(engine(1), model), start, 23, &NOISE);
        let pool = rayon::ThreadPoolBuilder::new().num_threads(5).build().unwrap();
        for (threads, futures) in [(1, 23), (2, 23), (3, 23), (4, 23), (4, 3), (5, 23), (2, 1)] {
            let watched = Watched::default();
            // One future a chunk: more chunks than threads.
            let simulator = BatchSimulator::new(engine(threads), model).with_units_a_chunk(1);
            let (found, _) = pool.install(|| run(simulator, start, futures, &watched));
            assert_eq!(found, all[..found.len()], "{threads} threads, {futures} futures");
            assert!(watched.0.into_inner().unwrap().len() <= threads, "{threads} threads");
        }
    });
}

/// Another push for each copy at each step.
fn pushed(copy: usize, step: usize, scene: &mut FutureScene<'_>) -> Result<(), ChangeError> {
    let push = Vector3::new(0.01 * copy as f32, 0.0, 0.02 * step as f32);
    scene.push(0, &push, &Vector3::zeros())
}

/// Copies that are reset, restored and refused alone do not disturb the others.
#[test]
fn copies_go_on_and_begin_anew_alone() {
    with_start(|loaded, start| {
        let simulator = |threads| BatchSimulator::new(engine(threads), loaded);
        let state = |copies: &futures::Copies, copy| copies.snapshot(copy).unwrap();
        // What a copy is after its steps from the start.
        let alone = |copy: usize, steps: std::ops::Range<usize>| {
            let mut one = simulator(1).copies(start, 1).unwrap();
            for step in steps {
                one.step(&|_, scene| pushed(copy, step, scene)).unwrap();
            }
            state(&one, 0)
        };
        for (threads, count) in [(1, 2), (2, 50), (1, 50), (4, 3)] {
            let mut copies =
                simulator(threads).with_units_a_chunk(12).copies(start, count).unwrap();
            assert_eq!((copies.len(), copies.units()), (count, 3));
            let begun = state(&copies, 1);
            for step in 0..3 {
                let ends = copies.step(&|copy, scene| pushed(copy, step, scene)).unwrap();
                assert_eq!(ends, vec![None; count]);
            }
            copies.reset(1).unwrap();
            assert_eq!(state(&copies, 1), begun);
            let middle = state(&copies, 0);
            let refuses = |copy: usize, scene: &mut FutureScene<'_>| match copy {
                0 => Err(ChangeError::Other("not now".into())),
                1 => pushed(1, 0, scene),
                _ => pushed(copy, 3, scene),
            };
            let ends = copies.step(&refuses).unwrap();
            assert!(matches!(&ends[0], Some(End::Refused(ChangeError::Other(_)))));
            assert!(ends[1..].iter().all(Option::is_none));
            assert_eq!(state(&copies, 0), middle);
            assert_eq!(state(&copies, 1), alone(1, 0..1));
            let last = count - 1;
            assert_eq!(state(&copies, last), alone(last, if last == 1 { 0..1 } else { 0..4 }));
            copies.restore(last, &middle).unwrap();
            assert_eq!(state(&copies, last), middle);
            assert_eq!(copies.pose(last, 2), copies.pose(0, 2));
            assert_eq!(copies.velocity(last, 2), copies.velocity(0, 2));
            let speed =
                copies.edit(0, |scene| scene.set_velocity(0, &Vector3::x(), &Vector3::zeros()));
            assert_eq!(speed, Ok(()));
            assert!((copies.velocity(0, 0).unwrap().linear_m_s - Vector3::x()).norm() < 1e-3);
            let missing = CopyError::NoSuchCopy { copy: count, copies: count };
            assert_eq!(copies.reset(count), Err(missing.clone()));
            assert_eq!(copies.snapshot(count), Err(missing));
            assert_eq!((copies.pose(count, 0), copies.pose(0, 3)), (None, None));
            assert!(matches!(
                copies.restore(0, &Snapshot::from_bytes(vec![0; 9])),
                Err(CopyError::Snapshot(_))
            ));
        }
    });
}
