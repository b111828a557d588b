//! Libraries, header and what finds them, under a prefix.

use std::collections::BTreeSet;
use std::fs;
use std::path::Path;
use std::process::Command;

use anyhow::{Context, Result};

use super::{licences, target};
use crate::process::{cargo, run};

/// The libraries of this machine. The number in their names is RF_ABI_VERSION.
const SONAME: &str = "librigidformer.so.5";

/// Below `bindings/c/include`.
const HEADERS: [&str; 2] = ["rigidformer.h", "rigidformer_tracker.h"];

/// Features of the libraries for Linux: all.
const HOST: &str = "tracker";

/// Builds the libraries for this machine and copies everything that an application needs.
pub(super) fn host(prefix: &Path) -> Result<()> {
    let mut build = cargo();
    build.args(["rustc", "--quiet", "--package", "rigidformer-capi", "--lib", "--release"]);
    build.args(["--features", HOST, "--crate-type", "cdylib,staticlib"]);
    build.args(["--", "-C", &format!("link-arg=-Wl,-soname,{SONAME}")]);
    run(&mut build).context("the libraries must build")?;

    let built = target().join("release");
    let lib = prefix.join("lib");
    copy(&built.join("librigidformer_capi.so"), &lib.join(SONAME))?;
    seal(&built, &lib.join("librigidformer.a"))?;
    let link = lib.join("librigidformer.so");
    let _ = fs::remove_file(&link);
    #[cfg(unix)]
    std::os::unix::fs::symlink(SONAME, &link).context("cannot link the library's name")?;

    for header in HEADERS {
        copy(&Path::new("bindings/c/include").join(header), &prefix.join("include").join(header))?;
    }
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
    licences::write(Path::new("."), &doc, HOST, &targets)?;
    println!("{}: header, libraries, pkg-config and CMake files, licences", prefix.display());
    Ok(())
}

/// Writes the static library with one object in it, of which only the functions of the headers are global. A second static library
/// of Rust has its own copy of the standard library, with the same names.
fn seal(built: &Path, to: &Path) -> Result<()> {
    let mut names = BTreeSet::new();
    for header in HEADERS {
        let path = Path::new("bindings/c/include").join(header);
        let text =
            fs::read_to_string(&path).with_context(|| format!("cannot read {}", path.display()))?;
        names.extend(functions(&text).map(str::to_owned));
    }
    let objects = ["rigidformer_joined.o", "rigidformer_sealed.o"].map(|name| built.join(name));
    let [joined, sealed] = &objects;
    // Groups would be kept once in a program, with names of one library that the other cannot see.
    let mut link = Command::new("ld");
    link.args(["-r", "--force-group-allocation", "--gc-sections"]);
    names.iter().for_each(|name| {
        link.args(["-u", name]);
    });
    run(link.arg("-o").arg(joined).arg(built.join("librigidformer_capi.a")))?;
    let mut hide = Command::new("objcopy");
    hide.args(["--strip-debug", "--remove-section", ".llvmbc", "--remove-section", ".llvmcmd"]);
    hide.args(["--wildcard", "--keep-global-symbol", "rf_*"]).arg(joined).arg(sealed);
    run(&mut hide)?;
    if let Some(folder) = to.parent() {
        fs::create_dir_all(folder).with_context(|| format!("cannot make {}", folder.display()))?;
    }
    // `ar` would add to one that is there.
    let _ = fs::remove_file(to);
    run(Command::new("ar").arg("crsD").arg(to).arg(sealed))?;
    objects.iter().for_each(|object| {
        let _ = fs::remove_file(object);
    });
    Ok(())
}

/// The functions that a header declares or names.
fn functions(header: &str) -> impl Iterator<Item = &str> {
    let calls = header.split('(').filter_map(|before| {
        before.rsplit(|c: char| c != '_' && !c.is_ascii_alphanumeric()).next()
    });
    calls.filter(|name| name.starts_with("rf_"))
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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn functions_of_a_header_are_found() {
        let header = "/** As rf_b. */\nrf_status rf_a(int x,\n  int y);\nconst char *rf_version(void);\nint f(void);";
        assert_eq!(functions(header).collect::<Vec<_>>(), ["rf_a", "rf_version"]);
    }
}
