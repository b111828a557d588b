//! Where units touch planes and each other in a substep.

use super::bodies::{Bodies, Give, Mover, Spring, World, rows};
use super::meeting::{FACE, Meeting, meeting, tangent, touching};
use super::patch::{self, Patch};
#[cfg(feature = "terrain")]
use super::terrain::{Touches, Visitor};
use crate::contact::ground::Plane;
use crate::contact::pieces::Piece;
use crate::geometry::{Hull, Pose, dot, norm, rotate, rotate_back};
#[cfg(rigidformer_host)]
use crate::kernels::Block;
use crate::kernels::Schedule;
use crate::limits::MAX_PIECES;
use crate::math;
use crate::scene::UnitSlot;
use nalgebra::Vector3;

/// Slower sliding has no direction, in approaches.
const SLIDES: f32 = 1e-3;

/// From this square of its phase (radians a substep) on a spring ends a substep where it would rest.
const SETTLES: f32 = 4.0;
/// How fast a spring is of so much impulse by a substep's way at a metre a second, kg.
fn haste(weight: f32, spring: f32) -> f32 {
    if spring < SETTLES * weight { spring / (SETTLES * weight) } else { 1.0 }
}

/// Numbers of a contact.
pub(super) const CONTACT: usize = 25;
/// Numbers that are kept of a contact for the next substep.
pub(super) const OLD: usize = 12;
/// Pairs of pieces that threads look at together, a unit. Microcontrollers have one thread.
pub(super) const SLOTS: usize = if cfg!(rigidformer_host) { 4 } else { 0 };
/// Numbers of such a pair: units and pieces, the normal of the substep before; then how many points touch, the normal,
/// points and gaps.
pub(super) const SLOT: usize = if cfg!(rigidformer_host) { 7 + 5 + 4 * patch::POINTS } else { 0 };
/// About how many multiplications it takes to look at one: decides whether threads share them.
#[cfg(rigidformer_host)]
const SLOT_COST: usize = 8 << 10;

/// The unit of a contact that is nearer to what does not move.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Held {
    Neither,
    From,
    To,
}

/// A point where two units touch, or a plane and a unit.
#[derive(Clone, Copy, Debug)]
pub(super) struct Contact {
    /// Along the normal and both tangents, N s.
    pub(super) impulse: [f32; 3],
    /// The unit that the normal points away from, by its number in the copy; None: a plane.
    pub(super) from: Option<usize>,
    /// The unit that it points to.
    pub(super) to: usize,
    /// Which of their pieces touch: the first one's number times [`MAX_PIECES`] and the second one's.
    pub(super) piece: usize,
    pub(super) held: Held,
    /// Whether it is the middle of a patch.
    pub(super) is_middle: bool,
    /// From the centres of both, or of their clusters, in the world's axes, metres.
    pub(super) arms: [Vector3<f32>; 2],
    /// Less what the units keep between them, metres.
    pub(super) gap: f32,
    /// Coefficient of a cone; below 0 it is of a pyramid, less.
    pub(super) friction: f32,
    /// Speed after a bounce, m/s; 0: it does not bounce. Below 0 the contact gives way, and this is less what a change of its speed
    /// changes of the impulse of its spring and damper, kg.
    pub(super) rebound: f32,
    pub(super) normal: Vector3<f32>,
    /// The first tangent; of the middle of a patch what brakes a spin about the normal: the mean arm of the corners (m), the impulse
    /// at that arm (N s), and its weight (kg).
    pub(super) tangent: Vector3<f32>,
    /// Impulse for a change of velocity along the normal and both tangents, kg.
    pub(super) weight: [f32; 3],
    /// Weight along the normal with one unit held, in weights; of one that gives way, the impulse of its spring as it is, N s.
    pub(super) stiffness: f32,
}

impl Contact {
    #[inline]
    pub(super) fn read(row: &[f32; CONTACT]) -> Self {
        #[rustfmt::skip]
        let [p, q, r, from, to, kind, ax, ay, az, bx, by, bz, gap, friction, rebound,
            nx, ny, nz, tx, ty, tz, along, across, aside, stiffness] = *row;
        let is_middle = Self::is_middle(row);
        let held = match if is_middle { kind - 3.0 } else { kind } {
            1.0 => Held::From,
            2.0 => Held::To,
            _ => Held::Neither,
        };
        Contact {
            impulse: [p, q, r],
            from: (from >= 0.0).then_some(from as usize),
            to: to as usize,
            piece: piece_of(to),
            held,
            is_middle,
            arms: [Vector3::new(ax, ay, az), Vector3::new(bx, by, bz)],
            gap,
            friction,
            rebound,
            normal: Vector3::new(nx, ny, nz),
            tangent: Vector3::new(tx, ty, tz),
            weight: [along, across, aside],
            stiffness,
        }
    }

    /// As [`read`](Self::read), where it is not worth its size on microcontrollers.
    #[cfg_attr(rigidformer_dsp, inline(never))]
    pub(super) fn load(row: &[f32; CONTACT]) -> Self {
        Self::read(row)
    }

    pub(super) fn write(&self, row: &mut [f32; CONTACT]) {
        let Contact { impulse: [p, q, r], arms: [a, b], normal: n, tangent: t, .. } = *self;
        let [along, across, aside] = self.weight;
        let kind = self.kind();
        let from = self.from.map_or(-1.0, |from| from as f32);
        #[rustfmt::skip]
        let numbers = [p, q, r, from, with_piece(self.to, self.piece), kind, a.x, a.y, a.z, b.x, b.y, b.z,
            self.gap, self.friction, self.rebound,
            n.x, n.y, n.z, t.x, t.y, t.z, along, across, aside, self.stiffness];
        *row = numbers;
    }

    /// What is held, and whether it is a middle, as a number.
    #[inline]
    fn kind(&self) -> f32 {
        let held = match self.held {
            Held::Neither => 0.0,
            Held::From => 1.0,
            Held::To => 2.0,
        };
        if self.is_middle { 3.0 + held } else { held }
    }

    /// Keeps what is held, and the weight with that.
    #[inline]
    pub(super) fn write_held(&self, row: &mut [f32; CONTACT]) {
        let [_, _, _, _, _, kind, .., stiffness] = row;
        (*kind, *stiffness) = (self.kind(), self.stiffness);
    }

    /// Makes it one that gives way.
    #[inline]
    fn give_way(&mut self, spring: &Spring, substep_s: f32) {
        let Spring { stiffness, dissipation } = spring;
        let ([weight, ..], pace) = (self.weight, stiffness * substep_s);
        let depth = -self.gap;
        // Of slow springs the depth half way counts, which keeps their energy, and of fast ones that at the end.
        let late = 0.5 + 0.5 * haste(weight, pace * substep_s);
        let damping = dissipation * if depth > 0.0 { depth } else { 0.0 };
        self.stiffness = pace * depth;
        self.rebound = -(pace * (damping + late * substep_s)).max(f32::MIN_POSITIVE);
    }

    /// How near it is to rigid contact, which moves units at the velocities that it leaves, from 0 to 1.
    pub(super) fn haste(&self, substep_s: f32) -> f32 {
        if !self.gives_way() {
            return 1.0;
        }
        let ([weight, ..], depth) = (self.weight, -self.gap);
        // Depth times stiffness and time is the spring's impulse.
        if depth == 0.0 { 0.0 } else { haste(weight, self.stiffness / depth * substep_s) }
    }

    /// Whether it gives way.
    #[inline(always)]
    pub(super) fn gives_way(&self) -> bool {
        cfg!(feature = "compliance") && self.rebound < 0.0
    }

    /// Whether it is one with a plane.
    #[inline]
    pub(super) fn is_on_plane([_, _, _, from, ..]: &[f32; CONTACT]) -> bool {
        *from < 0.0
    }

    /// Whether it is the middle of a patch.
    #[inline]
    pub(super) fn is_middle([_, _, _, _, _, kind, ..]: &[f32; CONTACT]) -> bool {
        *kind >= 3.0
    }

    /// Along its normal, how fast its units may leave each other after a sweep at least, m/s: an open gap allows just the approach that
    /// closes it in the substep.
    #[inline]
    pub(super) fn wanted(&self, substep_s: f32) -> f32 {
        -(if self.gap > 0.0 { self.gap } else { 0.0 } / substep_s)
    }

    /// Keeps the impulse.
    #[inline]
    pub(super) fn write_impulse(impulse: &[f32; 3], row: &mut [f32; CONTACT]) {
        let ([p, q, r, ..], [a, b, c]) = (row, impulse);
        (*p, *q, *r) = (*a, *b, *c);
    }

    #[inline]
    pub(super) fn axes(&self) -> [Vector3<f32>; 3] {
        let tangent = if self.is_middle { tangent(&self.normal) } else { self.tangent };
        [self.normal, tangent, self.normal.cross(&tangent)]
    }

    /// What brakes a spin about the normal of a patch, at its middle: arm (m), impulse at that arm (N s) and its weight (kg).
    #[inline]
    pub(super) fn twist(&self) -> Option<[f32; 3]> {
        self.is_middle.then(|| self.tangent.into())
    }

    /// Keeps the impulse of the twist of a middle.
    #[inline]
    pub(super) fn write_twist(impulse: f32, row: &mut [f32; CONTACT]) {
        let [.., twist, _, _, _, _, _] = row;
        *twist = impulse;
    }

    /// Pairs come in this order.
    pub(super) fn pair(&self) -> (Option<usize>, usize) {
        (self.from, self.to)
    }

    /// And pairs of pieces in this.
    pub(super) fn place(&self) -> Place {
        (self.from, self.to, self.piece)
    }
}

/// A pair of units and of their pieces.
pub(super) type Place = (Option<usize>, usize, usize);

/// Pairs of pieces of two units.
const PAIRS: usize = MAX_PIECES * MAX_PIECES;

/// A unit's number and a pair of pieces in one: pieces are the part behind the point. Exact for the first 16,384 units of a
/// copy, whose pairs nobody waits for.
fn with_piece(unit: usize, piece: usize) -> f32 {
    unit as f32 + piece as f32 / PAIRS as f32
}

/// The pair of pieces in [`with_piece`].
fn piece_of(number: f32) -> usize {
    ((number - number as usize as f32) * PAIRS as f32) as usize
}

/// What is kept of a contact for the substep after.
#[derive(Clone, Copy)]
pub(super) struct Old {
    pub(super) pair: (Option<usize>, usize),
    piece: usize,
    /// From the centre of the second unit or of its cluster, metres.
    pub(super) arm: Vector3<f32>,
    /// Along the normal, N s; 0: the contact has none, or another one went on from it.
    pub(super) along: f32,
    /// Across it, and along it that of a twist, N s.
    pub(super) rub: Vector3<f32>,
    pub(super) normal: Vector3<f32>,
}

impl Old {
    fn new(contact: &Contact) -> Self {
        let ([n, t, b], [along, across, aside]) = (contact.axes(), contact.impulse);
        let [_, twist, _] = contact.twist().unwrap_or_default();
        let rub = (t * across + b * aside) + n * twist;
        let [_, arm] = contact.arms;
        let (pair, piece, normal) = (contact.pair(), contact.piece, contact.normal);
        Old { pair, piece, arm, along, rub, normal }
    }

    pub(super) fn read(row: &[f32; OLD]) -> Self {
        let [along, from, to, ax, ay, az, rx, ry, rz, nx, ny, nz] = *row;
        Old {
            pair: ((from >= 0.0).then_some(from as usize), to as usize),
            piece: piece_of(to),
            arm: Vector3::new(ax, ay, az),
            along,
            rub: Vector3::new(rx, ry, rz),
            normal: Vector3::new(nx, ny, nz),
        }
    }

    fn write(&self, row: &mut [f32; OLD]) {
        let Old { pair: (from, to), piece, arm, along, rub, normal } = self;
        let from = from.map_or(-1.0, |from| from as f32);
        #[rustfmt::skip]
        let numbers = [*along, from, with_piece(*to, *piece), arm.x, arm.y, arm.z,
            rub.x, rub.y, rub.z, normal.x, normal.y, normal.z];
        *row = numbers;
    }
}

/// The contacts of a copy, by pairs in ascending order.
pub(super) struct Contacts<'r> {
    rows: &'r mut [[f32; CONTACT]],
    old: &'r mut [[f32; OLD]],
    count: usize,
    old_count: usize,
    /// Those that are the middle of a patch, once they are in order.
    middles: usize,
    /// Pairs that threads look at together.
    #[cfg(rigidformer_host)]
    slots: &'r mut [[f32; SLOT]],
    /// Room for contacts that sweeps take together.
    #[cfg(rigidformer_host)]
    blocks: &'r mut [Block],
    /// Where they are in it.
    #[cfg(rigidformer_host)]
    packed: Option<Blocks>,
}

/// Blocks that hold a copy's contacts: of the middles of patches, and of all.
#[cfg(rigidformer_host)]
#[derive(Clone, Copy)]
pub(super) struct Blocks {
    pub(super) middles: usize,
    pub(super) all: usize,
}

/// Contacts, and what puts them into blocks.
#[cfg(rigidformer_host)]
pub(super) struct ToPack<'a> {
    pub(super) rows: &'a mut [[f32; CONTACT]],
    /// What they are ordered by.
    pub(super) notes: &'a mut [[f32; OLD]],
    pub(super) blocks: &'a mut [Block],
    /// Where they are.
    pub(super) packed: Option<Blocks>,
    /// How many of the first in order are middles of patches.
    pub(super) middles: usize,
}

/// What the contacts of a pair have in common.
#[derive(Clone, Copy)]
struct Pair {
    from: Option<usize>,
    to: usize,
    piece: usize,
    /// From the first unit's centre to the second's, metres; 0 for a plane.
    apart: Vector3<f32>,
    normal: Vector3<f32>,
    skin: f32,
    friction: f32,
    restitution: f32,
    give: Give,
    /// Faster approaches bounce, m/s.
    bounces: f32,
}

impl<'r> Contacts<'r> {
    /// In a slab with room for so many.
    pub(super) fn new(slab: &'r mut [f32], room: usize) -> Self {
        let mut rest = slab;
        let (rows, old) = (self::rows(&mut rest, room), self::rows(&mut rest, room));
        Contacts {
            rows,
            old,
            count: 0,
            old_count: 0,
            middles: 0,
            #[cfg(rigidformer_host)]
            slots: &mut [],
            #[cfg(rigidformer_host)]
            blocks: &mut [],
            #[cfg(rigidformer_host)]
            packed: None,
        }
    }

    /// With so many pairs that threads look at together, where there is room for them, and blocks in what is left.
    #[cfg(rigidformer_host)]
    pub(super) fn with_slots(self, mut extra: &'r mut [f32], count: usize) -> Self {
        let slots = self::rows(&mut extra, count);
        let (lanes, _) = extra.as_chunks_mut();
        let (blocks, _) = lanes.as_chunks_mut();
        Contacts { slots, blocks, ..self }
    }

    /// Those of this substep, and what puts them into blocks.
    #[cfg(rigidformer_host)]
    pub(super) fn unpacked(&mut self) -> ToPack<'_> {
        let rows = self.rows.get_mut(..self.count).unwrap_or_default();
        let (packed, middles) = (self.packed, self.middles);
        ToPack { rows, notes: self.old, blocks: self.blocks, packed, middles }
    }

    /// Says where blocks of those of this substep are; none where they are swept one by one.
    #[cfg(rigidformer_host)]
    pub(super) fn set_packed(&mut self, packed: Option<Blocks>) {
        self.packed = packed;
    }

    /// Blocks of the middles of patches, and of the others; none where contacts are swept one by one.
    #[cfg(rigidformer_host)]
    pub(super) fn packed(&mut self) -> Option<[&mut [Block]; 2]> {
        let Blocks { middles, all } = self.packed?;
        let (first, rest) = self.blocks.split_at_mut_checked(middles)?;
        Some([first, rest.get_mut(..all.saturating_sub(middles))?])
    }

    /// How many there is room for.
    #[cfg(rigidformer_host)]
    pub(super) fn room(&self) -> usize {
        self.rows.len()
    }

    /// Forgets all.
    #[cfg(rigidformer_host)]
    pub(super) fn clear(&mut self) {
        (self.count, self.old_count) = (0, 0);
    }

    /// Those of this substep.
    pub(super) fn rows(&self) -> &[[f32; CONTACT]] {
        self.rows.get(..self.count).unwrap_or_default()
    }

    /// Those of this substep, and room for what they are ordered by. From there on the contacts of the substep before are gone.
    pub(super) fn ranked(&mut self) -> (&mut [[f32; CONTACT]], &mut [[f32; OLD]]) {
        (self.rows.get_mut(..self.count).unwrap_or_default(), self.old)
    }

    /// How far a contact is from what does not move, as [`ranked`](Self::ranked) was told.
    pub(super) fn level(&self, number: usize) -> f32 {
        self.old.get(number).map_or(0.0, |[_, _, level, ..]| *level)
    }

    /// Those of the substep before.
    pub(super) fn old(&self) -> &[[f32; OLD]] {
        self.old.get(..self.old_count).unwrap_or_default()
    }

    /// Those of this substep and of the substep before.
    pub(super) fn both(&mut self) -> (&mut [[f32; CONTACT]], &mut [[f32; OLD]]) {
        let rows = self.rows.get_mut(..self.count).unwrap_or_default();
        (rows, self.old.get_mut(..self.old_count).unwrap_or_default())
    }

    /// Says which contact comes at a rank.
    pub(super) fn set_order(&mut self, rank: usize, number: usize) {
        if let Some([order, ..]) = self.old.get_mut(rank) {
            *order = number as f32;
        }
    }

    /// Says that no contact comes from a rank on, for those who read them in another view of the slab.
    pub(super) fn end_order(&mut self, rank: usize) {
        if let Some([order, ..]) = self.old.get_mut(rank) {
            *order = -1.0;
        }
    }

    /// Finds the order that sweeps go in: by rank too, but the middles of patches first.
    pub(super) fn middles_first(&mut self) {
        let mut place = 0;
        for middles in [true, false] {
            for rank in 0..self.count {
                let Some([number, ..]) = self.old.get(rank).copied() else { break };
                let row = self.rows.get(number as usize);
                if row.is_some_and(|row| Contact::is_middle(row) == middles) {
                    if let Some([_, swept, ..]) = self.old.get_mut(place) {
                        *swept = number;
                    }
                    place += 1;
                }
            }
            if middles {
                self.middles = place;
            }
        }
    }

    /// Says that so many units rest on nothing, once contacts are in order.
    pub(super) fn rest_on_nothing(&mut self, units: usize) {
        self.old.iter_mut().take(units).for_each(|[_, _, _, rests, ..]| *rests = 0.0);
    }

    /// What a unit rests on.
    pub(super) fn rests_on(&self, unit: usize) -> f32 {
        self.old.get(unit).map_or(0.0, |[_, _, _, rests, ..]| *rests)
    }

    /// Says that a unit rests on so many more.
    pub(super) fn rest_on(&mut self, unit: usize, more: f32) {
        if let Some([_, _, _, rests, ..]) = self.old.get_mut(unit) {
            *rests += more;
        }
    }

    /// Contacts that are the middle of a patch: the first ones that are [`swept`](Self::swept).
    pub(super) fn middles(&self) -> usize {
        self.middles
    }

    /// The contact at a place of the order that sweeps go in.
    #[inline]
    pub(super) fn swept(&mut self, place: usize) -> Option<&mut [f32; CONTACT]> {
        let [_, number, ..] = self.old.get(place)?;
        self.rows.get_mut(*number as usize)
    }

    /// The contact at a rank; none after the last one.
    #[inline]
    pub(super) fn ordered(&mut self, rank: usize) -> Option<&mut [f32; CONTACT]> {
        let [order, ..] = self.old.get(rank).filter(|[order, ..]| *order >= 0.0)?;
        self.rows.get_mut(*order as usize)
    }

    /// Finds the contacts of a substep. The ones there were are those of the substep before. What has no room is left out:
    /// planes come first.
    #[cfg_attr(rigidformer_dsp, inline(never))]
    pub(super) fn find<S: Schedule>(
        &mut self,
        schedule: S,
        world: &World<'_>,
        bodies: &Bodies<'_>,
    ) {
        for (row, old) in self.rows.iter().take(self.count).zip(self.old.iter_mut()) {
            Old::new(&Contact::read(row)).write(old);
        }
        self.old_count = self.count;
        self.count = 0;
        for (to, unit) in world.units.iter().enumerate().filter(|(_, unit)| unit.is_free()) {
            if bodies.is_left_out(to) {
                continue;
            }
            for plane in world.planes().iter().enumerate() {
                self.with_plane(world, bodies, (to, unit), plane);
            }
            #[cfg(feature = "terrain")]
            self.with_terrain(world, bodies, (to, unit));
        }
        #[cfg(rigidformer_host)]
        if schedule.shares() && !self.slots.is_empty() {
            return self.find_together(schedule, world, bodies);
        }
        let _ = schedule;
        // Both lists have their pairs in one order: none is looked at twice.
        let mut place = 0;
        for (from, unit) in world.units.iter().enumerate() {
            if bodies.is_left_out(from) {
                continue;
            }
            for (to, other) in partners(world, bodies, from) {
                // Two units that nothing moves exchange no impulses, and units of one body do not collide.
                let moves = unit.is_free() || other.is_free();
                if moves && (unit.body == 0 || unit.body != other.body) {
                    self.with_unit(world, bodies, [(from, unit), (to, other)], &mut place);
                }
            }
        }
    }

    /// The normal that a pair had in the substep before; `next` is where the search goes on.
    fn known(&self, place: Place, next: &mut usize) -> Option<Vector3<f32>> {
        for row in self.old().iter().skip(*next) {
            let old = Old::read(row);
            let (from, to) = old.pair;
            let there = (from, to, old.piece);
            if there >= place {
                return (there == place).then_some(old.normal);
            }
            *next += 1;
        }
        None
    }

    #[cfg_attr(rigidformer_dsp, inline(never))]
    fn with_plane(
        &mut self,
        world: &World<'_>,
        bodies: &Bodies<'_>,
        (to, unit): (usize, &UnitSlot),
        (number, plane): (usize, &Plane),
    ) {
        let (mover, pose) = (bodies.mover_there(to), bodies.pose(to));
        let normal = plane.normal;
        let height = plane.height_here(&pose.centre);
        let whirl = norm(&mover.spin) * unit.radius * world.substep_s;
        let sink = (-dot(&normal, &mover.velocity)).max(0.0) * world.substep_s;
        let reach = sink + whirl + FACE * unit.radius;
        // Most units are far from most planes: a sphere says so without the hull.
        if height - unit.radius > reach {
            return;
        }
        let local = rotate_back(&pose.rotation, &normal);
        let points = world.hull_of(unit).iter();
        let round = world.round(unit);
        let height = height - round;
        let down = local * round;
        let points = points.map(|point| (point.coords - down, dot(&point.coords, &local) + height));
        let mut patch = patch::choose(points.filter(|(_, gap)| *gap < reach), &local);
        for (point, _) in &mut patch.points {
            *point = rotate(&pose.rotation, point);
        }
        let pair = Pair {
            from: None,
            to,
            piece: 0,
            apart: Vector3::zeros(),
            normal,
            skin: 0.0,
            friction: unit.physics.friction * plane.friction,
            restitution: restitution(world, unit.physics.restitution * plane.restitution),
            give: world.give_on(unit, number),
            bounces: world.bounces(unit.radius),
        };
        self.add(world, bodies, &pair, &patch);
    }

    #[cfg(feature = "terrain")]
    #[cfg_attr(rigidformer_dsp, inline(never))]
    fn with_terrain(
        &mut self,
        world: &World<'_>,
        bodies: &Bodies<'_>,
        (to, unit): (usize, &UnitSlot),
    ) {
        let Some(terrain) = &world.terrain else { return };
        let (mover, pose) = (bodies.mover_there(to), bodies.pose(to));
        let way = mover.velocity * world.substep_s;
        let margin = norm(&mover.spin) * unit.radius * world.substep_s + FACE * unit.radius;
        if pose.centre.z - unit.radius - (norm(&way) + margin) > terrain.highest {
            return;
        }
        let visitor = Visitor {
            terrain: terrain.surface.from(&pose.centre),
            radius: unit.radius,
            round: world.round(unit),
            way,
            margin,
            skin: world.skin(unit.radius),
            dip: terrain.surface.least_dip(unit.radius),
        };
        let mut touches = Touches::new(unit.radius);
        for number in 0..world.pieces(unit) {
            visitor.find(&world.piece(unit, number), &pose, &mut touches);
        }
        let pair = Pair {
            from: None,
            to,
            piece: 0,
            apart: Vector3::zeros(),
            normal: Vector3::zeros(),
            skin: 0.25 * world.skin(unit.radius),
            friction: unit.physics.friction * terrain.friction,
            restitution: restitution(world, unit.physics.restitution * terrain.restitution),
            give: world.give_alone(unit),
            bounces: world.bounces(unit.radius),
        };
        touches.each_patch(|normal, patch| {
            self.add(world, bodies, &Pair { normal: *normal, ..pair }, patch);
        });
    }

    #[cfg_attr(rigidformer_dsp, inline(never))]
    fn with_unit(
        &mut self,
        world: &World<'_>,
        bodies: &Bodies<'_>,
        [(from, unit), (to, other)]: [(usize, &UnitSlot); 2],
        place: &mut usize,
    ) {
        let poses = [bodies.pose(from), bodies.pose(to)];
        let units = [(from, unit), (to, other)];
        let Some(approach) = Approach::of(world, bodies, units, &poses) else { return };
        for a in 0..world.pieces(unit) {
            for b in 0..world.pieces(other) {
                let (pieces, piece) = ([a, b], a * MAX_PIECES + b);
                let Some(between) = approach.between(world, &poses, pieces) else { continue };
                let known = self.known((Some(from), to, piece), place);
                if let Some((normal, patch)) =
                    approach.meet(world, (&poses, pieces), (&between, known))
                {
                    self.add(world, bodies, &Pair { normal, piece, ..approach.pair }, &patch);
                }
            }
        }
    }

    /// As [`find`](Self::find) goes on after planes, on several threads: who finds what is no difference, and contacts come in the
    /// order of pairs.
    #[cfg(rigidformer_host)]
    fn find_together<S: Schedule>(&mut self, schedule: S, world: &World<'_>, bodies: &Bodies<'_>) {
        let slots = core::mem::take(&mut self.slots);
        let (mut place, mut count) = (0, 0);
        for (from, unit) in world.units.iter().enumerate() {
            if bodies.is_left_out(from) {
                continue;
            }
            for (to, other) in partners(world, bodies, from) {
                let moves = unit.is_free() || other.is_free();
                if !moves || (unit.body != 0 && unit.body == other.body) {
                    continue;
                }
                let units = [(from, unit), (to, other)];
                let poses = [bodies.pose(from), bodies.pose(to)];
                let Some(approach) = Approach::of(world, bodies, units, &poses) else { continue };
                for a in 0..world.pieces(unit) {
                    for b in 0..world.pieces(other) {
                        if approach.between(world, &poses, [a, b]).is_none() {
                            continue;
                        }
                        if count == slots.len() {
                            self.look(schedule, world, bodies, slots);
                            count = 0;
                        }
                        let known = self.known((Some(from), to, a * MAX_PIECES + b), &mut place);
                        if let Some(slot) = slots.get_mut(count) {
                            let n = known.unwrap_or_default();
                            let asked = [
                                from as f32,
                                to as f32,
                                with_piece(a, b),
                                has(known),
                                n.x,
                                n.y,
                                n.z,
                            ];
                            slot.iter_mut().zip(asked).for_each(|(slot, number)| *slot = number);
                            count += 1;
                        }
                    }
                }
            }
        }
        self.look(schedule, world, bodies, slots.get_mut(..count).unwrap_or_default());
        self.slots = slots;
    }

    /// Looks at pairs, on several threads, and adds their contacts in order.
    #[cfg(rigidformer_host)]
    fn look<S: Schedule>(
        &mut self,
        schedule: S,
        world: &World<'_>,
        bodies: &Bodies<'_>,
        slots: &mut [[f32; SLOT]],
    ) {
        let rows = slots.as_flattened_mut();
        schedule.each_row(rows, SLOT, SLOT_COST, &mut [], |_, slot, _| {
            let Some((asked, answer)) = slot.split_first_chunk_mut::<7>() else { return };
            let [_, _, _, is_known, x, y, z] = *asked;
            let known = (is_known > 0.0).then(|| Vector3::new(x, y, z));
            let found = asked_of(world, bodies, asked).and_then(|(approach, poses, pieces)| {
                let between = approach.between(world, &poses, pieces)?;
                approach.meet(world, (&poses, pieces), (&between, known))
            });
            answer.fill(0.0);
            let Some((normal, patch)) = found else { return };
            let Some(([count, middle, x, y, z], points)) = answer.split_first_chunk_mut() else {
                return;
            };
            (*count, *middle) = (patch.points.len() as f32, f32::from(u8::from(patch.has_middle)));
            (*x, *y, *z) = (normal.x, normal.y, normal.z);
            for (row, (point, gap)) in points.as_chunks_mut().0.iter_mut().zip(&patch.points) {
                *row = [point.x, point.y, point.z, *gap];
            }
        });
        for slot in slots {
            let Some((asked, answer)) = slot.split_first_chunk::<7>() else { continue };
            let Some(([count, middle, x, y, z], points)) = answer.split_first_chunk() else {
                continue;
            };
            // At most `POINTS`.
            let count = *count as usize;
            if count == 0 {
                continue;
            }
            let Some((approach, _, [a, b])) = asked_of(world, bodies, asked) else { continue };
            let mut patch = Patch { has_middle: *middle > 0.0, ..Patch::default() };
            for [x, y, z, gap] in points.as_chunks().0.iter().take(count) {
                let _ = patch.points.push((Vector3::new(*x, *y, *z), *gap));
            }
            let (normal, piece) = (Vector3::new(*x, *y, *z), a * MAX_PIECES + b);
            self.add(world, bodies, &Pair { normal, piece, ..approach.pair }, &patch);
        }
    }

    /// Makes contacts of a patch's points, counted from the first unit's centre, or from the only one's: as many as there
    /// is room for.
    #[cfg_attr(rigidformer_dsp, inline(never))]
    fn add(&mut self, world: &World<'_>, bodies: &Bodies<'_>, pair: &Pair, patch: &Patch) {
        let tangent = tangent(&pair.normal);
        let from = pair.from.map_or(Mover::STILL, |from| bodies.mover(from));
        let to = bodies.mover(pair.to);
        // Those of a cluster are counted from its centre.
        let shifts = [pair.from.and_then(|from| bodies.arm(from)), bodies.arm(pair.to)];
        let rounding = gap_rounding(world, bodies, pair);
        let spring = world.spring(&pair.give);
        for (number, (point, gap)) in patch.points.iter().enumerate() {
            // The corners of a patch have its springs.
            if spring.is_some() && patch.has_middle && number == 0 {
                continue;
            }
            let Some(row) = self.rows.get_mut(self.count) else { return };
            // What pushes a plane turns nothing, whatever the arm.
            let mut arms = [*point, point - pair.apart];
            for (arm, shift) in arms.iter_mut().zip(&shifts) {
                if let Some(shift) = shift {
                    *arm += shift;
                }
            }
            let [own, other] = arms;
            let relative = to.speed_at(&other) - from.speed_at(&own);
            let approach = dot(&relative, &pair.normal);
            let rebound = if approach < -pair.bounces { -pair.restitution * approach } else { 0.0 };
            let is_middle = patch.has_middle && number == 0;
            let is_pyramid = world.has_pyramids() && rebound > 0.0 && spring.is_none();
            let tangent = match is_pyramid {
                true => along_sliding(&relative, &pair.normal, approach).unwrap_or(tangent),
                false => tangent,
            };
            let mut contact = Contact {
                impulse: [0.0; 3],
                from: pair.from,
                to: pair.to,
                piece: pair.piece,
                held: Held::Neither,
                is_middle,
                arms,
                gap: gap - pair.skin - rounding,
                friction: if is_pyramid { -pair.friction } else { pair.friction },
                rebound,
                normal: pair.normal,
                tangent: if is_middle { Vector3::zeros() } else { tangent },
                weight: [0.0; 3],
                stiffness: 1.0,
            };
            contact.weight = contact.axes().map(|axis| {
                weight(to.inverse_mass_at(&other, &axis) + from.inverse_mass_at(&own, &axis))
            });
            if contact.is_middle {
                let arm = patch.mean_arm(&pair.normal);
                let soft = to.turn_along(&pair.normal) + from.turn_along(&pair.normal);
                let [_, across, _] = contact.weight;
                // A small patch turns freely, and keeps its friction for sliding.
                let heavy = weight(arm * arm * soft).min(across);
                contact.tangent = Vector3::new(arm, 0.0, heavy);
            }
            if let Some(spring) = &spring {
                contact.give_way(spring, world.substep_s);
            }
            contact.write(row);
            self.count += 1;
        }
    }
}

/// The units behind one that may touch it in the substep, with their numbers: all, on microcontrollers.
fn partners<'a>(
    world: &'a World<'_>,
    bodies: &'a Bodies<'_>,
    from: usize,
) -> impl Iterator<Item = (usize, &'a UnitSlot)> {
    let behind = world.units.iter().enumerate().skip(from + 1);
    #[cfg(rigidformer_host)]
    return behind.filter(move |(to, _)| bodies.may_meet(from, *to));
    #[cfg(not(rigidformer_host))]
    {
        let _ = bodies;
        behind
    }
}

/// 1 where there is something.
#[cfg(rigidformer_host)]
fn has<T>(some: Option<T>) -> f32 {
    if some.is_some() { 1.0 } else { 0.0 }
}

/// The pair that a slot asks of, and its pieces.
#[cfg(rigidformer_host)]
fn asked_of<'a>(
    world: &World<'a>,
    bodies: &Bodies<'_>,
    [from, to, pieces, ..]: &[f32; 7],
) -> Option<(Approach<'a>, [Pose; 2], [usize; 2])> {
    let (from, to) = (*from as usize, *to as usize);
    let units = [(from, world.units.get(from)?), (to, world.units.get(to)?)];
    let pieces = [*pieces as usize, piece_of(*pieces)];
    let poses = [bodies.pose(from), bodies.pose(to)];
    Some((Approach::of(world, bodies, units, &poses)?, poses, pieces))
}

/// Two units that may touch in the substep, and how they close in.
struct Approach<'a> {
    units: [&'a UnitSlot; 2],
    /// m/s
    closing: Vector3<f32>,
    /// How far they come closer in the substep at most, and what is allowed besides, metres.
    way: f32,
    margin: f32,
    pair: Pair,
}

impl<'a> Approach<'a> {
    /// None where their bounding spheres are too far apart.
    #[cfg_attr(not(rigidformer_host), inline(always))]
    fn of(
        world: &World<'_>,
        bodies: &Bodies<'_>,
        [(from, unit), (to, other)]: [(usize, &'a UnitSlot); 2],
        poses: &[Pose; 2],
    ) -> Option<Self> {
        let [mine, theirs] = [bodies.mover_there(from), bodies.mover_there(to)];
        let [Pose { centre: here, .. }, Pose { centre: there, .. }] = poses;
        let apart = there - here;
        let closing = mine.velocity - theirs.velocity;
        let whirl = norm(&mine.spin) * unit.radius + norm(&theirs.spin) * other.radius;
        let small = unit.radius.min(other.radius);
        let margin = whirl * world.substep_s + FACE * small;
        let room = (norm(&apart) - unit.radius) - other.radius;
        if room > norm(&closing) * world.substep_s + margin {
            return None;
        }
        let way = norm(&closing) * world.substep_s;
        let pair = Pair {
            from: Some(from),
            to,
            piece: 0,
            apart,
            normal: Vector3::zeros(),
            skin: world.skin(small),
            friction: unit.physics.friction * other.physics.friction,
            restitution: restitution(world, unit.physics.restitution * other.physics.restitution),
            give: world.give(unit, other),
            bounces: world.bounces(small),
        };
        Some(Approach { units: [unit, other], closing, way, margin, pair })
    }

    /// From the middle of a piece of the first to that of one of the second; none where those are too far apart.
    #[cfg_attr(not(rigidformer_host), inline(always))]
    fn between(
        &self,
        world: &World<'_>,
        poses: &[Pose; 2],
        [a, b]: [usize; 2],
    ) -> Option<Vector3<f32>> {
        let [unit, other] = self.units;
        if unit.pieces == 0 && other.pieces == 0 {
            return Some(self.pair.apart);
        }
        let pieces = [world.piece(unit, a), world.piece(other, b)];
        let between = between(&pieces, poses);
        let [mine, theirs] = &pieces;
        let too_far = (norm(&between) - mine.radius) - theirs.radius > self.way + self.margin;
        (!too_far).then_some(between)
    }

    /// Where two of their pieces touch or are about to, and the normal there.
    #[cfg_attr(not(rigidformer_host), inline(always))]
    fn meet(
        &self,
        world: &World<'_>,
        (poses, [a, b]): (&[Pose; 2], [usize; 2]),
        ways: (&Vector3<f32>, Option<Vector3<f32>>),
    ) -> Option<(Vector3<f32>, Patch)> {
        let [unit, other] = self.units;
        let pieces = [world.piece(unit, a), world.piece(other, b)];
        let motion = (&self.closing, world.substep_s, self.margin);
        meet(world, self.units, (pieces, poses), ways, motion, &self.pair)
    }
}

/// From the middle of one piece to that of another, in the world.
pub(super) fn between([mine, theirs]: &[Piece<'_>; 2], [here, there]: &[Pose; 2]) -> Vector3<f32> {
    let [own, other] =
        [(mine, here), (theirs, there)].map(|(piece, pose)| rotate(&pose.rotation, &piece.middle));
    (there.centre - here.centre) + (other - own)
}

/// Where two pieces touch or are about to, and the normal there. `motion` is how their units close in, for how long, and
/// what is allowed besides.
#[cfg_attr(rigidformer_dsp, inline(never))]
fn meet(
    world: &World<'_>,
    units: [&UnitSlot; 2],
    (pieces, poses): ([Piece<'_>; 2], &[Pose; 2]),
    (between, known): (&Vector3<f32>, Option<Vector3<f32>>),
    (closing, substep_s, margin): (&Vector3<f32>, f32, f32),
    pair: &Pair,
) -> Option<(Vector3<f32>, Patch)> {
    let ([mine, theirs], [here, there]) = (&pieces, poses);
    let hulls = [
        &Hull { points: mine.points, rotation: here.rotation },
        &Hull { points: theirs.points, rotation: there.rotation },
    ];
    if hulls.iter().any(|hull| hull.points.is_empty()) {
        return None;
    }
    let [unit, other] = units;
    let (small, radii) = (unit.radius.min(other.radius), unit.radius + other.radius);
    let far = norm(closing) * substep_s + margin;
    let rounds = units.map(|unit| world.round(unit));
    let ways = (&pair.apart, between, known);
    let met = meeting(hulls, rounds, ways, [small, radii, far]);
    let Meeting { gap, normal, middle } = met;
    if gap > dot(closing, &normal).max(0.0) * substep_s + margin {
        return None;
    }
    let patch = touching(hulls, [unit.radius, other.radius], &pair.apart, (&met, pair.skin));
    let patch = patch.unwrap_or_else(|| {
        let mut patch = Patch::default();
        let _ = patch.points.push((middle, gap));
        patch
    });
    Some((normal, patch))
}

/// What rounding may make of the gaps of a pair, metres.
#[cfg_attr(rigidformer_dsp, inline(never))]
fn gap_rounding(world: &World<'_>, bodies: &Bodies<'_>, pair: &Pair) -> f32 {
    let (mut most, mut radius) = (0.0_f32, f32::INFINITY);
    for number in [Some(pair.to), pair.from].into_iter().flatten() {
        // No more than two units' heights along the normal make a gap, or a height and a plane's offset, which is as far.
        let places = bodies.pose(number).centre;
        let heights = places.iter().zip(pair.normal.iter()).map(|(v, n)| v.abs() * n.abs());
        most = most.max(heights.fold(0.0, |sum, height| sum + height));
        radius = radius.min(world.units.get(number).map_or(0.0, |unit| unit.radius));
    }
    world.gap_rounding(most, radius)
}

/// The weight of what gives so much way, kg; 0 of what nothing moves.
fn weight(soft: f32) -> f32 {
    if soft > 0.0 { 1.0 / soft } else { 0.0 }
}

/// What a pair bounces with, by the contact law: the product of the two, and more.
fn restitution(world: &World<'_>, product: f32) -> f32 {
    let offset = world.scene.contact_law.restitution_offset;
    // What gains by a bounce does so by no more than its own coefficients say.
    if offset > 0.0 { (product + offset).min(product.max(1.0)) } else { product }
}

/// The direction of sliding at a contact; none where it is slow beside the approach.
fn along_sliding(
    relative: &Vector3<f32>,
    normal: &Vector3<f32>,
    approach: f32,
) -> Option<Vector3<f32>> {
    let sliding = relative - normal * approach;
    let speed = math::sqrt(dot(&sliding, &sliding));
    (speed > SLIDES * -approach).then(|| sliding / speed)
}
