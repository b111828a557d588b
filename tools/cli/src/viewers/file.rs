//! The options of the commands, and the files that they ask for.

use std::path::{Path, PathBuf};

use super::moving::Moving;
#[cfg(feature = "viewers")]
use super::{gltf, html, mcap};
use crate::arguments::Viewers as Asked;
use crate::output;
use crate::usage::{Usage, missing};

/// Makes a file's bytes.
type Writer = fn(&Moving) -> anyhow::Result<Vec<u8>>;

/// Nothing calls it: whoever asks for a file gets an error.
#[cfg(not(feature = "viewers"))]
const NONE: Writer = |_| Err(missing("--mcap, --gltf, --html", "viewers").into());
#[cfg(not(feature = "viewers"))]
const ALL: [Writer; 3] = [NONE; 3];
#[cfg(feature = "viewers")]
const ALL: [Writer; 3] = [mcap::file, gltf::file, html::file];

/// The files that the command line asks for.
pub struct Viewers<'a> {
    files: Vec<(&'static str, &'a Path, Writer)>,
}

impl<'a> Viewers<'a> {
    /// Looks where the files go, so that a path that cannot be written costs no computation.
    ///
    /// # Errors
    /// When a file cannot be written there, or this program writes none.
    pub fn open(asked: &'a Asked) -> anyhow::Result<Viewers<'a>> {
        let [mcap, gltf, html] = ALL;
        let all = [
            ("--mcap", &asked.mcap, mcap),
            ("--gltf", &asked.gltf, gltf),
            ("--html", &asked.html, html),
        ];
        let mut files: Vec<(_, &Path, _)> = Vec::new();
        for (option, path, writer) in all {
            let Some(path) = path else { continue };
            if cfg!(not(feature = "viewers")) {
                return Err(missing(option, "viewers").into());
            }
            let folder = path.parent().filter(|folder| !folder.as_os_str().is_empty());
            let shown = path.display();
            let problem = if path.is_dir() {
                Some(format!("{option} {shown}: is a folder; name a file in it"))
            } else if folder.is_some_and(|folder| !folder.is_dir()) {
                Some(format!("{option} {shown}: its folder does not exist; make it first"))
            } else {
                None
            };
            if let Some(problem) = problem {
                return Err(Usage(problem).into());
            }
            files.push((option, path, writer));
        }
        let viewers = Viewers { files };
        output::distinct(viewers.paths())?;
        Ok(viewers)
    }

    /// The options that are given, and their files.
    pub(crate) fn paths(&self) -> impl Iterator<Item = (&'static str, &'a Path)> {
        self.files.iter().map(|(option, path, _)| (*option, *path))
    }

    /// Refuses to write over what the command reads.
    ///
    /// # Errors
    /// When a file is one of the inputs.
    pub fn apart_from<'p>(
        &self,
        inputs: impl IntoIterator<Item = &'p Path> + Clone,
    ) -> anyhow::Result<()> {
        for (option, path, _) in &self.files {
            output::apart(option, path, inputs.clone())?;
        }
        Ok(())
    }

    /// Whether any file is asked for.
    pub fn is_asked(&self) -> bool {
        !self.files.is_empty()
    }

    /// Writes the files, all or none; `quiet` where stdout is for JSON.
    ///
    /// # Errors
    /// When a file cannot be made or written.
    pub fn write(&self, moving: &Moving, quiet: bool) -> anyhow::Result<()> {
        output::write_results(&self.made(moving)?, quiet)
    }

    /// The files and their bytes.
    ///
    /// # Errors
    /// When a file cannot be made.
    pub fn made(&self, moving: &Moving) -> anyhow::Result<Vec<(PathBuf, Vec<u8>)>> {
        if let Some((option, path, _)) = self.files.first().filter(|_| moving.frames().is_empty()) {
            let path = path.display();
            anyhow::bail!(
                "{option} {path}: no frame is there to show; give a scene or a recording that has some"
            );
        }
        if self.is_asked() && moving.units.iter().any(|unit| unit.is_soft) {
            output::note(
                "soft units do not bend in viewers: they keep their shape at rest, in the pose that fits best",
            );
        }
        self.files.iter().map(|(_, path, writer)| Ok((path.into(), writer(moving)?))).collect()
    }
}
