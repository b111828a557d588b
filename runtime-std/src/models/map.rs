//! Model files in memory without a copy.

use std::fs::File;
use std::io;
use std::ops::Deref;
use std::path::Path;

/// A file, mapped for reading.
pub(super) struct Map(memmap2::Mmap);

impl Map {
    /// Maps a whole file and reads its pages.
    pub(super) fn open(path: &Path) -> io::Result<Self> {
        let file = File::open(path)?;
        // SAFETY: the map is read-only and is unmapped when it is dropped; `LoadedModel::open` requires of its
        // caller that the file is not written meanwhile.
        #[allow(unsafe_code)]
        let map = unsafe { memmap2::MmapOptions::new().populate().map(&file)? };
        Ok(Map(map))
    }
}

impl Deref for Map {
    type Target = [u8];

    fn deref(&self) -> &[u8] {
        &self.0
    }
}
