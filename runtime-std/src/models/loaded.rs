//! Models in memory.

use std::ops::Deref;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use rigidformer_core::Model;
use rigidformer_weights::AlignedBuffer;
use self_cell::self_cell;

use super::error::ModelError;
use super::map;
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

/// Length from which files are mapped.
// Mapping saves the copy of a large model; small files are read whole, so that later writes do not matter.
const MAPPED_BYTES: u64 = 16 << 20;

pub(super) enum Bytes {
    Owned(AlignedBuffer),
    Mapped(map::Map),
    Embedded(&'static [u8]),
}

impl Deref for Bytes {
    type Target = [u8];

    fn deref(&self) -> &[u8] {
        match self {
            Bytes::Owned(buffer) => buffer,
            Bytes::Mapped(map) => map,
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
    /// Reads a model file and checks it. Files of 16 MiB and more are mapped instead of copied: do not write into such
    /// a file while it is in use (what this project writes replaces files whole, which is fine).
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
        if length >= MAPPED_BYTES {
            let map = map::Map::open(path).map_err(|source| unreadable(path, source))?;
            return Self::checked(path.into(), Bytes::Mapped(map));
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
        match Cell::try_new(bytes, |bytes| Model::load(bytes)) {
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
