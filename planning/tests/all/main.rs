//! Planners and identification.
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)]

mod identify;
mod planner;
mod pushing;
