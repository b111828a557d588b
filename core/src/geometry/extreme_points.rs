//! What is asked of a unit's convex hull, without building it: its extreme points and its centroid.

use super::dot;
use nalgebra::{Point3, Vector3};

/// Subdivision of the octahedron whose lattice points are the directions in which a hull is felt for: 258 of them.
const LATTICE: i32 = 8;
const SIDE: usize = 2 * LATTICE as usize + 1;
/// A point deeper below the hull than this share of twice the radius says that the hull is not the unit's shape: a ring,
/// a cup.
const HOLLOW: f32 = 0.08;
/// Share of the cube of the radius that six volumes must have: a flat hull's centroid is noise.
const FLAT: f32 = 1e-3;

/// For each lattice direction the point that is farthest that way: lower half, then upper half, by y, then x.
struct Extremes([u32; 2 * SIDE * SIDE]);

fn slot_of([x, y, z]: [i32; 3]) -> usize {
    let row = |value: i32| (value + LATTICE) as usize;
    (usize::from(z > 0) * SIDE + row(y)) * SIDE + row(x)
}

/// All 258 directions, |x| + |y| + |z| = [`LATTICE`].
fn directions() -> impl Iterator<Item = [i32; 3]> {
    (-LATTICE..=LATTICE).flat_map(|y| {
        let reach = LATTICE - y.abs();
        (-reach..=reach).flat_map(move |x| {
            let z = reach - x.abs();
            // On the equator both halves are one.
            [[x, y, -z], [x, y, z]].into_iter().take(if z == 0 { 1 } else { 2 })
        })
    })
}

fn vector(direction: [i32; 3]) -> Vector3<f32> {
    Vector3::from(direction.map(|value| value as f32))
}

/// As vectors, of no unit length.
#[cfg(any(feature = "deform", feature = "health"))]
pub(crate) fn felt_directions() -> impl Iterator<Item = Vector3<f32>> {
    directions().map(vector)
}

impl Extremes {
    /// Distances are taken from `middle`; of equally far points the first counts.
    #[cfg_attr(rigidformer_dsp, inline(never))]
    fn new(points: &[Point3<f32>], middle: &Point3<f32>) -> Self {
        let mut found = [0; 2 * SIDE * SIDE];
        for direction in directions() {
            let along = vector(direction);
            let mut best = (0, f32::NEG_INFINITY);
            for (index, point) in (0..).zip(points) {
                let reach = dot(&(point - middle), &along);
                if reach > best.1 {
                    best = (index, reach);
                }
            }
            if let Some(slot) = found.get_mut(slot_of(direction)) {
                *slot = best.0;
            }
        }
        Extremes(found)
    }

    fn at(&self, direction: [i32; 3]) -> usize {
        self.0.get(slot_of(direction)).map_or(0, |index| *index as usize)
    }

    /// The point that is farthest along a direction, from the middle.
    fn corner(
        &self,
        points: &[Point3<f32>],
        middle: &Point3<f32>,
        direction: [i32; 3],
    ) -> Vector3<f32> {
        points.get(self.at(direction)).map_or_else(Vector3::zeros, |point| point - middle)
    }

    /// Marks the points that are farthest in a direction with 1, the others with 0.
    #[cfg_attr(rigidformer_dsp, inline(never))]
    fn mark(&self, marks: &mut [f32]) {
        marks.fill(0.0);
        for direction in directions() {
            if let Some(mark) = marks.get_mut(self.at(direction)) {
                *mark = 1.0;
            }
        }
    }
}

/// The convex hull of points, felt for in 258 directions.
#[derive(Clone, Copy)]
pub(crate) struct Felt {
    /// The points' mean.
    pub(crate) middle: Point3<f32>,
    /// Six times the volume.
    pub(crate) volume: f32,
    /// The centroid's offset from the middle, times that.
    pub(crate) offset: Vector3<f32>,
}

impl Felt {
    #[cfg_attr(rigidformer_dsp, inline(never))]
    pub(crate) fn new(points: &[Point3<f32>]) -> Self {
        let middle = mean(points);
        Felt::of(points, middle, &Extremes::new(points, &middle))
    }

    #[cfg_attr(rigidformer_dsp, inline(never))]
    fn of(points: &[Point3<f32>], middle: Point3<f32>, extremes: &Extremes) -> Self {
        let (mut volume, mut moment) = (0.0_f32, Vector3::zeros());
        for octant in 0..8 {
            let sign = |axis: i32| 1 - 2 * (octant >> axis & 1);
            let [x, y, z] = [sign(0), sign(1), sign(2)];
            let corner =
                |[u, v, w]: [i32; 3]| extremes.corner(points, &middle, [u * x, v * y, w * z]);
            for i in 0..LATTICE {
                for j in 0..LATTICE - i {
                    let k = LATTICE - i - j;
                    let (b, c) = ([i + 1, j, k - 1], [i, j + 1, k - 1]);
                    let first = [[i, j, k], b, c];
                    let second = [b, [i + 1, j + 1, k - 2], c];
                    for triangle in [first, second].into_iter().take(if k < 2 { 1 } else { 2 }) {
                        let [p, q, r] = triangle.map(corner);
                        // Mirrored octants turn the other way round.
                        let part = (x * y * z) as f32 * dot(&p, &q.cross(&r));
                        volume += part;
                        moment += ((p + q) + r) * part;
                    }
                }
            }
        }
        Felt { middle, volume, offset: moment / 4.0 }
    }
}

/// The mean of points.
fn mean(points: &[Point3<f32>]) -> Point3<f32> {
    // From one of them: a sum of far coordinates would lose digits.
    let first = points.first().copied().unwrap_or_default();
    let mut sum = Vector3::zeros();
    for point in points {
        sum += point - first;
    }
    first + sum / points.len() as f32
}

/// Centroid of the convex hull of points: exact to some millimetres a metre. None where they are flat, or where some lie
/// so deep that the hull is not their shape.
pub(super) fn hull_centre(points: &[Point3<f32>]) -> Option<Point3<f32>> {
    points.first()?;
    let middle = mean(points);
    let extremes = Extremes::new(points, &middle);
    let Felt { volume, offset, .. } = Felt::of(points, middle, &extremes);
    let radius =
        points.iter().fold(0.0_f32, |most, point| most.max(super::norm(&(point - middle))));
    if volume.is_nan() || volume <= FLAT * (radius * radius * radius) {
        return None;
    }
    let deepest = HOLLOW * 2.0 * radius;
    let shallow = |point: &Point3<f32>| {
        directions().any(|direction| {
            let along = vector(direction);
            let corner = extremes.corner(points, &middle, direction);
            let depth = dot(&corner, &along) - dot(&(point - middle), &along);
            depth * depth <= deepest * deepest * dot(&along, &along)
        })
    };
    points.iter().all(shallow).then(|| middle + offset / volume)
}

/// A hull that holds a sphere of this share of its radius counts as a ball. Polyhedra from 120 points on a sphere are
/// that round.
const BALL: f32 = 0.975;

/// Copies the points that are farthest in one of 258 directions into `hull`, in their order. Returns how many they are, as
/// many as `hull` holds, at most, and whether they are those of a ball: in each direction one is nearly as far as any.
/// `marks` is scratch of a number a point.
pub(crate) fn extreme_points(
    points: &[Point3<f32>],
    marks: &mut [f32],
    hull: &mut [Point3<f32>],
) -> (usize, bool) {
    let extremes = Extremes::new(points, &Point3::origin());
    extremes.mark(marks);
    let radius = points.iter().fold(0.0_f32, |most, point| most.max(super::norm(&point.coords)));
    let least = BALL * radius;
    let mut is_ball = true;
    for direction in directions() {
        let along = vector(direction);
        let point = points.get(extremes.at(direction)).copied().unwrap_or_default();
        let reach = dot(&point.coords, &along).max(0.0);
        is_ball &= reach * reach >= least * least * dot(&along, &along);
    }
    let mut count = 0;
    let marked = points.iter().zip(marks).filter(|(_, mark)| **mark > 0.0);
    for ((point, _), slot) in marked.zip(hull) {
        *slot = *point;
        count += 1;
    }
    (count, is_ball)
}

/// Keeps the points that are farthest in one of 258 directions from the first one in front, in their order. How many they
/// are. `marks` is scratch of a number a point.
#[cfg_attr(rigidformer_dsp, inline(never))]
pub(crate) fn keep_extremes(points: &mut [Point3<f32>], marks: &mut [f32]) -> usize {
    let Some(first) = points.first().copied() else { return 0 };
    Extremes::new(points, &first).mark(marks);
    let mut count = 0;
    for (number, _) in marks.iter().enumerate().filter(|(_, mark)| **mark > 0.0) {
        let Some(point) = points.get(number).copied() else { break };
        if let Some(place) = points.get_mut(count) {
            *place = point;
            count += 1;
        }
    }
    count
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::vec::Vec;

    #[test]
    fn the_lattice_has_258_directions() {
        let mut all: Vec<_> = directions().collect();
        assert!(all.iter().all(|d| d.iter().map(|v| v.abs()).sum::<i32>() == LATTICE));
        all.sort();
        all.dedup();
        assert_eq!(all.len(), 258);
    }

    /// A tetrahedron's centroid is the mean of its corners, wherever points lie thickest.
    #[test]
    fn a_dense_edge_does_not_pull_the_centre_aside() {
        let corners = [[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 2.0, 0.0], [0.0, 0.0, 1.5]];
        let mut points: Vec<Point3<f32>> = corners.map(Point3::from).to_vec();
        points.extend((1..40).map(|i| Point3::new(i as f32 / 40.0, 0.0, 0.0)));
        let centre = hull_centre(&points).unwrap();
        assert!((centre - Point3::new(0.25, 0.5, 0.375)).norm() < 1e-5, "{centre}");
    }

    #[test]
    fn flat_and_hollow_points_have_no_hull_centre() {
        let flat: Vec<_> =
            (0..16).map(|i| Point3::new((i % 4) as f32, (i / 4) as f32, 1.0)).collect();
        assert_eq!(hull_centre(&flat), None);
        let corners =
            (0..8).map(|i| Point3::new((i & 1) as f32, (i >> 1 & 1) as f32, (i >> 2) as f32));
        let mut cube: Vec<_> = corners.collect();
        let centre = hull_centre(&cube).unwrap();
        assert!((centre - Point3::new(0.5, 0.5, 0.5)).norm() < 1e-6, "{centre}");
        cube.push(Point3::new(0.5, 0.5, 0.5));
        assert_eq!(hull_centre(&cube), None);
        assert_eq!(hull_centre(&[]), None);
    }

    #[test]
    fn extreme_points_keep_their_order_and_leave_the_inside_out() {
        let mut points: Vec<_> = (0..8)
            .map(|i| {
                let corner = |bit: i32| if i & bit == 0 { -0.5 } else { 0.5 };
                Point3::new(corner(1), corner(2), corner(4))
            })
            .collect();
        points.insert(3, Point3::new(0.1, 0.2, 0.0));
        let (mut marks, mut hull) = ([0.0; 9], [Point3::origin(); 9]);
        assert_eq!(extreme_points(&points, &mut marks, &mut hull), (8, false));
        points.remove(3);
        assert_eq!(hull[..8], points[..]);
    }
}
