//! The nearest point of any other unit, or the ground plane.

use super::dot;
use super::pose::Pose;
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

/// What is nearest to a query point.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) enum Nearest {
    /// The ground plane z = 0.
    Ground,
    /// A point of another unit.
    Point {
        /// Which unit.
        unit: usize,
        /// The point in that unit's local frame, metres.
        local: Vector3<f32>,
    },
}

/// A running search: the ground first, then units in ascending order; a later candidate
/// must be strictly nearer, so ties go to the ground, then the lowest unit, then the point
/// that comes first.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Search {
    query: Vector3<f32>,
    /// The unit that holds the nearest point so far, and where in it to look for that point.
    best: Option<(usize, usize)>,
    distance2: f32,
    distance: f32,
}

impl Search {
    /// Starts at the ground below or above the query point (world, metres).
    pub(crate) fn new(query: Vector3<f32>) -> Self {
        let distance = query.z.abs();
        Search { query, best: None, distance2: distance * distance, distance }
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
        let Some((unit, from)) = self.best else { return Nearest::Ground };
        let Some(Target { pose, points, .. }) = target(unit) else { return Nearest::Ground };
        let index = kernels.first_at(points, pose, &self.query, from, self.distance2);
        match points.get(index) {
            Some(point) => Nearest::Point { unit, local: point.coords },
            None => Nearest::Ground,
        }
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
        for _ in 0..200 {
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
            let query = Vector3::new(random(&mut state), random(&mut state), 3.0);
            let mut culled = Search::new(query);
            let mut brute = Search::new(query);
            for (unit, (pose, points)) in poses.iter().zip(&shapes).enumerate() {
                let radius = crate::geometry::radius(points);
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
