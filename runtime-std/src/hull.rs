//! Convex hulls by quickhull, for overlap depths and for pictures.

use std::collections::HashMap;
use std::mem;

use nalgebra::{Point3, Vector3};
use rigidformer_core::kernels::in_own_environment;

/// Height up to which a point counts as on a face, relative to the points' extent.
// It is above the rounding of f32 coordinates, 6e-8 of them, and below any depth that matters.
const FACE_TOLERANCE: f64 = 1e-5;

/// Height of a point on a face by f64 rounding alone, relative to that tolerance.
const ROUNDING_SHARE: f64 = 1e-7;

/// The convex hull of points that enclose a volume.
///
/// ```
/// use nalgebra::Point3;
/// use rigidformer_runtime::hull::ConvexHull;
/// let corners: Vec<Point3<f32>> =
///     (0..8).map(|i| Point3::new((i & 1) as f32, (i >> 1 & 1) as f32, (i >> 2) as f32)).collect();
/// let hull = ConvexHull::new(&corners).ok_or("flat")?;
/// assert_eq!(hull.faces().len(), 12);
/// assert!((hull.depth_m(&Point3::new(0.5, 0.5, 0.9)) - 0.1).abs() < 1e-6);
/// assert_eq!(hull.depth_m(&Point3::new(0.5, 0.5, 1.1)), 0.0);
/// # Ok::<(), &str>(())
/// ```
#[derive(Clone, Debug)]
pub struct ConvexHull {
    /// (faces) indices into the points, counter-clockwise seen from outside
    faces: Vec<[usize; 3]>,
    /// (faces) unit outward normal and its offset: n · x = offset on the face
    planes: Vec<(Vector3<f32>, f32)>,
}

struct Face {
    corners: [usize; 3],
    normal: Vector3<f64>,
    offset: f64,
    /// Points above this face that no other face owns.
    outside: Vec<usize>,
    /// Whether a later corner has replaced it.
    removed: bool,
}

impl Face {
    fn new(points: &[Vector3<f64>], corners: [usize; 3]) -> Self {
        let [a, b, c] = corners.map(|corner| points[corner]);
        let normal = (b - a).cross(&(c - a)).try_normalize(1e-18).unwrap_or_default();
        Face { corners, normal, offset: normal.dot(&a), outside: Vec::new(), removed: false }
    }

    /// Height of a point above the face; 0 for a face without area, so that no point is above it.
    fn height(&self, point: &Vector3<f64>) -> f64 {
        self.normal.dot(point) - self.offset
    }

    fn edges(&self) -> [(usize, usize); 3] {
        let [a, b, c] = self.corners;
        [(a, b), (b, c), (c, a)]
    }
}

impl ConvexHull {
    /// The hull of `points` in any order; `None` if they are fewer than 4, not finite, or (nearly) in one plane.
    pub fn new(points: &[Point3<f32>]) -> Option<Self> {
        in_own_environment(|| Self::around(points))
    }

    fn around(points: &[Point3<f32>]) -> Option<Self> {
        let points: Vec<Vector3<f64>> = points.iter().map(|point| point.coords.cast()).collect();
        // Comparisons with NaN would leave faces open.
        if !points.iter().all(|point| point.iter().all(|v| v.is_finite())) {
            return None;
        }
        let (mut faces, tolerance) = first_tetrahedron(&points)?;
        assign_points(&points, &mut faces, 0..points.len(), tolerance);
        let mut face_of_edge: HashMap<(usize, usize), usize> = HashMap::new();
        for (index, face) in faces.iter().enumerate() {
            face_of_edge.extend(face.edges().map(|edge| (edge, index)));
        }
        // Points of a removed face go to faces behind it in the list, so earlier faces need no second visit. Each round adds a corner, so
        // there are at most as many rounds as points.
        let mut first = 0;
        while first < faces.len() {
            match highest(&points, &faces[first]) {
                Some(corner) => {
                    add_corner(&points, &mut faces, &mut face_of_edge, first, corner, tolerance);
                }
                None => first += 1,
            }
        }
        // Removed faces stay in the list until here, because edges refer to faces by index.
        faces.retain(|face| !face.removed && face.normal != Vector3::zeros());
        let planes = faces.iter().map(|face| (face.normal.cast(), face.offset as f32)).collect();
        Some(Self { faces: faces.into_iter().map(|face| face.corners).collect(), planes })
    }

    /// (faces) Triangles as indices of the points, counter-clockwise seen from outside.
    pub fn faces(&self) -> &[[usize; 3]] {
        &self.faces
    }

    /// How far a point is above the hull's surface, metres: the greatest of its heights above the planes of the faces, so
    /// negative inside. Outside beyond an edge or a corner it is less than the distance to the hull, never more.
    ///
    /// ```
    /// use nalgebra::Point3;
    /// use rigidformer_runtime::hull::ConvexHull;
    /// let corners: Vec<Point3<f32>> =
    ///     (0..8).map(|i| Point3::new((i & 1) as f32, (i >> 1 & 1) as f32, (i >> 2) as f32)).collect();
    /// let hull = ConvexHull::new(&corners).ok_or("flat")?;
    /// assert!((hull.height_m(&Point3::new(0.5, 0.5, 1.2)) - 0.2).abs() < 1e-6);
    /// assert!((hull.height_m(&Point3::new(0.5, 0.5, 0.9)) + 0.1).abs() < 1e-6);
    /// # Ok::<(), &str>(())
    /// ```
    pub fn height_m(&self, point: &Point3<f32>) -> f32 {
        let height = |(normal, offset): &(Vector3<f32>, f32)| normal.dot(&point.coords) - offset;
        in_own_environment(|| self.planes.iter().map(height).fold(f32::NEG_INFINITY, f32::max))
    }

    /// Outward normal of the face that is nearest to the origin, and how far beyond the origin it is: negative where the origin is
    /// above it. The farthest one of those that it is above.
    pub(crate) fn nearest_face(&self) -> Option<(Vector3<f32>, f32)> {
        self.planes.iter().copied().min_by(|(_, a), (_, b)| a.total_cmp(b))
    }

    /// Distance from a point inside to the nearest face, metres; 0 outside.
    pub fn depth_m(&self, point: &Point3<f32>) -> f32 {
        in_own_environment(|| self.depth_here(point))
    }

    fn depth_here(&self, point: &Point3<f32>) -> f32 {
        let mut depth = f32::INFINITY;
        for (normal, offset) in &self.planes {
            depth = depth.min(offset - normal.dot(&point.coords));
            if depth <= 0.0 {
                return 0.0;
            }
        }
        if depth.is_finite() { depth } else { 0.0 }
    }
}

/// Four faces over four far points, and the tolerance in metres.
fn first_tetrahedron(points: &[Vector3<f64>]) -> Option<(Vec<Face>, f64)> {
    let farthest = |measure: &dyn Fn(&Vector3<f64>) -> f64| {
        (0..points.len()).max_by(|a, b| measure(&points[*a]).total_cmp(&measure(&points[*b])))
    };
    let a = farthest(&|point| -point.x)?;
    let b = farthest(&|point| (point - points[a]).norm())?;
    let extent = (points[b] - points[a]).norm();
    let tolerance = FACE_TOLERANCE * extent;
    let along = (points[b] - points[a]).try_normalize(1e-18)?;
    let c = farthest(&|point| (point - points[a]).cross(&along).norm())?;
    let base = Face::new(points, [a, b, c]);
    let d = farthest(&|point| base.height(point).abs())?;
    let height = base.height(&points[d]);
    // All points are in one plane.
    if height.abs() <= tolerance {
        return None;
    }
    // Where d is above the base, the base is reversed, so that its normal points outwards.
    let [b, c] = if height > 0.0 { [c, b] } else { [b, c] };
    let faces =
        [[a, b, c], [a, d, b], [b, d, c], [c, d, a]].map(|corners| Face::new(points, corners));
    Some((faces.into(), tolerance))
}

/// Assigns each of the points to the first face that it is above, if any.
fn assign_points(
    points: &[Vector3<f64>],
    faces: &mut [Face],
    which: impl IntoIterator<Item = usize>,
    tolerance: f64,
) {
    for point in which {
        if let Some(face) = faces.iter_mut().find(|face| face.height(&points[point]) > tolerance) {
            face.outside.push(point);
        }
    }
}

/// The highest of the points above a face.
fn highest(points: &[Vector3<f64>], face: &Face) -> Option<usize> {
    let height = |point: usize| face.height(&points[point]);
    face.outside.iter().copied().max_by(|a, b| height(*a).total_cmp(&height(*b)))
}

/// Replaces the faces that are visible from `corner` by a cone from it to their horizon.
fn add_corner(
    points: &[Vector3<f64>],
    faces: &mut Vec<Face>,
    face_of_edge: &mut HashMap<(usize, usize), usize>,
    above: usize,
    corner: usize,
    tolerance: f64,
) {
    // The search goes from neighbour to neighbour, so that the visible faces are connected. A cone over two separate horizons would make a
    // hull that crosses itself, and the rounds would not end. Faces visible by less than the tolerance are removed too, because they would
    // leave a concave edge.
    faces[above].removed = true;
    let mut visible = vec![above];
    let mut next = 0;
    while let Some(face) = visible.get(next) {
        next += 1;
        for (a, b) in faces[*face].edges() {
            let Some(neighbour) = face_of_edge.get(&(b, a)) else { continue };
            let face = &mut faces[*neighbour];
            if !face.removed && face.height(&points[corner]) > ROUNDING_SHARE * tolerance {
                face.removed = true;
                visible.push(*neighbour);
            }
        }
    }
    // In the order of the list, so that the hull does not depend on the search.
    visible.sort_unstable();
    let is_horizon = |(a, b): &(usize, usize)| {
        face_of_edge.get(&(*b, *a)).is_some_and(|neighbour| !faces[*neighbour].removed)
    };
    let horizon: Vec<_> =
        visible.iter().flat_map(|face| faces[*face].edges()).filter(is_horizon).collect();
    let orphans: Vec<_> = visible
        .iter()
        .flat_map(|face| mem::take(&mut faces[*face].outside))
        .filter(|point| *point != corner)
        .collect();
    let first_new = faces.len();
    for (a, b) in horizon {
        let face = Face::new(points, [a, b, corner]);
        face_of_edge.extend(face.edges().map(|edge| (edge, faces.len())));
        faces.push(face);
    }
    assign_points(points, &mut faces[first_new..], orphans, tolerance);
}

#[cfg(test)]
mod tests {
    use super::*;

    fn sphere(count: usize) -> Vec<Point3<f32>> {
        // Fibonacci points.
        (0..count)
            .map(|i| {
                let z = 1.0 - 2.0 * (i as f32 + 0.5) / count as f32;
                let (sin, cos) = (i as f32 * 2.399_963).sin_cos();
                let r = (1.0 - z * z).sqrt();
                Point3::new(r * cos, r * sin, z)
            })
            .collect()
    }

    #[test]
    fn a_sphere_has_all_points_as_corners_and_closes() {
        for count in [4, 5, 12, 64, 1142] {
            let points = sphere(count);
            let hull = ConvexHull::new(&points).unwrap();
            assert_eq!(hull.faces().len(), 2 * count - 4, "Euler, {count} points");
            for point in &points {
                assert!(
                    hull.planes.iter().all(|(n, offset)| n.dot(&point.coords) <= offset + 1e-4)
                );
            }
            assert!(hull.depth_m(&Point3::origin()) > 0.0);
        }
    }

    /// Rings of points on a ball: four in about one plane, again and again.
    fn globe(rings: usize, around: usize) -> Vec<Point3<f32>> {
        let at = |ring: usize, k: usize| {
            let (down, along) = (ring as f32 / rings as f32, k as f32 / around as f32);
            let (r, z) = (std::f32::consts::PI * down).sin_cos();
            let (sin, cos) = (std::f32::consts::TAU * along).sin_cos();
            Point3::new(r * cos, r * sin, z)
        };
        let poles = [Point3::new(0.0, 0.0, 1.0), Point3::new(0.0, 0.0, -1.0)];
        (1..rings).flat_map(|ring| (0..around).map(move |k| at(ring, k))).chain(poles).collect()
    }

    #[test]
    fn dense_balls_close_and_nothing_is_above_a_face() {
        for points in [sphere(3600), globe(50, 50), globe(60, 60)] {
            let hull = ConvexHull::new(&points).unwrap();
            assert_eq!(hull.faces().len(), 2 * points.len() - 4, "Euler");
            for face in hull.faces() {
                let [a, b, c] = face.map(|corner| points[corner].coords.cast::<f64>());
                let normal = (b - a).cross(&(c - a)).normalize();
                let above = points.iter().map(|p| normal.dot(&(p.coords.cast() - a)));
                assert!(above.fold(0.0, f64::max) < 2e-5);
            }
        }
        // All at once: time that grows with the square of them would be minutes.
        let many = ConvexHull::new(&globe(200, 300)).unwrap();
        assert!(many.faces().len() > 100_000);
    }

    #[test]
    fn a_grid_on_a_box_closes() {
        let mut points = Vec::new();
        for x in 0..5 {
            for y in 0..5 {
                for z in 0..5 {
                    points.push(Point3::new(x as f32 * 0.1, y as f32 * 0.07, z as f32 * 0.3));
                }
            }
        }
        let hull = ConvexHull::new(&points).unwrap();
        let volume: f32 = hull
            .faces()
            .iter()
            .map(|face| {
                let [a, b, c] = face.map(|i| points[i].coords);
                a.cross(&b).dot(&c) / 6.0
            })
            .sum();
        assert!((volume - 0.4 * 0.28 * 1.2).abs() < 1e-5, "{volume}");
    }

    #[test]
    fn flat_and_foul_points_have_no_hull() {
        assert!(ConvexHull::new(&[]).is_none());
        assert!(ConvexHull::new(&[Point3::origin(); 9]).is_none());
        let plane: Vec<_> =
            (0..9).map(|i| Point3::new((i % 3) as f32, (i / 3) as f32, 1.0)).collect();
        assert!(ConvexHull::new(&plane).is_none());
        let mut foul = sphere(12);
        foul[3].x = f32::NAN;
        assert!(ConvexHull::new(&foul).is_none());
    }
}
