//! Futures, copies and units out of play that begin with a world as it is.

use nalgebra::{Isometry3, Point3, Vector3};
use rigidformer_runtime::core::{
    EditError, Joint, Limits, Physics, Plane, Posed, Role, SnapshotError, Unit, UnitId,
};
use rigidformer_runtime::engine::Engine;
use rigidformer_runtime::futures::{
    BatchError, BatchSimulator, ChangeError, CopyError, Start, StartState,
};
use rigidformer_runtime::memory::TooLarge;
use rigidformer_runtime::models::LoadedModel;
use rigidformer_runtime::threads::Threads;
use rigidformer_runtime::world::{Snapshot, World};

const STEPS: usize = 8;
const PHYSICS: Physics = Physics { mass_kg: 1.0, friction: 0.4, restitution: 0.3 };

fn cube() -> Vec<Point3<f32>> {
    let corner = |i: usize, bit| if i & bit == 0 { -0.1 } else { 0.1 };
    (0..8).map(|i| Point3::new(corner(i, 1), corner(i, 2), corner(i, 4))).collect()
}

fn at(x: f32, z: f32) -> Isometry3<f32> {
    Isometry3::translation(x, 0.0, z)
}

fn engine(threads: usize) -> Engine {
    Engine { threads: Threads::new(threads), ..Engine::new().unwrap() }
}

fn file(name: &str) -> LoadedModel {
    let folder = concat!(env!("CARGO_MANIFEST_DIR"), "/../weights/models/");
    LoadedModel::copy_of(name, &std::fs::read(format!("{folder}{name}")).unwrap()).unwrap()
}

fn empty(model: &LoadedModel) -> World {
    let mut world = World::on(engine(1), model, Limits { units: 16, points: 512 }, 1).unwrap();
    world.set_dt(1.0 / 24.0).unwrap();
    world
}

/// A hand with two links on a slope, a shelf, and a loose cube; the hand is under way.
fn joints() -> World {
    let mut world = empty(&LoadedModel::embedded("edge", rigidformer_weights::EDGE).unwrap());
    let points = cube();
    let unit = Unit::new(&points, PHYSICS);
    let slope = Plane {
        normal: Vector3::new(0.6, 0.0, 0.8),
        offset_m: -0.2,
        friction: 0.5,
        restitution: 0.2,
    };
    world.set_planes(&[slope]).unwrap();
    world.set_gravity(Vector3::new(0.0, 1.0, -9.0)).unwrap();
    let mut above = world.add(&unit.role(Role::Driven).body(1), &at(0.0, 1.2)).unwrap();
    let hand = above;
    for place in 1..3 {
        let link = world.add(&unit.body(1), &at(0.2 * place as f32, 1.2)).unwrap();
        let (pivot, parent_pivot) = (Point3::new(-0.1, 0.0, 0.0), Point3::new(0.1, 0.0, 0.0));
        let joint = Joint::ball(link, above, pivot, parent_pivot);
        world.edit(|simulator| simulator.join(&joint)).unwrap();
        above = link;
    }
    world.add(&unit.role(Role::Fixed), &at(1.0, 0.3)).unwrap();
    world.add(&unit, &at(1.05, 0.6)).unwrap();
    for step in 1..4 {
        world.drive(hand, &at(0.01 * step as f32, 1.2)).unwrap();
        world.step().unwrap();
    }
    world.drive(hand, &at(0.1, 1.25)).unwrap();
    world
}

/// Two cubes that a bond holds, two that it held, and one beside them.
fn bonds() -> World {
    let mut world = empty(&file("fragments.rfm"));
    let points = cube();
    let unit = Unit::new(&points, PHYSICS);
    let ids: Vec<UnitId> = (0..4)
        .map(|place| world.add(&unit.body(2), &at(0.2 * place as f32, 0.5)).unwrap())
        .collect();
    world.add(&unit, &at(0.1, 0.9)).unwrap();
    world.edit(|simulator| {
        simulator.bond(&[[ids[0], ids[1]], [ids[1], ids[2]], [ids[2], ids[3]]]).unwrap();
        simulator.break_bond([ids[2], ids[3]]).unwrap();
    });
    for _ in 0..3 {
        world.step().unwrap();
    }
    world
}

/// (steps, units) where all is after each step.
fn rollout(world: &mut World) -> Vec<Isometry3<f32>> {
    let mut poses = Vec::new();
    for _ in 0..STEPS {
        world.step().unwrap();
        poses.extend(world.simulator().units().map(|unit| unit.pose()));
    }
    poses
}

#[test]
fn futures_of_a_world_have_its_bits() {
    for mut world in [joints(), bonds()] {
        let (model, state, before) =
            (world.model().clone(), world.start().unwrap(), world.snapshot());
        let start = Start::of(&state);
        assert_eq!((start.count(), start.dt_s), (5, 1.0 / 24.0));
        assert_eq!(state.snapshot(), &before);
        for threads in [1, 3] {
            let simulator = BatchSimulator::new(engine(threads), &model).with_units_a_chunk(15);
            let mut poses = vec![Isometry3::identity(); 7 * STEPS * 5];
            simulator.run(&start, STEPS, &(), &mut poses).unwrap();
            let mut copies = simulator.copies(&start, 7).unwrap();
            let alone = rollout(&mut world);
            for future in poses.chunks_exact(alone.len()) {
                assert_eq!(future, alone);
            }
            for step in 0..STEPS {
                copies.step(&|_, _| Ok(())).unwrap();
                for unit in 0..5 {
                    assert_eq!(copies.pose(6, unit), Some(alone[step * 5 + unit]));
                }
            }
            world.restore(&before).unwrap();
        }
        let units = BatchSimulator::new(engine(1), &model).units_of(&start).unwrap();
        let found = world.simulator().units().map(|unit| (unit.role(), 1.0, unit.pose()));
        assert_eq!(units, found.collect::<Vec<_>>());
    }
}

#[test]
fn what_a_start_says_besides_counts_where_it_differs() {
    let mut world = joints();
    let (model, state) = (world.model().clone(), world.start().unwrap());
    let ground = [Plane { normal: Vector3::z(), offset_m: 0.1, friction: 0.1, restitution: 0.0 }];
    let start = Start {
        dt_s: 1.0 / 48.0,
        planes: Some(&ground),
        gravity_m_s2: Some(Vector3::new(0.0, 0.0, -1.0)),
        ..Start::of(&state)
    };
    let mut poses = vec![Isometry3::identity(); STEPS * 5];
    BatchSimulator::new(engine(1), &model).run(&start, STEPS, &(), &mut poses).unwrap();
    world.set_planes(&ground).unwrap();
    world.set_gravity(Vector3::new(0.0, 0.0, -1.0)).unwrap();
    world.set_dt(1.0 / 48.0).unwrap();
    assert_eq!(poses, rollout(&mut world));
}

#[test]
fn states_that_cannot_be_are_refused() {
    let world = joints();
    let state = world.start().unwrap();
    let simulator = BatchSimulator::new(engine(1), world.model());
    let mut out = vec![Isometry3::identity(); 30];
    let mut error = |state: &StartState| {
        out.truncate(out.len() / state.units().max(1) * state.units().max(1));
        simulator.run(&Start::of(state), 1, &(), &mut out).unwrap_err()
    };
    let of = |snapshot: &Snapshot, units, points| {
        StartState::new(snapshot.clone(), Limits { units, points }, 1.0 / 24.0)
    };
    let found = error(&of(state.snapshot(), 6, 512));
    assert_eq!(found, BatchError::StateUnits { found: 5, said: 6 });
    let few = SnapshotError::TooManyUnits { found: 5, limit: 3 };
    assert_eq!(error(&of(state.snapshot(), 3, 512)), BatchError::State(few));
    let points = error(&of(state.snapshot(), 5, 39));
    assert!(matches!(points, BatchError::State(SnapshotError::TooManyPoints { .. })), "{points:?}");
    let none = error(&of(&Snapshot::from_bytes(vec![7; 40]), 5, 40));
    assert_eq!(none, BatchError::State(SnapshotError::NotASnapshot));
    let other = bonds().start().unwrap();
    assert_eq!(error(&other), BatchError::State(SnapshotError::OtherModel));
    // Two copies are no world.
    let mut two = World::on(engine(1), world.model(), Limits { units: 5, points: 40 }, 2).unwrap();
    two.restore(state.snapshot()).unwrap();
    two.edit(|simulator| simulator.replicate(2));
    assert!(matches!(error(&of(&two.snapshot(), 5, 40)), BatchError::State(_)));
    assert_eq!(two.start().unwrap(), state);
    let nothing = World::new(world.model(), Limits { units: 2, points: 16 }).unwrap();
    assert!(simulator.run(&Start::of(&nothing.start().unwrap()), 1, &(), &mut []).is_err());
}

/// What a copy does without a unit is what the scene does that never had it, where the network sees what is near.
#[test]
fn a_unit_out_of_play_is_not_there() {
    for (name, bytes) in [("edge", rigidformer_weights::EDGE), ("nano", rigidformer_weights::NANO)]
    {
        let model = LoadedModel::embedded(name, bytes).unwrap();
        let points = cube();
        let unit = Unit::new(&points, PHYSICS);
        let shelf = unit.role(Role::Fixed);
        let posed = |unit, x, z| Posed { unit, previous: at(x, z + 0.01), current: at(x, z) };
        let all = [
            posed(unit, 0.0, 0.3),
            posed(unit, 0.05, 0.55),
            posed(shelf, -0.05, 0.1),
            posed(unit, 0.0, 0.8),
        ];
        let start = Start { dt_s: 1.0 / 24.0, units: &all, ..Start::default() };
        let simulator = BatchSimulator::new(engine(2), &model).with_units_a_chunk(12);
        let mut copies = simulator.copies(&start, 6).unwrap();
        let begun = copies.snapshot(0).unwrap();
        // Copy 1 has neither cube 1 nor the shelf, copy 4 all but the last.
        for (copy, unit) in [(1, 1), (1, 2), (4, 3)] {
            copies.edit(copy, |scene| scene.take_out(unit)).unwrap();
            assert_eq!((copies.pose(copy, unit), copies.velocity(copy, unit)), (None, None));
            assert_eq!(
                copies.edit(copy, |scene| Ok((scene.is_out(unit), scene.pose(unit)))),
                Ok((true, None))
            );
        }
        let without = |units: &[usize]| {
            let left: Vec<_> = units.iter().map(|unit| all[*unit]).collect();
            simulator.copies(&Start { units: &left, ..start }, 1).unwrap()
        };
        let (mut full, mut two, mut three) =
            (without(&[0, 1, 2, 3]), without(&[0, 3]), without(&[0, 1, 2]));
        for _ in 0..20 {
            for each in [&mut copies, &mut full, &mut two, &mut three] {
                assert!(each.step(&|_, _| Ok(())).unwrap().iter().all(Option::is_none));
            }
            for unit in 0..4 {
                assert_eq!(copies.pose(0, unit), full.pose(0, unit));
            }
            // The network of nano sees all units, and that one far away.
            if name == "nano" {
                assert!(copies.pose(1, 0).is_some() && copies.pose(1, 2).is_none());
                continue;
            }
            assert_eq!([copies.pose(1, 0), copies.pose(1, 3)], [two.pose(0, 0), two.pose(0, 1)]);
            for unit in 0..3 {
                assert_eq!(copies.pose(4, unit), three.pose(0, unit));
            }
        }
        // Kept and brought back.
        let state = copies.snapshot(1).unwrap();
        copies.reset(1).unwrap();
        assert_eq!(copies.snapshot(1).unwrap(), begun);
        copies.restore(5, &state).unwrap();
        assert_eq!(
            (copies.pose(5, 2), copies.edit(5, |scene| Ok(scene.is_out(0)))),
            (None, Ok(false))
        );
        copies.edit(5, |scene| scene.set_poses(1, &at(3.0, 2.0), &at(3.0, 2.0))).unwrap();
        copies.step(&|_, _| Ok(())).unwrap();
        let fallen = copies.pose(5, 1).unwrap().translation.z;
        assert!((1.97..1.995).contains(&fallen), "{fallen}");
        let missing = copies.edit(5, |scene| scene.take_out(4));
        assert!(matches!(
            missing,
            Err(CopyError::Change(ChangeError::NoSuchUnit { unit: 4, units: 4 }))
        ));
    }
}

#[test]
fn what_holds_together_stays_in_play() {
    let (hanging, bonded) = (joints(), bonds());
    for (world, bound) in [(&hanging, [0, 1, 2].as_slice()), (&bonded, &[0, 1, 2])] {
        let (model, state) = (world.model(), world.start().unwrap());
        let mut copies =
            BatchSimulator::new(engine(1), model).copies(&Start::of(&state), 2).unwrap();
        let before = copies.snapshot(1).unwrap();
        for unit in bound {
            let refused = copies.edit(1, |scene| scene.take_out(*unit));
            let is_why = matches!(
                refused,
                Err(CopyError::Change(
                    ChangeError::Other(_) | ChangeError::Unit(EditError::Bonded { .. })
                ))
            );
            assert!(is_why, "{refused:?}");
        }
        assert_eq!(copies.snapshot(1).unwrap(), before);
        copies.edit(1, |scene| scene.take_out(4)).unwrap();
        copies.step(&|_, _| Ok(())).unwrap();
        assert_eq!(copies.pose(1, 4), None);
    }
}

#[test]
fn copies_are_counted_before_they_are_made() {
    let world = joints();
    let state = world.start().unwrap();
    let start = Start::of(&state);
    let simulator = BatchSimulator::new(engine(1), world.model()).with_units_a_chunk(10);
    let two = World::bytes(engine(1), world.model(), state.limits(), 2).unwrap() as u64;
    assert!(simulator.clone().with_memory(3 * two).copies(&start, 6).is_ok());
    let refused = simulator.clone().with_memory(3 * two).copies(&start, 7).err();
    let error = TooLarge { needed: 4 * two, most: 3 * two };
    assert_eq!(refused, Some(BatchError::Memory { copies: 7, error }));
    let endless = simulator.copies(&start, usize::MAX).err();
    assert!(matches!(endless, Some(BatchError::Memory { .. })), "{endless:?}");
    assert_eq!(simulator.copies_until(&start, 6, &|| true).err(), Some(BatchError::Cancelled));
}
