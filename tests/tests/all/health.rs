//! How far units are from what training saw: what is measured, and what is told apart by it.
#![allow(missing_docs, clippy::unwrap_used, clippy::expect_used, clippy::panic)]

use nalgebra::{Isometry3, Point3, Translation3, UnitQuaternion, Vector3};
use rigidformer_core::{Health, InnovationError, Physics, Posed, Role, Simulator, Unit, UnitId};
use rigidformer_runtime::noise::Noise;
use rigidformer_tests::firmware::TwoFrames;
use rigidformer_tests::{observed, seconds, with_simulator};
use rigidformer_weights::{AlignedBuffer, EDGE, ModelFile, ModelWriter, NANO, Quantity, Ranges};

const WOOD: Physics = Physics { mass_kg: 1.0, friction: 0.4, restitution: 0.5 };
/// Units of a scene.
const UNITS: usize = 6;
/// Points of one.
const POINTS: usize = 64;

/// Points of a ball, evenly.
fn ball(radius: f32) -> Vec<Point3<f32>> {
    let golden = std::f32::consts::PI * (3.0 - 5.0_f32.sqrt());
    let point = |i: usize| {
        let z = 1.0 - (2 * i + 1) as f32 / POINTS as f32;
        let (across, turn) = ((1.0 - z * z).sqrt(), golden * i as f32);
        Point3::new(across * turn.cos(), across * turn.sin(), z) * radius
    };
    (0..POINTS).map(point).collect()
}

fn cube(half: f32) -> Vec<Point3<f32>> {
    let corner = |i: usize, bit: usize| if i & bit == 0 { -half } else { half };
    (0..8).map(|i| Point3::new(corner(i, 1), corner(i, 2), corner(i, 4))).collect()
}

fn at(x: f32, y: f32, z: f32) -> Isometry3<f32> {
    Isometry3::translation(x, y, z)
}

/// A model's file with other ranges, or without.
fn with_ranges(model: &[u8], ranges: Option<Ranges>) -> AlignedBuffer {
    let file = ModelFile::parse(model).unwrap();
    let mut writer = ModelWriter::new(file.name(), *file.config()).ranges(ranges);
    for tensor in file.tensors() {
        writer = writer.tensor(tensor.name, tensor.shape, tensor.data);
    }
    AlignedBuffer::copy_of(&writer.finish().unwrap())
}

/// Six balls that are thrown onto each other, as in the scenes that the model learnt from; `change` tampers with the one in the middle
/// before they are observed.
fn throw(
    simulator: &mut Simulator<'_, '_>,
    seed: u64,
    step_code: f32,
    change: impl Fn(&mut Vec<Point3<f32>>, &mut Vector3<f32>),
) -> Vec<UnitId> {
    let dt_s = step_code / 240.0;
    let mut noise = Noise::new(seed, 0);
    let thrown: Vec<_> = (0..UNITS)
        .map(|number| {
            let place = Vector3::new(1.6 * (number % 3) as f32, 1.6 * (number / 3) as f32, 2.0);
            let place = place + Vector3::from_fn(|_, _| 0.3 * noise.normal());
            let middle = Vector3::new(1.6, 0.8, 1.0);
            let mut velocity = (middle - place) * 1.5;
            let mut points = ball(0.5 + 0.2 * noise.uniform());
            if number == UNITS / 2 {
                change(&mut points, &mut velocity);
            }
            (points, place, velocity)
        })
        .collect();
    let units = thrown.iter().map(|(points, place, velocity)| Posed {
        unit: Unit::new(points, WOOD),
        previous: Translation3::from(place - velocity * dt_s).into(),
        current: Translation3::from(*place).into(),
    });
    simulator.observe_poses(dt_s, units).unwrap();
    simulator.units().map(|unit| unit.id()).collect()
}

#[test]
fn quantities_are_what_they_are_called() {
    // In SI units, so that numbers are plain.
    let file = rigidformer_tests::with_similarity(
        NANO,
        rigidformer_weights::Similarity { length_m: 0.0, longest_step: 16.0 },
    );
    with_simulator(&file, 128, |simulator| {
        let dt_s = 5.0 / 240.0;
        let points = cube(0.2);
        let now = at(0.0, 0.0, 0.1);
        let turn = UnitQuaternion::from_scaled_axis(Vector3::z() * 0.1);
        let before = Isometry3::from_parts(Translation3::new(-0.03, 0.04, 0.1), turn.inverse());
        let unit = Unit::new(&points, Physics { mass_kg: 2.0, ..WOOD });
        let far = at(9.0, 0.0, 3.0);
        let other = Posed { unit, previous: far, current: far };
        let units = [Posed { unit, previous: before, current: now }, other];
        simulator.observe_poses(dt_s, units).unwrap();
        let id = simulator.unit(0).unwrap().id();
        let found = simulator.quantities(id).unwrap();
        let of = |quantity: Quantity| found[quantity as usize];
        let root3 = 3.0_f32.sqrt();
        for (quantity, expected) in [
            (Quantity::Speed, 0.05 / dt_s),
            (Quantity::Spin, 2.0 * 0.05_f32.sin() / dt_s),
            (Quantity::LnRadius, (0.2 * root3).ln()),
            (Quantity::Thickness, 1.0 / root3),
            (Quantity::LnMass, 2.0_f32.ln()),
            (Quantity::Friction, 0.4),
            (Quantity::Restitution, 0.5),
            (Quantity::StepCode, 5.0),
            (Quantity::Gravity, 10.0),
            (Quantity::Footing, 1.0),
            (Quantity::LnPoints, 8.0_f32.ln()),
            (Quantity::Spacing, 2.0 / root3),
            (Quantity::Hole, 1.0 - 1.0 / root3),
            (Quantity::Depth, 0.1 / (0.2 * root3)),
        ] {
            let value = of(quantity);
            assert!((value - expected).abs() <= 2e-3 * expected.abs(), "{quantity:?} {value}");
        }
        simulator.set_gravity(Vector3::new(0.0, 0.0, 10.0)).unwrap();
        let footing = |simulator: &Simulator<'_, '_>| {
            simulator.quantities(id).unwrap()[Quantity::Footing as usize]
        };
        assert_eq!(footing(simulator), -1.0);
        simulator.set_planes(&[]).unwrap();
        assert_eq!(footing(simulator), 0.0);
        simulator.set_gravity(Vector3::zeros()).unwrap();
        assert_eq!(footing(simulator), 1.0);
        assert_eq!(simulator.quantities(UnitId::from_bits(u64::MAX)), None);
    });
}

#[test]
fn a_model_that_does_not_say_what_training_saw_knows_nothing() {
    for model in [with_ranges(EDGE, None), AlignedBuffer::copy_of(NANO)] {
        with_simulator(&model, 16 * POINTS, |simulator| {
            let ids = throw(simulator, 1, 10.0, |_, _| {});
            for id in &ids {
                let health = simulator.health(*id).unwrap();
                assert_eq!(health, Health::default());
                assert!(!health.is_known() && !health.warns(0.0));
                assert!(health.with_innovation(5.0).warns(4.1));
            }
            assert_eq!(simulator.health_report(), Default::default());
        });
    }
}

#[test]
fn what_is_asked_of_health_changes_no_step() {
    let roll = |asks: bool| {
        with_simulator(EDGE, 16 * POINTS, |simulator| {
            let ids = throw(simulator, 2, 10.0, |_, _| {});
            for _ in 0..8 {
                if asks {
                    ids.iter().for_each(|id| assert!(simulator.health(*id).is_some()));
                    simulator.health_report();
                }
                simulator.step().unwrap();
            }
            simulator.units().map(|unit| unit.internal_pose()).collect::<Vec<_>>()
        })
    };
    assert_eq!(roll(true), roll(false));
}

/// What is done to a scene.
struct Case {
    name: &'static str,
    /// Any of these quantities of the unit in the middle is outside, or of all units if it is the world that is changed.
    quantities: &'static [Quantity],
    change: fn(&mut Vec<Point3<f32>>, &mut Vector3<f32>),
    world: fn(&mut Simulator<'_, '_>),
}

const CASES: [Case; 7] = [
    Case {
        name: "ten times too fast",
        quantities: &[Quantity::Speed],
        change: |_, velocity| *velocity *= 10.0,
        world: |_| {},
    },
    Case {
        name: "gravity upside down",
        quantities: &[Quantity::Footing],
        change: |_, _| {},
        world: |simulator| simulator.set_gravity(Vector3::new(0.0, 0.0, 10.0)).unwrap(),
    },
    Case {
        name: "ten times too large",
        quantities: &[Quantity::LnRadius],
        change: |points, _| points.iter_mut().for_each(|point| *point *= 10.0),
        world: |_| {},
    },
    Case {
        name: "ten times too small",
        quantities: &[Quantity::LnRadius],
        change: |points, _| points.iter_mut().for_each(|point| *point *= 0.1),
        world: |_| {},
    },
    Case {
        name: "a hole: three quarters of the points are missing",
        // The dish that is left is a shape like others: its points are too few.
        quantities: &[Quantity::LnPoints, Quantity::Thickness, Quantity::Hole],
        change: |points, _| {
            points.sort_by(|a, b| a.z.total_cmp(&b.z));
            points.truncate(POINTS / 4);
        },
        world: |_| {},
    },
    Case {
        name: "what is left is a thin dish",
        quantities: &[Quantity::Thickness],
        change: |points, _| points.iter_mut().for_each(|point| point.z *= 0.05),
        world: |_| {},
    },
    Case {
        name: "one point far from the others",
        quantities: &[Quantity::Spacing, Quantity::Thickness],
        change: |points, _| points[0] *= 6.0,
        world: |_| {},
    },
];

#[test]
fn scenes_unlike_training_are_told_before_the_first_step() {
    for seed in 0..20 {
        with_simulator(EDGE, 16 * POINTS, |simulator| {
            let ids = throw(simulator, seed, 10.0, |_, _| {});
            for id in ids {
                let health = simulator.health(id).unwrap();
                assert!(!health.warns(4.1), "seed {seed}: {health:?}");
            }
            assert_eq!(simulator.health_report().outside_units, 0);
        });
        for case in &CASES {
            with_simulator(EDGE, 16 * POINTS, |simulator| {
                let ids = throw(simulator, seed, 10.0, case.change);
                (case.world)(simulator);
                let health = simulator.health(ids[UNITS / 2]).unwrap();
                let told = case.quantities.iter().any(|quantity| health.is_outside(*quantity));
                assert!(told && health.warns(4.1), "{}, seed {seed}: {health:?}", case.name);
                let report = simulator.health_report();
                assert!(report.outside_units >= 1);
                assert!(report.farthest.is_some_and(|(_, excess)| excess.beyond > 0.05));
            });
        }
    }
}

/// Ranges do not tell a ball whose lower half is missing from a dome; what happens where the points are missing does. Every step
/// begins from what was observed of the whole ball.
#[test]
fn a_hole_is_told_by_the_innovation_before_the_error_is_a_tenth_of_the_size() {
    const RADIUS_M: f32 = 0.5;
    // The impact falls early in a step: at its end the whole ball is farthest from where the dome goes.
    let (whole, start) = (ball(RADIUS_M), at(0.0, 0.0, 0.806));
    let upper: Vec<_> = whole.iter().copied().filter(|point| point.z > 0.0).collect();
    // 2 mm and half a degree.
    let (place, turn) = (0.002_f32 * 0.002, 0.009_f32 * 0.009);
    let variances = [place, place, place, turn, turn, turn];
    let observe = |simulator: &mut Simulator<'_, '_>, points: &[Point3<f32>]| {
        let unit = Unit::new(points, WOOD);
        let posed = Posed { unit, previous: start, current: start };
        simulator.observe_poses(1.0 / 240.0, [posed]).unwrap();
        simulator.unit(0).unwrap().id()
    };
    let told = with_simulator(EDGE, POINTS, |truth| {
        with_simulator(EDGE, POINTS, |simulator| {
            let (ball, dome) = (observe(truth, &whole), observe(simulator, &upper));
            assert_eq!(simulator.health(dome).unwrap().outside, 0, "as a dome of training");
            for step in 0..120 {
                let seen = truth.get(ball).unwrap();
                simulator.set_poses(dome, &seen.previous_pose(), &seen.pose()).unwrap();
                truth.step().unwrap();
                simulator.step().unwrap();
                let (predicted, seen) = (simulator.pose(dome).unwrap(), truth.pose(ball).unwrap());
                let innovation = Health::innovation(&predicted, &seen, &variances).unwrap();
                let error_m = (seen.translation.vector - predicted.translation.vector).norm();
                let health = simulator.health(dome).unwrap().with_innovation(innovation);
                if health.warns(4.1) {
                    return Some((step, innovation, error_m));
                }
                assert!(error_m < 0.1 * 2.0 * RADIUS_M, "step {step}: {error_m} m, not told");
            }
            None
        })
    });
    let (step, innovation, error_m) = told.expect("told when it touches the ground");
    println!("step {step}: innovation {innovation:.1}, {error_m:.4} m off");
    assert!(step > 20 && error_m < 0.1 * 2.0 * RADIUS_M, "step {step}: {error_m} m");
}

#[test]
fn innovations_are_mahalanobis_distances() {
    let variances = [1e-4, 4e-4, 9e-4, 1e-2, 4e-2, 9e-2];
    let base = Isometry3::from_parts(
        Translation3::new(3.0, -2.0, 1.0),
        UnitQuaternion::from_scaled_axis(Vector3::new(1.0, -2.0, 0.5)),
    );
    let distance = |seen: &Isometry3<f32>| Health::innovation(&base, seen, &variances).unwrap();
    assert_eq!(distance(&base), 0.0);
    for axis in 0..3 {
        let mut way = Vector3::zeros();
        way[axis] = 0.05;
        let moved = Translation3::from(way) * base;
        let expected = 0.05 / variances[axis].sqrt();
        assert!((distance(&moved) - expected).abs() < 1e-2 * expected);
        // About the world's axes, also by the quaternion's negative.
        let turn = UnitQuaternion::from_scaled_axis(way);
        let turned = Isometry3::from_parts(base.translation, turn * base.rotation);
        let expected = 2.0 * 0.025_f32.sin() / variances[3 + axis].sqrt();
        assert!((distance(&turned) - expected).abs() < 1e-2 * expected);
        let negative = UnitQuaternion::new_unchecked(-turned.rotation.into_inner());
        let negative = Isometry3::from_parts(base.translation, negative);
        assert!((distance(&negative) - expected).abs() < 1e-2 * expected);
    }
    // Of a right prediction it is above 4.1 once in a hundred times.
    let mut noise = Noise::new(7, 1);
    let above = (0..4000).filter(|_| {
        let mut parts = [0.0; 6];
        for (part, variance) in parts.iter_mut().zip(variances) {
            *part = noise.normal() * variance.sqrt();
        }
        let turn = UnitQuaternion::from_scaled_axis(Vector3::new(parts[3], parts[4], parts[5]));
        let way = Vector3::new(parts[0], parts[1], parts[2]);
        let place = Translation3::from(base.translation.vector + way);
        distance(&Isometry3::from_parts(place, turn * base.rotation)) > 4.1
    });
    let share = above.count() as f32 / 4000.0;
    assert!((0.004..0.02).contains(&share), "{share}");
}

#[test]
fn numbers_that_are_none_give_no_innovation() {
    let good = at(1.0, 2.0, 3.0);
    for at in 0..6 {
        for bad in [0.0, -1.0, f32::NAN, f32::INFINITY, 1e13, -0.0] {
            let mut variances = [1.0; 6];
            variances[at] = bad;
            let found = Health::innovation(&good, &good, &variances);
            assert_eq!(found, Err(InnovationError::BadVariance { index: at }));
        }
    }
    for bad in [f32::NAN, f32::INFINITY, f32::NEG_INFINITY] {
        let pose = at(bad, 0.0, 0.0);
        for (predicted, observed) in [(&pose, &good), (&good, &pose)] {
            let found = Health::innovation(predicted, observed, &[1.0; 6]);
            assert_eq!(found, Err(InnovationError::BadPose));
        }
    }
    // Far beyond all sense, but numbers.
    let far = Health::innovation(&at(-3e38, 0.0, 0.0), &at(1.0, 0.0, 0.0), &[1e-38; 6]).unwrap();
    assert!(far.is_finite() && far > 1e30);
}

#[test]
fn driven_and_fixed_units_have_health_too() {
    with_simulator(EDGE, 16 * POINTS, |simulator| {
        let points = ball(0.5);
        let unit = |role| Unit::new(&points, WOOD).role(role);
        let posed = |role, x: f32| Posed {
            unit: unit(role),
            previous: at(x, 0.0, 1.0),
            current: at(x, 0.0, 1.0),
        };
        let units = [posed(Role::Free, 0.0), posed(Role::Driven, 2.0), posed(Role::Fixed, 4.0)];
        simulator.observe_poses(1.0 / 24.0, units).unwrap();
        let ids: Vec<_> = simulator.units().map(|unit| unit.id()).collect();
        let speed = |simulator: &Simulator<'_, '_>, id| {
            simulator.quantities(id).unwrap()[Quantity::Speed as usize]
        };
        // In a falling frame what rests rises: by half a step's fall from the middle of the step.
        assert!((0.2..0.3).contains(&speed(simulator, ids[0])));
        assert!(ids.iter().skip(1).all(|id| speed(simulator, *id) == 0.0));
        simulator.drive(ids[1], &at(2.0, 4.0, 1.0)).unwrap();
        assert!(speed(simulator, ids[1]) > 30.0);
        assert!(simulator.health(ids[1]).unwrap().is_outside(Quantity::Speed));
        assert!(!simulator.health(ids[2]).unwrap().is_outside(Quantity::Speed));
    });
}

/// What the image prints, as this machine computes it: `RIGIDFORMER_BLESS=1` writes the file that boards are compared with.
#[test]
fn the_image_says_what_this_machine_says() {
    let ranges = ModelFile::parse(EDGE).unwrap().ranges().copied();
    assert_eq!(Some(rigidformer_tests::health::RANGES), ranges, "edge's");
    let folder = concat!(env!("CARGO_MANIFEST_DIR"), "/../firmware-sim/firmware");
    let scene =
        TwoFrames::from_bytes(&std::fs::read(format!("{folder}/scenes/contact.bin")).unwrap());
    let mut text = String::new();
    with_simulator(NANO, 640, |simulator| {
        let units = observed(&scene.physics, &scene.previous, &scene.current);
        simulator.observe(seconds(scene.step), units).unwrap();
        rigidformer_tests::health::tell(simulator, |what, [a, b, c, d]| {
            text += &format!("INFO {what}: {a} {b:08x} {c} {d:08x}\n");
        })
        .unwrap();
    });
    text += "INFO done\n";
    let path = format!("{folder}/src/bin/health.out");
    if std::env::var_os("RIGIDFORMER_BLESS").is_some() {
        std::fs::write(&path, &text).unwrap();
    }
    assert_eq!(std::fs::read_to_string(&path).unwrap(), text);
}
