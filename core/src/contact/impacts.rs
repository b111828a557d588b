//! A unit's first impacts under free motion, between the convex hulls of points, and what an impulse there would do
//! (docs/MODEL.md, section 3).

use crate::contact::ground::Plane;
use crate::geometry::{
    Hull, Precision, Separation, dot, half_turn, norm, opposite, product, radius, rotate,
    rotate_back, separation,
};
use crate::limits::ANCHORS;
use crate::measure::Measure;
use crate::network::features::{CLAMP, GAP_CLAMP_M, Row};
use crate::scene::{Physics, Scene, Unit, UnitSlot};
use nalgebra::{Matrix3, Point3, Vector3};
use rigidformer_weights::{IMPACT_FEATURES, IMPACT_PUSHES, IMPACTS};

/// Other units that are looked at: those whose bounding spheres leave the least room. More cost time, and six change
/// nothing on MOVi.
const CANDIDATES: usize = 4;
/// Advances of the time towards an impact, at most: a bound on time, since advances towards a grazing impact get ever
/// smaller.
const ADVANCES: usize = 8;
/// Hulls this close touch, metres. Advances that wait for 0 would never end.
const TOUCH_M: f32 = 1e-3;
/// A gap above this at the end of the advances is no impact, metres: the search has stopped short of one.
const TOUCHING_M: f32 = 0.02;
/// Least moment of inertia of a kilogram, m^2: points on a line have none, and an impulse would spin them without bound.
const LEAST_INERTIA_M2: f32 = 1e-6;
/// Slower sliding has no direction, square of m/s: a division by it would turn rounding into friction.
const LEAST_SLIDING: f32 = 1e-12;

/// Numbers that are kept of a unit: how many impacts it has, their inputs, and its anchors' pushes.
pub(crate) const RECORD: usize = 1 + IMPACTS * IMPACT_FEATURES + ANCHORS * IMPACT_PUSHES;

/// The inputs of a unit's impacts in its record, one after another.
pub(crate) fn inputs(record: &[f32]) -> core::slice::ChunksExact<'_, f32> {
    // A whole number of at most `IMPACTS`.
    let count = record.first().map_or(0, |count| *count as usize).min(IMPACTS);
    record.get(1..1 + count * IMPACT_FEATURES).unwrap_or_default().chunks_exact(IMPACT_FEATURES)
}

/// (anchors, pushes) of a unit's record.
pub(crate) fn pushes(record: &[f32]) -> core::slice::ChunksExact<'_, f32> {
    record.get(1 + IMPACTS * IMPACT_FEATURES..).unwrap_or_default().chunks_exact(IMPACT_PUSHES)
}

/// As [`pushes`].
pub(crate) fn pushes_mut(record: &mut [f32]) -> core::slice::ChunksExactMut<'_, f32> {
    let pushes = record.get_mut(1 + IMPACTS * IMPACT_FEATURES..).unwrap_or_default();
    pushes.chunks_exact_mut(IMPACT_PUSHES)
}

/// The coming motion of a unit over a step, and of its hull at fractions of the step.
#[derive(Clone, Copy)]
struct Flight<'s> {
    unit: &'s UnitSlot,
    /// Metres a step, in the frame that falls.
    travel: Vector3<f32>,
    /// Rodrigues' parameters of a step's turn: half of it, in radians, while it is small.
    half: Vector3<f32>,
    hull: Hull<'s>,
}

impl<'s> Flight<'s> {
    #[cfg_attr(rigidformer_dsp, inline(never))]
    fn new(scene: &'s Scene<'_>, unit: &'s UnitSlot) -> Self {
        Flight {
            unit,
            travel: scene.travel(unit),
            half: half_turn(&unit.coming_turn()),
            hull: Hull { points: scene.hull_of(unit), rotation: unit.current.rotation },
        }
    }

    /// What the turn adds to the way of a point on the bounding sphere, metres a step.
    fn whirl(&self) -> f32 {
        2.0 * norm(&self.half) * self.unit.radius
    }

    /// The hull after a fraction of a step.
    fn at(&self, fraction: f32) -> Hull<'s> {
        if fraction == 0.0 {
            return self.hull;
        }
        let b = self.half * fraction;
        let scale = 2.0 / (1.0 + dot(&b, &b));
        let turn = |v: Vector3<f32>| {
            let once = b.cross(&v);
            v + (once + b.cross(&once)) * scale
        };
        let [x, y, z] = [Vector3::x(), Vector3::y(), Vector3::z()].map(turn);
        let turn = Matrix3::new(x.x, y.x, z.x, x.y, y.y, z.y, x.z, y.z, z.z);
        Hull { rotation: product(&turn, &self.hull.rotation), ..self.hull }
    }

    /// How fast a point moves whose lever is known, metres a step.
    fn speed(&self, lever: &Vector3<f32>) -> Vector3<f32> {
        self.travel + self.half.cross(lever) * 2.0
    }
}

/// What a unit meets.
#[derive(Clone, Copy)]
enum Other<'s> {
    Plane(&'s Plane),
    /// Its motion, its hull then, and the lever of its point.
    Unit(Flight<'s>, Hull<'s>, Vector3<f32>),
}

/// Where two units, or a unit and a plane, meet first, or come closest within the step.
#[derive(Clone, Copy)]
struct Impact<'s> {
    other: Other<'s>,
    hull: Hull<'s>,
    /// From the unit's centre, metres.
    lever: Vector3<f32>,
    /// Unit vector away from the unit.
    normal: Vector3<f32>,
    /// Of the step.
    fraction: f32,
    /// Then, metres; below 0 where they overlap now.
    gap: f32,
}

impl Impact<'_> {
    /// Metres a step towards the other, and the gap that this leaves at the end of the step.
    fn urgency(&self, towards: &Vector3<f32>) -> f32 {
        self.gap - dot(towards, &self.normal) * (1.0 - self.fraction)
    }
}

/// The items with the least keys, as many as there is room for; of equals those that came first.
struct Least<T, const ROOM: usize> {
    items: heapless::Vec<(T, f32), ROOM>,
}

impl<T, const ROOM: usize> Least<T, ROOM> {
    fn insert(&mut self, item: T, key: f32) {
        let Err(new) = self.items.push((item, key)) else { return };
        let mut worst: Option<&mut (T, f32)> = None;
        for old in &mut self.items {
            if worst.as_ref().is_none_or(|worst| old.1 > worst.1) {
                worst = Some(old);
            }
        }
        if let Some(worst) = worst.filter(|worst| new.1 < worst.1) {
            *worst = new;
        }
    }
}

/// Fills the record of unit `index`: raw inputs, and pushes. Only free units have impacts: nothing pushes others.
#[cfg_attr(rigidformer_dsp, inline(never))]
pub(crate) fn describe(scene: &Scene<'_>, index: usize, record: &mut [f32]) {
    record.fill(0.0);
    let Some(unit) = scene.units().get(index).filter(|unit| unit.is_free()) else { return };
    let flight = Flight::new(scene, unit);
    let mut found = Least::<Impact<'_>, IMPACTS> { items: heapless::Vec::new() };
    for plane in &scene.planes {
        if let Some(impact) = with_plane(scene, plane, &flight) {
            let urgency = impact.urgency(&(flight.speed(&impact.lever) + scene.fall()));
            found.insert(impact, urgency);
        }
    }
    for other in candidates(scene, index, &flight) {
        let other = Flight::new(scene, other);
        let (impact, lever) = with_unit(&flight, &other);
        let urgency = impact.urgency(&(flight.speed(&impact.lever) - other.speed(&lever)));
        found.insert(impact, urgency);
    }

    let Some((count, rest)) = record.split_first_mut() else { return };
    *count = found.items.len() as f32;
    let (inputs, pushes) = rest.split_at_mut((IMPACTS * IMPACT_FEATURES).min(rest.len()));
    let mut sums = [[Vector3::zeros(); 2]; 2];
    for ((impact, _), row) in found.items.iter().zip(inputs.chunks_exact_mut(IMPACT_FEATURES)) {
        let [kick, twist] = respond(scene, &flight, impact, row);
        let left = 1.0 - impact.fraction;
        for ([kicks, twists], share) in sums.iter_mut().zip([left, 1.0]) {
            *kicks += kick * share;
            *twists += twist * share;
        }
    }
    for (anchor, row) in scene.anchors_of(unit).iter().zip(pushes.chunks_exact_mut(IMPACT_PUSHES)) {
        let arm = rotate(&unit.current.rotation, anchor);
        let mut row = Row::new(row);
        for [kick, twist] in &sums {
            row.vector((kick + twist.cross(&arm)).map(|v| v.clamp(-CLAMP, CLAMP)));
        }
    }
}

/// The units of other bodies whose bounding spheres may meet the unit's within the step; of more than [`CANDIDATES`]
/// those with the least room.
fn candidates<'s>(
    scene: &'s Scene<'_>,
    index: usize,
    flight: &Flight<'s>,
) -> impl Iterator<Item = &'s UnitSlot> {
    let mut near = Least::<&UnitSlot, CANDIDATES> { items: heapless::Vec::new() };
    for (_, other) in scene.others(index, flight.unit) {
        let room = scene.room_to_unit((flight.unit, &flight.travel), other);
        if room < 0.0 {
            near.insert(other, room);
        }
    }
    near.items.into_iter().map(|(other, _)| other)
}

/// The lowest point when it reaches a plane; none where the bounding sphere stays above it.
#[cfg_attr(rigidformer_dsp, inline(never))]
fn with_plane<'s>(scene: &Scene<'_>, plane: &'s Plane, flight: &Flight<'s>) -> Option<Impact<'s>> {
    let (unit, travel) = (flight.unit, &flight.travel);
    if scene.room_to_plane((unit, travel), plane) >= 0.0 {
        return None;
    }
    let into = -plane.normal;
    let (rise, fall) = (dot(&plane.normal, travel), dot(&plane.normal, &scene.fall()));
    let height = plane.height_here(&unit.current.centre);
    let close = flight.whirl() - (rise + fall);
    let mut fraction = 0.0_f32;
    let mut advances = 0;
    loop {
        let hull = flight.at(fraction);
        let lever = hull.support(&into);
        let gap = ((height + fraction * rise) + fraction * fall) + dot(&plane.normal, &lever);
        advances += 1;
        if advances == ADVANCES || gap < TOUCH_M || close <= 1e-9 || fraction >= 1.0 {
            return Some(Impact {
                other: Other::Plane(plane),
                hull,
                lever,
                normal: into,
                fraction,
                gap,
            });
        }
        fraction = (fraction + gap / close).min(1.0);
    }
}

/// Conservative advancement: time goes on by no more than the gap allows. Units that overlap now get the normal and
/// the levers that they had when they met, and the gap along that normal now. The second value is the other's lever.
#[cfg_attr(rigidformer_dsp, inline(never))]
fn with_unit<'s>(flight: &Flight<'s>, other: &Flight<'s>) -> (Impact<'s>, Vector3<f32>) {
    let apart = flight.unit.current.centre - other.unit.current.centre;
    let relative = flight.travel - other.travel;
    let whirl = flight.whirl() + other.whirl();
    let mut last: Option<Separation> = None;
    // Whether it is of another time than `fraction`.
    let mut stale = true;
    let mut fraction = 0.0_f32;
    for (from, end) in [(0.0, 1.0), (-1.0, 0.0)] {
        fraction = from;
        for advance in 1..=ADVANCES {
            let there = apart + relative * fraction;
            let guess = last.map_or(there, |found| opposite(&found.normal));
            let hulls = [&flight.at(fraction), &other.at(fraction)];
            let found = separation(hulls, &there, &guess, &Precision::COARSE);
            stale = found.is_none();
            let Some(found) = found else { break };
            last = Some(found);
            let close = dot(&relative, &found.normal) + whirl;
            let touches = found.distance < TOUCH_M || close <= 1e-9;
            if touches || fraction >= end || advance == ADVANCES {
                break;
            }
            // Not all the way, so that there are two closest points to be found then.
            fraction = (fraction + (found.distance - 0.5 * TOUCH_M) / close).min(end);
        }
        if last.is_some() {
            if from < 0.0 {
                (fraction, stale) = (0.0, true);
            }
            break;
        }
        fraction = 0.0;
    }
    let normal = last.map_or_else(|| apart / -norm(&apart).max(1e-6), |found| found.normal);
    let (hull, other_hull) = (flight.at(fraction), other.at(fraction));
    let (levers, gap) = match last {
        Some(found) if !stale => (found.levers, found.distance),
        last => {
            let levers = [hull.support(&normal), other_hull.support(&opposite(&normal))];
            let [lever, other_lever] = levers;
            let across = (other_lever - lever) - (apart + relative * fraction);
            // Of a face any corner would be the farthest.
            (last.map_or(levers, |found| found.levers), dot(&across, &normal))
        }
    };
    let [lever, other_lever] = levers;
    let other = Other::Unit(*other, other_hull, other_lever);
    (Impact { other, hull, lever, normal, fraction, gap }, other_lever)
}

/// How a unit of a kilogram turns (rad/s) by a unit impulse `along` at a lever.
#[cfg_attr(rigidformer_dsp, inline(never))]
fn turned(
    hull: &Hull<'_>,
    unit: &UnitSlot,
    lever: &Vector3<f32>,
    along: &Vector3<f32>,
) -> Vector3<f32> {
    let torque = rotate_back(&hull.rotation, &lever.cross(along));
    rotate(&hull.rotation, &torque.component_div(&unit.inertia_m2))
}

/// Moment of inertia of a kilogram of a uniform ball, in squares of its radius: 2/5.
const BALL_INERTIA: f32 = 0.4;

/// Moments of inertia of a kilogram of a unit in a measure, m^2: its own, or those of a ball or of the box around its points
/// there.
#[cfg_attr(rigidformer_dsp, inline(never))]
pub(crate) fn inertia(
    unit: &Unit<'_>,
    points: &[Point3<f32>],
    is_ball: bool,
    measure: &Measure,
) -> Vector3<f32> {
    let length = measure.length();
    let moments = unit.inertia_kg_m2.map(|moments| {
        // What overflows turns by nothing.
        Vector3::from(moments) / (unit.physics.mass_kg * (length * length))
    });
    no_less(moments.unwrap_or_else(|| inertia_of(points, is_ball)))
}

/// What is too small would turn faster than impulses can be found for.
pub(crate) fn no_less(moments_m2: Vector3<f32>) -> Vector3<f32> {
    moments_m2.map(|moment| moment.max(LEAST_INERTIA_M2))
}

/// Moments of inertia of a kilogram that fills a ball, or the box around points, m^2: what physics engines take for spheres
/// and hulls.
fn inertia_of(points: &[Point3<f32>], is_ball: bool) -> Vector3<f32> {
    if is_ball {
        let radius = radius(points);
        return Vector3::repeat(BALL_INERTIA * (radius * radius));
    }
    let mut low = Vector3::repeat(f32::INFINITY);
    let mut high = Vector3::repeat(f32::NEG_INFINITY);
    for point in points {
        low = low.inf(&point.coords);
        high = high.sup(&point.coords);
    }
    let square = (high - low).map(|side| side * side);
    let all = (square.x + square.y) + square.z;
    square.map(|own| (all - own) / 12.0)
}

/// Writes an impact's inputs and returns the changes of velocity (m/s) and of turn (rad/s) that its impulse would
/// make, bounce and friction included.
#[cfg_attr(rigidformer_dsp, inline(never))]
fn respond(
    scene: &Scene<'_>,
    flight: &Flight<'_>,
    impact: &Impact<'_>,
    row: &mut [f32],
) -> [Vector3<f32>; 2] {
    let dt = scene.dt;
    let Impact { other, hull, lever, normal, fraction, gap } = impact;
    let Physics { friction, restitution, .. } = flight.unit.physics;
    let mass = flight.unit.mass;
    let velocity = flight.speed(lever) / dt;
    // Of the other: 1 / mass, velocity, friction and restitution.
    let (lightness, theirs, other_friction, other_restitution) = match other {
        Other::Plane(plane) => (0.0, scene.gravity * -dt, plane.friction, plane.restitution),
        Other::Unit(other, _, lever) => {
            let Physics { friction, restitution, .. } = other.unit.physics;
            (other.unit.lightness(), other.speed(lever) / dt, friction, restitution)
        }
    };
    let relative = velocity - theirs;
    let (friction, bounce) = (friction * other_friction, restitution * other_restitution);
    // The mass that an impulse along a direction meets, and the unit's turn by it.
    let met = |along: &Vector3<f32>| {
        let own = turned(hull, flight.unit, lever, along);
        // Not negative but for rounding.
        let mut soft = 1.0 / mass + lightness + dot(&own.cross(lever), along).max(0.0) / mass;
        if let Other::Unit(other, hull, lever) = other {
            let his = turned(hull, other.unit, lever, along);
            soft += dot(&his.cross(lever), along).max(0.0) * lightness;
        }
        (1.0 / soft, own)
    };
    let approach = dot(&relative, normal);
    let sliding = relative - normal * approach;
    let speed = crate::math::sqrt(dot(&sliding, &sliding).max(LEAST_SLIDING));
    let tangent = sliding / speed;
    let after = (gap - approach * (1.0 - fraction) * dt).clamp(-GAP_CLAMP_M, GAP_CLAMP_M);
    let touching = (1.0 - gap / TOUCHING_M).clamp(0.0, 1.0);
    let (effective, own) = met(normal);
    let impulse = effective * approach.max(0.0) * touching;
    let (drag_effective, drag_own) = met(&tangent);
    let drag = (friction * (1.0 + bounce) * impulse).min(drag_effective * speed * touching);
    let (impulse, drag) = (impulse / mass, drag / mass);
    let (push, spin) = (normal * -impulse, own * -impulse);
    let (rub, roll) = (tangent * -drag, drag_own * -drag);
    let mut row = Row::new(row);
    for vector in [normal, lever, &velocity, &relative, &sliding] {
        row.vector(*vector);
    }
    let ratio = mass * lightness;
    let gap = gap.clamp(-GAP_CLAMP_M, GAP_CLAMP_M);
    for scalar in [approach, after, gap, *fraction, touching] {
        row.scalar(scalar);
    }
    for scalar in [flight.unit.ln_mass, ratio / (1.0 + ratio), friction, bounce, effective / mass] {
        row.scalar(scalar);
    }
    for vector in [push, push * bounce, rub, spin, spin * bounce, roll] {
        row.vector(vector);
    }
    [push * (1.0 + bounce) + rub, spin * (1.0 + bounce) + roll]
}
