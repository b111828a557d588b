//! Snapshots: what goes on from one has the bits of what went on without, and hostile ones are refused or are scenes.
#![allow(missing_docs, clippy::unwrap_used, clippy::expect_used, clippy::panic)]

use nalgebra::{Isometry3, Point3, Vector3};
use rigidformer_core::{
    Compliance, EditError, Joint, Limits, Model, NoTrace, Observed, Physics, Pieces, Plane,
    Portable, Role, Serial, Simulator, SlabSizes, SnapshotError, Unit, UnitId,
};
use rigidformer_runtime::engine::Engine;
use rigidformer_runtime::models::LoadedModel;
use rigidformer_runtime::world::World;
use rigidformer_tests::bits::{Fnv1a, PRECISIONS, quantised};
use rigidformer_tests::hostile::{SMALLEST, SMALLEST_BONDS, SMALLEST_SOFT, random_model};
use rigidformer_tests::{Golden, Random, Room, Seen, packed_model, with_simulator};

/// Steps that must be the same, from each snapshot on.
const STEPS: usize = 100;
const DT_S: f32 = 1.0 / 24.0;
const WOOD: Physics = Physics { mass_kg: 1.0, friction: 0.4, restitution: 0.3 };

fn taken(simulator: &Simulator<'_, '_>) -> Vec<u8> {
    let mut bytes = vec![0xa5; simulator.snapshot_bytes() + 8];
    let length = simulator.snapshot(&mut bytes).unwrap();
    assert_eq!(length, simulator.snapshot_bytes());
    assert_eq!(bytes[length..], [0xa5; 8], "nothing is written behind");
    bytes.truncate(length);
    bytes
}

/// Whether two snapshots differ at most in the next name, which never falls, and in the checksum.
fn same(a: &[u8], b: &[u8]) -> bool {
    let but = |bytes: &[u8]| [&bytes[..20], &bytes[28..bytes.len() - 8]].concat();
    but(a) == but(b)
}

/// Where all units of all copies are, and which bonds hold, as a hash.
fn hash(simulator: &Simulator<'_, '_>) -> u64 {
    let mut hash = Fnv1a::default();
    (0..).map_while(|unit| simulator.unit(unit)).for_each(|unit| {
        hash.add_unit(&unit);
        hash.add(f32::from(unit.body().unwrap_or(u16::MAX)));
    });
    for copy in 0..simulator.copies() {
        simulator.bonds_in(copy).for_each(|bond| hash.add(f32::from(u8::from(bond.holds))));
    }
    hash.0
}

/// Hashes of so many steps; a step that fails is one of them.
fn go_on(simulator: &mut Simulator<'_, '_>, steps: usize) -> Vec<(bool, u64)> {
    let step = |_| (simulator.step().is_ok(), hash(simulator));
    (0..steps).map(step).collect()
}

/// Goes on from snapshots that are taken every few steps, in the same simulator and in another one with more room.
fn check(model: &[u8], points: usize, begin: impl Fn(&mut Simulator<'_, '_>)) {
    check_steps(STEPS, model, points, begin);
}

fn check_steps(steps: usize, model: &[u8], points: usize, begin: impl Fn(&mut Simulator<'_, '_>)) {
    with_simulator(model, points, |simulator| {
        begin(simulator);
        let mut snapshots = Vec::new();
        for _ in 0..3 {
            go_on(simulator, 6);
            snapshots.push(taken(simulator));
        }
        let expected = go_on(simulator, steps);
        let last = snapshots.len() - 1;
        for (number, bytes) in snapshots.iter().enumerate() {
            simulator.restore(bytes).unwrap();
            assert!(same(&taken(simulator), bytes), "a snapshot of what was restored is the same");
            // What came between the snapshots comes again, and then the same as without. The first has all of it behind it.
            if number == 0 {
                go_on(simulator, 6 * last);
                assert_eq!(go_on(simulator, steps), expected, "in the same simulator");
            }
            let loaded = Model::load(model).unwrap();
            let limits = Limits { units: 20, points: points + 100 };
            let mut room = Room::new(SlabSizes::new(loaded.config(), limits));
            let mut other = Simulator::new(&loaded, limits, room.slabs()).unwrap();
            other.restore(bytes).unwrap();
            go_on(&mut other, 6 * (last - number));
            assert_eq!(go_on(&mut other, steps), expected, "in another simulator");
        }
    });
}

fn golden(name: &str, simulator: &mut Simulator<'_, '_>) {
    let golden = Golden::read(name);
    if let Some(command) = golden.command() {
        simulator.set_command(&command).unwrap();
    }
    let posed = golden.inputs();
    let bodies = if golden.has("body") { golden.integers("body") } else { vec![] };
    let mut units = posed.posed();
    for (unit, body) in units.iter_mut().zip(bodies) {
        unit.unit.body = u16::try_from(body).ok();
    }
    simulator.observe_poses(golden.dt_s(), &units).unwrap();
    golden.bond(simulator);
}

#[test]
fn golden_scenes_go_on_as_they_would_have() {
    // In f16 a bond of the last one breaks (tests/data/bits.txt).
    let [(_, f32), (_, f16), (_, i8)] = PRECISIONS;
    for (name, precision) in
        [("tiny", f32), ("tiny-paper-inputs", i8), ("tiny-carried", i8), ("tiny-breaking", f16)]
    {
        let model = quantised(&packed_model(name), precision);
        check(&model, 1200, |simulator| golden(name, simulator));
    }
}

#[test]
fn a_soft_drape_goes_on_as_it_would_have() {
    let seen = Seen::golden();
    check(&packed_model("tiny-soft"), seen.scene.points(), |simulator| {
        seen.observe(simulator).unwrap();
        // Springs are found anew with this.
        let id = simulator.units().find(|unit| unit.is_soft()).unwrap().id();
        let physics = Physics { mass_kg: 0.3, friction: 0.7, restitution: 0.0 };
        simulator.set_physics(id, physics).unwrap();
    });
}

fn cuboid([x, y, z]: [f32; 3], half: [f32; 3]) -> Vec<Point3<f32>> {
    let side = |i: i32, bit| if i & bit == 0 { -1.0 } else { 1.0 };
    let [a, b, c] = half;
    (0..8)
        .map(|i| Point3::new(x + a * side(i, 1), y + b * side(i, 2), z + c * side(i, 4)))
        .collect()
}

fn at(x: f32, y: f32, z: f32) -> Isometry3<f32> {
    Isometry3::translation(x, y, z)
}

/// A cube in the middle of a bounce, a robot's chain, a hollow table, a driven and a fixed unit, a lost one in quarantine, a wall.
fn workshop(simulator: &mut Simulator<'_, '_>) -> Vec<UnitId> {
    simulator.set_dt(DT_S).unwrap();
    simulator.set_gravity(Vector3::new(0.1, 0.0, -9.7)).unwrap();
    let wall = Plane {
        normal: Vector3::new(-1.0, 0.0, 0.0),
        offset_m: -1.5,
        friction: 0.3,
        restitution: 0.4,
    };
    simulator.set_planes(&[Plane::ground(0.5, 0.6), wall]).unwrap();
    simulator.set_quarantine(true);
    let cube = cuboid([0.0; 3], [0.1; 3]);
    let bar = cuboid([0.05, 0.0, 0.0], [0.2, 0.05, 0.05]);
    let table = [
        cuboid([0.0, 0.0, 0.1], [0.2, 0.1, 0.01]),
        cuboid([-0.19, 0.0, 0.045], [0.01, 0.1, 0.045]),
        cuboid([0.19, 0.0, 0.045], [0.01, 0.1, 0.045]),
    ]
    .concat();
    let unit = Unit::new(&cube, WOOD);
    let mut ids = Vec::new();
    let mut add = |simulator: &mut Simulator<'_, '_>, unit: &Unit<'_>, before, now| {
        ids.push(simulator.add(unit, &before, &now).unwrap());
    };
    let gone = simulator.add(&unit, &at(0.0, 3.0, 1.0), &at(0.0, 3.0, 1.0)).unwrap();
    add(simulator, &unit, at(0.2, 0.1, 0.6), at(0.25, 0.1, 0.5));
    for link in 0..3 {
        let bar = Unit::new(&bar, WOOD).body(1).inertia([2e-3, 2e-2, 2e-2]);
        let pose = at(0.4 * link as f32, 1.0, 0.5);
        let bar = if link == 0 { bar.role(Role::Driven) } else { bar };
        add(simulator, &bar, pose, pose);
    }
    let hollow = Unit::new(&table, WOOD).pieces(Pieces::new(&table, &[8, 8, 8]));
    add(simulator, &hollow, at(-1.0, 0.0, 0.15), at(-1.0, 0.0, 0.14));
    add(simulator, &unit.role(Role::Fixed), at(-1.0, 0.0, 0.6), at(-1.0, 0.0, 0.6));
    add(simulator, &unit, at(-2e5, 0.2, 0.5), at(2e5, 0.2, 0.5));
    let half = unit.body(7);
    add(simulator, &half, at(1.0, -1.0, 0.5), at(1.0, -1.0, 0.45));
    add(simulator, &half, at(1.2, -1.0, 0.5), at(1.2, -1.0, 0.45));
    add(simulator, &half, at(1.2, -1.0, 0.7), at(1.2, -1.0, 0.65));
    simulator.remove(gone).unwrap();
    let [left, right] = [-0.15, 0.25].map(|x| Point3::new(x, 0.0, 0.0));
    for link in 1..3 {
        let (unit, parent) = (ids[link + 1], ids[link]);
        simulator.join(&Joint::ball(unit, parent, left, right)).unwrap();
    }
    simulator.bond(&[[ids[7], ids[8]], [ids[8], ids[9]]]).unwrap();
    simulator.break_bond([ids[8], ids[9]]).unwrap();
    simulator.drive(ids[1], &at(0.05, 1.0, 0.55)).unwrap();
    ids
}

#[test]
fn bounces_robots_bonds_and_what_is_held_go_on_as_they_would_have() {
    check(rigidformer_weights::EDGE, 400, |simulator| {
        workshop(simulator);
        simulator.step().unwrap();
        let held = simulator.units().filter(|unit| unit.is_quarantined()).count();
        assert_eq!(held, 1);
    });
}

/// A stiffness and a dissipation of planes and of units, which snapshots of rigid scenes have no room for.
#[test]
fn contact_that_gives_way_goes_on_as_it_would_have() {
    let give = |stiffness_n_m| Compliance { stiffness_n_m, dissipation_s_m: 1.5 };
    check(rigidformer_weights::EDGE, 400, |simulator| {
        let ids = workshop(simulator);
        let rigid = simulator.snapshot_bytes();
        simulator.set_plane_compliance(0, give(8e3)).unwrap();
        simulator.set_compliance(ids[0], give(2e4)).unwrap();
        simulator.set_compliance(ids[7], give(f32::INFINITY)).unwrap();
        assert!(simulator.snapshot_bytes() > rigid);
        assert_eq!(simulator.plane_compliance(0), Some(give(8e3)));
        assert_eq!(simulator.get(ids[0]).unwrap().compliance(), give(2e4));
    });
}

#[test]
fn compliance_out_of_range_is_refused_and_nothing_changes() {
    with_simulator(rigidformer_weights::EDGE, 400, |simulator| {
        let ids = workshop(simulator);
        let before = taken(simulator);
        let cube = cuboid([0.0; 3], [0.1; 3]);
        let (here, unit) = (at(0.0, 0.0, 9.0), Unit::new(&cube, WOOD));
        let bad =
            [(-1.0, 0.0), (1e-4, 0.0), (1e13, 0.0), (f32::NAN, 0.0), (1e4, -1.0), (1e4, f32::NAN)];
        for (stiffness_n_m, dissipation_s_m) in bad {
            let bad = Compliance { stiffness_n_m, dissipation_s_m };
            let errors = [
                simulator.set_compliance(ids[0], bad).unwrap_err().to_string(),
                simulator.set_plane_compliance(1, bad).unwrap_err().to_string(),
                simulator.add(&unit.compliance(bad), &here, &here).unwrap_err().to_string(),
            ];
            for error in errors {
                assert!(error.contains("stiffness") && error.contains("dissipation"), "{error}");
            }
        }
        let error = simulator.set_plane_compliance(2, Compliance::RIGID).unwrap_err();
        assert_eq!(error, EditError::NoSuchPlane { plane: 2, planes: 2 });
        assert!(same(&taken(simulator), &before));
    });
}

/// Steps longer than the model knows, in substeps.
#[test]
fn substeps_go_on_as_they_would_have() {
    // Each has four.
    check_steps(STEPS / 4, rigidformer_weights::NANO, 400, |simulator| {
        workshop(simulator);
        simulator.set_dt(4.0 * DT_S).unwrap();
    });
}

#[test]
fn a_scene_without_units_keeps_its_world() {
    with_simulator(&packed_model("tiny"), 100, |simulator| {
        let command = Golden::read("tiny").command().unwrap();
        let empty = taken(simulator);
        simulator.set_command(&command).unwrap();
        simulator.set_dt(DT_S).unwrap();
        simulator.set_planes(&[]).unwrap();
        let bytes = taken(simulator);
        simulator.restore(&empty).unwrap();
        assert_eq!((simulator.planes().len(), simulator.dt_s()), (1, None));
        simulator.restore(&bytes).unwrap();
        assert_eq!((simulator.planes().len(), simulator.dt_s()), (0, Some(DT_S)));
        let cube = cuboid([0.0; 3], [0.1; 3]);
        simulator.add(&Unit::new(&cube, WOOD), &at(0.0, 0.0, 1.0), &at(0.0, 0.0, 1.0)).unwrap();
        simulator.step().unwrap();
    });
}

/// Names given since then name no other unit.
#[test]
fn a_name_is_given_once() {
    with_simulator(rigidformer_weights::EDGE, 400, |simulator| {
        let ids = workshop(simulator);
        let bytes = taken(simulator);
        let cube = cuboid([0.0; 3], [0.1; 3]);
        let cube = Unit::new(&cube, WOOD);
        let later = simulator.add(&cube, &at(5.0, 0.0, 1.0), &at(5.0, 0.0, 1.0)).unwrap();
        simulator.restore(&bytes).unwrap();
        assert!(simulator.get(later).is_none());
        assert!(ids.iter().all(|id| simulator.get(*id).is_some()));
        let again = simulator.add(&cube, &at(5.0, 0.0, 1.0), &at(5.0, 0.0, 1.0)).unwrap();
        assert!(again > later);
    });
}

fn replicated(world: &mut World, copies: usize) {
    world.edit(|simulator| {
        let ids = workshop(simulator);
        assert_eq!(simulator.replicate(copies), copies);
        for copy in 1..copies {
            let pose = at(0.2 * copy as f32, 0.1, 0.6);
            simulator.set_poses_in(copy, ids[0], &pose, &pose).unwrap();
            simulator.set_physics_in(copy, ids[0], Physics { mass_kg: 3.0, ..WOOD }).unwrap();
            simulator.drive_in(copy, ids[1], &at(0.0, 1.0, 0.5 + 0.1 * copy as f32)).unwrap();
        }
        simulator.break_bond_in(1, [ids[7], ids[8]]).unwrap();
    });
}

fn all_copies(world: &mut World, steps: usize) -> Vec<u64> {
    let step = |_| {
        world.step_copies(&mut |_, outcome| assert!(outcome.is_ok())).unwrap();
        hash(world.simulator())
    };
    (0..steps).map(step).collect()
}

#[test]
fn copies_go_on_together_and_alone() {
    let model = LoadedModel::embedded("edge", rigidformer_weights::EDGE).unwrap();
    let limits = Limits { units: 12, points: 400 };
    let world =
        |copies| World::on(Engine::new().unwrap().single(), &model, limits, copies).unwrap();
    let mut all = world(3);
    replicated(&mut all, 3);
    all_copies(&mut all, 5);
    let bytes = taken(all.simulator());
    let alone: Vec<_> = (0..3)
        .map(|copy| {
            let mut one = vec![0; all.simulator().copy_snapshot_bytes()];
            assert_eq!(all.simulator().snapshot_copy(copy, &mut one), Ok(one.len()));
            one
        })
        .collect();
    let expected = all_copies(&mut all, 20);
    let mut other = world(4);
    other.edit(|simulator| simulator.restore(&bytes)).unwrap();
    assert_eq!(all_copies(&mut other, 20), expected);
    // Each copy by itself, from behind.
    for copy in [2, 0, 1] {
        all.edit(|simulator| simulator.restore_copy(copy, &alone[copy])).unwrap();
    }
    assert_eq!(all_copies(&mut all, 20), expected);
    // A copy as a scene of its own: what the whole has of it.
    other.edit(|simulator| simulator.restore(&bytes)).unwrap();
    for (copy, bytes) in alone.iter().enumerate() {
        let mut one = world(1);
        one.edit(|simulator| simulator.restore(bytes)).unwrap();
        let units = one.simulator().len();
        for number in 0..units {
            let whole = other.simulator().unit(copy * units + number).unwrap().internal_pose();
            assert_eq!(one.simulator().unit(number).unwrap().internal_pose(), whole);
        }
    }
    let mut small = world(2);
    let many = SnapshotError::TooManyCopies { found: 3, limit: 2 };
    assert_eq!(small.edit(|simulator| simulator.restore(&bytes)), Err(many));
    let none = SnapshotError::NoSuchCopy { copy: 3, copies: 3 };
    assert_eq!(all.edit(|simulator| simulator.restore_copy(3, &alone[0])), Err(none));
    assert_eq!(all.simulator().snapshot_copy(3, &mut []), Err(none));
    let other_scene = Err(SnapshotError::OtherScene);
    assert_eq!(all.edit(|simulator| simulator.restore_copy(0, &bytes)), other_scene);
    // How another copy gives way is no part of this one.
    let soft = Compliance { stiffness_n_m: 1e4, dissipation_s_m: 1.0 };
    let (rigid, id) = (alone[0].clone(), all.simulator().units().next().unwrap().id());
    all.edit(|simulator| simulator.set_compliance_in(1, id, soft)).unwrap();
    assert_eq!(all.edit(|simulator| simulator.restore_copy(0, &rigid)), Ok(()));
    let mut giving = vec![0; all.simulator().copy_snapshot_bytes()];
    assert!(all.simulator().snapshot_copy(1, &mut giving).is_ok());
    all.edit(|simulator| simulator.restore_copy(1, &alone[1])).unwrap();
    assert!(all.simulator().units().all(|unit| unit.compliance().is_rigid()));
    assert_eq!(all.edit(|simulator| simulator.restore_copy(1, &giving)), Ok(()));
    all.edit(|simulator| simulator.set_plane_compliance(0, soft)).unwrap();
    assert_eq!(all.edit(|simulator| simulator.restore_copy(0, &rigid)), other_scene);
    all.edit(|simulator| simulator.set_plane_compliance(0, Compliance::RIGID)).unwrap();
    all.edit(|simulator| simulator.set_gravity(Vector3::zeros())).unwrap();
    assert_eq!(all.edit(|simulator| simulator.restore_copy(0, &alone[0])), other_scene);
}

#[test]
fn another_model_is_refused_and_another_layout_is_not() {
    let (tiny, carried) = (packed_model("tiny"), packed_model("tiny-carried"));
    let bytes = with_simulator(&tiny, 1200, |simulator| {
        golden("tiny", simulator);
        taken(simulator)
    });
    let other = |model: &[u8]| with_simulator(model, 1200, |simulator| simulator.restore(&bytes));
    assert_eq!(other(&tiny), Ok(()));
    assert_eq!(other(&carried), Err(SnapshotError::OtherModel));
    for (name, precision) in PRECISIONS {
        let same = name == "f32";
        assert_eq!(other(&quantised(&tiny, precision)).is_ok(), same, "{name}");
    }
    // What a microcontroller writes, a host takes.
    let nano = LoadedModel::embedded("nano", rigidformer_weights::NANO).unwrap();
    let host = nano.clone().for_host().unwrap();
    assert_ne!(nano.bytes(), host.bytes());
    let bytes = with_simulator(nano.bytes(), 400, |simulator| {
        simulator.set_dt(DT_S).unwrap();
        let cube = cuboid([0.0; 3], [0.1; 3]);
        simulator.add(&Unit::new(&cube, WOOD), &at(0.0, 0.0, 0.3), &at(0.0, 0.0, 0.3)).unwrap();
        taken(simulator)
    });
    let rest = with_simulator(nano.bytes(), 400, |simulator| {
        simulator.restore(&bytes).unwrap();
        go_on(simulator, STEPS)
    });
    let mut world = World::new(&host, Limits { units: 4, points: 100 }).unwrap();
    world.edit(|simulator| simulator.restore(&bytes)).unwrap();
    let on_host: Vec<_> =
        (0..STEPS).map(|_| (world.step().is_ok(), hash(world.simulator()))).collect();
    assert_eq!(on_host, rest);
}

/// The checksum that a hostile writer would give.
pub(crate) fn seal(bytes: &mut [u8]) {
    let (body, end) = bytes.split_at_mut(bytes.len() - 8);
    let hash = body.as_chunks::<4>().0.iter().fold(0xcbf2_9ce4_8422_2325_u64, |hash, word| {
        (hash ^ u64::from(u32::from_le_bytes(*word))).wrapping_mul(0x0100_0000_01b3)
    });
    end.copy_from_slice(&hash.to_le_bytes());
}

/// Damages a snapshot in all ways: each is refused and changes nothing, or is a scene that can be stepped and written.
fn attack(model: &[u8], points: usize, seed: u64, begin: impl Fn(&mut Simulator<'_, '_>)) {
    with_simulator(model, points, |simulator| {
        begin(simulator);
        let bytes = taken(simulator);
        go_on(simulator, 3);
        let before = taken(simulator);
        for length in 0..bytes.len() {
            assert!(simulator.restore(&bytes[..length]).is_err(), "{length} bytes");
            let mut cut = bytes[..length].to_vec();
            if length >= 8 {
                seal(&mut cut);
                assert!(simulator.restore(&cut).is_err(), "{length} bytes, sealed");
            }
        }
        assert!(simulator.restore(&[&bytes[..], &[0; 4]].concat()).is_err());
        for byte in 0..bytes.len() {
            let mut damaged = bytes.clone();
            damaged[byte] ^= 0x41;
            assert!(simulator.restore(&damaged).is_err(), "byte {byte}");
        }
        assert!(taken(simulator) == before, "a refused snapshot changes nothing");
        let mut random = Random(seed);
        let (mut taken_over, mut refused) = (0, 0);
        let words = bytes.len() / 4 - 2;
        for word in (2..words).filter(|word| !(2..4).contains(word)) {
            let place = word * 4..word * 4 + 4;
            let own = u32::from_le_bytes(bytes[place.clone()].try_into().unwrap());
            let bit = 1 << (random.bits() % 32);
            let values = [
                own ^ bit,
                own ^ 0x8000_0000,
                f32::NAN.to_bits(),
                0,
                u32::MAX,
                1e8_f32.to_bits(),
                own.wrapping_add(1),
            ];
            for value in values {
                let mut damaged = bytes.clone();
                damaged[place.clone()].copy_from_slice(&value.to_le_bytes());
                seal(&mut damaged);
                let is_same = damaged == bytes;
                match simulator.restore(&damaged) {
                    Ok(()) => {
                        taken_over += 1;
                        let again = taken(simulator);
                        simulator.restore(&again).unwrap();
                        let _ = simulator.step_on(Serial(Portable), &mut NoTrace);
                        // What follows may diverge, and is refused then.
                        let _ = simulator.step();
                        simulator.restore(&before).unwrap();
                    }
                    Err(_) => {
                        assert!(!is_same);
                        refused += 1;
                    }
                }
            }
        }
        println!("{taken_over} snapshots are scenes, {refused} are refused");
        assert!(taken_over > 100 && refused > 100);
        assert!(same(&taken(simulator), &before));
    });
}

#[test]
fn hostile_snapshots_are_refused_or_are_scenes() {
    let bonds = random_model(SMALLEST_BONDS, 1);
    attack(&bonds, 400, 1, |simulator| {
        workshop(simulator);
    });
    let commanded = random_model(SMALLEST, 2);
    attack(&commanded, 100, 2, |simulator| {
        simulator.set_command(&[0.5]).unwrap();
        simulator.set_dt(DT_S).unwrap();
        simulator.set_contact_law("0.25,pyramid".parse().unwrap()).unwrap();
        let cube = cuboid([0.0; 3], [0.1; 3]);
        for x in [0.0, 0.15, 0.4] {
            simulator.add(&Unit::new(&cube, WOOD), &at(x, 0.0, 0.2), &at(x, 0.0, 0.15)).unwrap();
        }
    });
}

#[test]
fn hostile_soft_snapshots_are_refused_or_are_scenes() {
    let sheet = |dz: f32| -> Vec<Point3<f32>> {
        let row = |i: usize| (0..4).map(move |j| (i, j));
        let points = (0..4).flat_map(row);
        points.map(|(i, j)| Point3::new(0.1 * i as f32, 0.1 * j as f32, 0.2 + dz)).collect()
    };
    let (rest, before, now) = (sheet(0.0), sheet(0.02), sheet(0.01));
    let cube = cuboid([0.1, 0.1, 0.1], [0.05; 3]);
    attack(&random_model(SMALLEST_SOFT, 3), 60, 3, |simulator| {
        let soft = Observed { unit: Unit::new(&before, WOOD).soft(&rest, 1e4), current: &now };
        let rigid = Observed { unit: Unit::new(&cube, WOOD), current: &cube };
        simulator.observe(DT_S, [soft, rigid]).unwrap();
    });
}

#[test]
fn too_little_room_says_how_much_there_must_be() {
    with_simulator(rigidformer_weights::EDGE, 400, |simulator| {
        workshop(simulator);
        let bytes = taken(simulator);
        let needed = bytes.len();
        let mut short = vec![7; needed - 1];
        let room = SnapshotError::Room { needed, found: needed - 1 };
        assert_eq!(simulator.snapshot(&mut short), Err(room));
        assert!(short.iter().all(|byte| *byte == 7));
        let loaded = Model::load(rigidformer_weights::EDGE).unwrap();
        for (limits, error) in [
            (Limits { units: 9, points: 400 }, SnapshotError::TooManyUnits { found: 10, limit: 9 }),
            (
                Limits { units: 12, points: 90 },
                SnapshotError::TooManyPoints { found: 94, limit: 90 },
            ),
        ] {
            let mut room = Room::new(SlabSizes::new(loaded.config(), limits));
            let mut small = Simulator::new(&loaded, limits, room.slabs()).unwrap();
            assert_eq!(small.restore(&bytes), Err(error));
        }
    });
}
