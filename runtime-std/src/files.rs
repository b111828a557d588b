//! Files that are read or written whole, with errors that say which file and what to do.

use std::fs::File;
use std::io::{self, Read};
use std::path::{Path, PathBuf};

use rigidformer_weights::write_all_atomically;
#[doc(inline)]
pub use rigidformer_weights::{abandon, destination, is_stdout};

use crate::memory::{self, TooLarge};

/// Bytes that are made room for at first.
const LEAST_ROOM: u64 = 1 << 16;

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
/// half a file. An existing file is replaced; links are followed, modes survive, and devices and pipes are written into.
///
/// ```
/// let folder = tempfile::tempdir()?;
/// let path = folder.path().join("poses.csv");
/// rigidformer_runtime::files::write_whole(&path, b"frame,unit\n")?;
/// assert_eq!(std::fs::read(&path)?, b"frame,unit\n");
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
///
/// # Errors
/// When the file cannot be written: the old one, if any, is then as it was.
pub fn write_whole(path: &Path, bytes: &[u8]) -> Result<(), FileError> {
    write_all(&[(path, bytes)])
}

/// Writes all files or none, each as [`write_whole`] does.
///
/// ```
/// let folder = tempfile::tempdir()?;
/// let (poses, none) = (folder.path().join("poses.csv"), folder.path().join("none/strip.png"));
/// assert!(rigidformer_runtime::files::write_all(&[(&poses, b"frame,unit\n"), (&none, b"png")]).is_err());
/// assert!(!poses.exists());
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
///
/// # Errors
/// When one of them cannot be written: all are then as they were. What a device or a pipe took stays taken.
pub fn write_all(files: &[(&Path, &[u8])]) -> Result<(), FileError> {
    write_all_atomically(files).map_err(|error| FileError {
        path: error.path,
        action: "cannot be written",
        remedy: "name a file in a folder that exists and that you may write to",
        source: error.source,
    })
}

/// Reads a whole file of at most [`memory::limit`] bytes: a device or a pipe may have no end.
///
/// # Errors
/// [`FileError`] where it cannot be read or is longer.
pub fn read_whole(path: &Path) -> Result<Vec<u8>, FileError> {
    // Some systems open folders and fail only at the first read, with a less clear answer.
    let not_a_folder = if path.is_dir() { Err(io::ErrorKind::IsADirectory.into()) } else { Ok(()) };
    let read = || read_to(File::open(path)?, memory::limit());
    not_a_folder.and_then(|()| read()).map_err(|source| unreadable(path, source))
}

/// Reads a file that must have no more than so many bytes.
pub(crate) fn read_to(file: File, most: u64) -> io::Result<Vec<u8>> {
    let too_large = |needed| io::Error::new(io::ErrorKind::FileTooLarge, TooLarge { needed, most });
    let length = file.metadata()?.len();
    if length > most {
        return Err(too_large(length));
    }
    let mut bytes = Vec::new();
    // The length of a pipe is 0, and a file may grow while it is read.
    let mut room = length.max(LEAST_ROOM).min(most);
    let mut source = file;
    loop {
        let more = room.saturating_sub(bytes.len() as u64);
        let wanted = usize::try_from(more).map_err(io::Error::other)?;
        bytes.try_reserve_exact(wanted).map_err(io::Error::other)?;
        (&mut source).take(more).read_to_end(&mut bytes)?;
        let mut next = [0];
        if (bytes.len() as u64) < room || source.read(&mut next)? == 0 {
            return Ok(bytes);
        }
        if room >= most {
            return Err(too_large(most.saturating_add(1)));
        }
        room = room.saturating_mul(2).min(most);
        bytes.extend(next);
    }
}

/// Text from a file, fit to be shown: on one line, control characters as text (`\\u{1b}`), and shortened to at most so many characters
/// with ` ...` behind them. All texts from files go this way into errors.
///
/// ```
/// use rigidformer_runtime::files::shown;
/// assert_eq!(shown("a  b\n\tc", 20), "a b c");
/// assert_eq!(shown("\u{1b}[2J", 20), "\\u{1b}[2J");
/// assert_eq!(shown("1234567", 4), "1234 ...");
/// ```
pub fn shown(text: &str, most: usize) -> String {
    let mut line = String::new();
    let (mut characters, mut is_blank) = (0, false);
    for c in text.chars() {
        if c.is_whitespace() {
            is_blank = true;
            continue;
        }
        if is_blank && characters > 0 {
            line.push(' ');
            characters += 1;
        }
        is_blank = false;
        if characters >= most {
            line.truncate(line.trim_end().len());
            line.push_str(" ...");
            return line;
        }
        // Marks of direction are no control characters, and turn what follows them about.
        match c.is_control()
            || matches!(c, '\u{200e}'..='\u{200f}' | '\u{202a}'..='\u{202e}' | '\u{2066}'..='\u{2069}')
        {
            true => line.extend(c.escape_unicode()),
            false => line.push(c),
        }
        characters += 1;
    }
    line
}

pub(crate) fn unreadable(path: &Path, source: io::Error) -> FileError {
    let remedy = match source.kind() {
        io::ErrorKind::FileTooLarge => TooLarge::REMEDY,
        _ => "give the path of a file that exists and that you may read",
    };
    FileError { path: path.into(), action: "cannot be read", remedy, source }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_file_is_read_up_to_its_limit() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("file");
        for length in [0_usize, 1, 65_535, 65_536, 65_537, 200_000] {
            std::fs::write(&path, vec![7; length]).unwrap();
            let read = |most| read_to(File::open(&path).unwrap(), most);
            assert_eq!(read(length as u64).unwrap(), vec![7; length]);
            assert_eq!(read(1 << 30).unwrap().len(), length);
            if let Some(less) = length.checked_sub(1) {
                assert_eq!(read(less as u64).unwrap_err().kind(), io::ErrorKind::FileTooLarge);
            }
        }
        #[cfg(unix)]
        {
            let endless = File::open("/dev/zero").unwrap();
            let error = unreadable("zeros".as_ref(), read_to(endless, 1 << 20).unwrap_err());
            let text = error.to_string();
            assert!(text.contains("1048577 bytes") && text.contains("--memory"), "{text}");
        }
    }

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
