//! Rust's errors as Python's exceptions, with the same texts.
//!
//! The classes are in `rigidformer/_errors.py`: an exception with two bases is a class statement there.

use std::error::Error;
use std::io;

use pyo3::prelude::*;
use pyo3::sync::PyOnceLock;
use pyo3::types::PyType;
use rigidformer_core::StepError;
use rigidformer_evaluation::scenes::{Problem, SceneError};

const MODULE: &str = "rigidformer._errors";

static INPUT: PyOnceLock<Py<PyType>> = PyOnceLock::new();
static FILE: PyOnceLock<Py<PyType>> = PyOnceLock::new();
static STEP: PyOnceLock<Py<PyType>> = PyOnceLock::new();

/// What was given cannot be used: `InputError`.
pub(crate) fn input(text: impl Into<String>) -> PyErr {
    raised(&INPUT, "InputError", (text.into(),))
}

/// The exception for an error: `FileError` where the system refused a file, `StepError` where a step was refused, else
/// `InputError`.
pub(crate) fn raise<E: Error + 'static>(error: E) -> PyErr {
    let text = error.to_string();
    let mut cause: Option<&(dyn Error + 'static)> = Some(&error);
    // The first cause of a known kind decides, because a caller handles kinds and not layers.
    while let Some(found) = cause {
        if let Some(code) = refused_file(found) {
            return raised(&FILE, "FileError", (text, code));
        }
        if found.is::<StepError>() {
            return raised(&STEP, "StepError", (text,));
        }
        cause = found.source();
    }
    raised(&INPUT, "InputError", (text,))
}

/// The system's number for why it refused a file, if that is what the error is.
fn refused_file(error: &(dyn Error + 'static)) -> Option<Option<i32>> {
    if let Some(io) = error.downcast_ref::<io::Error>() {
        return Some(io.raw_os_error());
    }
    match &error.downcast_ref::<SceneError>()?.problem {
        // Scene errors keep the system's error in a variant and not as their source.
        Problem::Unreadable(io) => Some(io.raw_os_error()),
        _ => None,
    }
}

fn raised<A>(class: &'static PyOnceLock<Py<PyType>>, name: &str, arguments: A) -> PyErr
where
    A: pyo3::PyErrArguments + Send + Sync + 'static,
{
    // Errors are made on threads that do not hold the interpreter.
    Python::attach(|py| match class.import(py, MODULE, name) {
        Ok(class) => PyErr::from_type(class.clone(), arguments),
        Err(error) => error,
    })
}

/// `?` for Rust's errors.
pub(crate) trait OrRaise<T> {
    fn or_raise(self) -> PyResult<T>;
}

impl<T, E: Error + 'static> OrRaise<T> for Result<T, E> {
    fn or_raise(self) -> PyResult<T> {
        self.map_err(raise)
    }
}
