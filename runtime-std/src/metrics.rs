//! How far predicted poses are from recorded ones.
//!
//! HopNet's protocol, per scene and frame: the position error is `sqrt(mean over units of |p - p*|²)` with `p` the
//! origin of the body frame; the orientation error of a unit is the angle `2 asin(|vector part of q⁻¹ q*|)`, of which
//! the root mean square over units is taken. HopNet's own script prints the mean over units instead: both are here,
//! under their names. Figures of a split are means over its scenes.
//!
//! Two more say whether a prediction is plausible at all: [`rigidity`] and [`Penetration`].

use nalgebra::{Isometry3, Point3, Vector3};

use crate::hull::ConvexHull;
use crate::rollout::Trajectory;
use crate::scenes::RecordedScene;

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
    let turn = a.rotation.cast::<f64>().inverse() * b.rotation.cast::<f64>();
    2.0 * turn.imag().norm().min(1.0).asin().to_degrees()
}

/// Errors of `predicted` against the record of `scene` at a frame; `None` if either has no such frame. Between
/// samples the prediction is interpolated ([`Trajectory::pose`]).
pub fn frame_errors(
    predicted: &Trajectory,
    scene: &RecordedScene,
    frame: u32,
) -> Option<FrameErrors> {
    let units = scene.units().len();
    let mut sums = FrameErrors::default();
    for unit in 0..units {
        let found = predicted.pose(frame, unit)?;
        let truth = scene.pose(frame as usize, unit)?;
        let offset =
            found.translation.vector.cast::<f64>() - truth.translation.vector.cast::<f64>();
        let angle = angle_deg(&found, truth);
        sums.position_m += offset.norm_squared();
        sums.orientation_rms_deg += angle * angle;
        sums.orientation_mean_deg += angle;
    }
    let count = units as f64;
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
    FrameErrors {
        position_m: of(|errors| errors.position_m),
        orientation_rms_deg: of(|errors| errors.orientation_rms_deg),
        orientation_mean_deg: of(|errors| errors.orientation_mean_deg),
    }
}

/// Largest relative change of a distance between two points of one unit, over all samples of a trajectory.
///
/// Distances are taken from every point of a unit to two far ones: its first point and the point farthest from that.
/// Pairs closer than a tenth of the longest such distance are left out, since rounding alone changes those much. What
/// is measured is what a user sees who applies the predicted poses in f32.
pub fn rigidity(predicted: &Trajectory, scene: &RecordedScene) -> f64 {
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
            let shortest = 0.1 * from_first(&unit.points[far]);
            moved.clear();
            moved.extend(unit.points.iter().map(|point| pose * point));
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
    /// The deepest point below the ground plane z = 0.
    pub ground_m: f64,
    /// The deepest point of one unit inside the convex hull of another one's points: the distance to the hull's nearest
    /// face. Bodies with hollows overlap by this measure also where they only interlock, so compare with that of the
    /// record.
    pub units_m: f64,
}

impl Penetration {
    /// The deeper of both, ground and units apart.
    pub fn max(self, other: Self) -> Self {
        Self {
            ground_m: self.ground_m.max(other.ground_m),
            units_m: self.units_m.max(other.units_m),
        }
    }
}

/// Measures [`Penetration`] for the poses of one scene.
pub struct PenetrationProbe<'s> {
    scene: &'s RecordedScene,
    /// (units) `None` for flat ones, which nothing can be inside of.
    hulls: Vec<Option<ConvexHull>>,
    /// (units) bounding sphere about the points' mean: centre in the body frame, radius
    spheres: Vec<(Point3<f32>, f32)>,
}

impl<'s> PenetrationProbe<'s> {
    /// Prepares a scene's units.
    pub fn new(scene: &'s RecordedScene) -> Self {
        let units = scene.units();
        let hulls = units.iter().map(|unit| ConvexHull::new(&unit.points)).collect();
        let spheres = units.iter().map(|unit| bounding_sphere(&unit.points)).collect();
        Self { scene, hulls, spheres }
    }

    /// Penetration at the given poses, (units).
    pub fn measure(&self, poses: &[Isometry3<f32>]) -> Penetration {
        let mut lowest: f32 = 0.0;
        let mut deepest: f32 = 0.0;
        for (a, (unit, pose)) in self.scene.units().iter().zip(poses).enumerate() {
            lowest = unit.points.iter().map(|point| (pose * point).z).fold(lowest, f32::min);
            for (b, other) in poses.iter().enumerate() {
                if a != b {
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
        let (Some(Some(hull)), Some(unit)) = (self.hulls.get(b), self.scene.units().get(a)) else {
            return 0.0;
        };
        let ((centre_a, radius_a), (centre_b, radius_b)) = (self.spheres[a], self.spheres[b]);
        if (pose_a * centre_a - pose_b * centre_b).norm() > radius_a + radius_b {
            return 0.0;
        }
        let into_b = pose_b.inverse() * pose_a;
        unit.points.iter().map(|point| hull.depth_m(&(into_b * point))).fold(0.0, f32::max)
    }
}

fn bounding_sphere(points: &[Point3<f32>]) -> (Point3<f32>, f32) {
    let sum = points.iter().fold(Vector3::zeros(), |sum, point| sum + point.coords);
    let centre = Point3::from(sum / points.len().max(1) as f32);
    (centre, points.iter().map(|point| (point - centre).norm()).fold(0.0, f32::max))
}
