//! The functions of the header, but for those of `edit`. Each checks its pointers, calls the simulator and writes
//! results.
#![allow(unsafe_code)]

use crate::arrays::{fits, input, optional_output, output, status, with_simulator};
use crate::handle;
use crate::status::text;
use crate::types::rf_status::{
    self, RF_ERROR_ABI, RF_ERROR_NO_SUCH_ID, RF_ERROR_NO_SUCH_UNIT, RF_ERROR_NOT_SOFT,
    RF_ERROR_NULL, RF_ERROR_OVERLAP, RF_OK,
};
use crate::types::{
    RF_ABI_VERSION, rf_centre, rf_config, rf_detail, rf_internal_pose, rf_observation, rf_pose,
    rf_simulator, rf_step_report, rf_unit_id, rf_units, rf_velocity,
};
use core::ffi::{c_char, c_void};
use rigidformer_core::kernels::in_own_environment;
use rigidformer_core::{Limits, Observation, UnitId, UnitView};

/// Version of the library, such as "0.2.0"; a text that is never freed.
#[unsafe(no_mangle)]
pub extern "C" fn rf_version() -> *const c_char {
    concat!(env!("CARGO_PKG_VERSION"), "\0").as_ptr().cast()
}

/// RF_ABI_VERSION of the library; rf_init compares it with the header's.
#[unsafe(no_mangle)]
pub extern "C" fn rf_abi_version() -> u32 {
    RF_ABI_VERSION
}

/// What a code means, in English: a text that is never freed. Any number may be asked about.
#[unsafe(no_mangle)]
pub extern "C" fn rf_error_string(code: i32) -> *const c_char {
    // Never NULL, so that a program can print it without a check.
    text(code).as_ptr()
}

/// Takes a pose from seven numbers whose quaternion has w first, as those of Python, scene files and
/// recordings. Nothing is checked: the function that takes the pose does that.
///
/// @param numbers  x, y, z in metres, then w, x, y, z
/// @param pose     out: the pose
/// @return RF_OK, RF_ERROR_NULL or RF_ERROR_ALIGNMENT
///
/// # Safety
/// `numbers` is seven floats or NULL, `pose` may be written or is NULL.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn rf_pose_from_wxyz(numbers: *const f32, pose: *mut rf_pose) -> rf_status {
    let convert = || {
        let pose = output(pose, 1)?;
        // SAFETY: the caller's promise; the rest was checked.
        if let [x, y, z, w, i, j, k] = *unsafe { input(numbers, 7)? } {
            // SAFETY: as above.
            unsafe { pose.write(rf_pose { position: [x, y, z], quaternion: [i, j, k, w] }) };
        }
        Ok(())
    };
    status(convert())
}

/// Writes a pose as seven numbers whose quaternion has w first.
///
/// @param pose     the pose
/// @param numbers  out: x, y, z in metres, then w, x, y, z
/// @return as rf_pose_from_wxyz
///
/// # Safety
/// `pose` is a pose or NULL, and there is room for seven floats or `numbers` is NULL.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn rf_pose_to_wxyz(pose: *const rf_pose, numbers: *mut f32) -> rf_status {
    let convert = || {
        let numbers = output(numbers, 7)?;
        // SAFETY: the caller's promise; the rest was checked.
        for rf_pose { position: [x, y, z], quaternion: [i, j, k, w] } in unsafe { input(pose, 1)? }
        {
            let row = [x, y, z, w, i, j, k].map(|number| *number);
            // SAFETY: as above; there is room for seven.
            unsafe { numbers.cast::<[f32; 7]>().write(row) };
        }
        Ok(())
    };
    status(convert())
}

/// How large a workspace rf_init needs, exactly, in bytes: a multiple of RF_ALIGNMENT.
///
/// It depends on the model's sizes, the limits, the pointer size and this version of the library; of
/// libraries for Linux also on the kernels (RIGIDFORMER_KERNEL), on whether threads share a step, and where the model is int8 on its
/// weights, which the workspace then holds in another order. On processors with AMX, Linux refuses the
/// process signal stacks below about 11 kB from then on; RIGIDFORMER_KERNEL=avx512-vnni prevents that. Reads the whole model once (its
/// checksums); any thread may call it. Libraries for Linux allocate meanwhile.
///
/// @param config  the model and the limits
/// @param bytes   out: the size
/// @return RF_OK, RF_ERROR_NULL, RF_ERROR_ALIGNMENT, RF_ERROR_ABI, RF_ERROR_LENGTH,
///         RF_ERROR_KERNEL, RF_ERROR_THREADS or one of RF_ERROR_MODEL_...
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
        let (model, limits, threads) = unsafe { read(config)? };
        let needed = handle::workspace_bytes(model, limits, threads)?;
        // SAFETY: `output` checked it; the rest is the caller's promise.
        unsafe { out.write(needed) };
        Ok(())
    };
    status(in_own_environment(call))
}

/// Checks a model completely and makes a simulator in memory of the caller.
///
/// Nothing need be freed: what libraries for Linux allocate here, they free before this call returns. The workspace belongs to the simulator, and the
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
///         RF_ERROR_LENGTH, RF_ERROR_OVERLAP, RF_ERROR_KERNEL, RF_ERROR_THREADS or one of
///         RF_ERROR_MODEL_...
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
        // A workspace of NULL is refused later, with its own code.
        !workspace.is_null() && handle::overlap(workspace.addr(), workspace_bytes, address, bytes)
    };
    // A detail within the workspace would be overwritten, or would overwrite the simulator.
    let lost = inside(detail.addr(), size_of::<rf_detail>());
    let call = || {
        optional_output(detail)?;
        let out = output(simulator, 1)?;
        // Nothing is written before this, so that a simulator that is there goes on.
        if lost || inside(simulator.addr(), size_of::<*mut rf_simulator>()) {
            return Err(RF_ERROR_OVERLAP.into());
        }
        // SAFETY: `output` checked `out`; the rest is the caller's promise.
        unsafe {
            // A caller that ignores the status then fails at once, on NULL.
            out.write(core::ptr::null_mut());
            let (model, limits, threads) = read(config)?;
            out.write(handle::make(model, limits, threads, workspace.cast(), workspace_bytes)?);
        }
        Ok(())
    };
    let result: Result<(), rf_detail> = in_own_environment(call);
    let numbers = result.err().unwrap_or(rf_detail::of(RF_OK));
    // The detail is written for errors of all other arguments too.
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

/// Starts from two frames of points: the same points of the same units, in the same order, dt_s
/// seconds apart. Every step then takes as long. The previous frame becomes the reference of
/// rf_poses. Planes and gravity stay what they were; the ids and bonds of earlier units end. Soft
/// units deform: rf_soft_points says where their points are.
///
/// @param simulator    the simulator
/// @param dt_s         seconds between the two frames, and of a step; from 1 us (soft: 1 ms) and no longer
///                     than the model takes. nano and edge take 16 x 16/240 s in the scene's own time:
///                     1.07 s where the mean radius of free units is 0.7 m and gravity is the model's,
///                     and less by a square root where units are smaller or gravity is stronger. Models
///                     of soft bodies take 4096 of their sub-steps. The models that come with this
///                     project were trained with 1/240 to 40/240 s
/// @param units        the units
/// @param previous     (units->point_count, 3) x, y, z in metres, world frame
/// @param current      (units->point_count, 3) likewise
/// @param observation  out: what the observation was like; may be NULL
/// @return RF_OK, an error of the call (below 32), of the observation (64 to 79),
///         RF_ERROR_BAD_ROLE or RF_ERROR_BAD_BODY. Where it is refused, the scene is what it was
///
/// # Safety
/// The handle is one of rf_init; other pointers are NULL or point to what their types and lengths
/// say.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn rf_observe(
    simulator: *mut rf_simulator,
    dt_s: f32,
    units: *const rf_units,
    previous: *const f32,
    current: *const f32,
    observation: *mut rf_observation,
) -> rf_status {
    // SAFETY: here and below the caller's promise.
    unsafe {
        with_simulator(simulator, |locked| {
            let out = locked.optional(observation)?;
            let units = locked.units(units)?;
            let previous = locked.points(previous, units.points())?;
            let current = locked.points(current, units.points())?;
            let found = locked.simulator().observe(dt_s, units.observed(previous, current))?;
            report(out, found);
            Ok(())
        })
    }
}

/// Starts from known poses, dt_s seconds apart. Each carries the unit's reference points to the
/// world; nothing is fitted.
///
/// @param simulator    the simulator
/// @param dt_s         seconds, as for rf_observe
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
    dt_s: f32,
    units: *const rf_units,
    points: *const f32,
    previous: *const rf_pose,
    current: *const rf_pose,
    observation: *mut rf_observation,
) -> rf_status {
    // SAFETY: here and below the caller's promise.
    unsafe {
        with_simulator(simulator, |locked| {
            let out = locked.optional(observation)?;
            let units = locked.units(units)?;
            let points = locked.points(points, units.points())?;
            let previous = locked.input(previous, units.len())?;
            let current = locked.input(current, units.len())?;
            let posed = units.posed(points, previous, current);
            let found = locked.simulator().observe_poses(dt_s, posed)?;
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
        with_simulator(simulator, |locked| {
            let numbers = locked.input(numbers, count)?;
            Ok(locked.simulator().set_command(numbers)?)
        })
    }
}

/// Advances the scene by one step. The model moves free units, driven units go where rf_drive sends
/// them, and fixed units stay.
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
        with_simulator(simulator, |locked| {
            let out = locked.optional(report)?;
            let done = locked.step()?;
            if let Some(out) = out {
                out.write(rf_step_report {
                    active_units: done.active_units,
                    degenerate_units: done.degenerate_units,
                    #[cfg(feature = "health")]
                    quarantined_units: done.quarantined_units,
                    ..rf_step_report::default()
                });
            }
            Ok(())
        })
    }
}

/// Units in the scene: 0 before an observation or rf_add.
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
        with_simulator(simulator, |locked| {
            let out = locked.output(count, 1)?;
            out.write(locked.simulator().len() as u32);
            Ok(())
        })
    }
}

/// Ids of all units, in the order of rf_poses: that of the observation, then of rf_add.
///
/// @param simulator  the simulator
/// @param ids        out: (rf_unit_count) ids
/// @param capacity   how many there is room for
/// @return RF_OK, an error of the call, or RF_ERROR_BUFFER, which writes nothing
///
/// # Safety
/// As rf_observe.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn rf_unit_ids(
    simulator: *const rf_simulator,
    ids: *mut rf_unit_id,
    capacity: usize,
) -> rf_status {
    // SAFETY: the caller's promise.
    unsafe { by_unit(simulator, ids, capacity, |unit| unit.id().to_bits()) }
}

/// Pose of one unit in the current frame, as rf_poses gives it.
///
/// @param simulator  the simulator
/// @param id         which unit
/// @param pose       out: its pose
/// @return RF_OK, an error of the call or RF_ERROR_NO_SUCH_ID
///
/// # Safety
/// As rf_observe.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn rf_unit_pose(
    simulator: *const rf_simulator,
    id: rf_unit_id,
    pose: *mut rf_pose,
) -> rf_status {
    // SAFETY: the caller's promise.
    unsafe {
        with_simulator(simulator, |locked| {
            let out = locked.output(pose, 1)?;
            let found = locked.simulator().pose(UnitId::from_bits(id));
            out.write(found.ok_or(rf_detail::numbers(RF_ERROR_NO_SUCH_ID, id, 0))?.into());
            Ok(())
        })
    }
}

/// Poses of all units in the current frame: each carries the unit's reference points (rf_observe:
/// its points of the previous frame; rf_observe_poses, rf_add: `points`) to the world.
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
    unsafe { by_unit(simulator, poses, capacity, |unit| unit.pose().into()) }
}

/// How one unit moves now, at the end of its last step, in which gravity has acted to the end.
///
/// @param simulator  the simulator
/// @param id         which unit
/// @param velocity   out: its velocity
/// @return RF_OK, an error of the call or RF_ERROR_NO_SUCH_ID
///
/// # Safety
/// As rf_observe.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn rf_unit_velocity(
    simulator: *const rf_simulator,
    id: rf_unit_id,
    velocity: *mut rf_velocity,
) -> rf_status {
    // SAFETY: the caller's promise.
    unsafe {
        with_simulator(simulator, |locked| {
            let out = locked.output(velocity, 1)?;
            let found = locked.simulator().velocity(UnitId::from_bits(id));
            out.write(found.ok_or(rf_detail::numbers(RF_ERROR_NO_SUCH_ID, id, 0))?.into());
            Ok(())
        })
    }
}

/// How all units move now, in the order of rf_poses.
///
/// @param simulator   the simulator
/// @param velocities  out: (rf_unit_count) velocities, unit by unit
/// @param capacity    how many there is room for
/// @return RF_OK, an error of the call, or RF_ERROR_BUFFER, which writes nothing
///
/// # Safety
/// As rf_observe.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn rf_velocities(
    simulator: *const rf_simulator,
    velocities: *mut rf_velocity,
    capacity: usize,
) -> rf_status {
    // SAFETY: the caller's promise; `at` is below the capacity.
    unsafe {
        with_simulator(simulator, |locked| {
            let out = locked.output(velocities, capacity)?;
            let simulator = locked.simulator();
            fits(capacity, simulator.len())?;
            for (at, velocity) in simulator.velocities().enumerate() {
                out.add(at).write(velocity.into());
            }
            Ok(())
        })
    }
}

/// Centres of all units with all digits that the simulator keeps, in the order of rf_poses. Floats hold
/// no more than 6 cm at 1000 km.
///
/// @param simulator  the simulator
/// @param centres    out: (rf_unit_count) centres, x, y and z in the world, metres
/// @param capacity   how many there is room for
/// @return as rf_poses
///
/// # Safety
/// As rf_observe.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn rf_centres(
    simulator: *const rf_simulator,
    centres: *mut rf_centre,
    capacity: usize,
) -> rf_status {
    // SAFETY: the caller's promise.
    unsafe { by_unit(simulator, centres, capacity, |unit| unit.centre().into()) }
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
    unsafe { by_unit(simulator, poses, capacity, |unit| unit.internal_pose().into()) }
}

/// World positions of a unit's points in the current frame, in the simulator's own order, which is
/// not that of the observation: each next point is the one farthest from those before.
///
/// @param simulator  the simulator
/// @param unit       which unit, from 0, in the order of rf_poses
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
    // SAFETY: the caller's promise; `at` is below the count of points, which is at most the capacity.
    unsafe {
        with_simulator(simulator, |locked| {
            let found = locked.output(count, 1)?;
            let out = locked.output(points.cast::<[f32; 3]>(), capacity)?;
            let simulator = locked.simulator();
            let unit = simulator.unit(unit as usize).ok_or_else(|| {
                let units = simulator.len() as u64;
                rf_detail { unit, ..rf_detail::numbers(RF_ERROR_NO_SUCH_UNIT, 0, units) }
            })?;
            // Written before the check, so that a caller learns how long its array must be.
            found.write(unit.point_count());
            fits(capacity, unit.point_count())?;
            for (at, point) in unit.points().take(capacity).enumerate() {
                out.add(at).write(point.into());
            }
            Ok(())
        })
    }
}

/// World positions of a soft unit's points in the current frame, in the order in which rf_observe was
/// given them. A soft unit's pose is the place of the points' mean, without a turn.
///
/// @param simulator  the simulator
/// @param unit       which unit, from 0, in the order of rf_poses
/// @param points     out: (count, 3) x, y, z in metres; may be NULL where capacity is 0
/// @param capacity   how many points there is room for
/// @param count      out: how many points the unit has, also where RF_ERROR_BUFFER says that they do
///                   not fit
/// @return RF_OK, an error of the call, RF_ERROR_NO_SUCH_UNIT, RF_ERROR_NOT_SOFT or RF_ERROR_BUFFER
///
/// # Safety
/// As rf_observe.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn rf_soft_points(
    simulator: *const rf_simulator,
    unit: u32,
    points: *mut f32,
    capacity: usize,
    count: *mut usize,
) -> rf_status {
    // SAFETY: the caller's promise; a point is written where its number is below the capacity.
    unsafe {
        with_simulator(simulator, |locked| {
            let found = locked.output(count, 1)?;
            let out = locked.output(points.cast::<[f32; 3]>(), capacity)?;
            let simulator = locked.simulator();
            let view = simulator.unit(unit as usize).ok_or_else(|| {
                let units = simulator.len() as u64;
                rf_detail { unit, ..rf_detail::numbers(RF_ERROR_NO_SUCH_UNIT, 0, units) }
            })?;
            if !view.is_soft() {
                return Err(rf_detail { unit, ..rf_detail::of(RF_ERROR_NOT_SOFT) });
            }
            // Written before the check, so that a caller learns how long its array must be.
            found.write(view.point_count());
            fits(capacity, view.point_count())?;
            #[cfg(feature = "deform")]
            for (number, point) in view.soft_points().filter(|(number, _)| *number < capacity) {
                out.add(number).write(point.into());
            }
            #[cfg(not(feature = "deform"))]
            let _ = out;
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
        with_simulator(simulator, |locked| {
            let out = locked.output(detail, 1)?;
            out.write(*locked.detail());
            Ok(())
        })
    }
}

/// Writes something of every unit.
///
/// # Safety
/// As [`Locked::new`], and `slots` is NULL or has room for `capacity`.
unsafe fn by_unit<T>(
    simulator: *const rf_simulator,
    slots: *mut T,
    capacity: usize,
    of: impl Fn(UnitView<'_>) -> T,
) -> rf_status {
    // SAFETY: the caller's promise; `at` is below the capacity.
    unsafe {
        with_simulator(simulator, |locked| {
            let out = locked.output(slots, capacity)?;
            let simulator = locked.simulator();
            fits(capacity, simulator.len())?;
            for (at, unit) in simulator.units().enumerate() {
                out.add(at).write(of(unit));
            }
            Ok(())
        })
    }
}

fn report(out: Option<*mut rf_observation>, found: Observation) {
    // Taken apart by name, so that a new field of the core is not forgotten here.
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
unsafe fn read(config: *const rf_config) -> Result<(&'static [u8], Limits, u32), rf_detail> {
    // SAFETY: the caller's promise.
    let config = match unsafe { input(config, 1)? } {
        [config] => *config,
        _ => return Err(RF_ERROR_NULL.into()),
    };
    // Fields behind the version may mean something else in another header.
    if config.abi_version != RF_ABI_VERSION {
        let (found, expected) = (config.abi_version.into(), RF_ABI_VERSION.into());
        return Err(rf_detail::numbers(RF_ERROR_ABI, found, expected));
    }
    // SAFETY: the caller's promise.
    let model = unsafe { input(config.model, config.model_bytes)? };
    let limits = Limits { units: config.max_units as usize, points: config.max_points as usize };
    Ok((model, limits, config.threads))
}
