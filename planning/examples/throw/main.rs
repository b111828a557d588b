//! Plans a throw over a wall, by trying many in the model: `--help` says how.

mod options;
mod scene;

use std::path::Path;
use std::process::ExitCode;
use std::time::{Duration, Instant};

use nalgebra::{Isometry3, Vector3};
use rigidformer_cli::shared::{
    self, Drawing, Frame, Moving, MovingUnit, Usage, Viewers, interrupt, output,
};
use rigidformer_core::{Limits, Model, Plane};
use rigidformer_evaluation::rollout::RolloutError;
use rigidformer_planning::planner::{
    Action, Control, Cost, Cut, Event, Iteration, Launch, Method, Parameter, Plan, PlanError,
    Planner, Settings, Trial,
};
use rigidformer_runtime::engine::Engine;
use rigidformer_runtime::futures::{BatchSimulator, ChangeError, FutureScene, Variation};
use rigidformer_runtime::models::LoadedModel;
use rigidformer_runtime::world::World;
use serde_json::{Value, json};

use options::{MethodName, Throw};
use scene::{BALL, DT_S, STEP, STEPS, TARGET, ThrowScene};

const LAUNCH: Launch = Launch { unit: BALL };
/// m/s; the first throws are about straight at the wall.
const VELOCITY: [(f32, f32, [f32; 2]); 3] =
    [(5.0, 1.5, [0.0, 8.0]), (0.0, 0.8, [-3.0, 3.0]), (0.0, 2.0, [-2.0, 7.0])];
/// rad/s of each component.
const SPIN: (f32, f32, [f32; 2]) = (0.0, 3.0, [-12.0, 12.0]);
/// Metres of cost.
const TEMPERATURE: f32 = 0.05;
/// Speeds of the straight throws to compare with, m/s.
const STRAIGHT_M_S: [f32; 7] = [2.0, 3.0, 4.0, 5.0, 6.0, 7.0, 8.0];
/// Paths of an iteration in the picture.
const PATHS: usize = 96;

/// An iteration, as the table has it.
struct IterationRow {
    least: f32,
    so_far: f32,
    median: f32,
    /// Of the velocity, m/s.
    spread: f32,
    futures: usize,
    took: Duration,
}

/// All that is known of a throw.
struct Thrown {
    parameters: Vec<f32>,
    cost: f32,
    miss_m: f32,
    moved_m: [f32; 2],
}

fn main() -> ExitCode {
    shared::example(run)
}

fn run(arguments: &Throw) -> anyhow::Result<()> {
    let cancelled = interrupt::watch();
    let viewers = Viewers::open(&arguments.viewers)?;
    viewers.apart_from(arguments.model.path.iter().map(|path| path.as_path()))?;
    let loaded = shared::model(&arguments.model)?.for_host()?;
    let model = loaded.model();
    let scene = ThrowScene::new();
    let (units, posed) = (scene.units(), scene.posed());
    let simulator = BatchSimulator::new(Engine::new()?, &loaded);
    let settings = Settings {
        method: method(arguments.method),
        futures: arguments.futures as usize,
        iterations: arguments.iterations as usize,
        steps: STEPS,
        seed: arguments.seed,
    };
    let mut planner = Planner::new(settings, &parameters(arguments.spin))
        .map_err(|error| Usage(format!("--futures: {error}")))?;

    let total = u64::from(arguments.futures) * u64::from(arguments.iterations);
    let bar = output::progress(total, "planning");
    let (mut rows, mut samples) = (Vec::new(), Vec::new());
    let began = Instant::now();
    let mut row_began = began;
    let mut watch = |event: Event<'_>| match event {
        Event::Batch(futures) => bar.inc(futures as u64),
        Event::Iteration(iteration) => {
            rows.push(row(&iteration, row_began.elapsed()));
            row_began = Instant::now();
            // The first and the latest.
            samples.truncate(1);
            samples.push((iteration.index, iteration.samples.to_vec()));
        }
        _ => {}
    };
    let deadline = arguments.deadline_ms.map(|ms| began + Duration::from_millis(ms));
    let control = Control { deadline, cancelled, watch: &mut watch };
    let planned = planner.plan(&simulator, &ThrowScene::start(&posed), &LAUNCH, &scene, control);
    let took = began.elapsed();
    bar.finish_and_clear();
    if matches!(planned, Err(PlanError::Cut(Cut::Cancelled))) {
        return Err(RolloutError::Cancelled.into());
    }
    let plan = planned?;
    if plan.cut == Some(Cut::Cancelled) {
        return Err(RolloutError::Cancelled.into());
    }
    if alone(&loaded, &scene, &plan.best)? != plan.poses {
        anyhow::bail!("alone, the planned throw comes out otherwise: a fault of this program");
    }
    let trial = Trial { parameters: &plan.best, poses: &plan.poses, units: 3, stopped: false };
    let best = thrown(&scene, &trial);
    let straight = straight(&simulator, &scene)?;

    if arguments.json {
        output::json(&document(arguments, &rows, &plan, &best, &straight, took))?;
    } else {
        print(model, arguments, &rows, &plan, (&best, &straight), took)?;
    }
    if let Some(folder) = &arguments.out {
        let mut iterations = Vec::new();
        for (index, samples) in &samples {
            let count = samples.len() / arguments.futures.max(1) as usize;
            let few = samples.chunks_exact(count.max(1)).take(PATHS);
            let paths = throws(&simulator, &scene, &few.collect::<Vec<_>>())?;
            let ball = |poses: Vec<Isometry3<f32>>| {
                poses.into_iter().skip(BALL).step_by(units.len()).collect()
            };
            let title = format!("iteration {}", index + 1);
            iterations.push((title, paths.into_iter().map(ball).collect()));
        }
        let drawing = Drawing {
            thrown: BALL,
            hit: TARGET,
            units: &units,
            planes: &[ground(model)],
            start: &scene.poses,
            best: &plan.poses,
            iterations,
            seconds: DT_S,
            title: format!("A throw over a wall, planned with {}", name(arguments.method)),
        };
        write(folder, &shared::draw_paths(&drawing)?, arguments.json)?;
    }
    if viewers.is_asked() {
        viewers.write(&moving(model, &scene, &plan), arguments.json)?;
    }
    Ok(())
}

fn ground(model: &Model<'_>) -> Plane {
    let config = model.config();
    Plane::ground(config.ground_friction, config.ground_restitution)
}

/// The planned throw, for viewers.
fn moving(model: &Model<'_>, scene: &ThrowScene, plan: &Plan) -> Moving {
    let looks = scene.units().into_iter().zip(["ball", "wall", "target"]).enumerate();
    let looks: Vec<_> =
        looks.map(|(number, (unit, name))| MovingUnit::new(number, name, &unit)).collect();
    let steps = std::iter::once(&scene.poses[..]).chain(plan.poses.chunks(looks.len()));
    let frames = steps.enumerate().map(|(step, poses)| Frame {
        time_s: step as f64 * f64::from(DT_S),
        poses: poses.iter().copied().map(Some).collect(),
        truth: Vec::new(),
    });
    let poses_are = format!("planned with {}", model.file().name());
    Moving::new("A throw over a wall", poses_are, "", &[ground(model)], looks).with(frames)
}

fn write(folder: &Path, png: &[u8], json: bool) -> anyhow::Result<()> {
    interrupt::check()?;
    output::folder(folder)?;
    let path = folder.join("throw.png");
    output::write_whole(&path, png)?;
    // Nothing but JSON on stdout.
    match json {
        true => output::note(&format!("wrote {}", path.display())),
        false => output::line(format_args!("wrote {}", path.display()))?,
    }
    Ok(())
}

fn method(name: MethodName) -> Method {
    match name {
        MethodName::Mppi => Method::mppi(TEMPERATURE),
        MethodName::Cem => Method::cem(),
    }
}

fn name(method: MethodName) -> &'static str {
    match method {
        MethodName::Mppi => "MPPI",
        MethodName::Cem => "CEM",
    }
}

fn parameters(spin: bool) -> Vec<Parameter> {
    let spin = [SPIN; 3].into_iter().take(if spin { 3 } else { 0 });
    let all = VELOCITY.into_iter().chain(spin);
    all.map(|(mean, deviation, [low, high])| Parameter::new(mean, deviation).within(low, high))
        .collect()
}

fn row(iteration: &Iteration<'_>, took: Duration) -> IterationRow {
    let mut costs = iteration.costs.to_vec();
    costs.sort_by(f32::total_cmp);
    let squares = iteration.deviations.iter().take(3).map(|deviation| deviation * deviation);
    IterationRow {
        least: costs.first().copied().unwrap_or(f32::INFINITY),
        so_far: iteration.best_cost,
        median: costs.get(costs.len() / 2).copied().unwrap_or(f32::INFINITY),
        spread: (squares.sum::<f32>() / 3.0).sqrt(),
        futures: costs.len(),
        took,
    }
}

fn thrown(scene: &ThrowScene, trial: &Trial<'_>) -> Thrown {
    Thrown {
        parameters: trial.parameters.to_vec(),
        cost: scene.cost(trial),
        miss_m: scene.miss_m(trial),
        moved_m: scene.moved_m(trial),
    }
}

/// Throws with given parameters.
struct Given<'g>(&'g [&'g [f32]]);

impl Variation for Given<'_> {
    fn begin(&self, future: usize, scene: &mut FutureScene<'_>) -> Result<(), ChangeError> {
        LAUNCH.begin(self.0[future], scene)
    }
}

/// (throws) What becomes of the scene: (steps, units) poses.
fn throws(
    simulator: &BatchSimulator,
    scene: &ThrowScene,
    parameters: &[&[f32]],
) -> anyhow::Result<Vec<Vec<Isometry3<f32>>>> {
    let units = scene.posed();
    let row = STEPS * units.len();
    let mut poses = vec![Isometry3::identity(); parameters.len() * row];
    simulator.run(&ThrowScene::start(&units), STEPS, &Given(parameters), &mut poses)?;
    Ok(poses.chunks_exact(row).map(<[_]>::to_vec).collect())
}

/// The best of straight, level throws.
fn straight(simulator: &BatchSimulator, scene: &ThrowScene) -> anyhow::Result<Thrown> {
    let velocities = STRAIGHT_M_S.map(|speed| [speed, 0.0, 0.0]);
    let parameters = velocities.each_ref().map(|velocity| &velocity[..]);
    let paths = throws(simulator, scene, &parameters)?;
    let all = parameters.iter().zip(&paths).map(|(parameters, poses)| {
        thrown(scene, &Trial { parameters, poses, units: 3, stopped: false })
    });
    all.min_by(|a, b| a.cost.total_cmp(&b.cost))
        .ok_or_else(|| anyhow::anyhow!("no straight throw to compare with"))
}

/// (steps, units) A throw in a world that has nothing but it.
fn alone(
    model: &LoadedModel,
    scene: &ThrowScene,
    parameters: &[f32],
) -> anyhow::Result<Vec<Isometry3<f32>>> {
    let units = scene.posed();
    let points = units.iter().map(|posed| posed.unit.room()).sum();
    let limits = Limits { units: units.len(), points };
    let vector = |first: usize| {
        Vector3::from_fn(|axis, _| parameters.get(first + axis).copied().unwrap_or(0.0))
    };
    let (velocity, spin) = (vector(0), vector(3));
    let mut world = World::on(Engine::new()?.single(), model, limits, 1)?;
    world.edit(|simulator| simulator.observe_poses(DT_S, &units))?;
    let ball = world.simulator().unit(BALL).map(|unit| unit.id());
    world.set_velocity(ball.ok_or_else(|| anyhow::anyhow!("no ball"))?, &velocity, &spin)?;
    let mut poses = Vec::new();
    for _ in 0..STEPS {
        world.step()?;
        poses.extend(world.simulator().units().map(|unit| unit.pose()));
    }
    Ok(poses)
}

fn print(
    model: &Model<'_>,
    arguments: &Throw,
    rows: &[IterationRow],
    plan: &Plan,
    (best, straight): (&Thrown, &Thrown),
    took: Duration,
) -> anyhow::Result<()> {
    output::line(format_args!(
        "a ball, a wall and a falling target; model {}; {} of {} futures an iteration, {:.2} s each",
        model.file().name(),
        name(arguments.method),
        arguments.futures,
        STEPS as f32 * DT_S,
    ))?;
    let header =
        ["iteration", "best m", "so far m", "median m", "spread m/s", "futures", "futures/s"];
    let mut table = output::table(header);
    for (index, row) in rows.iter().enumerate() {
        output::row(
            &mut table,
            [
                (index + 1).to_string(),
                format!("{:.3}", row.least),
                format!("{:.3}", row.so_far),
                format!("{:.3}", row.median),
                format!("{:.3}", row.spread),
                row.futures.to_string(),
                format!("{:.0}", row.futures as f64 / row.took.as_secs_f64()),
            ],
        );
    }
    output::table_lines(&table)?;
    if plan.cut.is_some() {
        output::note(&format!(
            "the deadline cut it after {} futures, {} iterations complete",
            plan.futures, plan.iterations
        ));
    }
    output::line(describe("planned ", best))?;
    output::line(describe("straight", straight))?;
    output::line(format_args!(
        "{} futures in {:.2} s, {:.0} a second; predicted once more, alone: the same bits",
        plan.futures,
        took.as_secs_f64(),
        plan.futures as f64 / took.as_secs_f64(),
    ))
}

fn describe(what: &str, thrown: &Thrown) -> String {
    let numbers = |values: &[f32]| {
        values.iter().map(|value| format!("{value:.2}")).collect::<Vec<_>>().join(", ")
    };
    let velocity = thrown.parameters.get(..3).unwrap_or_default();
    let spin = thrown.parameters.get(3..6);
    let spin = spin.map(|spin| format!(", spin ({}) rad/s", numbers(spin))).unwrap_or_default();
    format!(
        "{what}  ({}) m/s{spin}: cost {:.3}; centres at least {:.2} m apart; target moved by ({}) m",
        numbers(velocity),
        thrown.cost,
        thrown.miss_m,
        numbers(&thrown.moved_m),
    )
}

fn document(
    arguments: &Throw,
    rows: &[IterationRow],
    plan: &Plan,
    best: &Thrown,
    straight: &Thrown,
    took: Duration,
) -> Value {
    let thrown = |thrown: &Thrown| {
        json!({
            "velocity_m_s": thrown.parameters.get(..3),
            "spin_rad_s": thrown.parameters.get(3..6),
            "cost": thrown.cost,
            "miss_m": thrown.miss_m,
            "target_moved_m": thrown.moved_m,
        })
    };
    let iterations = rows.iter().map(|row| {
        json!({
            "best": finite(row.least),
            "best_so_far": finite(row.so_far),
            "median": finite(row.median),
            "spread_m_s": row.spread,
            "futures": row.futures,
            "seconds": row.took.as_secs_f64(),
        })
    });
    let pose = |pose: &Isometry3<f32>| {
        let (t, q) = (pose.translation.vector, pose.rotation.quaternion());
        json!([t.x, t.y, t.z, q.w, q.i, q.j, q.k])
    };
    let steps = plan.poses.chunks(3).map(|poses| poses.iter().map(pose).collect::<Value>());
    json!({
        "method": name(arguments.method).to_lowercase(),
        "seed": arguments.seed,
        "step": STEP,
        "steps": STEPS,
        "iterations": iterations.collect::<Value>(),
        "planned": thrown(best),
        "straight": thrown(straight),
        "futures": plan.futures,
        "unusable": plan.unusable,
        "seconds": took.as_secs_f64(),
        "cut": plan.cut.map(|_| "deadline"),
        "poses": steps.collect::<Value>(),
    })
}

/// JSON has no infinity.
fn finite(cost: f32) -> Option<f32> {
    cost.is_finite().then_some(cost)
}
