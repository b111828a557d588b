//! RigidFormer for C and C++: the interface of `include/rigidformer.h`.
//!
//! `no_std`, without an allocator: everything lives in memory that the caller owns. The header is
//! generated from this crate (`cargo xtask header`), so what a C programmer reads there is written
//! here. A tour:
//!
//! 1. [`types`]: the plain structs that cross the border, and [`rf_status`](types::rf_status).
//! 2. [`ffi`]: the functions that make, observe, step and read; [`edit`]: those that change a scene
//!    between steps. Each checks its pointers and does no more.
//!    [`health`]: how far a unit's prediction may be believed; [`state`]: what to go on from.
//! 3. `arrays`: those checks; `convert`: what C hands in as the core takes it, and back.
//! 4. `engine`: which kernels step; `handle`: how a model and a simulator are laid out in the caller's memory, and how a handle
//!    is distinguished from something else.
//!
//! `docs/C.md` in the repository says how to build, link and use it.
//!
//! # Features
//!
//! | feature | gives |
//! |---|---|
//! | `panic-handler` | a panic handler that calls `rf_panic`, which the application may define; not with `std` |
//! | `std` | the fastest kernels of the processor, the panic handler of the standard library, and all features below: for Linux |
//! | `robot` | models that see robots from their heading; `rf_join` and its kin, which otherwise return `RF_ERROR_NO_JOINTS` |
//! | `deform` | models of soft bodies, and soft units, which are otherwise refused (`RF_ERROR_NOT_SOFT`); `rf_bond`, `rf_break_bond` and `rf_bonds`, which otherwise return `RF_ERROR_NO_BONDS` |
//! | `health` | `rf_health`, `rf_innovation` and `rf_set_quarantine`, which otherwise return `RF_ERROR_NO_HEALTH`, and models that say what training saw |
//! | `compliance` | `rf_set_compliance` and `rf_set_plane_compliance`, which otherwise return `RF_ERROR_NO_COMPLIANCE` |
//! | `terrain` | `rf_set_height_field`, which otherwise returns `RF_ERROR_NO_HEIGHT_FIELD` |
//! | `host` | all models, also those whose network sees what is in contact, such as edge; and the five above |
//! | `tracker` | `std`, and `rf_tracker_...` of `include/rigidformer_tracker.h`, in memory of its own |
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

mod arrays;
mod convert;
pub mod edit;
mod engine;
pub mod ffi;
mod handle;
pub mod health;
pub mod joints;
#[cfg(all(feature = "panic-handler", not(feature = "std"), not(test)))]
mod panic;
pub mod state;
mod status;
#[cfg(feature = "tracker")]
pub mod tracker;
pub mod types;
