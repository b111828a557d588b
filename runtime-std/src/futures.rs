//! Many futures of one scene: copies with commands, velocities or physics of their own that advance in lockstep, so
//! that each layer's weights are read once for all of them.

use std::ops::ControlFlow;

use nalgebra::{Isometry3, Vector3};
use rayon::prelude::*;
use rigidformer_core::kernels::in_own_environment;
use rigidformer_core::{
    CommandError, Compliance, ContactLaw, EditError, JoinError, Limits, ObserveError, Physics,
    Plane, Posed, Role, SnapshotError, StepError, StepReport, UnitId, Velocity,
};

use crate::engine::Engine;
use crate::memory::{Budget, TooLarge};
use crate::models::LoadedModel;
use crate::noise::Noise;
use crate::pivots::{self, Pivot};
use crate::pool;
use crate::terrain::HeightFieldBuf;
use crate::threads::Threads;
use crate::world::{World, WorldError};

mod copies;
mod state;

pub use copies::{Copies, CopyError};
pub use state::StartState;

/// Units of all copies in one simulator, about.
// More make no product faster (docs/PERFORMANCE.md), and the buffers of fewer stay in the cache.
const UNITS_PER_CHUNK: usize = 64;
/// Bytes that all copies of [`BatchSimulator::copies`] may take where nothing else is said: 4 GiB.
pub const USUAL_MEMORY: u64 = 4 << 30;

/// The scene that futures start from: units with their poses, or the state of a world ([`Start::of`]).
#[derive(Clone, Copy, Debug, Default)]
pub struct Start<'a> {
    /// The whole state of a world ([`World::start`]). `units` and `pivots` are then empty, and the others count where they differ.
    pub state: Option<&'a StartState>,
    /// Seconds between the two poses, and between predictions.
    pub dt_s: f32,
    /// (units) The units with their previous and current poses.
    pub units: &'a [Posed<'a>],
    /// For models that take one; empty for others.
    pub command: &'a [f32],
    /// Planes; the model's ground where there are none given.
    pub planes: Option<&'a [Plane]>,
    /// How contact with the first planes gives way; those behind are rigid, or as the state has them.
    pub plane_compliance: &'a [Compliance],
    /// How contacts that bounce differ from rigid ones; not at all where none is given, or as the state has it.
    pub contact_law: Option<ContactLaw>,
    /// Ground of varying height; none where none is given, or as the state has it.
    pub height_field: Option<&'a HeightFieldBuf>,
    /// Gravity, m/s²; the model's where there is none given.
    pub gravity_m_s2: Option<Vector3<f32>>,
    /// Pivots at which units are held together; [`pivots::find`] finds some.
    pub pivots: &'a [Pivot],
}

impl<'a> Start<'a> {
    /// A world as it is: its units with roles, velocities, joints and bonds, its planes, contact law, gravity and command. Futures go on from it
    /// with its bits.
    pub fn of(state: &'a StartState) -> Self {
        Start { state: Some(state), dt_s: state.dt_s(), ..Start::default() }
    }

    /// Units of the scene.
    pub fn count(&self) -> usize {
        self.state.map_or(self.units.len(), StartState::units)
    }
}

/// What makes futures differ, and when they end. Called from any thread. Its effect may depend on its arguments alone: then a future is the
/// same in every batch and on any number of threads.
pub trait Variation: Sync {
    /// Changes a future before its first step.
    ///
    /// # Errors
    /// [`ChangeError`] ends this future before it begins; the others go on.
    fn begin(&self, future: usize, scene: &mut FutureScene<'_>) -> Result<(), ChangeError> {
        let _ = (future, scene);
        Ok(())
    }

    /// Changes a future before its step `step`, from 0: a command, or a push.
    ///
    /// # Errors
    /// As [`begin`](Self::begin).
    fn steer(
        &self,
        future: usize,
        step: usize,
        scene: &mut FutureScene<'_>,
    ) -> Result<(), ChangeError> {
        let _ = (future, step, scene);
        Ok(())
    }

    /// Whether all futures are to end now, as at a deadline. Asked before each step of a lockstep, and before one begins.
    fn is_cut(&self) -> bool {
        false
    }

    /// Observes a future after its step `step`. [`ControlFlow::Break`] ends it there, and its share of the work goes to the others.
    fn watch(&self, future: usize, step: usize, poses: &[Isometry3<f32>]) -> ControlFlow<()> {
        let _ = (future, step, poses);
        ControlFlow::Continue(())
    }
}

/// Futures that do not differ.
impl Variation for () {}

/// Normal noise on the velocities of all units.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct VelocityNoise {
    /// Another seed, other futures.
    pub seed: u64,
    /// Deviation of each component, m/s.
    pub linear_m_s: f32,
    /// Deviation of each component, rad/s.
    pub angular_rad_s: f32,
}

impl Variation for VelocityNoise {
    fn begin(&self, future: usize, scene: &mut FutureScene<'_>) -> Result<(), ChangeError> {
        let mut noise = Noise::new(self.seed, future as u64);
        for unit in 0..scene.units() {
            let mut vector = |deviation| Vector3::from_fn(|_, _| deviation * noise.normal());
            let (linear, angular) = (vector(self.linear_m_s), vector(self.angular_rad_s));
            scene.push(unit, &linear, &angular)?;
        }
        Ok(())
    }
}

/// A future's scene, while it may be changed.
pub struct FutureScene<'s> {
    world: &'s mut World,
    copy: usize,
}

impl FutureScene<'_> {
    /// Units.
    pub fn units(&self) -> usize {
        self.world.simulator().len()
    }

    /// Where a unit is; nowhere while it is out of play.
    pub fn pose(&self, unit: usize) -> Option<Isometry3<f32>> {
        let pose = self.world.simulator().unit(self.index(unit)?)?.pose();
        Some(pose).filter(|pose| !is_out(pose))
    }

    /// The number of a unit among those of all copies.
    fn index(&self, unit: usize) -> Option<usize> {
        (unit < self.units()).then(|| self.copy * self.units() + unit)
    }

    fn id(&self, unit: usize) -> Result<UnitId, ChangeError> {
        let found = self.index(unit).and_then(|index| self.world.simulator().unit(index));
        let units = self.units();
        found.map(|unit| unit.id()).ok_or(ChangeError::NoSuchUnit { unit, units })
    }

    /// Sets the poses of a unit.
    ///
    /// # Errors
    /// [`ChangeError`]; the unit is what it was.
    pub fn set_poses(
        &mut self,
        unit: usize,
        previous: &Isometry3<f32>,
        current: &Isometry3<f32>,
    ) -> Result<(), ChangeError> {
        let (copy, id) = (self.copy, self.id(unit)?);
        Ok(self.world.edit(|simulator| simulator.set_poses_in(copy, id, previous, current))?)
    }

    /// Sets the pose of a driven unit after the next step.
    ///
    /// # Errors
    /// [`ChangeError`]; the unit is what it was.
    pub fn drive(&mut self, unit: usize, pose: &Isometry3<f32>) -> Result<(), ChangeError> {
        let (copy, id) = (self.copy, self.id(unit)?);
        Ok(self.world.edit(|simulator| simulator.drive_in(copy, id, pose))?)
    }

    /// How a unit moves now ([`Simulator::velocity`](rigidformer_core::Simulator::velocity)).
    pub fn velocity(&self, unit: usize) -> Option<Velocity> {
        self.world.simulator().velocity_in(self.copy, self.id(unit).ok()?)
    }

    /// Gives a unit velocities: linear in m/s of its frame's origin, angular in rad/s in the world frame
    /// ([`Simulator::set_velocity`](rigidformer_core::Simulator::set_velocity)).
    ///
    /// # Errors
    /// [`ChangeError`]; the unit is what it was.
    pub fn set_velocity(
        &mut self,
        unit: usize,
        linear: &Vector3<f32>,
        angular: &Vector3<f32>,
    ) -> Result<(), ChangeError> {
        let (copy, id) = (self.copy, self.id(unit)?);
        if self.is_out(unit) {
            let reason = format!("{id} is out of play; bring it back with set_poses first");
            return Err(ChangeError::Other(reason));
        }
        let velocity = Velocity { linear_m_s: *linear, angular_rad_s: *angular };
        Ok(self.world.edit(|simulator| simulator.set_velocity_in(copy, id, &velocity))?)
    }

    /// Adds to the velocities of a unit, as [`set_velocity`](Self::set_velocity) gives them.
    ///
    /// # Errors
    /// [`ChangeError`], as of a unit out of play, or that would turn by more than half a turn in a substep; the unit is what it was.
    pub fn push(
        &mut self,
        unit: usize,
        linear: &Vector3<f32>,
        angular: &Vector3<f32>,
    ) -> Result<(), ChangeError> {
        let units = self.units();
        let now = self.velocity(unit).ok_or(ChangeError::NoSuchUnit { unit, units })?;
        self.set_velocity(unit, &(now.linear_m_s + linear), &(now.angular_rad_s + angular))
    }

    /// Takes a unit out of play in this future alone: it is nowhere, touches nothing and is touched by nothing, until
    /// [`set_poses`](Self::set_poses) brings it back. [`Variation::watch`] and the output have it 1e5 m away along each axis. The
    /// others go on bit for bit as if it had never been there, where the model's scope is near (edge); a network that sees all units
    /// (nano) sees it as scenery there.
    ///
    /// # Errors
    /// [`ChangeError`] where it is soft, or a joint or a bond holds it to another unit.
    pub fn take_out(&mut self, unit: usize) -> Result<(), ChangeError> {
        let (copy, id) = (self.copy, self.id(unit)?);
        let simulator = self.world.simulator();
        if simulator.joints().any(|joint| joint.unit == id || joint.parent == id) {
            return Err(ChangeError::Other(format!(
                "{id} hangs together with another unit: end its joints in the start"
            )));
        }
        Ok(self.world.edit(|simulator| simulator.hold_in(copy, id, &nowhere(unit)))?)
    }

    /// Whether a unit is out of play.
    pub fn is_out(&self, unit: usize) -> bool {
        let found = self.index(unit).and_then(|index| self.world.simulator().unit(index));
        found.is_some_and(|unit| is_out(&unit.pose()))
    }

    /// Changes the physics of a unit.
    ///
    /// # Errors
    /// [`ChangeError`]; the unit is what it was.
    pub fn set_physics(&mut self, unit: usize, physics: Physics) -> Result<(), ChangeError> {
        let (copy, id) = (self.copy, self.id(unit)?);
        Ok(self.world.edit(|simulator| simulator.set_physics_in(copy, id, physics))?)
    }

    /// The command of this future's following steps.
    ///
    /// # Errors
    /// [`ChangeError`]; the command is what it was.
    pub fn set_command(&mut self, command: &[f32]) -> Result<(), ChangeError> {
        let copy = self.copy;
        self.world.edit(|simulator| simulator.set_copy_command(copy, command))?;
        Ok(())
    }
}

/// Metres along each axis of where units are that are out of play: farther than any scene, and near enough for snapshots.
const NOWHERE_M: f32 = 1e5;

/// Where a unit is that is out of play, each by itself.
fn nowhere(unit: usize) -> Isometry3<f32> {
    Isometry3::translation(NOWHERE_M + 100.0 * (unit % 1000) as f32, NOWHERE_M, NOWHERE_M)
}

fn is_out(pose: &Isometry3<f32>) -> bool {
    pose.translation.vector.min() > 0.9 * NOWHERE_M
}

/// Why a change of a future is refused.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum ChangeError {
    /// A pose or a physical property is out of range, or the unit is not driven.
    #[error(transparent)]
    Unit(#[from] EditError),
    /// The command is not one of this model.
    #[error(transparent)]
    Command(#[from] CommandError),
    /// The scene has no such unit.
    #[error("unit {unit} of {units}; they are counted from 0")]
    NoSuchUnit {
        /// Asked for.
        unit: usize,
        /// In the scene.
        units: usize,
    },
    /// A reason of the caller's own.
    #[error("{0}")]
    Other(String),
}

/// How a future ended.
#[derive(Clone, Debug, Default, PartialEq)]
pub enum End {
    /// All steps were taken.
    #[default]
    Complete,
    /// [`Variation::watch`] ended it.
    Stopped,
    /// [`Variation::is_cut`] ended all.
    Cut,
    /// A step failed; the last pose before it stands.
    Failed(StepError),
    /// It could not be changed as [`Variation`] asked.
    Refused(ChangeError),
}

/// What became of a future.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Outcome {
    /// Steps taken: as many rows of the output are its own, the others repeat the last.
    pub steps: usize,
    /// Why no more.
    pub end: End,
}

/// Why no future was rolled out.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum BatchError {
    /// The output is not as long as futures x steps x units.
    #[error("the output holds {found} poses, {expected} are needed: futures x steps x units")]
    Output {
        /// Poses needed.
        expected: usize,
        /// Poses given.
        found: usize,
    },
    /// No simulator could be made.
    #[error(transparent)]
    World(#[from] WorldError),
    /// The planes or the gravity of the start were refused.
    #[error(transparent)]
    Scene(#[from] EditError),
    /// The start was refused.
    #[error(transparent)]
    Start(#[from] ObserveError),
    /// The command was refused.
    #[error(transparent)]
    Command(#[from] CommandError),
    /// The pivots were refused.
    #[error(transparent)]
    Join(#[from] JoinError),
    /// The model takes a command and the start has none.
    #[error(transparent)]
    Step(#[from] StepError),
    /// The state is no snapshot of a world of this model.
    #[error("the start: {0}")]
    State(#[from] SnapshotError),
    /// The state has another number of units than it says.
    #[error("the start has {found} units, and says {said}")]
    StateUnits {
        /// Units of the snapshot.
        found: usize,
        /// Units that the start says it has.
        said: usize,
    },
    /// There is no room for so many copies of soft bodies in one lockstep.
    #[error(
        "{copies} copies of the soft bodies in one lockstep, {room} fit; give fewer units a chunk"
    )]
    Room {
        /// Copies of a lockstep.
        copies: usize,
        /// That there is room for.
        room: usize,
    },
    /// All copies together would take more memory than they may.
    #[error("{copies} copies: {error}; ask for fewer, or allow more by with_memory")]
    Memory {
        /// Asked for.
        copies: usize,
        /// How much.
        error: TooLarge,
    },
    /// The caller ended it before the copies were made.
    #[error("cancelled before all copies were made")]
    Cancelled,
}

/// Rolls out futures of scenes with one model.
///
/// ```
/// use nalgebra::{Isometry3, Point3};
/// use rigidformer_runtime::core::{Physics, Posed, Unit};
/// use rigidformer_runtime::futures::{BatchSimulator, Outcome, Start, VelocityNoise};
/// use rigidformer_runtime::engine::Engine;
/// use rigidformer_runtime::models::LoadedModel;
///
/// let loaded = LoadedModel::embedded("edge", rigidformer_weights::EDGE)?;
/// let corner = |i: usize, bit| if i & bit == 0 { -0.1 } else { 0.1 };
/// let points: Vec<_> = (0..8).map(|i| Point3::new(corner(i, 1), corner(i, 2), corner(i, 4))).collect();
/// let cube = Unit::new(&points, Physics { mass_kg: 1.0, friction: 0.4, restitution: 0.3 });
/// let at = |x, z| Isometry3::translation(x, 0.0, z);
/// let units = [0.0, 0.4].map(|x| Posed { unit: cube, previous: at(x, 0.92), current: at(x, 0.9) });
/// let start = Start { dt_s: 1.0 / 24.0, units: &units, ..Start::default() };
///
/// let (futures, steps) = (16, 6);
/// let mut poses = vec![Isometry3::identity(); futures * steps * 2];
/// let noise = VelocityNoise { seed: 1, linear_m_s: 0.3, angular_rad_s: 1.0 };
/// let outcomes = BatchSimulator::new(Engine::new()?, &loaded).run(&start, steps, &noise, &mut poses)?;
/// assert_eq!(outcomes, vec![Outcome { steps, ..Outcome::default() }; futures]);
/// let last_of_future_3 = &poses[(3 * steps + steps - 1) * 2..][..2];
/// assert!(last_of_future_3[0].translation.z < 0.9);
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
#[derive(Clone)]
pub struct BatchSimulator {
    engine: Engine,
    model: LoadedModel,
    units_a_chunk: usize,
    memory: u64,
}

impl BatchSimulator {
    /// Futures share their threads, or, where they are few, the work of each layer.
    pub fn new(engine: Engine, model: &LoadedModel) -> Self {
        let model = model.clone();
        BatchSimulator { engine, model, units_a_chunk: UNITS_PER_CHUNK, memory: USUAL_MEMORY }
    }

    /// The model that predicts.
    pub fn model(&self) -> &crate::core::Model<'_> {
        self.model.model()
    }

    /// About so many units, at least 1, advance in one lockstep; results do not depend on it.
    pub fn with_units_a_chunk(self, units: usize) -> Self {
        BatchSimulator { units_a_chunk: units.max(1), ..self }
    }

    /// All copies of one call of [`copies`](Self::copies) may take so many bytes, instead of [`USUAL_MEMORY`].
    pub fn with_memory(self, bytes: u64) -> Self {
        BatchSimulator { memory: bytes, ..self }
    }

    /// Rolls out as many futures as `out` (futures, steps, units) has room for, future by future: the poses after each
    /// step. What became of each, in order.
    ///
    /// # Errors
    /// [`BatchError`]; the output is then what it was.
    pub fn run(
        &self,
        start: &Start<'_>,
        steps: usize,
        variation: &impl Variation,
        out: &mut [Isometry3<f32>],
    ) -> Result<Vec<Outcome>, BatchError> {
        in_own_environment(|| self.run_here(start, steps, variation, out))
    }

    fn run_here(
        &self,
        start: &Start<'_>,
        steps: usize,
        variation: &impl Variation,
        out: &mut [Isometry3<f32>],
    ) -> Result<Vec<Outcome>, BatchError> {
        let units = start.count();
        let row = steps.saturating_mul(units).max(1);
        // The number of futures follows from the length of the output.
        if !out.len().is_multiple_of(row) {
            let expected = out.len().next_multiple_of(row);
            return Err(BatchError::Output { expected, found: out.len() });
        }
        let futures = out.len() / row;
        // A refused start must leave the output as it was, so one copy is tried first.
        self.begin(self.engine.single(), start, 1)?;
        let Division { chunk, share, threads } = Division::of(
            futures,
            (self.units_a_chunk / units.max(1)).max(1),
            self.engine.threads,
            Threads::all(),
        );
        let engine = Engine { threads, ..self.engine };
        let mut outcomes = vec![Outcome::default(); futures];
        let take = |index: usize, out: &mut [Isometry3<f32>], outcomes: &mut [Outcome]| {
            let chunks = out.chunks_mut(chunk * row).zip(outcomes.chunks_mut(chunk));
            chunks.enumerate().try_for_each(|(within, (out, outcomes))| {
                let first = index * share + within * chunk;
                // A thread of the pool has what its creator had set.
                in_own_environment(|| {
                    // The copies of thousands of locksteps take longer to make than a caller waits.
                    if variation.is_cut() {
                        return cut_all(outcomes);
                    }
                    let mut world = self.begin(engine, start, outcomes.len())?;
                    Lockstep { first, variation, outcomes, out, row }.run(&mut world, steps)
                })
            })
        };
        // Without threads rayon cannot be asked.
        if pool::is_there() {
            pool::enter(|| {
                let shares = out.par_chunks_mut(share * row).zip(outcomes.par_chunks_mut(share));
                shares
                    .enumerate()
                    .try_for_each(|(index, (out, outcomes))| take(index, out, outcomes))
            })?;
        } else {
            let mut shares =
                out.chunks_mut(share * row).zip(outcomes.chunks_mut(share)).enumerate();
            shares.try_for_each(|(index, (out, outcomes))| take(index, out, outcomes))?;
        }
        Ok(outcomes)
    }

    /// Units, and points of all of them, that a copy of the start has.
    fn limits(start: &Start<'_>) -> Limits {
        let points = start.units.iter().map(|posed| posed.unit.room()).sum();
        let of_units = Limits { units: start.units.len(), points };
        start.state.map_or(of_units, StartState::limits)
    }

    /// An error where copies would take more memory than they may.
    fn room_for(&self, copies: usize, bytes: u64) -> Result<(), BatchError> {
        let taken = Budget::new(self.memory).take(bytes);
        taken.map_err(|error| BatchError::Memory { copies, error })
    }

    /// A world with so many copies of the start.
    fn begin(&self, engine: Engine, start: &Start<'_>, copies: usize) -> Result<World, BatchError> {
        let limits = Self::limits(start);
        // A state that came from elsewhere may say anything of its size.
        self.room_for(copies, World::bytes(engine, &self.model, limits, copies)? as u64)?;
        let mut world = World::on(engine, &self.model, limits, copies)?;
        let takes_command = self.model.model().config().command_size > 0;
        let of_state = start.state.and_then(StartState::height_field);
        world.set_height_field(of_state)?;
        world.edit(|simulator| {
            if let Some(state) = start.state {
                simulator.restore(state.snapshot().as_bytes())?;
                let (found, said) = (simulator.len(), limits.units);
                // Rows of the output are as long as the start says.
                if found != said || simulator.copies() != 1 {
                    return Err(BatchError::StateUnits { found, said });
                }
            }
            if let Some(planes) = start.planes {
                simulator.set_planes(planes)?;
            }
            for (plane, compliance) in start.plane_compliance.iter().enumerate() {
                simulator.set_plane_compliance(plane, *compliance)?;
            }
            if let Some(law) = start.contact_law {
                simulator.set_contact_law(law)?;
            }
            if let Some(gravity) = start.gravity_m_s2 {
                simulator.set_gravity(gravity)?;
            }
            if start.state.is_none() {
                simulator.observe_poses(start.dt_s, start.units)?;
                pivots::hold(simulator, start.pivots)?;
            } else if simulator.dt_s() != Some(start.dt_s) {
                simulator.set_dt(start.dt_s)?;
            }
            if !start.command.is_empty() || (takes_command && start.state.is_none()) {
                simulator.set_command(start.command)?;
            }
            let room = simulator.replicate(copies);
            if room < copies {
                return Err(BatchError::Room { copies, room });
            }
            Ok::<_, BatchError>(())
        })?;
        if let Some(field) = start.height_field {
            world.set_height_field(Some(field))?;
        }
        Ok(world)
    }

    /// Role, mass and pose of each unit of a start.
    ///
    /// # Errors
    /// [`BatchError`] where no future can begin so.
    pub fn units_of(
        &self,
        start: &Start<'_>,
    ) -> Result<Vec<(Role, f32, Isometry3<f32>)>, BatchError> {
        let world = in_own_environment(|| self.begin(self.engine.single(), start, 1))?;
        let units = world.simulator().units();
        Ok(units.map(|unit| (unit.role(), unit.physics().mass_kg, unit.pose())).collect())
    }
}

/// How futures are divided.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
struct Division {
    /// Futures that advance together.
    chunk: usize,
    /// Futures that one thread takes, chunk after chunk; the next free thread takes the next share.
    share: usize,
    /// Threads that share the work of one chunk.
    threads: Threads,
}

impl Division {
    /// For the given threads, of `all` in the pool; `per_chunk` futures fit a chunk.
    fn of(futures: usize, per_chunk: usize, threads: Threads, all: Threads) -> Self {
        let count = threads.count();
        // rayon would use all threads of the pool, so shares bound how many work at a time.
        let is_bounded = count < all.count();
        // With fewer futures than threads, threads share the layers of each.
        if futures < count {
            let threads = if is_bounded { threads.shared_by(futures) } else { threads };
            return Division { chunk: 1, share: 1, threads };
        }
        // A multiple of the threads, so that all finish at about the same time.
        let chunks = futures.div_ceil(per_chunk).checked_next_multiple_of(count);
        let chunks = chunks.unwrap_or(usize::MAX).max(1);
        let chunk = futures.div_ceil(chunks).max(1);
        let each = futures.div_ceil(chunk).div_ceil(count).max(1);
        Division {
            chunk,
            share: if is_bounded { chunk.saturating_mul(each) } else { chunk },
            threads: threads.alone(),
        }
    }
}

/// Futures from `first` on that advance together.
struct Lockstep<'l, V> {
    first: usize,
    variation: &'l V,
    outcomes: &'l mut [Outcome],
    /// (futures, row)
    out: &'l mut [Isometry3<f32>],
    row: usize,
}

impl<V: Variation> Lockstep<'_, V> {
    fn run(&mut self, world: &mut World, steps: usize) -> Result<(), BatchError> {
        let units = world.simulator().len();
        // The future of each copy: copies of ended futures are removed.
        let mut futures: Vec<usize> = (0..self.outcomes.len()).collect();
        self.change(world, &mut futures, |variation, future, scene| variation.begin(future, scene));
        for step in 0..steps {
            self.change(world, &mut futures, |variation, future, scene| {
                variation.steer(future, step, scene)
            });
            if futures.is_empty() {
                break;
            }
            if self.variation.is_cut() {
                futures.iter().for_each(|future| self.outcomes[*future].end = End::Cut);
                break;
            }
            let mut failed: Vec<Option<StepError>> = vec![None; futures.len()];
            let mut note = |copy: usize, outcome: Result<StepReport, StepError>| {
                failed[copy] = outcome.err();
            };
            world.step_copies(&mut note)?;
            let mut alive = vec![true; futures.len()];
            for (copy, future) in futures.iter().copied().enumerate() {
                let outcome = &mut self.outcomes[future];
                if let Some(error) = failed[copy] {
                    outcome.end = End::Failed(error);
                    alive[copy] = false;
                    continue;
                }
                let poses = &mut self.out[future * self.row + step * units..][..units];
                for (unit, pose) in poses.iter_mut().enumerate() {
                    let found = world.simulator().unit(copy * units + unit);
                    *pose = found.map(|unit| unit.pose()).unwrap_or_default();
                }
                outcome.steps = step + 1;
                if self.variation.watch(self.first + future, step, poses).is_break() {
                    // An end after the last step cuts nothing.
                    outcome.end = if step + 1 < steps { End::Stopped } else { End::Complete };
                    alive[copy] = false;
                }
            }
            retain(world, &mut futures, &alive);
        }
        for (outcome, out) in self.outcomes.iter().zip(self.out.chunks_exact_mut(self.row)) {
            let taken = outcome.steps * units;
            // An ended future repeats its last poses, so that the output has no gaps.
            if let Some(last) = taken.checked_sub(units) {
                for at in taken..out.len() {
                    out[at] = out[last + (at - taken) % units.max(1)];
                }
            }
        }
        Ok(())
    }

    /// Lets the variation change each future; futures whose change is refused end.
    fn change(
        &mut self,
        world: &mut World,
        futures: &mut Vec<usize>,
        change: impl Fn(&V, usize, &mut FutureScene<'_>) -> Result<(), ChangeError>,
    ) {
        let mut alive = vec![true; futures.len()];
        for (copy, future) in futures.iter().copied().enumerate() {
            let mut scene = FutureScene { world: &mut *world, copy };
            if let Err(error) = change(self.variation, self.first + future, &mut scene) {
                self.outcomes[future].end = End::Refused(error);
                alive[copy] = false;
            }
        }
        retain(world, futures, &alive);
    }
}

/// Futures that did not begin.
fn cut_all(outcomes: &mut [Outcome]) -> Result<(), BatchError> {
    outcomes.iter_mut().for_each(|outcome| outcome.end = End::Cut);
    Ok(())
}

fn retain(world: &mut World, futures: &mut Vec<usize>, alive: &[bool]) {
    // Most steps end no future, and moving copies costs time.
    if alive.iter().all(|alive| *alive) {
        return;
    }
    world.edit(|simulator| simulator.retain_copies(|copy| alive[copy]));
    let mut alive = alive.iter();
    futures.retain(|_| alive.next().copied().unwrap_or(false));
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn threads_that_are_asked_for_are_all_that_work() {
        for all in [1, 2, 8, 16] {
            for count in 1..all {
                for futures in 1..200 {
                    let (threads, all) = (Threads::new(count), Threads::new(all));
                    let division = Division::of(futures, 5, threads, all);
                    let shares = futures.div_ceil(division.share);
                    assert!(shares * division.threads.count() <= count, "{futures}: {division:?}");
                    assert!(division.share.is_multiple_of(division.chunk), "{division:?}");
                }
            }
        }
    }

    #[test]
    fn with_all_threads_whoever_is_free_takes_a_chunk() {
        // As of a pool of 64: no more than 16 share a layer.
        let all = Threads::new(64);
        let many = Division::of(4096, 12, all, all);
        assert_eq!((many.chunk, many.share, many.threads.count()), (12, 12, 1));
        let few = Division::of(3, 12, all, all);
        assert_eq!((few.chunk, few.share, few.threads), (1, 1, all));
        let bounded = Division::of(3, 12, Threads::new(8), all);
        assert_eq!((bounded.chunk, bounded.share, bounded.threads.count()), (1, 1, 2));
        assert_eq!(Division::of(0, 12, Threads::new(8), all).chunk, 1);
    }
}
