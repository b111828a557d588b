//! Ctrl-C: a flag that long work looks at. Files get their names at the end, and temporary ones vanish when the work returns; a second Ctrl-C
//! removes them and ends the program before that.

use std::sync::Once;
use std::sync::atomic::{AtomicBool, Ordering};

use rigidformer_evaluation::rollout::RolloutError;
use rigidformer_runtime::files;

static INTERRUPTED: AtomicBool = AtomicBool::new(false);

/// From now on Ctrl-C sets the flag that is returned; a second one ends the program at once.
pub fn watch() -> &'static AtomicBool {
    static ONCE: Once = Once::new();
    ONCE.call_once(|| {
        // Without a handler Ctrl-C ends the program at once.
        let _ = ctrlc::set_handler(|| {
            if INTERRUPTED.swap(true, Ordering::Relaxed) {
                files::abandon();
                std::process::exit(130);
            }
        });
    });
    &INTERRUPTED
}

/// The flag that Ctrl-C sets once [`watch`] was called.
pub(crate) fn flag() -> &'static AtomicBool {
    &INTERRUPTED
}

/// An error once Ctrl-C was pressed.
///
/// # Errors
/// [`RolloutError::Cancelled`]
pub fn check() -> Result<(), RolloutError> {
    if INTERRUPTED.load(Ordering::Relaxed) { Err(RolloutError::Cancelled) } else { Ok(()) }
}
