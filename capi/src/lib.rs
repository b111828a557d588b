//! RigidFormer for C and C++: the interface of `include/rigidformer.h`.
//!
//! `no_std`, without an allocator: everything lives in memory that the caller owns. The header is
//! generated from this crate (`cargo xtask header`), so what a C programmer reads there is written
//! here. A tour:
//!
//! 1. [`types`]: the plain structs that cross the border, and [`rf_status`](types::rf_status).
//! 2. [`ffi`]: the functions. Each checks its pointers and does no more.
//! 3. `handle`: how a model and a simulator are laid out in the caller's memory, and how a handle
//!    is told from something else.
//! 4. `engine`: a simulator of any capacity, behind one interface.
//!
//! `docs/C.md` in the repository tells how to build, link and use it.
//!
//! # Features
//!
//! | feature | gives |
//! |---|---|
//! | none | up to 16 units |
//! | `units-64`, `units-256` | as many; whoever asks [`ffi::rf_init`] for 16 still pays for 16 |
//! | `panic-handler` | a panic handler that calls `rf_panic`, which the application may define; not with `std` |
//! | `std` | the panic handler of the standard library, and all capacities: for Linux |
#![no_std]
#![deny(
    clippy::indexing_slicing,
    clippy::unwrap_used,
    clippy::expect_used,
    clippy::panic,
    clippy::unreachable,
    clippy::arithmetic_side_effects
)]

#[cfg(feature = "std")]
extern crate std;

mod engine;
pub mod ffi;
mod handle;
#[cfg(all(feature = "panic-handler", not(feature = "std"), not(test)))]
mod panic;
mod status;
pub mod types;
