//! `rigidformer evaluate`: one way for all scenes, and a [`Metric`] for each kind of them.

mod fragments;
mod joining;
mod metric;
mod rigid;
mod robots;
mod soft;
mod tosses;

use std::path::PathBuf;
use std::sync::atomic::AtomicBool;

use rigidformer_evaluation::pivots::joined;
use rigidformer_evaluation::rollout::{open_loop_on, rollout_on};
use rigidformer_evaluation::scenes::{Dataset, RecordedScene, Split};
use rigidformer_runtime::engine::Engine;
use rigidformer_runtime::models::LoadedModel;
use rigidformer_runtime::progress::Progress;
use serde_json::{Value, json};

use crate::arguments::{Evaluate, usual_step};
use crate::usage::Usage;
use crate::viewers::{Moving, Viewers};
use crate::{contact, defaults, interrupt, output};
use fragments::Fragments;
use metric::{Headline, Metric, Task};
use rigid::Rigid;
use robots::Robots;
use soft::Soft;
use tosses::Tosses;

/// Files of results, and their bytes.
type Made = Vec<(PathBuf, Vec<u8>)>;
/// Measures the scenes of a file, and shows the figures; makes the picture that is asked for.
type Run = fn(&Evaluate, &Dataset, &AtomicBool) -> anyhow::Result<Made>;
/// Whether the scenes of a file are of a kind.
type Applies = fn(&Dataset) -> bool;

/// All kinds of scenes; the first that applies counts.
const METRICS: [(Applies, Run); 5] = [
    (Soft::applies, run_metric::<Soft>),
    (Fragments::applies, run_metric::<Fragments>),
    (Tosses::applies, run_metric::<Tosses>),
    (Robots::applies, run_metric::<Robots>),
    (Rigid::applies, run_metric::<Rigid>),
];

pub(crate) fn run(arguments: &Evaluate) -> anyhow::Result<()> {
    let cancelled = interrupt::watch();
    let viewers = Viewers::open(&arguments.viewers)?;
    let inputs = || {
        let paths = std::iter::once(&arguments.dataset).chain(&arguments.model.path);
        let more = arguments.neighbours.iter().chain(&arguments.contact.path);
        paths.chain(more).map(|path| path.as_path())
    };
    viewers.apart_from(inputs())?;
    if let Some(picture) = &arguments.picture {
        output::apart("--picture", picture, inputs())?;
    }
    let picture = arguments.picture.iter().map(|path| ("--picture", path.as_path()));
    output::distinct(picture.chain(viewers.paths()))?;
    if !viewers.is_asked() {
        if arguments.index.is_some() {
            let problem = "--index says which scene --mcap, --gltf and --html show; give one of them, or leave it out";
            return Err(Usage(problem.into()).into());
        }
        let made = measure(arguments, cancelled)?;
        return output::write_results(&made, arguments.json);
    }
    // Before the figures: a scene that is not there costs no computation.
    let dataset = Dataset::open(&arguments.dataset)?;
    let first = || dataset.scenes_of(Split::from(arguments.split)).first().copied();
    let scene = dataset.scene(arguments.index.or_else(first).unwrap_or(0), None)?;
    let scene = lawful(arguments, contact::applied_to(&arguments.contact, scene)?)?;
    let mut made = measure(arguments, cancelled)?;
    made.extend(viewers.made(&moving(arguments, &dataset, scene, cancelled)?)?);
    interrupt::check()?;
    output::write_results(&made, arguments.json)
}

/// A scene as it is predicted at the last of the step codes, for viewers.
fn moving(
    arguments: &Evaluate,
    dataset: &Dataset,
    scene: RecordedScene,
    cancelled: &AtomicBool,
) -> anyhow::Result<Moving> {
    let step = arguments.steps.last().copied().unwrap_or_else(|| usual_step(dataset));
    let loaded = model(arguments)?;
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

/// What predicts.
fn model(arguments: &Evaluate) -> anyhow::Result<LoadedModel> {
    let loaded = defaults::model(&arguments.model)?;
    let loaded = match arguments.without_network {
        true => defaults::without_network(&loaded)?,
        false => loaded,
    };
    if arguments.contact_law.is_some() && !loaded.model().config().motion.has_impulses() {
        let name = loaded.model().file().name();
        let problem = format!(
            "--contact-law: {name} does not move units by impulses; give edge or nano, or leave it out"
        );
        return Err(Usage(problem).into());
    }
    Ok(loaded.for_host()?)
}

/// A scene with the contact law that is asked for.
fn lawful(arguments: &Evaluate, scene: RecordedScene) -> anyhow::Result<RecordedScene> {
    match arguments.contact_law {
        Some(law) => Ok(scene.with_contact_law(law)?),
        None => Ok(scene),
    }
}

fn measure(arguments: &Evaluate, cancelled: &AtomicBool) -> anyhow::Result<Made> {
    let dataset = Dataset::open(&arguments.dataset)?;
    if arguments.neighbours.is_some() && dataset.command_size() == 0 {
        let problem = format!(
            "--neighbours: {} has no commands; neighbours are those of robots",
            arguments.dataset.display()
        );
        return Err(Usage(problem).into());
    }
    let found = METRICS.iter().find(|(applies, _)| applies(&dataset));
    let (_, run) = found.ok_or_else(|| anyhow::anyhow!("no figures are for such scenes"))?;
    run(arguments, &dataset, cancelled)
}

/// The figures of the same motion without the network.
struct Without {
    figures: Vec<Headline>,
    document: Value,
}

/// What the network is worth by a figure.
struct Gain {
    step: u32,
    name: &'static str,
    key: &'static str,
    with: f64,
    without: f64,
}

impl Gain {
    /// By how much the network lowers the figure, per cent; below 0 it raises it.
    fn percent(&self) -> f64 {
        if self.without > 0.0 { 100.0 * (1.0 - self.with / self.without) } else { 0.0 }
    }

    fn json(&self) -> Value {
        json!({
            "step": self.step, "figure": self.key, "with_network": self.with, "without_network": self.without,
            "gain_percent": self.percent(),
        })
    }
}

fn gains(with: &[Headline], without: &[Headline]) -> Vec<Gain> {
    let pairs = with.iter().zip(without);
    pairs
        .map(|(with, without)| Gain {
            step: with.step,
            name: with.name,
            key: with.key,
            with: with.value,
            without: without.value,
        })
        .collect()
}

fn print_gains(gains: &[Gain]) -> anyhow::Result<()> {
    output::line(
        "\nwhat the network is worth: the same motion without it, and what it takes off the error",
    )?;
    let mut table = output::table(["figure", "step", "with", "without", "gain"]);
    for gain in gains {
        let cells = [format!("{:.4}", gain.with), format!("{:.4}", gain.without)];
        let percent = format!("{:.1} %", gain.percent());
        let head = [gain.name.to_owned(), gain.step.to_string()];
        output::row(&mut table, head.into_iter().chain(cells).chain([percent]));
    }
    output::table_lines(&table)
}

fn run_metric<M: Metric>(
    arguments: &Evaluate,
    dataset: &Dataset,
    cancelled: &AtomicBool,
) -> anyhow::Result<Made> {
    let split = Split::from(arguments.split);
    let progress = Progress { cancelled, ..Progress::none() };
    let scenes = M::load(dataset, split, arguments.limit, progress)?;
    let scenes = contact::applied(&arguments.contact, scenes)?;
    let scenes: Vec<_> =
        scenes.into_iter().map(|scene| lawful(arguments, scene)).collect::<anyhow::Result<_>>()?;
    let loaded = model(arguments)?;
    let steps = arguments.steps_or(M::STEPS);
    let task = Task { arguments, dataset, split, scenes: &scenes, loaded: &loaded, steps };
    M::check(&task)?;
    // The same motion without the network stands beside every model, but one that says which bonds break: without it the record
    // would have to.
    let alone = match arguments.without_network || loaded.model().config().bonds > 0 {
        true => None,
        false => Some(defaults::uncorrected(&loaded)?),
    };
    let without = alone.as_ref().map(|alone| Task { loaded: alone, ..task });
    let calls = M::calls(&task) + without.as_ref().map_or(0, M::calls);
    let bar = output::progress(calls, dataset.name());
    let stepped = || bar.inc(1);
    let figures = M::measure(&task, Progress { cancelled, stepped: &stepped })?;
    let without = match &without {
        Some(task) => {
            let found = M::measure(task, Progress { cancelled, stepped: &stepped })?;
            Some(Without { figures: found.headlines(), document: found.json(task) })
        }
        None => None,
    };
    bar.finish_and_clear();
    interrupt::check()?;
    let gains = without.as_ref().map(|without| gains(&figures.headlines(), &without.figures));
    // A file has one law.
    let law = arguments.contact_law.unwrap_or(dataset.contact_law());
    let leaves_alone = !arguments.without_network && loaded.model().config().most_units > 0;
    if arguments.json {
        let mut document = figures.json(&task);
        if let Value::Object(fields) = &mut document {
            fields.insert("contact_law".into(), law.to_string().into());
        }
        if let (Value::Object(fields), Some(without), Some(gains)) = (&mut document, without, gains)
        {
            fields.insert("without_network".into(), without.document["model"].clone());
            fields.insert("gains".into(), gains.iter().map(Gain::json).collect());
            // What figures are of another motion by: a model keeps none of those.
            let mut changes = Vec::new();
            changes.extend(arguments.contact_law.map(|_| "--contact-law"));
            changes.extend(arguments.contact.path.as_ref().map(|_| "--contact"));
            changes.extend(arguments.join.then_some("--join"));
            changes.extend(arguments.limit.map(|_| "--limit"));
            fields.insert("changed_by".into(), json!(changes));
        }
        output::json(&document)?;
    } else {
        figures.print(&task)?;
        if !law.is_rigid() {
            output::line(format_args!("\ncontact law {law}"))?;
            if leaves_alone {
                output::line(
                    "the model leaves such scenes to impulses alone; --contact-law 0 has rigid contact",
                )?;
            }
        }
        if let Some(gains) = gains {
            print_gains(&gains)?;
        }
    }
    // After the figures: a path that cannot be written costs none of them.
    let picture = arguments.picture.iter().map(|path| Ok((path.clone(), figures.picture(&task)?)));
    picture.collect()
}
