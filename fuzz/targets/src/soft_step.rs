//! Any observations of soft units, bonds between rigid ones, changes and steps, in any order, on sound models of both: no panic, and
//! a call that fails leaves poses, points and bonds as they were.

use crate::structured::structured;
use arbitrary::Arbitrary;
use nalgebra::{Isometry3, Point3, Vector3};
use rigidformer_core::{
    Joint, Limits, Model, Observed, Physics, Pieces, Plane, Role, Simulator, SlabSizes, Unit,
    UnitId,
};
use rigidformer_tests::Room;
use rigidformer_tests::bits::{PRECISIONS, quantised};
use rigidformer_tests::hostile::{
    SMALLEST_BONDS, SMALLEST_IMPACT, SMALLEST_SOFT, assert_rigid, random_model, state,
};
use rigidformer_weights::{AlignedBuffer, Elastic, ModelConfig, Motion};
use std::sync::LazyLock;

/// Sound models in every storage: of soft bodies, of cloth whose springs limit strain and lag, of motion by impulses, and of bonds that it breaks.
pub(crate) static MODELS: LazyLock<Vec<AlignedBuffer>> = LazyLock::new(|| {
    let cloth = Elastic {
        neighbours: 8,
        falloff: 8,
        thickness_m: 0.002,
        damping_s: 0.0,
        rate_hz: 480.0,
        strain_sweeps: 4,
        strain_limit: 0.02,
        ..SMALLEST_SOFT.elastic
    };
    let impulses = ModelConfig { motion: Motion::Impulses, ..SMALLEST_IMPACT };
    let sources = [
        random_model(SMALLEST_SOFT, 1),
        random_model(ModelConfig { elastic: cloth, ..SMALLEST_SOFT }, 2),
        random_model(impulses, 3),
        random_model(SMALLEST_BONDS, 4),
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
            32760 => 1e-20,
            32761 => 1e-42,
            32762 => -0.0,
            32763 => 1e-6,
            32764 => f32::MAX,
            32765 => 1.000_001e6,
            32766 => 1e6,
            i16::MAX => f32::INFINITY,
            x => f32::from(x) / 16384.0,
        }
    }
}

fn vector(row: [Number; 3]) -> Vector3<f32> {
    Vector3::from(row.map(Number::value))
}

/// A sheet of patches over a box, or what should have been one.
#[derive(Arbitrary, Debug)]
pub(crate) struct Sheet {
    /// Patches, and points of each beside the first four.
    patches: u8,
    more: u8,
    /// Where the sheet is, how it is bent, and how far it has come.
    place: [Number; 3],
    bend: Number,
    way: [Number; 3],
    young: Number,
    physics: [Number; 3],
    rock: Option<u8>,
    bodies: u8,
    /// What is wrong with it.
    spoilt: Vec<Spoil>,
}

#[derive(Arbitrary, Debug)]
pub(crate) enum Spoil {
    Rest(u8, [Number; 3]),
    Before(u8, [Number; 3]),
    Now(u8, [Number; 3]),
    /// A point at rest that is where another one is, or nearly.
    Twin(u8, u8, bool),
    /// All points of a patch at rest in one place, or in as many that are as near as this.
    Shrink(u8, Number),
    Fewer(u8),
    FewerNow(u8),
    FewerAll(u8),
    Young(u8, Number),
    Role(u8, u8),
    Pieces(u8),
    Rigid(u8),
}

/// A patch, or the box.
#[derive(Default)]
struct Part {
    rest: Option<Vec<Point3<f32>>>,
    before: Vec<Point3<f32>>,
    now: Vec<Point3<f32>>,
    young_pa: f32,
    physics: Option<Physics>,
    role: Role,
    body: Option<u16>,
    pieces: bool,
}

impl Part {
    fn observed(&self) -> Observed<'_> {
        let default = Physics { mass_kg: 0.2, friction: 0.5, restitution: 0.0 };
        let unit = Unit::new(&self.before, self.physics.unwrap_or(default)).role(self.role);
        let unit = Unit { body: self.body, ..unit };
        let unit = match &self.rest {
            Some(rest) => unit.soft(rest, self.young_pa),
            None => unit,
        };
        let counts: &[u16] = &[4];
        let unit = match self.pieces && self.before.len() >= 4 {
            true => unit.pieces(Pieces::new(&self.before[..4], counts)),
            false => unit,
        };
        Observed { unit, current: &self.now }
    }
}

impl Sheet {
    fn parts(&self) -> Vec<Part> {
        let (place, way) = (vector(self.place), vector(self.way) * 0.1);
        let count = 4 + usize::from(self.more % 5);
        let rows = count.div_ceil(2);
        let bend = self.bend.value();
        let mut parts: Vec<Part> = (0..1 + usize::from(self.patches % 3))
            .map(|patch| {
                // Neighbours share a row of points.
                let at = |k: usize| {
                    let (x, y) = ((k % rows) as f32, (patch + k / rows) as f32);
                    Point3::new(0.1 * x, 0.1 * y, 0.0)
                };
                let rest: Vec<_> = (0..count).map(at).collect();
                let bent = |p: &Point3<f32>| p + place + Vector3::z() * (bend * p.x * p.y);
                let before: Vec<_> = rest.iter().map(bent).collect();
                let now = before.iter().map(|p| p + way).collect();
                let young_pa = self.young.value().abs() * 1e5;
                let [mass_kg, friction, restitution] = self.physics.map(Number::value);
                let physics = Physics { mass_kg, friction, restitution };
                let body = (self.bodies >> patch & 1 == 0).then_some(0);
                Part {
                    rest: Some(rest),
                    before,
                    now,
                    young_pa,
                    physics: (self.bodies & 64 != 0).then_some(physics),
                    body,
                    ..Part::default()
                }
            })
            .collect();
        if let Some(code) = self.rock {
            let corner = |k: usize, bit| if k & bit == 0 { -0.1 } else { 0.1 };
            let rock: Vec<_> =
                (0..8).map(|k| Point3::new(corner(k, 1), corner(k, 2), corner(k, 4))).collect();
            let role = role(code);
            parts.push(Part { now: rock.clone(), before: rock, role, ..Part::default() });
        }
        for spoil in self.spoilt.iter().take(3) {
            spoil.apply(&mut parts);
        }
        parts
    }
}

impl Spoil {
    fn apply(&self, parts: &mut [Part]) {
        let number = match self {
            Spoil::Rest(n, _) | Spoil::Before(n, _) | Spoil::Now(n, _) => *n,
            Spoil::Twin(n, ..) | Spoil::Shrink(n, _) | Spoil::Fewer(n) => *n,
            Spoil::FewerNow(n) | Spoil::FewerAll(n) | Spoil::Young(n, _) => *n,
            Spoil::Role(n, _) | Spoil::Pieces(n) | Spoil::Rigid(n) => *n,
        };
        let number = usize::from(number);
        let count = parts.len().max(1);
        let Some(part) = parts.get_mut(number % count) else { return };
        let at = |list: &mut Vec<Point3<f32>>, place: usize, p: Point3<f32>| {
            let length = list.len().max(1);
            if let Some(slot) = list.get_mut(place % length) {
                *slot = p;
            }
        };
        let place = number / count;
        let mut no_rest = Vec::new();
        let rest = part.rest.as_mut().unwrap_or(&mut no_rest);
        match self {
            Spoil::Rest(_, row) => at(rest, place, Point3::from(vector(*row))),
            Spoil::Before(_, row) => at(&mut part.before, place, Point3::from(vector(*row))),
            Spoil::Now(_, row) => at(&mut part.now, place, Point3::from(vector(*row))),
            Spoil::Twin(_, other, nearly) => {
                let length = rest.len().max(1);
                if let Some(mut twin) = rest.get(usize::from(*other) % length).copied() {
                    twin.z += if *nearly { 1e-9 } else { 0.0 };
                    at(rest, place, twin);
                }
            }
            Spoil::Shrink(_, size) => rest.iter_mut().for_each(|p| *p *= size.value()),
            Spoil::Fewer(_) => drop(rest.pop()),
            Spoil::FewerNow(_) => drop(part.now.pop()),
            Spoil::FewerAll(_) => {
                for list in [rest, &mut part.before, &mut part.now] {
                    list.truncate(place % 6);
                }
            }
            Spoil::Young(_, number) => part.young_pa = number.value(),
            Spoil::Role(_, code) => part.role = role(*code),
            Spoil::Pieces(_) => part.pieces = true,
            Spoil::Rigid(_) => part.rest = None,
        }
    }
}

#[derive(Arbitrary, Debug)]
pub(crate) enum Call {
    Observe(Dt, Sheet),
    /// Boxes in a row, of one body but for those that this says.
    Row(Dt, u8, [Number; 3]),
    Bond(Vec<[u8; 2]>),
    Break([u8; 2], u8),
    Join([u8; 2], [Number; 3]),
    Add(Box<Sheet>, u8),
    Remove(u8),
    SetPoses(u8, [Number; 3]),
    Drive(u8, [Number; 3]),
    SetPhysics(u8, [Number; 3]),
    SetRole(u8, u8),
    SetPlane([Number; 3], Number),
    SetGravity([Number; 3]),
    SetDt(Dt),
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
            // At most as many sub-steps as an execution has time for.
            Dt::Code(code) => f32::from(code % 32) / 240.0,
            Dt::Seconds(number) if (0.0..=2.0).contains(&number.value()) => number.value() * 0.1,
            Dt::Seconds(number) => number.value(),
        }
    }
}

fn role(code: u8) -> Role {
    match code % 4 {
        2 => Role::Driven,
        3 => Role::Fixed,
        _ => Role::Free,
    }
}

fn isometry(row: [Number; 3]) -> Isometry3<f32> {
    Isometry3::from_parts(vector(row).into(), nalgebra::UnitQuaternion::identity())
}

/// Poses, points, bonds and bodies.
pub(crate) type Everything = (Vec<[u32; 12]>, Vec<[u32; 3]>, Vec<String>);

/// What a failed call must leave.
pub(crate) fn everything(simulator: &Simulator<'_, '_>) -> Everything {
    let bits = |(_, p): (usize, Point3<f32>)| [p.x, p.y, p.z].map(f32::to_bits);
    let points =
        simulator.units().flat_map(|unit| unit.soft_points().map(bits).collect::<Vec<_>>());
    let bonds = simulator.bonds().map(|bond| format!("{bond:?}"));
    let bodies = simulator.units().map(|unit| format!("{:?}", unit.body()));
    (state(simulator), points.collect(), bonds.chain(bodies).collect())
}

/// Points of soft units are finite, and numbered as they were given.
fn assert_soft(simulator: &Simulator<'_, '_>) {
    for unit in simulator.units().filter(|unit| unit.is_soft()) {
        let mut numbers: Vec<usize> = unit.soft_points().map(|(number, _)| number).collect();
        numbers.sort_unstable();
        assert!(numbers.into_iter().eq(0..unit.point_count()), "a point has no place");
        assert!(unit.soft_points().all(|(_, p)| p.iter().all(|v| v.is_finite())));
    }
}

pub(crate) fn call(simulator: &mut Simulator<'_, '_>, known: &[UnitId], call: &Call) -> bool {
    let ids: Vec<UnitId> = simulator.units().map(|unit| unit.id()).collect();
    let id = |number: u8| -> UnitId {
        let number = usize::from(number);
        let known = known.get(number % known.len().max(1));
        ids.get(number % 5).or(known).copied().unwrap_or(UnitId::from_bits(number as u64))
    };
    match call {
        Call::Observe(dt, sheet) => {
            let parts = sheet.parts();
            simulator.observe(dt.value(), parts.iter().map(Part::observed)).is_ok()
        }
        Call::Row(dt, bodies, way) => {
            let corner = |k: usize, bit| if k & bit == 0 { 0.0 } else { 0.1 };
            let parts: Vec<Part> = (0..4_u8)
                .map(|unit| {
                    let x = 0.1 * f32::from(unit);
                    let at = |k: usize| Point3::new(x + corner(k, 1), corner(k, 2), corner(k, 4));
                    let before: Vec<_> = (0..8).map(at).collect();
                    let now = before.iter().map(|p| p + vector(*way) * 0.1).collect();
                    let body = (bodies >> unit & 1 == 0).then_some(7);
                    Part { before, now, body, ..Part::default() }
                })
                .collect();
            simulator.observe(dt.value(), parts.iter().map(Part::observed)).is_ok()
        }
        Call::Bond(pairs) => {
            let pairs: Vec<_> = pairs.iter().map(|pair| pair.map(id)).collect();
            simulator.bond(&pairs).is_ok()
        }
        Call::Break(pair, copy) => {
            let copy = usize::from(*copy & 1);
            simulator.break_bond_in(copy, pair.map(id)).is_ok()
        }
        Call::Join([unit, parent], pivot) => {
            let pivot = Point3::from(vector(*pivot));
            let (unit, parent) = (id(*unit), id(*parent));
            simulator.join(&Joint::ball(unit, parent, pivot, pivot)).is_ok()
        }
        Call::Add(sheet, number) => {
            let parts = sheet.parts();
            let Some(part) = parts.get(usize::from(*number) % parts.len().max(1)) else {
                return false;
            };
            let pose = Isometry3::identity();
            let is_soft = part.rest.is_some();
            let added = simulator.add(&part.observed().unit, &pose, &pose).is_ok();
            assert!(!(added && is_soft), "a soft unit was added");
            added
        }
        Call::Remove(number) => simulator.remove(id(*number)).is_ok(),
        Call::SetPoses(number, row) => {
            simulator.set_poses(id(*number), &isometry(*row), &isometry(*row)).is_ok()
        }
        Call::Drive(number, row) => simulator.drive(id(*number), &isometry(*row)).is_ok(),
        Call::SetPhysics(number, row) => {
            let [mass_kg, friction, restitution] = row.map(Number::value);
            simulator.set_physics(id(*number), Physics { mass_kg, friction, restitution }).is_ok()
        }
        Call::SetRole(number, code) => simulator.set_role(id(*number), role(*code)).is_ok(),
        Call::SetPlane(row, offset) => {
            let normal = vector(*row);
            let normal = normal.try_normalize(1e-3).unwrap_or(normal);
            let plane = Plane { normal, offset_m: offset.value(), friction: 0.5, restitution: 0.1 };
            simulator.set_planes(&[plane]).is_ok()
        }
        Call::SetGravity(row) => simulator.set_gravity(vector(*row) * 10.0).is_ok(),
        Call::SetDt(dt) => simulator.set_dt(dt.value()).is_ok(),
        Call::Step(_) => simulator.step().is_ok(),
    }
}

/// Makes the calls that an input stands for.
pub fn run(data: &[u8]) {
    let Some((which, calls)) = structured::<(u8, Vec<Call>)>(data) else { return };
    let model = Model::load(&MODELS[usize::from(which) % MODELS.len()]).expect("sound");
    let limits = Limits { units: 4, points: 36 };
    let mut room = Room::new(SlabSizes::new(model.config(), limits));
    let mut simulator = Simulator::new(&model, limits, room.slabs()).expect("slabs");
    let mut known = Vec::new();
    for next in calls.iter().take(10) {
        let repeats = if let Call::Step(n) = next { 1 + n % 4 } else { 1 };
        for _ in 0..repeats {
            known.extend(simulator.units().map(|unit| unit.id()));
            let before = everything(&simulator);
            if call(&mut simulator, &known, next) {
                assert_rigid(&simulator);
                assert_soft(&simulator);
            } else {
                assert_eq!(before, everything(&simulator), "a failed call changed the scene");
            }
        }
    }
}
