//! Planners, identification and calibration.
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)]

mod calibrate;
mod examples;
mod identify;
mod planner;
#[cfg(unix)]
mod push;
mod pushing;
mod throw;
mod walk;
