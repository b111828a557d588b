//! The surface of a true unit, as far as scores need it.

use nalgebra::{Isometry3, Matrix3, Point3, Unit, UnitQuaternion, Vector3};
use rigidformer_runtime::hull::ConvexHull;

use crate::scenes::RecordedUnit;

/// Points of a unit that stand for all of it, at most.
// Every sample is compared with every face, for every pose.
const SAMPLES: usize = 128;
/// A turn by this angle shows, if any does, radians: no symmetry of a polyhedron with few faces.
// No symmetry of a polyhedron with few faces is a turn by 29 degrees.
const TURN_RAD: f32 = 0.5;
/// A turn shows where it moves the points off the surface by more than this on average, in parts of the radius. A ball of 64 points
/// is off by 2 %, as a polyhedron.
// A ball of 64 points is a polyhedron that a turn moves by 2 % of its radius.
const SHOWS: f64 = 0.035;

/// Which turns a shape shows.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum Symmetry {
    /// All.
    None,
    /// All but those about an axis through the centre.
    Axis(Unit<Vector3<f32>>),
    /// None.
    Ball,
}

/// A rigid unit.
pub(super) struct Surface {
    /// Convex parts; none where the points enclose no volume.
    hulls: Vec<ConvexHull>,
    /// Points on it, in its body frame, metres.
    samples: Vec<Point3<f32>>,
    /// Mean distance of the samples from the surface: above 0 where pieces overlap, since points of one may lie in another.
    rest_m: f64,
    /// Middle of its points' box, in its body frame, metres.
    pub(super) centre: Point3<f32>,
    /// Of a sphere about the centre that holds all points, metres.
    pub(super) radius_m: f32,
    pub(super) symmetry: Symmetry,
}

impl Surface {
    pub(super) fn new(unit: &RecordedUnit) -> Surface {
        let hulls: Vec<_> = match unit.pieces.is_empty() {
            true => ConvexHull::new(&unit.points).into_iter().collect(),
            false => unit.pieces.iter().filter_map(ConvexHull::new).collect(),
        };
        let centre = middle(&unit.points);
        let radius_m = unit.points.iter().map(|point| (point - centre).norm()).fold(0.0, f32::max);
        let step = unit.points.len().div_ceil(SAMPLES).max(1);
        let samples = unit.points.iter().step_by(step).copied().collect();
        let mut surface =
            Surface { hulls, samples, rest_m: 0.0, centre, radius_m, symmetry: Symmetry::None };
        surface.rest_m = surface.off_m(&Isometry3::identity());
        surface.symmetry = surface.find_symmetry(&unit.points);
        surface
    }

    /// How far a point of the body frame is from the surface, metres: as [`ConvexHull::height_m`], which is below the distance beyond
    /// edges; of points without volume, from the nearest of them.
    pub(super) fn distance_m(&self, point: &Point3<f32>) -> f32 {
        if self.hulls.is_empty() {
            let apart = self.samples.iter().map(|own| (own - point).norm());
            // Flat points have no hull, so the nearest sample stands for a surface.
            return apart.fold(f32::INFINITY, f32::min);
        }
        // Where pieces overlap, the outermost surface is the one that can be seen.
        let heights = self.hulls.iter().map(|hull| hull.height_m(point));
        heights.fold(f32::INFINITY, f32::min).abs()
    }

    /// Mean distance of its own points from its surface after a motion of the body frame, metres, beyond that at rest.
    pub(super) fn moved_m(&self, motion: &Isometry3<f32>) -> f64 {
        // Pieces that overlap have points inside of each other, which no motion causes.
        (self.off_m(motion) - self.rest_m).max(0.0)
    }

    fn off_m(&self, motion: &Isometry3<f32>) -> f64 {
        let distances = self.samples.iter().map(|own| f64::from(self.distance_m(&(motion * own))));
        distances.sum::<f64>() / self.samples.len().max(1) as f64
    }

    fn find_symmetry(&self, points: &[Point3<f32>]) -> Symmetry {
        let mut spread = Matrix3::zeros();
        for point in points {
            let lever = point - self.centre;
            spread += lever * lever.transpose();
        }
        // An axis of revolution is a principal axis.
        let axes = spread.symmetric_eigen().eigenvectors;
        // Both ways and twice as far: a polyhedron that comes back to itself by chance does so
        // once.
        let hidden = |axis: &Unit<Vector3<f32>>| {
            [1.0, -1.0, 2.0].iter().all(|times| {
                let turn = UnitQuaternion::from_axis_angle(axis, times * TURN_RAD);
                let motion = Isometry3::rotation_wrt_point(turn, self.centre);
                self.moved_m(&motion) <= SHOWS * f64::from(self.radius_m)
            })
        };
        let axes = axes.column_iter().filter_map(|axis| Unit::try_new(axis.into_owned(), 1e-6));
        let hidden: Vec<_> = axes.filter(hidden).collect();
        match hidden.as_slice() {
            [] => Symmetry::None,
            [axis] => Symmetry::Axis(*axis),
            // Two axes of revolution are those of a ball.
            _ => Symmetry::Ball,
        }
    }
}

/// Middle of the box around points.
fn middle(points: &[Point3<f32>]) -> Point3<f32> {
    let low = points.iter().fold(Vector3::repeat(f32::MAX), |low, point| low.inf(&point.coords));
    let high = points.iter().fold(Vector3::repeat(f32::MIN), |high, point| high.sup(&point.coords));
    if points.is_empty() { Point3::origin() } else { Point3::from((low + high) / 2.0) }
}

#[cfg(test)]
pub(super) mod tests {
    use super::*;
    use rigidformer_core::Physics;

    const WOOD: Physics = Physics { mass_kg: 1.0, friction: 0.5, restitution: 0.2 };

    pub(crate) fn ball(radius_m: f32, count: usize) -> Vec<Point3<f32>> {
        let at = |i: usize| {
            let z = 1.0 - 2.0 * (i as f32 + 0.5) / count as f32;
            let (sin, cos) = (i as f32 * 2.399_963).sin_cos();
            let r = (1.0 - z * z).sqrt();
            Point3::new(r * cos, r * sin, z) * radius_m
        };
        (0..count).map(at).collect()
    }

    pub(crate) fn cuboid(half: [f32; 3]) -> Vec<Point3<f32>> {
        let corner =
            |i: usize, axis: usize| if i >> axis & 1 == 0 { -half[axis] } else { half[axis] };
        (0..8).map(|i| Point3::from([0, 1, 2].map(|axis| corner(i, axis)))).collect()
    }

    fn cylinder(radius_m: f32, half_m: f32) -> Vec<Point3<f32>> {
        let ring = |z: f32| {
            (0..24).map(move |i| {
                let (sin, cos) = (i as f32 / 24.0 * std::f32::consts::TAU).sin_cos();
                Point3::new(radius_m * cos, radius_m * sin, z)
            })
        };
        ring(-half_m).chain(ring(half_m)).collect()
    }

    fn of(points: Vec<Point3<f32>>) -> Surface {
        Surface::new(&RecordedUnit::new("x", points, WOOD, vec![Isometry3::identity()]))
    }

    #[test]
    fn balls_hide_all_turns_and_cylinders_those_about_their_axis() {
        assert_eq!(of(ball(0.1, 64)).symmetry, Symmetry::Ball);
        assert_eq!(of(ball(0.1, 512)).symmetry, Symmetry::Ball);
        assert_eq!(of(cuboid([0.1, 0.1, 0.1])).symmetry, Symmetry::None);
        assert_eq!(of(cuboid([0.1, 0.2, 0.3])).symmetry, Symmetry::None);
        for (radius_m, half_m) in [(0.1, 0.3), (0.2, 0.1), (0.1, 0.1)] {
            let Symmetry::Axis(axis) = of(cylinder(radius_m, half_m)).symmetry else {
                panic!("{radius_m} {half_m}")
            };
            assert!(axis.z.abs() > 0.999, "{axis:?}");
        }
    }

    #[test]
    fn distances_are_from_the_surface() {
        let cube = of(cuboid([0.1, 0.1, 0.1]));
        assert!((cube.distance_m(&Point3::origin()) - 0.1).abs() < 1e-6);
        assert!((cube.distance_m(&Point3::new(0.0, 0.13, 0.0)) - 0.03).abs() < 1e-6);
        let moved = cube.moved_m(&Isometry3::translation(0.02, 0.0, 0.0));
        // Half of the corners; the others slide along faces.
        assert!((moved - 0.01).abs() < 1e-6, "{moved}");
        let flat = of(vec![Point3::origin(), Point3::new(1.0, 0.0, 0.0)]);
        assert!((flat.distance_m(&Point3::new(0.0, 0.5, 0.0)) - 0.5).abs() < 1e-6);
    }
}
