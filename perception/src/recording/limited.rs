//! Files that are read whole, up to a size.

use std::fs::File;
use std::io::Read;
use std::path::Path;

use super::error::{CaptureError, CaptureProblem};

/// Reads a file of at most so many bytes.
pub(super) fn read_limited(path: &Path, most: u64) -> Result<Vec<u8>, CaptureError> {
    let fail = |problem| CaptureError::of(path, problem);
    let unreadable = |error| fail(CaptureProblem::Unreadable(error));
    let file = File::open(path).map_err(unreadable)?;
    let metadata = file.metadata().map_err(unreadable)?;
    if metadata.is_dir() {
        return Err(unreadable(std::io::ErrorKind::IsADirectory.into()));
    }
    if metadata.len() > most {
        return Err(fail(CaptureProblem::TooLarge { bytes: metadata.len(), most }));
    }
    let mut bytes = Vec::new();
    // A pipe has no length, so the limit is checked again while reading.
    let read = file.take(most.saturating_add(1)).read_to_end(&mut bytes).map_err(unreadable)?;
    if read as u64 > most {
        return Err(fail(CaptureProblem::TooLarge { bytes: read as u64, most }));
    }
    Ok(bytes)
}

/// Whether a file begins with these bytes.
pub(super) fn begins_with(path: &Path, bytes: &[u8]) -> Result<bool, CaptureError> {
    let unreadable = |error| CaptureError::of(path, CaptureProblem::Unreadable(error));
    let file = File::open(path).map_err(unreadable)?;
    let mut first = Vec::new();
    file.take(bytes.len() as u64).read_to_end(&mut first).map_err(unreadable)?;
    Ok(first == bytes)
}
