//! Whether a unit without a registration should be visible.

use nalgebra::{Isometry3, Point3};

use crate::capture::{DepthView, View};
use crate::estimate::Visibility;
use crate::surface::{Surface, Surfel};

/// Surfels that are tested, at most.
// A share needs no more of them.
const MAX_TESTED_SURFELS: usize = 60;
/// Share of visible surfels, of those that face a camera, from which a unit is missed and not hidden.
const MIN_VISIBLE_SHARE: f32 = 0.35;

/// What a depth camera measures at the position of a surfel.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum DepthTest {
    /// The surfel is out of view or occluded, or the pixel has no depth.
    NotVisible,
    /// A surface is at the position.
    Occupied,
    /// The measured point is behind the position.
    Free,
}

/// Whether a unit without a registration is hidden or missed. A cloud has no rays without points, so its units count as missed.
pub(super) fn visibility(surface: &Surface, pose: &Isometry3<f32>, views: &[View]) -> Visibility {
    let step = surface.surfels().len().div_ceil(MAX_TESTED_SURFELS).max(1);
    let (mut facing, mut visible) = (0, 0);
    let mut is_cloud = false;
    for view in views {
        let View::Depth(view) = view else {
            is_cloud = true;
            continue;
        };
        for surfel in surface.surfels().iter().step_by(step) {
            if faces(surfel, pose, view) {
                facing += 1;
                visible += u32::from(
                    depth_test(surfel, pose, view, 2.0 * surface.cell_m()) != DepthTest::NotVisible,
                );
            }
        }
    }
    let is_visible = visible as f32 > MIN_VISIBLE_SHARE * facing as f32;
    if is_cloud || (facing > 0 && is_visible) { Visibility::Missed } else { Visibility::Hidden }
}

/// Whether a depth camera measures a point well behind a surfel that should occlude it.
pub(super) fn is_in_free_space(
    surfel: &Surfel,
    pose: &Isometry3<f32>,
    views: &[View],
    margin_m: f32,
) -> bool {
    views.iter().any(|view| match view {
        View::Depth(view) => {
            faces(surfel, pose, view) && depth_test(surfel, pose, view, margin_m) == DepthTest::Free
        }
        View::Cloud(_) => false,
    })
}

fn faces(surfel: &Surfel, pose: &Isometry3<f32>, view: &DepthView) -> bool {
    let eye = view.camera.pose().translation.vector;
    let ray = (pose * surfel.point).coords - eye;
    // At grazing incidence the pixel beside may show what is behind.
    (pose * surfel.normal).dot(&ray) < -0.2 * ray.norm()
}

fn depth_test(
    surfel: &Surfel,
    pose: &Isometry3<f32>,
    view: &DepthView,
    margin_m: f32,
) -> DepthTest {
    let point: Point3<f32> = pose * surfel.point;
    let Some(([u, v], z)) = view.camera.pixel(&point) else { return DepthTest::NotVisible };
    if u < 0.0 || v < 0.0 {
        return DepthTest::NotVisible;
    }
    match view.depth_m(u.round() as u32, v.round() as u32) {
        None => DepthTest::NotVisible,
        Some(measured) if measured < z - margin_m => DepthTest::NotVisible,
        Some(measured) if measured > z + margin_m => DepthTest::Free,
        Some(_) => DepthTest::Occupied,
    }
}
