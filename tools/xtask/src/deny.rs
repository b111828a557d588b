//! What is depended on: licences, sources and banned crates of all lock files, and advisories.

use std::env;
use std::process::Command;

use anyhow::{Context, Result};

use crate::install::Program;
use crate::process::{line, output, run as run_command};
use crate::report::{Missing, Report};

const DENY: Program = Program { name: "cargo-deny", version: Some("0.20.2"), features: &[] };

/// Every manifest with a lock file of its own.
const MANIFESTS: [&str; 5] = [
    "Cargo.toml",
    "fuzz/Cargo.toml",
    "firmware-sim/firmware/Cargo.toml",
    "tools/analytic/Cargo.toml",
    "bindings/python/Cargo.toml",
];

/// Checks all lock files against `deny.toml`.
pub(crate) fn run(report: &mut Report) -> Result<()> {
    let program = match DENY.ensure() {
        Ok(program) => program,
        Err(missing) => {
            report.skip(missing);
            return Ok(());
        }
    };
    let config = env::current_dir().context("no current folder")?.join("deny.toml");
    let deny = |manifest: &str| {
        let mut command = Command::new(&program);
        command.arg("--config").arg(&config).args([
            "--locked",
            "--manifest-path",
            manifest,
            "check",
        ]);
        command
    };
    for manifest in MANIFESTS {
        let mut command = deny(manifest);
        command.args(["licenses", "bans", "sources"]);
        println!("{}", line(&command));
        run_command(&mut command)?;
    }
    // Their database is fetched from elsewhere: not everyone may.
    let mut fetch = Command::new(&program);
    fetch.args(["fetch", "db"]);
    if let Err(error) = output(&mut fetch) {
        let error = format!("{error:#}");
        let first = error.lines().next().unwrap_or_default();
        report.skip_part("advisories", Missing::new(first.to_owned(), line(&fetch)));
        return Ok(());
    }
    for manifest in MANIFESTS {
        run_command(deny(manifest).arg("advisories"))?;
    }
    Ok(())
}
