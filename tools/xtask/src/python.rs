//! The Python wheel: pip builds and installs it, pytest tests it, stubtest compares its types with the module. Its source distribution
//! builds, too. The lab's videos are tested beside it: they need its predictions, and no PyTorch.

use std::env;
use std::fs;
use std::path::{Path, PathBuf};
use std::process::Command;

use anyhow::{Context, Result, ensure};

use crate::package::LICENCES;
use crate::process::{cargo, line, output, run as run_command, target};
use crate::report::{Missing, Report};
use crate::{apt, tools};

pub(crate) const MANIFEST: &str = "bindings/python/Cargo.toml";
/// Versions of what tests need.
const CONSTRAINTS: &str = "bindings/python/tests/constraints.txt";

/// A linker for an old glibc.
const ZIG: &str = "ziglang";
/// Of the wheel, at most.
const MOST_BYTES: u64 = 9_000_000;

/// Tells tests in Python that what they need is there.
pub(crate) const COMPLETE: &str = "RIGIDFORMER_COMPLETE";

/// What the lab's videos take besides.
const OF_VIDEOS: [&str; 4] = ["av", "safetensors", "scipy", "tqdm"];
/// Their tests.
const VIDEOS: &str = "tools/lab/tests/test_controls.py";

/// Installs the wheel into an environment of its own and runs its tests and its example; then the same bits from the source distribution.
pub(crate) fn run(report: &mut Report) -> Result<()> {
    wheel(report)?;
    if report.skips() == 0 { source_distribution(report) } else { Ok(()) }
}

/// Builds the wheel for manylinux2014 without a container: zig links for an old glibc, and maturin looks at what is linked. Its bits
/// are those of the program.
pub(crate) fn release(report: &mut Report) -> Result<()> {
    let Some(place) = Place::ready(&[ZIG], report)? else { return Ok(()) };
    let (out, installed) = (place.folder.join("release"), place.folder.join("released"));
    for folder in [&out, &installed] {
        if folder.exists() {
            fs::remove_dir_all(folder).context("cannot remove the last wheel")?;
        }
    }
    let mut build = place.python();
    build.args(["-m", "maturin", "build", "--release", "--locked", "--zig"]);
    build.args(["--compatibility", "manylinux2014", "--manifest-path", MANIFEST, "--out"]);
    // zig is a package of the environment, and not of the `python3` of PATH, which maturin asks first.
    build.env("CARGO_ZIGBUILD_PYTHON_PATH", place.venv.join("bin/python"));
    shown(build.arg(&out).env("CARGO_TARGET_DIR", place.folder.join("build-release")))?;
    let mut files = fs::read_dir(&out)?.filter_map(|entry| Some(entry.ok()?.path()));
    let wheel = files.find(|path| path.extension().is_some_and(|end| end == "whl"));
    let wheel = wheel.context("maturin made no wheel")?;
    let name = wheel.file_name().unwrap_or_default().to_string_lossy().into_owned();
    ensure!(name.contains("manylinux2014"), "{name} is for another Linux");
    let bytes = fs::metadata(&wheel)?.len();
    println!("{name}: {bytes} bytes");
    ensure!(bytes <= MOST_BYTES, "{name} is larger than {MOST_BYTES} bytes");
    let mut install = place.python();
    install.args(["-m", "pip", "install", "--no-deps", "--target"]).arg(&installed).arg(&wheel);
    shown(&mut install)?;
    has_licences(&installed)?;
    let mut tests = place.pytest();
    tests.arg("bindings/python/tests/test_bits.py").env("PYTHONPATH", &installed);
    shown(tests.env("RIGIDFORMER_PROGRAM", program()?))
}

/// Lints, builds and installs the wheel, and runs its tests and its example.
pub(crate) fn wheel(report: &mut Report) -> Result<()> {
    let Some(place) = Place::ready(&[], report)? else { return Ok(()) };
    let mut clippy = cargo();
    clippy.args(["clippy", "--manifest-path", MANIFEST, "--release", "--locked"]);
    shown(place.build(clippy.args(["--", "--deny", "warnings"])))?;
    let mut install = place.python();
    install.args(["-m", "pip", "install", "--constraint", CONSTRAINTS, "./bindings/python[test]"]);
    shown(place.build(&mut install))?;

    // The same scenes by the program, for the bits.
    let program = program()?;
    let mut tests = place.pytest();
    // From another folder: the tests are of what is installed.
    shown(tests.arg("bindings/python/tests").env("RIGIDFORMER_PROGRAM", &program))?;
    let folder = &place.folder;
    shown(place.python().args(["-m", "mypy.stubtest", "rigidformer"]).current_dir(folder))?;
    let example = env::current_dir()?.join("bindings/python/examples/plot.py");
    shown(place.python().arg(example).current_dir(folder).env("MPLBACKEND", "Agg"))
}

/// The program as the tests build it, with all its features; beside it are examples. After the tests there is nothing to build.
pub(crate) fn program() -> Result<PathBuf> {
    shown(cargo().args(["test", "--workspace", "--no-run", "--quiet"]))?;
    Ok(target().canonicalize()?.join("debug/rigidformer"))
}

/// Packs the sources, builds a wheel of nothing but them, and compares its bits with the program's. The lab's videos use that wheel.
pub(crate) fn source_distribution(report: &mut Report) -> Result<()> {
    let Some(place) = Place::ready(&OF_VIDEOS, report)? else { return Ok(()) };
    let folder = place.folder.join("sdist");
    from_source_distribution(&place, &folder, &program()?)?;
    let mut videos = place.pytest();
    shown(videos.arg(VIDEOS).env("PYTHONPATH", folder.join("installed")))
}

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
    let mut tests = place.pytest();
    tests.arg("bindings/python/tests/test_bits.py");
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
    folder: PathBuf,
    venv: PathBuf,
    build: PathBuf,
}

impl Place {
    /// Makes the environment with `more` packages, or notes why it cannot be had.
    fn ready(more: &[&str], report: &mut Report) -> Result<Option<Place>> {
        if let Err(missing) = apt::ensure(&[tools::PYTHON]) {
            report.skip(missing);
            return Ok(None);
        }
        let folder = target().join("python");
        fs::create_dir_all(&folder).context("cannot make a folder")?;
        let folder = folder.canonicalize()?;
        let place = Place { venv: folder.join("venv"), build: folder.join("build"), folder };
        shown(Command::new("python3").args(["-m", "venv", "--clear"]).arg(&place.venv))?;
        // What the wheel needs from a registry; that a build fails is no reason to skip it.
        let mut needed = place.python();
        needed.args(["-m", "pip", "install", "--quiet", "--constraint", CONSTRAINTS]);
        needed.args(["numpy", "maturin", "pytest", "mypy", "matplotlib", "gymnasium"]).args(more);
        if let Err(error) = output(&mut needed) {
            let remedy =
                format!("give pip a network, or wheels by PIP_FIND_LINKS; then {}", line(&needed));
            report.skip(Missing::new(format!("{error:#}"), remedy));
            return Ok(None);
        }
        Ok(Some(place))
    }

    /// pytest of the environment. All that its tests need is there, so a skip for want of it is a failure.
    fn pytest(&self) -> Command {
        let mut command = self.python();
        command.args(["-m", "pytest", "-p", "no:cacheprovider"]).env(COMPLETE, "1");
        command
    }

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

fn shown(command: &mut Command) -> Result<()> {
    println!("{}", line(command));
    run_command(command)
}
