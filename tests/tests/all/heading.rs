//! Models that see a robot from its heading: docs/MODEL.md, sections 1 and 6.
#![allow(missing_docs, clippy::unwrap_used, clippy::expect_used, clippy::panic)]

use nalgebra::{Isometry3, Translation3, UnitQuaternion, Vector3};
use rigidformer_core::{Layer, Role, Simulator, StepReport, Trace};
use rigidformer_runtime::engine::Engine;
use rigidformer_runtime::kernels::Kernel;
use rigidformer_runtime::models::LoadedModel;
use rigidformer_runtime::threads::Threads;
use rigidformer_runtime::world::World;
use rigidformer_tests::{Golden, Inputs, packed_model, pose_difference, poses, with_simulator};
use rigidformer_weights::{
    ConfigError, Directions, FeatureSet, ModelConfig, ModelFile, Motion, Similarity,
};

const POINTS: usize = 2048;
const NAME: &str = "tiny-carried";

/// Layers of the network, in order.
#[derive(Default)]
struct Layers(Vec<f32>);

impl Trace for Layers {
    fn record(&mut self, layer: Layer, _: usize, values: &[f32]) {
        if matches!(layer, Layer::Features | Layer::Tokens | Layer::Head) {
            self.0.extend_from_slice(values);
        }
    }
}

fn inputs() -> (Inputs, Vec<f32>, f32) {
    let golden = Golden::read(NAME);
    (golden.inputs(), golden.command().unwrap(), golden.dt_s())
}

/// About the vertical, and over the ground.
fn moved(yaw: f32, x: f32, y: f32) -> Isometry3<f32> {
    let turn = UnitQuaternion::from_axis_angle(&Vector3::z_axis(), yaw);
    Isometry3::from_parts(Translation3::new(x, y, 0.0), turn)
}

fn observe(simulator: &mut Simulator<'_, '_>, inputs: &Inputs, dt_s: f32, world: &Isometry3<f32>) {
    let posed = inputs.posed().into_iter().map(|mut posed| {
        posed.previous = world * posed.previous;
        posed.current = world * posed.current;
        posed
    });
    simulator.observe_poses(dt_s, posed.collect::<Vec<_>>()).unwrap();
}

/// The network sees the same wherever the robot is and heads, and the prediction turns with it; a direction in the
/// command is one in the world.
#[test]
fn the_world_turned_turns_the_prediction() {
    let file = packed_model(NAME);
    let (inputs, command, dt_s) = inputs();
    let run = |world: &Isometry3<f32>, command: &[f32]| {
        with_simulator(&file, POINTS, |simulator| {
            simulator.set_command(command).unwrap();
            observe(simulator, &inputs, dt_s, world);
            let mut layers = Layers::default();
            simulator.step_traced(&mut layers).unwrap();
            (layers.0, poses(simulator))
        })
    };
    let (seen, straight) = run(&Isometry3::identity(), &command);
    for (yaw, x, y) in [(0.0, 3.0, -2.0), (1.0, 0.0, 0.0), (-2.5, -4.0, 1.0), (3.1, 10.0, 10.0)] {
        let world = moved(yaw, x, y);
        let along = world * Vector3::new(command[1], command[2], 0.0);
        let (again, turned) = run(&world, &[command[0], along.x, along.y]);
        let scale = seen.iter().fold(0.0_f32, |most, v| most.max(v.abs()));
        for (a, b) in seen.iter().zip(&again) {
            assert!((a - b).abs() < 2e-4 * scale, "{a} against {b}, {yaw}");
        }
        let expected: Vec<_> = straight.iter().map(|pose| world * pose).collect();
        let (position, angle) = pose_difference(&turned, &expected);
        assert!(position < 2e-5 && angle < 1e-4, "{yaw}: {position} m, {angle} rad");
        // Had the direction been the robot's own, another prediction would follow.
        if yaw != 0.0 {
            let (position, _) = pose_difference(&run(&world, &command).1, &expected);
            assert!(position > 1e-4, "{yaw}: {position} m");
        }
    }
}

/// Without a word from the network all parts go on together: a walk along a circle stays on it, and the body keeps its shape.
#[test]
fn a_silent_network_carries_the_body_on() {
    let golden = packed_model(NAME);
    let silent = rigidformer_tests::with_silent_head(&golden);
    let (mut inputs, command, dt_s) = inputs();
    // A step is a turn about (2, 1), the same for all parts.
    let about = Translation3::new(2.0, 1.0, 0.0);
    let stride = about * moved(0.2, 0.0, 0.0) * about.inverse();
    inputs.current = inputs.previous.iter().map(|pose| stride * pose).collect();
    with_simulator(&silent, POINTS, |simulator| {
        simulator.set_command(&command).unwrap();
        observe(simulator, &inputs, dt_s, &Isometry3::identity());
        let mut expected = inputs.current.clone();
        for _ in 0..20 {
            let report = simulator.step().unwrap();
            assert_eq!(report, StepReport { active_units: 10, ..StepReport::default() });
            expected.iter_mut().for_each(|pose| *pose = stride * *pose);
        }
        let (position, angle) = pose_difference(&poses(simulator), &expected);
        assert!(position < 1e-3 && angle < 1e-3, "{position} m, {angle} rad");
    });
}

/// Scenery and what is driven do not decide the heading, however heavy.
#[test]
fn only_free_units_lead() {
    let file = packed_model(NAME);
    let (inputs, command, dt_s) = inputs();
    let heaviest = |physics: &[rigidformer_core::Physics], but: Option<usize>| {
        let mut best = 0;
        for (number, physics_of) in physics.iter().enumerate() {
            if Some(number) != but
                && (Some(best) == but || physics_of.mass_kg > physics[best].mass_kg)
            {
                best = number;
            }
        }
        best
    };
    let first = heaviest(&inputs.physics, None);
    let features = |role: Role| {
        with_simulator(&file, POINTS, |simulator| {
            simulator.set_command(&command).unwrap();
            let mut posed = inputs.posed();
            posed[first].unit.role = role;
            simulator.observe_poses(dt_s, posed).unwrap();
            let mut layers = Layers::default();
            simulator.step_traced(&mut layers).unwrap();
            layers.0
        })
    };
    let lighter = heaviest(&inputs.physics, Some(first));
    assert_ne!(first, lighter);
    assert_ne!(features(Role::Free), features(Role::Fixed));
}

/// Copies under commands of their own, each with a heading of its own, on all kernels and any number of threads: the bits
/// of one alone.
#[test]
fn copies_have_headings_of_their_own() {
    let file = packed_model(NAME);
    let (inputs, command, dt_s) = inputs();
    let points = inputs.points.iter().map(Vec::len).sum();
    let limits = rigidformer_core::Limits { units: inputs.points.len(), points };
    let commands = [command.clone(), vec![0.7, -0.3, 0.9], vec![-1.0, 0.2, 0.1]];
    let alone = commands.each_ref().map(|command| {
        with_simulator(&file, POINTS, |simulator| {
            simulator.set_command(command).unwrap();
            observe(simulator, &inputs, dt_s, &Isometry3::identity());
            for _ in 0..5 {
                simulator.step().unwrap();
            }
            poses(simulator)
        })
    });
    assert_ne!(alone[0], alone[1]);
    for kernel in Kernel::available() {
        for threads in [1, 2] {
            let engine = Engine { kernel, threads: Threads::new(threads).eager() };
            let loaded = LoadedModel::copy_of(NAME, &file).unwrap().for_host().unwrap();
            let mut world = World::on(engine, &loaded, limits, 3).unwrap();
            world.edit(|simulator| {
                simulator.set_command(&command).unwrap();
                observe(simulator, &inputs, dt_s, &Isometry3::identity());
                assert_eq!(simulator.replicate(3), 3);
                for (copy, command) in commands.iter().enumerate() {
                    simulator.set_copy_command(copy, command).unwrap();
                }
            });
            for _ in 0..5 {
                engine.enter(|| {
                    world
                        .step_copies(&mut |_, report| {
                            report.unwrap();
                        })
                        .unwrap();
                });
            }
            let simulator = world.simulator();
            let units = simulator.len();
            for (copy, expected) in alone.iter().enumerate() {
                let found = (copy * units..(copy + 1) * units)
                    .map(|unit| simulator.unit(unit).unwrap().pose());
                assert_eq!(&found.collect::<Vec<_>>(), expected, "{kernel:?} {threads} {copy}");
            }
        }
    }
}

#[test]
fn files_say_what_they_hold() {
    let file = packed_model(NAME);
    let config = *ModelFile::parse(&file).unwrap().config();
    assert_eq!((config.motion, config.directions), (Motion::Robot, Directions::new(&[1])));
    assert_eq!(file[8..12], 5_u32.to_le_bytes(), "the version");
    let bad = |config: ModelConfig| config.validate().unwrap_err();
    assert_eq!(
        bad(ModelConfig { features: FeatureSet::Impact, ..config }),
        ConfigError::Robot { field: "features" }
    );
    let similarity = Similarity { length_m: 1.0, longest_step: 0.0 };
    assert_eq!(
        bad(ModelConfig { similarity, ..config }),
        ConfigError::Robot { field: "similarity" }
    );
    for (directions, motion) in [
        (Directions::new(&[2]), Motion::Robot),
        (Directions::new(&[0, 1]), Motion::Robot),
        (Directions(1 << 31), Motion::Robot),
        (Directions::new(&[1]), Motion::Free),
    ] {
        let found = directions.0;
        assert_eq!(
            bad(ModelConfig { directions, motion, ..config }),
            ConfigError::Directions { found, command_size: 3 }
        );
    }
}
