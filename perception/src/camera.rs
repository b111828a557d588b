//! Pinhole cameras.

use nalgebra::{Isometry3, Point3};
use rigidformer_core::kernels::in_own_environment;

/// A pinhole camera without distortion. Its frame has x to the right, y down and z forward; pixel (0, 0) is the top left one, and its
/// middle is at (0, 0).
///
/// ```
/// use nalgebra::{Isometry3, Point3};
/// use rigidformer_perception::camera::Camera;
///
/// let camera = Camera::new([640, 480], [544.5, 544.5], [320.0, 240.0], Isometry3::identity())?;
/// let point = camera.point([320.0, 240.0], 2.0);
/// assert_eq!(point, Point3::new(0.0, 0.0, 2.0));
/// assert_eq!(camera.pixel(&point), Some(([320.0, 240.0], 2.0)));
/// # Ok::<(), rigidformer_perception::camera::CameraError>(())
/// ```
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Camera {
    size: [u32; 2],
    focal: [f32; 2],
    centre: [f32; 2],
    pose: Isometry3<f32>,
}

/// Why a camera cannot be used.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum CameraError {
    /// An image has no pixels, or more than [`MAX_SIDE`] a side.
    #[error("images of {width} x {height} pixels: each side must have 1 to {MAX_SIDE}")]
    Size {
        /// Pixels a row.
        width: u32,
        /// Rows.
        height: u32,
    },
    /// A focal length is not a number above 0.
    #[error("focal lengths {x} and {y}: give both in pixels, above 0")]
    Focal {
        /// Along rows.
        x: f32,
        /// Along columns.
        y: f32,
    },
    /// The principal point is far outside of the image.
    #[error(
        "principal point ({x}, {y}): it must lie within one image's size of the image; are the intrinsics those of another resolution?"
    )]
    Centre {
        /// Along rows.
        x: f32,
        /// Along columns.
        y: f32,
    },
    /// A pose has a number that is not finite.
    #[error("the camera's pose has a number that is not finite")]
    Pose,
}

/// Pixels a side of an image, at most.
// It bounds the memory that a file may ask for.
pub const MAX_SIDE: u32 = 8192;

impl Camera {
    /// A camera of `[width, height]` pixels, with focal lengths and principal point in pixels; `pose` carries its frame to the world.
    ///
    /// # Errors
    /// [`CameraError`] says which of them cannot be.
    pub fn new(
        size: [u32; 2],
        focal: [f32; 2],
        centre: [f32; 2],
        pose: Isometry3<f32>,
    ) -> Result<Self, CameraError> {
        in_own_environment(|| Self::new_here(size, focal, centre, pose))
    }

    fn new_here(
        size: [u32; 2],
        focal: [f32; 2],
        centre: [f32; 2],
        pose: Isometry3<f32>,
    ) -> Result<Self, CameraError> {
        let ([width, height], [x, y]) = (size, focal);
        if size.iter().any(|side| !(1..=MAX_SIDE).contains(side)) {
            return Err(CameraError::Size { width, height });
        }
        if focal.iter().any(|focal| !focal.is_finite() || *focal <= 0.0) {
            return Err(CameraError::Focal { x, y });
        }
        let [x, y] = centre;
        let is_near = |at: f32, side: u32| (-(side as f32)..=2.0 * side as f32).contains(&at);
        if !is_near(x, width) || !is_near(y, height) {
            return Err(CameraError::Centre { x, y });
        }
        if pose.to_homogeneous().iter().any(|number| !number.is_finite()) {
            return Err(CameraError::Pose);
        }
        Ok(Camera { size, focal, centre, pose })
    }

    /// Pixels a row, and rows.
    pub fn size(&self) -> [u32; 2] {
        self.size
    }

    /// Focal lengths along rows and columns, pixels.
    pub fn focal(&self) -> [f32; 2] {
        self.focal
    }

    /// The principal point, pixels.
    pub fn centre(&self) -> [f32; 2] {
        self.centre
    }

    /// Carries the camera's frame to the world.
    pub fn pose(&self) -> &Isometry3<f32> {
        &self.pose
    }

    /// The same camera elsewhere.
    ///
    /// # Errors
    /// [`CameraError::Pose`].
    pub fn moved(&self, pose: Isometry3<f32>) -> Result<Self, CameraError> {
        Camera::new(self.size, self.focal, self.centre, pose)
    }

    /// The point of the world at a pixel, `z_m` in front of the camera's plane.
    pub fn point(&self, [u, v]: [f32; 2], z_m: f32) -> Point3<f32> {
        let ([fx, fy], [cx, cy]) = (self.focal, self.centre);
        self.pose * Point3::new((u - cx) * z_m / fx, (v - cy) * z_m / fy, z_m)
    }

    /// Pixel of a point of the world, in the image or beside it, and its distance in front of the camera's plane, metres; none behind the
    /// camera.
    pub fn pixel(&self, point: &Point3<f32>) -> Option<([f32; 2], f32)> {
        let local = self.pose.inverse_transform_point(point);
        let ([fx, fy], [cx, cy]) = (self.focal, self.centre);
        (local.z > 0.0)
            .then(|| ([fx * local.x / local.z + cx, fy * local.y / local.z + cy], local.z))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn cameras_that_cannot_be_are_refused() {
        let here = Isometry3::identity();
        let camera = |size, focal, centre| Camera::new(size, focal, centre, here);
        assert!(matches!(
            camera([0, 480], [500.0; 2], [320.0, 240.0]),
            Err(CameraError::Size { .. })
        ));
        assert!(matches!(
            camera([640, 9000], [500.0; 2], [320.0, 240.0]),
            Err(CameraError::Size { .. })
        ));
        for focal in [0.0, -1.0, f32::NAN, f32::INFINITY] {
            let camera = camera([640, 480], [500.0, focal], [320.0, 240.0]);
            assert!(matches!(camera, Err(CameraError::Focal { .. })));
        }
        assert!(matches!(
            camera([64, 48], [500.0; 2], [320.0, 240.0]),
            Err(CameraError::Centre { .. })
        ));
        let nowhere = Isometry3::translation(f32::NAN, 0.0, 0.0);
        let lost = Camera::new([640, 480], [500.0; 2], [320.0, 240.0], nowhere);
        assert_eq!(lost, Err(CameraError::Pose));
    }
}
