//! Copies of a scene that go on from step to step, and begin anew one by one: environments of reinforcement learning.

use nalgebra::Isometry3;
use rayon::prelude::*;
use rigidformer_core::kernels::in_own_environment;
use rigidformer_core::{SnapshotError, StepError, StepReport, UnitView, Velocity};

use super::{BatchError, BatchSimulator, ChangeError, Division, End, FutureScene, Start, is_out};
use crate::engine::Engine;
use crate::pool;
use crate::threads::Threads;
use crate::world::{Snapshot, World};

/// Copies of one scene, each with a state of its own, that a [`BatchSimulator`] steps together.
///
/// ```
/// use nalgebra::{Isometry3, Point3};
/// use rigidformer_runtime::core::{Physics, Posed, Role, Unit};
/// use rigidformer_runtime::engine::Engine;
/// use rigidformer_runtime::futures::{BatchSimulator, Start};
/// use rigidformer_runtime::models::LoadedModel;
///
/// let loaded = LoadedModel::embedded("nano", rigidformer_weights::NANO)?;
/// let corner = |i: usize, bit| if i & bit == 0 { -0.1 } else { 0.1 };
/// let points: Vec<_> = (0..8).map(|i| Point3::new(corner(i, 1), corner(i, 2), corner(i, 4))).collect();
/// let cube = Unit::new(&points, Physics { mass_kg: 1.0, friction: 0.4, restitution: 0.3 });
/// let above = Isometry3::translation(0.0, 0.0, 0.5);
/// let units = [Posed { unit: cube, previous: above, current: above }];
/// let start = Start { dt_s: 1.0 / 24.0, units: &units, ..Start::default() };
///
/// let mut copies = BatchSimulator::new(Engine::new()?, &loaded).copies(&start, 100)?;
/// for _ in 0..5 {
///     let ends = copies.step(&|_, _| Ok(()))?;
///     assert!(ends.iter().all(Option::is_none));
/// }
/// copies.reset(7)?;
/// let height = |copy| copies.pose(copy, 0).map(|pose: Isometry3<f32>| pose.translation.z);
/// assert_eq!(height(7), Some(0.5));
/// assert!(height(8) < Some(0.4));
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
pub struct Copies {
    /// As many copies as each holds, but for the last.
    chunks: Vec<World>,
    per_chunk: usize,
    /// Chunks that one thread takes.
    share: usize,
    count: usize,
    units: usize,
    /// Of one copy.
    start: Snapshot,
}

/// Why a copy does not begin anew.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum CopyError {
    /// There is no such copy.
    #[error("copy {copy} of {copies}; they are counted from 0")]
    NoSuchCopy {
        /// Asked for.
        copy: usize,
        /// That there are.
        copies: usize,
    },
    /// The bytes are no state of a copy of this scene.
    #[error(transparent)]
    Snapshot(#[from] SnapshotError),
    /// A change is refused.
    #[error(transparent)]
    Change(#[from] ChangeError),
}

impl BatchSimulator {
    /// So many copies of the start, at least 1, that go on from step to step. They take about 2 MiB for each 64 units, which is
    /// counted before anything is made.
    ///
    /// # Errors
    /// [`BatchError`].
    pub fn copies(&self, start: &Start<'_>, count: usize) -> Result<Copies, BatchError> {
        self.copies_until(start, count, &|| false)
    }

    /// As [`copies`](Self::copies), unless `is_cut`, asked before each lockstep, ends it.
    ///
    /// # Errors
    /// [`BatchError`].
    pub fn copies_until(
        &self,
        start: &Start<'_>,
        count: usize,
        is_cut: &(dyn Fn() -> bool + Sync),
    ) -> Result<Copies, BatchError> {
        in_own_environment(|| {
            let units = start.count();
            let count = count.max(1);
            let room = (self.units_a_chunk / units.max(1)).max(1);
            let Division { chunk: per_chunk, share, threads } =
                Division::of(count, room, self.engine.threads, Threads::all());
            let engine = Engine { threads, ..self.engine };
            let limits = Self::limits(start);
            let bytes = World::bytes(engine, &self.model, limits, per_chunk)?;
            let all = (bytes as u64).saturating_mul(count.div_ceil(per_chunk) as u64);
            self.room_for(count, all)?;
            let mut chunks = Vec::new();
            let mut left = count;
            while left > 0 {
                if is_cut() {
                    return Err(BatchError::Cancelled);
                }
                let copies = left.min(per_chunk);
                chunks.push(self.begin(engine, start, copies)?);
                left -= copies;
            }
            let of_first = chunks.first().and_then(|world| world.snapshot_copy(0).ok());
            // A scene without units is refused above, so there is a first copy.
            let start = of_first.ok_or(StepError::NoUnits)?;
            Ok(Copies { chunks, per_chunk, share: share / per_chunk, count, units, start })
        })
    }
}

impl Copies {
    /// How many there are.
    #[expect(clippy::len_without_is_empty, reason = "there is one at least")]
    pub fn len(&self) -> usize {
        self.count
    }

    /// Units of each.
    pub fn units(&self) -> usize {
        self.units
    }

    /// Advances each copy by a step, after `steer` has changed it: given commands, or targets. Why each did not go on, if it did
    /// not: one whose change is refused or whose step fails is where it was, with what `steer` had changed until then. `steer` is
    /// called from any thread.
    ///
    /// # Errors
    /// [`BatchError::Step`]: nothing was advanced.
    pub fn step(
        &mut self,
        steer: &(impl Fn(usize, &mut FutureScene<'_>) -> Result<(), ChangeError> + Sync),
    ) -> Result<Vec<Option<End>>, BatchError> {
        self.step_until(steer, &|| false)
    }

    /// As [`step`](Self::step). Once `is_cut`, asked before each lockstep, says so, the copies of the others stay where they are, and
    /// end with [`End::Cut`].
    ///
    /// # Errors
    /// As [`step`](Self::step).
    pub fn step_until(
        &mut self,
        steer: &(impl Fn(usize, &mut FutureScene<'_>) -> Result<(), ChangeError> + Sync),
        is_cut: &(dyn Fn() -> bool + Sync),
    ) -> Result<Vec<Option<End>>, BatchError> {
        let (per_chunk, share) = (self.per_chunk, self.share.max(1));
        let mut ends = vec![None; self.count];
        let advance = |index: usize, worlds: &mut [World], ends: &mut [Option<End>]| {
            let chunks = worlds.iter_mut().zip(ends.chunks_mut(per_chunk)).enumerate();
            // A thread of the pool has what its creator had set.
            in_own_environment(|| {
                chunks.into_iter().try_for_each(|(within, (world, ends))| {
                    if is_cut() {
                        ends.fill(Some(End::Cut));
                        return Ok(());
                    }
                    advance(world, (index * share + within) * per_chunk, ends, steer)
                })
            })
        };
        // Without threads rayon cannot be asked.
        if pool::is_there() && self.chunks.len() > share {
            pool::enter(|| {
                let shares = self.chunks.par_chunks_mut(share);
                let shares = shares.zip(ends.par_chunks_mut(share * per_chunk)).enumerate();
                shares.try_for_each(|(index, (worlds, ends))| advance(index, worlds, ends))
            })?;
        } else {
            let shares = self.chunks.chunks_mut(share);
            let mut shares = shares.zip(ends.chunks_mut(share * per_chunk)).enumerate();
            shares.try_for_each(|(index, (worlds, ends))| advance(index, worlds, ends))?;
        }
        Ok(ends)
    }

    /// Puts a copy where all began, with the start's physics and command.
    ///
    /// # Errors
    /// [`CopyError::NoSuchCopy`].
    pub fn reset(&mut self, copy: usize) -> Result<(), CopyError> {
        let start = self.start.clone();
        self.restore(copy, &start)
    }

    /// Changes a copy, such as where its units are.
    ///
    /// # Errors
    /// [`CopyError`]; what `change` changed before its error stays so.
    pub fn edit<R>(
        &mut self,
        copy: usize,
        change: impl FnOnce(&mut FutureScene<'_>) -> Result<R, ChangeError>,
    ) -> Result<R, CopyError> {
        let (world, copy) = self.world_mut(copy)?;
        Ok(in_own_environment(|| change(&mut FutureScene { world, copy }))?)
    }

    /// The whole state of a copy, to go on from with the same bits.
    ///
    /// # Errors
    /// [`CopyError::NoSuchCopy`].
    pub fn snapshot(&self, copy: usize) -> Result<Snapshot, CopyError> {
        let (world, copy) = self.world(copy)?;
        Ok(world.snapshot_copy(copy)?)
    }

    /// Goes on with a copy from a snapshot of any copy of this start.
    ///
    /// # Errors
    /// [`CopyError`]; the copy is what it was.
    pub fn restore(&mut self, copy: usize, snapshot: &Snapshot) -> Result<(), CopyError> {
        let (world, copy) = self.world_mut(copy)?;
        Ok(world.restore_copy(copy, snapshot)?)
    }

    /// Where a unit of a copy is; nowhere while it is out of play ([`FutureScene::take_out`]).
    pub fn pose(&self, copy: usize, unit: usize) -> Option<Isometry3<f32>> {
        Some(self.unit(copy, unit)?.pose()).filter(|pose| !is_out(pose))
    }

    /// A unit of a copy.
    pub fn unit(&self, copy: usize, unit: usize) -> Option<UnitView<'_>> {
        let (world, copy) = self.world(copy).ok()?;
        (unit < self.units).then(|| world.simulator().unit(copy * self.units + unit))?
    }

    /// How a unit of a copy moves now; none while it is out of play.
    pub fn velocity(&self, copy: usize, unit: usize) -> Option<Velocity> {
        self.pose(copy, unit)?;
        let id = self.unit(copy, unit)?.id();
        let (world, copy) = self.world(copy).ok()?;
        world.simulator().velocity_in(copy, id)
    }

    fn world(&self, copy: usize) -> Result<(&World, usize), CopyError> {
        let missing = CopyError::NoSuchCopy { copy, copies: self.count };
        let world = self.chunks.get(copy / self.per_chunk).filter(|_| copy < self.count);
        Ok((world.ok_or(missing)?, copy % self.per_chunk))
    }

    fn world_mut(&mut self, copy: usize) -> Result<(&mut World, usize), CopyError> {
        let missing = CopyError::NoSuchCopy { copy, copies: self.count };
        let world = self.chunks.get_mut(copy / self.per_chunk).filter(|_| copy < self.count);
        Ok((world.ok_or(missing)?, copy % self.per_chunk))
    }
}

/// Advances the copies of a chunk, the first of which is `first` among all.
fn advance(
    world: &mut World,
    first: usize,
    ends: &mut [Option<End>],
    steer: &(impl Fn(usize, &mut FutureScene<'_>) -> Result<(), ChangeError> + Sync),
) -> Result<(), BatchError> {
    let mut kept = Vec::new();
    for (copy, end) in ends.iter_mut().enumerate() {
        if let Err(error) = steer(first + copy, &mut FutureScene { world: &mut *world, copy }) {
            *end = Some(End::Refused(error));
            // All copies of a simulator step, and this one is put back.
            kept.extend(world.snapshot_copy(copy).ok().map(|now| (copy, now)));
        }
    }
    world.step_copies(&mut |copy: usize, outcome: Result<StepReport, StepError>| {
        if let (Some(end), Err(error)) = (ends.get_mut(copy), outcome) {
            end.get_or_insert(End::Failed(error));
        }
    })?;
    for (copy, now) in kept {
        let taken = world.restore_copy(copy, &now);
        debug_assert_eq!(taken, Ok(()), "a copy takes its own snapshot");
    }
    Ok(())
}
