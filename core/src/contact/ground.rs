//! The planes that a scene stands on or between: the one place that knows what the ground is.

use crate::geometry::{Hull, Pose, dot, norm};
use crate::kernels::in_own_environment;
use crate::limits::MAX_COORDINATE_M;
use nalgebra::Vector3;

/// Where there is nothing to touch, the inputs are those over a plane this far below, metres: far enough that every
/// feature of contact is at its limit.
pub(crate) const NOWHERE_M: f32 = 1000.0;
/// A normal is of unit length within this: normals that callers round to three digits pass, mistakes do not.
const NORMAL_TOLERANCE: f32 = 1e-3;

/// An unmoving plane; units stay on the side that its normal points to.
///
/// ```
/// use nalgebra::Vector3;
/// use rigidformer_core::Plane;
/// let wall = Plane { normal: Vector3::new(-1.0, 0.0, 0.0), offset_m: -2.0, friction: 0.5, restitution: 0.3 };
/// assert_eq!(wall.height_m(&Vector3::new(1.5, 7.0, 0.3)), 0.5); // half a metre in front of the wall at x = 2
/// ```
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Plane {
    /// Unit vector towards the free side.
    pub normal: Vector3<f32>,
    /// Distance of the plane from the origin along the normal, metres: points x with `normal . x = offset_m`.
    pub offset_m: f32,
    /// Friction coefficient, from 0 to 1000.
    pub friction: f32,
    /// Restitution coefficient, from 0 to 1000.
    pub restitution: f32,
}

impl Plane {
    /// The plane z = 0 with the free side above.
    pub const fn ground(friction: f32, restitution: f32) -> Plane {
        Plane { normal: Vector3::new(0.0, 0.0, 1.0), offset_m: 0.0, friction, restitution }
    }

    /// Height of a point above the plane, metres; negative below it.
    pub fn height_m(&self, point: &Vector3<f32>) -> f32 {
        in_own_environment(|| self.height_here(point))
    }

    #[inline]
    pub(crate) fn height_here(&self, point: &Vector3<f32>) -> f32 {
        dot(&self.normal, point) - self.offset_m
    }

    /// Whether all numbers are finite and in range, and the normal is of unit length within 1e-3.
    pub fn is_sound(&self) -> bool {
        in_own_environment(|| self.is_sound_here())
    }

    pub(crate) fn is_sound_here(&self) -> bool {
        let coefficient = |value: &f32| (0.0..=1e3).contains(value);
        (norm(&self.normal) - 1.0).abs() <= NORMAL_TOLERANCE
            && self.offset_m.abs() <= MAX_COORDINATE_M
            && coefficient(&self.friction)
            && coefficient(&self.restitution)
    }

    /// The plane that stands for nothing, and the height of a point above it: it is far below every point.
    pub(crate) fn nowhere(point: &Vector3<f32>) -> (&'static Plane, f32) {
        const NOWHERE: &Plane = &Plane::ground(0.0, 0.0);
        (NOWHERE, point.z - (point.z - NOWHERE_M))
    }

    /// How far a pose has the lowest of a hull's points below the plane, metres; 0 for no hull. A unit whose bounding
    /// sphere is above the plane is not looked at.
    pub(crate) fn depth_m(
        &self,
        points: &[nalgebra::Point3<f32>],
        radius: f32,
        pose: &Pose,
    ) -> f32 {
        let height = self.height_here(&pose.centre);
        if points.is_empty() || height >= radius {
            return 0.0;
        }
        let lowest = Hull { points, rotation: pose.rotation }.support(&-self.normal);
        (-(height + dot(&self.normal, &lowest))).max(0.0)
    }

    /// How far `next` has to rise so that it takes no point of the hull below the plane, or deeper below it than `now`, metres.
    pub(crate) fn lift_m(
        &self,
        points: &[nalgebra::Point3<f32>],
        radius: f32,
        now: &Pose,
        next: &Pose,
    ) -> f32 {
        let after = self.depth_m(points, radius, next);
        if after > 0.0 { (after - self.depth_m(points, radius, now)).max(0.0) } else { 0.0 }
    }
}

/// The plane nearest to a point, by its number, and the squared distance; of equally near ones the first. None, at an
/// infinite distance, where there is no plane.
pub(crate) fn nearest_plane(planes: &[Plane], point: &Vector3<f32>) -> (Option<usize>, f32) {
    let mut best = (None, f32::INFINITY);
    for (number, plane) in planes.iter().enumerate() {
        let height = plane.height_here(point);
        let square = height * height;
        if square < best.1 {
            best = (Some(number), square);
        }
    }
    best
}
