//! Unsafe code under AddressSanitizer and Miri.

#[cfg(test)]
use std::path::Path;
use std::process::Command;

use anyhow::{Context, Result};

use crate::process::{cargo, line, output, run};
use crate::report::{Missing, Report};

/// Crates whose tests reach all unsafe code of a host, by their folders: kernels, mapped files, and C's pointers.
const WATCHED: [(&str, &str); 4] = [
    ("rigidformer-kernels", "kernels"),
    ("rigidformer-runtime", "runtime-std"),
    ("rigidformer-capi", "bindings/c"),
    ("rigidformer-fuzz-targets", "fuzz/targets"),
];
/// Those tests. Others of `runtime-std` and of the fuzz targets take minutes with AddressSanitizer.
const REACHING: [&str; 11] = [
    "checks::",
    "methods::",
    "threads::",
    "world::",
    "edit::",
    "equal::",
    "header::",
    "health::",
    "misuse::",
    "soft::",
    "c_calls",
];
/// Miri runs no assembly: on this target libm has none.
const MIRI_TARGET: &str = "riscv64gc-unknown-linux-gnu";
/// Tests of C's pointers, and of the reader of model files.
const INTERPRETED: [&[&str]; 2] = [
    &["-p", "rigidformer-capi", "--test", "all", "--", "misuse::", "edit::"],
    &["-p", "rigidformer-weights", "--lib"],
];

/// Runs the tests that reach unsafe code with AddressSanitizer.
pub(crate) fn run_address() -> Result<()> {
    let mut arguments = vec!["--no-default-features", "--tests"];
    arguments.extend(WATCHED.iter().flat_map(|(package, _)| ["-p", package]));
    arguments.push("--");
    arguments.extend(REACHING);
    address(&arguments)
}

/// Runs all tests with AddressSanitizer, but for those of these checks.
pub(crate) fn run_everything() -> Result<()> {
    address(&["--workspace", "--exclude", "xtask", "--tests"])
}

/// Builds tests with AddressSanitizer and runs them. Sanitisers are an unstable option of the stable compiler.
fn address(arguments: &[&str]) -> Result<()> {
    let host = output(Command::new("rustc").arg("-vV"))?;
    let host =
        host.lines().find_map(|line| line.strip_prefix("host: ")).context("rustc names no host")?;
    let mut command = cargo();
    command.args(["test", "--target", host, "--target-dir", "target/sanitize"]).args(arguments);
    command.env("RUSTC_BOOTSTRAP", "1").env("RUSTFLAGS", "-Zsanitizer=address");
    // Instrumented loads make large products of f32 as slow as an emulator does.
    command.env("RIGIDFORMER_EMULATED", "1");
    println!("RUSTC_BOOTSTRAP=1 RUSTFLAGS=-Zsanitizer=address {}", line(&command));
    run(&mut command).context("AddressSanitizer found something")
}

/// Interprets tests with Miri, which takes hours.
pub(crate) fn run_miri(report: &mut Report) -> Result<()> {
    let mut install = Command::new("rustup");
    install.args(["component", "add", "--toolchain", "nightly", "miri", "rust-src"]);
    if let Err(error) = run(&mut install) {
        report.skip(Missing::new(format!("no Miri: {error:#}"), line(&install)));
        return Ok(());
    }
    for tests in INTERPRETED {
        let mut command = Command::new("cargo");
        command.args([
            "+nightly",
            "miri",
            "test",
            "--target",
            MIRI_TARGET,
            "--target-dir",
            "target/miri",
        ]);
        command.args(tests).env("MIRIFLAGS", "-Zmiri-disable-isolation");
        println!("MIRIFLAGS=-Zmiri-disable-isolation {}", line(&command));
        run(&mut command).context("Miri found something")?;
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn watched_tests_are_there() {
        let root = Path::new(env!("CARGO_MANIFEST_DIR")).join("../..");
        for name in REACHING.iter().filter_map(|name| name.strip_suffix("::")) {
            let has = |(_, folder): &(&str, &str)| {
                root.join(folder).join("tests/all").join(name).with_extension("rs").exists()
            };
            assert!(WATCHED.iter().any(has), "no crate has tests/all/{name}.rs");
        }
    }
}
