//! Pictures of rollouts, as PNG files.

mod camera;
mod colours;
mod curves;
mod cut;
#[cfg(feature = "sensors")]
mod depth;
mod drift;
mod film;
mod mesh;
mod page;
#[cfg(feature = "examples")]
mod paths;
mod plot;
mod raster;
mod strip;
mod surface;
mod toss;
#[cfg(feature = "sensors")]
mod track;
mod walk;

pub(crate) use colours::colour;
pub(crate) use curves::evaluation;
#[cfg(feature = "sensors")]
pub(crate) use depth::depths;
pub(crate) use drift::drift;
pub(crate) use page::Rgb;
#[cfg(feature = "examples")]
pub use paths::{Drawing, paths};
pub(crate) use plot::errors;
pub(crate) use strip::strip;
pub(crate) use toss::{Toss, toss};
#[cfg(feature = "sensors")]
pub(crate) use track::{Instant, Strip, tracks};
pub(crate) use walk::walk;
