//! The functions of the header that keep the state of a simulator, and go on from it.
#![allow(unsafe_code)]

use crate::arrays::{fits, with_simulator};
use crate::types::rf_simulator;
use crate::types::rf_status;

/// Bytes that rf_save writes now: about 300 for each unit and 12 for each point.
///
/// @param simulator  the simulator
/// @param bytes      out: how many
/// @return RF_OK or an error of the call
///
/// # Safety
/// As rf_observe.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn rf_state_bytes(
    simulator: *const rf_simulator,
    bytes: *mut usize,
) -> rf_status {
    // SAFETY: the caller's promise.
    unsafe {
        with_simulator(simulator, |locked| {
            let out = locked.output(bytes, 1)?;
            out.write(locked.simulator().snapshot_bytes());
            Ok(())
        })
    }
}

/// Writes the whole state of a simulator: units with their points, poses, velocities and targets, joints,
/// bonds, soft points, the command, planes, gravity and the time step. Going on from it by rf_load gives
/// the same bits, in this simulator or in another one with the same model, on any processor.
///
/// @param simulator  the simulator
/// @param state      out: (rf_state_bytes) bytes
/// @param capacity   how many there is room for
/// @param bytes      out: how many were written; may be NULL
/// @return RF_OK, an error of the call, or RF_ERROR_BUFFER, which writes nothing
///
/// # Safety
/// As rf_observe.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn rf_save(
    simulator: *const rf_simulator,
    state: *mut u8,
    capacity: usize,
    bytes: *mut usize,
) -> rf_status {
    // SAFETY: the caller's promise; the slice is as long as was checked, and zeros are bytes.
    unsafe {
        with_simulator(simulator, |locked| {
            let count = locked.optional(bytes)?;
            let out = locked.output(state, capacity)?;
            let needed = locked.simulator().snapshot_bytes();
            fits(capacity, needed)?;
            // The caller's memory may be uninitialised, which no slice may be.
            out.write_bytes(0, needed);
            let slice = core::slice::from_raw_parts_mut(out, needed);
            let written = locked.simulator().snapshot(slice)?;
            if let Some(count) = count {
                count.write(written);
            }
            Ok(())
        })
    }
}

/// Goes on from a state that rf_save wrote: units have the ids that they had, and ids that were given since
/// then are given to no other unit. The bytes are checked completely, wherever they come from.
///
/// @param simulator  the simulator
/// @param state      (bytes) what rf_save wrote
/// @param bytes      how many
/// @return RF_OK, an error of the call, RF_ERROR_TOO_MANY_UNITS, RF_ERROR_TOO_MANY_POINTS,
///         RF_ERROR_TOO_MANY_BONDS or one of RF_ERROR_STATE to RF_ERROR_STATE_FEATURE. Where it is
///         refused, the scene is what it was
///
/// # Safety
/// As rf_observe.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn rf_load(
    simulator: *mut rf_simulator,
    state: *const u8,
    bytes: usize,
) -> rf_status {
    // SAFETY: the caller's promise.
    unsafe {
        with_simulator(simulator, |locked| {
            let state = locked.input(state, bytes)?;
            Ok(locked.simulator().restore(state)?)
        })
    }
}
