//! Worlds: kept, moved to threads and changed between steps, always with the bits of a world that was made that way.

use std::path::Path;

use nalgebra::{Isometry3, Point3, Quaternion, Translation3, UnitQuaternion, Vector3};
use rigidformer_core::{
    EditError, Limits, ObserveError, Physics, Plane, Posed, Role, StepError, Unit, UnitId,
};
use rigidformer_evaluation::models::pack_bytes;
use rigidformer_runtime::engine::Engine;
use rigidformer_runtime::kernels::Kernel;
use rigidformer_runtime::models::LoadedModel;
use rigidformer_runtime::threads::Threads;
use rigidformer_runtime::world::World;

const DT_S: f32 = 10.0 / 240.0;
const RUBBER: Physics = Physics { mass_kg: 1.0, friction: 0.4, restitution: 0.3 };

fn edge() -> LoadedModel {
    LoadedModel::embedded("edge", rigidformer_weights::EDGE).unwrap()
}

/// An untrained model of the lab, packed here.
fn lab_model(name: &str) -> LoadedModel {
    let path = Path::new(env!("CARGO_MANIFEST_DIR"))
        .join(format!("../tests/data/{name}.model.safetensors"));
    let packed = pack_bytes(&path, &std::fs::read(&path).unwrap()).unwrap();
    LoadedModel::copy_of(name, &packed).unwrap()
}

fn single() -> Engine {
    Engine::new().unwrap().single()
}

/// A world on one thread whose steps take ten frames of the model.
fn world(model: &LoadedModel, units: usize, points: usize) -> World {
    let mut world = World::on(single(), model, Limits { units, points }, 1).unwrap();
    world.edit(|scene| scene.set_dt(DT_S)).unwrap();
    world
}

/// A lump about as large as a cube of 0.2 m: the first eight points are its corners.
fn lump(count: usize) -> Vec<Point3<f32>> {
    let point = |i: usize| {
        let reach = 0.1 / (1 + i / 8) as f32;
        let side = |bit: usize| if i & bit == 0 { -reach } else { reach };
        Point3::new(side(1), side(2), side(4) + 0.001 * i as f32)
    };
    (0..count).map(point).collect()
}

fn at(x: f32, y: f32, z: f32) -> Isometry3<f32> {
    Isometry3::translation(x, y, z)
}

/// Bits of where all units of all copies are.
fn bits(world: &World) -> Vec<u32> {
    let simulator = world.simulator();
    let units = (0..).map_while(|unit| simulator.unit(unit));
    let poses = units.map(|unit| unit.internal_pose());
    let numbers = |x: &f32| x.to_bits();
    poses
        .flat_map(|p| p.rotation.iter().chain(&p.centre).map(numbers).collect::<Vec<_>>())
        .collect()
}

/// What a refused call must not change, as text to the bit.
fn state(world: &World) -> String {
    let simulator = world.simulator();
    let units = (0..).map_while(|unit| simulator.unit(unit));
    let units: Vec<_> = units
        .map(|unit| (unit.id(), unit.role(), unit.body(), unit.physics(), unit.previous_pose()))
        .collect();
    let physics = (simulator.planes(), simulator.gravity_m_s2(), simulator.dt_s());
    format!("{:?} {units:?} {physics:?} {}", bits(world), simulator.copies())
}

/// A heap of so many lumps, the first of them driven.
fn heap(world: &mut World, count: usize) -> Vec<UnitId> {
    let ids = (0..count).map(|i| {
        let points = lump(8 + 5 * i);
        let role = if i == 0 { Role::Driven } else { Role::Free };
        let pose = at(0.05 * i as f32, 0.0, 0.11 + 0.21 * i as f32);
        world.add(&Unit::new(&points, RUBBER).role(role), &pose).unwrap()
    });
    ids.collect()
}

struct Robot {
    world: World,
    hand: UnitId,
}

impl Robot {
    fn new() -> Self {
        let mut world = world(&edge(), 3, 100);
        let hand = heap(&mut world, 3)[0];
        Robot { world, hand }
    }

    fn act(&mut self, steps: usize) -> Vec<u32> {
        for step in 0..steps {
            let x = self.world.pose(self.hand).unwrap().translation.x + 0.01 * step as f32;
            self.world.drive(self.hand, &at(x, 0.0, 0.11)).unwrap();
            self.world.step().unwrap();
        }
        bits(&self.world)
    }
}

#[test]
fn a_world_lives_in_a_struct_and_moves_to_a_thread() {
    let mut here = Robot::new();
    let expected = [here.act(3), here.act(3), here.act(3)];
    let mut robot = Robot::new();
    let first = robot.act(3);
    let (mut robot, second) = std::thread::spawn(move || {
        let found = robot.act(3);
        (robot, found)
    })
    .join()
    .unwrap();
    // Moved within memory too.
    let mut kept = Box::new(Robot::new());
    std::mem::swap(&mut *kept, &mut robot);
    assert_eq!([first, second, kept.act(3)], expected);
    assert_ne!(expected[0], expected[2]);
}

#[test]
fn driven_units_follow_their_targets() {
    let mut world = world(&edge(), 3, 100);
    let ids = heap(&mut world, 3);
    let turn = UnitQuaternion::from_scaled_axis(Vector3::new(0.0, 0.0, 0.3));
    let goal = Isometry3::from_parts(Translation3::new(-0.4, 0.2, 0.3), turn);
    world.drive(ids[0], &goal).unwrap();
    let start = world.pose(ids[0]).unwrap();
    assert_eq!(start.translation.vector, Vector3::new(0.0, 0.0, 0.11), "not before the step");
    for _ in 0..3 {
        world.step().unwrap();
        let pose = world.pose(ids[0]).unwrap();
        assert!((pose.translation.vector - goal.translation.vector).norm() < 1e-6, "{pose}");
        assert!(pose.rotation.angle_to(&goal.rotation) < 1e-3, "{pose}");
    }
    // One that is let go flies on, and one that is caught stays.
    world.edit(|scene| scene.set_role(ids[1], Role::Driven)).unwrap();
    world.edit(|scene| scene.set_role(ids[0], Role::Free)).unwrap();
    let caught = world.simulator().get(ids[1]).unwrap().internal_pose();
    world.step().unwrap();
    assert_eq!(world.simulator().get(ids[1]).unwrap().internal_pose(), caught);
    assert!(world.pose(ids[0]).unwrap().translation.z < 0.3, "it falls");
}

#[test]
fn fixed_units_never_move() {
    let mut world = world(&edge(), 3, 100);
    let points = lump(20);
    let shelf = world.add(&Unit::new(&points, RUBBER).role(Role::Fixed), &at(0.0, 0.0, 1.0));
    let falling = world.add(&Unit::new(&points, RUBBER), &at(0.0, 0.0, 1.25)).unwrap();
    let before = world.simulator().get(shelf.unwrap()).unwrap().internal_pose();
    for _ in 0..10 {
        world.step().unwrap();
        assert_eq!(world.simulator().unit(0).unwrap().internal_pose(), before);
    }
    assert!(world.pose(falling).unwrap().translation.z > 1.0, "it lies on the shelf");
}

#[test]
fn velocities_planes_and_time_steps_are_as_given() {
    let mut world = world(&edge(), 2, 100);
    let points = lump(12);
    let id = world.add(&Unit::new(&points, RUBBER), &at(0.0, 0.0, 1.0)).unwrap();
    world.edit(|scene| scene.set_planes(&[])).unwrap();
    world.edit(|scene| scene.set_gravity(Vector3::zeros())).unwrap();
    let (linear, angular) = (Vector3::new(1.0, -0.5, -2.0), Vector3::new(0.0, 0.9, 0.0));
    world.set_velocity(id, &linear, &angular).unwrap();
    let mut seconds = 0.0;
    // Velocities stay what they are when the time step changes.
    for dt in [DT_S, DT_S, DT_S / 2.0, DT_S / 2.0, 0.1, 0.013] {
        world.edit(|scene| scene.set_dt(dt)).unwrap();
        world.step().unwrap();
        seconds += dt;
        let pose = world.pose(id).unwrap();
        let expected = Vector3::new(0.0, 0.0, 1.0) + linear * seconds;
        // The frame's origin is near the centre of mass, about which the unit turns.
        assert!((pose.translation.vector - expected).norm() < 3e-3, "{dt} s: {pose}");
        assert!((pose.rotation.angle() - 0.9 * seconds).abs() < 2e-3, "{dt} s: {pose}");
    }
    // Gravity of the caller's: v t + g t^2 / 2.
    let before = world.pose(id).unwrap().translation.vector;
    let pull = Vector3::new(3.0, 0.0, 1.0);
    world.edit(|scene| scene.set_gravity(pull)).unwrap();
    world.edit(|scene| scene.set_dt(0.1)).unwrap();
    world.set_velocity(id, &Vector3::zeros(), &Vector3::zeros()).unwrap();
    world.step().unwrap();
    let way = world.pose(id).unwrap().translation.vector - before;
    assert!((way - pull * 0.005).norm() < 1e-5, "{way}");

    // Without a plane it falls for ever; on one that is raised it lies there.
    let heights = [None, Some(0.5)].map(|raised| {
        let mut world = self::world(&edge(), 1, 12);
        let id = world.add(&Unit::new(&points, RUBBER), &at(0.0, 0.0, 0.65)).unwrap();
        let plane = raised.map(|offset_m| Plane { offset_m, ..Plane::ground(0.3, 0.5) });
        world.edit(|scene| scene.set_planes(plane.as_slice())).unwrap();
        assert_eq!(world.simulator().planes(), plane.as_slice());
        for _ in 0..15 {
            world.step().unwrap();
        }
        world.pose(id).unwrap().translation.z
    });
    assert!(heights[0] < -1.0 && heights[1] > 0.5, "{heights:?}");
}

/// A fixed unit has no velocity, also once it is free; in models of robots gravity is an input, and changes no velocity by itself.
#[test]
fn velocities_are_of_the_role_and_the_model() {
    let points = lump(12);
    let (turn, way) = (Vector3::new(0.0, 0.5, 0.0), Vector3::new(1.0, 0.0, 0.0));
    let mut world = world(&edge(), 1, 12);
    let shelf = Unit::new(&points, RUBBER).role(Role::Fixed);
    let id = world.add(&shelf, &at(0.0, 0.0, 1.0)).unwrap();
    world.set_velocity(id, &way, &turn).unwrap();
    let unit = world.simulator().get(id).unwrap();
    assert_eq!(unit.previous_pose(), unit.pose());

    let robot = LoadedModel::embedded("g1", rigidformer_weights::G1).unwrap();
    let mut world = self::world(&robot, 1, 12);
    world.edit(|scene| scene.set_gravity(Vector3::new(0.0, 0.0, -9.81))).unwrap();
    let id = world.add(&Unit::new(&points, RUBBER), &at(0.0, 0.0, 1.0)).unwrap();
    let velocity = world.simulator().velocity(id).unwrap();
    assert_eq!((velocity.linear_m_s.norm(), velocity.angular_rad_s.norm()), (0.0, 0.0));
    world.set_velocity(id, &Vector3::zeros(), &Vector3::zeros()).unwrap();
    let unit = world.simulator().get(id).unwrap();
    assert_eq!(unit.previous_pose(), unit.pose());
}

/// A unit of a world, and its poses when it was added.
struct Entry {
    id: UnitId,
    shape: usize,
    role: Role,
    body: Option<u16>,
    first: [Isometry3<f32>; 2],
}

const SHAPES: [usize; 5] = [5, 8, 20, 33, 64];
const MASSES: [f32; 5] = [1.0, 0.2, 3.0, 0.7, 10.0];

fn add(world: &mut World, entry: &Entry) -> Result<UnitId, EditError> {
    let points = lump(SHAPES[entry.shape]);
    let physics = Physics { mass_kg: MASSES[entry.shape], ..RUBBER };
    let unit = Unit { body: entry.body, ..Unit::new(&points, physics).role(entry.role) };
    let [previous, current] = entry.first;
    world.edit(|scene| scene.add(&unit, &previous, &current))
}

/// Steps two worlds, which must stay alike.
#[track_caller]
fn assert_alike(a: &mut World, b: &mut World, steps: usize, what: &str) {
    assert_eq!(bits(a), bits(b), "{what}, at the start");
    for step in 0..steps {
        let (of_a, of_b) = (a.step(), b.step());
        assert_eq!(of_a, of_b, "{what}, step {step}");
        assert!(bits(a) == bits(b), "{what}, step {step}: other bits");
    }
}

/// Adds and removes units in an order that the seed gives, between steps. Each time the world is compared with one that
/// was made with exactly those units.
fn change(engine: Engine, model: &LoadedModel, seed: u64) {
    let mut state = seed;
    let mut next = |below: usize| {
        state = state.wrapping_mul(6364136223846793005).wrapping_add(1442695040888963407);
        (state >> 33) as usize % below
    };
    let limits = Limits { units: 6, points: 150 };
    let mut changed = World::on(engine, model, limits, 1).unwrap();
    changed.edit(|scene| scene.set_dt(DT_S)).unwrap();
    let mut entries: Vec<Entry> = Vec::new();
    let mut refused = 0;
    for round in 0..8 {
        for _ in 0..1 + next(4) {
            if !entries.is_empty() && next(5) < 2 {
                let gone = entries.remove(next(entries.len()));
                changed.remove(gone.id).unwrap();
                let again = changed.remove(gone.id);
                assert_eq!(again, Err(EditError::NoSuchUnit { id: gone.id }));
                continue;
            }
            let place = Vector3::new(
                0.1 * next(7) as f32,
                0.1 * next(7) as f32,
                0.15 + 0.1 * next(6) as f32,
            );
            let turn = UnitQuaternion::from_scaled_axis(Vector3::new(0.1, 0.2, next(6) as f32));
            let current = Isometry3::from_parts(place.into(), turn);
            let fallen = Translation3::new(0.0, 0.01 * next(3) as f32, 0.02);
            let role = [Role::Free, Role::Free, Role::Driven, Role::Fixed][next(4)];
            let body = [None, None, Some(4)][next(3)];
            let first = [fallen * current, current];
            let id = UnitId::from_bits(0);
            let mut entry = Entry { id, shape: next(SHAPES.len()), role, body, first };
            let before = bits(&changed);
            match add(&mut changed, &entry) {
                Ok(id) => {
                    entry.id = id;
                    entries.push(entry);
                }
                Err(error) => {
                    assert!(
                        matches!(
                            error,
                            EditError::Unit(
                                ObserveError::TooManyUnits { .. }
                                    | ObserveError::TooManyPoints { .. }
                            )
                        ),
                        "{error}"
                    );
                    assert_eq!(bits(&changed), before);
                    refused += 1;
                }
            }
        }
        if entries.is_empty() {
            assert_eq!(changed.step(), Err(StepError::NoUnits));
            continue;
        }
        // A pose that is read and set again is another one in its last bits: so it is set in both worlds.
        let points = entries.iter().map(|entry| SHAPES[entry.shape]).sum();
        let limits = Limits { units: entries.len(), points };
        let mut made = World::on(engine, model, limits, 1).unwrap();
        made.edit(|scene| scene.set_dt(DT_S)).unwrap();
        assert_eq!(changed.simulator().len(), entries.len());
        for (number, entry) in entries.iter().enumerate() {
            assert_eq!(changed.simulator().number(entry.id), Some(number));
            let unit = changed.simulator().get(entry.id).unwrap();
            assert_eq!((unit.role(), unit.body()), (entry.role, entry.body));
            assert_eq!(unit.point_count(), SHAPES[entry.shape]);
            let (previous, current) = (unit.previous_pose(), unit.pose());
            let id = add(&mut made, entry).unwrap();
            made.edit(|scene| scene.set_poses(id, &previous, &current)).unwrap();
            changed.edit(|scene| scene.set_poses(entry.id, &previous, &current)).unwrap();
        }
        let what = format!("seed {seed}, round {round}, {} units", entries.len());
        assert_alike(&mut changed, &mut made, 20, &what);
    }
    assert!(refused > 0 || seed != 1, "this seed fills the world");
}

#[test]
fn units_come_and_go_as_if_the_world_had_been_made_so() {
    // Not edge: its scenes are measured by the units that were there first.
    for seed in 1..=6 {
        change(single(), &lab_model("tiny-impulses"), seed);
    }
}

#[test]
fn units_come_and_go_in_other_models_and_on_threads() {
    let engine = Engine { threads: Threads::new(2).eager(), ..single() };
    for name in ["tiny-impact", "tiny-paper-inputs"] {
        for seed in 11..=13 {
            change(single(), &lab_model(name), seed);
        }
        change(engine, &lab_model(name), 14);
    }
    let impulses = lab_model("tiny-impulses");
    change(engine, &impulses, 15);
    change(Engine { kernel: Kernel::Portable, ..engine }, &impulses, 16);
}

#[test]
fn removing_leaves_what_was_never_added() {
    let model = lab_model("tiny-impulses");
    let entry = |shape: usize| {
        let pose = at(0.12 * shape as f32, 0.0, 0.12 + 0.05 * shape as f32);
        let id = UnitId::from_bits(0);
        Entry { id, shape, role: Role::Free, body: None, first: [pose; 2] }
    };
    // Which of the five is left out, in which order.
    for gone in [&[0_usize][..], &[4], &[2], &[0, 1], &[1, 0], &[3, 1, 4], &[4, 3, 2, 1]] {
        let (mut changed, mut made) = (world(&model, 5, 200), world(&model, 5, 200));
        let ids: Vec<_> = (0..5).map(|i| add(&mut changed, &entry(i)).unwrap()).collect();
        for gone in gone {
            changed.remove(ids[*gone]).unwrap();
        }
        for shape in (0..5).filter(|shape| !gone.contains(shape)) {
            add(&mut made, &entry(shape)).unwrap();
        }
        assert_alike(&mut changed, &mut made, 20, &format!("without {gone:?}"));
    }
}

#[test]
fn copies_have_driven_units_of_their_own() {
    let model = edge();
    let (copies, steps) = (3, 6);
    let way = |copy: usize, step: usize| at(0.02 * (copy * step) as f32, 0.01 * step as f32, 0.11);
    let limits = Limits { units: 3, points: 100 };
    let mut together = World::on(single(), &model, limits, copies).unwrap();
    together.edit(|scene| scene.set_dt(DT_S)).unwrap();
    let ids = heap(&mut together, 3);
    assert_eq!(together.edit(|scene| scene.replicate(copies)), copies);
    let mut alone: Vec<World> = (0..copies).map(|_| world(&model, 3, 100)).collect();
    let hands: Vec<UnitId> = alone.iter_mut().map(|world| heap(world, 3)[0]).collect();
    for step in 0..steps {
        for copy in 0..copies {
            let pose = way(copy, step);
            together.edit(|scene| scene.drive_in(copy, ids[0], &pose)).unwrap();
            alone[copy].drive(hands[copy], &pose).unwrap();
            alone[copy].step().unwrap();
        }
        let mut seen = Vec::new();
        together.step_copies(&mut |copy, outcome| seen.push((copy, outcome.is_ok()))).unwrap();
        assert_eq!(seen, [(0, true), (1, true), (2, true)]);
        let expected: Vec<u32> = alone.iter().flat_map(bits).collect();
        assert!(bits(&together) == expected, "step {step}");
    }
    let last = alone.iter().map(bits).collect::<Vec<_>>();
    assert!(last[0] != last[1] && last[1] != last[2], "commands of their own");
    let missing = together.edit(|scene| scene.drive_in(3, ids[0], &at(0.0, 0.0, 1.0)));
    assert_eq!(missing, Err(EditError::NoSuchCopy { copy: 3, copies }));
    // Made one again, it takes and loses units.
    together.edit(|scene| scene.replicate(1));
    together.remove(ids[1]).unwrap();
    assert_eq!(together.simulator().len(), 2);
    together.step().unwrap();
}

#[test]
fn copies_take_the_first_ones_command_along() {
    let model = lab_model("tiny");
    let limits = Limits { units: 3, points: 100 };
    let mut together = World::on(single(), &model, limits, 3).unwrap();
    together.edit(|scene| scene.set_dt(DT_S)).unwrap();
    heap(&mut together, 3);
    let commands = [[0.5, -0.5, 1.0], [-2.0, 1.0, 0.0]];
    together.edit(|scene| scene.set_command(&commands[0])).unwrap();
    together.edit(|scene| scene.set_copy_command(0, &commands[1])).unwrap();
    assert_eq!(together.edit(|scene| scene.replicate(3)), 3);
    together.step_copies(&mut |_, outcome| assert!(outcome.is_ok())).unwrap();
    let mut alone = world(&model, 3, 100);
    heap(&mut alone, 3);
    alone.edit(|scene| scene.set_command(&commands[1])).unwrap();
    alone.step().unwrap();
    let alone = bits(&alone);
    for (copy, bits) in bits(&together).chunks(alone.len()).enumerate() {
        assert!(bits == alone, "copy {copy}");
    }
}

#[test]
fn two_threads_equal_one() {
    let model = edge();
    let roll = |threads: Threads| {
        let engine = Engine { threads, ..single() };
        let limits = Limits { units: 12, points: 600 };
        let mut world = World::on(engine, &model, limits, 1).unwrap();
        world.edit(|scene| scene.set_dt(DT_S)).unwrap();
        let hand = heap(&mut world, 12)[0];
        let mut all = Vec::new();
        for step in 0..8 {
            world.drive(hand, &at(0.03 * step as f32, 0.0, 0.11)).unwrap();
            world.step().unwrap();
            all.push(bits(&world));
        }
        all
    };
    let one = roll(Threads::ONE);
    for threads in [Threads::new(2), Threads::new(2).eager(), Threads::new(2).eager_layers()] {
        assert!(roll(threads) == one, "{threads:?}");
    }
}

/// A call that must be refused, and what the answer must contain.
type Refused<'a> = (&'a str, Box<dyn FnOnce(&mut World) -> String + 'a>);

fn refused(world: &mut World, calls: Vec<Refused<'_>>) {
    for (expected, call) in calls {
        let before = state(world);
        let answer = call(world);
        assert!(answer.contains(expected), "{answer:?} for {expected:?}");
        assert_eq!(state(world), before, "after {expected:?}");
    }
}

fn text<T: std::fmt::Debug>(result: Result<T, impl std::fmt::Display>) -> String {
    match result {
        Ok(done) => panic!("not refused: {done:?}"),
        Err(error) => error.to_string(),
    }
}

#[test]
fn refused_calls_change_nothing() {
    let model = edge();
    let (mut world, mut twin) = (self::world(&model, 4, 60), self::world(&model, 4, 60));
    let (ids, twins) = (heap(&mut world, 3), heap(&mut twin, 3));
    for (world, id) in [(&mut world, ids[0]), (&mut twin, twins[0])] {
        world.step().unwrap();
        world.drive(id, &at(0.1, 0.0, 0.11)).unwrap();
    }
    let (hand, free) = (ids[0], ids[1]);
    let stranger = UnitId::from_bits(999);
    let (nan, here) = (at(f32::NAN, 0.0, 0.0), at(0.0, 0.0, 1.0));
    let far = at(0.0, 2e6, 0.0);
    let quaternion = UnitQuaternion::new_unchecked(Quaternion::new(0.9, 0.0, 0.0, 0.0));
    let short = Isometry3::from_parts(Translation3::identity(), quaternion);
    let points = lump(8);
    let unit = Unit::new(&points, RUBBER);
    let flat = vec![Point3::origin(); 8];
    let mut broken = lump(8);
    broken[3].y = f32::INFINITY;
    let many = lump(40);
    let heavy = Physics { mass_kg: 1e10, ..RUBBER };
    let slippery = Physics { friction: -0.1, ..RUBBER };
    let ground = Plane::ground(0.3, 0.5);
    let slanted = Plane { normal: Vector3::new(0.0, 0.5, 1.0), ..ground };
    let mut calls: Vec<Refused<'_>> = Vec::new();
    macro_rules! no {
        ($expected:literal, |$world:ident| $call:expr) => {
            calls.push(($expected, Box::new(|$world: &mut World| text($call))))
        };
    }
    no!("at least 4", |w| w.add(&Unit { points: &points[..3], ..unit }, &here));
    no!("point 3 of unit 3", |w| w.add(&Unit { points: &broken, ..unit }, &here));
    no!("coincide", |w| w.add(&Unit { points: &flat, ..unit }, &here));
    no!("raise Limits::points", |w| w.add(&Unit { points: &many, ..unit }, &here));
    no!("physics of unit 3", |w| w.add(&Unit { physics: heavy, ..unit }, &here));
    no!("a pose of unit 3", |w| w.add(&unit, &nan));
    no!("a pose of unit 3", |w| w.edit(|s| s.add(&unit, &short, &here)));
    no!("a pose of unit 3", |w| w.edit(|s| s.add(&unit, &here, &far)));
    no!("unit id 999", |w| w.remove(stranger));
    no!("unit id 999", |w| w.drive(stranger, &here));
    no!("is not driven", |w| w.drive(free, &here));
    no!("a pose of unit 0", |w| w.drive(hand, &nan));
    no!("no copy 1", |w| w.edit(|s| s.drive_in(1, hand, &here)));
    no!("a pose of unit 1", |w| w.edit(|s| s.set_poses(free, &here, &short)));
    no!("a pose of unit 1", |w| w.edit(|s| s.set_poses(free, &far, &here)));
    no!("unit id 999", |w| w.edit(|s| s.set_poses(stranger, &here, &here)));
    no!("a pose of unit 1", |w| w.set_velocity(
        free,
        &Vector3::new(f32::NAN, 0.0, 0.0),
        &Vector3::zeros()
    ));
    no!("half a turn a step", |w| w.set_velocity(
        free,
        &Vector3::zeros(),
        &Vector3::repeat(f32::INFINITY)
    ));
    no!("unit id 999", |w| w.set_velocity(stranger, &Vector3::zeros(), &Vector3::zeros()));
    no!("physics of unit 1", |w| w.edit(|s| s.set_physics(free, slippery)));
    no!("unit id 999", |w| w.edit(|s| s.set_physics(stranger, RUBBER)));
    no!("unit id 999", |w| w.edit(|s| s.set_role(stranger, Role::Fixed)));
    no!("9 planes given", |w| w.edit(|s| s.set_planes(&[ground; 9])));
    no!("plane 1", |w| w.edit(|s| s.set_planes(&[ground, slanted])));
    no!("gravity must be finite", |w| w.edit(|s| s.set_gravity(Vector3::repeat(f32::NAN))));
    no!("gravity must be finite", |w| w.edit(|s| s.set_gravity(Vector3::repeat(1e5))));
    no!("time step", |w| w.edit(|s| s.set_dt(0.0)));
    no!("time step", |w| w.edit(|s| s.set_dt(-0.1)));
    no!("time step", |w| w.edit(|s| s.set_dt(f32::NAN)));
    no!("time step", |w| w.edit(|s| s.set_dt(f32::INFINITY)));
    no!("the command has 2 numbers", |w| w.edit(|s| s.set_command(&[0.0; 2])));
    let posed = Posed { unit, previous: here, current: here };
    no!("a pose of unit 1", |w| w
        .edit(|s| s.observe_poses(DT_S, [posed, Posed { current: nan, ..posed }])));
    no!("no units", |w| w.edit(|s| s.observe_poses(DT_S, [posed; 0])));
    no!("5 units", |w| w.edit(|s| s.observe_poses(DT_S, [posed; 5])));
    no!("time step", |w| w.edit(|s| s.observe_poses(0.0, [posed])));
    no!("another layout", |w| w.edit(|s| s.step()));
    refused(&mut world, calls);
    assert_alike(&mut world, &mut twin, 5, "after all refusals");

    // A full world has no room for another.
    let small = lump(4);
    world.add(&Unit { points: &small, ..unit }, &at(0.0, 3.0, 1.0)).unwrap();
    refused(
        &mut world,
        vec![(
            "raise Limits::units",
            Box::new(|w| text(w.add(&Unit { points: &small, ..unit }, &here))),
        )],
    );
}

#[test]
fn what_comes_too_early_or_in_copies_is_refused() {
    let model = edge();
    let points = lump(8);
    let unit = Unit::new(&points, RUBBER);
    let limits = Limits { units: 2, points: 16 };
    let mut world = World::on(single(), &model, limits, 2).unwrap();
    assert_eq!(world.step(), Err(StepError::NoUnits));
    assert_eq!(world.add(&unit, &at(0.0, 0.0, 1.0)), Err(EditError::NoTimestep));
    world.edit(|scene| scene.set_dt(DT_S)).unwrap();
    assert_eq!(world.step(), Err(StepError::NoUnits));
    let id = world.add(&unit, &at(0.0, 0.0, 1.0)).unwrap();
    assert_eq!(world.edit(|scene| scene.replicate(2)), 2);
    refused(
        &mut world,
        vec![
            ("has 2 copies", Box::new(|w| text(w.add(&unit, &at(0.0, 0.0, 2.0))))),
            ("has 2 copies", Box::new(|w| text(w.remove(id)))),
            (
                "is not driven",
                Box::new(|w| text(w.edit(|s| s.drive_in(1, id, &at(0.0, 0.0, 1.0))))),
            ),
        ],
    );
    world.step().unwrap();
    let commanded = lab_model("tiny");
    let mut world = self::world(&commanded, 2, 16);
    world.add(&unit, &at(0.0, 0.0, 1.0)).unwrap();
    refused(
        &mut world,
        vec![
            ("a command of 3 numbers", Box::new(|w| text(w.step()))),
            ("has 2 numbers", Box::new(|w| text(w.edit(|s| s.set_command(&[0.0; 2]))))),
            (
                "number 1 is not",
                Box::new(|w| text(w.edit(|s| s.set_command(&[0.0, f32::NAN, 0.0])))),
            ),
            ("a command of 3 numbers", Box::new(|w| text(w.step()))),
        ],
    );
    world.edit(|scene| scene.set_command(&[0.0; 3])).unwrap();
    world.step().unwrap();
}

#[test]
fn a_step_that_fails_moves_nobody() {
    let mut world = world(&edge(), 2, 32);
    let points = lump(8);
    world.edit(|scene| scene.set_planes(&[])).unwrap();
    world.add(&Unit::new(&points, RUBBER), &at(0.0, 0.0, 1.0)).unwrap();
    let leaving = world.add(&Unit::new(&points, RUBBER), &at(999_999.0, 0.0, 1.0)).unwrap();
    world.set_velocity(leaving, &Vector3::new(100.0, 0.0, 0.0), &Vector3::zeros()).unwrap();
    refused(
        &mut world,
        vec![(
            "the prediction for unit 1 is not finite or beyond 1e6 m",
            Box::new(|w| text(w.step())),
        )],
    );
    world.remove(leaving).unwrap();
    world.step().unwrap();
}

#[test]
fn limits_without_memory_are_an_error() {
    let lots = usize::MAX / 2;
    for limits in [Limits { units: lots, points: 8 }, Limits { units: 1, points: lots }] {
        let error = World::new(&edge(), limits).err().map(|error| error.to_string());
        assert!(error.as_ref().is_some_and(|text| text.contains("lower the limits")), "{error:?}");
    }
}

#[test]
fn a_copy_that_fails_keeps_all_where_they_are() {
    let model = edge();
    let mut world = World::on(single(), &model, Limits { units: 2, points: 100 }, 2).unwrap();
    world.set_dt(DT_S).unwrap();
    let ids = heap(&mut world, 2);
    world.edit(|scene| scene.replicate(2));
    // It would go beyond the largest coordinate.
    let [far, farther] = [at(0.0, 0.0, 3e5), at(0.0, 0.0, 9e5)];
    world.edit(|scene| scene.set_poses_in(1, ids[1], &far, &farther)).unwrap();
    let before = bits(&world);
    assert!(world.step().is_err());
    assert_eq!(before, bits(&world));
}

#[test]
fn a_model_is_what_it_was_whatever_becomes_of_its_file() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("model.rfm");
    // In place, as `cp` does it: shorter, empty, of other bytes, longer, gone.
    let edge: &[u8] = rigidformer_weights::EDGE;
    let other = vec![0xa5; edge.len()];
    let longer = vec![0xa5; 32 << 20];
    let changes: [Option<&[u8]>; 5] =
        [Some(&other[..4096]), Some(&[]), Some(&other), Some(&longer), None];
    for after in changes {
        std::fs::write(&path, edge).unwrap();
        let loaded = LoadedModel::open(&path).unwrap();
        match after {
            Some(bytes) => std::fs::write(&path, bytes).unwrap(),
            None => std::fs::remove_file(&path).unwrap(),
        }
        assert!(loaded.bytes() == edge);
        assert!(LoadedModel::open(&path).is_err());
    }
}

#[cfg(target_os = "linux")]
#[test]
fn a_file_that_has_more_than_it_says_is_an_error() {
    // Its length is 0, and what it has is made as it is read.
    let error = LoadedModel::open("/proc/self/maps".as_ref()).err().unwrap().to_string();
    assert!(error.contains("grew while it was read"), "{error}");
}

#[test]
fn large_files_are_read_whole() {
    // Above the 16 MiB from which files once were mapped; the bytes behind a model are refused.
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("model.rfm");
    std::fs::write(&path, vec![0; (16 << 20) + 1]).unwrap();
    let error = LoadedModel::open(&path).err().unwrap().to_string();
    assert!(error.contains("model.rfm"), "{error}");
}

/// Where a unit was before the last step, also where contact changed its motion; where nothing says so, its motion does.
#[test]
fn a_previous_pose_is_where_a_unit_was_before_the_step() {
    let points = lump(8);
    let mut world = world(&edge(), 3, 24);
    let places = [at(0.0, 0.0, 0.1), at(1.0, 0.0, 0.6), at(2.0, 0.0, 0.1)];
    let ids = places.map(|pose| world.add(&Unit::new(&points, RUBBER), &pose).unwrap());
    assert_eq!(ids.map(|id| world.previous_pose(id)), ids.map(|id| world.pose(id)));
    world.set_velocity(ids[2], &Vector3::new(1.0, 0.0, 0.0), &Vector3::zeros()).unwrap();
    // It rests, it falls and bounces, it slides.
    for step in 0..20 {
        let before = ids.map(|id| world.pose(id));
        world.step().unwrap();
        assert_eq!(ids.map(|id| world.previous_pose(id)), before, "step {step}");
    }
    let copy = world.try_clone().unwrap();
    assert_eq!(ids.map(|id| copy.previous_pose(id)), ids.map(|id| world.previous_pose(id)));
    let other = world.previous_pose(ids[0]);
    let (there, here) = (at(1.0, 1.0, 2.0), at(1.0, 1.1, 2.0));
    world.edit(|simulator| simulator.set_poses(ids[1], &there, &here)).unwrap();
    let told = world.previous_pose(ids[1]).unwrap();
    assert!((told.translation.vector - there.translation.vector).norm() < 1e-6, "{told}");
    assert_eq!(world.previous_pose(ids[0]), other);
    world.remove(ids[0]).unwrap();
    assert_eq!(world.previous_pose(ids[0]), None);
}
