//! What a robot's controller gets wrong is said, and the robot walks on as if nothing had happened.
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)]

use std::path::Path;

use nalgebra::{Isometry3, Point3, Vector3};
use rigidformer_core::{
    CommandError, EditError, JoinError, Joint, Limits, ObserveError, Posed, Role, Simulator,
    StepError, StepReport, UnitId,
};
use rigidformer_runtime::engine::Engine;
use rigidformer_runtime::futures::{BatchError, BatchSimulator, Start};
use rigidformer_runtime::models::LoadedModel;
use rigidformer_runtime::pivots::Pivot;
use rigidformer_runtime::world::World;
use rigidformer_tests::bits::Fnv1a;
use rigidformer_tests::walk::Walk;
use rigidformer_weights::{AlignedBuffer, G1};

const HAND: usize = 30;

fn file() -> AlignedBuffer {
    let root = Path::new(env!("CARGO_MANIFEST_DIR"));
    AlignedBuffer::read(&root.join("../firmware-sim/firmware/scenes/walk.bin")).unwrap()
}

fn model() -> LoadedModel {
    LoadedModel::embedded("g1", G1).unwrap().for_host().unwrap()
}

/// A hash over four steps of the walk; the right hand is driven ahead. `fault` comes before the second step.
fn walked(fault: impl FnOnce(&mut World, UnitId, &Isometry3<f32>)) -> u64 {
    let file = file();
    let walk = Walk::read(&file).unwrap();
    let mut world = World::new(&model(), Limits { units: 31, points: 31 * 32 }).unwrap();
    let mut parts: Vec<Posed<'_>> = walk.links().collect();
    parts[HAND].unit.role = Role::Driven;
    let hand = world.edit(|simulator| {
        simulator.set_planes(&[walk.ground()]).unwrap();
        simulator.observe_poses(walk.seconds(), &parts).unwrap();
        simulator.unit(HAND).unwrap().id()
    });
    let (mut hash, mut fault) = (Fnv1a::default(), Some(fault));
    for step in 0..4 {
        let pose = parts[HAND].current * Isometry3::translation(0.1 * (step + 1) as f32, 0.0, 0.0);
        world.edit(|simulator| {
            walk.prepare(simulator, step).unwrap();
            simulator.drive(hand, &pose).unwrap();
        });
        if let (1, Some(fault)) = (step, fault.take_if(|_| step == 1)) {
            fault(&mut world, hand, &pose);
        }
        world.step().unwrap();
        world.edit(|simulator| simulator.units().for_each(|unit| hash.add_unit(&unit)));
    }
    hash.0
}

#[test]
fn faults_are_refused_and_change_nothing() {
    let undisturbed = walked(|_, _, _| ());
    let commanded = walked(|world, _, _| {
        world.edit(|simulator| {
            let short = simulator.set_command(&[0.5, 0.0]).unwrap_err();
            assert_eq!(short, CommandError::Size { found: 2, expected: 3 });
            assert!(matches!(
                simulator.set_command(&[0.5, f32::NAN, 0.0]),
                Err(CommandError::NotFinite { .. })
            ));
        });
    });
    let jumped = walked(|world, hand, pose| {
        world.edit(|simulator| {
            for far in [34.0, -500.0] {
                let there = Isometry3::from_parts(
                    (pose.translation.vector + Vector3::x() * far).into(),
                    pose.rotation,
                );
                let refused = simulator.drive(hand, &there).unwrap_err();
                assert!(matches!(refused, EditError::Jump { .. }), "{refused}");
                assert!(refused.to_string().contains("100 m/s"), "{refused}");
            }
            let nowhere = Isometry3::translation(f32::NAN, 0.0, 0.0);
            assert!(matches!(
                simulator.drive(hand, &nowhere),
                Err(EditError::Unit(ObserveError::BadPose { .. }))
            ));
        });
    });
    let joined = walked(|world, hand, _| {
        world.edit(|simulator| {
            let gone = UnitId::from_bits(7777);
            let zero = Point3::origin();
            let joint = Joint::ball(hand, gone, zero, zero);
            assert_eq!(simulator.join(&joint).unwrap_err(), JoinError::NoSuchUnit { id: gone });
        });
    });
    assert_eq!([commanded, jumped, joined], [undisturbed; 3]);
}

/// Copies that move up take their commands along: they go on as a scene of one copy under the same command.
#[test]
fn copies_that_are_kept_keep_their_commands() {
    let file = file();
    let walk = Walk::read(&file).unwrap();
    let parts: Vec<Posed<'_>> = walk.links().collect();
    let (model, limits) = (model(), Limits { units: 31, points: 31 * 32 });
    let commands = [[0.5, 0.0, 0.0], [0.0, 0.3, 0.0], [0.2, 0.0, 0.6]];
    let observe = |simulator: &mut Simulator<'_, '_>, command: &[f32]| {
        simulator.set_planes(&[walk.ground()]).unwrap();
        simulator.observe_poses(walk.seconds(), &parts).unwrap();
        simulator.set_command(command).unwrap();
    };
    let stepped = |world: &mut World| {
        for _ in 0..2 {
            let mut note = |_, report: Result<StepReport, StepError>| {
                report.unwrap();
            };
            world.step_copies(&mut note).unwrap();
        }
        let simulator = world.simulator();
        let units = 0..simulator.len() * simulator.copies();
        units.map(|unit| simulator.unit(unit).unwrap().pose()).collect::<Vec<_>>()
    };
    let alone = commands.map(|command| {
        let mut world = World::new(&model, limits).unwrap();
        world.edit(|simulator| observe(simulator, &command));
        stepped(&mut world)
    });
    assert!(alone[0] != alone[1] && alone[1] != alone[2]);
    let mut world = World::on(Engine::new().unwrap(), &model, limits, 3).unwrap();
    world.edit(|simulator| {
        observe(simulator, &commands[0]);
        assert_eq!(simulator.replicate(3), 3);
        for (copy, command) in commands.iter().enumerate() {
            assert!(simulator.set_copy_command(copy, command).unwrap());
        }
        simulator.retain_copies(|copy| copy != 0);
        assert_eq!(simulator.copies(), 2);
    });
    assert!(stepped(&mut world) == [alone[1].as_slice(), &alone[2]].concat());
}

#[test]
fn a_part_that_is_missing_is_named() {
    let file = file();
    let walk = Walk::read(&file).unwrap();
    let parts: Vec<Posed<'_>> = walk.links().collect();
    let planes = [walk.ground()];
    let pivots: Vec<Pivot> = walk
        .joints()
        .map(|([unit, parent], [pivot, parent_pivot])| {
            let (unit, parent) = (unit as usize, parent as usize);
            Pivot { unit, parent, pivot, parent_pivot, residual_m: 0.0 }
        })
        .collect();
    let simulator = BatchSimulator::new(Engine::new().unwrap(), &model());
    let run = |units: &[Posed<'_>]| {
        let start = Start {
            dt_s: walk.seconds(),
            units,
            command: &[0.5, 0.0, 0.0],
            planes: Some(&planes),
            pivots: &pivots,
            ..Start::default()
        };
        let mut out = vec![Isometry3::identity(); units.len()];
        simulator.run(&start, 1, &(), &mut out).map(|_| out)
    };
    assert!(run(&parts).is_ok());
    let refused = run(&parts[..HAND]).unwrap_err();
    assert!(matches!(refused, BatchError::Join(JoinError::NoSuchUnit { .. })), "{refused}");
    let mut cut = parts.clone();
    cut[4].unit.points = &cut[4].unit.points[..3];
    let refused = run(&cut).unwrap_err();
    assert!(refused.to_string().contains("unit 4"), "{refused}");
}
