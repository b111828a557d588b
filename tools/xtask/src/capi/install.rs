//! Libraries, header and what finds them, under a prefix.

use std::fs;
use std::path::Path;

use anyhow::{Context, Result};

use super::{licences, target};
use crate::process::{cargo, run};

/// The libraries of this machine. The number in their names is RF_ABI_VERSION.
const SONAME: &str = "librigidformer.so.5";

/// Builds the libraries for this machine and copies everything that an application needs.
pub(super) fn host(prefix: &Path) -> Result<()> {
    let mut build = cargo();
    build.args(["rustc", "--quiet", "--package", "rigidformer-capi", "--lib", "--release"]);
    build.args(["--features", "std", "--crate-type", "cdylib,staticlib"]);
    build.args(["--", "-C", &format!("link-arg=-Wl,-soname,{SONAME}")]);
    run(&mut build).context("the libraries must build")?;

    let built = target().join("release");
    let lib = prefix.join("lib");
    copy(&built.join("librigidformer_capi.so"), &lib.join(SONAME))?;
    copy(&built.join("librigidformer_capi.a"), &lib.join("librigidformer.a"))?;
    let link = lib.join("librigidformer.so");
    let _ = fs::remove_file(&link);
    #[cfg(unix)]
    std::os::unix::fs::symlink(SONAME, &link).context("cannot link the library's name")?;

    copy(Path::new("bindings/c/include/rigidformer.h"), &prefix.join("include/rigidformer.h"))?;
    copy(Path::new("bindings/c/share/model.S"), &prefix.join("share/rigidformer/model.S"))?;
    let cmake = lib.join("cmake/rigidformer");
    copy(
        Path::new("bindings/c/cmake/rigidformerConfig.cmake"),
        &cmake.join("rigidformerConfig.cmake"),
    )?;
    fill("bindings/c/cmake/rigidformerConfigVersion.cmake.in", &cmake)?;
    fill("bindings/c/pkgconfig/rigidformer.pc.in", &lib.join("pkgconfig"))?;
    // Of all libraries that a prefix may get: those for microcontrollers have fewer features, and no other crates.
    let host = licences::host()?;
    let targets = [host.as_str(), "thumbv7em-none-eabihf", "thumbv8m.main-none-eabihf"];
    let doc = prefix.join("share/doc/rigidformer");
    licences::write(Path::new("."), &doc, "std", &targets)?;
    println!("{}: header, libraries, pkg-config and CMake files, licences", prefix.display());
    Ok(())
}

/// Copies a file, making folders.
pub(super) fn copy(from: &Path, to: &Path) -> Result<()> {
    if let Some(folder) = to.parent() {
        fs::create_dir_all(folder).with_context(|| format!("cannot make {}", folder.display()))?;
    }
    fs::copy(from, to)
        .with_context(|| format!("cannot copy {} to {}", from.display(), to.display()))?;
    Ok(())
}

/// Fills `@NAME@`s in, and drops `.in`.
fn fill(from: &str, folder: &Path) -> Result<()> {
    let template = fs::read_to_string(from).with_context(|| format!("cannot read {from}"))?;
    // The one version of the workspace.
    let version = env!("CARGO_PKG_VERSION");
    let major_minor = version.rsplit_once('.').map_or(version, |(start, _)| start);
    let text = template
        .replace("@VERSION@", version)
        .replace("@MAJOR_MINOR@", major_minor)
        .replace("@POINTER_BYTES@", &size_of::<usize>().to_string());
    let name = Path::new(from).file_stem().context("a template has a name")?;
    fs::create_dir_all(folder).with_context(|| format!("cannot make {}", folder.display()))?;
    let to = folder.join(name);
    fs::write(&to, text).with_context(|| format!("cannot write {}", to.display()))
}
