//! The C interface: libraries under a prefix, and the examples against them.

mod boards;
mod install;
mod licences;
mod linking;

use std::env;
use std::fs;
use std::path::{Path, PathBuf};
use std::process::Command;

use anyhow::{Context, Result, bail};

use crate::process::{cargo, output, run as run_command};
use crate::report::Report;
use crate::{apt, tools};

const MODEL: &str = "weights/models/nano.rfm";
const SCENE: &str = "firmware-sim/firmware/scenes/contact.bin";
/// A robot's model and its scene.
const ROBOT: [&str; 2] = ["weights/models/g1.rfm", "firmware-sim/firmware/scenes/walk.bin"];
/// A model of cloth and its scene.
const CLOTH: [&str; 2] = ["weights/models/shell.rfm", "firmware-sim/firmware/scenes/drape.bin"];
/// A model that breaks bonds.
const FRAGMENTS: [&str; 1] = ["weights/models/fragments.rfm"];
/// The model that predicts what is followed.
const TRACKS: &str = "weights/models/edge.rfm";
/// What the examples say when they are handed nonsense.
const REFUSED: &str = "bindings/c/examples/refused.out";
/// What the libraries for microcontrollers are built with where nobody says more: a panic handler, without which they do not build,
/// and what nano needs.
pub(crate) const EMBEDDED: &str = "panic-handler";
/// How docs/C.md links what pkg-config finds.
const LINK: &str = r#"$(pkg-config --cflags --libs rigidformer) -Wl,-rpath,"$(pkg-config --variable=libdir rigidformer)""#;

/// Boards: those that a change needs, or that a release needs besides.
#[derive(Clone, Copy, PartialEq)]
enum Which {
    All,
    OnAChange,
    Others,
}

/// Builds and installs the libraries, then builds and runs the examples; `bless` takes what they say
/// about nonsense as what they should.
pub(crate) fn run(prefix: Option<PathBuf>, bless: bool, report: &mut Report) -> Result<()> {
    examples(Which::All, prefix, bless, report)
}

/// This machine's examples, and one board's.
pub(crate) fn on_a_change(report: &mut Report) -> Result<()> {
    examples(Which::OnAChange, None, false, report)
}

/// The other boards' examples.
pub(crate) fn other_boards(report: &mut Report) -> Result<()> {
    examples(Which::Others, None, false, report)
}

fn examples(which: Which, prefix: Option<PathBuf>, bless: bool, report: &mut Report) -> Result<()> {
    let folder = target().join("capi");
    fs::create_dir_all(&folder).context("cannot make a folder")?;
    let folder = folder.canonicalize()?;
    let prefix = prefix.unwrap_or_else(|| folder.join("prefix"));
    fs::create_dir_all(&prefix).with_context(|| format!("cannot make {}", prefix.display()))?;
    let place = Place { prefix: prefix.canonicalize()?, folder };
    install::host(&place.prefix)?;

    let mut expected = expected(bless)?;
    if which != Which::Others {
        host(&place, &mut expected, bless, report)?;
    }
    boards::run(which, &place, &expected, report)
}

/// Installs the libraries of this machine, the header, and what finds them, and nothing else.
pub(crate) fn install(prefix: &Path) -> Result<()> {
    install::host(prefix)
}

/// Writes the licences of libraries with such features for such targets into a folder: ours, and those of the crates that
/// are in them.
pub(crate) fn licences(to: &Path, features: &str, targets: &[&str]) -> Result<()> {
    licences::write(Path::new("."), to, features, targets)
}

/// Where things are, absolute.
struct Place {
    prefix: PathBuf,
    folder: PathBuf,
}

/// What every example must print, but for measurements.
struct Expected {
    refused: String,
    poses: String,
    /// Of the scene in `bindings/c/examples/push.c`.
    roles: String,
    /// Of the robot in `bindings/c/examples/host/walk.c`.
    walk: String,
    /// Of the sheet in `bindings/c/examples/host/drape.c`.
    drape: String,
    /// Of the wall in `bindings/c/examples/host/shatter.c`.
    shatter: String,
}

/// The lines that the examples must print: recorded, and computed here and now by the core alone.
fn expected(bless: bool) -> Result<Expected> {
    let with = |model: &str, image: &str| {
        let mut command = cargo();
        command.args(["run", "--quiet", "--release", "--package", "rigidformer-tests"]);
        command.args(["--bin", "firmware", "--", model, image]);
        output(&mut command).context("the core alone must roll the scenes out")
    };
    let core = |image: &str| with(MODEL, image);
    let poses = lines(&core("contact")?, |line| line.starts_with("contact: "));
    let roles = lines(&core("roles")?, |line| line.starts_with("roles: "));
    let walk = lines(&core("walk")?, |line| line.starts_with("walk: ") && line.contains("steps"));
    let drape = lines(&core("drape")?, |line| line.contains(" steps, points "));
    let refused = if bless { Ok(String::new()) } else { fs::read_to_string(REFUSED) };
    Ok(Expected {
        refused: refused.with_context(|| format!("cannot read {REFUSED}"))?,
        poses,
        roles,
        walk,
        drape,
        shatter: with(FRAGMENTS[0], "shatter")?,
    })
}

/// Compares what an example printed.
fn compare(name: &str, printed: &str, expected: &Expected) -> Result<()> {
    let poses = lines(printed, |line| line.starts_with("contact: "));
    let refused = refused(printed);
    for (what, found, expected) in
        [("about nonsense", &refused, &expected.refused), ("as poses", &poses, &expected.poses)]
    {
        if found != expected {
            bail!("{name} prints {what}:\n{found}expected:\n{expected}all of it:\n{printed}");
        }
    }
    println!("{name}: errors as recorded, 100 steps with the bits of the core");
    Ok(())
}

/// Compares what an example printed about the scene of roles.
fn roles(name: &str, printed: &str, expected: &Expected) -> Result<()> {
    let found = lines(printed, |line| line.starts_with("roles: "));
    if found.is_empty() || found != expected.roles {
        bail!("{name} prints:\n{found}expected:\n{}all of it:\n{printed}", expected.roles);
    }
    println!("{name}: a table, a pusher and a box with the bits of the core");
    Ok(())
}

fn refused(printed: &str) -> String {
    let other = ["contact: ", "roles: ", "measured "];
    lines(printed, |line| !other.iter().any(|start| line.starts_with(start)))
}

fn lines(text: &str, keep: impl Fn(&str) -> bool) -> String {
    text.lines().filter(|line| keep(line)).map(|line| format!("{line}\n")).collect()
}

/// The C++ examples and those in C through CMake, and the small one in C through pkg-config too.
fn host(place: &Place, expected: &mut Expected, bless: bool, report: &mut Report) -> Result<()> {
    let needed = [tools::CC, tools::CXX, tools::CMAKE_TOOL, tools::PKG_CONFIG_TOOL];
    if let Err(missing) = apt::ensure(&needed) {
        report.skip_part("examples on this machine", missing);
        return Ok(());
    }
    let build = place.folder.join("host");
    let model = Path::new(MODEL).canonicalize().with_context(|| format!("no {MODEL}"))?;
    let mut configure = Command::new("cmake");
    configure.args(["-S", "bindings/c/examples/host", "-B"]).arg(&build);
    configure.arg(format!("-DCMAKE_PREFIX_PATH={}", place.prefix.display()));
    // From the examples' folder, as a reader of their first line would.
    configure.arg(format!("-DMODEL=../../../../{MODEL}"));
    output(&mut configure)?;
    output(Command::new("cmake").arg("--build").arg(&build))?;
    let printed = output(Command::new(build.join("rollout_cpp")).args([MODEL, SCENE]))?;
    if bless {
        expected.refused = refused(&printed);
        fs::write(REFUSED, &expected.refused).with_context(|| format!("cannot write {REFUSED}"))?;
        println!("{REFUSED} written");
    }
    compare("C++17, CMake, shared library", &printed, expected)?;
    let printed = output(Command::new(build.join("push_cpp")).arg(MODEL))?;
    roles("C++17, roles", &printed, expected)?;
    roles("C, roles", &output(&mut Command::new(build.join("push")))?, expected)?;
    for (name, files, wanted, refusals) in [
        ("walk", &ROBOT[..], &expected.walk, 3),
        ("drape", &CLOTH, &expected.drape, 5),
        ("shatter", &FRAGMENTS, &expected.shatter, 4),
    ] {
        let printed = output(Command::new(build.join(name)).args(files))?;
        let found = lines(&printed, |line| line.starts_with(&format!("{name}: ")));
        let errors = printed.lines().filter(|line| line.starts_with("refused: error ")).count();
        if found.is_empty() || found != *wanted || errors != refusals {
            bail!("C, {name} prints:\n{printed}expected:\n{wanted}");
        }
    }
    println!("C, a robot under command: three errors, ten steps with the bits of the core");
    println!("C, a sheet on a sphere: five errors, twelve steps with the bits of the core");
    println!("C, a wall that breaks: four errors, twenty steps with the bits of the core");
    small("C, CMake, static library", &mut Command::new(build.join("small")))?;

    let program = place.folder.join("small");
    let mut compile = Command::new("sh");
    compile.arg("-c").arg(format!("exec cc \"$@\" {LINK}")).arg("cc");
    compile.args(["-std=c11", "-Wall", "-Wextra", "-Wpedantic", "-Werror"]);
    compile.args(["bindings/c/examples/host/small.c", "bindings/c/examples/host/camera.c"]);
    compile.arg(format!("-DRF_MODEL_FILE=\"{}\"", model.display()));
    compile.arg(place.prefix.join("share/rigidformer/model.S")).arg("-o").arg(&program);
    compile.env("PKG_CONFIG_PATH", place.prefix.join("lib/pkgconfig"));
    run_command(&mut compile)?;
    // As a user's shell would: nothing but the program says where the library is.
    let mut command = Command::new(program);
    command.env_remove("LD_LIBRARY_PATH");
    small("C, pkg-config, shared library", &mut command)?;
    track(&build)?;
    linking::check(place)
}

/// The example of the tracker, which compares with the truth itself.
fn track(build: &Path) -> Result<()> {
    let printed = output(Command::new(build.join("track")).arg(TRACKS))?;
    let errors = printed.lines().filter(|line| line.starts_with("refused: error ")).count();
    if errors != 2 {
        bail!("C, track prints:\n{printed}");
    }
    print!("C, a box that falls is followed: two errors\n{printed}");
    Ok(())
}

fn small(name: &str, command: &mut Command) -> Result<()> {
    let printed = output(command)?;
    let height = printed.strip_prefix("the first one has moved up by ");
    let height = height.and_then(|rest| rest.split(' ').next()?.parse::<f32>().ok());
    match height {
        Some(height) if height.is_finite() => println!("{name}: {}", printed.trim_end()),
        _ => bail!("{name} prints {printed}"),
    }
    Ok(())
}

/// Cargo's folder.
fn target() -> PathBuf {
    env::var_os("CARGO_TARGET_DIR").unwrap_or_else(|| "target".into()).into()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_page_has_what_is_run() {
        let page = include_str!("../../../docs/C.md");
        assert!(page.contains(&format!("cc app.c {LINK}\n")), "the line of pkg-config");
        // The library by hand is one that loads nano.
        assert!(page.contains(&format!("--features {EMBEDDED} --crate-type staticlib")));
    }

    #[test]
    fn a_pose_that_differs_is_an_error() -> Result<()> {
        let printed = "no model: error 32\nmeasured stack 9\ncontact: unit 0 [1]\n";
        let expected = |refused: &str, poses: &str| Expected {
            refused: refused.into(),
            poses: poses.into(),
            roles: "roles: 1 steps, poses 1\n".into(),
            walk: String::new(),
            drape: String::new(),
            shatter: String::new(),
        };
        let (refused, poses) = ("no model: error 32\n", "contact: unit 0 [1]\n");
        compare("a", printed, &expected(refused, poses))?;
        assert!(compare("a", printed, &expected(refused, "contact: unit 0 [2]\n")).is_err());
        assert!(compare("a", printed, &expected("", poses)).is_err());
        roles("a", "roles: 1 steps, poses 1\n", &expected(refused, poses))?;
        assert!(roles("a", "roles: 1 steps, poses 2\n", &expected(refused, poses)).is_err());
        assert!(roles("a", printed, &expected(refused, poses)).is_err());
        Ok(())
    }
}
