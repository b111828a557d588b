//! Why a model cannot be packed or quantised.

use std::path::PathBuf;

use rigidformer_runtime::files::FileError;
use rigidformer_runtime::models::ModelError;
use rigidformer_weights::WriteError;

use super::export::ExportError;

/// Why a model was not packed; nothing was written. Its text names the file, the field and the remedy.
#[derive(Debug, thiserror::Error)]
pub enum PackError {
    /// A file cannot be read or written.
    #[error(transparent)]
    File(#[from] FileError),
    /// The exported file is at fault.
    #[error(transparent)]
    Export(#[from] ExportError),
    /// Its contents break a rule of the packed format.
    #[error("{}: {source}", .path.display())]
    Write {
        /// The exported file.
        path: PathBuf,
        /// The rule.
        source: WriteError,
    },
    /// A packed model cannot be quantised as asked.
    #[error("{}: {source}", .path.display())]
    Source {
        /// The packed file.
        path: PathBuf,
        /// Why.
        source: SourceProblem,
    },
    /// The result is no model: a tensor is missing or has another shape than the configuration wants.
    #[error(transparent)]
    Model(#[from] ModelError),
}

/// Why a packed file cannot be quantised.
#[derive(Debug, thiserror::Error)]
pub enum SourceProblem {
    /// A tensor is quantised already.
    #[error(
        "tensor {tensor} is {dtype} already; quantise from the f32 model, so that errors do not add up"
    )]
    NotF32 {
        /// The tensor.
        tensor: String,
        /// Its type.
        dtype: String,
    },
    /// A layer that the policy names does not exist.
    #[error(
        "{option} {layer}: the model has no linear layer of that name (`rigidformer inspect` lists them, without `.weight`)"
    )]
    NoSuchLayer {
        /// The list that it is in.
        option: &'static str,
        /// The name given.
        layer: String,
    },
    /// The tensors would not stay byte for byte.
    #[error(
        "its tensors lie in the file in another way than this program writes them; pack it again from its export"
    )]
    OtherLayout,
}
