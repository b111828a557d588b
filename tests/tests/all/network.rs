//! The same motion with the network and without it.
#![allow(missing_docs, clippy::unwrap_used, clippy::expect_used, clippy::panic)]

use nalgebra::{Isometry3, Point3, UnitQuaternion, Vector3};
use rigidformer_core::weights::{ContactLaw, FrictionLimit};
use rigidformer_core::{Limits, Physics, Posed, Unit};
use rigidformer_evaluation::models::{random, with_rules};
use rigidformer_runtime::engine::Engine;
use rigidformer_runtime::kernels::Kernel;
use rigidformer_runtime::models::LoadedModel;
use rigidformer_runtime::noise::Noise;
use rigidformer_runtime::threads::Threads;
use rigidformer_runtime::world::World;
use rigidformer_tests::packed_model;

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

fn ruled(packed: &[u8], law: ContactLaw, most_units: u32) -> LoadedModel {
    loaded(&with_rules("model".as_ref(), packed, law, most_units).unwrap())
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

/// Without its network a model moves units as one does whose network says nothing, with rigid contacts.
#[test]
fn without_the_network_impulses_are_left() {
    for name in ["tiny-impulses", "nano"] {
        let packed = packed(name);
        let with_law = ruled(&packed, LAW, 0);
        let alone = random::without_network(with_law.model().config()).unwrap().unwrap();
        let expected = bits(&mut thrown(&loaded(&alone), 6, serial()), 20);
        let mut world = thrown(&with_law, 6, serial());
        assert!(world.simulator().has_network());
        world.set_network(false);
        assert_eq!(bits(&mut world, 20), expected, "{name}");
        let then = world.snapshot();
        let without = bits(&mut world, 5);
        world.restore(&then).unwrap();
        assert!(!world.simulator().has_network(), "a snapshot says so");
        assert_eq!(bits(&mut world, 5), without);
        let with = bits(&mut thrown(&with_law, 6, serial()), 20);
        assert_ne!(with, expected, "{name}");
        let mut back = thrown(&with_law, 6, serial());
        back.set_network(false);
        back.set_network(true);
        assert_eq!(bits(&mut back, 20), with, "{name}");
    }
}

/// Where there are more units than a model corrects, it leaves them alone, and its law too.
#[test]
fn more_units_than_a_model_corrects_are_left_alone() {
    let packed = packed("nano");
    let of_six = ruled(&packed, LAW, 6);
    let any = ruled(&packed, LAW, 0);
    let step = |model: &LoadedModel, units: usize, network: bool| {
        let mut world = thrown(model, units, serial());
        world.set_network(network);
        bits(&mut world, 10)
    };
    assert_eq!(step(&of_six, 6, true), step(&any, 6, true));
    assert_eq!(step(&of_six, 7, true), step(&any, 7, false));
    assert_ne!(step(&any, 7, true), step(&any, 7, false));
}

/// A law changes motion where contacts bounce, alike on all kernels, by one thread or two, also where sweeps are wide.
#[test]
fn a_law_has_the_same_bits_on_all_kernels() {
    let packed = packed("nano");
    let model = ruled(&packed, LAW, 0);
    for units in [6, 40] {
        let expected = bits(&mut thrown(&model, units, serial()), 12);
        let rigid = ruled(&packed, ContactLaw::RIGID, 0);
        assert_ne!(bits(&mut thrown(&rigid, units, serial()), 12), expected);
        for kernel in Kernel::available() {
            for threads in [Threads::ONE, Threads::all()] {
                let mut world = thrown(&model, units, Engine { kernel, threads });
                assert_eq!(bits(&mut world, 12), expected, "{kernel:?} {units}");
            }
        }
    }
}
