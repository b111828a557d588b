//! What to do, and what bodies are made of: both found by trying many futures of a scene in the model.
//!
//! | module | does |
//! |---|---|
//! | [`planner`] | MPPI and the cross-entropy method over futures; pushing; walking |
//! | `calibrate` | contact's numbers that fit many recorded scenes (feature `calibrate`) |
//! | `identify` | friction, restitution and mass ratios from how units move (feature `identify`) |
#![cfg_attr(test, allow(clippy::unwrap_used, clippy::expect_used, clippy::panic))]

#[cfg(feature = "calibrate")]
pub mod calibrate;
#[cfg(feature = "identify")]
pub mod identify;
pub mod planner;
