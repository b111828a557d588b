//! The crates as a registry would get them.

use std::env;
use std::fs;
use std::path::{Path, PathBuf};

use anyhow::{Context, Result, bail, ensure};
use cargo_metadata::MetadataCommand;

use crate::install::Program;
use crate::process::{cargo, line, output, run as run_command};
use crate::report::Report;

const CYCLONEDX: Program =
    Program { name: "cargo-cyclonedx", version: Some("0.5.9"), features: &[] };
/// Name of the documents as they are written first.
const BILL: &str = "rigidformer-bill";

/// What is published.
const CRATES: [&str; 11] = [
    "rigidformer-weights",
    "rigidformer-core",
    "rigidformer-kernels",
    "rigidformer-runtime",
    "rigidformer-perception",
    "rigidformer-capi",
    "rigidformer-evaluation",
    "rigidformer-planning",
    "rigidformer-robots",
    "rigidformer-firmware-sim",
    "rigidformer-cli",
];
pub(crate) const LICENCES: [&str; 2] = ["LICENSE-APACHE", "LICENSE-MIT"];
/// Registries take no larger files.
const MOST_BYTES: u64 = 10 << 20;

/// Packs all crates and checks the sizes; `builds` each from its package alone, and writes what each is made of.
pub(crate) fn run(builds: bool, report: &mut Report) -> Result<()> {
    let mut command = cargo();
    // A check is of what is there, committed or not.
    command.args(["package", "--locked", "--allow-dirty"]);
    for name in CRATES {
        command.args(["--package", name]);
    }
    if !builds {
        command.arg("--no-verify");
    }
    println!("{}", line(&command));
    run_command(&mut command)?;
    let target = env::var_os("CARGO_TARGET_DIR").map_or_else(|| "target".into(), PathBuf::from);
    let version = env!("CARGO_PKG_VERSION");
    let metadata = MetadataCommand::new().no_deps().exec().context("cargo metadata failed")?;
    for name in CRATES {
        let path = target.join(format!("package/{name}-{version}.crate"));
        let bytes = fs::metadata(&path).with_context(|| format!("no {}", path.display()))?.len();
        println!("{name} {version}: {bytes} bytes");
        let package = metadata.packages.iter().find(|package| package.name.as_str() == name);
        let folder = package.and_then(|package| package.manifest_path.parent());
        has_licences(name, folder.with_context(|| format!("there is no {name}"))?.as_std_path())?;
        if bytes > MOST_BYTES {
            bail!(
                "{} has {bytes} bytes, registries take {MOST_BYTES}: leave files out by `exclude`",
                path.display()
            );
        }
    }
    if builds { bills(&target.join("package"), report) } else { Ok(()) }
}

/// Both licences ask that their texts go with every copy. Links lead to them, which a checkout may have as files of a path.
fn has_licences(name: &str, folder: &Path) -> Result<()> {
    let mut list = cargo();
    list.args(["package", "--locked", "--allow-dirty", "--list", "--package", name]);
    let list = output(&mut list)?;
    for licence in LICENCES {
        if !list.lines().any(|file| file == licence) {
            bail!(
                "the package of {name} has no {licence}: link it from the folder of its Cargo.toml"
            );
        }
        let is_it = fs::read(folder.join(licence)).ok() == Some(fs::read(licence)?);
        ensure!(is_it, "{licence} of {name} is another text: check out with symbolic links");
    }
    Ok(())
}

/// What each crate is made of, as CycloneDX documents beside the packages.
fn bills(folder: &Path, report: &mut Report) -> Result<()> {
    if let Err(missing) = CYCLONEDX.ensure() {
        report.skip_part("bill of materials", missing);
        return Ok(());
    }
    let mut command = cargo();
    command.args(["cyclonedx", "--format", "json", "--override-filename", BILL]);
    println!("{}", line(&command));
    run_command(&mut command)?;
    // They are written beside the manifests, of unpublished crates too.
    let metadata = MetadataCommand::new().no_deps().exec().context("cargo metadata failed")?;
    for package in metadata.workspace_packages() {
        let Some(beside) = package.manifest_path.parent() else { continue };
        let written = beside.join(format!("{BILL}.json"));
        if !written.exists() {
            continue;
        }
        if CRATES.contains(&package.name.as_str()) {
            let to = folder.join(format!("{}-{}.cdx.json", package.name, package.version));
            fs::copy(&written, &to).with_context(|| format!("cannot write {}", to.display()))?;
            println!("{}", to.display());
        }
        fs::remove_file(&written).with_context(|| format!("cannot remove {written}"))?;
    }
    Ok(())
}
