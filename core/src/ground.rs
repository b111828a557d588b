//! The planes that a scene stands on or between: the one place that knows what the ground is.

use crate::geometry::{dot, norm};
use nalgebra::Vector3;

/// Planes of a scene, at most.
pub const MAX_PLANES: usize = 8;
/// A normal is of unit length within this.
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
        dot(&self.normal, point) - self.offset_m
    }

    /// Whether all numbers are finite and in range, and the normal is of unit length within 1e-3.
    pub fn is_sound(&self) -> bool {
        let coefficient = |value: &f32| (0.0..=1e3).contains(value);
        (norm(&self.normal) - 1.0).abs() <= NORMAL_TOLERANCE
            && self.offset_m.abs() <= crate::config::MAX_COORDINATE_M
            && coefficient(&self.friction)
            && coefficient(&self.restitution)
    }
}
