//! Distance between two convex hulls (Gilbert, Johnson and Keerthi), from their points alone.

use super::pose::{rotate_back_here, rotate_here};
use super::{dot, norm, opposite};
use crate::kernels::in_own_environment;
use nalgebra::{Isometry3, Matrix3, Point3, Vector3};

/// Support points that a search takes at most; most take five.
const ITERATIONS: usize = 24;
/// Triangles with a smaller square of the sine have no normal.
const SLIVER: f32 = 1e-8;

/// How far a search goes.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Precision {
    /// Where the next support point would shorten the squared distance by no more than this share, it is found.
    pub(crate) tolerance: f32,
    /// Nor is a support point one that is nearer by no more than this, which rounding can feign, metres.
    pub(crate) noise_m: f32,
    /// Closer hulls overlap, metres.
    pub(crate) overlap_m: f32,
    /// Support points closer together are one, metres.
    pub(crate) same_m: f32,
    /// Of hulls farther apart than this only that is told, as an infinite distance, metres.
    pub(crate) beyond_m: f32,
}

impl Precision {
    /// Enough to tell when hulls meet, and where; normals are right to degrees.
    pub(crate) const COARSE: Precision = Precision {
        tolerance: 1e-3,
        noise_m: 0.0,
        overlap_m: 1e-5,
        same_m: 1e-6,
        beyond_m: f32::INFINITY,
    };

    /// What f32 can carry of hulls whose radii have this sum. Relative to it, so that larger hulls are no other ones.
    pub(crate) fn fine(radii: f32) -> Precision {
        let noise_m = 3e-7 * radii;
        let (overlap_m, beyond_m) = (4e-6 * radii, f32::INFINITY);
        Precision { tolerance: 1e-6, noise_m, overlap_m, same_m: noise_m, beyond_m }
    }
}

/// A hull about its unit's centre.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Hull<'p> {
    /// (points) in the unit's frame, metres, at least one.
    pub(crate) points: &'p [Point3<f32>],
    /// The unit's frame to the world's axes.
    pub(crate) rotation: Matrix3<f32>,
}

impl Hull<'_> {
    /// The point that is farthest along a direction of the world, from the unit's centre in the world's axes.
    #[cfg_attr(rigidformer_dsp, inline(never))]
    pub(crate) fn support(&self, along: &Vector3<f32>) -> Vector3<f32> {
        let local = rotate_back_here(&self.rotation, along);
        rotate_here(&self.rotation, &farthest(self.points, &local).coords)
    }
}

/// The first of the points that are farthest along a direction; the origin where there is none.
fn farthest(points: &[Point3<f32>], along: &Vector3<f32>) -> Point3<f32> {
    #[cfg(rigidformer_host)]
    if points.len() > FEW {
        return farthest_of_many(points, along);
    }
    let (mut best, mut most) = (&Point3::origin(), f32::NEG_INFINITY);
    for point in points {
        let reach = dot(&point.coords, along);
        if reach > most {
            (best, most) = (point, reach);
        }
    }
    *best
}

/// Points up to which one search is sooner done than several.
#[cfg(rigidformer_host)]
const FEW: usize = 12;

/// As [`farthest`], with a search of its own for every fourth point: none waits for another, and nothing is guessed.
#[cfg(rigidformer_host)]
fn farthest_of_many(points: &[Point3<f32>], along: &Vector3<f32>) -> Point3<f32> {
    const SEARCHES: usize = 4;
    let (mut best, mut most) = ([0_u32; SEARCHES], [f32::NEG_INFINITY; SEARCHES]);
    let (groups, rest) = points.as_chunks::<SEARCHES>();
    for (group, points) in (0_u32..).zip(groups) {
        for ((best, most), point) in best.iter_mut().zip(&mut most).zip(points) {
            let reach = dot(&point.coords, along);
            let is_farther = reach > *most;
            *best = if is_farther { group } else { *best };
            *most = if is_farther { reach } else { *most };
        }
    }
    let (mut found, mut reached) = (usize::MAX, f32::NEG_INFINITY);
    let ends = best.iter().zip(most).enumerate();
    for (number, reach) in ends.map(|(k, (group, most))| (*group as usize * SEARCHES + k, most)) {
        if reach > reached || (reach == reached && number < found) {
            (found, reached) = (number, reach);
        }
    }
    for (number, point) in (points.len() - rest.len()..).zip(rest) {
        let reach = dot(&point.coords, along);
        if reach > reached {
            (found, reached) = (number, reach);
        }
    }
    let is_there = reached > f32::NEG_INFINITY;
    points.get(found).filter(|_| is_there).copied().unwrap_or_else(Point3::origin)
}

#[cfg(all(test, rigidformer_host))]
mod farthest_points {
    use super::*;

    #[test]
    fn many_searches_find_what_one_does() {
        let one = |points: &[Point3<f32>], along: &Vector3<f32>| {
            let mut found = (Point3::origin(), f32::NEG_INFINITY);
            for point in points {
                let reach = dot(&point.coords, along);
                if reach > found.1 {
                    found = (*point, reach);
                }
            }
            found.0
        };
        // Few different numbers, so that many points are as far; each is told from others by its third.
        let number = |i: usize, by: usize| ((i * by) % 7) as f32 - 3.0;
        let all: [_; 90] = core::array::from_fn(|i| {
            Point3::new(
                number(i, 3),
                number(i / 2, 5),
                if i % 11 == 0 { f32::NAN } else { i as f32 },
            )
        });
        for count in 0..=all.len() {
            for along in [[1.0, 0.0, 0.0], [-1.0, 2.0, 0.0], [0.0; 3], [0.5, 0.5, 1e-3]] {
                let along = Vector3::from(along);
                let points = all.get(..count).unwrap_or_default();
                let (found, expected) = (farthest_of_many(points, &along), one(points, &along));
                assert_eq!(found, expected, "{count} points along {along}");
            }
        }
    }
}

/// Distance between the convex hulls of two sets of points, each in a frame of its own, in the points' unit of length. `None` where
/// they overlap, and where one has no point.
///
/// ```
/// use nalgebra::{Isometry3, Point3};
/// use rigidformer_core::geometry::hull_distance;
/// let corner = |i: i32, bit| if i & bit == 0 { -0.5 } else { 0.5 };
/// let cube = [0, 1, 2, 3, 4, 5, 6, 7].map(|i| Point3::new(corner(i, 1), corner(i, 2), corner(i, 4)));
/// let (here, there) = (Isometry3::identity(), Isometry3::translation(1.25, 0.0, 0.1));
/// let apart = hull_distance([(&cube, &here), (&cube, &there)]).ok_or("they overlap")?;
/// assert!((apart - 0.25).abs() < 1e-5);
/// assert_eq!(hull_distance([(&cube, &here), (&cube, &here)]), None);
/// # Ok::<(), &str>(())
/// ```
pub fn hull_distance(posed: [(&[Point3<f32>], &Isometry3<f32>); 2]) -> Option<f32> {
    in_own_environment(|| {
        let [(a, from), (b, to)] = posed;
        let reach = |points: &[Point3<f32>]| {
            points.iter().fold(0.0_f32, |most, point| most.max(norm(&point.coords)))
        };
        let precision = Precision::fine(reach(a) + reach(b));
        let rotation = |pose: &Isometry3<f32>| pose.rotation.to_rotation_matrix().into_inner();
        let [a, b] =
            [(a, from), (b, to)].map(|(points, pose)| Hull { points, rotation: rotation(pose) });
        if a.points.is_empty() || b.points.is_empty() {
            return None;
        }
        let apart = from.translation.vector - to.translation.vector;
        separation([&a, &b], &apart, &apart, &precision).map(|found| found.distance)
    })
}

/// How far apart two hulls are.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Separation {
    /// Metres; infinite where it is beyond what is looked for.
    pub(crate) distance: f32,
    /// Unit vector from the first to the second.
    pub(crate) normal: Vector3<f32>,
    /// Their closest points, each from its unit's centre in the world's axes, metres.
    pub(crate) levers: [Vector3<f32>; 2],
}

/// A corner of the simplex in the difference of two hulls.
#[derive(Clone, Copy, Debug)]
struct Corner {
    difference: Vector3<f32>,
    levers: [Vector3<f32>; 2],
}

/// Distance of two hulls of which the first one's centre is at `apart` from the second one's; None where they overlap.
/// The search begins along `guess`, from the second to the first.
#[cfg_attr(rigidformer_dsp, inline(never))]
pub(crate) fn separation(
    [a, b]: [&Hull<'_>; 2],
    apart: &Vector3<f32>,
    guess: &Vector3<f32>,
    precision: &Precision,
) -> Option<Separation> {
    let Precision { tolerance, noise_m, overlap_m, same_m, beyond_m } = *precision;
    let mut simplex = heapless::Vec::<Corner, 4>::new();
    let mut nearest = *guess;
    let mut levers = [Vector3::zeros(); 2];
    for _ in 0..ITERATIONS {
        let (p, q) = (a.support(&opposite(&nearest)), b.support(&nearest));
        let difference = (p - q) + apart;
        let length2 = dot(&nearest, &nearest);
        let known = |old: &Corner| (old.difference - difference).amax() < same_m;
        let along = dot(&nearest, &difference);
        // The hulls are apart along that direction.
        if along > 0.0 && along * along > beyond_m * beyond_m * length2 {
            let far = Separation { distance: f32::INFINITY, normal: Vector3::zeros(), levers };
            return Some(far);
        }
        let gain = length2 - along;
        let allowed = tolerance * length2;
        let more = gain - allowed;
        let done = gain <= allowed || more * more < noise_m * noise_m * length2;
        if !simplex.is_empty() && (done || simplex.iter().any(known)) {
            break;
        }
        // Never full: a simplex of four that does not hold the origin loses a corner below.
        let _ = simplex.push(Corner { difference, levers: [p, q] });
        let mut weights = closest(&simplex)?.into_iter();
        let first = simplex.len() == 1;
        let mut point = Vector3::zeros();
        let [mut mine, mut theirs] = [Vector3::zeros(); 2];
        // In the corners' order, with what is not needed left out.
        simplex.retain(|Corner { difference, levers: [p, q] }| {
            let weight = weights.next().unwrap_or_default();
            let is_needed = weight > 0.0;
            if is_needed {
                point += difference * weight;
                mine += p * weight;
                theirs += q * weight;
            }
            is_needed
        });
        if noise_m > 0.0 {
            point = upright(&point, &simplex);
            // Rounding leads the search astray: the point before was closer.
            if !first && dot(&point, &point) >= length2 {
                break;
            }
        }
        (nearest, levers) = (point, [mine, theirs]);
        if simplex.is_full() || dot(&nearest, &nearest) < overlap_m * overlap_m {
            return None;
        }
    }
    let distance = norm(&nearest);
    (distance >= overlap_m).then(|| Separation { distance, normal: nearest / -distance, levers })
}

/// The point of a simplex that is closest to the origin, exactly across the simplex: a sum of far corners that ends near the
/// origin has kept few digits of its direction.
#[cfg_attr(rigidformer_dsp, inline(never))]
fn upright(point: &Vector3<f32>, simplex: &[Corner]) -> Vector3<f32> {
    let across = |edge: &Vector3<f32>| {
        let length2 = dot(edge, edge);
        if length2 > 0.0 { point - edge * (dot(edge, point) / length2) } else { *point }
    };
    match simplex {
        [a, b] => across(&(b.difference - a.difference)),
        [a, b, c] => {
            let edges = [b.difference - a.difference, c.difference - a.difference];
            let [ab, ac] = &edges;
            let normal = ab.cross(ac);
            let [lengths, square] = [dot(ab, ab) * dot(ac, ac), dot(&normal, &normal)];
            if square > SLIVER * lengths {
                normal * (dot(&normal, point) / square)
            } else if dot(ab, ab) > dot(ac, ac) {
                across(ab)
            } else {
                across(ac)
            }
        }
        _ => *point,
    }
}

/// Weights of a simplex' corners that give its point closest to the origin; None where the origin is inside.
#[cfg_attr(rigidformer_dsp, inline(never))]
fn closest(simplex: &[Corner]) -> Option<[f32; 4]> {
    let [a, b, c, d] = match simplex {
        [a, b] => {
            let (a, b) = (&a.difference, &b.difference);
            let edge = b - a;
            let length2 = dot(&edge, &edge);
            let t = if length2 > 0.0 { (-dot(&edge, a) / length2).clamp(0.0, 1.0) } else { 0.0 };
            return Some([1.0 - t, t, 0.0, 0.0]);
        }
        [a, b, c] => {
            let [u, v, w] = on_triangle(&a.difference, &b.difference, &c.difference);
            return Some([u, v, w, 0.0]);
        }
        [a, b, c, d] => [&a.difference, &b.difference, &c.difference, &d.difference],
        _ => return Some([1.0, 0.0, 0.0, 0.0]),
    };
    let mut least = f32::INFINITY;
    let mut best = None;
    for skipped in 0..4 {
        // Each face, and the corner opposite.
        let [p, q, r, other] = match skipped {
            0 => [b, c, d, a],
            1 => [c, d, a, b],
            2 => [d, a, b, c],
            _ => [a, b, c, d],
        };
        let normal = (q - p).cross(&(r - p));
        // Of the opposite corner and of the origin above the face; a flat simplex has no inside.
        let (side, mine) = (dot(&normal, &(other - p)), -dot(&normal, p));
        if side * mine > 0.0 {
            continue;
        }
        let weights @ [u, v, w] = on_triangle(p, q, r);
        let point = (p * u + q * v) + r * w;
        let length2 = dot(&point, &point);
        if length2 < least {
            least = length2;
            let [u, v, w] = weights;
            best = Some(match skipped {
                0 => [0.0, u, v, w],
                1 => [w, 0.0, u, v],
                2 => [v, w, 0.0, u],
                _ => [u, v, w, 0.0],
            });
        }
    }
    best
}

/// Weights of a triangle's corners that give its point closest to the origin (Ericson, *Real-Time Collision Detection*,
/// section 5.1.5).
fn on_triangle(a: &Vector3<f32>, b: &Vector3<f32>, c: &Vector3<f32>) -> [f32; 3] {
    let (ab, ac) = (b - a, c - a);
    let share = |part: f32, whole: f32| if whole > 0.0 { part / whole } else { 0.0 };
    let (d1, d2) = (-dot(&ab, a), -dot(&ac, a));
    if d1 <= 0.0 && d2 <= 0.0 {
        return [1.0, 0.0, 0.0];
    }
    let (d3, d4) = (-dot(&ab, b), -dot(&ac, b));
    if d3 >= 0.0 && d4 <= d3 {
        return [0.0, 1.0, 0.0];
    }
    let vc = d1 * d4 - d3 * d2;
    if vc <= 0.0 && d1 >= 0.0 && d3 <= 0.0 {
        let t = share(d1, d1 - d3);
        return [1.0 - t, t, 0.0];
    }
    let (d5, d6) = (-dot(&ab, c), -dot(&ac, c));
    if d6 >= 0.0 && d5 <= d6 {
        return [0.0, 0.0, 1.0];
    }
    let vb = d5 * d2 - d1 * d6;
    if vb <= 0.0 && d2 >= 0.0 && d6 <= 0.0 {
        let t = share(d2, d2 - d6);
        return [1.0 - t, 0.0, t];
    }
    let va = d3 * d6 - d5 * d4;
    if va <= 0.0 && d4 >= d3 && d5 >= d6 {
        let t = share(d4 - d3, (d4 - d3) + (d5 - d6));
        return [0.0, 1.0 - t, t];
    }
    let total = (va + vb) + vc;
    if total > 0.0 && va >= 0.0 && vb >= 0.0 && vc >= 0.0 {
        return [va / total, vb / total, vc / total];
    }
    // A sliver, of which rounding says nothing reliable: its edges hold all of it.
    let [first, second, third] = [(a, b), (a, c), (b, c)].map(|(p, q)| {
        let edge = q - p;
        let t = share(-dot(&edge, p), dot(&edge, &edge)).clamp(0.0, 1.0);
        let point = p + edge * t;
        (dot(&point, &point), t)
    });
    if first.0 <= second.0 && first.0 <= third.0 {
        [1.0 - first.1, first.1, 0.0]
    } else if second.0 <= third.0 {
        [1.0 - second.1, 0.0, second.1]
    } else {
        [0.0, 1.0 - third.1, third.1]
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::vec::Vec;

    fn of(hulls: [&Hull<'_>; 2], apart: Vector3<f32>) -> Option<Separation> {
        separation(hulls, &apart, &apart, &Precision::COARSE)
    }

    fn random(state: &mut u32) -> f32 {
        *state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
        (*state >> 8) as f32 / (1 << 23) as f32 - 1.0
    }

    fn cube() -> Vec<Point3<f32>> {
        (0..8)
            .map(|i| {
                let corner = |bit: i32| if i & bit == 0 { -0.5 } else { 0.5 };
                Point3::new(corner(1), corner(2), corner(4))
            })
            .collect()
    }

    #[test]
    fn cubes_face_to_face_and_edge_to_edge() {
        let points = cube();
        let flat = Hull { points: &points, rotation: Matrix3::identity() };
        let found = of([&flat; 2], Vector3::new(0.0, 0.1, 1.25)).unwrap();
        assert!((found.distance - 0.25).abs() < 1e-4, "{found:?}");
        assert!((found.normal + Vector3::z()).norm() < 1e-3, "{found:?}");
        // Turned by 45 degrees about x, its lowest edge is across the other's upper face.
        let half = core::f32::consts::FRAC_1_SQRT_2;
        let tilted = Matrix3::new(1.0, 0.0, 0.0, 0.0, half, -half, 0.0, half, half);
        let tilted = Hull { points: &points, rotation: tilted };
        let found = of([&tilted, &flat], Vector3::new(0.2, 0.0, 1.5)).unwrap();
        assert!((found.distance - (1.0 - half)).abs() < 1e-3, "{found:?}");
        assert_eq!(of([&flat; 2], Vector3::new(0.1, 0.2, 0.9)), None);
        assert_eq!(of([&flat; 2], Vector3::zeros()), None);
    }

    /// The closest points are what they are said to be: no point of either hull is beyond the planes through them.
    #[test]
    fn nothing_is_between_the_closest_points() {
        let mut state = 11;
        let mut apart_count = 0;
        for _ in 0..2000 {
            let mut shape = |count: usize| -> Vec<Point3<f32>> {
                let mut number = || random(&mut state);
                (0..count).map(|_| Point3::new(number(), number(), number())).collect()
            };
            let (a, b) = (shape(12), shape(30));
            let mut number = || random(&mut state);
            let apart = Vector3::new(number(), number(), number()) * 4.0;
            let [a, b] = [&a, &b].map(|points| Hull { points, rotation: Matrix3::identity() });
            let Some(found) = of([&a, &b], apart) else { continue };
            apart_count += 1;
            let Separation { distance, normal, levers: [p, q] } = found;
            assert!((normal.norm() - 1.0).abs() < 1e-5);
            assert!((((q - p) - apart) - normal * distance).norm() < 1e-4, "{found:?}");
            let reach = dot(&a.support(&normal), &normal) - dot(&p, &normal);
            let back = dot(&q, &normal) - dot(&b.support(&-normal), &normal);
            assert!(reach + back < 2e-3 * distance + 1e-5, "{found:?} {reach} {back}");
        }
        assert!(apart_count > 500, "{apart_count}");
    }
}
