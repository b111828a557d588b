//! Whole numbers from Python, whose exceptions name the argument.

use pyo3::exceptions::{PyOverflowError, PyValueError};
use pyo3::prelude::*;

use crate::errors::{input, range};

/// What Python gives, as a whole number or as some. Numbers that do not fit are of the base of all exceptions.
fn fitting<'py, T: FromPyObjectOwned<'py>>(
    value: &Bound<'py, PyAny>,
    name: &'static str,
) -> PyResult<T> {
    value.extract::<T>().map_err(|error| {
        let error: PyErr = error.into();
        if error.is_instance_of::<PyValueError>(value.py()) {
            // Of a sequence that has another length.
            return input(format!("{name}: {}", error.value(value.py())));
        }
        if !error.is_instance_of::<PyOverflowError>(value.py()) {
            return error;
        }
        let shown: String = value.repr().map_or_else(
            |_| "a number".to_owned(),
            // A number of a million digits is no message.
            |text| text.to_string_lossy().chars().take(60).collect(),
        );
        let wrong = if shown.contains('-') { "negative or too small" } else { "too large" };
        range(format!("{name} is {shown}, which is {wrong}; give a whole number in range"))
    })
}

/// A function a name, for `from_py_with`.
macro_rules! whole {
    ($($name:ident)*) => {$(
        pub(crate) fn $name<'py, T: FromPyObjectOwned<'py>>(value: &Bound<'py, PyAny>) -> PyResult<T> {
            fitting(value, stringify!($name))
        }
    )*};
}

whole! {
    a_step active_units approach body bonds cameras capture clusters commands confirm copy count degenerate_units frame frames futures height hold id
    index iterations last last_frame limit memory missed model_points pair pairs parent passed plane points quarantined_units seed size step
    steps targets threads unit units unusable which width
}
