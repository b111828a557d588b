//! What other programs show: a scene in motion as MCAP, as glTF, and as a page that plays it.

#[cfg(feature = "viewers")]
mod contacts;
mod file;
#[cfg(feature = "viewers")]
mod gltf;
#[cfg(feature = "viewers")]
mod html;
#[cfg(feature = "viewers")]
mod mcap;
// The viewers alone read all of it.
#[cfg_attr(not(feature = "viewers"), allow(dead_code))]
mod moving;

pub use file::Viewers;
pub use moving::{Frame, Moving, MovingUnit};
