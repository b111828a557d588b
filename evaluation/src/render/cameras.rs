//! Where cameras stand that see a scene.

use nalgebra::{Isometry3, Point3, Vector3};
use rigidformer_perception::camera::{Camera, CameraError};

use crate::scenes::RecordedScene;

/// Half the angle of view along the longer side of the image, radians: 60 degrees in all.
const HALF_VIEW_RAD: f32 = std::f32::consts::FRAC_PI_6;
/// How much farther away a camera is than it must be to see all units.
// Units move after the first frame, which is all that a camera is placed by.
const FARTHER: f32 = 1.5;
/// How far cameras look down, radians: 35 degrees.
// From there a camera sees tops and sides, and the ground behind.
const DOWN_RAD: f32 = 0.610_865_25;
/// Where the first camera stands, seen from the scene's middle, radians from x towards y: to the front and a little to the right.
const FIRST_RAD: f32 = -std::f32::consts::FRAC_PI_3;
/// From one camera to the next about the vertical, radians: 120 degrees.
// Three cameras surround a scene evenly.
const APART_RAD: f32 = 2.0 * std::f32::consts::FRAC_PI_3;
/// A scene is no smaller than this, metres.
// A single point would put the camera onto it.
const LEAST_RADIUS_M: f32 = 0.05;

/// `count` cameras of `[width, height]` pixels around a scene.
///
/// They look at the middle of the box around all units at the first frame, 35 degrees downwards, with a view of 60 degrees along the
/// longer side. A sphere about that middle that holds all units' points would be seen from 1/1.5 of the distance; so there is room
/// for motion. The first camera stands at an angle of -60 degrees from x towards y, each other one 120 degrees further.
///
/// # Errors
/// [`CameraError`] for sizes that no camera has.
///
/// ```
/// # use nalgebra::{Isometry3, Point3, Vector3};
/// # use rigidformer_core::Physics;
/// use rigidformer_evaluation::render::cameras;
/// # use rigidformer_evaluation::scenes::{RecordedScene, RecordedUnit, Split};
/// # let physics = Physics { mass_kg: 1.0, friction: 0.4, restitution: 0.3 };
/// # let corner = |k: u8, bit: u8| if k & bit == 0 { -0.1 } else { 0.1 };
/// # let points = (0..8).map(|k| Point3::new(corner(k, 1), corner(k, 2), corner(k, 4))).collect();
/// # let unit = RecordedUnit::new("cube", points, physics, vec![Isometry3::translation(1.0, 0.0, 0.1)]);
/// # let scene = RecordedScene::new("cube", 1, Split::Test, 240.0, Vector3::zeros(), vec![unit])?;
/// let [one, two] = cameras(&scene, [640, 480], 2)?.try_into().map_err(|_| "two were asked for")?;
/// // Both have the cube in the middle of their images.
/// let (pixel, _) = one.pixel(&Point3::new(1.0, 0.0, 0.1)).ok_or("behind")?;
/// assert!((pixel[0] - 319.5).abs() < 0.01 && (pixel[1] - 239.5).abs() < 0.01);
/// assert!(two.pose().translation.vector.z > 0.3);
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
pub fn cameras(
    scene: &RecordedScene,
    size: [u32; 2],
    count: usize,
) -> Result<Vec<Camera>, CameraError> {
    let points: Vec<Point3<f32>> =
        scene.units().iter().filter_map(|unit| unit.points_at(0)).flatten().collect();
    let corner = |start: f32, of: fn(f32, f32) -> f32| {
        points
            .iter()
            .fold(Vector3::repeat(start), |so_far, point| so_far.zip_map(&point.coords, of))
    };
    let (low, high) = (corner(f32::MAX, f32::min), corner(f32::MIN, f32::max));
    let middle =
        if points.is_empty() { Point3::origin() } else { Point3::from((low + high) / 2.0) };
    let far = points.iter().map(|point| (point - middle).norm()).fold(LEAST_RADIUS_M, f32::max);

    let [width, height] = size.map(|side| side as f32);
    let longer = width.max(height);
    let focal = longer / 2.0 / HALF_VIEW_RAD.tan();
    // The shorter side decides what fits. A floor keeps images of one pixel from infinite
    // distances.
    let half_view = (width.min(height) / 2.0 / focal).atan().max(1e-3);
    let distance = FARTHER * far / half_view.sin();
    let camera = |index: usize| {
        let (sin, cos) = (FIRST_RAD + APART_RAD * index as f32).sin_cos();
        let level = distance * DOWN_RAD.cos();
        let eye = middle + Vector3::new(level * cos, level * sin, distance * DOWN_RAD.sin());
        // A camera's y points down, so its own up is -y.
        let pose = Isometry3::face_towards(&eye, &middle, &-Vector3::z());
        Camera::new(size, [focal; 2], [(width - 1.0) / 2.0, (height - 1.0) / 2.0], pose)
    };
    (0..count).map(camera).collect()
}

/// Mean distance of the units from the cameras' planes at the first frame, metres.
pub fn distance_m(scene: &RecordedScene, cameras: &[Camera]) -> f32 {
    let places = scene.poses_at(0).unwrap_or_default();
    let depths = cameras.iter().flat_map(|camera| {
        places.iter().filter_map(|pose| camera.pixel(&pose.translation.vector.into()))
    });
    let depths: Vec<f32> = depths.map(|(_, depth_m)| depth_m).collect();
    depths.iter().sum::<f32>() / depths.len().max(1) as f32
}
