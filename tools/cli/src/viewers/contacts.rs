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
/// Between the last frame without a contact and the first with it distance is taken to shrink evenly.
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
                let poses = |frame: &Frame| Some((sound(frame, unit)?, sound(frame, other)?));
                let reach = |frame: &Frame| {
                    let (one, two) = poses(frame)?;
                    Some(body.room(&one, beside, &two))
                };
                let gap = |frame: &Frame| {
                    let (one, two) = poses(frame)?;
                    Some(body.gap(&one, beside, &two))
                };
                add(moving, (unit, Met::Unit(other)), &mut all, reach, gap);
            }
        }
        for (number, plane) in moving.planes.iter().enumerate() {
            if body.unit.role == Role::Free {
                let gap = |frame: &Frame| body.gap_to_plane(&sound(frame, unit)?, plane);
                let reach = |frame: &Frame| gap(frame).map(|(distance_m, _)| distance_m);
                add(moving, (unit, Met::Plane(number)), &mut all, reach, gap);
            }
        }
    }
    Ok(all)
}

/// A unit's pose, where it is there and finite.
fn sound(frame: &Frame, unit: usize) -> Option<Isometry3<f32>> {
    let pose = (*frame.poses.get(unit)?)?;
    pose.to_homogeneous().iter().all(|number| number.is_finite()).then_some(pose)
}

/// Distance and nearest points.
type Gap = (f32, Option<[Point3<f32>; 2]>);

/// Adds the contacts of a pair. `reach` is a lower bound of the distance that costs little, and `gap` is the distance.
fn add(
    moving: &Moving,
    (unit, met): (usize, Met),
    all: &mut [Vec<Contact>],
    reach: impl Fn(&Frame) -> Option<f32>,
    gap: impl Fn(&Frame) -> Option<Gap>,
) {
    // When they touch next, where nothing is in between that is not known.
    let mut next: Option<f64> = None;
    // Time and distance of the frame after.
    let mut after: Option<(f64, f32)> = None;
    for (frame, contacts) in moving.frames().iter().zip(all).rev() {
        let near = reach(frame).filter(|least| next.is_some() || *least <= TOUCH_M);
        let Some((distance_m, nearest)) = near.and_then(|_| gap(frame)) else {
            (next, after) = (None, None);
            continue;
        };
        if distance_m <= TOUCH_M {
            next = Some(frame.time_s);
        } else if let Some((later_s, later_m)) = after.filter(|(_, later)| *later <= TOUCH_M) {
            let share = f64::from((distance_m - TOUCH_M) / (distance_m - later_m));
            next = Some(frame.time_s + share * (later_s - frame.time_s));
        }
        after = Some((frame.time_s, distance_m));
        if let Some(at_s) = next {
            let time_s = at_s - frame.time_s;
            contacts.push(Contact { unit, met, time_s, distance_m, nearest });
        }
    }
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

    fn gap_to_plane(&self, pose: &Isometry3<f32>, plane: &Plane) -> Option<Gap> {
        let corners = self.unit.corners.iter().map(|corner| pose * corner);
        let height = |corner: &Point3<f32>| plane.height_m(&corner.coords);
        let lowest = corners.min_by(|a, b| height(a).total_cmp(&height(b)))?;
        let height_m = height(&lowest);
        Some((height_m, Some([lowest, lowest - plane.normal * height_m])))
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
