//! The functions of the tracker's header. Each checks its pointers, calls the tracker and writes results.
#![allow(unsafe_code)]

use super::convert::{self, Failure};
use super::registry::{self, State, guarded};
use super::types::*;
use crate::arrays::{fits, input, optional_output, output};
use crate::types::rf_status::{
    self, RF_ERROR_ABI, RF_ERROR_HORIZON, RF_ERROR_NO_SUCH_TRACK, RF_ERROR_NULL, RF_OK,
};
use crate::types::{RF_ABI_VERSION, rf_plane};
use core::ffi::c_char;
use rigidformer_perception::tracker::Forecast;
use std::format;

/// Fills options with their defaults: no model, planes and bodies are found, gravity of 9.81 m/s^2
/// downwards along z.
///
/// @param abi_version  RF_ABI_VERSION of your header
/// @param options      out: the defaults
/// @return RF_OK, RF_ERROR_NULL, RF_ERROR_ALIGNMENT or RF_ERROR_ABI
///
/// # Safety
/// Pointers are NULL or point to what their types and lengths say.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn rf_tracker_defaults(
    abi_version: u32,
    options: *mut rf_tracker_options,
) -> rf_status {
    let call = || {
        if abi_version != RF_ABI_VERSION {
            return Err(Failure::of(RF_ERROR_ABI));
        }
        let out = output(options, 1)?;
        // SAFETY: `output` checked it; the rest is the caller's promise.
        unsafe { out.write(convert::defaults()) };
        Ok(())
    };
    guarded(call).map_or_else(|failure| failure.code, |()| RF_OK)
}

/// Makes a tracker without units, in memory that the library allocates until rf_tracker_destroy.
///
/// @param options   what rf_tracker_defaults filled and you changed
/// @param tracker   out: the handle, or NULL where the call fails
/// @param message   out: what is wrong and its remedy, cut to the capacity, or ""; may be NULL
/// @param capacity  bytes of message, with the zero at its end
/// @return RF_OK, RF_ERROR_NULL, RF_ERROR_ALIGNMENT, RF_ERROR_LENGTH, RF_ERROR_ABI,
///         RF_ERROR_TRACKER_OPTION, RF_ERROR_MODEL_FILE, RF_ERROR_DEFECT or one of
///         RF_ERROR_MODEL_...
///
/// # Safety
/// As above.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn rf_tracker_create(
    options: *const rf_tracker_options,
    tracker: *mut *mut rf_tracker,
    message: *mut c_char,
    capacity: usize,
) -> rf_status {
    let call = || {
        let out = output(tracker, 1)?;
        // SAFETY: `output` checked `out`; the rest is the caller's promise.
        unsafe {
            // A caller that ignores the status then fails at once, on NULL.
            out.write(core::ptr::null_mut());
            let [options] = input(options, 1)? else { return Err(RF_ERROR_NULL.into()) };
            out.write(registry::add(convert::tracker(options)?));
        }
        Ok(())
    };
    let result = guarded(call);
    let text = result.as_ref().err().map_or("", |failure| &failure.message);
    if !message.is_null() {
        // SAFETY: the caller's promise.
        unsafe { write_text(text, message, capacity) };
    }
    result.map_or_else(|failure| failure.code, |()| RF_OK)
}

/// Ends a tracker and frees its memory. Later calls with the handle give RF_ERROR_HANDLE.
///
/// @return RF_OK, RF_ERROR_NULL, RF_ERROR_HANDLE, RF_ERROR_BUSY or RF_ERROR_DEFECT
#[unsafe(no_mangle)]
pub extern "C" fn rf_tracker_destroy(tracker: *mut rf_tracker) -> rf_status {
    registry::remove(tracker)
}

/// What the last refused call of a tracker was refused for, with its remedy.
///
/// @param tracker   the tracker
/// @param message   out: the text, cut to the capacity, or "" where no call was refused
/// @param capacity  bytes of message, with the zero at its end
/// @return RF_OK, RF_ERROR_NULL, RF_ERROR_HANDLE, RF_ERROR_BUSY or RF_ERROR_DEFECT
///
/// # Safety
/// As above.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn rf_tracker_message(
    tracker: *const rf_tracker,
    message: *mut c_char,
    capacity: usize,
) -> rf_status {
    if message.is_null() {
        return RF_ERROR_NULL;
    }
    registry::with(tracker, |state| {
        // SAFETY: the caller's promise.
        unsafe { write_text(&state.message, message, capacity) };
        Ok(())
    })
}

/// Updates a tracker with the next capture. Images and points are copied.
///
/// The time of a call is bounded by the options' numbers of units and clusters and by the sizes of
/// the images. It shares work out to all cores.
///
/// @param tracker  the tracker
/// @param capture  the capture
/// @param report   out: what it was like; may be NULL
/// @return RF_OK, an error of the call (below 32), RF_ERROR_NO_MEMORY, one of RF_ERROR_CAPTURE_...
///         or RF_ERROR_DEFECT. Where it is refused, the tracker is what it was
///
/// # Safety
/// As above.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn rf_tracker_observe(
    tracker: *mut rf_tracker,
    capture: *const rf_capture,
    report: *mut rf_capture_report,
) -> rf_status {
    registry::with(tracker, |state| {
        let out = optional_output(report)?;
        // SAFETY: the caller's promise.
        let capture = match unsafe { input(capture, 1)? } {
            // SAFETY: likewise.
            [capture] => unsafe { convert::capture(capture)? },
            _ => return Err(RF_ERROR_NULL.into()),
        };
        state.tracker.observe(&capture)?;
        state.forecast = Forecast::default();
        if let Some(out) = out {
            // SAFETY: `optional_output` checked it; the rest is the caller's promise.
            unsafe { out.write(report_of(state)) };
        }
        Ok(())
    })
}

/// The units that are followed, by ascending number, at the time of the last capture.
///
/// @param tracker   the tracker
/// @param units     out: (count) units; may be NULL where capacity is 0
/// @param capacity  how many there is room for; of tracks, max_units suffices
/// @param count     out: how many there are, also where RF_ERROR_BUFFER says that they do not fit
/// @return RF_OK, an error of the call, RF_ERROR_BUFFER, which writes no unit, or RF_ERROR_DEFECT
///
/// # Safety
/// As above.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn rf_tracker_units(
    tracker: *const rf_tracker,
    units: *mut rf_track,
    capacity: usize,
    count: *mut usize,
) -> rf_status {
    registry::with(tracker, |state| {
        let found = &state.tracker.estimate().units;
        let tracks = found.iter().map(|unit| convert::track(&state.tracker, unit));
        // SAFETY: the caller's promise.
        unsafe { write_all(tracks, units, capacity, count) }
    })
}

/// The observed surface of a unit, in its frame, metres.
///
/// @param tracker   the tracker
/// @param id        which unit
/// @param points    out: (count, 3) x, y, z; may be NULL where capacity is 0
/// @param capacity  how many points there is room for
/// @param count     out: how many there are, also where RF_ERROR_BUFFER says that they do not fit
/// @return as rf_tracker_units, or RF_ERROR_NO_SUCH_TRACK
///
/// # Safety
/// As above.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn rf_tracker_points(
    tracker: *const rf_tracker,
    id: u32,
    points: *mut f32,
    capacity: usize,
    count: *mut usize,
) -> rf_status {
    registry::with(tracker, |state| {
        let unit = state.tracker.estimate().units.iter().find(|unit| unit.id == id);
        let unit = unit.ok_or_else(|| no_such_track(id))?;
        let all = unit.points.iter().map(|point| <[f32; 3]>::from(*point));
        // SAFETY: the caller's promise.
        unsafe { write_all(all, points.cast(), capacity, count) }
    })
}

/// The points of a unit that the model gets, in its frame, metres: its surface, completed by hidden
/// sides. None before it has a shape.
///
/// @param tracker   the tracker
/// @param id        which unit
/// @param points    out: (count, 3) x, y, z; may be NULL where capacity is 0
/// @param capacity  how many points there is room for
/// @param count     out: how many there are, also where RF_ERROR_BUFFER says that they do not fit
/// @return as rf_tracker_points
///
/// # Safety
/// As above.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn rf_tracker_shape(
    tracker: *const rf_tracker,
    id: u32,
    points: *mut f32,
    capacity: usize,
    count: *mut usize,
) -> rf_status {
    registry::with(tracker, |state| {
        if !state.tracker.estimate().units.iter().any(|unit| unit.id == id) {
            return Err(no_such_track(id));
        }
        let shape = state.tracker.shape(id).unwrap_or_default();
        let all = shape.iter().map(|point| <[f32; 3]>::from(*point));
        // SAFETY: the caller's promise.
        unsafe { write_all(all, points.cast(), capacity, count) }
    })
}

/// The support planes: those of the options, or those that were found. At most RF_MAX_PLANES.
///
/// @param tracker   the tracker
/// @param planes    out: (count) planes; may be NULL where capacity is 0
/// @param capacity  how many there is room for
/// @param count     out: how many there are, also where RF_ERROR_BUFFER says that they do not fit
/// @return as rf_tracker_units
///
/// # Safety
/// As above.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn rf_tracker_planes(
    tracker: *const rf_tracker,
    planes: *mut rf_plane,
    capacity: usize,
    count: *mut usize,
) -> rf_status {
    registry::with(tracker, |state| {
        let all = state.tracker.planes().iter().map(|plane| rf_plane::from(*plane));
        // SAFETY: the caller's promise.
        unsafe { write_all(all, planes, capacity, count) }
    })
}

/// Predicts the units from the last capture on, in equal steps of about 1/24 s. Read them by
/// rf_tracker_predictions. Without a model there are none.
///
/// @param tracker    the tracker
/// @param horizon_s  seconds ahead, above 0 and at most RF_MAX_HORIZON_S
/// @param forecast   out: how many steps and units
/// @return RF_OK, an error of the call, RF_ERROR_HORIZON, RF_ERROR_FORECAST or RF_ERROR_DEFECT. Where it
///         is refused, the forecast before stays
///
/// # Safety
/// As above.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn rf_tracker_predict(
    tracker: *mut rf_tracker,
    horizon_s: f64,
    forecast: *mut rf_forecast,
) -> rf_status {
    registry::with(tracker, |state| {
        let out = output(forecast, 1)?;
        if !(horizon_s > 0.0 && horizon_s <= RF_MAX_HORIZON_S.into()) {
            let most = RF_MAX_HORIZON_S;
            let text = format!("a horizon of {horizon_s} s: give seconds above 0, at most {most}");
            return Err(Failure::new(RF_ERROR_HORIZON, text));
        }
        state.forecast = state.tracker.predict(horizon_s)?;
        let Forecast { step_s, poses, left_out } = &state.forecast;
        let units = poses.first().map_or(0, |poses| poses.len()) as u32;
        let (steps, left_out) = (poses.len() as u32, left_out.len() as u32);
        // SAFETY: `output` checked it; the rest is the caller's promise.
        unsafe {
            out.write(rf_forecast { step_s: *step_s, steps, units, left_out, reserved: 0 });
        }
        Ok(())
    })
}

/// The predictions of the last rf_tracker_predict, step by step, and by ascending number within one.
/// A capture ends them.
///
/// @param tracker      the tracker
/// @param predictions  out: (steps, units) predictions; may be NULL where capacity is 0
/// @param capacity     how many there is room for
/// @param count        out: how many there are, also where RF_ERROR_BUFFER says that they do not fit
/// @return as rf_tracker_units
///
/// # Safety
/// As above.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn rf_tracker_predictions(
    tracker: *const rf_tracker,
    predictions: *mut rf_prediction,
    capacity: usize,
    count: *mut usize,
) -> rf_status {
    registry::with(tracker, |state| {
        let steps = (1_u32..).zip(&state.forecast.poses);
        let all = steps.flat_map(|(step, poses)| {
            poses.iter().map(move |(id, pose)| rf_prediction {
                id: *id,
                step,
                pose: (*pose).into(),
            })
        });
        // SAFETY: the caller's promise.
        unsafe { write_all(all, predictions, capacity, count) }
    })
}

/// The units that the last rf_tracker_predict did not predict, and why.
///
/// @param tracker   the tracker
/// @param left_out  out: (count) units; may be NULL where capacity is 0
/// @param capacity  how many there is room for
/// @param count     out: how many there are, also where RF_ERROR_BUFFER says that they do not fit
/// @return as rf_tracker_units
///
/// # Safety
/// As above.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn rf_tracker_left_out(
    tracker: *const rf_tracker,
    left_out: *mut rf_left_out,
    capacity: usize,
    count: *mut usize,
) -> rf_status {
    registry::with(tracker, |state| {
        let all = state.forecast.left_out.iter().map(convert::left_out);
        // SAFETY: the caller's promise.
        unsafe { write_all(all, left_out, capacity, count) }
    })
}

fn no_such_track(id: u32) -> Failure {
    let text = format!("no unit has the number {id}: its track ended, or never was");
    Failure::new(RF_ERROR_NO_SUCH_TRACK, text)
}

fn report_of(state: &State) -> rf_capture_report {
    let report = state.tracker.report();
    rf_capture_report {
        units: state.tracker.estimate().units.len() as u32,
        seen: report.seen as u32,
        appeared: report.appeared.len() as u32,
        given_up: report.given_up.len() as u32,
        clusters: report.clusters as u32,
        clusters_left_out: report.clusters_left_out as u32,
        is_blind: report.is_blind().into(),
        is_without_model: report.forecast.is_some().into(),
    }
}

/// Writes how many there are, and all of them where they fit.
///
/// # Safety
/// `slots` is NULL or has room for `capacity`, and `count` is NULL or has room for one.
unsafe fn write_all<T>(
    all: impl Iterator<Item = T> + Clone,
    slots: *mut T,
    capacity: usize,
    count: *mut usize,
) -> Result<(), Failure> {
    let (found, out) = (output(count, 1)?, output(slots, capacity)?);
    let needed = all.clone().count();
    // SAFETY: `output` checked both; `at` is below the capacity.
    unsafe {
        found.write(needed);
        fits(capacity, needed)?;
        for (at, one) in all.take(capacity).enumerate() {
            out.add(at).write(one);
        }
    }
    Ok(())
}

/// Writes a text and a zero, cut to the capacity between two characters.
///
/// # Safety
/// `to` has room for `capacity` bytes.
unsafe fn write_text(text: &str, to: *mut c_char, capacity: usize) {
    let Some(room) = capacity.checked_sub(1) else { return };
    let mut length = text.len().min(room);
    while !text.is_char_boundary(length) {
        length = length.saturating_sub(1);
    }
    // SAFETY: the length is below the capacity; texts of errors have no zeros but in paths, where they would only end it early.
    unsafe {
        to.copy_from_nonoverlapping(text.as_ptr().cast(), length);
        to.add(length).write(0);
    }
}
