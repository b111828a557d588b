//! Trackers by their handles.
//!
//! A handle is the number of a tracker in the form of a pointer. It is looked up and never read, so that a dead or a made-up one is
//! refused. Numbers are never given twice.

use super::convert::Failure;
use super::types::rf_tracker;
use crate::types::rf_status::{
    self, RF_ERROR_BUSY, RF_ERROR_DEFECT, RF_ERROR_HANDLE, RF_ERROR_NULL, RF_OK,
};
use core::panic::AssertUnwindSafe;
use rigidformer_core::kernels::in_own_environment;
use rigidformer_perception::tracker::{Forecast, Tracker};
use std::collections::BTreeMap;
use std::panic::catch_unwind;
use std::string::String;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError, TryLockError};

/// Numbers from one handle to the next.
// Handles look like aligned pointers to debuggers and to sanitisers of bindings.
const APART: usize = 16;

pub(super) struct State {
    pub(super) tracker: Tracker,
    pub(super) forecast: Forecast,
    /// What the last error was, and its remedy.
    pub(super) message: String,
    /// Whether a call ended in a panic, after which nothing is known of the tracker.
    is_broken: bool,
}

struct Trackers {
    all: BTreeMap<usize, Arc<Mutex<State>>>,
    next: usize,
}

static TRACKERS: Mutex<Trackers> = Mutex::new(Trackers { all: BTreeMap::new(), next: APART });

fn trackers() -> MutexGuard<'static, Trackers> {
    // Nothing that panics runs under this lock, and a map is whole between two operations.
    TRACKERS.lock().unwrap_or_else(PoisonError::into_inner)
}

/// Takes a tracker in.
pub(super) fn add(tracker: Tracker) -> *mut rf_tracker {
    let state =
        State { tracker, forecast: Forecast::default(), message: String::new(), is_broken: false };
    let mut trackers = trackers();
    let handle = trackers.next;
    // Two numbers are the same after 2^60 trackers.
    trackers.next = handle.wrapping_add(APART).max(APART);
    trackers.all.insert(handle, Arc::new(Mutex::new(state)));
    core::ptr::without_provenance_mut(handle)
}

/// Ends a tracker that no call is in.
pub(super) fn remove(handle: *const rf_tracker) -> rf_status {
    if handle.is_null() {
        return RF_ERROR_NULL;
    }
    let mut trackers = trackers();
    let Some(found) = trackers.all.get(&handle.addr()).cloned() else { return RF_ERROR_HANDLE };
    if matches!(found.try_lock(), Err(TryLockError::WouldBlock)) {
        return RF_ERROR_BUSY;
    }
    trackers.all.remove(&handle.addr());
    drop(trackers);
    // What it drops may be large: not under the lock.
    guarded(|| {
        drop(found);
        Ok(())
    })
    .map_or_else(|failure| failure.code, |()| RF_OK)
}

/// Runs a call on a tracker, and keeps the text of its error there.
pub(super) fn with(
    handle: *const rf_tracker,
    call: impl FnOnce(&mut State) -> Result<(), Failure>,
) -> rf_status {
    if handle.is_null() {
        return RF_ERROR_NULL;
    }
    let found = trackers().all.get(&handle.addr()).cloned();
    let Some(found) = found else { return RF_ERROR_HANDLE };
    let mut state = match found.try_lock() {
        Ok(state) => state,
        // Refused and not waited for, as simulators do.
        Err(TryLockError::WouldBlock) => return RF_ERROR_BUSY,
        Err(TryLockError::Poisoned(_)) => return RF_ERROR_DEFECT,
    };
    if state.is_broken {
        return RF_ERROR_DEFECT;
    }
    match guarded(|| call(&mut state)) {
        Ok(()) => RF_OK,
        Err(failure) => {
            state.is_broken = failure.code == RF_ERROR_DEFECT;
            state.message = failure.message;
            failure.code
        }
    }
}

/// Runs a call to nearest, and turns a panic into an error: nothing unwinds into C.
pub(super) fn guarded<R>(call: impl FnOnce() -> Result<R, Failure>) -> Result<R, Failure> {
    // Whoever sees a state that a panic left behind is told so by its code.
    catch_unwind(AssertUnwindSafe(|| in_own_environment(call)))
        .unwrap_or_else(|_| Err(Failure::of(RF_ERROR_DEFECT)))
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used, clippy::panic)]
    use super::*;
    use rigidformer_perception::tracker::TrackerOptions;

    fn tracker() -> *mut rf_tracker {
        add(Tracker::new(TrackerOptions::default()).unwrap())
    }

    #[test]
    fn a_panic_ends_the_tracker_and_nothing_else() {
        let (one, other) = (tracker(), tracker());
        let status = with(one, |_| panic!("on purpose"));
        assert_eq!(status, RF_ERROR_DEFECT);
        assert_eq!(with(one, |_| Ok(())), RF_ERROR_DEFECT);
        assert_eq!(with(other, |_| Ok(())), RF_OK);
        assert_eq!([remove(one), remove(other)], [RF_OK; 2]);
        assert_eq!([remove(one), with(other, |_| Ok(()))], [RF_ERROR_HANDLE; 2]);
    }

    #[test]
    fn a_second_call_is_refused() {
        let handle = tracker();
        let status = with(handle, |_| {
            assert_eq!(with(handle, |_| Ok(())), RF_ERROR_BUSY);
            assert_eq!(remove(handle), RF_ERROR_BUSY);
            Ok(())
        });
        assert_eq!(status, RF_OK);
        assert_eq!(remove(handle), RF_OK);
    }
}
