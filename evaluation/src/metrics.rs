//! How far predicted poses are from recorded ones.
//!
//! HopNet's protocol, per scene and frame: the position error is `sqrt(mean over units of |p - p*|²)` with `p` the
//! origin of the body frame; the orientation error of a unit is the angle `2 asin(|vector part of q⁻¹ q*|)`, of which
//! the root mean square over units is taken. HopNet's own script prints the mean over units instead: both are here,
//! under their names. Figures of a split are means over its scenes. Only free units count: the others go where they are
//! told.
//!
//! Three more say whether a prediction is plausible at all: [`rigidity`], [`Penetration`] and how far the links of a body come
//! [`apart`].
//!
//! All are computed to nearest, whatever the caller's thread has set ([`in_own_environment`]).

use nalgebra::{Isometry3, Point3, Vector3};
use rigidformer_core::kernels::in_own_environment;
use rigidformer_core::{Plane, Role};
use rigidformer_runtime::hull::ConvexHull;
use rigidformer_runtime::pivots::Pivot;

use crate::rollout::Trajectory;
use crate::scenes::{RecordedScene, RecordedUnit};

/// Errors of one scene at one frame, or their means over scenes.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct FrameErrors {
    /// Root mean square over units, metres.
    pub position_m: f64,
    /// Root mean square over units, degrees.
    pub orientation_rms_deg: f64,
    /// Mean over units, degrees.
    pub orientation_mean_deg: f64,
}

/// Angle between two orientations, degrees from 0 to 180.
pub fn angle_deg(a: &Isometry3<f32>, b: &Isometry3<f32>) -> f64 {
    in_own_environment(|| {
        let turn = a.rotation.cast::<f64>().inverse() * b.rotation.cast::<f64>();
        // Rounding makes a unit quaternion longer than 1, where asin is NaN.
        2.0 * turn.imag().norm().min(1.0).asin().to_degrees()
    })
}

/// Distances of the two images of each pivot at each sample of a prediction from a frame to another; metres.
pub fn apart(predicted: &Trajectory, pivots: &[Pivot], first: u32, last: u32) -> Vec<f64> {
    let samples = predicted.iter().filter(|(frame, _)| (first..=last).contains(frame));
    let distances =
        samples.flat_map(|(_, poses)| pivots.iter().filter_map(move |pivot| pivot.apart_m(poses)));
    in_own_environment(|| distances.collect())
}

/// How far links come apart, over pivots, samples and scenes.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Apart {
    /// Half of the distances are at most as long, metres.
    pub median_m: f64,
    /// 99 of 100 are.
    pub most_m: f64,
    /// All are.
    pub max_m: f64,
}

impl Apart {
    /// Of distances, in any order; `None` where there are none.
    ///
    /// ```
    /// use rigidformer_evaluation::metrics::Apart;
    /// let found = Apart::of((0..=100).map(f64::from).collect());
    /// assert_eq!(found, Some(Apart { median_m: 50.0, most_m: 99.0, max_m: 100.0 }));
    /// assert_eq!(Apart::of(vec![]), None);
    /// ```
    pub fn of(mut distances_m: Vec<f64>) -> Option<Apart> {
        distances_m.sort_by(f64::total_cmp);
        // Without distances there is no figure, and 0 would look like a good one.
        let last = distances_m.len().checked_sub(1)?;
        let at = |share: f64| distances_m.get((last as f64 * share).round() as usize).copied();
        in_own_environment(|| {
            Some(Apart { median_m: at(0.5)?, most_m: at(0.99)?, max_m: at(1.0)? })
        })
    }
}

/// Errors of `predicted` against the record of `scene` at a frame, over its free units; zero without any. `None` if
/// either has no such frame. Between samples the prediction is interpolated ([`Trajectory::pose`]).
pub fn frame_errors(
    predicted: &Trajectory,
    scene: &RecordedScene,
    frame: u32,
) -> Option<FrameErrors> {
    in_own_environment(|| frame_errors_here(predicted, scene, frame))
}

fn frame_errors_here(
    predicted: &Trajectory,
    scene: &RecordedScene,
    frame: u32,
) -> Option<FrameErrors> {
    let mut free = 0usize;
    let mut sums = FrameErrors::default();
    for (unit, recorded) in scene.units().iter().enumerate() {
        let found = predicted.pose(frame, unit)?;
        let truth = recorded.poses.get(frame as usize)?;
        // Files may hold any sound pose of a soft unit, so its points are measured elsewhere.
        if recorded.role != Role::Free || recorded.soft.is_some() {
            continue;
        }
        free += 1;
        let offset =
            found.translation.vector.cast::<f64>() - truth.translation.vector.cast::<f64>();
        let angle = angle_deg(&found, truth);
        sums.position_m += offset.norm_squared();
        sums.orientation_rms_deg += angle * angle;
        sums.orientation_mean_deg += angle;
    }
    // A scene without free units has no error rather than NaN.
    let count = free.max(1) as f64;
    Some(FrameErrors {
        position_m: (sums.position_m / count).sqrt(),
        orientation_rms_deg: (sums.orientation_rms_deg / count).sqrt(),
        orientation_mean_deg: sums.orientation_mean_deg / count,
    })
}

/// Mean of errors over scenes; zero for none.
pub fn mean(errors: &[FrameErrors]) -> FrameErrors {
    let count = errors.len().max(1) as f64;
    let of = |value: fn(&FrameErrors) -> f64| errors.iter().map(value).sum::<f64>() / count;
    in_own_environment(|| FrameErrors {
        position_m: of(|errors| errors.position_m),
        orientation_rms_deg: of(|errors| errors.orientation_rms_deg),
        orientation_mean_deg: of(|errors| errors.orientation_mean_deg),
    })
}

/// Largest relative change of a distance between two points of one unit, over all samples of a trajectory.
///
/// Distances are taken from every point of a unit to two far ones: its first point and the point farthest from that.
/// Pairs closer than a tenth of the longest such distance are left out, since rounding alone changes those much. What
/// is measured is what a user sees who applies the predicted poses in f32.
pub fn rigidity(predicted: &Trajectory, scene: &RecordedScene) -> f64 {
    in_own_environment(|| rigidity_here(predicted, scene))
}

fn rigidity_here(predicted: &Trajectory, scene: &RecordedScene) -> f64 {
    let mut worst: f64 = 0.0;
    let mut moved: Vec<Point3<f32>> = Vec::new();
    for (_, poses) in predicted.iter() {
        for (unit, pose) in scene.units().iter().zip(poses) {
            let Some(first) = unit.points.first() else { continue };
            let from_first = |point: &Point3<f32>| (point - first).norm();
            let far = (0..unit.points.len())
                .max_by(|a, b| {
                    from_first(&unit.points[*a]).total_cmp(&from_first(&unit.points[*b]))
                })
                .unwrap_or(0);
            // Rounding changes short distances most, relative to their length.
            let shortest = 0.1 * from_first(&unit.points[far]);
            moved.clear();
            // In f32, as users do, so that the figure has their rounding.
            moved.extend(unit.points.iter().map(|point| pose * point));
            // Two far hubs see every change of shape, at a cost that grows with the points and not
            // their square.
            for hub in [0, far] {
                for (point, moved_point) in unit.points.iter().zip(&moved) {
                    let reference = (point - unit.points[hub]).cast::<f64>().norm();
                    if reference > f64::from(shortest) {
                        let now = (moved_point - moved[hub]).cast::<f64>().norm();
                        worst = worst.max((now / reference - 1.0).abs());
                    }
                }
            }
        }
    }
    worst
}

/// How deep bodies are inside what they should stay outside of, metres; 0 for not at all.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Penetration {
    /// The deepest point of a free unit behind a plane of the scene; the plane z = 0 where the planes are not known.
    pub ground_m: f64,
    /// The deepest point of one unit inside the convex hull of another one's points: the distance to the hull's nearest
    /// face. Of two units at least one is free, and they are of different
    /// bodies. Bodies with hollows overlap by this measure also where they only interlock, so compare with that of the record.
    pub units_m: f64,
}

impl Penetration {
    /// The deeper of both, ground and units apart.
    pub fn max(self, other: Self) -> Self {
        in_own_environment(|| Self {
            ground_m: self.ground_m.max(other.ground_m),
            units_m: self.units_m.max(other.units_m),
        })
    }
}

/// Measures [`Penetration`] for the poses of one scene.
pub struct PenetrationProbe<'s> {
    scene: &'s RecordedScene,
    planes: Vec<Plane>,
    /// (units) `None` for flat ones, which nothing can be inside of.
    hulls: Vec<Vec<ConvexHull>>,
    /// (units) bounding sphere about the points' mean: centre in the body frame, radius
    spheres: Vec<(Point3<f32>, f32)>,
}

impl<'s> PenetrationProbe<'s> {
    /// Prepares a scene's units.
    pub fn new(scene: &'s RecordedScene) -> Self {
        let units = scene.units();
        let (hulls, spheres) = in_own_environment(|| {
            (units.iter().map(hulls_of).collect(), units.iter().map(bounding_sphere).collect())
        });
        // Depth does not depend on friction and restitution, so zeros do.
        let planes =
            scene.planes().map_or_else(|| vec![Plane::ground(0.0, 0.0)], <[Plane]>::to_vec);
        Self { scene, planes, hulls, spheres }
    }

    /// Penetration at the given poses, (units).
    pub fn measure(&self, poses: &[Isometry3<f32>]) -> Penetration {
        in_own_environment(|| self.measure_here(poses))
    }

    fn measure_here(&self, poses: &[Isometry3<f32>]) -> Penetration {
        let mut lowest: f32 = 0.0;
        let mut deepest: f32 = 0.0;
        for (a, (unit, pose)) in self.scene.units().iter().zip(poses).enumerate() {
            if unit.role == Role::Free {
                // Driven and fixed units go where they are told, so their depth is no error.
                lowest = unit.points.iter().fold(lowest, |lowest, point| {
                    let point = (pose * point).coords;
                    self.planes.iter().map(|plane| plane.height_m(&point)).fold(lowest, f32::min)
                });
            }
            for (b, (beside, other)) in self.scene.units().iter().zip(poses).enumerate() {
                let one_body = unit.body.is_some() && unit.body == beside.body;
                let free = unit.role == Role::Free || beside.role == Role::Free;
                // Units of one body do not collide, and nobody separates scenery from scenery.
                if a != b && free && !one_body {
                    deepest = deepest.max(self.depth_inside((a, pose), (b, other)));
                }
            }
        }
        Penetration { ground_m: f64::from(-lowest).max(0.0), units_m: f64::from(deepest) }
    }

    /// Depth of the deepest point of unit `a` inside unit `b`.
    fn depth_inside(
        &self,
        (a, pose_a): (usize, &Isometry3<f32>),
        (b, pose_b): (usize, &Isometry3<f32>),
    ) -> f32 {
        let (Some(hulls), Some(unit)) = (self.hulls.get(b), self.scene.units().get(a)) else {
            return 0.0;
        };
        let ((centre_a, radius_a), (centre_b, radius_b)) = (self.spheres[a], self.spheres[b]);
        // Most pairs are far apart, and spheres tell so without looking at faces.
        if (pose_a * centre_a - pose_b * centre_b).norm() > radius_a + radius_b {
            return 0.0;
        }
        // Points go into the frame of b once, instead of all faces of b into the world.
        let into_b = pose_b.inverse() * pose_a;
        let points = unit.points.iter().map(|point| into_b * point);
        let depths = points.flat_map(|point| hulls.iter().map(move |hull| hull.depth_m(&point)));
        depths.fold(0.0, f32::max)
    }
}

/// Of a unit's convex pieces, or of its points; none where they are flat.
fn hulls_of(unit: &RecordedUnit) -> Vec<ConvexHull> {
    if unit.pieces.is_empty() {
        // Flat units have no hull, and nothing can be inside of them.
        return ConvexHull::new(&unit.points).into_iter().collect();
    }
    unit.pieces.iter().filter_map(ConvexHull::new).collect()
}

/// Of a unit's points and of its convex pieces.
fn bounding_sphere(unit: &RecordedUnit) -> (Point3<f32>, f32) {
    let points = || unit.points.iter().chain(unit.pieces.points());
    let sum = points().fold(Vector3::zeros(), |sum, point| sum + point.coords);
    let centre = Point3::from(sum / points().count().max(1) as f32);
    (centre, points().map(|point| (point - centre).norm()).fold(0.0, f32::max))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scenes::Split;
    use rigidformer_core::Physics;

    fn cube(x: f32, z: f32) -> RecordedUnit {
        let corner =
            |i: i32| Point3::from([1, 2, 4].map(|bit| if i & bit == 0 { -0.5 } else { 0.5 }));
        let physics = Physics { mass_kg: 1.0, friction: 0.4, restitution: 0.3 };
        let points = (0..8).map(corner).collect();
        RecordedUnit::new("cube", points, physics, vec![Isometry3::translation(x, 0.0, z)])
    }

    fn scene(units: Vec<RecordedUnit>) -> RecordedScene {
        RecordedScene::new("made", 1, Split::Test, 240.0, Vector3::zeros(), units).unwrap()
    }

    fn depths(scene: &RecordedScene) -> Penetration {
        PenetrationProbe::new(scene).measure(&scene.poses_at(0).unwrap())
    }

    #[test]
    fn only_free_units_have_errors() {
        let shelf = cube(0.0, 0.5).with_role(Role::Fixed);
        let scene =
            scene(vec![cube(0.0, 2.0), shelf.clone(), cube(3.0, 2.0).with_role(Role::Driven)]);
        let mut poses = scene.poses_at(0).unwrap();
        poses[0].translation.z += 0.25;
        poses[1].translation.z += 9.0;
        poses[2].translation.z += 9.0;
        let predicted = Trajectory::new(0, 1, poses);
        assert_eq!(frame_errors(&predicted, &scene, 0).unwrap().position_m, 0.25);
        assert!(frame_errors(&predicted, &scene, 1).is_none());
        let scenery = self::scene(vec![shelf]);
        let predicted = Trajectory::new(0, 1, scenery.poses_at(0).unwrap());
        assert_eq!(frame_errors(&predicted, &scenery, 0), Some(FrameErrors::default()));
    }

    #[test]
    fn the_ground_is_taken_where_planes_are_not_known() {
        let low = scene(vec![cube(0.0, 0.4), cube(3.0, 0.3)]);
        let known = low.clone().with_planes(vec![Plane::ground(0.3, 0.5)]).unwrap();
        assert_eq!(depths(&low).ground_m, f64::from(0.5f32 - 0.3));
        assert_eq!(depths(&low), depths(&known));
        let floating = low.with_planes(Vec::new()).unwrap();
        assert_eq!(depths(&floating).ground_m, 0.0);
    }

    /// What is between the walls of a hollow unit is not in it.
    #[test]
    fn pieces_leave_room_between_them() {
        let half = |x: f32| {
            let points = cube(0.0, 0.0).points;
            points.iter().map(|point| point + Vector3::new(x, 0.0, 0.0)).collect()
        };
        let points = [half(-1.0), half(1.0)].concat();
        let whole = RecordedUnit { points, ..cube(0.0, 2.0) };
        let pieces = whole.clone().with_pieces([half(-1.0), half(1.0)].into_iter().collect());
        let between = RecordedUnit {
            points: cube(0.0, 0.0).points.iter().map(|point| point * 0.5).collect(),
            ..cube(0.0, 2.0)
        };
        let depth =
            |unit: &RecordedUnit| depths(&scene(vec![unit.clone(), between.clone()])).units_m;
        assert!(depth(&whole) > 0.2);
        assert_eq!(depth(&pieces), 0.0);
    }

    #[test]
    fn walls_are_penetrated_by_free_units_only() {
        let wall = Plane {
            normal: Vector3::new(-1.0, 0.0, 0.0),
            offset_m: -2.0,
            ..Plane::ground(0.0, 0.0)
        };
        let unit = cube(1.75, 0.5);
        let with = |unit| depths(&scene(vec![unit]).with_planes(vec![wall]).unwrap()).ground_m;
        assert_eq!(with(unit.clone()), 0.25);
        assert_eq!(with(unit.clone().with_role(Role::Driven)), 0.0);
        assert_eq!(with(unit.with_role(Role::Fixed)), 0.0);
    }

    #[test]
    fn units_of_a_body_and_scenery_may_overlap() {
        let with = |a: RecordedUnit, b: RecordedUnit| depths(&scene(vec![a, b])).units_m;
        // A corner of each is well inside the other one.
        let (a, mut b) = (cube(0.0, 1.0), cube(0.75, 1.375));
        b.poses[0].translation.y = 0.375;
        assert_eq!(with(a.clone(), b.clone()), 0.25);
        assert_eq!(with(a.clone().with_body(4), b.clone().with_body(4)), 0.0);
        assert_eq!(with(a.clone().with_body(4), b.clone().with_body(5)), 0.25);
        assert_eq!(with(a.clone(), b.clone().with_role(Role::Fixed)), 0.25);
        let (a, b) = (a.with_role(Role::Driven), b.with_role(Role::Fixed));
        assert_eq!(with(a, b), 0.0);
    }
}
