//! What is segmented.

use nalgebra::Vector3;

/// No segment.
pub(crate) const NONE: u32 = u32::MAX;

/// An image to segment.
pub(crate) struct Image<'i> {
    pub(crate) width: usize,
    pub(crate) focal: [f32; 2],
    pub(crate) centre: [f32; 2],
    /// (height * width) Depth of pixels of no plane; 0 for all others, metres.
    pub(crate) depth_m: &'i [f32],
    pub(crate) tabletops: Tabletops<'i>,
    /// (height * width) All depths, those of planes among them; 0: not measured, metres.
    pub(crate) all_m: &'i [f32],
    /// Change of depth between neighbouring pixels from which they are of two surfaces, metres, at a depth in metres.
    pub(crate) gap: &'i (dyn Fn(f32) -> f32 + Sync),
}

/// Level faces that bodies stand on, a bit each.
#[derive(Clone, Copy)]
pub(crate) struct Tabletops<'i> {
    /// The vertical in the camera's frame, of length 1.
    pub(crate) up: Vector3<f32>,
    /// (height * width, or none) Those that a pixel is above.
    pub(crate) above: &'i [u8],
    /// (height * width, or none) Those at whose height and in whose extent a pixel is.
    pub(crate) level: &'i [u8],
}
