//! Recorded scenes.

use std::path::PathBuf;

use nalgebra::Point3;
use numpy::PyArrayDyn;
use pyo3::intern;
use pyo3::prelude::*;
use pyo3::types::{PyBytes, PyTuple};
use rigidformer_evaluation::contact::Contact;
use rigidformer_evaluation::pivots;
use rigidformer_evaluation::predicted;
use rigidformer_evaluation::render::{self, DepthNoise, Renderer};
use rigidformer_evaluation::scenes::{
    self, RecordedBond, RecordedScene, SceneNotes, Split, scene_file, write_scene,
};

use crate::arrays::{self, Floats, POSE};
use crate::bonds::Pivot;
use crate::errors::{OrRaise, input};
use crate::interrupt::{free, held};
use crate::perception::DepthView;
use crate::unit::{HeightField, Plane, Unit, array_of_vector, law, law_of, planes, planes_of};
use crate::whole;

/// The program's, byte for byte: a source distribution holds no file of another folder that is no crate of its own.
static EMBEDDED: &[u8] = include_bytes!("../scenes/default.safetensors");

/// Columns and rows of the images of [`Scene::views`], as `rigidformer track --render` has them.
const SIZE: [u32; 2] = [640, 480];
/// Metres a step of them.
const SCALE_M: f32 = 0.001;
/// Cameras around a scene, at most.
const MOST_CAMERAS: usize = 3;

/// The recorded scenes of one file.
///
/// Parameters
/// ----------
/// path : str, os.PathLike
///     A scene file (``*.safetensors``; ``evaluation/SCENES.md`` describes it).
///
/// Raises
/// ------
/// FileError
///     The file cannot be read.
/// InputError
///     It is no scene file, or a damaged one.
///
/// Source: ``evaluation/src/scenes/dataset.rs``.
///
/// >>> import rigidformer as rf
/// >>> dataset = rf.Dataset.embedded()
/// >>> len(dataset)
/// 1
/// >>> dataset.scene(0).frames
/// 121
#[pyclass(frozen, module = "rigidformer")]
pub(crate) struct Dataset {
    pub(crate) dataset: scenes::Dataset,
}

#[pymethods]
impl Dataset {
    #[new]
    fn open(py: Python<'_>, path: PathBuf) -> PyResult<Self> {
        // Reading checks all tensors, which takes long enough to let other threads run.
        let dataset = free(py, || scenes::Dataset::open(&path))?;
        Ok(Dataset { dataset: dataset.or_raise()? })
    }

    /// The file with one scene that comes with the package.
    #[staticmethod]
    fn embedded() -> PyResult<Self> {
        let dataset = scenes::Dataset::from_bytes("<default scene>", EMBEDDED);
        Ok(Dataset { dataset: dataset.or_raise()? })
    }

    /// A scene file that is in memory already.
    ///
    /// Parameters
    /// ----------
    /// data : bytes
    ///     The whole file.
    /// name : str
    ///     What errors call it.
    ///
    /// Raises
    /// ------
    /// InputError
    ///     It is no sound scene file.
    ///
    /// >>> import rigidformer as rf
    /// >>> rf.Dataset.from_bytes(b"no scenes")
    /// Traceback (most recent call last):
    ///     ...
    /// rigidformer.InputError: <bytes>: ...
    #[staticmethod]
    #[pyo3(signature = (data, name = "<bytes>"))]
    fn from_bytes(py: Python<'_>, data: &[u8], name: &str) -> PyResult<Self> {
        let dataset = free(py, || scenes::Dataset::from_bytes(name, data.to_vec()))?;
        Ok(Dataset { dataset: dataset.or_raise()? })
    }

    fn __reduce__<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyTuple>> {
        let class = py.get_type::<Dataset>();
        if self.dataset.bytes() == EMBEDDED {
            let embedded = class.getattr(intern!(py, "embedded"))?;
            return (embedded, ()).into_pyobject(py);
        }
        // A file may be another one by then, or on another machine.
        let name = self.dataset.path().to_string_lossy().into_owned();
        let bytes = PyBytes::new(py, self.dataset.bytes());
        (class.getattr(intern!(py, "from_bytes"))?, (bytes, name)).into_pyobject(py)
    }

    /// A scene.
    ///
    /// Parameters
    /// ----------
    /// index : int
    ///     From 0.
    /// frames : int, optional
    ///     How many of its frames, from the first on; None: all.
    ///
    /// Returns
    /// -------
    /// Scene
    ///
    /// Raises
    /// ------
    /// InputError
    ///     There is no such scene, it has fewer frames, or a pose of it is none.
    #[pyo3(signature = (index, frames = None))]
    fn scene(
        &self,
        py: Python<'_>,
        #[pyo3(from_py_with = whole::index)] index: usize,
        #[pyo3(from_py_with = whole::frames)] frames: Option<usize>,
    ) -> PyResult<Scene> {
        let scene = free(py, || self.dataset.scene(index, frames))?;
        Ok(Scene { scene: scene.or_raise()? })
    }

    /// list of int: the indices of the scenes in a split: "train", "validation", "test" or "extra".
    ///
    /// Raises
    /// ------
    /// InputError
    ///     There is no such split.
    fn scenes_of(&self, split: &str) -> PyResult<Vec<usize>> {
        Ok(self.dataset.scenes_of(split.parse::<Split>().or_raise()?))
    }

    /// Its name.
    #[getter]
    fn name(&self) -> &str {
        self.dataset.name()
    }

    /// Where it was read from.
    #[getter]
    fn path(&self) -> PathBuf {
        self.dataset.path().into()
    }

    /// Frames a second.
    #[getter]
    fn frame_rate_hz(&self) -> f32 {
        self.dataset.frame_rate_hz()
    }

    /// Numbers in a command; 0: its scenes have none.
    #[getter]
    fn command_size(&self) -> usize {
        self.dataset.command_size()
    }

    // An object without entries is an object: `world or other` is the world.
    fn __bool__(&self) -> bool {
        true
    }

    fn __len__(&self) -> usize {
        self.dataset.len()
    }

    fn __repr__(&self) -> String {
        format!("Dataset('{}', {} scenes)", self.dataset.name(), self.dataset.len())
    }
}

/// One scene with its recorded motion.
///
/// Parameters
/// ----------
/// units : sequence of Unit
///     With their points in their own reference frames. Soft ones count by their points at rest.
/// poses : array of float32, (frames, units, 7)
///     Where they were, at least one frame. Fixed units have one pose. Of soft units: the poses that fit best, or any.
/// frame_rate_hz : float
///     Above 0.
/// gravity_m_s2 : array, (3,)
/// contact_law : tuple of float and str, optional
///     As ``World.contact_law``: of what recorded the scene. None: contacts are rigid.
/// height_field : HeightField, optional
///     Ground of varying height that it is on, besides its planes.
/// planes : sequence of Plane, optional
///     None: not known, and rollouts stand on the model's ground.
/// commands : array of float32, (frames, size), optional
///     Of robots, from each frame to the next.
/// soft_points : array of float32, (frames, soft points, 3), optional
///     Where the points of all soft units were, one unit after another, metres. Scenes with soft units need it.
/// bonds : sequence of tuple (int, int, int or None), optional
///     Numbers of two units of one body that hold together, and the first frame in which they do not any more; None: they hold.
/// name, seed, split
///     What tables and errors call it; "train", "validation", "test" or "extra".
///
/// Raises
/// ------
/// InputError, TypeError
///     Shapes do not go together, or a number is not finite or out of range.
///
/// Source: ``evaluation/src/scenes/recorded.rs``.
///
/// >>> import numpy as np, rigidformer as rf
/// >>> points = np.array([[0, 0, 0], [.1, 0, 0], [0, .1, 0], [0, 0, .1]], np.float32)
/// >>> falling = [[[0, 0, 3 - 5 * (frame / 240) ** 2, 1, 0, 0, 0]] for frame in range(101)]
/// >>> scene = rf.Scene([rf.Unit(points)], falling, 240, gravity_m_s2=[0, 0, -10])
/// >>> scene.frames
/// 101
#[pyclass(frozen, module = "rigidformer")]
pub(crate) struct Scene {
    pub(crate) scene: RecordedScene,
}

#[pymethods]
impl Scene {
    #[new]
    #[pyo3(signature = (units, poses, frame_rate_hz, *, gravity_m_s2 = None, contact_law = None, height_field = None, planes = None, commands = None, soft_points = None, bonds = Vec::new(), name = "scene", seed = 0, split = "extra"))]
    #[expect(clippy::too_many_arguments, reason = "Python's are named")]
    fn new(
        units: Vec<Bound<'_, Unit>>,
        poses: &Bound<'_, PyAny>,
        frame_rate_hz: f32,
        gravity_m_s2: Option<&Bound<'_, PyAny>>,
        contact_law: Option<(f32, String)>,
        height_field: Option<Bound<'_, HeightField>>,
        planes: Option<Vec<Bound<'_, Plane>>>,
        commands: Option<&Bound<'_, PyAny>>,
        soft_points: Option<&Bound<'_, PyAny>>,
        #[pyo3(from_py_with = whole::bonds)] bonds: Vec<(usize, usize, Option<usize>)>,
        name: &str,
        #[pyo3(from_py_with = whole::seed)] seed: i64,
        split: &str,
    ) -> PyResult<Self> {
        let poses = Floats::of(poses, "poses", &[None, Some(units.len()), Some(POSE)])?;
        let rows = poses.slice()?;
        let mut soft = SoftFrames::of(soft_points, &units, poses.side(0))?;
        let recorded = units.iter().enumerate().map(|(number, unit)| {
            // Arrays lie by frame and unit, and scenes by unit and frame.
            let own = rows.chunks_exact(POSE).skip(number).step_by(units.len());
            let soft = soft.next(unit.get().soft_points());
            unit.get().recorded(format!("unit {number}"), own.map(arrays::pose_of).collect(), soft)
        });
        let gravity = match gravity_m_s2 {
            Some(gravity) => arrays::vector(gravity, "gravity_m_s2")?,
            None => nalgebra::Vector3::new(0.0, 0.0, -9.81),
        };
        let split = split.parse::<Split>().or_raise()?;
        let recorded = recorded.collect();
        let scene = RecordedScene::new(name, seed, split, frame_rate_hz, gravity, recorded);
        let mut scene = scene.or_raise()?.with_contact_law(law_of(contact_law)?).or_raise()?;
        let height_field = height_field.map(|field| field.get().field.clone());
        scene = scene.with_height_field(height_field).or_raise()?;
        if let Some(planes) = planes {
            scene = scene.with_planes(planes_of(&planes)).or_raise()?;
        }
        if let Some(commands) = commands {
            let commands = Floats::of(commands, "commands", &[Some(scene.frames()), None])?;
            let numbers = commands.slice()?.to_vec();
            scene = scene.with_commands(commands.side(1), numbers).or_raise()?;
        }
        let bonds = bonds.into_iter();
        let bonds = bonds.map(|(a, b, breaks_at)| RecordedBond { units: [a, b], breaks_at });
        Ok(Scene { scene: scene.with_bonds(bonds.collect()).or_raise()? })
    }

    // As a scene file, which has all of it but these.
    #[staticmethod]
    fn _of_file(data: &[u8], name: &str, knows_planes: bool) -> PyResult<Self> {
        let read = scenes::Dataset::from_bytes(name, data.to_vec()).or_raise()?;
        let read = read.scene(0, None).or_raise()?;
        let units = read.units().to_vec();
        let (seed, split, rate) = (read.seed(), read.split(), read.frame_rate_hz());
        let mut scene =
            RecordedScene::new(name, seed, split, rate, read.gravity_m_s2(), units).or_raise()?;
        scene = scene.with_contact_law(read.contact_law()).or_raise()?;
        scene = scene.with_height_field(read.height_field().cloned()).or_raise()?;
        if let Some(planes) = read.planes().filter(|_| knows_planes) {
            scene = scene.with_planes(planes.to_vec()).or_raise()?;
            let compliance = read.plane_compliance().to_vec();
            scene = scene.with_plane_compliance(compliance).or_raise()?;
        }
        let size = read.command_size();
        if size > 0 {
            let rows = (0..read.frames()).filter_map(|frame| read.command(frame));
            scene = scene.with_commands(size, rows.flatten().copied().collect()).or_raise()?;
            scene = scene.with_set_points(read.set_points().to_vec()).or_raise()?;
        }
        let scene = scene.with_mesh(read.mesh().clone()).or_raise()?;
        Ok(Scene { scene: scene.with_bonds(read.bonds().to_vec()).or_raise()? })
    }

    fn __reduce__<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyTuple>> {
        let knows_planes = self.scene.planes().is_some();
        let text = String::new;
        let notes = SceneNotes { dataset: text(), provenance: text(), licence: text() };
        let file = free(py, || {
            // A file cannot say that planes are not known.
            let scene = match knows_planes {
                true => self.scene.clone(),
                false => self.scene.clone().with_planes(Vec::new())?,
            };
            scene_file("<pickle>".as_ref(), &scene, &notes)
        })?;
        let bytes = PyBytes::new(py, &file.or_raise()?);
        let of_file = py.get_type::<Scene>().getattr(intern!(py, "_of_file"))?;
        (of_file, (bytes, self.scene.name(), knows_planes)).into_pyobject(py)
    }

    /// What tables and errors call it.
    #[getter]
    fn name(&self) -> &str {
        self.scene.name()
    }

    /// Of whatever made it.
    #[getter]
    fn seed(&self) -> i64 {
        self.scene.seed()
    }

    /// "train", "validation", "test" or "extra".
    #[getter]
    fn split(&self) -> String {
        self.scene.split().to_string()
    }

    /// Frames a second.
    #[getter]
    fn frame_rate_hz(&self) -> f32 {
        self.scene.frame_rate_hz()
    }

    /// float32 (3,): gravity, m/s^2.
    #[getter]
    fn gravity_m_s2<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyArrayDyn<f32>>> {
        array_of_vector(py, &self.scene.gravity_m_s2())
    }

    /// tuple of float and str, or None: how contacts that bounce differ from rigid ones in what recorded it, as ``World.contact_law``.
    #[getter]
    fn contact_law(&self) -> Option<(f32, &'static str)> {
        law(&self.scene.contact_law())
    }

    /// HeightField or None: ground of varying height that it is on, besides its planes.
    #[getter]
    fn height_field(&self) -> Option<HeightField> {
        self.scene.height_field().cloned().map(|field| HeightField { field })
    }

    /// tuple of Unit: with points in their reference frames. Soft units are their points at rest; where a scene does not say how stiff
    /// they are, these are rigid.
    #[getter]
    fn units<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyTuple>> {
        PyTuple::new(py, self.scene.units().iter().map(Unit::of).collect::<Vec<_>>())
    }

    /// list of str: names of the units' shapes.
    #[getter]
    fn shapes(&self) -> Vec<&str> {
        self.scene.units().iter().map(|unit| unit.shape.as_str()).collect()
    }

    /// tuple of Plane, or None where they are not known.
    #[getter]
    fn planes<'py>(&self, py: Python<'py>) -> PyResult<Option<Bound<'py, PyTuple>>> {
        self.scene.planes().map(|own| planes(py, own)).transpose()
    }

    /// Frames that were recorded.
    #[getter]
    fn frames(&self) -> usize {
        self.scene.frames()
    }

    /// float32 (frames, units, 7): where the units were. Read-only.
    #[getter]
    fn poses<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyArrayDyn<f32>>> {
        let (frames, units) = (self.scene.frames(), self.scene.units());
        let rows =
            (0..frames).flat_map(|frame| units.iter().filter_map(move |u| u.poses.get(frame)));
        arrays::read_only(arrays::array_of_poses(py, rows, &[frames, units.len()])?)
    }

    /// float32 (frames, soft points, 3), or None where it has no soft units: where their points were, one unit after another. A new
    /// array.
    #[getter]
    fn soft_points<'py>(&self, py: Python<'py>) -> PyResult<Option<Bound<'py, PyArrayDyn<f32>>>> {
        let frames = self.scene.frames();
        let recorded = (0..frames).filter_map(|frame| predicted::recorded(&self.scene, frame));
        let points = recorded.collect::<Vec<_>>().concat();
        // None tells a scene without soft units from one whose points are missing.
        if points.is_empty() {
            return Ok(None);
        }
        arrays::array_of_points(py, &points, &[frames, points.len() / frames])
            .and_then(arrays::read_only)
            .map(Some)
    }

    /// list of tuple (int, int, int or None): numbers of two units that hold together, and the first frame in which they do not any
    /// more; None: they hold.
    #[getter]
    fn bonds(&self) -> Vec<(usize, usize, Option<usize>)> {
        let bonds = self.scene.bonds().iter();
        bonds.map(|bond| (bond.units[0], bond.units[1], bond.breaks_at)).collect()
    }

    /// Where the points of all units were at a frame: what ``World.observe`` takes.
    ///
    /// Parameters
    /// ----------
    /// frame : int
    ///
    /// Returns
    /// -------
    /// list of arrays of float32, (n, 3)
    ///     One a unit, metres, in the world, in the order of the unit's points.
    ///
    /// Raises
    /// ------
    /// InputError
    ///     The frame was not recorded.
    ///
    /// Source: ``evaluation/src/scenes/recorded.rs``.
    ///
    /// >>> import rigidformer as rf
    /// >>> scene = rf.Dataset.embedded().scene(0)
    /// >>> units = [unit.with_points(points) for unit, points in zip(scene.units, scene.points(0))]
    /// >>> world = rf.World(rf.Model("edge"))
    /// >>> world.observe(10 / scene.frame_rate_hz, units, scene.points(10)).degenerate_units
    /// 0
    fn points<'py>(
        &self,
        py: Python<'py>,
        #[pyo3(from_py_with = whole::frame)] frame: usize,
    ) -> PyResult<Vec<Bound<'py, PyArrayDyn<f32>>>> {
        let (name, frames) = (self.scene.name(), self.scene.frames());
        let missing = || input(format!("{name}: has {frames} frames; frame {frame} is needed"));
        let units = self.scene.units().iter().map(|unit| {
            let points = held(|| unit.points_at(frame))?.ok_or_else(missing)?;
            arrays::array_of_points(py, &points, &[points.len()])
        });
        units.collect()
    }

    /// Where links of bodies hang together, as their poses in frames 0 to ``last`` show: what ``rollout(join=True)`` holds.
    ///
    /// Parameters
    /// ----------
    /// last : int
    ///     At least 1.
    ///
    /// Returns
    /// -------
    /// list of Pivot
    ///     Parents come first. Empty where no body has several links, or those slid.
    ///
    /// Raises
    /// ------
    /// InputError
    ///     A pivot takes two frames, and the range has one.
    ///
    /// Source: ``evaluation/src/pivots.rs``.
    fn pivots(
        &self,
        py: Python<'_>,
        #[pyo3(from_py_with = whole::last)] last: usize,
    ) -> PyResult<Vec<Pivot>> {
        let joined = free(py, || pivots::joined(self.scene.clone(), last))?.or_raise()?;
        Ok(joined.pivots().iter().copied().map(Pivot::from).collect())
    }

    /// The same scene with contact's numbers from a file: what ``rigidformer evaluate --contact`` measures.
    ///
    /// Parameters
    /// ----------
    /// path : str, os.PathLike
    ///     A file that ``rigidformer calibrate`` wrote.
    ///
    /// Returns
    /// -------
    /// Scene
    ///     Friction, stiffness, gravity, planes and inertia as the file says; recorded poses stay.
    ///
    /// Raises
    /// ------
    /// FileError
    ///     The file cannot be read.
    /// InputError
    ///     It is none of such numbers, or one of them is of a plane and the scene has none.
    ///
    /// Source: ``evaluation/src/contact.rs``.
    ///
    /// >>> import pathlib, tempfile, rigidformer as rf
    /// >>> path = pathlib.Path(tempfile.mkdtemp()) / "contact.toml"
    /// >>> _ = path.write_text('format = "rigidformer-contact"\nversion = 1\ngravity_factor = 0.5\n')
    /// >>> scene = rf.Dataset.embedded().scene(0)
    /// >>> bool(scene.with_contact(path).gravity_m_s2[2] == scene.gravity_m_s2[2] / 2)
    /// True
    fn with_contact(&self, py: Python<'_>, path: PathBuf) -> PyResult<Scene> {
        let applied = free(py, || Contact::open(&path)?.applied(&self.scene))?;
        Ok(Scene { scene: applied.or_raise()? })
    }

    /// What depth cameras around the scene see, as ``rigidformer track --render`` has it: images of 640 x 480 pixels in steps of a
    /// millimetre, with the numbers of the units, from 1 on, as labels. The same arguments give the same images.
    ///
    /// Parameters
    /// ----------
    /// time_s : float
    ///     Seconds after the first frame.
    /// cameras : int
    ///     1 to 3, 120 degrees apart.
    /// deviation_m : float
    ///     Standard deviation of depths, as far away as the units are at first; it grows with the square of the depth.
    /// edge_loss : float
    ///     Share of the pixels at edges that are lost, 0 to 1.
    /// capture : int
    ///     Which capture of a recording it is: each has errors of its own.
    /// seed : int
    ///     Of all errors.
    ///
    /// Returns
    /// -------
    /// list of DepthView
    ///     By camera.
    ///
    /// Raises
    /// ------
    /// InputError
    ///     Nothing was recorded at that time, an argument is out of range, or a unit has no surface.
    ///
    /// Source: ``evaluation/src/render.rs``.
    ///
    /// >>> import rigidformer as rf
    /// >>> scene = rf.Dataset.embedded().scene(0)
    /// >>> tracker = rf.Tracker(segmentation="given", gravity_m_s2=scene.gravity_m_s2)
    /// >>> for capture in range(3):
    /// ...     views = scene.views(capture / 30, cameras=2, capture=capture)
    /// ...     estimate = tracker.observe(capture / 30, views)
    /// >>> len(views), len(estimate.units) > 0
    /// (2, True)
    #[pyo3(signature = (time_s, *, cameras = 1, deviation_m = 0.001, edge_loss = 0.3, capture = 0, seed = 1))]
    #[expect(clippy::too_many_arguments, reason = "Python's are named")]
    fn views(
        &self,
        py: Python<'_>,
        time_s: f64,
        #[pyo3(from_py_with = whole::cameras)] cameras: usize,
        deviation_m: f32,
        edge_loss: f32,
        #[pyo3(from_py_with = whole::capture)] capture: u64,
        #[pyo3(from_py_with = whole::seed)] seed: u64,
    ) -> PyResult<Vec<DepthView>> {
        if !(1..=MOST_CAMERAS).contains(&cameras) {
            return Err(input(format!("cameras is {cameras}; give 1 to {MOST_CAMERAS}")));
        }
        if !(0.0..=1.0).contains(&deviation_m) {
            return Err(input(format!("deviation_m is {deviation_m}; give metres from 0 to 1")));
        }
        let placed = held(|| render::cameras(&self.scene, SIZE, cameras))?.or_raise()?;
        let away_m = render::distance_m(&self.scene, &placed).max(1e-3);
        let deviation_at_1m_m = deviation_m / (away_m * away_m);
        let noise = DepthNoise { deviation_at_1m_m, edge_loss, seed };
        let views = free(py, || {
            let renderer = Renderer::new(&self.scene)?;
            let seen = placed.iter().enumerate().map(|(index, camera)| {
                // Each image has a stream of its own.
                let stream = capture.wrapping_mul(cameras as u64).wrapping_add(index as u64);
                renderer.view(camera, time_s, SCALE_M, &noise, stream)
            });
            seen.collect::<Result<Vec<_>, _>>()
        })?;
        Ok(views.or_raise()?.into_iter().map(DepthView::from).collect())
    }

    /// float32 (frames, size), or None where it has no commands. Read-only.
    #[getter]
    fn commands<'py>(&self, py: Python<'py>) -> PyResult<Option<Bound<'py, PyArrayDyn<f32>>>> {
        let size = self.scene.command_size();
        if size == 0 {
            return Ok(None);
        }
        let rows = (0..self.scene.frames()).filter_map(|frame| self.scene.command(frame));
        let numbers = rows.flatten().copied().collect();
        arrays::array(py, numbers, &[self.scene.frames(), size])
            .and_then(arrays::read_only)
            .map(Some)
    }

    /// Writes a scene file with this one scene.
    ///
    /// Parameters
    /// ----------
    /// path : str, os.PathLike
    /// dataset, provenance, licence : str
    ///     What the file says besides its numbers.
    ///
    /// Raises
    /// ------
    /// FileError
    ///     It cannot be written.
    /// InputError
    ///     The scene's planes are not known.
    ///
    /// Source: ``evaluation/src/scenes/write.rs``.
    #[pyo3(signature = (path, *, dataset, provenance, licence))]
    fn save(
        &self,
        py: Python<'_>,
        path: PathBuf,
        dataset: String,
        provenance: String,
        licence: String,
    ) -> PyResult<()> {
        let notes = SceneNotes { dataset, provenance, licence };
        free(py, || write_scene(&path, &self.scene, &notes))?.or_raise()
    }

    fn __repr__(&self) -> String {
        let (units, frames) = (self.scene.units().len(), self.scene.frames());
        format!("Scene('{}', {units} units, {frames} frames)", self.scene.name())
    }
}

/// Points of a scene's soft units, which are given for all of them together.
struct SoftFrames {
    /// (frames, soft points)
    frames: Vec<Vec<Point3<f32>>>,
    /// Of the next unit.
    start: usize,
}

impl SoftFrames {
    fn of(
        points: Option<&Bound<'_, PyAny>>,
        units: &[Bound<'_, Unit>],
        frames: usize,
    ) -> PyResult<Self> {
        let counts = units.iter().map(|unit| unit.get().soft_points());
        let Some(points) = points else {
            return match counts.enumerate().find(|(_, count)| count.is_some()) {
                // Poses say nothing of soft points.
                Some((unit, _)) => Err(input(format!("unit {unit} is soft; give soft_points"))),
                None => Ok(SoftFrames { frames: Vec::new(), start: 0 }),
            };
        };
        let count: usize = counts.flatten().sum();
        let points = Floats::of(points, "soft_points", &[Some(frames), Some(count), Some(3)])?;
        // Scenes without soft units may give an empty array, and chunks of 0 would panic.
        let rows = points.points()?.chunks_exact(count.max(1)).map(<[Point3<f32>]>::to_vec);
        Ok(SoftFrames { frames: rows.collect(), start: 0 })
    }

    /// (frames, points) of the next unit with so many soft points; none of a rigid one.
    fn next(&mut self, count: Option<usize>) -> Option<Vec<Vec<Point3<f32>>>> {
        let own = self.start..self.start + count?;
        self.start = own.end;
        let of = |frame: &Vec<Point3<f32>>| frame.get(own.clone()).unwrap_or_default().to_vec();
        Some(self.frames.iter().map(of).collect())
    }
}

/// A frame that a rollout ends at: given, or the last recorded multiple of the step.
pub(crate) fn last_frame(scene: &RecordedScene, step: u32, given: Option<u32>) -> PyResult<u32> {
    if step == 0 {
        return Err(input("step is 0; give the frames of a step, at least 1"));
    }
    let recorded = u32::try_from(scene.frames().saturating_sub(1)).unwrap_or(u32::MAX);
    // Without an end the rollout ends with the record, which errors are measured by.
    Ok(given.unwrap_or(recorded - recorded % step))
}
