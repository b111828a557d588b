//! The nearest point without trying all points: a tree over each unit's points, which a rigid
//! unit keeps, and a box around each unit, which every step moves.
//!
//! The answer is that of brute force, bit for bit: `search` says why. All of it lies in one slice
//! of f32 numbers, in groups of [`WIDTH`], so that one pass over arrays of that length bounds or
//! measures a whole group:
//!
//! - a **leaf** is [`WIDTH`] points: x, y, z and the point's number in its unit;
//! - a **node** is the boxes of [`WIDTH`] leaves, a **root** those of [`WIDTH`] nodes;
//! - a **group** is the boxes of [`WIDTH`] units in the world.
//!
//! A unit's tree is its roots, its nodes, its leaves; where one node or leaf is all, nothing is
//! above it.

mod bounds;
mod place;
mod search;
#[cfg(test)]
mod tests;
mod tree;

pub(crate) use search::nearest;

use nalgebra::Point3;
use tree::Shape;

/// Points of a leaf, and boxes of whatever is above.
const WIDTH: usize = 16;

/// [`WIDTH`] numbers.
type Line = [f32; WIDTH];
/// x, y, z, and the bits of the point's number in its unit, ascending. A point is there twice or more
/// where the unit has too few.
type Leaf = [Line; 4];
/// Least x, y, z, largest x, y, z: what is not there has an empty box, infinitely far.
type Boxes = [Line; 6];
/// A unit's local box, least then largest; the bits of how many points it has, of its tree's
/// first line and of how many leaves there are before its own.
type Head = [f32; 9];
/// Rotation row by row, then centre.
type Frame = [f32; 12];
/// The bits of a leaf's unit and first line.
type Owner = [f32; 2];
/// The bits of one more than the unit (0: the ground) that is nearest to each point of a leaf, and
/// of the point's number in it.
type Found = [Line; 2];

/// How much an index holds: units and points of a copy, copies.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Room {
    pub(crate) units: usize,
    pub(crate) points: usize,
    pub(crate) copies: usize,
}

impl Room {
    /// f32 numbers of an index with this room.
    pub(crate) const fn numbers(&self) -> usize {
        let mut sum = 0_usize;
        let mut rest: &[usize] = &self.lengths();
        while let [first, tail @ ..] = rest {
            sum = sum.saturating_add(*first);
            rest = tail;
        }
        sum
    }

    /// Numbers of its parts, in the order of [`Parts`].
    const fn lengths(&self) -> [usize; 7] {
        let Room { units, points, copies } = *self;
        let groups = units.div_ceil(WIDTH).saturating_mul(copies);
        [
            self.lines().saturating_mul(WIDTH),
            self.leaves().saturating_mul(copies).saturating_mul(size_of::<Found>() / 4),
            groups.saturating_mul(size_of::<Boxes>() / 4),
            units.saturating_mul(copies).saturating_mul(size_of::<Frame>() / 4),
            units.saturating_mul(size_of::<Head>() / 4),
            self.leaves().saturating_mul(size_of::<Owner>() / 4),
            points,
        ]
    }

    /// Leaves of a copy, at most: the last one of each unit may have room to spare.
    const fn leaves(&self) -> usize {
        (self.points / WIDTH).saturating_add(self.units)
    }

    /// Lines that the trees take, at most: as with leaves, but only units of more than a leaf have
    /// nodes, of more than a node roots.
    const fn lines(&self) -> usize {
        let Room { units, points, .. } = *self;
        let leaves = self.leaves();
        let nodes = leaves / WIDTH + least(units, points / WIDTH);
        let roots = nodes / WIDTH + least(units, points / (WIDTH * WIDTH));
        leaves.saturating_mul(4).saturating_add((nodes + roots).saturating_mul(6))
    }
}

const fn least(a: usize, b: usize) -> usize {
    if a < b { a } else { b }
}

fn bits(number: usize) -> f32 {
    // Nothing is computed with it, and it is no NaN: 2^31 points do not fit in memory.
    f32::from_bits(number as u32)
}

/// The parts of the slice that an index lies in.
pub(crate) struct Parts<'a> {
    lines: &'a mut [Line],
    found: &'a mut [Found],
    groups: &'a mut [Boxes],
    frames: &'a mut [Frame],
    heads: &'a mut [Head],
    owners: &'a mut [Owner],
    /// Of each point of a copy, the bits of its place among those of all leaves.
    slots: &'a mut [f32],
}

impl<'a> Parts<'a> {
    /// Behind the scratch of the farthest-point ordering, `slab` has as many numbers as `room`
    /// says.
    pub(crate) fn new(slab: &'a mut [f32], room: &Room) -> Self {
        let mut rest = slab.get_mut(room.points..).unwrap_or_default();
        let [lines, found, groups, frames, heads, owners, slots] = room.lengths().map(|length| {
            let all = core::mem::take(&mut rest);
            let (part, others) = all.split_at_mut(length.min(all.len()));
            rest = others;
            part
        });
        Parts {
            lines: lines.as_chunks_mut().0,
            found: found.as_chunks_mut().0.as_chunks_mut().0,
            groups: groups.as_chunks_mut().0.as_chunks_mut().0,
            frames: frames.as_chunks_mut().0,
            heads: heads.as_chunks_mut().0,
            owners: owners.as_chunks_mut().0,
            slots,
        }
    }

    /// Builds the tree of a unit, whose number in the scene is `unit` and whose first point's
    /// `first`, after those of all before.
    pub(crate) fn add(&mut self, unit: usize, first: usize, points: &[Point3<f32>]) {
        let before = unit.checked_sub(1).and_then(|before| self.heads.get(before));
        let (start, leaf) = before.map_or((0, 0), after);
        let shape = Shape::new(points.len());
        let lines = self.lines.get_mut(start..start + shape.lines()).unwrap_or_default();
        let [[a, b, c], [d, e, f]] = tree::build(lines, &shape, points);
        if let Some(head) = self.heads.get_mut(unit) {
            *head = [a, b, c, d, e, f, bits(points.len()), bits(start), bits(leaf)];
        }
        let slots = self.slots.get_mut(first..).unwrap_or_default();
        let (leaves, _) = lines.get(shape.boxes() * 6..).unwrap_or_default().as_chunks::<4>();
        let owners = self.owners.get_mut(leaf..).unwrap_or_default();
        for ((i, [.., numbers]), owner) in leaves.iter().enumerate().zip(owners) {
            *owner = [bits(unit), bits(start + shape.boxes() * 6 + i * 4)];
            for (lane, number) in numbers.iter().enumerate() {
                if let Some(slot) = slots.get_mut(number.to_bits() as usize) {
                    *slot = bits((leaf + i) * WIDTH + lane);
                }
            }
        }
    }

    /// What is read in a search, of a scene of so many units a copy that was added and placed, and
    /// a row for the answers of each leaf of each copy.
    pub(crate) fn search(self, per_copy: usize) -> (Index<'a>, &'a mut [f32]) {
        let Parts { lines, found, groups, frames, heads, owners, .. } = self;
        let leaves = leaves(heads, per_copy);
        let index = Index { lines, groups, frames, heads, owners, per_copy, leaves };
        (index, found.as_flattened_mut().as_flattened_mut())
    }

    /// What was found for the points of a scene of so many units a copy.
    pub(crate) fn answers(self, per_copy: usize) -> Answers<'a> {
        let leaves = leaves(self.heads, per_copy);
        Answers { found: self.found, slots: self.slots, per_copy, leaves }
    }
}

/// The first line and the first leaf after those of a unit.
fn after([.., count, start, leaf]: &Head) -> (usize, usize) {
    let shape = Shape::new(count.to_bits() as usize);
    (start.to_bits() as usize + shape.lines(), leaf.to_bits() as usize + shape.leaves)
}

/// Leaves of so many units.
fn leaves(heads: &[Head], units: usize) -> usize {
    units.checked_sub(1).and_then(|last| heads.get(last)).map_or(0, |last| after(last).1)
}

/// Numbers of a row of answers: those of a leaf.
pub(crate) const ROW: usize = 2 * WIDTH;

/// Trees and boxes of a scene and its copies, as a search reads them.
#[derive(Clone, Copy, Debug)]
pub struct Index<'a> {
    lines: &'a [Line],
    groups: &'a [Boxes],
    frames: &'a [Frame],
    heads: &'a [Head],
    owners: &'a [Owner],
    /// Units of a copy.
    per_copy: usize,
    /// Leaves of a copy.
    leaves: usize,
}

impl Index<'_> {
    /// Rows of answers: leaves of so many copies.
    pub(crate) fn rows(&self, copies: usize) -> usize {
        self.leaves * copies
    }
}

/// What is nearest to each point.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Answers<'a> {
    found: &'a [Found],
    slots: &'a [f32],
    per_copy: usize,
    leaves: usize,
}

impl Answers<'_> {
    /// Of no points.
    pub(crate) const EMPTY: Answers<'static> =
        Answers { found: &[], slots: &[], per_copy: 0, leaves: 0 };

    /// The unit, and the number of the point in it, that is nearest to a point of unit `own`, of
    /// which the number in its copy is given; none where that is the ground.
    pub(crate) fn nearest(&self, own: usize, point: usize) -> Option<(usize, usize)> {
        let copy = own / self.per_copy.max(1);
        let slot = self.slots.get(point)?.to_bits() as usize;
        let [units, numbers] = self.found.get(copy * self.leaves + slot / WIDTH)?;
        let (unit, number) = (units.get(slot % WIDTH)?, numbers.get(slot % WIDTH)?);
        let unit = (unit.to_bits() as usize).checked_sub(1)?;
        Some((copy * self.per_copy + unit, number.to_bits() as usize))
    }
}
