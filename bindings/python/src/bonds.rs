//! What holds units together: bonds, and joints with their pivots.

use nalgebra::Point3;
use numpy::PyArrayDyn;
use pyo3::prelude::*;
use rigidformer_core as core;
use rigidformer_runtime::pivots;

use crate::arrays;
use crate::errors::input;
use crate::whole;

/// Two units of a world that hold together, or did.
///
/// Attributes
/// ----------
/// units : tuple of int
///     Ids, that of the unit first which was observed or added first.
/// holds : bool
///     Whether the bond holds: once it is broken it never holds again.
#[pyclass(frozen, get_all, eq, module = "rigidformer")]
#[derive(PartialEq)]
pub(crate) struct Bond {
    units: (u64, u64),
    holds: bool,
}

#[pymethods]
impl Bond {
    #[new]
    fn new(#[pyo3(from_py_with = whole::units)] units: (u64, u64), holds: bool) -> Self {
        Bond { units, holds }
    }

    fn __getnewargs__(&self) -> ((u64, u64), bool) {
        (self.units, self.holds)
    }

    fn __repr__(&self) -> String {
        let Bond { units: (one, other), holds } = self;
        // A repr reads as Python, where truths are capitalised.
        let holds = if *holds { "True" } else { "False" };
        format!("Bond(({one}, {other}), holds={holds})")
    }
}

impl From<core::Bond> for Bond {
    fn from(bond: core::Bond) -> Self {
        let core::Bond { units, holds } = bond;
        Bond { units: units.map(core::UnitId::to_bits).into(), holds }
    }
}

/// What holds a unit of a world to the unit that it hangs from: a pivot, one place that is fixed in the reference frames of both, and
/// perhaps an axis.
///
/// Attributes
/// ----------
/// unit, parent : int
///     Ids of the unit that hangs, and of the one that it hangs from.
/// pivot, parent_pivot : arrays of float32, (3,)
///     The place in the reference frames of both, metres. New arrays.
/// kind : str
///     ``"ball"``, ``"revolute"``, ``"prismatic"`` or ``"fixed"``.
/// axis : array of float32, (3,), or None
///     Of revolute and prismatic joints, in the unit's frame, of length 1.
/// limits : tuple of two floats, or None
///     Least and greatest position, radians or metres.
/// max_force : float or None
///     The most that takes it to a target, N m or N.
#[pyclass(frozen, eq, module = "rigidformer")]
#[derive(PartialEq)]
pub(crate) struct Joint {
    #[pyo3(get)]
    unit: u64,
    #[pyo3(get)]
    parent: u64,
    pivots: Pivots,
    kind: core::JointKind,
}

/// The kind of a joint, as its callers name it.
pub(crate) fn joint_kind(
    kind: &str,
    axis: Option<&Bound<'_, PyAny>>,
    limits: Option<[f32; 2]>,
    max_force: Option<f32>,
) -> PyResult<core::JointKind> {
    let has_axis = ["revolute", "prismatic"].contains(&kind);
    if !has_axis && (axis.is_some() || limits.is_some() || max_force.is_some()) {
        return Err(input(format!("a {kind} joint takes no axis, limits or max_force")));
    }
    let axis = || -> PyResult<core::JointAxis> {
        let missing = || input(format!("a {kind} joint takes an axis"));
        let axis = arrays::vector(axis.ok_or_else(missing)?, "axis")?;
        Ok(core::JointAxis { axis, limits, max_force })
    };
    match kind {
        "ball" => Ok(core::JointKind::Ball),
        "revolute" => Ok(core::JointKind::Revolute(axis()?)),
        "prismatic" => Ok(core::JointKind::Prismatic(axis()?)),
        "fixed" => Ok(core::JointKind::Fixed),
        _ => Err(input(format!("kind is {kind:?}: it must be ball, revolute, prismatic or fixed"))),
    }
}

#[pymethods]
impl Joint {
    #[new]
    #[pyo3(signature = (unit, parent, pivot, parent_pivot, kind = "ball", axis = None, limits = None, max_force = None))]
    #[expect(clippy::too_many_arguments, reason = "Python's have names")]
    fn new(
        #[pyo3(from_py_with = whole::unit)] unit: u64,
        #[pyo3(from_py_with = whole::parent)] parent: u64,
        pivot: &Bound<'_, PyAny>,
        parent_pivot: &Bound<'_, PyAny>,
        kind: &str,
        axis: Option<&Bound<'_, PyAny>>,
        limits: Option<[f32; 2]>,
        max_force: Option<f32>,
    ) -> PyResult<Self> {
        let kind = joint_kind(kind, axis, limits, max_force)?;
        Ok(Joint { unit, parent, pivots: Pivots::of(pivot, parent_pivot)?, kind })
    }

    #[expect(clippy::type_complexity, reason = "the arguments of `new`")]
    fn __getnewargs__<'py>(
        &self,
        py: Python<'py>,
    ) -> PyResult<(
        u64,
        u64,
        Place<'py>,
        Place<'py>,
        &'static str,
        Option<Place<'py>>,
        Option<(f32, f32)>,
        Option<f32>,
    )> {
        let places = (self.pivots.own(py)?, self.pivots.parents(py)?);
        let axis = self.axis(py)?;
        let (limits, max_force) = (self.limits(), self.max_force());
        Ok((self.unit, self.parent, places.0, places.1, self.kind(), axis, limits, max_force))
    }

    #[getter]
    fn kind(&self) -> &'static str {
        match self.kind {
            core::JointKind::Revolute(_) => "revolute",
            core::JointKind::Prismatic(_) => "prismatic",
            core::JointKind::Fixed => "fixed",
            _ => "ball",
        }
    }

    #[getter]
    fn axis<'py>(&self, py: Python<'py>) -> PyResult<Option<Place<'py>>> {
        let axis = self.kind.axis().map(|axis| Point3::from(axis.axis));
        axis.map(|axis| arrays::read_only(arrays::array_of_points(py, &[axis], &[])?)).transpose()
    }

    #[getter]
    fn limits(&self) -> Option<(f32, f32)> {
        self.kind.axis().and_then(|axis| axis.limits).map(|[least, greatest]| (least, greatest))
    }

    #[getter]
    fn max_force(&self) -> Option<f32> {
        self.kind.axis().and_then(|axis| axis.max_force)
    }

    #[getter]
    fn pivot<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyArrayDyn<f32>>> {
        self.pivots.own(py)
    }

    #[getter]
    fn parent_pivot<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyArrayDyn<f32>>> {
        self.pivots.parents(py)
    }

    fn __repr__(&self) -> String {
        let Joint { unit, parent, pivots, kind } = self;
        let mut rest = match kind {
            core::JointKind::Ball => String::new(),
            _ => format!(", kind='{}'", self.kind()),
        };
        if let Some(core::JointAxis { axis, limits, max_force }) = kind.axis() {
            rest += &format!(", axis=[{:?}, {:?}, {:?}]", axis.x, axis.y, axis.z);
            if let Some([least, greatest]) = limits {
                rest += &format!(", limits=({least:?}, {greatest:?})");
            }
            if let Some(force) = max_force {
                rest += &format!(", max_force={force:?}");
            }
        }
        format!("Joint({unit}, {parent}, {pivots}{rest})")
    }
}

impl From<core::Joint> for Joint {
    fn from(joint: core::Joint) -> Self {
        let core::Joint { unit, parent, pivot, parent_pivot, kind, .. } = joint;
        let pivots = Pivots { pivot, parent_pivot };
        Joint { unit: unit.to_bits(), parent: parent.to_bits(), pivots, kind }
    }
}

/// A pivot that recorded units share, as their poses show.
///
/// Attributes
/// ----------
/// unit, parent : int
///     Numbers in the scene of the unit that hangs, and of the one that it hangs from.
/// pivot, parent_pivot : arrays of float32, (3,)
///     The place in the reference frames of both, metres. New arrays.
/// residual_m : float
///     How well it fits: root mean square over frames of the distance of its two images, metres.
#[pyclass(frozen, eq, module = "rigidformer")]
#[derive(PartialEq, Clone)]
pub(crate) struct Pivot {
    #[pyo3(get)]
    unit: usize,
    #[pyo3(get)]
    parent: usize,
    pivots: Pivots,
    #[pyo3(get)]
    residual_m: f32,
}

#[pymethods]
impl Pivot {
    #[new]
    #[pyo3(signature = (unit, parent, pivot, parent_pivot, residual_m = 0.0))]
    fn new(
        #[pyo3(from_py_with = whole::unit)] unit: usize,
        #[pyo3(from_py_with = whole::parent)] parent: usize,
        pivot: &Bound<'_, PyAny>,
        parent_pivot: &Bound<'_, PyAny>,
        residual_m: f32,
    ) -> PyResult<Self> {
        Ok(Pivot { unit, parent, pivots: Pivots::of(pivot, parent_pivot)?, residual_m })
    }

    fn __getnewargs__<'py>(
        &self,
        py: Python<'py>,
    ) -> PyResult<(usize, usize, Place<'py>, Place<'py>, f32)> {
        let (own, parents) = (self.pivots.own(py)?, self.pivots.parents(py)?);
        Ok((self.unit, self.parent, own, parents, self.residual_m))
    }

    #[getter]
    fn pivot<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyArrayDyn<f32>>> {
        self.pivots.own(py)
    }

    #[getter]
    fn parent_pivot<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyArrayDyn<f32>>> {
        self.pivots.parents(py)
    }

    fn __repr__(&self) -> String {
        let Pivot { unit, parent, pivots, residual_m } = self;
        format!("Pivot({unit}, {parent}, {pivots}, residual_m={residual_m})")
    }
}

impl From<pivots::Pivot> for Pivot {
    fn from(found: pivots::Pivot) -> Self {
        let pivots::Pivot { unit, parent, pivot, parent_pivot, residual_m } = found;
        Pivot { unit, parent, pivots: Pivots { pivot, parent_pivot }, residual_m }
    }
}

impl Pivot {
    /// As the runtime has it.
    pub(crate) fn found(&self) -> pivots::Pivot {
        let Pivot { unit, parent, pivots: Pivots { pivot, parent_pivot }, residual_m } = *self;
        pivots::Pivot { unit, parent, pivot, parent_pivot, residual_m }
    }
}

/// float32 (3,)
type Place<'py> = Bound<'py, PyArrayDyn<f32>>;

/// One place in the frames of two units.
#[derive(PartialEq, Clone)]
struct Pivots {
    pivot: Point3<f32>,
    parent_pivot: Point3<f32>,
}

impl Pivots {
    fn of(pivot: &Bound<'_, PyAny>, parent_pivot: &Bound<'_, PyAny>) -> PyResult<Self> {
        let pivot = arrays::vector(pivot, "pivot")?.into();
        Ok(Pivots { pivot, parent_pivot: arrays::vector(parent_pivot, "parent_pivot")?.into() })
    }

    fn own<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyArrayDyn<f32>>> {
        arrays::read_only(arrays::array_of_points(py, &[self.pivot], &[])?)
    }

    fn parents<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyArrayDyn<f32>>> {
        arrays::read_only(arrays::array_of_points(py, &[self.parent_pivot], &[])?)
    }
}

impl std::fmt::Display for Pivots {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let [p, q] = [&self.pivot, &self.parent_pivot];
        write!(f, "[{}, {}, {}], [{}, {}, {}]", p.x, p.y, p.z, q.x, q.y, q.z)
    }
}
