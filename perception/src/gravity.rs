//! Which way is down, and how that is known.

use nalgebra::Vector3;
use rigidformer_core::Plane;
use rigidformer_core::kernels::in_own_environment;

use crate::capture::{Capture, View};
use crate::depth_noise::DepthNoise;
use crate::planes::{Measurement, Planes, height_m};
use crate::tracker::add_measurements;

/// Acceleration of free fall on Earth, m/s^2.
pub const STANDARD_M_S2: f32 = 9.81;
/// Least cosine of a plane's normal and z for the world to be taken as standing upright.
// Floors of calibrated cameras are level to within some degrees.
const UPRIGHT: f32 = 0.966;
/// Largest angle of a camera that stands in no world, radians.
const OWN_FRAME: f32 = 1e-4;
/// Distance of a point from its plane, metres, and as a share of its distance from the sensor.
const ON_PLANE: [f32; 2] = [0.005, 0.005];

/// How gravity is known, best first.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[non_exhaustive]
pub enum Known {
    /// The recording or its user says so.
    Given,
    /// An inertial sensor of the recording at rest measured it.
    Imu,
    /// The largest plane is taken to be level.
    LargestPlane,
    /// The world's z is taken to be up.
    Assumed,
}

/// Gravity, and how it is known.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Gravity {
    /// Acceleration of free fall, m/s^2.
    pub m_s2: Vector3<f32>,
    /// How it is known.
    pub known: Known,
    /// Whether the captures are in a camera's own frame, where -z is never down.
    pub in_camera: bool,
}

/// A plane of a capture.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Seen {
    /// Its normal points to the sensors.
    pub plane: Plane,
    /// Share of the capture's points on it.
    pub share: f32,
}

impl Gravity {
    /// Gravity that is known: an inertial sensor's where `known` says so.
    pub fn new(m_s2: Vector3<f32>, known: Known) -> Self {
        Gravity { m_s2, known, in_camera: false }
    }

    /// Gravity as a capture shows it. Where a plane is level by the world's z, z is up; else the largest plane is level. In a camera's own
    /// frame only the largest plane tells.
    ///
    /// ```
    /// use nalgebra::Isometry3;
    /// use rigidformer_perception::camera::Camera;
    /// use rigidformer_perception::capture::{Capture, DepthView, View};
    /// use rigidformer_perception::gravity::{Gravity, Known};
    ///
    /// // A camera in its own frame, z forward and y down, looks 45 degrees down on a floor a metre below it.
    /// let camera = Camera::new([160, 120], [140.0; 2], [79.5, 59.5], Isometry3::identity())?;
    /// let depth = (0..160 * 120).map(|at| {
    ///     let ray = ((at / 160) as f64 - 59.5) / 140.0;
    ///     (1000.0 * 2f64.sqrt() / (1.0 + ray)).round() as u16
    /// });
    /// let view = DepthView::new(camera, 0.001, depth.collect(), None)?;
    /// let gravity = Gravity::seen(&Capture { time_s: 0.0, views: vec![View::Depth(view)] });
    /// assert_eq!(gravity.known, Known::LargestPlane);
    /// assert!((gravity.m_s2.y - gravity.m_s2.z).abs() < 0.1 && gravity.m_s2.y > 6.8);
    /// # Ok::<(), Box<dyn std::error::Error>>(())
    /// ```
    pub fn seen(capture: &Capture) -> Self {
        in_own_environment(|| Self::seen_here(capture))
    }

    fn seen_here(capture: &Capture) -> Self {
        let in_camera = capture.views.iter().any(is_in_own_frame);
        let seen = planes(capture);
        let is_upright = seen.iter().any(|seen| seen.plane.normal.z > UPRIGHT);
        let assumed = Vector3::new(0.0, 0.0, -STANDARD_M_S2);
        match seen.first() {
            Some(largest) if in_camera || !is_upright => Gravity {
                m_s2: largest.plane.normal * -STANDARD_M_S2,
                known: Known::LargestPlane,
                in_camera,
            },
            _ => Gravity { m_s2: assumed, known: Known::Assumed, in_camera },
        }
    }
}

/// Planes of a capture, the largest first.
pub fn planes(capture: &Capture) -> Vec<Seen> {
    in_own_environment(|| planes_here(capture))
}

fn planes_here(capture: &Capture) -> Vec<Seen> {
    let mut measurements = Vec::new();
    for view in &capture.views {
        let mut noise = DepthNoise::default();
        if let View::Depth(view) = view {
            noise.update(view);
        }
        add_measurements(view, &noise, &mut measurements);
    }
    let mut planes = Planes::new([0.5, 0.4], Vector3::zeros(), 1);
    planes.update(&measurements);
    let is_on = |plane: &Plane, at: &Measurement| {
        let limit = ON_PLANE[0] + ON_PLANE[1] * at.towards.norm();
        height_m(plane, &at.point.coords).abs() < limit
    };
    let tabletops = planes.tabletops().iter().map(|tabletop| &tabletop.plane);
    let mut seen: Vec<Seen> = (planes.all().iter().chain(tabletops))
        .map(|plane| {
            let on = measurements.iter().filter(|at| is_on(plane, at)).count();
            Seen { plane: *plane, share: on as f32 / measurements.len().max(1) as f32 }
        })
        .collect();
    seen.sort_by(|a, b| b.share.total_cmp(&a.share));
    seen
}

/// Whether a depth camera stands in no world.
fn is_in_own_frame(view: &View) -> bool {
    match view {
        View::Depth(view) => view.camera.pose().rotation.angle() < OWN_FRAME,
        View::Cloud(_) => false,
    }
}
