//! How long work is watched and stopped.

use std::sync::atomic::AtomicBool;

/// How many steps of scenes are watched and stopped.
#[derive(Clone, Copy)]
pub struct Progress<'a> {
    /// Looked at before every step: once true, the work ends with an error that says so.
    pub cancelled: &'a AtomicBool,
    /// Called after every step of every scene, from any thread.
    pub stepped: &'a (dyn Fn() + Sync),
}

impl Progress<'static> {
    /// Neither watched nor stopped.
    pub fn none() -> Self {
        static NEVER: AtomicBool = AtomicBool::new(false);
        Progress { cancelled: &NEVER, stepped: &|| {} }
    }
}
