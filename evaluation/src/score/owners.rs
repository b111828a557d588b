//! Which unit a track's points lie on.

use nalgebra::Isometry3;
use rigidformer_perception::estimate::UnitEstimate;

use super::surface::Surface;

/// Points of a track that are looked at, at most.
// The share of 96 points is off that of all points by a twentieth, as a standard deviation.
const SAMPLES: usize = 96;
/// A track is a unit's where at least this share of its points lies on the unit.
// At most one unit has more than half.
const OWNS: f32 = 0.5;
/// A unit is part of another's track where at least this share of the track's points lies on it.
// A few points at a touch belong to a neighbour in any case.
const SHARES: f32 = 0.1;

/// What a track lies on.
#[derive(Clone, Debug, Default, PartialEq)]
pub(super) struct Owners {
    /// The unit that most of its points lie on.
    pub(super) on: Option<usize>,
    /// All units with a share of its points.
    pub(super) shares: Vec<usize>,
}

/// Where a track's points lie among units at these poses.
pub(super) fn owners_of(
    track: &UnitEstimate,
    surfaces: &[Surface],
    poses: &[Isometry3<f32>],
    near: f32,
) -> Owners {
    let mut counts = vec![0_u32; surfaces.len()];
    let step = track.points.len().div_ceil(SAMPLES).max(1);
    let mut all = 0_u32;
    for point in track.points.iter().step_by(step) {
        all += 1;
        let world = track.pose * point;
        let mut nearest: Option<(f32, usize)> = None;
        for (unit, (surface, pose)) in surfaces.iter().zip(poses).enumerate() {
            let own = pose.inverse_transform_point(&world);
            // Small units would own the points beside them if the limit were a length.
            let limit = near * surface.radius_m;
            // Most points are far from most units, and a sphere tells so cheaply.
            if (own - surface.centre).norm() > surface.radius_m + limit {
                continue;
            }
            let distance = surface.distance_m(&own);
            if distance <= limit && nearest.is_none_or(|(least, _)| distance < least) {
                nearest = Some((distance, unit));
            }
        }
        if let Some(count) = nearest.and_then(|(_, unit)| counts.get_mut(unit)) {
            *count += 1;
        }
    }
    let share = |count: u32| count as f32 / all.max(1) as f32;
    let numbered = || counts.iter().copied().enumerate();
    // `max_by_key` takes the last of equals, and reversed that is the first unit.
    let most = numbered().rev().max_by_key(|(_, count)| *count);
    Owners {
        on: most.filter(|(_, count)| *count > 0 && share(*count) >= OWNS).map(|(unit, _)| unit),
        shares: numbered()
            .filter(|(_, count)| *count > 0 && share(*count) >= SHARES)
            .map(|(unit, _)| unit)
            .collect(),
    }
}
