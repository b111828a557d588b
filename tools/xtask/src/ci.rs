//! All checks, one after another.

use std::process::Command;

use anyhow::Result;

use crate::{arrows, bench, bits, capi, embedded, firmware, fuzz, header, process};

/// Inputs: enough to show that the targets build and run; fuzz/README.md counts the long runs.
const FUZZ_EXECUTIONS: u64 = 20_000;

/// Stops at the first check that fails.
pub(crate) fn run() -> Result<()> {
    step("formatting", cargo(&["fmt", "--all", "--check"]))?;
    step(
        "formatting of the fuzz targets",
        cargo(&["fmt", "--manifest-path", "fuzz/Cargo.toml", "--check"]),
    )?;
    step(
        "lints",
        cargo(&["clippy", "--workspace", "--all-targets", "--release", "--", "--deny", "warnings"]),
    )?;
    let manifest = "firmware-sim/firmware/Cargo.toml";
    step("formatting of firmware", cargo(&["fmt", "--manifest-path", manifest, "--check"]))?;
    println!("== arrows");
    arrows::run(false)?;
    step("tests", cargo(&["test", "--workspace", "--release"]))?;
    let mut documentation = cargo(&["doc", "--workspace", "--no-deps"]);
    documentation.env("RUSTDOCFLAGS", "--deny warnings");
    step("documentation", documentation)?;
    println!("== without std");
    embedded::run(false)?;
    println!("== header");
    header::run(false)?;
    println!("== C and C++");
    capi::run(None, false)?;
    println!("== bits");
    bits::run(false)?;
    println!("== firmware");
    firmware::run(&firmware::Options::default())?;
    println!("== instruction counts");
    bench::counts(false)?;
    println!("== a short run of the fuzz targets");
    fuzz::run(FUZZ_EXECUTIONS)?;
    println!("== all checks passed");
    Ok(())
}

fn cargo(arguments: &[&str]) -> Command {
    let mut command = process::cargo();
    command.args(arguments);
    command
}

fn step(name: &str, mut command: Command) -> Result<()> {
    println!("== {name}: {}", process::line(&command));
    process::run(&mut command)
}
