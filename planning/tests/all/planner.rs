//! Planners find what costs least, the same on any number of threads, and end when they must.

use std::ops::ControlFlow;
use std::path::Path;
use std::sync::Mutex;
use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};
use std::thread::{self, ThreadId};
use std::time::{Duration, Instant};

use nalgebra::{Isometry3, Point3, Vector3};
use rigidformer_evaluation::models::pack_bytes;
use rigidformer_planning::planner::{
    Action, Commands, Control, Cost, Cut, Event, Launch, Method, Parameter, Plan, PlanError,
    Planner, Settings, SettingsError, Trial,
};
use rigidformer_runtime::core::{Limits, Physics, Posed, Unit};
use rigidformer_runtime::engine::Engine;
use rigidformer_runtime::futures::{BatchSimulator, ChangeError, FutureScene, Start};
use rigidformer_runtime::models::LoadedModel;
use rigidformer_runtime::threads::Threads;
use rigidformer_runtime::world::World;

/// Runs `body` with a cube in the air and a small model: untrained, but velocities matter to it.
fn with_start<R>(body: impl FnOnce(&LoadedModel, &Start<'_>) -> R) -> R {
    with_model("tiny-paper-inputs", &[], body)
}

fn with_model<R>(
    name: &str,
    command: &[f32],
    body: impl FnOnce(&LoadedModel, &Start<'_>) -> R,
) -> R {
    let path = Path::new(env!("CARGO_MANIFEST_DIR"))
        .join(format!("../tests/data/{name}.model.safetensors"));
    let packed = pack_bytes(&path, &std::fs::read(&path).unwrap()).unwrap();
    let loaded = LoadedModel::copy_of(name, &packed).unwrap();
    let corner = |i: usize, bit| if i & bit == 0 { -0.2 } else { 0.2 };
    let points: Vec<Point3<f32>> =
        (0..8).map(|i| Point3::new(corner(i, 1), corner(i, 2), corner(i, 4))).collect();
    let physics = Physics { mass_kg: 1.0, friction: 0.4, restitution: 0.3 };
    let rest = Isometry3::translation(0.0, 0.0, 0.8);
    let units = [Posed { unit: Unit::new(&points, physics), previous: rest, current: rest }];
    let start = Start { dt_s: 10.0 / 240.0, units: &units, command, ..Start::default() };
    body(&loaded, &start)
}

fn simulator(model: &LoadedModel, threads: usize, units_a_chunk: usize) -> BatchSimulator {
    let engine = Engine { threads: Threads::new(threads), ..Engine::new().unwrap() };
    BatchSimulator::new(engine, model).with_units_a_chunk(units_a_chunk)
}

/// The start in a world of one copy, on one thread.
fn alone(model: &LoadedModel, start: &Start<'_>) -> World {
    let engine = Engine::new().unwrap().single();
    let mut world = World::on(engine, model, Limits { units: 1, points: 8 }, 1).unwrap();
    world.edit(|simulator| simulator.observe_poses(start.dt_s, start.units)).unwrap();
    world
}

const METHODS: [Method; 2] = [
    Method::Cem { elite: 0.15, smoothing: 0.1 },
    Method::Mppi { temperature: 0.05, narrowing: 0.6 },
];

const GOAL: [f32; 3] = [1.0, -2.0, 0.5];

/// Of the parameters alone.
fn quadratic(trial: &Trial<'_>) -> f32 {
    trial.parameters.iter().zip(GOAL).map(|(x, goal)| (x - goal) * (x - goal)).sum()
}

/// How close the cube comes to a place: of what the model predicts.
fn miss(trial: &Trial<'_>) -> f32 {
    let goal = Vector3::new(0.7, -0.3, 0.3);
    let distances = trial.path(0).map(|pose| (pose.translation.vector - goal).norm());
    distances.fold(f32::INFINITY, f32::min)
}

fn plan(
    planner: &mut Planner,
    simulator: &BatchSimulator,
    start: &Start<'_>,
    action: &impl Action,
    cost: &impl Cost,
) -> Result<Plan, PlanError> {
    planner.plan(simulator, start, action, cost, Control::none(&mut |_| {}))
}

#[test]
fn both_methods_find_the_least_of_a_quadratic() {
    with_start(|model, start| {
        for method in METHODS {
            let settings = Settings { method, futures: 100, iterations: 8, steps: 1, seed: 3 };
            let mut planner = Planner::new(settings, &[Parameter::new(0.0, 2.0); 3]).unwrap();
            let found =
                plan(&mut planner, &simulator(model, 1, 256), start, &(), &quadratic).unwrap();
            assert!(found.cost < 0.01, "{found:?}");
            let off = found.mean.iter().zip(GOAL).map(|(mean, goal)| (mean - goal).abs());
            assert!(off.fold(0.0, f32::max) < 0.15, "{found:?}");
            assert!(found.deviations.iter().all(|deviation| *deviation < 0.3), "{found:?}");
            assert_eq!((found.futures, found.iterations, found.unusable), (800, 8, 0));
        }
    });
}

#[test]
fn the_best_stays_within_bounds() {
    with_start(|model, start| {
        let parameters = [
            Parameter::new(0.0, 1.0).within(-0.5, 0.75),
            Parameter::new(0.0, 2.0),
            Parameter::new(0.25, 0.0),
        ];
        for method in METHODS {
            let settings = Settings { method, futures: 64, iterations: 6, steps: 1, seed: 8 };
            let mut planner = Planner::new(settings, &parameters).unwrap();
            let found =
                plan(&mut planner, &simulator(model, 1, 256), start, &(), &quadratic).unwrap();
            assert!((found.best[0] - 0.75).abs() < 1e-6, "on its bound: {found:?}");
            assert!((found.best[1] + 2.0).abs() < 0.3, "{found:?}");
            assert_eq!((found.best[2], found.mean[2]), (0.25, 0.25), "without a deviation");
        }
    });
}

#[test]
fn a_plan_depends_on_its_seed_but_not_on_threads_or_batches() {
    with_start(|model, start| {
        for method in METHODS {
            let settings = Settings { method, futures: 40, iterations: 3, steps: 6, seed: 5 };
            let velocity = [Parameter::new(0.0, 2.0); 3];
            let (mut planner, launch) =
                (Planner::new(settings, &velocity).unwrap(), Launch { unit: 0 });
            let first =
                plan(&mut planner, &simulator(model, 1, 256), start, &launch, &miss).unwrap();
            assert!(first.cost < 0.3 && first.poses.len() == 6, "{first:?}");
            for (threads, units) in [(1, 1), (2, 7), (3, 1000)] {
                let simulator = simulator(model, threads, units);
                let again = plan(&mut planner, &simulator, start, &launch, &miss).unwrap();
                assert_eq!(again, first, "{threads} threads, {units} units a chunk");
            }
            // With a deadline that never comes, batches start small and grow.
            let simulator = simulator(model, 2, 256);
            let hour = Some(Instant::now() + Duration::from_secs(3600));
            let mut batches = Vec::new();
            let mut watch = |event: Event<'_>| {
                if let Event::Batch(futures) = event {
                    batches.push(futures);
                }
            };
            let control = Control { deadline: hour, ..Control::none(&mut watch) };
            let unhurried = planner.plan(&simulator, start, &launch, &miss, control).unwrap();
            assert_eq!(unhurried, first);
            assert_eq!(batches.iter().sum::<usize>(), 120);
            assert!(batches.len() > 3, "{batches:?}");

            let mut other = Planner::new(Settings { seed: 6, ..settings }, &velocity).unwrap();
            let other = plan(&mut other, &simulator, start, &launch, &miss).unwrap();
            assert_ne!(other.best, first.best);
        }
    });
}

/// The best alone, in a simulator of one copy.
#[test]
fn the_best_future_is_what_a_simulator_alone_predicts() {
    with_start(|model, start| {
        let settings = Settings { futures: 32, iterations: 2, steps: 8, ..Settings::default() };
        let mut planner = Planner::new(settings, &[Parameter::new(0.0, 2.0); 6]).unwrap();
        let batch = simulator(model, 2, 256);
        let found = plan(&mut planner, &batch, start, &Launch { unit: 0 }, &miss).unwrap();
        let [x, y, z, a, b, c]: [f32; 6] = found.best.clone().try_into().unwrap();
        let mut world = alone(model, start);
        let id = world.simulator().unit(0).unwrap().id();
        world.set_velocity(id, &Vector3::new(x, y, z), &Vector3::new(a, b, c)).unwrap();
        let alone = (0..8).map(|_| {
            world.step().unwrap();
            world.pose(id).unwrap()
        });
        assert_eq!(found.poses, alone.collect::<Vec<_>>());
    });
}

#[test]
fn costs_that_are_not_numbers_are_worst() {
    with_start(|model, start| {
        let half = |trial: &Trial<'_>| match trial.parameters[0] > 0.9 {
            true => f32::NAN,
            false => quadratic(trial),
        };
        for method in METHODS {
            let settings = Settings { method, futures: 64, iterations: 6, steps: 1, seed: 4 };
            let mut planner = Planner::new(settings, &[Parameter::new(0.0, 1.5); 3]).unwrap();
            let simulator = simulator(model, 1, 256);
            let found = plan(&mut planner, &simulator, start, &(), &half).unwrap();
            assert!((0.6..=0.9).contains(&found.best[0]), "{found:?}");
            assert!(found.unusable > 0 && found.futures == 384);
            assert!(found.mean.iter().chain(&found.deviations).all(|x| x.is_finite()));
            for bad in [f32::NAN, f32::INFINITY, f32::NEG_INFINITY] {
                let none = plan(&mut planner, &simulator, start, &(), &|_: &Trial<'_>| bad);
                let why = "its cost is not finite".to_owned();
                assert_eq!(none, Err(PlanError::NoneUsable { futures: 384, why }));
            }
        }
    });
}

/// Asks for a unit that is not there, or for an impossible pose, where the parameter is above 0.
struct Refusing;

impl Action for Refusing {
    fn begin(&self, parameters: &[f32], scene: &mut FutureScene<'_>) -> Result<(), ChangeError> {
        let unit = if parameters[0] > 0.0 { 7 } else { 0 };
        scene.set_velocity(unit, &Vector3::zeros(), &Vector3::zeros())
    }
}

#[test]
fn refused_futures_are_worst() {
    with_start(|model, start| {
        let settings = Settings { futures: 40, iterations: 3, steps: 1, ..Settings::default() };
        let simulator = simulator(model, 2, 256);
        let mut planner = Planner::new(settings, &[Parameter::new(0.0, 2.0)]).unwrap();
        let found = plan(&mut planner, &simulator, start, &Refusing, &quadratic).unwrap();
        assert!(found.best[0] <= 0.0 && found.best[0] > -0.2, "{found:?}");
        assert!(found.unusable > 10);
        let mut planner = Planner::new(settings, &[Parameter::new(1.0, 0.0)]).unwrap();
        let none = plan(&mut planner, &simulator, start, &Refusing, &quadratic).unwrap_err();
        let text = none.to_string();
        assert!(text.contains("none of 120 futures") && text.contains("unit 7 of 1"), "{text}");
        let wrong = plan(&mut planner, &simulator, start, &Launch { unit: 0 }, &quadratic);
        assert!(wrong.unwrap_err().to_string().contains("3 parameters, or 6"));
        let wrong = plan(&mut planner, &simulator, start, &Commands { size: 1 }, &quadratic);
        assert!(wrong.unwrap_err().to_string().contains("refused"), "edge takes no command");
    });
}

/// Ends futures once the cube is low.
struct Low;

impl Cost for Low {
    fn cost(&self, trial: &Trial<'_>) -> f32 {
        assert_eq!(trial.stopped, trial.last()[0].translation.z < 0.5 && trial.steps() < 8);
        trial.steps() as f32
    }

    fn watch(&self, _: usize, poses: &[Isometry3<f32>]) -> ControlFlow<()> {
        if poses[0].translation.z < 0.5 {
            ControlFlow::Break(())
        } else {
            ControlFlow::Continue(())
        }
    }
}

#[test]
fn a_cost_may_end_futures_early() {
    with_start(|model, start| {
        let settings = Settings { futures: 30, iterations: 3, steps: 8, ..Settings::default() };
        let mut planner = Planner::new(settings, &[Parameter::new(0.0, 2.0); 3]).unwrap();
        let simulator = simulator(model, 2, 256);
        let found = plan(&mut planner, &simulator, start, &Launch { unit: 0 }, &Low).unwrap();
        assert!(found.cost <= 3.0 && found.poses.len() == found.cost as usize, "{found:?}");
    });
}

/// A plan of five million futures.
fn endless(
    model: &LoadedModel,
    start: &Start<'_>,
    control: Control<'_>,
) -> Result<Plan, PlanError> {
    let settings = Settings { futures: 5000, iterations: 1000, steps: 4, ..Settings::default() };
    let mut planner = Planner::new(settings, &[Parameter::new(0.0, 2.0); 3]).unwrap();
    planner.plan(&simulator(model, 2, 256), start, &Launch { unit: 0 }, &miss, control)
}

#[test]
fn a_deadline_leaves_the_best_so_far() {
    with_start(|model, start| {
        let mut nobody = |_: Event<'_>| {};
        let past = Control { deadline: Some(Instant::now()), ..Control::none(&mut nobody) };
        let none = endless(model, start, past).unwrap_err();
        assert_eq!(none, PlanError::Cut(Cut::Deadline));
        assert!(none.to_string().contains("allow more time"));

        let mut told = 0;
        let mut watch = |event: Event<'_>| {
            if let Event::Batch(futures) = event {
                told += futures;
            }
        };
        let deadline = Some(Instant::now() + Duration::from_millis(300));
        let soon = Control { deadline, ..Control::none(&mut watch) };
        let found = endless(model, start, soon).unwrap();
        assert_eq!(found.cut, Some(Cut::Deadline));
        assert!(found.iterations < 1000 && found.futures > 0 && found.cost.is_finite());
        assert_eq!(told, found.futures);
    });
}

#[test]
fn a_flag_ends_it_too() {
    with_start(|model, start| {
        let mut nobody = |_: Event<'_>| {};
        let cancelled = AtomicBool::new(true);
        let control = Control { cancelled: &cancelled, ..Control::none(&mut nobody) };
        assert_eq!(endless(model, start, control), Err(PlanError::Cut(Cut::Cancelled)));

        cancelled.store(false, Ordering::Relaxed);
        let mut watch = |event: Event<'_>| {
            assert!(matches!(event, Event::Batch(_)), "no iteration is complete");
            cancelled.store(true, Ordering::Relaxed);
        };
        let control = Control { cancelled: &cancelled, ..Control::none(&mut watch) };
        let found = endless(model, start, control).unwrap();
        assert_eq!((found.cut, found.iterations), (Some(Cut::Cancelled), 0));
        let (futures, mean) = (found.futures, found.mean.clone());
        assert!(futures > 0 && mean != [0.0; 3], "it learned from the batch: {found:?}");

        // In the midst of a batch.
        let (cancelled, calls) = (AtomicBool::new(false), AtomicUsize::new(0));
        let counting = Counting { cancelled: &cancelled, calls: &calls };
        let settings = Settings { futures: 64, steps: 50, ..Settings::default() };
        let mut planner = Planner::new(settings, &[Parameter::new(0.0, 2.0); 3]).unwrap();
        let control = Control { cancelled: &cancelled, ..Control::none(&mut nobody) };
        let cut = planner.plan(&simulator(model, 1, 256), start, &(), &counting, control);
        assert_eq!(cut, Err(PlanError::Cut(Cut::Cancelled)));
        assert!(calls.into_inner() < 64 * 10);
    });
}

/// Cancels at its hundredth call.
struct Counting<'c> {
    cancelled: &'c AtomicBool,
    calls: &'c AtomicUsize,
}

impl Cost for Counting<'_> {
    fn cost(&self, _: &Trial<'_>) -> f32 {
        0.0
    }

    fn watch(&self, _: usize, _: &[Isometry3<f32>]) -> ControlFlow<()> {
        if self.calls.fetch_add(1, Ordering::Relaxed) == 100 {
            self.cancelled.store(true, Ordering::Relaxed);
        }
        ControlFlow::Continue(())
    }
}

/// A push a step along x: (steps, 1) parameters in m/s.
struct Pushes;

impl Action for Pushes {
    fn steer(
        &self,
        parameters: &[f32],
        step: usize,
        scene: &mut FutureScene<'_>,
    ) -> Result<(), ChangeError> {
        scene.push(0, &Vector3::new(parameters[step], 0.0, 0.0), &Vector3::zeros())
    }
}

#[test]
fn a_receding_horizon_goes_on_from_the_last_plan() {
    with_start(|model, start| {
        let settings = Settings { futures: 60, iterations: 4, steps: 4, ..Settings::default() };
        let pushes = [Parameter::new(0.0, 0.5).within(-1.0, 1.0); 4];
        let mut planner = Planner::new(settings, &pushes).unwrap();
        let simulator = simulator(model, 1, 256);
        // As far as possible, while it costs to push in the first step.
        let far =
            |trial: &Trial<'_>| trial.parameters[0].abs() - 10.0 * trial.last()[0].translation.x;
        let first = plan(&mut planner, &simulator, start, &Pushes, &far).unwrap();
        assert!(first.cost < -1.0, "{first:?}");
        planner.shift(1, 1).unwrap();
        assert_eq!(planner.mean()[..3], first.mean[1..]);
        assert_eq!(planner.mean()[3], 0.0, "as the planner was made");
        let second = plan(&mut planner, &simulator, start, &Pushes, &far).unwrap();
        assert_ne!(second.best, first.best, "other noise");
        planner.shift(9, 2).unwrap();
        assert_eq!(planner.mean(), [0.0; 4]);

        let expected = SettingsError::Length { expected: 6, found: 4 };
        assert_eq!(planner.shift(1, 3), Err(expected));
        assert!(planner.shift(1, 0).is_err());
        let expected = SettingsError::Length { expected: 4, found: 1 };
        assert_eq!(planner.set_mean(&[0.0]), Err(expected));
        let beyond = planner.set_mean(&[0.0, 0.0, 2.0, 0.0]).unwrap_err().to_string();
        assert_eq!(beyond, "parameter 2: its mean is 2; it must be finite and from -1 to 1");
        assert_eq!(planner.mean(), [0.0; 4]);
        planner.set_mean(&[0.5; 4]).unwrap();
        assert_eq!(planner.mean(), [0.5; 4]);
    });
}

#[test]
fn commands_are_given_step_by_step() {
    with_model("tiny", &[0.0; 3], |model, start| {
        let settings = Settings { futures: 24, iterations: 1, steps: 3, ..Settings::default() };
        let commands = [Parameter::new(0.0, 1.0).within(-1.0, 1.0); 6];
        let mut planner = Planner::new(settings, &commands).unwrap();
        let simulator = simulator(model, 1, 256);
        let high = |trial: &Trial<'_>| -trial.last()[0].translation.z;
        let found = plan(&mut planner, &simulator, start, &Commands { size: 3 }, &high).unwrap();
        let mut world = alone(model, start);
        // The third step keeps the second command.
        let alone = [0, 1, 1].map(|command| {
            let command = &found.best[3 * command..][..3];
            world.edit(|simulator| simulator.set_command(command)).unwrap();
            world.step().unwrap();
            world.simulator().unit(0).unwrap().pose()
        });
        assert_eq!(found.poses, alone);
        let wrong = plan(&mut planner, &simulator, start, &Commands { size: 2 }, &high);
        assert!(wrong.unwrap_err().to_string().contains("the command has 2 numbers"));
    });
}

#[test]
fn settings_out_of_range_are_named() {
    let good = Settings::default();
    let free = [Parameter::new(0.0, 1.0)];
    let says = |settings: Settings, parameters: &[Parameter], text: &str| {
        let error = Planner::new(settings, parameters).unwrap_err().to_string();
        assert!(error.contains(text), "{error}");
    };
    says(Settings { futures: 0, ..good }, &free, "futures is 0; give at least 1");
    says(Settings { iterations: 0, ..good }, &free, "iterations is 0");
    says(Settings { steps: 0, ..good }, &free, "steps is 0");
    says(good, &[], "parameters is 0");
    says(Settings { futures: 14, ..good }, &free, "fewer than two");
    let with = |method| Settings { method, ..good };
    for temperature in [0.0, -1.0, f32::NAN, f32::INFINITY] {
        says(with(Method::mppi(temperature)), &free, "finite and above 0");
    }
    for narrowing in [0.0, 1.1, f32::NAN] {
        says(with(Method::Mppi { temperature: 1.0, narrowing }), &free, "narrowing is");
    }
    for elite in [0.0, 1.5, f32::NAN] {
        says(with(Method::Cem { elite, smoothing: 0.0 }), &free, "elite is");
    }
    for smoothing in [-0.1, 1.0, f32::NAN] {
        says(with(Method::Cem { elite: 0.5, smoothing }), &free, "from 0 to below 1");
    }
    for deviation in [-1.0, f32::NAN, f32::INFINITY] {
        says(good, &[free[0], Parameter::new(0.0, deviation)], "parameter 1: its deviation is");
    }
    says(good, &[free[0].within(0.5, 1.0)], "parameter 0: its mean is 0");
    says(good, &[free[0].within(1.0, -1.0)], "it must be finite and from 1 to -1");
    says(good, &[free[0].within(f32::NAN, 1.0)], "its mean is 0");
    says(good, &[Parameter::new(f32::NAN, 1.0)], "its mean is NaN");
    assert!(Planner::new(with(Method::mppi(1.0)), &[free[0].within(0.0, 0.0)]).is_ok());
}

/// Remembers who asks, and predicts.
struct Serial<'s> {
    simulator: &'s BatchSimulator,
    start: &'s Start<'s>,
    calls: Mutex<Vec<ThreadId>>,
}

impl Cost for Serial<'_> {
    fn cost(&self, trial: &Trial<'_>) -> f32 {
        let mut calls = self.calls.try_lock().expect("one at a time");
        calls.push(thread::current().id());
        let mut out = [Isometry3::identity(); 4];
        self.simulator.run(self.start, 2, &(), &mut out).unwrap();
        miss(trial)
    }

    fn is_serial(&self) -> bool {
        true
    }
}

#[test]
fn a_serial_cost_is_called_where_the_planner_is_and_may_predict() {
    with_start(|model, start| {
        let settings = Settings { futures: 20, iterations: 2, steps: 4, ..Settings::default() };
        let simulator = simulator(model, 2, 256);
        let mut planner = Planner::new(settings, &[Parameter::new(0.0, 2.0); 3]).unwrap();
        let mut again = planner.clone();
        let serial = Serial { simulator: &simulator, start, calls: Mutex::default() };
        let found = plan(&mut planner, &simulator, start, &Launch { unit: 0 }, &serial).unwrap();
        let calls = serial.calls.into_inner().unwrap();
        assert_eq!(calls, vec![thread::current().id(); 40]);
        assert_eq!(found, plan(&mut again, &simulator, start, &Launch { unit: 0 }, &miss).unwrap());
    });
}
