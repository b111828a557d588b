//! Objects that threads share: one call at a time, also in a process that was forked while a call was under way.

use std::process;
use std::sync::atomic::{AtomicBool, AtomicU32, Ordering};
use std::sync::mpsc::{self, RecvTimeoutError};
use std::sync::{Arc, Mutex, MutexGuard, TryLockError};
use std::thread;
use std::time::Duration;

use pyo3::prelude::*;
use pyo3::sync::MutexExt;

use crate::errors::{fault, input};
use crate::interrupt::{TICK, free, interruptible, safe};

/// How often a lock of another process is looked at again, and how long each time.
// A thread that has just taken the lock has yet to say so.
const LOOKS: usize = 20;
const LOOK: Duration = Duration::from_millis(5);

/// What one call at a time may use.
pub(crate) struct Locked<T> {
    value: Mutex<T>,
    /// The process of the thread that took the lock last.
    holder: AtomicU32,
    /// A call has failed within.
    is_broken: AtomicBool,
}

impl<T: Send> Locked<T> {
    pub(crate) fn new(value: T) -> Self {
        Locked {
            value: Mutex::new(value),
            holder: AtomicU32::new(0),
            is_broken: AtomicBool::new(false),
        }
    }

    /// The value. Another thread that uses it is waited for with the interpreter free.
    pub(crate) fn lock(&self, py: Python<'_>) -> PyResult<MutexGuard<'_, T>> {
        if self.is_broken.load(Ordering::Relaxed) {
            return Err(broken());
        }
        let value = match self.value.try_lock() {
            Ok(value) => value,
            Err(TryLockError::WouldBlock) => self.wait(py)?,
            Err(TryLockError::Poisoned(_)) => return Err(broken()),
        };
        // It may have failed in the thread that was waited for.
        if self.is_broken.load(Ordering::Relaxed) {
            return Err(broken());
        }
        self.holder.store(process::id(), Ordering::Relaxed);
        Ok(value)
    }

    fn wait(&self, py: Python<'_>) -> PyResult<MutexGuard<'_, T>> {
        for _ in 0..LOOKS {
            if self.holder.load(Ordering::Relaxed) == process::id() {
                // A plain lock would wait with the interpreter held, and its holder may need that.
                return self.value.lock_py_attached(py).map_err(|_| broken());
            }
            py.detach(|| thread::sleep(LOOK));
            match self.value.try_lock() {
                Ok(value) => return Ok(value),
                Err(TryLockError::WouldBlock) => {}
                Err(TryLockError::Poisoned(_)) => return Err(broken()),
            }
        }
        // The thread that has it is the parent's, and will never give it back.
        Err(input(
            "the process was forked while a call on this object was under way; make a new one here",
        ))
    }

    /// After a fault of the library in a call with the value, it is of no use. For the one that has the lock.
    pub(crate) fn note<R>(&self, done: &PyResult<R>) {
        self.is_broken.fetch_or(done.is_err(), Ordering::Relaxed);
    }

    /// Uses the value with the interpreter free. After a fault of the library it is of no use.
    pub(crate) fn freely<R: Send>(
        &self,
        py: Python<'_>,
        work: impl FnOnce(&mut T) -> R + Send,
    ) -> PyResult<R> {
        let mut guard = self.lock(py)?;
        let value: &mut T = &mut guard;
        let done = free(py, || work(value));
        self.note(&done);
        done
    }
}

impl<T: Send> Locked<T> {
    /// As [`freely`](Self::freely), for work that ends early once its flag is true: at Ctrl-C, whose exception is the call's.
    pub(crate) fn interruptibly<R: Send>(
        &self,
        py: Python<'_>,
        work: impl FnOnce(&mut T, &AtomicBool) -> R + Send,
    ) -> PyResult<R> {
        let mut guard = self.lock(py)?;
        let value: &mut T = &mut guard;
        let has_ended = AtomicBool::new(false);
        let done = interruptible(py, |cancelled| {
            let result = work(value, cancelled);
            has_ended.store(true, Ordering::Relaxed);
            result
        });
        // An exception of Ctrl-C is no fault: the work has ended in order.
        let is_fault = done.is_err() && !has_ended.load(Ordering::Relaxed);
        self.is_broken.fetch_or(is_fault, Ordering::Relaxed);
        done
    }
}

impl<T: Send + 'static> Locked<T> {
    /// As [`freely`](Self::freely), for work that may be long and cannot end early: another thread does it with a copy, which takes
    /// the value's place. At Ctrl-C the value is what it was, and the thread ends by itself. Without a copy or a thread the
    /// value itself is changed, to the end.
    pub(crate) fn aside<R: Send + 'static>(
        &self,
        py: Python<'_>,
        copy: impl FnOnce(&mut T) -> Option<T> + Send,
        work: impl FnOnce(&mut T) -> R + Send + 'static,
    ) -> PyResult<R> {
        let mut guard = self.lock(py)?;
        let value: &mut T = &mut guard;
        let (to, mut from) = mpsc::channel();
        let work = Arc::new(Mutex::new(Some(work)));
        let taken = |work: &Mutex<Option<_>>| work.lock().ok().and_then(|mut work| work.take());
        if let Some(mut other) = free(py, || copy(value))? {
            let own = Arc::clone(&work);
            let body = move || {
                let done = safe(move || taken(&own).map(|work| (work(&mut other), other)));
                // A caller that was interrupted does not wait for it.
                let _ = to.send(done);
            };
            if thread::Builder::new().name("rigidformer".into()).spawn(body).is_ok() {
                loop {
                    let done = py.detach(|| {
                        let from = &mut from;
                        from.recv_timeout(TICK)
                    });
                    match done {
                        Ok(Ok(Some((result, other)))) => {
                            *value = other;
                            return Ok(result);
                        }
                        Ok(Err(panic)) => return Err(fault(&*panic)),
                        Err(RecvTimeoutError::Timeout) => py.check_signals()?,
                        Ok(Ok(None)) | Err(RecvTimeoutError::Disconnected) => {
                            return Err(fault(&"the work was lost"));
                        }
                    }
                }
            }
        }
        let work = taken(&work).ok_or_else(|| fault(&"the work was lost"))?;
        let done = free(py, || work(value));
        self.note(&done);
        done
    }
}

fn broken() -> PyErr {
    input("a call on this object failed with a fault of the library; make a new one")
}
