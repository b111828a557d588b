//! Unsafe code under AddressSanitizer and Miri.

use std::process::Command;

use anyhow::{Context, Result};

use crate::process::{cargo, line, output, run};
use crate::report::{Missing, Report};

/// Tests that reach all unsafe code of a host: kernels and mapped files, and C's pointers.
const WATCHED: [&[&str]; 3] = [
    &["-p", "rigidformer-kernels"],
    &["-p", "rigidformer-runtime", "--test", "all", "--", "threads::", "world::"],
    &["-p", "rigidformer-capi"],
];
/// Miri runs no assembly: on this target libm has none.
const MIRI_TARGET: &str = "riscv64gc-unknown-linux-gnu";
/// Tests of C's pointers, and of the reader of model files.
const INTERPRETED: [&[&str]; 2] = [
    &["-p", "rigidformer-capi", "--test", "all", "--", "misuse::", "edit::"],
    &["-p", "rigidformer-weights", "--lib"],
];

/// Builds the tests with AddressSanitizer and runs them. Sanitisers are an unstable option of the stable compiler.
pub(crate) fn run_address() -> Result<()> {
    let host = output(Command::new("rustc").arg("-vV"))?;
    let host =
        host.lines().find_map(|line| line.strip_prefix("host: ")).context("rustc names no host")?;
    for tests in WATCHED {
        let mut command = cargo();
        command.args(["test", "--target", host, "--target-dir", "target/sanitize"]).args(tests);
        command.env("RUSTC_BOOTSTRAP", "1").env("RUSTFLAGS", "-Zsanitizer=address");
        // Instrumented loads make large products of f32 as slow as an emulator does.
        command.env("RIGIDFORMER_EMULATED", "1");
        println!("RUSTC_BOOTSTRAP=1 RUSTFLAGS=-Zsanitizer=address {}", line(&command));
        run(&mut command).context("AddressSanitizer found something")?;
    }
    Ok(())
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
