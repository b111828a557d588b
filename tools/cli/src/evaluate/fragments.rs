//! Units that bonds hold together: where pieces are, and which bonds are broken.

use rigidformer_evaluation::fragments::{self, Baseline, BrokenBonds, Figures};
use rigidformer_evaluation::scenes::{Dataset, RecordedScene};
use rigidformer_evaluation::soft::{FRAMES, LAST_FRAME};
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

/// How well all bonds are told by who says the same of each.
struct Plain {
    name: &'static str,
    step: u32,
    bonds: BrokenBonds,
}

/// Where pieces are, and which bonds are broken.
pub(super) struct Fragments {
    ours: Vec<Row>,
    others: Vec<Row>,
    plain: Vec<Plain>,
}

impl Metric for Fragments {
    const STEPS: &'static [u32] = &[5];

    fn applies(dataset: &Dataset) -> bool {
        dataset.bonds().0 > 0
    }

    fn check(task: &Task<'_>) -> anyhow::Result<()> {
        if task.arguments.picture.is_some() || task.arguments.join {
            let problem = "--picture and --join are for units without bonds; `rigidformer rollout` draws those with bonds";
            return Err(Usage(problem.into()).into());
        }
        if !task.loaded.model().config().motion.has_impulses() {
            let problem = format!(
                "{} does not move units that hold together; take fragments.rfm, or another model whose motion is impulses",
                task.model_name()
            );
            return Err(Usage(problem).into());
        }
        Ok(check_steps(task.steps, task.scenes)?)
    }

    fn calls(task: &Task<'_>) -> u64 {
        let steps: u64 = task.steps.iter().map(|step| u64::from(LAST_FRAME.div_ceil(*step))).sum();
        2 * steps * task.scenes.len() as u64
    }

    fn measure(task: &Task<'_>, progress: Progress<'_>) -> anyhow::Result<Fragments> {
        let (scenes, name) = (task.scenes, task.model_name());
        let apart = fragments::separated(scenes)?;
        let (mut ours, mut others, mut plain) = (Vec::new(), Vec::new(), Vec::new());
        for step in task.steps {
            let alone = format!("{name}, pieces apart from the start");
            let figures = fragments::model(task.loaded, scenes, *step, progress)?;
            ours.push(Row { name: name.to_owned(), step: *step, figures });
            let figures = fragments::model(task.loaded, &apart, *step, progress)?;
            others.push(Row { name: alone, step: *step, figures });
            for baseline in Baseline::ALL {
                let figures = fragments::baseline(baseline, scenes, *step);
                others.push(Row { name: baseline.name().to_owned(), step: *step, figures });
            }
            for (name, are_broken) in [("all broken", true), ("none broken", false)] {
                let bonds = fragments::all_broken(scenes, *step, are_broken);
                plain.push(Plain { name, step: *step, bonds });
            }
        }
        Ok(Fragments { ours, others, plain })
    }

    fn headlines(&self) -> Vec<Headline> {
        let of_row = |row: &Row| {
            let value = row.figures.at_frames().into_iter().flatten().last()?.vertex_m;
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

fn print_tables(figures: &Fragments, task: &Task<'_>) -> anyhow::Result<()> {
    let Fragments { ours, others, plain } = figures;
    let (name, split, count) = (task.dataset.name(), task.split, task.scenes.len());
    let rate = task.scenes.first().map_or(0.0, RecordedScene::frame_rate_hz);
    output::line(format_args!("{name}, split {split}, {count} scenes at {rate} frames a second"))?;
    output::line(match task.loaded.model().config().bonds {
        0 => "bonds break when the record says so: the model does not",
        _ => "bonds break when the model says so",
    })?;
    output::line(
        "mean distance of points from where they were recorded, m (% of the body's size), and mean angle of pieces, degrees, at frame after the second one seen",
    )?;
    let frames = FRAMES.map(|frame| frame.to_string());
    let head = ["predictor", "step"].into_iter().chain(frames.iter().map(String::as_str));
    let mut errors = output::table(head);
    for row in ours.iter().chain(others) {
        let cells = row.figures.at_frames().map(|found| {
            found.map_or_else(
                || "-".to_owned(),
                |e| {
                    let share = 100.0 * e.vertex_share;
                    format!("{:.3} ({share:4.1}) / {:5.1}", e.vertex_m, e.orientation_deg)
                },
            )
        });
        output::row(&mut errors, [row.name.clone(), row.step.to_string()].into_iter().chain(cells));
    }
    output::table_lines(&errors)?;
    output::line("\nbonds that are broken at the end")?;
    let mut bonds =
        output::table(["predictor", "step", "F1", "precision", "recall", "F1 of those that hold"]);
    let mut add = |name: &str, step: String, found: &BrokenBonds| {
        let figures = [found.f1(), found.precision(), found.recall(), found.f1_of_holding()];
        let cells = figures.map(|figure| format!("{figure:.3}"));
        output::row(&mut bonds, [name.to_owned(), step].into_iter().chain(cells));
    };
    for row in ours {
        if let Some(found) = &row.figures.bonds {
            add(&row.name, row.step.to_string(), found);
        }
    }
    plain.iter().for_each(|row| add(row.name, row.step.to_string(), &row.bonds));
    output::table_lines(&bonds)
}

fn bonds_json(bonds: &BrokenBonds) -> Value {
    json!({
        "f1": bonds.f1(),
        "precision": bonds.precision(),
        "recall": bonds.recall(),
        "f1_of_holding": bonds.f1_of_holding(),
        "broken_in_both": bonds.both,
        "broken_in_rollout": bonds.rollout,
        "broken_in_record": bonds.record,
        "hold_in_both": bonds.neither,
    })
}

fn row_json(row: &Row) -> Value {
    let errors = row.figures.errors.iter().map(|e| {
        json!({
            "frame": e.frame, "vertex_m": e.vertex_m, "vertex_share": e.vertex_share, "position_m": e.position_m,
            "orientation_deg": e.orientation_deg, "scenes": e.scenes,
        })
    });
    json!({
        "name": row.name,
        "step": row.step,
        "frames": errors.collect::<Vec<_>>(),
        "bonds": row.figures.bonds.as_ref().map(bonds_json),
    })
}

fn document(figures: &Fragments, task: &Task<'_>) -> Value {
    let Fragments { ours, others, plain } = figures;
    let steps: Vec<Value> =
        ours.iter().map(|row| json!({ "step": row.step, "figures": row_json(row) })).collect();
    let plain = plain
        .iter()
        .map(|row| json!({ "name": row.name, "step": row.step, "bonds": bonds_json(&row.bonds) }));
    let others = others.iter().map(row_json).chain(plain).collect::<Vec<_>>();
    json!({
        "dataset": task.dataset.name(),
        "split": task.split.to_string(),
        "scenes": task.scenes.len(),
        "frame_rate_hz": task.scenes.first().map_or(0.0, RecordedScene::frame_rate_hz),
        "model": { "name": ours.first().map_or("", |row| row.name.as_str()), "steps": steps },
        "baselines": others,
    })
}
