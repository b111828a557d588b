//! The parts of an index, and what is read of them.

use super::layout::{Boxes, Found, Frame, Head, Line, NO_PLANE, Owner, Room, WIDTH, bits};
use super::tree::{self, Shape};
use crate::contact::ground::Plane;
use crate::geometry::Nearest;
use nalgebra::Point3;

/// The parts of the slice that an index lies in.
pub(crate) struct Parts<'a> {
    pub(super) lines: &'a mut [Line],
    pub(super) found: &'a mut [Found],
    pub(super) groups: &'a mut [Boxes],
    pub(super) frames: &'a mut [Frame],
    pub(super) heads: &'a mut [Head],
    pub(super) owners: &'a mut [Owner],
    /// Of each point of a copy, the bits of its place among those of all leaves.
    pub(super) slots: &'a mut [f32],
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
            let tree = [bits(points.len()), bits(start), bits(leaf)];
            let [count, start, leaf] = tree;
            *head = [a, b, c, d, e, f, count, start, leaf];
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
    pub(crate) fn search(self, per_copy: usize, planes: &'a [Plane]) -> (Index<'a>, &'a mut [f32]) {
        let Parts { lines, found, groups, frames, heads, owners, .. } = self;
        let leaves = leaves(heads, per_copy);
        let index = Index { lines, groups, frames, heads, owners, planes, per_copy, leaves };
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

/// Trees and boxes of a scene and its copies, as a search reads them.
#[derive(Clone, Copy, Debug)]
pub struct Index<'a> {
    pub(super) lines: &'a [Line],
    pub(super) groups: &'a [Boxes],
    pub(super) frames: &'a [Frame],
    pub(super) heads: &'a [Head],
    pub(super) owners: &'a [Owner],
    pub(super) planes: &'a [Plane],
    /// Units of a copy.
    pub(super) per_copy: usize,
    /// Leaves of a copy.
    pub(super) leaves: usize,
}

impl Index<'_> {
    /// The index in the scene of the unit of a row of answers.
    pub(crate) fn unit(&self, row: usize) -> Option<usize> {
        let leaves = self.leaves.max(1);
        let [unit, _] = self.owners.get(row % leaves)?;
        Some(row / leaves * self.per_copy + unit.to_bits() as usize)
    }

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

    /// What is nearest to a point of unit `own`, of which the number in its copy is given.
    pub(crate) fn nearest(&self, own: usize, point: usize) -> Nearest {
        self.find(own, point).unwrap_or(Nearest::Nothing)
    }

    fn find(&self, own: usize, point: usize) -> Option<Nearest> {
        let copy = own / self.per_copy.max(1);
        let slot = self.slots.get(point)?.to_bits() as usize;
        let [units, numbers] = self.found.get(copy * self.leaves + slot / WIDTH)?;
        let (unit, number) = (units.get(slot % WIDTH)?, numbers.get(slot % WIDTH)?);
        Some(match ((unit.to_bits() as usize).checked_sub(1), number.to_bits()) {
            (Some(unit), number) => {
                Nearest::Point { unit: copy * self.per_copy + unit, point: number as usize }
            }
            (None, NO_PLANE) => Nearest::Nothing,
            (None, number) => Nearest::Plane(number as usize),
        })
    }
}
