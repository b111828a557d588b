//! The Python wheel: pip builds and installs it, pytest tests it, stubtest compares its types with the module. Its source distribution
//! builds, too. The lab's videos are tested beside it: they need its predictions, and no PyTorch.

use std::env;
use std::fs;
use std::path::{Path, PathBuf};
use std::process::Command;

use anyhow::{Context, Result, ensure};

use crate::package::LICENCES;
use crate::process::{cargo, line, output, run as run_command};
use crate::report::{Missing, Report};
use crate::{apt, tools};

const MANIFEST: &str = "bindings/python/Cargo.toml";
/// Versions of what tests need.
const CONSTRAINTS: &str = "bindings/python/tests/constraints.txt";

/// What the lab's videos take besides.
const OF_VIDEOS: [&str; 4] = ["av", "safetensors", "scipy", "tqdm"];
/// Their tests.
const VIDEOS: &str = "tools/lab/tests/test_controls.py";

/// Installs the wheel into an environment of its own and runs its tests and its example.
pub(crate) fn run(report: &mut Report) -> Result<()> {
    if let Err(missing) = apt::ensure(&[tools::PYTHON]) {
        report.skip(missing);
        return Ok(());
    }
    let folder = target().join("python");
    fs::create_dir_all(&folder).context("cannot make a folder")?;
    let folder = folder.canonicalize()?;
    let place = Place { venv: folder.join("venv"), build: folder.join("build") };
    shown(Command::new("python3").args(["-m", "venv", "--clear"]).arg(&place.venv))?;
    // What the wheel needs from a registry; that a build fails is no reason to skip it.
    let mut needed = place.python();
    needed.args(["-m", "pip", "install", "--quiet", "--constraint", CONSTRAINTS]);
    needed.args(["numpy", "maturin", "pytest", "mypy", "matplotlib"]).args(OF_VIDEOS);
    if let Err(error) = output(&mut needed) {
        let remedy =
            format!("give pip a network, or wheels by PIP_FIND_LINKS; then {}", line(&needed));
        report.skip(Missing::new(format!("{error:#}"), remedy));
        return Ok(());
    }
    for arguments in [&["fmt", "--check"][..], &["clippy", "--release", "--locked"]] {
        let [name, rest @ ..] = arguments else { continue };
        let mut command = cargo();
        command.arg(name).args(["--manifest-path", MANIFEST]).args(rest);
        if *name == "clippy" {
            command.args(["--", "--deny", "warnings"]);
        }
        shown(place.build(&mut command))?;
    }
    let mut install = place.python();
    install.args(["-m", "pip", "install", "--constraint", CONSTRAINTS, "./bindings/python[test]"]);
    shown(place.build(&mut install))?;

    // The same scenes by the program, for the bits.
    let mut build = cargo();
    build.args(["build", "--release", "--features", "rigidformer-cli/full"]);
    build.args(["--package", "rigidformer-cli", "--bin", "rigidformer"]);
    build.args(["--package", "rigidformer-planning", "--example", "walk"]);
    shown(&mut build)?;
    let program = target().canonicalize()?.join("release/rigidformer");
    let mut tests = place.python();
    // From another folder: the tests are of what is installed.
    tests.args(["-m", "pytest", "-p", "no:cacheprovider", "bindings/python/tests"]);
    shown(tests.env("RIGIDFORMER_PROGRAM", &program))?;
    shown(place.python().args(["-m", "pytest", "-p", "no:cacheprovider", VIDEOS]))?;
    from_source_distribution(&place, &folder.join("sdist"), &program)?;
    shown(place.python().args(["-m", "mypy.stubtest", "rigidformer"]).current_dir(&folder))?;
    let example = env::current_dir()?.join("bindings/python/examples/plot.py");
    shown(place.python().arg(example).current_dir(&folder).env("MPLBACKEND", "Agg"))
}

/// Packs the sources, builds a wheel of nothing but them, and compares its bits with the program's.
fn from_source_distribution(place: &Place, folder: &Path, program: &Path) -> Result<()> {
    if folder.exists() {
        fs::remove_dir_all(folder).context("cannot remove the last source distribution")?;
    }
    let (unpacked, installed) = (folder.join("unpacked"), folder.join("installed"));
    fs::create_dir_all(&unpacked).context("cannot make a folder")?;
    let mut pack = place.python();
    pack.args(["-m", "maturin", "sdist", "--manifest-path", MANIFEST, "--out"]).arg(folder);
    shown(&mut pack)?;
    let mut files = fs::read_dir(folder)?.filter_map(|entry| Some(entry.ok()?.path()));
    let archive = files.find(|path| path.extension().is_some_and(|end| end == "gz"));
    let archive = archive.context("maturin made no source distribution")?;
    // With the time of now: the archive's, the same for all versions of a file, would tell cargo that nothing has changed. Always in
    // the same folder, so that cargo replaces what it built last.
    let mut unpack = Command::new("tar");
    unpack.args(["--extract", "--touch", "--strip-components=1", "--file"]).arg(&archive);
    shown(unpack.arg("--directory").arg(&unpacked))?;
    let mut install = place.python();
    install.args(["-m", "pip", "install", "--no-deps", "--target"]).arg(&installed).arg(&unpacked);
    shown(place.build(&mut install))?;
    has_licences(&installed)?;
    let mut tests = place.python();
    tests.args(["-m", "pytest", "-p", "no:cacheprovider", "bindings/python/tests/test_bits.py"]);
    shown(tests.env("PYTHONPATH", &installed).env("RIGIDFORMER_PROGRAM", program))
}

/// Both licences ask that their texts go with every copy; the wheel has them from the sources.
fn has_licences(installed: &Path) -> Result<()> {
    let mut entries = fs::read_dir(installed)?.filter_map(|entry| Some(entry.ok()?.path()));
    let about = entries.find(|path| path.extension().is_some_and(|end| end == "dist-info"));
    let about = about.context("the wheel has no metadata")?;
    for licence in LICENCES {
        let text = about.join("licenses").join(licence);
        let said = fs::read_to_string(&text);
        let said = said.with_context(|| format!("the wheel has no {}", text.display()))?;
        ensure!(said == fs::read_to_string(licence)?, "{} is another text", text.display());
    }
    Ok(())
}

/// Where things are, absolute.
struct Place {
    venv: PathBuf,
    build: PathBuf,
}

impl Place {
    /// The environment's interpreter, which writes nothing beside the sources.
    fn python(&self) -> Command {
        let mut command = Command::new(self.venv.join("bin/python"));
        command.env("PYTHONDONTWRITEBYTECODE", "1").env("PIP_DISABLE_PIP_VERSION_CHECK", "1");
        command
    }

    /// Builds for the environment's interpreter, apart from the workspace.
    fn build<'c>(&self, command: &'c mut Command) -> &'c mut Command {
        command.env("CARGO_TARGET_DIR", &self.build);
        // What maturin says to PyO3: no Python is linked.
        command.env("PYO3_BUILD_EXTENSION_MODULE", "1");
        command.env("PYO3_PYTHON", self.venv.join("bin/python"))
    }
}

fn target() -> PathBuf {
    env::var_os("CARGO_TARGET_DIR").map_or_else(|| "target".into(), PathBuf::from)
}

fn shown(command: &mut Command) -> Result<()> {
    println!("{}", line(command));
    run_command(command)
}
