//! What pickle and copy make an object of again.

use pyo3::prelude::*;
use pyo3::types::{PyDict, PyTuple};

/// Arguments of the class, by place and by name.
pub(crate) type Arguments<'py> = (Bound<'py, PyTuple>, Bound<'py, PyDict>);
