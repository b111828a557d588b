//! `rigidformer rollout`

use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

use rigidformer_core::Model;
use rigidformer_evaluation::free_fall;
use rigidformer_evaluation::pivots::joined;
use rigidformer_evaluation::predicted::predict;
use rigidformer_evaluation::scenes::{Dataset, Problem, SceneError, SceneNotes, Split, scene_file};
use rigidformer_runtime::engine::Engine;
use rigidformer_runtime::progress::Progress;

use crate::arguments::Rollout;
use crate::comparison::Comparison;
use crate::csv_text::CsvText;
use crate::usage::Usage;
use crate::viewers::{Moving, Viewers};
use crate::{contact, defaults, drive, interrupt, output, picture};

/// Frames between rows of the printed table.
const TABLE_FRAMES: u32 = 10;
/// Where a rollout ends unless told otherwise: half a second at 240 Hz.
const DEFAULT_LAST_FRAME: u32 = 120;

/// The prediction as a scene file, of bodies that bend or break.
const PREDICTED: &str = "predicted.safetensors";
/// Files that `--out` may get.
const RESULTS: [&str; 5] = ["poses.csv", "errors.png", "strip.png", "walk.png", PREDICTED];
/// Instants that strip.png has room for.
const MOST_SHOWN: usize = 8;

pub(crate) fn run(arguments: &Rollout) -> anyhow::Result<()> {
    let cancelled = interrupt::watch();
    let viewers = Viewers::open(&arguments.viewers)?;
    let inputs = || {
        let paths = arguments.scene.iter().chain(&arguments.model.path);
        paths.chain(&arguments.contact.path).map(|path| path.as_path())
    };
    viewers.apart_from(inputs())?;
    let results = RESULTS.map(|name| arguments.out.join(name));
    for path in &results {
        output::apart("--out", path, inputs())?;
    }
    let own = results.iter().map(|path| ("--out", path.as_path()));
    output::distinct(own.chain(viewers.paths()))?;
    let dataset = defaults::dataset(arguments.scene.as_deref())?;
    let first_of_test = || dataset.scenes_of(Split::Test).first().copied().unwrap_or(0);
    let index = arguments.index.unwrap_or_else(first_of_test);
    if !arguments.command.is_empty() {
        return drive::run(arguments, &dataset, index, &viewers, cancelled);
    }
    // A scene that is not there is named below.
    let recorded = dataset.frames_of(index).unwrap_or_else(|| dataset.frames());
    let step = arguments.step_for(&dataset);
    let last_frame = last_frame(&dataset, recorded, step, arguments)?;
    check_shown(&arguments.show, last_frame)?;
    let scene = dataset.scene(index, Some(last_frame as usize + 1))?;
    let scene = contact::applied_to(&arguments.contact, scene)?;
    let scene = if arguments.join { joined(scene, step as usize)? } else { scene };
    let loaded = defaults::model(&arguments.model)?.for_host()?;
    let model = loaded.model();

    let steps = last_frame / step - 1;
    let bar = output::progress(u64::from(steps), scene.name());
    let stepped = || bar.inc(1);
    let started = Instant::now();
    let progress = Progress { cancelled, stepped: &stepped };
    let predicted = predict(Engine::new()?, &loaded, &scene, step, last_frame, progress)?;
    let took = started.elapsed();
    bar.finish_and_clear();

    let too_few = || anyhow::anyhow!("{}: free fall needs frames 0 and {step}", scene.name());
    let free_fall = free_fall::trajectory(&scene, 0, step, last_frame).ok_or_else(too_few)?;
    let comparison = Comparison {
        scene: &scene,
        model_name: model.file().name().to_owned(),
        predicted,
        free_fall,
    };
    print(model, &comparison, took / steps)?;
    let mut files = results_of(&arguments.out, &comparison, &dataset, &arguments.show)?;
    if viewers.is_asked() {
        let poses_are = format!("predicted by {}", comparison.model_name);
        let poses = &comparison.predicted.poses;
        files.extend(viewers.made(&Moving::of_rollout(&scene, poses_are, poses))?);
    }
    interrupt::check()?;
    output::folder(&arguments.out)?;
    output::write_results(&files, false)
}

/// Whether all frames to show are predicted, or lie between two that are.
fn check_shown(shown: &[u32], last_frame: u32) -> anyhow::Result<()> {
    let problem = if shown.len() > MOST_SHOWN {
        let remedy = "give fewer frames";
        format!("--show with {} frames: {MOST_SHOWN} have room; {remedy}", shown.len())
    } else if let Some(frame) = shown.iter().find(|frame| **frame > last_frame) {
        let remedy = "give an earlier frame, or a later end with --frames";
        format!("--show {frame}: frame {last_frame} is the last one predicted; {remedy}")
    } else {
        return Ok(());
    };
    Err(Usage(problem).into())
}

/// The last frame to predict: a multiple of the step that is recorded, with at least one prediction before it.
fn last_frame(
    dataset: &Dataset,
    recorded: usize,
    step: u32,
    arguments: &Rollout,
) -> anyhow::Result<u32> {
    if let Some(frames) = arguments.frames.filter(|frames| *frames < step.saturating_mul(2)) {
        let remedy = "frames 0 and S are observed, so the first prediction is frame 2 S: \
                      give more frames or a smaller step";
        return Err(Usage(format!(
            "--frames {frames} with --step {step}: nothing to predict; {remedy}"
        ))
        .into());
    }
    let last_recorded = u32::try_from(recorded - 1).unwrap_or(u32::MAX);
    let wanted = arguments
        .frames
        .unwrap_or_else(|| last_recorded.min(DEFAULT_LAST_FRAME.max(step.saturating_mul(2))));
    let needed = wanted.max(step.saturating_mul(2));
    if needed > last_recorded {
        let problem =
            Problem::TooFewFrames { recorded, asked: (needed as usize).saturating_add(1) };
        return Err(SceneError {
            path: dataset.path().into(),
            field: "tensor unit_poses".into(),
            problem,
        }
        .into());
    }
    Ok(wanted - wanted % step)
}

fn print(
    model: &Model<'_>,
    comparison: &Comparison<'_>,
    step_took: Duration,
) -> anyhow::Result<()> {
    let (scene, step) = (comparison.scene, comparison.predicted.poses.step());
    output::line(format_args!(
        "scene {}: {} units, {} points; model {}: {} parameters",
        scene.name(),
        scene.units().len(),
        scene.points(),
        comparison.model_name,
        model.file().parameters(),
    ))?;
    output::line(format_args!(
        "step {step}: predicts every {:.1} ms from frames 0 and {step}; took {:.2} ms a step",
        comparison.time_s(step) * 1e3,
        step_took.as_secs_f64() * 1e3,
    ))?;
    let first = (step / TABLE_FRAMES + 1) * TABLE_FRAMES;
    let frames = (first..=comparison.predicted.poses.last_frame()).step_by(TABLE_FRAMES as usize);
    if comparison.is_soft() {
        points_table(comparison, frames)?;
    } else {
        poses_table(comparison, frames)?;
    }
    if !TABLE_FRAMES.is_multiple_of(step) {
        let what = if comparison.is_soft() { "points" } else { "poses" };
        output::note(&format!(
            "between the predicted frames, which are {step} apart, {what} are interpolated"
        ));
    }
    Ok(())
}

fn poses_table(
    comparison: &Comparison<'_>,
    frames: impl Iterator<Item = u32>,
) -> anyhow::Result<()> {
    let header = ["frame", "time s", "position m", "free fall", "orientation deg", "free fall"];
    let mut table = output::table(header);
    for row in frames.filter_map(|frame| comparison.row(frame)) {
        output::row(
            &mut table,
            [
                row.frame.to_string(),
                format!("{:.3}", comparison.time_s(row.frame)),
                format!("{:.4}", row.model.position_m),
                format!("{:.4}", row.free_fall.position_m),
                format!("{:.2}", row.model.orientation_rms_deg),
                format!("{:.2}", row.free_fall.orientation_rms_deg),
            ],
        );
    }
    output::table_lines(&table)?;
    output::line("errors against the record, RMS over units")
}

fn points_table(
    comparison: &Comparison<'_>,
    frames: impl Iterator<Item = u32>,
) -> anyhow::Result<()> {
    let header = ["frame", "time s", "points m", "best rigid", "farthest m", "best rigid"];
    let mut table = output::table(header);
    for row in frames.filter_map(|frame| comparison.points_row(frame)) {
        output::row(
            &mut table,
            [
                row.frame.to_string(),
                format!("{:.3}", comparison.time_s(row.frame)),
                format!("{:.4}", row.model.mean_m),
                format!("{:.4}", row.rigid.mean_m),
                format!("{:.4}", row.model.most_m),
                format!("{:.4}", row.rigid.most_m),
            ],
        );
    }
    output::table_lines(&table)?;
    output::line(
        "distance of soft points from where they were recorded: the mean, and the farthest; beside the best rigid motion of each body, which is told the truth",
    )
}

/// The files of a folder, and their bytes.
fn results_of(
    folder: &Path,
    comparison: &Comparison<'_>,
    dataset: &Dataset,
    shown: &[u32],
) -> anyhow::Result<Vec<(PathBuf, Vec<u8>)>> {
    let mut files = vec![
        (folder.join("poses.csv"), poses_csv(comparison)),
        (folder.join("errors.png"), picture::errors(comparison)?),
        (folder.join("strip.png"), picture::strip(comparison, shown)?),
    ];
    let is_more = comparison.is_soft() || !comparison.scene.bonds().is_empty();
    let predicted = match is_more && comparison.scene.planes().is_some() {
        true => Some(comparison.predicted.as_scene(comparison.scene)?),
        false => None,
    };
    // Poses do not say where soft points are, nor which bonds hold.
    if let Some(scene) = predicted {
        let path = folder.join(PREDICTED);
        let bytes = scene_file(&path, &scene, &notes(comparison, dataset))?;
        files.push((path, bytes));
    }
    Ok(files)
}

/// What the file of a prediction says of itself.
fn notes(comparison: &Comparison<'_>, dataset: &Dataset) -> SceneNotes {
    let (model, of) = (&comparison.model_name, dataset.provenance());
    let (scene, step) = (comparison.scene.name(), comparison.predicted.poses.step());
    SceneNotes {
        dataset: format!("{} predicted", dataset.name()),
        provenance: format!(
            "Predicted by the model {model} with step {step} from frames 0 and {step} of {scene}. Those are: {of}"
        ),
        licence: dataset.licence().into(),
    }
}

fn poses_csv(comparison: &Comparison<'_>) -> Vec<u8> {
    let pose_columns = ["x", "y", "z", "qw", "qx", "qy", "qz"];
    let truth = pose_columns.map(|column| format!("true_{column}"));
    let head = ["frame", "time_s", "unit"].into_iter().chain(pose_columns);
    let mut csv = CsvText::new(head.chain(truth.iter().map(String::as_str)));
    for (frame, poses) in comparison.predicted.poses.iter() {
        for (unit, pose) in poses.iter().enumerate() {
            let Some(truth) = comparison.scene.pose(frame as usize, unit) else { continue };
            let numbers = [pose, truth].into_iter().flat_map(|pose| {
                let (t, q) = (pose.translation.vector, pose.rotation.quaternion());
                [t.x, t.y, t.z, q.w, q.i, q.j, q.k]
            });
            let head =
                [frame.to_string(), format!("{:.6}", comparison.time_s(frame)), unit.to_string()];
            csv.row(head.into_iter().chain(numbers.map(|number| number.to_string())));
        }
    }
    csv.into_bytes()
}
