//! Oracles, golden vectors and suites that span the crates.
//!
//! One binary for all files: each more would be linked with the whole workspace once more. A file's tests alone:
//! `cargo test -p rigidformer-tests bad_input::`.

mod bad_input;
mod bits;
mod bonds;
mod breaking;
mod contact;
mod exact_state;
mod golden;
mod ground;
mod heading;
mod health;
mod hinges;
mod index;
mod joints;
mod kabsch;
mod math;
mod mutations;
mod network;
mod no_alloc;
mod parts;
mod pieces;
mod quarantine;
mod robots;
mod roles;
mod scope;
mod similarity;
mod snapshot;
mod soft;
mod still;
mod symmetries;
mod terrain;
mod walking;
