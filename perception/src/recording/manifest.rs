//! `frames.json` of a recording.

use std::collections::{BTreeSet, HashMap};
use std::path::{Component, Path, PathBuf};

use nalgebra::{Isometry3, Quaternion, Translation3, UnitQuaternion, Vector3};
use rigidformer_runtime::memory::Budget;
use serde::{Deserialize, Serialize};

use super::error::{CaptureError, CaptureProblem};
use super::limited::read_limited;
use super::points::shortened;
use crate::camera::Camera;
use crate::capture::{DepthError, SCALES_M};

/// The file's name.
pub(super) const NAME: &str = "frames.json";
/// Format of depth recordings.
const DEPTH: &str = "rigidformer-depth";
/// Format of clouds.
const CLOUDS: &str = "rigidformer-clouds";
/// The one version.
const VERSION: u32 = 1;
/// Bytes of the file, at most: half a million frames.
const MAX_BYTES: u64 = 64 << 20;
/// Bytes that a byte of the file takes in memory.
// `{"time_s":0,"camera":"","depth":"a"},` has 37 and becomes a frame of 176 as it is read, and one of 144 with its path.
const JSON_GROWTH: u64 = 12;
/// Frames are of one capture where their times differ by less than this, seconds.
pub(super) const MAX_CAPTURE_SPAN_S: f64 = 1e-3;
/// Tolerance of a quaternion's length.
// Files round to a few digits.
const QUATERNION_TOLERANCE: f32 = 1e-3;

/// A pose: metres, then w, x, y, z.
pub(super) type Pose = [f32; 7];

#[derive(Clone, Debug, Deserialize, Serialize)]
struct Kind {
    #[serde(default)]
    format: String,
    #[serde(default)]
    version: u32,
}

#[derive(Clone, Debug, Deserialize, Serialize)]
#[serde(deny_unknown_fields)]
pub(super) struct DepthManifest {
    format: String,
    version: u32,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub(super) gravity_m_s2: Option<[f32; 3]>,
    pub(super) cameras: Vec<CameraEntry>,
    pub(super) frames: Vec<FrameEntry>,
}

#[derive(Clone, Debug, Deserialize, PartialEq, Serialize)]
#[serde(deny_unknown_fields)]
pub(super) struct CameraEntry {
    pub(super) name: String,
    pub(super) width: u32,
    pub(super) height: u32,
    pub(super) fx: f32,
    pub(super) fy: f32,
    pub(super) cx: f32,
    pub(super) cy: f32,
    pub(super) depth_scale_m: f32,
    pub(super) pose: Pose,
}

#[derive(Clone, Debug, Deserialize, PartialEq, Serialize)]
#[serde(deny_unknown_fields)]
pub(super) struct FrameEntry {
    pub(super) time_s: f64,
    pub(super) camera: String,
    pub(super) depth: String,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub(super) labels: Option<String>,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub(super) pose: Option<Pose>,
}

#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct CloudManifest {
    #[serde(rename = "format")]
    _format: String,
    #[serde(rename = "version")]
    _version: u32,
    #[serde(default)]
    gravity_m_s2: Option<[f32; 3]>,
    clouds: Vec<CloudEntry>,
}

#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct CloudEntry {
    pub(super) time_s: f64,
    pub(super) file: String,
    #[serde(default)]
    pub(super) sensor: Option<[f32; 3]>,
}

/// A camera of a depth recording.
#[derive(Clone, Debug)]
pub(super) struct KnownCamera {
    pub(super) camera: Camera,
    pub(super) scale_m: f32,
}

/// A frame whose camera is known.
#[derive(Clone, Debug)]
pub(super) struct KnownFrame {
    pub(super) time_s: f64,
    /// Among the cameras.
    pub(super) camera: usize,
    pub(super) depth: PathBuf,
    pub(super) labels: Option<PathBuf>,
    /// Pose of the camera, where it differs from the recording's.
    pub(super) moved: Option<Isometry3<f32>>,
}

/// A cloud and its time.
#[derive(Clone, Debug)]
pub(super) struct KnownCloud {
    pub(super) time_s: f64,
    pub(super) path: PathBuf,
    pub(super) sensor: Option<[f32; 3]>,
}

/// Contents of a recording, in the order of times.
pub(super) enum Manifest {
    Depth { cameras: Vec<KnownCamera>, frames: Vec<KnownFrame>, gravity: Option<Vector3<f32>> },
    Clouds { clouds: Vec<KnownCloud>, gravity: Option<Vector3<f32>> },
}

impl DepthManifest {
    pub(super) fn new(
        gravity_m_s2: Option<[f32; 3]>,
        cameras: Vec<CameraEntry>,
        frames: Vec<FrameEntry>,
    ) -> Self {
        DepthManifest { format: DEPTH.into(), version: VERSION, gravity_m_s2, cameras, frames }
    }
}

/// Reads and checks a folder's `frames.json`, all but the images.
pub(super) fn read(folder: &Path) -> Result<Manifest, CaptureError> {
    let path = folder.join(NAME);
    let bytes = read_limited(&path, MAX_BYTES)?;
    Budget::default()
        .take((bytes.len() as u64).saturating_mul(JSON_GROWTH))
        .map_err(|large| CaptureError::of(path.as_path(), large))?;
    let json = |error: serde_json::Error| {
        CaptureError::of(path.as_path(), CaptureProblem::Json(shortened(error.to_string())))
    };
    let kind: Kind = serde_json::from_slice(&bytes).map_err(json)?;
    let found = format!("{:?} version {}", shortened(kind.format.clone()), kind.version);
    match (kind.format.as_str(), kind.version) {
        (DEPTH, VERSION) => depth(folder, &path, serde_json::from_slice(&bytes).map_err(json)?),
        (CLOUDS, VERSION) => clouds(folder, &path, serde_json::from_slice(&bytes).map_err(json)?),
        (DEPTH, _) => {
            let expected = "version 1, which this program knows";
            Err(CaptureError::of(path, CaptureProblem::Foreign { found, expected }))
        }
        _ => {
            let expected = "\"rigidformer-depth\" or \"rigidformer-clouds\", version 1";
            Err(CaptureError::of(path, CaptureProblem::Foreign { found, expected }))
        }
    }
}

fn depth(folder: &Path, path: &Path, manifest: DepthManifest) -> Result<Manifest, CaptureError> {
    let gravity = gravity(path, manifest.gravity_m_s2)?;
    let mut cameras = Vec::with_capacity(manifest.cameras.len());
    let mut places = HashMap::new();
    for (index, entry) in manifest.cameras.iter().enumerate() {
        let fail = |problem| {
            let name = shortened(entry.name.clone());
            CaptureError::at(path, &format!("camera {name:?}"), problem)
        };
        if places.insert(entry.name.as_str(), index).is_some() {
            return Err(fail(CaptureProblem::DuplicateCamera));
        }
        let pose = pose(&entry.pose).map_err(|what| fail(CaptureProblem::Pose(what)))?;
        let (size, focal) = ([entry.width, entry.height], [entry.fx, entry.fy]);
        let camera = Camera::new(size, focal, [entry.cx, entry.cy], pose)
            .map_err(|error| fail(error.into()))?;
        let scale_m = entry.depth_scale_m;
        if !SCALES_M.contains(&scale_m) {
            return Err(fail(DepthError::Scale { scale_m }.into()));
        }
        cameras.push(KnownCamera { camera, scale_m });
    }
    if manifest.frames.is_empty() {
        return Err(CaptureError::of(path, CaptureProblem::Empty));
    }
    let mut frames = Vec::with_capacity(manifest.frames.len());
    let mut times = Times::default();
    let mut of_capture = BTreeSet::new();
    for (index, entry) in manifest.frames.iter().enumerate() {
        let fail = |problem| CaptureError::at(path, &format!("frame {index}"), problem);
        let camera = *places
            .get(entry.camera.as_str())
            .ok_or_else(|| fail(CaptureProblem::UnknownCamera(shortened(entry.camera.clone()))))?;
        if times.is_new(entry.time_s).map_err(fail)? {
            of_capture.clear();
        }
        // A camera has one view in a capture.
        if !of_capture.insert(camera) {
            return Err(fail(CaptureProblem::Duplicate(entry.time_s)));
        }
        let inside = |name: &str| inside(folder, name).map_err(fail);
        let moved = entry.pose.as_ref().map(pose).transpose();
        let moved = moved.map_err(|what| fail(CaptureProblem::Pose(what)))?;
        let labels = entry.labels.as_deref().map(inside).transpose()?;
        let depth = inside(&entry.depth)?;
        frames.push(KnownFrame { time_s: entry.time_s, camera, depth, labels, moved });
    }
    Ok(Manifest::Depth { cameras, frames, gravity })
}

fn clouds(folder: &Path, path: &Path, manifest: CloudManifest) -> Result<Manifest, CaptureError> {
    let gravity = gravity(path, manifest.gravity_m_s2)?;
    if manifest.clouds.is_empty() {
        return Err(CaptureError::of(path, CaptureProblem::Empty));
    }
    let mut times = Times::default();
    let mut clouds = Vec::with_capacity(manifest.clouds.len());
    for (index, entry) in manifest.clouds.iter().enumerate() {
        let fail = |problem| CaptureError::at(path, &format!("cloud {index}"), problem);
        times.is_new(entry.time_s).map_err(fail)?;
        if entry.sensor.is_some_and(|sensor| sensor.iter().any(|v| !v.is_finite())) {
            return Err(fail(CaptureProblem::Pose("has a number that is not finite")));
        }
        let path = inside(folder, &entry.file).map_err(fail)?;
        clouds.push(KnownCloud { time_s: entry.time_s, path, sensor: entry.sensor });
    }
    Ok(Manifest::Clouds { clouds, gravity })
}

fn gravity(path: &Path, given: Option<[f32; 3]>) -> Result<Option<Vector3<f32>>, CaptureError> {
    if given.is_some_and(|gravity| gravity.iter().any(|number| !number.is_finite())) {
        let why = "gravity_m_s2 has a number that is not finite".to_owned();
        return Err(CaptureError::of(path, CaptureProblem::Json(why)));
    }
    Ok(given.map(Vector3::from))
}

/// Times that must not go back.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Times {
    last_s: Option<f64>,
    /// Of the capture's first frame.
    capture_s: f64,
}

impl Times {
    /// Whether a time begins a new capture.
    pub(super) fn is_new(&mut self, time_s: f64) -> Result<bool, CaptureProblem> {
        // Beyond this, f64 does not resolve milliseconds.
        if !(-1e12..=1e12).contains(&time_s) {
            return Err(CaptureProblem::Time(time_s));
        }
        let before = self.last_s.replace(time_s);
        let is_new = match before {
            Some(before_s) if time_s < before_s => {
                return Err(CaptureProblem::Backwards { time_s, before_s });
            }
            Some(_) => time_s - self.capture_s >= MAX_CAPTURE_SPAN_S,
            None => true,
        };
        if is_new {
            self.capture_s = time_s;
        }
        Ok(is_new)
    }
}

fn pose(numbers: &Pose) -> Result<Isometry3<f32>, &'static str> {
    let [x, y, z, w, i, j, k] = *numbers;
    if numbers.iter().any(|number| !number.is_finite()) {
        return Err("has a number that is not finite");
    }
    let quaternion = Quaternion::new(w, i, j, k);
    // The square of a large number may be infinite, and is no length of 1 either.
    if (quaternion.norm() - 1.0).abs() > QUATERNION_TOLERANCE || !quaternion.norm().is_finite() {
        return Err("has a quaternion whose length is not 1");
    }
    let rotation = UnitQuaternion::new_normalize(quaternion);
    Ok(Isometry3::from_parts(Translation3::new(x, y, z), rotation))
}

/// A pose as the file has it.
pub(super) fn numbers(pose: &Isometry3<f32>) -> Pose {
    let (t, q) = (pose.translation.vector, pose.rotation.quaternion());
    [t.x, t.y, t.z, q.w, q.i, q.j, q.k]
}

/// The path of a file in the folder.
fn inside(folder: &Path, name: &str) -> Result<PathBuf, CaptureProblem> {
    let relative = Path::new(name);
    let mut components = relative.components().peekable();
    // Neither absolute paths nor parents: a recording must not read files elsewhere.
    let is_inside = components.peek().is_some()
        && components.all(|component| matches!(component, Component::Normal(_)));
    if !is_inside {
        return Err(CaptureProblem::Outside(shortened(name.into())));
    }
    Ok(folder.join(relative))
}
