//! Models.

use std::path::{Path, PathBuf};

use pyo3::intern;
use pyo3::prelude::*;
use pyo3::types::{PyBytes, PyDict, PyTuple};
use rigidformer_evaluation::models::{Policy, Precision, quantised};
use rigidformer_runtime::models::LoadedModel;
use rigidformer_weights::{EDGE, NANO};

use crate::errors::{OrRaise, input};
use crate::interrupt::free;

/// A model in memory, checked. Worlds and simulators share it.
///
/// Parameters
/// ----------
/// source : str, os.PathLike
///     "edge" (1.5 M parameters, for hosts) or "nano" (0.29 M, int8, for controllers), which are embedded; everything else
///     is the path of a packed model file (``*.rfm``). A file of the name "edge" is ``Path("edge")``.
///
/// Raises
/// ------
/// FileError
///     The file cannot be read.
/// InputError
///     It is no sound model: truncated, damaged, or of another version.
///
/// Source: ``runtime-std/src/models/loaded.rs``.
///
/// >>> import rigidformer as rf
/// >>> rf.Model("edge")
/// Model('edge', 1485291 parameters)
#[pyclass(frozen, module = "rigidformer")]
pub(crate) struct Model {
    /// As hosts run it fastest.
    pub(crate) loaded: LoadedModel,
    /// As it was read, for what looks at its types.
    pub(crate) as_read: LoadedModel,
}

impl Model {
    fn new(loaded: LoadedModel) -> PyResult<Self> {
        // Laid out once a model and not once a world.
        Ok(Model { loaded: loaded.clone().for_host().or_raise()?, as_read: loaded })
    }
}

#[pymethods]
impl Model {
    #[new]
    fn open(py: Python<'_>, source: &Bound<'_, PyAny>) -> PyResult<Self> {
        let name = source.extract::<String>().ok();
        // A text may name an embedded model, and a path object never does.
        let path: Option<PathBuf> = match name.as_deref() {
            Some("edge" | "nano") => None,
            _ => Some(source.extract()?),
        };
        // Loading checks every weight, which takes long enough to let other threads run.
        let loaded = free(py, || match (path, name.as_deref()) {
            (Some(path), _) => LoadedModel::open(&path),
            (None, Some("nano")) => LoadedModel::embedded("nano", NANO),
            (None, _) => LoadedModel::embedded("edge", EDGE),
        })?;
        Model::new(loaded.or_raise()?)
    }

    /// A packed model that is in memory already.
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
    ///     It is no sound model.
    ///
    /// >>> import rigidformer as rf
    /// >>> rf.Model.from_bytes(b"no model")
    /// Traceback (most recent call last):
    ///     ...
    /// rigidformer.InputError: <bytes>: ...
    #[staticmethod]
    #[pyo3(signature = (data, name = "<bytes>"))]
    fn from_bytes(py: Python<'_>, data: &[u8], name: &str) -> PyResult<Self> {
        // A `bytes` object does not change while other threads run.
        let loaded = free(py, || LoadedModel::copy_of(name, data))?;
        Model::new(loaded.or_raise()?)
    }

    /// The same model with other weights: "f16", "i8" or "mixed" (int8 where it hurts least).
    ///
    /// Parameters
    /// ----------
    /// dtype : str
    ///     "f32", "f16", "i8" or "mixed". The model itself must be f32.
    /// wide, narrow : sequence of str
    ///     Layers to keep at f16, and layers to make int8 all the same, by name.
    ///
    /// Raises
    /// ------
    /// InputError
    ///     The model is quantised already, or there is no such layer or type.
    ///
    /// Source: ``evaluation/src/models/quantise.rs``.
    ///
    /// >>> import rigidformer as rf
    /// >>> small = rf.Model("edge").quantised("i8")
    /// >>> small.nbytes < 0.3 * rf.Model("edge").nbytes
    /// True
    #[pyo3(signature = (dtype = "i8", *, wide = Vec::new(), narrow = Vec::new()))]
    fn quantised(
        &self,
        py: Python<'_>,
        dtype: &str,
        wide: Vec<String>,
        narrow: Vec<String>,
    ) -> PyResult<Self> {
        let policy = Policy { precision: precision(dtype)?, wide, narrow };
        // From the file's own weights: those laid out for hosts have another type.
        let loaded = free(py, || quantised(&self.as_read, &policy))?;
        Model::new(loaded.or_raise()?)
    }

    /// The name that its file has for it.
    #[getter]
    fn name(&self) -> &str {
        self.as_read.model().file().name()
    }

    /// Where it was read from, or the name that was given for it.
    #[getter]
    fn path(&self) -> &Path {
        self.as_read.path()
    }

    /// Numbers that were learnt.
    #[getter]
    fn parameters(&self) -> u64 {
        self.as_read.model().file().parameters()
    }

    /// Bytes of its file.
    #[getter]
    fn nbytes(&self) -> usize {
        self.as_read.len()
    }

    /// Frames a second of the data that it was trained on: a step of dt seconds is the step code dt * frame_rate_hz.
    #[getter]
    fn frame_rate_hz(&self) -> f32 {
        self.as_read.model().config().frame_rate_hz
    }

    /// Numbers in a command; 0: it takes none.
    #[getter]
    fn command_size(&self) -> u32 {
        self.as_read.model().config().command_size
    }

    /// Where it comes from, in the words of its file.
    #[getter]
    fn provenance<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyDict>> {
        let entries = PyDict::new(py);
        for (key, value) in self.as_read.model().file().provenance() {
            entries.set_item(key, value)?;
        }
        Ok(entries)
    }

    // An embedded model is in every installation; of another one all bytes go along.
    fn __reduce__<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyTuple>> {
        let name = self.path().to_string_lossy().into_owned();
        let embedded: Option<&[u8]> = match name.as_str() {
            "edge" => Some(EDGE),
            "nano" => Some(NANO),
            _ => None,
        };
        if embedded.is_some_and(|bytes| bytes == self.as_read.bytes()) {
            return (py.get_type::<Model>(), (name,)).into_pyobject(py);
        }
        let again = py.import(intern!(py, "rigidformer._state"))?.getattr(intern!(py, "model"))?;
        (again, (PyBytes::new(py, self.as_read.bytes()), name)).into_pyobject(py)
    }

    // Models do not change.
    fn __copy__(this: Bound<'_, Self>) -> Bound<'_, Self> {
        this
    }

    fn __deepcopy__<'py>(this: Bound<'py, Self>, _memo: &Bound<'_, PyAny>) -> Bound<'py, Self> {
        this
    }

    fn __repr__(&self) -> String {
        format!("Model('{}', {} parameters)", self.name(), self.parameters())
    }
}

/// What weights become, by name.
pub(crate) fn precision(name: &str) -> PyResult<Precision> {
    match name {
        "f32" => Ok(Precision::F32),
        "f16" => Ok(Precision::F16),
        "i8" => Ok(Precision::I8),
        "mixed" => Ok(Precision::Mixed),
        _ => Err(input(format!("there is no dtype {name:?}; give f32, f16, i8 or mixed"))),
    }
}
