//! The pictures of a rollout, as PNG files.

mod camera;
mod mesh;
mod page;
mod plot;
mod raster;
mod strip;

pub(crate) use plot::errors;
pub(crate) use strip::strip;
