//! Arrays of the caller, checked before they are touched, and the call around them.
#![allow(unsafe_code)]

use crate::convert::{self, UnitPieces, UnitRest, Units};
use crate::handle::Locked;
use crate::types::rf_status::{
    self, RF_ERROR_ALIGNMENT, RF_ERROR_BUFFER, RF_ERROR_LENGTH, RF_ERROR_NULL, RF_OK,
};
use crate::types::{rf_detail, rf_simulator, rf_unit, rf_units};
use nalgebra::Point3;
use rigidformer_core::kernels::in_own_environment;
use rigidformer_core::{MAX_PIECES, Pieces, Unit};

/// Runs a call on a simulator, to nearest whatever the caller's thread has set, and keeps the numbers of its error there.
///
/// # Safety
/// As [`Locked::new`].
pub(crate) unsafe fn with_simulator(
    simulator: *const rf_simulator,
    call: impl FnOnce(&mut Locked) -> Result<(), rf_detail>,
) -> rf_status {
    // SAFETY: the caller's promise.
    let mut locked = match unsafe { Locked::new(simulator) } {
        Ok(locked) => locked,
        Err(detail) => return detail.code,
    };
    let result = in_own_environment(|| call(&mut locked));
    if let Err(detail) = result {
        // Kept in the workspace, since the library has no memory of its own.
        *locked.detail() = detail;
    }
    status(result)
}

pub(crate) fn status(result: Result<(), rf_detail>) -> rf_status {
    result.err().map_or(RF_OK, |detail| detail.code)
}

pub(crate) fn fits(capacity: usize, needed: usize) -> Result<(), rf_detail> {
    if capacity < needed {
        return Err(rf_detail::numbers(RF_ERROR_BUFFER, capacity as u64, needed as u64));
    }
    Ok(())
}

/// An array to read; one of length 0 may be NULL.
///
/// # Safety
/// `array` is NULL or has `length` elements, which nothing changes during the call.
pub(crate) unsafe fn input<'a, T>(array: *const T, length: usize) -> Result<&'a [T], rf_detail> {
    addressable(array, length)?;
    if length == 0 {
        return Ok(&[]);
    }
    // SAFETY: not NULL, aligned and of a length that can be; the rest is the caller's promise.
    Ok(unsafe { core::slice::from_raw_parts(array, length) })
}

/// An array to write, perhaps not initialised; one of length 0 may be NULL.
pub(crate) fn output<T>(array: *mut T, length: usize) -> Result<*mut T, rf_detail> {
    addressable(array, length)?;
    Ok(array)
}

pub(crate) fn optional_output<T>(place: *mut T) -> Result<Option<*mut T>, rf_detail> {
    if place.is_null() { Ok(None) } else { output(place, 1).map(Some) }
}

fn addressable<T>(array: *const T, length: usize) -> Result<(), rf_detail> {
    if length == 0 {
        return Ok(());
    }
    if array.is_null() {
        return Err(RF_ERROR_NULL.into());
    }
    // Processors such as the Cortex-M0 fault on such an access, and Rust forbids it everywhere.
    if !array.is_aligned() {
        return Err(RF_ERROR_ALIGNMENT.into());
    }
    // Slices of Rust are at most `isize::MAX` bytes long.
    let size = length.checked_mul(size_of::<T>()).filter(|size| isize::try_from(*size).is_ok());
    // An array that wraps round the address space is not one.
    match size.and_then(|size| array.addr().checked_add(size)) {
        Some(_) => Ok(()),
        None => Err(RF_ERROR_LENGTH.into()),
    }
}

/// The same for arrays of a call on a simulator, which must lie outside its workspace.
impl Locked {
    /// # Safety
    /// As [`input`].
    pub(crate) unsafe fn input<'a, T>(
        &self,
        array: *const T,
        length: usize,
    ) -> Result<&'a [T], rf_detail> {
        addressable(array, length)?;
        // Checked before a reference is made: two references to the workspace would be undefined.
        self.outside(array, length)?;
        // SAFETY: the caller's promise.
        unsafe { input(array, length) }
    }

    /// One element to read.
    ///
    /// # Safety
    /// As [`input`].
    pub(crate) unsafe fn one<T: Copy>(&self, place: *const T) -> Result<T, rf_detail> {
        // SAFETY: the caller's promise.
        match unsafe { self.input(place, 1)? } {
            [element] => Ok(*element),
            _ => Err(RF_ERROR_NULL.into()),
        }
    }

    /// An array to read; NULL is an empty one.
    ///
    /// # Safety
    /// As [`input`].
    unsafe fn optional_input<'a, T>(
        &self,
        array: *const T,
        length: usize,
    ) -> Result<&'a [T], rf_detail> {
        // SAFETY: the caller's promise.
        if array.is_null() { Ok(&[]) } else { unsafe { self.input(array, length) } }
    }

    pub(crate) fn output<T>(&self, array: *mut T, length: usize) -> Result<*mut T, rf_detail> {
        let array = output(array, length)?;
        self.outside(array, length)?;
        Ok(array)
    }

    pub(crate) fn optional<T>(&self, place: *mut T) -> Result<Option<*mut T>, rf_detail> {
        if place.is_null() { Ok(None) } else { self.output(place, 1).map(Some) }
    }

    /// The units of an observation, but for their points.
    ///
    /// # Safety
    /// As [`input`], for the arrays of `units` too.
    pub(crate) unsafe fn units<'a>(&self, units: *const rf_units) -> Result<Units<'a>, rf_detail> {
        // SAFETY: the caller's promise.
        unsafe {
            let units = self.one(units)?;
            let pieces = UnitPieces::new(
                self.optional_input(units.unit_pieces, units.unit_count)?,
                self.input(units.piece_counts, units.piece_count)?,
                self.points(units.piece_points, units.piece_point_count)?,
            )?;
            let young_pa = self.optional_input(units.young_pa, units.unit_count)?;
            let rest = match young_pa {
                // Rigid scenes need no points at rest, so NULL is fine.
                [] => &[],
                _ => self.points(units.rest_points, units.point_count)?,
            };
            Units::new(
                self.input(units.physics, units.unit_count)?,
                self.input(units.point_counts, units.unit_count)?,
                units.point_count,
                self.optional_input(units.roles, units.unit_count)?,
                self.optional_input(units.bodies, units.unit_count)?,
                self.optional_input(units.inertias_kg_m2.cast(), units.unit_count)?,
                pieces,
                UnitRest::new(young_pa, rest)?,
            )
        }
    }

    /// A unit and its points.
    ///
    /// # Safety
    /// As [`input`], for the arrays of `unit` too.
    pub(crate) unsafe fn unit<'a>(&self, unit: *const rf_unit) -> Result<Unit<'a>, rf_detail> {
        // SAFETY: the caller's promise.
        unsafe {
            let unit = self.one(unit)?;
            let counts = self.input(unit.piece_counts, unit.piece_count)?;
            // The core refuses more pieces than these without a look at the points.
            let counted = counts.iter().take(MAX_PIECES);
            let pieces = counted.fold(0_usize, |sum, count| sum.saturating_add((*count).into()));
            let pieces = Pieces::new(self.points(unit.piece_points, pieces)?, counts);
            Ok(Unit {
                role: convert::role(unit.role)?,
                body: convert::body(unit.body)?,
                inertia_kg_m2: convert::inertia(unit.inertia_kg_m2),
                pieces,
                ..Unit::new(self.points(unit.points, unit.point_count)?, unit.physics.into())
            })
        }
    }

    /// # Safety
    /// As [`input`], of three floats a point.
    pub(crate) unsafe fn points<'a>(
        &self,
        points: *const f32,
        count: usize,
    ) -> Result<&'a [Point3<f32>], rf_detail> {
        // SAFETY: the caller's promise; `convert` asserts that three floats are a point.
        unsafe { self.input(points.cast(), count) }
    }
}
