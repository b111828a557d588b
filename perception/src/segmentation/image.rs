//! What is segmented.

/// No segment.
pub(crate) const NONE: u32 = u32::MAX;

/// An image to segment.
pub(crate) struct Image<'i> {
    pub(crate) width: usize,
    pub(crate) focal: [f32; 2],
    pub(crate) centre: [f32; 2],
    /// (height * width) Depth of pixels of no plane; 0 for all others, metres.
    pub(crate) depth_m: &'i [f32],
    /// (height * width) Pixels of different numbers are of different bodies, whatever their depths.
    pub(crate) supports: &'i [u8],
    /// (height * width) All depths, those of planes among them; 0: not measured, metres.
    pub(crate) all_m: &'i [f32],
    /// Change of depth between neighbouring pixels from which they are of two surfaces, metres, at a depth in metres.
    pub(crate) gap: &'i (dyn Fn(f32) -> f32 + Sync),
}
