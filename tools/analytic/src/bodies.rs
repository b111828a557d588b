//! Recorded units as the engine sees them: hulls, masses, poses.

use nalgebra::{Isometry3, Point3, Quaternion, Translation3, UnitQuaternion, Vector3};
use rapier3d::dynamics::MassProperties;
use rapier3d::geometry::SharedShape;
use rapier3d::math::{Pose, Rotation, Vector};
use rapier3d::parry::query;
use rigidformer_evaluation::scenes::{RecordedScene, RecordedUnit};
use rigidformer_runtime::hull::ConvexHull;

use crate::arguments::Inertia;

/// A unit's convex hull, or its convex pieces.
pub(crate) struct Hull {
    pub(crate) shape: SharedShape,
    /// The same, piece by piece.
    pieces: Vec<SharedShape>,
    /// About the body frame's origin; no two hulls farther apart than the sum of theirs overlap.
    radius_m: f32,
}

impl Hull {
    /// The hulls of a scene's units, or the pieces of those that have some.
    pub(crate) fn of_scene(scene: &RecordedScene) -> anyhow::Result<Vec<Hull>> {
        let hull = |(index, unit): (usize, &RecordedUnit)| {
            Hull::of(unit).ok_or_else(|| {
                anyhow::anyhow!(
                    "{}: unit {index} ({}): its points enclose no volume; give it at least 4 points that do",
                    scene.name(),
                    unit.shape
                )
            })
        };
        scene.units().iter().enumerate().map(hull).collect()
    }

    /// `None` for points that enclose no volume.
    pub(crate) fn new(points: &[Point3<f32>]) -> Option<Hull> {
        // The engine's own hull takes points that are flat within rounding, and this one does not.
        ConvexHull::new(points)?;
        let vectors: Vec<Vector> = points.iter().map(|point| vector(&point.coords)).collect();
        // About the origin, which poses move: no centre has to be carried along.
        let radius_m = points.iter().map(|point| point.coords.norm()).fold(0.0, f32::max);
        let shape = SharedShape::convex_hull(&vectors)?;
        Some(Hull { pieces: vec![shape.clone()], shape, radius_m })
    }

    /// Of a unit: a compound of its pieces, if it has any. Flat pieces are left out.
    pub(crate) fn of(unit: &RecordedUnit) -> Option<Hull> {
        let hull = Hull::new(&unit.points)?;
        if unit.pieces.is_empty() {
            return Some(hull);
        }
        let found: Vec<Hull> = unit.pieces.iter().filter_map(Hull::new).collect();
        let pieces: Vec<SharedShape> = found.iter().map(|piece| piece.shape.clone()).collect();
        // Pieces may reach beyond the points.
        let radius_m = found.iter().map(|piece| piece.radius_m).fold(hull.radius_m, f32::max);
        // A unit whose pieces are all flat still has the hull of its points.
        if pieces.is_empty() {
            return Some(hull);
        }
        let placed = pieces.iter().map(|piece| (Pose::IDENTITY, piece.clone())).collect();
        Some(Hull { shape: SharedShape::compound(placed), pieces, radius_m })
    }

    /// A ball where a unit's points are all as far out, and so many that no facets can be meant; else the hull.
    pub(crate) fn or_ball(self, unit: &RecordedUnit) -> Hull {
        const POINTS: usize = 120;
        let radius_m = self.radius_m;
        let is_round = |point: &Point3<f32>| point.coords.norm() > 0.999 * radius_m;
        if unit.points.len() < POINTS || !unit.points.iter().all(is_round) {
            return self;
        }
        let shape = SharedShape::ball(radius_m);
        Hull { pieces: vec![shape.clone()], shape, radius_m }
    }

    /// How deep this hull is in another one: the least distance that separates them, 0 if they do not overlap.
    pub(crate) fn depth_m(
        &self,
        pose: &Isometry3<f32>,
        other: &Hull,
        other_pose: &Isometry3<f32>,
    ) -> f64 {
        let apart = (pose.translation.vector - other_pose.translation.vector).norm();
        // Most pairs are far apart, and spheres tell so without a search.
        if apart > self.radius_m + other.radius_m {
            return 0.0;
        }
        let (here, there) = (to_pose(pose), to_pose(other_pose));
        let mut deepest = 0.0_f64;
        for mine in &self.pieces {
            for theirs in &other.pieces {
                // An error means a shape that is no hull, and there is none.
                if let Ok(Some(contact)) = query::contact(&here, &**mine, &there, &**theirs, 0.0) {
                    deepest = deepest.max(f64::from(-contact.dist));
                }
            }
        }
        deepest
    }
}

/// Height of a unit's lowest point, metres.
pub(crate) fn lowest_m(points: &[Point3<f32>], pose: &Isometry3<f32>) -> f64 {
    f64::from(points.iter().map(|point| (pose * point).z).fold(f32::INFINITY, f32::min))
}

/// Mass and inertia about the body frame's origin, which is the centre of mass.
pub(crate) fn mass_properties(
    unit: &RecordedUnit,
    hull: &Hull,
    inertia: Inertia,
) -> MassProperties {
    let mass_kg = unit.physics.mass_kg;
    match (inertia, unit.inertia) {
        (Inertia::File, Some([x, y, z])) => {
            MassProperties::new(Vector::ZERO, mass_kg, Vector::new(x, y, z))
        }
        (Inertia::Hull, _) | (Inertia::File, None) => {
            let mut properties = hull.shape.mass_properties(1.0);
            properties.set_mass(mass_kg, true);
            // Records turn units about the origin of the body frame, which so is the centre of
            // mass.
            properties.local_com = Vector::ZERO;
            properties
        }
        (Inertia::Box, _) => {
            let extent = |axis: usize| {
                let (low, high) = unit
                    .points
                    .iter()
                    .map(|point| point[axis])
                    .fold((f32::INFINITY, f32::NEG_INFINITY), |(low, high), x| {
                        (low.min(x), high.max(x))
                    });
                (high - low) * (high - low)
            };
            let (x, y, z) = (extent(0), extent(1), extent(2));
            // Bullet, which made the records, gives a hull the inertia of its box.
            let moments = Vector::new(y + z, x + z, x + y) * (mass_kg / 12.0);
            MassProperties::new(Vector::ZERO, mass_kg, moments)
        }
    }
}

pub(crate) fn vector(v: &Vector3<f32>) -> Vector {
    Vector::new(v.x, v.y, v.z)
}

pub(crate) fn to_pose(pose: &Isometry3<f32>) -> Pose {
    // Recorded quaternions have length 1 within 5e-5 alone.
    let q = pose.rotation.quaternion().normalize();
    Pose::from_parts(vector(&pose.translation.vector), Rotation::from_xyzw(q.i, q.j, q.k, q.w))
}

pub(crate) fn from_pose(pose: &Pose) -> Isometry3<f32> {
    let (p, q) = (pose.translation, pose.rotation);
    Isometry3::from_parts(
        Translation3::new(p.x, p.y, p.z),
        // The engine's quaternions drift from length 1 over thousands of steps.
        UnitQuaternion::new_normalize(Quaternion::new(q.w, q.x, q.y, q.z)),
    )
}

#[cfg(test)]
pub(crate) mod tests {
    use super::*;
    use rigidformer_core::Physics;

    /// Corners of a cube about the origin.
    pub(crate) fn cube(side_m: f32) -> Vec<Point3<f32>> {
        let at = |i: usize, bit: usize| if i & bit == 0 { -side_m / 2.0 } else { side_m / 2.0 };
        (0..8).map(|i| Point3::new(at(i, 1), at(i, 2), at(i, 4))).collect()
    }

    #[test]
    fn overlapping_unit_cubes_are_as_deep_as_the_least_way_out() {
        let hull = Hull::new(&cube(1.0)).unwrap();
        let at = |x, y, z| Isometry3::translation(x, y, z);
        let depth = |pose| hull.depth_m(&at(0.0, 0.0, 0.0), &hull, &pose);
        assert!((depth(at(0.9, 0.0, 0.0)) - 0.1).abs() < 1e-4);
        assert!((depth(at(0.5, 0.2, 0.8)) - 0.2).abs() < 1e-4);
        assert_eq!(depth(at(1.1, 0.0, 0.0)), 0.0);
        assert_eq!(depth(at(5.0, 0.0, 0.0)), 0.0);
    }

    #[test]
    fn poses_survive_the_way_to_the_engine_and_back() {
        let turn = UnitQuaternion::from_scaled_axis(Vector3::new(0.3, -1.2, 0.7));
        let pose = Isometry3::from_parts(Translation3::new(1.0, -2.0, 3.0), turn);
        let back = from_pose(&to_pose(&pose));
        assert!((back.translation.vector - pose.translation.vector).norm() < 1e-6);
        assert!(back.rotation.angle_to(&pose.rotation) < 1e-3);
        let point = Point3::new(0.5, 0.6, 0.7);
        let moved = to_pose(&pose).transform_point(vector(&point.coords));
        assert!((vector(&(pose * point).coords) - moved).length() < 1e-5);
    }

    #[test]
    fn the_box_of_a_cube_has_the_inertia_of_its_hull() {
        let physics = Physics { mass_kg: 3.0, friction: 0.4, restitution: 0.3 };
        let unit = RecordedUnit::new("cube", cube(0.5), physics, Vec::new());
        let hull = Hull::new(&unit.points).unwrap();
        for inertia in [Inertia::Hull, Inertia::Box] {
            let properties = mass_properties(&unit, &hull, inertia);
            assert!((properties.mass() - 3.0).abs() < 1e-5);
            let moments = properties.principal_inertia();
            assert!((moments - Vector::splat(3.0 * 0.25 / 6.0)).length() < 1e-4, "{moments:?}");
        }
    }

    #[test]
    fn flat_points_have_no_hull() {
        let flat: Vec<_> = cube(1.0).into_iter().map(|p| Point3::new(p.x, p.y, 0.0)).collect();
        assert!(Hull::new(&flat).is_none());
        assert!(Hull::new(&[]).is_none());
    }
}
