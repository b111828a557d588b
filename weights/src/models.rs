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
