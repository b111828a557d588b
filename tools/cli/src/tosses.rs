//! `rigidformer evaluate` on a file that has the velocities of its units at frame 0.

use std::sync::atomic::AtomicBool;

use rigidformer_evaluation::figures;
use rigidformer_evaluation::open_loop::{
    self, CUBE_EDGE_M, CUBE_TOSSES, Figures, PUBLISHED, PublishedEngine, SceneErrors,
};
use rigidformer_evaluation::pivots;
use rigidformer_evaluation::rollout::open_loop_on;
use rigidformer_evaluation::scenes::{Dataset, RecordedScene};
use rigidformer_runtime::engine::Engine;
use rigidformer_runtime::models::LoadedModel;
use rigidformer_runtime::progress::Progress;
use serde_json::{Value, json};

use crate::arguments::{Evaluate, STEPS};
use crate::joining::cell;
use crate::picture::Toss;
use crate::{interrupt, output, picture};

/// The last of the frames that pivots are found from.
pub(crate) const JOIN_FRAME: usize = 10;

/// Rolls all scenes out in open loop and prints the errors.
pub(crate) fn run(
    arguments: &Evaluate,
    dataset: &Dataset,
    scenes: &[RecordedScene],
    loaded: &LoadedModel,
    cancelled: &AtomicBool,
) -> anyhow::Result<()> {
    let steps = arguments.steps_or(&STEPS);
    let counts = steps
        .iter()
        .flat_map(|step| scenes.iter().map(move |scene| open_loop::steps(loaded, scene, *step)));
    let bar = output::progress(counts.sum(), dataset.name());
    let stepped = || bar.inc(1);
    let joined = if arguments.join { Some(pivots::all_joined(scenes, JOIN_FRAME)?) } else { None };
    let scenes = joined.as_deref().unwrap_or(scenes);
    let mut by_step = Vec::new();
    for step in steps {
        let progress = Progress { cancelled, stepped: &stepped };
        by_step.push((*step, open_loop::model(loaded, scenes, *step, progress)?));
    }
    bar.finish_and_clear();
    interrupt::check()?;
    let native_hz = loaded.model().config().frame_rate_hz;
    let name = loaded.model().file().name();
    let head = Head { name, split: arguments.split.into(), scenes: scenes.len(), native_hz };
    match arguments.json {
        true => print_json(dataset, &head, &by_step)?,
        false => print_table(dataset, &head, &by_step)?,
    }
    // After the figures: a path that cannot be written costs none of them.
    if let (Some(path), Some((step, figures))) = (&arguments.picture, by_step.first()) {
        let bytes = draw_median(scenes, loaded, *step, &figures.by_scene, &head)?;
        output::write_whole(path, &bytes)?;
        let done = format!("wrote {}", path.display());
        match arguments.json {
            true => output::note(&done),
            false => output::line(done)?,
        }
    }
    Ok(())
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
    loaded: &LoadedModel,
    step: u32,
    errors: &[SceneErrors],
    head: &Head<'_>,
) -> anyhow::Result<Vec<u8>> {
    let chosen = median(errors).and_then(|at| Some((scenes.get(at)?, errors.get(at)?)));
    let (scene, error) = chosen.ok_or_else(|| anyhow::anyhow!("no toss to draw"))?;
    let predicted = open_loop_on(Engine::new()?, loaded, scene, step, Progress::none())?;
    let title = format!(
        "{}, the median of {}: {}, step {step}, off by {:.1} cm and {:.0}\u{b0} on average",
        scene.name(),
        errors.len(),
        head.name,
        error.position_m * 100.0,
        error.rotation_deg
    );
    let native_hz = f64::from(head.native_hz);
    picture::toss(&Toss { title, scene, predicted: &predicted, native_hz })
}

struct Head<'a> {
    name: &'a str,
    split: rigidformer_evaluation::scenes::Split,
    scenes: usize,
    native_hz: f32,
}

/// The published engines, if these are the tosses that they were measured on.
fn published(dataset: &Dataset) -> &'static [PublishedEngine] {
    if dataset.name() == CUBE_TOSSES { &PUBLISHED } else { &[] }
}

fn notes(dataset: &Dataset, head: &Head<'_>) -> Vec<String> {
    let mut notes = vec![format!(
        "step s predicts every s/{} s; the record has {} frames a second, and predictions are interpolated at its frames",
        head.native_hz,
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

fn print_table(
    dataset: &Dataset,
    head: &Head<'_>,
    by_step: &[(u32, Figures)],
) -> anyhow::Result<()> {
    output::line(format_args!("{}, split {}, {} scenes", dataset.name(), head.split, head.scenes))?;
    output::line(
        "open loop from the pose and velocity of frame 0: errors, means over all later frames of a scene,",
    )?;
    output::line("then mean and standard deviation over scenes")?;
    let engines = published(dataset);
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
        add(head.name, step.to_string(), *position_m, *rotation_deg, *apart);
    }
    for engine in engines {
        let metres = |percent: f64| percent / 100.0 * CUBE_EDGE_M;
        let (mean, sd) = engine.position_percent;
        add(engine.name, String::new(), (metres(mean), metres(sd)), engine.rotation_deg, None);
    }
    output::line(&table)?;
    for note in notes(dataset, head) {
        output::note(&note);
    }
    Ok(())
}

fn print_json(
    dataset: &Dataset,
    head: &Head<'_>,
    by_step: &[(u32, Figures)],
) -> anyhow::Result<()> {
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
    output::json(&json!({
        "dataset": dataset.name(),
        "split": head.split.to_string(),
        "scenes": head.scenes,
        "protocol": "open loop from the pose and velocity of frame 0",
        "model": { "name": head.name, "steps": by_step.iter().map(row).collect::<Vec<_>>() },
        "published": published(dataset).iter().map(engine).collect::<Vec<Value>>(),
        "notes": notes(dataset, head),
    }))
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
