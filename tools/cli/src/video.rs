//! Videos as H.264 in MP4, without loss after the conversion of colours.
//!
//! No crate encodes H.264 in Rust alone but by storing every sample of every frame. Our pictures mostly repeat: black around points, and a
//! camera that stands still. So a small encoder stores what changes and says of the rest that it does not ([`h264`]).

mod bits;
mod h264;
mod kind;
mod mp4;
mod planes;

use std::io::{Seek, SeekFrom, Write};
use std::path::{Path, PathBuf};

use rigidformer_runtime::files::FileError;
use tempfile::NamedTempFile;

pub(crate) use kind::{Kind, Rate};
pub(crate) use planes::Colours;

use h264::Encoder;
use mp4::Track;
use planes::Planes;

/// A video that is being written, into a temporary file beside its own.
pub(crate) struct Video {
    path: PathBuf,
    file: NamedTempFile,
    kind: Kind,
    encoder: Encoder,
    /// (frames so far) Bytes.
    sizes: Vec<u32>,
}

impl Video {
    pub(crate) fn create(path: &Path, kind: Kind) -> anyhow::Result<Video> {
        let encoder = Encoder::new(&kind);
        let file = beside(path).map_err(|source| unwritable(path, source))?;
        let mut video = Video { path: path.to_owned(), file, kind, encoder, sizes: Vec::new() };
        // Room for what is known at the end.
        let head = video.head();
        video.file.write_all(&head).map_err(|source| unwritable(path, source))?;
        Ok(video)
    }

    /// Adds a frame of (height, width) red, green, blue.
    pub(crate) fn push(&mut self, pixels: &[[u8; 3]]) -> anyhow::Result<()> {
        let planes = Planes::new(pixels, self.kind.size, self.kind.colours);
        let unit = self.encoder.encode(planes);
        let length = u32::try_from(unit.len())?;
        let written =
            self.file.write_all(&length.to_be_bytes()).and_then(|()| self.file.write_all(&unit));
        written.map_err(|source| unwritable(&self.path, source))?;
        self.sizes.push(length + 4);
        Ok(())
    }

    /// Gives the file its name, and its size in bytes.
    pub(crate) fn finish(mut self) -> anyhow::Result<u64> {
        let head = self.head();
        let mut write = || {
            self.file.seek(SeekFrom::Start(0))?;
            self.file.write_all(&head)?;
            self.file.as_file().sync_all()?;
            Ok(self.file.as_file().metadata()?.len())
        };
        let bytes = write().map_err(|source| unwritable(&self.path, source))?;
        let path = self.path;
        self.file.persist(&path).map_err(|error| unwritable(&path, error.error))?;
        Ok(bytes)
    }

    /// All before the frames. It has one length whatever the sizes of frames are.
    fn head(&self) -> Vec<u8> {
        let mut sizes = self.sizes.clone();
        sizes.resize(self.kind.frames as usize, 0);
        mp4::head(&Track {
            size: self.kind.size,
            rate: self.kind.rate,
            sizes: &sizes,
            parameters: self.encoder.parameters(),
            colours: self.kind.colours,
        })
    }
}

/// A file that vanishes unless it gets a name.
fn beside(path: &Path) -> std::io::Result<NamedTempFile> {
    let folder = path.parent().filter(|folder| !folder.as_os_str().is_empty());
    let mut builder = tempfile::Builder::new();
    builder.prefix(".rigidformer-").suffix(".tmp");
    #[cfg(unix)]
    {
        use std::os::unix::fs::PermissionsExt;
        // As any new file; the umask applies. Temporary files are private otherwise.
        builder.permissions(std::fs::Permissions::from_mode(0o666));
    }
    builder.tempfile_in(folder.unwrap_or(Path::new(".")))
}

fn unwritable(path: &Path, source: std::io::Error) -> FileError {
    FileError {
        path: path.into(),
        action: "cannot be written",
        remedy: "name a file in a folder that exists, that you may write to and that has room",
        source,
    }
}
