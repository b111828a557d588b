//! Lower bounds of the distances to boxes, and the best so far: what `search` compares.

use super::layout::{Boxes, Line, NO_PLANE, WIDTH};
use crate::contact::ground::Plane;

/// Bits of a bound that hold its lane.
const LANE: u32 = WIDTH as u32 - 1;

/// x, y, z of a leaf's points, the queries, each a lane.
pub(super) type Queries = [Line; 3];

/// The least candidates so far, lane by lane.
pub(super) struct Best {
    distance2: Line,
    /// 0 for a plane, or one more than the unit.
    pub(super) unit: [u32; WIDTH],
    pub(super) number: [u32; WIDTH],
}

impl Best {
    /// The nearest planes, as [`nearest_plane`](crate::contact::ground::nearest_plane) has them, step by step.
    #[inline(always)]
    pub(super) fn new([xs, ys, zs]: &Queries, planes: &[Plane]) -> Self {
        let (mut distance2, mut number) = ([f32::INFINITY; WIDTH], [NO_PLANE; WIDTH]);
        for (i, plane) in (0..).zip(planes) {
            let (normal, offset) = (&plane.normal, plane.offset_m);
            let lanes = xs.iter().zip(ys).zip(zs).zip(distance2.iter_mut().zip(&mut number));
            for (((x, y), z), (best, number)) in lanes {
                let height = ((normal.x * x + normal.y * y) + normal.z * z) - offset;
                let square = height * height;
                *number = if square < *best { i } else { *number };
                *best = if square < *best { square } else { *best };
            }
        }
        Best { distance2, unit: [0; WIDTH], number }
    }

    /// Takes what is nearer, or as near and before it.
    #[inline(always)]
    pub(super) fn merge(&mut self, distance2: &Line, unit: u32, numbers: &[u32; WIDTH]) {
        let lanes = self.distance2.iter_mut().zip(&mut self.unit).zip(&mut self.number);
        for (((best, its), first), (d, number)) in lanes.zip(distance2.iter().zip(numbers)) {
            let before = (unit < *its) | ((unit == *its) & (*number < *first));
            let take = (*d < *best) | ((*d == *best) & before);
            *best = if take { *d } else { *best };
            *its = if take { unit } else { *its };
            *first = if take { *number } else { *first };
        }
    }

    /// Bits of the largest squared distance.
    #[inline(always)]
    fn largest(&self) -> u32 {
        let mut largest = 0;
        for distance2 in &self.distance2 {
            largest = largest.max(distance2.to_bits());
        }
        largest
    }

    /// Whether a box is near enough to any query to hold something that is as near as the best.
    #[inline(always)]
    pub(super) fn may_improve(
        &self,
        [lx, ly, lz, hx, hy, hz]: &[f32; 6],
        [x, y, z]: &Queries,
    ) -> bool {
        let mut any = 0;
        for (((x, y), z), best) in x.iter().zip(y).zip(z).zip(&self.distance2) {
            let dx = outside(lx - x, x - hx);
            let dy = outside(ly - y, y - hy);
            let dz = outside(lz - z, z - hz);
            let bound = (dx * dx + dy * dy) + dz * dz;
            // Less than 0, in the first bit, where the bound is at most the best.
            any |= bound.to_bits().wrapping_sub(best.to_bits()).wrapping_sub(1);
        }
        any >> 31 == 1
    }
}

/// A box around queries: least, largest.
pub(super) struct Around([f32; 3], [f32; 3]);

impl Around {
    #[inline(always)]
    pub(super) fn new([xs, ys, zs]: &Queries) -> Self {
        let ((lx, hx), (ly, hy), (lz, hz)) = (extremes(xs), extremes(ys), extremes(zs));
        Around([lx, ly, lz], [hx, hy, hz])
    }
}

/// The least and the largest number: as integers in the same order, of which the compiler knows
/// that they can be compared in any order.
#[inline(always)]
fn extremes(line: &Line) -> (f32, f32) {
    const SIGN: u32 = 1 << 31;
    let number = |key: u32| f32::from_bits(if key < SIGN { !key } else { key ^ SIGN });
    let (mut least, mut largest) = (u32::MAX, 0_u32);
    for number in line {
        let bits = number.to_bits();
        let key = bits ^ ((((bits as i32) >> 31) as u32) | SIGN);
        least = least.min(key);
        largest = largest.max(key);
    }
    (number(least), number(largest))
}

/// Lower bounds of the squared distances between queries and what is in boxes, each with its lane
/// in the last bits: no two are equal.
pub(super) struct Bounds {
    all: [u32; WIDTH],
    /// What comes next is not below this: taking them in ascending order leaves the array as it
    /// is, which is what lets the compiler keep it in a register.
    from: u32,
}

impl Bounds {
    #[inline(always)]
    pub(super) fn new(boxes: &Boxes, around: &Around, share: f32) -> Self {
        let [lx, ly, lz, hx, hy, hz] = boxes;
        let Around([x, y, z], [to_x, to_y, to_z]) = around;
        let mut all = [0_u32; WIDTH];
        let low = lx.iter().zip(ly).zip(lz);
        let high = hx.iter().zip(hy).zip(hz);
        for (((bound, lane), ((lx, ly), lz)), ((hx, hy), hz)) in
            all.iter_mut().zip(0..).zip(low).zip(high)
        {
            let dx = outside(lx - to_x, x - hx);
            let dy = outside(ly - to_y, y - hy);
            let dz = outside(lz - to_z, z - hz);
            let square = ((dx * dx + dy * dy) + dz * dz) * share;
            *bound = (square.to_bits() & !LANE) | lane;
        }
        Bounds { all, from: 0 }
    }

    /// The lane of the least bound, unless that is beyond all of the best; each lane once.
    #[inline(always)]
    pub(super) fn next(&mut self, best: &Best) -> Option<usize> {
        // What is not above comes out, below zero, as the largest.
        let mut rest = self.all;
        for bound in &mut rest {
            *bound = bound.wrapping_sub(self.from);
        }
        let mut next = u32::MAX;
        for bound in &rest {
            next = next.min(*bound);
        }
        if next > (best.largest() | LANE).checked_sub(self.from)? {
            return None;
        }
        let next = next.wrapping_add(self.from);
        self.from = next.wrapping_add(1);
        Some((next & LANE) as usize)
    }
}

/// How far beyond either side, or 0.
#[inline(always)]
fn outside(below: f32, above: f32) -> f32 {
    let most = if below > above { below } else { above };
    if most > 0.0 { most } else { 0.0 }
}
