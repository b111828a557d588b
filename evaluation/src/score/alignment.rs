//! From a unit's body frame to a track's reference frame, and errors of poses under that.

use nalgebra::{Isometry3, Matrix3, Point3, Rotation3, Translation3, UnitQuaternion, Vector3};

use super::surface::{Surface, Symmetry};

/// Poses of a track and of the unit that it is, at the same times: sums of what the best alignment needs.
#[derive(Clone, Debug, Default)]
pub(super) struct Pairs {
    count: usize,
    centre: Vector3<f64>,
    rotation: Matrix3<f64>,
}

/// Carries a unit's body frame to a track's reference frame.
#[derive(Clone, Copy, Debug)]
pub(super) struct Alignment(Isometry3<f64>);

/// How far a pose is off.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct PoseError {
    pub(super) translation_m: f64,
    /// Where the centre is less where it truly is, in the world, metres.
    pub(super) offset_m: Vector3<f64>,
    /// None of what shows no turns.
    pub(super) rotation_deg: Option<f64>,
    pub(super) surface_m: f64,
}

impl Pairs {
    pub(super) fn add(
        &mut self,
        track: &Isometry3<f32>,
        truth: &Isometry3<f32>,
        centre: &Point3<f32>,
    ) {
        let (track, truth) = (track.cast::<f64>(), truth.cast::<f64>());
        // About the centre, because a turn there moves the origin of a distant frame far.
        let centre = truth * centre.cast::<f64>();
        self.count += 1;
        self.centre += track.inverse_transform_point(&centre).coords;
        let turn = track.rotation.inverse() * truth.rotation;
        self.rotation += turn.to_rotation_matrix().matrix();
    }

    /// The best in the sense of least squares of the centre's place and of the rotation matrix.
    pub(super) fn best(&self, centre: &Point3<f32>) -> Option<Alignment> {
        let mean = (self.count > 0).then(|| self.centre / self.count as f64)?;
        // The nearest rotation to a sum of rotations. The sum is far from singular unless a track
        // turns all ways.
        let svd = self.rotation.svd(true, true);
        let (u, v_t) = (svd.u?, svd.v_t?);
        let mut signs = Matrix3::identity();
        // Without it the nearest orthogonal matrix may be a reflection.
        signs[(2, 2)] = (u * v_t).determinant().signum();
        let rotation = Rotation3::from_matrix_unchecked(u * signs * v_t);
        let rotation = UnitQuaternion::from_rotation_matrix(&rotation);
        let translation = mean - rotation * centre.cast::<f64>().coords;
        Some(Alignment(Isometry3::from_parts(Translation3::from(translation), rotation)))
    }
}

impl Alignment {
    pub(super) fn error(
        &self,
        track: &Isometry3<f32>,
        truth: &Isometry3<f32>,
        surface: &Surface,
    ) -> PoseError {
        let believed = track.cast::<f64>() * self.0;
        let motion = truth.cast::<f64>().inverse() * believed;
        let centre = surface.centre.cast::<f64>();
        let turn = motion.rotation;
        // Rounding makes a unit quaternion longer than 1, where asin is NaN.
        let full = 2.0 * turn.imag().norm().min(1.0).asin();
        let rotation = match surface.symmetry {
            Symmetry::None => Some(full),
            Symmetry::Axis(axis) => {
                let axis = axis.into_inner().cast::<f64>();
                // A body of revolution may look the same both ways round, but a track does not jump
                // from one to the other.
                Some((turn * axis).dot(&axis).clamp(-1.0, 1.0).acos())
            }
            Symmetry::Ball => None,
        };
        let offset = motion * centre - centre;
        PoseError {
            translation_m: offset.norm(),
            offset_m: truth.rotation.cast::<f64>() * offset,
            rotation_deg: rotation.map(f64::to_degrees),
            surface_m: surface.moved_m(&motion.cast()),
        }
    }
}
