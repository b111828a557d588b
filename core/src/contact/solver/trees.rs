//! Units that hang together, within the solver's substeps.
//!
//! A substep moves a tree of joined units by the discrete law of RATTLE: impulses along the joints at its start, so that joints hold at
//! its end, and velocities that keep them holding there. That is of the second order, and energy does not drift. Impulses follow
//! from one pass up and one down the tree, whatever its length: inertia and bias of what hangs from each unit, then motions.

mod limb;

use super::bodies::{Bodies, Touched, World};
use crate::geometry::{columns, dot, norm, rotate, rotate_back, squared};
use crate::math;
use crate::scene::UnitSlot;
use crate::structure::articulation::{Inertia, Six, inverse};
use crate::structure::hinge::{Hinge, axis_of, whole_turn};
use crate::structure::link::{Above, Way};
pub(super) use limb::LIMB;
use limb::{Head, Limbs, Mode, Place};
use nalgebra::{Matrix3, Vector3};

/// Rounds that find the impulses of a substep. Each leaves about a hundredth of the gap.
const ROUNDS: u8 = 4;
/// Rounds that close what is open before a step, without velocity.
const CLOSING: u8 = 12;
/// Turns of a round, at most, rad.
const MOST_TURN: f64 = 0.5;
/// Rounds of closing after a substep: contact pushes units apart.
const CLOSING_LATER: u8 = 2;
/// Rounds in which joints reach limits, leave them, or give in.
const CHOICES: u8 = 4;
/// Gaps up to this are rounding, in levers; angles in radians.
const ROUNDING: f32 = 4e-7;
/// Of what hangs together the mass of a unit that nothing moves, where it hangs itself: impulses of others hardly move it.
const HEAVY: f32 = 1e4;
/// A gap closes in a substep by at most this, in levers and radians: no joint that cannot hold throws what it holds.
const MOST_CLOSED: f32 = 0.05;
/// Of what a joint is beyond a limit, comes back in a second.
const BACK_HZ: f32 = 10.0;
/// Of a step, what is all of it but for rounding.
const WHOLE: f32 = 0.9999;
/// How much faster than at the start of a step a joint goes to its target later in it.
const HASTE: f32 = 1.5;

/// The trees of a copy.
pub(super) struct Trees<'r> {
    limbs: Limbs<'r>,
    /// Units in trees, in an order in which parents come first.
    count: usize,
    /// kg of all that is free in them, by [`HEAVY`].
    heavy: f32,
}

impl<'r> Trees<'r> {
    /// In a slab of [`LIMB`] numbers a unit, none in use yet.
    pub(super) fn new(slab: &'r mut [f32], units: usize) -> Self {
        Trees { limbs: Limbs::new(slab, units), count: 0, heavy: 0.0 }
    }

    /// Whether a unit moves by these rules.
    pub(super) fn moves(&self, unit: usize) -> bool {
        self.count > 0 && matches!(self.limbs.head(unit).place, Place::Root | Place::Hangs)
    }

    /// Finds the trees, closes what is open in them and takes from the velocities that come into the step what joints do not allow.
    pub(super) fn begin(&mut self, world: &World<'_>, bodies: &mut Bodies<'_>) {
        self.count = 0;
        if !world.has_trees {
            return;
        }
        self.order(world.units);
        for number in 0..world.units.len() {
            let head = Head { mode: Mode::Passive, ..self.limbs.head(number) };
            self.limbs.set_head(number, &head);
        }
        self.weigh(world, bodies);
        self.close(world, bodies, CLOSING);
        self.hold(world, bodies);
    }

    /// Lists the units in trees, parents first.
    fn order(&mut self, units: &[UnitSlot]) {
        let parent = |unit: &UnitSlot| {
            let id = unit.link.above?.parent;
            units.binary_search_by_key(&id, |unit| unit.id.to_bits()).ok()
        };
        self.heavy = 0.0;
        for number in 0..units.len() {
            self.limbs.set_head(number, &Head::NONE);
        }
        for (number, unit) in units.iter().enumerate() {
            let Some(parent) = parent(unit) else { continue };
            let place = if unit.is_free() { Place::Hangs } else { Place::HeldBelow };
            self.limbs.set_head(number, &Head { place, parent, ..self.limbs.head(number) });
        }
        // What others hang from and that hangs from none.
        for unit in units {
            let Some(parent) = parent(unit) else { continue };
            let head = self.limbs.head(parent);
            if head.place == Place::Outside {
                let free = units.get(parent).is_some_and(UnitSlot::is_free);
                let place = if free { Place::Root } else { Place::Held };
                self.limbs.set_head(parent, &Head { place, ..head });
                self.limbs.list(self.count, parent);
                self.count += 1;
            }
        }
        // Each round lists at least one more, so there are no more rounds than units.
        let mut listed = 0;
        while listed < self.count {
            let until = self.count;
            for number in 0..units.len() {
                let head = self.limbs.head(number);
                let hangs = matches!(head.place, Place::Hangs | Place::HeldBelow);
                let is_next =
                    hangs && (listed..until).any(|place| self.limbs.listed(place) == head.parent);
                if is_next {
                    self.limbs.list(self.count, number);
                    self.count += 1;
                }
            }
            listed = until;
        }
        for place in 0..self.count {
            let unit = units.get(self.limbs.listed(place)).filter(|unit| unit.is_free());
            self.heavy += unit.map_or(0.0, |unit| unit.mass * HEAVY);
        }
    }

    /// Members with their numbers, slots and heads, parents first.
    fn member<'u>(
        &self,
        units: &'u [UnitSlot],
        place: usize,
    ) -> Option<(usize, &'u UnitSlot, Head)> {
        let number = self.limbs.listed(place);
        Some((number, units.get(number)?, self.limbs.head(number)))
    }

    /// What a unit hangs by.
    fn joint(unit: &UnitSlot) -> Option<&Above> {
        unit.link.above.as_ref()
    }

    /// Levers, axes and inertia of all that hangs, as units now lie and joints are now free.
    fn weigh(&mut self, world: &World<'_>, bodies: &Bodies<'_>) {
        for place in 0..self.count {
            let Some((number, unit, head)) = self.member(world.units, place) else { continue };
            let pose = bodies.pose(number);
            let mass = f64::from(unit.mass);
            let moments = unit.inertia_m2.cast::<f64>() * mass;
            let inertia = Inertia::of(mass, &moments, &pose.rotation.cast());
            self.limbs.set_inertia(number, &inertia);
            if let Some(above) = Self::joint(unit).filter(|_| head.place.hangs()) {
                let Some(parent) = world.units.get(head.parent) else { continue };
                let length = world.scene.measure.length();
                let parents = bodies.pose(head.parent).rotation;
                let own = rotate(&pose.rotation, &((above.pivot - unit.offset) / length));
                let lever = if above.guide.way == Way::Slides {
                    bodies.apart(world, head.parent, number)
                } else {
                    rotate(&parents, &((above.parent_pivot - parent.offset) / length)) - own
                };
                let axis = axis_of(above, &parents);
                self.limbs.set_levers(number, [lever, own, axis]);
            }
        }
        for place in (0..self.count).rev() {
            let Some((number, unit, head)) = self.member(world.units, place) else { continue };
            let whole = self.limbs.inertia(number);
            if head.place == Place::Root {
                self.limbs.set_inertia(number, &whole.inverted());
            }
            let Some(above) = Self::joint(unit).filter(|_| head.place.hangs()) else { continue };
            let [mut lever, arm, axis] = self.limbs.levers(number);
            let ways = self.ways(number, above.guide.way);
            let left = if head.place == Place::HeldBelow {
                // At its pivot it resists what its joint does not leave open, as if it were held by much.
                lever += arm;
                let open = (!head.mode.is_locked()).then_some(axis);
                let open = open.map(|axis| axis.cast());
                Inertia::held(above.guide.way, open, (self.heavy.into(), unit.radius.into()))
            } else {
                let gains = ways.map(|way| whole.times(&way));
                let mut matrix = [[0.0; 3]; 3];
                for (row, way) in matrix.iter_mut().zip(&ways) {
                    *row = gains.map(|gain| gain.dot(way));
                }
                let [[xx, xy, xz], [_, yy, yz], [_, _, zz]] = matrix;
                let weights = inverse(&[xx, yy, zz, xy, xz, yz]);
                self.limbs.set_gains(number, &gains, &weights);
                if head.mode.is_locked() { whole } else { whole.without(&gains, &weights) }
            };
            self.limbs.set_inertia(number, &left);
            // What nothing moves feels nothing.
            let parent = self.limbs.head(head.parent).place;
            if matches!(parent, Place::Root | Place::Hangs) {
                let felt = left.from(&lever.cast());
                let sum = self.limbs.inertia(head.parent).plus(&felt);
                self.limbs.set_inertia(head.parent, &sum);
            }
        }
    }

    /// Motions of a unit's centre, with its parent held, that its joint leaves open.
    fn ways(&self, number: usize, way: Way) -> [Six; 3] {
        let [_, arm, axis] = self.limbs.levers(number).map(|lever| lever.cast::<f64>());
        let about = |axis: Vector3<f64>| Six { way: arm.cross(&axis), turn: axis };
        match way {
            Way::Ball => [Vector3::x(), Vector3::y(), Vector3::z()].map(about),
            Way::Turns => [about(axis), Six::ZERO, Six::ZERO],
            Way::Slides => [Six { way: axis, turn: Vector3::zeros() }, Six::ZERO, Six::ZERO],
            Way::Fixed => [Six::ZERO; 3],
        }
    }

    /// Finds the changes of motion, of all units in trees, by impulses along the joints that make up what is `missing` there: of a
    /// unit's motion beside its parent's, at its pivot. What joints push with acts besides, once.
    fn solve(&mut self, world: &World<'_>, missing: impl Fn(&Self, usize, &Above) -> Six) {
        for place in 0..self.count {
            self.limbs.set_load(self.limbs.listed(place), &Six::ZERO);
        }
        for place in (0..self.count).rev() {
            let Some((number, unit, head)) = self.member(world.units, place) else { continue };
            let Some(above) = Self::joint(unit).filter(|_| head.place.hangs()) else { continue };
            let [lever, arm, _] = self.limbs.levers(number).map(|lever| lever.cast::<f64>());
            let wanted = missing(self, number, above);
            if head.place == Place::HeldBelow {
                self.limbs.set_wanted(number, &wanted);
                let axis = self.along(number, above.guide.way).times(head.push.into());
                let up = self.limbs.inertia(number).times(&wanted).plus(&axis).times(-1.0);
                let sum = self.limbs.load(head.parent).plus(&up.from(&(lever + arm)));
                self.limbs.set_load(head.parent, &sum);
                continue;
            }
            // At the pivot it is wanted, at the centre it acts.
            let wanted = Six { way: wanted.way + arm.cross(&wanted.turn), ..wanted };
            self.limbs.set_wanted(number, &wanted);
            let load = self.limbs.load(number);
            let mut up = load.minus(&self.limbs.inertia(number).times(&wanted));
            if !head.mode.is_locked() {
                let (gains, shares) = self.shares(number, (above.guide.way, &head), &load);
                for (gain, share) in gains.iter().zip(shares) {
                    up = up.minus(&gain.times(share));
                }
            }
            let sum = self.limbs.load(head.parent).plus(&up.from(&lever));
            self.limbs.set_load(head.parent, &sum);
        }
        for place in 0..self.count {
            let Some((number, unit, mut head)) = self.member(world.units, place) else { continue };
            let load = self.limbs.load(number);
            let change = match (head.place, Self::joint(unit)) {
                (Place::Root, _) => self.limbs.inertia(number).solve(&load),
                (Place::HeldBelow, Some(above)) => {
                    let [lever, arm, _] = self.limbs.levers(number);
                    let moved = self.limbs.change(head.parent).at(&(lever + arm).cast());
                    let lacks = moved.plus(&self.limbs.wanted(number));
                    let impulse = self.limbs.inertia(number).times(&lacks);
                    if head.mode.is_locked() {
                        head.held += impulse.dot(&self.along(number, above.guide.way)) as f32;
                    }
                    head.push = 0.0;
                    self.limbs.set_head(number, &head);
                    Six::ZERO
                }
                (Place::Hangs, Some(above)) => {
                    let [lever, ..] = self.limbs.levers(number);
                    let from = self.limbs.change(head.parent).at(&lever.cast());
                    let moved = from.plus(&self.limbs.wanted(number));
                    let mut change = moved;
                    if head.mode.is_locked() {
                        // What holds it along its axis.
                        let [way, ..] = self.ways(number, above.guide.way);
                        let impulse = self.limbs.inertia(number).times(&change).minus(&load);
                        head.held += impulse.dot(&way) as f32;
                    } else {
                        let (gains, weights) = self.limbs.gains(number);
                        let loads = self.loads(number, (above.guide.way, &head), &load);
                        let free = gains.map(|gain| gain.dot(&moved));
                        let [x, y, z] = [0, 1, 2].map(|row| {
                            let get = |all: &[f64; 3]| all.get(row).copied().unwrap_or_default();
                            get(&loads) - get(&free)
                        });
                        let shares = weigh_three(&weights, [x, y, z]);
                        let ways = self.ways(number, above.guide.way);
                        for (way, share) in ways.iter().zip(shares) {
                            change = change.plus(&way.times(share));
                        }
                    }
                    head.push = 0.0;
                    self.limbs.set_head(number, &head);
                    change
                }
                _ => Six::ZERO,
            };
            self.limbs.set_change(number, &change);
        }
    }

    /// What a joint's position grows along, at its pivot.
    fn along(&self, number: usize, way: Way) -> Six {
        let [_, _, axis] = self.limbs.levers(number);
        match way {
            Way::Slides => Six { way: axis.cast(), turn: Vector3::zeros() },
            _ => Six { way: Vector3::zeros(), turn: axis.cast() },
        }
    }

    /// Impulses along the open ways of a unit's joint.
    fn loads(&self, number: usize, (way, head): (Way, &Head), load: &Six) -> [f64; 3] {
        let ways = self.ways(number, way);
        let mut loads = ways.map(|way| way.dot(load));
        let [first, ..] = &mut loads;
        *first += f64::from(head.push);
        loads
    }

    /// How much of each open way those make, and their impulses.
    fn shares(&self, number: usize, joint: (Way, &Head), load: &Six) -> ([Six; 3], [f64; 3]) {
        let (gains, weights) = self.limbs.gains(number);
        (gains, weigh_three(&weights, self.loads(number, joint, load)))
    }

    /// Changes velocities so that joints hold, by impulses along them.
    fn hold(&mut self, world: &World<'_>, bodies: &mut Bodies<'_>) {
        let still = &*bodies;
        self.solve(world, |trees, number, above| trees.missing_velocity(still, number, above));
        self.change_velocities(world, bodies);
    }

    /// Adds what [`solve`](Self::solve) has found to the velocities of what moves.
    fn change_velocities(&self, world: &World<'_>, bodies: &mut Bodies<'_>) {
        for place in 0..self.count {
            let Some((number, _, head)) = self.member(world.units, place) else { continue };
            if matches!(head.place, Place::Root | Place::Hangs) {
                let change = self.limbs.change(number);
                let mut mover = bodies.mover(number);
                mover.velocity += change.way.cast::<f32>();
                mover.spin += change.turn.cast::<f32>();
                bodies.moves(number, &mover);
            }
        }
    }

    /// What a unit's velocity at its pivot lacks of what its joint wants.
    fn missing_velocity(&self, bodies: &Bodies<'_>, number: usize, above: &Above) -> Six {
        let head = self.limbs.head(number);
        let [lever, arm, axis] = self.limbs.levers(number);
        let (own, parent) = (bodies.mover(number), bodies.mover(head.parent));
        let mut way = parent.speed_at(&(lever + arm)) - own.speed_at(&arm);
        let mut turn = parent.spin - own.spin;
        let rate = if head.mode.is_locked() { Some(head.rate) } else { None };
        let along = |v: &Vector3<f32>| match rate {
            Some(rate) => v + axis * rate,
            None => v - axis * dot(&axis, v),
        };
        match above.guide.way {
            Way::Ball => turn = Vector3::zeros(),
            Way::Turns => turn = along(&turn),
            Way::Slides => way = along(&way),
            Way::Fixed => {}
        }
        Six { way: way.cast(), turn: turn.cast() }
    }

    /// How fast the position of a joint grows.
    fn rate(&self, bodies: &Bodies<'_>, number: usize, above: &Above) -> f32 {
        let head = self.limbs.head(number);
        let [lever, arm, axis] = self.limbs.levers(number);
        let (own, parent) = (bodies.mover(number), bodies.mover(head.parent));
        match above.guide.way {
            Way::Slides => dot(&axis, &(own.speed_at(&arm) - parent.speed_at(&(lever + arm)))),
            _ => dot(&axis, &(own.spin - parent.spin)),
        }
    }

    /// A joint as its units lie.
    fn hinge(
        &self,
        world: &World<'_>,
        bodies: &Bodies<'_>,
        (number, unit): (usize, &UnitSlot),
        above: &Above,
    ) -> Option<Hinge> {
        let head = self.limbs.head(number);
        let parent = world.units.get(head.parent)?;
        let rotations = [number, head.parent].map(|unit| bodies.pose(unit).rotation);
        let apart = bodies.apart(world, head.parent, number);
        let offsets = [&unit.offset, &parent.offset];
        Some(Hinge::of(above, &rotations, (offsets, world.scene.measure.length()), &apart))
    }

    /// Closes what is open by ways and turns that are no velocity.
    fn close(&mut self, world: &World<'_>, bodies: &mut Bodies<'_>, rounds: u8) {
        for _ in 0..rounds {
            if !self.note_gaps(world, bodies, None) {
                break;
            }
            self.solve(world, |trees, number, _| trees.limbs.change(number));
            let turns =
                (0..self.count).map(|place| self.limbs.change(self.limbs.listed(place)).turn);
            let turn = turns.fold(0.0_f64, |most, turn| most.max(turn.amax()));
            // Ways are straight, and a stretched chain that is too short would whirl.
            let share = if turn > MOST_TURN { MOST_TURN / turn } else { 1.0 };
            for place in 0..self.count {
                let Some((number, unit, head)) = self.member(world.units, place) else { continue };
                if matches!(head.place, Place::Root | Place::Hangs) {
                    let change = self.limbs.change(number).times(share);
                    let moves = [change.way, change.turn].map(|v| v.cast::<f32>());
                    bodies.advance_by(number, unit, moves);
                    bodies.square(number);
                }
            }
            self.weigh(world, bodies);
        }
    }

    /// Leaves in the place of changes what each joint lacks; whether that is more than rounding. With a time, joints that are locked lack
    /// what takes them on at their rate, and a gap counts as one that closes in it.
    fn note_gaps(&mut self, world: &World<'_>, bodies: &Bodies<'_>, time_s: Option<f32>) -> bool {
        let mut is_open = false;
        for place in 0..self.count {
            let Some((number, unit, head)) = self.member(world.units, place) else { continue };
            let above = Self::joint(unit).filter(|_| head.place.hangs());
            let hinge = above
                .and_then(|above| Some((above, self.hinge(world, bodies, (number, unit), above)?)));
            let Some((above, hinge)) = hinge else {
                self.limbs.set_change(number, &Six::ZERO);
                continue;
            };
            let Hinge { mut gap, mut tilt, position, axis } = hinge;
            let [lever, arm, _] = self.limbs.levers(number);
            let reach = (norm(&lever) + norm(&arm)) + unit.radius;
            if time_s.is_some() {
                let open = self.limbs.open(number);
                (gap, tilt) = (gap - open.way.cast::<f32>(), tilt - open.turn.cast::<f32>());
            }
            if let Some(time_s) = time_s.filter(|_| head.mode.is_locked()) {
                let lacks = (head.position + head.rate * time_s) - position;
                match above.guide.way {
                    Way::Slides => gap += axis * lacks,
                    _ => tilt += axis * whole_turn(lacks),
                }
            }
            is_open |= !(gap.amax() <= ROUNDING * reach && tilt.amax() <= ROUNDING * 4.0);
            if let Some(time_s) = time_s {
                let most = MOST_CLOSED;
                let within = |v: Vector3<f32>, most: f32| {
                    let size = norm(&v);
                    if size > most { v * (most / size) } else { v }
                };
                gap = within(gap, most * reach) / time_s;
                tilt = within(tilt, most) / time_s;
            }
            let [_, _, own] = self.limbs.levers(number);
            // What is free needs no impulse.
            if !head.mode.is_locked() {
                match above.guide.way {
                    Way::Ball => tilt = Vector3::zeros(),
                    Way::Turns => tilt -= own * dot(&own, &tilt),
                    Way::Slides => gap -= own * dot(&own, &gap),
                    Way::Fixed => {}
                }
            }
            self.limbs.set_change(number, &Six { way: gap.cast(), turn: tilt.cast() });
        }
        is_open
    }

    /// Begins the substep of impulses: which joints follow a target, and which are at a limit. `left_s` is what is left of the step.
    pub(super) fn choose(&mut self, world: &World<'_>, bodies: &mut Bodies<'_>, left_s: f32) {
        if self.count == 0 {
            return;
        }
        // What cannot be closed, as between two that are held, is nothing to speed up for.
        self.note_gaps(world, bodies, None);
        for place in 0..self.count {
            let number = self.limbs.listed(place);
            self.limbs.set_open(number, &self.limbs.change(number));
        }
        let mut changes = false;
        for place in 0..self.count {
            let Some((number, unit, before)) = self.member(world.units, place) else { continue };
            let above = Self::joint(unit).filter(|_| before.place.hangs());
            let Some(above) = above.filter(|above| above.guide.way.has_axis()) else { continue };
            let Some(hinge) = self.hinge(world, bodies, (number, unit), above) else { continue };
            let mut head = Head { position: hinge.position, held: 0.0, push: 0.0, ..before };
            let scale =
                if above.guide.way == Way::Slides { world.scene.measure.length() } else { 1.0 };
            if let Some(target) = above.guide.target {
                let [least, most] = above.guide.limits;
                let way = if target < least {
                    least
                } else if target > most {
                    most
                } else {
                    target
                };
                let way = way / scale - head.position;
                let way = if above.guide.way == Way::Turns { whole_turn(way) } else { way };
                (head.mode, head.rate) = (Mode::Driven, way / left_s);
                // What the ground keeps from it is no reason to hurry in the end.
                if left_s > world.scene.dt * WHOLE {
                    head.pace = HASTE * head.rate.abs();
                } else if head.rate.abs() > head.pace {
                    head.rate = if way < 0.0 { -head.pace } else { head.pace };
                }
                let force = world.force(above);
                if force.is_finite() {
                    // No faster than it can brake.
                    let (_, [weight, ..]) = self.limbs.gains(number);
                    let fastest = math::sqrt(force * weight as f32 * way.abs());
                    if head.rate.abs() > fastest {
                        head.rate = if way < 0.0 { -fastest } else { fastest };
                    }
                }
            } else if matches!(head.mode, Mode::Driven | Mode::Pushed) {
                head.mode = Mode::Passive;
            }
            if head.mode.is_at_limit() {
                head.mode = Mode::Passive;
            }
            changes |= head.mode.is_locked() != before.mode.is_locked();
            self.limbs.set_head(number, &head);
        }
        if changes {
            self.weigh(world, bodies);
        }
        for _ in 0..CHOICES {
            self.hold(world, bodies);
            if !self.reconsider(world, bodies) {
                return;
            }
            self.weigh(world, bodies);
        }
        self.hold(world, bodies);
    }

    /// As far as contact has changed velocities since: makes joints hold, reach limits and give in.
    pub(super) fn follow(&mut self, world: &World<'_>, bodies: &mut Bodies<'_>, bounces: bool) {
        if self.count == 0 {
            return;
        }
        self.hold(world, bodies);
        // Units have moved since, and bounce as joints were then.
        if !bounces && self.reconsider(world, bodies) {
            self.weigh(world, bodies);
            self.hold(world, bodies);
        }
    }

    /// Lets joints go that pull at a limit, stops those that would pass one, and lets those give in that need more than their force.
    /// Whether any did.
    fn reconsider(&mut self, world: &World<'_>, bodies: &Bodies<'_>) -> bool {
        let mut changes = false;
        let time = world.substep_s;
        for place in 0..self.count {
            let Some((number, unit, mut head)) = self.member(world.units, place) else { continue };
            let above = Self::joint(unit).filter(|_| head.place.hangs());
            let Some(above) = above.filter(|above| above.guide.way.has_axis()) else { continue };
            let before = head.mode;
            let scale =
                if above.guide.way == Way::Slides { world.scene.measure.length() } else { 1.0 };
            let [least, most] = above.guide.limits.map(|limit| limit / scale);
            let next = head.position + self.rate(bodies, number, above) * time;
            match before {
                Mode::Passive | Mode::Pushed => {
                    let limit = if next > most {
                        Some((Mode::AtMost, most))
                    } else if next < least {
                        Some((Mode::AtLeast, least))
                    } else {
                        None
                    };
                    if let Some((mode, limit)) = limit {
                        (head.mode, head.held) = (mode, 0.0);
                        // What is beyond comes back at leisure.
                        let back = if (next - head.position) * (limit - head.position) > 0.0 {
                            1.0 / time
                        } else {
                            BACK_HZ
                        };
                        head.rate = (limit - head.position) * back;
                    }
                }
                Mode::AtMost if head.held > 0.0 => head.mode = Mode::Passive,
                Mode::AtLeast if head.held < 0.0 => head.mode = Mode::Passive,
                Mode::Driven => {
                    let most = world.force(above) * time;
                    if head.held.abs() > most {
                        let most = if head.held < 0.0 { -most } else { most };
                        (head.push, head.held) = (most - head.held, most);
                        head.mode = Mode::Pushed;
                    }
                }
                Mode::AtMost | Mode::AtLeast => {}
            }
            if head.mode != before {
                changes = true;
                self.limbs.set_head(number, &head);
            }
        }
        changes
    }

    /// Moves the units over the substep, so that joints hold at its end.
    pub(super) fn advance(&mut self, world: &World<'_>, bodies: &mut Bodies<'_>) {
        if self.count == 0 {
            return;
        }
        self.spread_touches(bodies);
        for place in 0..self.count {
            let Some((number, _, head)) = self.member(world.units, place) else { continue };
            if matches!(head.place, Place::Root | Place::Hangs) {
                self.limbs.set_start(number, &bodies.start(number));
                if !head.is_touched {
                    let mut mover = bodies.mover(number);
                    mover.velocity -= world.half_gravity();
                    bodies.moves(number, &mover);
                }
            }
        }
        for round in 0..=ROUNDS {
            self.drift(world, bodies, false);
            if round == ROUNDS || !self.note_gaps(world, bodies, Some(world.substep_s)) {
                break;
            }
            self.solve(world, |trees, number, _| trees.limbs.change(number));
            self.change_velocities(world, bodies);
        }
        self.drift(world, bodies, true);
    }

    /// A tree of which contact has pushed a unit in this substep moves as what is pushed does.
    fn spread_touches(&mut self, bodies: &Bodies<'_>) {
        // Roots first, then down.
        for place in 0..self.count {
            let number = self.limbs.listed(place);
            let head = self.limbs.head(number);
            let is_touched = bodies.marks(number).touched == Touched::Now;
            self.limbs.set_head(number, &Head { is_touched, ..head });
        }
        for place in (0..self.count).rev() {
            let head = self.limbs.head(self.limbs.listed(place));
            if head.place.hangs() && head.is_touched {
                let parent = self.limbs.head(head.parent);
                self.limbs.set_head(head.parent, &Head { is_touched: true, ..parent });
            }
        }
        for place in 0..self.count {
            let number = self.limbs.listed(place);
            let head = self.limbs.head(number);
            if head.place.hangs() {
                let is_touched = head.is_touched | self.limbs.head(head.parent).is_touched;
                self.limbs.set_head(number, &Head { is_touched, ..head });
            }
        }
    }

    /// Moves units from the start of the substep by their velocities, which in the `end` become those there.
    fn drift(&mut self, world: &World<'_>, bodies: &mut Bodies<'_>, end: bool) {
        let time = world.substep_s;
        for place in 0..self.count {
            let Some((number, unit, head)) = self.member(world.units, place) else { continue };
            if !matches!(head.place, Place::Root | Place::Hangs) {
                continue;
            }
            let (rotation, mut moved) = self.limbs.start(number);
            let mut mover = bodies.mover(number);
            let more = mover.velocity.iter().chain(&mover.spin).map(|v| v * time);
            moved.iter_mut().zip(more).for_each(|(sum, more)| *sum += more);
            let (rotation, spin) = spun(&rotation, &mover.spin, (&unit.inertia_m2, time));
            bodies.put(number, unit, (&rotation, &moved));
            if end {
                mover.spin = spin;
                if !head.is_touched {
                    mover.velocity += world.half_gravity();
                }
                bodies.moves(number, &mover);
            }
        }
    }

    /// Ends a substep: closes what contact has opened, and makes velocities those that joints allow.
    pub(super) fn finish(&mut self, world: &World<'_>, bodies: &mut Bodies<'_>) {
        if self.count == 0 {
            return;
        }
        for place in 0..self.count {
            let number = self.limbs.listed(place);
            let mut head = self.limbs.head(number);
            if head.mode.is_at_limit() {
                head.rate = 0.0;
                self.limbs.set_head(number, &head);
            }
        }
        self.weigh(world, bodies);
        self.close(world, bodies, CLOSING_LATER);
        self.hold(world, bodies);
    }
}

/// A rotation and a spin after a time in which no torque acts, by turns about the axes of inertia: they keep angular momentum to
/// rounding, and energy but for a swing of the second order.
fn spun(
    rotation: &Matrix3<f32>,
    spin: &Vector3<f32>,
    (moments, time): (&Vector3<f32>, f32),
) -> (Matrix3<f32>, Vector3<f32>) {
    let mut momentum = rotate_back(rotation, spin).component_mul(moments);
    let [mut x, mut y, mut z] = columns(rotation);
    let half = 0.5 * time;
    for (axis, time) in [(0, half), (1, half), (2, time), (1, half), (0, half)] {
        let (a, b, own, moment, p, q) = match axis {
            0 => (&mut y, &mut z, momentum.x, moments.x, momentum.y, momentum.z),
            1 => (&mut z, &mut x, momentum.y, moments.y, momentum.z, momentum.x),
            _ => (&mut x, &mut y, momentum.z, moments.z, momentum.x, momentum.y),
        };
        let (sine, cosine) = math::sin_cos(own / moment * time);
        (*a, *b) = (*a * cosine + *b * sine, *b * cosine - *a * sine);
        let (p, q) = (p * cosine + q * sine, q * cosine - p * sine);
        match axis {
            0 => (momentum.y, momentum.z) = (p, q),
            1 => (momentum.z, momentum.x) = (p, q),
            _ => (momentum.x, momentum.y) = (p, q),
        }
    }
    let rotation = squared(&Matrix3::new(x.x, y.x, z.x, x.y, y.y, z.y, x.z, y.z, z.z));
    (rotation, rotate(&rotation, &momentum.component_div(moments)))
}

/// A symmetric matrix (xx, yy, zz, xy, xz, yz) times three numbers.
fn weigh_three([xx, yy, zz, xy, xz, yz]: &[f64; 6], [x, y, z]: [f64; 3]) -> [f64; 3] {
    [(xx * x + xy * y) + xz * z, (xy * x + yy * y) + yz * z, (xz * x + yz * y) + zz * z]
}
