//! What C hands in as the tracker takes it, and its errors as codes and texts.
#![allow(unsafe_code)]

use super::types::*;
use crate::arrays::input;
use crate::convert::isometry;
use crate::types::rf_status::{self, *};
use crate::types::{RF_ABI_VERSION, rf_detail, rf_plane, rf_pose};
use core::ffi::CStr;
use nalgebra::{Isometry3, Matrix6, Point3, UnitQuaternion, Vector3};
use rigidformer_core::Plane;
use rigidformer_perception::camera::{Camera, CameraError};
use rigidformer_perception::capture::{Capture, Cloud, DepthError, DepthView, View};
use rigidformer_perception::estimate::{Rest, UnitEstimate, Visibility};
use rigidformer_perception::tracker::{
    Completion, ForecastError, LeftOut, Segmentation, TrackError, Tracker, TrackerOptions,
};
use rigidformer_runtime::models::{LoadedModel, ModelError};
use std::format;
use std::path::Path;
use std::string::{String, ToString};
use std::vec::Vec;

/// Why a call was refused, and its remedy.
#[derive(Debug)]
pub(super) struct Failure {
    pub(super) code: rf_status,
    pub(super) message: String,
}

impl Failure {
    /// With the text of the code.
    pub(super) fn of(code: rf_status) -> Self {
        let text = crate::status::text(code as i32).to_string_lossy().into_owned();
        Failure { code, message: text }
    }

    pub(super) fn new(code: rf_status, message: impl ToString) -> Self {
        Failure { code, message: message.to_string() }
    }
}

impl From<rf_detail> for Failure {
    fn from(detail: rf_detail) -> Self {
        Self::of(detail.code)
    }
}

impl From<rf_status> for Failure {
    fn from(code: rf_status) -> Self {
        Self::of(code)
    }
}

impl From<TrackError> for Failure {
    fn from(error: TrackError) -> Self {
        let code = match &error {
            TrackError::Options { .. } => RF_ERROR_TRACKER_OPTION,
            TrackError::Order { .. } | TrackError::Time => RF_ERROR_CAPTURE_TIME,
            TrackError::Empty { .. } => RF_ERROR_CAPTURE_EMPTY,
            TrackError::Point { .. } => RF_ERROR_CAPTURE_POINT,
            TrackError::Scale { .. } => RF_ERROR_CAPTURE_SCALE,
            // Images are as long as their cameras say, since they are read so.
            _ => RF_ERROR_OTHER,
        };
        Failure::new(code, error)
    }
}

impl From<ModelError> for Failure {
    fn from(error: ModelError) -> Self {
        let code = match &error {
            ModelError::File(_) => RF_ERROR_MODEL_FILE,
            ModelError::Load { source, .. } => rf_detail::from(*source).code,
            ModelError::Write { .. } => RF_ERROR_OTHER,
        };
        Failure::new(code, error)
    }
}

impl From<ForecastError> for Failure {
    fn from(error: ForecastError) -> Self {
        let remedy = "the model does not take this scene: use one for rigid units without commands";
        Failure::new(RF_ERROR_FORECAST, format!("{error}; {remedy}"))
    }
}

fn option(what: &str) -> Failure {
    Failure::new(RF_ERROR_TRACKER_OPTION, format!("options: {what}"))
}

/// The defaults, as C has them.
pub(super) fn defaults() -> rf_tracker_options {
    let TrackerOptions {
        plane_physics: [plane_friction, plane_restitution],
        density_kg_m3,
        unit_physics: [unit_friction, unit_restitution],
        gravity_m_s2,
        model_points,
        confirm,
        missed,
        hidden_s,
        clusters,
        units,
        extents_m: [min_extent_m, max_extent_m],
        first_velocity: [first_speed_m_s, first_spin_rad_s],
        seed,
        ..
    } = TrackerOptions::default();
    rf_tracker_options {
        abi_version: RF_ABI_VERSION,
        segmentation: RF_SEGMENTATION_FOUND,
        model: core::ptr::null(),
        model_bytes: 0,
        model_path: core::ptr::null(),
        planes: core::ptr::null(),
        plane_count: 0,
        gravity_m_s2: gravity_m_s2.into(),
        density_kg_m3,
        unit_friction,
        unit_restitution,
        plane_friction,
        plane_restitution,
        min_extent_m,
        max_extent_m,
        first_speed_m_s,
        first_spin_rad_s,
        hidden_s,
        confirm,
        missed,
        max_units: units as u32,
        max_clusters: clusters as u32,
        model_points: model_points as u32,
        completion: RF_COMPLETION_FITTED,
        seed,
    }
}

/// # Safety
/// Pointers are NULL or point to what their names and lengths say.
pub(super) unsafe fn tracker(from: &rf_tracker_options) -> Result<Tracker, Failure> {
    if from.abi_version != RF_ABI_VERSION {
        return Err(RF_ERROR_ABI.into());
    }
    let mut options = TrackerOptions::default();
    // SAFETY: the caller's promise.
    options.model = unsafe { model(from)? };
    options.planes = match from.planes.is_null() {
        true if from.plane_count > 0 => return Err(RF_ERROR_NULL.into()),
        true => None,
        // SAFETY: the caller's promise.
        false => Some(planes(unsafe { input(from.planes, from.plane_count)? })),
    };
    options.segmentation = match from.segmentation {
        RF_SEGMENTATION_FOUND => Segmentation::Found,
        RF_SEGMENTATION_GIVEN => Segmentation::Given,
        _ => return Err(option("segmentation must be RF_SEGMENTATION_FOUND or _GIVEN")),
    };
    options.completion = match from.completion {
        RF_COMPLETION_SEEN => Completion::Seen,
        RF_COMPLETION_MIRRORED => Completion::Mirrored,
        RF_COMPLETION_FITTED => Completion::Fitted,
        _ => return Err(option("completion must be RF_COMPLETION_SEEN, _MIRRORED or _FITTED")),
    };
    options.gravity_m_s2 = Vector3::from(from.gravity_m_s2);
    options.density_kg_m3 = from.density_kg_m3;
    options.unit_physics = [from.unit_friction, from.unit_restitution];
    options.plane_physics = [from.plane_friction, from.plane_restitution];
    options.extents_m = [from.min_extent_m, from.max_extent_m];
    options.first_velocity = [from.first_speed_m_s, from.first_spin_rad_s];
    options.hidden_s = from.hidden_s;
    options.confirm = from.confirm;
    options.missed = from.missed;
    options.units = from.max_units as usize;
    options.clusters = from.max_clusters as usize;
    options.model_points = from.model_points as usize;
    options.seed = from.seed;
    Ok(Tracker::new(options)?)
}

/// # Safety
/// As [`tracker`].
unsafe fn model(from: &rf_tracker_options) -> Result<Option<LoadedModel>, Failure> {
    let model = match (from.model.is_null(), from.model_path.is_null()) {
        (true, true) if from.model_bytes > 0 => return Err(RF_ERROR_NULL.into()),
        (true, true) => return Ok(None),
        (false, false) => return Err(option("give model or model_path, not both")),
        (false, true) => {
            // SAFETY: the caller's promise.
            let bytes = unsafe { input(from.model, from.model_bytes)? };
            LoadedModel::copy_of("model", bytes)?
        }
        (true, false) => {
            // SAFETY: the caller's promise: it ends with a zero.
            let path = unsafe { CStr::from_ptr(from.model_path) };
            LoadedModel::open(&as_path(path)?)?
        }
    };
    // Nobody could give it a command.
    if model.model().config().command_size > 0 {
        return Err(option("the model takes commands: use one for rigid units, such as edge.rfm"));
    }
    Ok(Some(model.for_host()?))
}

fn as_path(path: &CStr) -> Result<std::path::PathBuf, Failure> {
    #[cfg(unix)]
    {
        use std::os::unix::ffi::OsStrExt;
        Ok(Path::new(std::ffi::OsStr::from_bytes(path.to_bytes())).into())
    }
    #[cfg(not(unix))]
    path.to_str().map(|path| Path::new(path).into()).map_err(|_| option("model_path is no UTF-8"))
}

fn planes(planes: &[rf_plane]) -> Vec<Plane> {
    planes.iter().map(|plane| Plane::from(*plane)).collect()
}

/// # Safety
/// Pointers are NULL or point to what their names and lengths say.
pub(super) unsafe fn capture(from: &rf_capture) -> Result<Capture, Failure> {
    // SAFETY: the caller's promise.
    let (depths, clouds) =
        unsafe { (input(from.depths, from.depth_count)?, input(from.clouds, from.cloud_count)?) };
    let mut views = Vec::new();
    reserve(&mut views, depths.len().saturating_add(clouds.len()))?;
    for (number, view) in depths.iter().enumerate() {
        // SAFETY: the caller's promise.
        views.push(View::Depth(unsafe { depth(number, view)? }));
    }
    for view in clouds {
        // SAFETY: the caller's promise.
        views.push(View::Cloud(unsafe { cloud(view)? }));
    }
    Ok(Capture { time_s: from.time_s, views })
}

/// # Safety
/// As [`capture`].
unsafe fn depth(number: usize, from: &rf_depth_view) -> Result<DepthView, Failure> {
    let fail = |error: CameraError| {
        Failure::new(RF_ERROR_CAPTURE_CAMERA, format!("depth image {number}: {error}"))
    };
    let pose = pose(&from.camera).ok_or_else(|| {
        let what =
            "the camera's pose is not finite, beyond 1e6 m, or its quaternion not of length 1";
        Failure::new(RF_ERROR_CAPTURE_CAMERA, format!("depth image {number}: {what}"))
    })?;
    let size = [from.width, from.height];
    let camera = Camera::new(size, from.focal, from.centre, pose).map_err(fail)?;
    // At most 8192 a side.
    let pixels = (from.width as usize).saturating_mul(from.height as usize);
    // SAFETY: the caller's promise.
    let (depth, labels) = unsafe { (copied(from.depth, pixels)?, labels(from.labels, pixels)?) };
    DepthView::new(camera, from.scale_m, depth, labels).map_err(|error| match error {
        DepthError::Scale { .. } => {
            Failure::new(RF_ERROR_CAPTURE_SCALE, format!("depth image {number}: {error}"))
        }
        // Images are read as long as their cameras say.
        _ => RF_ERROR_OTHER.into(),
    })
}

/// # Safety
/// As [`capture`].
unsafe fn cloud(from: &rf_cloud_view) -> Result<Cloud, Failure> {
    // SAFETY: the caller's promise.
    let points: &[[f32; 3]] = unsafe { input(from.points.cast(), from.point_count)? };
    let sensor = match from.has_sensor {
        0 => None,
        _ if from.sensor.iter().all(|number| number.abs() <= 1e6) => Some(from.sensor.into()),
        _ => {
            let text = "a cloud's sensor is not finite or beyond 1e6 m: set has_sensor to 0, or correct it";
            return Err(Failure::new(RF_ERROR_CAPTURE_POINT, text));
        }
    };
    let mut own: Vec<Point3<f32>> = Vec::new();
    reserve(&mut own, points.len())?;
    own.extend(points.iter().map(|point| Point3::from(*point)));
    // SAFETY: the caller's promise.
    let labels = unsafe { labels(from.labels, from.point_count)? };
    Ok(Cloud { points: own, sensor, labels })
}

/// # Safety
/// As [`capture`].
unsafe fn labels(array: *const u16, length: usize) -> Result<Option<Vec<u16>>, Failure> {
    if array.is_null() {
        return Ok(None);
    }
    // SAFETY: the caller's promise.
    unsafe { copied(array, length).map(Some) }
}

/// # Safety
/// As [`capture`].
unsafe fn copied(array: *const u16, length: usize) -> Result<Vec<u16>, Failure> {
    let mut own = Vec::new();
    reserve(&mut own, length)?;
    // SAFETY: the caller's promise.
    own.extend_from_slice(unsafe { input(array, length)? });
    Ok(own)
}

/// Room for so many, or an error where memory is short.
fn reserve<T>(own: &mut Vec<T>, length: usize) -> Result<(), Failure> {
    own.try_reserve_exact(length).map_err(|_| RF_ERROR_NO_MEMORY.into())
}

/// A pose that can be one.
fn pose(from: &rf_pose) -> Option<Isometry3<f32>> {
    let is_near = from.position.iter().all(|number| number.abs() <= 1e6);
    let square: f32 = from.quaternion.iter().map(|number| number * number).sum();
    // A sensor's pose is normalised here; what is farther off is no quaternion, or is in another order.
    let is_unit = (square - 1.0).abs() <= 0.01;
    (is_near && is_unit).then(|| {
        let Isometry3 { rotation, translation } = isometry(from);
        Isometry3::from_parts(translation, UnitQuaternion::new_normalize(rotation.into_inner()))
    })
}

pub(super) fn track(tracker: &Tracker, unit: &UnitEstimate) -> rf_track {
    let visibility = match unit.visibility {
        Visibility::Seen => RF_TRACK_SEEN,
        Visibility::Hidden => RF_TRACK_HIDDEN,
        Visibility::Missed => RF_TRACK_MISSED,
    };
    let rest = match unit.rest {
        Rest::Moving => 0,
        Rest::Supported => RF_TRACK_SUPPORTED,
        Rest::Held => RF_TRACK_HELD,
    };
    rf_track {
        id: unit.id,
        flags: visibility | rest,
        pose: unit.pose.into(),
        centre: tracker.centre(unit.id).unwrap_or_default().into(),
        mass_kg: tracker.physics(unit.id).map_or(0.0, |physics| physics.mass_kg),
        velocity: unit.velocity.into(),
        pose_covariance: rows(&unit.covariance),
        velocity_covariance: rows(&unit.velocity_covariance),
    }
}

/// By rows. A covariance is symmetric but for its last bits.
fn rows(matrix: &Matrix6<f32>) -> [f32; 36] {
    let mut all = [0.0; 36];
    all.iter_mut().zip(matrix.transpose().iter()).for_each(|(to, number)| *to = *number);
    all
}

pub(super) fn left_out((id, why): &(u32, LeftOut)) -> rf_left_out {
    let reason = match why {
        LeftOut::TooFewPoints => RF_LEFT_OUT_POINTS,
        LeftOut::Lost => RF_LEFT_OUT_LOST,
        // A reason that this interface has no number for is of this kind.
        _ => RF_LEFT_OUT_UNCERTAIN,
    };
    rf_left_out { id: *id, reason }
}
