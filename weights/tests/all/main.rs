//! What the format holds and refuses.
//!
//! One binary for all files: each more would be linked with the whole workspace once more. A file's tests alone:
//! `cargo test -p rigidformer-weights hostile::`.

mod common;
mod hostile;
mod no_alloc;
mod panels;
mod ranges;
mod round_trip;
mod rules;
mod similarity;
mod soft;
