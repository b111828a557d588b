//! Which kernels run a step, and on how many threads.

use crate::kernels::{Kernel, KernelError};
use crate::pool;
use crate::threads::Threads;

/// Which kernels to run, and on how many threads.
///
/// ```
/// use rigidformer_runtime::engine::Engine;
/// use rigidformer_runtime::kernels::Kernel;
/// use rigidformer_runtime::threads::Threads;
///
/// let fastest = Engine::new()?;
/// let reference = Engine { kernel: Kernel::Portable, threads: Threads::ONE };
/// println!("{} instead of {}", fastest.kernel, reference.kernel); // the same bits
/// # Ok::<(), rigidformer_runtime::kernels::KernelError>(())
/// ```
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Engine {
    /// Kernels that this processor can run.
    pub kernel: Kernel,
    /// Threads of the current rayon pool that share a step.
    pub threads: Threads,
}

impl Engine {
    /// The fastest kernels of this processor, or those that
    /// [`RIGIDFORMER_KERNEL`](crate::kernels::VARIABLE) names, on all threads.
    ///
    /// # Errors
    /// [`KernelError`] where the variable names none that this processor can run.
    pub fn new() -> Result<Self, KernelError> {
        Ok(Engine { kernel: Kernel::chosen()?, threads: Threads::all() })
    }

    /// The same kernels on one thread, for scenes that are on threads of their own.
    pub fn single(self) -> Self {
        Engine { threads: self.threads.alone(), ..self }
    }

    /// Runs `body` on a thread of the current rayon pool where several share a step: a loop of steps then gives work to awake threads. On one
    /// thread it runs here.
    pub fn enter<R: Send>(self, body: impl FnOnce() -> R + Send) -> R {
        if self.threads.count() == 1 { body() } else { pool::enter(body) }
    }
}
