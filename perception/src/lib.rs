//! From sensors to units: depth cameras and scanners, and the bodies that they measure.
//!
//! | module | does |
//! |---|---|
//! | [`camera`] | pinhole cameras: from pixels with a depth to points and back |
//! | [`capture`] | measurements at an instant: depth images, clouds of points |
//! | [`estimate`] | estimated state of the units at an instant |
//! | [`gravity`] | which way is down, and how that is known |
//! | [`known`] | bodies whose mesh is known |
//! | [`planes`] | support planes (floors, walls), and tabletops |
//! | [`tracker`] | tracks units from capture to capture |
//! | [`sampling`] | from a depth image or a cloud to clusters of points with normals |
//! | `recording` | recordings of sensors, read and written (feature `captures`) |
//!
//! Points are in metres. A camera's frame has x to the right, y down and z forward; the world has z up.
#![cfg_attr(test, allow(clippy::unwrap_used, clippy::expect_used, clippy::panic))]

pub mod camera;
pub mod capture;
mod cloud;
mod depth_noise;
pub mod estimate;
mod forecast;
pub mod gravity;
pub mod known;
mod motion;
pub mod planes;
mod primitive;
#[cfg(feature = "captures")]
pub mod recording;
mod registration;
pub mod sampling;
mod segmentation;
mod shape;
mod surface;
pub mod tracker;
