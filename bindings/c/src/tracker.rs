//! The tracker for C: `include/rigidformer_tracker.h`. It has memory of its own, and the standard library.
//!
//! 1. [`types`]: the structs that cross the border.
//! 2. [`ffi`]: the functions. Each checks its pointers and does no more.
//! 3. `convert`: what C hands in as `rigidformer-perception` takes it, and errors as codes and texts.
//! 4. `registry`: which handles there are. A handle is a number that is looked up, and never an address that is read.

mod convert;
pub mod ffi;
mod registry;
pub mod types;
