//! Simulators on this machine's fastest kernels and all its cores, whatever their types.

use nalgebra::{Isometry3, Point3};
use rigidformer_core::geometry::Pose;
use rigidformer_core::{
    CommandError, Kernels, Layer, Limits, Model, Observation, ObserveError, Physics, Simulator,
    SlabSizes, Slabs, StepError, StepReport, Trace, Unit, WorkspaceError,
};

use crate::kernels::{HostKernels, Kernel, KernelError, Run, Threaded, Threads};

/// The most units that a simulator of this runtime has room for, those of all copies together.
pub const MAX_UNITS: usize = 512;

/// Which kernels to run, and on how many threads.
///
/// ```
/// use rigidformer_runtime::engine::Engine;
/// use rigidformer_runtime::kernels::{Kernel, Threads};
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
        Engine { threads: Threads::ONE, ..self }
    }

    /// Calls `body`, on a thread of the current rayon pool, with a simulator that has room for so many copies of a scene
    /// within `limits`.
    ///
    /// ```
    /// use nalgebra::{Isometry3, Point3};
    /// use rigidformer_runtime::core::{Limits, Physics, Unit};
    /// use rigidformer_runtime::{engine::Engine, models::LoadedModel};
    ///
    /// let loaded = LoadedModel::embedded("edge", rigidformer_weights::EDGE)?;
    /// let corner = |i: usize, bit| if i & bit == 0 { -0.1 } else { 0.1 };
    /// let points: Vec<_> = (0..8).map(|i| Point3::new(corner(i, 1), corner(i, 2), corner(i, 4))).collect();
    /// let cube = Unit { points: &points, physics: Physics { mass_kg: 1.0, friction: 0.4, restitution: 0.3 } };
    /// let height = Engine::new()?.simulate(&loaded.model()?, Limits { units: 1, points: 8 }, 1, |simulator| {
    ///     let [before, now] = [1.02, 1.0].map(|z| [Isometry3::translation(0.0, 0.0, z)]);
    ///     simulator.observe_poses(5, &[cube], &before, &now)?;
    ///     simulator.step()?;
    ///     Ok::<_, Box<dyn std::error::Error + Send + Sync>>(simulator.pose(0).map(|pose| pose.translation.z))
    /// })??;
    /// assert!(height.is_some_and(|z| (0.97..0.98).contains(&z)));
    /// # Ok::<(), Box<dyn std::error::Error + Send + Sync>>(())
    /// ```
    ///
    /// # Errors
    /// [`EngineError`] where the processor lacks the kernels or the scene is too large.
    pub fn simulate<R: Send>(
        self,
        model: &Model<'_>,
        limits: Limits,
        copies: usize,
        body: impl FnOnce(&mut dyn Stepping) -> R + Send,
    ) -> Result<R, EngineError> {
        // No type of the caller's goes further: all that is large is compiled once, in this crate.
        let (mut body, mut result) = (Some(body), None);
        let mut once = |simulator: &mut dyn Stepping| {
            if let Some(body) = body.take() {
                result = Some(body(simulator));
            }
        };
        self.start(model, limits, copies, &mut once)?;
        let lacking = KernelError::Lacking { kernel: self.kernel };
        result.ok_or(EngineError::Kernel(lacking))
    }

    fn start(
        self,
        model: &Model<'_>,
        limits: Limits,
        copies: usize,
        body: &mut (dyn FnMut(&mut dyn Stepping) + Send),
    ) -> Result<(), EngineError> {
        let threads = self.threads;
        let task = Task { model, limits, copies, threads, body };
        let lacking = EngineError::Kernel(KernelError::Lacking { kernel: self.kernel });
        let run = || self.kernel.run(task).ok_or(lacking)?;
        if threads == Threads::ONE { run() } else { rayon::scope(|_| run()) }
    }
}

struct Task<'t, 'm> {
    model: &'t Model<'m>,
    limits: Limits,
    copies: usize,
    threads: Threads,
    body: &'t mut (dyn FnMut(&mut dyn Stepping) + Send),
}

impl Run for Task<'_, '_> {
    type Output = Result<(), EngineError>;

    fn run<K: HostKernels>(self, kernels: K) -> Self::Output {
        let Task { model, limits, copies, threads, body } = self;
        let sizes = SlabSizes::of::<Threaded<K>>(model.config(), limits, copies);
        // From a cache line on.
        let mut f32_slab = vec![0.0; sizes.f32 + 16];
        let start = f32_slab.as_ptr().align_offset(64).min(16);
        let f32_slab = &mut f32_slab[start..];
        let mut i8_slab = vec![0; sizes.i8];
        let mut point_slab = vec![Point3::origin(); sizes.points];
        let slabs = Slabs { f32: f32_slab, i8: &mut i8_slab, points: &mut point_slab };
        let kernels = Threaded::new(kernels, threads);
        let mut simulator =
            Simulator::<'_, '_, MAX_UNITS, _>::with_kernels(kernels, model, limits, copies, slabs)?;
        body(&mut simulator);
        Ok(())
    }
}

/// Why there is no simulator.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum EngineError {
    /// The kernels cannot be used.
    #[error(transparent)]
    Kernel(#[from] KernelError),
    /// The limits cannot be met.
    #[error(transparent)]
    Workspace(#[from] WorkspaceError),
}

/// A [`Simulator`] of whatever kernels; each method is the simulator's own.
pub trait Stepping: Send {
    /// [`Simulator::observe`]
    fn observe(
        &mut self,
        step: u32,
        physics: &[Physics],
        previous: &[&[Point3<f32>]],
        current: &[&[Point3<f32>]],
    ) -> Result<Observation, ObserveError>;

    /// [`Simulator::observe_poses`]
    fn observe_poses(
        &mut self,
        step: u32,
        units: &[Unit<'_>],
        previous: &[Isometry3<f32>],
        current: &[Isometry3<f32>],
    ) -> Result<Observation, ObserveError>;

    /// [`Simulator::set_command`]
    fn set_command(&mut self, command: &[f32]) -> Result<(), CommandError>;

    /// [`Simulator::step`]
    fn step(&mut self) -> Result<StepReport, StepError>;

    /// [`Simulator::step_traced`]
    fn step_traced(&mut self, trace: &mut dyn Trace) -> Result<StepReport, StepError>;

    /// [`Simulator::pose`]
    fn pose(&self, unit: usize) -> Option<Isometry3<f32>>;

    /// [`Simulator::previous_pose`]
    fn previous_pose(&self, unit: usize) -> Option<Isometry3<f32>>;

    /// [`Simulator::internal_pose`]
    fn internal_pose(&self, unit: usize) -> Option<Pose>;

    /// The first of [`Simulator::points`], as many as `out` has; how many there are of them.
    fn first_points(&self, unit: usize, out: &mut [Point3<f32>]) -> usize;

    /// [`Simulator::len`]
    fn units(&self) -> usize;

    /// [`Simulator::copies`]
    fn copies(&self) -> usize;

    /// [`Simulator::replicate`]
    fn replicate(&mut self, copies: usize) -> usize;

    /// [`Simulator::retain_copies`]
    fn retain_copies(&mut self, keep: &mut dyn FnMut(usize) -> bool);

    /// [`Simulator::set_copy_command`]
    fn set_copy_command(&mut self, copy: usize, command: &[f32]) -> Result<bool, CommandError>;

    /// [`Simulator::set_poses`]
    fn set_poses(
        &mut self,
        copy: usize,
        unit: usize,
        previous: &Isometry3<f32>,
        current: &Isometry3<f32>,
    ) -> Result<bool, ObserveError>;

    /// [`Simulator::set_physics`]
    fn set_physics(
        &mut self,
        copy: usize,
        unit: usize,
        physics: Physics,
    ) -> Result<bool, ObserveError>;

    /// [`Simulator::step_copies`]
    fn step_copies(
        &mut self,
        report: &mut dyn FnMut(usize, Result<StepReport, StepError>),
    ) -> Result<(), StepError>;
}

/// One type for every trace, so that the forward pass is compiled once per kernel.
struct Borrowed<'t>(Option<&'t mut dyn Trace>);

impl Trace for Borrowed<'_> {
    fn record(&mut self, layer: Layer, index: usize, values: &[f32]) {
        if let Some(trace) = &mut self.0 {
            trace.record(layer, index, values);
        }
    }

    fn records(&self) -> bool {
        self.0.as_ref().is_some_and(|trace| trace.records())
    }

    fn enter(&mut self, stage: rigidformer_core::Stage) {
        if let Some(trace) = &mut self.0 {
            trace.enter(stage);
        }
    }
}

impl<const UNITS: usize, K: Kernels + Send> Stepping for Simulator<'_, '_, UNITS, K> {
    fn observe(
        &mut self,
        step: u32,
        physics: &[Physics],
        previous: &[&[Point3<f32>]],
        current: &[&[Point3<f32>]],
    ) -> Result<Observation, ObserveError> {
        Simulator::observe(self, step, physics, previous, current)
    }

    fn observe_poses(
        &mut self,
        step: u32,
        units: &[Unit<'_>],
        previous: &[Isometry3<f32>],
        current: &[Isometry3<f32>],
    ) -> Result<Observation, ObserveError> {
        Simulator::observe_poses(self, step, units, previous, current)
    }

    fn set_command(&mut self, command: &[f32]) -> Result<(), CommandError> {
        Simulator::set_command(self, command)
    }

    fn step(&mut self) -> Result<StepReport, StepError> {
        Simulator::step_traced(self, &mut Borrowed(None))
    }

    fn step_traced(&mut self, trace: &mut dyn Trace) -> Result<StepReport, StepError> {
        Simulator::step_traced(self, &mut Borrowed(Some(trace)))
    }

    fn pose(&self, unit: usize) -> Option<Isometry3<f32>> {
        Simulator::pose(self, unit)
    }

    fn previous_pose(&self, unit: usize) -> Option<Isometry3<f32>> {
        Simulator::previous_pose(self, unit)
    }

    fn internal_pose(&self, unit: usize) -> Option<Pose> {
        Simulator::internal_pose(self, unit)
    }

    fn first_points(&self, unit: usize, out: &mut [Point3<f32>]) -> usize {
        let pairs = out.iter_mut().zip(self.points(unit));
        pairs.map(|(out, point)| *out = point).count()
    }

    fn units(&self) -> usize {
        self.len()
    }

    fn copies(&self) -> usize {
        Simulator::copies(self)
    }

    fn replicate(&mut self, copies: usize) -> usize {
        Simulator::replicate(self, copies)
    }

    fn retain_copies(&mut self, keep: &mut dyn FnMut(usize) -> bool) {
        Simulator::retain_copies(self, keep);
    }

    fn set_copy_command(&mut self, copy: usize, command: &[f32]) -> Result<bool, CommandError> {
        Simulator::set_copy_command(self, copy, command)
    }

    fn set_poses(
        &mut self,
        copy: usize,
        unit: usize,
        previous: &Isometry3<f32>,
        current: &Isometry3<f32>,
    ) -> Result<bool, ObserveError> {
        Simulator::set_poses(self, copy, unit, previous, current)
    }

    fn set_physics(
        &mut self,
        copy: usize,
        unit: usize,
        physics: Physics,
    ) -> Result<bool, ObserveError> {
        Simulator::set_physics(self, copy, unit, physics)
    }

    fn step_copies(
        &mut self,
        report: &mut dyn FnMut(usize, Result<StepReport, StepError>),
    ) -> Result<(), StepError> {
        Simulator::step_copies(self, &mut Borrowed(None), report)
    }
}
