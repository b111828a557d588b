//! What other programs show: a scene in motion as MCAP, as glTF, and as a page that plays it.

mod contacts;
mod file;
mod gltf;
mod html;
mod mcap;
mod moving;

pub(crate) use file::Viewers;
pub(crate) use moving::{Frame, Moving, MovingUnit};
