//! The fuzz targets of `fuzz/`, with the stable toolchain.

use std::process::Command;

use anyhow::{Context, Result};

use crate::apt;
use crate::install::Program;
use crate::process::{line, output, run as run_command};
use crate::report::Report;
use crate::tools;

const FUZZ: Program = Program { name: "cargo-fuzz", version: None, features: &[] };

const TARGETS: [&str; 3] = ["model_file", "observe_step", "soft_step"];

/// Runs every target for an equal share of `executions`.
pub(crate) fn run(executions: u64, report: &mut Report) -> Result<()> {
    if let Err(missing) = apt::ensure(&[tools::CXX]) {
        // libFuzzer is C++.
        report.skip(missing);
        return Ok(());
    }
    if let Err(missing) = FUZZ.ensure() {
        report.skip(missing);
        return Ok(());
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
