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

        pub(crate) fn choose() -> Result<Self, rf_detail> {
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
    use crate::types::rf_status::{RF_ERROR_KERNEL, RF_ERROR_OTHER};
    use rigidformer_core::{Layout, NoTrace, Schedule, Simulator, StepError, StepReport};
    use rigidformer_kernels::{HostKernels, Kernel, PanelsError, Run, Single, has_rows, to_panels};
    use rigidformer_weights::ModelFile;
    use std::vec::Vec;

    #[derive(Clone, Copy)]
    pub(crate) struct Engine {
        kernel: Kernel,
        layout: Layout,
    }

    impl Engine {
        /// Where the parts of a workspace begin: at cache lines, since a load that crosses two costs as much as two loads.
        pub(crate) const ALIGNMENT: usize = 64;

        pub(crate) fn choose() -> Result<Self, rf_detail> {
            let kernel = Kernel::chosen().map_err(|_| rf_detail::of(RF_ERROR_KERNEL))?;
            let layout = kernel.run(LayoutOf).ok_or(rf_detail::of(RF_ERROR_KERNEL))?;
            Ok(Engine { kernel, layout })
        }

        pub(crate) fn layout(self) -> Layout {
            self.layout
        }

        pub(crate) fn step(
            self,
            simulator: &mut Simulator<'_, '_>,
        ) -> Result<StepReport, StepError> {
            self.kernel.run(Step(simulator)).unwrap_or(Err(StepError::Layout))
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
