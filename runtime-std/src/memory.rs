//! How much memory the contents of a file may take.
//!
//! A short file can ask for much memory: an image of zeros, a shape that many units share. Readers count what their contents take in
//! memory, at its size there, before anything is allocated. Each scene, capture, import, model and mesh has a [`Budget`] of its own.

use std::sync::atomic::{AtomicU64, Ordering};

/// Bytes of a budget where nothing else is said: 1 GiB.
pub const USUAL_BYTES: u64 = 1 << 30;

static LIMIT: AtomicU64 = AtomicU64::new(USUAL_BYTES);

/// Bytes of a budget in this process: [`USUAL_BYTES`], unless [`set_limit`] says otherwise.
pub fn limit() -> u64 {
    LIMIT.load(Ordering::Relaxed)
}

/// Gives each [`Budget::default`] from here on so many bytes. It holds for the whole process, as the option `--memory` of the program.
///
/// ```
/// use rigidformer_runtime::memory;
/// memory::set_limit(4 << 30);
/// assert_eq!(memory::limit(), 4 << 30);
/// ```
pub fn set_limit(bytes: u64) {
    LIMIT.store(bytes, Ordering::Relaxed);
}

/// Contents that take more memory than they may.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[error("takes {needed} bytes of memory or more, and may take {most}")]
pub struct TooLarge {
    /// Bytes that were counted so far.
    pub needed: u64,
    /// Bytes of the budget.
    pub most: u64,
}

impl TooLarge {
    /// What the user can do about it.
    pub const REMEDY: &'static str =
        "split it, or allow more with --memory, such as --memory 4G (memory::set_limit)";
}

/// Bytes that may be allocated for one thing.
///
/// ```
/// use rigidformer_runtime::memory::Budget;
/// let mut budget = Budget::new(1000);
/// budget.take(600)?;
/// assert!(budget.take(600).is_err_and(|error| error.needed == 1200));
/// assert_eq!(budget.left(), 400, "what is refused is not counted");
/// # Ok::<(), rigidformer_runtime::memory::TooLarge>(())
/// ```
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Budget {
    most: u64,
    taken: u64,
}

impl Default for Budget {
    /// As large as [`limit`] says.
    fn default() -> Self {
        Self::new(limit())
    }
}

impl Budget {
    /// A budget of so many bytes.
    pub fn new(most: u64) -> Self {
        Self { most, taken: 0 }
    }

    /// Counts bytes that are about to be allocated.
    ///
    /// # Errors
    /// [`TooLarge`] where they are more than are left; then nothing is counted.
    pub fn take(&mut self, bytes: u64) -> Result<(), TooLarge> {
        let needed = self.taken.saturating_add(bytes);
        if needed > self.most {
            return Err(TooLarge { needed, most: self.most });
        }
        self.taken = needed;
        Ok(())
    }

    /// Counts so many values of a type that are about to be allocated.
    ///
    /// # Errors
    /// As [`take`](Self::take).
    pub fn take_all<T>(&mut self, count: usize) -> Result<(), TooLarge> {
        self.take((count as u64).saturating_mul(size_of::<T>() as u64))
    }

    /// Counts bytes that are freed again.
    pub fn give(&mut self, bytes: u64) {
        self.taken = self.taken.saturating_sub(bytes);
    }

    /// Bytes that may still be taken.
    pub fn left(&self) -> u64 {
        self.most.saturating_sub(self.taken)
    }
}
