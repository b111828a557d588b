//! Files that are written whole or not at all.

use std::borrow::ToOwned;
use std::fs::{self, File, Metadata};
use std::io::{self, Write};
use std::path::{Path, PathBuf};
use std::process;
use std::sync::atomic::{AtomicU32, Ordering};
use std::sync::{Mutex, MutexGuard, PoisonError};
use std::vec::Vec;
use std::{format, mem};

/// Links that are followed before they count as a circle, as Linux counts.
const MOST_LINKS: usize = 40;
/// Bits of a mode that a file hands on: none that lets programs run as somebody else.
#[cfg(unix)]
const PERMISSIONS: u32 = 0o777;

/// Temporary files that there are now.
static PENDING: Mutex<Vec<PathBuf>> = Mutex::new(Vec::new());

/// Why a file cannot be written: says which.
#[derive(Debug, thiserror::Error)]
#[error("{}: cannot be written ({source})", .path.display())]
pub struct WriteFileError {
    /// The file.
    pub path: PathBuf,
    /// What the system answered.
    pub source: io::Error,
}

/// Writes a file completely or not at all: into a temporary file beside it, to disk, then renamed
/// over `path`. The folder is synced after that.
///
/// Links are followed, and a file that exists keeps its mode and, where the system lets it, its owner. Devices and
/// pipes are written into, as are the descriptors behind `/dev/stdout` and `/dev/fd`.
///
/// ```
/// use rigidformer_weights::write_atomically;
///
/// # fn main() -> Result<(), Box<dyn std::error::Error>> {
/// let folder = tempfile::tempdir()?;
/// let path = folder.path().join("model.rfm");
/// write_atomically(&path, b"bytes")?;
/// assert_eq!(std::fs::read(&path)?, b"bytes");
/// # Ok(())
/// # }
/// ```
///
/// # Errors
/// Those of creating, writing and renaming, with the path; the old file, if any, is then as it was. When the folder
/// alone cannot be synced, the new file is in place.
pub fn write_atomically(path: &Path, bytes: &[u8]) -> Result<(), WriteFileError> {
    write_all_atomically(&[(path, bytes)])
}

/// Writes all files or none, each as [`write_atomically`] does: all are complete before the first gets its name, and when
/// one cannot be renamed, those before it get their old contents back.
///
/// ```
/// use rigidformer_weights::write_all_atomically;
///
/// # fn main() -> Result<(), Box<dyn std::error::Error>> {
/// let folder = tempfile::tempdir()?;
/// let (poses, none) = (folder.path().join("poses.csv"), folder.path().join("none/strip.png"));
/// assert!(write_all_atomically(&[(&poses, b"frame,unit\n"), (&none, b"png")]).is_err());
/// assert!(!poses.exists());
/// # Ok(())
/// # }
/// ```
///
/// # Errors
/// As those of [`write_atomically`], with the path of the first file that fails; also when two paths are one file.
/// What a device or a pipe took stays taken.
pub fn write_all_atomically(files: &[(&Path, &[u8])]) -> Result<(), WriteFileError> {
    write_all(files, &mut |_| Ok(()))
}

/// Where the bytes of a file named `path` go: the file itself or, behind links, the one that they lead to, which may not exist.
/// Two paths of one file have one destination.
///
/// # Errors
/// Those of reading links, and when the folder does not exist.
pub fn destination(path: &Path) -> io::Result<PathBuf> {
    match target(path)? {
        Target::Replace { place, .. } => Ok(place),
        Target::Into(place) => fs::canonicalize(&place).or(Ok(place)),
        Target::Descriptor(number) => Ok(format!("/dev/fd/{number}").into()),
    }
}

/// Whether `path` is this process's standard output, such as `/dev/stdout`.
pub fn is_stdout(path: &Path) -> bool {
    matches!(target(path), Ok(Target::Descriptor(1)))
}

/// Removes the temporary files of writes under way, and lets no other begin: for a process that is about to exit.
pub fn abandon() {
    let pending = pending();
    for path in pending.iter() {
        // What cannot be removed stays: the process ends.
        let _ = fs::remove_file(path);
    }
    // Never unlocked: whoever would make another file waits for the end.
    mem::forget(pending);
}

fn pending() -> MutexGuard<'static, Vec<PathBuf>> {
    PENDING.lock().unwrap_or_else(PoisonError::into_inner)
}

/// A call to the file system.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Call {
    Create,
    Write,
    Permit,
    Sync,
    Link,
    Rename,
    SyncFolder,
}

/// Asked before each call to the file system; tests let it fail.
type Before<'b> = &'b mut dyn FnMut(Call) -> io::Result<()>;

/// What happens to a path that is written to.
enum Target {
    /// A new file gets this name.
    Replace { place: PathBuf, old: Option<Metadata> },
    /// It is written into: a device, a pipe, a socket.
    Into(PathBuf),
    /// A file that this process has open.
    Descriptor(u32),
}

fn folder_of(path: &Path) -> &Path {
    path.parent().filter(|folder| !folder.as_os_str().is_empty()).unwrap_or(Path::new("."))
}

/// The number of a file that this process has open, of names such as `/dev/fd/1`.
fn descriptor(path: &Path) -> Option<u32> {
    if !cfg!(unix) {
        return None;
    }
    let number = path.file_name()?.to_str()?.parse().ok()?;
    let folder = fs::canonicalize(folder_of(path)).ok()?;
    let open = fs::canonicalize("/proc/self/fd").ok();
    (open.as_ref() == Some(&folder) || folder == Path::new("/dev/fd")).then_some(number)
}

fn target(path: &Path) -> io::Result<Target> {
    let mut place = path.to_owned();
    for _ in 0..MOST_LINKS {
        // Before its link is read: what that says of a pipe is no path.
        if let Some(number) = descriptor(&place) {
            return Ok(Target::Descriptor(number));
        }
        let old = match fs::symlink_metadata(&place) {
            Ok(old) if old.is_symlink() => {
                place = folder_of(&place).join(fs::read_link(&place)?);
                continue;
            }
            Ok(old) if old.is_dir() => return Err(io::ErrorKind::IsADirectory.into()),
            Ok(old) if !old.is_file() => return Ok(Target::Into(place)),
            Ok(old) => Some(old),
            Err(error) if error.kind() == io::ErrorKind::NotFound => None,
            Err(error) => return Err(error),
        };
        let name = place.file_name().ok_or(io::ErrorKind::NotFound)?;
        let place = fs::canonicalize(folder_of(&place))?.join(name);
        return Ok(Target::Replace { place, old });
    }
    Err(io::Error::other("its links lead in a circle"))
}

fn write_all(files: &[(&Path, &[u8])], before: Before<'_>) -> Result<(), WriteFileError> {
    let failed = |path: &Path| {
        let path = path.to_owned();
        move |source| WriteFileError { path, source }
    };
    let mut places: Vec<PathBuf> = Vec::with_capacity(files.len());
    let mut staged = Vec::with_capacity(files.len());
    let mut open = Vec::new();
    for (path, bytes) in files {
        match target(path).map_err(failed(path))? {
            Target::Replace { place, .. } if places.contains(&place) => {
                return Err(failed(path)(io::Error::other("two results have this name")));
            }
            Target::Replace { place, old } => {
                let file = staged_file(&place, old.as_ref(), bytes, before);
                staged.push((*path, place.clone(), old.is_some(), file.map_err(failed(path))?));
                places.push(place);
            }
            Target::Into(place) => open.push((*path, Target::Into(place), *bytes)),
            target => open.push((*path, target, *bytes)),
        }
    }
    for (path, target, bytes) in open {
        write_into(&target, bytes, before).map_err(failed(path))?;
    }
    rename_all(&mut staged, before)?;
    for (number, (path, place, ..)) in staged.iter().enumerate() {
        let folder = folder_of(place);
        if !places.iter().take(number).any(|other| folder_of(other) == folder) {
            sync_folder(folder, before).map_err(failed(path))?;
        }
    }
    Ok(())
}

/// A path, its place, whether a file is there, and the new one.
type Staged<'p> = (&'p Path, PathBuf, bool, Temporary);

/// Gives all files their names, or none.
fn rename_all(staged: &mut [Staged<'_>], before: Before<'_>) -> Result<(), WriteFileError> {
    let is_one = staged.len() < 2;
    let mut done: Vec<(PathBuf, Option<Temporary>)> = Vec::with_capacity(staged.len());
    for (path, place, is_there, file) in staged {
        let old = match *is_there && !is_one {
            true => backup(place, before).map(Some),
            false => Ok(None),
        };
        let renamed = old.and_then(|old| {
            before(Call::Rename)?;
            fs::rename(&file.path, &*place)?;
            file.is_kept = true;
            Ok(old)
        });
        match renamed {
            Ok(old) => done.push((place.clone(), old)),
            Err(source) => {
                done.into_iter().rev().for_each(|(place, old)| undo(&place, old));
                return Err(WriteFileError { path: path.to_owned(), source });
            }
        }
    }
    Ok(())
}

/// Gives a place its old file back, or none where none was. What fails here has no remedy: the first failure is told.
fn undo(place: &Path, old: Option<Temporary>) {
    let Some(mut old) = old else {
        let _ = fs::remove_file(place);
        return;
    };
    old.is_kept = fs::rename(&old.path, place).is_ok();
}

/// A second name for a file or, where the file system has no such thing, a copy.
fn backup(place: &Path, before: Before<'_>) -> io::Result<Temporary> {
    before(Call::Link)?;
    let mut file = Temporary::create(folder_of(place), true)?;
    // The name was free a moment ago, and nobody else uses such names.
    fs::remove_file(&file.path)?;
    if fs::hard_link(place, &file.path).is_err() {
        file.file = File::create_new(&file.path)?;
        io::copy(&mut File::open(place)?, &mut file.file)?;
        permit(&file.file, &fs::metadata(place)?)?;
    }
    Ok(file)
}

fn staged_file(
    place: &Path,
    old: Option<&Metadata>,
    bytes: &[u8],
    before: Before<'_>,
) -> io::Result<Temporary> {
    before(Call::Create)?;
    let mut temporary = Temporary::create(folder_of(place), old.is_some())?;
    let (first, second) = bytes.split_at(bytes.len() / 2);
    temporary.file.write_all(first)?;
    before(Call::Write)?;
    temporary.file.write_all(second)?;
    if let Some(old) = old {
        before(Call::Permit)?;
        permit(&temporary.file, old)?;
    }
    before(Call::Sync)?;
    temporary.file.sync_all()?;
    Ok(temporary)
}

fn write_into(target: &Target, bytes: &[u8], before: Before<'_>) -> io::Result<()> {
    before(Call::Write)?;
    match target {
        Target::Descriptor(1) => {
            let mut stdout = io::stdout().lock();
            stdout.write_all(bytes)?;
            stdout.flush()
        }
        Target::Descriptor(2) => io::stderr().lock().write_all(bytes),
        // Appended: who opened it may have written to it.
        Target::Descriptor(number) => {
            let path = PathBuf::from(format!("/dev/fd/{number}"));
            File::options().append(true).open(path)?.write_all(bytes)
        }
        Target::Into(path) | Target::Replace { place: path, .. } => {
            File::options().write(true).open(path)?.write_all(bytes)
        }
    }
}

/// Gives a new file the owner and the mode of an old one.
#[cfg(unix)]
fn permit(file: &File, old: &Metadata) -> io::Result<()> {
    use std::os::unix::fs::{MetadataExt, PermissionsExt, fchown};
    let new = file.metadata()?;
    let mut mode = old.mode() & PERMISSIONS;
    let (owner, group) = (new.uid() != old.uid(), new.gid() != old.gid());
    if owner {
        // Only root gives files away: without that right the file is the caller's.
        let _ = fchown(file, Some(old.uid()), None);
    }
    if group && fchown(file, None, Some(old.gid())).is_err() {
        // Another group gets no more than all others had.
        mode &= !0o070 | (mode & 0o007) << 3;
    }
    file.set_permissions(fs::Permissions::from_mode(mode))
}

#[cfg(not(unix))]
fn permit(file: &File, old: &Metadata) -> io::Result<()> {
    file.set_permissions(old.permissions())
}

/// Writes the names of a folder to disk, where folders can be opened.
#[cfg(unix)]
fn sync_folder(folder: &Path, before: Before<'_>) -> io::Result<()> {
    before(Call::SyncFolder)?;
    // A folder that may be written to and not read cannot be synced.
    let Ok(folder) = File::open(folder) else { return Ok(()) };
    match folder.sync_all() {
        Err(error)
            if matches!(error.kind(), io::ErrorKind::InvalidInput | io::ErrorKind::Unsupported) =>
        {
            Ok(())
        }
        synced => synced,
    }
}

#[cfg(not(unix))]
fn sync_folder(_: &Path, before: Before<'_>) -> io::Result<()> {
    before(Call::SyncFolder)
}

/// A new file of a name that no other has, removed unless it is kept.
struct Temporary {
    path: PathBuf,
    file: File,
    is_kept: bool,
}

impl Temporary {
    /// In a folder, for its owner alone or with the mode of any new file. Two processes may have the same number, on two machines
    /// that share the folder: then the name is taken, and the next one is tried.
    fn create(folder: &Path, is_private: bool) -> io::Result<Self> {
        static NEXT: AtomicU32 = AtomicU32::new(0);
        let mut options = File::options();
        options.write(true).create_new(true);
        #[cfg(unix)]
        if is_private {
            std::os::unix::fs::OpenOptionsExt::mode(&mut options, 0o600);
        }
        #[cfg(not(unix))]
        let _ = is_private;
        loop {
            let number = NEXT.fetch_add(1, Ordering::Relaxed);
            let path = folder.join(format!(".rigidformer-{}-{number}.tmp", process::id()));
            let mut pending = pending();
            match options.open(&path) {
                Ok(file) => {
                    pending.push(path.clone());
                    return Ok(Temporary { path, file, is_kept: false });
                }
                Err(error) if error.kind() == io::ErrorKind::AlreadyExists => {}
                Err(error) => return Err(error),
            }
        }
    }
}

impl Drop for Temporary {
    fn drop(&mut self) {
        let mut pending = pending();
        if !self.is_kept {
            // What cannot be removed is left: the error of writing says more.
            let _ = fs::remove_file(&self.path);
        }
        pending.retain(|path| *path != self.path);
    }
}

#[cfg(test)]
mod tests {
    use std::string::{String, ToString};
    use std::vec;

    use super::*;

    fn names(folder: &Path) -> Vec<String> {
        let entries = fs::read_dir(folder).unwrap();
        let mut names: Vec<_> =
            entries.map(|entry| entry.unwrap().file_name().into_string().unwrap()).collect();
        names.sort();
        names
    }

    /// Writes with a file system whose n-th call fails, for all n until nothing fails; after each failure `check` looks.
    fn each_call_fails(files: &[(&Path, &[u8])], mut check: impl FnMut(Call, WriteFileError)) {
        for n in 0.. {
            let (mut calls, mut failed) = (0, None);
            let done = write_all(files, &mut |call| {
                calls += 1;
                if calls <= n || failed.is_some() {
                    return Ok(());
                }
                failed = Some(call);
                Err(io::Error::other("no such luck"))
            });
            match (done, failed) {
                (Err(error), Some(call)) => check(call, error),
                (Ok(()), None) => return,
                (done, failed) => panic!("{failed:?}: {done:?}"),
            }
        }
    }

    #[test]
    fn whichever_call_fails_the_old_file_is_whole_and_nothing_is_left() {
        for old in [None, Some(b"old".as_slice())] {
            let folder = tempfile::tempdir().unwrap();
            let path = folder.path().join("model.rfm");
            if let Some(old) = old {
                fs::write(&path, old).unwrap();
            }
            let mut seen = vec![];
            each_call_fails(&[(&path, b"new")], |call, error| {
                seen.push(call);
                assert!(error.to_string().contains("model.rfm"), "{error}");
                let after = if call == Call::SyncFolder { Some(b"new".as_slice()) } else { old };
                assert_eq!(fs::read(&path).ok().as_deref(), after, "{call:?}");
                assert_eq!(names(folder.path()).len(), usize::from(after.is_some()), "{call:?}");
                match old {
                    Some(old) => fs::write(&path, old).unwrap(),
                    None => drop(fs::remove_file(&path)),
                }
            });
            let permit = usize::from(old.is_some());
            assert_eq!(seen.len(), 5 + permit, "{seen:?}");
            assert_eq!(fs::read(&path).unwrap(), b"new");
        }
    }

    #[test]
    fn whichever_call_fails_all_files_are_old_or_all_are_new() {
        let folder = tempfile::tempdir().unwrap();
        fs::create_dir(folder.path().join("more")).unwrap();
        let paths = ["a", "b", "more/c"].map(|name| folder.path().join(name));
        let files: Vec<(&Path, &[u8])> =
            paths.iter().map(|path| (path.as_path(), b"new".as_slice())).collect();
        let reset = || {
            let _ = fs::remove_file(&paths[1]);
            fs::write(&paths[0], "old").unwrap();
            fs::write(&paths[2], "old").unwrap();
        };
        reset();
        let mut failures = 0;
        each_call_fails(&files, |call, error| {
            failures += 1;
            assert!(error.path.starts_with(folder.path()));
            let found = paths.each_ref().map(|path| fs::read_to_string(path).ok());
            let found = found.each_ref().map(Option::as_deref);
            match call {
                Call::SyncFolder => assert_eq!(found, [Some("new"); 3]),
                _ => assert_eq!(found, [Some("old"), None, Some("old")], "{call:?}"),
            }
            let left: Vec<_> = names(folder.path())
                .into_iter()
                .chain(names(&folder.path().join("more")))
                .filter(|name| name.starts_with('.'))
                .collect();
            assert!(left.is_empty(), "{call:?}: {left:?}");
            reset();
        });
        assert_eq!(failures, 4 + 3 + 4 + 2 + 3 + 2);
    }

    #[test]
    fn two_names_of_one_file_are_refused() {
        let folder = tempfile::tempdir().unwrap();
        let (a, same) = (folder.path().join("a"), folder.path().join("./a"));
        let error = write_all_atomically(&[(&a, b"1"), (&same, b"2")]).unwrap_err();
        assert!(error.to_string().contains("two results"), "{error}");
        assert!(names(folder.path()).is_empty());
    }

    #[test]
    #[cfg(unix)]
    fn links_are_followed_and_modes_survive() {
        use std::os::unix::fs::{PermissionsExt, symlink};
        let folder = tempfile::tempdir().unwrap();
        let path = |name: &str| folder.path().join(name);
        fs::create_dir(path("elsewhere")).unwrap();
        for (mode, name) in [(0o600, "private"), (0o640, "group"), (0o666, "all"), (0o755, "run")] {
            fs::write(path(name), "old").unwrap();
            fs::set_permissions(path(name), fs::Permissions::from_mode(mode)).unwrap();
            write_atomically(&path(name), b"new").unwrap();
            let found = fs::metadata(path(name)).unwrap().permissions().mode();
            assert_eq!(found & 0o7777, mode, "{name}");
        }
        for (link, to) in [("one", "elsewhere/file"), ("two", "one"), ("dangling", "elsewhere/new")]
        {
            symlink(to, path(link)).unwrap();
            write_atomically(&path(link), link.as_bytes()).unwrap();
            assert!(fs::symlink_metadata(path(link)).unwrap().is_symlink(), "{link}");
            assert_eq!(fs::read(path(link)).unwrap(), link.as_bytes());
        }
        assert_eq!(fs::read(path("elsewhere/file")).unwrap(), b"two");
        assert_eq!(
            destination(&path("two")).unwrap(),
            destination(&path("elsewhere/file")).unwrap()
        );
        symlink("round", path("round")).unwrap();
        let error = write_atomically(&path("round"), b"x").unwrap_err();
        assert!(error.to_string().contains("circle"), "{error}");
    }

    #[test]
    #[cfg(unix)]
    fn devices_are_written_into() {
        use std::os::unix::fs::FileTypeExt;
        write_atomically(Path::new("/dev/null"), b"nothing").unwrap();
        assert!(fs::metadata("/dev/null").unwrap().file_type().is_char_device());
        #[cfg(target_os = "linux")]
        {
            let error = write_atomically(Path::new("/dev/full"), b"much").unwrap_err();
            assert!(error.to_string().starts_with("/dev/full"), "{error}");
        }
        assert!(is_stdout(Path::new("/dev/stdout")));
        assert!(!is_stdout(Path::new("/dev/null")));
    }
}
