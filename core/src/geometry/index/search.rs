//! The search: sixteen neighbouring points of a unit at a time, each in a lane.
//!
//! Together they are close to each other and far from most of the rest, so that what is passed
//! over is passed over for all, and what is not costs each little: no sum over lanes, and branches
//! for sixteen. One at a time took two to four times as long.
//!
//! The answer is the candidate that is least by (squared distance, unit, number), the planes
//! counting as a unit before all others. That is how ties are broken, and no order of visits can
//! change it. So all there is to show is that nothing is passed over whose computed squared
//! distance is at most the answer's.
//!
//! **Within a unit** a box is passed over where the squared distance to it, computed in the same
//! order as a point's, is greater than the best. Rounding is monotonic: for a point p in a box
//! whose least corner l is beyond the query q, p - q >= l - q >= 0, so the rounded differences
//! compare the same way, and so do their rounded squares and the rounded sums of those; likewise
//! for the largest corner, and where q is inside, the bound is 0. The same goes for a box around
//! the queries in place of q. No slack is needed: the computed bound is never greater than the
//! computed squared distance of any point inside.
//!
//! **Between units** boxes are in the world. With u the unit roundoff 2^-24, r the unit's radius,
//! c its centre, R its rotation, whose columns have products within e = 1e-5 of those of axes
//! (`place` gives others a box that is everywhere), and w = R p + c the place of a local point p:
//! computed local coordinates of the query are within 9 u |q - c| of R'(q - c), and
//! |R'(q - c) - p| >= (1 - 3 e) |q - w| - 3 e |p|. As |q - c| <= |q - w| + 1.01 r, the computed
//! distance is at least (1 - 4e-5) |q - w| - 4e-5 r. A side of the box is rounded by at most
//! 4 u |c| + 30 u r, and that around the sphere lacks 2e-5 r where R stretches; it is moved out by
//! 1e-4 r + 1e-6 (|c| + r), with the largest coordinate for |c|: w is inside by at least 7e-5 r.
//! So |q - w| is at least the distance to the box plus 7e-5 r, and the computed squared distance
//! at least (1 - 9e-5) times that to the box squared: [`SHRINK`].
//!
//! Bounds are compared as integers, which numbers from zero on allow, and their last bits are
//! taken for the lane: that makes them less, so it keeps all this true.
//!
//! Everything is inlined and without closures, which the compiler would compile apart from the
//! instructions that the caller has enabled; loops are over arrays of a line, which become vectors.

use super::bounds::{Around, Best, Bounds, Queries};
use super::layout::{Boxes, Frame, Leaf, Line, WIDTH};
use super::parts::Index;
use super::tree::Shape;

/// Share of the squared distance to a unit's box that no point of it is nearer than.
const SHRINK: f32 = 1.0 - 1e-4;

/// Answers for the leaf of a row: leaves of the first copy, then of the next.
#[inline(always)]
pub(crate) fn nearest(index: &Index<'_>, row: usize, found: &mut [f32]) {
    let leaves = index.leaves.max(1);
    let Some([unit, line]) = index.owners.get(row % leaves) else { return };
    let own = unit.to_bits() as usize;
    let frames = index.frames.get(row / leaves * index.per_copy..).unwrap_or_default();
    let (Some(leaf), Some(frame)) = (leaf(index.lines, line.to_bits() as usize), frames.get(own))
    else {
        return;
    };
    let best = among_all(index, row / leaves, own, &apply(frame, leaf));
    if let Some([units, numbers]) = found.as_chunks_mut::<WIDTH>().0.first_chunk_mut::<2>() {
        for (to, from) in units.iter_mut().zip(best.unit) {
            *to = f32::from_bits(from);
        }
        for (to, from) in numbers.iter_mut().zip(best.number) {
            *to = f32::from_bits(from);
        }
    }
}

/// The least candidates of a copy, but for a unit, for points of the world.
#[inline(always)]
fn among_all(index: &Index<'_>, copy: usize, own: usize, queries: &Queries) -> Best {
    let groups = index.per_copy.div_ceil(WIDTH);
    let groups = index.groups.get(copy * groups..(copy + 1) * groups).unwrap_or_default();
    let frames = copy * index.per_copy..(copy + 1) * index.per_copy;
    let frames = index.frames.get(frames).unwrap_or_default();
    let mut best = Best::new(queries, index.planes);
    let body = frames.get(own).map_or(0, |[.., body]| body.to_bits());
    let around = Around::new(queries);
    // From the unit's own group on, where its neighbours may be: what is nearer sooner passes over
    // more.
    for i in (own / WIDTH..groups.len()).chain(0..own / WIDTH) {
        let Some(group) = groups.get(i) else { break };
        let mut bounds = Bounds::new(group, &around, SHRINK);
        while let Some(lane) = bounds.next(&best) {
            let unit = i * WIDTH + lane;
            if unit == own {
                continue;
            }
            let (Some(head), Some(frame)) = (index.heads.get(unit), frames.get(unit)) else {
                continue;
            };
            let ([lx, ly, lz, hx, hy, hz, count, start, _], [.., its]) = (head, frame);
            if body != 0 && its.to_bits() == body {
                continue;
            }
            let queries = local(frame, queries);
            if best.may_improve(&[*lx, *ly, *lz, *hx, *hy, *hz], &queries) {
                let tree = Tree {
                    lines: index.lines.get(start.to_bits() as usize..).unwrap_or_default(),
                    count: count.to_bits() as usize,
                    unit: unit as u32 + 1,
                    queries: &queries,
                };
                tree.visit(&mut best);
            }
        }
    }
    best
}

/// As [`Pose::apply`](crate::geometry::Pose::apply), step by step.
#[inline(always)]
fn apply(frame: &Frame, [x, y, z, _]: &Leaf) -> Queries {
    let [a, b, c, d, e, f, g, h, i, cx, cy, cz, _] = *frame;
    let from = [x, y, z];
    [weigh(from, [a, b, c], cx), weigh(from, [d, e, f], cy), weigh(from, [g, h, i], cz)]
}

/// As [`Pose::local`](crate::geometry::Pose::local), step by step, but for the signs of
/// zeros, which the squares lose.
#[inline(always)]
fn local(frame: &Frame, [x, y, z]: &Queries) -> Queries {
    let [a, b, c, d, e, f, g, h, i, cx, cy, cz, _] = *frame;
    let from = [&less(x, cx), &less(y, cy), &less(z, cz)];
    [weigh(from, [a, d, g], 0.0), weigh(from, [b, e, h], 0.0), weigh(from, [c, f, i], 0.0)]
}

#[inline(always)]
fn less(line: &Line, centre: f32) -> Line {
    let mut out = *line;
    for out in &mut out {
        *out -= centre;
    }
    out
}

#[inline(always)]
fn weigh([xs, ys, zs]: [&Line; 3], [a, b, c]: [f32; 3], centre: f32) -> Line {
    let mut out = [0.0; WIDTH];
    for (((out, x), y), z) in out.iter_mut().zip(xs).zip(ys).zip(zs) {
        *out = ((a * x + b * y) + c * z) + centre;
    }
    out
}

#[inline(always)]
fn leaf(lines: &[Line], line: usize) -> Option<&Leaf> {
    lines.get(line..).and_then(<[Line]>::first_chunk)
}

/// A unit's tree and the queries in the unit's frame.
struct Tree<'a> {
    lines: &'a [Line],
    count: usize,
    unit: u32,
    queries: &'a Queries,
}

impl Tree<'_> {
    #[inline(always)]
    fn visit(&self, best: &mut Best) {
        let shape = Shape::new(self.count);
        if shape.nodes == 0 {
            return self.leaf(0, 0, best);
        }
        let around = Around::new(self.queries);
        // Where there is one node, it is what a root would be.
        let roots = shape.roots.max(1);
        for root in 0..roots {
            let Some(boxes) = self.boxes(root) else { return };
            let mut bounds = Bounds::new(boxes, &around, 1.0);
            while let Some(lane) = bounds.next(best) {
                if !best.may_improve(&side(boxes, lane), self.queries) {
                    continue;
                }
                let child = root * WIDTH + lane;
                if shape.roots == 0 {
                    self.leaf(shape.boxes(), child, best);
                    continue;
                }
                let Some(boxes) = self.boxes(shape.roots + child) else { return };
                let mut bounds = Bounds::new(boxes, &around, 1.0);
                while let Some(lane) = bounds.next(best) {
                    if best.may_improve(&side(boxes, lane), self.queries) {
                        self.leaf(shape.boxes(), child * WIDTH + lane, best);
                    }
                }
            }
        }
    }

    #[inline(always)]
    fn boxes(&self, at: usize) -> Option<&Boxes> {
        self.lines.get(at * 6..).and_then(<[Line]>::first_chunk)
    }

    /// Compares all points of a leaf, after so many boxes and leaves.
    #[inline(always)]
    fn leaf(&self, boxes: usize, at: usize, best: &mut Best) {
        let Some([xs, ys, zs, numbers]) = leaf(self.lines, boxes * 6 + at * 4) else { return };
        let [x, y, z] = self.queries;
        let (mut least, mut first) = ([f32::INFINITY; WIDTH], [0_u32; WIDTH]);
        let points = xs.iter().zip(ys).zip(zs).zip(numbers);
        for (((px, py), pz), number) in points.take(self.count.saturating_sub(at * WIDTH)) {
            let number = number.to_bits();
            let lanes = x.iter().zip(y).zip(z).zip(least.iter_mut().zip(&mut first));
            for (((x, y), z), (least, first)) in lanes {
                let (dx, dy, dz) = (px - x, py - y, pz - z);
                let square = (dx * dx + dy * dy) + dz * dz;
                let nearer = square < *least;
                *least = if nearer { square } else { *least };
                *first = if nearer { number } else { *first };
            }
        }
        best.merge(&least, self.unit, &first);
    }
}

/// The box of a lane.
#[inline(always)]
fn side(boxes: &Boxes, lane: usize) -> [f32; 6] {
    let mut side = [0.0; 6];
    for (side, line) in side.iter_mut().zip(boxes) {
        *side = line.get(lane).copied().unwrap_or_default();
    }
    side
}

/// For tests: what is nearest to each of some points of the world that belong to a unit.
#[cfg(test)]
pub(super) fn of_any(index: &Index<'_>, own: usize, queries: &Queries) -> super::layout::Found {
    let best = among_all(index, own / index.per_copy, own % index.per_copy, queries);
    [best.unit.map(f32::from_bits), best.number.map(f32::from_bits)]
}
