//! Walking: a robot is brought to a place by commands (forward and left speed, m/s, and turn, rad/s, in its heading) whose effect
//! a model predicts. [`WalkPlanner`] plans again at each observation, and begins with the rest of the last plan.

use std::f32::consts::PI;

use nalgebra::{Isometry3, Vector2};
use rigidformer_core::kernels::in_own_environment;
use rigidformer_core::{MAX_COORDINATE_M, Posed};
use rigidformer_runtime::futures::{BatchSimulator, Start};
use rigidformer_runtime::poses::{heading, heaviest_free};

use super::{
    Control, HeldCommands, Method, Parameter, Plan, PlanError, Planner, Settings, SettingsError,
    Trial,
};

/// Numbers in a command.
pub const COMMAND: usize = 3;
/// Metres that a radian of heading is worth.
const TURN_M_RAD: f32 = 0.3;
/// Distance from the goal within which its heading counts in full, metres; at twice the distance it does not count.
// Far from the goal the robot may have to turn elsewhere to get there.
const HEADING_RANGE_M: f32 = 0.5;

/// The goal of a robot.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Goal {
    /// Position on the ground below the leader, metres.
    pub place_m: [f32; 2],
    /// Its heading, radians from x towards y. `None`: any.
    pub heading_rad: Option<f32>,
}

impl Goal {
    /// Errors of the leader's pose: metres over the ground, and radians of heading, 0 where any is right.
    pub fn errors(&self, leader: &Isometry3<f32>) -> (f32, f32) {
        let away = leader.translation.vector.xy() - Vector2::from(self.place_m);
        let here = heading(leader).rotation.scaled_axis().z;
        let turn = self.heading_rad.map_or(0.0, |target| wrapped(here - target).abs());
        (away.norm(), turn)
    }

    /// Both errors as one distance, metres.
    fn cost(&self, leader: &Isometry3<f32>) -> f32 {
        let (away, turn) = self.errors(leader);
        away + TURN_M_RAD * turn * (2.0 - away / HEADING_RANGE_M).clamp(0.0, 1.0)
    }
}

/// An angle from -pi to pi.
fn wrapped(angle: f32) -> f32 {
    angle - 2.0 * PI * (angle / (2.0 * PI)).round()
}

/// How a [`WalkPlanner`] searches.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct WalkSettings {
    /// How the next iteration follows from the last.
    pub method: Method,
    /// Futures an iteration.
    pub futures: usize,
    /// At least 1.
    pub iterations: usize,
    /// Commands of a plan, at least 1.
    pub commands: usize,
    /// Steps that each lasts, at least 1.
    pub hold: usize,
    /// Another seed, other samples.
    pub seed: u64,
    /// Least numbers of a command.
    pub low: [f32; COMMAND],
    /// Greatest numbers of a command.
    pub high: [f32; COMMAND],
}

impl Default for WalkSettings {
    /// Three commands of three steps each, between those that the G1's walks have; two iterations of 16 futures.
    fn default() -> Self {
        WalkSettings {
            method: Method::Mppi { temperature: 0.01, narrowing: 0.5 },
            futures: 16,
            iterations: 2,
            commands: 3,
            hold: 3,
            seed: 1,
            low: [-0.7, -0.5, -1.0],
            high: [0.9, 0.5, 1.0],
        }
    }
}

impl WalkSettings {
    /// Deviation of the first samples, relative to the distance of the bounds.
    const DEVIATION: f32 = 0.25;

    fn command(&self, command: [f32; COMMAND]) -> [f32; COMMAND] {
        std::array::from_fn(|k| command[k].clamp(self.low[k], self.high[k]))
    }
}

/// What to do next.
#[derive(Clone, Debug, PartialEq)]
pub struct WalkPlan {
    /// The command for now; it holds for [`WalkSettings::hold`] steps, or until the next plan.
    pub command: [f32; COMMAND],
    /// Mean cost of the robot's pose over the steps, metres.
    pub cost: f32,
    /// (steps) Predicted poses of the leader.
    pub path: Vec<Isometry3<f32>>,
    /// The plan of the search; its parameters are (commands, 3).
    pub search: Plan,
}

/// Why a walk cannot be planned.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum WalkError {
    /// The search has no plan.
    #[error("{0}")]
    Plan(#[from] PlanError),
    /// A number is out of range, such as a place that is not finite.
    #[error(transparent)]
    Settings(#[from] SettingsError),
    /// Nothing is to be moved.
    #[error("the scene has no free unit; give the parts of a robot, free ones")]
    NoRobot,
    /// The model takes no such commands.
    #[error(
        "the model takes commands of {found} numbers, not of {COMMAND}; give the model of a walking robot"
    )]
    Model {
        /// Numbers in its commands; 0: it takes none.
        found: usize,
    },
}

/// Plans walks, one observation after the other.
///
/// `start` is a robot as it was observed; see `tests/tests/all/walking.rs` for a G1.
///
/// ```no_run
/// use rigidformer_runtime::futures::{BatchSimulator, Start};
/// use rigidformer_planning::planner::Control;
/// use rigidformer_planning::planner::walking::{Goal, WalkPlanner, WalkSettings};
/// use rigidformer_runtime::engine::Engine;
/// use rigidformer_runtime::models::LoadedModel;
///
/// let model = LoadedModel::open("weights/models/g1.rfm".as_ref())?;
/// let simulator = BatchSimulator::new(Engine::new()?, &model);
/// let mut planner = WalkPlanner::new(WalkSettings::default())?;
/// let goal = Goal { place_m: [2.0, 1.0], heading_rad: None };
/// let start = Start { dt_s: 1.0 / 3.0, units: &[], ..Start::default() }; // the links of the robot
/// let plan = planner.plan(&simulator, &start, &goal, Control::none(&mut |_| {}))?;
/// println!("{:?} brings it to {:?}", plan.command, plan.path.last());
/// planner.passed(1); // a step later: observe and plan again
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
#[derive(Clone, Debug)]
pub struct WalkPlanner {
    settings: WalkSettings,
    planner: Planner,
    /// Steps of the last plan's first command that are done.
    elapsed: usize,
    planned: bool,
}

impl WalkPlanner {
    /// A planner.
    ///
    /// # Errors
    /// [`SettingsError`] says what is out of range.
    pub fn new(settings: WalkSettings) -> Result<Self, SettingsError> {
        for (what, found) in [("commands", settings.commands), ("hold", settings.hold)] {
            if found == 0 {
                return Err(SettingsError::Zero { what });
            }
        }
        for (what, bounds) in [("low", settings.low), ("high", settings.high)] {
            if let Some(found) = bounds.into_iter().find(|number| !number.is_finite()) {
                return Err(SettingsError::Range { what, found, range: "finite" });
            }
        }
        let parameter = |k: usize| {
            let (low, high) = (settings.low[k], settings.high[k]);
            let deviation = WalkSettings::DEVIATION * (high - low);
            // Standing is the first mean, where the bounds allow it.
            Parameter::new(0.0_f32.clamp(low.min(high), high.max(low)), deviation).within(low, high)
        };
        let parameters: Vec<Parameter> =
            (0..settings.commands * COMMAND).map(|k| parameter(k % COMMAND)).collect();
        let search = Settings {
            method: settings.method,
            futures: settings.futures,
            iterations: settings.iterations,
            steps: settings.commands.saturating_mul(settings.hold),
            seed: settings.seed,
        };
        let planner = Planner::new(search, &parameters)?;
        Ok(WalkPlanner { settings, planner, elapsed: 0, planned: false })
    }

    /// How it searches.
    pub fn settings(&self) -> &WalkSettings {
        &self.settings
    }

    /// Searches for the commands that bring the robot to the goal soonest and keep it there. It tries the rest of the last plan first, then
    /// going straight there, turning there first, and standing still. The same observations and seed give the same plan, to the bit, on any
    /// number of threads, unless it is cut.
    ///
    /// # Errors
    /// [`WalkError`]; the next plan begins as this one did.
    pub fn plan(
        &mut self,
        simulator: &BatchSimulator,
        start: &Start<'_>,
        goal: &Goal,
        control: Control<'_>,
    ) -> Result<WalkPlan, WalkError> {
        in_own_environment(|| self.plan_here(simulator, start, goal, control))
    }

    fn plan_here(
        &mut self,
        simulator: &BatchSimulator,
        start: &Start<'_>,
        goal: &Goal,
        control: Control<'_>,
    ) -> Result<WalkPlan, WalkError> {
        let numbers = [Some(goal.place_m[0]), Some(goal.place_m[1]), goal.heading_rad];
        let is_coordinate = |number: &f32| number.abs() <= MAX_COORDINATE_M;
        if let Some(found) = numbers.into_iter().flatten().find(|number| !is_coordinate(number)) {
            let (what, range) = ("the place", "numbers up to 1e6");
            return Err(SettingsError::Range { what, found, range }.into());
        }
        let found = simulator.model().config().command_size as usize;
        if found != COMMAND {
            return Err(WalkError::Model { found });
        }
        let of_posed =
            |posed: &Posed<'_>| (posed.unit.role, posed.unit.physics.mass_kg, posed.current);
        let units: Vec<_> = match start.state {
            Some(_) => simulator.units_of(start).map_err(PlanError::from)?,
            None => start.units.iter().map(of_posed).collect(),
        };
        let leader = heaviest_free(units.iter().map(|(role, mass_kg, _)| (*role, *mass_kg)));
        let leader = leader.ok_or(WalkError::NoRobot)?;
        let (.., here) = *units.get(leader).ok_or(WalkError::NoRobot)?;
        // A refused proposal comes from a bad pose or time step, which the simulator reports.
        let _ = self.propose(&here, goal, start.dt_s);
        let action = HeldCommands { size: COMMAND, steps: self.settings.hold };
        let cost = |trial: &Trial<'_>| {
            let sum: f32 = trial.path(leader).map(|pose| goal.cost(pose)).sum();
            sum / trial.steps().max(1) as f32
        };
        // `steer` replaces this command before the first step.
        let begin = Start { command: &[0.0; COMMAND], ..*start };
        let search = self.planner.plan(simulator, &begin, &action, &cost, control)?;
        self.planned = true;
        let mut command = [0.0; COMMAND];
        for (to, from) in command.iter_mut().zip(&search.best) {
            *to = *from;
        }
        let units = start.count().max(1);
        let path = search.poses.chunks_exact(units).filter_map(|poses| poses.get(leader).copied());
        Ok(WalkPlan { command, cost: search.cost, path: path.collect(), search })
    }

    /// The next plan begins with these commands: up to [`WalkSettings::commands`], three numbers each; the others stay as they are.
    ///
    /// # Errors
    /// [`SettingsError`] for commands of another size or out of bounds; the planner is what it was.
    pub fn begin_with(&mut self, commands: &[f32]) -> Result<(), SettingsError> {
        let mut mean = self.planner.mean().to_vec();
        if commands.len() > mean.len() || !commands.len().is_multiple_of(COMMAND) {
            return Err(SettingsError::Length { expected: mean.len(), found: commands.len() });
        }
        mean[..commands.len()].copy_from_slice(commands);
        self.planner.set_mean(&mean)
    }

    /// Reports that `steps` steps of the last plan are done: the next plan begins with the rest.
    pub fn passed(&mut self, steps: usize) {
        if self.planned {
            // Steps within a command accumulate until the whole command is done.
            let hold = self.settings.hold;
            let elapsed = self.elapsed.saturating_add(steps % hold);
            let commands = (steps / hold).saturating_add(elapsed / hold);
            self.elapsed = elapsed % hold;
            // The parameters are whole commands.
            let _ = self.planner.shift(commands, COMMAND);
        }
    }

    /// Forgets the last plan and the commands of [`begin_with`](Self::begin_with), as after the robot is carried elsewhere. The stream of noise
    /// continues.
    pub fn forget(&mut self) {
        self.planned = false;
        self.elapsed = 0;
        // The parameters are whole commands, and all of them are over.
        let _ = self.planner.shift(self.settings.commands, COMMAND);
    }

    /// Proposes commands from where the robot is.
    fn propose(
        &mut self,
        here: &Isometry3<f32>,
        goal: &Goal,
        step_s: f32,
    ) -> Result<(), SettingsError> {
        let settings = &self.settings;
        let seconds = settings.hold as f32 * step_s;
        let current = heading(here);
        let way = Vector2::from(goal.place_m) - here.translation.vector.xy();
        let local = current.rotation.inverse() * nalgebra::Vector3::new(way.x, way.y, 0.0);
        let there = wrapped(way.y.atan2(way.x) - current.rotation.scaled_axis().z);
        let target =
            goal.heading_rad.map(|target| wrapped(target - current.rotation.scaled_axis().z));
        let turn = |angle: f32| angle / seconds;
        let far = local.norm();
        // Walk with a turn to the goal's heading, walk without a turn, turn towards the goal and walk, stand.
        let kinds = [
            [local.x / seconds, local.y / seconds, turn(target.unwrap_or(0.0))],
            [local.x / seconds, local.y / seconds, 0.0],
            [far / seconds * there.cos().max(0.0), 0.0, turn(there)],
            [0.0; COMMAND],
        ];
        let mut samples = Vec::new();
        for kind in kinds {
            let command = settings.command(kind);
            // Each kind twice: throughout, and for one command before standing.
            samples.extend(std::iter::repeat_n(command, settings.commands).flatten());
            samples.extend(command);
            let still = settings.command([0.0; COMMAND]);
            samples.extend(std::iter::repeat_n(still, settings.commands - 1).flatten());
        }
        self.planner.propose(&samples)
    }
}
