//! Worlds, futures and threads.
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)]

mod environment;
mod futures;
mod start;
mod threads;
mod world;
