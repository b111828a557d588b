//! Contacts of the units that are shown: when units meet, by the frames that follow.

use std::ops::Range;

use nalgebra::{Isometry3, Point3};
use parry3d::math::{Pose, Rotation, Vector};
use parry3d::query::ClosestPoints;
use parry3d::query::details::closest_points_support_map_support_map;
use parry3d::shape::SupportMap;
use rigidformer_core::{Plane, Role};

use super::moving::{Frame, Moving, MovingUnit};
use crate::interrupt;

/// Hulls this close touch, metres: as in the core's impacts.
const TOUCH_M: f32 = 1e-3;

/// What a unit meets.
#[derive(Clone, Copy)]
pub(super) enum Met {
    /// A unit with a higher number.
    Unit(usize),
    Plane(usize),
}

impl Met {
    pub(super) fn unit(self) -> Option<usize> {
        match self {
            Met::Unit(unit) => Some(unit),
            Met::Plane(_) => None,
        }
    }
}

/// A contact that is there at a frame, or that later frames have.
pub(super) struct Contact {
    pub(super) unit: usize,
    pub(super) met: Met,
    /// Until both touch; 0 while they do.
    pub(super) time_s: f64,
    /// Between the hulls; negative behind a plane, and 0 for units that overlap.
    pub(super) distance_m: f32,
    /// In the world, metres: the unit's point that is nearest, and that of what it meets. None for units that overlap.
    pub(super) nearest: Option<[Point3<f32>; 2]>,
}

/// (frames) Contacts of the first poses of `moving`, those of its prediction: of units of which one is free and which
/// are not parts of one body, and of free units and planes. Soft units have none: their shapes are not shown.
///
/// Between the last frame without a contact and the first with it distance is taken to shrink evenly. Units that meet and part again
/// between two frames are found too, by how they move before and after.
pub(super) fn contacts(moving: &Moving) -> anyhow::Result<Vec<Vec<Contact>>> {
    let bodies: Vec<Body<'_>> = moving.units.iter().map(Body::new).collect();
    let mut all: Vec<Vec<Contact>> = moving.frames().iter().map(|_| Vec::new()).collect();
    for (unit, body) in bodies.iter().enumerate() {
        interrupt::check()?;
        if body.unit.is_soft {
            continue;
        }
        for (other, beside) in bodies.iter().enumerate().skip(unit + 1) {
            let parts = body.unit.body.is_some() && body.unit.body == beside.unit.body;
            let is_free = [body, beside].iter().any(|body| body.unit.role == Role::Free);
            if is_free && !parts && !beside.unit.is_soft {
                let pair = Pair {
                    poses: |frame: &Frame| Some([sound(frame, unit)?, sound(frame, other)?]),
                    room: |[one, two]: &Poses| body.room(one, beside, two),
                    gap: |[one, two]: &Poses| body.gap(one, beside, two),
                };
                pair.add(moving, (unit, Met::Unit(other)), &mut all)?;
            }
        }
        for (number, plane) in moving.planes.iter().enumerate() {
            if body.unit.role == Role::Free {
                let pair = Pair {
                    poses: |frame: &Frame| Some([sound(frame, unit)?, Isometry3::identity()]),
                    room: |[one, _]: &Poses| body.gap_to_plane(one, plane).0,
                    gap: |[one, _]: &Poses| body.gap_to_plane(one, plane),
                };
                pair.add(moving, (unit, Met::Plane(number)), &mut all)?;
            }
        }
    }
    Ok(all)
}

/// A unit's pose, where it is there and finite.
fn sound(frame: &Frame, unit: usize) -> Option<Isometry3<f32>> {
    (*frame.poses.get(unit)?).filter(is_finite)
}

fn is_finite(pose: &Isometry3<f32>) -> bool {
    pose.to_homogeneous().iter().all(|number| number.is_finite())
}

/// Distance and nearest points.
type Gap = (f32, Option<[Point3<f32>; 2]>);
/// Of a unit, and of what it may meet.
type Poses = [Isometry3<f32>; 2];

/// A unit and what it may meet: where they are at a frame, a lower bound of their distance that costs little, and the distance.
struct Pair<P, R, G> {
    poses: P,
    room: R,
    gap: G,
}

impl<P, R, G> Pair<P, R, G>
where
    P: Fn(&Frame) -> Option<Poses>,
    R: Fn(&Poses) -> f32,
    G: Fn(&Poses) -> Gap,
{
    /// Adds the pair's contacts to those of each frame.
    fn add(
        &self,
        moving: &Moving,
        (unit, met): (usize, Met),
        all: &mut [Vec<Contact>],
    ) -> anyhow::Result<()> {
        interrupt::check()?;
        let known: Vec<Option<Instant>> = moving
            .frames()
            .iter()
            .map(|frame| Some((frame.time_s, (self.poses)(frame)?)))
            .collect();
        // When they touch next, where nothing is in between that is not known.
        let mut next: Option<f64> = None;
        // Time and distance of the frame after.
        let mut after: Option<(f64, f32)> = None;
        for (number, contacts) in all.iter_mut().enumerate().rev() {
            let around = |from: usize| number.checked_add(from)?.checked_sub(1);
            let [before, now, then, beyond] = [0, 1, 2, 3]
                .map(|from| around(from).and_then(|number| known.get(number).copied().flatten()));
            let Some((now_s, here)) = now else {
                (next, after) = (None, None);
                continue;
            };
            let between = match (before, then, beyond) {
                (Some(before), Some(then), Some(beyond)) => {
                    self.meeting([before, (now_s, here), then, beyond])
                }
                _ => None,
            };
            if next.is_none() && between.is_none() && (self.room)(&here) > TOUCH_M {
                after = None;
                continue;
            }
            let (distance_m, nearest) = (self.gap)(&here);
            if distance_m <= TOUCH_M {
                next = Some(now_s);
            } else if let Some((later_s, later_m)) = after.filter(|(_, later)| *later <= TOUCH_M) {
                let share = f64::from((distance_m - TOUCH_M) / (distance_m - later_m));
                next = Some(now_s + share * (later_s - now_s));
            } else if between.is_some() {
                next = between;
            }
            after = Some((now_s, distance_m));
            if let Some(at_s) = next {
                let time_s = at_s - now_s;
                contacts.push(Contact { unit, met, time_s, distance_m, nearest });
            }
        }
        Ok(())
    }

    /// When they meet between the second and the third of four instants and part again, such as at a bounce: motion that goes on evenly
    /// from before, and back evenly from after, must both lead to a contact.
    fn meeting(&self, [before, now, then, beyond]: [Instant; 4]) -> Option<f64> {
        let span_s = then.0 - now.0;
        let forward = |share: f64| ahead(&before, &now, share * span_s);
        let back = |share: f64| ahead(&beyond, &then, -share * span_s);
        let stride: f32 = forward(1.0)?
            .iter()
            .zip(&now.1)
            .map(|(to, from)| (to.translation.vector - from.translation.vector).norm())
            .sum();
        if (self.room)(&now.1) > stride + TOUCH_M {
            return None;
        }
        let share = self.first_touch(forward)?;
        self.first_touch(back)?;
        Some(now.0 + share * span_s)
    }

    /// The part of the way at which they first touch.
    fn first_touch(&self, at: impl Fn(f64) -> Option<Poses>) -> Option<f64> {
        let touches = |share: f64| Some((self.gap)(&at(share)?).0 <= TOUCH_M);
        let mut shares = (1..=PARTS).map(|part| f64::from(part) / f64::from(PARTS));
        let mut touching = shares.find(|share| touches(*share) == Some(true))?;
        let mut apart = touching - 1.0 / f64::from(PARTS);
        for _ in 0..HALVINGS {
            let middle = (apart + touching) / 2.0;
            let end = if touches(middle)? { &mut touching } else { &mut apart };
            *end = middle;
        }
        Some(touching)
    }
}

/// A time, and where both are.
type Instant = (f64, Poses);

/// Instants that are looked at between two frames.
const PARTS: u32 = 8;
/// Of the part within which the contact begins.
const HALVINGS: u32 = 10;

/// Where motion that goes on evenly leads, `seconds` after the second of two instants.
fn ahead(first: &Instant, second: &Instant, seconds: f64) -> Option<Poses> {
    let share = (seconds / (second.0 - first.0)) as f32;
    let on = |from: &Isometry3<f32>, to: &Isometry3<f32>| {
        let place =
            to.translation.vector + (to.translation.vector - from.translation.vector) * share;
        let turn = (to.rotation * from.rotation.inverse()).powf(share);
        Isometry3::from_parts(place.into(), turn * to.rotation)
    };
    let [one, two] = [0, 1].map(|which: usize| on(&first.1[which], &second.1[which]));
    (is_finite(&one) && is_finite(&two)).then_some([one, two])
}

/// A unit's convex pieces.
struct Body<'m> {
    unit: &'m MovingUnit,
    pieces: Vec<Piece<'m>>,
    /// Of a sphere around all of it, in the unit's frame.
    middle: Point3<f32>,
    radius_m: f32,
}

impl<'m> Body<'m> {
    fn new(unit: &'m MovingUnit) -> Self {
        let piece = |range: &Range<usize>| Piece(unit.corners.get(range.clone()).unwrap_or(&[]));
        let sum = unit.corners.iter().fold(Point3::origin(), |sum, corner| sum + corner.coords);
        let middle = sum / unit.corners.len().max(1) as f32;
        let farthest = unit.corners.iter().map(|corner| (corner - middle).norm());
        Body {
            unit,
            pieces: unit.pieces.iter().map(piece).filter(|piece| !piece.0.is_empty()).collect(),
            middle,
            radius_m: farthest.fold(0.0, f32::max),
        }
    }

    /// Between the spheres around two units.
    fn room(&self, pose: &Isometry3<f32>, other: &Body<'_>, its: &Isometry3<f32>) -> f32 {
        (pose * self.middle - its * other.middle).norm() - self.radius_m - other.radius_m
    }

    fn gap(&self, pose: &Isometry3<f32>, other: &Body<'_>, its: &Isometry3<f32>) -> Gap {
        let between = pose.inv_mul(its);
        let turn = between.rotation.coords;
        let rotation = Rotation::from_xyzw(turn.x, turn.y, turn.z, turn.w);
        let [x, y, z] = between.translation.vector.into();
        let between = Pose::from_parts(Vector::new(x, y, z), rotation);
        let mut least: Gap = (f32::INFINITY, None);
        for (one, two) in
            self.pieces.iter().flat_map(|one| other.pieces.iter().map(move |two| (one, two)))
        {
            let found = closest_points_support_map_support_map(&between, one, two, f32::MAX);
            let gap = match found {
                ClosestPoints::WithinMargin(one, two) => {
                    let [one, two] = [pose * point(one), its * point(two)];
                    ((one - two).norm(), Some([one, two]))
                }
                ClosestPoints::Intersecting => (0.0, None),
                ClosestPoints::Disjoint => continue,
            };
            if gap.0 < least.0 {
                least = gap;
            }
        }
        least
    }

    fn gap_to_plane(&self, pose: &Isometry3<f32>, plane: &Plane) -> Gap {
        let corners = self.unit.corners.iter().map(|corner| pose * corner);
        let height = |corner: &Point3<f32>| plane.height_m(&corner.coords);
        let Some(lowest) = corners.min_by(|a, b| height(a).total_cmp(&height(b))) else {
            return (f32::INFINITY, None);
        };
        let height_m = height(&lowest);
        (height_m, Some([lowest, lowest - plane.normal * height_m]))
    }
}

/// Points whose hull is meant: parry asks for support points only, so that sheets and rods work too.
struct Piece<'m>(&'m [Point3<f32>]);

impl SupportMap for Piece<'_> {
    fn local_support_point(&self, direction: Vector) -> Vector {
        let corners = self.0.iter().map(|corner| Vector::new(corner.x, corner.y, corner.z));
        let along = |corner: &Vector| corner.dot(direction);
        corners.max_by(|a, b| along(a).total_cmp(&along(b))).unwrap_or(Vector::ZERO)
    }
}

fn point(vector: Vector) -> Point3<f32> {
    Point3::new(vector.x, vector.y, vector.z)
}

#[cfg(test)]
#[allow(clippy::unwrap_used, clippy::panic)]
mod tests {
    use nalgebra::{Translation3, UnitQuaternion};
    use rigidformer_core::{Physics, Unit};

    use super::*;

    const HALF: f32 = 0.05;

    fn cube(number: usize, role: Role) -> MovingUnit {
        let corner = |corner: u8| {
            Point3::from([0, 1, 2].map(|axis| if corner >> axis & 1 == 1 { HALF } else { -HALF }))
        };
        let corners: Vec<_> = (0..8).map(corner).collect();
        let physics = Physics { mass_kg: 1.0, friction: 0.5, restitution: 0.0 };
        MovingUnit::new(number, "cube", &Unit::new(&corners, physics).role(role))
    }

    fn moving(
        units: Vec<MovingUnit>,
        planes: &[Plane],
        poses: &[&[Option<Isometry3<f32>>]],
    ) -> Moving {
        let frames = poses.iter().enumerate().map(|(number, poses)| Frame {
            time_s: 5.0 + number as f64 * 0.1,
            poses: poses.to_vec(),
            truth: Vec::new(),
        });
        Moving::new("a", "b", "c", planes, units).with(frames)
    }

    fn at(x: f32, z: f32) -> Option<Isometry3<f32>> {
        Some(Translation3::new(x, 0.0, z).into())
    }

    #[test]
    fn a_fall_is_timed_between_two_frames_and_stays_a_contact() {
        let ground = [Plane::ground(0.5, 0.0)];
        let heights = [0.351, 0.251, 0.151, 0.0, 0.05];
        let poses: Vec<_> = heights.map(|z| vec![at(0.0, z)]).into();
        let poses: Vec<_> = poses.iter().map(Vec::as_slice).collect();
        let found = contacts(&moving(vec![cube(0, Role::Free)], &ground, &poses)).unwrap();
        // From .101 above to .05 below: .1 of .151 of the way down.
        let meets_s = 0.2 + 0.1 * (0.1 / 0.151);
        for (number, expected) in
            [meets_s, meets_s - 0.1, meets_s - 0.2, 0.0, 0.0].iter().enumerate()
        {
            let [contact] = &found[number][..] else { panic!("{number}") };
            assert!((contact.time_s - expected).abs() < 1e-6, "{number}: {}", contact.time_s);
            assert!(matches!(contact.met, Met::Plane(0)));
            assert!((contact.distance_m - (heights[number] - HALF)).abs() < 1e-6);
            let [own, its] = contact.nearest.unwrap();
            assert!((own.z - contact.distance_m).abs() < 1e-6 && its.z.abs() < 1e-6);
        }
    }

    #[test]
    fn a_bounce_between_two_frames_is_found_and_a_near_miss_is_not() {
        let ground = [Plane::ground(0.5, 0.0)];
        let times = |xs: [f32; 6], zs: [f32; 6], planes: &[Plane], others: bool| {
            let poses = xs.iter().zip(zs).map(|(x, z)| match others {
                true => vec![at(*x, z), at(0.0, 0.0)],
                false => vec![at(*x, z)],
            });
            let poses: Vec<_> = poses.collect();
            let poses: Vec<_> = poses.iter().map(Vec::as_slice).collect();
            let mut units = vec![cube(0, Role::Free)];
            units.extend(others.then(|| cube(1, Role::Fixed)));
            let found = contacts(&moving(units, planes, &poses)).unwrap();
            found
                .iter()
                .map(|all| all.iter().map(|one| one.time_s).collect())
                .collect::<Vec<Vec<f64>>>()
        };
        // Down and up by .2 a frame, .001 above the ground in the middle between the third frame and the fourth.
        let heights = [0.551, 0.351, 0.151, 0.151, 0.351, 0.551];
        let found = times([0.0; 6], heights, &ground, false);
        for (number, expected) in [0.25, 0.15, 0.05].iter().enumerate() {
            let [time_s] = found[number][..] else { panic!("{found:?}") };
            assert!((time_s - expected).abs() < 2e-5, "{found:?}");
        }
        assert!(found[3..].iter().all(Vec::is_empty), "{found:?}");
        // Past each other, at .3 beside: distances shrink and grow too.
        let places = [-0.5, -0.3, -0.1, 0.1, 0.3, 0.5];
        assert!(times(places, [0.3; 6], &[], true).iter().all(Vec::is_empty));
        // At a side of .05 there is a contact.
        let found = times([-0.9, -0.6, -0.3, -0.3, -0.6, -0.9], [0.05; 6], &[], true);
        let expected = [0.266_333, 0.166_333, 0.066_333];
        for (number, expected) in expected.iter().enumerate() {
            let [time_s] = found[number][..] else { panic!("{found:?}") };
            assert!((time_s - expected).abs() < 2e-5, "{found:?}");
        }
    }

    #[test]
    fn what_has_passed_is_not_to_come_and_absence_ends_a_wait() {
        let two = || vec![cube(0, Role::Free), cube(1, Role::Driven)];
        let far = at(0.3, 0.0);
        let frames: [&[_]; 5] = [
            &[at(0.0, 0.0), far],
            &[at(0.2, 0.0), far],
            &[at(0.0, 0.0), far],
            &[at(0.0, 0.0), None],
            &[at(0.25, 0.0), far],
        ];
        let found = contacts(&moving(two(), &[], &frames)).unwrap();
        let times: Vec<Vec<f64>> =
            found.iter().map(|all| all.iter().map(|contact| contact.time_s).collect()).collect();
        let [first] = times[0][..] else { panic!("{times:?}") };
        assert!((first - 0.1 * (0.199 / 0.2)).abs() < 1e-6, "{first}");
        assert_eq!(times[1..], [vec![0.0], vec![], vec![], vec![0.0]]);
        assert!(found[4][0].nearest.is_none(), "they overlap");
    }

    #[test]
    fn parts_of_a_body_and_what_is_not_free_are_left_out() {
        let poses: [&[_]; 1] = [&[at(0.0, 0.0), at(0.1, 0.0)]];
        let count = |units| contacts(&moving(units, &[], &poses)).unwrap()[0].len();
        assert_eq!(count(vec![cube(0, Role::Free), cube(1, Role::Free)]), 1);
        assert_eq!(count(vec![cube(0, Role::Fixed), cube(1, Role::Driven)]), 0);
        let part = |number| MovingUnit { body: Some(3), ..cube(number, Role::Free) };
        assert_eq!(count(vec![part(0), part(1)]), 0);
        let soft = MovingUnit { is_soft: true, ..cube(1, Role::Free) };
        assert_eq!(count(vec![cube(0, Role::Free), soft]), 0);
    }

    #[test]
    fn sheets_points_and_poses_that_are_not_finite_are_no_trouble() {
        let physics = Physics { mass_kg: 1.0, friction: 0.5, restitution: 0.0 };
        let sheet =
            [Point3::new(-1.0, -1.0, 0.0), Point3::new(1.0, -1.0, 0.0), Point3::new(0.0, 1.0, 0.0)];
        let sheet = MovingUnit::new(1, "sheet", &Unit::new(&sheet, physics));
        let single = MovingUnit::new(2, "point", &Unit::new(&[Point3::origin()], physics));
        let turned = UnitQuaternion::from_euler_angles(0.0, 0.0, 0.3);
        let units = vec![cube(0, Role::Free), sheet, single];
        let pose = |z: f32| Some(Isometry3::from_parts(Translation3::new(0.0, 0.0, z), turned));
        let frames: [&[_]; 2] =
            [&[pose(f32::NAN), pose(-0.3), pose(0.0)], &[pose(0.0), pose(-HALF - 5e-4), pose(0.2)]];
        let found = contacts(&moving(units, &[], &frames)).unwrap();
        assert!(found[0].is_empty());
        let [contact] = &found[1][..] else { panic!("{}", found[1].len()) };
        assert!(matches!((contact.unit, contact.met), (0, Met::Unit(1))));
        assert!((contact.distance_m - 5e-4).abs() < 1e-6, "{}", contact.distance_m);
    }
}
