//! A model and a simulator in memory that the caller owns, and handles to them.
//!
//! A workspace, the state at a multiple of [`RF_ALIGNMENT`] and each other part at one of [`Engine::ALIGNMENT`]:
//!
//! ```text
//! | State: header, model, simulator | f32 slab | unit slab | point slab | i8 slab | the model in panels |
//! ```
//!
//! The last part is there where the engine reads int8 matrices in panels and the caller's model has them in rows.
//!
//! The simulator refers to the model and to the slabs, so a workspace must stay where it is; the
//! header knows its own address. A handle is that address.
//!
//! # Why this is sound
//!
//! - [`State`] is only ever reached through a raw pointer, field by field. No reference to all of
//!   it is made: one would alias the simulator's reference to the model.
//! - Those two references, and the `'static` in [`State`], last until the caller releases, moves or
//!   reuses the memory, which the caller of `rf_init` promises to do only after the last call. After
//!   [`release`] calls find no magic number and stop before they touch anything else.
//! - `busy` is taken before the simulator is touched and given back after, so there is never more
//!   than one reference to it, whichever threads and interrupts call.
//! - Nothing here frees a resource when dropped, so memory is simply left.
#![allow(unsafe_code)]

use crate::engine::{self, Engine};
use crate::types::rf_status::{
    RF_ERROR_ALIGNMENT, RF_ERROR_BUSY, RF_ERROR_HANDLE, RF_ERROR_LENGTH, RF_ERROR_MEMORY,
    RF_ERROR_NULL, RF_ERROR_OTHER, RF_ERROR_OVERLAP, RF_OK,
};
use crate::types::{RF_ALIGNMENT, rf_detail, rf_simulator};
use core::mem::{offset_of, size_of};
use core::sync::atomic::{AtomicBool, AtomicU32, Ordering};
use nalgebra::Point3;
use rigidformer_core::{
    Limits, Model, Simulator, SlabSizes, Slabs, StepError, StepReport, UnitSlot,
};
use rigidformer_weights::{ModelConfig, ModelFile};

/// "RFS2", in a file of memory that a debugger shows.
// Memory of another kind has this number once in four billion.
const MAGIC: u32 = u32::from_le_bytes(*b"RFS2");

/// What comes first in every workspace.
#[repr(C)]
struct Header {
    /// [`MAGIC`] while there is a simulator.
    magic: AtomicU32,
    busy: AtomicBool,
    /// Where this header was made.
    own: *const Header,
    /// Length of the workspace, bytes.
    bytes: usize,
    detail: rf_detail,
}

/// What a workspace begins with.
#[repr(C, align(16))]
struct State {
    header: Header,
    engine: Engine,
    model: Model<'static>,
    simulator: Simulator<'static, 'static>,
}

const _: () = assert!(align_of::<State>() == RF_ALIGNMENT);
// A handle is the workspace's address, and the header is read through it.
const _: () = assert!(offset_of!(State, header) == 0);
// Every slab begins at a multiple of the engine's alignment, which must suit its elements, and a model's.
const _: () = assert!(Engine::ALIGNMENT.is_multiple_of(align_of::<UnitSlot>()));
const _: () = assert!(Engine::ALIGNMENT.is_multiple_of(RF_ALIGNMENT));

/// Parts of a workspace behind the state: offsets from the first of them, bytes.
#[derive(Clone, Copy)]
struct Plan {
    engine: Engine,
    limits: Limits,
    slabs: SlabSizes,
    f32: usize,
    units: usize,
    points: usize,
    i8: usize,
    /// Of the model in panels.
    model: usize,
    /// The whole workspace.
    bytes: usize,
}

impl Plan {
    /// `model_bytes` is the length of the model in panels, or 0.
    fn new(
        config: &ModelConfig,
        limits: Limits,
        threads: u32,
        model_bytes: usize,
    ) -> Result<Self, rf_detail> {
        let engine = Engine::choose(threads)?;
        let slabs = SlabSizes::of(config, limits, 1, engine.layout());
        let reserve = |at: &mut usize, length: usize, size: usize| {
            let here = *at;
            let end = here.checked_add(length.checked_mul(size)?)?;
            *at = end.checked_next_multiple_of(Engine::ALIGNMENT)?;
            Some(here)
        };
        let mut at = 0;
        let plan = (|| {
            let f32 = reserve(&mut at, slabs.f32, size_of::<f32>())?;
            let units = reserve(&mut at, slabs.units, size_of::<UnitSlot>())?;
            let points = reserve(&mut at, slabs.points, size_of::<Point3<f32>>())?;
            let i8 = reserve(&mut at, slabs.i8, size_of::<i8>())?;
            let model = reserve(&mut at, model_bytes, 1)?;
            // A workspace begins at a multiple of RF_ALIGNMENT, so the first part may have to wait for one of the engine's.
            let bytes = at.checked_add(size_of::<State>())?;
            let bytes = bytes.checked_add(Engine::ALIGNMENT.checked_sub(RF_ALIGNMENT)?)?;
            // Pointers within a workspace may be at most `isize::MAX` bytes apart.
            isize::try_from(bytes).is_ok().then_some(())?;
            Some(Plan { engine, limits, slabs, f32, units, points, i8, model, bytes })
        })();
        plan.ok_or(rf_detail::of(RF_ERROR_LENGTH))
    }
}

/// Length of the workspace that [`make`] needs.
pub(crate) fn workspace_bytes(
    model: &[u8],
    limits: Limits,
    threads: u32,
) -> Result<usize, rf_detail> {
    let file = ModelFile::parse(model)?;
    let packed = engine::packed(model)?;
    Ok(Plan::new(file.config(), limits, threads, packed.map_or(0, |packed| packed.len()))?.bytes)
}

/// Checks a model and makes a simulator in `memory`, which is untouched where that fails.
///
/// # Safety
/// `memory` may be read and written for `bytes`, and stays so, at its place and used by nothing
/// else, until the last call with the handle; so does what `model` refers to.
pub(crate) unsafe fn make(
    model: &'static [u8],
    limits: Limits,
    threads: u32,
    memory: *mut u8,
    bytes: usize,
) -> Result<*mut rf_simulator, rf_detail> {
    if memory.is_null() {
        return Err(RF_ERROR_NULL.into());
    }
    if !memory.addr().is_multiple_of(RF_ALIGNMENT) {
        return Err(RF_ERROR_ALIGNMENT.into());
    }
    // A model within the workspace would be overwritten while it is read.
    if overlap(memory.addr(), bytes, model.as_ptr().addr(), model.len()) {
        return Err(RF_ERROR_OVERLAP.into());
    }
    // The model is checked before the memory is written: a simulator that is there goes on.
    let loaded = Model::load(model)?;
    let packed = engine::packed(model)?;
    let packed: Option<&[u8]> = packed.as_ref().map(AsRef::as_ref);
    let plan = Plan::new(loaded.config(), limits, threads, packed.map_or(0, <[u8]>::len))?;
    // The detail says how much is needed, so that a caller may size its array by one failed call.
    if bytes < plan.bytes {
        return Err(rf_detail::numbers(RF_ERROR_MEMORY, bytes as u64, plan.bytes as u64));
    }
    // SAFETY: the memory is the caller's, aligned and long enough for this plan.
    unsafe { lay_out(loaded, packed, &plan, memory) }
}

/// # Safety
/// As [`make`]; `memory` is aligned to [`RF_ALIGNMENT`] and holds `plan.bytes`.
unsafe fn lay_out(
    model: Model<'static>,
    packed: Option<&[u8]>,
    plan: &Plan,
    memory: *mut u8,
) -> Result<*mut rf_simulator, rf_detail> {
    let state: *mut State = memory.cast();
    // The plan has room for this: see `Plan::new`.
    let behind = memory.addr().wrapping_add(size_of::<State>());
    let first = behind.next_multiple_of(Engine::ALIGNMENT).wrapping_sub(memory.addr());
    // SAFETY: all of the plan lies within the memory and its parts apart from each other, each at a
    // multiple of 16. Zeros are valid f32, points and i8, and every unit is written, so that the
    // slabs may be referred to.
    // From here to the last line nobody has a handle. The references made here are the simulator's
    // alone: see the head of this file.
    unsafe {
        memory.write_bytes(0, plan.bytes);
        (&raw mut (*state).engine).write(plan.engine);
        let parts = memory.add(first);
        let model = match packed {
            None => model,
            Some(packed) => {
                let at = parts.add(plan.model);
                at.copy_from_nonoverlapping(packed.as_ptr(), packed.len());
                // It is the model that was loaded, in another form.
                Model::load(core::slice::from_raw_parts(at, packed.len()))?
            }
        };
        (&raw mut (*state).model).write(model);
        let units: *mut UnitSlot = parts.add(plan.units).cast();
        // Zeros are no valid unit slot, so each is written.
        for unit in 0..plan.slabs.units {
            units.add(unit).write(UnitSlot::EMPTY);
        }
        let slabs = Slabs {
            f32: core::slice::from_raw_parts_mut(parts.add(plan.f32).cast(), plan.slabs.f32),
            i8: core::slice::from_raw_parts_mut(parts.add(plan.i8).cast(), plan.slabs.i8),
            points: core::slice::from_raw_parts_mut(
                parts.add(plan.points).cast(),
                plan.slabs.points,
            ),
            units: core::slice::from_raw_parts_mut(units, plan.slabs.units),
        };
        // The plan has the lengths that the simulator asks for, so it has no reason to refuse.
        let layout = plan.engine.layout();
        let simulator = Simulator::with_layout(&(*state).model, plan.limits, 1, layout, slabs)
            .map_err(|_| rf_detail::of(RF_ERROR_OTHER))?;
        (&raw mut (*state).simulator).write(simulator);
        // The header comes last: until its magic number stands, no call finds a simulator.
        (&raw mut (*state).header).write(Header {
            magic: AtomicU32::new(MAGIC),
            busy: AtomicBool::new(false),
            own: state.cast(),
            bytes: plan.bytes,
            detail: rf_detail::of(RF_OK),
        });
    }
    Ok(memory.cast())
}

/// Ends a simulator: later calls with the handle are refused.
///
/// # Safety
/// As [`Locked::new`].
pub(crate) unsafe fn release(handle: *mut rf_simulator) -> Result<(), rf_detail> {
    // SAFETY: the caller's promise is that of `new`.
    let locked = unsafe { Locked::new(handle)? };
    // SAFETY: `new` found a header, and an atomic may be shared.
    unsafe { (*locked.header).magic.store(0, Ordering::Release) };
    Ok(())
}

/// Marks a simulator as one that a call is in; whether one was before.
#[cfg(target_has_atomic = "8")]
fn enter(busy: &AtomicBool) -> bool {
    busy.swap(true, Ordering::Acquire)
}

#[cfg(not(any(target_has_atomic = "8", target_arch = "riscv32")))]
compile_error!(
    "this target has no atomic instructions; say in bindings/c/src/handle.rs how it switches interrupts off"
);

/// The same on a RISC-V core without atomic instructions, such as the ESP32-C3's. There is one core, and
/// code runs in machine mode: nothing gets in between while interrupts are off.
#[cfg(all(target_arch = "riscv32", not(target_has_atomic = "8")))]
fn enter(busy: &AtomicBool) -> bool {
    const INTERRUPTS: u32 = 1 << 3;
    let before: u32;
    // SAFETY: a few instructions later interrupts are what they were.
    unsafe { core::arch::asm!("csrrci {}, mstatus, 8", out(reg) before) };
    let was = busy.load(Ordering::Acquire);
    busy.store(true, Ordering::Release);
    // SAFETY: this switches on only what was on.
    unsafe { core::arch::asm!("csrs mstatus, {}", in(reg) before & INTERRUPTS) };
    was
}

/// A simulator that no other call is in.
pub(crate) struct Locked {
    header: *mut Header,
}

impl Locked {
    /// # Safety
    /// `handle` is NULL, or what [`make`] returned, or points to memory that can be read like a
    /// header.
    pub(crate) unsafe fn new(handle: *const rf_simulator) -> Result<Self, rf_detail> {
        if handle.is_null() {
            return Err(RF_ERROR_NULL.into());
        }
        // An unaligned read is undefined, so the address is looked at before the memory.
        if !handle.addr().is_multiple_of(RF_ALIGNMENT) {
            return Err(RF_ERROR_HANDLE.into());
        }
        let header: *mut Header = handle.cast_mut().cast();
        // SAFETY: readable by the caller's promise, and aligned. Behind the magic number is a header
        // that `lay_out` wrote; its `own` does not change, and atomics may be shared.
        unsafe {
            if (*header).magic.load(Ordering::Acquire) != MAGIC || (*header).own != header {
                return Err(RF_ERROR_HANDLE.into());
            }
            // Refused and not waited for: an interrupt handler that waits for what it interrupts
            // waits for ever.
            if enter(&(*header).busy) {
                return Err(RF_ERROR_BUSY.into());
            }
            // Another thread may release it between the first look and this one.
            if (*header).magic.load(Ordering::Acquire) != MAGIC {
                (*header).busy.store(false, Ordering::Release);
                return Err(RF_ERROR_HANDLE.into());
            }
        }
        Ok(Locked { header })
    }

    pub(crate) fn simulator(&mut self) -> &mut Simulator<'static, 'static> {
        // SAFETY: `new` found a header, so a `State` is around it, and `busy` is ours: this is the
        // only reference to the simulator, and it ends before `self` does.
        unsafe { &mut (*self.header.cast::<State>()).simulator }
    }

    /// Advances the scene by one step.
    pub(crate) fn step(&mut self) -> Result<StepReport, StepError> {
        // SAFETY: as in `simulator`; the field does not change.
        let engine = unsafe { (*self.header.cast::<State>()).engine };
        engine.step(self.simulator())
    }

    /// Keeps the numbers of an error, or shows those of the last.
    pub(crate) fn detail(&mut self) -> &mut rf_detail {
        // SAFETY: as in `simulator`; nothing else refers to this field.
        unsafe { &mut (*self.header).detail }
    }

    /// Refuses an array that lies within the workspace.
    pub(crate) fn outside<T>(&self, array: *const T, length: usize) -> Result<(), rf_detail> {
        // SAFETY: as in `simulator`; the field does not change.
        let bytes = unsafe { (*self.header).bytes };
        // `addressable` has shown that the product fits.
        let size = length.saturating_mul(size_of::<T>());
        if overlap(self.header.addr(), bytes, array.addr(), size) {
            return Err(RF_ERROR_OVERLAP.into());
        }
        Ok(())
    }
}

impl Drop for Locked {
    fn drop(&mut self) {
        // SAFETY: as in `new`.
        unsafe { (*self.header).busy.store(false, Ordering::Release) };
    }
}

pub(crate) fn overlap(a: usize, a_bytes: usize, b: usize, b_bytes: usize) -> bool {
    // Empty ranges overlap nothing, wherever they begin.
    a_bytes > 0 && b_bytes > 0 && a < b.saturating_add(b_bytes) && b < a.saturating_add(a_bytes)
}

#[cfg(test)]
mod tests {
    use super::*;
    use rigidformer_weights::{Aligned, include_model};

    const MODEL: &Aligned<[u8]> = include_model!("../tests/data/smallest.rfm");

    #[repr(align(16))]
    struct Memory([u8; 64]);

    /// What is refused, and that none of the memory was written.
    fn refused(bytes: usize, off: usize) -> Option<rf_detail> {
        let mut memory = Memory([0xa5; 64]);
        let limits = Limits { units: 2, points: 10 };
        // SAFETY: no pointer that can be read or written is handed in: an error comes first.
        let made =
            unsafe { make(MODEL, limits, 1, memory.0.as_mut_ptr().wrapping_add(off), bytes) };
        assert!(memory.0.iter().all(|byte| *byte == 0xa5));
        made.err()
    }

    #[test]
    fn too_little_memory_says_how_much_is_needed() -> Result<(), rf_detail> {
        let needed = workspace_bytes(MODEL, Limits { units: 2, points: 10 }, 0)?;
        for bytes in [0, 1, size_of::<Header>() - 1, size_of::<Header>(), 64] {
            let detail = refused(bytes, 0).ok_or(rf_detail::of(RF_OK))?;
            assert_eq!((detail.code, detail.found), (RF_ERROR_MEMORY, bytes as u64));
            assert_eq!(detail.expected, needed as u64, "{bytes} bytes");
        }
        Ok(())
    }

    #[test]
    fn memory_that_cannot_be_is_not_touched() {
        for bytes in [0, 1, 8, 48] {
            assert_eq!(refused(bytes, 8), Some(RF_ERROR_ALIGNMENT.into()));
            let limits = Limits { units: 2, points: 10 };
            // SAFETY: NULL is refused.
            let made = unsafe { make(MODEL, limits, 1, core::ptr::null_mut(), bytes) };
            assert_eq!(made.err(), Some(RF_ERROR_NULL.into()));
        }
    }
}
