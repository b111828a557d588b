//! The functions of the header for joints with axes. One that is refused changes nothing.
#![allow(unsafe_code)]

use crate::arrays::with_simulator;
#[cfg(feature = "robot")]
use crate::types::rf_status::RF_ERROR_BAD_JOINT;
#[cfg(not(feature = "robot"))]
use crate::types::rf_status::RF_ERROR_NO_JOINTS;
#[cfg(feature = "robot")]
use crate::types::{RF_JOINT_BALL, RF_JOINT_FIXED, RF_JOINT_PRISMATIC, RF_JOINT_REVOLUTE};
use crate::types::{rf_detail, rf_joint, rf_simulator, rf_status, rf_unit_id};
#[cfg(feature = "robot")]
use nalgebra::{Point3, Vector3};
use rigidformer_core::Simulator;
#[cfg(feature = "robot")]
use rigidformer_core::{Joint, JointAxis, JointKind, UnitId};

/// Hangs a unit from another, as rf_join, by a joint of any kind. Models that move units by impulses know
/// all kinds, others RF_JOINT_BALL alone. A joint with an axis is free until rf_set_joint_target.
///
/// @param simulator  the simulator
/// @param id         the unit that hangs
/// @param parent     the unit that it hangs from
/// @param joint      what holds it
/// @return RF_OK, an error of the call, RF_ERROR_NO_SUCH_ID, RF_ERROR_BAD_JOINT, RF_ERROR_BONDED,
///         RF_ERROR_DEFORMS or RF_ERROR_NO_JOINTS. Where it is refused, the joints are what they were
///
/// # Safety
/// As rf_observe.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn rf_join_by(
    simulator: *mut rf_simulator,
    id: rf_unit_id,
    parent: rf_unit_id,
    joint: *const rf_joint,
) -> rf_status {
    // SAFETY: the caller's promise.
    unsafe {
        with_simulator(simulator, |locked| {
            let joint = locked.one(joint)?;
            join_by(locked.simulator(), [id, parent], &joint)
        })
    }
}

/// Takes a joint to a position by the end of the next step, and holds it there. Beyond a limit that is the
/// limit. A joint with a `max_force` may come later.
///
/// @param simulator  the simulator
/// @param id         the unit that hangs by it
/// @param target     radians, the shorter way round, or metres; infinite: it is free from now on
/// @return RF_OK, an error of the call, RF_ERROR_NO_SUCH_ID, RF_ERROR_BAD_JOINT or RF_ERROR_NO_JOINTS.
///         Where it is refused, the target is what it was
///
/// # Safety
/// As rf_observe.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn rf_set_joint_target(
    simulator: *mut rf_simulator,
    id: rf_unit_id,
    target: f32,
) -> rf_status {
    // SAFETY: the caller's promise.
    unsafe { with_simulator(simulator, |locked| set_target(locked.simulator(), id, target)) }
}

/// Writes the position of the joint that a unit hangs by.
///
/// @param simulator  the simulator
/// @param id         the unit
/// @param position   out: radians from minus half a turn to half a turn, or metres
/// @return RF_OK, an error of the call, RF_ERROR_NO_SUCH_ID, RF_ERROR_BAD_JOINT or RF_ERROR_NO_JOINTS
///
/// # Safety
/// As rf_observe.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn rf_joint_position(
    simulator: *mut rf_simulator,
    id: rf_unit_id,
    position: *mut f32,
) -> rf_status {
    // SAFETY: the caller's promise.
    unsafe {
        with_simulator(simulator, |locked| {
            let place = locked.output(position, 1)?;
            place.write(position_of(locked.simulator(), id)?);
            Ok(())
        })
    }
}

#[cfg(feature = "robot")]
fn join_by(
    simulator: &mut Simulator<'_, '_>,
    units: [rf_unit_id; 2],
    joint: &rf_joint,
) -> Result<(), rf_detail> {
    let [unit, parent] = units.map(UnitId::from_bits);
    let [pivot, parent_pivot] = [joint.pivot, joint.parent_pivot].map(Point3::from);
    let axis = JointAxis {
        axis: Vector3::from(joint.axis),
        limits: (joint.limits != [0.0; 2]).then_some(joint.limits),
        max_force: (joint.max_force != 0.0).then_some(joint.max_force),
    };
    let kind = match joint.kind {
        RF_JOINT_BALL => JointKind::Ball,
        RF_JOINT_REVOLUTE => JointKind::Revolute(axis),
        RF_JOINT_PRISMATIC => JointKind::Prismatic(axis),
        RF_JOINT_FIXED => JointKind::Fixed,
        _ => return Err(rf_detail::numbers(RF_ERROR_BAD_JOINT, unit.to_bits(), 0)),
    };
    Ok(simulator.join(&Joint::ball(unit, parent, pivot, parent_pivot).kind(kind))?)
}

#[cfg(feature = "robot")]
fn set_target(
    simulator: &mut Simulator<'_, '_>,
    id: rf_unit_id,
    target: f32,
) -> Result<(), rf_detail> {
    let target = (!target.is_infinite()).then_some(target);
    Ok(simulator.set_joint_target(UnitId::from_bits(id), target)?)
}

#[cfg(feature = "robot")]
fn position_of(simulator: &Simulator<'_, '_>, id: rf_unit_id) -> Result<f32, rf_detail> {
    use crate::types::rf_status::RF_ERROR_NO_SUCH_ID;
    let unit = UnitId::from_bits(id);
    let position = simulator.joint_position(unit);
    let known = simulator.number(unit).is_some();
    let error = if known { RF_ERROR_BAD_JOINT } else { RF_ERROR_NO_SUCH_ID };
    position.ok_or(rf_detail::numbers(error, id, 0))
}

#[cfg(not(feature = "robot"))]
fn join_by(_: &mut Simulator<'_, '_>, _: [rf_unit_id; 2], _: &rf_joint) -> Result<(), rf_detail> {
    Err(rf_detail::of(RF_ERROR_NO_JOINTS))
}

#[cfg(not(feature = "robot"))]
fn set_target(_: &mut Simulator<'_, '_>, _: rf_unit_id, _: f32) -> Result<(), rf_detail> {
    Err(rf_detail::of(RF_ERROR_NO_JOINTS))
}

#[cfg(not(feature = "robot"))]
fn position_of(_: &Simulator<'_, '_>, _: rf_unit_id) -> Result<f32, rf_detail> {
    Err(rf_detail::of(RF_ERROR_NO_JOINTS))
}
