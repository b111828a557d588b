//! Rust's errors as Python's exceptions, in Python's words.
//!
//! The classes are in `rigidformer/_errors.py`: an exception with two bases is a class statement there.

use std::any::Any;
use std::error::Error;
use std::fmt::Write as _;
use std::io;
use std::path::{Path, PathBuf};

use pyo3::prelude::*;
use pyo3::sync::PyOnceLock;
use pyo3::types::PyType;
use rigidformer_core::StepError;
use rigidformer_evaluation::contact::ContactError;
use rigidformer_evaluation::scenes::{Problem, SceneError};
use rigidformer_robots::RobotError;
use rigidformer_runtime::files::FileError;
use rigidformer_runtime::futures::BatchError;
use rigidformer_runtime::models::ModelError;
use rigidformer_runtime::world::WorldError;

const MODULE: &str = "rigidformer._errors";

static INPUT: PyOnceLock<Py<PyType>> = PyOnceLock::new();
static RANGE: PyOnceLock<Py<PyType>> = PyOnceLock::new();
static FILE: PyOnceLock<Py<PyType>> = PyOnceLock::new();
static MEMORY: PyOnceLock<Py<PyType>> = PyOnceLock::new();
static STEP: PyOnceLock<Py<PyType>> = PyOnceLock::new();
static FAULT: PyOnceLock<Py<PyType>> = PyOnceLock::new();

/// What the Rust library says, and what it is called in Python.
const WORDS: [(&str, &str); 14] = [
    ("call set_dt or observe first", "set dt_s or call observe first"),
    ("raise Limits::units", "make the World with more units="),
    ("raise Limits::points", "make the World with more points="),
    ("give it Role::Driven", "call set_role(id, \"driven\")"),
    ("say them with RecordedScene::with_planes", "give Scene(planes=)"),
    ("call set_command first", "call command first"),
    ("call replicate first", "ask for more copies"),
    ("allow more by with_memory", "allow more by BatchSimulator(memory=)"),
    ("give fewer units a chunk", "start from fewer points"),
    ("add and remove units before replicate", "add and remove units in scenes of one copy"),
    ("make it with Simulator::with_layout of this one's LAYOUT", "make a new World"),
    ("Role::Fixed", "\"fixed\""),
    ("Role::Free", "\"free\""),
    ("Role::Driven", "\"driven\""),
];

/// What was given cannot be used: `InputError`.
pub(crate) fn input(text: impl Into<String>) -> PyErr {
    raised(&INPUT, "InputError", (shown(&text.into()),))
}

/// A whole number out of range: `RangeError`.
pub(crate) fn range(text: String) -> PyErr {
    raised(&RANGE, "RangeError", (shown(&text),))
}

/// More memory than there is, or than may be taken: `MemoryLimitError`.
pub(crate) fn memory(text: impl Into<String>) -> PyErr {
    raised(&MEMORY, "MemoryLimitError", (shown(&text.into()),))
}

/// A panic of the library: `FaultError`.
pub(crate) fn fault(panic: &(dyn Any + Send)) -> PyErr {
    let text = panic.downcast_ref::<&str>().copied();
    let text = text.or_else(|| panic.downcast_ref::<String>().map(String::as_str));
    let text = shown(text.unwrap_or("it gives no reason"));
    raised(&FAULT, "FaultError", (format!("a fault of the library: {text}; please report it"),))
}

/// The exception for an error: `FileError` where the system refused a file, `StepError` where a step was refused,
/// `MemoryLimitError` where it would take too much memory, else `InputError`.
pub(crate) fn raise<E: Error + 'static>(error: E) -> PyErr {
    let text = text_of(&error);
    let mut path: Option<PathBuf> = None;
    let mut cause: Option<&(dyn Error + 'static)> = Some(&error);
    // The first cause of a known kind decides, because a caller handles kinds and not layers.
    while let Some(found) = cause {
        path = path.or_else(|| path_of(found).map(Path::to_path_buf));
        if let Some(io) = refused_file(found) {
            let name = path.filter(|path| !path.to_string_lossy().starts_with('<'));
            return raised(&FILE, "FileError", (text, io.raw_os_error(), name, kind(io)));
        }
        if is_of_memory(found) {
            return memory(text);
        }
        if found.is::<StepError>() {
            return raised(&STEP, "StepError", (text,));
        }
        cause = found.source();
    }
    raised(&INPUT, "InputError", (text,))
}

/// Whether there is no memory, or more was asked for than may be taken.
fn is_of_memory(error: &(dyn Error + 'static)) -> bool {
    let of_world = |error: &WorldError| matches!(error, WorldError::Memory { .. });
    match error.downcast_ref::<BatchError>() {
        // It passes its world's error on as its own.
        Some(BatchError::World(error)) => of_world(error),
        Some(BatchError::Memory { .. }) => true,
        _ => error.downcast_ref::<WorldError>().is_some_and(of_world),
    }
}

/// What an error says, in Python's words.
pub(crate) fn text_of(error: &dyn Error) -> String {
    shown(&in_python(error.to_string()))
}

/// The file that an error is about.
fn path_of<'e>(error: &'e (dyn Error + 'static)) -> Option<&'e Path> {
    // A model's error passes its file's on as its own, and so does contact's.
    if let Some(ModelError::File(file)) = error.downcast_ref() {
        return Some(&file.path);
    }
    if let Some(ContactError::File(file)) = error.downcast_ref() {
        return Some(&file.path);
    }
    if let Some(RobotError::File(file)) = error.downcast_ref() {
        return Some(&file.path);
    }
    let file = error.downcast_ref::<FileError>().map(|error| error.path.as_path());
    file.or_else(|| error.downcast_ref::<SceneError>().map(|error| error.path.as_path()))
}

/// Why the system refused a file, if that is what the error is.
fn refused_file<'e>(error: &'e (dyn Error + 'static)) -> Option<&'e io::Error> {
    if let Some(io) = error.downcast_ref::<io::Error>() {
        return Some(io);
    }
    match &error.downcast_ref::<SceneError>()?.problem {
        // Scene errors keep the system's error in a variant and not as their source.
        Problem::Unreadable(io) => Some(io),
        _ => None,
    }
}

/// The system's name for a kind of error, where the library found it and not the system.
fn kind(error: &io::Error) -> Option<&'static str> {
    match error.kind() {
        io::ErrorKind::NotFound => Some("ENOENT"),
        io::ErrorKind::PermissionDenied => Some("EACCES"),
        io::ErrorKind::IsADirectory => Some("EISDIR"),
        io::ErrorKind::NotADirectory => Some("ENOTDIR"),
        io::ErrorKind::AlreadyExists => Some("EEXIST"),
        io::ErrorKind::FileTooLarge => Some("EFBIG"),
        _ => None,
    }
}

/// The text with Python's names.
fn in_python(text: String) -> String {
    WORDS.iter().fold(text, |text, (rust, python)| text.replace(rust, python))
}

/// The text without characters that would change a terminal or hide what is said: files may hold any.
fn shown(text: &str) -> String {
    let mut shown = String::with_capacity(text.len());
    for c in text.chars() {
        match c {
            // Control characters, and those that turn the direction of writing.
            c if c.is_control()
                || matches!(c, '\u{200e}' | '\u{200f}' | '\u{202a}'..='\u{202e}' | '\u{2028}' | '\u{2029}' | '\u{2066}'..='\u{2069}') =>
            {
                // Writing to a String cannot fail.
                let _ = write!(shown, "\\u{{{:x}}}", u32::from(c));
            }
            c => shown.push(c),
        }
    }
    shown
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
