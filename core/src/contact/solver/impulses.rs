//! Impulses at contacts, one after the other.

use super::bodies::{Bodies, FAR, Mover, World};
use super::contacts::{CONTACT, Contact, Contacts, Held, Old};
use super::trees::Trees;
#[cfg(rigidformer_host)]
use super::wide;
use crate::geometry::{dot, norm, opposite};
#[cfg(rigidformer_host)]
use crate::kernels::Kernels;
use crate::kernels::{Goal, Schedule};
use crate::math;
use nalgebra::Vector3;

/// Sweeps over all contacts in a step, of all substeps together, but for those that are cut.
const SWEEPS: u8 = 18;
/// Sweeps of a substep, at least: with fewer, impulses do not get through a stack.
const LEAST_SWEEPS: u8 = 4;
/// Sweeps after those, upwards from what does not move, each lower unit held: they carry what sweeps to and fro leave.
const SETTLING: u8 = 1;
/// Sweeps in which contacts bounce: a bounce passes through as many units.
const BOUNCING: u8 = 8;
/// Sweeps of a substep that push overlaps apart: the next substep goes on from there.
const PUSHES: u8 = 1;
/// A contact this close to one of the substep before goes on from its impulse, in radii: it is the same one, moved.
const SAME_CONTACT: f32 = 0.1;
/// Cosine of 45 degrees, within which its normal must be. At an inner corner two pieces push two ways at one place.
const SAME_WAY: f32 = 0.7;
/// Gaps up to this hold what is above them, in what units keep between them: resting contacts keep one of it.
const HOLDS: f32 = 2.0;
/// Ways of a substep, at most, of what closes in fast and touches, in radii of the smaller unit.
const WAY: f32 = 1.0 / 32.0;
/// Levels from what does not move that are told apart: sweeps go upwards by them, and higher stacks share the last.
const LEVELS: u8 = 8;

/// The units of a contact, the first one still for a plane.
#[inline]
fn movers(bodies: &Bodies<'_>, contact: &Contact) -> [Mover; 2] {
    let from = contact.from.map_or(Mover::STILL, |from| bodies.mover(from));
    [from, bodies.mover(contact.to)]
}

/// Radius of the smaller unit, metres; 0 for a plane, which keeps no distance.
fn radius(world: &World<'_>, contact: &Contact) -> f32 {
    let radius = |unit: usize| world.units.get(unit).map_or(0.0, |unit| unit.radius);
    contact.from.map_or(0.0, |from| radius(from).min(radius(contact.to)))
}

/// As [`radius`], with that of a unit on a plane.
fn radius_of(world: &World<'_>, contact: &Contact) -> f32 {
    match contact.from {
        Some(_) => radius(world, contact),
        None => world.units.get(contact.to).map_or(0.0, |unit| unit.radius),
    }
}

/// How fast a contact's units close in along its normal, m/s, and the smaller radius, metres.
#[cfg_attr(rigidformer_dsp, inline(never))]
fn approach(world: &World<'_>, bodies: &Bodies<'_>, contact: &Contact) -> (f32, f32) {
    let [own, other] = &contact.arms;
    let mut leaving = bodies.speed_at(contact.to, other);
    if let Some(from) = contact.from {
        leaving -= bodies.speed_at(from, own);
    }
    (-dot(&leaving, &contact.normal), radius_of(world, contact))
}

/// Ticks until the first of the fast approaches touches, or is [`WAY`] further: where contacts are and when they bounce is known to a
/// substep.
#[cfg_attr(rigidformer_dsp, inline(never))]
pub(super) fn ticks(world: &World<'_>, bodies: &Bodies<'_>, contacts: &Contacts<'_>) -> u16 {
    let mut share = 1.0;
    if world.gives_way() {
        return world.ticks;
    }
    for row in contacts.rows() {
        let contact = Contact::load(row);
        let (closing, small) = approach(world, bodies, &contact);
        if closing <= world.bounces(small) {
            continue;
        }
        let (gap, near) = (positive(contact.gap), WAY * small);
        let way = if gap > near { gap - 0.5 * near } else { gap + 0.5 * near };
        if way < share * closing * world.substep_s {
            share = way / (closing * world.substep_s);
        }
    }
    // At most all.
    ((share * f32::from(world.ticks)) as u16).max(1)
}

/// Rebounds are of approaches that gravity has sped up for all of the substep: takes that back where it is cut.
#[cfg_attr(rigidformer_dsp, inline(never))]
pub(super) fn shorten(
    world: &World<'_>,
    bodies: &Bodies<'_>,
    contacts: &mut Contacts<'_>,
    by_s: f32,
) {
    let falls = |unit: usize| world.units.get(unit).is_some_and(|unit| unit.is_free());
    let (rows, _) = contacts.both();
    for row in rows {
        let mut contact = Contact::load(row);
        if contact.rebound <= 0.0 {
            continue;
        }
        let (closing, _) = approach(world, bodies, &contact);
        let pull = dot(&world.scene.gravity, &contact.normal) * by_s;
        let mut before = closing;
        if falls(contact.to) {
            before -= pull;
        }
        if contact.from.is_some_and(falls) {
            before += pull;
        }
        contact.rebound *= if before > 0.0 { positive(closing) / before } else { 0.0 };
        contact.write(row);
    }
}

/// Contacts that were there in the substep before begin with their impulses. Of several that are close enough the closest
/// one counts, and each counts once.
#[cfg_attr(rigidformer_dsp, inline(never))]
pub(super) fn warm_start(
    world: &World<'_>,
    bodies: &mut Bodies<'_>,
    contacts: &mut Contacts<'_>,
    before: u16,
) {
    // What rests has impulses as long as substeps; what has hit has none in the next.
    let share = f32::from(world.ticks.min(before)) / f32::from(before);
    let (rows, olds) = contacts.both();
    // Both lists have their pairs in one order.
    let mut first = 0;
    for row in rows {
        let mut contact = Contact::read(row);
        let radius = world.units.get(contact.to).map_or(0.0, |unit| unit.radius);
        let mut nearest = SAME_CONTACT * radius;
        let mut found = None;
        for (number, row) in (first..).zip(olds.iter().skip(first)) {
            let old = Old::read(row);
            // Pairs ascend: behind this one there are none of the contact's.
            if old.pair > contact.pair() {
                break;
            }
            if old.pair < contact.pair() {
                first += 1;
            } else if old.along > 0.0 && dot(&old.normal, &contact.normal) > SAME_WAY {
                let [_, arm] = contact.arms;
                let distance = norm(&(old.arm - arm));
                if distance < nearest {
                    nearest = distance;
                    found = Some((number, old));
                }
            }
        }
        let Some((number, old)) = found else { continue };
        // An impulse that two contacts begin with would act twice.
        if let Some([taken, ..]) = olds.get_mut(number) {
            *taken = 0.0;
        }
        let [n, t, b] = contact.axes();
        // Along the old normal is the impulse of its twist.
        let (along, rub) = (old.along * share, old.rub * share);
        let twist = dot(&rub, &old.normal);
        let rub = rub - old.normal * twist;
        let [across, aside] = [dot(&rub, &t), dot(&rub, &b)];
        contact.impulse = [along, across, aside];
        Contact::write_impulse(&contact.impulse, row);
        let impulse = (n * along + t * across) + b * aside;
        let [mut from, mut to] = movers(bodies, &contact);
        let [own, other] = &contact.arms;
        to.apply_impulse(other, &impulse);
        from.apply_impulse(own, &opposite(&impulse));
        if let Some([arm, ..]) = contact.twist() {
            Contact::write_twist(twist, row);
            let whirl = n * (twist * arm);
            to.twist(&whirl);
            from.twist(&opposite(&whirl));
        }
        keep(bodies, &contact, &[from, to]);
    }
}

/// Keeps the velocities and spins of a contact's units.
#[inline]
fn keep(bodies: &mut Bodies<'_>, contact: &Contact, [from, to]: &[Mover; 2]) {
    if let Some(number) = contact.from {
        bodies.moves(number, from);
    }
    bodies.moves(contact.to, to);
}

/// Finds how many contacts a unit is from one that does not move, which unit of each contact is held, and the order of
/// contacts from there on. The contacts of the substep before give their place to that order.
#[cfg_attr(rigidformer_dsp, inline(never))]
pub(super) fn rank(world: &World<'_>, bodies: &mut Bodies<'_>, contacts: &mut Contacts<'_>) {
    let below = |bodies: &Bodies<'_>, contact: &Contact| {
        contact.from.map_or(0.0, |from| bodies.marks(from).level)
    };
    for _ in 0..LEVELS {
        let mut settled = true;
        for row in contacts.rows() {
            let contact = Contact::read(row);
            let small = radius(world, &contact);
            let skin = world.skin(small);
            // A plane has no radius to measure its gap in.
            let holds = if contact.from.is_none() {
                world.units.get(contact.to).map_or(0.0, |unit| world.skin(unit.radius))
            } else {
                skin
            };
            // What is this far apart carries nothing.
            if contact.gap + skin > HOLDS * holds {
                continue;
            }
            let (lower, upper) = (below(bodies, &contact), bodies.marks(contact.to).level);
            let level = upper.min(lower + 1.0);
            if level < upper {
                bodies.set_level(contact.to, level);
                settled = false;
            }
            if let Some(from) = contact.from.filter(|_| level + 1.0 < lower) {
                bodies.set_level(from, level + 1.0);
                settled = false;
            }
        }
        // Another round would find the same levels.
        if settled {
            break;
        }
    }
    let (rows, orders) = contacts.ranked();
    for (row, order) in rows.iter_mut().zip(orders) {
        let contact = Contact::read(row);
        let (below, above) = (below(bodies, &contact), bodies.marks(contact.to).level);
        let [_, _, level, ..] = order;
        *level = below.min(above);
        let held = if below < above {
            Held::From
        } else if below > above {
            Held::To
        } else {
            Held::Neither
        };
        Contact { held, stiffness: stiffness(bodies, &contact, held), ..contact }.write_held(row);
    }
    let (count, mut rank) = (contacts.rows().len(), 0);
    for step in 0..=LEVELS + 1 {
        let step = f32::from(step);
        let last = step > f32::from(LEVELS);
        for number in 0..count {
            let lower = contacts.level(number);
            // Whatever is above the last level that is told apart comes in the end.
            if lower == step || (last && lower > step) {
                contacts.set_order(rank, number);
                rank += 1;
            }
        }
        if rank == count {
            break;
        }
    }
    contacts.end_order(count);
    contacts.middles_first();
}

/// Weight of a contact along its normal with the held unit held, in weights.
fn stiffness(bodies: &Bodies<'_>, contact: &Contact, held: Held) -> f32 {
    if contact.gives_way() {
        return contact.stiffness;
    }
    // With neither held, or on a plane, the weight is that of all sweeps.
    if contact.from.is_none() || held == Held::Neither {
        return 1.0;
    }
    let ([from, to], [own, other]) = (movers(bodies, contact), contact.arms);
    let [from, to] =
        [from.inverse_mass_at(&own, &contact.normal), to.inverse_mass_at(&other, &contact.normal)];
    let moves = if held == Held::From { to } else { from };
    if moves > 0.0 { (from + to) / moves } else { 1.0 }
}

/// Lets each unit carry what is above it, downwards, as if what is below moved as before the substep: what rests on patches does so
/// after one sweep. A step remembers no impulses of the one before.
#[cfg_attr(rigidformer_dsp, inline(never))]
pub(super) fn carry(world: &World<'_>, bodies: &mut Bodies<'_>, contacts: &mut Contacts<'_>) {
    contacts.rest_on_nothing(world.units.len());
    for is_counting in [true, false] {
        for place in (0..contacts.middles()).rev() {
            let Some(contact) = contacts.swept(place).map(|row| Contact::load(row)) else {
                continue;
            };
            let (upper, lower) = match contact.held {
                Held::From => (contact.to, contact.from),
                Held::To => (contact.from.unwrap_or(contact.to), Some(contact.to)),
                Held::Neither => continue,
            };
            let still = lower.map_or(Vector3::zeros(), |lower| bodies.shifted(lower).velocity);
            let n = if contact.held == Held::To { -contact.normal } else { contact.normal };
            let (root, closing) =
                (bodies.root_of(upper), dot(&(still - bodies.shifted(upper).velocity), &n));
            // What hits it is not carried.
            if closing > world.bounces(radius_of(world, &contact)) {
                continue;
            }
            if is_counting {
                contacts.rest_on(root, 1.0);
                continue;
            }
            let share = 1.0 / contacts.rests_on(root);
            contacts.rest_on(root, -1.0);
            let [own, other] = &contact.arms;
            let [mut from, mut to] = movers(bodies, &contact);
            let mover = bodies.mover(upper);
            let leaving = dot(&(mover.velocity - still), &n);
            let wanted = -(positive(contact.gap) / world.substep_s);
            let along = positive((wanted - leaving) * share / mover.lightness);
            let push = contact.normal * along;
            to.apply_impulse(other, &push);
            from.apply_impulse(own, &opposite(&push));
            keep(bodies, &contact, &[from, to]);
            if let Some(row) = contacts.swept(place) {
                Contact::write_impulse(&[along, 0.0, 0.0], row);
            }
        }
    }
}

/// Takes the approaches that gaps do not allow, and lets friction act.
#[cfg_attr(rigidformer_dsp, inline(never))]
pub(super) fn stop<S: Schedule>(
    schedule: S,
    world: &World<'_>,
    (bodies, trees): (&mut Bodies<'_>, &mut Trees<'_>),
    contacts: &mut Contacts<'_>,
) {
    #[cfg(rigidformer_host)]
    if S::Kernels::SWEEPS {
        wide::pack(world, bodies, contacts);
    }
    // What has a spring takes no part in settling.
    let more = if world.gives_way() { SETTLING } else { 0 };
    let sweeps = (SWEEPS / world.substeps.max(1)).max(LEAST_SWEEPS) + more;
    for turn in 0..sweeps {
        // To and fro: an order of contacts would favour what comes last.
        if !sweep(schedule, world, bodies, contacts, (Goal::Stop, turn % 2 == 1)) {
            break;
        }
        trees.follow(world, bodies, false);
    }
    for _ in 0..world.share_of(SETTLING) {
        if !sweep(schedule, world, bodies, contacts, (Goal::Settle, true)) {
            break;
        }
        trees.follow(world, bodies, false);
    }
    #[cfg(rigidformer_host)]
    wide::unpack(contacts);
}

/// Lets contacts bounce that have an impulse.
#[cfg_attr(rigidformer_dsp, inline(never))]
pub(super) fn bounce<S: Schedule>(
    schedule: S,
    world: &World<'_>,
    (bodies, trees): (&mut Bodies<'_>, &mut Trees<'_>),
    contacts: &mut Contacts<'_>,
) {
    for turn in 0..BOUNCING {
        if !sweep(schedule, world, bodies, contacts, (Goal::Bounce, turn % 2 == 1)) {
            break;
        }
        trees.follow(world, bodies, true);
    }
    #[cfg(rigidformer_host)]
    wide::unpack(contacts);
}

/// One impulse at each contact, upwards or downwards. Whether any contact had one: where none has, the next sweep has none
/// either.
#[cfg_attr(rigidformer_dsp, inline(never))]
fn sweep<S: Schedule>(
    schedule: S,
    world: &World<'_>,
    bodies: &mut Bodies<'_>,
    contacts: &mut Contacts<'_>,
    (goal, upwards): (Goal, bool),
) -> bool {
    #[cfg(rigidformer_host)]
    if let Some([middles, corners]) = contacts.packed() {
        let (kernels, motions) = (schedule.kernels(), bodies.motions());
        let acts = kernels.sweep(middles, motions, (goal, upwards));
        return kernels.sweep(corners, motions, (goal, upwards)) | acts;
    }
    #[cfg(not(rigidformer_host))]
    let _ = schedule;
    let (count, middles) = (contacts.rows().len(), contacts.middles());
    let mut acts = false;
    // The middles of patches first: they carry the load without turning anything.
    for (start, end) in [(0, middles), (middles, count)] {
        for place in start..end {
            let place = if upwards { place } else { start + (end - 1 - place) };
            let Some(row) = contacts.swept(place) else { continue };
            let aim = (goal, world.substep_s);
            acts |= if Contact::is_on_plane(row) {
                resolve_on_plane(bodies, row, aim)
            } else {
                resolve(bodies, row, aim)
            };
        }
    }
    acts
}

/// The impulse along the normal that takes the approach; `leaving` is how fast the second unit leaves the first one there.
/// None: the contact has no impulse, and gets none.
#[inline]
fn normal_impulse(
    contact: &Contact,
    leaving: &Vector3<f32>,
    heavy: f32,
    (goal, substep_s): (Goal, f32),
) -> Option<f32> {
    let [before, across, aside] = contact.impulse;
    if contact.gives_way() {
        return spring_impulse(contact, dot(leaving, &contact.normal), heavy, goal);
    }
    let wanted = match goal {
        Goal::Bounce => contact.rebound,
        _ => contact.wanted(substep_s),
    };
    let along = positive(before + (wanted - dot(leaving, &contact.normal)) * heavy);
    // None of them is negative.
    ((along + before) + (across.abs() + aside.abs()) > 0.0).then_some(along)
}

/// As [`normal_impulse`], of a contact that gives way: what its spring and damper give with the speed at the end of the substep.
#[inline]
fn spring_impulse(contact: &Contact, speed: f32, heavy: f32, goal: Goal) -> Option<f32> {
    let [before, across, aside] = contact.impulse;
    // What has a spring bounces by it.
    if goal != Goal::Stop {
        return None;
    }
    let slope = -contact.rebound;
    let missing = (contact.stiffness - slope * speed) - before;
    let along = positive(before + missing * (heavy / (heavy + slope)));
    ((along + before) + (across.abs() + aside.abs()) > 0.0).then_some(along)
}

/// A number, or 0 if it is below: `max` is a call on processors without an instruction for it.
#[inline]
fn positive(number: f32) -> f32 {
    if number > 0.0 { number } else { 0.0 }
}

/// Impulses of friction along both tangents, and of a twist at its arm, within what an impulse along the normal allows.
#[inline]
fn limited([p, q, r]: [f32; 3], friction: f32, along: f32) -> [f32; 3] {
    // A pyramid's directions have a limit each.
    if friction < 0.0 {
        let most = -friction * along;
        let within = |impulse: f32| {
            if impulse > most {
                most
            } else if impulse < -most {
                -most
            } else {
                impulse
            }
        };
        return [within(p), within(q), within(r)];
    }
    // Coulomb's cone, round: all directions share one limit, and so does a twist at its arm.
    let (most, size) = (friction * along, math::sqrt((p * p + q * q) + r * r));
    let share = if size > most { most / size } else { 1.0 };
    [p * share, q * share, r * share]
}

/// Lets friction act within what `along` allows: against sliding, and at the middle of a patch against a spin about the normal too. The
/// first unit is [`Mover::STILL`] for a plane.
#[inline]
fn rub(contact: &Contact, along: f32, [from, to]: [&mut Mover; 2], row: &mut [f32; CONTACT]) {
    let ([n, t, b], [_, across, aside]) = (contact.axes(), contact.impulse);
    let ([own, other], [_, heavy_across, heavy_aside]) = (&contact.arms, contact.weight);
    let [arm, twist, heavy] = contact.twist().unwrap_or_default();
    let (mut r, mut sliding) = (0.0, to.speed_at(other) - from.speed_at(own));
    if contact.is_middle {
        r = twist - dot(&(to.spin - from.spin), &n) * arm * heavy;
        // As if the spin were braked: all three at once may overshoot.
        let turn = n * ((r - twist) * arm);
        sliding += to.turned_at(&turn, other) + from.turned_at(&turn, own);
    }
    let sought = across - dot(&sliding, &t) * heavy_across;
    let sought_aside = aside - dot(&sliding, &b) * heavy_aside;
    let (p, q);
    [p, q, r] = limited([sought, sought_aside, r], contact.friction, along);
    let push = t * (p - across) + b * (q - aside);
    to.apply_impulse(other, &push);
    from.apply_impulse(own, &opposite(&push));
    Contact::write_impulse(&[along, p, q], row);
    if contact.is_middle {
        let turn = n * ((r - twist) * arm);
        to.twist(&turn);
        from.twist(&opposite(&turn));
        Contact::write_twist(r, row);
    }
}

/// What takes the approach of two units, and friction within its cone. Whether there is any.
#[cfg_attr(rigidformer_dsp, inline(never))]
fn resolve(bodies: &mut Bodies<'_>, row: &mut [f32; CONTACT], aim: (Goal, f32)) -> bool {
    let (goal, _) = aim;
    let contact = Contact::read(row);
    let ([own, other], [mut heavy, ..]) = (&contact.arms, contact.weight);
    let [before, ..] = contact.impulse;
    let Some(number) = contact.from.filter(|_| goal != Goal::Bounce || before > 0.0) else {
        return false;
    };
    // A held unit takes no part of the approach, so the other needs all of the impulse.
    if goal == Goal::Settle {
        heavy *= contact.stiffness;
    }
    let leaving = bodies.speed_at(contact.to, other) - bodies.speed_at(number, own);
    let Some(along) = normal_impulse(&contact, &leaving, heavy, aim) else { return false };
    // Most contacts end above: the rest is read for those that do not.
    let contact = Contact::read(row);
    let (n, [before, ..]) = (contact.normal, contact.impulse);
    let Some(mut from) = bodies.find(number) else { return false };
    let Some(mut to) = bodies.find(contact.to) else { return false };
    if goal == Goal::Settle {
        match contact.held {
            Held::Neither => {}
            Held::From => from.hold(),
            Held::To => to.hold(),
        }
    }
    let push = n * (along - before);
    to.apply_impulse(other, &push);
    from.apply_impulse(own, &opposite(&push));
    rub(&contact, along, [&mut from, &mut to], row);
    bodies.moves(number, &from);
    bodies.moves(contact.to, &to);
    true
}

/// As [`resolve`], for a unit on a plane, which nothing moves: the same numbers for half of the work.
#[inline]
fn resolve_on_plane(bodies: &mut Bodies<'_>, row: &mut [f32; CONTACT], aim: (Goal, f32)) -> bool {
    let (goal, _) = aim;
    let contact = Contact::read(row);
    let ([_, arm], [heavy, ..]) = (&contact.arms, contact.weight);
    let [before, ..] = contact.impulse;
    // Contacts without an impulse did not touch, and do not bounce.
    if goal == Goal::Bounce && before <= 0.0 {
        return false;
    }
    let leaving = bodies.speed_at(contact.to, arm);
    let Some(along) = normal_impulse(&contact, &leaving, heavy, aim) else { return false };
    let contact = Contact::read(row);
    let (n, [before, ..]) = (contact.normal, contact.impulse);
    let Some(mut to) = bodies.find(contact.to) else { return false };
    to.apply_impulse(arm, &(n * (along - before)));
    rub(&contact, along, [&mut { Mover::STILL }, &mut to], row);
    bodies.moves(contact.to, &to);
    true
}

/// Marks the units that impulses have moved. Whether any contact bounces.
#[cfg_attr(rigidformer_dsp, inline(never))]
pub(super) fn mark(world: &World<'_>, bodies: &mut Bodies<'_>, contacts: &Contacts<'_>) -> bool {
    let mut bounces = false;
    for row in contacts.rows() {
        let contact = Contact::read(row);
        let [along, ..] = contact.impulse;
        if along > 0.0 {
            contact.from.into_iter().chain([contact.to]).for_each(|unit| bodies.touch(unit));
            bounces |= contact.rebound > 0.0;
            if world.gives_way() {
                let haste = contact.haste(world.substep_s);
                let units = contact.from.into_iter().chain([contact.to]);
                units.for_each(|unit| bodies.hasten(unit, haste));
            }
        }
    }
    bounces
}

/// Finds the ways out of overlaps, from what does not move on; velocities stay.
#[cfg_attr(rigidformer_dsp, inline(never))]
pub(super) fn push_apart(world: &World<'_>, bodies: &mut Bodies<'_>, contacts: &mut Contacts<'_>) {
    for _ in 0..PUSHES {
        for rank in 0..contacts.rows().len() {
            let Some(contact) = contacts.ordered(rank).map(|row| Contact::read(row)) else {
                continue;
            };
            if contact.gives_way() {
                continue;
            }
            let ([own, other], normal) = (contact.arms, contact.normal);
            let gap = contact.gap + world.skin(radius(world, &contact));
            let mut apart = bodies.shift_at(contact.to, &other);
            if let Some(from) = contact.from {
                apart -= bodies.shift_at(from, &own);
            }
            let depth = -gap - dot(&apart, &normal);
            // Earlier pushes have taken the overlap away.
            if depth <= 0.0 {
                continue;
            }
            let mut from = contact.from.map_or(Mover::STILL, |from| bodies.shifted(from));
            let mut to = bodies.shifted(contact.to);
            let moves_to = to.is_moved() && contact.held != Held::To;
            let moves_from = from.is_moved() && contact.held != Held::From;
            let mut soft = if moves_to { to.inverse_mass_at(&other, &normal) } else { 0.0 };
            if moves_from {
                soft += from.inverse_mass_at(&own, &normal);
            }
            // Two units that nothing moves stay in each other.
            if soft <= 0.0 {
                continue;
            }
            let push = normal * (depth * world.pushes / soft);
            if moves_to {
                to.apply_impulse(&other, &push);
                bodies.shifts(contact.to, &to);
                bodies.touch(contact.to);
            }
            if let Some(number) = contact.from.filter(|_| moves_from) {
                from.apply_impulse(&own, &opposite(&push));
                bodies.shifts(number, &from);
                bodies.touch(number);
            }
        }
    }
    bodies.shift_all(world);
}

const _: () = assert!(LEVELS as f32 + 1.0 < FAR, "levels are below the one of what nothing holds");
