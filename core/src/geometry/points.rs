//! Canonical order, centre, radius and farthest-point ordering of a unit's points.

use super::{dot, norm};
use crate::kernels::in_own_environment;
use core::cmp::Ordering;
use nalgebra::{Point3, Vector3};

/// Kernel radius of the centre's density weights, as a share of the unit's diameter.
const DENSITY_RADIUS: f32 = 0.2;

/// Estimate of the centre of mass from points alone: the centroid of their convex hull, or their
/// [`density_centre`] where that is not their shape (docs/MODEL.md, section 1).
///
/// `points` are sorted in place by x, y, z, which makes the result independent of their order.
pub fn centre_of_mass(points: &mut [Point3<f32>]) -> Point3<f32> {
    in_own_environment(|| centre_of_mass_here(points))
}

pub(crate) fn centre_of_mass_here(points: &mut [Point3<f32>]) -> Point3<f32> {
    sort(points);
    super::extreme_points::hull_centre(points).unwrap_or_else(|| density_centre_here(points))
}

/// Estimate of the centre of mass without the shape: their mean, each weighted by the
/// inverse of the local point density, so that an unevenly sampled surface does not pull
/// it aside (docs/MODEL.md, section 1).
///
/// `points` are sorted in place by x, y, z, which makes the result independent of their
/// order. Time grows with the square of their number.
pub fn density_centre(points: &mut [Point3<f32>]) -> Point3<f32> {
    in_own_environment(|| density_centre_here(points))
}

fn density_centre_here(points: &mut [Point3<f32>]) -> Point3<f32> {
    sort(points);
    let mut diameter2 = 0.0_f32;
    for (i, a) in points.iter().enumerate() {
        for b in points.iter().skip(i + 1) {
            let d = a - b;
            diameter2 = diameter2.max(dot(&d, &d));
        }
    }
    let reach2 = (DENSITY_RADIUS * DENSITY_RADIUS) * diameter2;
    if reach2 < f32::MIN_POSITIVE {
        return points.first().copied().unwrap_or_else(Point3::origin);
    }
    let mut total = 0.0_f32;
    let mut sum = Vector3::zeros();
    for a in points.iter() {
        let mut density = 0.0_f32;
        for b in points.iter() {
            let d = a - b;
            let q = 1.0 + dot(&d, &d) / reach2;
            let q2 = q * q;
            density += 1.0 / (q2 * q2);
        }
        let weight = 1.0 / density;
        total += weight;
        sum += a.coords * weight;
    }
    Point3::from(sum / total)
}

/// Points whose distance is this close to the greatest count as equally far, so that
/// rounding does not decide between the corners of a symmetric unit.
const TIE: f32 = 1.0 - 1e-4;

/// Puts points into farthest-point order in place: the first is the farthest from
/// `centre`, each next the farthest from all before it; ties go to the smallest x, y, z.
/// Any prefix then covers the unit evenly, and the first four are its anchors.
///
/// `distance` is scratch of at least as many numbers as there are points.
pub fn farthest_point_order(
    points: &mut [Point3<f32>],
    centre: &Point3<f32>,
    distance: &mut [f32],
) {
    in_own_environment(|| farthest_point_order_here(points, centre, distance));
}

pub(crate) fn farthest_point_order_here(
    points: &mut [Point3<f32>],
    centre: &Point3<f32>,
    distance: &mut [f32],
) {
    let mut start = true;
    let mut reference = *centre;
    let mut rest = points;
    let mut distance = distance;
    while !rest.is_empty() {
        let greatest = nearer(rest, distance, &reference, start);
        // The first point chosen replaces the centre; its distances start afresh.
        let fresh = core::mem::replace(&mut start, false);
        let best = smallest(rest, distance, greatest * TIE);
        let Some((index, chosen)) = best else { return };
        let (Some((first, points)), Some((nearest, distances))) = (
            core::mem::take(&mut rest).split_first_mut(),
            core::mem::take(&mut distance).split_first_mut(),
        ) else {
            return;
        };
        // The one that is first already has nothing to change places with.
        let other = index.checked_sub(1);
        if let Some(other) = other.and_then(|other| points.get_mut(other)) {
            core::mem::swap(first, other);
        }
        if let Some(other) = other.and_then(|other| distances.get_mut(other)) {
            core::mem::swap(nearest, other);
        }
        if fresh {
            distances.fill(f32::INFINITY);
        }
        reference = chosen;
        rest = points;
        distance = distances;
    }
}

/// Points that are looked at together.
// On hosts in vectors: whoever adds a mesh waits for the square of its points.
const LANES: usize = if cfg!(rigidformer_host) { 8 } else { 1 };

/// Lowers each point's distance, squared, to that from `reference`, or sets it to that, and returns the greatest.
fn nearer(
    points: &[Point3<f32>],
    distance: &mut [f32],
    reference: &Point3<f32>,
    sets: bool,
) -> f32 {
    let mut greatest = [0.0_f32; LANES];
    for (points, distances) in points.chunks(LANES).zip(distance.chunks_mut(LANES)) {
        for ((p, d), greatest) in points.iter().zip(distances).zip(&mut greatest) {
            let delta = p - reference;
            let d2 = dot(&delta, &delta);
            // Comparisons, and not `min` and `max`, which ask for numbers that are none.
            *d = if sets || d2 < *d { d2 } else { *d };
            *greatest = if *d > *greatest { *d } else { *greatest };
        }
    }
    greatest.into_iter().fold(0.0, f32::max)
}

/// The point of the smallest x, y, z among those at least so far away, and its place.
fn smallest(points: &[Point3<f32>], distance: &[f32], least: f32) -> Option<(usize, Point3<f32>)> {
    let mut best: Option<(usize, Point3<f32>)> = None;
    let chunks = points.chunks(LANES).zip(distance.chunks(LANES));
    for (start, (points, distances)) in (0..).step_by(LANES).zip(chunks) {
        // Few points are so far away, and the look at all of them at once is short.
        if distances.iter().fold(false, |any, d| any | (*d >= least)) {
            for (i, (p, d)) in (start..).zip(points.iter().zip(distances)) {
                let first = best.is_none_or(|(_, b)| lexicographic(p, &b) == Ordering::Less);
                if *d >= least && first {
                    best = Some((i, *p));
                }
            }
        }
    }
    best
}

/// Insertion sort: the centre takes the square of the number of points anyway, and the sorts of the standard
/// library are large and can panic.
fn sort(points: &mut [Point3<f32>]) {
    for end in 1..points.len() {
        let mut at = end;
        while let Some([a, b]) = at.checked_sub(1).and_then(|low| points.get_mut(low..=at))
            && lexicographic(a, b) == Ordering::Greater
        {
            core::mem::swap(a, b);
            at -= 1;
        }
    }
}

/// Radius about the origin of a sphere that holds all points, metres.
pub fn radius(points: &[Point3<f32>]) -> f32 {
    in_own_environment(|| radius_here(points))
}

pub(crate) fn radius_here(points: &[Point3<f32>]) -> f32 {
    points.iter().fold(0.0_f32, |r, p| r.max(norm(&p.coords)))
}

fn lexicographic(a: &Point3<f32>, b: &Point3<f32>) -> Ordering {
    let by = |x: f32, y: f32| x.partial_cmp(&y).unwrap_or(Ordering::Equal);
    by(a.x, b.x).then(by(a.y, b.y)).then(by(a.z, b.z))
}
