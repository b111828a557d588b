//! Progress and cancellation of long work.

use std::sync::atomic::AtomicBool;

/// Progress and cancellation of work in steps of scenes.
#[derive(Clone, Copy)]
pub struct Progress<'a> {
    /// Read before every step: once true, the work ends with an error that says so.
    pub cancelled: &'a AtomicBool,
    /// Called after every step of every scene, from any thread.
    pub stepped: &'a (dyn Fn() + Sync),
}

impl Progress<'static> {
    /// Without progress or cancellation.
    pub fn none() -> Self {
        static NEVER: AtomicBool = AtomicBool::new(false);
        Progress { cancelled: &NEVER, stepped: &|| {} }
    }
}
