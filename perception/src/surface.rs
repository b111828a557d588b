//! What has been seen of a unit's surface: small plane pieces (surfels) in the unit's frame, and the reference points that are made of them.

use std::collections::HashMap;
use std::sync::Arc;

use kiddo::{ImmutableKdTree, SquaredEuclidean};
use nalgebra::{Point3, Vector3};

/// Surfels of a surface, at most.
const MOST_SURFELS: usize = 900;
/// Cells along the longest side of what is seen first.
const CELLS: f32 = 16.0;
/// Reference points of a unit, at most.
pub(super) const MOST_POINTS: usize = 256;
/// Distance of reference points, in parts of the unit's radius: about 250 of them cover a sphere.
const SPACING: f32 = 0.22;
/// Captures in which a surfel was seen before it makes a reference point.
const SEEN: u16 = 2;
/// Information of a surfel, at most, in that of the observation that is added: older ones fade, so that errors of poses do not last.
const MOST_OBSERVATIONS: f32 = 30.0;

/// A surface element: a small plane piece, in the unit's frame.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Surfel {
    pub(super) point: Point3<f32>,
    pub(super) normal: Vector3<f32>,
    /// Along the normal, 1/m^2.
    pub(super) information: f32,
    /// Captures in which it was seen.
    seen: u16,
    /// The capture in which it was seen last.
    last: u64,
    /// Captures in which something was seen behind it.
    seen_through: u8,
}

/// Cell, and which of six ways a surface faces: two sides of a thin body share a cell.
type Key = [i32; 4];

/// Surfels of a surface, at most one a cell and way.
pub(super) struct Surface {
    surfels: Vec<Surfel>,
    cells: HashMap<Key, u32>,
    cell_m: f32,
    tree: Option<ImmutableKdTree<f32, 3>>,
    points: Arc<[Point3<f32>]>,
    /// Of all surfels from the origin of the frame, metres.
    radius_m: f32,
}

/// The surfel nearest to a point.
#[derive(Clone, Copy, Debug)]
pub(super) struct Nearest<'s> {
    pub(super) surfel: &'s Surfel,
    pub(super) square_m2: f32,
}

impl Surface {
    /// An empty one, of a body of about this size.
    pub(super) fn new(extent_m: f32) -> Self {
        Surface {
            surfels: Vec::new(),
            cells: HashMap::new(),
            cell_m: (extent_m / CELLS).max(1e-4),
            tree: None,
            points: Arc::from([]),
            radius_m: 0.0,
        }
    }

    pub(super) fn surfels(&self) -> &[Surfel] {
        &self.surfels
    }

    pub(super) fn points(&self) -> &Arc<[Point3<f32>]> {
        &self.points
    }

    pub(super) fn cell_m(&self) -> f32 {
        self.cell_m
    }

    pub(super) fn radius_m(&self) -> f32 {
        self.radius_m
    }

    /// The surfel nearest to a point of the unit's frame.
    pub(super) fn nearest(&self, point: &Point3<f32>) -> Option<Nearest<'_>> {
        let tree = self.tree.as_ref()?;
        let query = [point.x, point.y, point.z];
        let found = tree.query(&query).nearest_one::<SquaredEuclidean<f32>>().execute();
        let surfel = self.surfels.get(found.item as usize)?;
        Some(Nearest { surfel, square_m2: found.distance })
    }

    /// Adds what was seen in a capture: points, normals and the deviation along them, in the unit's frame.
    pub(super) fn add(
        &mut self,
        capture: u64,
        seen: impl Iterator<Item = (Point3<f32>, Vector3<f32>, f32)>,
    ) {
        for (point, normal, deviation_m) in seen {
            if !point.iter().chain(normal.iter()).all(|number| number.is_finite()) {
                continue;
            }
            let information = 1.0 / (deviation_m * deviation_m).max(1e-9);
            let (seen, last) = (1, capture);
            self.put(Surfel { point, normal, information, seen, last, seen_through: 0 });
        }
        if self.surfels.len() > MOST_SURFELS {
            self.coarsen();
        }
        self.index();
    }

    /// Drops surfels that something was seen behind again and again. `is_open` says of a surfel whether that was so in this capture.
    pub(super) fn carve(&mut self, is_open: impl Fn(&Surfel) -> bool) {
        let before = self.surfels.len();
        for surfel in &mut self.surfels {
            surfel.seen_through = match is_open(surfel) {
                true => surfel.seen_through.saturating_add(1),
                false => surfel.seen_through.saturating_sub(1),
            };
        }
        self.surfels.retain(|surfel| surfel.seen_through < 4);
        if self.surfels.len() < before {
            self.rehash();
            self.index();
        }
    }

    /// Drops the surfels that are within a cell of points that turned out to be of something else.
    pub(super) fn drop_near(&mut self, points: &[Point3<f32>]) {
        let all: Vec<[f32; 3]> = points.iter().map(|point| (*point).into()).collect();
        if all.is_empty() {
            return;
        }
        let Ok(tree) = ImmutableKdTree::<f32, 3>::new_from_slice(&all) else { return };
        let limit = self.cell_m * self.cell_m;
        self.surfels.retain(|surfel| {
            let query: [f32; 3] = surfel.point.into();
            tree.query(&query).nearest_one::<SquaredEuclidean<f32>>().execute().distance > limit
        });
        self.rehash();
        self.index();
    }

    fn key(&self, point: &Point3<f32>, normal: &Vector3<f32>) -> Key {
        let cell = point.coords / self.cell_m;
        let axis = normal.iamax();
        let way = 2 * axis as i32 + i32::from(normal[axis] < 0.0);
        [cell.x.floor() as i32, cell.y.floor() as i32, cell.z.floor() as i32, way]
    }

    fn put(&mut self, new: Surfel) {
        let key = self.key(&new.point, &new.normal);
        if let Some(surfel) = self.cells.get(&key).and_then(|at| self.surfels.get_mut(*at as usize))
        {
            let old = surfel.information.min(MOST_OBSERVATIONS * new.information);
            let part = new.information / (old + new.information);
            surfel.point += (new.point - surfel.point) * part;
            let normal = surfel.normal + (new.normal - surfel.normal) * part;
            surfel.normal = normal.try_normalize(1e-6).unwrap_or(surfel.normal);
            surfel.information = old + new.information;
            if surfel.last != new.last {
                surfel.seen = surfel.seen.saturating_add(new.seen);
                surfel.last = new.last;
            }
            return;
        }
        self.cells.insert(key, self.surfels.len() as u32);
        self.surfels.push(new);
    }

    /// Larger cells, so that there are fewer surfels.
    fn coarsen(&mut self) {
        while self.surfels.len() > MOST_SURFELS {
            self.cell_m *= 1.4;
            self.rehash();
        }
    }

    fn rehash(&mut self) {
        let surfels = std::mem::take(&mut self.surfels);
        self.cells.clear();
        surfels.into_iter().for_each(|surfel| self.put(surfel));
    }

    fn index(&mut self) {
        let all: Vec<[f32; 3]> = self.surfels.iter().map(|surfel| surfel.point.into()).collect();
        self.tree = if all.is_empty() { None } else { ImmutableKdTree::new_from_slice(&all).ok() };
        let farthest = self.surfels.iter().map(|surfel| surfel.point.coords.norm());
        self.radius_m = farthest.fold(0.0, f32::max);
        self.grow();
    }

    /// Adds reference points where there are none.
    fn grow(&mut self) {
        let least = (SPACING * self.radius_m).powi(2);
        let mut points: Vec<Point3<f32>> = Vec::new();
        for surfel in self.surfels.iter().filter(|surfel| surfel.seen >= SEEN) {
            if self.points.len() + points.len() >= MOST_POINTS {
                break;
            }
            let is_far = |other: &Point3<f32>| (other - surfel.point).norm_squared() > least;
            if self.points.iter().chain(&points).all(is_far) {
                points.push(surfel.point);
            }
        }
        if !points.is_empty() {
            self.points = self.points.iter().chain(&points).copied().collect();
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn sphere(count: usize) -> Vec<(Point3<f32>, Vector3<f32>, f32)> {
        let at = |i: usize| {
            let z = 1.0 - 2.0 * (i as f32 + 0.5) / count as f32;
            let (sin, cos) = (i as f32 * 2.399_963).sin_cos();
            let r = (1.0 - z * z).sqrt();
            let normal = Vector3::new(r * cos, r * sin, z);
            (Point3::from(normal * 0.1), normal, 0.001)
        };
        (0..count).map(at).collect()
    }

    #[test]
    fn points_are_bounded_and_never_move() {
        let mut surface = Surface::new(0.2);
        let seen = sphere(3000);
        surface.add(0, seen.iter().take(1000).copied());
        assert!(surface.points().is_empty(), "seen once");
        surface.add(1, seen.iter().take(1000).copied());
        let first = surface.points().clone();
        assert!(first.len() > 20);
        for capture in 2..8 {
            surface.add(capture, seen.iter().copied());
            assert!(surface.surfels().len() <= MOST_SURFELS);
        }
        assert!(surface.points().len() > 2 * first.len() && surface.points().len() <= MOST_POINTS);
        assert_eq!(&surface.points()[..first.len()], &first[..]);
        let near = surface.nearest(&Point3::new(0.0, 0.0, 0.12)).unwrap();
        assert!((near.surfel.point - Point3::new(0.0, 0.0, 0.1)).norm() < surface.cell_m());
    }

    #[test]
    fn what_is_seen_through_goes() {
        let mut surface = Surface::new(0.2);
        surface.add(0, sphere(500).into_iter());
        for _ in 0..4 {
            surface.carve(|surfel| surfel.point.z > 0.0);
        }
        assert!(surface.surfels().iter().all(|surfel| surfel.point.z <= 0.0));
        assert!(surface.nearest(&Point3::new(0.0, 0.0, -0.1)).is_some());
    }
}
