//! numpy arrays as slices, and poses as rows of seven numbers.

use nalgebra::{Isometry3, Point3, Quaternion, Translation3, UnitQuaternion, Vector3};
use numpy::ndarray::{ArrayD, IxDyn};
use numpy::{
    IntoPyArray, PyArrayDyn, PyArrayMethods, PyReadonlyArrayDyn, PyReadwriteArrayDyn,
    PyUntypedArray, PyUntypedArrayMethods,
};
use pyo3::PyTypeInfo;
use pyo3::exceptions::PyTypeError;
use pyo3::intern;
use pyo3::prelude::*;
use pyo3::types::{PyDict, PyList, PyTuple};

use crate::errors::input;

/// Numbers of a pose: x, y, z in metres, then w, x, y, z of a unit quaternion.
pub(crate) const POSE: usize = 7;

/// A side of a shape: any length, or one.
pub(crate) type Side = Option<usize>;

/// Numbers from Python as f32: a C-contiguous float32 array in place, everything else converted into a new one.
pub(crate) struct Floats<'py> {
    array: PyReadonlyArrayDyn<'py, f32>,
    name: &'static str,
}

impl<'py> Floats<'py> {
    /// `name` is what errors call it.
    pub(crate) fn of(
        value: &Bound<'py, PyAny>,
        name: &'static str,
        shape: &[Side],
    ) -> PyResult<Self> {
        refuse_masked(value, name)?;
        let array = match value.cast::<PyArrayDyn<f32>>() {
            // Frames of a sensor arrive so, and a copy of each would cost more than the checks.
            Ok(array) if array.is_c_contiguous() && is_aligned(array) => array.clone(),
            _ => converted(value, name)?,
        };
        let found = array.shape();
        let fits = found.len() == shape.len()
            && found.iter().zip(shape).all(|(found, side)| side.is_none_or(|side| side == *found));
        if !fits {
            return Err(misshapen(name, found, shape));
        }
        // numpy's arrays may be lent to a writer, which Rust's slices forbid.
        let array = array.try_readonly().map_err(|error| input(format!("{name}: {error}")))?;
        Ok(Floats { array, name })
    }

    pub(crate) fn slice(&self) -> PyResult<&[f32]> {
        self.array.as_slice().map_err(|error| input(format!("{}: {error}", self.name)))
    }

    /// Rows of three, in place.
    pub(crate) fn points(&self) -> PyResult<&[Point3<f32>]> {
        Ok(bytemuck::cast_slice(self.slice()?))
    }

    /// The length of a side.
    pub(crate) fn side(&self, axis: usize) -> usize {
        self.array.shape().get(axis).copied().unwrap_or_default()
    }
}

/// An error for arrays whose mask hides numbers: what lies behind it would be used.
pub(crate) fn refuse_masked(value: &Bound<'_, PyAny>, name: &str) -> PyResult<()> {
    let py = value.py();
    // Frames of a sensor are plain arrays, and the look costs nothing.
    if value.get_type().is(PyUntypedArray::type_object(py)) {
        return Ok(());
    }
    let class = py.import(intern!(py, "numpy.ma"))?.getattr(intern!(py, "MaskedArray"))?;
    let inside = |sequence: &Bound<'_, PyAny>| -> PyResult<bool> {
        for item in sequence.try_iter()? {
            if item?.is_instance(&class)? {
                return Ok(true);
            }
        }
        Ok(false)
    };
    // numpy.asarray drops the masks of a list's arrays.
    let listed = value.is_instance_of::<PyList>() || value.is_instance_of::<PyTuple>();
    if value.is_instance(&class)? || (listed && inside(value)?) {
        return Err(input(format!(
            "{name} is a masked array; give a plain one, such as {name}.filled(0) or the rows without a mask"
        )));
    }
    Ok(())
}

/// Whether the numbers lie where f32 may lie: views of bytes need not.
fn is_aligned(array: &Bound<'_, PyArrayDyn<f32>>) -> bool {
    array.data().addr().is_multiple_of(align_of::<f32>())
}

/// A new float32 array of real numbers.
fn converted<'py>(
    value: &Bound<'py, PyAny>,
    name: &'static str,
) -> PyResult<Bound<'py, PyArrayDyn<f32>>> {
    let py = value.py();
    let numpy = py.import(intern!(py, "numpy"))?;
    // Tensors of other libraries, which need not know numpy.
    let tensor =
        value.hasattr(intern!(py, "__dlpack__"))? && !value.hasattr(intern!(py, "__array__"))?;
    let read = if tensor { intern!(py, "from_dlpack") } else { intern!(py, "asanyarray") };
    let seen = numpy.call_method1(read, (value,));
    // numpy's own text says what is wrong, and ours which argument it is.
    let seen = seen.map_err(|error| input(format!("{name}: {}", error.value(py))))?;
    // Objects that make arrays of themselves may make masked ones.
    refuse_masked(&seen, name)?;
    let dtype = seen.getattr(intern!(py, "dtype"))?;
    let kind: String = dtype.getattr(intern!(py, "kind"))?.extract()?;
    // numpy would turn complex numbers, truths and texts into floats without a word.
    if !matches!(kind.as_str(), "f" | "i" | "u") {
        let text = format!("{name} has dtype {}; give real numbers, best as float32", dtype.str()?);
        return Err(PyTypeError::new_err(text));
    }
    // Numbers that overflow become infinite and are refused where they are used. A new array is
    // aligned and in order.
    let keywords = PyDict::new(py);
    keywords.set_item("dtype", "float32")?;
    keywords.set_item("order", "C")?;
    let errors = PyDict::new(py);
    // A warning of numpy's would come from a line that the user has not written, and so would an error: of numbers too small, too.
    errors.set_item("all", "ignore")?;
    let quiet = numpy.call_method(intern!(py, "errstate"), (), Some(&errors))?;
    quiet.call_method0(intern!(py, "__enter__"))?;
    let array = numpy.call_method(intern!(py, "array"), (seen,), Some(&keywords));
    // The state is restored before the error is looked at, or it would stay changed.
    quiet.call_method1(intern!(py, "__exit__"), (py.None(), py.None(), py.None()))?;
    Ok(array?.cast_into::<PyArrayDyn<f32>>()?)
}

/// Whole numbers as they are: depths and labels lose nothing.
pub(crate) fn whole<'py>(
    value: &Bound<'py, PyAny>,
    name: &'static str,
) -> PyResult<PyReadonlyArrayDyn<'py, u16>> {
    refuse_masked(value, name)?;
    // Depths in float metres would be cut to whole metres by a conversion.
    let Ok(array) = value.cast::<PyArrayDyn<u16>>() else {
        let dtype = value.getattr(intern!(value.py(), "dtype"));
        let found = match dtype {
            Ok(dtype) => format!("an array of {}", dtype.str()?),
            Err(_) => format!("a {}", value.get_type().name()?),
        };
        return Err(PyTypeError::new_err(format!("{name} is {found}; give an array of uint16")));
    };
    // Fields of packed records lie at any address, and their strides are no multiples of a number's
    // size.
    let array = match array.is_aligned() {
        true => array.clone(),
        false => {
            let py = value.py();
            let numpy = py.import(intern!(py, "numpy"))?;
            let keywords = PyDict::new(py);
            keywords.set_item("order", "C")?;
            let copy = numpy.call_method(intern!(py, "array"), (array,), Some(&keywords))?;
            copy.cast_into::<PyArrayDyn<u16>>()?
        }
    };
    array.try_readonly().map_err(|error| input(format!("{name}: {error}")))
}

pub(crate) fn misshapen(name: &str, found: &[usize], shape: &[Side]) -> PyErr {
    let side = |side: &Side| side.map_or("n".to_owned(), |side| side.to_string());
    let tuple = |sides: Vec<String>| match sides.as_slice() {
        // Python writes a tuple of one with a comma.
        [one] => format!("({one},)"),
        more => format!("({})", more.join(", ")),
    };
    let found = tuple(found.iter().map(usize::to_string).collect());
    let wanted = tuple(shape.iter().map(side).collect());
    input(format!("{name} has shape {found}; give {wanted}"))
}

/// A shape of known sides.
pub(crate) fn sides(shape: &[usize]) -> Vec<Side> {
    shape.iter().copied().map(Some).collect()
}

/// A pose from a row. Its quaternion is taken as it is: a simulator refuses one that is not of unit length.
pub(crate) fn pose_of(row: &[f32]) -> Isometry3<f32> {
    // Shapes are checked before, so every row has seven numbers.
    let &[x, y, z, qw, qx, qy, qz] = row else { return Isometry3::identity() };
    let rotation = UnitQuaternion::new_unchecked(Quaternion::new(qw, qx, qy, qz));
    Isometry3::from_parts(Translation3::new(x, y, z), rotation)
}

/// A row from a pose.
pub(crate) fn row_of(pose: &Isometry3<f32>) -> [f32; POSE] {
    let (t, q) = (pose.translation.vector, pose.rotation.quaternion());
    [t.x, t.y, t.z, q.w, q.i, q.j, q.k]
}

/// One pose.
pub(crate) fn pose(value: &Bound<'_, PyAny>, name: &'static str) -> PyResult<Isometry3<f32>> {
    Ok(pose_of(Floats::of(value, name, &[Some(POSE)])?.slice()?))
}

/// Rows of poses.
pub(crate) fn poses(
    value: &Bound<'_, PyAny>,
    name: &'static str,
    count: Side,
) -> PyResult<Vec<Isometry3<f32>>> {
    let numbers = Floats::of(value, name, &[count, Some(POSE)])?;
    Ok(numbers.slice()?.chunks_exact(POSE).map(pose_of).collect())
}

/// Two numbers.
pub(crate) fn pair(value: &Bound<'_, PyAny>, name: &'static str) -> PyResult<[f32; 2]> {
    let numbers = Floats::of(value, name, &[Some(2)])?;
    <[f32; 2]>::try_from(numbers.slice()?).map_err(|error| input(format!("{name}: {error}")))
}

/// Three numbers.
pub(crate) fn vector(value: &Bound<'_, PyAny>, name: &'static str) -> PyResult<Vector3<f32>> {
    Ok(Vector3::from_row_slice(Floats::of(value, name, &[Some(3)])?.slice()?))
}

/// Points that are kept.
pub(crate) fn points(value: &Bound<'_, PyAny>, name: &'static str) -> PyResult<Vec<Point3<f32>>> {
    Ok(Floats::of(value, name, &[None, Some(3)])?.points()?.to_vec())
}

/// An array that takes the numbers over without a copy.
pub(crate) fn array<'py, T: numpy::Element>(
    py: Python<'py>,
    numbers: Vec<T>,
    shape: &[usize],
) -> PyResult<Bound<'py, PyArrayDyn<T>>> {
    let array = ArrayD::from_shape_vec(IxDyn(shape), numbers);
    Ok(array.map_err(|error| input(error.to_string()))?.into_pyarray(py))
}

/// An array of an object's own numbers: what is written into a copy of them would be lost without a word.
pub(crate) fn read_only<T: numpy::Element>(
    array: Bound<'_, PyArrayDyn<T>>,
) -> PyResult<Bound<'_, PyArrayDyn<T>>> {
    array.call_method1(intern!(array.py(), "setflags"), (false,))?;
    Ok(array)
}

/// Rows as an array of this shape, in the caller's own one if there is one.
pub(crate) fn rows<'py, const N: usize>(
    py: Python<'py>,
    rows: impl Iterator<Item = [f32; N]>,
    shape: &[usize],
    out: Option<Bound<'py, PyAny>>,
) -> PyResult<Bound<'py, PyAny>> {
    let Some(out) = out else {
        return Ok(array(py, rows.flatten().collect(), shape)?.into_any());
    };
    let mut lent = self::out(&out, shape)?;
    let numbers = lent.as_slice_mut().map_err(|error| input(format!("out: {error}")))?;
    for (to, from) in numbers.as_chunks_mut::<N>().0.iter_mut().zip(rows) {
        *to = from;
    }
    // numpy refuses to hand the array out while it is lent for writing.
    drop(lent);
    Ok(out)
}

/// An array of poses, whose shape ends with 7.
pub(crate) fn array_of_poses<'py, 'p>(
    py: Python<'py>,
    poses: impl IntoIterator<Item = &'p Isometry3<f32>>,
    shape: &[usize],
) -> PyResult<Bound<'py, PyArrayDyn<f32>>> {
    let numbers: Vec<f32> = poses.into_iter().flat_map(row_of).collect();
    array(py, numbers, &[shape, &[POSE]].concat())
}

/// An array of points, whose shape ends with 3.
pub(crate) fn array_of_points<'py>(
    py: Python<'py>,
    points: &[Point3<f32>],
    shape: &[usize],
) -> PyResult<Bound<'py, PyArrayDyn<f32>>> {
    array(py, bytemuck::cast_slice(points).to_vec(), &[shape, &[3]].concat())
}

/// The caller's own array, to write into.
pub(crate) fn out<'py>(
    array: &Bound<'py, PyAny>,
    shape: &[usize],
) -> PyResult<PyReadwriteArrayDyn<'py, f32>> {
    refuse_masked(array, "out")?;
    // A converted copy would be written instead of the caller's array.
    let Ok(array) = array.cast::<PyArrayDyn<f32>>() else {
        return Err(PyTypeError::new_err("out must be an array of float32"));
    };
    if array.shape() != shape {
        return Err(misshapen("out", array.shape(), &sides(shape)));
    }
    // Rows of a slice with steps cannot be written as one.
    if !array.is_c_contiguous() {
        return Err(input("out must be C-contiguous"));
    }
    array.try_readwrite().map_err(|error| input(format!("out: {error}")))
}
