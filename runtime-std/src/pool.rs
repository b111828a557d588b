//! The threads that share work: rayon's, or, in a process that was forked, some of its own.
//!
//! A fork has none of its parent's threads, and work that waits for those would wait for ever.

use std::error::Error;
use std::process;
use std::sync::OnceLock;
use std::sync::atomic::{AtomicU32, Ordering};

use rayon::{ThreadPool, ThreadPoolBuilder};
use rigidformer_core::kernels::in_own_environment;

/// Processes, each forked from the one before, that make threads.
const MOST_PROCESSES: usize = 32;

/// The threads of one process.
struct Slot {
    /// Whose; 0: nobody's yet.
    process: AtomicU32,
    pool: OnceLock<Option<Pool>>,
}

enum Pool {
    /// Rayon's own, which a program may have configured.
    Global,
    Own(ThreadPool),
}

// Each process writes into a slot that no other has begun to: a fork comes at any time, also while a slot is written.
static SLOTS: [Slot; MOST_PROCESSES] =
    [const { Slot { process: AtomicU32::new(0), pool: OnceLock::new() } }; MOST_PROCESSES];

/// The threads of this process; none where the system gives none.
fn pool() -> Option<&'static Pool> {
    let this = process::id();
    let mine = |slot: &&Slot| {
        let claimed = slot.process.compare_exchange(0, this, Ordering::AcqRel, Ordering::Acquire);
        claimed.map_or_else(|process| process == this, |_| true)
    };
    let (index, slot) = SLOTS.iter().enumerate().find(|(_, slot)| mine(slot))?;
    // Threads begin with what the one has set that makes them.
    let made = || in_own_environment(|| if index == 0 { global() } else { own() });
    slot.pool.get_or_init(made).as_ref()
}

/// Rayon's own threads.
fn global() -> Option<Pool> {
    match ThreadPoolBuilder::new().build_global() {
        // The system refused a thread. Without a source the pool is there already.
        Err(error) if error.source().is_some() => None,
        _ => Some(Pool::Global),
    }
}

/// Threads of a forked process.
fn own() -> Option<Pool> {
    ThreadPoolBuilder::new().build().ok().map(Pool::Own)
}

/// How many threads the current pool has; one where the system gives none.
pub fn size() -> usize {
    if rayon::current_thread_index().is_some() {
        return rayon::current_num_threads();
    }
    match pool() {
        Some(Pool::Global) => rayon::current_num_threads(),
        Some(Pool::Own(pool)) => pool.current_num_threads(),
        None => 1,
    }
}

/// Whether work can be shared: there is a pool, and all of rayon's functions inside of [`enter`] use it.
pub fn is_there() -> bool {
    rayon::current_thread_index().is_some() || pool().is_some()
}

/// Runs `body` on a thread of the current pool, or of this process's: rayon's functions in it use that pool. Where the system gives no
/// threads it runs here, and must then not share its work ([`is_there`]).
pub fn enter<R: Send>(body: impl FnOnce() -> R + Send) -> R {
    // A thread of a pool is awake already.
    if rayon::current_thread_index().is_some() {
        return body();
    }
    match pool() {
        Some(Pool::Global) => rayon::scope(|_| body()),
        Some(Pool::Own(pool)) => pool.install(body),
        None => body(),
    }
}

/// Both, on two threads where there are some.
pub(crate) fn join<A: Send, B: Send>(
    one: impl FnOnce() -> A + Send,
    other: impl FnOnce() -> B + Send,
) -> (A, B) {
    let (mut one, mut other) = (Some(one), Some(other));
    let (mut first, mut second) = (None, None);
    join_erased(&mut || first = one.take().map(|one| one()), &mut || {
        second = other.take().map(|other| other());
    });
    match (first, second) {
        (Some(first), Some(second)) => (first, second),
        _ => unreachable!("both have run"),
    }
}

// Rayon's join, compiled for each closure of each kernel, would be half of this crate.
fn join_erased(one: &mut (dyn FnMut() + Send), other: &mut (dyn FnMut() + Send)) {
    if rayon::current_thread_index().is_some() {
        rayon::join(one, other);
        return;
    }
    match pool() {
        Some(Pool::Global) => drop(rayon::join(one, other)),
        Some(Pool::Own(pool)) => drop(pool.join(one, other)),
        None => {
            one();
            other();
        }
    }
}
