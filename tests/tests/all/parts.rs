//! Steps longer than the longest that a model knows, which are taken in equal parts.
#![allow(missing_docs, clippy::unwrap_used, clippy::expect_used, clippy::panic)]

use nalgebra::{Isometry3, Point3, Translation3, UnitQuaternion, Vector3};
use rigidformer_core::{
    EditError, Layer, Layout, Limits, MAX_SUB_STEPS, Model, Native, NoTrace, ObserveError, Physics,
    Posed, Role, Serial, Simulator, SlabSizes, Stage, StepError, Trace, Unit, UnitId,
};
use rigidformer_runtime::engine::Engine;
use rigidformer_runtime::kernels::Kernel;
use rigidformer_runtime::models::LoadedModel;
use rigidformer_runtime::threads::Threads;
use rigidformer_runtime::world::World;
use rigidformer_tests::{
    Golden, Room, packed_model, pose_difference, poses, with_similarity, with_simulator,
};
use rigidformer_weights::{AlignedBuffer, ModelConfig, ModelFile, ModelWriter, Similarity};

const POINTS: usize = 2048;
const RATE_HZ: f32 = 240.0;
const WOOD: Physics = Physics { mass_kg: 1.0, friction: 0.4, restitution: 0.3 };
const G: f32 = -10.0;

fn edge(longest_step: f32) -> AlignedBuffer {
    with_similarity(rigidformer_weights::EDGE, Similarity { length_m: 0.0, longest_step })
}

fn cube(half: f32) -> Vec<Point3<f32>> {
    let corner = |i: usize, bit: usize| if i & bit == 0 { -half } else { half };
    (0..8).map(|i| Point3::new(corner(i, 1), corner(i, 2), corner(i, 4))).collect()
}

fn at(x: f32, y: f32, z: f32) -> Isometry3<f32> {
    Isometry3::translation(x, y, z)
}

/// What a unit with a velocity and a spin was so many seconds before it is at `now`: without gravity.
fn before(
    now: &Isometry3<f32>,
    velocity: Vector3<f32>,
    spin: Vector3<f32>,
    seconds: f32,
) -> Isometry3<f32> {
    let back = UnitQuaternion::from_scaled_axis(spin * -seconds);
    let place = now.translation.vector - velocity * seconds;
    Isometry3::from_parts(Translation3::from(place), back * now.rotation)
}

/// Where all units of all copies are and were, as bits.
fn state(simulator: &Simulator<'_, '_>) -> Vec<u32> {
    let units = (0..).map_while(|number| simulator.unit(number));
    let poses = units.flat_map(|unit| [unit.pose(), unit.previous_pose()]);
    let numbers = |pose: Isometry3<f32>| {
        let place = pose.translation.vector;
        place.iter().chain(&pose.rotation.coords).map(|v| v.to_bits()).collect::<Vec<_>>()
    };
    poses.flat_map(numbers).collect()
}

#[test]
fn free_fall_is_exact() {
    let points = cube(0.2);
    let (velocity, spin) = (Vector3::new(1.0, -2.0, 3.0), Vector3::new(0.5, -1.0, 2.0));
    for (code, longest) in [(40.0, 5.0), (40.0, 6.0), (33.3, 10.0), (40.0, 0.0)] {
        with_simulator(&edge(longest), POINTS, |simulator| {
            let dt = code / RATE_HZ;
            let start = at(0.0, 0.0, 2.0);
            simulator.set_planes(&[]).unwrap();
            let unit = Unit::new(&points, WOOD);
            let posed =
                Posed { unit, previous: before(&start, velocity, spin, dt), current: start };
            simulator.observe_poses(dt, [posed]).unwrap();
            let read = simulator.unit(0).unwrap().previous_pose();
            let difference = pose_difference(&[read], &[posed.previous]);
            assert!(difference.0 < 2e-5 && difference.1 < 1e-5, "{difference:?}");
            for step in 1..=5 {
                simulator.step().unwrap();
                // Each step's mean velocity is g dt more than that of the one before.
                let n = step as f32;
                let fall = 0.5 * n * (n + 1.0) * G * dt * dt;
                let place = start.translation.vector + velocity * (dt * n) + Vector3::z() * fall;
                let turn = UnitQuaternion::from_scaled_axis(spin * (dt * n));
                let expected = Isometry3::from_parts(Translation3::from(place), turn);
                let found = simulator.unit(0).unwrap().pose();
                let difference = pose_difference(&[found], &[expected]);
                assert!(difference.0 < 5e-4 && difference.1 < 1e-4, "{step}: {difference:?}");
            }
            // Another step, then: the velocity that units have now is kept, half a step after the mean of the last.
            let velocity = velocity + Vector3::z() * (5.5 * G * dt);
            let dt = 7.0 / RATE_HZ;
            simulator.set_dt(dt).unwrap();
            let unit = simulator.unit(0).unwrap();
            let way = (velocity - Vector3::z() * (0.5 * G * dt)) * dt;
            let expected = unit.pose().translation.vector - way;
            let found = unit.previous_pose().translation.vector;
            assert!((found - expected).norm() < 2e-4, "{found} {expected}");
        });
    }
}

/// Against a simulator that is told to take the parts as steps.
#[test]
fn a_step_is_its_parts() {
    let points = cube(0.2);
    let unit = Unit::new(&points, WOOD);
    let (dt, parts) = (20.0 / RATE_HZ, 4);
    let part = dt / parts as f32;
    let (down, fast) = (Vector3::new(0.0, 0.0, -2.0), Vector3::new(1.0, 0.2, 0.0));
    let spin = Vector3::new(0.3, 0.7, 0.1);
    let table = at(0.0, 0.0, 0.2);
    let currents = [at(0.1, 0.03, 0.75), at(-0.6, 0.1, 0.8)];
    let run = |file: &[u8], step_s: f32, steps: usize| {
        with_simulator(file, POINTS, |simulator| {
            let free = |current: Isometry3<f32>, velocity: Vector3<f32>| {
                let previous = before(&current, velocity, spin, dt);
                Posed { unit, previous, current }
            };
            let still = |role, pose| Posed { unit: unit.role(role), previous: pose, current: pose };
            let held = [still(Role::Fixed, table), still(Role::Driven, at(0.8, 0.0, 0.6))];
            let scene = [free(currents[0], down), free(currents[1], fast), held[0], held[1]];
            simulator.observe_poses(step_s, scene).unwrap();
            let ids: Vec<_> = simulator.units().map(|unit| unit.id()).collect();
            if step_s < dt {
                // The last part's mean velocity is ahead of the step's by what gravity adds in between.
                let ahead = Vector3::z() * (G * 0.5 * (dt - step_s));
                for ((id, current), velocity) in ids.iter().zip(&currents).zip([down, fast]) {
                    let previous = before(current, velocity + ahead, spin, step_s);
                    simulator.set_poses(*id, &previous, current).unwrap();
                }
            }
            let mut active = 0;
            for step in 1..=steps {
                let place = 0.8 - 0.3 * step_s * step as f32;
                simulator.drive(ids[3], &at(place, 0.0, 0.6)).unwrap();
                active += simulator.step().unwrap().active_units;
            }
            assert!(active > 0);
            poses(simulator)
        })
    };
    let similarity = Similarity { length_m: 0.0, longest_step: 5.0 };
    let free = with_similarity(&packed_model("tiny-impact"), similarity);
    // Impulses make more of what rounding changes.
    for (name, file, steps) in [("tiny-impact", free, 6), ("edge", edge(5.0), 2)] {
        let whole = run(&file, dt, steps);
        let in_parts = run(&file, part, steps * parts);
        let difference = pose_difference(&whole, &in_parts);
        println!("{name}: {difference:?}");
        assert!(difference.0 < 1e-4 && difference.1 < 1e-3, "{name}: {difference:?}");
    }
}

#[test]
fn driven_units_arrive_to_the_bit() {
    let points = cube(0.2);
    let unit = Unit::new(&points, WOOD).role(Role::Driven);
    let dt = 30.0 / RATE_HZ;
    let target = |step: usize| {
        let turn = UnitQuaternion::from_scaled_axis(Vector3::new(0.3, 0.2, 0.5) * step as f32);
        Isometry3::from_parts(Translation3::new(0.1 * step as f32, 0.3, 0.7), turn)
    };
    let file = edge(4.0);
    let bits = |simulator: &Simulator<'_, '_>, id: UnitId| {
        let pose = simulator.get(id).unwrap().internal_pose();
        pose.rotation.iter().chain(&pose.centre).map(|v| v.to_bits()).collect::<Vec<_>>()
    };
    with_simulator(&file, POINTS, |simulator| {
        simulator.set_dt(dt).unwrap();
        let id = simulator.add(&unit, &target(0), &target(0)).unwrap();
        for step in 1..6 {
            simulator.drive(id, &target(step)).unwrap();
            simulator.step().unwrap();
            let alone = with_simulator(&file, POINTS, |other| {
                other.set_dt(dt).unwrap();
                let id = other.add(&unit, &target(step), &target(step)).unwrap();
                bits(other, id)
            });
            assert_eq!(bits(simulator, id), alone, "step {step}");
            // A step ago it was where it came from, as the last part's motion says.
            let read = simulator.get(id).unwrap().previous_pose();
            let difference = pose_difference(&[read], &[target(step - 1)]);
            assert!(difference.0 < 1e-5 && difference.1 < 1e-4, "{difference:?}");
            // Without a target it stays.
            let there = bits(simulator, id);
            simulator.step().unwrap();
            assert_eq!(bits(simulator, id), there);
        }
    });
}

#[test]
fn steps_that_are_too_long_are_refused() {
    let points = cube(0.2);
    let longest = 5.0 * MAX_SUB_STEPS as f32 / RATE_HZ;
    let unit = Unit::new(&points, WOOD);
    with_simulator(&edge(5.0), POINTS, |simulator| {
        let posed = Posed { unit, previous: at(0.0, 0.0, 3.0), current: at(0.0, 0.0, 3.0) };
        simulator.observe_poses(longest, [posed]).unwrap();
        let before = state(simulator);
        let refused = simulator.set_dt(longest * 1.5).unwrap_err();
        let EditError::Unit(error @ ObserveError::LongTimestep { substeps, longest_s, .. }) =
            refused
        else {
            panic!("{refused:?}")
        };
        assert!((substeps - 24.0).abs() < 1e-3 && (longest_s / longest - 1.0).abs() < 1e-5);
        println!("{error}");
        let far = Posed { current: at(9.0, 0.0, 3.0), ..posed };
        assert!(simulator.observe_poses(longest * 1.5, [far]).is_err());
        assert_eq!((state(simulator), simulator.dt_s()), (before, Some(longest)));
        simulator.set_dt(longest_s).unwrap();
        simulator.step().unwrap();
    });
}

/// Of scenes in their own measure the longest step depends on gravity and size.
#[test]
fn a_gravity_that_makes_steps_too_long_is_refused() {
    let similar = Similarity { length_m: 0.35, longest_step: 5.0 };
    let file = with_similarity(rigidformer_weights::EDGE, similar);
    let points = cube(0.2);
    let unit = Unit::new(&points, WOOD);
    with_simulator(&file, POINTS, |simulator| {
        let posed = Posed { unit, previous: at(0.0, 0.0, 3.0), current: at(0.0, 0.0, 3.0) };
        simulator.observe_poses(60.0 / RATE_HZ, [posed]).unwrap();
        let before = state(simulator);
        let strong = Vector3::new(0.0, 0.0, 10.0 * G);
        assert!(matches!(
            simulator.set_gravity(strong),
            Err(EditError::Unit(ObserveError::LongTimestep { .. }))
        ));
        assert_eq!((state(simulator), simulator.gravity_m_s2().z), (before, G));
        let small = cube(0.01);
        let tiny = Posed { unit: Unit::new(&small, WOOD), ..posed };
        assert!(simulator.observe_poses(60.0 / RATE_HZ, [tiny]).is_err());
        simulator.step().unwrap();
    });
}

/// The untrained model with a head so loud that units leave the world within a step.
fn loud() -> AlignedBuffer {
    let packed = packed_model("tiny-impact");
    let file = ModelFile::parse(&packed).unwrap();
    let similarity = Similarity { length_m: 0.0, longest_step: 40.0 };
    let config = ModelConfig { similarity, output_scale: 1e6, ..*file.config() };
    let mut writer = ModelWriter::new("loud", config);
    for tensor in file.tensors() {
        writer = writer.tensor(tensor.name, tensor.shape, tensor.data);
    }
    AlignedBuffer::copy_of(&writer.finish().unwrap())
}

#[test]
fn a_step_that_fails_in_a_part_is_undone() {
    let (file, golden) = (loud(), Golden::read("tiny-impact"));
    let inputs = golden.inputs();
    let model = Model::load(&file).unwrap();
    let limits = Limits { units: 16, points: POINTS };
    let mut room = Room::new(SlabSizes::of(model.config(), limits, 2, Layout::SMALL));
    let mut simulator =
        Simulator::with_layout(&model, limits, 2, Layout::SMALL, room.slabs()).unwrap();
    let dt = 16.0 * 40.0 / RATE_HZ;
    let mut posed = inputs.posed();
    posed[0].unit.role = Role::Driven;
    simulator.observe_poses(dt, posed).unwrap();
    let driven = simulator.unit(0).unwrap().id();
    simulator.drive(driven, &at(1.0, 2.0, 3.0)).unwrap();
    let before = state(&simulator);
    let error = simulator.step().unwrap_err();
    assert!(matches!(error, StepError::Diverged { .. }), "{error:?}");
    assert_eq!(state(&simulator), before);
    // Not at once: some parts of it went well.
    simulator.set_dt(40.0 / RATE_HZ).unwrap();
    simulator.step().unwrap();
    let arrived = simulator.get(driven).unwrap().pose();
    assert!(pose_difference(&[arrived], &[at(1.0, 2.0, 3.0)]).0 < 1e-5, "the target was kept");

    // Of two copies the one fails whose units meet; those of the other are far apart.
    simulator.observe_poses(dt, inputs.posed()).unwrap();
    assert_eq!(simulator.replicate(2), 2);
    let ids: Vec<_> = simulator.units().map(|unit| unit.id()).collect();
    for (number, id) in ids.iter().enumerate() {
        let place = at(100.0 * number as f32, 0.0, 50_000.0);
        simulator.set_poses_in(1, *id, &place, &place).unwrap();
    }
    let before = state(&simulator);
    let mut outcomes = vec![];
    simulator
        .step_copies(Serial(Native), &mut NoTrace, |copy, outcome| outcomes.push((copy, outcome)))
        .unwrap();
    let [(0, Err(first)), (1, Ok(second))] = outcomes[..] else { panic!("{outcomes:?}") };
    assert!(matches!(first, StepError::Diverged { .. }) && second.active_units == 0);
    let after = state(&simulator);
    let half = before.len() / 2;
    assert_eq!(after[..half], before[..half]);
    assert_ne!(after[half..], before[half..]);
    let fallen = simulator.unit(ids.len()).unwrap().pose().translation.z - 50_000.0;
    assert!((fallen - G * dt * dt / 2.0).abs() < 0.1, "{fallen}");
}

/// Copies of a scene go where it goes, bit for bit.
#[test]
fn copies_step_in_parts_as_the_scene_alone() {
    let golden = Golden::read("edge");
    let inputs = golden.inputs();
    let file = edge(3.0);
    let dt = golden.step as f32 * 2.0 / RATE_HZ;
    let alone = with_simulator(&file, POINTS, |simulator| {
        simulator.observe_poses(dt, inputs.posed()).unwrap();
        let reports = [simulator.step().unwrap(), simulator.step().unwrap()];
        (poses(simulator), reports)
    });
    let model = Model::load(&file).unwrap();
    let limits = Limits { units: 16, points: POINTS };
    let mut room = Room::new(SlabSizes::of(model.config(), limits, 3, Layout::SMALL));
    let mut simulator =
        Simulator::with_layout(&model, limits, 3, Layout::SMALL, room.slabs()).unwrap();
    simulator.observe_poses(dt, inputs.posed()).unwrap();
    assert_eq!(simulator.replicate(3), 3);
    for report in alone.1 {
        simulator
            .step_copies(Serial(Native), &mut NoTrace, |_, found| assert_eq!(found, Ok(report)))
            .unwrap();
    }
    let all: Vec<_> = (0..).map_while(|number| Some(simulator.unit(number)?.pose())).collect();
    assert_eq!(all, [alone.0.clone(), alone.0.clone(), alone.0].concat());
}

/// Stages that a step goes through.
struct Stages(Vec<Stage>);

impl Trace for Stages {
    fn record(&mut self, _: Layer, _: usize, _: &[f32]) {}

    fn records(&self) -> bool {
        false
    }

    fn enter(&mut self, stage: Stage) {
        self.0.push(stage);
    }
}

#[test]
fn a_step_leaves_out_a_network_that_corrects_nothing() {
    let points = cube(0.2);
    let engine = Engine { kernel: Kernel::Portable, threads: Threads::ONE };
    let model = LoadedModel::embedded("edge", rigidformer_weights::EDGE).unwrap();
    let run = |threads: Threads| {
        let limits = Limits { units: 2, points: 64 };
        let mut world = World::on(Engine { threads, ..engine }, &model, limits, 1).unwrap();
        // One falls from high above and lands, the other lies far off.
        let unit = Unit::new(&points, WOOD);
        let there = |x, z| Posed { unit, previous: at(x, 0.0, z), current: at(x, 0.0, z) };
        let units = [there(0.0, 1.5), there(50.0, 0.2)];
        world.edit(|simulator| simulator.observe_poses(10.0 / RATE_HZ, units)).unwrap();
        let mut seen = Vec::new();
        for _ in 0..30 {
            let mut stages = Stages(Vec::new());
            let report = world.step_traced(&mut stages).unwrap();
            seen.push((report.active_units, stages.0.contains(&Stage::Interaction)));
        }
        (state(world.simulator()), seen)
    };
    let (poses, seen) = run(Threads::ONE);
    let (whole, all) = run(Threads::ONE.whole());
    assert_eq!(poses, whole);
    assert!(all.iter().all(|(_, network)| *network));
    assert!(seen.iter().all(|(active, network)| *network == (*active > 0)), "{seen:?}");
    let with = seen.iter().filter(|(_, network)| *network).count();
    assert!((1..seen.len()).contains(&with), "it flies, and lands: {seen:?}");
}
