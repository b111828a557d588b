//! How well the model predicts: scenes that were recorded, rollouts of them, and what the two differ by.
//!
//! | module | does |
//! |---|---|
//! | [`scenes`] | reads, checks and writes recorded scenes (`SCENES.md` describes the file) |
//! | [`rollout`] | one recorded scene, or many in parallel, to predicted poses |
//! | [`predicted`] | all that a rollout predicts, soft points and bonds too, and that as a scene |
//! | [`metrics`] | errors of predicted poses: HopNet's protocol, rigidity, penetration |
//! | [`figures`] | a rollout and its metrics over a whole split |
//! | [`open_loop`] | the errors of rollouts from one pose and velocity: recorded tosses |
//! | [`robots`] | how well the motion of robots under command is predicted |
//! | [`soft`] | rollouts of soft bodies and the errors of their points |
//! | [`fragments`] | rollouts of bodies that break, and which of their bonds do |
//! | [`free_fall`] | the baseline that knows gravity and inertia and nothing else |
//! | [`health`] | what training saw of a model's inputs, and how often scenes are outside |
//! | [`paper`] | the published figures to compare with |
//! | `contact` | numbers of contact that recordings tell, and their file (feature `contact`) |
//! | [`convex_pieces`] | convex pieces of hollow units |
//! | [`pivots`] | pivots of recorded scenes |
//! | `render` | what depth cameras would see of a recorded scene (feature `sensors`) |
//! | `score` | how far a tracker's estimates are from the true scene (feature `sensors`) |
//! | `segments` | how well a segmentation finds the bodies of an image (feature `sensors`) |
//! | [`windows`] | what the network sees in single steps of recorded scenes, for training |
//! | [`models`] | packs and quantises models |
//!
//! Frames of reference are right-handed with z up; units are SI.
//!
//! # Example
//!
//! The free-fall error of a recorded scene, 0.1 s after its second frame:
//!
//! ```
//! use rigidformer_evaluation::{free_fall, metrics};
//! use rigidformer_evaluation::scenes::{RecordedScene, RecordedUnit, Split};
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

#[cfg(feature = "contact")]
pub mod contact;
pub mod convex_pieces;
pub mod figures;
pub mod fragments;
pub mod free_fall;
pub mod health;
mod held_bonds;
pub mod metrics;
pub mod models;
pub mod open_loop;
pub mod paper;
pub mod pivots;
pub mod predicted;
#[cfg(feature = "sensors")]
pub mod render;
pub mod robots;
pub mod rollout;
pub mod scenes;
#[cfg(feature = "sensors")]
pub mod score;
#[cfg(feature = "sensors")]
pub mod segments;
pub mod soft;
pub mod windows;
