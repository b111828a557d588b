//! `rigidformer evaluate`

use rigidformer_runtime::evaluation::{self, FRAMES, Figures, LAST_FRAME, SceneFigures};
use rigidformer_runtime::files::write_whole;
use rigidformer_runtime::metrics::{FrameErrors, Penetration};
use rigidformer_runtime::paper::{self, Published};
use rigidformer_runtime::pivots;
use rigidformer_runtime::rollout::Progress;
use rigidformer_runtime::scenes::{Dataset, Split};
use serde_json::{Value, json};

use crate::arguments::{Evaluate, STEPS};
use crate::joining::{apart_json, cell};
use crate::loading::load_scenes;
use crate::usage::Usage;
use crate::{defaults, deforming, fragments, interrupt, output, picture, tosses, walks};

/// Frames of a scene until the last one that the published tables read.
pub(crate) const TO_LAST_FRAME: usize = LAST_FRAME as usize + 1;
/// The published split's scenes.
const PUBLISHED_SCENES: usize = 120;

struct Results {
    model: String,
    split: Split,
    scenes: usize,
    /// (scenes) Name, seed and number of units.
    names: Vec<(String, i64, usize)>,
    /// (step code, figures)
    by_step: Vec<(u32, Figures)>,
    free_fall: Figures,
    /// Mean and maximum over scenes.
    recorded: (Penetration, Penetration),
}

pub(crate) fn run(arguments: &Evaluate) -> anyhow::Result<()> {
    let cancelled = interrupt::watch();
    let split = Split::from(arguments.split);
    let dataset = Dataset::open(&arguments.dataset)?;
    if arguments.neighbours.is_some() && dataset.command_size() == 0 {
        let problem = format!(
            "--neighbours: {} has no commands; neighbours are those of robots",
            arguments.dataset.display()
        );
        return Err(Usage(problem).into());
    }
    if dataset.soft_units() > 0 {
        let scenes = load_scenes(&dataset, split, arguments.limit, None)?;
        let loaded = defaults::model(&arguments.model)?.for_host()?;
        return deforming::run(arguments, &dataset, &scenes, &loaded, cancelled);
    }
    if dataset.bonds().0 > 0 {
        let scenes = load_scenes(&dataset, split, arguments.limit, None)?;
        let loaded = defaults::model(&arguments.model)?.for_host()?;
        return fragments::run(arguments, &dataset, &scenes, &loaded, cancelled);
    }
    if dataset.has_velocities() {
        let scenes = load_scenes(&dataset, split, arguments.limit, None)?;
        let loaded = defaults::model(&arguments.model)?.for_host()?;
        return tosses::run(arguments, &dataset, &scenes, &loaded, cancelled);
    }
    if dataset.command_size() > 0 {
        let scenes = load_scenes(&dataset, split, arguments.limit, None)?;
        let loaded = defaults::model(&arguments.model)?.for_host()?;
        return walks::run(arguments, &dataset, &scenes, &loaded, cancelled);
    }
    let steps = arguments.steps_or(&STEPS);
    let mut scenes = load_scenes(&dataset, split, arguments.limit, Some(TO_LAST_FRAME))?;
    if scenes.iter().any(pivots::has_parts) {
        // The pivots that parts are measured by are those of all frames.
        scenes = load_scenes(&dataset, split, arguments.limit, None)?;
    }
    let loaded = defaults::model(&arguments.model)?.for_host()?;
    let model = loaded.model();

    let predictions =
        steps.iter().map(|step| u64::from(LAST_FRAME.div_ceil(*step)).saturating_sub(1));
    let bar = output::progress(predictions.sum::<u64>() * scenes.len() as u64, dataset.name());
    let stepped = || bar.inc(1);
    let mut by_step = Vec::new();
    for step in steps {
        let progress = Progress { cancelled, stepped: &stepped };
        let figures = match arguments.join {
            true => {
                let joined = pivots::all_joined(&scenes, *step as usize)?;
                evaluation::model(&loaded, &joined, *step, progress)?
            }
            false => evaluation::model(&loaded, &scenes, *step, progress)?,
        };
        by_step.push((*step, figures));
    }
    bar.finish_and_clear();
    let results = Results {
        model: model.file().name().to_owned(),
        split,
        scenes: scenes.len(),
        names: scenes
            .iter()
            .map(|scene| (scene.name().to_owned(), scene.seed(), scene.units().len()))
            .collect(),
        by_step,
        free_fall: evaluation::free_falling(&scenes)?,
        recorded: evaluation::recorded_penetration(&scenes, 1),
    };
    interrupt::check()?;
    if arguments.json {
        print_json(&dataset, &results)?;
    } else {
        print_tables(&dataset, &results)?;
    }
    // After the figures: a path that cannot be written costs none of them.
    if let Some(path) = &arguments.picture {
        let title = format!(
            "{}, {}, {} scenes of {split}: mean over scenes of the RMS over units",
            results.model,
            dataset.name(),
            results.scenes
        );
        let rate = scenes.first().map_or(1.0, |scene| f64::from(scene.frame_rate_hz()));
        let (by_step, free) = (&results.by_step, &results.free_fall);
        let picture = picture::evaluation(&title, dataset.name(), by_step, free, rate)?;
        write_whole(path, &picture)?;
        match arguments.json {
            true => output::note(&format!("wrote {}", path.display())),
            false => output::line(format_args!("wrote {}", path.display()))?,
        }
    }
    Ok(())
}

/// Whether the published figures are of these very scenes.
fn comparable(results: &Results) -> bool {
    results.split == Split::Test && results.scenes == PUBLISHED_SCENES
}

fn print_tables(dataset: &Dataset, results: &Results) -> anyhow::Result<()> {
    output::line(format_args!(
        "{}, split {}, {} scenes",
        dataset.name(),
        results.split,
        results.scenes
    ))?;
    output::line(
        "position error m / orientation error degrees (RMS over units, mean over scenes) at frame",
    )?;
    let mut errors = output::table(["predictor", "step", "50", "75", "100"]);
    let ours = |figures: &Figures| {
        figures.errors.map(|e| format!("{:.3} / {:5.2}", e.position_m, e.orientation_rms_deg))
    };
    let theirs = |row: &Published| {
        row.errors.map(|(position, degrees)| format!("{position:.3} / {degrees:5.2}"))
    };
    let mut add = |name: &str, step: Option<u32>, cells: [String; 3]| {
        let head = [name.to_owned(), step.map_or(String::new(), |step| step.to_string())];
        output::row(&mut errors, head.into_iter().chain(cells));
    };
    for (step, figures) in &results.by_step {
        add(&results.model, Some(*step), ours(figures));
        if let Some(row) = paper::rigidformer(dataset.name(), *step) {
            add("paper", row.step, theirs(row));
        }
    }
    if let Some(row) = paper::hop_net(dataset.name()) {
        add("HopNet", None, theirs(row));
    }
    add("free fall", None, ours(&results.free_fall));
    output::line(&errors)?;

    output::line(
        "\nmean orientation error over units, degrees, at frame; deepest penetration until frame 100, m",
    )?;
    output::line("(mean over scenes, worst scene); largest change of a length within a unit")?;
    let has_parts = results.by_step.iter().any(|(_, figures)| figures.apart.is_some());
    if has_parts {
        output::line(
            "parts apart: distance of the images of pivots of all recorded frames, median / 99 %, mm",
        )?;
    }
    let columns = ["predictor", "step", "50", "75", "100", "into ground", "into units", "length"];
    let mut more = output::table(columns.into_iter().chain(has_parts.then_some("parts apart")));
    let depths = |mean: Penetration, max: Penetration| {
        let pair = |mean: f64, max: f64| format!("{mean:.3}, {max:.3}");
        [pair(mean.ground_m, max.ground_m), pair(mean.units_m, max.units_m)]
    };
    let predicted = |name: &str, step: String, figures: &Figures| {
        let means = figures.errors.map(|e| format!("{:.2}", e.orientation_mean_deg));
        let depths = depths(figures.penetration_mean, figures.penetration_max);
        let cells = [name.to_owned(), step].into_iter().chain(means).chain(depths);
        let cells = cells.chain([format!("{:.0e}", figures.rigidity)]);
        cells.chain(has_parts.then(|| cell(figures.apart))).collect::<Vec<_>>()
    };
    for (step, figures) in &results.by_step {
        output::row(&mut more, predicted(&results.model, step.to_string(), figures));
    }
    output::row(&mut more, predicted("free fall", String::new(), &results.free_fall));
    let (mean, max) = results.recorded;
    let blank = std::iter::repeat_n(String::new(), 4);
    output::row(
        &mut more,
        ["recorded".to_owned()].into_iter().chain(blank).chain(depths(mean, max)),
    );
    output::line(&more)?;
    for note in notes(dataset, results) {
        output::note(&note);
    }
    Ok(())
}

fn notes(dataset: &Dataset, results: &Results) -> Vec<String> {
    let mut notes = vec!["free fall keeps the velocity and spin of frames 2 and 3".to_owned()];
    for (step, _) in &results.by_step {
        let between: Vec<String> =
            FRAMES.iter().filter(|frame| **frame % step != 0).map(u32::to_string).collect();
        if !between.is_empty() {
            let frames = between.join(", ");
            notes.push(format!(
                "step {step} does not reach frame {frames}: poses there are interpolated (slerp)"
            ));
        }
    }
    if paper::hop_net(dataset.name()).is_none() {
        notes.push(format!("nothing is published for {}", dataset.name()));
    } else if !comparable(results) {
        notes.push(format!(
            "the published rows are of all {PUBLISHED_SCENES} test scenes, this is {} of {}",
            results.scenes, results.split
        ));
    }
    notes
}

fn print_json(dataset: &Dataset, results: &Results) -> anyhow::Result<()> {
    let rows = results
        .by_step
        .iter()
        .map(|(step, figures)| json!({ "step": step, "figures": figures_json(figures) }));
    let published: Vec<Value> = paper::PUBLISHED
        .iter()
        .filter(|row| row.dataset == dataset.name())
        .map(published_json)
        .collect();
    let (mean, max) = results.recorded;
    output::json(&json!({
        "dataset": dataset.name(),
        "split": results.split.to_string(),
        "scenes": results.scenes,
        "model": { "name": results.model, "steps": rows.collect::<Vec<_>>() },
        "free_fall": figures_json(&results.free_fall),
        "recorded": { "penetration": penetration_json(mean, max) },
        "per_scene": per_scene_json(results),
        "published": published,
        "published_scenes_are_these": comparable(results),
        "notes": notes(dataset, results),
    }))
}

/// Every scene with its figures at each step code.
fn per_scene_json(results: &Results) -> Vec<Value> {
    let figures = |scene: &SceneFigures| {
        json!({
            "frames": frames_json(&scene.errors),
            "penetration": {
                "ground_m": scene.penetration.ground_m,
                "units_m": scene.penetration.units_m,
            },
            "rigidity": scene.rigidity,
        })
    };
    let scene = |(index, (name, seed, units)): (usize, &(String, i64, usize))| {
        let of = |all: &Figures| all.by_scene.get(index).map(figures);
        let steps = results.by_step.iter();
        let steps = steps.map(|(step, all)| json!({ "step": step, "figures": of(all) }));
        json!({
            "name": name,
            "seed": seed,
            "units": units,
            "steps": steps.collect::<Vec<_>>(),
            "free_fall": of(&results.free_fall),
        })
    };
    results.names.iter().enumerate().map(scene).collect()
}

fn frames_json(errors: &[FrameErrors; 3]) -> Vec<Value> {
    let frame = |(frame, errors): (u32, &FrameErrors)| {
        json!({
            "frame": frame,
            "position_m": errors.position_m,
            "orientation_rms_deg": errors.orientation_rms_deg,
            "orientation_mean_deg": errors.orientation_mean_deg,
        })
    };
    FRAMES.into_iter().zip(errors).map(frame).collect()
}

fn figures_json(figures: &Figures) -> Value {
    json!({
        "frames": frames_json(&figures.errors),
        "penetration": penetration_json(figures.penetration_mean, figures.penetration_max),
        "rigidity": figures.rigidity,
        "apart": apart_json(figures.apart),
    })
}

fn penetration_json(mean: Penetration, max: Penetration) -> Value {
    json!({
        "ground_mean_m": mean.ground_m,
        "ground_max_m": max.ground_m,
        "units_mean_m": mean.units_m,
        "units_max_m": max.units_m,
    })
}

fn published_json(row: &Published) -> Value {
    // HopNet's script prints the mean over objects.
    let orientation = match row.step {
        Some(_) => "orientation_rms_deg",
        None => "orientation_mean_deg",
    };
    let frame = |(frame, (position_m, degrees)): (u32, (f64, f64))| json!({ "frame": frame, "position_m": position_m, orientation: degrees });
    json!({
        "predictor": row.predictor,
        "step": row.step,
        "frames": FRAMES.into_iter().zip(row.errors).map(frame).collect::<Vec<_>>(),
    })
}
