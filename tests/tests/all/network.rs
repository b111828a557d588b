//! The same motion with the network and without it.
#![allow(missing_docs, clippy::unwrap_used, clippy::expect_used, clippy::panic)]

use nalgebra::{Isometry3, Point3, UnitQuaternion, Vector3};
use rigidformer_core::{
    ContactLaw, EditError, FrictionLimit, Limits, Physics, Posed, SnapshotError, Unit,
};
use rigidformer_evaluation::models::{random, with_rules};
use rigidformer_runtime::engine::Engine;
use rigidformer_runtime::futures::{BatchSimulator, Start};
use rigidformer_runtime::kernels::Kernel;
use rigidformer_runtime::models::LoadedModel;
use rigidformer_runtime::noise::Noise;
use rigidformer_runtime::threads::Threads;
use rigidformer_runtime::world::World;
use rigidformer_tests::packed_model;

use crate::snapshot::seal;

const DT_S: f32 = 1.0 / 48.0;
const RUBBER: Physics = Physics { mass_kg: 0.5, friction: 0.6, restitution: 0.6 };
const LAW: ContactLaw = ContactLaw { restitution_offset: 0.1, friction: FrictionLimit::Pyramid };

fn cube() -> Vec<Point3<f32>> {
    let side = |i: i32| if i & 1 == 0 { -0.1 } else { 0.1 };
    (0..8).map(|i| Point3::new(side(i), side(i >> 1), side(i >> 2))).collect()
}

fn loaded(packed: &[u8]) -> LoadedModel {
    LoadedModel::copy_of("<model>", packed).unwrap()
}

/// The packed model of this name.
fn packed(name: &str) -> Vec<u8> {
    match name {
        "nano" => rigidformer_weights::NANO.to_vec(),
        name => packed_model(name).to_vec(),
    }
}

/// The same model, which corrects up to so many units; 0: any.
fn ruled(packed: &[u8], most_units: u32) -> LoadedModel {
    loaded(&with_rules("model".as_ref(), packed, most_units).unwrap())
}

/// Cubes that fall onto each other, thrown.
fn thrown(model: &LoadedModel, units: usize, engine: Engine) -> World {
    let limits = Limits { units, points: 8 * units };
    let mut world = World::on(engine, model, limits, 1).unwrap();
    let points = cube();
    let posed: Vec<Posed<'_>> = (0..units)
        .map(|number| {
            let mut noise = Noise::new(3, number as u64);
            let (row, level) = (number % 4, number / 4);
            let (x, z) = (0.25 * row as f32, 0.15 + 0.25 * level as f32);
            let now = Isometry3::translation(x, 0.02 * noise.normal(), z);
            let turn = Vector3::from_fn(|_, _| 0.05 * noise.normal());
            let way = Vector3::from_fn(|_, _| 0.3 * noise.normal()) - Vector3::z();
            let before = Isometry3::from_parts(
                (now.translation.vector - way * DT_S).into(),
                UnitQuaternion::from_scaled_axis(turn),
            );
            Posed { unit: Unit::new(&points, RUBBER), previous: before, current: now }
        })
        .collect();
    world.edit(|simulator| simulator.observe_poses(DT_S, posed)).unwrap();
    world
}

fn bits(world: &mut World, steps: usize) -> Vec<u32> {
    let mut out = Vec::new();
    for _ in 0..steps {
        world.step().unwrap();
        for unit in world.simulator().units() {
            let pose = unit.pose();
            let numbers = pose.translation.vector.iter().chain(pose.rotation.coords.iter());
            out.extend(numbers.map(|number| number.to_bits()));
        }
    }
    out
}

fn serial() -> Engine {
    Engine { kernel: Kernel::Portable, threads: Threads::ONE }
}

/// The same in a scene with a contact law.
fn lawful(model: &LoadedModel, law: ContactLaw, units: usize, engine: Engine) -> World {
    let mut world = thrown(model, units, engine);
    world.set_contact_law(law).unwrap();
    world
}

/// Without its network a model moves units as one does whose network says nothing, by the scene's law.
#[test]
fn without_the_network_impulses_are_left() {
    for (name, law) in [("tiny-impulses", LAW), ("nano", LAW), ("tiny-impulses", ContactLaw::RIGID)]
    {
        let model = ruled(&packed(name), 0);
        let alone = random::without_network(model.model().config()).unwrap().unwrap();
        let expected = bits(&mut lawful(&loaded(&alone), law, 6, serial()), 20);
        let mut world = lawful(&model, law, 6, serial());
        assert!(world.simulator().has_network());
        world.set_network(false);
        assert_eq!(bits(&mut world, 20), expected, "{name}");
        let then = world.snapshot();
        let without = bits(&mut world, 5);
        world.restore(&then).unwrap();
        assert!(!world.simulator().has_network(), "a snapshot says so");
        assert_eq!(bits(&mut world, 5), without);
        let with = bits(&mut lawful(&model, law, 6, serial()), 20);
        assert_ne!(with, expected, "{name}");
        let mut back = lawful(&model, law, 6, serial());
        back.set_network(false);
        back.set_network(true);
        assert_eq!(bits(&mut back, 20), with, "{name}");
    }
}

/// Where there are more units than a model corrects, or the scene has a law, it leaves them alone; the law stays.
#[test]
fn more_units_than_a_model_corrects_are_left_alone() {
    let packed = packed("nano");
    let (of_six, any) = (ruled(&packed, 6), ruled(&packed, 0));
    let step = |model: &LoadedModel, law: ContactLaw, units: usize, network: bool| {
        let mut world = lawful(model, law, units, serial());
        world.set_network(network);
        bits(&mut world, 10)
    };
    let rigid = ContactLaw::RIGID;
    assert_eq!(step(&of_six, rigid, 6, true), step(&any, rigid, 6, true));
    assert_eq!(step(&of_six, rigid, 7, true), step(&any, rigid, 7, false));
    assert_eq!(step(&of_six, LAW, 6, true), step(&any, LAW, 6, false));
    assert_ne!(step(&any, LAW, 6, true), step(&any, LAW, 6, false));
    assert_eq!(step(&of_six, LAW, 7, true), step(&any, LAW, 7, false));
    assert_ne!(step(&of_six, LAW, 7, true), step(&of_six, rigid, 7, true));
}

/// A law changes motion where contacts bounce, alike on all kernels, by one thread or two, also where sweeps are wide.
#[test]
fn a_law_has_the_same_bits_on_all_kernels() {
    let model = ruled(&packed("nano"), 0);
    for units in [6, 40] {
        let expected = bits(&mut lawful(&model, LAW, units, serial()), 12);
        assert_ne!(bits(&mut thrown(&model, units, serial()), 12), expected);
        for kernel in Kernel::available() {
            for threads in [Threads::ONE, Threads::all()] {
                let mut world = lawful(&model, LAW, units, Engine { kernel, threads });
                assert_eq!(bits(&mut world, 12), expected, "{kernel:?} {units}");
            }
        }
    }
}

/// Contacts are rigid until told otherwise; a law that cannot be changes nothing, and a rigid one leaves nothing behind.
#[test]
fn laws_out_of_range_are_refused() {
    let model = ruled(&packed("tiny-impulses"), 0);
    let mut world = thrown(&model, 6, serial());
    assert_eq!(world.simulator().contact_law(), ContactLaw::RIGID);
    let rigid = world.snapshot();
    world.set_contact_law(LAW).unwrap();
    let then = world.snapshot();
    for restitution_offset in [-0.1, -f32::MIN_POSITIVE, 1.0001, f32::NAN, f32::INFINITY] {
        let refused = world.set_contact_law(ContactLaw { restitution_offset, ..ContactLaw::RIGID });
        assert_eq!(refused, Err(EditError::BadContactLaw));
        assert_eq!(
            refused.unwrap_err().to_string(),
            "contact law: restitution_offset must be from 0 to 1"
        );
        assert_eq!(world.snapshot().as_bytes(), then.as_bytes());
    }
    let unsigned = ContactLaw { restitution_offset: -0.0, ..ContactLaw::RIGID };
    world.set_contact_law(unsigned).unwrap();
    assert_eq!(world.snapshot().as_bytes(), rigid.as_bytes());
}

/// A snapshot has the law of its scene, in two words that rigid scenes do not have; copies have it too.
#[test]
fn snapshots_and_copies_have_the_law() {
    let model = ruled(&packed("tiny-impulses"), 0);
    let start = || lawful(&model, LAW, 6, serial());
    let expected = bits(&mut start(), 20);
    let state = start().snapshot();
    let rigid = thrown(&model, 6, serial()).snapshot();
    assert_eq!(state.as_bytes().len(), rigid.as_bytes().len() + 8);

    // Taken by a world of other limits, and one that had another law.
    let mut world = World::on(serial(), &model, Limits { units: 9, points: 90 }, 2).unwrap();
    world.restore(&state).unwrap();
    assert_eq!(world.simulator().contact_law(), LAW);
    assert_eq!(world.snapshot().as_bytes(), state.as_bytes());
    assert_eq!(bits(&mut world, 20), expected);
    world.restore(&rigid).unwrap();
    assert_eq!(world.simulator().contact_law(), ContactLaw::RIGID);
    let own = bits(&mut world, 20);
    assert_eq!(own, bits(&mut thrown(&model, 6, serial()), 20));
    assert_ne!(own, expected);

    // Both copies of a scene, and one that is taken as a scene of its own.
    world.restore(&state).unwrap();
    assert_eq!(world.edit(|simulator| simulator.replicate(2)), 2);
    assert_eq!(bits(&mut world, 20), expected);
    let poses = |copy: usize| -> Vec<Isometry3<f32>> {
        (0..6).map(|unit| world.simulator().unit(6 * copy + unit).unwrap().pose()).collect()
    };
    assert_eq!(poses(0), poses(1));
    let single = world.snapshot_copy(1).unwrap();
    // Planes, gravity and the law are those of all copies.
    let refused = world.restore_copy(0, &rigid);
    assert_eq!(refused, Err(SnapshotError::OtherScene));
    let mut alone = World::on(serial(), &model, Limits { units: 6, points: 48 }, 1).unwrap();
    alone.restore(&single).unwrap();
    assert_eq!(alone.simulator().contact_law(), LAW);
}

/// Futures of a world have its law, and another one where their start says so.
#[test]
fn futures_have_the_law_of_their_start() {
    let model = ruled(&packed("tiny-impulses"), 0);
    let simulator = BatchSimulator::new(serial(), &model);
    let run = |start: &Start<'_>| {
        let mut out = vec![Isometry3::identity(); 3 * 12 * 6];
        simulator.run(start, 12, &(), &mut out).unwrap();
        let (first, others) = out.split_at(12 * 6);
        assert!(others.chunks_exact(12 * 6).all(|other| other == first));
        let numbers = |pose: &Isometry3<f32>| {
            let numbers = pose.translation.vector.iter().chain(pose.rotation.coords.iter());
            numbers.map(|number| number.to_bits()).collect::<Vec<_>>()
        };
        first.iter().flat_map(numbers).collect::<Vec<_>>()
    };
    let own = bits(&mut lawful(&model, LAW, 6, serial()), 12);
    let rigid = bits(&mut thrown(&model, 6, serial()), 12);
    let of_own = lawful(&model, LAW, 6, serial()).start().unwrap();
    let of_rigid = thrown(&model, 6, serial()).start().unwrap();
    assert_eq!(run(&Start::of(&of_own)), own);
    assert_eq!(run(&Start { contact_law: Some(LAW), ..Start::of(&of_rigid) }), own);
    assert_eq!(run(&Start { contact_law: Some(ContactLaw::RIGID), ..Start::of(&of_own) }), rigid);
}

/// What no snapshot has in the place of a law is refused, and the scene stays what it was.
#[test]
fn hostile_laws_in_snapshots_are_refused() {
    let model = ruled(&packed("tiny-impulses"), 0);
    let mut world = lawful(&model, LAW, 6, serial());
    let then = world.snapshot();
    // Behind seven words of the head and fourteen of the scene; flags are the fifth of these.
    let (law, flags) = (4 * (7 + 14), 4 * (7 + 4));
    assert_eq!(then.as_bytes()[law..law + 4], 0.1_f32.to_le_bytes());
    let with = |offset: f32, friction: u32| {
        let mut bytes = then.as_bytes().to_vec();
        bytes[law..law + 4].copy_from_slice(&offset.to_le_bytes());
        bytes[law + 4..law + 8].copy_from_slice(&friction.to_le_bytes());
        bytes
    };
    let mut hostile: Vec<Vec<u8>> = vec![with(0.1, 2), with(0.1, u32::MAX), with(0.0, 0)];
    hostile.extend([-0.0, -0.1, 1.5, f32::NAN, f32::INFINITY].map(|offset| with(offset, 1)));
    // Without the flag the words are too many, and a flag that is none is refused.
    let mut unflagged = then.as_bytes().to_vec();
    unflagged[flags] &= !16;
    hostile.push(unflagged);
    let mut unknown = then.as_bytes().to_vec();
    unknown[flags] |= 32;
    hostile.push(unknown);
    for mut bytes in hostile {
        seal(&mut bytes);
        let refused = world.edit(|simulator| simulator.restore(&bytes)).unwrap_err();
        assert!(
            matches!(refused, SnapshotError::Unsound { .. } | SnapshotError::Length { .. }),
            "{refused}"
        );
        assert_eq!(world.snapshot().as_bytes(), then.as_bytes());
    }
    let mut sound = with(0.0, 1);
    seal(&mut sound);
    world.edit(|simulator| simulator.restore(&sound)).unwrap();
    let pyramid = ContactLaw { restitution_offset: 0.0, ..LAW };
    assert_eq!(world.simulator().contact_law(), pyramid);
}
