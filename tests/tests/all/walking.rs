//! A G1 is led to a place in its own model, the same on any number of threads, and what cannot be planned is said.
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)]

use std::path::Path;

use nalgebra::{Isometry3, Point3};
use rigidformer_core::{Limits, Plane, Posed, Role};
use rigidformer_planning::planner::walking::{
    Goal, WalkError, WalkPlan, WalkPlanner, WalkSettings,
};
use rigidformer_planning::planner::{Control, SettingsError};
use rigidformer_runtime::engine::Engine;
use rigidformer_runtime::futures::{BatchSimulator, Start};
use rigidformer_runtime::models::LoadedModel;
use rigidformer_runtime::pivots::{self, Pivot};
use rigidformer_runtime::poses::heading;
use rigidformer_runtime::threads::Threads;
use rigidformer_runtime::world::World;
use rigidformer_tests::walk::Walk;
use rigidformer_weights::{AlignedBuffer, G1, NANO};

/// The heaviest part of the robot.
const TORSO: usize = 15;

fn file() -> AlignedBuffer {
    let root = Path::new(env!("CARGO_MANIFEST_DIR"));
    AlignedBuffer::read(&root.join("../firmware-sim/firmware/scenes/walk.bin")).unwrap()
}

fn joints(walk: &Walk<'_>) -> Vec<Pivot> {
    let pivot = |([unit, parent], [pivot, parent_pivot]): ([u32; 2], [Point3<f32>; 2])| {
        let (unit, parent) = (unit as usize, parent as usize);
        Pivot { unit, parent, pivot, parent_pivot, residual_m: 0.0 }
    };
    walk.joints().map(pivot).collect()
}

fn simulator(threads: usize) -> BatchSimulator {
    let model = LoadedModel::embedded("g1", G1).unwrap().for_host().unwrap();
    BatchSimulator::new(Engine { threads: Threads::new(threads), ..Engine::new().unwrap() }, &model)
}

fn quick() -> WalkSettings {
    WalkSettings { futures: 12, iterations: 1, commands: 2, hold: 3, ..WalkSettings::default() }
}

struct Robot<'w> {
    seconds: f32,
    planes: [Plane; 1],
    joints: Vec<Pivot>,
    parts: Vec<Posed<'w>>,
}

impl<'w> Robot<'w> {
    fn new(walk: &Walk<'w>) -> Self {
        let planes = [walk.ground()];
        Robot {
            seconds: walk.seconds(),
            planes,
            joints: joints(walk),
            parts: walk.links().collect(),
        }
    }

    fn start(&self) -> Start<'_> {
        let Robot { planes, joints, parts, .. } = self;
        let (units, planes, pivots) =
            (parts.as_slice(), Some(planes.as_slice()), joints.as_slice());
        Start { dt_s: self.seconds, units, planes, pivots, ..Start::default() }
    }

    fn torso(&self) -> Isometry3<f32> {
        self.parts[TORSO].current
    }

    /// A place so far ahead of and to the left of the robot.
    fn goal(&self, ahead: f32, left: f32, turn: Option<f32>) -> Goal {
        let here = heading(&self.torso());
        let there = here * Point3::new(ahead, left, 0.0);
        let heading_rad = turn.map(|turn| here.rotation.scaled_axis().z + turn);
        Goal { place_m: [there.x, there.y], heading_rad }
    }

    fn plan(
        &self,
        planner: &mut WalkPlanner,
        threads: usize,
        goal: &Goal,
    ) -> Result<WalkPlan, WalkError> {
        planner.plan(&simulator(threads), &self.start(), goal, Control::none(&mut |_| {}))
    }
}

#[test]
fn the_robot_comes_to_its_place_and_stays() {
    let file = file();
    let mut robot = Robot::new(&Walk::read(&file).unwrap());
    let goal = robot.goal(0.5, 0.4, None);
    let model = LoadedModel::embedded("g1", G1).unwrap().for_host().unwrap();
    let limits = Limits { units: 31, points: 31 * 32 };
    let mut world = World::new(&model, limits).unwrap();
    let mut planner = WalkPlanner::new(quick()).unwrap();
    let begin = goal.errors(&robot.torso()).0;
    for _ in 0..9 {
        let plan = robot.plan(&mut planner, 2, &goal).unwrap();
        world.edit(|simulator| {
            simulator.set_planes(&robot.planes).unwrap();
            simulator.observe_poses(robot.seconds, &robot.parts).unwrap();
            pivots::hold(simulator, &robot.joints).unwrap();
            simulator.set_command(&plan.command).unwrap();
        });
        world.step().unwrap();
        let poses: Vec<Isometry3<f32>> =
            world.edit(|simulator| simulator.units().map(|unit| unit.pose()).collect());
        for (part, pose) in robot.parts.iter_mut().zip(poses) {
            (part.previous, part.current) = (part.current, pose);
        }
        planner.passed(1);
    }
    let end = goal.errors(&robot.torso()).0;
    assert!(begin > 0.6 && end < 0.15, "from {begin} m to {end} m");
}

#[test]
fn a_heading_is_taken_too() {
    let file = file();
    let robot = Robot::new(&Walk::read(&file).unwrap());
    let mut planner = WalkPlanner::new(WalkSettings { commands: 3, ..quick() }).unwrap();
    let goal = robot.goal(0.0, 0.0, Some(0.9));
    let plan = robot.plan(&mut planner, 2, &goal).unwrap();
    let (_, begin) = goal.errors(&robot.torso());
    let (away, turn) = goal.errors(plan.path.last().unwrap());
    assert!(begin > 0.85 && turn < 0.5 && away < 0.4, "{begin} {turn} rad, {away} m: {plan:?}");
    assert!(plan.command[2] > 0.2, "{plan:?}");
}

#[test]
fn plans_are_the_same_on_any_number_of_threads() {
    let file = file();
    let robot = Robot::new(&Walk::read(&file).unwrap());
    let goal = robot.goal(1.0, -0.5, Some(-0.5));
    let plans = |threads, seed| {
        let mut planner = WalkPlanner::new(WalkSettings { seed, ..quick() }).unwrap();
        let first = robot.plan(&mut planner, threads, &goal).unwrap();
        planner.passed(4);
        [first, robot.plan(&mut planner, threads, &goal).unwrap()]
    };
    assert_eq!(plans(1, 1), plans(3, 1));
    assert_ne!(plans(1, 1)[0].search.mean, plans(1, 2)[0].search.mean);
}

#[test]
fn any_number_of_steps_may_have_passed() {
    let file = file();
    let robot = Robot::new(&Walk::read(&file).unwrap());
    let goal = robot.goal(1.0, 0.0, None);
    let after = |passed: &[usize]| {
        let mut planner = WalkPlanner::new(quick()).unwrap();
        robot.plan(&mut planner, 1, &goal).unwrap();
        passed.iter().for_each(|steps| planner.passed(*steps));
        robot.plan(&mut planner, 1, &goal).unwrap().command
    };
    // All commands are over, whatever the rest is.
    assert_eq!(after(&[2, usize::MAX]), after(&[2, 60]));
    let mut planner = WalkPlanner::new(quick()).unwrap();
    let none = Start { dt_s: 0.0, ..robot.start() };
    let refused = planner.plan(&simulator(1), &none, &goal, Control::none(&mut |_| {}));
    let refused = refused.unwrap_err().to_string();
    assert!(refused.contains("time step"), "{refused}");
}

#[test]
fn what_is_forgotten_is_not_tried() {
    let file = file();
    let robot = Robot::new(&Walk::read(&file).unwrap());
    let goal = robot.goal(1.0, 0.0, None);
    // With whether a plan, and what was told to begin with, came before.
    let after = |planned: bool, told: bool| {
        let mut planner = WalkPlanner::new(quick()).unwrap();
        if planned {
            robot.plan(&mut planner, 1, &goal).unwrap();
            planner.passed(1);
        } else {
            planner.forget(); // noise moves on as with `passed`
        }
        if told {
            planner.begin_with(&[0.9, 0.5, 1.0]).unwrap();
        } else {
            planner.begin_with(&[]).unwrap();
        }
        planner.forget();
        planner.passed(1); // there is no plan of which steps could have passed
        robot.plan(&mut planner, 1, &goal).unwrap()
    };
    let fresh = after(false, false);
    assert_eq!(after(true, false), fresh);
    assert_eq!(after(true, true), fresh);
}

#[test]
fn what_cannot_be_planned_is_said() {
    let file = file();
    let mut robot = Robot::new(&Walk::read(&file).unwrap());
    let mut planner = WalkPlanner::new(quick()).unwrap();
    for (place_m, heading_rad) in
        [([f32::NAN, 0.0], None), ([0.0, 1e30], None), ([0.0, 0.0], Some(f32::INFINITY))]
    {
        let nowhere = Goal { place_m, heading_rad };
        let refused = robot.plan(&mut planner, 1, &nowhere).unwrap_err();
        assert!(refused.to_string().starts_with("the place is "), "{refused}");
    }
    let goal = robot.goal(1.0, 0.0, None);
    let nano = LoadedModel::embedded("nano", NANO).unwrap().for_host().unwrap();
    let other = BatchSimulator::new(Engine::new().unwrap(), &nano);
    let refused = planner.plan(&other, &robot.start(), &goal, Control::none(&mut |_| {}));
    assert_eq!(refused.unwrap_err(), WalkError::Model { found: 0 });
    robot.parts.iter_mut().for_each(|part| part.unit.role = Role::Fixed);
    assert_eq!(robot.plan(&mut planner, 1, &goal).unwrap_err(), WalkError::NoRobot);
    robot.parts.clear();
    assert_eq!(robot.plan(&mut planner, 1, &goal).unwrap_err(), WalkError::NoRobot);
    let bounds = WalkSettings { low: [1.0; 3], high: [-1.0; 3], ..quick() };
    assert!(matches!(
        WalkPlanner::new(bounds),
        Err(SettingsError::Bounds { .. } | SettingsError::Deviation { .. })
    ));
    let none = WalkSettings { low: [f32::NAN; 3], high: [f32::NAN; 3], ..quick() };
    assert!(matches!(WalkPlanner::new(none), Err(SettingsError::Range { what: "low", .. })));
    assert!(matches!(
        WalkPlanner::new(WalkSettings { hold: 0, ..quick() }),
        Err(SettingsError::Zero { what: "hold" })
    ));
}
