//! Pushing: a driven unit, the pusher, brings a free one, the body, to where it shall be, over a plane z = const.
//!
//! A [`Push`] is a straight line that the pusher goes along: its heading, how far it passes beside the body's centre, and
//! how far it pushes after touching. [`PushPlanner`] samples pushes, predicts them with the model (or with another
//! [`Predictor`]), and plans anew whenever the scene is observed; the last plan's push, as far as it is left, is the
//! first that is tried. On its way around the body the pusher keeps off it, and that way is not predicted: nothing moves.

mod path;

use std::borrow::Cow;
use std::convert::Infallible;
use std::ops::ControlFlow;
use std::sync::atomic::{AtomicBool, Ordering};

use nalgebra::{Isometry3, Point3, Translation3, Vector2, Vector3};
use rigidformer_core::{MAX_COORDINATE_M, Plane, Posed, Role, Unit, math};
use rigidformer_runtime::futures::{
    BatchError, BatchSimulator, ChangeError, End, FutureScene, Start, Variation,
};
use rigidformer_runtime::poses;

use super::{
    Control, Cut, Method, Parameter, Plan, PlanError, Planner, Settings, SettingsError, cut,
};
use path::{MOST_STEPS, Outline};

/// The unit that is pushed, among the units of a prediction.
const BODY: usize = 0;
/// The unit that pushes.
const PUSHER: usize = 1;
/// Heading, offset, length.
const WIDTH: usize = 3;

/// What is seen before a plan: poses, a step of the predictions apart.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Sight {
    /// Where the body was a step ago.
    pub body_before: Isometry3<f32>,
    /// Where the body is.
    pub body: Isometry3<f32>,
    /// Where the pusher was a step ago.
    pub pusher_before: Isometry3<f32>,
    /// Where the pusher is. It keeps its height and turn.
    pub pusher: Isometry3<f32>,
}

impl Sight {
    fn check(&self) -> Result<(), SettingsError> {
        let seen = [
            ("the body's previous pose", &self.body_before),
            ("the body's pose", &self.body),
            ("the pusher's previous pose", &self.pusher_before),
            ("the pusher's pose", &self.pusher),
        ];
        for (what, pose) in seen {
            let mut numbers = pose.translation.vector.iter().chain(pose.rotation.coords.iter());
            if let Some(&found) = numbers.find(|number| !is_near(**number)) {
                return Err(SettingsError::Range { what, found, range: NEAR });
            }
        }
        Ok(())
    }
}

/// Whether a number is one that coordinates may be.
fn is_near(number: f32) -> bool {
    number.abs() <= MAX_COORDINATE_M
}

/// Of numbers that are near.
const NEAR: &str = "of numbers up to 1e6";

/// What pushes and is pushed, and how the pusher moves.
#[derive(Clone, Debug)]
pub struct Pushing<'p> {
    /// (points) of the body, in its own frame, metres. Its outline on the ground is their convex hull.
    pub body: Cow<'p, [Point3<f32>]>,
    /// Of the pusher, metres: its outline is a circle about its frame's origin.
    pub radius_m: f32,
    /// Seconds between two places of a path, and between the two poses of a [`Sight`].
    pub step_s: f32,
    /// While the pusher pushes, m/s.
    pub push_m_s: f32,
    /// On its way around the body, m/s.
    pub travel_m_s: f32,
    /// At least so much room is left to the body on the way around it, metres.
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
        if !(self.longest_m.is_finite() && self.longest_m >= SHORTEST_M) {
            return Err(SettingsError::Range { what, found: self.longest_m, range });
        }
        let (what, range) = ("settle_s", "finite and at least 0");
        if !(self.settle_s.is_finite() && self.settle_s >= 0.0) {
            return Err(SettingsError::Range { what, found: self.settle_s, range });
        }
        Ok(())
    }

    /// Steps of the longest prediction, about.
    fn predicted(&self) -> f32 {
        let push = self.longest_m / (self.push_m_s * self.step_s) + AT_HAND_STEPS;
        push + (self.settle_s / self.step_s).round()
    }

    /// Steps to settle.
    fn settle(&self) -> usize {
        (self.settle_s / self.step_s).round() as usize
    }
}

/// Steps of all predictions of an iteration, at most: 32 MiB of places, and seven times as much of poses of two units.
const MOST_PREDICTED: f32 = (1 << 22) as f32;
/// The shortest push, metres.
const SHORTEST_M: f32 = 0.002;

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

    fn parameters(&self) -> [f32; WIDTH] {
        [self.heading_rad, self.offset_m, self.length_m]
    }

    fn way(&self) -> Vector2<f32> {
        let (sin, cos) = math::sin_cos(turn_within(self.heading_rad));
        Vector2::new(cos, sin)
    }
}

/// The same turn from -pi to pi.
fn turn_within(angle: f32) -> f32 {
    let turns = (angle / std::f32::consts::TAU).round();
    angle - turns * std::f32::consts::TAU
}

/// Which way a body's x axis points over the ground, radians from x towards y.
pub fn yaw_rad(pose: &Isometry3<f32>) -> f32 {
    let x = pose.rotation * Vector3::x();
    x.y.atan2(x.x)
}

/// Where a body shall be.
///
/// Its [`cost`](Self::cost) is a distance in metres, where a turn counts as [`lever_m`](Self::lever_m) times its angle,
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
            if !is_near(found) {
                return Err(SettingsError::Range { what, found, range: NEAR });
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
        (away.norm(), turn_within(yaw_rad(pose) - self.yaw_rad).abs())
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
    /// Whether it is there now, and moves as it was seen to move. Otherwise it begins at rest.
    pub at_hand: bool,
    /// Where it is after each step, metres.
    pub places_m: Vec<[f32; 2]>,
}

/// What foretells where strokes bring the body.
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
        sight: &Sight,
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
        sight: &Sight,
        strokes: &[Stroke],
        cut: &(dyn Fn() -> Option<Cut> + Sync),
        out: &mut Vec<Vec<Isometry3<f32>>>,
    ) -> Result<(), BatchError> {
        let units = [
            Posed { unit: self.body, previous: sight.body_before, current: sight.body },
            Posed {
                unit: self.pusher.role(Role::Driven),
                previous: sight.pusher_before,
                current: sight.pusher,
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
        let late = (0..strokes.len()).map(|_| AtomicBool::new(false)).collect();
        let driven = Drive { strokes, pusher: sight.pusher, cut, late };
        let outcomes = self.simulator.run(&start, steps, &driven, &mut poses)?;
        for (index, (stroke, outcome)) in strokes.iter().zip(&outcomes).enumerate() {
            if driven.late[index].load(Ordering::Relaxed) {
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
    /// Height and turn are those of now.
    pusher: Isometry3<f32>,
    cut: &'d (dyn Fn() -> Option<Cut> + Sync),
    /// (strokes) whether it was ended for want of time.
    late: Vec<AtomicBool>,
}

impl Drive<'_> {
    fn at(&self, [x, y]: [f32; 2]) -> Isometry3<f32> {
        let place = Translation3::new(x, y, self.pusher.translation.z);
        Isometry3::from_parts(place, self.pusher.rotation)
    }
}

impl Variation for Drive<'_> {
    fn begin(&self, future: usize, scene: &mut FutureScene<'_>) -> Result<(), ChangeError> {
        let stroke = &self.strokes[future];
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
            Some(place) => scene.drive(PUSHER, &self.at(*place)),
            None => Ok(()),
        }
    }

    fn watch(&self, future: usize, step: usize, _: &[Isometry3<f32>]) -> ControlFlow<()> {
        if step + 1 >= self.strokes[future].places_m.len() {
            return ControlFlow::Break(());
        }
        if (self.cut)().is_some() {
            self.late[future].store(true, Ordering::Relaxed);
            return ControlFlow::Break(());
        }
        ControlFlow::Continue(())
    }
}

/// The baseline without contact: the body goes on as it was seen to move, through pusher and ground.
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
        sight: &Sight,
        strokes: &[Stroke],
        _: &(dyn Fn() -> Option<Cut> + Sync),
        out: &mut Vec<Vec<Isometry3<f32>>>,
    ) -> Result<(), Infallible> {
        let (before, now, step_s) = (&sight.body_before, &sight.body, f64::from(self.step_s));
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
    /// Deviation of offsets, as a part of the outline's greatest distance from the body's centre.
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
    /// (steps) predicted poses of the body, from `path_m[approach]` on and while it settles.
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

/// Plans pushes, one sight after the other.
///
/// A cube is pushed 6 cm to the left, seen by the model alone:
///
/// ```
/// use nalgebra::{Isometry3, Point3};
/// use rigidformer_runtime::core::{Physics, Plane, Unit};
/// use rigidformer_runtime::futures::BatchSimulator;
/// use rigidformer_planning::planner::pushing::{Goal, ModelPredictor, PushPlanner, PushSettings, Pushed, Pushing, Sight};
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
/// let sight = Sight { body_before: body, body, pusher_before: pusher, pusher };
/// let goal = Goal::new([-0.06, 0.0], 0.0);
/// let settings = PushSettings { futures: 8, iterations: 1, ..PushSettings::default() };
/// let mut planner = PushPlanner::new(settings, Pushing::new(&cube, 0.01))?;
/// let cost = |pushed: &Pushed<'_>| goal.cost(pushed);
/// let plan = planner.plan(&sight, &mut predictor, &goal, &cost, Control::none(&mut |_| {}))?;
/// assert!(plan.cost < plan.stay && plan.poses.last().is_some_and(|pose| pose.translation.x < -0.02));
/// planner.passed(&plan, plan.path_m.len() / 2); // then look again and plan anew
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
#[derive(Clone, Debug)]
pub struct PushPlanner<'p> {
    pushing: Pushing<'p>,
    planner: Planner,
    /// Greatest offset of a push, metres.
    widest_m: f32,
    left: Option<Left>,
}

/// What is left of a plan.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Left {
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
        let found = settings.futures as f32 * pushing.predicted();
        if found.is_nan() || found > MOST_PREDICTED {
            let what = "futures, times the steps of the longest push and of settling,";
            return Err(SettingsError::Range { what, found, range: "at most 4194304" });
        }
        let reach_m = Outline::new(&pushing.body, &Isometry3::identity()).reach_m();
        let widest_m = WIDEST * reach_m;
        let parameters = [
            Parameter::new(0.0, settings.heading_rad),
            Parameter::new(0.0, settings.offset * reach_m).within(-widest_m, widest_m),
            Parameter::new(SHORTEST_M, settings.length_m).within(SHORTEST_M, pushing.longest_m),
        ];
        let search = Settings {
            method: settings.method,
            futures: settings.futures,
            iterations: settings.iterations,
            steps: 1,
            seed: settings.seed,
        };
        let planner = Planner::new(search, &parameters)?;
        Ok(PushPlanner { pushing, planner, widest_m, left: None })
    }

    /// Searches for the push that costs least. Tried first are what is left of the last plan, and pushes on each side of
    /// the body, in the middle and beside it, about as long as the way to the goal. The same calls, in the same order, with
    /// the same sights, seed and predictions give the same plans, to the bit, unless one is cut. A deadline is looked for
    /// before each push is tried; the costs of those that were predicted by then are still found.
    ///
    /// # Errors
    /// [`PushError`]
    pub fn plan<P: Predictor>(
        &mut self,
        sight: &Sight,
        predictor: &mut P,
        goal: &Goal,
        cost: &dyn Fn(&Pushed<'_>) -> f32,
        control: Control<'_>,
    ) -> Result<PushPlan, PushError<P::Error>> {
        sight.check().map_err(PushError::Settings)?;
        goal.check().map_err(PushError::Settings)?;
        let outline = Outline::new(&self.pushing.body, &sight.body);
        if outline.corners() < 3 {
            return Err(PushError::Outline { corners: outline.corners() });
        }
        let first = self.propose(&outline, sight, goal);
        self.planner.set_mean(&first.parameters()).map_err(PushError::Settings)?;
        let (pushing, deadline, cancelled) = (&self.pushing, control.deadline, control.cancelled);
        let stop = move || cut(deadline, cancelled);
        let mut best: Option<(f32, Vec<Isometry3<f32>>)> = None;
        let mut reached = false;
        let search = self.planner.plan_by(control, |samples, costs| {
            let mut ways: Vec<Way> = Vec::new();
            for sample in samples.chunks_exact(WIDTH) {
                if !ways.is_empty() && stop().is_some() {
                    break;
                }
                ways.push(Way::new(pushing, &outline, sight, Push::of(sample)));
            }
            reached |= ways.iter().any(|way| way.touches);
            let strokes: Vec<Stroke> = ways.iter().map(|way| way.stroke(pushing)).collect();
            let mut found = Vec::with_capacity(strokes.len());
            predictor.predict(sight, &strokes, &stop, &mut found).map_err(PushError::Predictor)?;
            for (way, poses) in ways.iter().zip(found) {
                let cost = way.cost(pushing, sight, &poses, cost);
                costs.push(cost);
                if cost.is_finite() && best.as_ref().is_none_or(|(least, _)| cost < *least) {
                    best = Some((cost, poses));
                }
            }
            Ok::<_, PushError<P::Error>>(stop().filter(|_| costs.len() * WIDTH < samples.len()))
        });
        let search = search.map_err(|error| match error {
            PushError::Plan(PlanError::NoneUsable { .. }) if !reached => {
                PushError::Unreachable { steps: MOST_STEPS }
            }
            other => other,
        })?;
        let push = Push::of(&search.best);
        let way = Way::new(pushing, &outline, sight, push);
        let approach = way.approach;
        let staying =
            Pushed { push: Push::default(), seconds: 0.0, before: &sight.body, poses: &[] };
        let stay = cost(&staying);
        let poses = best.map(|(_, poses)| poses).unwrap_or_default();
        Ok(PushPlan {
            push,
            cost: search.cost,
            stay,
            path_m: way.path(pushing, sight),
            approach,
            poses,
            search,
        })
    }

    /// So many steps of a plan's path were carried out: the next plan begins with what is left of it.
    pub fn passed(&mut self, plan: &PushPlan, steps: usize) {
        let Pushing { push_m_s, step_s, .. } = self.pushing;
        let pushed = steps.saturating_sub(plan.approach) as f32 * push_m_s * step_s;
        let length_m = plan.push.length_m - (pushed - self.gap_m()).max(0.0);
        self.left = (steps < plan.path_m.len() && length_m > SHORTEST_M).then_some(Left {
            push: Push { length_m, ..plan.push },
            pushing: steps > plan.approach,
        });
    }

    /// Forgets the last plan.
    pub fn forget(&mut self) {
        self.left = None;
    }

    fn gap_m(&self) -> f32 {
        GAP_STEPS * self.pushing.push_m_s * self.pushing.step_s
    }

    /// Proposes pushes, the most promising first; the one to begin with.
    fn propose(&mut self, outline: &Outline, sight: &Sight, goal: &Goal) -> Push {
        let here = sight.body.translation.vector.xy();
        let to = Vector2::from(goal.place_m) - here;
        let turn = turn_within(goal.yaw_rad - yaw_rad(&sight.body));
        let (reach, longest) = (outline.reach_m(), self.pushing.longest_m);
        let widest = self.widest_m;
        // How far it brings the body towards the goal, about, and the push.
        let mut pushes: Vec<(f32, Push)> = Vec::new();
        for (middle, along) in outline.sides().into_iter().take(SIDES) {
            let way = path::left_of(along).normalize();
            let heading_rad = way.y.atan2(way.x);
            for aside in [0.0, -ASIDE, ASIDE] {
                let offset_m = path::cross(way, middle) + aside * along.norm();
                // Pushed left of its centre a body turns right.
                let turned = if aside == 0.0 { 0.0 } else { -turn * aside.signum() * reach };
                let nearer = to.dot(&way);
                let length_m = nearer.max(turned).clamp(LEAST_PROPOSED_M.min(longest), longest);
                let push =
                    Push { heading_rad, offset_m: offset_m.clamp(-widest, widest), length_m };
                pushes.push((nearer + turned, push));
            }
        }
        pushes.sort_by(|a, b| b.0.total_cmp(&a.0));
        let samples: Vec<f32> = pushes.iter().flat_map(|(_, push)| push.parameters()).collect();
        // They are in bounds; where a pose is not finite, the mean is refused.
        let _ = self.planner.propose(&samples);
        match self.left {
            Some(Left { push, pushing }) => {
                let pusher = sight.pusher.translation.vector.xy() - here;
                let offset_m =
                    if pushing { path::cross(push.way(), pusher) } else { push.offset_m };
                // It may be of another planner, with other bounds.
                let length_m = push.length_m.clamp(SHORTEST_M, longest);
                Push { offset_m: offset_m.clamp(-widest, widest), length_m, ..push }
            }
            None => pushes.first().map(|(_, push)| *push).unwrap_or_default(),
        }
    }
}

/// Greatest offset of a push, as a part of the outline's greatest distance from the body's centre.
const WIDEST: f32 = 0.95;
/// How far beside a side's middle pushes are proposed, as a part of its length.
const ASIDE: f32 = 0.3;
/// No shorter push is proposed, metres.
const LEAST_PROPOSED_M: f32 = 0.01;
/// At most so many sides of an outline are proposed, the longest.
const SIDES: usize = 4;
/// So many steps before touching the predicted part of a path begins.
const GAP_STEPS: f32 = 1.0;
/// A place at most so many steps of the pusher away is at hand: what it touches on the way there is predicted.
const AT_HAND_STEPS: f32 = 6.0;

/// A push as the pusher goes it from where it is.
struct Way {
    push: Push,
    /// On the way around the body: corners, and how many steps; they are not predicted.
    around: Vec<Vector2<f32>>,
    approach: usize,
    /// Where the push begins.
    from: [f32; 2],
    /// (steps) Places of the push.
    places: Vec<[f32; 2]>,
    /// Whether it touches the body at all, in so many steps as a path may have.
    touches: bool,
}

impl Way {
    fn new(pushing: &Pushing<'_>, outline: &Outline, sight: &Sight, push: Push) -> Way {
        let here = sight.pusher.translation.vector.xy();
        let (around, places) = (Vec::new(), Vec::new());
        let none = Way { push, around, approach: 0, from: here.into(), places, touches: false };
        Way::from(pushing, outline, here, push).unwrap_or(none)
    }

    /// The way from `here`; none if it does not touch, or does not get there.
    fn from(
        pushing: &Pushing<'_>,
        outline: &Outline,
        here: Vector2<f32>,
        push: Push,
    ) -> Option<Way> {
        let way = push.way();
        let pace = pushing.push_m_s * pushing.step_s;
        let touch = outline.touch(way, push.offset_m, pushing.radius_m)?;
        let begin = touch - way * (GAP_STEPS * pace);
        let corners = outline.around(here, begin, way, pushing.radius_m, pushing.room_m);
        let end = touch + way * push.length_m;
        let mut places = Vec::new();
        let straight = corners.len() == 1;
        if straight && (begin - here).norm() <= AT_HAND_STEPS * pace {
            path::paced(here, &[begin, end], pace, |place| places.push(place))?;
            let (around, from) = (Vec::new(), here.into());
            return Some(Way { push, around, approach: 0, from, places, touches: true });
        }
        let approach = path::paced(here, &corners, pushing.travel_m_s * pushing.step_s, |_| ())?;
        path::paced(begin, &[end], pace, |place| places.push(place))?;
        let (around, from) = (corners, begin.into());
        Some(Way { push, around, approach, from, places, touches: true })
    }

    /// (steps) All places.
    fn path(mut self, pushing: &Pushing<'_>, sight: &Sight) -> Vec<[f32; 2]> {
        let (here, pace) =
            (sight.pusher.translation.vector.xy(), pushing.travel_m_s * pushing.step_s);
        let mut all = Vec::with_capacity(self.approach + self.places.len());
        // What got there before gets there again.
        let _ = path::paced(here, &self.around, pace, |place| all.push(place));
        all.append(&mut self.places);
        all
    }

    /// What is to be predicted: the push, and settling.
    fn stroke(&self, pushing: &Pushing<'_>) -> Stroke {
        let mut places_m = self.places.clone();
        if let Some(last) = places_m.last().copied() {
            places_m.extend(std::iter::repeat_n(last, pushing.settle()));
        }
        Stroke { from_m: self.from, at_hand: self.approach == 0, places_m }
    }

    fn cost(
        &self,
        pushing: &Pushing<'_>,
        sight: &Sight,
        poses: &[Isometry3<f32>],
        cost: &dyn Fn(&Pushed<'_>) -> f32,
    ) -> f32 {
        if !self.touches || poses.is_empty() {
            return f32::INFINITY;
        }
        let seconds = (self.approach + self.places.len()) as f32 * pushing.step_s;
        cost(&Pushed { push: self.push, seconds, before: &sight.body, poses })
    }
}
