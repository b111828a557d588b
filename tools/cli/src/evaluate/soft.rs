//! Soft bodies: the errors of their points, and how far they are stretched and torn.

use rigidformer_evaluation::scenes::{Dataset, RecordedScene};
use rigidformer_evaluation::soft::{self, Baseline, FRAMES, Figures, LAST_FRAME};
use rigidformer_runtime::progress::Progress;
use serde_json::{Value, json};

use super::metric::{Headline, Metric, Task};
use crate::output;
use crate::usage::{Usage, check_steps};

/// Figures of one predictor.
struct Row {
    name: String,
    step: u32,
    figures: Figures,
}

/// How far points are from where they were recorded, and how sound bodies stay.
pub(super) struct Soft {
    ours: Vec<Row>,
    others: Vec<Row>,
    record: Row,
}

impl Metric for Soft {
    const STEPS: &'static [u32] = &[5];

    fn applies(dataset: &Dataset) -> bool {
        dataset.soft_units() > 0
    }

    fn check(task: &Task<'_>) -> anyhow::Result<()> {
        if task.arguments.picture.is_some() || task.arguments.join {
            let problem =
                "--picture and --join are for rigid units; `rigidformer rollout` draws soft ones";
            return Err(Usage(problem.into()).into());
        }
        Ok(check_steps(task.steps, task.scenes)?)
    }

    fn calls(task: &Task<'_>) -> u64 {
        let steps: u64 = task.steps.iter().map(|step| u64::from(LAST_FRAME.div_ceil(*step))).sum();
        steps * task.scenes.len() as u64
    }

    fn measure(task: &Task<'_>, progress: Progress<'_>) -> anyhow::Result<Soft> {
        let (mut ours, mut others) = (Vec::new(), Vec::new());
        for step in task.steps {
            let figures = soft::model(task.loaded, task.scenes, *step, progress)?;
            ours.push(Row { name: task.model_name().to_owned(), step: *step, figures });
            for baseline in Baseline::ALL {
                let figures = soft::baseline(baseline, task.scenes, *step);
                others.push(Row { name: baseline.name().to_owned(), step: *step, figures });
            }
        }
        let step = task.steps.first().copied().unwrap_or_default();
        let figures = soft::of_record(task.scenes, step);
        Ok(Soft { ours, others, record: Row { name: "recorded".into(), step, figures } })
    }

    fn headlines(&self) -> Vec<Headline> {
        let of_row = |row: &Row| {
            let value = row.figures.errors.last()?.vertex_m;
            Some(Headline {
                step: row.step,
                name: "points at the last frame, m",
                key: "points_m",
                value,
            })
        };
        self.ours.iter().filter_map(of_row).collect()
    }

    fn print(&self, task: &Task<'_>) -> anyhow::Result<()> {
        print_tables(self, task)
    }

    fn json(&self, task: &Task<'_>) -> Value {
        document(self, task)
    }
}

fn print_tables(figures: &Soft, task: &Task<'_>) -> anyhow::Result<()> {
    let Soft { ours, others, record } = figures;
    let (name, split, count) = (task.dataset.name(), task.split, task.scenes.len());
    let rate = task.scenes.first().map_or(0.0, RecordedScene::frame_rate_hz);
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
            let cell = |e: &soft::VertexErrors| {
                format!("{:.4} ({:4.1})", e.vertex_m, 100.0 * e.vertex_share)
            };
            found.map_or_else(|| "-".to_owned(), cell)
        });
        output::row(&mut errors, [row.name.clone(), row.step.to_string()].into_iter().chain(cells));
    }
    output::table_lines(&errors)?;
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
    output::table_lines(&sound)
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

fn document(figures: &Soft, task: &Task<'_>) -> Value {
    let Soft { ours, others, record } = figures;
    let steps: Vec<Value> =
        ours.iter().map(|row| json!({ "step": row.step, "figures": row_json(row) })).collect();
    json!({
        "dataset": task.dataset.name(),
        "split": task.split.to_string(),
        "scenes": task.scenes.len(),
        "frame_rate_hz": task.scenes.first().map_or(0.0, RecordedScene::frame_rate_hz),
        "model": { "name": ours.first().map_or("", |row| row.name.as_str()), "steps": steps },
        "baselines": others.iter().map(row_json).collect::<Vec<_>>(),
        "recorded": row_json(record),
    })
}
