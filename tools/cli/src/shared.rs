//! What the examples of `rigidformer-planning` share with the program. It is no interface to build on.

use std::process::ExitCode;

use clap::Parser;

pub use crate::arguments::{Model, Viewers as ViewerOptions};
pub use crate::defaults::model;
#[cfg(feature = "examples")]
pub use crate::picture::{Drawing, paths as draw_paths};
pub use crate::usage::Usage;
pub use crate::viewers::{Frame, Moving, MovingUnit, Viewers};

/// Ctrl-C.
pub mod interrupt {
    pub use crate::interrupt::{check, watch};
}

/// What goes to stdout and to stderr.
pub mod output {
    pub use crate::output::{
        folder, json, line, note, progress, row, table, table_lines, write_whole,
    };
}

/// Runs an example with the options of its command line; the exit codes are the program's.
pub fn example<Options: Parser>(run: impl FnOnce(&Options) -> anyhow::Result<()>) -> ExitCode {
    let done = Options::try_parse().map_err(anyhow::Error::from);
    let done = done.and_then(|options| run(&options));
    let told = crate::output::tell();
    match done.and(told) {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => crate::report(&error),
    }
}
