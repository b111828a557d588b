//! The functions of the header. Each checks its pointers, calls the engine and writes results.
#![allow(unsafe_code)]

use crate::engine::{Engine, Units};
use crate::handle::{self, Locked, MAX_UNITS};
use crate::status::TEXTS;
use crate::types::rf_status::{
    self, RF_ERROR_ABI, RF_ERROR_ALIGNMENT, RF_ERROR_BUFFER, RF_ERROR_LENGTH, RF_ERROR_NULL,
    RF_ERROR_OVERLAP, RF_OK,
};
use crate::types::{
    RF_ABI_VERSION, rf_config, rf_detail, rf_internal_pose, rf_observation, rf_physics, rf_pose,
    rf_simulator, rf_step_report, rf_units,
};
use core::ffi::{CStr, c_char, c_void};
use nalgebra::Point3;
use rigidformer_core::{Limits, Observation};
use rigidformer_weights::ModelFile;

/// Version of the library, such as "0.1.0"; a text that is never freed.
#[unsafe(no_mangle)]
pub extern "C" fn rf_version() -> *const c_char {
    concat!(env!("CARGO_PKG_VERSION"), "\0").as_ptr().cast()
}

/// RF_ABI_VERSION of the library; rf_init compares it with the header's.
#[unsafe(no_mangle)]
pub extern "C" fn rf_abi_version() -> u32 {
    RF_ABI_VERSION
}

/// The most units that this library was built for: 16, 64 or 256.
#[unsafe(no_mangle)]
pub extern "C" fn rf_max_units() -> u32 {
    MAX_UNITS as u32
}

/// What a code means, in English: a text that is never freed. Any number may be asked about.
#[unsafe(no_mangle)]
pub extern "C" fn rf_error_string(code: i32) -> *const c_char {
    let known = TEXTS.iter().find(|(known, _)| *known as i32 == code);
    known.map_or(c"unknown error code", |(_, text)| *text as &CStr).as_ptr()
}

/// How large a workspace rf_init needs, exactly, in bytes: a multiple of RF_ALIGNMENT.
///
/// It depends on the model's sizes, the limits, the pointer size and this version of the library.
/// Reads the whole model once (its checksums); any thread may call it.
///
/// @param config  the model and the limits
/// @param bytes   out: the size
/// @return RF_OK, RF_ERROR_NULL, RF_ERROR_ALIGNMENT, RF_ERROR_ABI, RF_ERROR_CAPACITY,
///         RF_ERROR_LENGTH or one of RF_ERROR_MODEL_...
///
/// # Safety
/// Pointers are NULL or point to what their types and lengths say.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn rf_workspace_bytes(
    config: *const rf_config,
    bytes: *mut usize,
) -> rf_status {
    let call = || {
        let out = output(bytes, 1)?;
        // SAFETY: the caller's promise.
        let (model, limits) = unsafe { read(config)? };
        let needed = handle::workspace_bytes(ModelFile::parse(model)?.config(), limits)?;
        // SAFETY: `output` checked it; the rest is the caller's promise.
        unsafe { out.write(needed) };
        Ok(())
    };
    status(call())
}

/// Checks a model completely and makes a simulator in memory of the caller.
///
/// Nothing is allocated and nothing need be freed. The workspace belongs to the simulator, and the
/// model is read in place: both must stay where they are, unchanged and mapped, until the last call
/// with the simulator (or rf_release). A workspace must not be copied or moved. Where this call
/// fails, the workspace is untouched, so a simulator that was there before goes on. Where it
/// succeeds, that one is gone: make sure that no call with it is under way, since this call is
/// how a workspace is recovered whose caller was stopped in the middle.
///
/// @param config           the model and the limits
/// @param workspace        memory aligned to RF_ALIGNMENT; need not be initialised
/// @param workspace_bytes  its size, at least that of rf_workspace_bytes
/// @param simulator        out: the handle, or NULL where the call fails
/// @param detail           out: the numbers of the error; may be NULL
/// @return RF_OK, RF_ERROR_NULL, RF_ERROR_ALIGNMENT, RF_ERROR_ABI, RF_ERROR_MEMORY,
///         RF_ERROR_CAPACITY, RF_ERROR_LENGTH, RF_ERROR_OVERLAP or one of RF_ERROR_MODEL_...
///
/// # Safety
/// As above, and pointers are NULL or point to what their types and lengths say.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn rf_init(
    config: *const rf_config,
    workspace: *mut c_void,
    workspace_bytes: usize,
    simulator: *mut *mut rf_simulator,
    detail: *mut rf_detail,
) -> rf_status {
    let inside = |address: usize, bytes: usize| {
        !workspace.is_null() && handle::overlap(workspace.addr(), workspace_bytes, address, bytes)
    };
    let lost = inside(detail.addr(), size_of::<rf_detail>());
    let call = || {
        optional_output(detail)?;
        let out = output(simulator, 1)?;
        // Before anything is written: a simulator that is there goes on.
        if lost || inside(simulator.addr(), size_of::<*mut rf_simulator>()) {
            return Err(RF_ERROR_OVERLAP.into());
        }
        // SAFETY: `output` checked `out`; the rest is the caller's promise.
        unsafe {
            out.write(core::ptr::null_mut());
            let (model, limits) = read(config)?;
            out.write(handle::make(model, limits, workspace.cast(), workspace_bytes)?);
        }
        Ok(())
    };
    let result: Result<(), rf_detail> = call();
    let numbers = result.err().unwrap_or(rf_detail::of(RF_OK));
    if optional_output(detail).is_ok() && !detail.is_null() && !lost {
        // SAFETY: aligned, and the caller's promise.
        unsafe { detail.write(numbers) };
    }
    numbers.code
}

/// Ends a simulator: later calls with the handle give RF_ERROR_HANDLE while the workspace is not
/// used for something else. Only needed to have that; nothing is freed.
///
/// @return RF_OK, RF_ERROR_NULL, RF_ERROR_HANDLE or RF_ERROR_BUSY
///
/// # Safety
/// The handle is NULL, or one that rf_init made whose workspace is still readable.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn rf_release(simulator: *mut rf_simulator) -> rf_status {
    // SAFETY: the caller's promise.
    status(unsafe { handle::release(simulator) })
}

/// Starts from two frames of points: the same points of the same units, in the same order, some
/// native frames of the model apart. The previous frame becomes the reference of rf_poses.
///
/// @param simulator    the simulator
/// @param step         step code: native frames between the two, and between steps; at least 1.
///                     One native frame is 1/240 s for the models that come with this project
/// @param units        the units
/// @param previous     (units->point_count, 3) x, y, z in metres, world frame
/// @param current      (units->point_count, 3) likewise
/// @param observation  out: what the observation was like; may be NULL
/// @return RF_OK, an error of the call (below 32) or of the observation (64 to 72). Where it is
///         refused, the scene is what it was
///
/// # Safety
/// The handle is one of rf_init; other pointers are NULL or point to what their types and lengths
/// say.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn rf_observe(
    simulator: *mut rf_simulator,
    step: u32,
    units: *const rf_units,
    previous: *const f32,
    current: *const f32,
    observation: *mut rf_observation,
) -> rf_status {
    // SAFETY: here and below the caller's promise.
    unsafe {
        with(simulator, |locked| {
            let out = locked.optional(observation)?;
            let (units, points) = locked.units(units)?;
            let previous = locked.points(previous, points)?;
            let current = locked.points(current, points)?;
            let found = locked.engine().observe(step, units, previous, current)?;
            report(out, found);
            Ok(())
        })
    }
}

/// Starts from known poses, some native frames of the model apart. Each carries the unit's reference
/// points to the world; nothing is fitted.
///
/// @param simulator    the simulator
/// @param step         step code, as for rf_observe
/// @param units        the units
/// @param points       (units->point_count, 3) x, y, z in metres, each unit in its own reference
///                     frame, in any order
/// @param previous     (units->unit_count) poses of the previous frame
/// @param current      (units->unit_count) poses of the current frame
/// @param observation  out: all zeros; may be NULL
/// @return as rf_observe
///
/// # Safety
/// As rf_observe.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn rf_observe_poses(
    simulator: *mut rf_simulator,
    step: u32,
    units: *const rf_units,
    points: *const f32,
    previous: *const rf_pose,
    current: *const rf_pose,
    observation: *mut rf_observation,
) -> rf_status {
    // SAFETY: here and below the caller's promise.
    unsafe {
        with(simulator, |locked| {
            let out = locked.optional(observation)?;
            let (units, count) = locked.units(units)?;
            let points = locked.points(points, count)?;
            let previous = locked.input(previous, units.physics.len())?;
            let current = locked.input(current, units.physics.len())?;
            let found = locked.engine().observe_poses(step, units, points, previous, current)?;
            report(out, found);
            Ok(())
        })
    }
}

/// Sets the command that conditions all following steps, for models that take one.
///
/// @param simulator  the simulator
/// @param numbers    (count) finite numbers in the model's units
/// @param count      how many; the model's command size
/// @return RF_OK, an error of the call, RF_ERROR_COMMAND_SIZE or RF_ERROR_COMMAND_NUMBER. Where it
///         is refused, the previous command stays
///
/// # Safety
/// As rf_observe.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn rf_set_command(
    simulator: *mut rf_simulator,
    numbers: *const f32,
    count: usize,
) -> rf_status {
    // SAFETY: the caller's promise.
    unsafe {
        with(simulator, |locked| {
            let numbers = locked.input(numbers, count)?;
            locked.engine().set_command(numbers)
        })
    }
}

/// Advances the scene by one step of the observation's step code.
///
/// @param simulator  the simulator
/// @param report     out: what the step did; may be NULL
/// @return RF_OK, an error of the call, RF_ERROR_NOT_OBSERVED, RF_ERROR_NO_COMMAND or
///         RF_ERROR_DIVERGED. Where it is refused, the scene is what it was
///
/// # Safety
/// As rf_observe.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn rf_step(
    simulator: *mut rf_simulator,
    report: *mut rf_step_report,
) -> rf_status {
    // SAFETY: the caller's promise.
    unsafe {
        with(simulator, |locked| {
            let out = locked.optional(report)?;
            let done = locked.engine().step()?;
            if let Some(out) = out {
                out.write(rf_step_report {
                    active_units: done.active_units,
                    degenerate_units: done.degenerate_units,
                    reserved: [0; 2],
                });
            }
            Ok(())
        })
    }
}

/// Units in the scene: 0 before an observation.
///
/// @param simulator  the simulator
/// @param count      out: how many
/// @return RF_OK or an error of the call
///
/// # Safety
/// As rf_observe.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn rf_unit_count(
    simulator: *const rf_simulator,
    count: *mut u32,
) -> rf_status {
    // SAFETY: the caller's promise.
    unsafe {
        with(simulator, |locked| {
            let out = locked.output(count, 1)?;
            out.write(locked.engine().len() as u32);
            Ok(())
        })
    }
}

/// Poses of all units in the current frame: each carries the unit's reference points (rf_observe:
/// its points of the previous frame; rf_observe_poses: `points`) to the world.
///
/// @param simulator  the simulator
/// @param poses      out: (rf_unit_count) poses, unit by unit
/// @param capacity   how many there is room for
/// @return RF_OK, an error of the call, or RF_ERROR_BUFFER, which writes nothing
///
/// # Safety
/// As rf_observe.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn rf_poses(
    simulator: *const rf_simulator,
    poses: *mut rf_pose,
    capacity: usize,
) -> rf_status {
    // SAFETY: the caller's promise.
    unsafe { by_unit(simulator, poses, capacity, |engine, unit| engine.pose(unit)) }
}

/// Poses of all units as the simulator keeps them, about the units' own centres: the bits by which
/// two targets are compared.
///
/// @param simulator  the simulator
/// @param poses      out: (rf_unit_count) poses, unit by unit
/// @param capacity   how many there is room for
/// @return as rf_poses
///
/// # Safety
/// As rf_observe.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn rf_internal_poses(
    simulator: *const rf_simulator,
    poses: *mut rf_internal_pose,
    capacity: usize,
) -> rf_status {
    // SAFETY: the caller's promise.
    unsafe { by_unit(simulator, poses, capacity, |engine, unit| engine.internal_pose(unit)) }
}

/// World positions of a unit's points in the current frame, in the simulator's own order, which is
/// not that of the observation: each next point is the one farthest from those before.
///
/// @param simulator  the simulator
/// @param unit       which unit, from 0
/// @param points     out: (count, 3) x, y, z in metres; may be NULL where capacity is 0
/// @param capacity   how many points there is room for
/// @param count      out: how many points the unit has, also where RF_ERROR_BUFFER says that they do
///                   not fit
/// @return RF_OK, an error of the call, RF_ERROR_NO_SUCH_UNIT or RF_ERROR_BUFFER
///
/// # Safety
/// As rf_observe.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn rf_points(
    simulator: *const rf_simulator,
    unit: u32,
    points: *mut f32,
    capacity: usize,
    count: *mut usize,
) -> rf_status {
    // SAFETY: the caller's promise; `put` is called with numbers below the count, which is at most
    // the capacity.
    unsafe {
        with(simulator, |locked| {
            let found = locked.output(count, 1)?;
            let out = locked.output(points.cast::<[f32; 3]>(), capacity)?;
            let unit = unit as usize;
            let needed = locked.engine().point_count(unit)?;
            found.write(needed);
            fits(capacity, needed)?;
            locked.engine().points(unit, &mut |at, point| out.add(at).write(point));
            Ok(())
        })
    }
}

/// Numbers of the last error of a simulator's calls: which unit and point, what was found and what
/// would do. Errors that find no simulator (RF_ERROR_HANDLE, RF_ERROR_BUSY) are not kept.
///
/// @param simulator  the simulator
/// @param detail     out: the numbers; its code is RF_OK where no call was refused yet
/// @return RF_OK or an error of the call
///
/// # Safety
/// As rf_observe.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn rf_last_error_detail(
    simulator: *const rf_simulator,
    detail: *mut rf_detail,
) -> rf_status {
    // SAFETY: the caller's promise.
    unsafe {
        with(simulator, |locked| {
            let out = locked.output(detail, 1)?;
            out.write(*locked.detail());
            Ok(())
        })
    }
}

/// Runs a call on a simulator and keeps the numbers of its error there.
///
/// # Safety
/// As [`Locked::new`].
unsafe fn with(
    simulator: *const rf_simulator,
    call: impl FnOnce(&mut Locked) -> Result<(), rf_detail>,
) -> rf_status {
    // SAFETY: the caller's promise.
    let mut locked = match unsafe { Locked::new(simulator) } {
        Ok(locked) => locked,
        Err(detail) => return detail.code,
    };
    let result = call(&mut locked);
    if let Err(detail) = result {
        *locked.detail() = detail;
    }
    status(result)
}

fn status(result: Result<(), rf_detail>) -> rf_status {
    result.err().map_or(RF_OK, |detail| detail.code)
}

/// Writes something of every unit.
///
/// # Safety
/// As [`Locked::new`], and `slots` is NULL or has room for `capacity`.
unsafe fn by_unit<T>(
    simulator: *const rf_simulator,
    slots: *mut T,
    capacity: usize,
    of: impl Fn(&dyn Engine, usize) -> Option<T>,
) -> rf_status {
    // SAFETY: the caller's promise; `unit` is below the capacity.
    unsafe {
        with(simulator, |locked| {
            let out = locked.output(slots, capacity)?;
            let engine = locked.engine();
            fits(capacity, engine.len())?;
            for unit in 0..engine.len() {
                if let Some(value) = of(engine, unit) {
                    out.add(unit).write(value);
                }
            }
            Ok(())
        })
    }
}

fn fits(capacity: usize, needed: usize) -> Result<(), rf_detail> {
    if capacity < needed {
        return Err(rf_detail::numbers(RF_ERROR_BUFFER, capacity as u64, needed as u64));
    }
    Ok(())
}

fn report(out: Option<*mut rf_observation>, found: Observation) {
    let Observation { residual_m, degenerate_units } = found;
    if let Some(out) = out {
        // SAFETY: `optional` checked it; the rest is the promise of the function that was called.
        unsafe { out.write(rf_observation { residual_m, degenerate_units, reserved: [0; 2] }) };
    }
}

/// The model and the limits, for as long as rf_init's caller promises.
///
/// # Safety
/// Pointers are NULL or point to what their types and lengths say.
unsafe fn read(config: *const rf_config) -> Result<(&'static [u8], Limits), rf_detail> {
    // SAFETY: the caller's promise.
    let config = match unsafe { input(config, 1)? } {
        [config] => *config,
        _ => return Err(RF_ERROR_NULL.into()),
    };
    if config.abi_version != RF_ABI_VERSION {
        let (found, expected) = (config.abi_version.into(), RF_ABI_VERSION.into());
        return Err(rf_detail::numbers(RF_ERROR_ABI, found, expected));
    }
    // SAFETY: the caller's promise.
    let model = unsafe { input(config.model, config.model_bytes)? };
    let limits = Limits { units: config.max_units as usize, points: config.max_points as usize };
    Ok((model, limits))
}

/// An array to read; one of length 0 may be NULL.
///
/// # Safety
/// `array` is NULL or has `length` elements, which nothing changes during the call.
unsafe fn input<'a, T>(array: *const T, length: usize) -> Result<&'a [T], rf_detail> {
    addressable(array, length)?;
    if length == 0 {
        return Ok(&[]);
    }
    // SAFETY: not NULL, aligned and of a length that can be; the rest is the caller's promise.
    Ok(unsafe { core::slice::from_raw_parts(array, length) })
}

/// An array to write, perhaps not initialised; one of length 0 may be NULL.
fn output<T>(array: *mut T, length: usize) -> Result<*mut T, rf_detail> {
    addressable(array, length)?;
    Ok(array)
}

fn optional_output<T>(place: *mut T) -> Result<Option<*mut T>, rf_detail> {
    if place.is_null() { Ok(None) } else { output(place, 1).map(Some) }
}

fn addressable<T>(array: *const T, length: usize) -> Result<(), rf_detail> {
    if length == 0 {
        return Ok(());
    }
    if array.is_null() {
        return Err(RF_ERROR_NULL.into());
    }
    if !array.is_aligned() {
        return Err(RF_ERROR_ALIGNMENT.into());
    }
    let size = length.checked_mul(size_of::<T>()).filter(|size| isize::try_from(*size).is_ok());
    match size.and_then(|size| array.addr().checked_add(size)) {
        Some(_) => Ok(()),
        None => Err(RF_ERROR_LENGTH.into()),
    }
}

/// The same for arrays of a call on a simulator, which must lie outside its workspace.
impl Locked {
    /// # Safety
    /// As [`input`].
    unsafe fn input<'a, T>(&self, array: *const T, length: usize) -> Result<&'a [T], rf_detail> {
        // Before a reference is made.
        self.outside(array, length)?;
        // SAFETY: the caller's promise.
        unsafe { input(array, length) }
    }

    fn output<T>(&self, array: *mut T, length: usize) -> Result<*mut T, rf_detail> {
        let array = output(array, length)?;
        self.outside(array, length)?;
        Ok(array)
    }

    fn optional<T>(&self, place: *mut T) -> Result<Option<*mut T>, rf_detail> {
        if place.is_null() { Ok(None) } else { self.output(place, 1).map(Some) }
    }

    /// Physics and counts, and how many points each array of points has.
    ///
    /// # Safety
    /// As [`input`].
    unsafe fn units<'a>(&self, units: *const rf_units) -> Result<(Units<'a>, usize), rf_detail> {
        // SAFETY: the caller's promise.
        unsafe {
            let units = match self.input(units, 1)? {
                [units] => *units,
                _ => return Err(RF_ERROR_NULL.into()),
            };
            let physics: &[rf_physics] = self.input(units.physics, units.unit_count)?;
            let counts = self.input(units.point_counts, units.unit_count)?;
            Ok((Units { physics, counts }, units.point_count))
        }
    }

    /// # Safety
    /// As [`input`], of three floats a point.
    unsafe fn points<'a>(
        &self,
        points: *const f32,
        count: usize,
    ) -> Result<&'a [Point3<f32>], rf_detail> {
        // SAFETY: the caller's promise; `handle` asserts that three floats are a point.
        unsafe { self.input(points.cast(), count) }
    }
}
