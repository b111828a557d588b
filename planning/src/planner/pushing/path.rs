//! Ways of the pusher over the ground: where it touches the body's outline, and how it comes there.

use nalgebra::{Isometry3, Point3, Vector2};
use rigidformer_core::math;

/// Nearer than this counts as touching, metres per metre of the outline's reach.
const TOUCHING: f32 = 1e-3;
/// At most so many steps towards the outline: each halves what is left, or more.
const TRACES: usize = 64;
/// Steps of an arc around the body, radians.
const ARC_RAD: f32 = 0.1;
/// Steps of a part of a path, at most, but for its last.
pub(super) const MOST_STEPS: usize = 1 << 22;

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
        // The lower side from the left, then the upper one back.
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

    /// How far a point is outside, metres; negative inside.
    pub(super) fn distance_m(&self, point: Vector2<f32>) -> f32 {
        let (mut inside, mut nearest) = (f32::NEG_INFINITY, f32::INFINITY);
        for (a, b) in self.edges() {
            let (along, to) = (b - a, point - a);
            let length = along.norm().max(f32::MIN_POSITIVE);
            inside = inside.max(-cross(along, to) / length);
            let part = (to.dot(&along) / (length * length)).clamp(0.0, 1.0);
            nearest = nearest.min((to - along * part).norm());
        }
        if inside < 0.0 { inside } else { nearest }
    }

    /// Where a circle first touches that comes along `way`, `offset` to the left of the centre: its centre then. None
    /// if it passes.
    pub(super) fn touch(
        &self,
        way: Vector2<f32>,
        offset: f32,
        radius: f32,
    ) -> Option<Vector2<f32>> {
        let reach = self.reach_m();
        let line = self.centre + left_of(way) * offset;
        let mut along = -(reach + radius) * 2.0;
        for _ in 0..TRACES {
            let gap = self.distance_m(line + way * along) - radius;
            if gap < TOUCHING * reach {
                return Some(line + way * along);
            }
            along += gap;
            if along > reach + radius {
                return None;
            }
        }
        Some(line + way * along)
    }

    /// Whether a circle can go straight from one place to another: it may touch, but not push.
    fn clear(&self, from: Vector2<f32>, to: Vector2<f32>, radius: f32) -> bool {
        let (reach, length) = (self.reach_m(), (to - from).norm());
        let parts =
            (length / (0.05 * reach).max(f32::MIN_POSITIVE)).ceil().clamp(1.0, 1000.0) as u32;
        (0..=parts).all(|part| {
            let place = from + (to - from) * (part as f32 / parts as f32);
            // Where it stands now it may touch a little more.
            let allowed = if part == 0 { 0.1 } else { 0.02 };
            self.distance_m(place) > radius - allowed * reach
        })
    }

    /// Corners of a way of the circle's centre from `from` to `to`, which lies on a line that comes from outside along
    /// `way`; without `from`. It keeps `room` away from the circle about the body where it cannot go straight.
    pub(super) fn around(
        &self,
        from: Vector2<f32>,
        to: Vector2<f32>,
        way: Vector2<f32>,
        radius: f32,
        room: f32,
    ) -> Vec<Vector2<f32>> {
        if self.clear(from, to, radius) {
            return vec![to];
        }
        let ring = self.reach_m() + radius + room;
        let mut corners = Vec::new();
        let mut here = from - self.centre;
        if here.norm() < ring {
            here = here.try_normalize(1e-6).unwrap_or(-way) * ring;
            corners.push(self.centre + here);
        }
        // Where the line comes in.
        let aside = cross(way, to - self.centre).clamp(-ring, ring);
        let gate = left_of(way) * aside - way * math::sqrt(ring * ring - aside * aside);
        // So far around is the gate, and so far one sees around from here.
        let turn = cross(here, gate).atan2(here.dot(&gate));
        let seen = (ring / here.norm().max(ring)).acos();
        let side = turn.signum();
        let mut at = seen;
        while at < turn.abs() {
            let (sin, cos) = math::sin_cos(side * at);
            let out = here.normalize() * ring;
            corners.push(
                self.centre + Vector2::new(out.x * cos - out.y * sin, out.x * sin + out.y * cos),
            );
            at += ARC_RAD;
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

pub(super) fn left_of(way: Vector2<f32>) -> Vector2<f32> {
    Vector2::new(-way.y, way.x)
}

/// Calls `visit` with the places a step apart on a way through `corners` at an even pace, the last one at its end. How
/// many they are; none where they do not get there in [`MOST_STEPS`]: far from the origin a step can be less than
/// what coordinates resolve.
pub(super) fn paced(
    from: Vector2<f32>,
    corners: &[Vector2<f32>],
    pace: f32,
    mut visit: impl FnMut([f32; 2]),
) -> Option<usize> {
    let (mut here, mut left, mut count) = (from, pace, 0);
    for corner in corners {
        let mut way = (corner - here).norm();
        while way > left {
            let before = here;
            here += (corner - here) * (left / way);
            // What is left of a step at a corner may be nothing.
            if (here == before && left == pace) || count >= MOST_STEPS {
                return None;
            }
            visit(here.into());
            (count, left) = (count + 1, pace);
            way = (corner - here).norm();
        }
        left -= way;
        here = *corner;
    }
    if left < pace {
        visit(here.into());
        count += 1;
    }
    Some(count)
}
