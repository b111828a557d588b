//! Unsafe code under AddressSanitizer and Miri, and threads under ThreadSanitizer.

#[cfg(test)]
use std::path::Path;
use std::process::Command;

use anyhow::{Context, Result};

use crate::process::{cargo, line, output, run};
use crate::report::{Missing, Report};

/// Crates whose tests reach all unsafe code of a host, by their folders: kernels, and C's pointers.
const WATCHED: [(&str, &str); 4] = [
    ("rigidformer-kernels", "kernels"),
    ("rigidformer-runtime", "runtime-std"),
    ("rigidformer-capi", "bindings/c"),
    ("rigidformer-fuzz-targets", "fuzz/targets"),
];
/// Those tests. Others of `runtime-std` and of the fuzz targets take minutes with AddressSanitizer.
const REACHING: [&str; 13] = [
    "checks::",
    "methods::",
    "threads::",
    "world::",
    "edit::",
    "equal::",
    "handle::tests::",
    "header::",
    "health::",
    "misuse::",
    "soft::",
    "status::tests::",
    "c_calls",
];
/// Miri runs no assembly: on this target libm has none.
const MIRI_TARGET: &str = "riscv64gc-unknown-linux-gnu";
/// Tests of C's pointers and handles, of pointers to columns, and of the reader of model files. Miri makes no hard links, with
/// which several files are written at once.
const INTERPRETED: [&[&str]; 4] = [
    &["-p", "rigidformer-weights", "--lib", "--", "--skip", "all_files_are_old_or_all_are_new"],
    &["-p", "rigidformer-kernels", "--lib"],
    &["-p", "rigidformer-capi", "--lib", "--", "--skip", "tracker::"],
    &["-p", "rigidformer-capi", "--test", "all", "--", "misuse::", "edit::"],
];

/// Runs the tests that reach unsafe code with AddressSanitizer.
pub(crate) fn run_address() -> Result<()> {
    let mut arguments = vec!["--no-default-features", "--tests"];
    arguments.extend(WATCHED.iter().flat_map(|(package, _)| ["-p", package]));
    arguments.push("--");
    arguments.extend(REACHING);
    address(&arguments)
}

/// All crates but that of these checks.
const EVERYTHING: [&str; 3] = ["--workspace", "--exclude", "xtask"];

/// Runs all tests with AddressSanitizer, but for those of these checks.
pub(crate) fn run_everything() -> Result<()> {
    // Tests of planning start its examples, which `--tests` leaves out. In their profile and with their features, so that both share
    // what is built.
    cargo_with_address(
        &[&["build", "--profile", "test"], &EVERYTHING[..], &["--examples"]].concat(),
    )?;
    address(&[&EVERYTHING[..], &["--tests"]].concat())
}

/// Builds tests with AddressSanitizer and runs them.
fn address(arguments: &[&str]) -> Result<()> {
    cargo_with_address(&[&["test"], arguments].concat())
}

/// Runs a command of cargo with AddressSanitizer. Sanitisers are an unstable option of the stable compiler.
fn cargo_with_address(words: &[&str]) -> Result<()> {
    let mut command = cargo();
    let (before, after) = words.split_at(1);
    command
        .args(before)
        .args(["--target", &host()?, "--target-dir", "target/sanitize"])
        .args(after);
    command.env("RUSTC_BOOTSTRAP", "1").env("RUSTFLAGS", "-Zsanitizer=address");
    // Instrumented loads make large products of f32 as slow as an emulator does.
    command.env("RIGIDFORMER_EMULATED", "1");
    println!("RUSTC_BOOTSTRAP=1 RUSTFLAGS=-Zsanitizer=address {}", line(&command));
    run(&mut command).context("AddressSanitizer found something")
}

/// Tests in which threads share the work of steps and of futures.
const SHARED: [&str; 4] = ["-p", "rigidformer-runtime", "--test", "all"];
const SHARING: [&str; 2] = ["threads::", "futures::"];

/// Runs tests of threads with ThreadSanitizer. It has to see the standard library too, which nightly Rust builds from source.
pub(crate) fn run_threads(report: &mut Report) -> Result<()> {
    if !nightly(&["rust-src"], report) {
        return Ok(());
    }
    let mut command = Command::new("cargo");
    command.args(["+nightly", "test", "-Zbuild-std", "--target", &host()?]);
    command.args(["--target-dir", "target/sanitize-threads"]).args(SHARED).arg("--").args(SHARING);
    command.env("RUSTFLAGS", "-Zsanitizer=thread");
    command.env("RIGIDFORMER_EMULATED", "1").env("RIGIDFORMER_WATCHED", "1");
    println!("RUSTFLAGS=-Zsanitizer=thread {}", line(&command));
    run(&mut command).context("ThreadSanitizer found something")
}

/// Whether nightly Rust has these components. The report says so where it cannot have them.
fn nightly(components: &[&str], report: &mut Report) -> bool {
    let mut install = Command::new("rustup");
    install.args(["component", "add", "--toolchain", "nightly"]).args(components);
    match run(&mut install) {
        Ok(()) => true,
        Err(error) => {
            report.skip(Missing::new(format!("no nightly Rust: {error:#}"), line(&install)));
            false
        }
    }
}

/// The target that this machine is.
fn host() -> Result<String> {
    let about = output(Command::new("rustc").arg("-vV"))?;
    let host = about.lines().find_map(|line| line.strip_prefix("host: "));
    host.map(str::to_owned).context("rustc names no host")
}

/// Interprets tests with Miri.
pub(crate) fn run_miri(report: &mut Report) -> Result<()> {
    if !nightly(&["miri", "rust-src"], report) {
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
            let file = |(_, folder): &(&str, &str), inside: &str, name: &str| {
                std::fs::read_to_string(root.join(folder).join(inside).join(format!("{name}.rs")))
            };
            // Tests of a crate's own files, or a file of tests.
            let has = |watched: &(&str, &str)| match name.strip_suffix("::tests") {
                Some(name) => {
                    file(watched, "src", name).is_ok_and(|text| text.contains("\nmod tests {"))
                }
                None => file(watched, "tests/all", name).is_ok(),
            };
            assert!(WATCHED.iter().any(has), "no crate has tests of {name}");
        }
    }
}
