//! The forward pass and the rollout. The only module that composes blocks.

use crate::config::{ANCHORS, Limits, MAX_COMMAND, MAX_COORDINATE_M, Sizes, SlabSizes};
use crate::error::{CommandError, ObserveError, StepError, WorkspaceError};
use crate::geometry::index::Parts;
use crate::geometry::{
    Pose, Rank, centre_of_mass, extreme_points, farthest_point_order, kabsch_f64, norm, radius,
};
use crate::kernels::{Divisible, Kernels, Portable};
use crate::layers::{copy, part, part_mut, rows_mut};
use crate::model::Model;
use crate::projection::{Projection, Rigid};
use crate::scene::{Physics, Scene, Unit, UnitState};
use crate::trace::{Layer, NoTrace, Stage, Trace};
use crate::workspace::{Workspace, command_places};
use crate::{anchors, encoder, impacts, interaction, math, motion};
use nalgebra::{Isometry3, Matrix3, Point3, Vector3};

mod copies;

/// Points of a unit closer together than this are one point, metres.
const MIN_EXTENT_M: f32 = 1e-6;

/// Memory that the caller owns and a simulator works in. Lengths: [`SlabSizes::new`].
pub struct Slabs<'s> {
    /// Activations.
    pub f32: &'s mut [f32],
    /// Rows on their way into int8 layers.
    pub i8: &'s mut [i8],
    /// The scene's points.
    pub points: &'s mut [Point3<f32>],
}

/// About the multiplications that moving a unit is worth: a microsecond's.
const UNIT_COST: usize = 256 << 10;

/// What an accepted observation was like.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Observation {
    /// Largest distance of an observed point from the rigid fit of its unit, metres; 0 where
    /// poses were given. Far above the sensor's noise, a unit was not rigid or its points
    /// were not the same in both frames.
    pub residual_m: f32,
    /// Units whose points left their rotation open (all on a line).
    pub degenerate_units: u32,
}

/// What a step did.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct StepReport {
    /// Units whose motion the network predicted; the others can touch nothing within the
    /// step and moved freely, exactly.
    pub active_units: u32,
    /// Units whose anchors left their rotation open; see [`Rank`].
    pub degenerate_units: u32,
}

/// A scene of up to `UNITS` units and the model that advances it.
///
/// ```
/// use nalgebra::{Point3, Vector3};
/// use rigidformer_core::{Limits, Model, Physics, Simulator, SlabSizes, Slabs};
/// # fn main() -> Result<(), Box<dyn std::error::Error>> {
/// let model = Model::load(rigidformer_weights::EDGE)?;
/// let limits = Limits { units: 2, points: 16 };
/// let sizes = SlabSizes::new(model.config(), limits);
/// let mut numbers = vec![0.0; sizes.f32];
/// let mut bytes = vec![0; sizes.i8];
/// let mut points = vec![Point3::origin(); sizes.points];
/// let slabs = Slabs { f32: &mut numbers, i8: &mut bytes, points: &mut points };
/// let mut simulator: Simulator<2> = Simulator::new(&model, limits, slabs)?;
///
/// // A cube drops onto another; 10 native frames, 1/24 s, between what was seen.
/// let cube = |z: f32| [0, 1, 2, 3, 4, 5, 6, 7].map(|i| {
///     let corner = |bit: i32| if i & bit == 0 { -0.2 } else { 0.2 };
///     Point3::new(corner(1), corner(2), z + corner(4))
/// });
/// let (low, before, now) = (cube(0.2), cube(0.9), cube(0.8));
/// let rubber = Physics { mass_kg: 0.5, friction: 0.8, restitution: 0.7 };
/// simulator.observe(10, &[rubber; 2], &[&low, &before], &[&low, &now])?;
/// for _ in 0..6 {
///     simulator.step()?;
/// }
/// let pose = simulator.pose(1).ok_or("no such unit")?; // carries `before` a quarter of a second ahead
/// let height = (pose * Point3::new(0.0, 0.0, 0.9)).z;
/// assert!(height > 0.3, "{height}: free fall would have it at 0.2 m, inside the other");
/// # Ok(())
/// # }
/// ```
pub struct Simulator<'m, 's, const UNITS: usize, K: Kernels = Portable, P: Projection = Rigid> {
    model: &'m Model<'m>,
    sizes: Sizes,
    limits: Limits,
    scene: Scene<'s, UNITS>,
    next: heapless::Vec<Pose, UNITS>,
    command: heapless::Vec<f32, MAX_COMMAND>,
    workspace: Workspace<'s>,
    kernels: K,
    projection: P,
}

impl<'m, 's, const UNITS: usize, K: Kernels, P: Projection> Simulator<'m, 's, UNITS, K, P> {
    /// Carves the workspace; the slabs may be longer than needed.
    ///
    /// # Errors
    /// [`WorkspaceError`] when a slab is too short, or the limits exceed `UNITS`.
    pub fn new(
        model: &'m Model<'m>,
        limits: Limits,
        slabs: Slabs<'s>,
    ) -> Result<Self, WorkspaceError>
    where
        K: Default,
    {
        Self::with_kernels(K::default(), model, limits, 1, slabs)
    }

    /// As [`new`](Self::new) with kernels that only some processors have, and room for `copies`
    /// (at least 1; without the feature `host` it is 1) of a scene within `limits`; the slabs are
    /// as long as [`SlabSizes::of`] says.
    ///
    /// # Errors
    /// As [`new`](Self::new).
    pub fn with_kernels(
        kernels: K,
        model: &'m Model<'m>,
        limits: Limits,
        copies: usize,
        slabs: Slabs<'s>,
    ) -> Result<Self, WorkspaceError> {
        let copies = if cfg!(rigidformer_host) { copies.max(1) } else { 1 };
        let needed = SlabSizes::of::<K>(model.config(), limits, copies);
        let units = limits.units.saturating_mul(copies);
        if units > UNITS {
            return Err(WorkspaceError::Units { limit: units, capacity: UNITS });
        }
        if slabs.f32.len() < needed.f32 {
            let found = slabs.f32.len();
            return Err(WorkspaceError::F32Slab { needed: needed.f32, found });
        }
        if slabs.i8.len() < needed.i8 {
            let found = slabs.i8.len();
            return Err(WorkspaceError::I8Slab { needed: needed.i8, found });
        }
        if slabs.points.len() < needed.points {
            let found = slabs.points.len();
            return Err(WorkspaceError::PointSlab { needed: needed.points, found });
        }
        let sizes = Sizes::new::<K>(model.config(), limits, copies);
        let (points, hulls) = slabs.points.split_at_mut(limits.points.min(slabs.points.len()));
        let hulls = if sizes.impacts == 0 { &mut [] } else { hulls };
        Ok(Simulator {
            model,
            sizes,
            limits,
            scene: Scene {
                units: heapless::Vec::new(),
                per_copy: 0,
                points,
                hulls,
                step: 1,
                dt: 0.0,
            },
            next: heapless::Vec::new(),
            command: heapless::Vec::new(),
            workspace: Workspace::carve::<K>(&sizes, slabs.f32, slabs.i8),
            kernels,
            projection: P::default(),
        })
    }

    /// Sets the command that conditions all following steps of all copies, for models that take
    /// one.
    ///
    /// # Errors
    /// [`CommandError`] when the size is not the model's `command_size` or a number is not
    /// finite; the previous command stays.
    pub fn set_command(&mut self, command: &[f32]) -> Result<(), CommandError> {
        self.check_command(command)?;
        self.command.clear();
        let _ = self.command.extend_from_slice(command);
        self.apply_command(0, command);
        let length = command_places(&self.sizes) * 2 * self.sizes.width;
        let (first, others) =
            self.workspace.commands.split_at_mut(length.min(self.workspace.commands.len()));
        for other in rows_mut(others, length) {
            copy(first, other);
        }
        Ok(())
    }

    fn check_command(&self, command: &[f32]) -> Result<(), CommandError> {
        let expected = self.sizes.command;
        if command.len() != expected {
            return Err(CommandError::Size { expected, found: command.len() });
        }
        match command.iter().position(|v| !v.is_finite()) {
            Some(index) => Err(CommandError::NotFinite { index }),
            None => Ok(()),
        }
    }

    fn apply_command(&mut self, copy: usize, command: &[f32]) {
        let networks = core::iter::once(&self.model.encoder.command)
            .chain(self.model.blocks.iter().map(|block| &block.command));
        let width = 2 * self.sizes.width;
        for (i, film) in networks.enumerate() {
            if let Some(film) = film {
                let place = copy * command_places(&self.sizes) + i;
                let out = part_mut(self.workspace.commands, place * width, width);
                film.mlp.apply(
                    self.kernels,
                    command,
                    self.workspace.film_hidden,
                    out,
                    &mut self.workspace.scratch,
                );
            }
        }
    }

    /// Starts from two frames of points, `step` native frames apart: `previous[i]` and
    /// `current[i]` are the same points of unit i (world frame, metres, in the same order).
    /// The previous frame becomes the reference frame of [`pose`](Self::pose), and its axes those of the box that
    /// stands for a unit's inertia in models with impacts: for long bodies that lie askew [`observe_poses`](Self::observe_poses)
    /// with points in the body's own frame tells more.
    ///
    /// # Errors
    /// [`ObserveError`] names what is wrong with the input; the scene is what it was.
    pub fn observe(
        &mut self,
        step: u32,
        physics: &[Physics],
        previous: &[&[Point3<f32>]],
        current: &[&[Point3<f32>]],
    ) -> Result<Observation, ObserveError> {
        if step == 0 {
            return Err(ObserveError::ZeroStep);
        }
        if previous.len() != current.len() || previous.len() != physics.len() {
            return Err(ObserveError::FrameMismatch {
                previous: previous.len(),
                current: current.len(),
                physics: physics.len(),
            });
        }
        let units = previous.iter().zip(physics);
        self.check_units(units.map(|(points, physics)| Unit { points, physics: *physics }))?;
        for (unit, (previous, current)) in previous.iter().zip(current).enumerate() {
            if previous.len() != current.len() {
                let (previous, current) = (previous.len(), current.len());
                return Err(ObserveError::PointMismatch { unit, previous, current });
            }
            check_points(unit, current)?;
            check_extent(unit, current)?;
        }
        self.begin(step);
        let mut observation = Observation::default();
        for ((previous, current), physics) in previous.iter().zip(current).zip(physics) {
            let pairs = previous.iter().zip(current.iter()).map(|(a, b)| (&a.coords, &b.coords));
            let fit = kabsch_f64(pairs.clone(), &Matrix3::identity());
            observation.residual_m = observation.residual_m.max(fit.residual(pairs));
            observation.degenerate_units += u32::from(fit.rank != Rank::Full);
            let unit = Unit { points: previous, physics: *physics };
            self.add_unit(&unit, |offset| {
                let first = Pose { rotation: Matrix3::identity(), centre: offset.coords };
                (first, fit.pose_at(&offset.coords))
            });
        }
        Ok(observation)
    }

    /// Starts from known poses, `step` native frames apart: each carries the unit's
    /// reference points to the world. Nothing is fitted, so the report is all zeros.
    ///
    /// # Errors
    /// [`ObserveError`] names what is wrong with the input; the scene is what it was.
    pub fn observe_poses(
        &mut self,
        step: u32,
        units: &[Unit<'_>],
        previous: &[Isometry3<f32>],
        current: &[Isometry3<f32>],
    ) -> Result<Observation, ObserveError> {
        if step == 0 {
            return Err(ObserveError::ZeroStep);
        }
        if previous.len() != current.len() || previous.len() != units.len() {
            return Err(ObserveError::FrameMismatch {
                previous: previous.len(),
                current: current.len(),
                physics: units.len(),
            });
        }
        self.check_units(units.iter().copied())?;
        for (unit, (previous, current)) in previous.iter().zip(current).enumerate() {
            check_pose(unit, previous)?;
            check_pose(unit, current)?;
        }
        self.begin(step);
        for (unit, (previous, current)) in units.iter().zip(previous.iter().zip(current)) {
            self.add_unit(unit, |offset| {
                (Pose::from_isometry(previous, offset), Pose::from_isometry(current, offset))
            });
        }
        Ok(Observation::default())
    }

    /// Advances the scene by one step. Models with the inputs `Impact` let no extreme point of a unit end it below the ground,
    /// or deeper than the unit was (docs/MODEL.md, section 7).
    ///
    /// # Errors
    /// [`StepError`]; the scene is what it was.
    pub fn step(&mut self) -> Result<StepReport, StepError> {
        self.step_traced(&mut NoTrace)
    }

    /// As [`step`](Self::step), showing every layer to `trace`.
    ///
    /// # Errors
    /// [`StepError`]; the scene is what it was.
    pub fn step_traced<T: Trace>(&mut self, trace: &mut T) -> Result<StepReport, StepError> {
        self.predict(trace)?;
        let mut report = StepReport::default();
        for copy in 0..self.scene.copies() {
            let copy = self.advance(copy, trace)?;
            report.active_units += copy.active_units;
            report.degenerate_units += copy.degenerate_units;
        }
        Ok(report)
    }

    /// Runs the network on the current scene; leaves its output in `workspace.head`.
    fn predict<T: Trace>(&mut self, trace: &mut T) -> Result<(), StepError> {
        let Self { model, sizes, scene, workspace, kernels, .. } = self;
        if scene.units.is_empty() {
            return Err(StepError::NotObserved);
        }
        if self.command.len() != sizes.command {
            return Err(StepError::NoCommand { size: sizes.command });
        }

        trace.enter(Stage::Encoder);
        encoder::encode(*kernels, model, sizes, scene, workspace, trace);
        trace.enter(Stage::Interaction);
        interaction::interact(*kernels, model, sizes, scene, workspace, trace);
        trace.enter(Stage::Anchors);
        anchors::predict(*kernels, model, sizes, scene, workspace, trace);
        trace.record(Layer::Head, 0, part(workspace.head, 0, scene.units.len() * ANCHORS * 3));

        trace.enter(Stage::Motion);
        Ok(())
    }

    /// Moves a copy as the network's output says, all of its units or none.
    fn advance<T: Trace>(&mut self, copy: usize, trace: &mut T) -> Result<StepReport, StepError> {
        let Self { model, scene, workspace, kernels, projection, .. } = self;
        let (first, count) = (copy * scene.per_copy, scene.per_copy);
        self.next.clear();
        let head: &[f32] = workspace.head;
        let report = if kernels.shares() && !trace.records() {
            for unit in scene.units.iter().skip(first).take(count) {
                let _ = self.next.push(unit.current);
            }
            let whole = Moves { first, next: &mut self.next };
            let run = |_: K, Moves { first: begin, next }: Moves<'_>| {
                let mut report = StepReport::default();
                for (index, next) in (begin..).zip(next) {
                    let fit = moved(model, scene, *projection, head, index, &mut NoTrace);
                    *next = fit
                        .map_err(|()| StepError::Diverged { unit: index - first })?
                        .add_to(&mut report);
                }
                Ok(report)
            };
            // Of two that fail, the first one's error.
            let merge = |a: Result<StepReport, StepError>, b: Result<StepReport, StepError>| {
                let (a, b) = (a?, b?);
                Ok(StepReport {
                    active_units: a.active_units + b.active_units,
                    degenerate_units: a.degenerate_units + b.degenerate_units,
                })
            };
            kernels.share(count * UNIT_COST, whole, &run, &merge)?
        } else {
            let mut report = StepReport::default();
            for index in first..first + count {
                let fit = moved(model, scene, *projection, head, index, trace);
                let pose = fit
                    .map_err(|()| StepError::Diverged { unit: index - first })?
                    .add_to(&mut report);
                let _ = self.next.push(pose);
            }
            report
        };
        // Swaps, because copies within one scene would be the only use of `memmove` in a firmware.
        let units = self.scene.units.iter_mut().skip(first);
        for (unit, next) in units.zip(&mut self.next) {
            core::mem::swap(&mut unit.previous, &mut unit.current);
            core::mem::swap(&mut unit.current, next);
        }
        Ok(report)
    }

    /// Units in the scene, or in each copy of it; 0 before an observation.
    pub fn len(&self) -> usize {
        self.scene.per_copy
    }

    /// Whether nothing was observed yet.
    pub fn is_empty(&self) -> bool {
        self.scene.units.is_empty()
    }

    /// Step code of the observation.
    pub fn step_code(&self) -> u32 {
        self.scene.step
    }

    /// Pose of a unit in the current frame: carries its reference points to the world. Unit `i`
    /// of copy `c` is unit `c * len() + i`.
    pub fn pose(&self, unit: usize) -> Option<Isometry3<f32>> {
        self.scene.units.get(unit).map(|unit| unit.current.isometry(&unit.offset))
    }

    /// As [`pose`](Self::pose), a step earlier.
    pub fn previous_pose(&self, unit: usize) -> Option<Isometry3<f32>> {
        self.scene.units.get(unit).map(|unit| unit.previous.isometry(&unit.offset))
    }

    /// Pose of a unit as rotation and centre of its internal frame: the bits that targets
    /// are compared by.
    pub fn internal_pose(&self, unit: usize) -> Option<Pose> {
        self.scene.units.get(unit).map(|unit| unit.current)
    }

    /// World positions of a unit's points in the current frame, metres, in the simulator's
    /// own (farthest-point) order.
    pub fn points(&self, unit: usize) -> impl Iterator<Item = Point3<f32>> + '_ {
        let unit = self.scene.units.get(unit);
        unit.into_iter().flat_map(|unit| {
            let local = self.scene.points_of(unit).iter();
            local.map(|point| Point3::from(unit.current.apply(&point.coords)))
        })
    }

    fn check_units<'u>(
        &self,
        units: impl ExactSizeIterator<Item = Unit<'u>>,
    ) -> Result<(), ObserveError> {
        if units.len() == 0 {
            return Err(ObserveError::NoUnits);
        }
        if units.len() > self.limits.units {
            let (found, limit) = (units.len(), self.limits.units);
            return Err(ObserveError::TooManyUnits { found, limit });
        }
        let mut total = 0_usize;
        for (unit, Unit { points, physics }) in units.enumerate() {
            if points.len() < ANCHORS {
                return Err(ObserveError::TooFewPoints { unit, found: points.len() });
            }
            check_points(unit, points)?;
            check_extent(unit, points)?;
            if !physics.is_sound() {
                return Err(ObserveError::BadPhysics { unit });
            }
            total = total.saturating_add(points.len());
        }
        if total > self.limits.points {
            return Err(ObserveError::TooManyPoints { found: total, limit: self.limits.points });
        }
        Ok(())
    }

    /// From here on an observation cannot fail.
    fn begin(&mut self, step: u32) {
        self.scene.units.clear();
        self.scene.per_copy = 0;
        self.scene.step = step;
        self.scene.dt = step as f32 / self.model.config().frame_rate_hz;
        let code = step as f32 / 10.0;
        let condition = [code, code * code];
        let films = core::iter::once(&self.model.encoder.film)
            .chain(self.model.blocks.iter().map(|block| &block.film))
            .chain(core::iter::once(&self.model.anchors.film));
        let width = 2 * self.sizes.width;
        for (i, film) in films.enumerate() {
            let out = part_mut(self.workspace.films, i * width, width);
            film.mlp.apply(
                self.kernels,
                &condition,
                self.workspace.film_hidden,
                out,
                &mut self.workspace.scratch,
            );
        }
    }

    /// `poses` gives the previous and the current pose of the unit's centre, which lies at
    /// its argument in the reference frame.
    fn add_unit(&mut self, unit: &Unit<'_>, poses: impl FnOnce(&Point3<f32>) -> (Pose, Pose)) {
        let start = self.scene.units.last().map_or(0, |last| last.start + last.count);
        let count = unit.points.len();
        let slab = self.scene.points.get_mut(start..start + count).unwrap_or_default();
        for (slot, point) in slab.iter_mut().zip(unit.points) {
            *slot = *point;
        }
        let offset = centre_of_mass(slab);
        // Not the index behind it: the order fills all that it gets.
        let scratch = match K::INDEX {
            true => part_mut(self.workspace.distance, 0, count),
            false => &mut *self.workspace.distance,
        };
        farthest_point_order(slab, &offset, scratch);
        for point in slab.iter_mut() {
            *point = Point3::from(*point - offset);
        }
        let inertia_m2 = impacts::box_inertia(slab);
        let hull = match self.scene.hulls.get_mut(start..start + count) {
            // The weights' place is free as scratch: they are filled below.
            Some(hull) => {
                let marks = part_mut(self.workspace.avp_weights, start * ANCHORS, count);
                extreme_points(slab, marks, hull)
            }
            None => 0,
        };
        let (first, current) = poses(&offset);
        let state = UnitState {
            start,
            count,
            physics: unit.physics,
            ln_mass: math::ln(unit.physics.mass_kg),
            radius: radius(slab),
            offset,
            hull,
            inertia_m2,
            first,
            previous: first,
            current,
        };
        if K::INDEX {
            let mut index = Parts::new(self.workspace.distance, &self.sizes.room());
            index.add(self.scene.units.len(), start, slab);
        }
        let weights = part_mut(self.workspace.avp_weights, start * ANCHORS, count * ANCHORS);
        anchors::pooling_weights(&self.scene, &state, self.model.anchors.sigma_m, weights);
        // The number of units was checked.
        let _ = self.scene.units.push(state);
        self.scene.per_copy += 1;
    }
}

/// Where units go: poses of those from `first` on.
struct Moves<'a> {
    first: usize,
    next: &'a mut [Pose],
}

impl Divisible for Moves<'_> {
    fn split(self, left: usize, of: usize) -> [Self; 2] {
        let count = self.next.len() * left / of;
        let (next, others) = self.next.split_at_mut(count);
        [Moves { first: self.first, next }, Moves { first: self.first + count, next: others }]
    }
}

/// Where a unit goes.
struct Moved {
    pose: Pose,
    active: bool,
    degenerate: bool,
}

impl Moved {
    fn add_to(self, report: &mut StepReport) -> Pose {
        report.active_units += u32::from(self.active);
        report.degenerate_units += u32::from(self.degenerate);
        self.pose
    }
}

/// Moves a unit as `head` (units, anchors, 3) says; an error where that is nowhere.
fn moved<P: Projection, T: Trace, const UNITS: usize>(
    model: &Model<'_>,
    scene: &Scene<'_, UNITS>,
    projection: P,
    head: &[f32],
    index: usize,
    trace: &mut T,
) -> Result<Moved, ()> {
    let unit = scene.units.get(index).ok_or(())?;
    let out = part(head, index * ANCHORS * 3, ANCHORS * 3);
    let (advanced, active) = motion::advance(model.config(), scene, index, unit, out);
    trace.record(Layer::Advanced, index, advanced.map(|a| [a.x, a.y, a.z]).as_flattened());
    let reference = scene.anchors_of(unit);
    let fit = projection.project(&reference, &advanced, &unit.current);
    if !finite(&advanced) || !fit.pose.is_sound(MAX_COORDINATE_M) {
        return Err(());
    }
    let pose = motion::above_ground(scene, unit, fit.pose);
    Ok(Moved { pose, active, degenerate: fit.rank != Rank::Full })
}

fn check_pose(unit: usize, pose: &Isometry3<f32>) -> Result<(), ObserveError> {
    if copies::is_sound(pose) { Ok(()) } else { Err(ObserveError::BadPose { unit }) }
}

fn check_points(unit: usize, points: &[Point3<f32>]) -> Result<(), ObserveError> {
    // A NaN compares as not within the limit.
    let bad = |p: &Point3<f32>| !p.iter().all(|v| v.abs() <= MAX_COORDINATE_M);
    match points.iter().position(bad) {
        Some(point) => Err(ObserveError::BadPoint { unit, point }),
        None => Ok(()),
    }
}

fn check_extent(unit: usize, points: &[Point3<f32>]) -> Result<(), ObserveError> {
    let first = points.first().copied().unwrap_or_else(Point3::origin);
    if points.iter().all(|p| norm(&(p - first)) < MIN_EXTENT_M) {
        return Err(ObserveError::Coincident { unit });
    }
    Ok(())
}

fn finite(anchors: &[Vector3<f32>; ANCHORS]) -> bool {
    anchors.iter().all(|a| a.iter().all(|v| v.is_finite()))
}
