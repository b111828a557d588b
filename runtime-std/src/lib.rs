//! RigidFormer on a host: what a robot's computer links. Everything around the model that needs files, threads or memory of its own.
//!
//! | module | does |
//! |---|---|
//! | [`world`] | a simulator that owns model and memory, on the fastest kernels and all cores |
//! | [`models`] | loads a packed model |
//! | [`futures`] | many futures of one scene in lockstep |
//! | [`group`] | several worlds in one space: robots, and what they push |
//! | [`engine`] | which kernels, on how many threads |
//! | [`kernels`] | the fastest arithmetic of this processor (`rigidformer-kernels`) |
//! | [`threads`] | kernels on several threads |
//! | [`pool`] | the threads, also of a forked process |
//! | [`terrain`] | ground of varying height |
//! | [`pivots`] | pivots between the links of articulated bodies, from their poses |
//! | [`poses`] | free fall, velocities and headings, from poses alone |
//! | [`hull`] | convex hulls of units |
//! | `mesh` | meshes of bodies: OBJ, STL, COLLADA (feature `meshes`) |
//! | [`noise`] | random numbers by seed and stream |
//! | [`progress`] | progress and cancellation of long work |
//! | [`files`] | files that are written whole or not at all |
//! | [`memory`] | how much memory the contents of a file may take |
//!
//! Frames of reference are right-handed with z up; units are SI.
#![cfg_attr(test, allow(clippy::unwrap_used, clippy::expect_used, clippy::panic))]

pub use rigidformer_core as core;
pub use rigidformer_core::nalgebra;
pub use rigidformer_kernels as kernels;

pub mod engine;
pub mod files;
pub mod futures;
pub mod group;
pub mod hull;
pub mod memory;
#[cfg(feature = "meshes")]
pub mod mesh;
pub mod models;
pub mod noise;
pub mod pivots;
pub mod pool;
pub mod poses;
pub mod progress;
pub mod terrain;
pub mod threads;
pub mod world;
