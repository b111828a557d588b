//! Packed RigidFormer models: one file holds what a model is, its tensors and where it comes from.
//!
//! A tour, in the order in which a model travels:
//!
//! 1. [`ModelWriter`] (feature `std`) packs a [`ModelConfig`] and named tensors into bytes;
//!    [`write_atomically`] puts them into a file. The same input always gives the same bytes.
//! 2. Firmware embeds the file with [`include_model!`]; a program on Linux maps it or reads it into
//!    an [`AlignedBuffer`].
//! 3. [`ModelFile::parse`] checks everything once: version, sizes, checksums, alignment, overlap,
//!    finite values, limits.
//! 4. After that, accessors lend out slices of those same bytes. They cannot fail, and nothing is
//!    copied or allocated.
//!
//! The layout is in `FORMAT.md` beside this crate, byte by byte.
//!
//! ```
//! use rigidformer_weights::{
//!     AlignedBuffer, ModelConfig, ModelFile, ModelWriter, Shape, TensorData,
//! };
//!
//! # fn main() -> Result<(), Box<dyn std::error::Error>> {
//! let bytes = ModelWriter::new("tiny", ModelConfig::TINY)
//!     .provenance("trained on", "MOVi-Sphere")
//!     .metric("position_rmse_m", 0.25)
//!     .tensor("head.bias", Shape::Vector(3), TensorData::F32(&[1.0, 2.0, 3.0]))
//!     .finish()?;
//!
//! let bytes = AlignedBuffer::copy_of(&bytes);
//! let model = ModelFile::parse(&bytes)?;
//! assert_eq!(model.name(), "tiny");
//! assert_eq!(model.parameters(), 3);
//! let head = model.tensor("head.bias").ok_or("no head")?;
//! assert_eq!(head.data, TensorData::F32(&[1.0, 2.0, 3.0]));
//! # Ok(())
//! # }
//! ```
//!
//! # Not supported
//!
//! Big-endian targets, tensors of more than two dimensions, weights below 8 bits, compressed files,
//! changing a file in place.
//!
//! # Features
//!
//! | feature | gives | needs |
//! |---|---|---|
//! | none | the reader | `core` only: no allocator |
//! | `edge` | `EDGE`, the trained default model | as much flash as `weights/models/edge.rfm` |
//! | `nano` | `NANO`, the trained model for microcontrollers | as much flash as `weights/models/nano.rfm` |
//! | `g1` | `G1`, the trained model of a walking robot | as much flash as `weights/models/g1.rfm` |
//! | `shell` | `SHELL`, the trained model of cloth, and `deform` | as much flash as `weights/models/shell.rfm` |
//! | `deform` | versions 6 and 7 of the format: models of soft bodies, models that break bonds | nothing: a reader without it is smaller |
//! | `health` | version 9 of the format: models that say what training saw | nothing: a reader without it is smaller |
//! | `host` | versions 2 and 8 of the format: hidden widths, int8 panels, a network that sees what is in contact; and the two above | nothing: a reader without it is smaller |
//! | `std` | `host`, [`ModelWriter`], [`write_atomically`], [`AlignedBuffer`] | the standard library |
#![cfg_attr(test, allow(clippy::unwrap_used, clippy::expect_used, clippy::panic))]
#![no_std]
// The tour above links to the writer.
#![cfg_attr(not(feature = "std"), allow(rustdoc::broken_intra_doc_links))]
#![cfg_attr(
    not(test),
    deny(
        clippy::arithmetic_side_effects,
        clippy::expect_used,
        clippy::indexing_slicing,
        clippy::panic,
        clippy::unreachable,
        clippy::unwrap_used
    )
)]

#[cfg(target_endian = "big")]
compile_error!(
    "model files are little-endian and are read in place: big-endian targets are not supported"
);

#[cfg(feature = "std")]
extern crate std;

mod aligned;
#[cfg(feature = "std")]
mod buffer;
mod config;
mod decimal;
mod directory;
mod error;
#[cfg(feature = "std")]
mod files;
mod header;
mod layout;
#[cfg(any(feature = "edge", feature = "g1", feature = "nano"))]
mod models;
mod order;
#[cfg(feature = "health")]
mod ranges;
mod reader;
mod tensor;
mod validate;
#[cfg(feature = "std")]
mod writer;

pub use aligned::Aligned;
#[cfg(feature = "std")]
pub use buffer::AlignedBuffer;
pub use config::{
    BLEND_CODE, BLEND_HIDDEN, BOND_FEATURES, Directions, Elastic, FeatureSet, Hidden,
    IMPACT_FEATURES, IMPACT_PUSHES, IMPACTS, MAX_NEIGHBOURS, ModelConfig, Motion, Scales, Scope,
    Similarity,
};
pub use decimal::{AtMost, Decimal};
pub use error::{FormatError, Section};
#[cfg(feature = "std")]
pub use files::{
    WriteFileError, abandon, destination, is_stdout, write_all_atomically, write_atomically,
};
pub use layout::{MAGIC, MAX_NAME_BYTES, MAX_TENSORS, SLICE_ALIGNMENT, TENSOR_ALIGNMENT, VERSION};
#[cfg(feature = "edge")]
pub use models::EDGE;
#[cfg(feature = "g1")]
pub use models::G1;
#[cfg(feature = "nano")]
pub use models::NANO;
#[cfg(feature = "shell")]
pub use models::SHELL;
#[cfg(feature = "health")]
pub use ranges::{Quantity, Ranges};
#[cfg(feature = "host")]
pub use reader::Checked;
pub use reader::ModelFile;
pub use tensor::{DType, PANEL, PANEL_DEPTH, Panels, Shape, Tensor, TensorData};
pub use validate::ConfigError;
#[cfg(feature = "std")]
pub use writer::{ModelWriter, WriteError};
