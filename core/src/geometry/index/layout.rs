//! How an index lies in a slice of f32 numbers, and how much room it takes.

/// Points of a leaf, and boxes of whatever is above.
pub(super) const WIDTH: usize = 16;

/// [`WIDTH`] numbers.
pub(super) type Line = [f32; WIDTH];
/// x, y, z, and the bits of the point's number in its unit, ascending. A point is there twice or more
/// where the unit has too few.
pub(super) type Leaf = [Line; 4];
/// Least x, y, z, largest x, y, z: what is not there has an empty box, infinitely far.
pub(super) type Boxes = [Line; 6];
/// A unit's local box, least then largest; the bits of how many points it has, of its tree's
/// first line, and of how many leaves there are before its own.
pub(super) type Head = [f32; 9];
/// Rotation row by row, then centre, and the bits of the unit's body (0: its own), which is not the same in all copies.
pub(super) type Frame = [f32; 13];
/// The bits of a leaf's unit and first line.
pub(super) type Owner = [f32; 2];
/// The bits of one more than the unit (0: a plane) that is nearest to each point of a leaf, and
/// of the number of the point in it, or of the plane ([`NO_PLANE`]: there is nothing).
pub(super) type Found = [Line; 2];

/// In the place of a plane's number: there is none.
pub(super) const NO_PLANE: u32 = 255;

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

    /// Numbers of its parts, in the order of [`Parts`](super::Parts).
    pub(super) const fn lengths(&self) -> [usize; 7] {
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
    pub(super) const fn lines(&self) -> usize {
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

/// A whole number in the place of an f32.
pub(super) fn bits(number: usize) -> f32 {
    // Nothing is computed with it, and it is no NaN: 2^31 points do not fit in memory.
    f32::from_bits(number as u32)
}

/// Numbers of a row of answers: those of a leaf.
pub(crate) const ROW: usize = 2 * WIDTH;
