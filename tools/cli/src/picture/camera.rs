//! Where a picture is seen from.

use nalgebra::{Point3, Vector3};
use rigidformer_core::Plane;

/// A perspective view. Pixels count from the top left corner.
#[derive(Clone, Copy)]
pub(super) struct Camera {
    eye: Point3<f32>,
    right: Vector3<f32>,
    up: Vector3<f32>,
    forward: Vector3<f32>,
    /// Pixels per unit of slope.
    focal: f32,
    /// Pixel that the view's axis goes through.
    centre: (f32, f32),
    /// Of planes, metres.
    grid_m: f32,
}

/// A point seen by a camera.
#[derive(Clone, Copy)]
pub(super) struct Seen {
    pub(super) x: f32,
    pub(super) y: f32,
    /// Distance along the view's axis, metres, above 0.
    pub(super) depth: f32,
}

/// Nearer than this nothing is drawn, metres.
pub(super) const NEAR_M: f32 = 0.05;
/// A picture that is fitted is seen from here or farther, metres.
const NEAREST_M: f32 = 0.3;
/// From here on the grid of planes is one of metres, nearer of decimetres.
const METRES_FROM_M: f32 = 2.5;
/// How high pictures are seen from unless they say otherwise.
const ELEVATION_RAD: f32 = 0.36;
/// Part of the picture's half size that fitted points may take.
const FILL: f32 = 0.90;

impl Camera {
    /// Looks at all of `points` from above and the side at `azimuth_rad`, as near as shows them all in `width` x
    /// `height` pixels.
    pub(super) fn fit(
        points: &[Point3<f32>],
        azimuth_rad: f32,
        width: usize,
        height: usize,
    ) -> Camera {
        Camera::fit_from(points, (azimuth_rad, ELEVATION_RAD), width, height)
    }

    /// As [`Camera::fit`], from an azimuth and an elevation.
    pub(super) fn fit_from(
        points: &[Point3<f32>],
        (azimuth, elevation): (f32, f32),
        width: usize,
        height: usize,
    ) -> Camera {
        let slope = 0.30_f32;
        let forward = -Vector3::new(
            azimuth.cos() * elevation.cos(),
            azimuth.sin() * elevation.cos(),
            elevation.sin(),
        );
        let right = forward.cross(&Vector3::z()).try_normalize(1e-6).unwrap_or_else(Vector3::x);
        let up = right.cross(&forward);
        let focal = width.min(height) as f32 / 2.0 / slope;
        let centre = (width as f32 / 2.0, height as f32 / 2.0);
        let (eye, grid_m) = (Point3::origin(), 1.0);
        let mut camera = Camera { eye, right, up, forward, focal, centre, grid_m };

        // Slide sideways and back until the outermost points touch the margins: a few rounds, each nearly exact.
        let (half_x, half_y) =
            (FILL * width as f32 / 2.0 / focal, FILL * height as f32 / 2.0 / focal);
        let middle = points.iter().fold(Vector3::zeros(), |sum, point| sum + point.coords)
            / points.len().max(1) as f32;
        let mut target = Point3::from(middle);
        let mut distance = NEAREST_M;
        for _ in 0..12 {
            distance = NEAREST_M;
            for point in points {
                let offset = point - target;
                let (x, y, z) =
                    (offset.dot(&right).abs(), offset.dot(&up).abs(), offset.dot(&forward));
                distance = f32::max(distance, (x / half_x).max(y / half_y) - z);
            }
            camera.eye = target - forward * distance;
            let (mut low, mut high) = ((f32::MAX, f32::MAX), (f32::MIN, f32::MIN));
            for seen in points.iter().filter_map(|point| camera.see(point)) {
                low = (low.0.min(seen.x), low.1.min(seen.y));
                high = (high.0.max(seen.x), high.1.max(seen.y));
            }
            if low.0 > high.0 {
                break;
            }
            let off = ((low.0 + high.0) / 2.0 - centre.0, (low.1 + high.1) / 2.0 - centre.1);
            target += (right * off.0 - up * off.1) * (distance / focal * 0.9);
        }
        camera.eye = target - forward * distance;
        camera.grid_m = if distance < METRES_FROM_M { 0.1 } else { 1.0 };
        camera
    }

    /// How far in front of the eye a point is along the view's axis, metres.
    pub(super) fn depth_m(&self, point: &Point3<f32>) -> f32 {
        (point - self.eye).dot(&self.forward)
    }

    /// Where a point appears, unless it is behind or too near.
    pub(super) fn see(&self, point: &Point3<f32>) -> Option<Seen> {
        (self.depth_m(point) > NEAR_M).then(|| self.see_cut(point)).flatten()
    }

    /// Likewise of a corner of what was cut at [`NEAR_M`], whose depth is rounded.
    pub(super) fn see_cut(&self, point: &Point3<f32>) -> Option<Seen> {
        let offset = point - self.eye;
        let depth = self.depth_m(point).max(NEAR_M);
        let scale = self.focal / depth;
        let seen = Seen {
            x: self.centre.0 + offset.dot(&self.right) * scale,
            y: self.centre.1 - offset.dot(&self.up) * scale,
            depth,
        };
        (seen.x.is_finite() && seen.y.is_finite()).then_some(seen)
    }

    /// Where the ray through a pixel meets a plane's free side, and how far that is along the view's axis.
    pub(super) fn meet(&self, (x, y): (f32, f32), plane: &Plane) -> Option<(Point3<f32>, f32)> {
        let ray = self.forward
            + self.right * ((x - self.centre.0) / self.focal)
            + self.up * ((self.centre.1 - y) / self.focal);
        let climb = plane.normal.dot(&ray);
        let depth = -plane.height_m(&self.eye.coords) / climb;
        (climb < 0.0 && depth > NEAR_M).then(|| (self.eye + ray * depth, depth))
    }

    /// Width and height of the picture, whole pixels.
    pub(super) fn pixels_across(&self) -> (usize, usize) {
        let (width, height) = self.size();
        (width as usize, height as usize)
    }

    /// Width and height of the picture, pixels.
    pub(super) fn size(&self) -> (f32, f32) {
        (2.0 * self.centre.0, 2.0 * self.centre.1)
    }

    /// Between two lines of a plane's grid, metres.
    pub(super) fn grid_m(&self) -> f32 {
        self.grid_m
    }

    pub(super) fn eye(&self) -> Point3<f32> {
        self.eye
    }

    /// Towards the picture's right edge, a unit vector.
    pub(super) fn right(&self) -> Vector3<f32> {
        self.right
    }

    /// Along the view's axis, a unit vector.
    pub(super) fn forward(&self) -> Vector3<f32> {
        self.forward
    }

    /// Pixels that a length across the view takes up at a point seen.
    pub(super) fn pixels(&self, length_m: f32, at: Seen) -> f32 {
        length_m * self.focal / at.depth
    }
}
