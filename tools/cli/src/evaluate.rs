//! `rigidformer evaluate`

use std::sync::atomic::AtomicBool;

use rigidformer_evaluation::figures::{self, Figures, SplitFigures};
use rigidformer_evaluation::metrics::Penetration;
use rigidformer_evaluation::paper::{self, Published};
use rigidformer_evaluation::pivots::joined;
use rigidformer_evaluation::rollout::{open_loop_on, rollout_on};
use rigidformer_evaluation::scenes::{Dataset, RecordedScene, Split};
use rigidformer_runtime::engine::Engine;
use rigidformer_runtime::progress::Progress;

use crate::arguments::{Evaluate, STEPS, usual_step};
use crate::joining::cell;
use crate::loading::{load_scenes, plain};
use crate::usage::Usage;
use crate::viewers::{Moving, Viewers};
use crate::{defaults, deforming, fragments, interrupt, output, picture, tosses, walks};

pub(crate) fn run(arguments: &Evaluate) -> anyhow::Result<()> {
    let cancelled = interrupt::watch();
    let viewers = Viewers::open(&arguments.viewers)?;
    let inputs = || {
        let paths = std::iter::once(&arguments.dataset).chain(&arguments.model.path);
        paths.chain(&arguments.neighbours).map(|path| path.as_path())
    };
    viewers.apart_from(inputs())?;
    if let Some(picture) = &arguments.picture {
        output::apart("--picture", picture, inputs())?;
    }
    if !viewers.is_asked() {
        if arguments.index.is_some() {
            let problem = "--index says which scene --mcap, --gltf and --html show; give one of them, or leave it out";
            return Err(Usage(problem.into()).into());
        }
        return measure(arguments, cancelled);
    }
    // Before the figures: a scene that is not there costs no computation.
    let dataset = Dataset::open(&arguments.dataset)?;
    let first = || dataset.scenes_of(Split::from(arguments.split)).first().copied();
    let scene = dataset.scene(arguments.index.or_else(first).unwrap_or(0), None)?;
    measure(arguments, cancelled)?;
    viewers.write(&moving(arguments, &dataset, scene, cancelled)?, arguments.json)
}

/// A scene as it is predicted at the last of the step codes, for viewers.
fn moving(
    arguments: &Evaluate,
    dataset: &Dataset,
    scene: RecordedScene,
    cancelled: &AtomicBool,
) -> anyhow::Result<Moving> {
    let step = arguments.steps.last().copied().unwrap_or_else(|| usual_step(dataset));
    let loaded = defaults::model(&arguments.model)?.for_host()?;
    let engine = Engine::new()?;
    let progress = Progress { cancelled, ..Progress::none() };
    let poses_are = format!("predicted by {}, step {step}", loaded.model().file().name());
    let scene = if arguments.join { joined(scene, step as usize)? } else { scene };
    if scene.has_velocities() {
        let rollout = open_loop_on(engine, &loaded, &scene, step, progress)?;
        let rate_hz = f64::from(loaded.model().config().frame_rate_hz);
        return Ok(Moving::of_open_loop(&scene, poses_are, &rollout, rate_hz));
    }
    let last = u32::try_from(scene.frames().saturating_sub(1))?;
    let rollout = rollout_on(engine, &loaded, &scene, step, last - last % step, progress)?;
    Ok(Moving::of_rollout(&scene, poses_are, &rollout))
}

fn measure(arguments: &Evaluate, cancelled: &AtomicBool) -> anyhow::Result<()> {
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
    let progress = Progress { cancelled, ..Progress::none() };
    let scenes = figures::scenes_to_evaluate(&dataset, split, arguments.limit, progress);
    let scenes = scenes.map_err(plain)?;
    let loaded = defaults::model(&arguments.model)?.for_host()?;

    let bar = output::progress(figures::calls(steps, scenes.len()), dataset.name());
    let stepped = || bar.inc(1);
    let progress = Progress { cancelled, stepped: &stepped };
    let how = (steps, arguments.join);
    let results = figures::evaluate(&loaded, &dataset, split, &scenes, how, progress);
    let results = results.map_err(plain)?;
    bar.finish_and_clear();
    interrupt::check()?;
    if arguments.json {
        output::json(&results.document())?;
    } else {
        print_tables(&dataset, &results)?;
    }
    // After the figures: a path that cannot be written costs none of them.
    if let Some(path) = &arguments.picture {
        let title = format!(
            "{}, {}, {} scenes of {split}: mean over scenes of the RMS over units",
            results.model,
            dataset.name(),
            results.names.len()
        );
        let rate = scenes.first().map_or(1.0, |scene| f64::from(scene.frame_rate_hz()));
        let (by_step, free) = (&results.by_step, &results.free_fall);
        let picture = picture::evaluation(&title, dataset.name(), by_step, free, rate)?;
        output::write_whole(path, &picture)?;
        match arguments.json {
            true => output::note(&format!("wrote {}", path.display())),
            false => output::line(format_args!("wrote {}", path.display()))?,
        }
    }
    Ok(())
}

fn print_tables(dataset: &Dataset, results: &SplitFigures) -> anyhow::Result<()> {
    output::line(format_args!(
        "{}, split {}, {} scenes",
        dataset.name(),
        results.split,
        results.names.len()
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
    for note in results.notes() {
        output::note(&note);
    }
    Ok(())
}
