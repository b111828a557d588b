//! Files that are read or written whole, with errors that say which file and what to do.

use std::io;
use std::path::{Path, PathBuf};

use rigidformer_weights::write_atomically;

/// A file that could not be read or written: says which, what was tried, and what to do.
#[derive(Debug, thiserror::Error)]
#[error("{}: {action} ({source}); {remedy}", .path.display())]
pub struct FileError {
    /// The file.
    pub path: PathBuf,
    /// What was tried, such as "cannot be written".
    pub action: &'static str,
    /// What the user can do about it.
    pub remedy: &'static str,
    /// What the system answered.
    pub source: io::Error,
}

/// Writes `bytes` to `path`: first to a temporary file in the same folder, which is renamed when it is complete, so that readers never get
/// half a file. An existing file is replaced.
///
/// ```
/// let folder = tempfile::tempdir()?;
/// let path = folder.path().join("poses.csv");
/// rigidformer_runtime::files::write_whole(&path, b"frame,unit\n")?;
/// assert_eq!(std::fs::read(&path)?, b"frame,unit\n");
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
pub fn write_whole(path: &Path, bytes: &[u8]) -> Result<(), FileError> {
    let not_a_folder = if path.is_dir() { Err(io::ErrorKind::IsADirectory.into()) } else { Ok(()) };
    let write = || write_atomically(path, bytes).map_err(|error| error.source);
    not_a_folder.and_then(|()| write()).map_err(|source| FileError {
        path: path.into(),
        action: "cannot be written",
        remedy: "name a file in a folder that exists and that you may write to",
        source,
    })
}

/// Reads a whole file.
pub fn read_whole(path: &Path) -> Result<Vec<u8>, FileError> {
    // Some systems open folders and fail only at the first read, with a less clear answer.
    let not_a_folder = if path.is_dir() { Err(io::ErrorKind::IsADirectory.into()) } else { Ok(()) };
    not_a_folder.and_then(|()| std::fs::read(path)).map_err(|source| unreadable(path, source))
}

pub(crate) fn unreadable(path: &Path, source: io::Error) -> FileError {
    let remedy = "give the path of a file that exists and that you may read";
    FileError { path: path.into(), action: "cannot be read", remedy, source }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_failed_write_leaves_nothing_behind() {
        let folder = tempfile::tempdir().unwrap();
        let error = write_whole(folder.path(), b"x").unwrap_err();
        assert!(error.to_string().contains("cannot be written"), "{error}");
        let error = write_whole(&folder.path().join("none/file"), b"x").unwrap_err();
        assert!(error.to_string().contains("folder that exists"), "{error}");
        assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 0);
    }
}
