//! All checks, one after another.

use std::process::Command;

use anyhow::Result;

use crate::{arrows, bits, capi, embedded, firmware, header, process};

/// Stops at the first check that fails.
pub(crate) fn run() -> Result<()> {
    step("formatting", cargo(&["fmt", "--all", "--check"]))?;
    step(
        "lints",
        cargo(&["clippy", "--workspace", "--all-targets", "--release", "--", "--deny", "warnings"]),
    )?;
    println!("== arrows");
    arrows::run()?;
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
