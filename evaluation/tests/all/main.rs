//! Scene files, rollouts and metrics.
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)]

mod free_fall_table;
mod pivots;
mod rollout;
mod scenes;
mod smooth_errors;
