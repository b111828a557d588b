//! Layers: slices in, slices out. Shapes are in the comments, rows first.

pub(crate) mod attention;
mod linear;
mod norm;

pub(crate) use linear::{Chain, Film, Linear, Mlp};
pub(crate) use norm::{add, modulate, rms_norm, rms_norm_in_place, swiglu};
