//! RigidFormer on a host: everything around the model that needs files, threads or memory of its own.
//!
//! | module | does |
//! |---|---|
//! | [`scenes`] | reads, checks and writes recorded scenes (`SCENES.md` describes the file) |
//! | [`models`] | loads a packed model, packs one from safetensors |
//! | [`rollout`] | one recorded scene, or many in parallel, to predicted poses |
//! | [`deforming`] | rollouts of soft bodies and the errors of their points |
//! | [`predicted`] | all that a rollout predicts, soft points and bonds too, and that as a scene |
//! | [`world`] | a simulator that owns model and memory, on the fastest kernels and all cores |
//! | [`engine`] | which kernels, on how many threads |
//! | [`futures`] | many futures of one scene in lockstep |
//! | [`kernels`] | the fastest arithmetic of this processor, on all its cores |
//! | [`metrics`] | errors of predicted poses: HopNet's protocol, rigidity, penetration |
//! | [`evaluation`] | a rollout and its metrics over a whole split |
//! | [`open_loop`] | the errors of rollouts from one pose and velocity: recorded tosses |
//! | [`free_fall`] | the baseline that knows gravity and inertia and nothing else |
//! | [`identify`] | friction, restitution and mass ratios from how units move |
//! | [`hull`] | convex hulls of units |
//! | [`perception`] | from depth images and clouds to units that are followed |
//! | [`pieces`] | convex pieces of hollow units |
//! | [`pivots`] | where the parts of articulated bodies turn about each other, from their poses |
//! | [`noise`] | random numbers by seed and place |
//! | [`planner`] | what to do: MPPI and CEM over futures |
//! | [`paper`] | the published figures to compare with |
//! | [`files`] | files that are written whole or not at all |
//!
//! Frames of reference are right-handed with z up; units are SI.
//!
//! # Example
//!
//! The free-fall error of a recorded scene, 0.1 s after its second frame:
//!
//! ```
//! use rigidformer_runtime::{free_fall, metrics, scenes::{RecordedScene, RecordedUnit, Split}};
//! use nalgebra::{Isometry3, Point3, Vector3};
//! use rigidformer_core::Physics;
//!
//! // A cube's corners dropped from 10 m, frame by frame at 240 Hz.
//! let drop = |frame: u32| {
//!     let t = frame as f32 / 240.0;
//!     Isometry3::translation(0.0, 0.0, 10.0 - 5.0 * t * t)
//! };
//! let points = vec![Point3::origin(), Point3::new(0.1, 0.0, 0.0), Point3::new(0.0, 0.1, 0.0), Point3::new(0.0, 0.0, 0.1)];
//! let physics = Physics { mass_kg: 1.0, friction: 0.4, restitution: 0.3 };
//! let unit = RecordedUnit::new("cube", points, physics, (0..=25).map(drop).collect());
//! let scene = RecordedScene::new("drop", 1, Split::Test, 240.0, Vector3::new(0.0, 0.0, -10.0), vec![unit])?;
//!
//! let predicted = free_fall::trajectory(&scene, 0, 1, 25).ok_or("too few frames")?;
//! let errors = metrics::frame_errors(&predicted, &scene, 25).ok_or("frame not predicted")?;
//! assert!(errors.position_m < 1e-4 && errors.orientation_rms_deg < 1e-3);
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```
#![cfg_attr(test, allow(clippy::unwrap_used, clippy::expect_used, clippy::panic))]

pub use rigidformer_core as core;

mod bonded;
pub mod deforming;
pub mod engine;
pub mod evaluation;
pub mod files;
pub mod fragments;
pub mod free_fall;
pub mod futures;
pub mod health;
pub mod hull;
pub mod identify;
pub mod kernels;
pub mod metrics;
pub mod models;
pub mod noise;
pub mod open_loop;
pub mod paper;
pub mod perception;
pub mod pieces;
pub mod pivots;
pub mod planner;
pub mod predicted;
pub mod rollout;
pub mod scenes;
pub mod walks;
pub mod world;
