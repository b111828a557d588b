//! Where two faces, or a hull and a plane, touch: a few points that stand for all of them.

use crate::geometry::{Hull, dot, norm, rotate_back};
use crate::math;
use nalgebra::Vector3;

/// Corners of a face, at most.
const CORNERS: usize = 8;
/// Corners that two faces share, at most.
const SHARED: usize = 2 * CORNERS;
/// Points of a patch, at most: four and their middle.
const POINTS: usize = 5;
/// Square of the distance in which corners are one, in radii^2.
const SAME: f32 = 1e-12;
/// Of faces whose corners are flatter than this only one direction is known.
const FLAT: f32 = 1e-4;
/// Metres that a point of a patch counts as nearer for each that it is higher.
const STEEP: f32 = 10.0;
/// Points this far aside, in the greatest distance, are aside.
const ASIDE: f32 = 1e-6;

/// Points that may touch, and gaps there, metres.
#[derive(Default)]
pub(super) struct Patch {
    pub(super) points: heapless::Vec<(Vector3<f32>, f32), POINTS>,
    /// Whether the first point is the middle of the others.
    pub(super) has_middle: bool,
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
    (sign, depth, radius): (f32, f32, f32),
) -> Face {
    let local = axes.map(|axis| rotate_back(&hull.rotation, &axis));
    let [x, y, z] = axes.map(|axis| dot(&axis, shift));
    let [u, v, n] = &local;
    let heights = hull.points.iter().map(|point| dot(&point.coords, n) + z);
    let top = heights.clone().fold(f32::NEG_INFINITY, |top, height| top.max(sign * height));
    let least = top - depth;
    let flat = hull.points.iter().zip(heights).enumerate();
    let flat = flat.filter(|(_, (_, height))| sign * height >= least);
    let flat = flat.map(|(number, (point, height))| {
        (number, [dot(&point.coords, u) + x, dot(&point.coords, v) + y, height])
    });

    let mut corners = Face::new();
    let mut first: Option<(usize, [f32; 3])> = None;
    for point in flat.clone() {
        let [x, y, _] = point.1;
        if first.is_none_or(|(_, [fx, fy, _])| x < fx || (x == fx && y < fy)) {
            first = Some(point);
        }
    }
    let Some(first) = first else { return corners };
    let mut here = first;
    loop {
        if corners.push(here.1).is_err() || corners.is_full() {
            return corners;
        }
        let [hx, hy, _] = here.1;
        let mut after: Option<(usize, [f32; 3])> = None;
        for point in flat.clone() {
            if point.0 == here.0 {
                continue;
            }
            let Some((_, [ax, ay, _])) = after else {
                after = Some(point);
                continue;
            };
            let [bx, by, _] = point.1;
            let (ax, ay, bx, by) = (ax - hx, ay - hy, bx - hx, by - hy);
            let side = ax * by - ay * bx;
            if side < 0.0 || (side == 0.0 && bx * bx + by * by > ax * ax + ay * ay) {
                after = Some(point);
            }
        }
        let Some(after) = after.filter(|after| after.0 != first.0) else { return corners };
        let [ax, ay, _] = after.1;
        let (ax, ay) = (ax - hx, ay - hy);
        if ax * ax + ay * ay < SAME * radius * radius {
            return corners;
        }
        here = after;
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
