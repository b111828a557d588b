//! Pictures of rollouts, as PNG files.

mod camera;
mod colours;
mod curves;
mod cut;
mod depth;
mod drift;
mod film;
mod mesh;
mod page;
mod plot;
mod raster;
mod strip;
mod surface;
mod throw;
mod toss;
mod track;
mod walk;

pub(crate) use colours::colour;
pub(crate) use curves::evaluation;
pub(crate) use depth::depths;
pub(crate) use drift::drift;
pub(crate) use page::Rgb;
pub(crate) use plot::errors;
pub(crate) use strip::strip;
pub(crate) use throw::{Drawing, throw};
pub(crate) use toss::{Toss, toss};
pub(crate) use track::{Instant, Strip, tracks};
pub(crate) use walk::walk;
