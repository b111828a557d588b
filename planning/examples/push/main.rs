//! Pushes a cube to random goals in PyBullet, planning in the model again and again: `--help` says how.

mod options;
mod world;

use std::convert::Infallible;
use std::process::ExitCode;
use std::sync::atomic::AtomicBool;
use std::time::{Duration, Instant};

use nalgebra::Isometry3;
use rigidformer_cli::shared::{self, Frame, Moving, MovingUnit, Viewers, interrupt, output};
use rigidformer_core::{Role, Unit};
use rigidformer_evaluation::models::{Policy, Precision, quantised};
use rigidformer_evaluation::rollout::RolloutError;
use rigidformer_planning::planner::pushing::{
    FreeMotion, Goal, ModelPredictor, Observation, Predictor, PushError, PushPlan, PushPlanner,
    PushSettings, Pushed, Pushing, Stroke,
};
use rigidformer_planning::planner::{Control, Cut, PlanError};
use rigidformer_runtime::engine::Engine;
use rigidformer_runtime::futures::{BatchError, BatchSimulator};
use rigidformer_runtime::models::LoadedModel;
use serde_json::{Value, json};

use options::{Oracle, Push};
use world::{Scene, World, WorldError};

/// Python unless told otherwise, found by PATH alone: a program of the current folder runs only where it is named.
const PYTHON: &str = "python3";
/// A push that saves less than this is not worth it, metres.
const WORTH_M: f32 = 0.001;
/// Steps that the cube gets to come to rest at the end.
const REST: usize = 30;

/// How a trial ended.
struct Outcome {
    seed: u64,
    position_m: f32,
    yaw_rad: f32,
    /// In the world.
    seconds: f32,
    plans: usize,
    planning: Duration,
}

impl Outcome {
    fn within(&self, metres: f32, radians: f32) -> bool {
        self.position_m <= metres && self.yaw_rad <= radians
    }
}

/// Why a push cannot be predicted.
#[derive(Debug, thiserror::Error)]
enum PredictError {
    #[error(transparent)]
    Model(#[from] BatchError),
    #[error(transparent)]
    World(#[from] WorldError),
}

impl From<Infallible> for PredictError {
    fn from(never: Infallible) -> Self {
        match never {}
    }
}

/// What predicts, as `--planner` says.
enum Any<'a, 'm> {
    Model(&'a mut ModelPredictor<'m>),
    Engine(&'a mut World),
    Free(FreeMotion),
}

impl Predictor for Any<'_, '_> {
    type Error = PredictError;

    fn predict(
        &mut self,
        observation: &Observation,
        strokes: &[Stroke],
        cut: &(dyn Fn() -> Option<Cut> + Sync),
        out: &mut Vec<Vec<Isometry3<f32>>>,
    ) -> Result<(), PredictError> {
        match self {
            Any::Model(model) => Ok(model.predict(observation, strokes, cut, out)?),
            Any::Engine(world) => Ok(world.predict(observation, strokes, cut, out)?),
            Any::Free(free) => Ok(free.predict(observation, strokes, cut, out)?),
        }
    }
}

fn main() -> ExitCode {
    shared::example(run)
}

fn run(arguments: &Push) -> anyhow::Result<()> {
    let cancelled = interrupt::watch();
    let viewers = Viewers::open(&arguments.viewers)?;
    viewers.apart_from(arguments.model.path.iter().map(|path| path.as_path()))?;
    let loaded = match arguments.planner {
        Oracle::Model => Some(model(arguments)?),
        _ => None,
    };
    let simulator = match &loaded {
        Some(loaded) => Some(BatchSimulator::new(Engine::new()?, loaded)),
        None => None,
    };
    let python = arguments.python.clone().unwrap_or_else(|| PYTHON.into());
    let bar = output::progress(u64::from(arguments.trials), "pushing");
    let done = World::start(&python).map_err(PredictError::from).map_err(PushError::Predictor);
    let done = done.and_then(|mut world| {
        let (mut outcomes, mut first) = (Vec::new(), None);
        for trial in 0..u64::from(arguments.trials) {
            let seed = arguments.seed + trial;
            let (outcome, moving) =
                play(arguments, seed, &mut world, simulator.as_ref(), cancelled)?;
            outcomes.push(outcome);
            first.get_or_insert(moving);
            bar.inc(1);
        }
        Ok((outcomes, first))
    });
    bar.finish_and_clear();
    let (outcomes, first) = match done {
        Ok(outcomes) => outcomes,
        Err(error) if interrupted(&error) => return Err(RolloutError::Cancelled.into()),
        Err(error) => return Err(error.into()),
    };
    let name = loaded.as_ref().map(|loaded| loaded.model().file().name().to_owned());
    if arguments.json {
        output::json(&document(arguments, name.as_deref(), &outcomes))?;
    } else {
        print(arguments, name.as_deref(), &outcomes)?;
    }
    match first {
        Some(first) if viewers.is_asked() => viewers.write(&first, arguments.json),
        _ => Ok(()),
    }
}

type Failure = PushError<PredictError>;

fn interrupted(error: &Failure) -> bool {
    matches!(error, PushError::Plan(PlanError::Cut(Cut::Cancelled)))
        || matches!(error, PushError::Predictor(PredictError::World(WorldError::Interrupted)))
}

/// The default model with int8 weights, or the given one.
fn model(arguments: &Push) -> anyhow::Result<LoadedModel> {
    let loaded = shared::model(&arguments.model)?;
    if arguments.model.path.is_some() {
        return Ok(loaded.for_host()?);
    }
    Ok(quantised(&loaded, &Policy::from(Precision::I8))?.for_host()?)
}

fn play(
    arguments: &Push,
    seed: u64,
    world: &mut World,
    simulator: Option<&BatchSimulator>,
    cancelled: &AtomicBool,
) -> Result<(Outcome, Moving), Failure> {
    let failed = |error: WorldError| PushError::Predictor(PredictError::World(error));
    let scene = world.reset(seed).map_err(failed)?;
    let goal = Goal::new([scene.goal[0], scene.goal[1]], scene.goal[2]);
    let cost = |pushed: &Pushed<'_>| goal.cost(pushed);
    let pushing =
        Pushing { step_s: scene.frame_s, ..Pushing::new(&scene.cube.points, scene.radius_m) };
    let settings = PushSettings {
        futures: arguments.futures as usize,
        iterations: arguments.iterations as usize,
        seed,
        ..PushSettings::default()
    };
    let mut planner = PushPlanner::new(settings, pushing).map_err(PushError::Settings)?;
    let planes = [scene.ground];
    let mut model = simulator.map(|simulator| predictor(simulator, &scene, &planes));
    let cycle = ((arguments.cycle_ms as f32 / 1000.0 / scene.frame_s).round() as usize).max(1);
    let most = (arguments.seconds / scene.frame_s) as usize;
    let (mut observation, mut steps, mut plans, mut planning) =
        (scene.observation, 0, 0, Duration::ZERO);
    let mut frames = vec![seen(0.0, &observation, [observation.body, observation.pusher])];
    while steps < most {
        let mut any = match (arguments.planner, &mut model) {
            (Oracle::Engine, _) => Any::Engine(world),
            (_, Some(model)) => Any::Model(model),
            (_, None) => {
                Any::Free(FreeMotion { gravity_m_s2: scene.gravity_m_s2, step_s: scene.frame_s })
            }
        };
        let began = Instant::now();
        let deadline = arguments.deadline_ms.map(|ms| began + Duration::from_millis(ms));
        let control = Control { deadline, cancelled, watch: &mut |_| {} };
        let plan: PushPlan = planner.plan(&observation, &mut any, &goal, &cost, control)?;
        planning += began.elapsed();
        plans += 1;
        if plan.search.cut == Some(Cut::Cancelled) {
            return Err(PushError::Plan(PlanError::Cut(Cut::Cancelled)));
        }
        if plan.cost > plan.stay - WORTH_M {
            break;
        }
        let next = &plan.path_m[..cycle.min(plan.path_m.len()).min(most - steps)];
        let expected = expected(&observation, &plan, next.len());
        observation = world.act(next).map_err(failed)?;
        steps += next.len();
        frames.push(seen(steps as f32 * scene.frame_s, &observation, expected));
        planner.passed(&plan, next.len());
    }
    let place = observation.pusher.translation;
    let last = world.act(&[[place.x, place.y]; REST]).map_err(failed)?;
    let (position_m, yaw_rad) = goal.errors(&last.body);
    let seconds = steps as f32 * scene.frame_s;
    frames.push(seen(
        (steps + REST) as f32 * scene.frame_s,
        &last,
        [observation.body, observation.pusher],
    ));
    let outcome = Outcome { seed, position_m, yaw_rad, seconds, plans, planning };
    Ok((outcome, moving(arguments, &scene, seed, frames)))
}

/// Poses of the cube and the pusher that a plan expects after so many of its steps.
fn expected(observation: &Observation, plan: &PushPlan, steps: usize) -> [Isometry3<f32>; 2] {
    let pushed = steps.checked_sub(plan.approach + 1);
    let body = pushed.and_then(|step| plan.poses.get(step)).copied().unwrap_or(observation.body);
    let mut pusher = observation.pusher;
    if let Some([x, y]) = steps.checked_sub(1).and_then(|step| plan.path_m.get(step)) {
        pusher.translation.x = *x;
        pusher.translation.y = *y;
    }
    [body, pusher]
}

/// What is seen at the end of a control cycle, beside what was expected.
fn seen(time_s: f32, observation: &Observation, expected: [Isometry3<f32>; 2]) -> Frame {
    let truth = vec![Some(observation.body), Some(observation.pusher)];
    Frame { time_s: f64::from(time_s), poses: expected.map(Some).to_vec(), truth }
}

/// A trial, for viewers.
fn moving(arguments: &Push, scene: &Scene, seed: u64, frames: Vec<Frame>) -> Moving {
    let cube = Unit::new(&scene.cube.points, scene.cube.physics);
    let pusher = Unit::new(&scene.pusher.points, scene.pusher.physics).role(Role::Driven);
    let units = vec![MovingUnit::new(0, "cube", &cube), MovingUnit::new(1, "pusher", &pusher)];
    let poses_are = format!("expected by the planner ({})", arguments.planner.name());
    let name = format!("A push, seed {seed}");
    Moving::new(name, poses_are, "what the world did", &[scene.ground], units).with(frames)
}

fn predictor<'s>(
    simulator: &BatchSimulator,
    scene: &'s Scene,
    planes: &'s [rigidformer_core::Plane],
) -> ModelPredictor<'s> {
    ModelPredictor {
        simulator: simulator.clone(),
        body: Unit::new(&scene.cube.points, scene.cube.physics),
        pusher: Unit::new(&scene.pusher.points, scene.pusher.physics).role(Role::Driven),
        planes: Some(planes),
        gravity_m_s2: Some(scene.gravity_m_s2),
        step_s: scene.frame_s,
    }
}

/// What is said of all trials.
struct Summary {
    within_2cm: usize,
    within_5cm: usize,
    position_m: f32,
    yaw_rad: f32,
    seconds: f32,
    plans: usize,
    plans_per_s: f64,
}

fn summary(outcomes: &[Outcome]) -> Summary {
    let count = |metres, radians| outcomes.iter().filter(|o| o.within(metres, radians)).count();
    let median = |of: fn(&Outcome) -> f32| {
        let mut all: Vec<f32> = outcomes.iter().map(of).collect();
        all.sort_by(f32::total_cmp);
        let (a, b) = (all.get(all.len().saturating_sub(1) / 2), all.get(all.len() / 2));
        (a.copied().unwrap_or_default() + b.copied().unwrap_or_default()) / 2.0
    };
    let plans = outcomes.iter().map(|outcome| outcome.plans).sum::<usize>();
    let planning: Duration = outcomes.iter().map(|outcome| outcome.planning).sum();
    let seconds: f32 = outcomes.iter().map(|outcome| outcome.seconds).sum();
    Summary {
        within_2cm: count(0.02, 0.1),
        within_5cm: count(0.05, f32::INFINITY),
        position_m: median(|outcome| outcome.position_m),
        yaw_rad: median(|outcome| outcome.yaw_rad),
        seconds: seconds / outcomes.len().max(1) as f32,
        plans,
        plans_per_s: plans as f64 / planning.as_secs_f64().max(f64::MIN_POSITIVE),
    }
}

fn print(arguments: &Push, model: Option<&str>, outcomes: &[Outcome]) -> anyhow::Result<()> {
    let all = summary(outcomes);
    let header = [
        "planner",
        "trials",
        "within 5 cm",
        "within 2 cm, .1 rad",
        "median cm",
        "median rad",
        "mean s",
        "plans",
        "plans/s",
    ];
    let mut table = output::table(header);
    let name = match model {
        Some(model) => format!("{} ({model})", arguments.planner.name()),
        None => arguments.planner.name().into(),
    };
    output::row(
        &mut table,
        [
            name,
            outcomes.len().to_string(),
            all.within_5cm.to_string(),
            all.within_2cm.to_string(),
            format!("{:.2}", all.position_m * 100.0),
            format!("{:.3}", all.yaw_rad),
            format!("{:.1}", all.seconds),
            all.plans.to_string(),
            format!("{:.1}", all.plans_per_s),
        ],
    );
    output::table_lines(&table)
}

fn document(arguments: &Push, model: Option<&str>, outcomes: &[Outcome]) -> Value {
    let all = summary(outcomes);
    let each = outcomes.iter().map(|outcome| {
        json!({
            "seed": outcome.seed,
            "position_m": outcome.position_m,
            "yaw_rad": outcome.yaw_rad,
            "seconds": outcome.seconds,
            "plans": outcome.plans,
            "planning_s": outcome.planning.as_secs_f64(),
        })
    });
    json!({
        "planner": arguments.planner.name(),
        "model": model,
        "seed": arguments.seed,
        "trials": outcomes.len(),
        "within_2cm": all.within_2cm,
        "within_5cm": all.within_5cm,
        "median_position_m": all.position_m,
        "median_yaw_rad": all.yaw_rad,
        "mean_seconds": all.seconds,
        "plans": all.plans,
        "plans_per_s": all.plans_per_s,
        "futures": arguments.futures,
        "iterations": arguments.iterations,
        "cycle_ms": arguments.cycle_ms,
        "per_trial": each.collect::<Value>(),
    })
}
