//! Several walking robots in one space: what walking past each other does to their paths, what neighbours do to their
//! accuracy, and what it costs.
//!
//! `several walk SCENES [COUNT]`: a file of G1 walks, of which so many are measured. `several arm ARMS PUSHES`: files of the same
//! pushes, without the cube and with it (docs/ROBOTS.md): an arm moves by its model, and a box that it pushes by impulses.

use std::env;
use std::error::Error;
use std::path::Path;
use std::sync::OnceLock;
use std::time::Instant;

use nalgebra::{Isometry3, Vector3};
use rigidformer_evaluation::metrics::{FrameErrors, frame_errors, mean};
use rigidformer_evaluation::pivots::joined;
use rigidformer_evaluation::robots::leader;
use rigidformer_evaluation::rollout::Trajectory;
use rigidformer_evaluation::scenes::{Dataset, RecordedScene};
use rigidformer_runtime::core::{Limits, Plane, Posed, Role};
use rigidformer_runtime::group::{Group, MemberId};
use rigidformer_runtime::models::LoadedModel;
use rigidformer_runtime::pivots;
use rigidformer_runtime::poses::heading;
use rigidformer_runtime::threads::Threads;
use rigidformer_runtime::world::World;

/// Frames of a step, at 30 a second.
const STEP: usize = 10;
/// Frames of a walk that are predicted.
const LAST: usize = 300;
/// Metres between the paths of two that walk past each other.
const ASIDE_M: f32 = 0.8;
/// Neighbour distances that are compared, metres.
const DISTANCES_M: [f32; 4] = [0.0, 0.3, 1.0, 3.0];

type Outcome<T> = Result<T, Box<dyn Error>>;

fn main() -> Outcome<()> {
    let arguments: Vec<String> = env::args().skip(1).collect();
    let words: Vec<&str> = arguments.iter().map(String::as_str).collect();
    match words[..] {
        ["walk", scenes] => walk(Path::new(scenes), usize::MAX),
        ["walk", scenes, count] => walk(Path::new(scenes), count.parse()?),
        ["arm", arms, pushes] => arm(Path::new(arms), Path::new(pushes)),
        _ => Err("several walk SCENES [COUNT], or: several arm ARMS PUSHES".into()),
    }
}

fn shipped(name: &str) -> Outcome<LoadedModel> {
    let models = Path::new(env!("CARGO_MANIFEST_DIR")).join("../weights/models");
    Ok(LoadedModel::open(&models.join(name))?.for_host()?)
}

fn walk(path: &Path, count: usize) -> Outcome<()> {
    let (model, dataset) = (shipped("g1.rfm")?, Dataset::open(path)?);
    let scenes =
        (0..dataset.len().min(count)).map(|scene| Ok(joined(dataset.scene(scene, None)?, STEP)?));
    let scenes = scenes.collect::<Outcome<Vec<_>>>()?;
    let [one, .., other] = scenes.as_slice() else { return Err("give two walks or more".into()) };
    past(&model, [one, other])?;
    accuracy(&model, &scenes)?;
    cost(&model, one)
}

/// Errors of a cube that an arm pushes: the arm by its model, the cube by impulses, with the network of edge and without.
fn arm(arms: &Path, pushes: &Path) -> Outcome<()> {
    let (model, edge) = (shipped("arm.rfm")?, shipped("edge.rfm")?);
    let (arms, pushes) = (Dataset::open(arms)?, Dataset::open(pushes)?);
    println!(
        "cube from where it was recorded, mm: median and 90 % of the scenes, at the end of the push; how far it moved; the last finger from where it was recorded"
    );
    for (by, predicts, network) in [
        ("the recorded arm, impulses", false, false),
        ("the recorded arm, edge", false, true),
        ("the model's arm, impulses", true, false),
        ("the model's arm, edge", true, true),
    ] {
        let (mut errors, mut ways, mut hands) = (Vec::new(), Vec::new(), Vec::new());
        for number in 0..arms.len() {
            let (scene, whole) = (arms.scene(number, None)?, pushes.scene(number, None)?);
            let cube = whole.units().len() - 1;
            let at = |frame| whole.pose(frame, cube).copied().ok_or("too short");
            let mut group = Group::new();
            let mut world = robot(&model, &scene, &Isometry3::identity(), 0)?;
            if !predicts {
                let links: Vec<_> = world.simulator().units().map(|unit| unit.id()).collect();
                links.iter().skip(1).try_for_each(|id| {
                    world.edit(|simulator| simulator.set_role(*id, Role::Driven))
                })?;
            }
            let robot = group.add("arm", world)?;
            let mut world = World::new(&edge, Limits { units: 16, points: 4096 })?;
            world.set_dt(STEP as f32 / whole.frame_rate_hz())?;
            world.set_gravity(whole.gravity_m_s2())?;
            world.set_contact_law(whole.contact_law())?;
            world.set_planes(whole.planes().unwrap_or(&[Plane::ground(1.0, 0.0)]))?;
            world.set_network(network);
            let id = world.add(&whole.units()[cube].as_unit(), &at(STEP)?)?;
            let boxes = group.add("cube", world)?;
            for frame in (STEP..LAST).step_by(STEP) {
                let command = scene.command_of_step(frame, frame + STEP).ok_or("no command")?;
                group.set_command(robot, &command)?;
                let world = group.world_mut(robot).ok_or("gone")?;
                let links: Vec<_> = world.simulator().units().map(|unit| unit.id()).collect();
                for (number, link) in links.iter().enumerate().skip(1).filter(|_| !predicts) {
                    world.drive(*link, scene.pose(frame + STEP, number).ok_or("too short")?)?;
                }
                group.step()?;
            }
            let found = group.world(boxes).and_then(|world| world.pose(id)).ok_or("gone")?;
            let apart = |a: Isometry3<f32>, b: Isometry3<f32>| {
                f64::from((a.translation.vector - b.translation.vector).norm()) * 1e3
            };
            errors.push(apart(found, at(LAST)?));
            let hand = scene.units().len() - 1;
            let found = group
                .world(robot)
                .and_then(|world| world.simulator().unit(hand))
                .ok_or("gone")?
                .pose();
            hands.push(apart(found, *scene.pose(LAST, hand).ok_or("too short")?));
            ways.push(apart(at(STEP)?, at(LAST)?));
        }
        errors.sort_by(f64::total_cmp);
        println!(
            "{by}: {:.1} {:.1}; {:.0}; {:.1}",
            errors[errors.len() / 2],
            errors[errors.len() * 9 / 10],
            median(ways),
            median(hands)
        );
    }
    Ok(())
}

/// A world with a robot that starts at a place, with room for others.
fn robot(
    model: &LoadedModel,
    scene: &RecordedScene,
    at: &Isometry3<f32>,
    others: usize,
) -> Outcome<World> {
    let too_short = "the scene is too short";
    let poses = [0, STEP].map(|frame| scene.poses_at(frame).ok_or(too_short));
    let [previous, current] = poses;
    let units: Vec<Posed<'_>> = scene
        .units()
        .iter()
        .zip(previous?.into_iter().zip(current?))
        .map(|(unit, (previous, current))| Posed {
            unit: unit.as_unit(),
            previous: at * previous,
            current: at * current,
        })
        .collect();
    let limits =
        Limits { units: units.len() * (1 + others), points: scene.points() * (1 + others) };
    let mut world = World::new(model, limits)?;
    world.edit(|simulator| {
        simulator.set_gravity(scene.gravity_m_s2())?;
        simulator.set_planes(scene.planes().unwrap_or(&[Plane::ground(0.0, 0.0)]))?;
        simulator.observe_poses(STEP as f32 / scene.frame_rate_hz(), &units)?;
        pivots::hold(simulator, scene.pivots())?;
        simulator.set_command(&vec![0.0; scene.command_size()])?;
        Ok::<_, Box<dyn Error>>(())
    })?;
    Ok(world)
}

/// What carries a robot's first heading to a place and a direction, in turns.
fn placed(scene: &RecordedScene, x: f32, y: f32, turns: f32) -> Outcome<Isometry3<f32>> {
    let link = leader(scene).ok_or("no robot")?;
    let from = heading(scene.pose(STEP, link).ok_or("too short")?);
    let turn = Isometry3::rotation(Vector3::z() * (std::f32::consts::TAU * turns));
    Ok(Isometry3::translation(x, y, 0.0) * turn * from.inverse())
}

fn place(group: &Group, id: MemberId, link: usize) -> Outcome<Vector3<f32>> {
    let unit = group.world(id).and_then(|world| world.simulator().unit(link));
    Ok(unit.ok_or("no link")?.pose().translation.vector)
}

/// Two walk towards each other on paths that are some way apart.
fn past(model: &LoadedModel, scenes: [&RecordedScene; 2]) -> Outcome<()> {
    let at = [placed(scenes[0], 0.0, 0.0, 0.0)?, placed(scenes[1], 5.0, ASIDE_M, 0.5)?];
    let link = leader(scenes[0]).ok_or("no robot")?;
    let with = |members: &[usize], distance_m: Option<f32>| -> Outcome<Vec<Vec<Vector3<f32>>>> {
        let mut group = Group::new();
        for number in members {
            let world = robot(model, scenes[*number], &at[*number], 1)?;
            let id = group.add(["east", "west"][*number], world)?;
            group.set_command(id, &[0.5, 0.0, 0.0])?;
            group.set_neighbour_distance(id, distance_m)?;
        }
        let mut paths = vec![Vec::new(); members.len()];
        let (mut nearest, mut found) = (f32::INFINITY, 0);
        for step in 0..=LAST / STEP {
            if step > 0 {
                found += group.step()?.iter().map(|report| report.neighbours).sum::<usize>();
                let gaps = group.gaps_in_step(1.0)?;
                nearest = gaps.first().map_or(nearest, |gap| nearest.min(gap.gap_m));
            }
            for (path, id) in paths.iter_mut().zip(group.ids()) {
                path.push(place(&group, id, link)?);
            }
        }
        if members.len() > 1 {
            println!(
                "neighbours within {distance_m:?} m: least gap {nearest:.3} m, {found} neighbours in all"
            );
        }
        Ok(paths)
    };
    let alone = [with(&[0], None)?.remove(0), with(&[1], None)?.remove(0)];
    let blind = with(&[0, 1], None)?;
    let seeing = with(&[0, 1], Some(1.0))?;
    println!(
        "time s | east alone x y | together | neighbours | west alone x y | together | neighbours | apart m"
    );
    for sample in (0..=LAST / STEP).step_by(3) {
        let cell = |path: &[Vector3<f32>]| format!("{:6.2} {:6.2}", path[sample].x, path[sample].y);
        let apart = (blind[0][sample] - blind[1][sample]).xy().norm();
        println!(
            "{:5.1} | {} | {} | {} | {} | {} | {} | {apart:.2}",
            sample as f32 * STEP as f32 / 30.0,
            cell(&alone[0]),
            cell(&blind[0]),
            cell(&seeing[0]),
            cell(&alone[1]),
            cell(&blind[1]),
            cell(&seeing[1])
        );
    }
    let same = alone.iter().zip(&blind).all(|(alone, together)| alone == together);
    println!(
        "without neighbours the paths are {}",
        if same { "the same to the bit" } else { "OTHERS" }
    );
    Ok(())
}

/// Errors of recorded walks beside another robot, which walks beside it.
fn accuracy(model: &LoadedModel, scenes: &[RecordedScene]) -> Outcome<()> {
    println!(
        "errors beside another walk that begins {ASIDE_M} m aside, metres / degrees at frames 50, 100, 200, 300; neighbours a step"
    );
    let distances = [None].into_iter().chain(DISTANCES_M.map(Some));
    for distance_m in distances {
        let mut all: [Vec<FrameErrors>; 4] = Default::default();
        let (mut found, mut steps) = (0, 0);
        for (number, scene) in scenes.iter().enumerate() {
            let other = &scenes[(number + 1) % scenes.len()];
            let link = leader(scene).ok_or("no robot")?;
            let here = heading(scene.pose(STEP, link).ok_or("too short")?);
            let there = here * placed(other, 0.0, ASIDE_M, 0.0)?;
            let mut group = Group::new();
            let one = group.add("one", robot(model, scene, &Isometry3::identity(), 1)?)?;
            let two = group.add("other", robot(model, other, &there, 1)?)?;
            group.set_neighbour_distance(one, distance_m)?;
            let mut walk = Trajectory::new(0, STEP as u32, scene.poses_at(0).ok_or("too short")?);
            walk.push(scene.poses_at(STEP).ok_or("too short")?);
            for frame in (STEP..LAST).step_by(STEP) {
                for (id, scene) in [(one, scene), (two, other)] {
                    let command = scene.command_of_step(frame, frame + STEP).ok_or("no command")?;
                    group.set_command(id, &command)?;
                }
                found += group.step()?[0].neighbours;
                steps += 1;
                let world = group.world(one).ok_or("gone")?;
                walk.push(world.simulator().units().map(|unit| unit.pose()));
            }
            for (all, frame) in all.iter_mut().zip([50, 100, 200, 300]) {
                all.push(frame_errors(&walk, scene, frame).ok_or("no such frame")?);
            }
        }
        let cells = all.map(|errors| {
            let FrameErrors { position_m, orientation_rms_deg, .. } = mean(&errors);
            format!("{position_m:.3}/{orientation_rms_deg:.2}")
        });
        let name = distance_m.map_or("none".into(), |distance| format!("within {distance} m"));
        println!("neighbours {name:12}: {}; {:.1}", cells.join(" "), found as f64 / steps as f64);
    }
    Ok(())
}

/// Milliseconds of a step of 1, 2, 4 and 8 robots, in turns: the median, and the median of the ratio to one in the same turn.
fn cost(model: &LoadedModel, scene: &RecordedScene) -> Outcome<()> {
    const TURNS: usize = 9;
    // Linux counts processor time in ticks of some milliseconds.
    const STEPS: usize = 40;
    println!("processor time of a step on one thread (Linux; elsewhere time by the clock)");
    let cases = [(None, 20.0), (Some(0.3), 20.0), (Some(0.3), ASIDE_M)];
    for (distance_m, apart) in cases {
        let mut times: [Vec<f64>; 4] = Default::default();
        let mut found = [0; 4];
        for _ in 0..TURNS {
            for ((count, times), found) in [1, 2, 4, 8].into_iter().zip(&mut times).zip(&mut found)
            {
                let mut group = Group::on(Threads::ONE);
                for number in 0..count {
                    let at = placed(scene, 0.0, apart * number as f32, 0.0)?;
                    let id = group.add(&number.to_string(), robot(model, scene, &at, 7)?)?;
                    group.set_neighbour_distance(id, distance_m)?;
                    group.set_command(id, &[0.5, 0.0, 0.0])?;
                }
                *found = group.step()?.iter().map(|report| report.neighbours).sum();
                let begin = processor_ms();
                for _ in 0..STEPS {
                    *found += group.step()?.iter().map(|report| report.neighbours).sum::<usize>();
                }
                times.push((processor_ms() - begin) / STEPS as f64);
            }
        }
        for ((count, of), found) in [1, 2, 4, 8].iter().zip(&times).zip(found) {
            println!(
                "neighbours within {distance_m:?} m, {apart} m apart, {count} robots: {:.2} ms, {:.2} times one; {:.0} neighbours a step",
                median(of.clone()),
                median(of.iter().zip(&times[0]).map(|(many, one)| many / one).collect()),
                found as f64 / (STEPS + 1) as f64,
            );
        }
    }
    Ok(())
}

/// Of this thread: what other programs take does not count.
fn processor_ms() -> f64 {
    static BEGIN: OnceLock<Instant> = OnceLock::new();
    let of_linux = || {
        let text = std::fs::read_to_string("/proc/thread-self/schedstat").ok()?;
        text.split_whitespace().next()?.parse::<f64>().ok()
    };
    of_linux().map_or_else(
        || BEGIN.get_or_init(Instant::now).elapsed().as_secs_f64() * 1e3,
        |nanoseconds| nanoseconds * 1e-6,
    )
}

fn median(mut values: Vec<f64>) -> f64 {
    values.sort_by(f64::total_cmp);
    values[values.len() / 2]
}
