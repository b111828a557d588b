//! The observed surface of a unit: surfels (small plane elements) in the unit's frame, and the reference points that are made of them.

use std::collections::HashMap;
use std::num::NonZeroUsize;
use std::sync::Arc;

use kiddo::{ImmutableKdTree, SquaredEuclidean};
use nalgebra::{Point3, Vector3};

/// Surfels of a surface, at most.
// It bounds memory and the time of registration, whatever the size of the unit.
const MAX_SURFELS: usize = 900;
/// Cells along the diameter of a unit's first observation.
const CELLS: f32 = 16.0;
/// Reference points of a unit, at most.
pub(super) const MAX_REFERENCE_POINTS: usize = 256;
/// Least distance of reference points, in radii of the unit.
// At this distance about 250 points cover a sphere, within [`MAX_REFERENCE_POINTS`].
const SPACING: f32 = 0.22;
/// Captures that a surfel needs to become a reference point.
// Reference points never move, so noise of a single capture must not make one.
const MIN_CAPTURES: u16 = 2;
/// Largest information of a surfel, in that of a new observation.
// Older observations fade, so that their errors of pose do not persist.
const MAX_INFORMATION_RATIO: f32 = 30.0;

/// A surface element: a small plane piece, in the unit's frame.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Surfel {
    pub(super) point: Point3<f32>,
    pub(super) normal: Vector3<f32>,
    /// Along the normal, 1/m^2.
    pub(super) information: f32,
    /// Captures that observed it.
    captures: u16,
    /// The last of them.
    last: u64,
    /// Captures in which a camera measured a point behind it, less those in which none did.
    free_captures: u8,
}

const TWO: NonZeroUsize = NonZeroUsize::new(2).unwrap();
/// Error of a distance by rounding, in lengths of its size.
const ROUNDING: f32 = 4.0 * f32::EPSILON;
/// Least cosine between normals of elements of one side.
const SAME_SIDE: f32 = 0.5;
/// Radius of a ball inside a mesh, in that of the ball around it, from which the mesh is a ball's.
const BALL_SHARE: f32 = 0.9;
/// Least deviation of a surface between known elements, in their spacing.
const KNOWN_DEVIATION: f32 = 0.002;

/// Cell, and which of six directions a surface faces.
// Both sides of a thin body may lie in one cell, and must not be averaged.
type Key = [i32; 4];

/// Surfels of a surface, at most one for each cell and direction.
pub(super) struct Surface {
    surfels: Vec<Surfel>,
    cells: HashMap<Key, u32>,
    cell_m: f32,
    tree: Option<ImmutableKdTree<f32, 3>>,
    points: Arc<[Point3<f32>]>,
    /// Largest distance of a surfel from the origin of the frame, metres.
    radius_m: f32,
    /// Whether it is that of a ball, whose facets do not tell its turn.
    is_ball: bool,
}

/// The surfel nearest to a point.
#[derive(Clone, Copy, Debug)]
pub(super) struct Nearest<'s> {
    pub(super) surfel: &'s Surfel,
    pub(super) square_m2: f32,
}

/// The surfel nearest to a point, and how far the point may go until another may be.
#[derive(Clone, Copy, Debug)]
pub(super) struct Remembered {
    point: Point3<f32>,
    at: u32,
    /// Metres; less than 0 where nothing is remembered.
    slack_m: f32,
}

impl Remembered {
    pub(super) const NONE: Self =
        Remembered { point: Point3::new(0.0, 0.0, 0.0), at: 0, slack_m: -1.0 };
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
            is_ball: false,
        }
    }

    /// That of a body whose shape is known: elements about `spacing_m` from each other.
    pub(super) fn known(elements: &[(Point3<f32>, Vector3<f32>)], spacing_m: f32) -> Self {
        let mut surface = Surface::new(CELLS * spacing_m);
        // How far the surface is from an element's plane, beside it: facets of a ball are in other planes than their neighbours.
        let deviation_m = |(point, normal): &(Point3<f32>, Vector3<f32>)| {
            let beside = elements.iter().filter(|(other, facing)| {
                (other - point).norm_squared() < spacing_m * spacing_m
                    && facing.dot(normal) > SAME_SIDE
            });
            let (sum, count) = beside.fold((0.0, 0.0), |(sum, count), (other, _)| {
                let off = normal.dot(&(other - point));
                (sum + off * off, count + 1.0)
            });
            (sum / f32::max(count, 1.0)).sqrt()
        };
        let least_m = (KNOWN_DEVIATION * spacing_m).max(1e-6);
        let surfel = |element: &(Point3<f32>, Vector3<f32>)| Surfel {
            point: element.0,
            normal: element.1,
            information: deviation_m(element).max(least_m).powi(-2),
            captures: u16::MAX,
            last: 0,
            free_captures: 0,
        };
        surface.surfels = elements.iter().map(surfel).collect();
        let centre = Point3::from(
            elements.iter().map(|(point, _)| point.coords).sum::<Vector3<f32>>()
                / elements.len().max(1) as f32,
        );
        let (inner, outer) =
            elements.iter().fold((f32::MAX, 0.0_f32), |(inner, outer), (point, normal)| {
                let out = point - centre;
                (inner.min(normal.dot(&out)), outer.max(out.norm()))
            });
        surface.is_ball = inner > BALL_SHARE * outer;
        surface.index();
        surface
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

    pub(super) fn is_ball(&self) -> bool {
        self.is_ball
    }

    /// The surfel nearest to a point of the unit's frame.
    pub(super) fn nearest(&self, point: &Point3<f32>) -> Option<Nearest<'_>> {
        let tree = self.tree.as_ref()?;
        let query = [point.x, point.y, point.z];
        let found = tree.query(&query).nearest_one::<SquaredEuclidean<f32>>().execute();
        let surfel = self.surfels.get(found.item as usize)?;
        Some(Nearest { surfel, square_m2: found.distance })
    }

    /// The same as [`nearest`](Self::nearest). It searches only where the point has moved so far that another surfel may be nearest.
    pub(super) fn nearest_from(
        &self,
        point: &Point3<f32>,
        remembered: &mut Remembered,
    ) -> Option<Nearest<'_>> {
        let is_near = (point - remembered.point).norm() <= remembered.slack_m;
        if !is_near {
            *remembered = self.nearest_two(point)?;
        }
        let surfel = self.surfels.get(remembered.at as usize)?;
        Some(Nearest { surfel, square_m2: (point - surfel.point).norm_squared() })
    }

    fn nearest_two(&self, point: &Point3<f32>) -> Option<Remembered> {
        let tree = self.tree.as_ref()?;
        let query = [point.x, point.y, point.z];
        let two = tree.query(&query).nearest_n::<SquaredEuclidean<f32>>(TWO).execute();
        let first = two.first()?;
        // A way of the point changes every distance by its length at most.
        let way = two
            .get(1)
            .map_or(f32::MAX, |next| 0.5 * (next.distance.sqrt() - first.distance.sqrt()));
        // Distances are rounded.
        let slack_m = way - ROUNDING * (first.distance.sqrt() + self.radius_m);
        Some(Remembered { point: *point, at: first.item, slack_m })
    }

    /// Adds the observations of a capture: points, normals and the deviation along them, in the unit's frame.
    pub(super) fn add(
        &mut self,
        capture: u64,
        observations: impl Iterator<Item = (Point3<f32>, Vector3<f32>, f32)>,
    ) {
        for (point, normal, deviation_m) in observations {
            // A point that is not finite would have an undefined cell.
            if !point.iter().chain(normal.iter()).all(|number| number.is_finite()) {
                continue;
            }
            // Exact points of synthetic images must not weigh infinitely.
            let information = 1.0 / (deviation_m * deviation_m).max(1e-9);
            let (captures, last) = (1, capture);
            self.insert_surfel(Surfel {
                point,
                normal,
                information,
                captures,
                last,
                free_captures: 0,
            });
        }
        if self.surfels.len() > MAX_SURFELS {
            self.coarsen();
        }
        self.index();
    }

    /// Removes surfels in free space: those behind which cameras measure points again and again. `is_free` says whether this capture shows a
    /// surfel to be in free space.
    pub(super) fn remove_free_space(&mut self, is_free: impl Fn(&Surfel) -> bool) {
        let before = self.surfels.len();
        for surfel in &mut self.surfels {
            surfel.free_captures = match is_free(surfel) {
                true => surfel.free_captures.saturating_add(1),
                false => surfel.free_captures.saturating_sub(1),
            };
        }
        // Four captures: an error of pose in one of them shows free space where there is none.
        self.surfels.retain(|surfel| surfel.free_captures < 4);
        if self.surfels.len() < before {
            self.rehash();
            self.index();
        }
    }

    /// Removes the surfels within a cell of points that belong to another body.
    pub(super) fn remove_near(&mut self, points: &[Point3<f32>]) {
        let all: Vec<[f32; 3]> = points.iter().map(|point| (*point).into()).collect();
        // An empty tree has no nearest point.
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
        let facing = 2 * axis as i32 + i32::from(normal[axis] < 0.0);
        [cell.x.floor() as i32, cell.y.floor() as i32, cell.z.floor() as i32, facing]
    }

    fn insert_surfel(&mut self, new: Surfel) {
        let key = self.key(&new.point, &new.normal);
        if let Some(surfel) = self.cells.get(&key).and_then(|at| self.surfels.get_mut(*at as usize))
        {
            let old = surfel.information.min(MAX_INFORMATION_RATIO * new.information);
            let weight = new.information / (old + new.information);
            surfel.point += (new.point - surfel.point) * weight;
            let normal = surfel.normal + (new.normal - surfel.normal) * weight;
            surfel.normal = normal.try_normalize(1e-6).unwrap_or(surfel.normal);
            surfel.information = old + new.information;
            // Several points of one capture are one observation.
            if surfel.last != new.last {
                surfel.captures = surfel.captures.saturating_add(new.captures);
                surfel.last = new.last;
            }
            return;
        }
        self.cells.insert(key, self.surfels.len() as u32);
        self.surfels.push(new);
    }

    /// Enlarges the cells until the surfels fit.
    fn coarsen(&mut self) {
        while self.surfels.len() > MAX_SURFELS {
            // About sqrt(2): each time about half of the cells of a surface remain.
            self.cell_m *= 1.4;
            self.rehash();
        }
    }

    fn rehash(&mut self) {
        let surfels = std::mem::take(&mut self.surfels);
        self.cells.clear();
        surfels.into_iter().for_each(|surfel| self.insert_surfel(surfel));
    }

    fn index(&mut self) {
        let all: Vec<[f32; 3]> = self.surfels.iter().map(|surfel| surfel.point.into()).collect();
        self.tree = if all.is_empty() { None } else { ImmutableKdTree::new_from_slice(&all).ok() };
        let farthest = self.surfels.iter().map(|surfel| surfel.point.coords.norm());
        self.radius_m = farthest.fold(0.0, f32::max);
        self.add_reference_points();
    }

    /// Adds reference points where none is near.
    fn add_reference_points(&mut self) {
        let least = (SPACING * self.radius_m).powi(2);
        let mut points: Vec<Point3<f32>> = Vec::new();
        for surfel in self.surfels.iter().filter(|surfel| surfel.captures >= MIN_CAPTURES) {
            // The present points never move, so growth ends here.
            if self.points.len() + points.len() >= MAX_REFERENCE_POINTS {
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
        let points = sphere(3000);
        surface.add(0, points.iter().take(1000).copied());
        assert!(surface.points().is_empty(), "seen once");
        surface.add(1, points.iter().take(1000).copied());
        let first = surface.points().clone();
        assert!(first.len() > 20);
        for capture in 2..8 {
            surface.add(capture, points.iter().copied());
            assert!(surface.surfels().len() <= MAX_SURFELS);
        }
        assert!(
            surface.points().len() > 2 * first.len()
                && surface.points().len() <= MAX_REFERENCE_POINTS
        );
        assert_eq!(&surface.points()[..first.len()], &first[..]);
        let near = surface.nearest(&Point3::new(0.0, 0.0, 0.12)).unwrap();
        assert!((near.surfel.point - Point3::new(0.0, 0.0, 0.1)).norm() < surface.cell_m());
    }

    #[test]
    fn what_is_remembered_is_nearest() {
        let mut surface = Surface::new(0.2);
        assert!(surface.nearest_from(&Point3::origin(), &mut Remembered::NONE.clone()).is_none());
        surface.add(0, sphere(700).into_iter());
        let (mut remembered, mut searches) = (Remembered::NONE, 0);
        // A way along the sphere and away from it, in steps that grow.
        for step in 0..400 {
            let way = (step as f32 * 0.02).powi(2) * 0.01;
            let (sin, cos) = (5.0 * way).sin_cos();
            let point = Point3::new(cos * 0.11, sin * 0.11, 0.2 * way);
            let before = remembered.point;
            let near = surface.nearest_from(&point, &mut remembered).unwrap();
            searches += usize::from(remembered.point != before);
            let right = surface.nearest(&point).unwrap();
            assert_eq!(near.surfel.point, right.surfel.point, "step {step}");
            assert!((near.square_m2 - right.square_m2).abs() < 1e-8);
        }
        assert!((10..300).contains(&searches), "{searches}");
        // A single surfel is always nearest.
        let mut one = Surface::new(0.2);
        one.add(0, sphere(1).into_iter());
        assert!(one.nearest_from(&Point3::new(9.0, 9.0, 9.0), &mut remembered).is_some());
    }

    #[test]
    fn what_is_seen_through_goes() {
        let mut surface = Surface::new(0.2);
        surface.add(0, sphere(500).into_iter());
        for _ in 0..4 {
            surface.remove_free_space(|surfel| surfel.point.z > 0.0);
        }
        assert!(surface.surfels().iter().all(|surfel| surfel.point.z <= 0.0));
        assert!(surface.nearest(&Point3::new(0.0, 0.0, -0.1)).is_some());
    }

    #[test]
    fn known_elements_are_as_uncertain_as_their_surroundings() {
        // On a plane there is nothing beside an element's own.
        let flat: Vec<_> = (0..400)
            .map(|k| {
                let [u, v] = [k % 20, k / 20].map(|at| at as f32 * 0.01);
                (Point3::new(u, v, 0.0), Vector3::z())
            })
            .collect();
        let flat = Surface::known(&flat, 0.01);
        assert!(!flat.is_ball());
        assert!(flat.surfels().iter().all(|one| one.information.sqrt().recip() < 3e-5));
        // 850 elements of a ball are 12 mm apart there, and their planes .6 mm off each other.
        let ball: Vec<_> = sphere(850).into_iter().map(|(at, normal, _)| (at, normal)).collect();
        let ball = Surface::known(&ball, 0.0133);
        assert!(ball.is_ball());
        let off = |one: &Surfel| one.information.sqrt().recip();
        assert!(ball.surfels().iter().all(|one| (3e-4..1e-3).contains(&off(one))));
        let egg = sphere(850).into_iter().map(|(at, normal, _)| {
            (
                Point3::new(at.x * 1.2, at.y, at.z),
                Vector3::new(normal.x / 1.2, normal.y, normal.z).normalize(),
            )
        });
        assert!(!Surface::known(&egg.collect::<Vec<_>>(), 0.0133).is_ball());
    }
}
