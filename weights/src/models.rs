//! The trained models that come with this crate.

use crate::{Aligned, include_model};

/// The default model for boards that run Linux.
///
/// ```
/// use rigidformer_weights::{EDGE, ModelFile};
///
/// assert!(ModelFile::parse(EDGE).is_ok());
/// ```
pub static EDGE: &Aligned<[u8]> = include_model!("../models/edge.rfm");
