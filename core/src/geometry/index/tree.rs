//! Builds the tree over a unit's points, once an observation.

use super::layout::{Boxes, Leaf, Line, WIDTH, bits};
use nalgebra::Point3;

/// x, y, z and the bits of the point's number, on the way to a leaf.
type Element = [f32; 4];
/// Least and largest x, y, z.
type Bounds = [[f32; 3]; 2];

const NOTHING: Bounds = [[f32::INFINITY; 3], [f32::NEG_INFINITY; 3]];

/// How many of each a unit's tree has.
#[derive(Clone, Copy, Debug)]
pub(super) struct Shape {
    pub(super) leaves: usize,
    /// None above a single leaf.
    pub(super) nodes: usize,
    /// None above a single node.
    pub(super) roots: usize,
}

impl Shape {
    /// Of a unit with so many points.
    #[inline(always)]
    pub(super) fn new(points: usize) -> Self {
        let above = |n: usize| if n > 1 { n.div_ceil(WIDTH) } else { 0 };
        let leaves = points.div_ceil(WIDTH);
        let nodes = above(leaves);
        Shape { leaves, nodes, roots: above(nodes) }
    }

    /// Roots and nodes.
    #[inline(always)]
    pub(super) fn boxes(&self) -> usize {
        self.roots + self.nodes
    }

    pub(super) fn lines(&self) -> usize {
        self.boxes() * 6 + self.leaves * 4
    }
}

/// Builds a tree of this shape over the points; returns the box around them.
pub(super) fn build(lines: &mut [Line], shape: &Shape, points: &[Point3<f32>]) -> Bounds {
    let (boxes, leaves) = lines.split_at_mut((shape.boxes() * 6).min(lines.len()));
    let (roots, nodes) = boxes.split_at_mut((shape.roots * 6).min(boxes.len()));
    // The points are sorted where the leaves will be, which are as long.
    let (elements, _) = leaves.as_flattened_mut().as_chunks_mut::<4>();
    for ((i, point), element) in points.iter().enumerate().zip(elements.iter_mut()) {
        *element = [point.x, point.y, point.z, bits(i)];
    }
    let (elements, spare) = elements.split_at_mut(points.len().min(elements.len()));
    split(elements);
    spare.fill(elements.last().copied().unwrap_or_default());
    let (leaves, _) = leaves.as_chunks_mut::<4>();
    let all = leaves.iter_mut().map(finish);
    if shape.nodes == 0 {
        return all.fold(NOTHING, around);
    }
    let (nodes, _) = nodes.as_chunks_mut::<6>();
    let all = gather(nodes, all);
    let (roots, _) = roots.as_chunks_mut::<6>();
    if roots.is_empty() {
        return all.fold(NOTHING, around);
    }
    gather(roots, all).fold(NOTHING, around)
}

/// Sorts points so that each run of a leaf's, and each run of a node's, are close together: halves
/// at the median of the longest side, as nearly as whole leaves and nodes allow. As deep as the
/// number of leaves has bits, and a few more.
fn split(elements: &mut [Element]) {
    let count = elements.len();
    if count <= WIDTH {
        // So that the first of equals is met first.
        return elements.sort_unstable_by_key(|[.., number]| number.to_bits());
    }
    let mut whole = WIDTH;
    while whole.saturating_mul(WIDTH) < count {
        whole = whole.saturating_mul(WIDTH);
    }
    // From 1 to one less than there are wholes, so less than `count`.
    let middle = count.div_ceil(whole) / 2 * whole;
    let [low, high] = elements.iter().fold(NOTHING, |bounds, p| around(bounds, point(p)));
    let [x, y, z] = core::array::from_fn(|axis| {
        let at = |v: &[f32; 3]| v.get(axis).copied().unwrap_or_default();
        at(&high) - at(&low)
    });
    let axis = if x >= y && x >= z {
        |p: &Element| p[0]
    } else if y >= z {
        |p: &Element| p[1]
    } else {
        |p: &Element| p[2]
    };
    if middle < count {
        elements.select_nth_unstable_by(middle, |a, b| axis(a).total_cmp(&axis(b)));
    }
    let (first, second) = elements.split_at_mut(middle.min(count));
    split(first);
    split(second);
}

/// Turns the points of a leaf, one after another, into a leaf; returns the box around them.
fn finish(leaf: &mut Leaf) -> Bounds {
    let mut elements = [[0.0; 4]; WIDTH];
    elements.as_flattened_mut().copy_from_slice(leaf.as_flattened());
    for (axis, line) in leaf.iter_mut().enumerate() {
        for (slot, element) in line.iter_mut().zip(&elements) {
            *slot = element.get(axis).copied().unwrap_or_default();
        }
    }
    elements.iter().map(point).fold(NOTHING, around)
}

/// Fills boxes, [`WIDTH`] together, as they come; says what is around each of those.
fn gather(
    into: &mut [Boxes],
    mut from: impl Iterator<Item = Bounds>,
) -> impl Iterator<Item = Bounds> {
    into.iter_mut().map(move |boxes| {
        let mut all = NOTHING;
        for lane in 0..WIDTH {
            let one = from.next().unwrap_or(NOTHING);
            for (line, side) in boxes.iter_mut().zip(one.as_flattened()) {
                if let Some(slot) = line.get_mut(lane) {
                    *slot = *side;
                }
            }
            all = around(all, one);
        }
        all
    })
}

fn point([x, y, z, _]: &Element) -> Bounds {
    [[*x, *y, *z]; 2]
}

fn around([low, high]: Bounds, [lower, higher]: Bounds) -> Bounds {
    let pick = |a: [f32; 3], b: [f32; 3], first: fn(f32, f32) -> bool| {
        let ([a, b, c], [d, e, f]) = (a, b);
        [(a, d), (b, e), (c, f)].map(|(a, b)| if first(a, b) { a } else { b })
    };
    [pick(low, lower, |a, b| a < b), pick(high, higher, |a, b| a > b)]
}
