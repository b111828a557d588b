//! Pushes are planned, the same on any number of threads, and what cannot be planned is said.

use std::path::Path;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Instant;

use nalgebra::{Isometry3, Point3, Vector3};
use rigidformer_planning::planner::pushing::{
    FreeMotion, Goal, ModelPredictor, Observation, Predictor, PushError, PushPlan, PushPlanner,
    PushSettings, Pushed, Pushing, Stroke, yaw_rad,
};
use rigidformer_planning::planner::{Control, Cut, Event, PlanError, SettingsError};
use rigidformer_runtime::core::{Limits, Physics, Plane, Posed, Role, Unit};
use rigidformer_runtime::engine::Engine;
use rigidformer_runtime::futures::BatchSimulator;
use rigidformer_runtime::models::LoadedModel;
use rigidformer_runtime::threads::Threads;
use rigidformer_runtime::world::World;

const STEP_S: f32 = 1.0 / 60.0;
const RADIUS_M: f32 = 0.012;
const PHYSICS: Physics = Physics { mass_kg: 0.1, friction: 0.5, restitution: 0.0 };
const GRAVITY: Vector3<f32> = Vector3::new(0.0, 0.0, -9.81);

fn nano() -> LoadedModel {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("../weights/models/nano.rfm");
    LoadedModel::open(&path).unwrap().for_host().unwrap()
}

fn cube() -> Vec<Point3<f32>> {
    let side = |i: usize, bit| if i & bit == 0 { -0.025 } else { 0.025 };
    (0..8).map(|i| Point3::new(side(i, 1), side(i, 2), side(i, 4))).collect()
}

/// A standing stick of eight sides.
fn stick() -> Vec<Point3<f32>> {
    let corner = |i: usize| {
        let (sin, cos) = (std::f32::consts::TAU * (i % 8) as f32 / 8.0).sin_cos();
        Point3::new(RADIUS_M * cos, RADIUS_M * sin, if i < 8 { -0.02 } else { 0.02 })
    };
    (0..16).map(corner).collect()
}

fn ground() -> [Plane; 1] {
    [Plane::ground(1.0, 0.0)]
}

/// The cube at the origin, the stick to its right.
fn observation() -> Observation {
    let (body, pusher) =
        (Isometry3::translation(0.0, 0.0, 0.025), Isometry3::translation(0.1, 0.02, 0.025));
    Observation { body_before: body, body, pusher_before: pusher, pusher }
}

fn with_predictor<R>(threads: usize, body: impl FnOnce(&mut ModelPredictor<'_>) -> R) -> R {
    let (cube, stick, planes) = (cube(), stick(), ground());
    let engine = Engine { threads: Threads::new(threads), ..Engine::new().unwrap() };
    body(&mut ModelPredictor {
        simulator: BatchSimulator::new(engine, &nano()),
        body: Unit::new(&cube, PHYSICS),
        pusher: Unit::new(&stick, PHYSICS),
        planes: Some(&planes),
        gravity_m_s2: Some(GRAVITY),
        step_s: STEP_S,
    })
}

fn plan<P: Predictor>(
    planner: &mut PushPlanner<'_>,
    observation: &Observation,
    predictor: &mut P,
    goal: &Goal,
) -> Result<PushPlan, PushError<P::Error>> {
    let cost = |pushed: &Pushed<'_>| goal.cost(pushed);
    planner.plan(observation, predictor, goal, &cost, Control::none(&mut |_| {}))
}

/// Pushes in the model as the world, planned in the model: plans, and where the cube ends.
fn play(threads: usize, seed: u64, goal: &Goal) -> (Vec<PushPlan>, Isometry3<f32>) {
    let (points, stick, model) = (cube(), stick(), nano());
    let settings = PushSettings { seed, ..PushSettings::default() };
    let mut planner = PushPlanner::new(settings, Pushing::new(&points, RADIUS_M)).unwrap();
    let mut observation = observation();
    let limits = Limits { units: 2, points: 24 };
    let mut world = World::on(Engine::new().unwrap().single(), &model, limits, 1).unwrap();
    let units =
        [(&points, observation.body, Role::Free), (&stick, observation.pusher, Role::Driven)];
    let units = units.map(|(points, pose, role)| Posed {
        unit: Unit::new(points, PHYSICS).role(role),
        previous: pose,
        current: pose,
    });
    world
        .edit(|simulator| {
            simulator.set_planes(&ground())?;
            simulator.set_gravity(GRAVITY)
        })
        .unwrap();
    world.edit(|simulator| simulator.observe_poses(STEP_S, units)).unwrap();
    let [body, pusher] = [0, 1].map(|unit| world.simulator().unit(unit).unwrap().id());
    let mut plans = Vec::new();
    with_predictor(threads, |predictor| {
        for _ in 0..16 {
            let plan = plan(&mut planner, &observation, predictor, goal).unwrap();
            let (cost, stay) = (plan.cost, plan.stay);
            plans.push(plan);
            if cost > stay - 0.001 {
                break;
            }
            let plan = plans.last().unwrap();
            let path = &plan.path_m[..plan.path_m.len().min(24)];
            for [x, y] in path {
                world.drive(pusher, &Isometry3::translation(*x, *y, 0.025)).unwrap();
                world.step().unwrap();
            }
            let of = |id| world.simulator().get(id).unwrap();
            observation = Observation {
                body_before: of(body).previous_pose(),
                body: of(body).pose(),
                pusher_before: of(pusher).previous_pose(),
                pusher: of(pusher).pose(),
            };
            planner.passed(plan, path.len());
        }
    });
    (plans, observation.body)
}

#[test]
fn a_cube_comes_to_its_goal_and_turn() {
    let goal = Goal::new([-0.12, 0.07], 0.5);
    let (plans, last) = play(2, 1, &goal);
    let (metres, radians) = goal.errors(&last);
    assert!(metres < 0.01 && radians < 0.1, "{metres} m, {radians} rad, {} plans", plans.len());
    assert!(plans.iter().all(|plan| plan.search.cut.is_none()));
}

#[test]
fn the_same_seed_gives_the_same_plans_on_any_number_of_threads() {
    let goal = Goal::new([0.05, -0.06], -0.3);
    let one = play(1, 7, &goal);
    assert_eq!(one, play(2, 7, &goal));
    assert_ne!(one.0[0], play(2, 8, &goal).0[0]);
}

#[test]
fn paths_keep_off_the_cube_and_end_at_the_push() {
    let points = cube();
    let pushing = Pushing::new(&points, RADIUS_M);
    let mut planner = PushPlanner::new(PushSettings::default(), pushing.clone()).unwrap();
    // The goal is where the stick is: it has to go around.
    let goal = Goal::new([0.2, 0.0], 0.0);
    let plan = with_predictor(2, |predictor| plan(&mut planner, &observation(), predictor, &goal))
        .unwrap();
    assert!(plan.push.heading_rad.abs() < 0.6, "{plan:?}");
    assert!(plan.approach > 5 && plan.approach < plan.path_m.len());
    let (approach, push) = plan.path_m.split_at(plan.approach);
    let room = |[x, y]: &[f32; 2]| {
        let outside = |v: f32| (v.abs() - 0.025).max(0.0);
        (outside(*x).powi(2) + outside(*y).powi(2)).sqrt()
    };
    assert!(approach.iter().all(|place| room(place) > RADIUS_M), "{approach:?}");
    assert!(push.iter().any(|place| room(place) < RADIUS_M));
    let mut here = [0.1, 0.02];
    for (index, place) in plan.path_m.iter().enumerate() {
        let way = (place[0] - here[0]).hypot(place[1] - here[1]);
        let most = if index < plan.approach { pushing.travel_m_s } else { pushing.push_m_s };
        assert!(way <= most * STEP_S * 1.001, "step {index}: {way} m");
        here = *place;
    }
    let (end, touched) = (plan.poses.last().unwrap(), plan.poses.len() - push.len());
    assert_eq!(touched, 3); // settling
    assert!(end.translation.x > 0.05 && yaw_rad(end).abs() < 0.5, "{end:?}");
}

#[test]
fn without_contact_no_push_is_worth_its_time() {
    let points = cube();
    let pushing = Pushing::new(&points, RADIUS_M);
    let mut planner = PushPlanner::new(PushSettings::default(), pushing).unwrap();
    let mut free = FreeMotion { gravity_m_s2: GRAVITY, step_s: STEP_S };
    let plan = plan(&mut planner, &observation(), &mut free, &Goal::new([-0.1, 0.0], 0.0)).unwrap();
    assert!(plan.cost > plan.stay);
}

#[test]
fn plans_end_when_they_must() {
    let points = cube();
    let goal = Goal::new([-0.1, 0.0], 0.0);
    let cost = |pushed: &Pushed<'_>| goal.cost(pushed);
    let mut planner =
        PushPlanner::new(PushSettings::default(), Pushing::new(&points, RADIUS_M)).unwrap();
    with_predictor(2, |predictor| {
        let mut unwatched = |_: Event<'_>| {};
        let now = Control { deadline: Some(Instant::now()), ..Control::none(&mut unwatched) };
        let cut = planner.plan(&observation(), predictor, &goal, &cost, now).unwrap_err();
        assert_eq!(cut, PushError::Plan(PlanError::Cut(Cut::Deadline)));
        // After the first iteration.
        let cancelled = AtomicBool::new(false);
        let mut watch = |_: Event<'_>| cancelled.store(true, Ordering::Relaxed);
        let control = Control { deadline: None, cancelled: &cancelled, watch: &mut watch };
        let plan = planner.plan(&observation(), predictor, &goal, &cost, control).unwrap();
        assert_eq!((plan.search.cut, plan.search.iterations), (Some(Cut::Cancelled), 1));
        assert!(plan.cost < plan.stay);
    });
}

#[test]
fn what_cannot_be_is_said() {
    let points = cube();
    let wrong = |settings: PushSettings, pushing: Pushing<'_>| {
        PushPlanner::new(settings, pushing).unwrap_err().to_string()
    };
    let (settings, pushing) = (PushSettings::default(), Pushing::new(&points, RADIUS_M));
    let none = PushSettings { futures: 0, ..settings };
    assert!(wrong(none, pushing.clone()).contains("futures is 0"));
    let many = PushSettings { futures: 1 << 17, ..settings };
    assert!(wrong(many, pushing.clone()).contains("futures, times"));
    let wide = PushSettings { heading_rad: f32::NAN, ..settings };
    assert!(wrong(wide, pushing.clone()).contains("deviation"));
    for (what, pushing) in [
        ("radius_m", Pushing { radius_m: 0.0, ..pushing.clone() }),
        ("step_s", Pushing { step_s: -1.0, ..pushing.clone() }),
        ("push_m_s", Pushing { push_m_s: f32::NAN, ..pushing.clone() }),
        ("travel_m_s", Pushing { travel_m_s: f32::INFINITY, ..pushing.clone() }),
        ("room_m", Pushing { room_m: 0.0, ..pushing.clone() }),
        ("longest_m", Pushing { longest_m: 0.001, ..pushing.clone() }),
        ("settle_s", Pushing { settle_s: -0.1, ..pushing.clone() }),
        ("of settling", Pushing { settle_s: 1e30, ..pushing.clone() }),
        ("longest push", Pushing { longest_m: 1e30, ..pushing.clone() }),
        ("longest push", Pushing { step_s: 1e-30, ..pushing.clone() }),
    ] {
        assert!(wrong(settings, pushing).contains(what), "{what}");
    }
    let mut free = FreeMotion { gravity_m_s2: GRAVITY, step_s: STEP_S };
    let goal = Goal::new([0.1, 0.0], 0.0);
    let flat: Vec<_> = (0..4).map(|i| Point3::new(i as f32, 0.0, 0.0)).collect();
    let mut planner = PushPlanner::new(settings, Pushing::new(&flat, RADIUS_M)).unwrap();
    let error = plan(&mut planner, &observation(), &mut free, &goal).unwrap_err();
    assert!(matches!(error, PushError::Outline { corners: ..3 }), "{error}");
    let mut planner = PushPlanner::new(settings, pushing).unwrap();
    let goal = Goal::new([0.1, 0.0], 0.0);
    for (what, nowhere) in [
        ("place_m", Goal::new([f32::NAN, 0.0], 0.0)),
        ("place_m", Goal::new([0.0, 2e6], 0.0)),
        ("yaw_rad", Goal::new([0.0, 0.0], f32::INFINITY)),
        ("lever_m", Goal { lever_m: -1.0, ..goal }),
        ("haste_m_s", Goal { haste_m_s: f32::NAN, ..goal }),
    ] {
        let error = plan(&mut planner, &observation(), &mut free, &nowhere).unwrap_err();
        assert!(matches!(error, PushError::Settings(SettingsError::Range { .. })), "{error}");
        assert!(error.to_string().starts_with(what), "{what}: {error}");
    }
}

#[test]
fn a_plan_of_another_planner_is_cut_to_the_bounds() {
    let points = cube();
    let far = Goal::new([-2.0, 0.0], 0.0);
    let long = Pushing { longest_m: 1.0, ..Pushing::new(&points, RADIUS_M) };
    with_predictor(1, |predictor| {
        let mut other = PushPlanner::new(PushSettings::default(), long).unwrap();
        let foreign = plan(&mut other, &observation(), predictor, &far).unwrap();
        assert!(foreign.push.length_m > 0.5);
        let mut planner =
            PushPlanner::new(PushSettings::default(), Pushing::new(&points, RADIUS_M)).unwrap();
        planner.passed(&foreign, 1);
        let own = plan(&mut planner, &observation(), predictor, &far).unwrap();
        assert!(own.push.length_m <= 0.12);
    });
}

#[test]
fn a_long_way_around_is_a_way() {
    let points = cube();
    let mut planner =
        PushPlanner::new(PushSettings::default(), Pushing::new(&points, RADIUS_M)).unwrap();
    let mut observation = observation();
    for pose in [&mut observation.pusher_before, &mut observation.pusher] {
        pose.translation.x = 200.0;
    }
    let goal = Goal::new([-0.1, 0.0], 0.0);
    let plan =
        with_predictor(1, |predictor| plan(&mut planner, &observation, predictor, &goal)).unwrap();
    assert!(plan.approach > 20_000 && plan.cost < 5_000.0, "{}", plan.approach);
    assert!(plan.path_m.len() - plan.approach < 60);
}

#[test]
fn paths_without_end_are_no_pushes() {
    let points = cube();
    let mut free = FreeMotion { gravity_m_s2: GRAVITY, step_s: STEP_S };
    // So far away, and where coordinates are so coarse that a step leads nowhere.
    let moved = |body: f32, pusher: f32| {
        let mut observation = observation();
        for pose in [&mut observation.body_before, &mut observation.body] {
            pose.translation.x += body;
        }
        for pose in [&mut observation.pusher_before, &mut observation.pusher] {
            pose.translation.x += pusher;
        }
        observation
    };
    for (body, pusher) in [(0.0, 9e5), (9e5, 9e5), (0.0, f32::INFINITY), (0.0, f32::NAN)] {
        let mut planner =
            PushPlanner::new(PushSettings::default(), Pushing::new(&points, RADIUS_M)).unwrap();
        let goal = Goal::new([body - 0.1, 0.0], 0.0);
        let error = plan(&mut planner, &moved(body, pusher), &mut free, &goal).unwrap_err();
        let said = match pusher.is_finite() {
            true => matches!(error, PushError::Unreachable { .. } | PushError::Outline { .. }),
            false => error.to_string().starts_with("the pusher's previous pose is"),
        };
        assert!(said, "{body} {pusher}: {error}");
    }
}

#[test]
fn strokes_that_cannot_be_predicted_have_no_poses() {
    let stroke = |places_m: Vec<[f32; 2]>| Stroke { from_m: [0.1, 0.0], at_hand: false, places_m };
    let strokes = [
        stroke(vec![[0.095, 0.0], [0.09, 0.0]]),
        stroke(Vec::new()),
        stroke(vec![[f32::NAN, 0.0]]),
        stroke(vec![[0.097, 0.0]; 4]),
    ];
    let mut found = Vec::new();
    with_predictor(1, |predictor| {
        predictor.predict(&observation(), &strokes, &|| None, &mut found).unwrap();
    });
    assert_eq!(found.iter().map(Vec::len).collect::<Vec<_>>(), [2, 0, 0, 4]);
}
