//! Units and planes.

use nalgebra::{Isometry3, Point3, Vector3};
use numpy::PyArrayDyn;
use pyo3::prelude::*;
use pyo3::types::{PyDict, PyTuple};
use rigidformer_core::{self as core, Compliance, Physics, Role};
use rigidformer_evaluation::convex_pieces::ConvexPieces;
use rigidformer_evaluation::scenes::RecordedUnit;
use rigidformer_runtime::terrain::HeightFieldBuf;

use crate::arrays::{self, Floats};
use crate::errors::{OrRaise, input};
use crate::pickle::Arguments;
use crate::whole;

/// One set of points with physics, a role and a body: an object, a link of a robot, or a patch of a body that deforms.
///
/// Parameters
/// ----------
/// points : array of float32, (n, 3)
///     Surface points in the unit's reference frame, metres; at least 4, in any order. For ``World.observe`` they are those of
///     the previous frame, in the world. They are copied: a unit is the same for good.
/// mass_kg : float
///     From 1e-9 to 1e9.
/// friction, restitution : float
///     From 0 to 1000.
/// role : str
///     Who moves it: "free" (the model), "driven" (it goes to its target), "fixed" (nobody).
/// body : int, optional
///     Units of one body do not collide with each other; 0 to 65534. None: a body of its own.
/// inertia_kg_m2 : array, (3,), optional
///     Principal moments about axes along those of the points' frame. None: those of a box around the points.
/// stiffness_n_m : float
///     How contact with it gives way: newtons a metre of depth at each contact point, from 1e-3 to 1e12. 0: it is rigid.
///     Where it gives way, restitution counts for nothing.
/// dissipation_s_m : float
///     What such contact loses, s/m, from 0 to 1e6.
/// pieces : sequence of arrays of float32, (n, 3)
///     Convex pieces that a hollow unit touches with; at most 32 of 4 to 255 points. None given: the hull of its points.
/// rest : array of float32, (n, 3), optional
///     Makes the unit soft, with ``young_pa``: its points at rest, metres, in the order of ``points``. All patches of a body are in one
///     frame; points of two patches that are in one place at rest are one. None: it is rigid.
/// young_pa : float, optional
///     Young's modulus of a soft unit, Pa, from 1e-3 to 1e15.
///
/// Raises
/// ------
/// InputError, TypeError
///     An array has another shape or no real numbers, or ``rest`` comes without ``young_pa``. Ranges are checked where a world takes
///     the unit.
///
/// Source: ``core/src/scene.rs``.
///
/// >>> import numpy as np, rigidformer as rf
/// >>> corners = 0.2 * np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)], np.float32)
/// >>> rf.Unit(corners, mass_kg=1.0, role="driven")
/// Unit(8 points, 1 kg, driven)
/// >>> rf.Unit(corners, rest=corners, young_pa=9e3)
/// Unit(8 points, 1 kg, free, soft)
#[pyclass(frozen, module = "rigidformer")]
#[derive(Clone)]
pub(crate) struct Unit {
    points: Vec<Point3<f32>>,
    physics: Physics,
    role: Role,
    body: Option<u16>,
    inertia_kg_m2: Option<[f32; 3]>,
    compliance: Compliance,
    pieces: ConvexPieces,
    soft: Option<Soft>,
}

/// What makes a unit soft.
#[derive(Clone)]
struct Soft {
    /// (points)
    rest: Vec<Point3<f32>>,
    young_pa: f32,
}

impl Unit {
    /// Points that a world looks at: its own and those of its pieces.
    pub(crate) fn room(&self) -> usize {
        self.view().room()
    }

    /// As the core has it.
    pub(crate) fn view(&self) -> core::Unit<'_> {
        core::Unit {
            role: self.role,
            body: self.body,
            inertia_kg_m2: self.inertia_kg_m2,
            compliance: self.compliance,
            pieces: self.pieces.view(),
            soft: self
                .soft
                .as_ref()
                .map(|soft| core::Soft { rest: &soft.rest, young_pa: soft.young_pa }),
            ..core::Unit::new(&self.points, self.physics)
        }
    }

    /// As a scene has it, which moved so: `soft` is (frames, points) of a soft unit.
    pub(crate) fn recorded(
        &self,
        name: String,
        poses: Vec<Isometry3<f32>>,
        soft: Option<Vec<Vec<Point3<f32>>>>,
    ) -> RecordedUnit {
        // A recorded soft unit has its shape at rest.
        let shape = self.soft.as_ref().map_or(&self.points, |soft| &soft.rest);
        let unit = RecordedUnit::new(name, shape.clone(), self.physics, poses);
        RecordedUnit {
            role: self.role,
            body: self.body,
            inertia: self.inertia_kg_m2,
            compliance: self.compliance,
            pieces: self.pieces.clone(),
            soft,
            young_pa: self.soft.as_ref().map(|soft| soft.young_pa),
            ..unit
        }
    }

    /// A recorded unit. One that deforms is soft where it is known how stiff it is.
    pub(crate) fn of(unit: &RecordedUnit) -> Self {
        // A unit without stiffness cannot be simulated as soft, and is shown as rigid.
        let young_pa = unit.young_pa.filter(|_| unit.soft.is_some());
        Unit {
            points: unit.points.clone(),
            physics: unit.physics,
            role: unit.role,
            body: unit.body,
            inertia_kg_m2: unit.inertia,
            compliance: unit.compliance,
            pieces: unit.pieces.clone(),
            soft: young_pa.map(|young_pa| Soft { rest: unit.points.clone(), young_pa }),
        }
    }

    /// Points at rest of a soft unit; none of a rigid one.
    pub(crate) fn soft_points(&self) -> Option<usize> {
        self.soft.as_ref().map(|soft| soft.rest.len())
    }
}

#[pymethods]
impl Unit {
    #[new]
    #[pyo3(signature = (points, mass_kg = 1.0, friction = 0.5, restitution = 0.4, *, role = "free", body = None, inertia_kg_m2 = None, stiffness_n_m = 0.0, dissipation_s_m = 0.0, pieces = Vec::new(), rest = None, young_pa = None))]
    #[expect(clippy::too_many_arguments, reason = "Python's are named")]
    fn new(
        points: &Bound<'_, PyAny>,
        mass_kg: f32,
        friction: f32,
        restitution: f32,
        role: &str,
        #[pyo3(from_py_with = whole::body)] body: Option<u16>,
        inertia_kg_m2: Option<Bound<'_, PyAny>>,
        stiffness_n_m: f32,
        dissipation_s_m: f32,
        pieces: Vec<Bound<'_, PyAny>>,
        rest: Option<Bound<'_, PyAny>>,
        young_pa: Option<f32>,
    ) -> PyResult<Self> {
        // Scene files and C take numbers to 65534, and so does Python.
        if body == Some(u16::MAX) {
            return Err(input("body 65535 is none; give 0 to 65534"));
        }
        let inertia = inertia_kg_m2.map(|moments| arrays::vector(&moments, "inertia_kg_m2"));
        let pieces = pieces.iter().map(|piece| arrays::points(piece, "pieces"));
        let soft = match (rest, young_pa) {
            (Some(rest), Some(young_pa)) => {
                Some(Soft { rest: arrays::points(&rest, "rest")?, young_pa })
            }
            (None, None) => None,
            _ => {
                return Err(input(
                    "rest and young_pa make a unit soft together; give both or none",
                ));
            }
        };
        Ok(Unit {
            points: arrays::points(points, "points")?,
            // Ranges are the core's to check, so that no limit is kept twice.
            physics: Physics { mass_kg, friction, restitution },
            role: role_of(role)?,
            body,
            inertia_kg_m2: inertia.transpose()?.map(Into::into),
            compliance: Compliance { stiffness_n_m, dissipation_s_m },
            pieces: pieces.collect::<PyResult<ConvexPieces>>()?,
            soft,
        })
    }

    /// The same unit with other points.
    ///
    /// Parameters
    /// ----------
    /// points : array of float32, (n, 3)
    ///     As many as before and in their order, for ``World.observe``: where they are in the previous frame, in the world, metres.
    ///
    /// Returns
    /// -------
    /// Unit
    ///
    /// Raises
    /// ------
    /// InputError, TypeError
    ///     The array has another shape or no real numbers.
    fn with_points(&self, points: &Bound<'_, PyAny>) -> PyResult<Self> {
        let count = self.points.len();
        let points = Floats::of(points, "points", &[Some(count), Some(3)])?.points()?.to_vec();
        let (pieces, soft) = (self.pieces.clone(), self.soft.clone());
        Ok(Unit { points, pieces, soft, ..*self })
    }

    /// float32 (n, 3): its points in its reference frame, metres. Read-only.
    #[getter]
    fn points<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyArrayDyn<f32>>> {
        arrays::read_only(arrays::array_of_points(py, &self.points, &[self.points.len()])?)
    }

    /// Kilograms.
    #[getter]
    fn mass_kg(&self) -> f32 {
        self.physics.mass_kg
    }

    /// Friction coefficient.
    #[getter]
    fn friction(&self) -> f32 {
        self.physics.friction
    }

    /// Restitution coefficient.
    #[getter]
    fn restitution(&self) -> f32 {
        self.physics.restitution
    }

    /// Stiffness of its contact points, N/m; 0: it is rigid.
    #[getter]
    fn stiffness_n_m(&self) -> f32 {
        self.compliance.stiffness_n_m
    }

    /// Dissipation of its contact points, s/m.
    #[getter]
    fn dissipation_s_m(&self) -> f32 {
        self.compliance.dissipation_s_m
    }

    /// Who moves it: "free", "driven" or "fixed".
    #[getter]
    fn role(&self) -> &'static str {
        role_name(self.role)
    }

    /// The body that it belongs to, if it is not one of its own.
    #[getter]
    fn body(&self) -> Option<u16> {
        self.body
    }

    /// float32 (n, 3): points at rest of a soft unit, metres, read-only; None of a rigid one.
    #[getter]
    fn rest<'py>(&self, py: Python<'py>) -> PyResult<Option<Bound<'py, PyArrayDyn<f32>>>> {
        let array = |soft: &Soft| {
            arrays::read_only(arrays::array_of_points(py, &soft.rest, &[soft.rest.len()])?)
        };
        self.soft.as_ref().map(array).transpose()
    }

    /// Young's modulus of a soft unit, Pa; None of a rigid one.
    #[getter]
    fn young_pa(&self) -> Option<f32> {
        self.soft.as_ref().map(|soft| soft.young_pa)
    }

    fn __getnewargs_ex__<'py>(&self, py: Python<'py>) -> PyResult<Arguments<'py>> {
        let array = |points: &[Point3<f32>]| arrays::array_of_points(py, points, &[points.len()]);
        let more = PyDict::new(py);
        more.set_item("mass_kg", self.physics.mass_kg)?;
        more.set_item("friction", self.physics.friction)?;
        more.set_item("restitution", self.physics.restitution)?;
        more.set_item("role", self.role())?;
        more.set_item("body", self.body)?;
        more.set_item("inertia_kg_m2", self.inertia_kg_m2)?;
        more.set_item("stiffness_n_m", self.compliance.stiffness_n_m)?;
        more.set_item("dissipation_s_m", self.compliance.dissipation_s_m)?;
        more.set_item("pieces", self.pieces.iter().map(array).collect::<PyResult<Vec<_>>>()?)?;
        if let Some(soft) = &self.soft {
            more.set_item("rest", array(&soft.rest)?)?;
            more.set_item("young_pa", soft.young_pa)?;
        }
        Ok(((array(&self.points)?,).into_pyobject(py)?, more))
    }

    fn __repr__(&self) -> String {
        let (points, mass, role) = (self.points.len(), self.physics.mass_kg, self.role());
        let soft = if self.soft.is_some() { ", soft" } else { "" };
        format!("Unit({points} points, {mass} kg, {role}{soft})")
    }
}

/// An unmoving half-space boundary: ground, slope or wall. Units stay on the side of the normal.
///
/// Parameters
/// ----------
/// normal : array, (3,)
///     Unit vector towards the free side.
/// offset_m : float
///     Points x of the plane have normal . x = offset_m, metres.
/// friction, restitution : float
///     From 0 to 1000.
///
/// Raises
/// ------
/// InputError, TypeError
///     The normal is no array of three numbers. Ranges are checked where a world takes the plane.
///
/// Source: ``core/src/ground.rs``.
///
/// >>> import rigidformer as rf
/// >>> rf.Plane([0, 0, 1])
/// Plane([0, 0, 1], offset_m=0, friction=0.5, restitution=0.4)
#[pyclass(frozen, module = "rigidformer")]
pub(crate) struct Plane {
    pub(crate) plane: core::Plane,
}

#[pymethods]
impl Plane {
    #[new]
    #[pyo3(signature = (normal, offset_m = 0.0, friction = 0.5, restitution = 0.4))]
    fn new(
        normal: &Bound<'_, PyAny>,
        offset_m: f32,
        friction: f32,
        restitution: f32,
    ) -> PyResult<Self> {
        let normal = arrays::vector(normal, "normal")?;
        Ok(Plane { plane: core::Plane { normal, offset_m, friction, restitution } })
    }

    /// float32 (3,): unit vector towards the free side. Read-only.
    #[getter]
    fn normal<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyArrayDyn<f32>>> {
        array_of_vector(py, &self.plane.normal)
    }

    /// Distance from the origin along the normal, metres.
    #[getter]
    fn offset_m(&self) -> f32 {
        self.plane.offset_m
    }

    /// Friction coefficient.
    #[getter]
    fn friction(&self) -> f32 {
        self.plane.friction
    }

    /// Restitution coefficient.
    #[getter]
    fn restitution(&self) -> f32 {
        self.plane.restitution
    }

    fn __getnewargs__<'py>(
        &self,
        py: Python<'py>,
    ) -> PyResult<(Bound<'py, PyArrayDyn<f32>>, f32, f32, f32)> {
        let core::Plane { offset_m, friction, restitution, .. } = self.plane;
        Ok((self.normal(py)?, offset_m, friction, restitution))
    }

    fn __repr__(&self) -> String {
        let core::Plane { normal: n, offset_m, friction, restitution } = self.plane;
        format!(
            "Plane([{}, {}, {}], offset_m={offset_m}, friction={friction}, restitution={restitution})",
            n.x, n.y, n.z
        )
    }
}

/// Unmoving ground of varying height: a grid of heights. Units stay above it; beyond its borders there is nothing.
///
/// A cell between four heights is two triangles, which share the diagonal from its corner of least x and y, as MuJoCo's hfield has
/// it. Contact with it is rigid on its side, and impulses alone move units there: no network has seen such ground.
///
/// Parameters
/// ----------
/// heights_m : array of float32, (rows, columns)
///     Heights above the corner, metres; rows go along y and columns along x. At least 2 of each, at most 4,194,304 heights.
/// spacing_m : float or array, (2,)
///     Between columns along x and between rows along y, metres, from 1e-4 to 1e4.
/// corner_m : array, (3,)
///     The place of a first height of zero.
/// friction, restitution : float
///     From 0 to 1000.
///
/// Raises
/// ------
/// InputError, TypeError
///     An array has another shape or no real numbers, or a number is out of range.
///
/// Source: ``core/src/contact/height_field.rs``.
///
/// >>> import numpy as np, rigidformer as rf
/// >>> x, y = np.meshgrid(np.arange(-5, 6), np.arange(-5, 6))
/// >>> bowl = rf.HeightField(0.01 * (x**2 + y**2), 0.1, [-0.5, -0.5, 0])
/// >>> bowl
/// HeightField(11 x 11, spacing_m=[0.1, 0.1], friction=0.5, restitution=0.4)
/// >>> round(bowl.height_m(0.3, 0), 6)
/// 0.09
#[pyclass(frozen, module = "rigidformer")]
pub(crate) struct HeightField {
    pub(crate) field: HeightFieldBuf,
}

#[pymethods]
impl HeightField {
    #[new]
    #[pyo3(signature = (heights_m, spacing_m, corner_m = None, friction = 0.5, restitution = 0.4))]
    fn new(
        heights_m: &Bound<'_, PyAny>,
        spacing_m: &Bound<'_, PyAny>,
        corner_m: Option<&Bound<'_, PyAny>>,
        friction: f32,
        restitution: f32,
    ) -> PyResult<Self> {
        let heights = Floats::of(heights_m, "heights_m", &[None, None])?;
        let spacing_m = match spacing_m.extract::<f32>() {
            Ok(spacing_m) => [spacing_m; 2],
            Err(_) => arrays::pair(spacing_m, "spacing_m")?,
        };
        let corner_m = corner_m.map(|corner| arrays::vector(corner, "corner_m")).transpose()?;
        let field = HeightFieldBuf {
            heights_m: heights.slice()?.into(),
            columns: heights.side(1),
            spacing_m,
            corner_m: corner_m.unwrap_or_default(),
            friction,
            restitution,
        };
        field.view().check().or_raise()?;
        Ok(HeightField { field })
    }

    /// float32 (rows, columns): heights above the corner, metres. Read-only.
    #[getter]
    fn heights_m<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyArrayDyn<f32>>> {
        let shape = [self.field.view().rows(), self.field.columns];
        arrays::read_only(arrays::array(py, self.field.heights_m.to_vec(), &shape)?)
    }

    /// tuple of float: between columns along x and between rows along y, metres.
    #[getter]
    fn spacing_m(&self) -> (f32, f32) {
        self.field.spacing_m.into()
    }

    /// float32 (3,): the place of a first height of zero. Read-only.
    #[getter]
    fn corner_m<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyArrayDyn<f32>>> {
        array_of_vector(py, &self.field.corner_m)
    }

    /// Friction coefficient.
    #[getter]
    fn friction(&self) -> f32 {
        self.field.friction
    }

    /// Restitution coefficient.
    #[getter]
    fn restitution(&self) -> f32 {
        self.field.restitution
    }

    /// Height of the ground at a place.
    ///
    /// Parameters
    /// ----------
    /// x_m, y_m : float
    ///
    /// Returns
    /// -------
    /// float or None
    ///     Metres; None beyond the borders.
    ///
    /// Raises
    /// ------
    /// TypeError
    ///     A place is no number.
    fn height_m(&self, x_m: f32, y_m: f32) -> Option<f32> {
        self.field.view().height_m(x_m, y_m)
    }

    fn __getnewargs__<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyTuple>> {
        let (heights, corner) = (self.heights_m(py)?, self.corner_m(py)?);
        let arguments = (heights, self.spacing_m(), corner, self.friction(), self.restitution());
        arguments.into_pyobject(py)
    }

    fn __repr__(&self) -> String {
        let HeightFieldBuf { columns, spacing_m, friction, restitution, .. } = &self.field;
        let rows = self.field.view().rows();
        format!(
            "HeightField({rows} x {columns}, spacing_m={spacing_m:?}, friction={friction}, restitution={restitution})"
        )
    }
}

/// Planes of a list.
pub(crate) fn planes_of(planes: &[Bound<'_, Plane>]) -> Vec<core::Plane> {
    planes.iter().map(|plane| plane.get().plane).collect()
}

/// A tuple of planes: an object's own, which a list would seem to take more of.
pub(crate) fn planes<'py>(
    py: Python<'py>,
    planes: &[core::Plane],
) -> PyResult<Bound<'py, PyTuple>> {
    let planes: Vec<Plane> = planes.iter().map(|plane| Plane { plane: *plane }).collect();
    PyTuple::new(py, planes)
}

/// Three numbers.
pub(crate) fn array_of_vector<'py>(
    py: Python<'py>,
    vector: &Vector3<f32>,
) -> PyResult<Bound<'py, PyArrayDyn<f32>>> {
    arrays::read_only(arrays::array(py, vector.as_slice().to_vec(), &[3])?)
}

/// A role by name.
pub(crate) fn role_of(name: &str) -> PyResult<Role> {
    match name {
        "free" => Ok(Role::Free),
        "driven" => Ok(Role::Driven),
        "fixed" => Ok(Role::Fixed),
        _ => Err(input(format!("there is no role {name:?}; give free, driven or fixed"))),
    }
}

/// The name of a role.
pub(crate) fn role_name(role: Role) -> &'static str {
    match role {
        Role::Driven => "driven",
        Role::Fixed => "fixed",
        // Roles may be added to the core before Python knows them.
        _ => "free",
    }
}

/// A contact law as Python has it; None: contacts are rigid. Its number is checked where it goes.
pub(crate) fn law_of(given: Option<(f32, String)>) -> PyResult<core::ContactLaw> {
    let Some((restitution_offset, friction)) = given else { return Ok(core::ContactLaw::RIGID) };
    let friction = match friction.as_str() {
        "cone" => core::FrictionLimit::Cone,
        "pyramid" => core::FrictionLimit::Pyramid,
        _ => return Err(input(format!("there is no friction {friction:?}; give cone or pyramid"))),
    };
    Ok(core::ContactLaw { restitution_offset, friction })
}

/// A contact law as Python has it.
pub(crate) fn law_pair(law: &core::ContactLaw) -> (f32, &'static str) {
    let pyramid = law.friction == core::FrictionLimit::Pyramid;
    (law.restitution_offset, if pyramid { "pyramid" } else { "cone" })
}

/// As [`law_pair`]; None: contacts are rigid.
pub(crate) fn law(law: &core::ContactLaw) -> Option<(f32, &'static str)> {
    (!law.is_rigid()).then(|| law_pair(law))
}
