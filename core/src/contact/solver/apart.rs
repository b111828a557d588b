//! Units that overlap at the end of a step. What a network corrects after impulses may overlap, and so may turns that a
//! substep takes to the first order.

use super::bodies::{Touched, World};
use super::contacts::{Contact, Held, between};
use super::meeting::{Meeting, gap_along, meeting};
use super::{carve, contacts_of};
use crate::contact::ground::Plane;
use crate::geometry::{Hull, Pose, STATE, State, dot, rotate_back};
use crate::limits::MAX_PIECES;
use crate::scene::{Scene, UnitSlot, members};
use nalgebra::Vector3;

/// Sweeps over all pairs: in stacks a push into the next unit needs another sweep.
const KEEPS: u8 = 4;
/// Of an overlap this much is left, in radii of the smaller unit: units that rest on each other go on touching.
const SLACK: f32 = 0.0002;

/// The state that a unit goes to.
type Next = [f32; STATE];

/// Moves units apart where they overlap, without turning them, from what does not move on. `scratch` is what
/// [`solve`](super::solve) has left there; `next` has the states that the units of the copy go to,
/// (units, [`STATE`]).
#[cfg_attr(rigidformer_dsp, inline(never))]
pub(crate) fn keep_apart(scene: &Scene<'_>, first: usize, scratch: &mut [f32], next: &mut [f32]) {
    let world = World::new(scene, first, 1);
    let units = world.units.len();
    let (mut bodies, mut contacts, _) = carve(scratch, &mut [], world.units);
    let (next, _) = next.as_chunks_mut();
    // At first all are looked at, then what the sweep before has moved.
    bodies.mark_all(|_| Touched::Before);
    for _ in 0..KEEPS {
        let mut place = None;
        let mut moves = false;
        for rank in 0..contacts_of(units) * units {
            let Some(contact) = contacts.ordered(rank).map(|row| Contact::read(row)) else { break };
            // The contacts of two pieces follow each other.
            let Some(from) = contact.from.filter(|_| place != Some(contact.place())) else {
                continue;
            };
            if contact.gives_way() {
                continue;
            }
            place = Some(contact.place());
            let moved = |unit| bodies.marks(unit).touched != Touched::Never;
            if !(moved(from) || moved(contact.to)) {
                continue;
            }
            let Some(ways) = ways_out(&world, (from, &contact), next) else { continue };
            for (number, way) in [from, contact.to].into_iter().zip(ways) {
                if way.amax() > 0.0 {
                    shift(&world, number, &way, next);
                    bodies.touch(number);
                    moves = true;
                }
            }
        }
        if !moves {
            break;
        }
        bodies.mark_all(|touched| match touched {
            Touched::Now => Touched::Before,
            _ => Touched::Never,
        });
    }
}

/// Ways that take the units of a contact out of each other; none where they do not overlap, or nothing moves them.
#[cfg_attr(rigidformer_dsp, inline(never))]
fn ways_out(
    world: &World<'_>,
    (from, contact): (usize, &Contact),
    next: &[Next],
) -> Option<[Vector3<f32>; 2]> {
    let numbers = [from, contact.to];
    let [Some(mine), Some(theirs)] = numbers.map(|number| world.units.get(number)) else {
        return None;
    };
    let [Some(here), Some(there)] = numbers.map(|number| next.get(number).map(pose)) else {
        return None;
    };
    let light = [
        if contact.held == Held::From { 0.0 } else { world.lightness(mine) },
        if contact.held == Held::To { 0.0 } else { world.lightness(theirs) },
    ];
    let [light_from, light_to] = light;
    let soft = light_from + light_to;
    let small = mine.radius.min(theirs.radius);
    let (a, b) = (contact.piece / MAX_PIECES, contact.piece % MAX_PIECES);
    let pieces = [world.piece(mine, a), world.piece(theirs, b)];
    let poses = [here, there];
    let between = between(&pieces, &poses);
    let ([a, b], [here, there]) = (pieces, poses);
    let hulls = [
        &Hull { points: a.points, rotation: here.rotation },
        &Hull { points: b.points, rotation: there.rotation },
    ];
    let rounds = [mine, theirs].map(|unit| world.round(unit));
    let apart = there.centre - here.centre;
    let slack = SLACK * small;
    // Along the normal of the contact first: what is apart there is apart.
    if soft <= 0.0 || gap_along(hulls, rounds, &apart, &contact.normal) >= -slack {
        return None;
    }
    // What is apart is of no interest here.
    let sizes = [small, mine.radius + theirs.radius, 0.0];
    let Meeting { gap, normal, .. } =
        meeting(hulls, rounds, (&apart, &between, Some(contact.normal)), sizes);
    let depth = -slack - gap;
    let way = normal * (depth / soft);
    (depth > 0.0).then(|| [way * -light_from, way * light_to])
}

/// Moves a unit, and then out of planes; out of other ground the next step pushes it. That is no velocity.
#[cfg_attr(rigidformer_dsp, inline(never))]
fn shift(world: &World<'_>, number: usize, way: &Vector3<f32>, next: &mut [Next]) {
    let (Some(unit), Some(row)) = (world.units.get(number), next.get_mut(number)) else { return };
    if let Some(cluster_root) = unit.cluster_root() {
        return shift_together(world, cluster_root, way, next);
    }
    let mut now = State::read(row);
    now.shift(way);
    for (number, plane) in world.planes().iter().enumerate() {
        let low = lowest(world, unit, (number, plane), &now.pose);
        if low < 0.0 {
            now.shift(&(plane.normal * -low));
        }
    }
    now.write(row);
}

/// As [`shift`], of a cluster: out of each plane as far as the deepest of its units has to go.
#[cfg_attr(rigidformer_dsp, inline(never))]
fn shift_together(world: &World<'_>, cluster_root: usize, way: &Vector3<f32>, next: &mut [Next]) {
    let move_all = |way: &Vector3<f32>, next: &mut [Next]| {
        for (number, _) in members(world.units, cluster_root) {
            let Some(row) = next.get_mut(number) else { continue };
            let mut state = State::read(row);
            state.shift(way);
            state.write(row);
        }
    };
    move_all(way, next);
    for plane in world.planes().iter().enumerate() {
        let deepest = |low: f32, (number, unit): (usize, &UnitSlot)| {
            next.get(number).map_or(low, |row| low.min(lowest(world, unit, plane, &pose(row))))
        };
        let low = members(world.units, cluster_root).fold(0.0, deepest);
        if low < 0.0 {
            move_all(&(plane.1.normal * -low), next);
        }
    }
}

/// Height of the lowest point of a unit over a plane where it is below that, else 0, metres.
fn lowest(
    world: &World<'_>,
    unit: &UnitSlot,
    (number, plane): (usize, &Plane),
    pose: &Pose,
) -> f32 {
    let height = plane.height_here(&pose.centre);
    if height > unit.radius || world.gives_way_on(unit, number) {
        return 0.0;
    }
    let (local, height) = (rotate_back(&pose.rotation, &plane.normal), height - world.round(unit));
    let lowest =
        |low: f32, point: &nalgebra::Point3<f32>| low.min(dot(&point.coords, &local) + height);
    world.hull_of(unit).iter().fold(0.0, lowest)
}

/// The pose of a row.
fn pose(row: &Next) -> Pose {
    crate::geometry::read_pose(row)
}
