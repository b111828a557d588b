//! Bonds that a model breaks: in the step, for good, in each copy alike, and not where the step fails.
#![allow(missing_docs, clippy::unwrap_used, clippy::expect_used, clippy::panic)]

use nalgebra::{Isometry3, Point3, Vector3};
use rigidformer_core::{
    Model, NoTrace, Physics, Portable, Posed, Serial, Simulator, StepError, Unit, UnitId,
};
use rigidformer_runtime::engine::Engine;
use rigidformer_runtime::models::LoadedModel;
use rigidformer_runtime::world::World;
use rigidformer_tests::{Golden, Random, packed_model, with_simulator};
use rigidformer_weights::{
    AlignedBuffer, BOND_FEATURES, ConfigError, FormatError, ModelConfig, ModelFile, ModelWriter,
    Motion, Similarity, TensorData,
};

const DT_S: f32 = 1.0 / 60.0;
const STONE: Physics = Physics { mass_kg: 1.0, friction: 0.6, restitution: 0.1 };

/// tiny-breaking with other last biases of the network of bonds: what is far above 0 breaks all that impulses act on.
fn with_bias(bias: f32) -> AlignedBuffer {
    let packed = packed_model("tiny-breaking");
    let file = ModelFile::parse(&packed).unwrap();
    let mut writer = ModelWriter::new("biased", *file.config());
    let mut tensors: Vec<_> = file.tensors().collect();
    let biases = [bias];
    for tensor in &mut tensors {
        if tensor.name == "bonds.net.1.bias" {
            tensor.data = TensorData::F32(&biases);
        }
        writer = writer.tensor(tensor.name, tensor.shape, tensor.data);
    }
    AlignedBuffer::copy_of(&writer.finish().unwrap())
}

fn cuboid(half: f32) -> Vec<Point3<f32>> {
    let side = |i: i32, bit| if i & bit == 0 { -half } else { half };
    (0..8).map(|i| Point3::new(side(i, 1), side(i, 2), side(i, 4))).collect()
}

/// A row of three cubes with their centres at a height, which falls at a speed, bonded one to the next.
fn row(simulator: &mut Simulator<'_, '_>, height: f32, speed: f32) -> Vec<UnitId> {
    let points = cuboid(0.1);
    let unit = Unit::new(&points, STONE).body(4);
    let at = |k: usize, z: f32| Isometry3::translation(0.2 * k as f32, 0.03, z);
    let posed = (0..3).map(|k| Posed {
        unit,
        previous: at(k, height + speed * DT_S),
        current: at(k, height),
    });
    simulator.observe_poses(DT_S, posed).unwrap();
    let ids: Vec<_> = simulator.units().map(|unit| unit.id()).collect();
    simulator.bond(&[[ids[0], ids[1]], [ids[1], ids[2]]]).unwrap();
    ids
}

fn holds(simulator: &Simulator<'_, '_>, copy: usize) -> Vec<bool> {
    simulator.bonds_in(copy).map(|bond| bond.holds).collect()
}

fn bits(simulator: &Simulator<'_, '_>, copy: usize) -> Vec<u32> {
    let units = copy * simulator.len()..(copy + 1) * simulator.len();
    let poses = units.map(|unit| simulator.unit(unit).unwrap().internal_pose());
    let numbers = poses
        .flat_map(|pose| pose.rotation.iter().chain(&pose.centre).copied().collect::<Vec<_>>());
    numbers.map(f32::to_bits).collect()
}

#[test]
fn what_flies_or_rests_never_breaks_and_what_lands_does() {
    let eager = with_bias(1e3);
    with_simulator(&eager, 200, |simulator| {
        row(simulator, 2.0, 0.0);
        for _ in 0..20 {
            simulator.step().unwrap();
        }
        assert_eq!(holds(simulator, 0), [true, true], "in flight");

        row(simulator, 0.13, 2.0);
        let mut steps = 0;
        while holds(simulator, 0).contains(&true) {
            simulator.step().unwrap();
            steps += 1;
            assert!(steps < 20, "it lands");
        }
        let bodies: Vec<_> = simulator.units().map(|unit| unit.body()).collect();
        assert!(bodies[0] == Some(4) && bodies[1] != bodies[0] && bodies[2] != bodies[1]);
        assert_ne!(bodies[0], bodies[2]);
        for _ in 0..20 {
            simulator.step().unwrap();
        }
        assert_eq!(holds(simulator, 0), [false, false], "for good");
    });
    with_simulator(&with_bias(-1e3), 200, |simulator| {
        row(simulator, 0.13, 4.0);
        for _ in 0..60 {
            simulator.step().unwrap();
        }
        assert_eq!(holds(simulator, 0), [true, true], "a model that breaks nothing");
    });
}

/// A bond that the caller breaks before the step, where the model would in it, leaves the same motion.
#[test]
fn what_breaks_in_a_step_does_not_hold_in_it() {
    let run = |by_model: bool| {
        with_simulator(&with_bias(if by_model { 1e3 } else { -1e3 }), 200, |simulator| {
            let ids = row(simulator, 0.101, 6.0);
            if !by_model {
                for pair in ids.windows(2) {
                    assert!(simulator.break_bond([pair[0], pair[1]]).unwrap());
                }
            }
            simulator.step().unwrap();
            assert_eq!(holds(simulator, 0), [false, false]);
            bits(simulator, 0)
        })
    };
    assert_eq!(run(true), run(false));
}

#[test]
fn a_step_that_fails_breaks_nothing() {
    with_simulator(&with_bias(1e3), 200, |simulator| {
        // The last unit leaves the room that coordinates have; the first two land on the ground.
        let points = cuboid(0.1);
        let edge = 1e6 - 1.0;
        let at = |x: f32, z: f32| Isometry3::translation(x, 0.03, z);
        let held = |x: f32| Posed {
            unit: Unit::new(&points, STONE).body(4),
            previous: at(x, 0.101 + 6.0 * DT_S),
            current: at(x, 0.101),
        };
        let lost = Posed {
            unit: Unit::new(&points, STONE),
            previous: at(edge - 2e4, 50.0),
            current: at(edge, 50.0),
        };
        simulator.observe_poses(DT_S, [held(0.0), held(0.2), lost]).unwrap();
        let ids: Vec<_> = simulator.units().map(|unit| unit.id()).collect();
        simulator.bond(&[[ids[0], ids[1]]]).unwrap();
        let (before, bodies) = (bits(simulator, 0), |simulator: &Simulator<'_, '_>| {
            simulator.units().map(|unit| unit.body()).collect::<Vec<_>>()
        });
        let was = bodies(simulator);
        let mut failed = Vec::new();
        simulator
            .step_copies(Serial(Portable), &mut NoTrace, |_, report| failed.push(report))
            .unwrap();
        assert_eq!(failed, [Err(StepError::Diverged { unit: 2 })]);
        assert_eq!(simulator.step(), Err(StepError::Diverged { unit: 2 }));
        assert_eq!((holds(simulator, 0), bits(simulator, 0)), (vec![true], before));
        assert_eq!(bodies(simulator), was);
        simulator.remove(ids[2]).unwrap();
        simulator.step().unwrap();
        assert_eq!(holds(simulator, 0), [false], "without the lost one it breaks");
    });
}

/// Copies in which other things happen break other bonds; each is what it would be alone, on every engine.
#[test]
fn copies_break_as_they_would_alone() {
    let golden = Golden::read("tiny-breaking");
    let inputs = golden.inputs();
    let limits = rigidformer_core::Limits {
        units: inputs.points.len(),
        points: inputs.points.iter().map(Vec::len).sum(),
    };
    let observe = |simulator: &mut Simulator<'_, '_>| {
        let mut posed = inputs.posed();
        for (posed, body) in posed.iter_mut().zip(golden.integers("body")) {
            posed.unit.body = u16::try_from(body).ok();
        }
        simulator.observe_poses(golden.dt_s(), posed).unwrap();
        golden.bond(simulator);
    };
    let run = |loaded: &LoadedModel, engine: Engine, copies: usize| {
        let mut world = World::on(engine, loaded, limits, copies).unwrap();
        world.edit(|simulator| {
            observe(simulator);
            assert_eq!(simulator.replicate(copies), copies);
        });
        // In the last copy the first bond is broken beforehand.
        let pair = world.simulator().bonds().next().unwrap().units;
        world.edit(|simulator| simulator.break_bond_in(copies - 1, pair).unwrap());
        let mut all = vec![Vec::new(); copies];
        for _ in 0..40 {
            world.step_copies(&mut |_, report| assert!(report.is_ok())).unwrap();
            for (copy, seen) in all.iter_mut().enumerate() {
                seen.push((bits(world.simulator(), copy), holds(world.simulator(), copy)));
            }
        }
        all
    };
    let single = || Engine::new().unwrap().single();
    // From a model that breaks all to one that breaks nothing: somewhere between, one bond breaks and the other holds.
    let mut has_parted = false;
    for bias in [0.5, 0.0, -0.25, -0.5, -0.75, -1.0, -1.25, -1.5] {
        let loaded = LoadedModel::copy_of("biased", &with_bias(bias)).unwrap();
        let alone = run(&loaded, single(), 1); // the bond is broken
        let three = run(&loaded, single(), 3);
        assert_eq!(three[0], three[1]);
        assert_eq!(three[2], alone[0]);
        assert_eq!(run(&loaded, Engine::new().unwrap(), 3), three, "threads");
        let (_, last) = three[0].last().unwrap();
        has_parted |= last.contains(&false) && last.contains(&true) && three[0] != three[2];
    }
    assert!(has_parted, "one breaks and the other holds");
}

/// With its units in another order, a scene breaks alike.
#[test]
fn bonds_break_in_any_order_of_units() {
    let run = |order: [usize; 3]| {
        with_simulator(&with_bias(0.0), 200, |simulator| {
            let points = cuboid(0.1);
            let unit = Unit::new(&points, STONE).body(1);
            let posed = order.map(|k| {
                let pose = |z: f32| {
                    let tilt =
                        nalgebra::UnitQuaternion::from_scaled_axis(Vector3::new(0.2, 0.3, 0.1));
                    let arm = tilt * Vector3::new(0.2 * k as f32, 0.0, 0.0);
                    Isometry3::from_parts((arm + Vector3::new(0.0, 0.0, z)).into(), tilt)
                };
                Posed { unit, previous: pose(0.4 + 3.0 * DT_S), current: pose(0.4) }
            });
            simulator.observe_poses(DT_S, posed).unwrap();
            let mut ids = [UnitId::from_bits(0); 3];
            for (place, k) in order.iter().enumerate() {
                ids[*k] = simulator.unit(place).unwrap().id();
            }
            simulator.bond(&[[ids[0], ids[1]], [ids[1], ids[2]]]).unwrap();
            let mut seen = Vec::new();
            for _ in 0..25 {
                simulator.step().unwrap();
                seen.push(holds(simulator, 0));
            }
            seen
        })
    };
    let one = run([0, 1, 2]);
    assert_eq!(one, run([2, 0, 1]));
    assert!(one.iter().any(|holds| holds.contains(&false)), "something breaks");
}

#[test]
fn configurations_and_files_that_do_not_go_with_bonds_are_refused() {
    let packed = packed_model("tiny-breaking");
    let config = *ModelFile::parse(&packed).unwrap().config();
    assert_eq!(config.bonds, 8);
    let amiss = |config: ModelConfig| config.validate().unwrap_err();
    let wide = ModelConfig { bonds: 16_385, ..config };
    assert!(matches!(amiss(wide), ConfigError::Size { field: "bonds", .. }));
    let still = ModelConfig { motion: Motion::Free, ..config };
    assert_eq!(amiss(still), ConfigError::Bonds { field: "motion" });
    let similarity = Similarity { length_m: 0.5, longest_step: 0.0 };
    let measured = ModelConfig { similarity, ..config };
    assert_eq!(amiss(measured), ConfigError::Bonds { field: "similarity" });

    // Without one of its tensors, or with one of another shape, the file is no model.
    let file = ModelFile::parse(&packed).unwrap();
    for name in
        ["bonds.feature_mean", "bonds.feature_scale", "bonds.net.0.weight", "bonds.net.1.bias"]
    {
        let mut writer = ModelWriter::new("lacking", config);
        for tensor in file.tensors().filter(|tensor| tensor.name != name) {
            writer = writer.tensor(tensor.name, tensor.shape, tensor.data);
        }
        let lacking = AlignedBuffer::copy_of(&writer.finish().unwrap());
        let error = Model::load(&lacking).err().unwrap().to_string();
        assert!(error.contains(name), "{error}");
    }
    let other = ModelConfig { bonds: 9, ..config };
    let mut writer = ModelWriter::new("other", other);
    for tensor in file.tensors() {
        writer = writer.tensor(tensor.name, tensor.shape, tensor.data);
    }
    let other = AlignedBuffer::copy_of(&writer.finish().unwrap());
    let error = Model::load(&other).err().unwrap().to_string();
    assert!(error.contains("bonds.net.0.weight"), "{error}");
    assert_eq!(BOND_FEATURES, 16);

    // Every version from 6 on says so in its prefix; a newer one is refused.
    let mut newer = packed.to_vec();
    newer[8] = 11;
    let newer = AlignedBuffer::copy_of(&newer);
    let error = ModelFile::parse(&newer).err().unwrap();
    assert_eq!(error, FormatError::Version { found: 11, supported: 10 });
}

/// Damaged anywhere, a file with bonds is refused or loads; nothing panics.
#[test]
fn damaged_files_are_refused() {
    let packed = packed_model("tiny-breaking");
    let mut random = Random(11);
    for _ in 0..200 {
        let mut bytes = packed.to_vec();
        let place = (random.bits() % bytes.len() as u64) as usize;
        bytes[place] ^= 1 << (random.bits() % 8);
        assert!(Model::load(&AlignedBuffer::copy_of(&bytes)).is_err(), "byte {place}");
        let cut = AlignedBuffer::copy_of(&packed[..place]);
        assert!(Model::load(&cut).is_err(), "{place} bytes");
    }
}
