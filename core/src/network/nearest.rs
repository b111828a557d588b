//! The nearest plane, or point of a unit of another body, by looking at all of them.

use crate::contact::ground::{Plane, nearest_plane};
use crate::geometry::{Nearest, Pose, dot};
use crate::kernels::Kernels;
use crate::math;
use nalgebra::{Point3, Vector3};

/// Slack on the test that passes over a whole unit, so that rounding never passes over the
/// unit that holds the nearest point.
const SLACK: f32 = 1.0 + 1e-4;

/// One unit as a search target.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Target<'p> {
    /// Current pose.
    pub(crate) pose: &'p Pose,
    /// (points) in the unit's local frame.
    pub(crate) points: &'p [Point3<f32>],
    /// Radius about the centre, metres.
    pub(crate) radius: f32,
}

/// A running search: the planes first, then units in ascending order; a later candidate
/// must be strictly nearer, so ties go to the first plane, then the lowest unit, then the point
/// that comes first.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Search {
    query: Vector3<f32>,
    plane: Option<usize>,
    /// The unit that holds the nearest point so far, and where in it to look for that point.
    best: Option<(usize, usize)>,
    distance2: f32,
    distance: f32,
}

impl Search {
    /// Starts at the plane nearest to the query point (world, metres).
    pub(crate) fn new(query: Vector3<f32>, planes: &[Plane]) -> Self {
        let (plane, distance2) = nearest_plane(planes, &query);
        Search { query, plane, best: None, distance2, distance: math::sqrt(distance2) }
    }

    /// Compares with all points of a unit, unless its bounding sphere is too far for kernels
    /// that look at it.
    pub(crate) fn visit<K: Kernels>(&mut self, kernels: K, unit: usize, target: &Target<'_>) {
        if K::CULL {
            let delta = self.query - target.pose.centre;
            let reach = (target.radius + self.distance) * SLACK;
            if dot(&delta, &delta) > reach * reach {
                return;
            }
        }
        let Target { pose, points, .. } = target;
        let nearest = kernels.nearest(points, pose, &self.query, self.distance2);
        let Some((from, distance2)) = nearest else { return };
        self.distance2 = distance2;
        self.best = Some((unit, from));
        if K::CULL {
            self.distance = math::sqrt(distance2);
        }
    }

    /// What was nearest, given the units that were visited.
    pub(crate) fn nearest<'p, K: Kernels>(
        &self,
        kernels: K,
        target: impl Fn(usize) -> Option<Target<'p>>,
    ) -> Nearest {
        let of_plane = self.plane.map_or(Nearest::Nothing, Nearest::Plane);
        let Some((unit, from)) = self.best else { return of_plane };
        let Some(Target { pose, points, .. }) = target(unit) else { return of_plane };
        let point = kernels.first_at(points, pose, &self.query, from, self.distance2);
        Nearest::Point { unit, point }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::kernels::Portable;
    use nalgebra::Matrix3;

    fn random(state: &mut u32) -> f32 {
        *state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
        (*state >> 8) as f32 / (1 << 23) as f32 - 1.0
    }

    /// Passing over far units never changes the answer.
    #[test]
    fn culling_equals_brute_force() {
        let mut state = 7;
        for round in 0..200 {
            let mut shapes = [[Point3::origin(); 20]; 6];
            for p in shapes.as_flattened_mut() {
                *p = Point3::new(random(&mut state), random(&mut state), random(&mut state));
            }
            let poses: [Pose; 6] = core::array::from_fn(|_| Pose {
                rotation: Matrix3::identity(),
                centre: Vector3::new(
                    4.0 * random(&mut state),
                    4.0 * random(&mut state),
                    4.0 + 4.0 * random(&mut state),
                ),
            });
            let wall =
                Plane { normal: Vector3::x(), offset_m: -2.0, friction: 0.5, restitution: 0.5 };
            let planes = [Plane::ground(0.3, 0.5), wall];
            let planes = &planes[..round % 3];
            let query = Vector3::new(random(&mut state), random(&mut state), 3.0);
            let mut culled = Search::new(query, planes);
            let mut brute = Search::new(query, planes);
            for (unit, (pose, points)) in poses.iter().zip(&shapes).enumerate() {
                let radius = crate::geometry::radius_here(points);
                culled.visit(Portable, unit, &Target { pose, points, radius });
                brute.visit(Portable, unit, &Target { pose, points, radius: 1e6 });
            }
            let target = |unit: usize| {
                Some(Target { pose: poses.get(unit)?, points: shapes.get(unit)?, radius: 0.0 })
            };
            assert_eq!(culled.nearest(Portable, target), brute.nearest(Portable, target));
        }
    }
}
