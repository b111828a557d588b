//! Room for what checks build: a disk that fills half way leaves errors of compilers and linkers.

use std::path::Path;
use std::process::Command;

use anyhow::{Context, Result, ensure};

use crate::process::output;

/// What a change needs, in MiB: 5,483 of the program and the tests in the release profile, 1,985 of the tests in their own, 1,080 with
/// AddressSanitizer, 1,000 of the Python wheel and its environment.
pub(crate) const CHANGE_MIB: u64 = 10_000;
/// What a release needs.
pub(crate) const FULL_MIB: u64 = 15_500;

/// Refuses to begin where a folder's disk has no room for `needed_mib`, what the folder has included.
pub(crate) fn ensure_room(folder: &Path, needed_mib: u64) -> Result<()> {
    std::fs::create_dir_all(folder).with_context(|| format!("cannot make {}", folder.display()))?;
    let free = output(Command::new("df").arg("-Pk").arg(folder))?;
    let free_mib = free_kib(&free).context("df does not say what is free")? / 1024;
    let have = output(Command::new("du").arg("-sk").arg(folder))?;
    let have_mib = first_number(&have).context("du does not say how large a folder is")? / 1024;
    ensure!(
        free_mib + have_mib >= needed_mib,
        "{} has {free_mib} MiB left on its disk, the checks take {needed_mib} ({have_mib} of them are there): free some",
        folder.display()
    );
    Ok(())
}

/// The available KiB, by POSIX's df: fourth in the second line.
fn free_kib(text: &str) -> Option<u64> {
    text.lines().nth(1)?.split_whitespace().nth(3)?.parse().ok()
}

fn first_number(text: &str) -> Option<u64> {
    text.split_whitespace().next()?.parse().ok()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_free_part_of_a_disk_is_read() {
        let said =
            "Filesystem 1024-blocks Used Available Capacity Mounted on\n/dev/vda 100 60 40 60% /\n";
        assert_eq!(free_kib(said), Some(40));
        assert_eq!(free_kib("Filesystem\n"), None);
        assert_eq!(first_number("123\ttarget\n"), Some(123));
    }

    #[test]
    fn a_full_disk_is_named() -> Result<()> {
        let folder = tempfile::tempdir()?;
        ensure_room(folder.path(), 0)?;
        let error = ensure_room(folder.path(), u64::MAX).err().map(|error| error.to_string());
        assert!(error.is_some_and(|text| text.contains("free some")));
        Ok(())
    }
}
