//! Soft bodies: the core against PyTorch, kernels and threads against each other, and input that cannot be.
#![allow(missing_docs, clippy::unwrap_used, clippy::expect_used, clippy::panic)]

use nalgebra::{Isometry3, Point3, UnitQuaternion, Vector3};
use rigidformer_core::{
    BondError, EditError, JoinError, Joint, Layer, Limits, ObserveError, Observed, Physics,
    Portable, Posed, Role, Serial, Simulator, Trace, Unit,
};
use rigidformer_evaluation::predicted::{Predicted, predict};
use rigidformer_evaluation::rollout::RolloutError;
use rigidformer_evaluation::scenes::RecordedScene;
use rigidformer_runtime::engine::Engine;
use rigidformer_runtime::kernels::Kernel;
use rigidformer_runtime::models::LoadedModel;
use rigidformer_runtime::progress::Progress;
use rigidformer_runtime::threads::Threads;
use rigidformer_runtime::world::World;
use rigidformer_tests::{Seen, data, packed_model, poses, with_simulator};
use safetensors::SafeTensors;
use std::collections::BTreeMap;

const STEP: u32 = Seen::STEP;

/// Values by layer and index, tiles of a unit appended.
#[derive(Default)]
struct Recording(BTreeMap<(Layer, usize), Vec<f32>>);

impl Trace for Recording {
    fn record(&mut self, layer: Layer, index: usize, values: &[f32]) {
        self.0.entry((layer, index)).or_default().extend_from_slice(values);
    }
}

impl Recording {
    /// All indices of a layer, one after another.
    fn layer(&self, layer: Layer) -> Vec<f32> {
        let parts = self.0.iter().filter(|((l, _), _)| *l == layer);
        parts.flat_map(|(_, values)| values.iter().copied()).collect()
    }
}

fn scene() -> RecordedScene {
    Seen::golden().scene
}

fn model() -> LoadedModel {
    LoadedModel::copy_of("tiny-soft", &packed_model("tiny-soft")).expect("model")
}

fn rolled(engine: Engine, scene: &RecordedScene, steps: u32) -> Predicted {
    let last = STEP * (1 + steps);
    predict(engine, &model(), scene, STEP, last, Progress::none()).expect("rollout")
}

fn tensor(name: &str) -> (Vec<f32>, Vec<usize>) {
    let bytes = std::fs::read(data("tiny-soft.golden.safetensors")).expect("golden");
    let tensors = SafeTensors::deserialize(&bytes).expect("golden tensors");
    let view = tensors.tensor(name).expect("tensor");
    let (values, _) = view.data().as_chunks::<4>();
    (values.iter().map(|b| f32::from_le_bytes(*b)).collect(), view.shape().to_vec())
}

/// Points of a sheet over a ball, a box and a free ball, step after step.
#[test]
fn the_core_agrees_with_the_lab() {
    let engine = Engine { kernel: Kernel::Portable, threads: Threads::ONE };
    let (values, shape) = tensor("points");
    let found = rolled(engine, &scene(), shape[0] as u32);
    let (centres, _) = tensor("rigid_centres");
    for step in 0..shape[0] {
        let frame = STEP * (2 + step as u32);
        let mine = found.points.as_ref().unwrap().at(frame).expect("sample");
        let theirs = values.as_chunks::<3>().0.iter().skip(step * shape[1]).take(shape[1]);
        let worst = mine
            .iter()
            .zip(theirs)
            .map(|(a, b)| (a - Point3::from(*b)).norm())
            .fold(0.0_f32, f32::max);
        println!("step {step}: points differ by {worst:.1e} m");
        // Springs amplify rounding: a sheet that hits a ball is not a still one.
        assert!(worst < 1e-5 * 10.0_f32.powi(step as i32), "step {step}: {worst} m");
        // The last of the three rigid units is the free ball.
        let ball = found.poses.pose(frame, 6).expect("pose").translation.vector;
        let theirs = centres.as_chunks::<3>().0[step * 3 + 2];
        let apart = (ball - nalgebra::Vector3::from(theirs)).norm();
        assert!(apart < 1e-4 * 10.0_f32.powi(step as i32), "ball at step {step}: {apart} m");
    }
}

/// Inputs of points of the first step, layer by layer.
#[test]
fn features_and_head_agree_with_the_lab() {
    let (seen, packed) = (Seen::golden(), packed_model("tiny-soft"));
    let mut recording = Recording::default();
    with_simulator(&packed, seen.scene.points(), |simulator| {
        seen.observe(simulator).unwrap();
        simulator.step_on(Serial(Portable), &mut recording).unwrap();
    });
    for (layer, name) in [(Layer::Features, "features"), (Layer::Head, "head")] {
        let (theirs, shape) = tensor(name);
        let mine = recording.layer(layer);
        assert_eq!(mine.len(), theirs.len(), "{name}");
        let width = *shape.last().unwrap();
        let mut worst = vec![0.0_f32; width];
        for (a, b) in mine.chunks(width).zip(theirs.chunks(width)) {
            for (worst, (a, b)) in worst.iter_mut().zip(a.iter().zip(b)) {
                *worst = worst.max((a - b).abs());
            }
        }
        assert!(worst.iter().all(|w| *w < 1e-3), "{name}: {worst:?}");
    }
}

/// Kernels and threads change no bit of points and poses.
#[test]
fn every_kernel_and_thread_count_gives_the_same_bits() {
    let scene = scene();
    let reference = rolled(Engine { kernel: Kernel::Portable, threads: Threads::ONE }, &scene, 6);
    for kernel in Kernel::available() {
        for threads in [Threads::ONE, Threads::all()] {
            assert_eq!(rolled(Engine { kernel, threads }, &scene, 6), reference, "{kernel}");
        }
    }
}

/// Copies of a point stay in one place, and nothing is deep in the ball or below the ground.
#[test]
fn patches_do_not_tear_and_points_stay_outside() {
    let scene = scene();
    let found = rolled(Engine::new().unwrap(), &scene, 12);
    let last = found.points.as_ref().unwrap().samples.last().unwrap();
    let rest: Vec<_> =
        scene.units().iter().filter(|u| u.soft.is_some()).flat_map(|u| &u.points).collect();
    for (i, a) in rest.iter().enumerate() {
        for (j, b) in rest.iter().enumerate().skip(i + 1) {
            if (*a - *b).norm() < 1e-6 {
                assert_eq!(last[i], last[j], "copies {i} and {j}");
            }
        }
    }
    let rock = scene.units()[4].poses[0].translation.vector;
    for point in last {
        assert!(point.z > 0.0 && (point.coords - rock).norm() > 0.08, "{point}");
    }
}

/// A ball that spins beside a sheet goes on spinning as it did, and stays where it is: rounding does not grow from step to step.
#[test]
fn a_rigid_unit_that_spins_keeps_its_spin_and_its_shape() {
    let (seen, packed) = (Seen::golden(), packed_model("tiny-soft"));
    let mut units = seen.units();
    let ball = units.len() - 1;
    let (points, before) = (units[ball].current, units[ball].unit.points);
    let middle = middle_of(points);
    let spin = UnitQuaternion::from_scaled_axis(Vector3::new(0.1, -0.2, 0.15));
    let turned: Vec<_> = points.iter().map(|p| middle + spin * (p - middle)).collect();
    units[ball].current = &turned;
    with_simulator(&packed, seen.scene.points(), |simulator| {
        simulator.set_planes(seen.scene.planes().unwrap()).unwrap();
        simulator.observe(seen.dt_s(), units).unwrap();
        let radius = (points.first().unwrap() - middle).norm();
        let mut last = poses(simulator)[ball].rotation;
        for step in 0..60 {
            simulator.step().unwrap();
            let pose = poses(simulator)[ball];
            let turn = (pose.rotation * last.inverse()).angle_to(&spin);
            assert!(turn < 2e-3, "step {step}: {turn} rad");
            let place = pose * middle_of(before);
            assert!(place.z > radius - 1e-3 && place.coords.norm() < 5.0, "step {step}: {place}");
            last = pose.rotation;
        }
    });
}

fn middle_of(points: &[Point3<f32>]) -> Point3<f32> {
    Point3::from(points.iter().map(|p| p.coords).sum::<Vector3<f32>>() / points.len() as f32)
}

fn refused(change: impl FnOnce(&mut Vec<Observed<'_>>)) -> ObserveError {
    let (seen, packed) = (Seen::golden(), packed_model("tiny-soft"));
    let mut units = seen.units();
    change(&mut units);
    with_simulator(&packed, seen.scene.points(), |simulator| {
        let good = seen.units();
        simulator.observe(STEP as f32 / 60.0, good).unwrap();
        let before = poses(simulator);
        let error = simulator.observe(STEP as f32 / 60.0, units).unwrap_err();
        assert_eq!(poses(simulator), before, "a refused observation changes nothing");
        simulator.step().unwrap();
        error
    })
}

#[test]
fn soft_units_that_cannot_be_are_refused() {
    static FEW: [Point3<f32>; 5] = [const { Point3::new(0.0, 0.0, 0.0) }; 5];
    static SAME: [Point3<f32>; 16] = [const { Point3::new(0.1, 0.0, 0.0) }; 16];
    static FAR: [Point3<f32>; 16] = [const { Point3::new(f32::NAN, 0.0, 0.0) }; 16];
    // Apart, but by less than a micrometre.
    static NEAR: [Point3<f32>; 16] = {
        let mut points = [Point3::new(0.0, 0.0, 0.0); 16];
        let mut at = 0;
        while at < points.len() {
            points[at] = Point3::new(at as f32 * 1e-8, 0.0, 0.0);
            at += 1;
        }
        points
    };
    for rest in [&FEW[..], &SAME[..], &NEAR[..], &FAR[..], &[]] {
        let error = refused(|units| units[1].unit = units[1].unit.soft(rest, 1e5));
        assert_eq!(error, ObserveError::BadSoft { unit: 1 });
    }
    for young in [0.0, -1.0, f32::NAN, f32::INFINITY, 1e20] {
        let error = refused(|units| {
            let rest = units[2].unit.soft.unwrap().rest;
            units[2].unit = units[2].unit.soft(rest, young);
        });
        assert_eq!(error, ObserveError::BadSoft { unit: 2 });
    }
    let error = refused(|units| units[0].unit = units[0].unit.role(Role::Fixed));
    assert_eq!(error, ObserveError::BadSoft { unit: 0 });
    let error = refused(|units| units[0].current = &FEW);
    assert!(matches!(error, ObserveError::PointMismatch { unit: 0, .. }), "{error}");
}

/// Points at rest that rounding makes one keep a place each.
#[test]
fn every_point_has_a_number_of_its_own() {
    let (seen, packed) = (Seen::golden(), packed_model("tiny-soft"));
    let mut units = seen.units();
    let mut rest = units[1].unit.soft.unwrap().rest.to_vec();
    (rest[2], rest[7]) = (Point3::new(1e-30, 0.0, 0.0), Point3::new(2e-30, 0.0, 0.0));
    units[1].unit = units[1].unit.soft(&rest, 1e5);
    let current = units[1].current;
    with_simulator(&packed, seen.scene.points(), |simulator| {
        simulator.observe(seen.dt_s(), &units).unwrap();
        let places: BTreeMap<_, _> = simulator.unit(1).unwrap().soft_points().collect();
        assert!(places.into_values().eq(current.iter().copied()));
        simulator.step().unwrap();
    });
}

/// What does not go with a patch is refused, and the scene is what it was.
#[test]
fn a_patch_has_no_pose_and_is_free() {
    let (seen, packed) = (Seen::golden(), packed_model("tiny-soft"));
    let here = Isometry3::identity();
    with_simulator(&packed, seen.scene.points(), |simulator| {
        let soft = seen.units()[0].unit;
        simulator.set_dt(seen.dt_s()).unwrap();
        let error = simulator.add(&soft, &here, &here).unwrap_err();
        assert_eq!(error, EditError::Unit(ObserveError::SoftPose { unit: 0 }));
        assert!(simulator.is_empty());

        seen.observe(simulator).unwrap();
        let before = places(simulator);
        let ids = simulator.units().map(|unit| unit.id()).collect::<Vec<_>>();
        assert_eq!(simulator.set_poses(ids[0], &here, &here), Err(EditError::Deforms));
        assert_eq!(simulator.add(&soft, &here, &here), Err(EditError::Deforms));
        assert_eq!(simulator.drive(ids[0], &here), Err(EditError::NotDriven { id: ids[0] }));
        for role in [Role::Fixed, Role::Driven] {
            assert_eq!(simulator.set_role(ids[0], role), Err(EditError::Deforms));
        }
        simulator.set_role(ids[0], Role::Free).unwrap();
        let pivot = Point3::origin();
        for [unit, parent] in [[ids[0], ids[5]], [ids[5], ids[0]]] {
            let joint = Joint::ball(unit, parent, pivot, pivot);
            assert_eq!(simulator.join(&joint), Err(JoinError::Deforms { id: ids[0] }));
        }
        assert_eq!(simulator.bond(&[[ids[0], ids[1]]]), Err(BondError::Motion));
        assert_eq!(places(simulator), before);
        let alone = |simulator: &mut Simulator<'_, '_>| {
            seen.observe(simulator).unwrap();
            simulator.step().unwrap();
            places(simulator)
        };
        simulator.step().unwrap();
        let refused = places(simulator);
        assert_eq!(alone(simulator), refused, "what was refused left nothing behind");
    });
}

fn places(simulator: &Simulator<'_, '_>) -> Vec<Point3<f32>> {
    simulator
        .units()
        .flat_map(|unit| unit.soft_points().collect::<Vec<_>>())
        .map(|(_, p)| p)
        .collect()
}

/// A patch that is given another mass moves as one that was observed with it.
#[test]
fn physics_of_a_patch_change() {
    let (seen, packed) = (Seen::golden(), packed_model("tiny-soft"));
    let moved = |heavy_before: bool, heavy_after: bool| {
        with_simulator(&packed, seen.scene.points(), |simulator| {
            let mut units = seen.units();
            let of_patch = units[1].unit.physics;
            let heavy = Physics { mass_kg: of_patch.mass_kg * 4.0, friction: 0.1, ..of_patch };
            if heavy_before {
                units[1].unit.physics = heavy;
            }
            simulator.observe(seen.dt_s(), &units).unwrap();
            let id = simulator.unit(1).unwrap().id();
            if heavy_after {
                simulator.set_physics(id, heavy).unwrap();
            }
            for _ in 0..4 {
                simulator.step().unwrap();
            }
            places(simulator)
        })
    };
    assert_eq!(moved(false, true), moved(true, false));
    assert_ne!(moved(false, true), moved(false, false));
}

/// The points of the soft units of a copy, as their owner gave them, by their numbers.
fn places_in(simulator: &Simulator<'_, '_>, copy: usize) -> Vec<(usize, Point3<f32>)> {
    let units = copy * simulator.len()..(copy + 1) * simulator.len();
    units.filter_map(|unit| simulator.unit(unit)).flat_map(|unit| unit.soft_points()).collect()
}

/// Copies go on as scenes alone do, whatever is changed in each, and when others are dropped.
#[test]
fn copies_are_scenes_of_their_own() {
    let (seen, model) = (Seen::golden(), model());
    let (units, points) = (seen.scene.units().len(), seen.scene.points());
    let limits = Limits { units: units + 1, points: points + 7 };
    let light = Physics { mass_kg: 0.01, friction: 0.0, restitution: 0.0 };
    // What sets a copy apart from the scene: the mass and friction of a patch, and those of a rigid unit.
    let change = |simulator: &mut Simulator<'_, '_>, copy: usize, nature: usize| {
        let ids = [0, 6].map(|number| simulator.unit(number).unwrap().id());
        if nature > 0 {
            simulator.set_physics_in(copy, ids[nature % 2], light).unwrap();
        }
    };
    let begun = |engine: Engine, copies: usize| {
        let mut world = World::on(engine, &model, limits, copies).unwrap();
        world.edit(|simulator| {
            simulator.observe(seen.dt_s(), seen.units()).unwrap();
            assert_eq!(simulator.replicate(copies), copies);
        });
        world
    };
    let alone = |nature: usize, steps: usize| {
        let mut world = begun(Engine { kernel: Kernel::Portable, threads: Threads::ONE }, 1);
        world.edit(|simulator| change(simulator, 0, nature));
        (0..steps).for_each(|_| {
            world.step().unwrap();
        });
        (places_in(world.simulator(), 0), poses(world.simulator()))
    };
    let expected = [0, 1, 2].map(|nature| alone(nature, 6));
    assert!(expected[0] != expected[1] && expected[1] != expected[2]);
    for kernel in Kernel::available() {
        for threads in [Threads::ONE, Threads::all()] {
            let mut world = begun(Engine { kernel, threads }, 4);
            let natures = [2, 0, 1, 2];
            world.edit(|simulator| {
                natures
                    .iter()
                    .enumerate()
                    .for_each(|(copy, nature)| change(simulator, copy, *nature));
            });
            for step in 0..6 {
                world.step_copies(&mut |_, outcome| assert!(outcome.is_ok())).unwrap();
                if step == 2 {
                    world.edit(|simulator| simulator.retain_copies(|copy| copy % 2 == 1));
                }
            }
            let simulator = world.simulator();
            assert_eq!(simulator.copies(), 2);
            for (copy, nature) in [(0, 0), (1, 2)] {
                let (points, rigid) = &expected[nature];
                assert_eq!(&places_in(simulator, copy), points, "{kernel}: copy {copy}");
                let own = copy * units..(copy + 1) * units;
                let found = own.map(|unit| simulator.unit(unit).unwrap().pose());
                assert!(found.eq(rigid.iter().copied()), "{kernel}: copy {copy}");
            }
        }
    }
}

/// A copy in which a point goes nowhere stays where it was, and the others go on.
#[test]
fn a_copy_that_fails_stays_and_the_others_go_on() {
    let (seen, packed) = (Seen::golden(), packed_model("tiny-soft"));
    let model = LoadedModel::copy_of("tiny-soft", &packed).unwrap();
    let (units, points) = (seen.scene.units().len(), seen.scene.points());
    let mut world = World::on(
        Engine { kernel: Kernel::Portable, threads: Threads::ONE },
        &model,
        Limits { units, points },
        3,
    )
    .unwrap();
    let far = Isometry3::translation(9.9e5, 0.0, 5.0);
    let farther = Isometry3::translation(-9.9e5, 0.0, 5.0);
    let before = world.edit(|simulator| {
        simulator.observe(seen.dt_s(), seen.units()).unwrap();
        assert_eq!(simulator.replicate(3), 3);
        let ball = simulator.unit(6).unwrap().id();
        simulator.set_poses_in(1, ball, &farther, &far).unwrap();
        [0, 1, 2].map(|copy| places_in(simulator, copy))
    });
    let mut failed = Vec::new();
    world
        .step_copies(&mut |copy, outcome| {
            if outcome.is_err() {
                failed.push(copy);
            }
        })
        .unwrap();
    assert_eq!(failed, [1]);
    let after = [0, 1, 2].map(|copy| places_in(world.simulator(), copy));
    assert_eq!(after[1], before[1]);
    assert_eq!(after[0], after[2]);
    assert_ne!(after[0], before[0]);
}

/// Another time step keeps the velocities of points, and one that points cannot come from changes nothing.
#[test]
fn points_keep_their_velocities_at_another_time_step() {
    let (seen, packed) = (Seen::golden(), packed_model("tiny-soft"));
    with_simulator(&packed, seen.scene.points(), |simulator| {
        // Nothing pulls, and nothing is near: the network alone would turn them, so it is one short step.
        simulator.set_planes(&[]).unwrap();
        let lifted = |points: &[Point3<f32>], way: f32| -> Vec<_> {
            points.iter().map(|p| Point3::new(p.x + way, p.y, p.z + 9.0)).collect()
        };
        let seen_units = seen.units();
        let frames: Vec<_> = seen_units
            .iter()
            .map(|unit| (lifted(unit.unit.points, 0.0), lifted(unit.unit.points, 0.05)))
            .collect();
        let units = seen_units.iter().zip(&frames).map(|(unit, (before, now))| Observed {
            unit: Unit { points: before, ..unit.unit },
            current: now,
        });
        let units: Vec<_> = units.filter(|unit| unit.unit.soft.is_some()).collect();
        simulator.observe(0.05, &units).unwrap();
        let before = places(simulator);
        let error = simulator.set_dt(68.0).unwrap_err();
        assert!(matches!(error, EditError::Unit(ObserveError::LongTimestep { .. })), "{error}");
        simulator.set_dt(0.01).unwrap();
        assert_eq!(places(simulator), before);
        simulator.step().unwrap();
        for (a, b) in before.iter().zip(places(simulator)) {
            // At 1 m/s, 1 cm; at the way of the longer step it would be 5.
            assert!((b.x - a.x - 0.01).abs() < 0.005, "{a} {b}");
        }
    });
}

/// A model of rigid bodies takes no soft unit, and a soft unit has no pose.
#[test]
fn soft_units_need_points_and_a_model_that_moves_them() {
    let seen = Seen::golden();
    let scene = &seen.scene;
    with_simulator(rigidformer_weights::EDGE, scene.points(), |simulator| {
        let error = simulator.observe(1.0 / 12.0, seen.units()).unwrap_err();
        assert_eq!(error, ObserveError::NotSoft { unit: 0 });
    });
    with_simulator(&packed_model("tiny-soft"), scene.points(), |simulator| {
        let posed = seen.units().into_iter().map(|seen| Posed {
            unit: seen.unit,
            previous: Isometry3::identity(),
            current: Isometry3::identity(),
        });
        let error = simulator.observe_poses(1.0 / 12.0, posed.collect::<Vec<_>>()).unwrap_err();
        assert_eq!(error, ObserveError::SoftPose { unit: 0 });
        let error = simulator.observe(1e3, seen.units()).unwrap_err();
        assert!(matches!(error, ObserveError::LongTimestep { .. }), "{error}");
        simulator.observe(1.0 / 12.0, seen.units()).unwrap();
        let id = simulator.units().last().unwrap().id();
        assert_eq!(simulator.remove(id), Err(EditError::Deforms));
        assert_eq!(simulator.replicate(4), 1, "this simulator has room for one");
    });
    let edge = LoadedModel::embedded("edge", rigidformer_weights::EDGE).unwrap();
    let engine = Engine::new().unwrap();
    let error = predict(engine, &edge, scene, STEP, 20, Progress::none()).unwrap_err();
    assert!(matches!(error, RolloutError::Soft { unit: 0, .. }), "{error}");
}
