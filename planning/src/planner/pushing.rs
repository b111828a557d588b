//! Pushing: a driven unit, the pusher, brings a free unit, the body, to a goal on a plane z = const.
//!
//! A [`Push`] is a straight line of the pusher: heading, offset from the body's centre, and length after contact. [`PushPlanner`] samples
//! pushes, predicts them with the model (or with another [`Predictor`]), and plans again at each observation. It tries the rest of the last
//! push first. The pusher goes around the body without contact, so this approach is not predicted.

mod path;

use std::borrow::Cow;
use std::convert::Infallible;
use std::ops::ControlFlow;
use std::sync::atomic::{AtomicBool, Ordering};

use nalgebra::{Isometry3, Point3, Translation3, Vector2, Vector3};
use rigidformer_core::kernels::in_own_environment;
use rigidformer_core::{MAX_COORDINATE_M, Plane, Posed, Role, Unit, math};
use rigidformer_runtime::futures::{
    BatchError, BatchSimulator, ChangeError, End, FutureScene, Start, Variation,
};
use rigidformer_runtime::poses;

use super::{
    Control, Cut, Method, Parameter, Plan, PlanError, Planner, Settings, SettingsError, cut,
};
use path::{MAX_STEPS, Outline};

/// The unit that is pushed, among the units of a prediction.
const BODY: usize = 0;
/// The unit that pushes.
const PUSHER: usize = 1;
/// Heading, offset, length.
const PARAMETERS: usize = 3;

/// What a plan starts from: two poses of body and pusher, a step of the predictions apart.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Observation {
    /// Where the body was a step ago.
    pub body_before: Isometry3<f32>,
    /// Where the body is.
    pub body: Isometry3<f32>,
    /// Where the pusher was a step ago.
    pub pusher_before: Isometry3<f32>,
    /// Where the pusher is. It keeps its height and rotation.
    pub pusher: Isometry3<f32>,
}

impl Observation {
    fn check(&self) -> Result<(), SettingsError> {
        let seen = [
            ("the body's previous pose", &self.body_before),
            ("the body's pose", &self.body),
            ("the pusher's previous pose", &self.pusher_before),
            ("the pusher's pose", &self.pusher),
        ];
        for (what, pose) in seen {
            let mut numbers = pose.translation.vector.iter().chain(pose.rotation.coords.iter());
            if let Some(&found) = numbers.find(|number| !is_coordinate(**number)) {
                return Err(SettingsError::Range { what, found, range: COORDINATE_RANGE });
            }
        }
        Ok(())
    }
}

/// Whether a number is one that coordinates may be.
fn is_coordinate(number: f32) -> bool {
    number.abs() <= MAX_COORDINATE_M
}

/// Range of coordinates, in errors.
const COORDINATE_RANGE: &str = "of numbers up to 1e6";

/// What pushes and is pushed, and how the pusher moves.
#[derive(Clone, Debug)]
pub struct Pushing<'p> {
    /// (points) of the body, in its own frame, metres. Its outline on the ground is their convex hull.
    pub body: Cow<'p, [Point3<f32>]>,
    /// Of the pusher, metres: its outline is a circle about its frame's origin.
    pub radius_m: f32,
    /// Seconds between two positions of a path, and between the two poses of an [`Observation`].
    pub step_s: f32,
    /// While the pusher pushes, m/s.
    pub push_m_s: f32,
    /// On its way around the body, m/s.
    pub travel_m_s: f32,
    /// Least clearance to the body on the way around it, metres.
    pub room_m: f32,
    /// The longest push after touching, metres.
    pub longest_m: f32,
    /// Seconds that a prediction goes on after the pusher has stopped.
    pub settle_s: f32,
}

impl<'p> Pushing<'p> {
    /// Of a body and a round pusher, in steps of 1/60 s: pushes of up to 0.12 m at 0.2 m/s, ways around the body at
    /// 0.4 m/s with 8 mm of room, and 0.05 s to settle.
    pub fn new(body: impl Into<Cow<'p, [Point3<f32>]>>, radius_m: f32) -> Self {
        Pushing {
            body: body.into(),
            radius_m,
            step_s: 1.0 / 60.0,
            push_m_s: 0.2,
            travel_m_s: 0.4,
            room_m: 0.008,
            longest_m: 0.12,
            settle_s: 0.05,
        }
    }

    fn check(&self) -> Result<(), SettingsError> {
        let above = [
            ("radius_m", self.radius_m),
            ("step_s", self.step_s),
            ("push_m_s", self.push_m_s),
            ("travel_m_s", self.travel_m_s),
            ("room_m", self.room_m),
        ];
        for (what, found) in above {
            if !(found.is_finite() && found > 0.0) {
                return Err(SettingsError::Range { what, found, range: "finite and above 0" });
            }
        }
        let (what, range) = ("longest_m", "finite and at least 0.002");
        if !(self.longest_m.is_finite() && self.longest_m >= MIN_LENGTH_M) {
            return Err(SettingsError::Range { what, found: self.longest_m, range });
        }
        let (what, range) = ("settle_s", "finite and at least 0");
        if !(self.settle_s.is_finite() && self.settle_s >= 0.0) {
            return Err(SettingsError::Range { what, found: self.settle_s, range });
        }
        Ok(())
    }

    /// Steps of the longest prediction, about.
    fn predicted_steps(&self) -> f32 {
        let push = self.longest_m / (self.push_m_s * self.step_s) + AT_HAND_STEPS;
        push + (self.settle_s / self.step_s).round()
    }

    /// Steps to settle.
    fn settle_steps(&self) -> usize {
        (self.settle_s / self.step_s).round() as usize
    }
}

/// Steps of all predictions of an iteration, at most.
// They take 32 MiB of positions, and seven times as much of poses of two units.
const MAX_PREDICTED_STEPS: f32 = (1 << 22) as f32;
/// The shortest push, metres.
const MIN_LENGTH_M: f32 = 0.002;

/// A straight push.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Push {
    /// Which way, radians from x towards y.
    pub heading_rad: f32,
    /// How far to the left of the body's centre (its frame's origin) the line passes, metres.
    pub offset_m: f32,
    /// How far the pusher goes on after touching, metres.
    pub length_m: f32,
}

impl Push {
    fn of(parameters: &[f32]) -> Push {
        let at = |index: usize| parameters.get(index).copied().unwrap_or_default();
        Push { heading_rad: at(0), offset_m: at(1), length_m: at(2) }
    }

    fn parameters(&self) -> [f32; PARAMETERS] {
        [self.heading_rad, self.offset_m, self.length_m]
    }

    fn way(&self) -> Vector2<f32> {
        let (sin, cos) = math::sin_cos(wrapped(self.heading_rad));
        Vector2::new(cos, sin)
    }
}

/// The same angle from -pi to pi.
fn wrapped(angle: f32) -> f32 {
    let turns = (angle / std::f32::consts::TAU).round();
    angle - turns * std::f32::consts::TAU
}

/// Which way a body's x axis points over the ground, radians from x towards y.
pub fn yaw_rad(pose: &Isometry3<f32>) -> f32 {
    let x = pose.rotation * Vector3::x();
    x.y.atan2(x.x)
}

/// The goal of a body.
///
/// Its [`cost`](Self::cost) is a distance in metres, where a rotation counts as [`lever_m`](Self::lever_m) times its angle,
/// and the time of the push as [`haste_m_s`](Self::haste_m_s) a second.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Goal {
    /// Metres.
    pub place_m: [f32; 2],
    /// Radians from x towards y.
    pub yaw_rad: f32,
    /// Metres that a radian is worth.
    pub lever_m: f32,
    /// Metres that a second is worth.
    pub haste_m_s: f32,
}

impl Goal {
    /// A place and a yaw; a radian is worth 0.1 m, a second 5 mm.
    pub fn new(place_m: [f32; 2], yaw_rad: f32) -> Self {
        Goal { place_m, yaw_rad, lever_m: 0.1, haste_m_s: 0.005 }
    }

    /// Whether it is a goal: place and yaw within 1e6, lever and haste finite and at least 0.
    ///
    /// # Errors
    /// [`SettingsError`] says what is out of range.
    pub fn check(&self) -> Result<(), SettingsError> {
        let [x, y] = self.place_m;
        for (what, found) in [("place_m", x), ("place_m", y), ("yaw_rad", self.yaw_rad)] {
            if !is_coordinate(found) {
                return Err(SettingsError::Range { what, found, range: COORDINATE_RANGE });
            }
        }
        for (what, found) in [("lever_m", self.lever_m), ("haste_m_s", self.haste_m_s)] {
            if !(found.is_finite() && found >= 0.0) {
                let range = "finite and at least 0";
                return Err(SettingsError::Range { what, found, range });
            }
        }
        Ok(())
    }

    /// How far a body is from its place, metres, and from its yaw, radians.
    pub fn errors(&self, pose: &Isometry3<f32>) -> (f32, f32) {
        let away = pose.translation.vector.xy() - Vector2::from(self.place_m);
        (away.norm(), wrapped(yaw_rad(pose) - self.yaw_rad).abs())
    }

    /// Both errors as one distance, metres.
    pub fn distance_m(&self, pose: &Isometry3<f32>) -> f32 {
        let (away, turned) = self.errors(pose);
        let turned = turned * self.lever_m;
        (away * away + turned * turned).sqrt()
    }

    /// What a push costs that ends so.
    pub fn cost(&self, pushed: &Pushed<'_>) -> f32 {
        self.distance_m(pushed.last()) + self.haste_m_s * pushed.seconds
    }
}

/// A push, and what became of the body.
#[derive(Clone, Copy, Debug)]
pub struct Pushed<'p> {
    /// What was tried.
    pub push: Push,
    /// Seconds that the whole path takes, with the way around the body.
    pub seconds: f32,
    /// Where the body is before it.
    pub before: &'p Isometry3<f32>,
    /// (steps) Where the body is after each step from the path's predicted part; none where nothing was predicted.
    pub poses: &'p [Isometry3<f32>],
}

impl<'p> Pushed<'p> {
    /// Where the body is at the end.
    pub fn last(&self) -> &'p Isometry3<f32> {
        self.poses.last().unwrap_or(self.before)
    }
}

/// A path of the pusher whose effect is to be predicted.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Stroke {
    /// Where the pusher is when the prediction begins, metres. It may be elsewhere now.
    pub from_m: [f32; 2],
    /// Whether it is there now, with its observed velocity. Otherwise it begins at rest.
    pub at_hand: bool,
    /// Where it is after each step, metres.
    pub places_m: Vec<[f32; 2]>,
}

/// Predicts the body's motion under strokes.
pub trait Predictor {
    /// Why it cannot.
    type Error;

    /// Appends to `out` for each stroke, in order, the body's poses after each step; none for a stroke that cannot be
    /// predicted, fewer strokes only where `cut` says that it is time to end.
    ///
    /// # Errors
    /// Where nothing can be predicted.
    fn predict(
        &mut self,
        observation: &Observation,
        strokes: &[Stroke],
        cut: &(dyn Fn() -> Option<Cut> + Sync),
        out: &mut Vec<Vec<Isometry3<f32>>>,
    ) -> Result<(), Self::Error>;
}

/// Predicts with the model.
#[derive(Clone)]
pub struct ModelPredictor<'p> {
    /// Futures of the model.
    pub simulator: BatchSimulator,
    /// What is pushed.
    pub body: Unit<'p>,
    /// What pushes; its role is [`Role::Driven`] whatever it says.
    pub pusher: Unit<'p>,
    /// Planes; the model's ground where there are none given.
    pub planes: Option<&'p [Plane]>,
    /// Gravity, m/s²; the model's where there is none given.
    pub gravity_m_s2: Option<Vector3<f32>>,
    /// Seconds of a step.
    pub step_s: f32,
}

impl Predictor for ModelPredictor<'_> {
    type Error = BatchError;

    fn predict(
        &mut self,
        observation: &Observation,
        strokes: &[Stroke],
        cut: &(dyn Fn() -> Option<Cut> + Sync),
        out: &mut Vec<Vec<Isometry3<f32>>>,
    ) -> Result<(), BatchError> {
        let units = [
            Posed { unit: self.body, previous: observation.body_before, current: observation.body },
            Posed {
                unit: self.pusher.role(Role::Driven),
                previous: observation.pusher_before,
                current: observation.pusher,
            },
        ];
        let start = Start {
            dt_s: self.step_s,
            units: &units,
            planes: self.planes,
            gravity_m_s2: self.gravity_m_s2,
            ..Start::default()
        };
        let steps = strokes.iter().map(|stroke| stroke.places_m.len()).max().unwrap_or(0).max(1);
        let row = steps * units.len();
        let mut poses = vec![Isometry3::identity(); strokes.len() * row];
        let is_late = (0..strokes.len()).map(|_| AtomicBool::new(false)).collect();
        let driven = Drive { strokes, pusher: observation.pusher, cut, is_late };
        let outcomes = self.simulator.run(&start, steps, &driven, &mut poses)?;
        for (index, (stroke, outcome)) in strokes.iter().zip(&outcomes).enumerate() {
            // Strokes behind a late one may be incomplete too, and the order of costs must hold.
            if driven.is_late[index].load(Ordering::Relaxed) || outcome.end == End::Cut {
                break;
            }
            let ended = !matches!(outcome.end, End::Failed(_) | End::Refused(_));
            let taken = if ended { stroke.places_m.len().min(outcome.steps) } else { 0 };
            let path = poses[index * row..][..taken * units.len()].iter();
            out.push(path.skip(BODY).step_by(units.len()).copied().collect());
        }
        Ok(())
    }
}

/// Futures in which the pusher goes along strokes.
struct Drive<'d> {
    strokes: &'d [Stroke],
    /// Its present height and rotation hold.
    pusher: Isometry3<f32>,
    cut: &'d (dyn Fn() -> Option<Cut> + Sync),
    /// (strokes) Whether the deadline ended it.
    is_late: Vec<AtomicBool>,
}

impl Drive<'_> {
    fn at(&self, [x, y]: [f32; 2]) -> Isometry3<f32> {
        let position = Translation3::new(x, y, self.pusher.translation.z);
        Isometry3::from_parts(position, self.pusher.rotation)
    }
}

impl Variation for Drive<'_> {
    fn begin(&self, future: usize, scene: &mut FutureScene<'_>) -> Result<(), ChangeError> {
        let stroke = &self.strokes[future];
        // The approach is not predicted, so the prediction begins at its end, at rest.
        if !stroke.at_hand {
            let begin = self.at(stroke.from_m);
            scene.set_poses(PUSHER, &begin, &begin)?;
        }
        Ok(())
    }

    fn steer(
        &self,
        future: usize,
        step: usize,
        scene: &mut FutureScene<'_>,
    ) -> Result<(), ChangeError> {
        match self.strokes[future].places_m.get(step) {
            Some(position) => scene.drive(PUSHER, &self.at(*position)),
            None => Ok(()),
        }
    }

    fn is_cut(&self) -> bool {
        (self.cut)().is_some()
    }

    fn watch(&self, future: usize, step: usize, _: &[Isometry3<f32>]) -> ControlFlow<()> {
        if step + 1 >= self.strokes[future].places_m.len() {
            return ControlFlow::Break(());
        }
        if (self.cut)().is_some() {
            self.is_late[future].store(true, Ordering::Relaxed);
            return ControlFlow::Break(());
        }
        ControlFlow::Continue(())
    }
}

/// The baseline without contact: the body keeps its observed motion, through pusher and ground.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct FreeMotion {
    /// Gravity, m/s².
    pub gravity_m_s2: Vector3<f32>,
    /// Seconds of a step.
    pub step_s: f32,
}

impl Predictor for FreeMotion {
    type Error = Infallible;

    fn predict(
        &mut self,
        observation: &Observation,
        strokes: &[Stroke],
        _: &(dyn Fn() -> Option<Cut> + Sync),
        out: &mut Vec<Vec<Isometry3<f32>>>,
    ) -> Result<(), Infallible> {
        let (before, now, step_s) =
            (&observation.body_before, &observation.body, f64::from(self.step_s));
        let after =
            |gaps: usize| poses::free_fall(before, now, &self.gravity_m_s2, step_s, gaps as f64);
        out.extend(strokes.iter().map(|stroke| (1..=stroke.places_m.len()).map(after).collect()));
        Ok(())
    }
}

/// How a [`PushPlanner`] searches.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PushSettings {
    /// How the next iteration follows from the last.
    pub method: Method,
    /// Pushes an iteration.
    pub futures: usize,
    /// At least 1.
    pub iterations: usize,
    /// Another seed, other samples.
    pub seed: u64,
    /// Deviation of headings, radians.
    pub heading_rad: f32,
    /// Deviation of offsets, relative to the outline's greatest distance from the body's centre.
    pub offset: f32,
    /// Deviation of lengths, metres.
    pub length_m: f32,
}

impl PushSettings {
    fn check(&self) -> Result<(), SettingsError> {
        let deviations = [
            ("heading_rad", self.heading_rad),
            ("offset", self.offset),
            ("length_m", self.length_m),
        ];
        for (what, found) in deviations {
            if !(found.is_finite() && found >= 0.0) {
                let range = "a deviation, finite and at least 0";
                return Err(SettingsError::Range { what, found, range });
            }
        }
        Ok(())
    }
}

impl Default for PushSettings {
    /// Two iterations of 8 pushes with MPPI at so low a temperature that about the best counts.
    fn default() -> Self {
        PushSettings {
            method: Method::Mppi { temperature: 0.002, narrowing: 0.5 },
            futures: 8,
            iterations: 2,
            seed: 1,
            heading_rad: 0.25,
            offset: 0.25,
            length_m: 0.03,
        }
    }
}

/// What to do next.
#[derive(Clone, Debug, PartialEq)]
pub struct PushPlan {
    /// The best push.
    pub push: Push,
    /// Its cost.
    pub cost: f32,
    /// The cost of leaving the body where it is.
    pub stay: f32,
    /// (steps) where the pusher is after each, metres: around the body, then the push.
    pub path_m: Vec<[f32; 2]>,
    /// So many of them lead around the body.
    pub approach: usize,
    /// (steps) Predicted poses of the body, from `path_m[approach]` on and while it settles.
    pub poses: Vec<Isometry3<f32>>,
    /// The plan of the search.
    pub search: Plan,
}

/// Why a push cannot be planned.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum PushError<E> {
    /// The predictor failed.
    #[error(transparent)]
    Predictor(E),
    /// The search has no plan.
    #[error("{0}")]
    Plan(PlanError),
    /// A number is out of range, such as a pose that is not finite.
    #[error(transparent)]
    Settings(SettingsError),
    /// Every path is too long, or its steps are less than what coordinates resolve there.
    #[error(
        "no push gets to the body in {steps} steps of the pusher; bring the two nearer to each other or to the origin, or \
         raise step_s, push_m_s or travel_m_s"
    )]
    Unreachable {
        /// Of a path, at most.
        steps: usize,
    },
    /// The body has no outline.
    #[error(
        "the body's outline on the ground has {corners} corners; give points that enclose an area"
    )]
    Outline {
        /// Of the hull of its points, seen from above.
        corners: usize,
    },
}

impl<E> From<PlanError> for PushError<E> {
    fn from(error: PlanError) -> Self {
        PushError::Plan(error)
    }
}

/// Plans pushes, one observation after the other.
///
/// The model plans a push of a cube by 6 cm to the left:
///
/// ```
/// use nalgebra::{Isometry3, Point3};
/// use rigidformer_runtime::core::{Physics, Plane, Unit};
/// use rigidformer_runtime::futures::BatchSimulator;
/// use rigidformer_planning::planner::pushing::{Goal, ModelPredictor, Observation, PushPlanner, PushSettings, Pushed, Pushing};
/// use rigidformer_planning::planner::Control;
/// use rigidformer_runtime::engine::Engine;
/// use rigidformer_runtime::models::LoadedModel;
///
/// let model = LoadedModel::embedded("edge", rigidformer_weights::EDGE)?;
/// let box_of = |half: f32| -> Vec<Point3<f32>> {
///     let side = |i: usize, bit| if i & bit == 0 { -half } else { half };
///     (0..8).map(|i| Point3::new(side(i, 1), side(i, 2), side(i, 4))).collect()
/// };
/// let (cube, stick) = (box_of(0.025), box_of(0.01));
/// let physics = Physics { mass_kg: 0.1, friction: 0.5, restitution: 0.0 };
/// let ground = [Plane::ground(1.0, 0.0)];
/// let mut predictor = ModelPredictor {
///     simulator: BatchSimulator::new(Engine::new()?, &model),
///     body: Unit::new(&cube, physics),
///     pusher: Unit::new(&stick, physics),
///     planes: Some(&ground),
///     gravity_m_s2: None,
///     step_s: 1.0 / 60.0,
/// };
/// let (body, pusher) = (Isometry3::translation(0.0, 0.0, 0.025), Isometry3::translation(0.1, 0.0, 0.02));
/// let observation = Observation { body_before: body, body, pusher_before: pusher, pusher };
/// let goal = Goal::new([-0.06, 0.0], 0.0);
/// let settings = PushSettings { futures: 8, iterations: 1, ..PushSettings::default() };
/// let mut planner = PushPlanner::new(settings, Pushing::new(&cube, 0.01))?;
/// let cost = |pushed: &Pushed<'_>| goal.cost(pushed);
/// let plan = planner.plan(&observation, &mut predictor, &goal, &cost, Control::none(&mut |_| {}))?;
/// assert!(plan.cost < plan.stay && plan.poses.last().is_some_and(|pose| pose.translation.x < -0.02));
/// planner.passed(&plan, plan.path_m.len() / 2); // then observe and plan again
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
#[derive(Clone, Debug)]
pub struct PushPlanner<'p> {
    pushing: Pushing<'p>,
    planner: Planner,
    /// Greatest offset of a push, metres.
    max_offset_m: f32,
    remaining: Option<RemainingPush>,
}

/// The rest of a plan.
#[derive(Clone, Copy, Debug, PartialEq)]
struct RemainingPush {
    push: Push,
    /// The pusher is past the approach: the line goes through where it is.
    pushing: bool,
}

impl<'p> PushPlanner<'p> {
    /// A planner for one body and one pusher.
    ///
    /// # Errors
    /// [`SettingsError`] says what is out of range.
    pub fn new(settings: PushSettings, pushing: Pushing<'p>) -> Result<Self, SettingsError> {
        pushing.check()?;
        settings.check()?;
        let found = settings.futures as f32 * pushing.predicted_steps();
        if found.is_nan() || found > MAX_PREDICTED_STEPS {
            let what = "futures, times the steps of the longest push and of settling,";
            return Err(SettingsError::Range { what, found, range: "at most 4194304" });
        }
        let reach_m = Outline::new(&pushing.body, &Isometry3::identity()).reach_m();
        let max_offset_m = MAX_OFFSET * reach_m;
        let parameters = [
            Parameter::new(0.0, settings.heading_rad),
            Parameter::new(0.0, settings.offset * reach_m).within(-max_offset_m, max_offset_m),
            Parameter::new(MIN_LENGTH_M, settings.length_m).within(MIN_LENGTH_M, pushing.longest_m),
        ];
        let search = Settings {
            method: settings.method,
            futures: settings.futures,
            iterations: settings.iterations,
            steps: 1,
            seed: settings.seed,
        };
        let planner = Planner::new(search, &parameters)?;
        Ok(PushPlanner { pushing, planner, max_offset_m, remaining: None })
    }

    /// Searches for the push of least cost. It tries the rest of the last plan first, then pushes on each side of the body, in the middle
    /// and beside it, about as long as the distance to the goal. The same calls in the same order, with the same observations, seed and
    /// predictions, give the same plans, to the bit, unless one is cut. The deadline is checked before each push; the costs of pushes that
    /// are predicted by then still count.
    ///
    /// # Errors
    /// [`PushError`]
    pub fn plan<P: Predictor>(
        &mut self,
        observation: &Observation,
        predictor: &mut P,
        goal: &Goal,
        cost: &dyn Fn(&Pushed<'_>) -> f32,
        control: Control<'_>,
    ) -> Result<PushPlan, PushError<P::Error>> {
        in_own_environment(|| self.plan_here(observation, predictor, goal, cost, control))
    }

    fn plan_here<P: Predictor>(
        &mut self,
        observation: &Observation,
        predictor: &mut P,
        goal: &Goal,
        cost: &dyn Fn(&Pushed<'_>) -> f32,
        control: Control<'_>,
    ) -> Result<PushPlan, PushError<P::Error>> {
        observation.check().map_err(PushError::Settings)?;
        goal.check().map_err(PushError::Settings)?;
        let outline = Outline::new(&self.pushing.body, &observation.body);
        // A degenerate outline has no sides to push.
        if outline.corners() < 3 {
            return Err(PushError::Outline { corners: outline.corners() });
        }
        let first = self.propose(&outline, observation, goal);
        self.planner.set_mean(&first.parameters()).map_err(PushError::Settings)?;
        let (pushing, deadline, cancelled) = (&self.pushing, control.deadline, control.cancelled);
        let stop = move || cut(deadline, cancelled);
        let mut best: Option<(f32, Vec<Isometry3<f32>>)> = None;
        let mut reached = false;
        let search = self.planner.plan_by(control, |samples, costs| {
            // A part after the other: one that is cut costs no more than its own, and a deadline finds the parts before it complete.
            let mut size = FIRST_PART;
            while costs.len() * PARAMETERS < samples.len() {
                let before = costs.len();
                let rest = &samples[before * PARAMETERS..];
                let part = &rest[..rest.len().min(size * PARAMETERS)];
                size = (2 * size).min(LARGEST_PART);
                let mut paths: Vec<PusherPath> = Vec::new();
                for sample in part.chunks_exact(PARAMETERS) {
                    if before + paths.len() > 0 && stop().is_some() {
                        break;
                    }
                    paths.push(PusherPath::new(pushing, &outline, observation, Push::of(sample)));
                }
                // An error tells unreachable bodies from costs that are not finite.
                reached |= paths.iter().any(|path| path.touches);
                let strokes: Vec<Stroke> = paths.iter().map(|path| path.stroke(pushing)).collect();
                let mut found = Vec::with_capacity(strokes.len());
                predictor
                    .predict(observation, &strokes, &stop, &mut found)
                    .map_err(PushError::Predictor)?;
                for (path, poses) in paths.iter().zip(found) {
                    let cost = path.cost(pushing, observation, &poses, cost);
                    costs.push(cost);
                    if cost.is_finite() && best.as_ref().is_none_or(|(least, _)| cost < *least) {
                        best = Some((cost, poses));
                    }
                }
                if (costs.len() - before) * PARAMETERS < part.len() {
                    break;
                }
            }
            Ok::<_, PushError<P::Error>>(
                stop().filter(|_| costs.len() * PARAMETERS < samples.len()),
            )
        });
        let search = search.map_err(|error| match error {
            PushError::Plan(PlanError::NoneUsable { .. }) if !reached => {
                PushError::Unreachable { steps: MAX_STEPS }
            }
            other => other,
        })?;
        let push = Push::of(&search.best);
        let path = PusherPath::new(pushing, &outline, observation, push);
        let approach = path.approach;
        let staying =
            Pushed { push: Push::default(), seconds: 0.0, before: &observation.body, poses: &[] };
        let stay = cost(&staying);
        let poses = best.map(|(_, poses)| poses).unwrap_or_default();
        Ok(PushPlan {
            push,
            cost: search.cost,
            stay,
            path_m: path.positions(pushing, observation),
            approach,
            poses,
            search,
        })
    }

    /// Reports that `steps` steps of a plan's path are done: the next plan begins with the rest.
    pub fn passed(&mut self, plan: &PushPlan, steps: usize) {
        let Pushing { push_m_s, step_s, .. } = self.pushing;
        let pushed = steps.saturating_sub(plan.approach) as f32 * push_m_s * step_s;
        // The gap before contact is part of the path, and not of the push's length.
        let length_m = plan.push.length_m - (pushed - self.gap_m()).max(0.0);
        self.remaining =
            (steps < plan.path_m.len() && length_m > MIN_LENGTH_M).then_some(RemainingPush {
                push: Push { length_m, ..plan.push },
                pushing: steps > plan.approach,
            });
    }

    /// Forgets the last plan.
    pub fn forget(&mut self) {
        self.remaining = None;
    }

    fn gap_m(&self) -> f32 {
        GAP_STEPS * self.pushing.push_m_s * self.pushing.step_s
    }

    /// Proposes pushes, the most promising first, and returns the first to try.
    fn propose(&mut self, outline: &Outline, observation: &Observation, goal: &Goal) -> Push {
        let here = observation.body.translation.vector.xy();
        let to = Vector2::from(goal.place_m) - here;
        let turn = wrapped(goal.yaw_rad - yaw_rad(&observation.body));
        let (reach, longest) = (outline.reach_m(), self.pushing.longest_m);
        let max_offset = self.max_offset_m;
        // Approximate gain towards the goal, and the push.
        let mut pushes: Vec<(f32, Push)> = Vec::new();
        for (middle, along) in outline.sides().into_iter().take(MAX_SIDES) {
            let way = path::left_of(along).normalize();
            let heading_rad = way.y.atan2(way.x);
            for side_offset in [0.0, -SIDE_OFFSET, SIDE_OFFSET] {
                let offset_m = path::cross(way, middle) + side_offset * along.norm();
                // A push left of the centre turns the body right.
                let rotation_gain =
                    if side_offset == 0.0 { 0.0 } else { -turn * side_offset.signum() * reach };
                let approach_gain = to.dot(&way);
                let length_m =
                    approach_gain.max(rotation_gain).clamp(MIN_PROPOSED_M.min(longest), longest);
                let push = Push {
                    heading_rad,
                    offset_m: offset_m.clamp(-max_offset, max_offset),
                    length_m,
                };
                pushes.push((approach_gain + rotation_gain, push));
            }
        }
        pushes.sort_by(|a, b| b.0.total_cmp(&a.0));
        let samples: Vec<f32> = pushes.iter().flat_map(|(_, push)| push.parameters()).collect();
        // Samples are in bounds. Where a pose is not finite, `set_mean` refuses the mean.
        let _ = self.planner.propose(&samples);
        match self.remaining {
            Some(RemainingPush { push, pushing }) => {
                let pusher = observation.pusher.translation.vector.xy() - here;
                let offset_m =
                    if pushing { path::cross(push.way(), pusher) } else { push.offset_m };
                // The plan may come from another planner, with other bounds.
                let length_m = push.length_m.clamp(MIN_LENGTH_M, longest);
                Push { offset_m: offset_m.clamp(-max_offset, max_offset), length_m, ..push }
            }
            None => pushes.first().map(|(_, push)| *push).unwrap_or_default(),
        }
    }
}

/// Pushes that are predicted together at first: few, so that a deadline finds some complete.
const FIRST_PART: usize = 32;
/// Pushes that are predicted together, at most.
// Enough to fill the threads, and few enough to make paths for within milliseconds.
const LARGEST_PART: usize = 512;

/// Greatest offset of a push, relative to the outline's greatest distance from the body's centre.
const MAX_OFFSET: f32 = 0.95;
/// Offset of proposed pushes from the middle of a side, in its lengths.
// Pushes off the centre turn the body.
const SIDE_OFFSET: f32 = 0.3;
/// The shortest proposed push, metres.
const MIN_PROPOSED_M: f32 = 0.01;
/// Sides of an outline with proposed pushes, at most; the longest.
const MAX_SIDES: usize = 4;
/// Steps before contact at which the predicted part of a path begins.
const GAP_STEPS: f32 = 1.0;
/// Steps of the pusher up to which the start of a push is at hand.
// On so short a way the pusher touches the body early, so the way is predicted too.
const AT_HAND_STEPS: f32 = 6.0;

/// The pusher's path of a push from where it is.
struct PusherPath {
    push: Push,
    /// Corners of the way around the body, and its steps; they are not predicted.
    around: Vec<Vector2<f32>>,
    approach: usize,
    /// Where the push begins.
    from: [f32; 2],
    /// (steps) Positions of the push.
    positions: Vec<[f32; 2]>,
    /// Whether it reaches the body within the steps that a path may have.
    touches: bool,
}

impl PusherPath {
    fn new(
        pushing: &Pushing<'_>,
        outline: &Outline,
        observation: &Observation,
        push: Push,
    ) -> PusherPath {
        let here = observation.pusher.translation.vector.xy();
        let (around, positions) = (Vec::new(), Vec::new());
        let none =
            PusherPath { push, around, approach: 0, from: here.into(), positions, touches: false };
        PusherPath::from(pushing, outline, here, push).unwrap_or(none)
    }

    /// The path from `here`; none if it misses or does not reach the body.
    fn from(
        pushing: &Pushing<'_>,
        outline: &Outline,
        here: Vector2<f32>,
        push: Push,
    ) -> Option<PusherPath> {
        let way = push.way();
        let pace = pushing.push_m_s * pushing.step_s;
        let touch = outline.touch(way, push.offset_m, pushing.radius_m)?;
        let begin = touch - way * (GAP_STEPS * pace);
        let corners = outline.around(here, begin, way, pushing.radius_m, pushing.room_m);
        let end = touch + way * push.length_m;
        let mut positions = Vec::new();
        let straight = corners.len() == 1;
        if straight && (begin - here).norm() <= AT_HAND_STEPS * pace {
            path::paced(here, &[begin, end], pace, |position| positions.push(position))?;
            let (around, from) = (Vec::new(), here.into());
            return Some(PusherPath { push, around, approach: 0, from, positions, touches: true });
        }
        let approach = path::paced(here, &corners, pushing.travel_m_s * pushing.step_s, |_| ())?;
        path::paced(begin, &[end], pace, |position| positions.push(position))?;
        let (around, from) = (corners, begin.into());
        Some(PusherPath { push, around, approach, from, positions, touches: true })
    }

    /// (steps) All positions.
    fn positions(mut self, pushing: &Pushing<'_>, observation: &Observation) -> Vec<[f32; 2]> {
        let (here, pace) =
            (observation.pusher.translation.vector.xy(), pushing.travel_m_s * pushing.step_s);
        let mut all = Vec::with_capacity(self.approach + self.positions.len());
        // The path exists: `from` has paced it.
        let _ = path::paced(here, &self.around, pace, |position| all.push(position));
        all.append(&mut self.positions);
        all
    }

    /// The predicted part: the push, and settling.
    fn stroke(&self, pushing: &Pushing<'_>) -> Stroke {
        let mut places_m = self.positions.clone();
        if let Some(last) = places_m.last().copied() {
            places_m.extend(std::iter::repeat_n(last, pushing.settle_steps()));
        }
        Stroke { from_m: self.from, at_hand: self.approach == 0, places_m }
    }

    fn cost(
        &self,
        pushing: &Pushing<'_>,
        observation: &Observation,
        poses: &[Isometry3<f32>],
        cost: &dyn Fn(&Pushed<'_>) -> f32,
    ) -> f32 {
        // A miss, or a failed prediction, is never the best.
        if !self.touches || poses.is_empty() {
            return f32::INFINITY;
        }
        let seconds = (self.approach + self.positions.len()) as f32 * pushing.step_s;
        cost(&Pushed { push: self.push, seconds, before: &observation.body, poses })
    }
}
