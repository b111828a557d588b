//! The harness on small models.
//!
//! One binary for all files: each more would be linked with the whole workspace once more. A file's tests alone:
//! `cargo test -p rigidformer-firmware-sim harness::`.

mod common;
mod harness;
