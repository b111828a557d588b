//! The trained models that come with this crate.

use crate::{Aligned, include_model};

/// The default model for boards that run Linux.
///
/// ```
/// use rigidformer_weights::{EDGE, ModelFile};
///
/// assert!(ModelFile::parse(EDGE).is_ok());
/// ```
#[cfg(feature = "edge")]
pub static EDGE: &Aligned<[u8]> = include_model!("../models/edge.rfm");

/// The model for microcontrollers: int8, for up to 512 KiB of flash.
///
/// ```
/// use rigidformer_weights::{ModelFile, NANO};
///
/// assert!(ModelFile::parse(NANO).is_ok());
/// ```
#[cfg(feature = "nano")]
pub static NANO: &Aligned<[u8]> = include_model!("../models/nano.rfm");

/// The model of a Unitree G1 of 31 parts that walks under command: int8, 816 kB (docs/ROBOTS.md).
///
/// ```
/// use rigidformer_weights::{G1, ModelFile};
///
/// assert!(ModelFile::parse(G1).is_ok());
/// ```
#[cfg(feature = "g1")]
pub static G1: &Aligned<[u8]> = include_model!("../models/g1.rfm");

/// The model of cloth, thin elastic shells: int8, 320 kB.
///
/// ```
/// use rigidformer_weights::{ModelFile, SHELL};
///
/// assert!(ModelFile::parse(SHELL).is_ok());
/// ```
#[cfg(feature = "shell")]
pub static SHELL: &Aligned<[u8]> = include_model!("../models/shell.rfm");
