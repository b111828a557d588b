//! `rigidformer`: rolls out, evaluates, inspects, packs and compares RigidFormer models. `rigidformer --help` is the manual.
//!
//! Exit codes: 0 done, 1 failed, 2 wrong usage, 130 interrupted.

use std::process::ExitCode;

fn main() -> ExitCode {
    match rigidformer_cli::run(std::env::args_os()) {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => rigidformer_cli::report(&error),
    }
}
