//! Models whose network sees what is in contact: rows of units that come and go.
#![allow(missing_docs, clippy::unwrap_used, clippy::expect_used, clippy::panic)]

use nalgebra::{Isometry3, Point3, UnitQuaternion, Vector3};
use rigidformer_core::weights::{AlignedBuffer, ModelConfig, Scope};
use rigidformer_core::{
    Layer, Limits, LoadError, Model, NoTrace, Physics, Portable, Posed, Serial, Simulator, Trace,
    Unit,
};
use rigidformer_evaluation::models::with_scope;
use rigidformer_runtime::engine::Engine;
use rigidformer_runtime::kernels::Kernel;
use rigidformer_runtime::models::LoadedModel;
use rigidformer_runtime::noise::Noise;
use rigidformer_runtime::threads::Threads;
use rigidformer_runtime::world::World;
use rigidformer_tests::{packed_model, with_simulator};

const DT_S: f32 = 1.0 / 48.0;
const STEPS: usize = 30;
const WOOD: Physics = Physics { mass_kg: 0.5, friction: 0.5, restitution: 0.4 };

fn near(name: &str) -> AlignedBuffer {
    let packed = match name {
        "edge" => AlignedBuffer::copy_of(rigidformer_weights::EDGE),
        name => packed_model(name),
    };
    AlignedBuffer::copy_of(&with_scope(name.as_ref(), &packed, Scope::Near).unwrap())
}

/// The corners of a cube, and points on its edges.
fn cube() -> Vec<Point3<f32>> {
    let side = |i: i32| [-0.1, 0.0, 0.1][i as usize % 3];
    let all = (0..27).map(|i| Point3::new(side(i), side(i / 3), side(i / 9)));
    all.filter(|p| p.coords.iter().filter(|v| **v != 0.0).count() > 1).collect()
}

/// Poses a step before and now of so many cubes that fall in heaps of three, the heaps far apart.
fn falling(count: usize, seed: u64) -> Vec<[Isometry3<f32>; 2]> {
    let place = |number: usize| {
        let mut noise = Noise::new(seed, number as u64);
        let turn = Vector3::from_fn(|_, _| noise.normal());
        let way = Vector3::from_fn(|_, _| 0.2 * noise.normal()) - Vector3::z();
        let (heap, level) = (number / 3, number % 3);
        let (x, z) = (2.0 * heap as f32, 0.13 + 0.3 * level as f32 + 0.2 * heap as f32);
        let middle = Vector3::new(x + 0.05 * noise.normal(), 0.05 * noise.normal(), z);
        let now = UnitQuaternion::from_scaled_axis(turn);
        let before = UnitQuaternion::from_scaled_axis(turn * 0.97);
        [
            Isometry3::from_parts((middle - way * DT_S).into(), before),
            Isometry3::from_parts(middle.into(), now),
        ]
    };
    (0..count).map(place).collect()
}

fn observe(simulator: &mut Simulator<'_, '_>, poses: &[[Isometry3<f32>; 2]]) {
    let points = cube();
    let units = poses.iter().map(|[previous, current]| Posed {
        unit: Unit::new(&points, WOOD),
        previous: *previous,
        current: *current,
    });
    simulator.observe_poses(DT_S, units).unwrap();
}

fn bits(simulator: &Simulator<'_, '_>, units: std::ops::Range<usize>) -> Vec<u32> {
    let units = units.map(|number| simulator.unit(number).unwrap().internal_pose());
    let numbers =
        units.flat_map(|pose| [pose.rotation.as_slice(), pose.centre.as_slice()].concat());
    numbers.map(f32::to_bits).collect()
}

/// Puts the units of a copy elsewhere.
fn move_to(simulator: &mut Simulator<'_, '_>, copy: usize, poses: &[[Isometry3<f32>; 2]]) {
    let ids: Vec<_> = simulator.units().map(|unit| unit.id()).collect();
    for (id, [previous, current]) in ids.iter().zip(poses) {
        simulator.set_poses_in(copy, *id, previous, current).unwrap();
    }
}

/// The bits of units after each step, by the portable kernels on one thread. The scene is seen elsewhere first.
fn alone(model: &[u8], [first, poses]: [&[[Isometry3<f32>; 2]]; 2], seen: usize) -> Vec<u32> {
    with_simulator(model, poses.len() * cube().len(), |simulator| {
        observe(simulator, first);
        move_to(simulator, 0, poses);
        let step = |_| {
            simulator.step_on(Serial(Portable), &mut NoTrace).unwrap();
            bits(simulator, 0..seen)
        };
        (0..STEPS).flat_map(step).collect()
    })
}

/// Rows of units in the network, step by step.
#[derive(Default)]
struct Rows(usize);

impl Trace for Rows {
    fn record(&mut self, layer: Layer, index: usize, values: &[f32]) {
        if (layer, index) == (Layer::Tokens, 0) {
            self.0 += values.len();
        }
    }
}

/// Kernels, threads, copies and what is left out change no bit, and each copy is the scene alone.
#[test]
fn bits_are_the_same_for_kernels_threads_and_copies() {
    for name in ["edge", "tiny-impulses"] {
        let packed = near(name);
        let model = LoadedModel::copy_of(name, &packed).unwrap().for_host().unwrap();
        let (all, limits) = (9, Limits { units: 9, points: 9 * cube().len() });
        let scenes = [1, 2, 3].map(|seed| falling(all, seed));
        let expected = [0, 1, 2].map(|scene| alone(&packed, [&scenes[0], &scenes[scene]], all));
        assert!(expected[0] != expected[1] && expected[1] != expected[2]);
        for kernel in Kernel::available() {
            for threads in [Threads::ONE, Threads::all(), Threads::all().whole()] {
                for copies in [1, 3] {
                    let mut world =
                        World::on(Engine { kernel, threads }, &model, limits, copies).unwrap();
                    world.edit(|simulator| {
                        observe(simulator, &scenes[0]);
                        assert_eq!(simulator.replicate(copies), copies);
                        for (copy, scene) in scenes.iter().take(copies).enumerate() {
                            move_to(simulator, copy, scene);
                        }
                    });
                    let mut found = vec![Vec::new(); copies];
                    for _ in 0..STEPS {
                        world.step_copies(&mut |_, outcome| assert!(outcome.is_ok())).unwrap();
                        for (copy, found) in found.iter_mut().enumerate() {
                            found.extend(bits(world.simulator(), copy * all..(copy + 1) * all));
                        }
                    }
                    for (copy, (found, expected)) in found.iter().zip(&expected).enumerate() {
                        assert!(
                            found == expected,
                            "{name} {kernel} {threads:?}: copy {copy} of {copies}"
                        );
                    }
                }
            }
        }
    }
}

/// What can touch nothing changes no bit of the others: a model that sees all knows that it is there.
#[test]
fn what_is_far_is_not_seen() {
    let packed = near("tiny-impulses");
    let (few, mut many) = (falling(3, 1), falling(3, 1));
    for number in 0..6_i16 {
        let up = |z: f32| Isometry3::translation(f32::from(number), 5.0, 40.0 + z);
        many.push([up(0.0), up(-0.01)]);
    }
    let expected = alone(&packed, [&few; 2], 3);
    assert!(alone(&packed, [&many; 2], 3) == expected, "with units far above");
    let all = packed_model("tiny-impulses");
    assert!(alone(&all, [&many; 2], 3) != alone(&all, [&few; 2], 3), "a model that sees all");
}

/// The network has rows of what is in contact alone, and none where nothing is; also where no step is cut short.
#[test]
fn rows_are_those_of_what_is_near() {
    let packed = near("edge");
    let poses = falling(9, 1);
    with_simulator(&packed, 9 * cube().len(), |simulator| {
        observe(simulator, &poses);
        let width = simulator.model().config().width as usize;
        let rows: Vec<usize> = (0..STEPS)
            .map(|_| {
                let mut rows = Rows::default();
                simulator.step_traced(&mut rows).unwrap();
                rows.0 / width
            })
            .collect();
        assert!(rows.iter().any(|rows| (1..9).contains(rows)), "{rows:?}");
        // Far above the ground nothing is in contact.
        let ids: Vec<_> = simulator.units().map(|unit| unit.id()).collect();
        for (number, id) in ids.into_iter().enumerate() {
            let at = |z: f32| Isometry3::translation(number as f32, 0.0, 20.0 + z);
            simulator.set_poses(id, &at(0.01), &at(0.0)).unwrap();
        }
        let mut rows = Rows::default();
        simulator.step_traced(&mut rows).unwrap();
        assert_eq!(rows.0, 0);
    });
}

/// Scopes go with impulses alone.
#[test]
fn other_models_see_all() {
    let error = with_scope("tiny".as_ref(), &packed_model("tiny"), Scope::Near).unwrap_err();
    assert!(error.to_string().contains("`scope` Near"), "{error}");
    let config: fn(&AlignedBuffer) -> Result<ModelConfig, LoadError> =
        |file| Model::load(file).map(|model| *model.config());
    assert_eq!(config(&near("tiny-impulses")).unwrap().scope, Scope::Near);
    let back = with_scope("edge".as_ref(), &near("edge"), Scope::All).unwrap();
    assert_eq!(config(&AlignedBuffer::copy_of(&back)).unwrap().scope, Scope::All);
}
