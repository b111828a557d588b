//! Every kind of bad input gets its own error, and the scene stays what it was.
#![allow(missing_docs, clippy::unwrap_used, clippy::expect_used, clippy::panic)]

use nalgebra::{Isometry3, Point3, Translation3, UnitQuaternion};
use rigidformer_core::{
    CommandError, EditError, Layout, Limits, LoadError, MAX_PLANES, Model, NoTrace, ObserveError,
    Observed, Physics, Plane, Portable, Role, Schedule, Simulator, SlabSizes, Slabs, StepError,
    Unit, UnitId, UnitSlot, WorkspaceError,
};
use rigidformer_tests::{
    Golden, Inputs, data, observed, packed_model, poses, seconds, with_simulator,
};
use rigidformer_weights::{AlignedBuffer, ModelConfig, ModelFile, ModelWriter, Shape, TensorData};

/// Observes a good scene, then expects `error` from bad input and the same scene after it.
fn refused(
    error: ObserveError,
    text: &str,
    bad: impl FnOnce(
        &mut Simulator<'_, '_>,
        &Inputs,
    ) -> Result<rigidformer_core::Observation, ObserveError>,
) {
    let golden = Golden::read("tiny-paper-inputs");
    let inputs = golden.inputs();
    with_simulator(&packed_model("tiny-paper-inputs"), 700, |simulator| {
        simulator.observe_poses(seconds(1), inputs.posed()).unwrap();
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

const NONE: [Observed<'static>; 0] = [];

const BAD_INERTIAS: [[f32; 3]; 7] = [
    [0.0, 0.0, 0.0],
    [1.0, 1.0, 0.0],
    [1.0, -1.0, 1.0],
    [1.0, f32::NAN, 1.0],
    [f32::INFINITY, 1.0, 1.0],
    [1e19, 1e19, 1e19],
    // Greater than the sum of the others.
    [1.0, 2.01, 1.0],
];

fn still(points: &[Point3<f32>], physics: Physics) -> Observed<'_> {
    Observed { unit: Unit::new(points, physics), current: points }
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
                    s.observe(seconds(1), observed(&inputs.physics, &points[0], &points[1]))
                },
            );
        }
        refused(ObserveError::BadPoint { unit: 0, point: 0 }, "drop it", |s, inputs| {
            let mut inputs = Golden::read("tiny-paper-inputs")
                .inputs()
                .permuted(&(0..inputs.points.len()).collect::<Vec<_>>());
            inputs.points[0][0].x = bad;
            s.observe_poses(seconds(1), inputs.posed())
        });
    }
}

#[test]
fn no_units_and_too_many() {
    refused(ObserveError::NoUnits, "at least one", |s, _| s.observe(seconds(1), NONE));
    refused(ObserveError::TooManyUnits { found: 17, limit: 16 }, "17 units", |s, inputs| {
        s.observe(seconds(1), [still(&inputs.points[0], inputs.physics[0]); 17])
    });
    refused(ObserveError::TooManyPoints { found: 800, limit: 700 }, "thin them", |s, inputs| {
        let many: Vec<_> = (0..800).map(|i| Point3::new(i as f32, 0.5, 1.0)).collect();
        s.observe(seconds(1), [still(&many, inputs.physics[0])])
    });
}

#[test]
fn units_without_extent() {
    refused(ObserveError::TooFewPoints { unit: 1, found: 3 }, "at least 4", |s, inputs| {
        let mut points = frames(inputs);
        points[0][1].truncate(3);
        s.observe(seconds(1), observed(&inputs.physics, &points[0], &points[1]))
    });
    refused(ObserveError::Coincident { unit: 0 }, "coincide", |s, inputs| {
        let points = [Point3::new(1.0, 2.0, 3.0); 8];
        s.observe(seconds(1), [still(&points, inputs.physics[0])])
    });
    refused(ObserveError::Coincident { unit: 1 }, "coincide", |s, inputs| {
        let mut points = frames(inputs);
        points[1][1].fill(Point3::new(1.0, 2.0, 3.0));
        s.observe(seconds(1), observed(&inputs.physics, &points[0], &points[1]))
    });
    refused(ObserveError::Coincident { unit: 0 }, "coincide", |s, inputs| {
        let dust = [0.0, 3e-23, 7e-23, 1e-22].map(|x| Point3::new(x, 0.0, 0.0));
        s.observe(seconds(1), [still(&dust, inputs.physics[0])])
    });
}

#[test]
fn frames_that_do_not_match() {
    let mut left = 0;
    let count = Golden::read("tiny-paper-inputs").inputs().points[3].len();
    refused(
        ObserveError::PointMismatch { unit: 3, previous: count, current: count - 1 },
        "same points in the same order",
        |s, inputs| {
            let mut points = frames(inputs);
            points[1][3].pop();
            left += 1;
            s.observe(seconds(1), observed(&inputs.physics, &points[0], &points[1]))
        },
    );
}

#[test]
fn steps_physics_and_poses() {
    for dt in [0.0, -0.1, f32::NAN, f32::INFINITY, 1e-45] {
        refused(ObserveError::BadTimestep, "seconds above 0", |s, inputs| {
            s.observe_poses(dt, inputs.posed())
        });
    }
    for (mass_kg, friction, restitution) in [
        (0.0, 0.5, 0.5),
        (-1.0, 0.5, 0.5),
        (f32::NAN, 0.5, 0.5),
        (1.0, -0.1, 0.5),
        (1.0, 0.5, f32::INFINITY),
    ] {
        refused(ObserveError::BadPhysics { unit: 4 }, "unit 4", |s, inputs| {
            let mut units = inputs.posed();
            units[4].unit.physics = Physics { mass_kg, friction, restitution };
            s.observe_poses(seconds(1), units)
        });
    }
    for moments in BAD_INERTIAS {
        refused(ObserveError::BadInertia { unit: 4 }, "inertia of unit 4", |s, inputs| {
            let mut units = inputs.posed();
            units[4].unit.inertia_kg_m2 = Some(moments);
            s.observe_poses(seconds(1), units)
        });
        refused(ObserveError::BadInertia { unit: 0 }, "the box", |s, inputs| {
            let first = still(&inputs.points[0], inputs.physics[0]);
            s.observe(seconds(1), [Observed { unit: first.unit.inertia(moments), ..first }])
        });
    }
    refused(ObserveError::BadPose { unit: 6 }, "pose of unit 6", |s, inputs| {
        let mut units = inputs.posed();
        units[6].current.translation.vector.z = f32::NAN;
        s.observe_poses(seconds(1), units)
    });
    refused(ObserveError::BadPose { unit: 0 }, "pose of unit 0", |s, inputs| {
        let mut units = inputs.posed();
        let zero = UnitQuaternion::new_unchecked(nalgebra::Quaternion::new(0.0, 0.0, 0.0, 0.0));
        units[0].previous = Isometry3::from_parts(Translation3::identity(), zero);
        s.observe_poses(seconds(1), units)
    });
}

#[test]
fn steps_before_their_time() {
    let golden = Golden::read("tiny");
    let inputs = golden.inputs();
    with_simulator(&packed_model("tiny"), 1000, |simulator| {
        assert_eq!(simulator.step(), Err(StepError::NoUnits));
        assert!(simulator.unit(0).is_none() && simulator.is_empty());
        simulator.observe_poses(seconds(10), inputs.posed()).unwrap();
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
            simulator.observe_poses(seconds(step), inputs.posed()).unwrap();
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
        simulator.observe_poses(seconds(1), inputs.posed()).unwrap();
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
        let mut units = vec![UnitSlot::EMPTY; 4];
        let slabs =
            Slabs { f32: &mut numbers, i8: &mut bytes, points: &mut points, units: &mut units };
        Simulator::new(&model, limits, slabs).map(|_| ()).unwrap_err()
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
    let short = WorkspaceError::UnitSlab { needed: 5, found: 4 };
    assert_eq!(new(wide, 1 << 22, 1 << 20, 64), short);
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

/// Observes a good scene, then expects `error` from a bad change and the same scene after it.
fn unchanged(
    error: EditError,
    text: &str,
    bad: impl FnOnce(&mut Simulator<'_, '_>, &Inputs) -> Result<(), EditError>,
) {
    let inputs = Golden::read("tiny-impact").inputs();
    with_simulator(&packed_model("tiny-impact"), 700, |simulator| {
        simulator.observe_poses(seconds(5), inputs.posed()).unwrap();
        let before = poses(simulator);
        let (planes, gravity) = (simulator.planes().to_vec(), simulator.gravity_m_s2());
        let (ids, dt): (Vec<_>, _) =
            (simulator.units().map(|unit| unit.id()).collect(), simulator.dt_s());
        assert_eq!(bad(simulator, &inputs), Err(error));
        assert!(error.to_string().contains(text), "{error}");
        assert_eq!(poses(simulator), before);
        assert_eq!((simulator.planes(), simulator.gravity_m_s2()), (&planes[..], gravity));
        assert!(simulator.units().map(|unit| unit.id()).eq(ids) && simulator.dt_s() == dt);
        simulator.step().unwrap();
    });
}

#[test]
fn changes_of_what_is_not_there() {
    let nobody = UnitId::from_bits(u64::MAX);
    let here = Isometry3::translation(0.0, 0.0, 1.0);
    let physics = Physics { mass_kg: 1.0, friction: 0.5, restitution: 0.5 };
    let gone = EditError::NoSuchUnit { id: nobody };
    unchanged(gone, "names no unit", |s, _| s.remove(nobody));
    unchanged(gone, "removed", |s, _| s.drive(nobody, &here));
    unchanged(gone, "another scene", |s, _| s.set_poses(nobody, &here, &here));
    unchanged(gone, "names no unit", |s, _| s.set_physics(nobody, physics));
    unchanged(gone, "names no unit", |s, _| s.set_role(nobody, Role::Fixed));
    let copy = EditError::NoSuchCopy { copy: 1, copies: 1 };
    unchanged(copy, "call replicate first", |s, _| {
        let id = s.unit(0).unwrap().id();
        s.set_poses_in(1, id, &here, &here)
    });
    // Names of a scene that was observed before name nobody.
    let inputs = Golden::read("tiny-impact").inputs();
    with_simulator(&packed_model("tiny-impact"), 700, |simulator| {
        simulator.observe_poses(seconds(5), inputs.posed()).unwrap();
        let old = simulator.unit(0).unwrap().id();
        simulator.observe_poses(seconds(5), inputs.posed()).unwrap();
        assert_eq!(simulator.remove(old), Err(EditError::NoSuchUnit { id: old }));
        assert!(simulator.get(old).is_none() && simulator.pose(old).is_none());
    });
}

#[test]
fn changes_that_cannot_be() {
    let here = Isometry3::translation(0.0, 0.0, 1.0);
    let nowhere = Isometry3::translation(0.0, f32::NAN, 1.0);
    let first = |s: &Simulator<'_, '_>| s.unit(0).unwrap().id();
    let mut id = UnitId::from_bits(0);
    with_simulator(&packed_model("tiny-impact"), 700, |simulator| {
        simulator.observe_poses(seconds(5), Golden::read("tiny-impact").inputs().posed()).unwrap();
        id = first(simulator);
    });
    unchanged(EditError::NotDriven { id }, "Role::Driven", |s, _| s.drive(first(s), &here));
    let bad_pose = EditError::Unit(ObserveError::BadPose { unit: 0 });
    unchanged(bad_pose, "pose of unit 0", |s, _| s.set_poses(first(s), &here, &nowhere));
    unchanged(bad_pose, "pose of unit 0", |s, _| {
        s.set_role(first(s), Role::Driven).unwrap();
        s.drive(first(s), &nowhere)
    });
    let physics = Physics { mass_kg: 0.0, friction: 0.5, restitution: 0.5 };
    let bad_physics = EditError::Unit(ObserveError::BadPhysics { unit: 0 });
    unchanged(bad_physics, "mass", |s, _| s.set_physics(first(s), physics));
    let dt = EditError::Unit(ObserveError::BadTimestep);
    // At the last one the moving units would come from beyond the largest coordinate.
    for bad in [0.0, -1.0, f32::NAN, f32::INFINITY, 1e30] {
        unchanged(dt, "seconds", |s, _| s.set_dt(bad));
    }
    for bad in [f32::NAN, f32::INFINITY, 2e4] {
        unchanged(EditError::BadGravity, "gravity", |s, _| {
            s.set_gravity(nalgebra::Vector3::new(0.0, bad, -9.8))
        });
    }
    let ground = Plane::ground(0.3, 0.5);
    let many = [ground; MAX_PLANES + 1];
    let found = MAX_PLANES + 1;
    let too_many = EditError::TooManyPlanes { found, limit: MAX_PLANES };
    unchanged(too_many, "at most 8", |s, _| s.set_planes(&many));
    for bad in [
        Plane { normal: ground.normal * 1.1, ..ground },
        Plane { offset_m: f32::NAN, ..ground },
        Plane { offset_m: 1e7, ..ground },
        Plane { friction: -0.1, ..ground },
        Plane { restitution: f32::INFINITY, ..ground },
    ] {
        unchanged(EditError::BadPlane { plane: 1 }, "length 1", |s, _| {
            s.set_planes(&[ground, bad])
        });
    }
}

#[test]
fn units_that_cannot_be_added() {
    let here = Isometry3::translation(0.0, 0.0, 5.0);
    let nowhere = Isometry3::translation(0.0, f32::NAN, 1.0);
    fn add(
        s: &mut Simulator<'_, '_>,
        unit: &Unit<'_>,
        at: &Isometry3<f32>,
    ) -> Result<(), EditError> {
        s.add(unit, at, at).map(|_| ())
    }
    let unit = EditError::Unit;
    unchanged(
        unit(ObserveError::TooFewPoints { unit: 10, found: 3 }),
        "at least 4",
        |s, inputs| add(s, &Unit::new(&inputs.points[0][..3], inputs.physics[0]), &here),
    );
    for moments in BAD_INERTIAS {
        let error = unit(ObserveError::BadInertia { unit: 10 });
        unchanged(error, "sum of the other two", |s, inputs| {
            add(s, &Unit::new(&inputs.points[0], inputs.physics[0]).inertia(moments), &here)
        });
    }
    unchanged(unit(ObserveError::BadPose { unit: 10 }), "pose of unit 10", |s, inputs| {
        add(s, &Unit::new(&inputs.points[0], inputs.physics[0]), &nowhere)
    });
    let points = Golden::read("tiny-impact").inputs().points;
    let total: usize = points.iter().map(Vec::len).sum();
    let many: Vec<_> = (0..700).map(|i| Point3::new(i as f32, 0.5, 1.0)).collect();
    let found = total + many.len();
    let error = unit(ObserveError::TooManyPoints { found, limit: 700 });
    unchanged(error, "thin them", |s, inputs| add(s, &Unit::new(&many, inputs.physics[0]), &here));
    unchanged(
        unit(ObserveError::TooManyUnits { found: 17, limit: 16 }),
        "17 units",
        |s, inputs| {
            let small = Unit::new(&inputs.points[0][..4], inputs.physics[0]);
            // All of those that fit are taken away again.
            let before: Vec<_> = s.units().map(|unit| unit.id()).collect();
            while s.len() < 16 {
                add(s, &small, &here)?;
            }
            let refused = add(s, &small, &here);
            let added: Vec<_> =
                s.units().map(|u| u.id()).filter(|id| !before.contains(id)).collect();
            added.into_iter().for_each(|id| s.remove(id).unwrap());
            refused
        },
    );
    // A scene without a time step has none to add to.
    let inputs = Golden::read("tiny-impact").inputs();
    let small = Unit::new(&inputs.points[0], inputs.physics[0]);
    with_simulator(&packed_model("tiny-impact"), 700, |simulator| {
        assert_eq!(add(simulator, &small, &here), Err(EditError::NoTimestep));
        assert_eq!(simulator.dt_s(), None);
        simulator.set_dt(0.01).unwrap();
        add(simulator, &small, &here).unwrap();
        assert_eq!((simulator.dt_s(), simulator.len()), (Some(0.01), 1));
        simulator.step().unwrap();
    });
}

/// A simulator steps on schedules of its own layout alone.
#[test]
fn schedules_of_another_layout() {
    #[derive(Clone, Copy)]
    struct Other;
    impl Schedule for Other {
        type Kernels = Portable;
        const LAYOUT: Layout = Layout { index: true, ..Layout::SMALL };
        fn kernels(self) -> Portable {
            Portable
        }
    }
    let inputs = Golden::read("tiny-impact").inputs();
    with_simulator(&packed_model("tiny-impact"), 700, |simulator| {
        simulator.observe_poses(seconds(5), inputs.posed()).unwrap();
        let before = poses(simulator);
        assert_eq!(simulator.step_on(Other, &mut NoTrace), Err(StepError::Layout));
        assert_eq!(poses(simulator), before);
        simulator.step().unwrap();
    });
}
