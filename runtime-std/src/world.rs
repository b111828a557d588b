//! A simulator that owns its model, its memory and its scene.

use std::sync::Arc;

use elsa::sync::FrozenVec;
use nalgebra::{Isometry3, Point3, Vector3};
use rigidformer_core::kernels::in_own_environment;
use rigidformer_core::{
    ContactLaw, EditError, Layer, Limits, Plane, Schedule, Simulator, SlabSizes, Slabs,
    SnapshotError, Stage, StepError, StepReport, Trace, Unit, UnitId, UnitSlot, Velocity,
    WorkspaceError,
};
use self_cell::{MutBorrow, self_cell};

use crate::engine::Engine;
use crate::kernels::{HostKernels, KernelError, Run};
use crate::models::LoadedModel;
use crate::terrain::HeightFieldBuf;
use crate::threads::{Threaded, Threads};

/// A simulator that owns its model and memory, so that a struct can hold it and a thread can take it.
///
/// Its bits do not depend on the rounding, the flush of subnormal numbers or the traps that the caller's thread has set: each call
/// computes to nearest ([`in_own_environment`]) and restores them.
///
/// ```
/// use nalgebra::{Isometry3, Point3};
/// use rigidformer_runtime::core::{Limits, Physics, Role, Unit};
/// use rigidformer_runtime::models::LoadedModel;
/// use rigidformer_runtime::world::World;
///
/// let model = LoadedModel::embedded("edge", rigidformer_weights::EDGE)?;
/// let mut world = World::new(&model, Limits { units: 8, points: 512 })?;
/// world.set_dt(1.0 / 24.0)?;
/// let corner = |i: usize, bit| if i & bit == 0 { -0.2 } else { 0.2 };
/// let corners: Vec<_> = (0..8).map(|i| Point3::new(corner(i, 1), corner(i, 2), corner(i, 4))).collect();
/// let rubber = Physics { mass_kg: 1.0, friction: 0.5, restitution: 0.5 };
/// let cube = world.add(&Unit::new(&corners, rubber), &Isometry3::translation(0.0, 0.0, 1.0))?; // at rest
/// let hand = world.add(&Unit::new(&corners, rubber).role(Role::Driven), &Isometry3::translation(0.0, 1.5, 1.0))?;
/// for step in 1..=6 {
///     world.drive(hand, &Isometry3::translation(0.0, 1.5 - 0.1 * step as f32, 1.0))?;
///     world.step()?;
/// }
/// assert_eq!(world.pose(hand).map(|pose| (pose.translation.y * 10.0).round()), Some(9.0));
/// assert!(world.pose(cube).is_some_and(|pose| pose.translation.z < 0.95)); // it falls
/// let other = std::thread::spawn(move || world.step().map(|_| world)).join();
/// assert!(other.is_ok());
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
pub struct World {
    engine: Engine,
    /// Of a scene, that there is room for.
    copies: usize,
    cell: Cell,
    /// Of the height field that was set last.
    heights: Option<Arc<[f32]>>,
    /// Of the last step.
    stepped: Vec<Stepped>,
}

/// What a step did to a unit.
#[derive(Clone, Copy)]
struct Stepped {
    id: UnitId,
    before: Isometry3<f32>,
    after: Isometry3<f32>,
    velocity: Velocity,
}

/// The whole state of a world at some time ([`World::snapshot`]): bytes that may be kept in a file, and taken from one, since
/// [`World::restore`] checks them. They are the same on all machines.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Snapshot {
    bytes: Vec<u8>,
}

impl Snapshot {
    /// The bytes.
    pub fn as_bytes(&self) -> &[u8] {
        &self.bytes
    }

    /// From [`as_bytes`](Self::as_bytes). Whether they are a snapshot, restoring says.
    pub fn from_bytes(bytes: Vec<u8>) -> Self {
        Snapshot { bytes }
    }
}

/// What a world goes back to where a step with others fails.
#[derive(Default)]
pub(crate) struct Undo {
    bytes: Vec<u8>,
    stepped: Vec<Stepped>,
}

/// What the simulator borrows.
struct Storage {
    model: LoadedModel,
    memory: MutBorrow<Memory>,
    /// Of all height fields that there were.
    heights: FrozenVec<Arc<[f32]>>,
}

struct Memory {
    f32: Vec<f32>,
    i8: Vec<i8>,
    points: Vec<Point3<f32>>,
    units: Vec<UnitSlot>,
}

type BorrowingSimulator<'a> = Simulator<'a, 'a>;

self_cell!(
    struct Cell {
        owner: Storage,
        #[covariant]
        dependent: BorrowingSimulator,
    }
);

/// Why a world cannot be made.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum WorldError {
    /// The kernels cannot be used.
    #[error(transparent)]
    Kernel(#[from] KernelError),
    /// There is no memory for the limits.
    #[error("no memory for {bytes} bytes: lower the limits of units, points or copies")]
    Memory {
        /// Of one of the buffers.
        bytes: usize,
    },
    /// The limits cannot be met.
    #[error(transparent)]
    Workspace(#[from] WorkspaceError),
    /// A copy does not take the state of the world that it is of.
    #[error(transparent)]
    Snapshot(#[from] SnapshotError),
}

impl World {
    /// An empty world within these limits, over the model's ground plane, on the fastest kernels and all threads.
    ///
    /// # Errors
    /// [`WorldError`] where the processor lacks the kernels that the environment asks for, or there is no memory.
    pub fn new(model: &LoadedModel, limits: Limits) -> Result<Self, WorldError> {
        World::on(Engine::new()?, model, limits, 1)
    }

    /// As [`new`](Self::new) on an engine of the caller's choice, with room for so many
    /// [copies](Simulator::replicate) of a scene within `limits`.
    ///
    /// # Errors
    /// As [`new`](Self::new).
    pub fn on(
        engine: Engine,
        model: &LoadedModel,
        limits: Limits,
        copies: usize,
    ) -> Result<Self, WorldError> {
        // The buffers depend on the tiles of the kernels that will step.
        let layout = layout_of(engine)?;
        let sizes = SlabSizes::of(model.model().config(), limits, copies, layout);
        let memory = Memory {
            // Room to begin at a cache line: a load that crosses two costs as much as two loads, 5 to 15 % of a step.
            f32: filled(0.0, sizes.f32.saturating_add(CACHE_LINE))?,
            i8: filled(0, sizes.i8)?,
            points: filled(Point3::origin(), sizes.points)?,
            units: filled(UnitSlot::EMPTY, sizes.units)?,
        };
        let storage = Storage {
            model: model.clone(),
            memory: MutBorrow::new(memory),
            heights: FrozenVec::new(),
        };
        let cell = in_own_environment(|| {
            Cell::try_new(storage, |storage| {
                let Memory { f32, i8, points, units } = storage.memory.borrow_mut();
                // `align_offset` may give no offset, and the slab then begins unaligned.
                let start = f32.as_ptr().align_offset(4 * CACHE_LINE).min(CACHE_LINE);
                let slabs = Slabs { f32: &mut f32[start..], i8, points, units };
                Simulator::with_layout(storage.model.model(), limits, copies, layout, slabs)
            })
        })?;
        Ok(World { engine, copies, cell, heights: None, stepped: Vec::new() })
    }

    /// Bytes that a world within these limits takes, beside the model.
    ///
    /// # Errors
    /// [`WorldError::Kernel`] where the processor lacks the engine's kernels.
    pub fn bytes(
        engine: Engine,
        model: &LoadedModel,
        limits: Limits,
        copies: usize,
    ) -> Result<usize, WorldError> {
        let layout = layout_of(engine)?;
        Ok(SlabSizes::of(model.model().config(), limits, copies, layout).bytes())
    }

    /// Another world in the same state, which goes on by itself: the same model, engine and limits, and memory of its own.
    ///
    /// # Errors
    /// As [`on`](Self::on).
    pub fn try_clone(&self) -> Result<Self, WorldError> {
        let mut other =
            World::on(self.engine, self.model(), self.simulator().limits(), self.copies)?;
        // The same model takes the same field.
        let _ = other.set_height_field(self.height_field().as_ref());
        other.restore(&self.snapshot())?;
        other.stepped.clone_from(&self.stepped);
        Ok(other)
    }

    /// The whole state of the scene and all its copies ([`Simulator::snapshot`]): going on from it gives the same bits.
    ///
    /// ```
    /// use nalgebra::{Isometry3, Point3};
    /// use rigidformer_runtime::core::{Limits, Physics, Unit};
    /// use rigidformer_runtime::models::LoadedModel;
    /// use rigidformer_runtime::world::World;
    ///
    /// # let model = LoadedModel::embedded("edge", rigidformer_weights::EDGE)?;
    /// let mut world = World::new(&model, Limits { units: 8, points: 512 })?;
    /// # world.set_dt(1.0 / 24.0)?;
    /// # let corner = |i: usize, bit| if i & bit == 0 { -0.2 } else { 0.2 };
    /// # let corners: Vec<_> = (0..8).map(|i| Point3::new(corner(i, 1), corner(i, 2), corner(i, 4))).collect();
    /// # let rubber = Physics { mass_kg: 1.0, friction: 0.5, restitution: 0.5 };
    /// let cube = world.add(&Unit::new(&corners, rubber), &Isometry3::translation(0.0, 0.0, 1.0))?;
    /// let snapshot = world.snapshot();
    /// let mut other = world.try_clone()?;
    /// for world in [&mut world, &mut other] {
    ///     (0..12).try_for_each(|_| world.step().map(drop))?;
    /// }
    /// assert_eq!(world.pose(cube), other.pose(cube));
    /// world.restore(&snapshot)?;
    /// assert_eq!(world.pose(cube), Some(Isometry3::translation(0.0, 0.0, 1.0)));
    /// # Ok::<(), Box<dyn std::error::Error>>(())
    /// ```
    pub fn snapshot(&self) -> Snapshot {
        let simulator = self.simulator();
        let mut bytes = vec![0; simulator.snapshot_bytes()];
        let written = simulator.snapshot(&mut bytes);
        debug_assert_eq!(written, Ok(bytes.len()), "there is room for all of it");
        Snapshot { bytes }
    }

    /// As [`snapshot`](Self::snapshot), of one copy alone ([`Simulator::snapshot_copy`]).
    ///
    /// # Errors
    /// [`SnapshotError::NoSuchCopy`].
    pub fn snapshot_copy(&self, copy: usize) -> Result<Snapshot, SnapshotError> {
        let simulator = self.simulator();
        let mut bytes = vec![0; simulator.copy_snapshot_bytes()];
        simulator.snapshot_copy(copy, &mut bytes)?;
        Ok(Snapshot { bytes })
    }

    /// Goes on from a snapshot of a world of the same model ([`Simulator::restore`]).
    ///
    /// # Errors
    /// [`SnapshotError`]; the scene is what it was.
    pub fn restore(&mut self, snapshot: &Snapshot) -> Result<(), SnapshotError> {
        self.edit(|simulator| simulator.restore(&snapshot.bytes))
    }

    /// Goes on with one copy from a snapshot of one copy of the same scene ([`Simulator::restore_copy`]).
    ///
    /// # Errors
    /// [`SnapshotError`]; the copy is what it was.
    pub fn restore_copy(&mut self, copy: usize, snapshot: &Snapshot) -> Result<(), SnapshotError> {
        self.edit(|simulator| simulator.restore_copy(copy, &snapshot.bytes))
    }

    /// Copies of a scene that there is room for.
    pub fn copies(&self) -> usize {
        self.copies
    }

    /// The simulator, read only.
    pub fn simulator(&self) -> &Simulator<'_, '_> {
        self.cell.borrow_dependent()
    }

    /// Calls `change` with the simulator, to observe a scene or to change it. To step, call [`step`](Self::step), which has the engine's
    /// kernels: the simulator's own step refuses this layout.
    pub fn edit<R>(&mut self, change: impl FnOnce(&mut Simulator<'_, '_>) -> R) -> R {
        self.cell.with_dependent_mut(|_, simulator| in_own_environment(|| change(simulator)))
    }

    /// Lets the network correct motion, as it does at first, or leaves it out ([`Simulator::set_network`]).
    ///
    /// ```
    /// use rigidformer_runtime::core::Limits;
    /// use rigidformer_runtime::{models::LoadedModel, world::World};
    ///
    /// # fn main() -> Result<(), Box<dyn std::error::Error>> {
    /// # let path = concat!(env!("CARGO_MANIFEST_DIR"), "/../weights/models/nano.rfm");
    /// let model = LoadedModel::open(path.as_ref())?;
    /// let mut world = World::new(&model, Limits { units: 4, points: 256 })?;
    /// world.set_network(false);
    /// assert!(!world.simulator().has_network());
    /// # Ok(())
    /// # }
    /// ```
    pub fn set_network(&mut self, corrects: bool) {
        self.edit(|simulator| simulator.set_network(corrects));
    }

    /// The model.
    pub fn model(&self) -> &LoadedModel {
        &self.cell.borrow_owner().model
    }

    /// Kernels and threads.
    pub fn engine(&self) -> Engine {
        self.engine
    }

    /// Advances the scene by one step.
    ///
    /// # Errors
    /// [`StepError`]; the scene is what it was.
    pub fn step(&mut self) -> Result<StepReport, StepError> {
        self.run(None)
    }

    /// As [`step`](Self::step), and records every layer in `trace`.
    ///
    /// # Errors
    /// [`StepError`]; the scene is what it was.
    pub fn step_traced(&mut self, trace: &mut (dyn Trace + Send)) -> Result<StepReport, StepError> {
        self.run(Some(trace))
    }

    /// As [`step`](Self::step), on no more than so many of its threads.
    pub(crate) fn step_within(&mut self, threads: Threads) -> Result<StepReport, StepError> {
        let own = self.engine;
        self.engine.threads = own.threads.at_most(threads);
        let report = self.step();
        self.engine = own;
        report
    }

    /// Keeps what [`undo`](Self::undo) needs, in the memory of the time before.
    pub(crate) fn remember(&self, undo: &mut Undo) {
        let simulator = self.simulator();
        undo.bytes.resize(simulator.snapshot_bytes(), 0);
        let written = simulator.snapshot(&mut undo.bytes);
        debug_assert_eq!(written, Ok(undo.bytes.len()), "there is room for all of it");
        undo.stepped.clone_from(&self.stepped);
    }

    /// Goes back to what it was when that was remembered, to the bit.
    pub(crate) fn undo(&mut self, undo: &Undo) {
        let restored = self.edit(|simulator| simulator.restore(&undo.bytes));
        debug_assert_eq!(restored, Ok(()), "it held that state before");
        self.stepped.clone_from(&undo.stepped);
    }

    fn run(&mut self, trace: Option<&mut (dyn Trace + Send)>) -> Result<StepReport, StepError> {
        let engine = self.engine;
        let before: Vec<_> = self.states().map(|(id, pose, _)| (id, pose)).collect();
        let step = Step { world: self, trace };
        let report = engine.enter(|| engine.kernel.run(step)).unwrap_or(Err(StepError::Layout))?;
        let mut stepped = core::mem::take(&mut self.stepped);
        stepped.clear();
        let after = before.into_iter().zip(self.states());
        stepped.extend(after.map(|((id, before), (_, after, velocity))| Stepped {
            id,
            before,
            after,
            velocity,
        }));
        self.stepped = stepped;
        Ok(report)
    }

    /// Where the units of the first copy are and how they move.
    fn states(&self) -> impl Iterator<Item = (UnitId, Isometry3<f32>, Velocity)> {
        let simulator = self.simulator();
        let units = simulator.units().zip(simulator.velocities());
        units.map(|(unit, velocity)| (unit.id(), unit.pose(), velocity))
    }

    /// Advances every copy by one step and calls `report` for each, in order ([`Simulator::step_copies`]).
    ///
    /// # Errors
    /// [`StepError`]: nothing was advanced.
    pub fn step_copies(
        &mut self,
        report: &mut (dyn FnMut(usize, Result<StepReport, StepError>) + Send),
    ) -> Result<(), StepError> {
        let engine = self.engine;
        self.stepped.clear();
        let step = StepCopies { world: self, report };
        engine.enter(|| engine.kernel.run(step)).unwrap_or(Err(StepError::Layout))
    }

    /// Sets the duration of a step, seconds ([`Simulator::set_dt`]): an empty world needs it before units are added.
    ///
    /// # Errors
    /// [`EditError`]; the scene is what it was.
    pub fn set_dt(&mut self, dt_s: f32) -> Result<(), EditError> {
        self.edit(|simulator| simulator.set_dt(dt_s))
    }

    /// Says how contacts that bounce differ from rigid ones ([`Simulator::set_contact_law`]).
    ///
    /// ```
    /// use rigidformer_core::Limits;
    /// use rigidformer_runtime::{models::LoadedModel, world::World};
    /// let model = LoadedModel::embedded("edge", rigidformer_weights::EDGE)?;
    /// let mut world = World::new(&model, Limits { units: 1, points: 8 })?;
    /// world.set_contact_law("0.03,pyramid".parse()?)?;
    /// assert_eq!(world.simulator().contact_law().to_string(), "0.03,pyramid");
    /// # Ok::<(), Box<dyn std::error::Error>>(())
    /// ```
    ///
    /// # Errors
    /// [`EditError`]; the law is what it was.
    pub fn set_contact_law(&mut self, law: ContactLaw) -> Result<(), EditError> {
        self.edit(|simulator| simulator.set_contact_law(law))
    }

    /// Puts the scene on ground of varying height, besides its planes; `None` takes it away ([`Simulator::set_height_field`]).
    ///
    /// The heights are shared, not copied, and stay in memory as long as the world: one that changes its ground often keeps all of them.
    ///
    /// ```
    /// use nalgebra::{Isometry3, Point3, Vector3};
    /// use rigidformer_core::{Limits, Physics, Unit};
    /// use rigidformer_runtime::{models::LoadedModel, terrain::HeightFieldBuf, world::World};
    ///
    /// let slope = HeightFieldBuf {
    ///     heights_m: [0.0, 2.0, 0.0, 2.0].into(),
    ///     columns: 2,
    ///     spacing_m: [4.0, 4.0],
    ///     corner_m: Vector3::new(-2.0, -2.0, -1.0),
    ///     friction: 0.1,
    ///     restitution: 0.0,
    /// };
    /// let model = LoadedModel::embedded("edge", rigidformer_weights::EDGE)?;
    /// let mut world = World::new(&model, Limits { units: 1, points: 8 })?;
    /// world.set_dt(1.0 / 30.0)?;
    /// world.set_height_field(Some(&slope))?;
    /// # let corner = |i: usize, bit| if i & bit == 0 { -0.1 } else { 0.1 };
    /// # let corners: Vec<_> = (0..8).map(|i| Point3::new(corner(i, 1), corner(i, 2), corner(i, 4))).collect();
    /// # let ice = Physics { mass_kg: 1.0, friction: 0.1, restitution: 0.0 };
    /// let cube = world.add(&Unit::new(&corners, ice), &Isometry3::translation(0.0, 0.0, 0.2))?;
    /// (0..15).try_for_each(|_| world.step().map(drop))?;
    /// assert!(world.pose(cube).is_some_and(|pose| pose.translation.x < -0.2), "it slides down");
    /// # Ok::<(), Box<dyn std::error::Error>>(())
    /// ```
    ///
    /// # Errors
    /// [`EditError`]; the ground is what it was.
    pub fn set_height_field(&mut self, field: Option<&HeightFieldBuf>) -> Result<(), EditError> {
        self.cell.with_dependent_mut(|storage, simulator| {
            let Some(field) = field else { return simulator.set_height_field(None) };
            field.view().check()?;
            // What the model refuses is not kept.
            if !simulator.model().config().motion.has_impulses() {
                return simulator.set_height_field(Some(field.over(&[])));
            }
            let heights = &storage.heights;
            let is_same = |kept: &&[f32]| std::ptr::eq::<[f32]>(*kept, &*field.heights_m);
            let kept = heights.iter().find(is_same);
            let kept = kept.unwrap_or_else(|| heights.push_get(field.heights_m.clone()));
            simulator.set_height_field(Some(field.over(kept)))
        })?;
        self.heights = field.map(|field| field.heights_m.clone());
        Ok(())
    }

    /// The ground of varying height: see [`set_height_field`](Self::set_height_field).
    pub fn height_field(&self) -> Option<HeightFieldBuf> {
        let field = self.simulator().height_field()?;
        let is_it = |heights: &&Arc<[f32]>| std::ptr::eq::<[f32]>(&***heights, field.heights_m);
        // What was set through `edit` is not shared yet.
        let heights = self.heights.as_ref().filter(is_it).cloned();
        Some(HeightFieldBuf::shared(&field, heights.unwrap_or_else(|| field.heights_m.into())))
    }

    /// Replaces the planes of the scene; none is a scene without ground ([`Simulator::set_planes`]).
    ///
    /// # Errors
    /// [`EditError`]; the scene is what it was.
    pub fn set_planes(&mut self, planes: &[Plane]) -> Result<(), EditError> {
        self.edit(|simulator| simulator.set_planes(planes))
    }

    /// Sets the acceleration of free fall, m/s^2 ([`Simulator::set_gravity`]).
    ///
    /// # Errors
    /// [`EditError`]; the scene is what it was.
    pub fn set_gravity(&mut self, gravity_m_s2: Vector3<f32>) -> Result<(), EditError> {
        self.edit(|simulator| simulator.set_gravity(gravity_m_s2))
    }

    /// Adds a unit at rest: its velocity is 0. [`Simulator::add`] adds one that moves.
    ///
    /// # Errors
    /// [`EditError`]; the scene is what it was.
    pub fn add(&mut self, unit: &Unit<'_>, pose: &Isometry3<f32>) -> Result<UnitId, EditError> {
        self.edit(|simulator| simulator.add(unit, pose, pose))
    }

    /// Removes a unit ([`Simulator::remove`]).
    ///
    /// # Errors
    /// [`EditError`]; the scene is what it was.
    pub fn remove(&mut self, id: UnitId) -> Result<(), EditError> {
        self.edit(|simulator| simulator.remove(id))
    }

    /// Sets the pose of a driven unit after the next step ([`Simulator::drive`]).
    ///
    /// # Errors
    /// [`EditError`]; the unit is what it was.
    pub fn drive(&mut self, id: UnitId, pose: &Isometry3<f32>) -> Result<(), EditError> {
        self.edit(|simulator| simulator.drive(id, pose))
    }

    /// How a unit moves now ([`Simulator::velocity`]).
    pub fn velocity(&self, id: UnitId) -> Option<Velocity> {
        self.simulator().velocity(id)
    }

    /// How all units move now, in their order ([`Simulator::velocities`]).
    pub fn velocities(&self) -> Vec<Velocity> {
        self.simulator().velocities().collect()
    }

    /// Gives a unit velocities: linear in m/s of its frame's origin, angular in rad/s in the world frame
    /// ([`Simulator::set_velocity`]). A driven unit forgets its target.
    ///
    /// # Errors
    /// [`EditError`]; the unit is what it was.
    pub fn set_velocity(
        &mut self,
        id: UnitId,
        linear_m_s: &Vector3<f32>,
        angular_rad_s: &Vector3<f32>,
    ) -> Result<(), EditError> {
        let velocity = Velocity { linear_m_s: *linear_m_s, angular_rad_s: *angular_rad_s };
        self.edit(|simulator| simulator.set_velocity(id, &velocity))
    }

    /// Gives all units velocities, in their order ([`Simulator::set_velocities`]).
    ///
    /// # Errors
    /// [`EditError`]; all units are what they were.
    pub fn set_velocities(&mut self, velocities: &[Velocity]) -> Result<(), EditError> {
        self.edit(|simulator| simulator.set_velocities(velocities))
    }

    /// Pose of a unit: carries its reference points to the world.
    pub fn pose(&self, id: UnitId) -> Option<Isometry3<f32>> {
        in_own_environment(|| self.simulator().pose(id))
    }

    /// Where a unit was before the last [`step`](Self::step). Of one whose pose or velocity is another since, and after
    /// [`step_copies`](Self::step_copies), where its motion says that it was, as if it had flown ([`UnitView::previous_pose`](rigidformer_core::UnitView::previous_pose)).
    ///
    /// ```
    /// # use nalgebra::{Isometry3, Point3};
    /// # use rigidformer_runtime::core::{Limits, Physics, Unit};
    /// # use rigidformer_runtime::models::LoadedModel;
    /// # use rigidformer_runtime::world::World;
    /// # let model = LoadedModel::embedded("edge", rigidformer_weights::EDGE)?;
    /// # let mut world = World::new(&model, Limits { units: 8, points: 512 })?;
    /// # world.set_dt(1.0 / 24.0)?;
    /// # let corner = |i: usize, bit| if i & bit == 0 { -0.2 } else { 0.2 };
    /// # let corners: Vec<_> = (0..8).map(|i| Point3::new(corner(i, 1), corner(i, 2), corner(i, 4))).collect();
    /// # let rubber = Physics { mass_kg: 1.0, friction: 0.5, restitution: 0.5 };
    /// let cube = world.add(&Unit::new(&corners, rubber), &Isometry3::translation(0.0, 0.0, 1.0))?;
    /// world.step()?;
    /// assert_eq!(world.previous_pose(cube), Some(Isometry3::translation(0.0, 0.0, 1.0)));
    /// # Ok::<(), Box<dyn std::error::Error>>(())
    /// ```
    pub fn previous_pose(&self, id: UnitId) -> Option<Isometry3<f32>> {
        let unit = self.simulator().get(id)?;
        let is_it = |stepped: &&Stepped| {
            // Also where it was put back by the bits.
            in_own_environment(|| {
                stepped.id == id
                    && Some(stepped.after) == self.pose(id)
                    && Some(stepped.velocity) == self.velocity(id)
            })
        };
        if let Some(stepped) = self.stepped.iter().find(is_it) {
            return Some(stepped.before);
        }
        let Velocity { linear_m_s, angular_rad_s } = self.velocity(id)?;
        let rests = in_own_environment(|| linear_m_s.amax().max(angular_rad_s.amax()) < STILL);
        Some(if rests { unit.pose() } else { unit.previous_pose() })
    }
}

/// A vector of `count` clones of a value; an error where memory is short.
fn filled<T: Clone>(value: T, count: usize) -> Result<Vec<T>, WorldError> {
    // `vec!` aborts the process where memory is short; a world reports it.
    let mut all = Vec::new();
    let bytes = count.saturating_mul(size_of::<T>());
    all.try_reserve_exact(count).map_err(|_| WorldError::Memory { bytes })?;
    all.resize(count, value);
    Ok(all)
}

/// Slower units are where they were: what velocities round to, in m/s and rad/s.
const STILL: f32 = 1e-6;
/// f32 numbers of a cache line of 64 bytes.
const CACHE_LINE: usize = 16;

fn layout_of(engine: Engine) -> Result<rigidformer_core::Layout, KernelError> {
    engine.kernel.run(LayoutOf).ok_or(KernelError::Lacking { kernel: engine.kernel })
}

/// The layout that kernels on threads need.
struct LayoutOf;

impl Run for LayoutOf {
    type Output = rigidformer_core::Layout;

    fn run<K: HostKernels>(self, _: K) -> Self::Output {
        Threaded::<K>::LAYOUT
    }
}

struct Step<'w, 't> {
    world: &'w mut World,
    trace: Option<&'t mut (dyn Trace + Send)>,
}

impl Run for Step<'_, '_> {
    type Output = Result<StepReport, StepError>;

    fn run<K: HostKernels>(self, kernels: K) -> Self::Output {
        let Step { world, trace } = self;
        let schedule = Threaded::new(kernels, world.engine.threads);
        world.edit(|simulator| simulator.step_on(schedule, &mut AnyTrace(trace)))
    }
}

struct StepCopies<'w, 'r> {
    world: &'w mut World,
    report: &'r mut (dyn FnMut(usize, Result<StepReport, StepError>) + Send),
}

impl Run for StepCopies<'_, '_> {
    type Output = Result<(), StepError>;

    fn run<K: HostKernels>(self, kernels: K) -> Self::Output {
        let StepCopies { world, report } = self;
        let schedule = Threaded::new(kernels, world.engine.threads);
        world.edit(|simulator| simulator.step_copies(schedule, &mut AnyTrace(None), report))
    }
}

/// One type for every trace, so that the forward pass is compiled once per kernel.
struct AnyTrace<'t>(Option<&'t mut (dyn Trace + Send)>);

impl Trace for AnyTrace<'_> {
    fn record(&mut self, layer: Layer, index: usize, values: &[f32]) {
        if let Some(trace) = &mut self.0 {
            trace.record(layer, index, values);
        }
    }

    fn records(&self) -> bool {
        self.0.as_ref().is_some_and(|trace| trace.records())
    }

    fn enter(&mut self, stage: Stage) {
        if let Some(trace) = &mut self.0 {
            trace.enter(stage);
        }
    }

    fn begin_again(&mut self) {
        if let Some(trace) = &mut self.0 {
            trace.begin_again();
        }
    }
}
