//! Walking: a robot is brought to a place by commands (forward and left speed, m/s, and turn, rad/s, in its heading) whose effect
//! a model predicts. [`WalkPlanner`] plans anew whenever the robot is observed, and begins with what is left of the last plan.

use std::f32::consts::PI;

use nalgebra::{Isometry3, Vector2};
use rigidformer_core::MAX_COORDINATE_M;
use rigidformer_runtime::futures::{BatchSimulator, Start};
use rigidformer_runtime::poses::{heading, heaviest_free};

use super::{
    Control, HeldCommands, Method, Parameter, Plan, PlanError, Planner, Settings, SettingsError,
    Trial,
};

/// Numbers in a command.
pub const COMMAND: usize = 3;
/// How far a radian of heading counts, metres.
const TURN_M_RAD: f32 = 0.3;
/// Nearer to the place than this the heading that was asked for counts in full, twice as far not at all, metres.
const NEAR_M: f32 = 0.5;

/// Where a robot shall be.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Place {
    /// On the ground, metres: where the heaviest part shall be above.
    pub place_m: [f32; 2],
    /// Which way it shall look, radians from x towards y. `None`: any.
    pub heading_rad: Option<f32>,
}

impl Place {
    /// How far a part is from there: metres over the ground, and radians of heading, 0 where any is as good.
    pub fn errors(&self, part: &Isometry3<f32>) -> (f32, f32) {
        let away = part.translation.vector.xy() - Vector2::from(self.place_m);
        let here = heading(part).rotation.scaled_axis().z;
        let turn = self.heading_rad.map_or(0.0, |wanted| within(here - wanted).abs());
        (away.norm(), turn)
    }

    /// What the errors come to, metres. Far away the heading does not count: the robot may have to turn on its way.
    fn cost(&self, part: &Isometry3<f32>) -> f32 {
        let (away, turn) = self.errors(part);
        away + TURN_M_RAD * turn * (2.0 - away / NEAR_M).clamp(0.0, 1.0)
    }
}

/// An angle from -pi to pi.
fn within(angle: f32) -> f32 {
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
    /// Deviation of the first samples, as a part of what lies between the bounds.
    const DEVIATION: f32 = 0.25;

    fn command(&self, command: [f32; COMMAND]) -> [f32; COMMAND] {
        std::array::from_fn(|k| command[k].clamp(self.low[k], self.high[k]))
    }
}

/// What to do next.
#[derive(Clone, Debug, PartialEq)]
pub struct WalkPlan {
    /// What to command now; it holds for [`WalkSettings::hold`] steps unless there is another plan before.
    pub command: [f32; COMMAND],
    /// Mean over the steps of how far the robot is from the place, metres.
    pub cost: f32,
    /// (steps) Predicted poses of the heaviest part.
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
/// use rigidformer_planning::planner::walking::{Place, WalkPlanner, WalkSettings};
/// use rigidformer_runtime::engine::Engine;
/// use rigidformer_runtime::models::LoadedModel;
///
/// let model = LoadedModel::open("weights/models/g1.rfm".as_ref())?;
/// let simulator = BatchSimulator::new(Engine::new()?, &model);
/// let mut planner = WalkPlanner::new(WalkSettings::default())?;
/// let place = Place { place_m: [2.0, 1.0], heading_rad: None };
/// let start = Start { dt_s: 1.0 / 3.0, units: &[], ..Start::default() }; // the parts of the robot
/// let plan = planner.plan(&simulator, &start, &place, Control::none(&mut |_| {}))?;
/// println!("{:?} brings it to {:?}", plan.command, plan.path.last());
/// planner.passed(1); // a step later: look again and plan anew
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
#[derive(Clone, Debug)]
pub struct WalkPlanner {
    settings: WalkSettings,
    planner: Planner,
    /// Steps of the last plan's first command that are over.
    over: usize,
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
        Ok(WalkPlanner { settings, planner, over: 0, planned: false })
    }

    /// How it searches.
    pub fn settings(&self) -> &WalkSettings {
        &self.settings
    }

    /// Searches for the commands that bring the robot to the place soonest and keep it there. Tried first are what is left of the
    /// last plan, going straight there, turning there first, and standing still. The same observations and seed
    /// give the same plan, to the bit, on any number of threads, unless it is cut.
    ///
    /// # Errors
    /// [`WalkError`]; the next plan begins as this one did.
    pub fn plan(
        &mut self,
        simulator: &BatchSimulator,
        start: &Start<'_>,
        place: &Place,
        control: Control<'_>,
    ) -> Result<WalkPlan, WalkError> {
        let goal = [Some(place.place_m[0]), Some(place.place_m[1]), place.heading_rad];
        let is_near = |number: &f32| number.abs() <= MAX_COORDINATE_M;
        if let Some(found) = goal.into_iter().flatten().find(|number| !is_near(number)) {
            let (what, range) = ("the place", "numbers up to 1e6");
            return Err(SettingsError::Range { what, found, range }.into());
        }
        let found = simulator.model().config().command_size as usize;
        if found != COMMAND {
            return Err(WalkError::Model { found });
        }
        let units = start.units.iter().map(|seen| (seen.unit.role, seen.unit.physics.mass_kg));
        let leader = heaviest_free(units).ok_or(WalkError::NoRobot)?;
        let here = start.units.get(leader).ok_or(WalkError::NoRobot)?.current;
        // Where it is refused, the simulator says which pose or time step is none.
        let _ = self.propose(&here, place, start.dt_s);
        let action = HeldCommands { size: COMMAND, steps: self.settings.hold };
        let cost = |trial: &Trial<'_>| {
            let sum: f32 = trial.path(leader).map(|pose| place.cost(pose)).sum();
            sum / trial.steps().max(1) as f32
        };
        // Whatever is commanded before the first step is replaced there.
        let begin = Start { command: &[0.0; COMMAND], ..*start };
        let search = self.planner.plan(simulator, &begin, &action, &cost, control)?;
        self.planned = true;
        let mut command = [0.0; COMMAND];
        for (to, from) in command.iter_mut().zip(&search.best) {
            *to = *from;
        }
        let units = start.units.len().max(1);
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

    /// So many steps of the last plan were carried out: the next plan begins with what is left of it.
    pub fn passed(&mut self, steps: usize) {
        if self.planned {
            let hold = self.settings.hold;
            let over = self.over.saturating_add(steps % hold);
            let commands = (steps / hold).saturating_add(over / hold);
            self.over = over % hold;
            // The parameters are whole commands.
            let _ = self.planner.shift(commands, COMMAND);
        }
    }

    /// Forgets the last plan and what [`begin_with`](Self::begin_with) said, as where the robot was carried elsewhere. The noise goes on.
    pub fn forget(&mut self) {
        self.planned = false;
        self.over = 0;
        // The parameters are whole commands, and all of them are over.
        let _ = self.planner.shift(self.settings.commands, COMMAND);
    }

    /// Proposes commands from where the robot is.
    fn propose(
        &mut self,
        here: &Isometry3<f32>,
        place: &Place,
        step_s: f32,
    ) -> Result<(), SettingsError> {
        let settings = &self.settings;
        let seconds = settings.hold as f32 * step_s;
        let seen = heading(here);
        let way = Vector2::from(place.place_m) - here.translation.vector.xy();
        let local = seen.rotation.inverse() * nalgebra::Vector3::new(way.x, way.y, 0.0);
        let there = within(way.y.atan2(way.x) - seen.rotation.scaled_axis().z);
        let wanted = place.heading_rad.map(|wanted| within(wanted - seen.rotation.scaled_axis().z));
        let turn = |angle: f32| angle / seconds;
        let far = local.norm();
        let kinds = [
            [local.x / seconds, local.y / seconds, turn(wanted.unwrap_or(0.0))],
            [local.x / seconds, local.y / seconds, 0.0],
            [far / seconds * there.cos().max(0.0), 0.0, turn(there)],
            [0.0; COMMAND],
        ];
        let mut samples = Vec::new();
        for kind in kinds {
            let command = settings.command(kind);
            // The first of a kind all the time, and then standing.
            samples.extend(std::iter::repeat_n(command, settings.commands).flatten());
            samples.extend(command);
            let still = settings.command([0.0; COMMAND]);
            samples.extend(std::iter::repeat_n(still, settings.commands - 1).flatten());
        }
        self.planner.propose(&samples)
    }
}
