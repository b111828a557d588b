//! Every kind of bad input gets its own error, and the scene stays what it was.
#![allow(missing_docs, clippy::unwrap_used, clippy::expect_used, clippy::panic)]

use nalgebra::{Isometry3, Point3, Translation3, UnitQuaternion};
use rigidformer_core::{
    CommandError, Limits, LoadError, Model, ObserveError, Physics, Simulator, SlabSizes, Slabs,
    StepError, WorkspaceError,
};
use rigidformer_tests::{Golden, Inputs, data, packed_model, poses, with_simulator};
use rigidformer_weights::{AlignedBuffer, ModelConfig, ModelFile, ModelWriter, Shape, TensorData};

/// Observes a good scene, then expects `error` from bad input and the same scene after it.
fn refused(
    error: ObserveError,
    text: &str,
    bad: impl FnOnce(
        &mut Simulator<'_, '_, 16>,
        &Inputs,
    ) -> Result<rigidformer_core::Observation, ObserveError>,
) {
    let golden = Golden::read("tiny-paper-inputs");
    let inputs = golden.inputs();
    with_simulator(&packed_model("tiny-paper-inputs"), 700, |simulator| {
        simulator.observe_poses(1, &inputs.units(), &inputs.previous, &inputs.current).unwrap();
        let before = poses(simulator);
        assert_eq!(bad(simulator, &inputs), Err(error));
        assert!(error.to_string().contains(text), "{error}");
        assert_eq!(poses(simulator), before);
        simulator.step().unwrap();
    });
}

fn frames(inputs: &Inputs) -> [Vec<Vec<Point3<f32>>>; 2] {
    [inputs.frame(&inputs.previous), inputs.frame(&inputs.current)]
}

fn slices(frame: &[Vec<Point3<f32>>]) -> Vec<&[Point3<f32>]> {
    frame.iter().map(Vec::as_slice).collect()
}

#[test]
fn points_that_are_not_finite() {
    for bad in [f32::NAN, f32::INFINITY, f32::NEG_INFINITY, 2e6] {
        for frame in [0, 1] {
            refused(
                ObserveError::BadPoint { unit: 2, point: 5 },
                "point 5 of unit 2",
                |s, inputs| {
                    let mut points = frames(inputs);
                    points[frame][2][5].y = bad;
                    s.observe(1, &inputs.physics, &slices(&points[0]), &slices(&points[1]))
                },
            );
        }
        refused(ObserveError::BadPoint { unit: 0, point: 0 }, "drop it", |s, inputs| {
            let mut inputs = Golden::read("tiny-paper-inputs")
                .inputs()
                .permuted(&(0..inputs.points.len()).collect::<Vec<_>>());
            inputs.points[0][0].x = bad;
            s.observe_poses(1, &inputs.units(), &inputs.previous, &inputs.current)
        });
    }
}

#[test]
fn no_units_and_too_many() {
    refused(ObserveError::NoUnits, "at least one", |s, _| s.observe(1, &[], &[], &[]));
    refused(ObserveError::TooManyUnits { found: 17, limit: 16 }, "17 units", |s, inputs| {
        let points = [inputs.points[0].as_slice(); 17];
        s.observe(1, &[inputs.physics[0]; 17], &points, &points)
    });
    refused(ObserveError::TooManyPoints { found: 800, limit: 700 }, "thin them", |s, inputs| {
        let many: Vec<_> = (0..800).map(|i| Point3::new(i as f32, 0.5, 1.0)).collect();
        s.observe(1, &inputs.physics[..1], &[&many], &[&many])
    });
}

#[test]
fn units_without_extent() {
    refused(ObserveError::TooFewPoints { unit: 1, found: 3 }, "at least 4", |s, inputs| {
        let mut points = frames(inputs);
        points[0][1].truncate(3);
        s.observe(1, &inputs.physics, &slices(&points[0]), &slices(&points[1]))
    });
    refused(ObserveError::Coincident { unit: 0 }, "coincide", |s, inputs| {
        let points = [Point3::new(1.0, 2.0, 3.0); 8];
        s.observe(1, &inputs.physics[..1], &[&points], &[&points])
    });
    refused(ObserveError::Coincident { unit: 1 }, "coincide", |s, inputs| {
        let mut points = frames(inputs);
        points[1][1].fill(Point3::new(1.0, 2.0, 3.0));
        s.observe(1, &inputs.physics, &slices(&points[0]), &slices(&points[1]))
    });
    refused(ObserveError::Coincident { unit: 0 }, "coincide", |s, inputs| {
        let dust = [0.0, 3e-23, 7e-23, 1e-22].map(|x| Point3::new(x, 0.0, 0.0));
        s.observe(1, &inputs.physics[..1], &[&dust], &[&dust])
    });
}

#[test]
fn frames_that_do_not_match() {
    refused(
        ObserveError::FrameMismatch { previous: 10, current: 9, physics: 10 },
        "must agree",
        |s, inputs| {
            let points = frames(inputs);
            s.observe(1, &inputs.physics, &slices(&points[0]), &slices(&points[1][..9]))
        },
    );
    let mut left = 0;
    let count = Golden::read("tiny-paper-inputs").inputs().points[3].len();
    refused(
        ObserveError::PointMismatch { unit: 3, previous: count, current: count - 1 },
        "same points in the same order",
        |s, inputs| {
            let mut points = frames(inputs);
            points[1][3].pop();
            left += 1;
            s.observe(1, &inputs.physics, &slices(&points[0]), &slices(&points[1]))
        },
    );
}

#[test]
fn steps_physics_and_poses() {
    refused(ObserveError::ZeroStep, "at least one native frame", |s, inputs| {
        s.observe_poses(0, &inputs.units(), &inputs.previous, &inputs.current)
    });
    for (mass_kg, friction, restitution) in [
        (0.0, 0.5, 0.5),
        (-1.0, 0.5, 0.5),
        (f32::NAN, 0.5, 0.5),
        (1.0, -0.1, 0.5),
        (1.0, 0.5, f32::INFINITY),
    ] {
        refused(ObserveError::BadPhysics { unit: 4 }, "unit 4", |s, inputs| {
            let mut units = inputs.units();
            units[4].physics = Physics { mass_kg, friction, restitution };
            s.observe_poses(1, &units, &inputs.previous, &inputs.current)
        });
    }
    refused(ObserveError::BadPose { unit: 6 }, "pose of unit 6", |s, inputs| {
        let mut poses = inputs.current.clone();
        poses[6].translation.vector.z = f32::NAN;
        s.observe_poses(1, &inputs.units(), &inputs.previous, &poses)
    });
    refused(ObserveError::BadPose { unit: 0 }, "pose of unit 0", |s, inputs| {
        let mut poses = inputs.previous.clone();
        let zero = UnitQuaternion::new_unchecked(nalgebra::Quaternion::new(0.0, 0.0, 0.0, 0.0));
        poses[0] = Isometry3::from_parts(Translation3::identity(), zero);
        s.observe_poses(1, &inputs.units(), &poses, &inputs.current)
    });
}

#[test]
fn steps_before_their_time() {
    let golden = Golden::read("tiny");
    let inputs = golden.inputs();
    with_simulator(&packed_model("tiny"), 1000, |simulator| {
        assert_eq!(simulator.step(), Err(StepError::NotObserved));
        assert!(simulator.pose(0).is_none() && simulator.is_empty());
        simulator.observe_poses(10, &inputs.units(), &inputs.previous, &inputs.current).unwrap();
        assert_eq!(simulator.step(), Err(StepError::NoCommand { size: 3 }));
        assert_eq!(
            simulator.set_command(&[0.0; 2]),
            Err(CommandError::Size { expected: 3, found: 2 })
        );
        assert_eq!(
            simulator.set_command(&[0.0, f32::NAN, 0.0]),
            Err(CommandError::NotFinite { index: 1 })
        );
        simulator.set_command(&[0.0, 0.5, 0.0]).unwrap();
        simulator.step().unwrap();
    });
}

/// Any positive step code is accepted; where the prediction leaves the world, that is said.
#[test]
fn unusual_step_codes() {
    let inputs = Golden::read("tiny-paper-inputs").inputs();
    for name in ["tiny-paper-inputs", "tiny-impact"] {
        unusual_step_codes_of(name, &inputs);
    }
}

fn unusual_step_codes_of(name: &str, inputs: &Inputs) {
    with_simulator(&packed_model(name), 1000, |simulator| {
        for step in [2, 3, 7, 24, 240, 100_000, u32::MAX] {
            simulator
                .observe_poses(step, &inputs.units(), &inputs.previous, &inputs.current)
                .unwrap();
            let before = poses(simulator);
            match simulator.step() {
                Ok(_) => {
                    assert!(poses(simulator).iter().all(|p| p.translation.vector.norm() < 2e6))
                }
                Err(error) => {
                    assert!(matches!(error, StepError::Diverged { .. }) && step > 240, "{step}");
                    assert_eq!(poses(simulator), before);
                }
            }
        }
    });
}

/// A model that predicts nonsense is stopped before the scene changes.
#[test]
fn diverging_predictions() {
    let inputs = Golden::read("tiny-paper-inputs").inputs();
    let file = packed_model("tiny-paper-inputs");
    let broken = rewritten(&file, |name, values| {
        if name == "anchors.head.1.bias" {
            values.fill(3e38);
        }
    });
    with_simulator(&broken, 1000, |simulator| {
        simulator.observe_poses(1, &inputs.units(), &inputs.previous, &inputs.current).unwrap();
        let before = poses(simulator);
        assert!(matches!(simulator.step(), Err(StepError::Diverged { unit: 0 })));
        assert_eq!(poses(simulator), before);
    });
}

/// A packed file with its f32 tensors changed.
fn rewritten(file: &[u8], mut change: impl FnMut(&str, &mut [f32])) -> AlignedBuffer {
    let file = ModelFile::parse(file).unwrap();
    let mut writer = ModelWriter::new(file.name(), *file.config());
    let mut tensors = Vec::new();
    for tensor in file.tensors() {
        let TensorData::F32(values) = tensor.data else { panic!("f32 expected") };
        let mut values = values.to_vec();
        change(tensor.name, &mut values);
        tensors.push((tensor.name, tensor.shape, values));
    }
    for (name, shape, values) in &tensors {
        writer = writer.tensor(name, *shape, TensorData::F32(values));
    }
    AlignedBuffer::copy_of(&writer.finish().unwrap())
}

#[test]
fn slabs_and_limits() {
    let file = packed_model("tiny");
    let model = Model::load(&file).unwrap();
    let limits = Limits { units: 4, points: 64 };
    let sizes = SlabSizes::new(model.config(), limits);
    let new = |limits: Limits, numbers: usize, bytes: usize, points: usize| {
        let mut numbers = vec![0.0; numbers];
        let mut bytes = vec![0; bytes];
        let mut points = vec![Point3::origin(); points];
        let slabs = Slabs { f32: &mut numbers, i8: &mut bytes, points: &mut points };
        Simulator::<4>::new(&model, limits, slabs).map(|_| ()).unwrap_err()
    };
    let (needed, found) = (sizes.f32, sizes.f32 - 1);
    assert_eq!(new(limits, found, sizes.i8, 64), WorkspaceError::F32Slab { needed, found });
    assert_eq!(
        new(limits, needed, sizes.i8, 63),
        WorkspaceError::PointSlab { needed: 64, found: 63 }
    );
    let i8 = sizes.i8;
    let short = WorkspaceError::I8Slab { needed: i8, found: i8 - 1 };
    assert_eq!(new(limits, needed, i8 - 1, 64), short);
    // Models with impacts keep the extreme points of units besides.
    let impacts = packed_model("tiny-impact");
    assert_eq!(SlabSizes::new(Model::load(&impacts).unwrap().config(), limits).points, 128);
    let wide = Limits { units: 5, points: 64 };
    assert_eq!(new(wide, 1 << 22, 1 << 20, 64), WorkspaceError::Units { limit: 5, capacity: 4 });
}

#[test]
fn files_that_are_no_models() {
    let load = |bytes: &[u8]| Model::load(&AlignedBuffer::copy_of(bytes)).map(|_| ()).unwrap_err();
    let good = packed_model("tiny");
    for bytes in
        [&b""[..], b"RFMODEL", b"PK\x03\x04 a zip file, not a model at all, but long enough"]
    {
        assert!(matches!(load(bytes), LoadError::Format(_)));
    }
    let safetensors = std::fs::read(data("tiny.model.safetensors")).unwrap();
    assert!(matches!(load(&safetensors), LoadError::Format(_)));
    for length in (0..good.len()).step_by(997) {
        assert!(matches!(load(&good[..length]), LoadError::Format(_)), "{length}");
    }
    // Sound files of incomplete or foreign models.
    let empty = ModelWriter::new("empty", ModelConfig::TINY)
        .tensor("x", Shape::Vector(1), TensorData::F32(&[0.0]))
        .finish()
        .unwrap();
    let error = load(&empty);
    assert!(
        matches!(error, LoadError::MissingTensor(_)) && error.to_string().contains("missing"),
        "{error}"
    );
}
