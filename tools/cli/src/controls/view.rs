//! Where the videos are seen from.

use nalgebra::{Isometry3, Matrix3, Point3, Rotation3, Translation3, UnitQuaternion, Vector3};
use rigidformer_perception::camera::{Camera, CameraError};

/// Part of the picture's half size that what is shown may take.
const FILL: f32 = 0.90;
/// A camera is no nearer than this, metres.
const NEAREST_M: f32 = 0.3;
/// Rounds of moving the camera, each nearly exact.
const ROUNDS: usize = 12;

/// A camera without a place.
#[derive(Clone, Copy)]
pub(super) struct Lens {
    pub(super) size: [u32; 2],
    /// Along the longer side, radians.
    pub(super) view_rad: f32,
}

/// Right, down and forward, unit vectors.
#[derive(Clone, Copy)]
struct Axes {
    right: Vector3<f32>,
    down: Vector3<f32>,
    forward: Vector3<f32>,
}

impl Axes {
    /// `None` where there is no direction.
    fn along(forward: &Vector3<f32>) -> Option<Axes> {
        let forward = forward.try_normalize(1e-6)?;
        // Straight up or down x is on the right.
        let right = forward.cross(&Vector3::z()).try_normalize(1e-4).unwrap_or_else(Vector3::x);
        Some(Axes { right, down: forward.cross(&right), forward })
    }
}

impl Lens {
    /// Looks from an azimuth and an elevation, radians, at all of `points`, as near as shows them.
    pub(super) fn fit(
        &self,
        points: &[Point3<f32>],
        [azimuth, elevation]: [f32; 2],
    ) -> Result<Camera, CameraError> {
        let level = elevation.cos();
        let back = Vector3::new(azimuth.cos() * level, azimuth.sin() * level, elevation.sin());
        let axes = Axes::along(&-back).ok_or(CameraError::Pose)?;
        let [half_x, half_y] = self.size.map(|side| FILL * side as f32 / 2.0 / self.focal());
        let mut target = middle(points);
        let mut distance = NEAREST_M;
        // Slide sideways and back until the outermost points touch the margins.
        for _ in 0..ROUNDS {
            distance = NEAREST_M;
            for point in points {
                let [x, y, z] = self.apart(&axes, &target, point);
                distance = distance.max((x.abs() / half_x).max(y.abs() / half_y) - z);
            }
            let (mut low, mut high) = ([f32::MAX; 2], [f32::MIN; 2]);
            for point in points {
                let [x, y, z] = self.apart(&axes, &target, point);
                for (k, slope) in [x / (z + distance), y / (z + distance)].into_iter().enumerate() {
                    low[k] = low[k].min(slope);
                    high[k] = high[k].max(slope);
                }
            }
            if low[0] > high[0] {
                break;
            }
            let off = [0, 1].map(|k| (low[k] + high[k]) / 2.0 * distance * 0.9);
            target += axes.right * off[0] + axes.down * off[1];
        }
        self.camera(&axes, &(target - axes.forward * distance))
    }

    /// Looks from one place to another; `None` where they are one.
    pub(super) fn between(
        &self,
        eye: &Point3<f32>,
        target: &Point3<f32>,
    ) -> Option<Result<Camera, CameraError>> {
        Axes::along(&(target - eye)).map(|axes| self.camera(&axes, eye))
    }

    /// Pixels.
    fn focal(&self) -> f32 {
        let longer = self.size.into_iter().max().unwrap_or(1) as f32;
        longer / 2.0 / (self.view_rad / 2.0).tan()
    }

    fn apart(&self, axes: &Axes, target: &Point3<f32>, point: &Point3<f32>) -> [f32; 3] {
        let offset = point - target;
        [axes.right, axes.down, axes.forward].map(|axis| offset.dot(&axis))
    }

    fn camera(&self, axes: &Axes, eye: &Point3<f32>) -> Result<Camera, CameraError> {
        let turn = Matrix3::from_columns(&[axes.right, axes.down, axes.forward]);
        let turn = UnitQuaternion::from_rotation_matrix(&Rotation3::from_matrix_unchecked(turn));
        let pose = Isometry3::from_parts(Translation3::from(eye.coords), turn);
        // Pixels count from the middle of the first one.
        let centre = self.size.map(|side| (side as f32 - 1.0) / 2.0);
        Camera::new(self.size, [self.focal(); 2], centre, pose)
    }
}

/// The middle of the box around points.
pub(super) fn middle(points: &[Point3<f32>]) -> Point3<f32> {
    let Some(first) = points.first() else { return Point3::origin() };
    let bounds = (first.coords, first.coords);
    let (low, high) = points.iter().fold(bounds, |(l, h), p| (l.inf(&p.coords), h.sup(&p.coords)));
    Point3::from((low + high) / 2.0)
}

#[cfg(test)]
#[allow(clippy::unwrap_used)]
mod tests {
    use super::*;

    const LENS: Lens = Lens { size: [720, 480], view_rad: 1.0 };

    #[test]
    fn the_camera_is_as_near_as_shows_all() {
        let points: Vec<_> = (0..8)
            .map(|i| Point3::new((i & 1) as f32 * 4.0, (i >> 1 & 1) as f32, (i >> 2) as f32))
            .collect();
        for [azimuth, elevation] in [[-1.0, 0.6], [2.0, 0.0], [0.3, -0.5], [0.0, 1.55]] {
            let camera = LENS.fit(&points, [azimuth, elevation]).unwrap();
            let (mut x, mut y) = ([f32::MAX, f32::MIN], [f32::MAX, f32::MIN]);
            for point in &points {
                let ([u, v], _) = camera.pixel(point).unwrap();
                x = [x[0].min(u), x[1].max(u)];
                y = [y[0].min(v), y[1].max(v)];
            }
            let wide = (x[1] - x[0]) / (0.9 * 720.0);
            let high = (y[1] - y[0]) / (0.9 * 480.0);
            assert!((0.97..1.01).contains(&wide.max(high)), "{azimuth} {elevation}: {wide} {high}");
            assert!(x[0] > 0.0 && x[1] < 719.0 && y[0] > 0.0 && y[1] < 479.0, "{x:?} {y:?}");
        }
    }

    #[test]
    fn up_is_up_and_right_is_right() {
        let (eye, target) = (Point3::new(0.0, -5.0, 1.0), Point3::new(0.0, 0.0, 1.0));
        let camera = LENS.between(&eye, &target).unwrap().unwrap();
        let pixel = |x: f32, z: f32| camera.pixel(&Point3::new(x, 0.0, z)).unwrap().0;
        let [u, v] = pixel(0.0, 1.0);
        assert!((u - 359.5).abs() < 1e-3 && (v - 239.5).abs() < 1e-3);
        assert!(pixel(1.0, 1.0)[0] > u && pixel(0.0, 2.0)[1] < v);
        // An angle of view of 1 along the longer side.
        assert!((pixel(5.0 * 0.5_f32.tan(), 1.0)[0] - 719.5).abs() < 0.01);
        assert!(LENS.between(&eye, &eye).is_none());
        // Straight down.
        let camera = LENS.between(&Point3::new(0.0, 0.0, 5.0), &Point3::origin());
        assert!(camera.unwrap().unwrap().pixel(&Point3::new(1.0, 0.0, 0.0)).unwrap().0[0] > 400.0);
    }
}
