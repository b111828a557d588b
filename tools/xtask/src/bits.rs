//! The same bits on every processor and in every build: long rollouts, hashed, against the
//! committed hashes (`docs/BITS.md`).

use std::env;
use std::fs;
use std::path::{Path, PathBuf};
use std::process::Command;
use std::thread;

use anyhow::{Context, Result, bail};

use crate::apt::{self, Tool};
use crate::embedded::{installed_or_added, without};
use crate::process::{cargo, output, run as run_command};
use crate::report::{Missing, Report};
use crate::{rust_src, tools};

const GOLDEN: &str = "tests/data/bits.txt";

/// A processor that qemu-user plays.
struct Cross {
    target: &'static str,
    /// As Debian names it in its cross compilers.
    gnu: &'static str,
    emulator: &'static str,
    tools: [Tool; 2],
}

const CROSS: &[Cross] = &[
    Cross {
        target: "aarch64-unknown-linux-gnu",
        gnu: "aarch64-linux-gnu",
        emulator: "qemu-aarch64",
        tools: tools::AARCH64,
    },
    Cross {
        target: "riscv64gc-unknown-linux-gnu",
        gnu: "riscv64-linux-gnu",
        emulator: "qemu-riscv64",
        tools: tools::RISCV64,
    },
];

/// Compares release and debug on this machine, then the other processors; `bless` writes this
/// machine's hashes as the golden ones first.
pub(crate) fn run(bless: bool, report: &mut Report) -> Result<()> {
    builds(&[true, false], CROSS, bless, report)
}

/// The builds that a change needs: release, and a processor with kernels of its own. The tests are the debug build.
pub(crate) fn on_a_change(report: &mut Report) -> Result<()> {
    builds(&[true], &CROSS[..1], false, report)
}

/// The others: debug, and a processor that runs the portable kernels.
pub(crate) fn others(report: &mut Report) -> Result<()> {
    builds(&[false], &CROSS[1..], false, report)
}

/// Compares release builds, or debug ones, on this machine, and release builds for other processors.
fn builds(releases: &[bool], crosses: &[Cross], bless: bool, report: &mut Report) -> Result<()> {
    let mut golden = Vec::new();
    let mut faults = Vec::new();
    for &release in releases {
        run_command(&mut build(release, None)).context("the program must build")?;
        let found = output(&mut Command::new(program(release, None)))?;
        if bless && release {
            write_golden(&found)?;
        }
        if golden.is_empty() {
            golden = read_golden()?;
        }
        let name = if release { "this machine, release" } else { "this machine, debug" };
        compare(name, &golden, &found, &mut faults);
    }
    // An emulator keeps one core busy for minutes: the next program is built and run meanwhile. What fails there stops no other.
    thread::scope(|scope| {
        let mut running = Vec::new();
        for cross in crosses {
            match emulated(cross) {
                Ok(Ok(mut command)) => {
                    running.push((cross.target, scope.spawn(move || output(&mut command))));
                }
                Ok(Err(missing)) => report.skip_part(cross.target, missing),
                Err(error) => faults.push(format!("{}: {error:#}", cross.target)),
            }
        }
        for (target, found) in running {
            match found.join() {
                Ok(Ok(found)) => compare(target, &golden, &found, &mut faults),
                Ok(Err(error)) => faults.push(format!("{target}: {error:#}")),
                Err(_) => faults.push(format!("{target}: the thread of its emulator died")),
            }
        }
    });
    if !faults.is_empty() {
        bail!(
            "{}\n`bits --pack FOLDER` writes these models; `rigidformer diff` names the first layer, unit and \
             element that differ between two traces; docs/BITS.md tells how to renew {GOLDEN} after a change \
             that is meant",
            faults.join("\n")
        );
    }
    Ok(())
}

/// Adds a sentence for every line that differs.
fn compare(place: &str, golden: &[String], found: &str, faults: &mut Vec<String>) {
    let found: Vec<&str> = found.lines().collect();
    let before = faults.len();
    for expected in golden {
        let name = name_of(expected);
        match found.iter().find(|line| name_of(line) == name) {
            Some(line) if line == expected => {}
            Some(line) => {
                faults.push(format!("{place}: {name} differs:\n  {line}\n  {expected} (golden)"));
            }
            None => faults.push(format!("{place}: {name} is missing")),
        }
    }
    for line in &found {
        if !golden.iter().any(|expected| name_of(expected) == name_of(line)) {
            faults.push(format!("{place}: {GOLDEN} has no {}", name_of(line)));
        }
    }
    if faults.len() == before {
        println!("{place}: {} models, the same bits", golden.len());
    }
}

fn name_of(line: &str) -> &str {
    line.split(' ').next().unwrap_or_default()
}

fn read_golden() -> Result<Vec<String>> {
    let text = fs::read_to_string(GOLDEN).with_context(|| format!("cannot read {GOLDEN}"))?;
    let lines = text.lines().filter(|line| !line.starts_with('#') && !line.is_empty());
    let lines: Vec<String> = lines.map(str::to_owned).collect();
    if lines.is_empty() {
        bail!("{GOLDEN} has no hashes; `cargo xtask bits --bless` writes them");
    }
    Ok(lines)
}

fn write_golden(found: &str) -> Result<()> {
    let text = format!("# Written by `cargo xtask bits --bless`; docs/BITS.md explains.\n{found}");
    fs::write(GOLDEN, text).with_context(|| format!("cannot write {GOLDEN}"))
}

/// Builds the program for another processor: the command that plays it, or why that cannot be.
fn emulated(cross: &Cross) -> Result<std::result::Result<Command, Missing>> {
    if let Err(missing) = apt::ensure(&cross.tools) {
        return Ok(Err(missing));
    }
    let sysroot = output(Command::new("rustc").args(["--print", "sysroot"]))?;
    let sysroot = Path::new(sysroot.trim_end());
    let mut command = build(true, Some(cross));
    if !installed_or_added(sysroot, cross.target) {
        if let Err(missing) = rust_src::ensure(sysroot) {
            return Ok(Err(without(cross.target, missing)));
        }
        command.arg("-Zbuild-std=std,panic_abort").env("RUSTC_BOOTSTRAP", "1");
    }
    run_command(&mut command).with_context(|| format!("{} must build", cross.target))?;
    let mut command = Command::new(cross.emulator);
    command.arg("-L").arg(format!("/usr/{}", cross.gnu)).arg(program(true, Some(cross)));
    Ok(Ok(command))
}

fn build(release: bool, cross: Option<&Cross>) -> Command {
    let mut command = cargo();
    command.args(["build", "--quiet", "--package", "rigidformer-tests", "--bin", "bits"]);
    if release {
        command.arg("--release");
    }
    if let Some(cross) = cross {
        let name = cross.target.to_uppercase().replace('-', "_");
        command.args(["--target", cross.target]);
        command.env(format!("CARGO_TARGET_{name}_LINKER"), format!("{}-gcc", cross.gnu));
    }
    command
}

/// Where cargo puts the program.
fn program(release: bool, cross: Option<&Cross>) -> PathBuf {
    let target = env::var_os("CARGO_TARGET_DIR").unwrap_or_else(|| "target".into());
    let mut path = PathBuf::from(target);
    if let Some(cross) = cross {
        path.push(cross.target);
    }
    path.push(if release { "release" } else { "debug" });
    // So that it is not looked for on the PATH.
    Path::new(".").join(path).join("bits")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_difference_names_the_place_and_the_model() {
        let golden = ["a poses 1".to_owned(), "b poses 2".to_owned(), "c poses 3".to_owned()];
        let mut faults = Vec::new();
        compare("here", &golden, "a poses 1\nb poses 9\nd poses 4\n", &mut faults);
        assert_eq!(
            faults,
            [
                "here: b differs:\n  b poses 9\n  b poses 2 (golden)",
                "here: c is missing",
                "here: tests/data/bits.txt has no d"
            ]
        );
    }
}
