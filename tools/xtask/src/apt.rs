//! Programs from the machine's own package sources, and proof that they work.

use std::env;
use std::fs;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};

use anyhow::{Context, Result, bail};

use crate::process::{line, output, run as run_command};
use crate::report::Missing;
use crate::sources::files;

/// A program that a check needs.
#[derive(Clone, Copy)]
pub(crate) struct Tool {
    pub(crate) name: &'static str,
    /// All that it needs; packages that are merely recommended are not installed.
    pub(crate) packages: &'static [&'static str],
    /// Whether it also runs from a folder of its own, by [`program`].
    pub(crate) movable: bool,
    /// Uses the program in an empty folder as the check will: a program may be there without its headers.
    pub(crate) proof: fn(&Path) -> Result<()>,
}

/// Makes sure that tools work, or tells why they cannot be had and what to do by hand.
pub(crate) fn ensure(tools: &[Tool]) -> std::result::Result<(), Missing> {
    let fails = |tool: &Tool| prove(tool).err().map(|error| (*tool, format!("{error:#}")));
    let missing: Vec<(Tool, String)> = tools.iter().filter_map(fails).collect();
    let Some((tool, error)) = missing.first() else {
        return Ok(());
    };
    let why = format!("{} does not work: {error}", tool.name);
    let mut packages: Vec<&str> = Vec::new();
    for package in missing.iter().flat_map(|(tool, _)| tool.packages) {
        if !packages.contains(package) {
            packages.push(package);
        }
    }
    // What a check wants is never worth a package of the user's.
    let mut apt = Command::new("apt-get");
    apt.args(["install", "--yes", "--no-remove", "--no-install-recommends"]).args(&packages);
    apt.env("DEBIAN_FRONTEND", "noninteractive").stdin(Stdio::null());
    if let Err(reason) = is_root_with_apt() {
        return Err(Missing::new(format!("{why}; {reason}"), line(&apt)));
    }
    println!("{why}\n{}", line(&apt));
    // Lists that were never fetched make the first attempt fail.
    let installed = run_command(&mut apt)
        .or_else(|_| run_command(Command::new("apt-get").arg("update").stdin(Stdio::null())))
        .and_then(|()| run_command(&mut apt));
    if let Err(error) = installed {
        if missing.iter().any(|(tool, _)| !tool.movable) {
            return Err(Missing::new(format!("{why}; {error:#}"), line(&apt)));
        }
        let names: Vec<&str> = missing.iter().map(|(tool, _)| tool.name).collect();
        println!("{error:#}; unpacking {} into {}", names.join(", "), private().display());
        unpack(&packages, &names).map_err(|unpacking| {
            Missing::new(format!("{why}; {error:#}; unpacked instead: {unpacking:#}"), line(&apt))
        })?;
    }
    for (tool, _) in &missing {
        prove(tool).map_err(|error| {
            let why = format!("{} does not work, although apt has it: {error:#}", tool.name);
            Missing::new(why, line(&apt))
        })?;
    }
    Ok(())
}

/// How to start a program that may have been unpacked instead of installed.
pub(crate) fn program(name: &str) -> PathBuf {
    let unpacked = private().join("bin").join(name);
    if unpacked.is_file() { unpacked } else { name.into() }
}

/// Where packages are unpacked that cannot be installed beside the user's.
fn private() -> PathBuf {
    let target = env::var_os("CARGO_TARGET_DIR").unwrap_or_else(|| "target".into());
    // From every folder.
    env::current_dir().unwrap_or_default().join(target).join("packages")
}

/// Unpacks packages and what they depend on, and writes scripts that start their programs. Nothing is installed and
/// nothing removed: a package that the machine has may be at odds with the one that is wanted.
fn unpack(packages: &[&str], programs: &[&str]) -> Result<()> {
    let folder = private();
    let (archives, root, bin) = (folder.join("archives"), folder.join("root"), folder.join("bin"));
    for folder in [&archives.join("partial"), &root, &bin] {
        fs::create_dir_all(folder).with_context(|| format!("cannot make {}", folder.display()))?;
    }
    let mut download = Command::new("apt-get");
    download.args(["install", "--download-only", "--yes", "--no-install-recommends"]);
    download.arg("-o").arg(format!("Dir::Cache::Archives={}", archives.display()));
    // The folder belongs to root alone.
    download.args(["-o", "APT::Sandbox::User=root"]).args(packages).stdin(Stdio::null());
    run_command(&mut download)?;
    for archive in
        files(&archives)?.iter().filter(|path| path.extension().is_some_and(|e| e == "deb"))
    {
        run_command(Command::new("dpkg").arg("--extract").arg(archive).arg(&root))?;
    }
    let mut libraries = Vec::new();
    for lib in ["lib", "usr/lib"] {
        let folders = files(&root.join(lib))?.into_iter();
        libraries.extend(folders.filter(|path| path.to_string_lossy().ends_with("-linux-gnu")));
    }
    let libraries = env::join_paths(libraries).context("cannot list folders of libraries")?;
    for name in programs {
        let program = root.join("usr/bin").join(name);
        if !program.is_file() {
            bail!("the packages have no {name}");
        }
        let script = format!(
            "#!/bin/sh\nLD_LIBRARY_PATH='{}' exec '{}' \"$@\"\n",
            libraries.to_string_lossy(),
            program.display()
        );
        let path = bin.join(name);
        fs::write(&path, script).with_context(|| format!("cannot write {}", path.display()))?;
        run_command(Command::new("chmod").arg("+x").arg(&path))?;
    }
    Ok(())
}

fn prove(tool: &Tool) -> Result<()> {
    let folder = tempfile::tempdir()?;
    (tool.proof)(folder.path())
}

/// Whether packages can be had, or why not.
pub(crate) fn is_root_with_apt() -> std::result::Result<(), &'static str> {
    let works = |program: &str| output(Command::new(program).arg("--version")).is_ok();
    if !works("apt-get") || !works("apt-cache") || !works("dpkg") {
        return Err("this machine has no apt");
    }
    if is_root() { Ok(()) } else { Err("this is not root") }
}

/// Whether this program may install and mount.
pub(crate) fn is_root() -> bool {
    output(Command::new("id").arg("-u")).is_ok_and(|user| user.trim() == "0")
}
