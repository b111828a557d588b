//! The program, run as a user runs it.
//!
//! One binary for all files: each more would be linked with the whole workspace once more. A file's tests alone:
//! `cargo test -p rigidformer-cli cli::`.

mod bombs;
mod cli;
#[cfg(unix)]
mod doors;
mod hostile;
mod import;
#[cfg(feature = "robots")]
mod import_robot;
mod render;
mod smooth_and_labels;
mod track;
mod viewers;
