//! From depth images and clouds to units that are followed.

use std::collections::BTreeMap;

use nalgebra::{Isometry3, Matrix6, Vector6};
use numpy::{PyArrayDyn, PyUntypedArrayMethods};
use pyo3::prelude::*;
use pyo3::types::PyTuple;
use rigidformer_perception::camera;
use rigidformer_perception::capture::{self, Capture, View};
use rigidformer_perception::estimate::{Rest, UnitEstimate, Visibility};
use rigidformer_perception::tracker::{
    self, Completion, LeftOut, Segmentation, TrackError, TrackerOptions,
};
use rigidformer_runtime::pool;

use crate::arrays::{self, Floats};
use crate::errors::{OrRaise, input};
use crate::interrupt::{held, with_threads};
use crate::locked::Locked;
use crate::model::Model;
use crate::unit::{Plane, planes, planes_of};
use crate::whole;

/// A pinhole camera without distortion. Its frame has x to the right, y down and z forward; the middle of pixel (0, 0), the top left
/// one, is at (0, 0).
///
/// Parameters
/// ----------
/// width, height : int
///     Pixels, 1 to 8192.
/// fx, fy, cx, cy : float
///     Focal lengths, above 0, and principal point, pixels.
/// pose : array of float32, (7,), optional
///     Carries the camera's frame to the world. None: they are one.
///
/// Raises
/// ------
/// InputError, TypeError
///     One of them cannot be.
///
/// Source: ``perception/src/camera.rs``.
///
/// >>> import rigidformer as rf
/// >>> camera = rf.Camera(640, 480, 544.5, 544.5, 320, 240)
#[pyclass(frozen, module = "rigidformer")]
pub(crate) struct Camera {
    camera: camera::Camera,
}

#[pymethods]
impl Camera {
    #[new]
    #[pyo3(signature = (width, height, fx, fy, cx, cy, pose = None))]
    fn new(
        #[pyo3(from_py_with = whole::width)] width: u32,
        #[pyo3(from_py_with = whole::height)] height: u32,
        fx: f32,
        fy: f32,
        cx: f32,
        cy: f32,
        pose: Option<&Bound<'_, PyAny>>,
    ) -> PyResult<Self> {
        let pose = pose.map(|pose| arrays::pose(pose, "pose")).transpose()?;
        let pose = pose.unwrap_or_else(Isometry3::identity);
        let (size, focal, centre) = ([width, height], [fx, fy], [cx, cy]);
        let camera = held(|| camera::Camera::new(size, focal, centre, pose))?;
        Ok(Camera { camera: camera.or_raise()? })
    }

    /// The same camera elsewhere.
    ///
    /// Raises
    /// ------
    /// InputError, TypeError
    ///     The pose has a number that is not finite.
    fn moved(&self, pose: &Bound<'_, PyAny>) -> PyResult<Self> {
        let pose = arrays::pose(pose, "pose")?;
        let camera = held(|| self.camera.moved(pose))?;
        Ok(Camera { camera: camera.or_raise()? })
    }

    /// tuple of int: pixels a row, and rows.
    #[getter]
    fn size(&self) -> (u32, u32) {
        self.camera.size().into()
    }

    /// float32 (7,): carries the camera's frame to the world.
    #[getter]
    fn pose<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyArrayDyn<f32>>> {
        arrays::read_only(arrays::array_of_poses(py, [self.camera.pose()], &[])?)
    }

    fn __getnewargs__<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyTuple>> {
        let ([width, height], [fx, fy]) = (self.camera.size(), self.camera.focal());
        let [cx, cy] = self.camera.centre();
        (width, height, fx, fy, cx, cy, self.pose(py)?).into_pyobject(py)
    }

    fn __repr__(&self) -> String {
        let [width, height] = self.camera.size();
        format!("Camera({width} x {height})")
    }
}

/// A depth image and its camera. The arrays are copied.
///
/// Parameters
/// ----------
/// camera : Camera
///     At that instant.
/// depth : array of uint16, (height, width)
///     Distance from the camera's plane, not along the ray, in steps; 0: nothing was measured.
/// scale_m : float
///     Metres a step, from 1e-6 to 10: 0.001 where depths are millimetres.
/// labels : array of uint16, (height, width), optional
///     Which body is seen, where somebody else told: 0 for what is none.
///
/// Raises
/// ------
/// InputError, TypeError
///     Image, labels and camera are of different sizes, or a type or the scale is another.
///
/// Source: ``perception/src/capture.rs``.
#[pyclass(frozen, module = "rigidformer")]
pub(crate) struct DepthView {
    view: capture::DepthView,
}

#[pymethods]
impl DepthView {
    #[new]
    #[pyo3(signature = (camera, depth, scale_m = 0.001, labels = None))]
    fn new(
        camera: &Camera,
        depth: &Bound<'_, PyAny>,
        scale_m: f32,
        labels: Option<&Bound<'_, PyAny>>,
    ) -> PyResult<Self> {
        let [width, height] = camera.camera.size();
        let shape = [height as usize, width as usize];
        let depth = image(depth, "depth", &shape)?;
        let labels = labels.map(|labels| image(labels, "labels", &shape)).transpose()?;
        let camera = camera.camera;
        let view = held(|| capture::DepthView::new(camera, scale_m, depth, labels))?;
        Ok(DepthView { view: view.or_raise()? })
    }

    fn __getnewargs__<'py>(
        &self,
        py: Python<'py>,
    ) -> PyResult<(Camera, Image<'py>, f32, Option<Image<'py>>)> {
        let capture::DepthView { camera, scale_m, depth, labels } = &self.view;
        let [width, height] = camera.size();
        let array =
            |rows: &Vec<u16>| arrays::array(py, rows.clone(), &[height as usize, width as usize]);
        let labels = labels.as_ref().map(array).transpose()?;
        Ok((Camera { camera: *camera }, array(depth)?, *scale_m, labels))
    }
}

impl From<capture::DepthView> for DepthView {
    fn from(view: capture::DepthView) -> Self {
        DepthView { view }
    }
}

/// uint16 (height, width)
type Image<'py> = Bound<'py, PyArrayDyn<u16>>;

/// Numbers by rows, whatever the array's layout.
fn image(value: &Bound<'_, PyAny>, name: &'static str, shape: &[usize]) -> PyResult<Vec<u16>> {
    let array = arrays::whole(value, name)?;
    if array.shape() != shape {
        return Err(arrays::misshapen(name, array.shape(), &arrays::sides(shape)));
    }
    // Row by row, also where an image is a view with its columns first.
    Ok(array.as_array().iter().copied().collect())
}

/// Points that a scanner saw. The arrays are copied.
///
/// Parameters
/// ----------
/// points : array of float32, (n, 3)
///     In the world, metres.
/// sensor : array, (3,), optional
///     Where the sensor was: surfaces face it.
/// labels : array of uint16, (n,), optional
///     Which body each point is of, where somebody else told: 0 for what is none.
///
/// Raises
/// ------
/// InputError, TypeError
///     An array has another shape or type.
///
/// Source: ``perception/src/capture.rs``.
#[pyclass(frozen, module = "rigidformer")]
pub(crate) struct Cloud {
    cloud: capture::Cloud,
}

#[pymethods]
impl Cloud {
    #[new]
    #[pyo3(signature = (points, sensor = None, labels = None))]
    fn new(
        points: &Bound<'_, PyAny>,
        sensor: Option<&Bound<'_, PyAny>>,
        labels: Option<&Bound<'_, PyAny>>,
    ) -> PyResult<Self> {
        let points = arrays::points(points, "points")?;
        let sensor = sensor.map(|sensor| arrays::vector(sensor, "sensor")).transpose()?;
        let labels = labels.map(|labels| image(labels, "labels", &[points.len()])).transpose()?;
        Ok(Cloud { cloud: capture::Cloud { points, sensor: sensor.map(Into::into), labels } })
    }

    fn __getnewargs__<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyTuple>> {
        let capture::Cloud { points, sensor, labels } = &self.cloud;
        let labels = labels.as_ref().map(|own| arrays::array(py, own.clone(), &[own.len()]));
        let points = arrays::array_of_points(py, points, &[points.len()])?;
        let sensor: Option<[f32; 3]> = sensor.map(|sensor| sensor.coords.into());
        (points, sensor, labels.transpose()?).into_pyobject(py)
    }
}

/// What a sensor saw.
#[derive(FromPyObject)]
enum Seen<'py> {
    Depth(Bound<'py, DepthView>),
    Cloud(Bound<'py, Cloud>),
}

impl Seen<'_> {
    fn view(&self) -> View {
        match self {
            Seen::Depth(view) => View::Depth(view.get().view.clone()),
            Seen::Cloud(cloud) => View::Cloud(cloud.get().cloud.clone()),
        }
    }
}

/// Follows the units of a scene from capture to capture.
///
/// Parameters
/// ----------
/// model : Model, optional
///     The motion model. Without one, units fly or lie, whichever fits better, and nothing is predicted.
/// segmentation : str
///     What tells bodies from each other: "found" (planes, and gaps) or "given" (labels).
/// planes : sequence of Plane, optional
///     The scene's, at most 8; None: up to four are looked for.
/// plane_physics, unit_physics : tuple of float
///     Friction and restitution that planes and units are taken to have.
/// density_kg_m3 : float
///     That units are taken to have.
/// gravity_m_s2 : array, (3,), optional
///     None: (0, 0, -9.81).
/// completion : str
///     How the sides of a unit that nobody has seen are guessed: "fitted" (boxes, cylinders and balls; others mirrored),
///     "mirrored" or "seen" (they are not).
/// model_points : int
///     Points of a unit that the model gets, at most: 8 to 256.
/// confirm, missed : int
///     Captures in which a unit has been seen before it is told of, and in which it may be missed before it is given up.
/// hidden_s : float
///     Seconds that a unit may be hidden before it is given up.
/// clusters, units : int
///     Clusters of a capture that are looked at, and units that are followed, at most.
/// extents_m : tuple of float
///     Diameters that a unit may have.
/// first_velocity : tuple of float
///     Speeds (m/s) and spins (rad/s) of units that come into view, standard deviation.
/// seed : int
///     Of the search for planes.
/// network : bool
///     Whether the model's network corrects its motion; without it impulses alone predict.
///
/// Raises
/// ------
/// InputError
///     An option is out of range.
///
/// Source: ``perception/src/tracker/mod.rs``, ``docs/TRACKING.md``.
///
/// >>> import numpy as np, rigidformer as rf
/// >>> # A camera half a metre above a floor looks down at the top of a box, 20 cm high, that slides along.
/// >>> camera = rf.Camera(160, 120, 140, 140, 80, 60, [0, 0, 0.5, 0, 0, 1, 0])
/// >>> tracker = rf.Tracker()
/// >>> for frame in range(4):
/// ...     depth = np.full((120, 160), 500, np.uint16)
/// ...     depth[40:90, 40 + frame:90 + frame] = 300
/// ...     estimate = tracker.observe(frame / 30, [rf.DepthView(camera, depth)])
/// >>> [unit.sight for unit in estimate.units], len(tracker.planes)
/// (['seen'], 1)
#[pyclass(frozen, module = "rigidformer")]
pub(crate) struct Tracker {
    tracker: Locked<tracker::Tracker>,
}

#[pymethods]
impl Tracker {
    #[new]
    #[pyo3(signature = (model = None, *, segmentation = "found", planes = None, plane_physics = (0.5, 0.4), unit_physics = (0.5, 0.4), density_kg_m3 = 1000.0, gravity_m_s2 = None, completion = "fitted", model_points = 96, confirm = 2, missed = 5, hidden_s = 3.0, clusters = 128, units = 64, extents_m = (0.01, 5.0), first_velocity = (2.0, 4.0), seed = 1, network = true))]
    #[expect(clippy::too_many_arguments, reason = "Python's are named")]
    fn new(
        model: Option<&Model>,
        segmentation: &str,
        planes: Option<Vec<Bound<'_, Plane>>>,
        plane_physics: (f32, f32),
        unit_physics: (f32, f32),
        density_kg_m3: f32,
        gravity_m_s2: Option<&Bound<'_, PyAny>>,
        completion: &str,
        #[pyo3(from_py_with = whole::model_points)] model_points: usize,
        #[pyo3(from_py_with = whole::confirm)] confirm: u32,
        #[pyo3(from_py_with = whole::missed)] missed: u32,
        hidden_s: f64,
        #[pyo3(from_py_with = whole::clusters)] clusters: usize,
        #[pyo3(from_py_with = whole::units)] units: usize,
        extents_m: (f32, f32),
        first_velocity: (f32, f32),
        #[pyo3(from_py_with = whole::seed)] seed: u64,
        network: bool,
    ) -> PyResult<Self> {
        let mut options = TrackerOptions::default();
        // Fields are set one by one: the struct may grow and cannot be built here.
        options.model = model.map(|model| model.loaded.clone());
        options.segmentation = match segmentation {
            "found" => Segmentation::Found,
            "given" => Segmentation::Given,
            _ => {
                return Err(input(format!(
                    "there is no segmentation {segmentation:?}; give found or given"
                )));
            }
        };
        options.planes = planes.map(|planes| planes_of(&planes));
        options.plane_physics = plane_physics.into();
        options.unit_physics = unit_physics.into();
        options.density_kg_m3 = density_kg_m3;
        if let Some(gravity) = gravity_m_s2 {
            options.gravity_m_s2 = arrays::vector(gravity, "gravity_m_s2")?;
        }
        options.completion = match completion {
            "fitted" => Completion::Fitted,
            "mirrored" => Completion::Mirrored,
            "seen" => Completion::Seen,
            _ => {
                return Err(input(format!(
                    "there is no completion {completion:?}; give fitted, mirrored or seen"
                )));
            }
        };
        options.model_points = model_points;
        options.confirm = confirm;
        options.missed = missed;
        options.hidden_s = hidden_s;
        options.clusters = clusters;
        options.units = units;
        options.extents_m = extents_m.into();
        options.first_velocity = first_velocity.into();
        options.seed = seed;
        options.network = network;
        let tracker = held(|| tracker::Tracker::new(options))?.or_raise()?;
        Ok(Tracker { tracker: Locked::new(tracker) })
    }

    /// Takes the next capture: what all sensors saw at one instant. The interpreter is free meanwhile.
    ///
    /// Parameters
    /// ----------
    /// time_s : float
    ///     Seconds since any instant; rises from one capture to the next.
    /// views : sequence of DepthView or Cloud
    ///     By sensor, in the same order in each capture.
    ///
    /// Returns
    /// -------
    /// Estimate
    ///     What is believed of the units at that time.
    ///
    /// Raises
    /// ------
    /// InputError, TypeError
    ///     The capture cannot be one; the tracker is what it was.
    fn observe(&self, py: Python<'_>, time_s: f64, views: Vec<Seen<'_>>) -> PyResult<Estimate> {
        let capture = Capture { time_s, views: views.iter().map(Seen::view).collect() };
        with_threads()?;
        // Locked by this thread: a thread of the pool that waits may take up another call on the same tracker.
        let observe = |tracker: &mut tracker::Tracker| {
            pool::enter(|| Ok::<_, TrackError>(tracker.observe(&capture)?.units.clone()))
        };
        let units = self.tracker.freely(py, observe)?.or_raise()?;
        Ok(Estimate { time_s, units })
    }

    /// Where the model has the units in the time to come, from the last capture on, in equal steps of about 1/24 s. The interpreter
    /// is free meanwhile.
    ///
    /// Parameters
    /// ----------
    /// horizon_s : float
    ///     Seconds to the last step.
    ///
    /// Returns
    /// -------
    /// Forecast
    ///     Without poses where the tracker has no model.
    ///
    /// Raises
    /// ------
    /// InputError, StepError
    ///     The horizon is no finite number above 0; the model refuses the scene, or a step.
    fn predict(&self, py: Python<'_>, horizon_s: f64) -> PyResult<Forecast> {
        // Negated, so that NaN is refused too.
        if !(horizon_s.is_finite() && horizon_s > 0.0) {
            return Err(input(format!("horizon_s is {horizon_s}; give seconds above 0")));
        }
        let forecast = self.tracker.freely(py, |tracker| tracker.predict(horizon_s))?.or_raise()?;
        let mut paths: BTreeMap<u32, Vec<Isometry3<f32>>> = BTreeMap::new();
        for (id, pose) in forecast.poses.iter().flatten() {
            // Forecasts lie by step and track, and users follow tracks.
            paths.entry(*id).or_default().push(*pose);
        }
        let poses = paths
            .into_iter()
            .map(|(id, path)| Ok((id, arrays::array_of_poses(py, &path, &[path.len()])?.unbind())));
        let why = |(id, why): &(u32, LeftOut)| (*id, why.to_string());
        Ok(Forecast {
            step_s: forecast.step_s,
            poses: poses.collect::<PyResult<_>>()?,
            left_out: forecast.left_out.iter().map(why).collect(),
        })
    }

    /// tuple of Plane: the support planes.
    #[getter]
    fn planes<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyTuple>> {
        planes(py, self.tracker.lock(py)?.planes())
    }

    /// float32 (n, 3): points of a unit that the model gets, in the unit's frame, metres: what has been seen, and a guess at what has
    /// not. None where there is no such unit.
    fn shape<'py>(
        &self,
        py: Python<'py>,
        #[pyo3(from_py_with = whole::id)] id: u32,
    ) -> PyResult<Option<Bound<'py, PyArrayDyn<f32>>>> {
        let tracker = self.tracker.lock(py)?;
        let Some(points) = tracker.shape(id) else { return Ok(None) };
        arrays::array_of_points(py, points, &[points.len()]).map(Some)
    }

    /// float: mass of a unit that the model gets, kg: that of its ``shape``'s hull at ``density_kg_m3``. None where there is no such
    /// unit.
    fn mass_kg(
        &self,
        py: Python<'_>,
        #[pyo3(from_py_with = whole::id)] id: u32,
    ) -> PyResult<Option<f32>> {
        Ok(self.tracker.lock(py)?.physics(id).map(|physics| physics.mass_kg))
    }
}

/// What is believed of all units at an instant. Also made of its attributes, in this order.
#[pyclass(frozen, module = "rigidformer")]
pub(crate) struct Estimate {
    time_s: f64,
    units: Vec<UnitEstimate>,
}

#[pymethods]
impl Estimate {
    #[new]
    fn new(time_s: f64, units: Vec<Bound<'_, Track>>) -> Self {
        Estimate { time_s, units: units.iter().map(|track| track.get().unit.clone()).collect() }
    }

    fn __getnewargs__(&self) -> (f64, Vec<Track>) {
        (self.time_s, self.units())
    }

    /// Of the capture, seconds.
    #[getter]
    fn time_s(&self) -> f64 {
        self.time_s
    }

    /// list of Track: by ascending id.
    #[getter]
    fn units(&self) -> Vec<Track> {
        self.units.iter().map(|unit| Track { unit: unit.clone() }).collect()
    }

    fn __repr__(&self) -> String {
        format!("Estimate({} s, {} units)", self.time_s, self.units.len())
    }
}

/// What is believed of a unit. Also made of its attributes, in this order.
#[pyclass(frozen, module = "rigidformer")]
pub(crate) struct Track {
    unit: UnitEstimate,
}

#[pymethods]
impl Track {
    #[new]
    #[pyo3(signature = (id, pose, covariance, velocity, velocity_covariance, points, sight = "seen", rest = "moving"))]
    #[expect(clippy::too_many_arguments, reason = "a track has as many")]
    fn new(
        #[pyo3(from_py_with = whole::id)] id: u32,
        pose: &Bound<'_, PyAny>,
        covariance: &Bound<'_, PyAny>,
        velocity: &Bound<'_, PyAny>,
        velocity_covariance: &Bound<'_, PyAny>,
        points: &Bound<'_, PyAny>,
        sight: &str,
        rest: &str,
    ) -> PyResult<Self> {
        let matrix = |value, name| {
            let rows = Floats::of(value, name, &[Some(6), Some(6)])?;
            Ok::<_, PyErr>(Matrix6::from_column_slice(rows.slice()?))
        };
        let unit = UnitEstimate {
            id,
            pose: arrays::pose(pose, "pose")?,
            covariance: matrix(covariance, "covariance")?,
            velocity: Vector6::from_column_slice(
                Floats::of(velocity, "velocity", &[Some(6)])?.slice()?,
            ),
            velocity_covariance: matrix(velocity_covariance, "velocity_covariance")?,
            points: arrays::points(points, "points")?.into(),
            visibility: named(&SIGHTS, sight, "sight")?,
            rest: named(&RESTS, rest, "rest")?,
        };
        Ok(Track { unit })
    }

    fn __getnewargs__<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyTuple>> {
        let (covariance, moving) = (self.covariance(py)?, self.velocity_covariance(py)?);
        let (pose, velocity, points) = (self.pose(py)?, self.velocity(py)?, self.points(py)?);
        let (id, sight, rest) = (self.id(), self.sight(), self.rest());
        (id, pose, covariance, velocity, moving, points, sight, rest).into_pyobject(py)
    }

    /// Its own number: no other unit has it, or will have.
    #[getter]
    fn id(&self) -> u32 {
        self.unit.id
    }

    /// float32 (7,): carries its reference points to the world.
    #[getter]
    fn pose<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyArrayDyn<f32>>> {
        arrays::array_of_poses(py, [&self.unit.pose], &[])
    }

    /// float32 (6, 6): of the pose: translation in metres, then rotation in radians, in the world's axes about the unit's centre.
    #[getter]
    fn covariance<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyArrayDyn<f32>>> {
        // nalgebra has columns and numpy rows, which are the same in a symmetric matrix.
        arrays::read_only(arrays::array(py, self.unit.covariance.as_slice().to_vec(), &[6, 6])?)
    }

    /// float32 (6,): of its centre in m/s, then spin in rad/s, in the world's axes.
    #[getter]
    fn velocity<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyArrayDyn<f32>>> {
        let velocity: &Vector6<f32> = &self.unit.velocity;
        arrays::read_only(arrays::array(py, velocity.as_slice().to_vec(), &[6])?)
    }

    /// float32 (6, 6): of the velocity.
    #[getter]
    fn velocity_covariance<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyArrayDyn<f32>>> {
        arrays::read_only(arrays::array(
            py,
            self.unit.velocity_covariance.as_slice().to_vec(),
            &[6, 6],
        )?)
    }

    /// float32 (n, 3): points of its surface that have been seen so far, in its reference frame, metres.
    #[getter]
    fn points<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyArrayDyn<f32>>> {
        arrays::read_only(arrays::array_of_points(
            py,
            &self.unit.points,
            &[self.unit.points.len()],
        )?)
    }

    /// How it was found: "seen", "hidden" (behind something or out of view) or "missed".
    #[getter]
    fn sight(&self) -> &'static str {
        name_of(&SIGHTS, self.unit.visibility)
    }

    /// Whether it rests: "moving", "supported" (on a plane, a tabletop or another unit) or "held" (nothing is seen that it stands on).
    #[getter]
    fn rest(&self) -> &'static str {
        name_of(&RESTS, self.unit.rest)
    }

    fn __repr__(&self) -> String {
        format!("Track({}, {})", self.unit.id, self.sight())
    }
}

/// How a unit was found, by name.
const SIGHTS: [(&str, Visibility); 3] =
    [("seen", Visibility::Seen), ("hidden", Visibility::Hidden), ("missed", Visibility::Missed)];
/// Whether it rests.
const RESTS: [(&str, Rest); 3] =
    [("moving", Rest::Moving), ("supported", Rest::Supported), ("held", Rest::Held)];

fn name_of<T: Copy + PartialEq>(names: &[(&'static str, T)], value: T) -> &'static str {
    names.iter().find(|(_, own)| *own == value).map_or("", |(name, _)| name)
}

fn named<T: Copy>(names: &[(&str, T)], name: &str, what: &str) -> PyResult<T> {
    let found = names.iter().find(|(own, _)| *own == name).map(|(_, value)| *value);
    found.ok_or_else(|| {
        let all: Vec<_> = names.iter().map(|(name, _)| *name).collect();
        input(format!("there is no {what} {name:?}; give {}", all.join(", ")))
    })
}

/// Where units will be. Also made of its attributes, in this order.
///
/// Attributes
/// ----------
/// step_s : float
///     Seconds between samples; the first is a step after the last capture.
/// poses : dict of int to array of float32, (samples, 7)
///     Of each track's reference points.
/// left_out : dict of int to str
///     Tracks that nothing is predicted of, and why.
#[pyclass(frozen, module = "rigidformer")]
pub(crate) struct Forecast {
    #[pyo3(get)]
    step_s: f64,
    poses: BTreeMap<u32, Py<PyArrayDyn<f32>>>,
    #[pyo3(get)]
    left_out: BTreeMap<u32, String>,
}

#[pymethods]
impl Forecast {
    #[new]
    fn new(
        py: Python<'_>,
        step_s: f64,
        poses: BTreeMap<u32, Bound<'_, PyAny>>,
        left_out: BTreeMap<u32, String>,
    ) -> PyResult<Self> {
        let path = |(id, poses): (u32, Bound<'_, PyAny>)| {
            let poses = arrays::poses(&poses, "poses", None)?;
            let path = arrays::array_of_poses(py, &poses, &[poses.len()])?;
            Ok((id, path.unbind()))
        };
        Ok(Forecast {
            step_s,
            poses: poses.into_iter().map(path).collect::<PyResult<_>>()?,
            left_out,
        })
    }

    fn __getnewargs__<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyTuple>> {
        (self.step_s, self.poses(py), self.left_out.clone()).into_pyobject(py)
    }

    #[getter]
    fn poses(&self, py: Python<'_>) -> BTreeMap<u32, Py<PyArrayDyn<f32>>> {
        self.poses.iter().map(|(id, poses)| (*id, poses.clone_ref(py))).collect()
    }

    fn __repr__(&self) -> String {
        format!("Forecast({} tracks, every {} s)", self.poses.len(), self.step_s)
    }
}
