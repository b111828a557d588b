//! Paths of the pusher over the ground: where it touches the body's outline, and how it gets there.

use nalgebra::{Isometry3, Point3, Vector2};
use rigidformer_core::math;

/// Distance that counts as contact, relative to the outline's reach.
// Sphere tracing approaches the contact without reaching it.
const CONTACT_TOLERANCE: f32 = 1e-3;
/// Steps of sphere tracing towards the outline, at most.
const MAX_TRACE_STEPS: usize = 64;
/// Angle between corners of an arc around the body, radians.
// The chords stay within .13 % of the radius of the circle.
const ARC_STEP_RAD: f32 = 0.1;
/// Steps of a section of a path, at most, beside the last one.
// It bounds memory where a pace is tiny against the distance.
pub(super) const MAX_STEPS: usize = 1 << 22;

/// The convex hull of a body's points, seen from above, in the world.
#[derive(Clone, Debug)]
pub(super) struct Outline {
    centre: Vector2<f32>,
    /// Counter-clockwise.
    corners: Vec<Vector2<f32>>,
}

impl Outline {
    pub(super) fn new(points: &[Point3<f32>], pose: &Isometry3<f32>) -> Outline {
        let mut all: Vec<Vector2<f32>> =
            points.iter().map(|point| (pose * point).coords.xy()).collect();
        all.sort_by(|a, b| a.x.total_cmp(&b.x).then(a.y.total_cmp(&b.y)));
        let mut corners: Vec<Vector2<f32>> = Vec::new();
        // Andrew's monotone chain: the lower side from the left, then the upper one back.
        for pass in 0..2 {
            let first = corners.len();
            for index in 0..all.len() {
                let point = all[if pass == 0 { index } else { all.len() - 1 - index }];
                while let [.., a, b] = corners[first..] {
                    if cross(b - a, point - b) > 0.0 {
                        break;
                    }
                    corners.pop();
                }
                corners.push(point);
            }
            corners.pop();
        }
        Outline { centre: pose.translation.vector.xy(), corners }
    }

    pub(super) fn corners(&self) -> usize {
        self.corners.len()
    }

    /// The greatest distance from the centre, metres.
    pub(super) fn reach_m(&self) -> f32 {
        self.corners.iter().map(|corner| (corner - self.centre).norm()).fold(0.0, f32::max)
    }

    fn edges(&self) -> impl Iterator<Item = (Vector2<f32>, Vector2<f32>)> + '_ {
        let next = self.corners.iter().cycle().skip(1);
        self.corners.iter().copied().zip(next.copied())
    }

    /// (edges) The middle of each, relative to the centre, and its length along, metres: long edges first.
    pub(super) fn sides(&self) -> Vec<(Vector2<f32>, Vector2<f32>)> {
        let mut sides: Vec<_> =
            self.edges().map(|(a, b)| ((a + b) / 2.0 - self.centre, b - a)).collect();
        sides.sort_by(|a, b| b.1.norm().total_cmp(&a.1.norm()));
        sides
    }

    /// Signed distance of a point, metres; negative inside.
    pub(super) fn distance_m(&self, point: Vector2<f32>) -> f32 {
        let (mut inside, mut nearest) = (f32::NEG_INFINITY, f32::INFINITY);
        for (a, b) in self.edges() {
            let (along, to) = (b - a, point - a);
            let length = along.norm().max(f32::MIN_POSITIVE);
            inside = inside.max(-cross(along, to) / length);
            let fraction = (to.dot(&along) / (length * length)).clamp(0.0, 1.0);
            nearest = nearest.min((to - along * fraction).norm());
        }
        // Outside, the distance to edges counts: that to their lines is too small behind a corner.
        if inside < 0.0 { inside } else { nearest }
    }

    /// Centre of a circle at its first contact, as it moves along `direction`, `offset` to the left of the outline's centre. None if it
    /// misses.
    pub(super) fn touch(
        &self,
        direction: Vector2<f32>,
        offset: f32,
        radius: f32,
    ) -> Option<Vector2<f32>> {
        let reach = self.reach_m();
        let line = self.centre + left_of(direction) * offset;
        let mut along = -(reach + radius) * 2.0;
        for _ in 0..MAX_TRACE_STEPS {
            let gap = self.distance_m(line + direction * along) - radius;
            if gap < CONTACT_TOLERANCE * reach {
                return Some(line + direction * along);
            }
            along += gap;
            // The circle is behind the outline.
            if along > reach + radius {
                return None;
            }
        }
        Some(line + direction * along)
    }

    /// Whether a circle can move straight from one position to another: it may touch, but not push.
    fn is_clear(&self, from: Vector2<f32>, to: Vector2<f32>, radius: f32) -> bool {
        let (reach, length) = (self.reach_m(), (to - from).norm());
        let samples =
            (length / (0.05 * reach).max(f32::MIN_POSITIVE)).ceil().clamp(1.0, 1000.0) as u32;
        (0..=samples).all(|index| {
            let position = from + (to - from) * (index as f32 / samples as f32);
            // At its present position it may overlap a little more: the last push ended in contact.
            let allowed = if index == 0 { 0.1 } else { 0.02 };
            self.distance_m(position) > radius - allowed * reach
        })
    }

    /// Corners of a path of the circle's centre from `from` to `to`, without `from`. `to` lies on a line that comes from outside along
    /// `direction`. The path keeps `room` away from the circle about the body where it cannot go straight.
    pub(super) fn around(
        &self,
        from: Vector2<f32>,
        to: Vector2<f32>,
        direction: Vector2<f32>,
        radius: f32,
        room: f32,
    ) -> Vec<Vector2<f32>> {
        if self.is_clear(from, to, radius) {
            return vec![to];
        }
        let ring = self.reach_m() + radius + room;
        let mut corners = Vec::new();
        let mut here = from - self.centre;
        // From inside the ring the path first leaves it radially.
        if here.norm() < ring {
            here = here.try_normalize(1e-6).unwrap_or(-direction) * ring;
            corners.push(self.centre + here);
        }
        // Where the line enters the ring.
        let aside = cross(direction, to - self.centre).clamp(-ring, ring);
        let gate = left_of(direction) * aside - direction * math::sqrt(ring * ring - aside * aside);
        // Angle to the gate, and angle of the tangent from here: the path joins the ring at the tangent.
        let turn = cross(here, gate).atan2(here.dot(&gate));
        let visible_angle = (ring / here.norm().max(ring)).acos();
        let side = turn.signum();
        let mut at = visible_angle;
        while at < turn.abs() {
            let (sin, cos) = math::sin_cos(side * at);
            let out = here.normalize() * ring;
            corners.push(
                self.centre + Vector2::new(out.x * cos - out.y * sin, out.x * sin + out.y * cos),
            );
            at += ARC_STEP_RAD;
        }
        corners.push(self.centre + gate);
        corners.push(to);
        corners
    }
}

/// z of the cross product: above 0 if b points to the left of a.
pub(super) fn cross(a: Vector2<f32>, b: Vector2<f32>) -> f32 {
    a.x * b.y - a.y * b.x
}

pub(super) fn left_of(direction: Vector2<f32>) -> Vector2<f32> {
    Vector2::new(-direction.y, direction.x)
}

/// Calls `visit` with positions a step apart on a path through `corners` at an even pace, the last one at its end. Returns their number;
/// none where [`MAX_STEPS`] do not suffice, or where a step is less than the resolution of coordinates.
pub(super) fn paced(
    from: Vector2<f32>,
    corners: &[Vector2<f32>],
    pace: f32,
    mut visit: impl FnMut([f32; 2]),
) -> Option<usize> {
    let (mut here, mut left, mut count) = (from, pace, 0);
    for corner in corners {
        let mut distance = (corner - here).norm();
        while distance > left {
            let before = here;
            here += (corner - here) * (left / distance);
            // Behind a corner the rest of a step may be 0, which is no lack of resolution.
            if (here == before && left == pace) || count >= MAX_STEPS {
                return None;
            }
            visit(here.into());
            (count, left) = (count + 1, pace);
            distance = (corner - here).norm();
        }
        left -= distance;
        here = *corner;
    }
    if left < pace {
        visit(here.into());
        count += 1;
    }
    Some(count)
}
