//! `rigidformer-analytic`: yardsticks for RigidFormer from an analytic engine. `rigidformer-analytic --help` is the
//! manual.
//!
//! Exit codes: 0 done, 1 failed, 2 wrong usage.
#![cfg_attr(test, allow(clippy::unwrap_used, clippy::expect_used, clippy::panic))]

mod arguments;
mod bodies;
mod long;
mod output;
mod overlap;
mod rapier;
mod rest;
mod rollouts;
mod simulation;
mod statistics;
mod time;

use std::process::ExitCode;

use arguments::{Arguments, Command};
use clap::Parser;

fn main() -> ExitCode {
    let arguments = Arguments::parse();
    let done = match &arguments.command {
        Command::Rapier(arguments) => rapier::run(arguments),
        Command::Overlap(arguments) => overlap::run(arguments),
        Command::Rest(arguments) => rest::run(arguments),
        Command::Long(arguments) => long::run(arguments),
        Command::Time(arguments) => time::run(arguments),
    };
    match done {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => report(&error),
    }
}

fn report(error: &anyhow::Error) -> ExitCode {
    // Whoever reads the output may stop early, as `rigidformer-analytic rapier FILE | head` does.
    let io = error.downcast_ref::<std::io::Error>();
    if io.is_some_and(|io| io.kind() == std::io::ErrorKind::BrokenPipe) {
        return ExitCode::SUCCESS;
    }
    output::error(error);
    ExitCode::FAILURE
}
