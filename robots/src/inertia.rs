//! Mass, centre of mass and inertia of links.

use nalgebra::{Isometry3, Matrix3, Point3, SymmetricEigen, Vector3};

use crate::error::Problem;

/// Moments may be above the sum of the others by this share: files have few digits.
const ROUNDING: f64 = 1e-3;
/// Moments below zero by this share of the greatest are zero, rounded.
const BELOW: f64 = 1e-6;

/// Of a mass below 0.
pub(crate) const BELOW_0: Problem = Problem::Inertia("its mass is below 0; give its mass in kg");

/// Mass properties of a body in some frame.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Inertia {
    /// Mass, kg.
    pub mass_kg: f64,
    /// Centre of mass.
    pub centre_m: Point3<f64>,
    /// Moments and products about the centre of mass, along the frame's axes, kg m^2.
    pub about_centre: Matrix3<f64>,
}

impl Inertia {
    /// The same body in the frame that `pose` leads to.
    pub fn moved(&self, pose: &Isometry3<f64>) -> Self {
        let turn = pose.rotation.to_rotation_matrix();
        let turned = turn.matrix() * self.about_centre * turn.matrix().transpose();
        Self {
            mass_kg: self.mass_kg,
            centre_m: pose * self.centre_m,
            about_centre: symmetric(&turned),
        }
    }

    /// Of several bodies in one frame.
    pub fn sum(bodies: &[Inertia]) -> Self {
        let mass_kg: f64 = bodies.iter().map(|body| body.mass_kg).sum();
        if mass_kg <= 0.0 {
            return Self::default();
        }
        let weighted: Vector3<f64> =
            bodies.iter().map(|body| body.centre_m.coords * body.mass_kg).sum();
        let centre_m = Point3::from(weighted / mass_kg);
        let about = bodies.iter().map(|body| {
            let off = body.centre_m - centre_m;
            let square = Matrix3::identity() * off.norm_squared() - off * off.transpose();
            body.about_centre + square * body.mass_kg
        });
        Self { mass_kg, centre_m, about_centre: about.sum() }
    }

    /// The same body with all masses multiplied.
    pub(crate) fn scaled(&self, factor: f64) -> Self {
        Self { mass_kg: self.mass_kg * factor, about_centre: self.about_centre * factor, ..*self }
    }

    /// Its principal moments, rising.
    pub fn principal_moments(&self) -> [f64; 3] {
        let mut moments: [f64; 3] = SymmetricEigen::new(self.about_centre).eigenvalues.into();
        moments.sort_by(f64::total_cmp);
        moments
    }

    /// What no body has of mass and moments.
    pub(crate) fn problem(&self) -> Option<Problem> {
        if !(self.mass_kg >= 0.0 && self.mass_kg.is_finite()) {
            return Some(BELOW_0);
        }
        if !self.about_centre.iter().all(|moment| moment.is_finite()) {
            return Some(Problem::Inertia("its inertia is too large to count with; mend it"));
        }
        let [least, _, most] = self.principal_moments();
        if least < -BELOW * most.abs().max(f64::MIN_POSITIVE) {
            return Some(Problem::Inertia(
                "a principal moment of its inertia is below 0; give moments about the centre of mass, or have them balanced (--balance)",
            ));
        }
        None
    }

    /// Whether a body may have it: no principal moment is below 0, or above the sum of the others.
    pub fn is_of_a_body(&self) -> bool {
        let [least, middle, most] = self.principal_moments();
        self.problem().is_none() && most <= (least + middle) * (1.0 + ROUNDING) + f64::MIN_POSITIVE
    }

    /// As a body that has these moments nearly: where one is above the sum of the others, or below 0, all are their mean.
    pub(crate) fn balanced(&self) -> Self {
        let mean = self.about_centre.trace().abs() / 3.0;
        match self.is_of_a_body() {
            true => *self,
            false => Self { about_centre: Matrix3::identity() * mean, ..*self },
        }
    }
}

/// What to note of a link whose inertia no body has.
pub(crate) fn doubt(link: &str, is_balanced: bool) -> String {
    let then = match is_balanced {
        true => "it was balanced",
        false => "it stays as it is, and units have that of a box; --balance mends it",
    };
    format!("{link}: a moment of its inertia is above the sum of the others, as of no body: {then}")
}

/// The nearest symmetric matrix: rounding leaves products that differ.
pub(crate) fn symmetric(matrix: &Matrix3<f64>) -> Matrix3<f64> {
    (matrix + matrix.transpose()) * 0.5
}

/// A matrix of moments and products.
pub(crate) fn matrix([xx, yy, zz, xy, xz, yz]: [f64; 6]) -> Matrix3<f64> {
    Matrix3::new(xx, xy, xz, xy, yy, yz, xz, yz, zz)
}
