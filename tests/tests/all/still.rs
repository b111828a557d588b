//! What lies still is left out of the solver's work on hosts, until something changes or comes near: no bit says so.
#![allow(missing_docs, clippy::unwrap_used, clippy::expect_used, clippy::panic)]

use nalgebra::{Isometry3, Point3, UnitQuaternion, Vector3};
use rigidformer_core::{Physics, Plane, Posed, Role, Simulator, Unit, UnitId};
use rigidformer_runtime::noise::Noise;
use rigidformer_tests::with_simulator;

const DT_S: f32 = 1.0 / 48.0;
const STEPS: usize = 160;
const WOOD: Physics = Physics { mass_kg: 0.5, friction: 0.6, restitution: 0.1 };

fn cube() -> Vec<Point3<f32>> {
    let corner = |i: i32, bit: i32| if i & bit == 0 { -0.1 } else { 0.1 };
    (0..8).map(|i| Point3::new(corner(i, 1), corner(i, 2), corner(i, 4))).collect()
}

/// Cubes that come to lie alone, on each other, on a fixed one and on a driven one.
fn observe(simulator: &mut Simulator<'_, '_>, seed: u64) -> Vec<UnitId> {
    let points = cube();
    let unit = |number: usize| {
        let mut noise = Noise::new(seed, number as u64);
        let (column, level) = (number % 6, number / 6);
        let shake = Vector3::from_fn(|_, _| 0.01 * noise.normal());
        let at = Vector3::new(0.6 * column as f32, 0.0, 0.101 + 0.21 * level as f32) + shake;
        let turn = UnitQuaternion::from_scaled_axis(Vector3::z() * 0.1 * noise.normal());
        let role = match (column, level) {
            (0, 0) => Role::Fixed,
            (1, 0) => Role::Driven,
            _ => Role::Free,
        };
        let pose = Isometry3::from_parts(at.into(), turn);
        Posed { unit: Unit::new(&points, WOOD).role(role), previous: pose, current: pose }
    };
    // Columns of two, and those of the last two of one.
    let units = (0..10).map(unit);
    simulator.observe_poses(DT_S, units).unwrap();
    simulator.units().map(|unit| unit.id()).collect()
}

fn bits(simulator: &Simulator<'_, '_>) -> Vec<u32> {
    let poses = simulator.units().map(|unit| unit.internal_pose());
    let numbers =
        poses.flat_map(|pose| [pose.rotation.as_slice(), pose.centre.as_slice()].concat());
    numbers.map(f32::to_bits).collect()
}

/// What is done to a scene that lies still.
type Change = fn(&mut Simulator<'_, '_>, &[UnitId]);

const CHANGES: [(&str, Change); 11] = [
    ("nothing", |_, _| {}),
    ("a cube is thrown at the others", |s, ids| {
        let at = |x: f32| Isometry3::translation(x, 0.02, 0.25);
        s.set_poses(ids[9], &at(2.9), &at(2.85)).unwrap();
    }),
    ("a support goes", |s, ids| s.remove(ids[2]).unwrap()),
    ("the fixed one goes", |s, ids| s.remove(ids[0]).unwrap()),
    ("the fixed one falls", |s, ids| {
        s.set_poses(
            ids[0],
            &Isometry3::translation(0.0, 0.0, 2.0),
            &Isometry3::translation(0.0, 0.0, 2.0),
        )
        .unwrap();
        s.set_role(ids[0], Role::Free).unwrap();
    }),
    ("the driven one drives away", |s, ids| {
        let here = s.pose(ids[1]).unwrap();
        s.drive(ids[1], &(Isometry3::translation(0.0, 0.06, 0.0) * here)).unwrap();
    }),
    ("the ground tilts", |s, _| {
        let ground = s.planes()[0];
        let normal = Vector3::new(0.5, 0.0, 1.0).normalize();
        s.set_planes(&[Plane { normal, ..ground }]).unwrap();
    }),
    ("gravity turns", |s, _| s.set_gravity(Vector3::new(8.0, 0.0, -5.0)).unwrap()),
    ("a step takes longer", |s, _| s.set_dt(DT_S * 1.5).unwrap()),
    ("a cube gets slippery", |s, ids| {
        s.set_gravity(Vector3::new(3.0, 0.0, -9.0)).unwrap();
        s.set_physics(ids[2], Physics { friction: 0.0, ..WOOD }).unwrap();
    }),
    ("one more falls onto a column", |s, _| {
        let (points, at) = (cube(), |z: f32| Isometry3::translation(1.2, 0.0, z));
        s.add(&Unit::new(&points, WOOD), &at(0.9), &at(0.85)).unwrap();
    }),
];

/// The bits of all steps; `stirs`: before each something is set to what it is, after which nothing counts as still.
fn rolled(model: &[u8], seed: u64, change: Change, stirs: bool) -> Vec<Vec<u32>> {
    with_simulator(model, 11 * 8, |simulator| {
        let ids = observe(simulator, seed);
        let mut steps = Vec::new();
        for step in 0..STEPS {
            if step == STEPS / 2 {
                change(simulator, &ids);
            }
            if stirs {
                let planes = simulator.planes().to_vec();
                simulator.set_planes(&planes).unwrap();
            }
            simulator.step().unwrap();
            steps.push(bits(simulator));
        }
        steps
    })
}

#[test]
fn what_lies_still_is_as_if_it_were_looked_at() {
    // Steps of edge cost more, and the solver does the same work beside both.
    let models: [(&str, &[u8], &[u64]); 2] =
        [("edge", rigidformer_weights::EDGE, &[1]), ("nano", rigidformer_weights::NANO, &[1, 2])];
    for (name, model, seeds) in models {
        for (what, change) in CHANGES {
            for &seed in seeds {
                let found = rolled(model, seed, change, false);
                assert!(found == rolled(model, seed, change, true), "{name}: {what}, seed {seed}");
                let is_still = |step: usize| found[step] == found[step - 1];
                let half = STEPS / 2;
                assert!(is_still(half - 1) && is_still(half - 2), "{name}: it lies still before");
                // At rest a longer step changes nothing either.
                assert_eq!(
                    matches!(what, "nothing" | "a step takes longer"),
                    found[half - 1] == found[STEPS - 1],
                    "{name}: {what}"
                );
            }
        }
    }
}
