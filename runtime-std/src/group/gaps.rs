//! How far units of different members are apart, and how deep they are in each other.

use nalgebra::{Isometry3, Point3, Vector3};
use rigidformer_core::UnitId;
use rigidformer_core::geometry::hull_distance;

use super::id::MemberId;
use super::member::Member;
use super::presence::{self, Presence};

use crate::hull::ConvexHull;

/// Metres that two units come nearer at most between two looks at a step.
// Thinner than any link that matters; half of it is what a look between two may miss.
const LOOK_M: f32 = 0.02;
/// Looks at a step, at most: it bounds the time, and what is faster is missed by more.
const MOST_LOOKS: usize = 64;
/// Supports that the depth of an overlap is found by, at most. Boxes take 10, balls of 100 points 30.
const MOST_SUPPORTS: usize = 128;

/// How far two units of different members are apart, hull from hull.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Gap {
    /// Whose units.
    pub members: [MemberId; 2],
    /// The units, each in its member's world.
    pub units: [UnitId; 2],
    /// Metres between their convex hulls; negative where they overlap: the shortest way that would take them apart.
    pub gap_m: f32,
    /// When in the step, from 0 at its start to 1 at its end.
    pub share: f32,
}

/// A unit and its points, for the search.
struct Shape {
    presence: Presence,
    points: Vec<Point3<f32>>,
}

fn shapes(member: &Member) -> Vec<Shape> {
    let simulator = member.world.simulator();
    let presences = presence::presences(&member.world).into_iter();
    let shapes = presences.filter_map(|presence| {
        let unit = simulator.get(presence.id)?;
        let points = unit.points().map(|point| presence.now.inverse_transform_point(&point));
        // The last step, from its start to its end.
        let (now, next) = (member.world.previous_pose(presence.id)?, presence.now);
        let middle = now * presence.now.inverse_transform_point(&presence.middle);
        Some(Shape {
            points: points.collect(),
            presence: Presence { now, next, middle, ..presence },
        })
    });
    shapes.collect()
}

/// All pairs of units of different members that come as near as `within_m`, the nearest first. In the whole of the last step, or
/// only at its end.
pub(super) fn gaps(members: &[Member], within_m: f32, in_step: bool) -> Vec<Gap> {
    let all: Vec<(MemberId, Vec<Shape>)> =
        members.iter().map(|member| (member.id, shapes(member))).collect();
    let balls: Vec<_> = all
        .iter()
        .map(|(_, shapes)| {
            let presences: Vec<Presence> = shapes.iter().map(|shape| shape.presence).collect();
            presence::around(&presences)
        })
        .collect();
    let mut found = Vec::new();
    for (number, (one, shapes)) in all.iter().enumerate() {
        for (other, theirs) in all.iter().zip(&balls).skip(number + 1).filter_map(|(them, ball)| {
            let (Some((middle, radius)), Some((place, reach))) = (balls[number], *ball) else {
                return None;
            };
            ((middle - place).norm() - (radius + reach) <= within_m).then_some((them.0, &them.1))
        }) {
            for (a, b) in shapes.iter().flat_map(|a| theirs.iter().map(move |b| (a, b))) {
                if a.presence.room_m(&b.presence) > within_m {
                    continue;
                }
                if let Some((gap_m, share)) = least(a, b, within_m, in_step) {
                    let units = [a.presence.id, b.presence.id];
                    found.push(Gap { members: [*one, other], units, gap_m, share });
                }
            }
        }
    }
    // Of equals the first members' first units come first.
    found.sort_by(|a, b| a.gap_m.total_cmp(&b.gap_m));
    found
}

/// The least gap of two units, and when; none beyond `within_m`.
fn least(a: &Shape, b: &Shape, within_m: f32, in_step: bool) -> Option<(f32, f32)> {
    let looks = if in_step { looks(&a.presence, &b.presence) } else { 1 };
    let mut best: Option<(f32, f32)> = None;
    for look in 0..=looks {
        // The end alone, unless the whole step is asked for.
        if look < looks && !in_step {
            continue;
        }
        let share = look as f32 / looks as f32;
        let poses = [a, b].map(|shape| presence::between(&shape.presence, share));
        let gap = gap_m([&a.points, &b.points], &poses);
        if gap <= within_m && best.is_none_or(|(least, _)| gap < least) {
            best = Some((gap, share));
        }
    }
    best
}

fn looks(a: &Presence, b: &Presence) -> usize {
    let way = a.reach_m() + b.reach_m();
    ((way / LOOK_M).ceil() as usize).clamp(1, MOST_LOOKS)
}

/// Metres between two hulls; negative the depth of their overlap.
fn gap_m([a, b]: [&[Point3<f32>]; 2], [from, to]: &[Isometry3<f32>; 2]) -> f32 {
    // Where they just touch it is 0, and not the other zero.
    hull_distance([(a, from), (b, to)]).unwrap_or_else(|| 0.0 - depth_m([a, b], [from, to]))
}

/// The shortest way that takes two hulls that overlap apart: from the origin to the surface of the hull of all differences of their
/// points, whose nearest face supports in turn push outwards (expanding polytope). 0 where that has no volume.
fn depth_m([a, b]: [&[Point3<f32>]; 2], [from, to]: [&Isometry3<f32>; 2]) -> f32 {
    let apart = from.translation.vector - to.translation.vector;
    let support = |along: &Vector3<f32>| {
        let most = |points: &[Point3<f32>], pose: &Isometry3<f32>, along: Vector3<f32>| {
            let local = pose.rotation.inverse() * along;
            let reach = |point: &Point3<f32>| point.coords.dot(&local);
            let best = points.iter().max_by(|a, b| reach(a).total_cmp(&reach(b)));
            best.map(|point| pose.rotation * point.coords).unwrap_or_default()
        };
        Point3::from(most(a, from, *along) - most(b, to, -along) + apart)
    };
    let mut corners: Vec<Point3<f32>> = Vec::new();
    let sides = [-1.0, 0.0, 1.0_f32];
    for along in sides.iter().flat_map(|x| sides.iter().map(move |y| (*x, *y))) {
        for z in sides {
            let corner = support(&Vector3::new(along.0, along.1, z));
            if !corners.contains(&corner) {
                corners.push(corner);
            }
        }
    }
    for _ in 0..MOST_SUPPORTS {
        let Some(hull) = ConvexHull::new(&corners) else { return 0.0 };
        let Some((normal, offset)) = hull.nearest_face() else { return 0.0 };
        let corner = support(&normal);
        // No point of the differences is beyond the face: it is one of theirs.
        if normal.dot(&corner.coords) - offset <= 1e-5 * offset.abs().max(1e-3)
            || corners.contains(&corner)
        {
            return offset.max(0.0);
        }
        corners.push(corner);
    }
    // A lower bound: faces only move outwards.
    ConvexHull::new(&corners)
        .and_then(|hull| hull.nearest_face())
        .map_or(0.0, |(_, depth)| depth.max(0.0))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn cuboid([x, y, z]: [f32; 3]) -> Vec<Point3<f32>> {
        let side = |i: usize, bit: usize, half: f32| if i & bit == 0 { -half } else { half };
        (0..8).map(|i| Point3::new(side(i, 1, x), side(i, 2, y), side(i, 4, z))).collect()
    }

    #[test]
    fn gaps_of_boxes_are_their_distance_or_their_depth() {
        let (a, b) = (cuboid([0.1, 0.2, 0.3]), cuboid([0.1; 3]));
        let here = Isometry3::translation(5.0, 0.0, 1.0);
        for (x, expected) in [(0.5, 0.3), (0.21, 0.01), (0.19, -0.01), (0.05, -0.15)] {
            let there = here * Isometry3::translation(x, 0.02, 0.03);
            let gap = gap_m([&a, &b], &[here, there]);
            assert!((gap - expected).abs() < 1e-5, "{x}: {gap}");
            assert_eq!(gap, gap_m([&a, &b], &[here, there]));
        }
        // Turned by 45 degrees an edge points at the other's face.
        let turn = Isometry3::rotation(Vector3::z() * std::f32::consts::FRAC_PI_4);
        let there = here * Isometry3::translation(0.2, 0.0, 0.0) * turn;
        let expected = 0.2 - 0.1 - 0.1 * std::f32::consts::SQRT_2;
        let gap = gap_m([&a, &b], &[here, there]);
        assert!((gap - expected).abs() < 1e-5, "{gap}, {expected}");
    }

    #[test]
    fn depths_of_round_units_are_those_of_their_points() {
        let ball: Vec<Point3<f32>> = (0..200)
            .map(|i| {
                let z = 1.0 - (2 * i + 1) as f32 / 200.0;
                let (sin, cos) = (2.4 * i as f32).sin_cos();
                Point3::from(
                    Vector3::new((1.0 - z * z).sqrt() * cos, (1.0 - z * z).sqrt() * sin, z) * 0.1,
                )
            })
            .collect();
        let here = Isometry3::identity();
        for x in [0.12, 0.15, 0.18] {
            let gap = gap_m([&ball, &ball], &[here, Isometry3::translation(x, 0.01, 0.02)]);
            let expected = (x * x + 0.0005_f32).sqrt() - 0.2;
            // 200 points lie up to 3 % inside of the ball.
            assert!(gap < 0.0 && (gap - expected).abs() < 0.01, "{gap} {expected}");
        }
    }
}
