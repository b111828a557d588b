//! Units that diverge, held while the others go on.
#![allow(missing_docs, clippy::unwrap_used, clippy::expect_used, clippy::panic)]

use nalgebra::{Isometry3, Point3, UnitQuaternion, Vector3};
use rigidformer_core::{
    EditError, Limits, Physics, Posed, Role, Simulator, StepError, Unit, UnitId,
};
use rigidformer_runtime::engine::Engine;
use rigidformer_runtime::kernels::Kernel;
use rigidformer_runtime::models::LoadedModel;
use rigidformer_runtime::threads::Threads;
use rigidformer_runtime::world::World;
use rigidformer_tests::{packed_model, with_simulator};
use rigidformer_weights::{AlignedBuffer, ModelFile, ModelWriter, TensorData};

const DT_S: f32 = 1.0 / 48.0;
const STEPS: usize = 30;
const WOOD: Physics = Physics { mass_kg: 0.5, friction: 0.6, restitution: 0.3 };
/// The number of the unit that is poisoned.
const POISONED: usize = 1;

fn cube() -> Vec<Point3<f32>> {
    let corner = |i: i32, bit: i32| if i & bit == 0 { -0.1 } else { 0.1 };
    (0..8).map(|i| Point3::new(corner(i, 1), corner(i, 2), corner(i, 4))).collect()
}

fn at(x: f32, y: f32, z: f32) -> Isometry3<f32> {
    Isometry3::translation(x, y, z)
}

/// Where the poisoned unit stays: between the others, which fall onto it.
fn place() -> Isometry3<f32> {
    at(0.3, 0.0, 0.1)
}

/// What a broken sensor says of it a step ago: a next step would be beyond all coordinates.
fn nonsense() -> Isometry3<f32> {
    at(-9.9e5, -9.9e5, 0.1)
}

/// Five cubes that fall on each other.
fn observe(simulator: &mut Simulator<'_, '_>, role: Role) -> Vec<UnitId> {
    let points = cube();
    let units = (0..5).map(|number| {
        let turn = UnitQuaternion::from_scaled_axis(Vector3::new(0.1, 0.2, 0.3) * number as f32);
        let pose = Isometry3::from_parts(
            Vector3::new(0.15 * number as f32, 0.01, 0.25 + 0.22 * (number % 3) as f32).into(),
            turn,
        );
        let (pose, role) = match number {
            POISONED => (place(), role),
            _ => (pose, Role::Free),
        };
        Posed { unit: Unit::new(&points, WOOD).role(role), previous: pose, current: pose }
    });
    simulator.observe_poses(DT_S, units).unwrap();
    simulator.units().map(|unit| unit.id()).collect()
}

/// Bits of all poses of a copy.
fn bits(simulator: &Simulator<'_, '_>, copy: usize) -> Vec<u32> {
    let count = simulator.len();
    let poses =
        (copy * count..(copy + 1) * count).map(|n| simulator.unit(n).unwrap().internal_pose());
    let numbers =
        poses.flat_map(|pose| [pose.rotation.as_slice(), pose.centre.as_slice()].concat());
    numbers.map(f32::to_bits).collect()
}

/// The bits of all steps with the unit as scenery.
fn beside_scenery(model: &[u8]) -> Vec<Vec<u32>> {
    with_simulator(model, 5 * 8, |simulator| {
        observe(simulator, Role::Fixed);
        let mut step = |_| {
            simulator.step().unwrap();
            bits(simulator, 0)
        };
        (0..STEPS).map(&mut step).collect()
    })
}

#[test]
fn a_unit_that_is_poisoned_in_every_step_is_scenery_for_the_others_to_the_bit() {
    for model in [rigidformer_weights::EDGE, rigidformer_weights::NANO] {
        let expected = beside_scenery(model);
        with_simulator(model, 5 * 8, |simulator| {
            let ids = observe(simulator, Role::Free);
            simulator.set_quarantine(true);
            for (step, expected) in expected.iter().enumerate() {
                simulator.set_poses(ids[POISONED], &nonsense(), &place()).unwrap();
                assert!(!simulator.get(ids[POISONED]).unwrap().is_quarantined());
                assert_eq!(simulator.step().unwrap().quarantined_units, 1);
                assert!(bits(simulator, 0) == *expected, "step {step}");
                let unit = simulator.get(ids[POISONED]).unwrap();
                assert!(unit.is_quarantined());
                assert_eq!(unit.role(), Role::Free, "its caller's");
            }
            // It stays so until it is given a pose; then it falls.
            simulator.set_quarantine(false);
            assert_eq!(simulator.step().unwrap().quarantined_units, 1);
            let above = at(0.3, 2.0, 2.0);
            simulator.set_poses(ids[POISONED], &above, &above).unwrap();
            assert_eq!(simulator.step().unwrap().quarantined_units, 0);
            assert!(simulator.pose(ids[POISONED]).unwrap().translation.z < 2.0);
        });
    }
}

#[test]
fn without_quarantine_the_step_fails_and_changes_nothing() {
    with_simulator(rigidformer_weights::NANO, 5 * 8, |simulator| {
        let ids = observe(simulator, Role::Free);
        simulator.set_poses(ids[POISONED], &nonsense(), &place()).unwrap();
        let before = bits(simulator, 0);
        assert!(!simulator.quarantine());
        assert_eq!(simulator.step(), Err(StepError::Diverged { unit: POISONED }));
        assert!(bits(simulator, 0) == before);
        assert!(!simulator.get(ids[POISONED]).unwrap().is_quarantined());
    });
}

#[test]
fn a_step_that_fails_otherwise_holds_nothing() {
    let model = packed_model("tiny-carried");
    assert!(ModelFile::parse(&model).unwrap().config().command_size > 0);
    with_simulator(&model, 5 * 8, |simulator| {
        let ids = observe(simulator, Role::Free);
        simulator.set_poses(ids[POISONED], &nonsense(), &place()).unwrap();
        simulator.set_quarantine(true);
        assert!(matches!(simulator.step(), Err(StepError::NoCommand { .. })));
        let unit = simulator.get(ids[POISONED]).unwrap();
        assert!(!unit.is_quarantined());
        assert_eq!(unit.role(), Role::Free);
    });
}

/// The same f32 model, whose head says far too much.
fn louder(model: &[u8]) -> AlignedBuffer {
    let buffer = AlignedBuffer::copy_of(model);
    let file = ModelFile::parse(&buffer).unwrap();
    let loud: Vec<Vec<f32>> = file
        .tensors()
        .map(|tensor| match tensor.data {
            TensorData::F32(values) if tensor.name.starts_with("anchors.head.1") => {
                values.iter().map(|value| value * 1e12).collect()
            }
            _ => vec![],
        })
        .collect();
    let mut writer = ModelWriter::new("loud", *file.config());
    for (tensor, loud) in file.tensors().zip(&loud) {
        let data = if loud.is_empty() { tensor.data } else { TensorData::F32(loud) };
        writer = writer.tensor(tensor.name, tensor.shape, data);
    }
    AlignedBuffer::copy_of(&writer.finish().unwrap())
}

#[test]
fn units_that_the_network_sends_nowhere_are_held_and_the_others_fly_on() {
    let loud = louder(&packed_model("tiny"));
    let quiet = packed_model("tiny");
    let points = cube();
    let fly = |model: &[u8], both: bool| {
        with_simulator(model, 3 * 8, |simulator| {
            let unit = |at: Isometry3<f32>| Posed {
                unit: Unit::new(&points, WOOD),
                previous: at,
                current: at,
            };
            // Two touch, one is far from all.
            let all =
                [unit(at(0.0, 0.0, 0.101)), unit(at(0.0, 0.0, 0.31)), unit(at(50.0, 0.0, 40.0))];
            let units = if both { &all[..] } else { &all[2..] };
            simulator.set_quarantine(true);
            simulator.set_command(&[0.5; 3]).unwrap();
            simulator.observe_poses(DT_S, units).unwrap();
            let start = bits(simulator, 0);
            let mut held = Vec::new();
            for _ in 0..5 {
                held.push(simulator.step().unwrap().quarantined_units);
            }
            (held, start, bits(simulator, 0))
        })
    };
    let (held, start, end) = fly(&loud, true);
    assert!(held[0] >= 1 && held.is_sorted(), "{held:?}");
    for number in 0..held[0].min(1) as usize {
        assert!(start[number * 12..][..12] == end[number * 12..][..12], "where it was");
    }
    let (none, _, alone) = fly(&quiet, false);
    assert_eq!(none, [0; 5]);
    assert!(end[24..] == alone, "what flies alone flies exactly");
}

#[test]
fn a_copy_that_is_poisoned_leaves_the_other_copies_alone() {
    for model in [rigidformer_weights::EDGE, rigidformer_weights::NANO] {
        let expected = beside_scenery(model);
        let free: Vec<Vec<u32>> = with_simulator(model, 5 * 8, |simulator| {
            observe(simulator, Role::Free);
            let mut step = |_| {
                simulator.step().unwrap();
                bits(simulator, 0)
            };
            (0..STEPS).map(&mut step).collect()
        });
        let loaded = LoadedModel::copy_of("model", model).unwrap();
        let portable = Engine { kernel: Kernel::Portable, threads: Threads::ONE };
        for engine in [portable, Engine::new().unwrap()] {
            let limits = Limits { units: 5, points: 5 * 8 };
            let mut world = World::on(engine, &loaded, limits, 3).unwrap();
            let ids = world.edit(|simulator| {
                let ids = observe(simulator, Role::Free);
                simulator.set_quarantine(true);
                assert_eq!(simulator.replicate(3), 3);
                simulator.set_poses_in(1, ids[POISONED], &nonsense(), &place()).unwrap();
                ids
            });
            assert_eq!(ids.len(), 5);
            for (expected, free) in expected.iter().zip(&free) {
                let mut held = Vec::new();
                let mut note = |_, report: Result<rigidformer_core::StepReport, StepError>| {
                    held.push(report.unwrap().quarantined_units);
                };
                world.step_copies(&mut note).unwrap();
                assert_eq!(held, [0, 1, 0]);
                let simulator = world.simulator();
                assert!(bits(simulator, 0) == *free && bits(simulator, 2) == *free);
                assert!(bits(simulator, 1) == *expected);
            }
        }
    }
}

#[test]
fn what_a_caller_may_do_to_a_unit_in_quarantine() {
    with_simulator(rigidformer_weights::NANO, 6 * 8, |simulator| {
        let ids = observe(simulator, Role::Free);
        let id = ids[POISONED];
        simulator.set_quarantine(true);
        let poison = |simulator: &mut Simulator<'_, '_>| {
            simulator.set_poses(id, &nonsense(), &place()).unwrap();
            assert_eq!(simulator.step().unwrap().quarantined_units, 1);
        };
        poison(simulator);
        // Nothing drives it, and another role ends quarantine.
        assert_eq!(simulator.drive(id, &place()), Err(EditError::NotDriven { id }));
        simulator.set_role(id, Role::Free).unwrap();
        assert!(simulator.get(id).unwrap().is_quarantined());
        simulator.set_role(id, Role::Driven).unwrap();
        assert!(!simulator.get(id).unwrap().is_quarantined());
        simulator.drive(id, &place()).unwrap();
        assert_eq!(simulator.step().unwrap().quarantined_units, 0);
        simulator.set_role(id, Role::Free).unwrap();
        poison(simulator);
        simulator.set_physics(id, WOOD).unwrap();
        simulator.set_dt(DT_S * 2.0).unwrap();
        simulator.remove(ids[0]).unwrap();
        assert_eq!(simulator.step().unwrap().quarantined_units, 1);
        simulator.remove(id).unwrap();
        assert_eq!(simulator.step().unwrap().quarantined_units, 0);
    });
}
