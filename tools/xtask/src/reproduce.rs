//! Whether the C library has the same bytes whoever builds it.

use std::env;
use std::fs;
use std::path::{Path, PathBuf};
use std::process::Command;

use anyhow::{Context, Result, bail};

use crate::process::{cargo, line, output, run as run_command};

/// What C programs link.
const LIBRARIES: [(&str, &str); 2] =
    [("staticlib", "librigidformer_capi.a"), ("cdylib", "librigidformer_capi.so")];

/// Builds the libraries from a copy of the sources in each of two folders, and compares them.
pub(crate) fn run() -> Result<()> {
    let target = env::var_os("CARGO_TARGET_DIR").map_or_else(|| "target".into(), PathBuf::from);
    let folder = target.join("reproduce");
    fs::create_dir_all(&folder).context("cannot make a folder")?;
    let folder = folder.canonicalize()?;
    let mut built: Vec<Vec<Vec<u8>>> = Vec::new();
    for name in ["here", "in-another-place"] {
        let place = folder.join(name);
        copy_sources(&place.join("source"))?;
        built.push(build(&place)?);
    }
    let [first, second] = built.as_slice() else { bail!("two builds were made") };
    for ((_, file), (a, b)) in LIBRARIES.iter().zip(first.iter().zip(second)) {
        if a != b {
            let at = a.iter().zip(b).position(|(a, b)| a != b);
            bail!(
                "{file} differs between two builds, {} and {} bytes, from byte {at:?} on",
                a.len(),
                b.len()
            );
        }
        println!("{file}: {} bytes, the same twice", a.len());
    }
    // Two copies of all sources and builds take room.
    fs::remove_dir_all(&folder).context("cannot remove the builds")
}

/// What git tracks, as it is now.
fn copy_sources(to: &Path) -> Result<()> {
    let tracked = output(Command::new("git").args([
        "ls-files",
        "-z",
        "--cached",
        "--others",
        "--exclude-standard",
    ]))?;
    for path in tracked.split('\0').filter(|path| !path.is_empty() && Path::new(path).is_file()) {
        let target = to.join(path);
        if let Some(folder) = target.parent() {
            fs::create_dir_all(folder)?;
        }
        fs::copy(path, &target).with_context(|| format!("cannot copy {path}"))?;
    }
    Ok(())
}

fn build(place: &Path) -> Result<Vec<Vec<u8>>> {
    let source = place.join("source");
    let home = env::var_os("CARGO_HOME").map(PathBuf::from);
    let home = home.or_else(|| env::var_os("HOME").map(|home| PathBuf::from(home).join(".cargo")));
    let sysroot = output(Command::new("rustc").args(["--print", "sysroot"]))?;
    // Names of folders stand in panics' texts.
    let remaps = [
        (source.clone(), "/rigidformer"),
        (home.unwrap_or_default(), "/cargo"),
        (sysroot.trim().into(), "/rust"),
    ];
    let flags: Vec<String> = remaps
        .iter()
        .map(|(from, to)| format!("--remap-path-prefix={}={to}", from.display()))
        .collect();
    let target = place.join("target");
    for (kind, _) in LIBRARIES {
        let mut command = cargo();
        command.args([
            "rustc",
            "--release",
            "--locked",
            "--package",
            "rigidformer-capi",
            "--features",
            "tracker",
        ]);
        command.args(["--crate-type", kind]).current_dir(&source);
        command.env("CARGO_TARGET_DIR", &target).env("CARGO_ENCODED_RUSTFLAGS", flags.join("\x1f"));
        println!("{}", line(&command));
        run_command(&mut command)?;
    }
    let read = |(_, file): &(&str, &str)| {
        let path = target.join("release").join(file);
        fs::read(&path).with_context(|| format!("cannot read {}", path.display()))
    };
    LIBRARIES.iter().map(read).collect()
}
