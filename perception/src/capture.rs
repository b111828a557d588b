//! Measurements of all sensors at an instant.

mod facts;

use nalgebra::Point3;
use rigidformer_core::kernels::in_own_environment;

use super::camera::Camera;

pub use facts::{Doubt, Facts};

/// Measurements of all sensors at one instant: their times differ by less than a millisecond.
#[derive(Clone, Debug, PartialEq)]
pub struct Capture {
    /// Seconds since an instant that all captures of a recording share; rises from one to the next.
    pub time_s: f64,
    /// By sensor.
    pub views: Vec<View>,
}

/// Measurement of one sensor.
#[derive(Clone, Debug, PartialEq)]
pub enum View {
    /// A depth camera.
    Depth(DepthView),
    /// A scanner, or a cloud that is merged from several.
    Cloud(Cloud),
}

/// A depth image and its camera.
#[derive(Clone, Debug, PartialEq)]
pub struct DepthView {
    /// The camera at that instant.
    pub camera: Camera,
    /// Metres a step of `depth`, above 0: 0.001 where depths are millimetres.
    pub scale_m: f32,
    /// Distance of the visible surface from the camera's plane, by rows from the top; 0: not measured. (height * width)
    pub depth: Vec<u16>,
    /// Label of the visible body, where labels are given; 0 for none. (height * width)
    pub labels: Option<Vec<u16>>,
}

/// Points of a scanner.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Cloud {
    /// In the world, metres.
    pub points: Vec<Point3<f32>>,
    /// Where the sensor was, if it is known: surfaces face it.
    pub sensor: Option<Point3<f32>>,
    /// Label of each point's body, where labels are given; 0 for none. (points)
    pub labels: Option<Vec<u16>>,
}

/// Metres a step of a depth image, at least and at most.
// With them the farthest depth is from 7 cm to 655 km. Beyond, single precision does not tell points apart, or overflows.
pub const SCALES_M: std::ops::RangeInclusive<f32> = 1e-6..=10.0;

/// Why a depth image cannot be used.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum DepthError {
    /// An image of another size than its camera's.
    #[error(
        "{given} numbers for an image of {width} x {height} pixels: image and camera must be of one size"
    )]
    Size {
        /// Pixels a row.
        width: u32,
        /// Rows.
        height: u32,
        /// Depths or labels that were given.
        given: usize,
    },
    /// A scale that is not in [`SCALES_M`].
    #[error(
        "a depth scale of {scale_m:e} m: give metres a step of the image, from 1e-6 to 10, such as 0.001 for millimetres"
    )]
    Scale {
        /// As given.
        scale_m: f32,
    },
}

impl DepthView {
    /// Depths by rows from the top, in steps of `scale_m` metres; 0: not measured.
    ///
    /// # Errors
    /// [`DepthError`] where image, labels and camera are of different sizes, or the scale is not in [`SCALES_M`].
    pub fn new(
        camera: Camera,
        scale_m: f32,
        depth: Vec<u16>,
        labels: Option<Vec<u16>>,
    ) -> Result<Self, DepthError> {
        let [width, height] = camera.size();
        let pixels = width as usize * height as usize;
        for given in [Some(depth.len()), labels.as_ref().map(Vec::len)].into_iter().flatten() {
            if given != pixels {
                return Err(DepthError::Size { width, height, given });
            }
        }
        if !in_own_environment(|| SCALES_M.contains(&scale_m)) {
            return Err(DepthError::Scale { scale_m });
        }
        Ok(DepthView { camera, scale_m, depth, labels })
    }

    /// Depth at a pixel, metres; none where nothing was measured.
    pub fn depth_m(&self, column: u32, row: u32) -> Option<f32> {
        let [width, height] = self.camera.size();
        if column >= width || row >= height {
            return None;
        }
        let steps = *self.depth.get(row as usize * width as usize + column as usize)?;
        (steps > 0).then(|| f32::from(steps) * self.scale_m)
    }

    /// The point of the world that is seen at a pixel.
    pub fn point(&self, column: u32, row: u32) -> Option<Point3<f32>> {
        let z_m = self.depth_m(column, row)?;
        Some(self.camera.point([column as f32, row as f32], z_m))
    }
}

impl Cloud {
    /// Whether a point was measured: scanners write rays that met nothing as the origin of their frame.
    pub(super) fn is_return(&self, point: &Point3<f32>) -> bool {
        let is_sensor = self.sensor.is_some_and(|eye| (point - eye).norm_squared() < 1e-12);
        !is_sensor && *point != Point3::origin()
    }
}
