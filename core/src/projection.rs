//! What turns advanced anchors into a motion of the whole unit (docs/MODEL.md, section 7).

use crate::config::ANCHORS;
use crate::geometry::{Fit, Pose, kabsch};
use nalgebra::Vector3;

/// Deformation model of a unit. Nothing upstream knows which one runs.
pub trait Projection: Copy + Default + Sync {
    /// The pose that carries `reference` anchors (local, metres) onto the `advanced` ones
    /// (world, metres); `previous` decides what they leave open.
    fn project(
        self,
        reference: &[Vector3<f32>; ANCHORS],
        advanced: &[Vector3<f32>; ANCHORS],
        previous: &Pose,
    ) -> Fit;
}

/// Rigid units: Kabsch from the reference anchors each step, so that no drift accumulates.
#[derive(Clone, Copy, Debug, Default)]
pub struct Rigid;

impl Projection for Rigid {
    fn project(
        self,
        reference: &[Vector3<f32>; ANCHORS],
        advanced: &[Vector3<f32>; ANCHORS],
        previous: &Pose,
    ) -> Fit {
        kabsch(reference, advanced, &previous.rotation)
    }
}
