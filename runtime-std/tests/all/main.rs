//! Worlds, futures and threads.
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)]

mod environment;
mod futures;
mod group;
mod start;
mod threads;
mod world;
