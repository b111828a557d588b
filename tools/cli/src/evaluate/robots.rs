//! Robots under command: the errors of their parts, beside guesses and the published ones.

use std::path::Path;

use rigidformer_evaluation::figures;
use rigidformer_evaluation::metrics::{Apart, FrameErrors, apart};
use rigidformer_evaluation::pivots;
use rigidformer_evaluation::robots::{self, Neighbours};
use rigidformer_evaluation::rollout::{Trajectory, rollout_many};
use rigidformer_evaluation::scenes::{Dataset, RecordedScene, Split};
use rigidformer_runtime::progress::Progress;
use serde_json::{Value, json};

use super::joining::cell;
use super::metric::{Headline, Metric, Task};
use crate::loading::load_scenes;
use crate::output;
use crate::usage::Usage;

/// Frames of the table.
const FRAMES: [u32; 4] = [50, 100, 200, 300];
/// Where rollouts end, or with the record.
const LAST_FRAME: u32 = 300;
/// The published frame, and where walks are looked up to: later ones leave few beginnings to choose from.
const PUBLISHED_FRAME: u32 = 100;
/// Step code of the published rows.
const PUBLISHED_STEP: u32 = 10;
/// Frames a second of the published rows.
const PUBLISHED_HZ: f32 = 30.0;

type Curve = Vec<(u32, FrameErrors)>;

/// Figures of one predictor.
struct Row {
    name: String,
    step: u32,
    curve: Curve,
    /// How far the parts come apart.
    apart: Option<Apart>,
}

/// The errors of robots under their commands.
pub(super) struct Robots {
    ours: Vec<Row>,
    others: Vec<Row>,
}

impl Metric for Robots {
    const STEPS: &'static [u32] = &[PUBLISHED_STEP];

    fn applies(dataset: &Dataset) -> bool {
        dataset.command_size() > 0
    }

    fn check(task: &Task<'_>) -> anyhow::Result<()> {
        if task.arguments.picture.is_some() {
            let problem = "--picture draws no robots; `rigidformer rollout --command` does";
            return Err(Usage(problem.into()).into());
        }
        let (recorded, last) = ends(task.scenes);
        match task.steps.iter().find(|step| last < step.saturating_mul(2)) {
            None => Ok(()),
            Some(step) => Err(Usage(format!(
                "--steps {step}: the shortest scene has {recorded} frames; the first prediction is frame {}",
                step.saturating_mul(2)
            ))
            .into()),
        }
    }

    fn calls(task: &Task<'_>) -> u64 {
        let (_, last) = ends(task.scenes);
        let steps: u64 = task.steps.iter().map(|step| u64::from(last / step - 1)).sum();
        steps * task.scenes.len() as u64
    }

    fn measure(task: &Task<'_>, progress: Progress<'_>) -> anyhow::Result<Robots> {
        let scenes = task.scenes;
        let (_, last) = ends(scenes);
        let (mut ours, mut others) = (Vec::new(), Vec::new());
        for step in task.steps {
            let end = last - last % step;
            let joined = match task.arguments.join {
                true => Some(pivots::all_joined(scenes, *step as usize)?),
                false => None,
            };
            let held = joined.as_deref().unwrap_or(scenes);
            let predicted = rollout_many(task.loaded, held, *step, end, progress)?;
            ours.push(row(task.model_name().to_owned(), *step, &predicted, scenes));
            let guesses: [(&str, Guess); 2] = [
                ("constant velocity", robots::constant_velocity),
                ("rigid carry", robots::rigid_carry),
            ];
            for (name, guess) in guesses {
                let predicted = scenes.iter().map(|scene| guess(scene, *step, end));
                let Some(predicted) = predicted.collect::<Option<Vec<_>>>() else { continue };
                others.push(row(name.into(), *step, &predicted, scenes));
            }
            if let Some(path) = &task.arguments.neighbours {
                others.push(neighbours(path, scenes, *step)?);
            }
        }
        Ok(Robots { ours, others })
    }

    fn headlines(&self) -> Vec<Headline> {
        let of_row = |row: &Row| {
            let (_, last) = row.curve.last()?;
            Some(Headline {
                step: row.step,
                name: "links at the last frame, m",
                key: "links_m",
                value: last.position_m,
            })
        };
        self.ours.iter().filter_map(of_row).collect()
    }

    fn print(&self, task: &Task<'_>) -> anyhow::Result<()> {
        print_table(self, task)
    }

    fn json(&self, task: &Task<'_>) -> Value {
        document(self, task)
    }
}

/// Frames of the shortest scene, and the last one to predict.
fn ends(scenes: &[RecordedScene]) -> (usize, u32) {
    let recorded = scenes.iter().map(RecordedScene::frames).min().unwrap_or_default();
    let last = u32::try_from(recorded.saturating_sub(1)).unwrap_or(u32::MAX);
    (recorded, LAST_FRAME.min(last))
}

type Guess = fn(&RecordedScene, u32, u32) -> Option<Trajectory>;

/// What walks that began alike went on to do.
fn neighbours(path: &Path, scenes: &[RecordedScene], step: u32) -> anyhow::Result<Row> {
    let dataset = Dataset::open(path)?;
    let known = load_scenes(&dataset, Split::Train, None, None)?;
    let end = PUBLISHED_FRAME - PUBLISHED_FRAME % step;
    let library = Neighbours::new(&known, step, end);
    let predicted = scenes.iter().map(|scene| library.trajectory(scene));
    let predicted = predicted.collect::<Option<Vec<_>>>().ok_or_else(|| {
        Usage(format!(
            "--neighbours {}: has no {} walks of {} frames of the same parts in its training split; give the file that \
             the model was trained on",
            path.display(),
            robots::NEIGHBOURS,
            end + 1
        ))
    })?;
    Ok(row("three neighbours".into(), step, &predicted, scenes))
}

fn row(name: String, step: u32, predicted: &[Trajectory], scenes: &[RecordedScene]) -> Row {
    let first = step.saturating_mul(2);
    let distances = predicted
        .iter()
        .zip(scenes)
        .flat_map(|(walk, scene)| apart(walk, &pivots::recorded(scene), first, walk.last_frame()));
    let apart = Apart::of(distances.collect());
    Row { name, step, curve: robots::curve(predicted, scenes), apart }
}

/// The published row, where these are such frames and steps.
fn published(dataset: &Dataset, step: u32) -> Option<(f64, f64, &'static str)> {
    let alike = step == PUBLISHED_STEP && dataset.frame_rate_hz() == PUBLISHED_HZ;
    robots::published(dataset.name()).filter(|_| alike)
}

/// Errors at a frame; between samples none are made up.
fn at(row: &Row, frame: u32) -> Option<&FrameErrors> {
    row.curve.iter().find(|(found, _)| *found == frame).map(|(_, errors)| errors)
}

fn print_table(figures: &Robots, task: &Task<'_>) -> anyhow::Result<()> {
    let (Robots { ours, others }, dataset) = (figures, task.dataset);
    output::line(format_args!(
        "{}, split {}, {} scenes under command, {} frames a second",
        dataset.name(),
        task.split,
        task.scenes.len(),
        dataset.frame_rate_hz()
    ))?;
    output::line(
        "position error m / orientation error degrees (RMS over units, mean over scenes) at frame",
    )?;
    let mut table =
        output::table(["predictor", "step", "50", "100", "200", "300", "apart mm, 50 / 99 %"]);
    let cells = |row: &Row| {
        let numbers = FRAMES.map(|frame| {
            at(row, frame).map_or(String::new(), |errors| {
                format!("{:.3} / {:.2}", errors.position_m, errors.orientation_rms_deg)
            })
        });
        let head = [row.name.clone(), row.step.to_string()].into_iter();
        head.chain(numbers).chain([cell(row.apart)]).collect::<Vec<_>>()
    };
    for row in ours {
        output::row(&mut table, cells(row));
        if let Some((position, degrees, _)) = published(dataset, row.step) {
            let figure = format!("{position:.3} / {degrees:.2}");
            let blank = String::new;
            let step = row.step.to_string();
            output::row(
                &mut table,
                ["paper".into(), step, blank(), figure, blank(), blank(), blank()],
            );
        }
    }
    others.iter().for_each(|row| output::row(&mut table, cells(row)));
    output::table_lines(&table)?;
    if let Some((_, _, what)) = ours.iter().find_map(|row| published(dataset, row.step)) {
        output::note(&format!("the paper's row is of {what}; its walks are not published"));
    }
    Ok(())
}

fn document(figures: &Robots, task: &Task<'_>) -> Value {
    let (Robots { ours, others }, dataset) = (figures, task.dataset);
    let figures = |row: &Row| {
        let frames = row.curve.iter().map(|(frame, errors)| {
            json!({
                "frame": frame,
                "position_m": errors.position_m,
                "orientation_rms_deg": errors.orientation_rms_deg,
                "orientation_mean_deg": errors.orientation_mean_deg,
            })
        });
        let frames: Vec<Value> = frames.collect();
        json!({ "step": row.step, "figures": { "frames": frames }, "apart": figures::apart_json(row.apart) })
    };
    let named = |row: &Row| {
        let mut value = figures(row);
        value["name"] = json!(row.name);
        value
    };
    let name = ours.first().map_or("", |row| row.name.as_str());
    let paper = ours.iter().find_map(|row| published(dataset, row.step));
    json!({
        "dataset": dataset.name(),
        "split": task.split.to_string(),
        "scenes": task.scenes.len(),
        "model": { "name": name, "steps": ours.iter().map(figures).collect::<Vec<_>>() },
        "others": others.iter().map(named).collect::<Vec<_>>(),
        "published": paper.map(|(position_m, orientation_rms_deg, measured_on)| json!({
            "step": PUBLISHED_STEP, "frame": PUBLISHED_FRAME, "position_m": position_m,
            "orientation_rms_deg": orientation_rms_deg, "measured_on": measured_on,
        })),
    })
}
