//! Where two faces, or a hull and a plane, touch: a few points that stand for all of them.

use crate::geometry::{Hull, dot, norm, rotate_back};
use crate::math;
use nalgebra::Vector3;

/// Corners of a face, at most: its outermost points to so many sides. Four would turn round faces into squares.
const CORNERS: usize = 8;
/// Those sides: odd multiples of a sixteenth of a turn, none along an axis, where faces of boxes tie.
const SIDES: [(f32, f32); CORNERS] = {
    let (c, s) = (0.923_879_5, 0.382_683_43);
    [(c, s), (s, c), (-s, c), (-c, s), (-c, -s), (-s, -c), (s, -c), (c, -s)]
};
/// Faces with less area are edges, in half squares of their length: their winding is noise.
const THIN: f32 = 1e-3;
/// Corners that two faces share, at most: clipping one by the other adds no more than the other has.
const SHARED: usize = 2 * CORNERS;
/// Points of a patch, at most: four carry a face, and their middle keeps stacks from tipping.
pub(super) const POINTS: usize = 5;
/// Faces smaller than the root of this have no slope, in radii: they are points.
const SAME: f32 = 1e-12;
/// Of faces whose corners are flatter than this only one direction is known: they are edges.
const FLAT: f32 = 1e-4;
/// Points are ranked by distance, less this times their height above the deepest. Without it the bevel of a face wins
/// over the face.
const STEEP: f32 = 10.0;
/// Points this far to a side, in the greatest distance, are to that side: rounding puts points of a line to either.
const ASIDE: f32 = 1e-6;

/// Points that may touch, and gaps there, metres.
#[derive(Default)]
pub(super) struct Patch {
    pub(super) points: heapless::Vec<(Vector3<f32>, f32), POINTS>,
    /// Whether the first point is the middle of the others.
    pub(super) has_middle: bool,
}

impl Patch {
    /// How far the others are from the first point in the mean, across the normal, metres.
    #[cfg_attr(rigidformer_dsp, inline(never))]
    pub(super) fn mean_arm(&self, normal: &Vector3<f32>) -> f32 {
        let Some(((middle, _), corners)) = self.points.split_first() else { return 0.0 };
        let arms = corners.iter().map(|(corner, _)| {
            let arm = corner - middle;
            norm(&(arm - normal * dot(&arm, normal)))
        });
        arms.fold(0.0, |sum, arm| sum + arm) / corners.len().max(1) as f32
    }
}

/// Of points that may touch, at most four, and their middle first where they are more than two: the deepest one, the
/// farthest from it across the normal, and the farthest from both to either side. A point that is higher counts as less
/// far: else the bevel of a face would be chosen for the face. The middle carries a weight without turning the unit, so
/// that few sweeps suffice.
#[cfg_attr(rigidformer_dsp, inline(never))]
pub(super) fn choose<I>(candidates: I, normal: &Vector3<f32>) -> Patch
where
    I: Iterator<Item = (Vector3<f32>, f32)> + Clone,
{
    let mut few = heapless::Vec::<(Vector3<f32>, f32), POINTS>::new();
    let mut deepest = (Vector3::zeros(), f32::INFINITY);
    for candidate in candidates.clone() {
        // One more than four says that there are more.
        let _ = few.push(candidate);
        if candidate.1 < deepest.1 {
            deepest = candidate;
        }
    }
    if few.is_full() {
        few.clear();
        let height = |gap: f32| STEEP * (gap - deepest.1);
        let (mut far, mut most) = (deepest, f32::NEG_INFINITY);
        for candidate in candidates.clone() {
            let way = candidate.0 - deepest.0;
            let reach = norm(&(way - normal * dot(&way, normal))) - height(candidate.1);
            if reach > most {
                (far, most) = (candidate, reach);
            }
        }
        let across = normal.cross(&(far.0 - deepest.0));
        let size = norm(&across);
        let (mut left, mut right) = (None, None);
        let (mut high, mut low) = (f32::NEG_INFINITY, f32::NEG_INFINITY);
        for candidate in candidates {
            let side = dot(&across, &(candidate.0 - deepest.0));
            let rank = side.abs() - height(candidate.1) * size;
            if side > ASIDE * size * size && rank > high {
                (high, left) = (rank, Some(candidate));
            }
            if side < -ASIDE * size * size && rank > low {
                (low, right) = (rank, Some(candidate));
            }
        }
        for chosen in [Some(deepest), Some(far), left, right].into_iter().flatten() {
            let _ = few.push(chosen);
        }
    }
    let has_middle = few.len() > 2;
    let mut patch = Patch { points: heapless::Vec::new(), has_middle };
    if has_middle {
        let mut sum = (Vector3::zeros(), 0.0);
        for (point, gap) in &few {
            sum = (sum.0 + point, sum.1 + gap);
        }
        let count = few.len() as f32;
        let _ = patch.points.push((sum.0 / count, sum.1 / count));
    }
    for point in few {
        let _ = patch.points.push(point);
    }
    patch
}

/// Corners of a face in convex order, each across the normal and its height along it.
pub(super) type Face = heapless::Vec<[f32; 3], CORNERS>;

/// The axes that faces are seen in: two across the normal and the normal.
pub(super) type Axes = [Vector3<f32>; 3];

/// The face of a hull along sign x normal: all points that are at most `depth` behind the first, metres. `shift` is
/// where the unit's centre is.
#[cfg_attr(rigidformer_dsp, inline(never))]
pub(super) fn face(
    hull: &Hull<'_>,
    shift: &Vector3<f32>,
    axes: &Axes,
    (sign, depth): (f32, f32),
) -> Face {
    let local = axes.map(|axis| rotate_back(&hull.rotation, &axis));
    let [x, y, z] = axes.map(|axis| dot(&axis, shift));
    let [u, v, n] = &local;
    let heights = hull.points.iter().map(|point| dot(&point.coords, n) + z);
    let top = heights.clone().fold(f32::NEG_INFINITY, |top, height| top.max(sign * height));
    let least = top - depth;
    let mut most = [f32::NEG_INFINITY; CORNERS];
    let mut outermost = [(usize::MAX, [0.0; 3]); CORNERS];
    for (number, (point, height)) in hull.points.iter().zip(heights).enumerate() {
        if sign * height < least {
            continue;
        }
        let [x, y] = [dot(&point.coords, u) + x, dot(&point.coords, v) + y];
        for (((a, b), most), outermost) in SIDES.iter().zip(&mut most).zip(&mut outermost) {
            let reach = a * x + b * y;
            if reach > *most {
                (*most, *outermost) = (reach, (number, [x, y, height]));
            }
        }
    }
    // They are in convex order; neighbouring sides may share one.
    let mut corners = Face::new();
    let (mut first, mut last) = (usize::MAX, usize::MAX);
    for (number, corner) in outermost {
        if number != last && number != first {
            let _ = corners.push(corner);
            last = number;
            if first == usize::MAX {
                first = number;
            }
        }
    }
    edge(&mut corners);
    corners
}

/// Of corners that lie on a line keeps the two that are farthest from each other.
#[cfg_attr(rigidformer_dsp, inline(never))]
fn edge(corners: &mut Face) {
    let (mut area, mut length, mut ends) = (0.0, 0.0, None);
    for (number, (a, b)) in corners.iter().zip(corners.iter().cycle().skip(1)).enumerate() {
        let [x, y, _] = a;
        let [bx, by, _] = b;
        area += x * by - y * bx;
        for other in corners.iter().take(number) {
            let [ox, oy, _] = other;
            let (dx, dy) = (x - ox, y - oy);
            if dx * dx + dy * dy > length {
                (length, ends) = (dx * dx + dy * dy, Some([*other, *a]));
            }
        }
    }
    if corners.len() > 2 && area <= THIN * length {
        corners.truncate(1);
        if let Some(ends) = ends {
            corners.clear();
            let _ = corners.extend_from_slice(&ends);
        }
    }
}

/// Height of a face's plane over the plane across the normal.
pub(super) struct Slope {
    middle: [f32; 3],
    rise: [f32; 2],
}

impl Slope {
    /// By least squares over the corners, of which there is at least one.
    #[cfg_attr(rigidformer_dsp, inline(never))]
    pub(super) fn new(corners: &[[f32; 3]], radius: f32) -> Self {
        let count = corners.len() as f32;
        let mut middle = [0.0; 3];
        for corner in corners {
            for (sum, value) in middle.iter_mut().zip(corner) {
                *sum += value;
            }
        }
        let middle = middle.map(|sum| sum / count);
        let (mut xx, mut xy, mut yy, mut xz, mut yz) = (0.0, 0.0, 0.0, 0.0, 0.0);
        let [mx, my, mz] = middle;
        for [x, y, z] in corners {
            let (x, y, z) = (x - mx, y - my, z - mz);
            xx += x * x;
            xy += x * y;
            yy += y * y;
            xz += x * z;
            yz += y * z;
        }
        let size = xx + yy;
        let determinant = xx * yy - xy * xy;
        let rise = if size < SAME * radius * radius {
            [0.0, 0.0]
        } else if determinant > FLAT * size * size {
            [(xz * yy - yz * xy) / determinant, (yz * xx - xz * xy) / determinant]
        } else {
            // An edge: along it alone.
            let (x, y) = if xx >= yy { (xx, xy) } else { (xy, yy) };
            let length = math::sqrt(x * x + y * y);
            let (x, y) = (x / length, y / length);
            let rise = (xz * x + yz * y) / size;
            [rise * x, rise * y]
        };
        Slope { middle, rise }
    }

    pub(super) fn at(&self, [x, y]: [f32; 2]) -> f32 {
        let ([mx, my, mz], [rx, ry]) = (self.middle, self.rise);
        mz + (rx * (x - mx) + ry * (y - my))
    }
}

/// Corners of what faces share, across the normal.
pub(super) type Shared = heapless::Vec<[f32; 2], SHARED>;

/// Where two faces lie over each other: of a polygon and an edge, or of two polygons. None of anything less.
pub(super) fn overlap(mine: &Face, theirs: &Face) -> Shared {
    match (mine.len(), theirs.len()) {
        (3.., 3..) | (2, 3..) => clip(mine, theirs),
        (3.., 2) => clip(theirs, mine),
        _ => Shared::new(),
    }
}

/// The part of a polygon or an edge that is within another, convex polygon.
#[cfg_attr(rigidformer_dsp, inline(never))]
fn clip(corners: &[[f32; 3]], other: &[[f32; 3]]) -> Shared {
    let mut here = Shared::new();
    for [x, y, _] in corners {
        let _ = here.push([*x, *y]);
    }
    for ([ax, ay, _], [bx, by, _]) in other.iter().zip(other.iter().cycle().skip(1)) {
        let (ex, ey) = (bx - ax, by - ay);
        let inside = |[x, y]: [f32; 2]| ex * (y - ay) - ey * (x - ax);
        let mut kept = Shared::new();
        // An edge has no way back.
        let ways = if here.len() == 2 { 1 } else { here.len() };
        for (number, (p, q)) in here.iter().zip(here.iter().cycle().skip(1)).enumerate() {
            let (mine, next) = (inside(*p), inside(*q));
            // What has no room is left out.
            if mine >= 0.0 {
                let _ = kept.push(*p);
            }
            let crosses = (mine < 0.0 && next > 0.0) || (mine > 0.0 && next < 0.0);
            if crosses && number < ways {
                let share = mine / (mine - next);
                let ([px, py], [qx, qy]) = (p, q);
                let _ = kept.push([px + share * (qx - px), py + share * (qy - py)]);
            }
        }
        here = kept;
        if here.is_empty() {
            break;
        }
    }
    here
}
