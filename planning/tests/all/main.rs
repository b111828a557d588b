//! Planners and identification.
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)]

mod examples;
mod identify;
mod planner;
#[cfg(unix)]
mod push;
mod pushing;
mod throw;
mod walk;
