//! Where a joint is, and what it lacks to hold.

use crate::geometry::{dot, norm, product, rotate, rotation_of, turn_between};
use crate::structure::link::{Above, Way};
use nalgebra::{Matrix3, Point3, Vector3};

/// A joint as its units lie.
pub(crate) struct Hinge {
    /// From the unit's pivot to the parent's image of it, but for what is free, m.
    pub(crate) gap: Vector3<f32>,
    /// Turn that takes the unit to where the joint wants it, but for what is free, rad.
    pub(crate) tilt: Vector3<f32>,
    /// Of the joint along its axis, rad or m; 0 without one.
    pub(crate) position: f32,
    /// As the parent carries it, in the world.
    pub(crate) axis: Vector3<f32>,
}

impl Hinge {
    /// Of a unit's joint, by the rotations of the unit and its parent, their centres in their reference frames, how long a metre is
    /// there, and the way from the parent's centre to the unit's.
    pub(crate) fn of(
        above: &Above,
        [own, parents]: &[Matrix3<f32>; 2],
        ([offset, parents_offset], length): ([&Point3<f32>; 2], f32),
        apart: &Vector3<f32>,
    ) -> Hinge {
        let arm = rotate(own, &((above.pivot - offset) / length));
        let parents_arm = rotate(parents, &((above.parent_pivot - parents_offset) / length));
        let mut gap = (parents_arm - arm) - apart;
        let goal = product(parents, &rest(above));
        let axis = rotate(&goal, &above.guide.axis);
        let (mut tilt, mut position) = (Vector3::zeros(), 0.0);
        match above.guide.way {
            Way::Ball => {}
            Way::Turns => {
                let own_axis = rotate(own, &above.guide.axis);
                tilt = own_axis.cross(&axis);
                if dot(&own_axis, &axis) < 0.0 {
                    // From beyond a quarter turn the sine leads back.
                    let size = norm(&tilt);
                    tilt = if size > 0.0 { tilt / size } else { side(&axis) };
                }
                let mark = side(&above.guide.axis);
                let (here, there) = (rotate(own, &mark), rotate(&goal, &mark));
                let sine = dot(&axis, &there.cross(&here));
                position = libm::atan2f(sine, dot(&there, &here));
            }
            Way::Slides => {
                position = -dot(&axis, &gap);
                gap += axis * position;
                tilt = turn_between(own, &goal);
            }
            Way::Fixed => tilt = turn_between(own, &goal),
        }
        Hinge { gap, tilt, position, axis }
    }
}

/// The axis as the parent carries it, in the world.
pub(crate) fn axis_of(above: &Above, parents: &Matrix3<f32>) -> Vector3<f32> {
    rotate(&product(parents, &rest(above)), &above.guide.axis)
}

/// The rotation of a unit in its parent's frame at position 0.
fn rest(above: &Above) -> Matrix3<f32> {
    rotation_of(&above.guide.rest)
}

/// A direction across an axis.
fn side(axis: &Vector3<f32>) -> Vector3<f32> {
    let across = if axis.x.abs() < 0.6 { Vector3::x() } else { Vector3::y() };
    let side = axis.cross(&across);
    let size = norm(&side);
    if size > 0.0 { side / size } else { across }
}

/// An angle within half a turn.
pub(crate) fn whole_turn(angle: f32) -> f32 {
    use core::f32::consts::{PI, TAU};
    if angle > PI {
        angle - TAU
    } else if angle < -PI {
        angle + TAU
    } else {
        angle
    }
}
