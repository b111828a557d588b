//! What carries a unit that rests: a plane, a tabletop, another unit, or nothing that is seen.

use nalgebra::{Point3, Vector3};
use rigidformer_core::Plane;

use super::unit::TrackedUnit;
use crate::estimate::Rest;
use crate::planes::height_m;

/// Distance of the lowest points from what carries them: metres, and radii.
const SUPPORT_M: f32 = 6e-3;
const SUPPORT_RADII: f32 = 0.06;
/// Least cosine between the normal of a plane that carries and the vertical.
const MIN_LEVEL: f32 = 0.7;
/// Share of a unit's height whose points may stand on another unit.
const LOWEST_SHARE: f32 = 0.15;

/// What carries each unit, where it rests.
pub(super) fn rests(
    units: &[TrackedUnit],
    planes: impl Fn(&TrackedUnit) -> Vec<Plane>,
    gravity: &Vector3<f32>,
) -> Vec<Rest> {
    // Without gravity nothing needs a support.
    let up = (-gravity).try_normalize(1e-6);
    let of = |unit: &TrackedUnit| match up {
        _ if !unit.anchor.holds => Rest::Moving,
        None => Rest::Supported,
        Some(up) => match is_carried(unit, units, &planes(unit), &up) {
            true => Rest::Supported,
            false => Rest::Held,
        },
    };
    units.iter().map(of).collect()
}

fn is_carried(
    unit: &TrackedUnit,
    units: &[TrackedUnit],
    planes: &[Plane],
    up: &Vector3<f32>,
) -> bool {
    let pose = unit.pose();
    let seen = unit.surface.surfels().iter().map(|surfel| surfel.point);
    let completed = unit.shape.iter().flat_map(|shape| shape.points.iter().copied());
    let points: Vec<Point3<f32>> = seen.chain(completed).map(|point| pose * point).collect();
    let radius = unit.radius_m();
    let tolerance = SUPPORT_M + SUPPORT_RADII * radius;
    let on_plane = |plane: &Plane| {
        let lowest = points.iter().map(|point| height_m(plane, &point.coords));
        plane.normal.dot(up) > MIN_LEVEL && lowest.fold(f32::MAX, f32::min).abs() < tolerance
    };
    if planes.iter().any(on_plane) {
        return true;
    }
    let heights = points.iter().map(|point| up.dot(&point.coords));
    let (low, high) =
        heights.fold((f32::MAX, f32::MIN), |(low, high), h| (low.min(h), high.max(h)));
    let limit = low + LOWEST_SHARE * (high - low);
    let feet: Vec<&Point3<f32>> =
        points.iter().filter(|point| up.dot(&point.coords) <= limit).collect();
    let middle = pose * unit.centre;
    let carries = |other: &TrackedUnit| {
        let pose = other.pose();
        let (centre, reach) = (pose * other.centre, other.radius_m() + radius + tolerance);
        // The one that carries is below, and near.
        if std::ptr::eq(unit, other)
            || up.dot(&(middle - centre)) <= 0.0
            || (middle - centre).norm() > reach
        {
            return false;
        }
        let near = (tolerance + other.surface.cell_m()).powi(2);
        feet.iter().any(|foot| {
            let found = other.surface.nearest(&pose.inverse_transform_point(foot));
            found.is_some_and(|found| found.square_m2 < near)
        })
    };
    units.iter().any(carries)
}
