//! The C interface, called as C calls it.
//!
//! One binary for all files: each more would be linked with the whole workspace once more. A file's tests alone:
//! `cargo test -p rigidformer-capi edit::`.

mod common;
mod edit;
mod environment;
mod equal;
mod header;
mod health;
mod kernels;
mod misuse;
mod soft;
mod stack;
mod state;
mod tracker;
