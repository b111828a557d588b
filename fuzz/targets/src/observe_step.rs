//! Any observations, changes of the scene, commands and steps, in any order, on sound models: no panic, a call that
//! fails leaves the scene as it was, and fixed units stay to the bit.

use crate::structured::structured;
use arbitrary::Arbitrary;
use nalgebra::{Isometry3, Point3, Quaternion, Translation3, Unit as UnitOf, Vector3};
use rigidformer_core::{
    Limits, Model, Observed, Physics, Pieces, Plane, Posed, Role, Simulator, SlabSizes, Unit,
    UnitId,
};
use rigidformer_tests::Room;
use rigidformer_tests::bits::{PRECISIONS, quantised};
use rigidformer_tests::hostile::{SMALLEST, SMALLEST_IMPACT, assert_rigid, random_model, state};
use rigidformer_weights::{AlignedBuffer, FeatureSet, ModelConfig, Motion};
use std::sync::LazyLock;

/// Sound models: every storage, all kinds of features, both of motion.
pub(crate) static MODELS: LazyLock<Vec<AlignedBuffer>> = LazyLock::new(|| {
    let paper = ModelConfig {
        features: FeatureSet::Paper,
        motion: Motion::Verlet,
        command_size: 0,
        output_scale: 10.0,
        ..SMALLEST
    };
    let impulses = ModelConfig { motion: Motion::Impulses, ..SMALLEST_IMPACT };
    let sources = [
        random_model(SMALLEST, 1),
        random_model(paper, 2),
        random_model(SMALLEST_IMPACT, 3),
        random_model(impulses, 4),
    ];
    let each =
        |source: &AlignedBuffer| PRECISIONS.map(|(_, precision)| quantised(source, precision));
    sources.iter().flat_map(each).collect()
});

/// A number that is mostly of the size of a scene, and sometimes what numbers should not be.
#[derive(Arbitrary, Clone, Copy, Debug)]
pub(crate) struct Number(i16);

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
pub(crate) struct FuzzUnit {
    points: Vec<[Number; 3]>,
    /// How the second frame differs, point by point: none repeats.
    moved: Vec<[Number; 3]>,
    shift: [Number; 3],
    physics: [Number; 3],
    poses: [[Number; 7]; 2],
    role: u8,
    body: u8,
    inertia: Option<[Number; 3]>,
    /// Points of its convex pieces, which are its first ones.
    pieces: Vec<u8>,
    /// Whether there are as many points as these say, where it has them.
    whole: bool,
    /// The same as the core takes them.
    #[arbitrary(default)]
    counts: std::cell::OnceCell<Vec<u16>>,
}

impl FuzzUnit {
    fn points(&self) -> Vec<Point3<f32>> {
        points(&self.points)
    }

    /// The second frame of points.
    fn current(&self) -> Vec<Point3<f32>> {
        let shift = Vector3::from(self.shift.map(Number::value));
        let moved = points(&self.moved).into_iter().map(|p| p.coords);
        let moved = moved.chain(std::iter::repeat(Vector3::zeros()));
        self.points().iter().zip(moved).map(|(p, m)| p + shift + m * 0.01).collect()
    }

    fn unit<'a>(&'a self, points: &'a [Point3<f32>]) -> Unit<'a> {
        let unit = Unit::new(points, physics(self.physics)).role(role(self.role));
        // Mostly few points each: sound ones are to be found.
        let count = |count: &u8| if *count < 250 { u16::from(*count % 16) } else { 300 };
        let counts = self.counts.get_or_init(|| self.pieces.iter().map(count).collect());
        let sum: usize = counts.iter().map(|count| usize::from(*count)).sum();
        let given = if self.whole { sum.min(points.len()) } else { points.len() };
        let unit = if counts.is_empty() {
            unit
        } else {
            unit.pieces(Pieces::new(&points[..given], counts))
        };
        let unit = match self.body {
            0 | 1 => unit.body(u16::from(self.body)),
            _ => unit,
        };
        match self.inertia {
            Some(moments) => unit.inertia(moments.map(Number::value)),
            None => unit,
        }
    }

    fn pose(&self, frame: usize, sound: bool) -> Isometry3<f32> {
        isometry(self.poses[frame], sound)
    }
}

#[derive(Arbitrary, Debug)]
pub(crate) enum Call {
    Observe { dt: Dt, units: Vec<FuzzUnit>, shorter: bool },
    ObservePoses { dt: Dt, units: Vec<FuzzUnit>, sound: bool },
    Add(FuzzUnit, bool),
    Remove(u8),
    Drive(u8, [Number; 7], bool),
    SetPoses(u8, [[Number; 7]; 2], bool),
    SetPhysics(u8, [Number; 3]),
    SetRole(u8, u8),
    SetPlanes(Vec<([Number; 6], bool)>),
    SetGravity([Number; 3]),
    SetDt(Dt),
    Command(Vec<Number>),
    Step(u8),
}

/// Seconds: mostly such as frames are apart.
#[derive(Arbitrary, Clone, Copy, Debug)]
pub(crate) enum Dt {
    Code(u8),
    Seconds(Number),
}

impl Dt {
    fn value(self) -> f32 {
        match self {
            Dt::Code(code) => f32::from(code) / 240.0,
            Dt::Seconds(number) => number.value(),
        }
    }
}

fn points(rows: &[[Number; 3]]) -> Vec<Point3<f32>> {
    rows.iter().map(|row| Point3::from(row.map(Number::value))).collect()
}

fn physics(row: [Number; 3]) -> Physics {
    let [mass_kg, friction, restitution] = row.map(Number::value);
    Physics { mass_kg, friction, restitution }
}

fn role(code: u8) -> Role {
    match code % 4 {
        2 => Role::Driven,
        3 => Role::Fixed,
        _ => Role::Free,
    }
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

fn plane((row, sound): &([Number; 6], bool)) -> Plane {
    let [x, y, z, offset_m, friction, restitution] = row.map(Number::value);
    let normal = Vector3::new(x, y, z);
    let length = normal.norm();
    let normal =
        if *sound && length.is_finite() && length > 0.0 { normal / length } else { normal };
    Plane { normal, offset_m, friction, restitution }
}

/// A unit of now or, on a number that is none of them, one that is not there any more.
fn id(ids: &[UnitId], known: &[UnitId], number: u8) -> Option<UnitId> {
    let number = usize::from(number);
    ids.get(number % 4).or_else(|| known.get(number % known.len().max(1))).copied()
}

pub(crate) fn call(simulator: &mut Simulator<'_, '_>, known: &[UnitId], call: &Call) -> bool {
    let ids: Vec<UnitId> = simulator.units().map(|unit| unit.id()).collect();
    let id = |number: &u8| id(&ids, known, *number);
    match call {
        Call::Observe { dt, units, shorter } => {
            let shapes: Vec<_> = units.iter().map(|unit| (unit.points(), unit.current())).collect();
            let observed = units.iter().zip(&shapes).map(|(unit, (points, current))| {
                let length = current.len() - usize::from(*shorter && !current.is_empty());
                Observed { unit: unit.unit(points), current: &current[..length] }
            });
            simulator.observe(dt.value(), observed).is_ok()
        }
        Call::ObservePoses { dt, units, sound } => {
            let shapes: Vec<_> = units.iter().map(FuzzUnit::points).collect();
            let posed = units.iter().zip(&shapes).map(|(unit, points)| Posed {
                unit: unit.unit(points),
                previous: unit.pose(0, *sound),
                current: unit.pose(1, *sound),
            });
            simulator.observe_poses(dt.value(), posed).is_ok()
        }
        Call::Add(unit, sound) => {
            let points = unit.points();
            simulator.add(&unit.unit(&points), &unit.pose(0, *sound), &unit.pose(1, *sound)).is_ok()
        }
        Call::Remove(number) => id(number).is_some_and(|id| simulator.remove(id).is_ok()),
        Call::Drive(number, pose, sound) => {
            id(number).is_some_and(|id| simulator.drive(id, &isometry(*pose, *sound)).is_ok())
        }
        Call::SetPoses(number, poses, sound) => id(number).is_some_and(|id| {
            let [previous, current] = poses.map(|pose| isometry(pose, *sound));
            simulator.set_poses(id, &previous, &current).is_ok()
        }),
        Call::SetPhysics(number, row) => {
            id(number).is_some_and(|id| simulator.set_physics(id, physics(*row)).is_ok())
        }
        Call::SetRole(number, code) => {
            id(number).is_some_and(|id| simulator.set_role(id, role(*code)).is_ok())
        }
        Call::SetPlanes(rows) => {
            let planes: Vec<Plane> = rows.iter().map(plane).collect();
            simulator.set_planes(&planes).is_ok()
        }
        Call::SetGravity(row) => {
            simulator.set_gravity(Vector3::from(row.map(Number::value))).is_ok()
        }
        Call::SetDt(dt) => simulator.set_dt(dt.value()).is_ok(),
        Call::Command(numbers) => {
            let numbers: Vec<f32> = numbers.iter().map(|n| n.value()).collect();
            simulator.set_command(&numbers).is_ok()
        }
        Call::Step(_) => {
            let fixed = || simulator.units().map(|unit| unit.role() == Role::Fixed);
            let fixed: Vec<bool> = fixed().collect();
            let before = state(simulator);
            let stepped = simulator.step().is_ok();
            let after = state(simulator);
            let same = |((fixed, a), b): ((&bool, _), _)| !fixed || a == b;
            assert!(fixed.iter().zip(&before).zip(&after).all(same), "a step moved a fixed unit");
            stepped
        }
    }
}

/// Makes the calls that an input stands for.
pub fn run(data: &[u8]) {
    let Some((which, calls)) = structured::<(u8, Vec<Call>)>(data) else { return };
    let model = Model::load(&MODELS[usize::from(which) % MODELS.len()]).expect("sound");
    let limits = Limits { units: 3, points: 24 };
    let mut room = Room::new(SlabSizes::new(model.config(), limits));
    let mut simulator = Simulator::new(&model, limits, room.slabs()).expect("slabs");
    let command = vec![0.25; model.config().command_size as usize];
    simulator.set_command(&command).expect("a sound command");
    let mut known = Vec::new();
    for next in calls.iter().take(12) {
        let repeats = if let Call::Step(n) = next { 1 + n % 4 } else { 1 };
        for _ in 0..repeats {
            known.extend(simulator.units().map(|unit| unit.id()));
            let before = state(&simulator);
            if call(&mut simulator, &known, next) {
                assert_rigid(&simulator);
            } else {
                assert_eq!(before, state(&simulator), "a failed call changed the scene");
            }
        }
    }
}
