//! The commands of the program `rigidformer`. `rigidformer --help` is the manual; this is no interface to build on: programs use
//! `rigidformer-runtime`. It is a library so that fuzz targets can call commands without starting a process.

// Options of commands that a feature brings are read there alone.
#[cfg_attr(not(feature = "full"), allow(dead_code))]
mod arguments;
#[cfg(feature = "calibrate")]
mod calibrate;
mod check;
mod commanded;
mod comparison;
mod contact;
mod csv_text;
#[cfg(feature = "pieces")]
mod decomposed;
mod defaults;
mod drive;
mod evaluate;
#[cfg(feature = "identify")]
mod identify;
#[cfg(feature = "import")]
mod import;
#[cfg(feature = "robots")]
mod import_robot;
mod inspect;
mod interrupt;
#[cfg(test)]
mod listings;
mod loading;
#[cfg(any(feature = "pieces", feature = "sensors"))]
mod meshes;
mod moved;
mod output;
mod pack;
mod picture;
#[cfg(feature = "pieces")]
mod pieces;
mod printable;
#[cfg(feature = "sensors")]
mod render;
mod rollout;
#[doc(hidden)]
pub mod shared;
mod trace;
#[cfg(feature = "sensors")]
mod track;
mod usage;
mod viewers;

use std::ffi::OsString;
use std::process::ExitCode;

use arguments::{Arguments, Command};
use clap::Parser;
use rigidformer_evaluation::rollout::RolloutError;
use rigidformer_runtime::memory;
use usage::Usage;

/// Runs a command that a feature brings, or says which feature.
macro_rules! with {
    ($command:literal, $feature:literal, $run:expr) => {{
        #[cfg(feature = $feature)]
        let done = $run;
        #[cfg(not(feature = $feature))]
        let done = Err(usage::missing($command, $feature).into());
        done
    }};
}

/// Runs a command line, the program's name first, and then tells its results.
///
/// # Errors
/// Whatever the command could not do, for [`report`]. An error of clap may be the answer to `--help`.
pub fn run(line: impl IntoIterator<Item = OsString>) -> anyhow::Result<()> {
    let done = command(line);
    // Also what a command found before it failed.
    let told = output::tell();
    done.and(told)
}

fn command(line: impl IntoIterator<Item = OsString>) -> anyhow::Result<()> {
    let line: Vec<OsString> = line.into_iter().collect();
    moved::check(&line)?;
    let arguments = Arguments::try_parse_from(line)?;
    if let Some(bytes) = arguments.memory {
        memory::set_limit(bytes);
    }
    match &arguments.command {
        Command::Rollout(arguments) => rollout::run(arguments),
        Command::Evaluate(arguments) => evaluate::run(arguments),
        Command::Inspect(arguments) => inspect::run(arguments),
        Command::Pack(arguments) => pack::run(arguments),
        Command::Pieces(_arguments) => with!("pieces", "pieces", pieces::run(_arguments)),
        Command::Check(arguments) => check::run(arguments),
        Command::Import(_arguments) => with!("import", "import", import::run(_arguments)),
        Command::ImportRobot(_arguments) => {
            with!("import-robot", "robots", import_robot::run(_arguments))
        }
        Command::Identify(_arguments) => with!("identify", "identify", identify::run(_arguments)),
        Command::Calibrate(_arguments) => {
            with!("calibrate", "calibrate", calibrate::run(_arguments))
        }
        Command::Render(_arguments) => with!("render", "sensors", render::run(_arguments)),
        Command::Track(_arguments) => with!("track", "sensors", track::run(_arguments)),
        Command::Trace(arguments) => trace::record(arguments),
        Command::Diff(arguments) => trace::diff(arguments),
    }
}

/// From here on this process says nothing: for callers in loops.
pub fn silence() {
    output::silence();
}

/// Tells of an error, and gives the program's exit code.
pub fn report(error: &anyhow::Error) -> ExitCode {
    if let Some(usage) = error.downcast_ref::<clap::Error>() {
        return answer(usage);
    }
    if error.downcast_ref::<RolloutError>() == Some(&RolloutError::Cancelled) {
        output::interrupted();
        return ExitCode::from(130);
    }
    output::error(error);
    ExitCode::from(if error.is::<Usage>() { 2 } else { 1 })
}

/// Prints what clap says of a command line: help, or what is wrong with it.
fn answer(usage: &clap::Error) -> ExitCode {
    let is_plain = |argument: OsString| {
        argument.to_str().is_some_and(|argument| printable::shown(argument) == argument)
    };
    if usage.use_stderr() {
        // Its own text has colours, and arguments as they are.
        match std::env::args_os().all(is_plain) {
            // With stderr gone there is nobody to tell.
            true => drop(usage.print()),
            false => output::plain(&usage.to_string()),
        }
        return ExitCode::from(2);
    }
    match output::heard(usage.print()) {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            output::error(error);
            ExitCode::FAILURE
        }
    }
}
