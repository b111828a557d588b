//! Long calls: the interpreter is free meanwhile, and Ctrl-C ends them. A fault of the library is an exception, and work has the
//! stack that it needs and rounds to nearest, whatever the caller's thread has.

use std::any::Any;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::atomic::{AtomicBool, Ordering};
use std::thread;
use std::time::Duration;

use pyo3::prelude::*;
use rigidformer_core::kernels::in_own_environment;
use rigidformer_runtime::pool;

use crate::errors::{fault, input};

/// How often signals are looked for.
// Nobody feels 20 ms after Ctrl-C, and fifty wake-ups a second cost nothing.
pub(crate) const TICK: Duration = Duration::from_millis(20);

/// Stack that a step and an observation need, with room to spare.
// On AVX2 a step takes about 150 KiB; threads of Python may have 32 KiB.
const STACK_LEFT: usize = 512 << 10;
/// Stack for them where the thread has less left.
const STACK: usize = 2 << 20;

/// Runs `work` with the interpreter free.
pub(crate) fn free<R: Send>(py: Python<'_>, work: impl FnOnce() -> R + Send) -> PyResult<R> {
    py.detach(|| safe(work)).map_err(|panic| fault(&*panic))
}

/// Runs `work` with the interpreter held, for what reads arrays in place or is short.
pub(crate) fn held<R>(work: impl FnOnce() -> R) -> PyResult<R> {
    safe(work).map_err(|panic| fault(&*panic))
}

/// With enough stack and to nearest; its panic, if there is one.
pub(crate) fn safe<R>(work: impl FnOnce() -> R) -> thread::Result<R> {
    let work = || in_own_environment(work);
    // What a panic leaves half done is behind locks, which it poisons.
    catch_unwind(AssertUnwindSafe(|| stacker::maybe_grow(STACK_LEFT, STACK, work)))
}

/// As [`interruptible`], on the threads that rayon's functions use.
pub(crate) fn shared<R: Send>(
    py: Python<'_>,
    work: impl FnOnce(&AtomicBool) -> R + Send,
) -> PyResult<R> {
    with_threads()?;
    interruptible(py, |cancelled| pool::enter(|| work(cancelled)))
}

/// An error where the system gives no threads to share work among.
pub(crate) fn with_threads() -> PyResult<()> {
    match pool::is_there() {
        true => Ok(()),
        false => Err(input(
            "the system gives this process no threads; raise the limit of processes (ulimit -u, or the container's pids) or of memory",
        )),
    }
}

/// Runs `work` on a thread of its own while this one, which Python may have given the signals to, looks for them. Once there is
/// one whose handler raises, `work`'s flag is true; its exception is the call's when `work` has ended.
pub(crate) fn interruptible<R: Send>(
    py: Python<'_>,
    work: impl FnOnce(&AtomicBool) -> R + Send,
) -> PyResult<R> {
    let (cancelled, done) = (AtomicBool::new(false), AtomicBool::new(false));
    let caller = thread::current();
    // Taken by the thread, or left for this one.
    let work = std::sync::Mutex::new(Some(work));
    let taken = || work.lock().ok().and_then(|mut work| work.take());
    let ended = thread::scope(|scope| {
        let (flag, ended) = (&cancelled, &done);
        let body = move || {
            // Dropped on a panic as well, or the caller would wait for ever.
            let _wake = WakeCaller { ended, caller };
            // A thread begins with what the one has set that makes it.
            in_own_environment(|| taken().map(|work| work(flag)))
        };
        // Python runs handlers of signals on its main thread alone, which must not be busy.
        let worker = thread::Builder::new().name("rigidformer".into()).spawn_scoped(scope, body);
        let Ok(worker) = worker else { return Ended::NoThread };
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
        Ended::Thread(py.detach(|| worker.join()), interrupted)
    });
    match ended {
        Ended::Thread(_, Some(error)) => Err(error),
        Ended::Thread(Ok(Some(result)), None) => Ok(result),
        Ended::Thread(Err(panic), None) => Err(fault(&*panic)),
        // The system gives no thread: the work is done here, and ends before a signal is looked at.
        Ended::Thread(Ok(None), None) | Ended::NoThread => match taken() {
            Some(work) => free(py, || work(&cancelled)),
            None => Err(fault(&"the work was lost")),
        },
    }
}

/// How the work of a call ended.
enum Ended<R> {
    Thread(Result<Option<R>, Box<dyn Any + Send>>, Option<PyErr>),
    NoThread,
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
