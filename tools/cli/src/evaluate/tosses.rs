//! Tosses, scenes with the velocities of their units at frame 0: the errors of rollouts in open loop.

use rigidformer_evaluation::figures;
use rigidformer_evaluation::open_loop::{
    self, CUBE_EDGE_M, CUBE_TOSSES, Figures, PUBLISHED, PublishedEngine, SceneErrors,
};
use rigidformer_evaluation::pivots;
use rigidformer_evaluation::rollout::open_loop_on;
use rigidformer_evaluation::scenes::{Dataset, RecordedScene};
use rigidformer_runtime::engine::Engine;
use rigidformer_runtime::progress::Progress;
use serde_json::{Value, json};

use super::joining::cell;
use super::metric::{Headline, Metric, Task};
use crate::arguments::STEPS;
use crate::picture::Toss;
use crate::{output, picture};

/// The last of the frames that pivots are found from.
const JOIN_FRAME: usize = 10;

/// The errors of rollouts in open loop.
pub(super) struct Tosses {
    by_step: Vec<(u32, Figures)>,
    /// The scenes with the parts of bodies held together, where that is asked for.
    joined: Option<Vec<RecordedScene>>,
}

impl Metric for Tosses {
    const STEPS: &'static [u32] = &STEPS;

    fn applies(dataset: &Dataset) -> bool {
        dataset.has_velocities()
    }

    fn check(_: &Task<'_>) -> anyhow::Result<()> {
        Ok(())
    }

    fn calls(task: &Task<'_>) -> u64 {
        let of_step = |step: &u32| {
            let step = *step;
            task.scenes.iter().map(move |scene| open_loop::steps(task.loaded, scene, step))
        };
        task.steps.iter().flat_map(of_step).sum()
    }

    fn measure(task: &Task<'_>, progress: Progress<'_>) -> anyhow::Result<Tosses> {
        let joined = match task.arguments.join {
            true => Some(pivots::all_joined(task.scenes, JOIN_FRAME)?),
            false => None,
        };
        let scenes = joined.as_deref().unwrap_or(task.scenes);
        let mut by_step = Vec::new();
        for step in task.steps {
            by_step.push((*step, open_loop::model(task.loaded, scenes, *step, progress)?));
        }
        Ok(Tosses { by_step, joined })
    }

    fn headlines(&self) -> Vec<Headline> {
        let of_step = |(step, figures): &(u32, Figures)| {
            [
                Headline {
                    step: *step,
                    name: "position, m",
                    key: "position_m",
                    value: figures.position_m.0,
                },
                Headline {
                    step: *step,
                    name: "rotation, degrees",
                    key: "rotation_deg",
                    value: figures.rotation_deg.0,
                },
            ]
        };
        self.by_step.iter().flat_map(of_step).collect()
    }

    fn print(&self, task: &Task<'_>) -> anyhow::Result<()> {
        print_table(task, &self.by_step)
    }

    fn json(&self, task: &Task<'_>) -> Value {
        document(task, &self.by_step)
    }

    fn picture(&self, task: &Task<'_>) -> anyhow::Result<Vec<u8>> {
        let scenes = self.joined.as_deref().unwrap_or(task.scenes);
        let first = self.by_step.first();
        let (step, figures) = first.ok_or_else(|| anyhow::anyhow!("no toss to draw"))?;
        draw_median(scenes, task, *step, &figures.by_scene)
    }
}

/// Number of the toss with the median position error: of an even number the better one of the two in the middle.
fn median(errors: &[SceneErrors]) -> Option<usize> {
    let mut order: Vec<usize> = (0..errors.len()).collect();
    order.sort_by(|a, b| errors[*a].position_m.total_cmp(&errors[*b].position_m));
    order.get(errors.len().div_ceil(2).checked_sub(1)?).copied()
}

/// Draws the toss with the median position error; a PNG file.
fn draw_median(
    scenes: &[RecordedScene],
    task: &Task<'_>,
    step: u32,
    errors: &[SceneErrors],
) -> anyhow::Result<Vec<u8>> {
    let chosen = median(errors).and_then(|at| Some((scenes.get(at)?, errors.get(at)?)));
    let (scene, error) = chosen.ok_or_else(|| anyhow::anyhow!("no toss to draw"))?;
    let predicted = open_loop_on(Engine::new()?, task.loaded, scene, step, Progress::none())?;
    let title = format!(
        "{}, the median of {}: {}, step {step}, off by {:.1} cm and {:.0}\u{b0} on average",
        scene.name(),
        errors.len(),
        task.model_name(),
        error.position_m * 100.0,
        error.rotation_deg
    );
    let native_hz = f64::from(native_hz(task));
    picture::toss(&Toss { title, scene, predicted: &predicted, native_hz })
}

/// Frames a second of the model.
fn native_hz(task: &Task<'_>) -> f32 {
    task.loaded.model().config().frame_rate_hz
}

/// The published engines, if these are the tosses that they were measured on.
fn published(dataset: &Dataset) -> &'static [PublishedEngine] {
    if dataset.name() == CUBE_TOSSES { &PUBLISHED } else { &[] }
}

fn notes(task: &Task<'_>) -> Vec<String> {
    let dataset = task.dataset;
    let mut notes = vec![format!(
        "step s predicts every s/{} s; the record has {} frames a second, and predictions are interpolated at its frames",
        native_hz(task),
        dataset.frame_rate_hz()
    )];
    if published(dataset).is_empty() {
        notes.push(format!("nothing is published for {}", dataset.name()));
    } else {
        notes.push(
            "published: Acosta et al., arXiv 2110.00541; each engine's parameters were fitted to such tosses".into(),
        );
    }
    notes
}

fn print_table(task: &Task<'_>, by_step: &[(u32, Figures)]) -> anyhow::Result<()> {
    let (name, split, count) = (task.dataset.name(), task.split, task.scenes.len());
    output::line(format_args!("{name}, split {split}, {count} scenes"))?;
    output::line(
        "open loop from the pose and velocity of frame 0: errors, means over all later frames of a scene,",
    )?;
    output::line("then mean and standard deviation over scenes")?;
    let engines = published(task.dataset);
    let edges = !engines.is_empty();
    let columns = ["predictor", "step", "position m", "% of an edge", "rotation deg"];
    let shown = columns.into_iter().filter(|column| edges || !column.starts_with('%'));
    let has_parts = by_step.iter().any(|(_, figures)| figures.apart.is_some());
    let apart = "parts apart mm, median / 99 %";
    let mut table = output::table(shown.chain(has_parts.then_some(apart)));
    let pair = |(mean, sd): (f64, f64), digits: usize| format!("{mean:.digits$} ± {sd:.digits$}");
    let mut add = |name: &str, step: String, metres: (f64, f64), degrees: (f64, f64), apart| {
        let share = (metres.0 / CUBE_EDGE_M * 100.0, metres.1 / CUBE_EDGE_M * 100.0);
        let mut cells = vec![name.to_owned(), step, pair(metres, 4)];
        cells.extend(edges.then(|| pair(share, 1)));
        cells.push(pair(degrees, 1));
        cells.extend(has_parts.then(|| cell(apart)));
        output::row(&mut table, cells);
    };
    for (step, figures) in by_step {
        let Figures { position_m, rotation_deg, apart, .. } = figures;
        add(task.model_name(), step.to_string(), *position_m, *rotation_deg, *apart);
    }
    for engine in engines {
        let metres = |percent: f64| percent / 100.0 * CUBE_EDGE_M;
        let (mean, sd) = engine.position_percent;
        add(engine.name, String::new(), (metres(mean), metres(sd)), engine.rotation_deg, None);
    }
    output::table_lines(&table)?;
    for note in notes(task) {
        output::note(&note);
    }
    Ok(())
}

fn document(task: &Task<'_>, by_step: &[(u32, Figures)]) -> Value {
    let toss = |scene: &SceneErrors| {
        json!({
            "seed": scene.seed,
            "frames": scene.frames,
            "position_m": scene.position_m,
            "rotation_deg": scene.rotation_deg,
        })
    };
    let row = |(step, figures): &(u32, Figures)| {
        json!({
            "step": step,
            "position_m": figures.position_m.0,
            "position_sd_m": figures.position_m.1,
            "rotation_deg": figures.rotation_deg.0,
            "rotation_sd_deg": figures.rotation_deg.1,
            "apart": figures::apart_json(figures.apart),
            "per_toss": figures.by_scene.iter().map(toss).collect::<Vec<_>>(),
        })
    };
    let engine = |engine: &PublishedEngine| {
        let metres = |percent: f64| percent / 100.0 * CUBE_EDGE_M;
        json!({
            "predictor": engine.name,
            "position_m": metres(engine.position_percent.0),
            "position_sd_m": metres(engine.position_percent.1),
            "position_percent_of_edge": engine.position_percent.0,
            "rotation_deg": engine.rotation_deg.0,
            "rotation_sd_deg": engine.rotation_deg.1,
        })
    };
    json!({
        "dataset": task.dataset.name(),
        "split": task.split.to_string(),
        "scenes": task.scenes.len(),
        "protocol": "open loop from the pose and velocity of frame 0",
        "model": { "name": task.model_name(), "steps": by_step.iter().map(row).collect::<Vec<_>>() },
        "published": published(task.dataset).iter().map(engine).collect::<Vec<Value>>(),
        "notes": notes(task),
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn of_two_in_the_middle_the_better_one_is_the_median() {
        let of = |metres: &[f64]| {
            let errors = metres.iter().map(|metres| SceneErrors {
                seed: 0,
                frames: 1,
                position_m: *metres,
                rotation_deg: 0.0,
            });
            median(&errors.collect::<Vec<_>>())
        };
        assert_eq!(of(&[]), None);
        assert_eq!(of(&[3.0]), Some(0));
        assert_eq!(of(&[3.0, 1.0, 2.0]), Some(2));
        assert_eq!(of(&[4.0, 1.0, 3.0, 2.0]), Some(3));
    }
}
