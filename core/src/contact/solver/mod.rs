//! Rigid motion with contact by sequential impulses (docs/CONTACT.md): what an engine that knows hulls, masses, frictions
//! and restitutions would do in a step. The twin of the lab's `solver`.
//!
//! A step here is a substep of the simulator's step; the solver divides it again, into equal substeps of its own, which fast approaches
//! cut. In each gravity changes velocities, contacts are found, impulses take the approaches that gaps do not allow, units move, fast
//! approaches bounce, and overlaps are pushed apart. All in one order, and in levers from the units' centres, so that
//! nothing is lost far from the origin.

mod apart;
mod bodies;
mod contacts;
mod impulses;
mod meeting;
mod patch;
#[cfg(feature = "terrain")]
mod terrain;
#[cfg(test)]
mod tests;
#[cfg(feature = "robot")]
mod trees;
#[cfg(not(feature = "robot"))]
#[path = "no_trees.rs"]
mod trees;
#[cfg(rigidformer_host)]
mod wide;

use crate::geometry::{State, dot, squared};
use crate::kernels::Schedule;
use crate::scene::{Role, Scene, UnitSlot};
pub(crate) use apart::keep_apart;
pub(crate) use bodies::PRIOR;
use bodies::{Bodies, FAR, TICKS, Touched, World};
use contacts::Contacts;
#[cfg(rigidformer_host)]
use contacts::SLOTS;
use nalgebra::Vector3;
use trees::Trees;

/// Room for contacts, a unit of a copy with so many: the workspace has a size that is known ahead. A copy with M units has M times as many.
pub(crate) const fn contacts_of(units: usize) -> usize {
    // In a heap a box has six neighbours, of five contacts each.
    if units > FEW { 24 } else { 12 }
}

/// Units of a copy, at most, that are too few for a heap in which most have neighbours all around.
const FEW: usize = 32;

/// Numbers of scratch a unit of a copy with so many: itself, its contacts and those of the substep before.
pub(crate) const fn scratch(units: usize) -> usize {
    bodies::BODY + trees::LIMB + contacts_of(units) * (contacts::CONTACT + contacts::OLD)
}

/// And behind those of all units of a copy, for layouts with an index: it lets substeps leave units out, threads share one, and sweeps
/// take many contacts at a time.
pub(crate) const fn extra(units: usize) -> usize {
    let numbers = bodies::BALL + bodies::RANGE + contacts::SLOTS * contacts::SLOT;
    #[cfg(rigidformer_host)]
    let numbers = if units > FEW { numbers + wide::NUMBERS } else { numbers };
    let _ = units;
    numbers
}

const _: () = assert!(
    scratch(FEW) - trees::LIMB <= 465,
    "every unit of every copy pays for the solver's scratch"
);

/// Substeps a second, at least: contacts are found once a substep, so longer ones find them late.
const SUBSTEPS_HZ: f32 = 144.0;
/// Substeps of a step without fast approaches, at most: a bound on its time.
const MOST_SUBSTEPS: u8 = 16;
/// And with them.
const MOST_CUT_SUBSTEPS: u8 = 32;
/// A step may be longer by this share of a substep: 6 / 144 s are six of them in f32 too.
const SLACK: f32 = 0.01;
/// Greater turns of a step are cut, radians: from half a turn on, the way there is shorter the other way round.
const MOST_TURN: f32 = 3.0;
/// Smaller turns of a step commute, radians: what that leaves out is less than f32 do.
const SMALL_TURN: f32 = 3e-4;

/// Where the units of a copy go in a step. `first` is the copy's first unit; `scratch` has as many numbers a unit of
/// the copy as [`scratch`] says, and `prior` [`PRIOR`]:
///
/// - the state after the step, whose way and turn carry velocity and spin at the end of the step,
/// - how much of the network's correction applies, from 0 (the unit rests) to 1 (it touches nothing, or moves briskly).
///
/// Free units that nothing touches go on as [`UnitSlot::free`] says, to the bit.
#[cfg_attr(rigidformer_dsp, inline(never))]
pub(crate) fn solve<S: Schedule>(
    schedule: S,
    scene: &Scene<'_>,
    first: usize,
    (scratch, prior): (&mut [f32], &mut [f32]),
) {
    solve_with(schedule, scene, first, (scratch, prior), true);
}

/// As [`solve`]; hosts leave out what contact cannot reach where it `may_rest`: the same bits.
#[inline]
fn solve_with<S: Schedule>(
    schedule: S,
    scene: &Scene<'_>,
    first: usize,
    (scratch, prior): (&mut [f32], &mut [f32]),
    may_rest: bool,
) {
    let world = World::new(scene, first, substeps(scene.dt));
    // What hangs from something wakes with it.
    let may_rest = may_rest && !world.has_trees();
    let (mut bodies, mut contacts, mut trees) = carve(scratch, prior, world.units);
    let is_done = in_substeps(schedule, &world, (&mut bodies, &mut contacts, &mut trees), may_rest);
    #[cfg(rigidformer_host)]
    if !is_done {
        // Contact sent a unit out of its range: nothing is certain to stay as it is.
        contacts.clear();
        in_substeps(schedule, &world, (&mut bodies, &mut contacts, &mut trees), false);
    }
    #[cfg(not(rigidformer_host))]
    let _ = is_done;
    // The last one first: the motion of a cluster is in the row of its first unit.
    for (number, unit) in world.units.iter().enumerate().rev() {
        let (next, share) = outcome(scene, &world, (&bodies, &trees), (number, unit));
        bodies.tell(number, &next, share);
    }
}

/// Says of each unit of a copy whether it stays as it is until something changes. `prior` and `scratch` are as [`solve`] left them, and the
/// units that the step has left as they were are those with a number of contacts.
#[cfg(rigidformer_host)]
pub(crate) fn mark_still(units: &mut [UnitSlot], prior: &[f32], scratch: &mut [f32]) {
    let rests = prior.chunks_exact(PRIOR).map(|row| row.last().is_some_and(|share| *share < 0.0));
    let before = units.len() * (self::scratch(units.len()) + bodies::BALL);
    let ranges = scratch.get_mut(before..).unwrap_or_default().as_chunks_mut().0;
    bodies::mark_still(units, rests, ranges);
}

/// Takes all substeps of a step. Hosts leave out what contact cannot reach, where it `may_rest`; false where that was wrong. What is
/// found is then of no use.
#[cfg_attr(rigidformer_dsp, inline(always))]
fn in_substeps<S: Schedule>(
    schedule: S,
    world: &World<'_>,
    (bodies, contacts, trees): (&mut Bodies<'_>, &mut Contacts<'_>, &mut Trees<'_>),
    may_rest: bool,
) -> bool {
    bodies.begin(world);
    trees.begin(world, bodies);
    #[cfg(rigidformer_host)]
    let left_out = bodies.range(world, meeting::FACE, may_rest);
    #[cfg(not(rigidformer_host))]
    let _ = may_rest;
    let step = world;
    let (mut left, mut taken, mut before) = (TICKS * u16::from(step.substeps), 0, TICKS);
    while left > 0 {
        let mut part = step.part(left.min(TICKS));
        let world = &part;
        bodies.begin_substep(world);
        #[cfg(rigidformer_host)]
        {
            bodies.enclose(world, meeting::FACE);
            if !bodies.are_in_range() {
                // Some units were left out on the word of ranges that do not hold.
                if left_out.is_some() {
                    return false;
                }
                bodies.unbound_ranges();
            }
        }
        contacts.find(schedule, world, bodies);
        let most = MOST_CUT_SUBSTEPS.max(if world.has_trees() { 2 * step.substeps } else { 0 });
        let least = left.div_ceil(u16::from(most.saturating_sub(taken).max(1)));
        let ticks = impulses::ticks(world, bodies, contacts).max(least);
        if ticks < world.ticks {
            // What rests does so in steps that are not cut.
            #[cfg(rigidformer_host)]
            if bodies.leaves_still() {
                return false;
            }
            let whole = world.substep_s;
            part = step.part(ticks);
            bodies.shorten(&part, whole - part.substep_s);
            impulses::shorten(&part, bodies, contacts, whole - part.substep_s);
        }
        let world = &part;
        #[cfg(rigidformer_host)]
        {
            // With those of what stays they must have room, or others would be left out.
            let room = contacts.room();
            if left_out.is_some_and(|still| contacts.rows().len() + still > room) {
                return false;
            }
            if contacts.rows().len() == room {
                bodies.unbound_ranges();
            }
            bodies.count(contacts.rows().iter().map(|row| contacts::Contact::read(row).to));
        }
        impulses::warm_start(world, bodies, contacts, before);
        before = world.ticks;
        impulses::rank(world, bodies, contacts);
        if taken == 0 {
            bodies.hold(world);
            if !world.gives_way() {
                impulses::carry(world, bodies, contacts);
            }
        }
        // What gives way moves at the mean of the velocities before and after.
        if !world.gives_way() {
            bodies.forget();
        }
        trees.choose(world, bodies, step.seconds(left));
        impulses::stop(schedule, world, (bodies, trees), contacts);
        let bounces = impulses::mark(world, bodies, contacts);
        bodies.advance(world, |unit| trees.moves(unit));
        trees.advance(world, bodies);
        if bounces {
            impulses::bounce(schedule, world, (bodies, trees), contacts);
        }
        impulses::push_apart(world, bodies, contacts);
        trees.finish(world, bodies);
        left = left.saturating_sub(world.ticks);
        taken = taken.saturating_add(1);
    }
    #[cfg(rigidformer_host)]
    bodies.end(if taken == step.substeps { taken } else { 0 });
    true
}

/// The units and contacts of a copy in its scratch, and the units' motion in the rows of its result; there it may be left out.
#[cfg_attr(rigidformer_dsp, inline(always))]
fn carve<'r>(
    scratch: &'r mut [f32],
    prior: &'r mut [f32],
    units: &'r [UnitSlot],
) -> (Bodies<'r>, Contacts<'r>, Trees<'r>) {
    let count = units.len();
    let (own, others) = scratch.split_at_mut((count * bodies::BODY).min(scratch.len()));
    let (limbs, others) = others.split_at_mut((count * trees::LIMB).min(others.len()));
    let trees = Trees::new(limbs, count);
    let bodies = Bodies::new(own, prior, units);
    #[cfg(rigidformer_host)]
    {
        let room = count * (self::scratch(count) - bodies::BODY - trees::LIMB);
        let (others, mut extra) = others.split_at_mut(room.min(others.len()));
        let bodies = bodies.with_ranges(&mut extra);
        let contacts = Contacts::new(others, contacts_of(count) * count);
        (bodies, contacts.with_slots(extra, SLOTS * count), trees)
    }
    #[cfg(not(rigidformer_host))]
    (bodies, Contacts::new(others, contacts_of(count) * count), trees)
}

/// Parts that a step is taken in, at least.
fn substeps(dt: f32) -> u8 {
    let mut substeps = 1;
    while substeps < MOST_SUBSTEPS && f32::from(substeps) < dt * SUBSTEPS_HZ - SLACK {
        substeps += 1;
    }
    substeps
}

/// The numbers of a unit's row.
#[cfg_attr(rigidformer_dsp, inline(never))]
fn outcome(
    scene: &Scene<'_>,
    world: &World<'_>,
    (bodies, trees): (&Bodies<'_>, &Trees<'_>),
    (number, unit): (usize, &UnitSlot),
) -> (State, f32) {
    match unit.role {
        Role::Driven => return (unit.driven(), 0.0),
        Role::Fixed => return (unit.resting(), 0.0),
        Role::Free => {}
    }
    if let Some(cluster_root) = unit.cluster_root() {
        return outcome_together(scene, world, bodies, (number, unit, cluster_root));
    }
    let (marks, mut mover) = (bodies.marks(number), bodies.mover(number));
    #[cfg(rigidformer_host)]
    if bodies.is_still(number) {
        return (world.lying(unit), -1.0);
    }
    if trees.moves(number) {
        // The network has seen no joints: it corrects what contact changes, and what touches nothing flies by impulses alone.
        let touched = marks.touched != Touched::Never;
        let share = if touched { world.share(unit, &mover, None) } else { 0.0 };
        cut(&mut mover, scene.dt);
        return (moved(world, bodies, (number, unit), &mover), share);
    }
    if marks.touched == Touched::Never {
        return (unit.free(&scene.fall()), 0.0);
    }
    let (rest, speed) = (world.rest(unit), mover.speed(unit.radius));
    if marks.level < FAR
        && marks.speed < rest
        && speed < rest
        && stays(world, bodies, (number, unit.radius))
    {
        return (world.lying(unit), -1.0);
    }
    let share = world.share(unit, &mover, None);
    cut(&mut mover, scene.dt);
    (moved(world, bodies, (number, unit), &mover), share)
}

/// As [`outcome`], of a unit in a cluster. What is in one flies freely about its centre of mass alone, so that the solver's own
/// pose counts there too.
#[cfg_attr(rigidformer_dsp, inline(never))]
fn outcome_together(
    scene: &Scene<'_>,
    world: &World<'_>,
    bodies: &Bodies<'_>,
    (number, unit, cluster_root): (usize, &UnitSlot, usize),
) -> (State, f32) {
    let (marks, mut mover) = (bodies.marks(number), bodies.mover(number));
    let cluster = bodies.cluster(world, cluster_root);
    let arm = bodies.pose(number).centre - cluster.centre;
    let touched = marks.touched != Touched::Never;
    let (rest, speed) = (world.rest(unit), mover.speed(cluster.radius));
    let is_slow = marks.speed < rest && speed < rest;
    if touched
        && marks.level < FAR
        && is_slow
        && stays(world, bodies, (cluster_root, cluster.radius))
    {
        return (world.lying(unit), -1.0);
    }
    let share = if touched { world.share(unit, &mover, Some(&arm)) } else { 0.0 };
    cut(&mut mover, scene.dt);
    (moved(world, bodies, (number, unit), &mover.at(&arm)), share)
}

/// Whether a slow unit is where it was. What is pushed out of something else is slow too, and goes.
#[cfg_attr(rigidformer_dsp, inline(never))]
fn stays(world: &World<'_>, bodies: &Bodies<'_>, (number, radius): (usize, f32)) -> bool {
    let [way, turn] = bodies.moved(number);
    let (skin, arm) = (world.skin(radius), turn * radius);
    dot(&way, &way) + dot(&arm, &arm) <= skin * skin
}

/// Where the solver has taken a unit that moves so at the end.
#[cfg_attr(rigidformer_dsp, inline(never))]
fn moved(
    world: &World<'_>,
    bodies: &Bodies<'_>,
    (number, unit): (usize, &UnitSlot),
    mover: &bodies::Mover,
) -> State {
    let [way, turn] = bodies.moved(number);
    let mut next = unit.state();
    next.shift(&way);
    // Small turns add up, and keep the digits that a matrix rounds off.
    if turn.amax() < SMALL_TURN {
        next.turn(&turn);
    } else {
        next.pose.rotation = squared(&bodies.pose(number).rotation);
        next.course.turn_low = Vector3::zeros();
    }
    let [way, turn] = world.motion(mover);
    State { course: next.course.moving(way, turn), ..next }
}

/// Cuts a spin beyond [`MOST_TURN`] a step.
fn cut(mover: &mut bodies::Mover, dt: f32) {
    let turn = crate::geometry::norm(&mover.spin) * dt;
    if turn > MOST_TURN {
        mover.spin *= MOST_TURN / turn;
    }
}
