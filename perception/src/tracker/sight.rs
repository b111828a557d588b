//! Whether a unit that was not found could have been seen.

use nalgebra::{Isometry3, Point3};

use crate::capture::{DepthView, View};
use crate::estimate::Sight;
use crate::surface::{Surface, Surfel};

/// Surfels that are looked for, at most.
const LOOKS: usize = 60;
/// A unit is hidden where a smaller share of the surfels that face a camera is in plain view.
const PLAIN: f32 = 0.35;

/// What a depth camera has at the place of a surfel.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum There {
    /// The surfel is out of view, turned away, or behind something; or nothing was measured.
    Unseen,
    /// Something is at the place.
    Something,
    /// What is seen is behind the place.
    Through,
}

/// What a unit that was not found is: hidden, or missed. Clouds say nothing of what they did not hit.
pub(super) fn sight(surface: &Surface, pose: &Isometry3<f32>, views: &[View]) -> Sight {
    let step = surface.surfels().len().div_ceil(LOOKS).max(1);
    let (mut facing, mut plain) = (0, 0);
    let mut is_cloud = false;
    for view in views {
        let View::Depth(view) = view else {
            is_cloud = true;
            continue;
        };
        for surfel in surface.surfels().iter().step_by(step) {
            if faces(surfel, pose, view) {
                facing += 1;
                plain +=
                    u32::from(there(surfel, pose, view, 2.0 * surface.cell_m()) != There::Unseen);
            }
        }
    }
    let is_plain = plain as f32 > PLAIN * facing as f32;
    if is_cloud || (facing > 0 && is_plain) { Sight::Missed } else { Sight::Hidden }
}

/// Whether a depth camera sees something well behind a surfel that should hide it.
pub(super) fn is_seen_through(
    surfel: &Surfel,
    pose: &Isometry3<f32>,
    views: &[View],
    margin_m: f32,
) -> bool {
    views.iter().any(|view| match view {
        View::Depth(view) => {
            faces(surfel, pose, view) && there(surfel, pose, view, margin_m) == There::Through
        }
        View::Cloud(_) => false,
    })
}

fn faces(surfel: &Surfel, pose: &Isometry3<f32>, view: &DepthView) -> bool {
    let eye = view.camera.pose().translation.vector;
    let ray = (pose * surfel.point).coords - eye;
    (pose * surfel.normal).dot(&ray) < -0.2 * ray.norm()
}

fn there(surfel: &Surfel, pose: &Isometry3<f32>, view: &DepthView, margin_m: f32) -> There {
    let point: Point3<f32> = pose * surfel.point;
    let Some(([u, v], z)) = view.camera.pixel(&point) else { return There::Unseen };
    if u < 0.0 || v < 0.0 {
        return There::Unseen;
    }
    match view.depth_m(u.round() as u32, v.round() as u32) {
        None => There::Unseen,
        Some(seen) if seen < z - margin_m => There::Unseen,
        Some(seen) if seen > z + margin_m => There::Through,
        Some(_) => There::Something,
    }
}
