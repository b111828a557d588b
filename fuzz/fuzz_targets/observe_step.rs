//! Any observations, commands and steps, in any order, on sound models: no panic, and a call that
//! fails leaves the poses as they were.
#![no_main]

use arbitrary::Arbitrary;
use libfuzzer_sys::fuzz_target;
use nalgebra::{Isometry3, Point3, Quaternion, Translation3, Unit as UnitOf};
use rigidformer_core::{Limits, Model, Physics, Simulator, SlabSizes, Slabs, Unit};
use rigidformer_tests::bits::{PRECISIONS, quantised};
use rigidformer_tests::hostile::{SMALLEST, SMALLEST_IMPACT, assert_rigid, random_model, state};
use rigidformer_weights::{AlignedBuffer, FeatureSet, ModelConfig, Motion};
use std::sync::LazyLock;

/// Sound models: every storage, all kinds of features, both of motion.
static MODELS: LazyLock<Vec<AlignedBuffer>> = LazyLock::new(|| {
    let paper = ModelConfig {
        features: FeatureSet::Paper,
        motion: Motion::Verlet,
        command_size: 0,
        output_scale: 10.0,
        ..SMALLEST
    };
    let sources =
        [random_model(SMALLEST, 1), random_model(paper, 2), random_model(SMALLEST_IMPACT, 3)];
    let each =
        |source: &AlignedBuffer| PRECISIONS.map(|(_, precision)| quantised(source, precision));
    sources.iter().flat_map(each).collect()
});

/// A number that is mostly of the size of a scene, and sometimes what numbers should not be.
#[derive(Arbitrary, Clone, Copy, Debug)]
struct Number(i16);

impl Number {
    fn value(self) -> f32 {
        match self.0 {
            i16::MIN => f32::NAN,
            -32767 => f32::NEG_INFINITY,
            -32766 => -1e6,
            -32765 => f32::MIN,
            -32764 => -1e-38,
            -32763 => -1e5,
            32759 => 1e5,
            32760 => 1e-20,
            32761 => 1e-42,
            32762 => -0.0,
            32763 => f32::MIN_POSITIVE,
            32764 => f32::MAX,
            32765 => 1.000_001e6,
            32766 => 1e6,
            i16::MAX => f32::INFINITY,
            x => f32::from(x) / 4096.0,
        }
    }
}

#[derive(Arbitrary, Debug)]
struct FuzzUnit {
    points: Vec<[Number; 3]>,
    /// How the second frame differs, point by point: none repeats.
    moved: Vec<[Number; 3]>,
    shift: [Number; 3],
    physics: [Number; 3],
    poses: [[Number; 7]; 2],
}

#[derive(Arbitrary, Debug)]
enum Call {
    Observe { step: u8, units: Vec<FuzzUnit>, drop: u8 },
    ObservePoses { step: u16, units: Vec<FuzzUnit>, drop: u8, sound: bool },
    Command(Vec<Number>),
    Step(u8),
}

fn points(rows: &[[Number; 3]]) -> Vec<Point3<f32>> {
    rows.iter().map(|row| Point3::from(row.map(Number::value))).collect()
}

fn isometry(row: [Number; 7], sound: bool) -> Isometry3<f32> {
    let [x, y, z, i, j, k, w] = row.map(Number::value);
    let mut q = Quaternion::new(w, i, j, k);
    let length = q.norm();
    if sound && length.is_finite() && length > 0.0 {
        q /= length;
    }
    Isometry3::from_parts(Translation3::new(x, y, z), UnitOf::new_unchecked(q))
}

fn call(simulator: &mut Simulator<'_, '_, 3>, call: &Call) -> bool {
    let physics = |unit: &FuzzUnit| {
        let [mass_kg, friction, restitution] = unit.physics.map(Number::value);
        Physics { mass_kg, friction, restitution }
    };
    match call {
        Call::Observe { step, units, drop } => {
            let before: Vec<_> = units.iter().map(|unit| points(&unit.points)).collect();
            let after: Vec<Vec<_>> = units
                .iter()
                .zip(&before)
                .map(|(unit, before)| {
                    let shift = Point3::from(unit.shift.map(Number::value));
                    let moved = points(&unit.moved).into_iter().map(|p| p.coords);
                    let moved = moved.chain(std::iter::repeat(Default::default()));
                    before.iter().zip(moved).map(|(p, m)| p + shift.coords + m * 0.01).collect()
                })
                .collect();
            let before: Vec<_> = before.iter().map(Vec::as_slice).collect();
            let mut after: Vec<_> = after.iter().map(Vec::as_slice).collect();
            let mut physics: Vec<_> = units.iter().map(physics).collect();
            match drop {
                0 => drop_last(&mut after),
                1 => drop_last(&mut physics),
                2 => after.iter_mut().for_each(|p| *p = &p[..p.len().saturating_sub(1)]),
                _ => {}
            }
            simulator.observe(u32::from(*step), &physics, &before, &after).is_ok()
        }
        Call::ObservePoses { step, units, drop, sound } => {
            let shapes: Vec<_> = units.iter().map(|unit| points(&unit.points)).collect();
            let pose = |i: usize| units.iter().map(move |unit| isometry(unit.poses[i], *sound));
            let mut previous: Vec<_> = pose(0).collect();
            let current: Vec<_> = pose(1).collect();
            if *drop == 0 {
                drop_last(&mut previous);
            }
            let units: Vec<Unit<'_>> = shapes
                .iter()
                .zip(units)
                .map(|(points, unit)| Unit { points, physics: physics(unit) })
                .collect();
            simulator.observe_poses(u32::from(*step), &units, &previous, &current).is_ok()
        }
        Call::Command(numbers) => {
            let numbers: Vec<f32> = numbers.iter().map(|n| n.value()).collect();
            simulator.set_command(&numbers).is_ok()
        }
        Call::Step(_) => simulator.step().is_ok(),
    }
}

fn drop_last<T>(items: &mut Vec<T>) {
    let _ = items.pop();
}

fuzz_target!(|input: (u8, Vec<Call>)| {
    let (which, calls) = input;
    let model = Model::load(&MODELS[usize::from(which) % MODELS.len()]).expect("sound");
    let limits = Limits { units: 3, points: 24 };
    let sizes = SlabSizes::new(model.config(), limits);
    let mut numbers = vec![f32::NAN; sizes.f32];
    let mut bytes = vec![-1; sizes.i8];
    let mut slab = vec![Point3::origin(); sizes.points];
    let slabs = Slabs { f32: &mut numbers, i8: &mut bytes, points: &mut slab };
    let mut simulator: Simulator<'_, '_, 3> = Simulator::new(&model, limits, slabs).expect("slabs");
    let command = vec![0.25; model.config().command_size as usize];
    simulator.set_command(&command).expect("a sound command");
    for next in calls.iter().take(8) {
        let repeats = if let Call::Step(n) = next { 1 + n % 4 } else { 1 };
        for _ in 0..repeats {
            let before = state(&simulator);
            if call(&mut simulator, next) {
                assert_rigid(&simulator);
            } else {
                assert_eq!(before, state(&simulator), "a failed call changed the scene");
            }
        }
    }
});
