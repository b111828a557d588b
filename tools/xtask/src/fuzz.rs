//! The fuzz targets of `fuzz/`, with the stable toolchain.

use std::process::Command;

use anyhow::{Context, Result};

use crate::process::{line, output, run as run_command};

const TARGETS: [&str; 2] = ["model_file", "observe_step"];

/// Runs every target for an equal share of `executions`.
pub(crate) fn run(executions: u64) -> Result<()> {
    let version = || output(Command::new("cargo-fuzz").arg("--version"));
    if version().is_err() {
        let mut install = Command::new("cargo");
        install.args(["install", "--locked", "cargo-fuzz"]);
        if let Err(error) = run_command(&mut install) {
            println!("skipped: no cargo-fuzz, and {error:#}; by hand: {}", line(&install));
            return Ok(());
        }
    }
    let host = output(Command::new("rustc").arg("-vV"))?;
    let host = host.lines().find_map(|line| line.strip_prefix("host: ")).unwrap_or_default();
    for target in TARGETS {
        let mut command = Command::new("cargo-fuzz");
        // Coverage instrumentation is an unstable option of the stable compiler. No sanitiser:
        // there is no unsafe code to watch, and panics and overflows are caught without.
        command.args([
            "run",
            "--fuzz-dir",
            "fuzz",
            "--sanitizer",
            "none",
            "--target",
            host,
            target,
        ]);
        command.args(["--", "-seed=1", "-max_len=1024", "-timeout=10"]);
        command.arg(format!("-runs={}", executions.div_ceil(TARGETS.len() as u64)));
        command.env("RUSTC_BOOTSTRAP", "1");
        println!("{}", line(&command));
        run_command(&mut command).with_context(|| format!("{target} found something"))?;
    }
    Ok(())
}
