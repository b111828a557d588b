//! Soft bodies: points that springs hold together, and what the network's output does to them (docs/MODEL.md, sections 6 and 7).
//!
//! A soft unit is a patch of a body. Its points are where they are: the slab of points has them about their mean, and the unit's
//! poses are that mean without a turn, so that whoever reads a unit's shape reads the deformed one.

use crate::error::ObserveError;
use crate::geometry::{
    Course, Pose, State, dot, felt_directions, kabsch_here, norm, radius_here, rotate, rotate_back,
};
use crate::kernels::Schedule;
use crate::limits::{ANCHORS, MAX_COORDINATE_M, MIN_EXTENT_M};
use crate::math;
use crate::model::Model;
use crate::scene::{Retimed, Role, Scene, Soft, Unit, UnitSlot};
use crate::sizes::Sizes;
use crate::slices::{rows, slice_at, slice_at_mut};
use crate::structure::soft_points::{
    BLEND, FELT, MASS, SPRING, SoftPoints, number, put, repeat, set, vector,
};
use crate::structure::stage::{Attempt, Structure};
use crate::workspace::Rows;
use nalgebra::{Matrix3, Point3, Vector3};
use rigidformer_weights::{BLEND_CODE, BLEND_HIDDEN, Elastic, MAX_NEIGHBOURS, ModelConfig};

/// Soft bodies in a step.
pub(crate) struct SoftBodies;

impl Structure for SoftBodies {
    fn prior(config: &ModelConfig, scene: &mut Scene<'_>, copy: usize) {
        solve(scene, &config.elastic, copy);
    }

    fn state(scene: &Scene<'_>, index: usize, unit: &UnitSlot) -> State {
        // A patch has its points; its pose follows from them when they have moved.
        if unit.is_soft() { unit.resting() } else { rigid_state(scene, index, unit) }
    }

    fn constrain<S: Schedule>(schedule: S, attempt: Attempt<'_, '_>) -> Result<(), usize> {
        let Attempt { model, sizes, scene, copy, rows, .. } = attempt;
        if !sizes.is_soft() {
            return Ok(());
        }
        blend(schedule, model, sizes, (scene, copy), rows)
    }

    fn commit(scene: &mut Scene<'_>, copy: usize) {
        commit(scene, copy);
    }
}

/// Points closer at rest than this share of the body's spacing are one mass: patches meet there, and a spring without
/// length has no direction.
const SAME: f32 = 1e-3;
/// Springs up to this many spacings resist compression too where strain is limited. Longer ones lie across folds, which
/// may close.
const SHORT: f32 = 1.2;
/// Shorter distances have no direction, metres: the division would blow rounding up.
const TINY_M: f32 = 1e-9;
/// Substeps of a step, at most: a bound on its time.
pub(crate) const MAX_SOFT_SUBSTEPS: f32 = 4096.0;
/// A hull that holds a sphere of this share of its radius counts as a ball. Polyhedra from 120 points on a sphere are
/// that round.
const BALL: f32 = 0.975;

/// Checks a unit that is said to be soft.
pub(crate) fn check(elastic: &Elastic, number: usize, unit: &Unit<'_>) -> Result<(), ObserveError> {
    let Some(Soft { rest, young_pa }) = unit.soft else { return Ok(()) };
    if elastic.neighbours == 0 {
        return Err(ObserveError::NotSoft { unit: number });
    }
    let is_near = |p: &Point3<f32>| p.iter().all(|v| v.abs() <= MAX_COORDINATE_M);
    // Anchors that coincide at rest tell no patch from another.
    let has_extent = |first: &Point3<f32>| rest.iter().any(|p| norm(&(p - first)) >= MIN_EXTENT_M);
    let sound = rest.len() == unit.points.len()
        && rest.iter().all(is_near)
        && rest.first().is_some_and(has_extent)
        && (1e-3..=1e15).contains(&young_pa)
        && unit.role == Role::Free
        && unit.pieces.is_empty();
    let apart = |(i, p): (usize, &Point3<f32>)| rest.iter().skip(i + 1).all(|q| p != q);
    if sound && rest.iter().enumerate().all(apart) {
        return Ok(());
    }
    Err(ObserveError::BadSoft { unit: number })
}

/// Takes the state of a unit whose points at rest lie in order in the slab, about `offset`: `previous` and `current` are as its
/// owner gave them.
pub(crate) fn add_patch(
    scene: &mut Scene<'_>,
    (start, count): (usize, usize),
    rest: &[Point3<f32>],
    offset: &Point3<f32>,
    [previous, current]: [&[Point3<f32>]; 2],
) {
    let Scene { points, soft, .. } = scene;
    // Which points have a row already, until masses are found.
    let taken = slice_at_mut(soft.owner, start, count);
    taken.fill(0.0);
    for row in start..start + count {
        let Some(point) = points.get(row) else { return };
        // Where the unit gave the point that is here now: the nearest one without a row, since the centre was taken off it. Points
        // that differ by less than that rounds off have a row each all the same.
        let apart = |p: &Point3<f32>| {
            let d = (p - offset) - point.coords;
            dot(&d, &d)
        };
        let mut best = (0, f32::INFINITY);
        for ((index, p), taken) in rest.iter().enumerate().zip(taken.iter()) {
            let d = apart(p);
            if *taken == 0.0 && d < best.1 {
                best = (index, d);
            }
        }
        put(taken, best.0, 1.0);
        let at = |list: &[Point3<f32>]| list.get(best.0).copied().unwrap_or_default().coords;
        put(soft.given, row, best.0 as f32);
        set(soft.rest, row, &at(rest));
        let (way, current) = (at(current) - at(previous), at(current));
        set(soft.state, row * 2, &way);
        set(soft.state, row * 2 + 1, &current);
    }
}

/// Finds masses and springs of a copy's soft bodies, once all units are there, and what rigid units are to them. Copies have as many
/// springs as the first.
pub(crate) fn bind(scene: &mut Scene<'_>, elastic: &Elastic, copy: usize) {
    let (first, units) = copy_of(scene.slots, scene.per_copy, copy);
    let Scene { soft, points, .. } = scene;
    let (mut radii, mut many) = (0.0_f32, 0.0_f32);
    let mut springs = copy * soft.count;
    let before = springs;
    for (index, unit) in (first..).zip(units) {
        if unit.is_soft() {
            radii += rest_radius(soft, unit);
            many += 1.0;
            let is_first = !units.iter().take(index - first).any(|u| same_body(u, unit));
            if is_first {
                springs = bind_body(soft, units, unit, (elastic, springs));
            }
        } else {
            let own = points.get(unit.start..unit.start + unit.count).unwrap_or_default();
            for (k, felt) in felt_directions().enumerate() {
                let along = felt / norm(&felt);
                let reach = own.iter().fold(f32::NEG_INFINITY, |most, p| {
                    let reach = dot(&p.coords, &along);
                    if reach > most { reach } else { most }
                });
                put(soft.supports, index * FELT + k, reach);
            }
        }
    }
    soft.count = springs - before;
    soft.size_m = if many > 0.0 { radii / many } else { 0.0 };
}

/// The units of a copy, and the index of the first.
fn copy_of(slots: &[UnitSlot], per_copy: usize, copy: usize) -> (usize, &[UnitSlot]) {
    let first = if cfg!(rigidformer_host) { copy * per_copy } else { 0 };
    (first, slots.get(first..first + per_copy).unwrap_or_default())
}

/// Makes the points, springs and weights of a copy of so many points what those of another one are.
pub(crate) fn replicate(
    scene: &mut Scene<'_>,
    weights: &mut [f32],
    points: usize,
    (from, to): (usize, usize),
) {
    let Scene { per_copy, points: slab, soft, .. } = scene;
    for row in 0..points {
        let point = slab.get(from * points + row).copied();
        if let (Some(slot), Some(point)) = (slab.get_mut(to * points + row), point) {
            *slot = point;
        }
    }
    repeat(weights, points * ANCHORS, from, to);
    soft.replicate((*per_copy, points), from, to);
}

fn rest_radius(soft: &SoftPoints<'_>, unit: &UnitSlot) -> f32 {
    let rows = unit.start..unit.start + unit.count;
    let mut middle = Vector3::zeros();
    for row in rows.clone() {
        middle += soft.rest(row);
    }
    middle /= unit.count as f32;
    rows.fold(0.0_f32, |most, row| most.max(norm(&(soft.rest(row) - middle))))
}

/// Whether two soft units of a copy are patches of one body.
fn same_body(a: &UnitSlot, b: &UnitSlot) -> bool {
    a.is_soft() && b.is_soft() && (a.id == b.id || (a.body != 0 && a.body == b.body))
}

/// Rows of the points of a body, in order, with their units.
fn rows_of<'u>(
    units: &'u [UnitSlot],
    first: &'u UnitSlot,
) -> impl Iterator<Item = (usize, &'u UnitSlot)> + Clone {
    let patches = units.iter().filter(move |unit| same_body(unit, first));
    patches.flat_map(|unit| (unit.start..unit.start + unit.count).map(move |row| (row, unit)))
}

/// The square of the distance between two points at rest.
fn apart(soft: &SoftPoints<'_>, a: usize, b: usize) -> f32 {
    let d = soft.rest(a) - soft.rest(b);
    dot(&d, &d)
}

/// The number of springs behind those that there were.
fn bind_body(
    soft: &mut SoftPoints<'_>,
    units: &[UnitSlot],
    first: &UnitSlot,
    (elastic, mut springs): (&Elastic, usize),
) -> usize {
    let body = || rows_of(units, first);
    let mut size = 0.0_f32;
    for (a, _) in body() {
        for (b, _) in body() {
            size = size.max(apart(soft, a, b));
        }
    }
    let total = body().count();
    let same = SAME * SAME * (size / total as f32);
    let (mut masses, mut kilograms) = (0.0_f32, 0.0_f32);
    for (row, unit) in body() {
        let owner = body().map(|(b, _)| b).find(|b| apart(soft, row, *b) <= same).unwrap_or(row);
        put(soft.owner, row, owner as f32);
        kilograms += unit.mass / unit.count as f32;
        put(soft.masses, row * MASS + 2, 0.0);
        let copies = number(soft.masses, owner * MASS + 2) + 1.0;
        put(soft.masses, owner * MASS + 2, copies);
        masses += if owner == row { 1.0 } else { 0.0 };
    }
    for (row, unit) in body() {
        let lightness = if soft.owner(row) == row { masses / kilograms } else { 0.0 };
        put(soft.masses, row * MASS, lightness);
        put(soft.masses, row * MASS + 1, unit.physics.friction);
    }
    // The distance of each mass to the last neighbour that it has a spring to, and that neighbour: of equally far ones the first
    // counts as nearer.
    let mut spacing = 0.0_f32;
    for (a, _) in body() {
        if soft.lightness(a) == 0.0 {
            continue;
        }
        let mut nearest = [(f32::INFINITY, 0.0_f32); MAX_NEIGHBOURS];
        let kept = (elastic.neighbours as usize).min(MAX_NEIGHBOURS);
        let Some(nearest) = nearest.get_mut(..kept) else { return springs };
        for (b, _) in body().filter(|(b, _)| *b != a) {
            if soft.lightness(b) == 0.0 {
                continue;
            }
            let mut found = (apart(soft, a, b), b as f32);
            for slot in nearest.iter_mut() {
                // One that is pushed out stays ahead of later ones that are as far.
                if found.0 < slot.0 || (found.0 == slot.0 && found.1 < slot.1) {
                    core::mem::swap(slot, &mut found);
                }
            }
        }
        let closest = nearest.first().map_or(0.0, |slot| slot.0);
        spacing += if closest.is_finite() { math::sqrt(closest) } else { 0.0 };
        let last = nearest.last().copied().unwrap_or_default();
        set(soft.before, a, &Vector3::new(last.0, last.1, 0.0));
    }
    spacing /= masses;
    for (a, unit) in body() {
        put(soft.masses, a * MASS + 3, spacing);
        if soft.lightness(a) == 0.0 {
            continue;
        }
        for (b, _) in body().filter(|(b, _)| *b > a) {
            if soft.lightness(b) == 0.0 {
                continue;
            }
            let d = apart(soft, a, b);
            let reaches = |from: usize, to: usize| {
                let last = vector(soft.before, from);
                d < last.x || (d == last.x && to as f32 <= last.y)
            };
            if !(reaches(a, b) || reaches(b, a)) {
                continue;
            }
            let length = math::sqrt(d);
            let young = math::exp(unit.ln_young);
            let metres = if elastic.thickness_m > 0.0 { elastic.thickness_m } else { spacing };
            let mut stiffness = (young * elastic.stiffness) * metres;
            for _ in 0..elastic.falloff {
                stiffness *= spacing / length;
            }
            let at = springs * SPRING;
            let spring = [a as f32, b as f32, length, 1.0 / stiffness];
            if let Some(slots) = soft.springs.get_mut(at..at + SPRING) {
                slots.copy_from_slice(&spring);
                springs += 1;
            }
        }
    }
    springs
}

/// Brings what others read of a soft unit to where its points are: the slab of points, poses and radius.
pub(crate) fn refresh(scene: &mut Scene<'_>, index: usize) {
    let Some(mut unit) = scene.units().get(index).copied() else { return };
    if !unit.is_soft() {
        return;
    }
    let Scene { points, soft, .. } = scene;
    let rows = unit.start..unit.start + unit.count;
    let share = unit.count as f32;
    let [mut way, mut now] = [Vector3::zeros(); 2];
    for row in rows.clone() {
        way += soft.increment(row);
        now += soft.current(row);
    }
    let rotation = Matrix3::identity();
    unit.course = Course::REST.moving(way / share, Vector3::zeros());
    unit.current = Pose { rotation, centre: now / share };
    unit.target = unit.current;
    let slab = points.get_mut(rows.clone()).unwrap_or_default();
    for (point, row) in slab.iter_mut().zip(rows) {
        *point = Point3::from(soft.current(row) - unit.current.centre);
    }
    unit.radius = radius_here(slab);
    let mut rest = [Vector3::zeros(); ANCHORS];
    let mut here = rest;
    for (k, (rest, here)) in rest.iter_mut().zip(&mut here).enumerate() {
        (*rest, *here) = (soft.rest(unit.start + k), soft.current(unit.start + k));
    }
    unit.first = kabsch_here(&rest, &here, &unit.first.rotation).pose;
    if let Some(slot) = scene.units_mut().get_mut(index) {
        *slot = unit;
    }
}

/// Makes the last step of soft units one of another length, at the same velocities. Where `changes` is false nothing moves: none
/// where a point would come from nowhere.
pub(crate) fn retime(scene: &mut Scene<'_>, motion: &Retimed, changes: bool) -> Option<()> {
    for index in 0..scene.count {
        let Some(unit) = scene.units().get(index).copied().filter(UnitSlot::is_soft) else {
            continue;
        };
        for row in unit.start..unit.start + unit.count {
            let soft = &mut scene.soft;
            let (way, current) = (soft.increment(row), soft.current(row));
            // What was put somewhere without motion stays so.
            let way = if way == Vector3::zeros() { way } else { motion.way(&way) };
            if !(current - way).iter().all(|v| v.abs() <= MAX_COORDINATE_M) {
                return None;
            }
            if changes {
                soft.set_state(row, &way, &current);
            }
        }
        if changes {
            refresh(scene, index);
        }
    }
    Some(())
}

/// Moves a mass out by its share of a depth, and drags it along the surface: `there` is where it would be had it stuck to it.
fn rub(
    x: &mut Vector3<f32>,
    there: &Vector3<f32>,
    normal: &Vector3<f32>,
    (depth, friction, share): (f32, f32, f32),
) {
    *x += normal * (depth * share);
    let way = *x - there;
    let slide = way - normal * dot(&way, normal);
    let size = norm(&slide);
    if size > TINY_M {
        *x -= slide * ((friction * depth).min(size) / size * share);
    }
}

/// How long a sub-step is, and how many a step has.
fn substeps(elastic: &Elastic, dt: f32) -> (f32, u32) {
    let exact = dt * elastic.rate_hz - 1e-3;
    // At most `MAX_SOFT_SUBSTEPS`, as the time step was checked.
    let whole = exact.clamp(0.0, MAX_SOFT_SUBSTEPS) as u32;
    let steps = if (whole as f32) < exact { whole + 1 } else { whole }.max(1);
    (dt / steps as f32, steps)
}

/// Moves a copy's soft bodies by springs and contact for a step, and the rigid units beside them.
fn solve(scene: &mut Scene<'_>, elastic: &Elastic, copy: usize) {
    let (dt, gravity) = (scene.dt, scene.gravity);
    let (first, units) = copy_of(scene.slots, scene.per_copy, copy);
    let (h, steps) = substeps(elastic, dt);
    let half = gravity * (dt * 0.5);
    let Scene { soft, planes, .. } = scene;
    for (index, unit) in (first..).zip(units) {
        if unit.is_soft() {
            for row in unit.start..unit.start + unit.count {
                let now = soft.current(row);
                let velocity = soft.increment(row) / dt + half;
                set(soft.after, row, &now);
                set(soft.velocity, row, &velocity);
            }
        } else {
            let velocity = unit.course.way / dt + half;
            set(soft.rigid, index * 3, &unit.current.centre);
            set(soft.rigid, index * 3 + 1, &velocity);
        }
    }
    let soft_units = || units.iter().filter(|unit| unit.is_soft());
    let obstacles = || (first..).zip(units).filter(|(_, unit)| !unit.is_soft());
    for _ in 0..steps {
        for unit in soft_units() {
            for row in unit.start..unit.start + unit.count {
                if soft.lightness(row) == 0.0 {
                    continue;
                }
                let velocity = vector(soft.velocity, row) + gravity * h;
                let x = vector(soft.after, row);
                set(soft.velocity, row, &velocity);
                set(soft.before, row, &x);
                set(soft.after, row, &(x + velocity * h));
            }
        }
        for (index, unit) in obstacles() {
            let y = vector(soft.rigid, index * 3);
            set(soft.rigid, index * 3 + 2, &y);
            let way = match unit.role {
                Role::Free => {
                    let velocity = vector(soft.rigid, index * 3 + 1) + gravity * h;
                    set(soft.rigid, index * 3 + 1, &velocity);
                    velocity * h
                }
                Role::Driven => (unit.target.centre - unit.current.centre) / steps as f32,
                Role::Fixed => Vector3::zeros(),
            };
            set(soft.rigid, index * 3, &(y + way));
        }
        relax(soft, elastic, h, copy);
        for unit in soft_units() {
            for row in unit.start..unit.start + unit.count {
                if soft.lightness(row) == 0.0 {
                    continue;
                }
                let (mut x, before) = (vector(soft.after, row), vector(soft.before, row));
                for plane in planes.iter() {
                    let depth = (plane.offset_m + elastic.skin_m) - dot(&plane.normal, &x);
                    if depth > 0.0 {
                        let friction = soft.friction(row) * plane.friction;
                        rub(&mut x, &before, &plane.normal, (depth, friction, 1.0));
                    }
                }
                for (index, other) in obstacles() {
                    touch(soft, (row, &mut x, &before), (index, other), elastic.skin_m);
                }
                set(soft.after, row, &x);
            }
        }
        for (index, unit) in obstacles().filter(|(_, unit)| unit.is_free()) {
            let (mut y, before) =
                (vector(soft.rigid, index * 3), vector(soft.rigid, index * 3 + 2));
            for plane in planes.iter() {
                let depth = (plane.offset_m + unit.radius) - dot(&plane.normal, &y);
                if depth > 0.0 {
                    let friction = unit.physics.friction * plane.friction;
                    rub(&mut y, &before, &plane.normal, (depth, friction, 1.0));
                }
            }
            set(soft.rigid, index * 3, &y);
            set(soft.rigid, index * 3 + 1, &((y - before) / h));
        }
        for unit in soft_units() {
            for row in unit.start..unit.start + unit.count {
                if soft.lightness(row) > 0.0 {
                    let way = vector(soft.after, row) - vector(soft.before, row);
                    set(soft.velocity, row, &(way / h));
                }
            }
        }
    }
    for unit in soft_units() {
        for row in unit.start..unit.start + unit.count {
            let owner = soft.owner(row);
            if owner != row {
                let (x, v) = (vector(soft.after, owner), vector(soft.velocity, owner));
                set(soft.after, row, &x);
                set(soft.velocity, row, &v);
            }
        }
    }
}

/// Corrects every spring of a copy once, in order.
fn relax(soft: &mut SoftPoints<'_>, elastic: &Elastic, h: f32, copy: usize) {
    let lag = elastic.damping_s / h;
    let square = h * h;
    let SoftPoints { springs, after, before, masses, count, .. } = soft;
    let length = *count * SPRING;
    for spring in rows(slice_at(springs, copy * length, length), SPRING) {
        let [a, b, length, compliance] = spring else { return };
        let (a, b) = (*a as usize, *b as usize);
        let (x, y) = (vector(after, a), vector(after, b));
        let between = x - y;
        let size = norm(&between);
        if size < TINY_M {
            continue;
        }
        let along = between / size;
        let mut error = size - length;
        if lag > 0.0 {
            let rate = dot(&((x - vector(before, a)) - (y - vector(before, b))), &along);
            error += lag * rate;
        }
        let (light, other) = (number(masses, a * MASS), number(masses, b * MASS));
        let pull = -error / ((1.0 + lag) * (light + other) + compliance / square);
        set(after, a, &(x + along * (pull * light)));
        set(after, b, &(y - along * (pull * other)));
    }
}

/// Brings a copy's springs that are strained beyond the limit back to it, one after the other, in so many sweeps.
fn limit_strain(soft: &mut SoftPoints<'_>, elastic: &Elastic, copy: usize) {
    let SoftPoints { springs, after, masses, count, .. } = soft;
    let length = *count * SPRING;
    let springs = slice_at(springs, copy * length, length);
    for _ in 0..elastic.strain_sweeps {
        for spring in rows(springs, SPRING) {
            let [a, b, length, _] = spring else { return };
            let (a, b) = (*a as usize, *b as usize);
            let (x, y) = (vector(after, a), vector(after, b));
            let between = x - y;
            let size = norm(&between);
            let is_short = *length < SHORT * number(masses, a * MASS + 3);
            let least = if is_short { length * (1.0 - elastic.strain_limit) } else { 0.0 };
            let most = length * (1.0 + elastic.strain_limit);
            // False where the numbers are none.
            let is_strained = size >= TINY_M && (size < least || size > most);
            if !is_strained {
                continue;
            }
            let wanted = if size > most { most } else { least };
            let (light, other) = (number(masses, a * MASS), number(masses, b * MASS));
            let along = between / size;
            let pull = (wanted - size) / (light + other);
            set(after, a, &(x + along * (pull * light)));
            set(after, b, &(y - along * (pull * other)));
        }
    }
}

/// Keeps a mass out of a rigid unit, which takes its part of the way where it is free.
fn touch(
    soft: &mut SoftPoints<'_>,
    (row, x, before): (usize, &mut Vector3<f32>, &Vector3<f32>),
    (index, other): (usize, &UnitSlot),
    skin_m: f32,
) {
    let y = vector(soft.rigid, index * 3);
    let from = *x - y;
    let size = norm(&from);
    let depth = (other.radius + skin_m) - size;
    // Also where the numbers are none.
    if !(depth > 0.0 && size >= TINY_M) {
        return;
    }
    let contact = if other.is_ball {
        Some((depth, from / size))
    } else {
        deepest(soft, (index, other), &from, skin_m)
    };
    let Some((depth, normal)) = contact else { return };
    let (light, heavy) = (soft.lightness(row), other.lightness());
    let there = before + (y - vector(soft.rigid, index * 3 + 2));
    let was = *x;
    let friction = soft.friction(row) * other.physics.friction;
    rub(x, &there, &normal, (depth, friction, light / (light + heavy)));
    if heavy > 0.0 {
        set(soft.rigid, index * 3, &(y - (*x - was) * (heavy / light)));
    }
}

/// How deep a place is in the hull of a rigid unit, metres, and the way out; none outside. `from` is seen from its centre.
fn deepest(
    soft: &SoftPoints<'_>,
    (index, unit): (usize, &UnitSlot),
    from: &Vector3<f32>,
    skin_m: f32,
) -> Option<(f32, Vector3<f32>)> {
    let local = rotate_back(&unit.current.rotation, from);
    let mut best: Option<(f32, Vector3<f32>)> = None;
    for (k, felt) in felt_directions().enumerate() {
        let along = felt / norm(&felt);
        let depth = (number(soft.supports, index * FELT + k) + skin_m) - dot(&along, &local);
        if depth <= 0.0 {
            return None;
        }
        if best.is_none_or(|(least, _)| depth < least) {
            best = Some((depth, along));
        }
    }
    best.map(|(depth, along)| (depth, rotate(&unit.current.rotation, &along)))
}

/// Marks rigid units that are balls, after [`bind`].
pub(crate) fn mark_balls(scene: &mut Scene<'_>) {
    for index in 0..scene.count {
        let Some(unit) = scene.units().get(index).copied().filter(|unit| !unit.is_soft()) else {
            continue;
        };
        let own = slice_at(scene.soft.supports, index * FELT, FELT);
        let is_ball = own.len() == FELT && own.iter().all(|reach| *reach >= BALL * unit.radius);
        if let Some(slot) = scene.units_mut().get_mut(index) {
            slot.is_ball = is_ball;
        }
    }
}

/// Where a rigid unit beside soft ones goes.
fn rigid_state(scene: &Scene<'_>, index: usize, unit: &UnitSlot) -> State {
    let soft = &scene.soft;
    let (centre, velocity) = (vector(soft.rigid, index * 3), vector(soft.rigid, index * 3 + 1));
    let way = (velocity - scene.gravity * (scene.dt * 0.5)) * scene.dt;
    let turn = unit.course.turn();
    let mut next = State { course: unit.course.moving(way, turn), ..unit.state() };
    next.shift(&(centre - unit.current.centre));
    next.turn(&turn);
    next
}

/// Adds what the network says to the points of a copy's soft units: `head` is its output (units, anchors, outputs), `channels` the point
/// network's (points, channels). The number in the copy of a unit of which a point is nowhere then.
fn blend<S: Schedule>(
    schedule: S,
    model: &Model<'_>,
    sizes: &Sizes,
    (scene, copy): (&mut Scene<'_>, usize),
    w: &mut Rows<'_>,
) -> Result<(), usize> {
    let (dt, gravity, scale) = (scene.dt, scene.gravity, model.config().output_scale);
    let Some(net) = &model.blend else { return Ok(()) };
    let outputs = sizes.outputs;
    let (first, units) = copy_of(scene.slots, scene.per_copy, copy);
    let Scene { soft, planes, .. } = scene;
    let soft_units = || (first..).zip(units).filter(|(_, unit)| unit.is_soft());
    for (index, unit) in soft_units() {
        let [mut from, mut to] = [[Vector3::zeros(); ANCHORS]; 2];
        let outs = slice_at(w.head, index * ANCHORS * outputs, ANCHORS * outputs);
        let anchors = from.iter_mut().zip(&mut to).zip(rows(outs, outputs));
        for (k, ((from, to), out)) in anchors.enumerate() {
            *from = vector(soft.after, unit.start + k);
            *to = *from + vector(out, 0) * (scale * dt);
        }
        let turn = kabsch_here(&from, &to, &Matrix3::identity()).pose.rotation;
        let row = slice_at_mut(soft.blends, index * BLEND, BLEND);
        let (rotation, shifts) = row.split_at_mut(9.min(row.len()));
        rotation.iter_mut().zip(turn.iter()).for_each(|(slot, value)| *slot = *value);
        for (k, (from, to)) in from.iter().zip(&to).enumerate() {
            set(shifts, k, &(to - rotate(&turn, from)));
        }
    }
    let reach = model.blend_radius * soft.size_m;
    let softness = 1.0 / (reach * reach);
    let (width, tile) = (sizes.point_width + BLEND_CODE, sizes.tiles.points.max(1));
    for (_, unit) in soft_units() {
        let mut done = 0;
        while done < unit.count {
            let rows_here = tile.min(unit.count - done);
            let inputs = slice_at_mut(w.tile_features, 0, rows_here * width);
            for (k, input) in crate::slices::rows_mut(inputs, width).enumerate() {
                let row = unit.start + done + k;
                let (channels, code) = input.split_at_mut(sizes.point_width.min(input.len()));
                let from = slice_at(w.point_channels, row * sizes.point_width, sizes.point_width);
                crate::slices::copy_slice(from, channels);
                code.fill(0.0);
                let patches = || soft_units().filter(|(_, other)| same_body(other, unit));
                let near = |other: &UnitSlot, anchor: usize| apart(soft, row, other.start + anchor);
                let mut least = f32::INFINITY;
                for (_, other) in patches() {
                    for anchor in 0..ANCHORS {
                        least = least.min(near(other, anchor));
                    }
                }
                let (mut total, mut turn) = (0.0_f32, [0.0_f32; 9]);
                let [mut shift, mut rate] = [Vector3::zeros(); 2];
                for (index, other) in patches() {
                    let blend = slice_at(soft.blends, index * BLEND, BLEND);
                    let (rotation, shifts) = blend.split_at(9.min(blend.len()));
                    for anchor in 0..ANCHORS {
                        let weight = math::exp((least - near(other, anchor)) * softness);
                        total += weight;
                        let place = (index * ANCHORS + anchor) * outputs;
                        let out = slice_at(w.head, place, outputs);
                        let told = slice_at(out, 6, BLEND_CODE);
                        turn.iter_mut().zip(rotation).for_each(|(sum, r)| *sum += weight * r);
                        code.iter_mut().zip(told).for_each(|(sum, c)| *sum += weight * c);
                        shift += vector(shifts, anchor) * weight;
                        rate += vector(out, 1) * weight;
                    }
                }
                let share = 1.0 / total;
                code.iter_mut().for_each(|value| *value *= share);
                let turn = Matrix3::from_column_slice(&turn) * share;
                let x = rotate(&turn, &vector(soft.after, row)) + shift * share;
                let v = vector(soft.velocity, row) + rate * (share * scale);
                // The anchors' own places are not read any more.
                set(soft.before, row, &x);
                set(soft.velocity, row, &v);
            }
            let hidden = slice_at_mut(w.tile_hidden, 0, rows_here * BLEND_HIDDEN);
            let out = slice_at_mut(w.tile_points, 0, rows_here * 6);
            net.apply(schedule, inputs, hidden, out, &mut w.scratch);
            for (k, out) in rows(out, 6).enumerate() {
                let row = unit.start + done + k;
                let x = vector(soft.before, row) + vector(out, 0) * (scale * dt);
                let v = vector(soft.velocity, row) + vector(out, 1) * scale;
                set(soft.before, row, &x);
                set(soft.velocity, row, &v);
            }
            done += rows_here;
        }
    }
    // Points that are one mass go where their mean goes.
    for (_, unit) in soft_units() {
        for row in unit.start..unit.start + unit.count {
            let owner = soft.owner(row);
            let (x, v) = (vector(soft.before, row), vector(soft.velocity, row));
            let (mut sum, mut rates) = (x, v);
            if owner != row {
                sum += vector(soft.after, owner);
                rates += vector(soft.velocity, owner);
            }
            set(soft.after, owner, &sum);
            set(soft.velocity, owner, &rates);
        }
    }
    for (_, unit) in soft_units() {
        for row in unit.start..unit.start + unit.count {
            if soft.owner(row) == row {
                let share = 1.0 / number(soft.masses, row * MASS + 2);
                let (x, v) = (vector(soft.after, row) * share, vector(soft.velocity, row) * share);
                set(soft.after, row, &x);
                set(soft.velocity, row, &v);
            }
        }
    }
    limit_strain(soft, &model.config().elastic, copy);
    for (index, unit) in soft_units() {
        for row in unit.start..unit.start + unit.count {
            let owner = soft.owner(row);
            if owner == row {
                let (mut x, v) = (vector(soft.after, row), vector(soft.velocity, row));
                for (other, rigid) in (first..).zip(units).filter(|(_, u)| !u.is_soft()) {
                    if rigid.is_ball {
                        let from = x - vector(soft.rigid, other * 3);
                        let size = norm(&from).max(TINY_M);
                        let depth = (rigid.radius + model.config().elastic.skin_m) - size;
                        x += from / size * depth.max(0.0);
                    }
                }
                for plane in planes.iter() {
                    let skin = model.config().elastic.skin_m;
                    let depth = (plane.offset_m + skin) - dot(&plane.normal, &x);
                    x += plane.normal * depth.max(0.0);
                }
                set(soft.after, row, &x);
                set(soft.velocity, row, &((v - gravity * (dt * 0.5)) * dt));
            }
            let (x, way) = (vector(soft.after, owner), vector(soft.velocity, owner));
            set(soft.after, row, &x);
            set(soft.velocity, row, &way);
            if !(x - way).iter().chain(x.iter()).all(|c| c.abs() <= MAX_COORDINATE_M) {
                return Err(index - first);
            }
        }
    }
    Ok(())
}

/// Moves the points of a copy's soft units to where [`blend`] left them.
fn commit(scene: &mut Scene<'_>, copy: usize) {
    let first = copy * scene.per_copy;
    for index in first..first + scene.per_copy {
        let Some(unit) = scene.units().get(index).copied().filter(UnitSlot::is_soft) else {
            continue;
        };
        let soft = &mut scene.soft;
        for row in unit.start..unit.start + unit.count {
            let (x, way) = (vector(soft.after, row), vector(soft.velocity, row));
            soft.set_state(row, &way, &x);
        }
        refresh(scene, index);
    }
}
