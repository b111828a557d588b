//! Long calls: the interpreter is free meanwhile, and Ctrl-C ends them.

use std::sync::atomic::{AtomicBool, Ordering};
use std::thread;
use std::time::Duration;

use pyo3::prelude::*;

use crate::errors::OrRaise;

/// How often signals are looked for.
// Nobody feels 50 ms after Ctrl-C, and twenty wake-ups a second cost nothing.
pub(crate) const TICK: Duration = Duration::from_millis(50);

/// Runs `work` on a thread of its own while this one, which Python may have given the signals to, looks for them. Once there is
/// one whose handler raises, `work`'s flag is true; its exception is the call's when `work` has ended.
pub(crate) fn interruptible<R: Send>(
    py: Python<'_>,
    work: impl FnOnce(&AtomicBool) -> R + Send,
) -> PyResult<R> {
    let (cancelled, done) = (AtomicBool::new(false), AtomicBool::new(false));
    let caller = thread::current();
    thread::scope(|scope| {
        let (flag, ended) = (&cancelled, &done);
        let body = move || {
            // Dropped on a panic as well, or the caller would wait for ever.
            let _wake = WakeCaller { ended, caller };
            work(flag)
        };
        // Python runs handlers of signals on its main thread alone, which must not be busy.
        let worker = thread::Builder::new().name("rigidformer".into()).spawn_scoped(scope, body);
        let worker = worker.or_raise()?;
        let mut interrupted = None;
        while !done.load(Ordering::Acquire) {
            // Parked without the interpreter: the work may need it, for a cost in Python.
            py.detach(|| thread::park_timeout(TICK));
            // A second Ctrl-C must not replace the exception of the first.
            if interrupted.is_none()
                && let Err(error) = py.check_signals()
            {
                // The work ends by itself: a thread cannot be stopped from outside.
                cancelled.store(true, Ordering::Relaxed);
                interrupted = Some(error);
            }
        }
        // Joined without the interpreter, which the end of the work may still need.
        let result = py.detach(|| worker.join());
        match (interrupted, result) {
            (Some(error), _) => Err(error),
            (None, Ok(result)) => Ok(result),
            // A panic is a fault of the library, which PyO3 turns into an exception.
            (None, Err(panic)) => std::panic::resume_unwind(panic),
        }
    })
}

/// Wakes the caller however the work ends.
struct WakeCaller<'t> {
    ended: &'t AtomicBool,
    caller: thread::Thread,
}

impl Drop for WakeCaller<'_> {
    fn drop(&mut self) {
        self.ended.store(true, Ordering::Release);
        // Otherwise each short call would last until the next tick.
        self.caller.unpark();
    }
}
