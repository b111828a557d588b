//! Colours that say where something was in the first frame, as Diffusion as Shader has them.

use nalgebra::{Point3, Vector3};
use rigidformer_perception::camera::Camera;

/// What is nearer to the camera's plane, or behind it, counts as being there, metres.
pub(super) const NEAR_M: f32 = 0.01;
/// Parts of the points that are farther than blue begins, and nearer than it ends.
const PERCENTILES: [f64; 2] = [0.02, 0.98];
/// Of points that are all equally far.
const MIDDLE: f32 = 0.5;

/// The colours of a video.
pub(super) struct Palette {
    focal: [f32; 2],
    /// Of the picture, from its left and upper edges, pixels.
    centre: [f32; 2],
    size: [f32; 2],
    /// Inverse depths where blue is 0 and 255, 1/m.
    pub(super) inverse_m: [f32; 2],
}

/// A point as a camera has it: right, down, forward.
pub(super) fn seen(camera: &Camera, point: &Point3<f32>) -> Vector3<f32> {
    camera.pose().inverse_transform_point(point).coords
}

impl Palette {
    /// Of points in the first frame, as a camera has them.
    pub(super) fn new(camera: &Camera, first: &[Vector3<f32>]) -> Palette {
        let mut palette = Palette {
            focal: camera.focal(),
            // The middle of the first pixel is half a pixel from the edges.
            centre: camera.centre().map(|at| at + 0.5),
            size: camera.size().map(|side| side as f32),
            inverse_m: [0.0; 2],
        };
        let inverse = |points: &mut dyn Iterator<Item = &Vector3<f32>>| -> Vec<f32> {
            points.map(|point| 1.0 / point.z).collect()
        };
        let mut shown = inverse(&mut first.iter().filter(|point| palette.shows(point)));
        if shown.is_empty() {
            shown = inverse(&mut first.iter().filter(|point| point.z >= NEAR_M));
        }
        shown.sort_by(f32::total_cmp);
        palette.inverse_m = PERCENTILES.map(|part| percentile(&shown, part));
        palette
    }

    /// Whether a point is in the picture, whatever is in front of it.
    pub(super) fn shows(&self, point: &Vector3<f32>) -> bool {
        let [x, y] = self.place(point);
        let [width, height] = self.size;
        point.z >= NEAR_M && (0.0..width).contains(&x) && (0.0..height).contains(&y)
    }

    /// Where a point is seen, pixels from the left and upper edges.
    pub(super) fn place(&self, point: &Vector3<f32>) -> [f32; 2] {
        let ([fx, fy], [cx, cy]) = (self.focal, self.centre);
        let z = point.z.max(NEAR_M);
        [fx * point.x / z + cx, fy * point.y / z + cy]
    }

    /// The colour of what was here in the first frame.
    pub(super) fn colour(&self, first: &Vector3<f32>) -> [u8; 3] {
        let ([x, y], [width, height]) = (self.place(first), self.size);
        let [far, near] = self.inverse_m;
        let inverse = 1.0 / first.z.max(NEAR_M);
        let blue = if near > far { (inverse - far) / (near - far) } else { MIDDLE };
        // Conversions saturate, so what is beside the picture has the colour of its edge.
        [x / width, y / height, blue].map(|part| (255.0 * part).round() as u8)
    }
}

/// Of sorted numbers, on the straight line between the two beside it; 0 without any.
fn percentile(sorted: &[f32], part: f64) -> f32 {
    let at = part * sorted.len().saturating_sub(1) as f64;
    let number = |at: f64| sorted.get(at as usize).copied().unwrap_or_default();
    let (low, high) = (number(at.floor()), number(at.ceil()));
    low + (high - low) * at.fract() as f32
}

#[cfg(test)]
#[allow(clippy::unwrap_used)]
mod tests {
    use super::*;
    use nalgebra::Isometry3;

    /// 100 x 50 pixels, at the origin, with the middle of the picture straight ahead.
    fn camera() -> Camera {
        Camera::new([100, 50], [50.0; 2], [49.5, 24.5], Isometry3::identity()).unwrap()
    }

    #[test]
    fn colours_say_where_a_point_was() {
        let first = [Vector3::new(0.0, 0.0, 1.0), Vector3::new(0.0, 0.0, 2.0)];
        let palette = Palette::new(&camera(), &first);
        // Inverse depths .5 and 1: the percentiles lie .02 of the way within.
        assert!(
            (palette.inverse_m[0] - 0.51).abs() < 1e-6
                && (palette.inverse_m[1] - 0.99).abs() < 1e-6
        );
        assert_eq!(palette.colour(&first[0]), [128, 128, 255]);
        assert_eq!(palette.colour(&first[1]), [128, 128, 0]);
        // A quarter of the width from the left, three quarters of the height from above, half way between by inverse depth.
        let z = 1.0 / 0.7512;
        let point = Vector3::new(-25.0 / 50.0 * z, 12.5 / 50.0 * z, z);
        assert_eq!(palette.colour(&point), [64, 191, 128]);
    }

    #[test]
    fn what_begins_beside_the_picture_has_the_colour_of_its_edge() {
        let palette = Palette::new(&camera(), &[Vector3::new(0.0, 0.0, 1.0)]);
        for (point, colour) in [
            (Vector3::new(9.0, 0.0, 1.0), [255, 128, 128]),
            (Vector3::new(-9.0, -9.0, 1.0), [0, 0, 128]),
            // Behind the camera, to its right and above it.
            (Vector3::new(1.0, -1.0, -1.0), [255, 0, 128]),
        ] {
            assert!(!palette.shows(&point));
            assert_eq!(palette.colour(&point), colour, "{point}");
        }
    }

    #[test]
    fn points_beside_the_picture_do_not_set_the_range_of_blue() {
        let inside = [1.0, 2.0].map(|z| Vector3::new(0.0, 0.0, z));
        let beside = [Vector3::new(99.0, 0.0, 0.1), Vector3::new(0.0, 0.0, -0.5)];
        let all = [&inside[..], &beside].concat();
        let inverse_m = |points: &[Vector3<f32>]| Palette::new(&camera(), points).inverse_m;
        assert_eq!(inverse_m(&all), inverse_m(&inside));
        // Without any inside those in front of the camera do.
        assert_eq!(inverse_m(&beside), [10.0, 10.0]);
    }

    #[test]
    fn percentiles_are_those_of_numpy() {
        let numbers: Vec<f32> = (0..=10).map(|number| number as f32).collect();
        assert!((percentile(&numbers, 0.02) - 0.2).abs() < 1e-6);
        assert!((percentile(&numbers, 0.98) - 9.8).abs() < 1e-6);
        assert_eq!(percentile(&[3.0], 0.98), 3.0);
        assert_eq!(percentile(&[], 0.98), 0.0);
    }
}
