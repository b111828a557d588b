//! `rigidformer identify`

use std::collections::BTreeMap;

use rigidformer_evaluation::rollout::RolloutError;
use rigidformer_evaluation::scenes::{Dataset, RecordedScene, Split};
use rigidformer_planning::identify::recording::Recording;
use rigidformer_planning::identify::{
    Identified, IdentifyError, Interval, PoseNoise, Prior, Settings, UnitPhysics,
};
use rigidformer_runtime::core::Physics;
use rigidformer_runtime::engine::Engine;
use rigidformer_runtime::memory::Budget;
use rigidformer_runtime::progress::Progress;
use serde_json::{Value, json};

use crate::arguments::Identify;
use crate::usage::Usage;
use crate::{contact, defaults, interrupt, output};

/// What was found in a scene, or in all that show the same bodies.
struct Found {
    scenes: Vec<RecordedScene>,
    /// (scenes) Their numbers in the file.
    indices: Vec<usize>,
    noise: PoseNoise,
    identified: Identified,
}

impl Found {
    fn name(&self) -> String {
        match self.scenes.as_slice() {
            [only] => only.name().to_owned(),
            all => format!("{} scenes", all.len()),
        }
    }
}

pub(crate) fn run(arguments: &Identify) -> anyhow::Result<()> {
    let cancelled = interrupt::watch();
    if let Some(out) = &arguments.out {
        let inputs = std::iter::once(&arguments.scenes).chain(&arguments.model.path);
        let inputs = inputs.chain(&arguments.contact.path);
        output::apart("--out", out, inputs.map(|path| path.as_path()))?;
    }
    let dataset = Dataset::open(&arguments.scenes)?;
    let indices = chosen(arguments, &dataset)?;
    let loaded = defaults::model(&arguments.model)?.for_host()?;
    let settings = settings(arguments)?;
    let mut budget = Budget::default();
    let mut scenes = Vec::with_capacity(indices.len());
    for index in &indices {
        interrupt::check()?;
        let scene = dataset.scene_within(*index, None, &mut budget)?;
        scenes.push((*index, contact::applied_to(&arguments.contact, scene)?));
    }
    let together: Vec<Vec<(usize, RecordedScene)>> = match arguments.same_body {
        true => vec![scenes],
        false => scenes.into_iter().map(|scene| vec![scene]).collect(),
    };
    let engine = Engine::new()?;
    let bar = output::progress((together.len() * settings.rounds) as u64, dataset.name());
    let mut found = Vec::with_capacity(together.len());
    for scenes in together {
        let (indices, scenes): (Vec<_>, Vec<_>) = scenes.into_iter().unzip();
        let mut recording = Recording::new(engine, &loaded, &scenes, settings)?;
        // A round is one on the bar, however many windows there are; those that need not be taken are done too.
        let windows = recording.windows().max(1) as u64;
        let (before, taken) = (bar.position(), std::sync::atomic::AtomicU64::new(0));
        let stepped = || {
            let done = taken.fetch_add(1, std::sync::atomic::Ordering::Relaxed) + 1;
            bar.set_position(before + done / windows);
        };
        let identified = recording.identify(Progress { cancelled, stepped: &stepped });
        let identified = identified.map_err(|error| match error {
            IdentifyError::Cancelled => anyhow::Error::new(RolloutError::Cancelled),
            other => other.into(),
        })?;
        bar.set_position(before + settings.rounds as u64);
        let noise = recording.noise();
        found.push(Found { scenes, indices, noise, identified });
    }
    bar.finish_and_clear();
    interrupt::check()?;
    match arguments.json {
        true => output::json(&document(&dataset, loaded.model().file().name(), &settings, &found))?,
        false => print(&dataset, loaded.model().file().name(), &found)?,
    }
    if let Some(path) = &arguments.out {
        let mut all = BTreeMap::new();
        for found in &found {
            all.extend(changes(&dataset, found, arguments.same_body)?);
        }
        output::write_whole(path, &dataset.with_physics(&all)?)?;
        let done = format!("wrote {}", path.display());
        match arguments.json {
            true => output::note(&done),
            false => output::line(done)?,
        }
    }
    Ok(())
}

/// Numbers of the scenes that are asked for.
fn chosen(arguments: &Identify, dataset: &Dataset) -> anyhow::Result<Vec<usize>> {
    let path = dataset.path().display();
    if let Some(index) = arguments.index {
        if index >= dataset.len() {
            let problem = format!("--index {index}: {path} has {} scenes, from 0", dataset.len());
            return Err(Usage(problem).into());
        }
        return Ok(vec![index]);
    }
    let mut indices = match arguments.split.map(Split::from) {
        Some(split) => {
            let indices = dataset.scenes_of(split);
            anyhow::ensure!(
                !indices.is_empty(),
                "{path}: scene_split: no scene is in the split {split}; choose another with --split"
            );
            indices
        }
        None => (0..dataset.len()).collect(),
    };
    if let Some(limit) = arguments.limit {
        indices.truncate(limit as usize);
    }
    Ok(indices)
}

fn settings(arguments: &Identify) -> Result<Settings, Usage> {
    let noise = arguments.noise_mm.zip(arguments.noise_mrad);
    let noise =
        noise.map(|(mm, mrad)| PoseNoise { position_m: mm * 1e-3, rotation_rad: mrad * 1e-3 });
    let &[friction_most, restitution_most] = arguments.most.as_slice() else {
        let problem =
            "--most: give two numbers, the largest friction and restitution, such as 1.2,1";
        return Err(Usage(problem.into()));
    };
    let prior = Prior { friction_most, restitution_most, ..Prior::default() };
    Ok(Settings {
        particles: arguments.particles as usize,
        seed: arguments.seed,
        noise,
        prior,
        ..Settings::default()
    })
}

/// The bound or middle of an interval; none of what was not seen.
fn value(interval: &Interval) -> Option<f64> {
    match *interval {
        Interval::Between { middle, .. } => Some(middle),
        Interval::AtLeast { low } => Some(low),
        Interval::AtMost { high } => Some(high),
        _ => None,
    }
}

/// By scene and unit, what its physics become. Where all scenes show the same bodies, also those that were not looked at.
fn changes(
    dataset: &Dataset,
    found: &Found,
    same_body: bool,
) -> anyhow::Result<BTreeMap<(usize, usize), Physics>> {
    let mut changes = BTreeMap::new();
    let units = &found.identified.units;
    let indices = if same_body { (0..dataset.len()).collect() } else { found.indices.clone() };
    for index in indices {
        let scene = dataset.scene(index, Some(1))?;
        if scene.units().len() != units.len() {
            continue;
        }
        for (unit, (recorded, known)) in scene.units().iter().zip(units).enumerate() {
            let Physics { mass_kg, friction, restitution } = recorded.physics;
            let or = |interval: &Interval, given: f32| value(interval).map_or(given, |v| v as f32);
            let friction = or(&known.own_friction, friction);
            let restitution = or(&known.own_restitution, restitution);
            changes.insert((index, unit), Physics { mass_kg, friction, restitution });
        }
    }
    Ok(changes)
}

fn print(dataset: &Dataset, model: &str, found: &[Found]) -> anyhow::Result<()> {
    output::line(format_args!(
        "{}, model {model}: friction and restitution with the plane (products of both), 90 % intervals",
        dataset.name()
    ))?;
    let mut table =
        output::table(["scene", "unit", "friction", "restitution", "pieces", "noise mm", "misfit"]);
    let unfinished = found.iter().filter(|of| of.identified.unfinished).count();
    for of in found {
        let Some(scene) = of.scenes.first() else { continue };
        let rows = of.identified.units.iter().zip(scene.units()).enumerate();
        for (unit, (known, recorded)) in rows.filter(|(_, (known, _))| known.touched) {
            let cells = [
                of.name(),
                format!("{unit} {}", recorded.shape),
                known.friction.to_string(),
                known.restitution.to_string(),
                of.identified.windows.to_string(),
                format!("{:.2}", f64::from(of.noise.position_m) * 1e3),
                format!("{:.1}", of.identified.misfit),
            ];
            output::row(&mut table, cells);
        }
    }
    output::table_lines(&table)?;
    for of in found {
        for ratio in &of.identified.ratios {
            let [one, other] = ratio.units;
            output::line(format_args!(
                "{}: mass of unit {one} / mass of unit {other}: {}",
                of.name(),
                ratio.ratio
            ))?;
        }
    }
    let untouched =
        found.iter().filter(|of| !of.identified.units.iter().any(|unit| unit.touched)).count();
    if untouched > 0 {
        output::note(&format!(
            "in {untouched} scenes nothing touches anything for long enough: there is nothing to see"
        ));
    }
    if unfinished > 0 {
        output::note(&format!(
            "in {unfinished} of {} the search ended early: intervals are wider than the motion allows; try --particles 256",
            found.len()
        ));
    }
    if found.iter().any(|of| of.identified.misfit > 20.0) {
        output::note(
            "a misfit far above 1: the model does not move like this record; intervals were widened by it",
        );
    }
    Ok(())
}

fn interval_json(interval: &Interval) -> Value {
    match *interval {
        Interval::Between { low, middle, high } => {
            json!({ "seen": "between", "low": low, "middle": middle, "high": high })
        }
        Interval::AtLeast { low } => json!({ "seen": "at least", "low": low }),
        Interval::AtMost { high } => json!({ "seen": "at most", "high": high }),
        _ => json!({ "seen": "no" }),
    }
}

fn document(dataset: &Dataset, model: &str, settings: &Settings, found: &[Found]) -> Value {
    let unit = |(number, known): (usize, &UnitPhysics)| {
        json!({
            "unit": number,
            "touched": known.touched,
            "friction": interval_json(&known.friction),
            "restitution": interval_json(&known.restitution),
            "own_friction": interval_json(&known.own_friction),
            "own_restitution": interval_json(&known.own_restitution),
        })
    };
    let result = |of: &Found| {
        let ratios = of.identified.ratios.iter();
        let ratios =
            ratios.map(|r| json!({ "units": r.units, "mass_ratio": interval_json(&r.ratio) }));
        json!({
            "scenes": of.indices,
            "names": of.scenes.iter().map(RecordedScene::name).collect::<Vec<_>>(),
            "units": of.identified.units.iter().enumerate().map(unit).collect::<Vec<_>>(),
            "met": ratios.collect::<Vec<_>>(),
            "pieces": of.identified.windows,
            "noise_m": of.noise.position_m,
            "noise_rad": of.noise.rotation_rad,
            "misfit": of.identified.misfit,
            "unfinished": of.identified.unfinished,
        })
    };
    json!({
        "dataset": dataset.name(),
        "model": model,
        "seed": settings.seed,
        "particles": settings.particles,
        "probability": 0.9,
        "friction_is": "with the plane: the product of both coefficients",
        "results": found.iter().map(result).collect::<Vec<_>>(),
    })
}
