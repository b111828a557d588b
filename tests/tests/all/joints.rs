//! Units that are joined stay together, with the trained models.
#![allow(missing_docs, clippy::unwrap_used, clippy::expect_used, clippy::panic)]

use nalgebra::{Isometry3, Point3, Vector3};
use rigidformer_core::{
    JoinError, Joint, Limits, Physics, Portable, Role, Serial, Simulator, Unit, UnitId,
};
use rigidformer_runtime::engine::Engine;
use rigidformer_runtime::kernels::Kernel;
use rigidformer_runtime::models::LoadedModel;
use rigidformer_runtime::world::World;
use rigidformer_tests::with_simulator;

const DT_S: f32 = 10.0 / 240.0;
const STEPS: usize = 24;
const WOOD: Physics = Physics { mass_kg: 1.0, friction: 0.4, restitution: 0.3 };
/// What rounding leaves between the two images of a pivot.
const ROUNDING_M: f32 = 2e-6;

/// The corners of a bar along x, about a place that is not its middle.
fn bar() -> Vec<Point3<f32>> {
    let corner = |i: i32, bit| if i & bit == 0 { -1.0 } else { 1.0 };
    let place =
        |i| Point3::new(0.2 * corner(i, 1) + 0.05, 0.05 * corner(i, 2), 0.05 * corner(i, 4));
    (0..8).map(place).collect()
}

fn at(x: f32, y: f32, z: f32) -> Isometry3<f32> {
    Isometry3::translation(x, y, z)
}

fn with_scene<R>(body: impl FnOnce(&mut Simulator<'_, '_>) -> R) -> R {
    with_simulator(rigidformer_weights::EDGE, 16 * 56, |simulator| {
        simulator.set_dt(DT_S).unwrap();
        body(simulator)
    })
}

/// Bars of one body in a row, end to end, that turn about axes of their own.
fn row(simulator: &mut Simulator<'_, '_>, roles: &[Role]) -> Vec<UnitId> {
    let points = bar();
    let bar = |(number, role): (usize, &Role)| {
        let unit = Unit::new(&points, Physics { mass_kg: 1.0 + number as f32, ..WOOD });
        let current = at(0.4 * number as f32, 0.0, 0.6);
        let spin = Vector3::new(0.02, 0.05 * (number as f32 - 1.0), -0.03);
        let previous =
            Isometry3::new(current.translation.vector - Vector3::new(0.02, 0.01, -0.01), spin);
        let moves = *role == Role::Free;
        let previous = if moves { previous } else { current };
        simulator.add(&unit.role(*role).body(1), &previous, &current).unwrap()
    };
    roles.iter().enumerate().map(bar).collect()
}

/// Where the right end of one bar is the left end of another.
fn joint(unit: UnitId, parent: UnitId) -> Joint {
    let [left, right] = [-0.15, 0.25].map(|x| Point3::new(x, 0.0, 0.0));
    Joint::ball(unit, parent, left, right)
}

/// The largest distance of the two images of a pivot.
fn apart(simulator: &Simulator<'_, '_>) -> f32 {
    let distance = |joint: Joint| {
        let own = simulator.pose(joint.unit).unwrap() * joint.pivot;
        (own - simulator.pose(joint.parent).unwrap() * joint.parent_pivot).norm()
    };
    simulator.joints().map(distance).fold(0.0, f32::max)
}

fn bits(simulator: &Simulator<'_, '_>) -> Vec<u32> {
    let poses = simulator.units().map(|unit| unit.internal_pose());
    let numbers = poses
        .flat_map(|pose| pose.rotation.iter().chain(&pose.centre).copied().collect::<Vec<_>>());
    numbers.map(f32::to_bits).collect()
}

#[test]
fn joined_units_stay_together() {
    let free = [Role::Free; 4];
    let (apart_alone, apart_joined) = with_scene(|simulator| {
        let chain = row(simulator, &free);
        let joints: Vec<_> = chain.windows(2).map(|pair| joint(pair[1], pair[0])).collect();
        // In an order in which parents stand behind.
        let run = |simulator: &mut Simulator<'_, '_>| {
            (0..STEPS).fold(0.0_f32, |most, _| {
                simulator.step().unwrap();
                let gap = |joint: &Joint| {
                    let own = simulator.pose(joint.unit).unwrap() * joint.pivot;
                    (own - simulator.pose(joint.parent).unwrap() * joint.parent_pivot).norm()
                };
                joints.iter().map(gap).fold(most, f32::max)
            })
        };
        let alone = run(simulator);
        let ids: Vec<_> = simulator.units().map(|unit| unit.id()).collect();
        ids.into_iter().for_each(|id| simulator.remove(id).unwrap());
        let chain = row(simulator, &free);
        let joints: Vec<_> = chain.windows(2).map(|pair| joint(pair[1], pair[0])).collect();
        joints.iter().for_each(|joint| simulator.join(joint).unwrap());
        assert_eq!(simulator.joints().collect::<Vec<_>>(), joints);
        let joined = (0..STEPS).fold(0.0_f32, |most, _| {
            simulator.step().unwrap();
            most.max(apart(simulator))
        });
        (alone, joined)
    });
    assert!(apart_alone > 0.02, "{apart_alone}");
    assert!(apart_joined < ROUNDING_M, "{apart_joined}");
}

/// Whichever of them is the root.
#[test]
fn a_tree_of_free_units_keeps_its_centre_of_mass() {
    let free = [Role::Free; 4];
    let step = |links: &[(usize, usize)]| {
        with_scene(|simulator| {
            let ids = row(simulator, &free);
            for (unit, parent) in links {
                // From the left to the right, or back.
                let [left, right] = [ids[*unit.min(parent)], ids[*unit.max(parent)]];
                let mut joint = joint(right, left);
                if unit < parent {
                    joint = Joint::ball(left, right, joint.parent_pivot, joint.pivot);
                }
                simulator.join(&joint).unwrap();
            }
            simulator.step().unwrap();
            assert!(apart(simulator) < ROUNDING_M);
            let units =
                simulator.units().map(|unit| (unit.physics().mass_kg, unit.internal_pose().centre));
            let (mass, sum) = units.fold((0.0, Vector3::zeros()), |(mass, sum), (own, centre)| {
                (mass + own, sum + centre * own)
            });
            let poses: Vec<_> = simulator.units().map(|unit| unit.pose()).collect();
            (sum / mass, poses)
        })
    };
    let (apart, _) = step(&[]);
    let chains = [[(1, 0), (2, 1), (3, 2)], [(0, 1), (1, 2), (2, 3)], [(0, 1), (2, 1), (3, 2)]]
        .map(|links| step(&links));
    for (centre, poses) in &chains {
        assert!((centre - apart).norm() < ROUNDING_M, "{centre} {apart}");
        for (pose, other) in poses.iter().zip(&chains[0].1) {
            // Sweeps push in the order of the units that hang.
            assert!((pose.translation.vector - other.translation.vector).norm() < 2e-3);
            assert!(pose.rotation.angle_to(&other.rotation) < 0.02);
        }
    }
}

#[test]
fn what_nothing_moves_stays_and_carries_the_others() {
    for (roles, links) in [
        ([Role::Driven, Role::Free, Role::Free, Role::Free], [(1, 0), (2, 1), (3, 2)]),
        ([Role::Free, Role::Free, Role::Fixed, Role::Free], [(1, 0), (2, 1), (3, 2)]),
        ([Role::Free, Role::Driven, Role::Driven, Role::Free], [(1, 0), (2, 1), (3, 2)]),
    ] {
        with_scene(|simulator| {
            let ids = row(simulator, &roles);
            let links = links.map(|(unit, parent)| joint(ids[unit], ids[parent]));
            links.iter().for_each(|joint| simulator.join(joint).unwrap());
            for step in 1..=8 {
                let mut targets = Vec::new();
                for (number, role) in roles.iter().enumerate() {
                    let x = 0.4 * number as f32;
                    let z = if *role == Role::Driven { 0.6 + 0.01 * step as f32 } else { 0.6 };
                    if *role == Role::Driven {
                        simulator.drive(ids[number], &at(x, 0.0, z)).unwrap();
                    }
                    targets.push(at(x, 0.0, z));
                }
                simulator.step().unwrap();
                assert!(apart(simulator) < ROUNDING_M, "{roles:?} step {step}");
                for (number, unit) in simulator.units().enumerate() {
                    if unit.role() != Role::Free {
                        let moved =
                            unit.pose().translation.vector - targets[number].translation.vector;
                        assert!(moved.norm() < 1e-6, "{roles:?} {number} {moved}");
                    }
                }
            }
        });
    }
}

/// A star between two that are held: each arm hangs from the nearest, and what cannot be met stays open.
#[test]
fn between_two_that_are_held_a_joint_may_stay_open() {
    with_scene(|simulator| {
        let ids = row(simulator, &[Role::Driven, Role::Free, Role::Driven]);
        simulator.join(&joint(ids[1], ids[0])).unwrap();
        simulator.join(&joint(ids[2], ids[1])).unwrap();
        simulator.drive(ids[2], &at(1.2, 0.0, 0.6)).unwrap();
        simulator.step().unwrap();
        let gaps: Vec<_> = simulator
            .joints()
            .map(|joint| {
                let own = simulator.pose(joint.unit).unwrap() * joint.pivot;
                (own - simulator.pose(joint.parent).unwrap() * joint.parent_pivot).norm()
            })
            .collect();
        assert!(gaps[0] < ROUNDING_M && gaps[1] > 0.2, "{gaps:?}");
        assert_eq!(simulator.pose(ids[2]).unwrap(), at(1.2, 0.0, 0.6));
    });
}

#[test]
fn joints_go_with_their_units_and_scenes() {
    with_scene(|simulator| {
        let ids = row(simulator, &[Role::Free; 4]);
        let joints = [joint(ids[1], ids[0]), joint(ids[2], ids[1]), joint(ids[3], ids[2])];
        joints.iter().for_each(|joint| simulator.join(joint).unwrap());
        simulator.remove(ids[0]).unwrap();
        assert_eq!(simulator.joints().collect::<Vec<_>>(), joints[1..]);
        simulator.step().unwrap();
        assert!(apart(simulator) < ROUNDING_M);
        assert_eq!(simulator.unjoin(ids[2]), Ok(Some(joints[1])));
        assert_eq!(simulator.unjoin(ids[2]), Ok(None));
        // Another parent in place of the first.
        let other = joint(ids[3], ids[1]);
        simulator.join(&other).unwrap();
        assert_eq!(simulator.joints().collect::<Vec<_>>(), [other]);
        simulator.remove(ids[1]).unwrap();
        assert_eq!(simulator.joints().count(), 0);
        simulator.join(&joints[2]).unwrap();
        let points = bar();
        let still = rigidformer_core::Posed {
            unit: Unit::new(&points, WOOD),
            previous: at(0.0, 0.0, 0.6),
            current: at(0.0, 0.0, 0.6),
        };
        simulator.observe_poses(DT_S, [still, still]).unwrap();
        assert_eq!(simulator.joints().count(), 0);
    });
}

#[test]
fn joints_that_cannot_be_are_refused() {
    with_scene(|simulator| {
        let ids = row(simulator, &[Role::Free; 4]);
        let good = [joint(ids[1], ids[0]), joint(ids[2], ids[1])];
        good.iter().for_each(|joint| simulator.join(joint).unwrap());
        let nobody = UnitId::from_bits(77);
        let no_such = JoinError::NoSuchUnit { id: nobody };
        let circle = |id, parent| JoinError::Circle { id, parent };
        let far = Point3::new(0.0, 2e6, 0.0);
        for (joint, error) in [
            (joint(nobody, ids[0]), no_such),
            (joint(ids[3], nobody), no_such),
            (joint(ids[3], ids[3]), circle(ids[3], ids[3])),
            (joint(ids[0], ids[2]), circle(ids[0], ids[2])),
            (joint(ids[1], ids[2]), circle(ids[1], ids[2])),
            (
                Joint { pivot: Point3::new(f32::NAN, 0.0, 0.0), ..joint(ids[3], ids[0]) },
                JoinError::BadPivot { id: ids[3] },
            ),
            (
                Joint { parent_pivot: far, ..joint(ids[3], ids[0]) },
                JoinError::BadPivot { id: ids[3] },
            ),
        ] {
            assert_eq!(simulator.join(&joint), Err(error), "{error}");
            assert_eq!(simulator.joints().collect::<Vec<_>>(), good, "{error}");
        }
        assert_eq!(simulator.unjoin(nobody), Err(no_such));
        assert!(circle(ids[0], ids[2]).to_string().contains("the other way round"));
    });
}

/// A scene with a chain of three and a bar alone, joined or not; the bits of each step, of every copy.
fn of_world(engine: Engine, model: &LoadedModel, copies: usize, joined: bool) -> Vec<Vec<u32>> {
    let limits = Limits { units: 4, points: 32 };
    let mut world = World::on(engine, model, limits, copies).unwrap();
    world.edit(|simulator| {
        simulator.set_dt(DT_S).unwrap();
        let ids = row(simulator, &[Role::Free; 4]);
        if joined {
            simulator.join(&joint(ids[2], ids[1])).unwrap();
            simulator.join(&joint(ids[1], ids[0])).unwrap();
        }
        assert_eq!(simulator.replicate(copies), copies);
    });
    let mut steps = vec![Vec::new(); copies];
    for _ in 0..STEPS {
        world.step_copies(&mut |_, outcome| assert!(outcome.is_ok())).unwrap();
        for (copy, bits) in steps.iter_mut().enumerate() {
            for number in 0..4 {
                let pose = world.simulator().unit(copy * 4 + number).unwrap().internal_pose();
                bits.extend(pose.rotation.iter().chain(&pose.centre).map(|v| v.to_bits()));
            }
        }
    }
    steps
}

#[test]
fn bits_are_the_same_for_kernels_threads_and_copies() {
    for bytes in [rigidformer_weights::EDGE, rigidformer_weights::NANO] {
        let model = LoadedModel::embedded("model", bytes).unwrap();
        let alone = with_simulator(bytes, 64, |simulator| {
            simulator.set_dt(DT_S).unwrap();
            let ids = row(simulator, &[Role::Free; 4]);
            simulator.join(&joint(ids[1], ids[0])).unwrap();
            simulator.join(&joint(ids[2], ids[1])).unwrap();
            let step = |_| {
                simulator.step_on(Serial(Portable), &mut rigidformer_core::NoTrace).unwrap();
                bits(simulator)
            };
            (0..STEPS).flat_map(step).collect::<Vec<_>>()
        });
        for threads in [1, 2] {
            for kernel in [Kernel::Portable, Kernel::chosen().unwrap()] {
                let engine = Engine { kernel, ..Engine::new().unwrap() };
                let engine = if threads == 1 { engine.single() } else { engine };
                for copies in [1, 3] {
                    for copy in of_world(engine, &model, copies, true) {
                        assert_eq!(copy, alone, "{kernel:?} {threads} {copies}");
                    }
                }
            }
        }
    }
}

/// Joints change nothing of units that have none, and none of them without joints.
#[test]
fn units_alone_keep_their_bits() {
    let model = LoadedModel::embedded("edge", rigidformer_weights::EDGE).unwrap();
    let engine = Engine::new().unwrap();
    let (joined, alone) = (of_world(engine, &model, 1, true), of_world(engine, &model, 1, false));
    let fourth = |steps: &[Vec<u32>]| steps[0].chunks(48).next().map(|step| step[36..].to_vec());
    assert_eq!(fourth(&joined), fourth(&alone));
    assert_ne!(joined, alone);
    let undone = with_scene(|simulator| {
        let ids = row(simulator, &[Role::Free; 4]);
        simulator.join(&joint(ids[1], ids[0])).unwrap();
        simulator.unjoin(ids[1]).unwrap();
        (0..STEPS)
            .flat_map(|_| {
                simulator.step().unwrap();
                bits(simulator)
            })
            .collect::<Vec<_>>()
    });
    assert_eq!(undone, alone[0]);
}
