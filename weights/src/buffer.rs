//! Bytes on the heap at an address that tensors can be read from in place.

use std::fs::File;
use std::io::{self, Read};
use std::ops::Deref;
use std::path::Path;
use std::vec;
use std::vec::Vec;

use crate::TENSOR_ALIGNMENT;

/// Bytes on the heap at a 64-byte aligned address, for models that are not embedded.
///
/// ```
/// use rigidformer_weights::AlignedBuffer;
///
/// let buffer = AlignedBuffer::copy_of(&[1, 2, 3]);
/// assert_eq!(&*buffer, &[1, 2, 3]);
/// assert!(buffer.as_ptr().addr().is_multiple_of(64));
/// ```
#[derive(Debug)]
pub struct AlignedBuffer {
    /// Never grown, so that its heap address stays.
    bytes: Vec<u8>,
    start: usize,
    length: usize,
}

impl AlignedBuffer {
    /// A copy of `bytes`, aligned.
    pub fn copy_of(bytes: &[u8]) -> Self {
        let mut buffer = Self::zeros(bytes.len());
        buffer.fill().copy_from_slice(bytes);
        buffer
    }

    /// A whole file, aligned. Memory is used as the file is read, so that a length that is a lie costs none.
    ///
    /// # Errors
    /// Those of opening and reading the file; also when its length changes meanwhile, or there is no memory for it.
    pub fn read(path: &Path) -> io::Result<Self> {
        let mut file = File::open(path)?;
        let length = usize::try_from(file.metadata()?.len()).map_err(io::Error::other)?;
        let mut bytes: Vec<u8> = Vec::new();
        bytes
            .try_reserve_exact(length.saturating_add(TENSOR_ALIGNMENT))
            .map_err(|_| io::Error::from(io::ErrorKind::OutOfMemory))?;
        let start = bytes.as_ptr().align_offset(TENSOR_ALIGNMENT).min(TENSOR_ALIGNMENT);
        bytes.resize(start, 0);
        if file.by_ref().take(length as u64).read_to_end(&mut bytes)? < length {
            return Err(io::Error::other("the file shrank while it was read"));
        }
        if file.read(&mut [0])? != 0 {
            return Err(io::Error::other("the file grew while it was read"));
        }
        Ok(AlignedBuffer { bytes, start, length })
    }

    /// So many zeros, aligned.
    fn zeros(length: usize) -> Self {
        let bytes: Vec<u8> = vec![0; length.saturating_add(TENSOR_ALIGNMENT)];
        let start = bytes.as_ptr().align_offset(TENSOR_ALIGNMENT);
        AlignedBuffer { bytes, start, length }
    }

    /// The bytes, to fill them in.
    fn fill(&mut self) -> &mut [u8] {
        let (_, aligned) = self.bytes.split_at_mut_checked(self.start).unwrap_or_default();
        aligned.get_mut(..self.length).unwrap_or_default()
    }
}

impl Deref for AlignedBuffer {
    type Target = [u8];

    fn deref(&self) -> &[u8] {
        let (_, aligned) = self.bytes.split_at_checked(self.start).unwrap_or_default();
        aligned.get(..self.length).unwrap_or_default()
    }
}
