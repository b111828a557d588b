//! Robots from URDF and MJCF files.

use std::path::PathBuf;

use nalgebra::{Isometry3, Translation3, UnitQuaternion};
use numpy::PyArrayDyn;
use pyo3::prelude::*;
use rigidformer_robots as robots;

use crate::arrays;
use crate::errors::OrRaise;
use crate::interrupt::free;
use crate::json::to_python;
use crate::scene::Scene;
use crate::whole;

/// A robot, as its file describes it: links, and the joints between them. ``load_robot`` makes one.
///
/// Source: ``robots/src/robot.rs``.
#[pyclass(frozen, module = "rigidformer")]
pub(crate) struct Robot {
    robot: robots::Robot,
}

#[pymethods]
impl Robot {
    /// Its name.
    #[getter]
    fn name(&self) -> &str {
        &self.robot.name
    }

    /// list of str: names of its links, in the order of ``poses``.
    #[getter]
    fn links(&self) -> Vec<&str> {
        self.robot.links.iter().map(|link| link.name.as_str()).collect()
    }

    /// Mass of all links, kg.
    #[getter]
    fn mass_kg(&self) -> f64 {
        self.robot.mass_kg()
    }

    /// list of str: what was passed over, or mended.
    #[getter]
    fn notes(&self) -> Vec<String> {
        self.robot.notes.clone()
    }

    /// list of float: joint positions at rest, as the file has the links: of MJCF ``qpos0``. Joints that follow others have none, balls
    /// four (w, x, y, z), free links seven.
    #[getter]
    fn rest(&self) -> Vec<f64> {
        self.robot.rest()
    }

    /// dict: ``links`` with mass, centre of mass, inertia and pose at rest, and ``joints`` with kind, parent, child, axis, anchor, limits.
    ///
    /// Returns
    /// -------
    /// dict
    fn describe<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyAny>> {
        to_python(py, &self.robot.describe().or_raise()?)
    }

    /// Where the links are, in the frame of the first one.
    ///
    /// Parameters
    /// ----------
    /// positions : sequence of float, optional
    ///     Of the joints, as ``rest`` has them. None: at rest.
    ///
    /// Returns
    /// -------
    /// array of float32, (links, 7)
    ///
    /// Raises
    /// ------
    /// InputError
    ///     They are of another number, or no positions.
    #[pyo3(signature = (positions = None))]
    fn poses<'py>(
        &self,
        py: Python<'py>,
        positions: Option<Vec<f64>>,
    ) -> PyResult<Bound<'py, PyArrayDyn<f32>>> {
        let positions = positions.unwrap_or_else(|| self.robot.rest());
        let poses = self.robot.poses(&positions).or_raise()?;
        let poses: Vec<Isometry3<f32>> = poses.iter().map(|pose| pose.cast()).collect();
        arrays::array_of_poses(py, poses.iter(), &[poses.len()])
    }

    /// Its links as the units of a scene of two frames at rest: those with a shape, and a mass or no motion.
    ///
    /// Parameters
    /// ----------
    /// points : int
    ///     Of each unit, on its surface.
    /// positions : sequence of float, optional
    ///     Of the joints. None: at rest.
    /// at : tuple of float
    ///     Where the first link is, metres.
    /// fixed_base : bool
    ///     Whether the first link never moves.
    /// principal_frames : bool
    ///     Turn units' frames to their principal axes, so that moments are exact.
    /// frame_rate_hz : float
    ///
    /// Returns
    /// -------
    /// Scene
    ///
    /// Raises
    /// ------
    /// InputError
    ///     No link makes a unit, or a number is out of range.
    #[pyo3(signature = (*, points = 32, positions = None, at = (0.0, 0.0, 0.0), fixed_base = false, principal_frames = false, frame_rate_hz = 60.0))]
    #[expect(clippy::too_many_arguments, reason = "Python's are named")]
    fn scene(
        &self,
        py: Python<'_>,
        #[pyo3(from_py_with = whole::points)] points: usize,
        positions: Option<Vec<f64>>,
        at: (f64, f64, f64),
        fixed_base: bool,
        principal_frames: bool,
        frame_rate_hz: f32,
    ) -> PyResult<Scene> {
        let mut options = robots::SceneOptions::default();
        options.points = points;
        options.positions = positions;
        options.base =
            Isometry3::from_parts(Translation3::new(at.0, at.1, at.2), UnitQuaternion::identity());
        options.fixed_base = fixed_base;
        options.principal_frames = principal_frames;
        options.frame_rate_hz = frame_rate_hz;
        let made = free(py, || self.robot.scene(&options))?.or_raise()?;
        Ok(Scene { scene: made.scene })
    }

    // An object without entries is an object: `robot or other` is the robot.
    fn __bool__(&self) -> bool {
        true
    }

    fn __repr__(&self) -> String {
        let robot = &self.robot;
        format!(
            "Robot('{}', {} links, {} joints)",
            robot.name,
            robot.links.len(),
            robot.joints.len()
        )
    }
}

/// Reads a robot: URDF or MJCF, with its meshes.
///
/// Parameters
/// ----------
/// path : str, os.PathLike
///     The file.
/// package_paths : sequence of str or os.PathLike
///     Folders of packages, for ``package://``.
/// skip_meshes : bool
///     Leave out shapes whose mesh is not found.
/// merge_fixed : bool
///     Make one link of those that fixed joints hold together.
/// balance : bool
///     Give links whose moments no body has those of a ball of the same sum.
///
/// Returns
/// -------
/// Robot
///
/// Raises
/// ------
/// FileError
///     The file cannot be read.
/// InputError
///     It is no robot: says which element, in which line, and the remedy.
///
/// Source: ``robots/src/load.rs``.
///
/// >>> import os, tempfile, rigidformer as rf
/// >>> text = "<mujoco><worldbody><body name='ball' pos='0 0 1'><freejoint/><geom size='.1'/></body></worldbody></mujoco>"
/// >>> with tempfile.TemporaryDirectory() as folder:
/// ...     path = os.path.join(folder, "ball.xml")
/// ...     with open(path, "w") as file:
/// ...         _ = file.write(text)
/// ...     robot = rf.load_robot(path)
/// >>> robot.links, round(robot.mass_kg, 3)
/// (['world', 'ball'], 4.189)
/// >>> len(robot.scene().units)
/// 1
#[pyfunction]
#[pyo3(signature = (path, *, package_paths = Vec::new(), skip_meshes = false, merge_fixed = false, balance = false))]
pub(crate) fn load_robot(
    py: Python<'_>,
    path: PathBuf,
    package_paths: Vec<PathBuf>,
    skip_meshes: bool,
    merge_fixed: bool,
    balance: bool,
) -> PyResult<Robot> {
    let mut options = robots::LoadOptions::default();
    options.package_paths = package_paths;
    options.skip_missing_meshes = skip_meshes;
    options.merge_fixed = merge_fixed;
    options.balance_inertia = balance;
    let robot = free(py, || robots::load_robot_with(&path, &options))?.or_raise()?;
    Ok(Robot { robot })
}

/// Reads all meshes of a folder, each a free body that weighs what it encloses.
///
/// Parameters
/// ----------
/// folder : str, os.PathLike
///     With STL, OBJ or COLLADA files.
/// density_kg_m3 : float
/// scale : float
///     Metres that a length of 1 in the files stands for.
///
/// Returns
/// -------
/// Robot
///     A world with the bodies in a row.
///
/// Raises
/// ------
/// FileError
///     The folder cannot be read.
/// InputError
///     It has no meshes, or one encloses nothing.
///
/// Source: ``robots/src/sets.rs``.
#[pyfunction]
#[pyo3(signature = (folder, *, density_kg_m3 = 1000.0, scale = 1.0))]
pub(crate) fn load_meshes(
    py: Python<'_>,
    folder: PathBuf,
    density_kg_m3: f64,
    scale: f64,
) -> PyResult<Robot> {
    let mut options = robots::MeshSetOptions::default();
    options.density_kg_m3 = density_kg_m3;
    options.scale = scale;
    let robot = free(py, || robots::load_meshes(&folder, &options))?.or_raise()?;
    Ok(Robot { robot })
}
