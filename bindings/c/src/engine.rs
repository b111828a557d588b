//! What steps a simulator: the kernels that the target is sure to have, or with `std` the fastest of this processor.

#[cfg(not(feature = "std"))]
pub(crate) use target::{Engine, packed};

#[cfg(feature = "std")]
pub(crate) use host::{Engine, packed};

/// Kernels that the target is sure to have, on models as they are.
#[cfg(not(feature = "std"))]
mod target {
    use crate::types::rf_detail;
    use rigidformer_core::{Layout, Simulator, StepError, StepReport};

    #[derive(Clone, Copy)]
    pub(crate) struct Engine;

    impl Engine {
        /// Where the parts of a workspace begin: at multiples of RF_ALIGNMENT.
        pub(crate) const ALIGNMENT: usize = crate::types::RF_ALIGNMENT;

        pub(crate) fn choose(_threads: u32) -> Result<Self, rf_detail> {
            Ok(Engine)
        }

        pub(crate) fn layout(self) -> Layout {
            Layout::SMALL
        }

        pub(crate) fn step(
            self,
            simulator: &mut Simulator<'_, '_>,
        ) -> Result<StepReport, StepError> {
            simulator.step()
        }
    }

    /// The form that a workspace holds; none, since the model is read in place.
    pub(crate) fn packed(_: &[u8]) -> Result<Option<&'static [u8]>, rf_detail> {
        Ok(None)
    }
}

/// The fastest kernels of this processor, or those that the environment names, as Rust's runtime chooses them.
#[cfg(feature = "std")]
mod host {
    use crate::types::rf_detail;
    use crate::types::rf_status::{RF_ERROR_KERNEL, RF_ERROR_OTHER, RF_ERROR_THREADS};
    use rigidformer_core::{Layout, NoTrace, Schedule, Simulator, StepError, StepReport};
    use rigidformer_kernels::{HostKernels, Kernel, PanelsError, Run, Single, has_rows, to_panels};
    use rigidformer_weights::ModelFile;
    use std::vec::Vec;

    #[derive(Clone, Copy)]
    pub(crate) struct Engine {
        kernel: Kernel,
        /// That share a step, at least 1.
        threads: u32,
        layout: Layout,
    }

    impl Engine {
        /// Where the parts of a workspace begin: at cache lines, since a load that crosses two costs as much as two loads.
        pub(crate) const ALIGNMENT: usize = 64;

        pub(crate) fn choose(threads: u32) -> Result<Self, rf_detail> {
            if threads > MOST_THREADS {
                let (found, expected) = (threads.into(), MOST_THREADS.into());
                return Err(rf_detail::numbers(RF_ERROR_THREADS, found, expected));
            }
            let kernel = Kernel::chosen().map_err(|_| rf_detail::of(RF_ERROR_KERNEL))?;
            let layout = match threads > 1 {
                true => shared::layout(kernel),
                false => kernel.run(LayoutOf),
            };
            let layout = layout.ok_or(rf_detail::of(RF_ERROR_KERNEL))?;
            Ok(Engine { kernel, threads: threads.max(1), layout })
        }

        pub(crate) fn layout(self) -> Layout {
            self.layout
        }

        pub(crate) fn step(
            self,
            simulator: &mut Simulator<'_, '_>,
        ) -> Result<StepReport, StepError> {
            let stepped = match self.threads > 1 {
                true => shared::step(self.kernel, self.threads, simulator),
                false => self.kernel.run(Step(simulator)),
            };
            stepped.unwrap_or(Err(StepError::Layout))
        }
    }

    #[cfg(feature = "threads")]
    const MOST_THREADS: u32 = crate::types::RF_MAX_THREADS;
    #[cfg(not(feature = "threads"))]
    const MOST_THREADS: u32 = 1;

    /// Several threads, the runtime's.
    #[cfg(feature = "threads")]
    mod shared {
        use super::{HostKernels, Kernel, Layout, NoTrace, Run, Simulator, StepError, StepReport};
        use rigidformer_core::Schedule;
        use rigidformer_runtime::pool;
        use rigidformer_runtime::threads::{Threaded, Threads};

        pub(super) fn layout(kernel: Kernel) -> Option<Layout> {
            struct LayoutOf;

            impl Run for LayoutOf {
                type Output = Layout;

                fn run<K: HostKernels>(self, _: K) -> Layout {
                    Threaded::<K>::LAYOUT
                }
            }

            kernel.run(LayoutOf)
        }

        struct Step<'s, 'a, 'b> {
            threads: Threads,
            simulator: &'s mut Simulator<'a, 'b>,
        }

        impl Run for Step<'_, '_, '_> {
            type Output = Result<StepReport, StepError>;

            fn run<K: HostKernels>(self, kernels: K) -> Self::Output {
                let schedule = Threaded::new(kernels, self.threads);
                self.simulator.step_on(schedule, &mut NoTrace)
            }
        }

        pub(super) fn step(
            kernel: Kernel,
            threads: u32,
            simulator: &mut Simulator<'_, '_>,
        ) -> Option<Result<StepReport, StepError>> {
            let threads = Threads::new(threads as usize);
            // On a thread of the pool, or each layer waits for one to wake up.
            pool::enter(|| kernel.run(Step { threads, simulator }))
        }
    }

    /// There are none.
    #[cfg(not(feature = "threads"))]
    mod shared {
        use super::{Kernel, Layout, Simulator, StepError, StepReport};

        pub(super) fn layout(_: Kernel) -> Option<Layout> {
            None
        }

        pub(super) fn step(
            _: Kernel,
            _: u32,
            _: &mut Simulator<'_, '_>,
        ) -> Option<Result<StepReport, StepError>> {
            None
        }
    }

    struct LayoutOf;

    impl Run for LayoutOf {
        type Output = Layout;

        fn run<K: HostKernels>(self, _: K) -> Layout {
            Single::<K>::LAYOUT
        }
    }

    struct Step<'s, 'a, 'b>(&'s mut Simulator<'a, 'b>);

    impl Run for Step<'_, '_, '_> {
        type Output = Result<StepReport, StepError>;

        fn run<K: HostKernels>(self, kernels: K) -> Self::Output {
            self.0.step_on(Single(kernels), &mut NoTrace)
        }
    }

    /// The form that a workspace holds: int8 matrices in panels. None for a model that is read in place.
    pub(crate) fn packed(model: &[u8]) -> Result<Option<Vec<u8>>, rf_detail> {
        if !has_rows(&ModelFile::parse(model)?) {
            return Ok(None);
        }
        to_panels(model).map(Some).map_err(|error| match error {
            PanelsError::Format(error) => error.into(),
            PanelsError::Write(_) => RF_ERROR_OTHER.into(),
        })
    }
}
