//! The functions of the header that say how far a unit's prediction may be believed.
#![allow(unsafe_code)]

use crate::arrays::{input, output, status, with_simulator};
#[cfg(feature = "health")]
use crate::convert::isometry;
#[cfg(not(feature = "health"))]
use crate::types::rf_status::RF_ERROR_NO_HEALTH;
use crate::types::rf_status::{self, RF_ERROR_NULL};
#[cfg(feature = "health")]
use crate::types::rf_status::{RF_ERROR_BAD_POSE, RF_ERROR_BAD_VARIANCE, RF_ERROR_NO_SUCH_ID};
use crate::types::{rf_detail, rf_health, rf_pose, rf_simulator, rf_unit_id};
use core::ffi::{CStr, c_char};
use rigidformer_core::Simulator;
use rigidformer_core::kernels::in_own_environment;
#[cfg(feature = "health")]
use rigidformer_core::{Health, InnovationError, UnitId};

/// Names of the quantities, in the order of their numbers.
// The core's names have no NUL at their end, and C needs one; a test compares the two lists.
const QUANTITIES: [&CStr; crate::types::RF_QUANTITIES as usize] = [
    c"speed",
    c"spin",
    c"ln radius",
    c"thickness",
    c"ln mass",
    c"friction",
    c"restitution",
    c"step code",
    c"gravity",
    c"footing",
    c"ln points",
    c"spacing",
    c"hole",
    c"depth",
];

/// Name of a quantity that rf_health looks at, by its number below RF_QUANTITIES: a text that is never
/// freed. Any number may be asked about.
#[unsafe(no_mangle)]
pub extern "C" fn rf_quantity_string(quantity: u32) -> *const c_char {
    let known = QUANTITIES.get(quantity as usize).copied();
    // Never NULL, so that a program can print it without a check.
    known.unwrap_or(c"unknown quantity").as_ptr()
}

/// How far a unit is from what the model's training saw, as it is now. This measures the unit when
/// asked, which costs about as much as observing it does; a step does none of it.
///
/// @param simulator  the simulator
/// @param id         which unit
/// @param health     out: its health
/// @return RF_OK, an error of the call, RF_ERROR_NO_SUCH_ID or RF_ERROR_NO_HEALTH
///
/// # Safety
/// As rf_observe.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn rf_unit_health(
    simulator: *const rf_simulator,
    id: rf_unit_id,
    health: *mut rf_health,
) -> rf_status {
    // SAFETY: the caller's promise.
    unsafe {
        with_simulator(simulator, |locked| {
            let out = locked.output(health, 1)?;
            out.write(of_unit(locked.simulator(), id)?);
            Ok(())
        })
    }
}

/// How far an observed pose is from a predicted one, in standard deviations: the Mahalanobis distance
/// over the way between the two, m, and the turn from one to the other, rad, along the world's axes.
/// Of a right prediction it is above 4.1 once in a hundred times. It needs no simulator; any thread may
/// call it.
///
/// @param predicted  what rf_poses said
/// @param observed   what a sensor says
/// @param variances  (6) of prediction and observation together: x, y, z, m^2, and turns about x, y, z,
///                   rad^2; each above 0 and at most 1e12
/// @param distance   out: the distance
/// @return RF_OK, RF_ERROR_NULL, RF_ERROR_ALIGNMENT, RF_ERROR_LENGTH, RF_ERROR_BAD_POSE where a pose
///         is not finite, RF_ERROR_BAD_VARIANCE or RF_ERROR_NO_HEALTH
///
/// # Safety
/// Pointers are NULL or point to what their types and lengths say.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn rf_innovation(
    predicted: *const rf_pose,
    observed: *const rf_pose,
    variances: *const f32,
    distance: *mut f32,
) -> rf_status {
    let call = || {
        let out = output(distance, 1)?;
        // SAFETY: the caller's promise.
        let (predicted, observed, variances) =
            unsafe { (input(predicted, 1)?, input(observed, 1)?, input(variances, 6)?) };
        let ([predicted], [observed], Some(variances)) =
            (predicted, observed, variances.first_chunk())
        else {
            return Err(RF_ERROR_NULL.into());
        };
        let found = innovation(predicted, observed, variances)?;
        // SAFETY: `output` checked it; the rest is the caller's promise.
        unsafe { out.write(found) };
        Ok(())
    };
    status(in_own_environment(call))
}

/// Says what becomes of a free unit that diverges. At first, and with 0, rf_step fails then
/// (RF_ERROR_DIVERGED). With 1 the unit is held where it was and the others go on: they see it as
/// they do a fixed one. It is held until rf_set_poses gives it poses, or rf_set_role another role. Units that a
/// bond holds, and scenes with soft units, fail as ever.
///
/// @param simulator  the simulator
/// @param holds      1 or 0
/// @return RF_OK, an error of the call or RF_ERROR_NO_HEALTH
///
/// # Safety
/// As rf_observe.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn rf_set_quarantine(simulator: *mut rf_simulator, holds: u32) -> rf_status {
    // SAFETY: the caller's promise.
    unsafe { with_simulator(simulator, |locked| set_quarantine(locked.simulator(), holds != 0)) }
}

#[cfg(feature = "health")]
fn of_unit(simulator: &Simulator<'_, '_>, id: rf_unit_id) -> Result<rf_health, rf_detail> {
    let health = simulator.health(UnitId::from_bits(id));
    let health = health.ok_or(rf_detail::numbers(RF_ERROR_NO_SUCH_ID, id, 0))?;
    let farthest = health.farthest;
    Ok(rf_health {
        known: health.is_known().into(),
        outside: health.outside,
        // Zeros where nothing is known: `known` tells them from a quantity of 0.
        quantity: farthest.map_or(0, |excess| excess.quantity as u32),
        value: farthest.map_or(0.0, |excess| excess.value),
        beyond: farthest.map_or(0.0, |excess| excess.beyond),
        quarantined: health.is_quarantined.into(),
        reserved: [0; 2],
    })
}

#[cfg(feature = "health")]
fn innovation(
    predicted: &rf_pose,
    observed: &rf_pose,
    variances: &[f32; 6],
) -> Result<f32, rf_detail> {
    let found = Health::innovation(&isometry(predicted), &isometry(observed), variances);
    found.map_err(|error| match error {
        InnovationError::BadVariance { index } => {
            rf_detail { index: index as u32, ..rf_detail::of(RF_ERROR_BAD_VARIANCE) }
        }
        // The other errors are of poses that are not finite.
        _ => RF_ERROR_BAD_POSE.into(),
    })
}

#[cfg(feature = "health")]
fn set_quarantine(simulator: &mut Simulator<'_, '_>, holds: bool) -> Result<(), rf_detail> {
    simulator.set_quarantine(holds);
    Ok(())
}

#[cfg(not(feature = "health"))]
fn of_unit(_: &Simulator<'_, '_>, _: rf_unit_id) -> Result<rf_health, rf_detail> {
    Err(RF_ERROR_NO_HEALTH.into())
}

#[cfg(not(feature = "health"))]
fn innovation(_: &rf_pose, _: &rf_pose, _: &[f32; 6]) -> Result<f32, rf_detail> {
    Err(RF_ERROR_NO_HEALTH.into())
}

#[cfg(not(feature = "health"))]
fn set_quarantine(_: &mut Simulator<'_, '_>, _: bool) -> Result<(), rf_detail> {
    Err(RF_ERROR_NO_HEALTH.into())
}

#[cfg(all(test, feature = "health"))]
mod tests {
    use super::QUANTITIES;
    use rigidformer_weights::Quantity;

    #[test]
    fn quantities_have_the_names_of_the_core() {
        let names = Quantity::ALL.map(Quantity::name);
        assert!(QUANTITIES.iter().map(|name| name.to_str().unwrap_or_default()).eq(names));
    }
}
