//! From a recorded scene's first frames to predicted poses.

use std::sync::atomic::Ordering;

use nalgebra::{Isometry3, Matrix3, Point3, Translation3, UnitQuaternion, Vector3};
use rayon::prelude::*;
use rigidformer_core::kernels::in_own_environment;
use rigidformer_core::{
    BondError, CommandError, EditError, JoinError, Limits, ObserveError, Observed, Posed, Role,
    Soft, StepError, Unit, UnitId, UnitView, geometry::kabsch_f64,
};
use rigidformer_runtime::engine::Engine;
use rigidformer_runtime::kernels::KernelError;
use rigidformer_runtime::models::LoadedModel;
use rigidformer_runtime::pivots::hold;
use rigidformer_runtime::progress::Progress;
use rigidformer_runtime::world::{World, WorldError};

use crate::held_bonds::{self, HeldBonds};
use crate::scenes::{RecordedScene, RecordedUnit, Velocity};

/// Poses of all units at evenly spaced frames.
#[derive(Clone, Debug, PartialEq)]
pub struct Trajectory {
    first_frame: u32,
    step: u32,
    units: usize,
    /// (samples, units)
    poses: Vec<Isometry3<f32>>,
}

impl Trajectory {
    /// A trajectory that so far has one sample: the poses at `first_frame`. `step` frames lie between samples, at
    /// least 1.
    pub fn new(first_frame: u32, step: u32, poses: Vec<Isometry3<f32>>) -> Self {
        // A step of 0 would put all samples at one frame.
        Self { first_frame, step: step.max(1), units: poses.len(), poses }
    }

    /// Adds the next sample. Units that `poses` lacks keep their last pose; those in excess are left out.
    pub fn push(&mut self, poses: impl IntoIterator<Item = Isometry3<f32>>) {
        let start = self.poses.len();
        self.poses.extend(poses.into_iter().take(self.units));
        // A short sample would shift the units of all later ones.
        while self.poses.len() < start + self.units {
            self.poses.push(self.poses[self.poses.len() - self.units]);
        }
    }

    /// Frames between samples.
    pub fn step(&self) -> u32 {
        self.step
    }

    /// Units.
    pub fn units(&self) -> usize {
        self.units
    }

    /// Samples, at least one.
    pub fn samples(&self) -> usize {
        self.poses.len().checked_div(self.units).unwrap_or(0)
    }

    /// First frame.
    pub fn first_frame(&self) -> u32 {
        self.first_frame
    }

    /// Last frame.
    pub fn last_frame(&self) -> u32 {
        // Rollouts end at a frame that the caller chooses, so sums of frames saturate.
        let gaps = u32::try_from(self.samples().saturating_sub(1)).unwrap_or(u32::MAX);
        self.first_frame.saturating_add(gaps.saturating_mul(self.step))
    }

    /// Frame and poses, (units), of every sample in turn.
    pub fn iter(&self) -> impl Iterator<Item = (u32, &[Isometry3<f32>])> {
        let frame = |sample: u32| self.first_frame.saturating_add(sample.saturating_mul(self.step));
        // A trajectory without units has no samples; chunks of 0 would panic.
        (0..).map(frame).zip(self.poses.chunks_exact(self.units.max(1)))
    }

    /// Pose of a unit at a frame. Between samples it is interpolated: linearly in position, along the shortest turn
    /// in orientation. `None` outside the trajectory.
    pub fn pose(&self, frame: u32, unit: usize) -> Option<Isometry3<f32>> {
        let since = frame.checked_sub(self.first_frame)?;
        // Rows lie side by side, so a unit too many would be the next sample's.
        if unit >= self.units {
            return None;
        }
        let (sample, rest) = ((since / self.step) as usize, since % self.step);
        let at = |sample: usize| self.poses.get(sample * self.units + unit).copied();
        let before = at(sample)?;
        // Poses of samples are returned bit for bit.
        if rest == 0 {
            return Some(before);
        }
        let after = at(sample + 1)?;
        Some(in_own_environment(|| between(&before, &after, rest as f32 / self.step as f32)))
    }

    /// As [`pose`](Self::pose) at any time, in frames, which need not be a whole number.
    pub fn pose_at(&self, frames: f64, unit: usize) -> Option<Isometry3<f32>> {
        in_own_environment(|| self.pose_at_here(frames, unit))
    }

    fn pose_at_here(&self, frames: f64, unit: usize) -> Option<Isometry3<f32>> {
        let since = (frames - f64::from(self.first_frame)) / f64::from(self.step);
        // Negated, so that NaN is outside.
        if !(since >= 0.0 && unit < self.units) {
            return None;
        }
        // Rounding moves a sample's own time by a little, and that is still the sample.
        let nearest = since.round();
        let since = if (since - nearest).abs() < 1e-6 { nearest } else { since };
        let at = |sample: usize| self.poses.get(sample.checked_mul(self.units)? + unit).copied();
        let (sample, share) = (since as usize, since.fract() as f32);
        let before = at(sample)?;
        if share == 0.0 { Some(before) } else { Some(between(&before, &at(sample + 1)?, share)) }
    }
}

/// The pose at a share of the way from one to the other.
fn between(before: &Isometry3<f32>, after: &Isometry3<f32>, share: f32) -> Isometry3<f32> {
    let position = before.translation.vector.lerp(&after.translation.vector, share);
    // Half a turn between samples has no shortest way, so the nearer sample stands for it.
    let nearer = if share < 0.5 { before.rotation } else { after.rotation };
    let rotation = before.rotation.try_slerp(&after.rotation, share, 1e-6).unwrap_or(nearer);
    Isometry3::from_parts(Translation3::from(position), rotation)
}

/// Why a scene could not be rolled out. Its text names the scene and the remedy.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum RolloutError {
    /// The caller asked to stop.
    #[error("cancelled")]
    Cancelled,
    /// The scene has too few recorded frames to start from.
    #[error(
        "{scene}: step {step} starts from frames 0 and {step}, {recorded} frames are recorded; use a smaller step"
    )]
    TooFewFrames {
        /// The scene.
        scene: String,
        /// Step code asked for.
        step: u32,
        /// Frames recorded.
        recorded: usize,
    },
    /// The model wants a command, and the scene has none, or one of another size.
    #[error(
        "{scene}: its commands have {found} numbers (0: it has none), the model wants {size}; use a scene recorded with \
         such commands, or another model"
    )]
    NeedsCommand {
        /// The scene.
        scene: String,
        /// Numbers in a command of the model.
        size: usize,
        /// Numbers in a command of the scene; 0 without commands.
        found: usize,
    },
    /// A unit is soft, and the model moves rigid ones.
    #[error(
        "{scene}: unit {unit} is soft and this model moves rigid units; give a model of soft bodies, such as shell.rfm or soft.rfm, or a scene without soft units"
    )]
    Soft {
        /// The scene.
        scene: String,
        /// The unit.
        unit: usize,
    },
    /// How stiff a soft unit is, is not known.
    #[error(
        "{scene}: the Young's modulus of soft unit {unit} is not known; add unit_young to the scene file"
    )]
    NoYoung {
        /// The scene.
        scene: String,
        /// The unit.
        unit: usize,
    },
    /// The scene lacks what a rollout from one pose and velocity needs, or has what it cannot have.
    #[error("{scene}: {what}")]
    OpenLoop {
        /// The scene.
        scene: String,
        /// What is wrong, and the remedy.
        what: &'static str,
    },
    /// No simulator could be made for the scene.
    #[error("{scene}: {source}")]
    World {
        /// The scene.
        scene: String,
        /// Why.
        source: WorldError,
    },
    /// Planes, gravity or a driven unit's pose were refused.
    #[error("{scene}: {source}")]
    Edit {
        /// The scene.
        scene: String,
        /// The simulator's answer.
        source: EditError,
    },
    /// A command was refused.
    #[error("{scene}: {source}")]
    Command {
        /// The scene.
        scene: String,
        /// The simulator's answer.
        source: CommandError,
    },
    /// The kernels that the environment asks for cannot be used.
    #[error(transparent)]
    Kernel(#[from] KernelError),
    /// The first frames were refused.
    #[error("{scene}: {source}")]
    Observe {
        /// The scene.
        scene: String,
        /// The simulator's answer.
        source: ObserveError,
    },
    /// Its pivots were refused.
    #[error("{scene}: {source}")]
    Join {
        /// The scene.
        scene: String,
        /// The simulator's answer.
        source: JoinError,
    },
    /// Its bonds were refused.
    #[error("{scene}: {source}")]
    Bond {
        /// The scene.
        scene: String,
        /// The simulator's answer.
        source: BondError,
    },
    /// A step was refused.
    #[error("{scene}: step to frame {frame}: {source}")]
    Step {
        /// The scene.
        scene: String,
        /// The frame that was not reached.
        frame: u32,
        /// The simulator's answer.
        source: StepError,
    },
}

/// Rolls one scene out: observes its frames 0 and `step`, then predicts every `step` frames until `last_frame` is
/// reached or passed. The trajectory starts with the two observed frames. The scene's planes, gravity, frame rate, driven
/// units and commands count; a scene whose planes are not known stands on the model's ground. Units that share a pivot are held together
/// ([`RecordedScene::with_pivots`]). Bonds hold until the model breaks them. With a model that breaks none they hold until a step
/// begins at whose first frame the record has them broken. Only models
/// whose motion is by impulses hold them.
///
/// ```
/// use nalgebra::{Isometry3, Point3, Vector3};
/// use rigidformer_core::Physics;
/// use rigidformer_runtime::models::LoadedModel;
/// use rigidformer_evaluation::rollout::rollout;
/// use rigidformer_runtime::progress::Progress;
/// use rigidformer_evaluation::scenes::{RecordedScene, RecordedUnit, Split};
///
/// let loaded = LoadedModel::embedded("edge", rigidformer_weights::EDGE)?;
/// // A recorded scene, usually from `Dataset::open(path)?.scene(index, None)?`.
/// let fall = |frame| Isometry3::translation(0.0, 0.0, 3.0 - 5.0 * (frame as f32 / 240.0).powi(2));
/// let corner = |i: i32| [1, 2, 4].map(|bit| if i & bit == 0 { -0.1 } else { 0.1 });
/// let points = (0..8).map(|i| Point3::from(corner(i))).collect();
/// let rubber = Physics { mass_kg: 1.0, friction: 0.4, restitution: 0.3 };
/// let unit = RecordedUnit::new("cube", points, rubber, (0..=100).map(fall).collect());
/// let gravity = Vector3::new(0.0, 0.0, -10.0);
/// let scene = RecordedScene::new("drop", 1, Split::Test, 240.0, gravity, vec![unit])?;
///
/// let predicted = rollout(&loaded, &scene, 10, 100, Progress::none())?;
/// let pose = predicted.pose(100, 0).ok_or("not predicted")?;
/// assert!((pose.translation.z - fall(100).translation.z).abs() < 1e-4); // nothing to touch: exact
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
pub fn rollout(
    model: &LoadedModel,
    scene: &RecordedScene,
    step: u32,
    last_frame: u32,
    progress: Progress<'_>,
) -> Result<Trajectory, RolloutError> {
    rollout_on(Engine::new()?, model, scene, step, last_frame, progress)
}

/// As [`rollout`] on kernels and threads of the caller's choice; the result is the same, bit by bit.
pub fn rollout_on(
    engine: Engine,
    model: &LoadedModel,
    scene: &RecordedScene,
    step: u32,
    last_frame: u32,
    progress: Progress<'_>,
) -> Result<Trajectory, RolloutError> {
    rollout_seen(engine, model, scene, step, last_frame, progress, &mut |_| {})
}

/// As [`rollout_on`], and shows what is simulated: once when it has observed the frames 0 and `step`, and after each step.
///
/// # Errors
/// As [`rollout_on`].
pub fn rollout_seen(
    engine: Engine,
    model: &LoadedModel,
    scene: &RecordedScene,
    step: u32,
    last_frame: u32,
    progress: Progress<'_>,
    seen: &mut (dyn FnMut(&Replay<'_>) + Send),
) -> Result<Trajectory, RolloutError> {
    let mut replay = Replay::new(engine, model, scene)?;
    let name = || scene.name().to_owned();
    let too_few = || RolloutError::TooFewFrames { scene: name(), step, recorded: scene.frames() };
    let run = || {
        replay.observe(step, step)?;
        seen(&replay);
        let mut trajectory = Trajectory::new(0, step, scene.poses_at(0).ok_or_else(too_few)?);
        trajectory.push(scene.poses_at(step as usize).ok_or_else(too_few)?);
        while trajectory.last_frame() < last_frame {
            if progress.cancelled.load(Ordering::Relaxed) {
                return Err(RolloutError::Cancelled);
            }
            replay.command(trajectory.last_frame(), step)?;
            let frame = trajectory.last_frame().saturating_add(step);
            let source = replay.world.step();
            source.map_err(|source| RolloutError::Step { scene: name(), frame, source })?;
            trajectory.push(replay.poses());
            seen(&replay);
            (progress.stepped)();
        }
        Ok(trajectory)
    };
    engine.enter(|| in_own_environment(run))
}

/// Rolls one scene out in open loop: from the poses and velocities of its frame 0 alone, to its last frame or beyond. The
/// trajectory is in native frames of the model, `step` of them a sample; a frame of the record may lie between them
/// ([`Trajectory::pose_at`]).
///
/// A simulator is told a velocity by two poses. The earlier one is where a body comes from that covers
/// `v dt + g dt^2 / 2` and turns by `w dt` in the next step under free motion.
///
/// # Errors
/// [`RolloutError::OpenLoop`] for a scene without velocities, or with driven units or commands, which have no value between
/// frames.
pub fn open_loop_on(
    engine: Engine,
    model: &LoadedModel,
    scene: &RecordedScene,
    step: u32,
    progress: Progress<'_>,
) -> Result<Trajectory, RolloutError> {
    let mut replay = Replay::new(engine, model, scene)?;
    let name = || scene.name().to_owned();
    let frames = in_own_environment(|| open_loop_frames(model, scene));
    let run = || {
        let first = replay.start(step)?;
        let mut trajectory = Trajectory::new(0, step, first);
        while f64::from(trajectory.last_frame()) < frames {
            if progress.cancelled.load(Ordering::Relaxed) {
                return Err(RolloutError::Cancelled);
            }
            let frame = trajectory.last_frame().saturating_add(step);
            let source = replay.world.step();
            source.map_err(|source| RolloutError::Step { scene: name(), frame, source })?;
            trajectory.push(replay.world.simulator().units().map(|unit| unit.pose()));
            (progress.stepped)();
        }
        Ok(trajectory)
    };
    engine.enter(|| in_own_environment(run))
}

/// How long a scene's record lasts, in native frames of the model.
pub(crate) fn open_loop_frames(model: &LoadedModel, scene: &RecordedScene) -> f64 {
    let native = f64::from(model.model().config().frame_rate_hz);
    let frames = (scene.frames() - 1) as f64 * native / f64::from(scene.frame_rate_hz());
    // Rounding must not add a step beyond the record.
    frames * (1.0 - 1e-7)
}

/// Rolls scenes out on all threads; the results are in the order of the scenes and do not depend on the threads.
/// Ends with the error of the first scene, in that order, that has one.
pub fn rollout_many(
    model: &LoadedModel,
    scenes: &[RecordedScene],
    step: u32,
    last_frame: u32,
    progress: Progress<'_>,
) -> Result<Vec<Trajectory>, RolloutError> {
    on_all_threads(scenes, |engine, scene| {
        rollout_on(engine, model, scene, step, last_frame, progress)
    })
}

/// Does the same to all scenes, on all threads: each scene on one of them, but for those that are fewer than the threads.
pub(crate) fn on_all_threads<T: Send>(
    scenes: &[RecordedScene],
    one: impl Fn(Engine, &RecordedScene) -> Result<T, RolloutError> + Sync,
) -> Result<Vec<T>, RolloutError> {
    let mut engine = Engine::new()?;
    // Many scenes fill all threads by themselves, and a thread a scene needs no waiting.
    if scenes.len() >= rayon::current_num_threads() {
        engine = engine.single();
    }
    let results: Vec<_> = scenes.par_iter().map(|scene| one(engine, scene)).collect();
    // The first error in the order of the scenes, so that it does not depend on the threads.
    results.into_iter().collect()
}

/// A world that a recorded scene is replayed into: its units, planes and gravity; where its driven units go and its
/// commands, step by step.
pub struct Replay<'s> {
    /// The world.
    pub world: World,
    scene: &'s RecordedScene,
    model: LoadedModel,
    /// (units) Ids of the driven ones.
    driven: Vec<Option<UnitId>>,
    /// (units) What carries a unit's points to where the simulator's poses of it count from; empty: nothing does.
    bases: Vec<Isometry3<f32>>,
    held: HeldBonds,
}

impl<'s> Replay<'s> {
    /// A world with room for the scene.
    ///
    /// # Errors
    /// [`RolloutError`] where the model cannot move the scene's units or lacks its commands.
    pub fn new(
        engine: Engine,
        model: &LoadedModel,
        scene: &'s RecordedScene,
    ) -> Result<Self, RolloutError> {
        let name = || scene.name().to_owned();
        let elastic = model.model().config().motion.is_soft();
        for (unit, recorded) in scene.units().iter().enumerate() {
            // The simulator would refuse it too, but without the scene's name and a remedy.
            if recorded.soft.is_some() && !elastic {
                return Err(RolloutError::Soft { scene: name(), unit });
            }
            if recorded.soft.is_some() && recorded.young_pa.is_none() {
                return Err(RolloutError::NoYoung { scene: name(), unit });
            }
        }
        let (size, found) = (model.model().config().command_size as usize, scene.command_size());
        // Models without commands take scenes with them, as baselines do.
        if size > 0 && size != found {
            return Err(RolloutError::NeedsCommand { scene: name(), size, found });
        }
        // Exactly the scene's size: a workspace grows with its limits.
        let limits = Limits {
            units: scene.units().len(),
            points: scene.units().iter().map(|unit| unit.as_unit().room()).sum(),
        };
        let world = World::on(engine, model, limits, 1);
        let world = world.map_err(|source| RolloutError::World { scene: name(), source })?;
        let mut replay = Replay {
            world,
            scene,
            model: model.clone(),
            driven: Vec::new(),
            bases: Vec::new(),
            held: HeldBonds::default(),
        };
        replay.edit(|world| {
            world.set_height_field(scene.height_field())?;
            world.edit(|simulator| {
                simulator.set_gravity(scene.gravity_m_s2())?;
                simulator.set_contact_law(scene.contact_law())?;
                // Unknown planes leave the model's ground in place.
                let Some(planes) = scene.planes() else { return Ok(()) };
                simulator.set_planes(planes)?;
                let mut all = scene.plane_compliance().iter().enumerate();
                all.try_for_each(|(plane, own)| simulator.set_plane_compliance(plane, *own))
            })
        })?;
        Ok(replay)
    }

    fn edit(
        &mut self,
        change: impl FnOnce(&mut World) -> Result<(), EditError>,
    ) -> Result<(), RolloutError> {
        let scene = self.scene.name();
        change(&mut self.world).map_err(|source| RolloutError::Edit { scene: scene.into(), source })
    }

    /// Starts from the recorded poses at frames `frame - step` and `frame`.
    ///
    /// # Errors
    /// [`RolloutError`] where they are not recorded or not accepted.
    pub fn observe(&mut self, step: u32, frame: u32) -> Result<(), RolloutError> {
        let scene = self.scene;
        let name = || scene.name().to_owned();
        // Poses say nothing of soft points, so such scenes are observed by points.
        if scene.units().iter().any(|unit| unit.soft.is_some()) {
            return self.observe_points(step, frame);
        }
        let poses =
            |frame: Option<u32>| -> Option<Vec<Isometry3<f32>>> { scene.poses_at(frame? as usize) };
        let (Some(previous), Some(current)) = (poses(frame.checked_sub(step)), poses(Some(frame)))
        else {
            let recorded = scene.frames();
            return Err(RolloutError::TooFewFrames { scene: name(), step, recorded });
        };
        self.observe_poses(step as f32 / scene.frame_rate_hz(), &previous, &current)?;
        self.hold(frame)
    }

    /// Goes on from the recorded poses at frames `frame - step` and `frame` of the scene that was [observed](Self::observe), whose first
    /// frame stays. Scenes of soft units or bonds are observed anew.
    ///
    /// # Errors
    /// [`RolloutError`] where they are not recorded or not accepted.
    pub(crate) fn go_to(&mut self, step: u32, frame: u32) -> Result<(), RolloutError> {
        let scene = self.scene;
        if scene.units().iter().any(|unit| unit.soft.is_some()) {
            return self.observe(step, frame);
        }
        let at = |frame: Option<u32>| scene.poses_at(frame? as usize);
        let (Some(previous), Some(current)) = (at(frame.checked_sub(step)), at(Some(frame))) else {
            let (scene, recorded) = (scene.name().to_owned(), scene.frames());
            return Err(RolloutError::TooFewFrames { scene, step, recorded });
        };
        self.go_as(step, frame, &[previous, current])
    }

    /// As [`go_to`](Self::go_to), from given poses of all units a step before the frame and then. They are rigid.
    ///
    /// # Errors
    /// [`RolloutError`] where they are not accepted.
    pub(crate) fn go_as(
        &mut self,
        step: u32,
        frame: u32,
        [previous, current]: &[Vec<Isometry3<f32>>; 2],
    ) -> Result<(), RolloutError> {
        let dt_s = step as f32 / self.scene.frame_rate_hz();
        if !self.scene.bonds().is_empty() {
            self.observe_poses(dt_s, previous, current)?;
            return self.hold(frame);
        }
        self.edit(|world| {
            world.edit(|simulator| {
                simulator.set_dt(dt_s)?;
                let ids: Vec<_> = simulator.units().map(|unit| unit.id()).collect();
                let mut poses = ids.into_iter().zip(previous.iter().zip(current));
                poses.try_for_each(|(id, (previous, current))| {
                    simulator.set_poses(id, previous, current)
                })
            })
        })
    }

    /// Makes the bonds that hold at a frame.
    fn hold(&mut self, frame: u32) -> Result<(), RolloutError> {
        let held = HeldBonds::make(&mut self.world, self.scene, frame as usize);
        let name = || self.scene.name().to_owned();
        self.held = held.map_err(|source| RolloutError::Bond { scene: name(), source })?;
        Ok(())
    }

    /// (bonds) Whether each of the scene's bonds holds now; `None` where the rollout holds none.
    pub fn holding(&self) -> Option<Vec<bool>> {
        held_bonds::holding(&self.world, self.scene)
    }

    /// As [`observe`](Self::observe), from points: those of soft units say where they are.
    fn observe_points(&mut self, step: u32, frame: u32) -> Result<(), RolloutError> {
        let scene = self.scene;
        let name = || scene.name().to_owned();
        let at = |frame: Option<u32>| -> Option<Vec<Vec<Point3<f32>>>> {
            let frame = frame? as usize;
            scene.units().iter().map(|unit| unit.points_at(frame)).collect()
        };
        let (Some(previous), Some(current)) = (at(frame.checked_sub(step)), at(Some(frame))) else {
            let recorded = scene.frames();
            return Err(RolloutError::TooFewFrames { scene: name(), step, recorded });
        };
        let units = scene.units().iter().zip(previous.iter().zip(&current));
        let units = units.map(|(unit, (previous, current))| {
            // The simulator takes the points of the previous frame as those of the unit.
            let seen = Unit { points: previous, ..unit.as_unit() };
            let soft = unit.young_pa.map(|young_pa| Soft { rest: &unit.points, young_pa });
            Observed { unit: Unit { soft, ..seen }, current }
        });
        let dt_s = step as f32 / scene.frame_rate_hz();
        let done = self.world.edit(|simulator| simulator.observe(dt_s, units));
        done.map_err(|source| RolloutError::Observe { scene: name(), source })?;
        // The simulator's poses count from the observed points of the previous frame, and
        // trajectories from the body frame.
        let first = frame.checked_sub(step).and_then(|frame| scene.poses_at(frame as usize));
        self.bases = first.unwrap_or_default();
        self.find_driven();
        self.hold(frame)
    }

    fn find_driven(&mut self) {
        let driven = self.world.simulator().units();
        let driven = driven.map(|unit| (unit.role() == Role::Driven).then(|| unit.id()));
        self.driven = driven.collect();
    }

    /// Poses of all units now: of a soft one, the rigid pose that fits its points best.
    pub fn poses(&self) -> Vec<Isometry3<f32>> {
        let units = self.world.simulator().units().zip(self.scene.units()).enumerate();
        let pose = |(index, (unit, recorded)): (usize, (UnitView<'_>, &RecordedUnit))| {
            if !unit.is_soft() {
                return self
                    .bases
                    .get(index)
                    .map_or_else(|| unit.pose(), |base| unit.pose() * base);
            }
            let pairs: Vec<_> = unit
                .soft_points()
                .filter_map(|(number, point)| {
                    Some((recorded.points.get(number)?.coords, point.coords))
                })
                .collect();
            // A soft unit's own pose has no turn, and trajectories need one.
            let fit = kabsch_f64(pairs.iter().map(|(a, b)| (a, b)), &Matrix3::identity());
            fit.pose.isometry(&Point3::origin())
        };
        units.map(pose).collect()
    }

    /// Points of all soft units now, in the order of the scene's units and of their points, metres.
    pub fn soft_points(&self) -> Vec<Point3<f32>> {
        let mut all = Vec::new();
        for unit in self.world.simulator().units().filter(|unit| unit.is_soft()) {
            let start = all.len();
            // Points come in the simulator's order and go to their places in the unit's.
            all.resize(start + unit.point_count(), Point3::origin());
            for (number, point) in unit.soft_points() {
                if let Some(slot) = all.get_mut(start + number) {
                    *slot = point;
                }
            }
        }
        all
    }

    /// Starts from the recorded poses and velocities at frame 0, for steps of so many native frames of the model. Gives
    /// these poses.
    ///
    /// # Errors
    /// As [`open_loop_on`].
    pub fn start(&mut self, step: u32) -> Result<Vec<Isometry3<f32>>, RolloutError> {
        let scene = self.scene;
        let refused = |what| RolloutError::OpenLoop { scene: scene.name().to_owned(), what };
        // The model's frames fall between the record's, where targets and commands are not known.
        if scene.units().iter().any(|unit| unit.role == Role::Driven) || scene.command_size() > 0 {
            return Err(refused(
                "has driven units or commands, which have no value between frames; leave unit_velocity out of the file, to \
                 start from two frames",
            ));
        }
        // Steps are the model's native frames, since the record's rate (148 Hz) is not one that it
        // learnt.
        let dt_s = step as f32 / self.model.model().config().frame_rate_hz;
        let (mut previous, mut current) = (Vec::new(), Vec::new());
        for unit in scene.units() {
            let (Some(velocity), Some(pose)) = (unit.velocity, unit.poses.first()) else {
                return Err(refused(
                    "has no unit_velocity, the velocity of its units at frame 0; add it to the file",
                ));
            };
            let still = unit.role == Role::Fixed;
            // Scenery has equal poses in both frames, or it would be told to move.
            let velocity = if still { Velocity::default() } else { velocity };
            let gravity = if still { Vector3::zeros() } else { scene.gravity_m_s2() };
            // Free motion then covers v dt + g dt^2 / 2 in the next step.
            let way = velocity.linear_m_s * dt_s - gravity * (0.5 * dt_s * dt_s);
            let turn = UnitQuaternion::from_scaled_axis(velocity.angular_rad_s * -dt_s);
            let position = Translation3::from(pose.translation.vector - way);
            previous.push(Isometry3::from_parts(position, turn * pose.rotation));
            current.push(*pose);
        }
        self.observe_poses(dt_s, &previous, &current)?;
        self.hold(0)?;
        Ok(current)
    }

    /// Starts from two poses of each unit, `dt_s` apart.
    fn observe_poses(
        &mut self,
        dt_s: f32,
        previous: &[Isometry3<f32>],
        current: &[Isometry3<f32>],
    ) -> Result<(), RolloutError> {
        let scene = self.scene;
        let units = scene.units().iter().zip(previous.iter().zip(current));
        let units = units.map(|(unit, (previous, current))| Posed {
            unit: unit.as_unit(),
            previous: *previous,
            current: *current,
        });
        let done = self.world.edit(|simulator| simulator.observe_poses(dt_s, units));
        let name = || scene.name().to_owned();
        done.map_err(|source| RolloutError::Observe { scene: name(), source })?;
        // An observation ends all joints, so they are made after it.
        let done = self.world.edit(|simulator| hold(simulator, scene.pivots()));
        done.map_err(|source| RolloutError::Join { scene: name(), source })?;
        self.find_driven();
        Ok(())
    }

    /// Gives the next step, from `frame` to `frame + step`, its command and the poses of driven units, as recorded; after
    /// the last recorded frame driven units stay, and the last command holds.
    ///
    /// # Errors
    /// [`RolloutError`] where they are not accepted.
    pub fn command(&mut self, frame: u32, step: u32) -> Result<(), RolloutError> {
        let (scene, next) = (self.scene, frame.saturating_add(step) as usize);
        // A bond breaks before the step that begins at its frame, as the record has it.
        let broken = self.held.break_recorded(&mut self.world, frame as usize);
        let name = || scene.name().to_owned();
        broken.map_err(|source| RolloutError::Bond { scene: name(), source })?;
        for unit in 0..self.driven.len() {
            let Some(id) = self.driven[unit] else { continue };
            // Beyond the record a driven unit stays where it was told to go last.
            if let Some(pose) = scene.pose(next, unit) {
                let base = self.bases.get(unit).map(Isometry3::inverse);
                let pose = base.map_or(*pose, |base| pose * base);
                self.edit(|world| world.drive(id, &pose))?;
            }
        }
        if self.model.model().config().command_size > 0 {
            let last = scene.frames() - 1;
            // Beyond the record the last command holds.
            let (from, to) = ((frame as usize).min(last), next.min(last + 1));
            let command = scene.command_of_step(from, to.max(from + 1)).unwrap_or_default();
            let done = self.world.edit(|simulator| simulator.set_command(&command));
            let scene = scene.name();
            done.map_err(|source| RolloutError::Command { scene: scene.into(), source })?;
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn between_samples_a_pose_is_half_way() {
        let turn = |angle| UnitQuaternion::from_axis_angle(&Vector3::z_axis(), angle);
        let pose = |x, angle| Isometry3::from_parts(Translation3::new(x, 0.0, 0.0), turn(angle));
        let mut trajectory = Trajectory::new(0, 10, vec![pose(0.0, 0.0)]);
        trajectory.push([pose(1.0, 1.0)]);
        let middle = trajectory.pose(5, 0).unwrap();
        assert!((middle.translation.vector.x - 0.5).abs() < 1e-6);
        assert!((middle.rotation.angle() - 0.5).abs() < 1e-6);
        assert_eq!(trajectory.pose(10, 0), Some(pose(1.0, 1.0)));
        assert_eq!(trajectory.pose(11, 0), None);
        assert_eq!(trajectory.pose(5, 1), None);
        assert_eq!(trajectory.pose_at(5.0, 0), trajectory.pose(5, 0));
        assert_eq!(trajectory.pose_at(10.0 + 1e-9, 0), trajectory.pose(10, 0));
        assert!((trajectory.pose_at(2.5, 0).unwrap().translation.x - 0.25).abs() < 1e-6);
        for (frames, unit) in [(10.1, 0), (-0.1, 0), (f64::NAN, 0), (5.0, 1), (1e300, 0)] {
            assert_eq!(trajectory.pose_at(frames, unit), None, "{frames}");
        }
    }
}
