//! Errors that the captures of a unit share: more captures do not average them.

use nalgebra::{Matrix6, Vector6};

/// Bound of the errors of poses that neighbouring pixels and captures share: metres, and radii.
pub(super) const SHARED_ERROR_M: f64 = 1.5e-3;
const SHARED_ERROR_RADII: f64 = 1e-2;
/// Deviation of theirs, as a share of the bound.
const DEVIATION_SHARE: f64 = 0.5;

/// Bound of the shared errors of a unit, metres. `shift_m` is how far the capture is from the planes of those before.
pub(super) fn shared_m(radius_m: f64, shift_m: f64) -> f64 {
    SHARED_ERROR_M + SHARED_ERROR_RADII * radius_m + shift_m
}

/// Deviations of shared errors.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Errors {
    pub(super) position_m: f64,
    pub(super) turn_rad: f64,
}

impl Errors {
    /// Errors that move the surface of a unit of this radius by so much.
    pub(super) fn new(position_m: f64, radius_m: f64) -> Self {
        Errors { position_m, turn_rad: position_m / radius_m.max(1e-4) }
    }

    pub(super) fn shared(radius_m: f64, shift_m: f64) -> Self {
        Errors::new(DEVIATION_SHARE * shared_m(radius_m, shift_m), radius_m)
    }

    pub(super) fn covariance(self) -> Matrix6<f64> {
        let variance = |deviation: f64| deviation * deviation;
        let (position, turn) = (variance(self.position_m), variance(self.turn_rad));
        Matrix6::from_diagonal(&Vector6::new(position, position, position, turn, turn, turn))
    }

    /// The information of a pose that has these errors besides.
    pub(super) fn widen(self, information: &Matrix6<f64>) -> Matrix6<f64> {
        // Of (I^-1 + D)^-1, which needs no inverse of an information that is singular.
        let wide = (Matrix6::identity() + information * self.covariance()).try_inverse();
        let information = wide.map_or(*information, |wide| wide * information);
        (information + information.transpose()) * 0.5
    }

    /// Square of a displacement in its deviations, where its measurement has this information and these errors.
    pub(super) fn square(self, off: &Vector6<f64>, information: &Matrix6<f64>) -> f64 {
        off.dot(&(self.widen(information) * off))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn widening_adds_variances_and_leaves_unknown_what_is_unknown() {
        // Division by a power of two is exact.
        let errors = Errors::shared(0.125, 0.0);
        assert_eq!(errors.position_m, 0.5 * (1.5e-3 + 1e-2 * 0.125));
        assert_eq!(errors.turn_rad, 8.0 * errors.position_m);
        let seen = Vector6::new(1e-3, 1e-4, 0.0, 0.02, 0.0, 1e-3);
        let information = seen.map(|sd: f64| if sd > 0.0 { sd.powi(-2) } else { 0.0 });
        let wide = errors.widen(&Matrix6::from_diagonal(&information));
        for (axis, sd) in seen.iter().enumerate() {
            let error = if axis < 3 { errors.position_m } else { errors.turn_rad };
            let expected = if *sd > 0.0 { 1.0 / (sd * sd + error * error) } else { 0.0 };
            assert!((wide[(axis, axis)] - expected).abs() <= 1e-9 * expected, "{axis}");
        }
        let off = Vector6::new(errors.position_m, 0.0, 1.0, 0.0, 1.0, 0.0);
        let square = errors.square(&off, &Matrix6::from_diagonal(&information));
        let expected = errors.position_m.powi(2) / (1e-6 + errors.position_m.powi(2));
        assert!((square - expected).abs() <= 1e-9 * expected, "{square}");
    }
}
