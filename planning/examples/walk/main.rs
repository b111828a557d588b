//! Finds the commands that bring a robot to a place, by trying many in the model: `--help` says how.

mod options;

use std::process::ExitCode;
use std::time::{Duration, Instant};

use nalgebra::Isometry3;
use rigidformer_cli::shared::{self, Usage, interrupt, output};
use rigidformer_core::Posed;
use rigidformer_evaluation::pivots::joined;
use rigidformer_evaluation::rollout::RolloutError;
use rigidformer_evaluation::scenes::Dataset;
use rigidformer_planning::planner::walking::{
    COMMAND, Goal, WalkError, WalkPlan, WalkPlanner, WalkSettings,
};
use rigidformer_planning::planner::{Control, Cut, PlanError};
use rigidformer_runtime::engine::Engine;
use rigidformer_runtime::futures::{BatchSimulator, Start};
use rigidformer_runtime::poses::heading;
use serde_json::{Value, json};

use options::Walk;

fn main() -> ExitCode {
    shared::example(run)
}

fn run(arguments: &Walk) -> anyhow::Result<()> {
    let cancelled = interrupt::watch();
    let goal = goal(arguments)?;
    let step = arguments.step as usize;
    let dataset = Dataset::open(&arguments.scene)?;
    // Frames 0 and S alone are seen.
    let scene = dataset.scene(arguments.index, Some(step + 1))?;
    let scene = if arguments.join { joined(scene, step)? } else { scene };
    let [Some(previous), Some(current)] = [scene.poses_at(0), scene.poses_at(step)] else {
        let (name, frames) = (scene.name(), scene.frames());
        anyhow::bail!(
            "{name} has {frames} frames, frames 0 and {step} are observed; give a longer scene, or a smaller --step"
        );
    };
    let poses = previous.into_iter().zip(current);
    let units: Vec<Posed<'_>> = scene
        .units()
        .iter()
        .zip(poses)
        .map(|(unit, (previous, current))| Posed { unit: unit.as_unit(), previous, current })
        .collect();
    let start = Start {
        dt_s: arguments.step as f32 / scene.frame_rate_hz(),
        units: &units,
        planes: scene.planes(),
        plane_compliance: scene.plane_compliance(),
        contact_law: Some(scene.contact_law()),
        gravity_m_s2: Some(scene.gravity_m_s2()),
        pivots: scene.pivots(),
        ..Start::default()
    };
    let loaded = shared::model(&arguments.model)?.for_host()?;
    let simulator = BatchSimulator::new(Engine::new()?, &loaded);
    let settings = WalkSettings {
        futures: arguments.futures as usize,
        iterations: arguments.iterations as usize,
        seed: arguments.seed,
        ..WalkSettings::default()
    };
    let mut planner = WalkPlanner::new(settings)?;
    planner.begin_with(&arguments.first).map_err(|error| Usage(format!("--first: {error}")))?;
    let began = Instant::now();
    let deadline = arguments.deadline_ms.map(|ms| began + Duration::from_millis(ms));
    let control = Control { deadline, cancelled, watch: &mut |_| {} };
    let plan = match planner.plan(&simulator, &start, &goal, control) {
        Ok(plan) if plan.search.cut != Some(Cut::Cancelled) => plan,
        Ok(_) | Err(WalkError::Plan(PlanError::Cut(Cut::Cancelled))) => {
            return Err(RolloutError::Cancelled.into());
        }
        Err(error) => return Err(error.into()),
    };
    let found =
        Found { plan: &plan, goal: &goal, seconds: start.dt_s, took: began.elapsed(), settings };
    let model = loaded.model().file().name();
    if arguments.json {
        output::json(&found.document(model))
    } else {
        found.print(scene.name(), model)
    }
}

fn goal(arguments: &Walk) -> Result<Goal, Usage> {
    let &[x, y] = arguments.to.as_slice() else {
        let found = arguments.to.len();
        return Err(Usage(format!("--to has {found} numbers; give two, as in --to 2,1")));
    };
    let heading_rad = arguments.heading.map(f32::to_radians);
    let numbers = [Some(x), Some(y), heading_rad];
    match numbers.into_iter().flatten().find(|number| !number.is_finite()) {
        Some(number) => Err(Usage(format!(
            "{number} is no number to go by: --to takes metres, --heading degrees"
        ))),
        None => Ok(Goal { place_m: [x, y], heading_rad }),
    }
}

/// A plan, and what it was made for.
struct Found<'f> {
    plan: &'f WalkPlan,
    goal: &'f Goal,
    /// Of a step.
    seconds: f32,
    took: Duration,
    settings: WalkSettings,
}

impl Found<'_> {
    /// After how many seconds, by which command, and where the robot is then.
    fn rows(&self) -> impl Iterator<Item = (f32, &[f32], &Isometry3<f32>)> {
        self.plan.path.iter().enumerate().map(|(step, pose)| {
            let first = step / self.settings.hold * COMMAND;
            let command = self.plan.search.best.get(first..first + COMMAND);
            ((step + 1) as f32 * self.seconds, command.unwrap_or_default(), pose)
        })
    }

    fn print(&self, scene: &str, model: &str) -> anyhow::Result<()> {
        let [x, y] = self.goal.place_m;
        output::line(format_args!("{scene} to {x}, {y} m, model {model}"))?;
        let header = [
            "time s",
            "forward m/s",
            "left m/s",
            "turn rad/s",
            "x m",
            "y m",
            "heading deg",
            "away m",
        ];
        let mut table = output::table(header);
        for (seconds, command, pose) in self.rows() {
            let here = heading(pose);
            let number = |k: usize| format!("{:.2}", command.get(k).copied().unwrap_or_default());
            output::row(
                &mut table,
                [
                    format!("{seconds:.2}"),
                    number(0),
                    number(1),
                    number(2),
                    format!("{:.2}", here.translation.x),
                    format!("{:.2}", here.translation.y),
                    format!("{:.0}", here.rotation.scaled_axis().z.to_degrees()),
                    format!("{:.2}", self.goal.errors(pose).0),
                ],
            );
        }
        output::table_lines(&table)?;
        let milliseconds = self.took.as_secs_f64() * 1e3;
        output::line(format_args!(
            "{} futures of {} steps in {milliseconds:.0} ms",
            self.plan.search.futures,
            self.plan.path.len()
        ))
    }

    fn document(&self, model: &str) -> Value {
        let path = self.rows().map(|(seconds, command, pose)| {
            let here = heading(pose);
            let (away_m, turn_rad) = self.goal.errors(pose);
            json!({
                "seconds": seconds, "command": command, "x": here.translation.x, "y": here.translation.y,
                "heading_rad": here.rotation.scaled_axis().z, "away_m": away_m, "turn_rad": turn_rad,
            })
        });
        json!({
            "model": model,
            "command": self.plan.command,
            "commands": self.plan.search.best,
            "mean": self.plan.search.mean,
            "hold_steps": self.settings.hold,
            "cost_m": self.plan.cost,
            "path": path.collect::<Value>(),
            "futures": self.plan.search.futures,
            "cut": self.plan.search.cut.map(|cut| cut.to_string()),
            "planning_s": self.took.as_secs_f64(),
        })
    }
}
