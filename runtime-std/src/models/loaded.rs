//! Models in memory.

use std::ops::Deref;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use rigidformer_core::Model;
use rigidformer_core::kernels::in_own_environment;
use rigidformer_weights::AlignedBuffer;
use self_cell::self_cell;

use super::error::ModelError;
use crate::files::unreadable;
use crate::memory::Budget;

/// A model in memory, checked. Clones share it.
///
/// ```no_run
/// use rigidformer_runtime::models::LoadedModel;
/// let loaded = LoadedModel::open("edge.rfm".as_ref())?;
/// println!("{}: {} parameters", loaded.model().file().name(), loaded.model().file().parameters());
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
#[derive(Clone)]
pub struct LoadedModel {
    path: Arc<Path>,
    cell: Arc<Cell>,
}

pub(super) enum Bytes {
    Owned(AlignedBuffer),
    Embedded(&'static [u8]),
}

impl Deref for Bytes {
    type Target = [u8];

    fn deref(&self) -> &[u8] {
        match self {
            Bytes::Owned(buffer) => buffer,
            Bytes::Embedded(bytes) => bytes,
        }
    }
}

self_cell!(
    struct Cell {
        owner: Bytes,
        #[covariant]
        dependent: Model,
    }
);

impl LoadedModel {
    /// Reads a model file and checks it. What becomes of the file later does not matter: the model is a copy.
    ///
    /// # Errors
    /// [`ModelError`] where the file cannot be read, its length changes meanwhile, or it is no model.
    pub fn open(path: &Path) -> Result<Self, ModelError> {
        // Reading a folder gives errors that differ between systems.
        if path.is_dir() {
            return Err(unreadable(path, std::io::ErrorKind::IsADirectory.into()).into());
        }
        let length = std::fs::metadata(path).map_or(0, |file| file.len());
        if let Err(error) = Budget::default().take(length) {
            let error = std::io::Error::new(std::io::ErrorKind::FileTooLarge, error);
            return Err(unreadable(path, error).into());
        }
        let bytes = AlignedBuffer::read(path).map_err(|source| unreadable(path, source))?;
        Self::checked(path.into(), Bytes::Owned(bytes))
    }

    /// A model that is in memory already, copied to where it can be read in place; errors call it `name`.
    pub fn copy_of(name: impl Into<PathBuf>, bytes: &[u8]) -> Result<Self, ModelError> {
        Self::checked(name.into().into(), Bytes::Owned(AlignedBuffer::copy_of(bytes)))
    }

    /// A model that is embedded in the program, aligned to 16 bytes; errors call it `name`.
    pub fn embedded(name: impl Into<PathBuf>, bytes: &'static [u8]) -> Result<Self, ModelError> {
        Self::checked(name.into().into(), Bytes::Embedded(bytes))
    }

    pub(super) fn checked(path: Arc<Path>, bytes: Bytes) -> Result<Self, ModelError> {
        match in_own_environment(|| Cell::try_new(bytes, |bytes| Model::load(bytes))) {
            Ok(cell) => Ok(Self { path, cell: Arc::new(cell) }),
            Err(source) => Err(ModelError::Load { path: path.to_path_buf(), source }),
        }
    }

    /// The model.
    pub fn model(&self) -> &Model<'_> {
        self.cell.borrow_dependent()
    }

    /// Its file, byte for byte.
    pub fn bytes(&self) -> &[u8] {
        self.cell.borrow_owner()
    }

    /// Where it was read from.
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// Bytes of the file.
    pub fn len(&self) -> usize {
        self.bytes().len()
    }

    /// Whether the file has no bytes, which no model has.
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }
}
