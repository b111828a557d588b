//! Reference geometry of a unit, nearest points and the rigid fit.
//!
//! What takes many points computes to nearest, whatever the caller's thread has set ([`in_own_environment`]). [`dot`], [`norm`] and
//! [`Pose`] are arithmetic, and compute as the caller's does.
//!
//! [`in_own_environment`]: crate::kernels::in_own_environment

mod extreme_points;
mod fit;
pub(crate) mod index;
mod jacobi;
mod points;
mod pose;
mod separation;
mod state;

#[cfg(any(feature = "deform", feature = "health"))]
pub(crate) use extreme_points::felt_directions;
pub(crate) use extreme_points::{Felt, extreme_points, keep_extremes};
#[cfg(feature = "deform")]
pub(crate) use fit::orthonormal;
#[cfg(feature = "deform")]
pub(crate) use fit::turn_that_fits;
pub use fit::{Fit, Rank, kabsch, kabsch_f64};
pub(crate) use fit::{kabsch_f64_here, kabsch_here};
pub use index::Index;
pub use jacobi::{Svd, leading_svd};
pub use points::{centre_of_mass, density_centre, farthest_point_order, radius};
pub(crate) use points::{centre_of_mass_here, farthest_point_order_here, radius_here};
pub use pose::Pose;
pub(crate) use pose::{
    POSE, direction, product, product_transposed, read_pose, rotate, rotate_back, swing,
    turn_between, turned, turned_by, write_pose,
};
#[cfg(feature = "robot")]
pub(crate) use pose::{columns, rotation_of};
pub use separation::hull_distance;
pub(crate) use separation::{Hull, Precision, Separation, separation};
pub(crate) use state::{COURSE, Course, STATE, State, half_turn, squared};

use nalgebra::Vector3;

/// What is nearest to a point.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Nearest {
    /// There is nothing else.
    Nothing,
    /// A plane, by its number.
    Plane(usize),
    /// A point of another unit, by its number in the unit's own order.
    Point { unit: usize, point: usize },
}

/// Dot product in one fixed order.
pub fn dot(a: &Vector3<f32>, b: &Vector3<f32>) -> f32 {
    (a.x * b.x + a.y * b.y) + a.z * b.z
}

/// The vector back; the operator is a loop where the compiler is after small code.
#[inline]
pub(crate) fn opposite(a: &Vector3<f32>) -> Vector3<f32> {
    Vector3::new(-a.x, -a.y, -a.z)
}

/// Length of a vector.
pub fn norm(a: &Vector3<f32>) -> f32 {
    crate::math::sqrt(dot(a, a))
}
