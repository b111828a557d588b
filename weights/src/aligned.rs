//! Bytes at an address that tensors can be read from in place.

use core::ops::Deref;

/// A value at a 64-byte aligned address; `Aligned<[u8]>` is what
/// [`ModelFile::parse`](crate::ModelFile::parse) wants.
///
/// `include_bytes!` promises no alignment. [`include_model!`](crate::include_model) wraps it; by
/// hand:
///
/// ```
/// use rigidformer_weights::{Aligned, FormatError, ModelFile};
///
/// static BYTES: &Aligned<[u8]> = &Aligned(*b"not a model");
///
/// assert!(BYTES.as_ptr().addr().is_multiple_of(64));
/// assert!(matches!(ModelFile::parse(BYTES), Err(FormatError::NotAModel { .. })));
/// ```
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(C, align(64))]
pub struct Aligned<T: ?Sized>(
    /// The value.
    pub T,
);

impl<T: ?Sized> Deref for Aligned<T> {
    type Target = T;

    fn deref(&self) -> &T {
        &self.0
    }
}

/// Embeds a model file, aligned: `&'static Aligned<[u8]>`. The path is relative to the calling
/// source file.
///
/// ```
/// use rigidformer_weights::{Aligned, ModelFile, include_model};
///
/// static MODEL: &Aligned<[u8]> = include_model!("../tests/data/tiny.rfm");
///
/// # fn main() -> Result<(), rigidformer_weights::FormatError> {
/// let model = ModelFile::parse(MODEL)?;
/// assert_eq!(model.name(), "tiny");
/// # Ok(())
/// # }
/// ```
#[macro_export]
macro_rules! include_model {
    ($path:expr $(,)?) => {{
        static MODEL: &$crate::Aligned<[u8]> = &$crate::Aligned(*::core::include_bytes!($path));
        MODEL
    }};
}
