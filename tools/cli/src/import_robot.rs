//! `rigidformer import-robot`

use std::path::PathBuf;

use nalgebra::{Isometry3, Translation3};
use rigidformer_core::Limits;
use rigidformer_evaluation::scenes::{Dataset, SceneNotes};
use rigidformer_robots::{
    LoadOptions, MeshSetOptions, Robot, RobotScene, SceneOptions, load_meshes, load_robot_with,
};
use rigidformer_runtime::engine::Engine;
use rigidformer_runtime::futures::StartState;
use serde_json::{Value, json};

use crate::arguments::ImportRobot;
use crate::usage::Usage;
use crate::{defaults, interrupt, output};

/// Notes that are said, at most.
const MOST_NOTES: usize = 20;

pub(crate) fn run(arguments: &ImportRobot) -> anyhow::Result<()> {
    interrupt::watch();
    output::apart("--out", &arguments.out, [arguments.input.as_path()])?;
    check(arguments)?;
    if let Some(state) = &arguments.state {
        let others = [arguments.input.as_path(), arguments.out.as_path()];
        output::apart("--state", state, others)?;
        if let Some(model) = &arguments.model.path {
            output::apart("--state", state, [model.as_path()])?;
        }
    }
    let robot = read(arguments)?;
    // Files that a robot names are known once it is read, and nothing is written yet.
    output::apart("--out", &arguments.out, robot.files.iter().map(PathBuf::as_path))?;
    if let Some(state) = &arguments.state {
        output::apart("--state", state, robot.files.iter().map(PathBuf::as_path))?;
    }
    interrupt::check()?;
    let made = robot.scene(&scene_options(arguments)?)?;
    let notes = SceneNotes {
        dataset: robot.name.clone(),
        provenance: "A robot at rest, read by `rigidformer import-robot`.".into(),
        licence: arguments.licence.clone(),
    };
    let bytes = made.file(&arguments.out, &notes)?;
    // What another command would refuse is not written.
    let dataset = Dataset::from_bytes(arguments.out.clone(), bytes)?;
    dataset.scene(0, None)?;
    let state = state(arguments, &made)?;
    interrupt::check()?;
    output::write_whole(&arguments.out, dataset.bytes())?;
    if let (Some(path), Some(state)) = (&arguments.state, &state) {
        output::write_whole(path, state.snapshot().as_bytes())?;
    }
    told(arguments, &robot, (&made, dataset.bytes().len()), state.as_ref())
}

/// The scene as a state, where one is asked for.
fn state(arguments: &ImportRobot, made: &RobotScene) -> anyhow::Result<Option<StartState>> {
    if arguments.state.is_none() {
        return Ok(None);
    }
    let model = defaults::model(&arguments.model)?.for_host()?;
    Ok(Some(made.world(Engine::new()?, &model)?.start()?))
}

fn check(arguments: &ImportRobot) -> Result<(), Usage> {
    let at_least_0 = |number: f32| (0.0..=1e3).contains(&number);
    let wrong = [
        (!(4..=4096).contains(&arguments.points), "--points: give 4 to 4096"),
        (
            !(arguments.fps > 0.0 && arguments.fps <= 1e6),
            "--fps: give a number above 0, at most a million",
        ),
        (!at_least_0(arguments.friction), "--friction: give 0 to 1000"),
        (!at_least_0(arguments.restitution), "--restitution: give 0 to 1000"),
        (
            arguments.density.is_some_and(|density| !(1e-3..=1e6).contains(&density)),
            "--density: give 0.001 to a million kg/m^3",
        ),
        (
            arguments.scale.is_some_and(|scale| !(1e-10..=1e6).contains(&scale)),
            "--scale: give 1e-10 to 1e6",
        ),
    ];
    // What has no effect is a mistake.
    let (of_files, of_folders) = (
        "is for a robot's file, and has no effect on a folder of meshes; leave it out",
        "is for a folder of meshes, and has no effect on a robot's file; leave it out",
    );
    let is_folder = arguments.input.is_dir();
    let idle = [
        ("--package-path", is_folder && !arguments.package_path.is_empty(), of_files),
        ("--skip-meshes", is_folder && arguments.skip_meshes, of_files),
        ("--merge-fixed", is_folder && arguments.merge_fixed, of_files),
        ("--balance", is_folder && arguments.balance, of_files),
        ("--fixed-base", is_folder && arguments.fixed_base, of_files),
        ("--density", !is_folder && arguments.density.is_some(), of_folders),
        (
            "--model",
            arguments.state.is_none() && arguments.model.path.is_some(),
            "is for --state; give both",
        ),
        ("--scale", !is_folder && arguments.scale.is_some(), of_folders),
    ];
    if let Some((option, _, text)) = idle.into_iter().find(|(_, is_idle, _)| *is_idle) {
        return Err(Usage(format!("{option} {text}")));
    }
    match wrong.into_iter().find(|(is_wrong, _)| *is_wrong) {
        Some((_, text)) => Err(Usage(text.into())),
        None => Ok(()),
    }
}

fn read(arguments: &ImportRobot) -> anyhow::Result<Robot> {
    if arguments.input.is_dir() {
        let mut options = MeshSetOptions::default();
        options.density_kg_m3 = arguments.density.unwrap_or(options.density_kg_m3);
        options.scale = arguments.scale.unwrap_or(options.scale);
        return Ok(load_meshes(&arguments.input, &options)?);
    }
    let mut options = LoadOptions::default();
    options.package_paths = arguments.package_path.clone();
    options.skip_missing_meshes = arguments.skip_meshes;
    options.merge_fixed = arguments.merge_fixed;
    options.balance_inertia = arguments.balance;
    Ok(load_robot_with(&arguments.input, &options)?)
}

fn scene_options(arguments: &ImportRobot) -> anyhow::Result<SceneOptions> {
    let numbers: Option<Vec<f64>> =
        arguments.at.split(',').map(|word| word.trim().parse().ok()).collect();
    let at = numbers.as_deref().and_then(|numbers| <[f64; 3]>::try_from(numbers).ok());
    let at = at.filter(|at| at.iter().all(|v| v.abs() <= 1e5));
    let [x, y, z] =
        at.ok_or_else(|| Usage(format!("--at {}: give three numbers, metres", arguments.at)))?;
    let mut options = SceneOptions::default();
    options.points = arguments.points;
    options.frame_rate_hz = arguments.fps;
    options.friction = arguments.friction;
    options.restitution = arguments.restitution;
    options.fixed_base = arguments.fixed_base;
    options.principal_frames = arguments.principal;
    options.base =
        Isometry3::from_parts(Translation3::new(x, y, z), nalgebra::UnitQuaternion::identity());
    Ok(options)
}

fn told(
    arguments: &ImportRobot,
    robot: &Robot,
    (made, bytes): (&RobotScene, usize),
    state: Option<&StartState>,
) -> anyhow::Result<()> {
    let notes: Vec<&String> = robot.notes.iter().chain(&made.notes).collect();
    let joined = made.scene.pivots().len();
    if arguments.json {
        let units = made.scene.units().iter().map(|unit| {
            json!({
                "name": unit.shape,
                "points": unit.points.len(),
                "pieces": unit.pieces.len(),
                "mass_kg": unit.physics.mass_kg,
                "inertia_kg_m2": unit.inertia,
                "body": unit.body,
            })
        });
        let mut document = robot.describe()?;
        if let Value::Object(fields) = &mut document {
            fields.insert("out".into(), arguments.out.display().to_string().into());
            fields.insert("bytes".into(), bytes.into());
            fields.insert("units".into(), units.collect());
            fields.insert("pivots".into(), joined.into());
            fields.insert("notes".into(), json!(notes));
            if let Some(state) = state {
                let Limits { units, points } = state.limits();
                let bytes = state.snapshot().as_bytes().len();
                let state = json!({ "bytes": bytes, "units": units, "points": points });
                fields.insert("state".into(), state);
            }
        }
        return output::json(&document);
    }
    for note in notes.iter().take(MOST_NOTES) {
        output::note(note);
    }
    if notes.len() > MOST_NOTES {
        output::note(&format!("{} more; --json has all", notes.len() - MOST_NOTES));
    }
    let moving = robot.joints.iter().filter(|joint| joint.kind.positions() > 0).count();
    output::line(format_args!(
        "{}: {} of {} links are units, {:.6} kg; {moving} joints that move, {joined} pivots; {bytes} bytes",
        arguments.out.display(),
        made.links.len(),
        robot.links.len(),
        robot.mass_kg(),
    ))?;
    if let (Some(path), Some(state)) = (&arguments.state, state) {
        let Limits { units, points } = state.limits();
        let bytes = state.snapshot().as_bytes().len();
        let path = path.display();
        output::line(format_args!(
            "{path}: for limits of {units} units and {points} points; {bytes} bytes"
        ))?;
    }
    Ok(())
}
