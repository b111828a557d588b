//! The heading that a model of robots sees a scene from (docs/MODEL.md, section 1).

use crate::geometry::{Pose, product_transposed, rotate, rotate_back};
use crate::math;
use crate::scene::{Scene, UnitSlot};
use crate::slices::{copy_slice, slice_at_mut};
use nalgebra::{Matrix3, Vector3};
use rigidformer_weights::ModelConfig;

/// Whether this build has room for models of robots.
pub(crate) const ROBOT: bool = cfg!(feature = "robot");

/// Below this square of twice a cosine a rotation is upside down: no heading is nearer to it than others.
const TINY_TURN: f32 = 1e-6;

/// Whether a model sees scenes from a heading; the compiler knows where none does.
pub(crate) fn is_robot(config: &ModelConfig) -> bool {
    ROBOT && config.motion.is_robot()
}

/// The frame that goes with a pose: its turn about the vertical, and the point of z = 0 below its centre.
fn heading(pose: &Pose) -> Pose {
    let r = &pose.rotation;
    let (cos, sin) = (r.m11 + r.m22, r.m21 - r.m12);
    let square = cos * cos + sin * sin;
    let (cos, sin) = if square < TINY_TURN {
        // Any heading is as good; the world's is the same on every target.
        (1.0, 0.0)
    } else {
        let size = math::sqrt(square);
        (cos / size, sin / size)
    };
    Pose {
        rotation: Matrix3::new(cos, -sin, 0.0, sin, cos, 0.0, 0.0, 0.0, 1.0),
        centre: Vector3::new(pose.centre.x, pose.centre.y, 0.0),
    }
}

/// The heaviest free one of some units, of all where none is free; the first of equals.
fn heaviest(units: &[UnitSlot]) -> Option<&UnitSlot> {
    let mut units = units.iter();
    let first = units.next()?;
    Some(units.fold(first, |found, unit| {
        let heavier = unit.mass > found.mass;
        // What is driven or fixed may be scenery, however heavy.
        match (found.is_free(), unit.is_free()) {
            (false, true) => unit,
            (true, false) => found,
            _ => {
                if heavier {
                    unit
                } else {
                    found
                }
            }
        }
    }))
}

/// Puts the frame of now into all units' [`first`](UnitSlot::first).
pub(crate) fn turn_frames(scene: &mut Scene<'_>) {
    let per_copy = scene.per_copy.max(1);
    for units in scene.units_mut().chunks_mut(per_copy) {
        let Some(frame) = heaviest(units).map(|unit| heading(&unit.current)) else { return };
        units.iter_mut().for_each(|unit| unit.first = frame);
    }
}

/// Where a unit goes with the heaviest one's heading, which turns and moves over the ground as in the last step: its rotation, and
/// its centre from where that is now.
pub(crate) fn motion_with_leader(scene: &Scene<'_>, index: usize, unit: &UnitSlot) -> Pose {
    let (_, around) = scene.around(index);
    let rotation = unit.current.rotation;
    let Some(leader) = heaviest(around) else { return Pose { rotation, ..Pose::default() } };
    let (now, before) = (heading(&leader.current), heading(&leader.state().before()));
    let on = product_transposed(&now.rotation, &before.rotation);
    let way = Vector3::new(leader.course.way.x, leader.course.way.y, 0.0);
    let arm = unit.current.centre - now.centre;
    let centre = rotate(&on, &(arm + way)) - arm;
    Pose { rotation: crate::geometry::product(&on, &rotation), centre }
}

/// A direction in the world as a unit's frame has it, for models that see from one.
pub(crate) fn inward(unit: &UnitSlot, direction: &Vector3<f32>) -> Vector3<f32> {
    rotate_back(&unit.first.rotation, direction)
}

/// The direction in the world that a unit's frame has so.
pub(crate) fn outward(unit: &UnitSlot, direction: &Vector3<f32>) -> Vector3<f32> {
    rotate(&unit.first.rotation, direction)
}

/// A command as a unit's frame has it: directions in the world turned into the frame.
pub(crate) fn command<'c>(
    config: &ModelConfig,
    unit: &UnitSlot,
    given: &[f32],
    seen: &'c mut [f32],
) -> &'c [f32] {
    let seen = slice_at_mut(seen, 0, given.len());
    copy_slice(given, seen);
    for index in config.directions.indices() {
        if let (Some([x, y]), Some([u, v])) =
            (given.get(index..index + 2), seen.get_mut(index..index + 2))
        {
            let turned = inward(unit, &Vector3::new(*x, *y, 0.0));
            (*u, *v) = (turned.x, turned.y);
        }
    }
    seen
}

/// Where the network is told that an anchor of a unit is.
pub(crate) fn seen(config: &ModelConfig, unit: &UnitSlot, anchor: &Vector3<f32>) -> Vector3<f32> {
    let place = unit.current.apply(anchor);
    if is_robot(config) { unit.first.local(&place) } else { place }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn turned(yaw: f32, tilt: f32) -> Matrix3<f32> {
        let about_z = nalgebra::Rotation3::from_axis_angle(&Vector3::z_axis(), yaw);
        let about_x = nalgebra::Rotation3::from_axis_angle(&Vector3::x_axis(), tilt);
        (about_z * about_x).into_inner()
    }

    #[test]
    fn a_heading_is_the_turn_about_the_vertical_however_the_unit_leans() {
        for yaw in [-3.0, -0.5, 0.0, 1.0, 2.5_f32] {
            for tilt in [-1.5, 0.0, 0.3, 1.5] {
                let pose =
                    Pose { rotation: turned(yaw, tilt), centre: Vector3::new(1.0, 2.0, 3.0) };
                let frame = heading(&pose);
                assert!((frame.rotation - turned(yaw, 0.0)).norm() < 1e-6, "{yaw} {tilt}");
                assert_eq!(frame.centre, Vector3::new(1.0, 2.0, 0.0));
            }
        }
    }

    #[test]
    fn a_unit_upside_down_heads_nowhere_and_its_frame_is_the_worlds() {
        let rotation = Matrix3::new(1.0, 0.0, 0.0, 0.0, -1.0, 0.0, 0.0, 0.0, -1.0);
        let frame = heading(&Pose { rotation, centre: Vector3::zeros() });
        assert_eq!(frame.rotation, Matrix3::identity());
    }
}
