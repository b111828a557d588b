//! Building for a processor without an operating system.

use std::env;
use std::path::Path;
use std::process::Command;

use anyhow::{Context, Result};

use crate::arrows::NO_STD;
use crate::process::{cargo, line, output, run as run_command};
use crate::report::{Missing, Report};
use crate::rust_src;

/// Unrolling and generous inlining would double the text for a few per cent of speed: the loops that matter
/// are assembly.
pub(crate) const SMALL: &str = "-C llvm-args=--unroll-threshold=20 -C llvm-args=--unroll-partial-threshold=20 \
    -C llvm-args=--inline-threshold=50";

/// The same for the C library, where the compiler sees less at once: with less inlining it keeps divisions by
/// zero that cannot happen, and their panics.
pub(crate) const SMALL_LIBRARY: &str = "-C llvm-args=--unroll-threshold=20 -C llvm-args=--unroll-partial-threshold=20 \
    -C llvm-args=--inline-threshold=75";

/// Cortex-M4 and M7 with a floating point unit.
const TARGET: &str = "thumbv7em-none-eabihf";

/// Builds the crates without std: with the installed target, with one from rustup, or with a `core`
/// of our own building.
pub(crate) fn run(from_source: bool, report: &mut Report) -> Result<()> {
    let mut command = build();
    if let Err(missing) = prepare(&mut command, TARGET, from_source)? {
        report.skip(missing);
        return Ok(());
    }
    run_command(&mut command).context("the crates must build without std")
}

/// Makes a build command work for a target: with its libraries, or building `core` itself, or not at all,
/// and why.
pub(crate) fn prepare(
    command: &mut Command,
    target: &str,
    from_source: bool,
) -> Result<std::result::Result<(), Missing>> {
    let sysroot = output(Command::new("rustc").args(["--print", "sysroot"]))?;
    let sysroot = Path::new(sysroot.trim_end());
    if !from_source && installed_or_added(sysroot, target) {
        return Ok(Ok(()));
    }
    if let Err(missing) = rust_src::ensure(sysroot) {
        return Ok(Err(without(target, missing)));
    }
    command
        .args(["-Zbuild-std=core,compiler_builtins", "-Zbuild-std-features=compiler-builtins-mem"])
        .env("RUSTC_BOOTSTRAP", "1");
    Ok(Ok(()))
}

/// Names the target whose libraries are missing along with their source.
pub(crate) fn without(target: &str, missing: Missing) -> Missing {
    let Missing { why, remedy } = missing;
    Missing::new(
        format!("rustup cannot add {target}; {why}"),
        format!("`rustup target add {target}`, or {remedy}"),
    )
}

/// Whether the target's libraries are there, or rustup could add them.
pub(crate) fn installed_or_added(sysroot: &Path, target: &str) -> bool {
    let installed = || sysroot.join("lib/rustlib").join(target).join("lib").is_dir();
    if installed() {
        return true;
    }
    let mut rustup = Command::new("rustup");
    rustup.args(["target", "add", target]);
    match run_command(&mut rustup) {
        Ok(()) => installed(),
        Err(error) => {
            println!(
                "{error:#}; by hand: `{}`; going on with the standard library's source",
                line(&rustup)
            );
            false
        }
    }
}

fn build() -> Command {
    let mut command = cargo();
    command.args(["build", "--release", "--lib", "--no-default-features", "--target", TARGET]);
    // Apart: building `core` makes cargo build everything else again.
    let target = env::var_os("CARGO_TARGET_DIR").unwrap_or_else(|| "target".into());
    command.arg("--target-dir").arg(Path::new(&target).join("no-std"));
    for name in NO_STD {
        command.args(["--package", name]);
    }
    command
}
