//! What must not change the answer, and what must not change over time.
#![allow(missing_docs, clippy::unwrap_used, clippy::expect_used, clippy::panic)]

use nalgebra::{Isometry3, Point3, Translation3, UnitQuaternion, Vector3};
use rigidformer_core::{Limits, Model, Simulator, SlabSizes, Slabs, UnitSlot};
use rigidformer_tests::{
    Golden, Inputs, Random, observed, packed_model, pose_difference, poses, seconds, with_simulator,
};

const POINTS: usize = 2048;

fn run(
    file: &[u8],
    step: u32,
    command: Option<&[f32]>,
    inputs: &Inputs,
    steps: usize,
) -> Vec<Isometry3<f32>> {
    with_simulator(file, POINTS, |simulator| {
        if let Some(command) = command {
            simulator.set_command(command).unwrap();
        }
        simulator.observe_poses(seconds(step), inputs.posed()).unwrap();
        for _ in 0..steps {
            simulator.step().unwrap();
        }
        poses(simulator)
    })
}

/// Units in another order give the same poses in that order; only sums over units round
/// differently.
#[test]
fn unit_permutation() {
    for name in ["tiny", "tiny-paper-inputs", "tiny-impact"] {
        let (file, golden) = (packed_model(name), Golden::read(name));
        let (inputs, command) = (golden.inputs(), golden.command());
        let straight = run(&file, golden.step, command.as_deref(), &inputs, 1);
        let mut random = Random(1);
        for _ in 0..5 {
            let order = random.order(inputs.points.len());
            let permuted = run(&file, golden.step, command.as_deref(), &inputs.permuted(&order), 1);
            let expected: Vec<_> = order.iter().map(|&i| straight[i]).collect();
            let (position, angle) = pose_difference(&permuted, &expected);
            assert!(position < 2e-6 && angle < 1e-5, "{name}: {position} m, {angle} rad");
        }
    }
}

/// Points in another order give the same bits: the simulator puts them into its own order,
/// which also settles which points are the anchors and in which order they come.
#[test]
fn point_order_and_anchor_reindexing() {
    for name in ["tiny", "tiny-impact"] {
        point_order_and_anchor_reindexing_of(name);
    }
}

fn point_order_and_anchor_reindexing_of(name: &str) {
    let (file, golden) = (packed_model(name), Golden::read(name));
    let (mut inputs, command) = (golden.inputs(), golden.command());
    let straight = run(&file, golden.step, command.as_deref(), &inputs, 3);
    let mut random = Random(2);
    for _ in 0..5 {
        for points in &mut inputs.points {
            let order = random.order(points.len());
            *points = order.iter().map(|&i| points[i]).collect();
        }
        assert_eq!(run(&file, golden.step, command.as_deref(), &inputs, 3), straight);
    }
}

/// The same through frames of points, whose poses are fitted.
#[test]
fn point_order_of_observed_frames() {
    let (file, golden) = (packed_model("tiny"), Golden::read("tiny"));
    let (mut inputs, command) = (golden.inputs(), golden.command().unwrap());
    let observe = |inputs: &Inputs| {
        let (before, now) = (inputs.frame(&inputs.previous), inputs.frame(&inputs.current));
        with_simulator(&file, POINTS, |simulator| {
            simulator.set_command(&command).unwrap();
            let report = simulator
                .observe(seconds(golden.step), observed(&inputs.physics, &before, &now))
                .unwrap();
            assert!(report.residual_m < 5e-6, "{report:?}");
            simulator.step().unwrap();
            let units = simulator.units();
            units
                .map(|unit| unit.points().map(|p| p.coords).sum::<Vector3<f32>>())
                .collect::<Vec<_>>()
        })
    };
    let straight = observe(&inputs);
    let mut random = Random(3);
    for points in &mut inputs.points {
        let order = random.order(points.len());
        *points = order.iter().map(|&i| points[i]).collect();
    }
    for (a, b) in observe(&inputs).iter().zip(&straight) {
        assert!((a - b).norm() / (1.0 + b.norm()) < 2e-5, "{a} against {b}");
    }
}

/// Turning the world about z turns what is exact (free motion, gate, rigid fit) with it.
/// The network itself is not equivariant (paper, section III); a model whose head is silent
/// leaves the rigid step alone.
#[test]
fn z_rotation_of_the_rigid_step() {
    let (file, golden) = (packed_model("tiny"), Golden::read("tiny"));
    let inputs = golden.inputs();
    let mut random = Random(4);
    for _ in 0..5 {
        let turn = Isometry3::from_parts(
            Translation3::new(random.uniform(), random.uniform(), 0.0),
            UnitQuaternion::from_axis_angle(&Vector3::z_axis(), 3.0 * random.uniform()),
        );
        // High up, nothing can touch: every unit takes the exact path.
        let lift = |pose: &Isometry3<f32>, i: usize| {
            Translation3::new(0.0, 0.0, 50.0 + 20.0 * i as f32) * pose
        };
        let raise = |poses: &[Isometry3<f32>]| -> Vec<_> {
            poses.iter().enumerate().map(|(i, p)| lift(p, i)).collect()
        };
        let free = Inputs {
            points: inputs.points.clone(),
            physics: inputs.physics.clone(),
            previous: raise(&inputs.previous),
            current: raise(&inputs.current),
        };
        let turned = Inputs {
            points: inputs.points.clone(),
            physics: inputs.physics.clone(),
            previous: free.previous.iter().map(|p| turn * p).collect(),
            current: free.current.iter().map(|p| turn * p).collect(),
        };
        let command = golden.command();
        let straight = run(&file, golden.step, command.as_deref(), &free, 5);
        let expected: Vec<_> = straight.iter().map(|p| turn * p).collect();
        let turned = run(&file, golden.step, command.as_deref(), &turned, 5);
        let (position, angle) = pose_difference(&turned, &expected);
        // Coordinates up to 250 m round at 1.5e-5 m, five times amplified by the velocity.
        assert!(position < 5e-4 && angle < 2e-5, "{position} m, {angle} rad");
    }
}

/// After 500 steps every pair of points of a unit is as far apart as in its reference.
#[test]
fn units_stay_rigid_over_500_steps() {
    for name in ["tiny", "tiny-paper-inputs", "tiny-impact"] {
        let (file, golden) = (packed_model(name), Golden::read(name));
        let (inputs, command) = (golden.inputs(), golden.command());
        let worst = with_simulator(&file, POINTS, |simulator| {
            if let Some(command) = &command {
                simulator.set_command(command).unwrap();
            }
            simulator.observe_poses(seconds(golden.step), inputs.posed()).unwrap();
            for _ in 0..500 {
                // An untrained model may send units far off; that they stay rigid counts.
                if simulator.step().is_err() {
                    break;
                }
            }
            let mut worst = 0.0_f32;
            for (i, unit) in simulator.units().enumerate() {
                let r = unit.internal_pose().rotation;
                worst = worst.max((r.transpose() * r - nalgebra::Matrix3::identity()).norm());
                let carried: Vec<_> = inputs.points[i].iter().map(|p| r * p.coords).collect();
                for (a, p) in carried.iter().zip(&inputs.points[i]) {
                    for (b, q) in carried.iter().zip(&inputs.points[i]) {
                        worst = worst.max(((a - b).norm() - (p - q).norm()).abs());
                    }
                }
            }
            worst
        });
        println!("{name}: {worst:.1e}");
        assert!(worst < 2e-6, "{name}: {worst}");
    }
}

/// A longer or dirtier slab changes nothing.
#[test]
fn slab_contents_do_not_matter() {
    for name in ["tiny-paper-inputs", "tiny-impact"] {
        slab_contents_do_not_matter_to(name);
    }
}

fn slab_contents_do_not_matter_to(name: &str) {
    let (file, golden) = (packed_model(name), Golden::read(name));
    let inputs = golden.inputs();
    let expected = run(&file, golden.step, None, &inputs, 5);
    let model = Model::load(&file).unwrap();
    let limits = Limits { units: 12, points: 900 };
    let sizes = SlabSizes::new(model.config(), limits);
    let mut numbers = vec![1e9; sizes.f32 + 77];
    let mut points = vec![Point3::new(9.0, 9.0, 9.0); sizes.points + 3];
    let mut bytes = vec![77; sizes.i8 + 5];
    let mut units = vec![UnitSlot::EMPTY; sizes.units + 4];
    let slabs = Slabs { f32: &mut numbers, i8: &mut bytes, points: &mut points, units: &mut units };
    let mut simulator = Simulator::new(&model, limits, slabs).unwrap();
    simulator.observe_poses(seconds(golden.step), inputs.posed()).unwrap();
    for _ in 0..5 {
        simulator.step().unwrap();
    }
    assert_eq!(poses(&simulator), expected);
}
