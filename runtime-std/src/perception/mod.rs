//! From sensors to units: what depth cameras and scanners see, and what of it moves.
//!
//! | module | does |
//! |---|---|
//! | [`camera`] | pinhole cameras: from pixels with a depth to points and back |
//! | [`capture`] | what sensors saw at an instant: depth images, clouds of points |
//! | [`estimate`] | what is believed of the units at an instant |
//! | `recording` | recordings of sensors, read and written (feature `captures`) |
//! | [`render`] | what depth cameras would see of a recorded scene |
//! | [`score`] | how far estimates are from the true scene |
//!
//! Points are in metres. A camera's frame has x to the right, y down and z forward; the world has z up.

pub mod camera;
pub mod capture;
pub mod estimate;
#[cfg(feature = "captures")]
pub mod recording;
pub mod render;
pub mod score;
