//! Inputs that are kept: sound ones to begin with in `fuzz/seeds/TARGET`, and what fuzzing found in an archive a target,
//! `fuzz/corpus/TARGET.zip`, since those are many and small.

use std::fs;
use std::io::{Cursor, Read, Write};
use std::path::{Path, PathBuf};

use anyhow::{Context, Result};
use zip::write::SimpleFileOptions;
use zip::{CompressionMethod, DateTime, ZipArchive, ZipWriter};

const FOLDER: &str = "fuzz/corpus";
const SEEDS: &str = "fuzz/seeds";
/// Bytes of the inputs that an archive keeps, at most: the shortest ones.
const MOST_BYTES: usize = 512 << 10;

fn archive(target: &str) -> PathBuf {
    Path::new(FOLDER).join(format!("{target}.zip"))
}

/// The folder of a target's inputs, with those of its archive in it.
pub(super) fn unpacked(target: &str) -> Result<PathBuf> {
    let folder = Path::new(FOLDER).join(target);
    fs::create_dir_all(&folder).with_context(|| format!("cannot make {}", folder.display()))?;
    let seeds = Path::new(SEEDS).join(target);
    if seeds.is_dir() {
        for entry in fs::read_dir(&seeds)? {
            let seed = entry?.path();
            let name = seed.file_name().unwrap_or_default().to_string_lossy().into_owned();
            fs::copy(&seed, folder.join(format!("seed-{name}")))
                .with_context(|| format!("cannot copy {}", seed.display()))?;
        }
    }
    let path = archive(target);
    if !path.exists() {
        return Ok(folder);
    }
    let shown = path.display();
    let bytes = fs::read(&path).with_context(|| format!("cannot read {shown}"))?;
    let mut archive =
        ZipArchive::new(Cursor::new(bytes)).with_context(|| format!("{shown} is damaged"))?;
    for index in 0..archive.len() {
        let mut input = archive.by_index(index).with_context(|| format!("{shown} is damaged"))?;
        let mut bytes = Vec::new();
        input.read_to_end(&mut bytes).with_context(|| format!("{shown} is damaged"))?;
        fs::write(folder.join(format!("kept-{index:05}")), bytes)?;
    }
    Ok(folder)
}

/// Makes the archive of a folder's inputs, the shortest first; how many, and the archive's bytes. The same inputs give the same archive.
pub(super) fn pack(target: &str, folder: &Path) -> Result<(usize, usize)> {
    let mut inputs = Vec::new();
    for entry in fs::read_dir(folder)? {
        inputs.push(fs::read(entry?.path())?);
    }
    inputs.sort_by(|a, b| (a.len(), a).cmp(&(b.len(), b)));
    let mut bytes = 0;
    inputs.retain(|input| {
        bytes += input.len();
        bytes <= MOST_BYTES
    });
    let options = SimpleFileOptions::default()
        .compression_method(CompressionMethod::Deflated)
        .last_modified_time(DateTime::default());
    let mut archive = ZipWriter::new(Cursor::new(Vec::new()));
    for (index, input) in inputs.iter().enumerate() {
        archive.start_file(format!("{index:05}"), options)?;
        archive.write_all(input)?;
    }
    let bytes = archive.finish()?.into_inner();
    let path = self::archive(target);
    let temporary = path.with_extension("zip.tmp");
    fs::write(&temporary, &bytes)?;
    fs::rename(&temporary, &path)?;
    Ok((inputs.len(), bytes.len()))
}
