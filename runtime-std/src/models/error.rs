//! Why a model cannot be used.

use std::path::PathBuf;

use rigidformer_core::LoadError;
use rigidformer_weights::WriteError;

use crate::files::FileError;

/// Why a model file cannot be used. Its text names the file, the field and the remedy.
#[derive(Debug, thiserror::Error)]
pub enum ModelError {
    /// The file cannot be read.
    #[error(transparent)]
    File(#[from] FileError),
    /// It is no model, or not one that this build can run.
    #[error("{}: {source}", .path.display())]
    Load {
        /// The file.
        path: PathBuf,
        /// What is wrong with it.
        source: LoadError,
    },
    /// It cannot be written in another form.
    #[error("{}: {source}", .path.display())]
    Write {
        /// The file.
        path: PathBuf,
        /// The rule of the packed format that it breaks.
        source: WriteError,
    },
}
