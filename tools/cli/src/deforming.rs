//! `rigidformer evaluate` on soft bodies.

use std::sync::atomic::AtomicBool;

use rigidformer_evaluation::deforming::{self, Baseline, FRAMES, Figures, LAST_FRAME};
use rigidformer_evaluation::scenes::{Dataset, RecordedScene};
use rigidformer_runtime::models::LoadedModel;
use rigidformer_runtime::progress::Progress;
use serde_json::{Value, json};

use crate::arguments::Evaluate;
use crate::usage::{Usage, check_steps};
use crate::{interrupt, output};

/// Step code where none is given.
const STEP: u32 = 5;

/// Figures of one predictor.
struct Row {
    name: String,
    step: u32,
    figures: Figures,
}

/// Rolls all scenes out and prints how far points are from where they were recorded.
pub(crate) fn run(
    arguments: &Evaluate,
    dataset: &Dataset,
    scenes: &[RecordedScene],
    loaded: &LoadedModel,
    cancelled: &AtomicBool,
) -> anyhow::Result<()> {
    if arguments.picture.is_some() || arguments.join {
        let problem =
            "--picture and --join are for rigid units; `rigidformer rollout` draws soft ones";
        return Err(Usage(problem.into()).into());
    }
    let steps = arguments.steps_or(&[STEP]);
    check_steps(steps, scenes)?;
    let total: u64 = steps.iter().map(|step| u64::from(LAST_FRAME.div_ceil(*step))).sum();
    let bar = output::progress(total * scenes.len() as u64, dataset.name());
    let stepped = || bar.inc(1);
    let (mut ours, mut others) = (Vec::new(), Vec::new());
    for step in steps {
        let progress = Progress { cancelled, stepped: &stepped };
        let figures = deforming::model(loaded, scenes, *step, progress)?;
        ours.push(Row { name: loaded.model().file().name().to_owned(), step: *step, figures });
        for baseline in Baseline::ALL {
            let figures = deforming::baseline(baseline, scenes, *step);
            others.push(Row { name: baseline.name().to_owned(), step: *step, figures });
        }
    }
    bar.finish_and_clear();
    interrupt::check()?;
    let step = steps.first().copied().unwrap_or(STEP);
    let record = Row { name: "recorded".into(), step, figures: deforming::of_record(scenes, step) };
    match arguments.json {
        true => print_json(arguments, dataset, scenes, (&ours, &others, &record)),
        false => print_tables(arguments, dataset, scenes, (&ours, &others, &record)),
    }
}

fn print_tables(
    arguments: &Evaluate,
    dataset: &Dataset,
    scenes: &[RecordedScene],
    (ours, others, record): (&[Row], &[Row], &Row),
) -> anyhow::Result<()> {
    let split = rigidformer_evaluation::scenes::Split::from(arguments.split);
    let rate = scenes.first().map_or(0.0, RecordedScene::frame_rate_hz);
    let count = scenes.len();
    let name = dataset.name();
    output::line(format_args!("{name}, split {split}, {count} scenes at {rate} frames a second"))?;
    output::line(
        "mean distance of points from where they were recorded, m (% of the body's size), at frame after the second one seen",
    )?;
    let frames = FRAMES.map(|frame| frame.to_string());
    let head = ["predictor", "step"].into_iter().chain(frames.iter().map(String::as_str));
    let mut errors = output::table(head);
    for row in ours.iter().chain(others) {
        let cells = FRAMES.map(|frame| {
            let found = row.figures.errors.iter().find(|error| error.frame == frame);
            let cell = |e: &deforming::VertexErrors| {
                format!("{:.4} ({:4.1})", e.vertex_m, 100.0 * e.vertex_share)
            };
            found.map_or_else(|| "-".to_owned(), cell)
        });
        output::row(&mut errors, [row.name.clone(), row.step.to_string()].into_iter().chain(cells));
    }
    output::line(&errors)?;
    output::line(
        "\nat most, of 99 %: edges longer and shorter than at rest, change of volumes, points deep in balls and planes; largest tear",
    )?;
    let head = [
        "predictor",
        "step",
        "longer %",
        "shorter %",
        "volume %",
        "balls mm",
        "planes mm",
        "tear mm",
    ];
    let mut sound = output::table(head);
    for row in ours.iter().chain([record]) {
        let s = &row.figures.soundness;
        let cells = [
            format!("{:.1}", 100.0 * s.stretch_99),
            format!("{:.1}", 100.0 * s.shrink_99),
            format!("{:.1}", 100.0 * s.volume_99),
            format!("{:.1}", 1e3 * s.ball_depth_99_m),
            format!("{:.1}", 1e3 * s.plane_depth_99_m),
            format!("{:.1}", 1e3 * s.tear_m),
        ];
        output::row(&mut sound, [row.name.clone(), row.step.to_string()].into_iter().chain(cells));
    }
    output::line(&sound)
}

fn row_json(row: &Row) -> Value {
    let s = &row.figures.soundness;
    let errors = row.figures.errors.iter().map(|e| {
        json!({
            "frame": e.frame, "vertex_m": e.vertex_m, "vertex_share": e.vertex_share, "scenes": e.scenes,
        })
    });
    json!({
        "name": row.name,
        "step": row.step,
        "frames": errors.collect::<Vec<_>>(),
        "stretch_99": s.stretch_99,
        "shrink_99": s.shrink_99,
        "volume_99": s.volume_99,
        "ball_depth_99_m": s.ball_depth_99_m,
        "plane_depth_99_m": s.plane_depth_99_m,
        "tear_m": s.tear_m,
    })
}

fn print_json(
    arguments: &Evaluate,
    dataset: &Dataset,
    scenes: &[RecordedScene],
    (ours, others, record): (&[Row], &[Row], &Row),
) -> anyhow::Result<()> {
    let steps: Vec<Value> =
        ours.iter().map(|row| json!({ "step": row.step, "figures": row_json(row) })).collect();
    output::json(&json!({
        "dataset": dataset.name(),
        "split": rigidformer_evaluation::scenes::Split::from(arguments.split).to_string(),
        "scenes": scenes.len(),
        "frame_rate_hz": scenes.first().map_or(0.0, RecordedScene::frame_rate_hz),
        "model": { "name": ours.first().map_or("", |row| row.name.as_str()), "steps": steps },
        "baselines": others.iter().map(row_json).collect::<Vec<_>>(),
        "recorded": row_json(record),
    }))
}
