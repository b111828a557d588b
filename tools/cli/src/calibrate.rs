//! `rigidformer calibrate`

use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

use rigidformer_evaluation::contact::{Contact, NUMBERS};
use rigidformer_evaluation::pivots::joined;
use rigidformer_evaluation::rollout::RolloutError;
use rigidformer_evaluation::scenes::{Dataset, RecordedScene, Split};
use rigidformer_planning::calibrate::{
    Bounds, CalibrateError, Calibrated, Calibration, Figures, Memo, Settings, Start, StartNoise,
    Weights, figures, start_noise,
};
use rigidformer_runtime::files::{self, FileError};
use rigidformer_runtime::memory::Budget;
use rigidformer_runtime::models::LoadedModel;
use rigidformer_runtime::noise::{Noise, mix};
use rigidformer_runtime::progress::Progress;
use serde_json::{Value, json};

use crate::arguments::Calibrate;
use crate::usage::Usage;
use crate::{defaults, interrupt, output};

/// How often a state is written, at most.
const KEEP_EVERY: Duration = Duration::from_secs(5);
/// The last frame that pivots are found from where the first one has velocities, as `evaluate` has it.
const JOINING: usize = 10;
/// The stream of random numbers that scenes are drawn by; searches have others.
const DRAW: u64 = 1 << 40;

/// Numbers of scenes in the file, by what they are for.
struct Shares {
    train: Vec<usize>,
    validation: Vec<usize>,
    test: Vec<usize>,
}

/// Scenes of one purpose, and what predictors do on them with the numbers of the file and with the fitted ones.
struct Share {
    name: &'static str,
    figures: Vec<(Option<Figures>, Option<Figures>)>,
}

/// (shares, predictors) Errors with some numbers.
type Measured = [Vec<Option<Figures>>; 3];

/// The file that what was computed is kept in, if there is one.
struct State<'s> {
    path: Option<&'s Path>,
    /// The calibration that it is of.
    of: u64,
    last: Instant,
}

impl State<'_> {
    fn write(&self, memo: &Memo) -> std::result::Result<(), FileError> {
        match self.path {
            Some(path) => output::write_state(path, memo.text(self.of).as_bytes()),
            None => Ok(()),
        }
    }

    fn keep(&mut self, memo: &Memo) {
        if self.last.elapsed() >= KEEP_EVERY {
            // The next one may succeed, and of the last one it is said.
            let _ = self.write(memo);
            self.last = Instant::now();
        }
    }

    /// Writes it for the last time. Numbers are worth more than the way to them, so that an error is only said.
    fn close(&self, memo: &Memo) {
        if let Err(error) = self.write(memo) {
            output::note(&format!("--resume: {error}; the state there is an older one"));
        }
    }

    /// Says what Ctrl-C leaves.
    fn left(&self, error: anyhow::Error) -> anyhow::Error {
        let cancelled = matches!(error.downcast_ref(), Some(RolloutError::Cancelled));
        if let Some(path) = self.path.filter(|_| cancelled) {
            output::note(&format!("the same command goes on from {}", path.display()));
        }
        error
    }
}

pub(crate) fn run(arguments: &Calibrate) -> anyhow::Result<()> {
    let cancelled = interrupt::watch();
    let files = [("--out", &arguments.out), ("--resume", &arguments.resume)];
    let files = || files.iter().filter_map(|(name, path)| Some((*name, path.as_deref()?)));
    for (name, path) in files() {
        let inputs = std::iter::once(&arguments.scenes).chain(&arguments.model.path);
        output::apart(name, path, inputs.map(PathBuf::as_path))?;
    }
    output::distinct(files())?;
    let settings = settings(arguments)?;
    let dataset = Dataset::open(&arguments.scenes)?;
    let shares = shares(arguments, &dataset)?;
    let given = defaults::model(&arguments.model)?;
    // What impulses do is said beside every model that has them.
    let alone = match arguments.without_network {
        true => Some(defaults::without_network(&given)?),
        false => defaults::without_network(&given).ok(),
    };
    let alone = alone.map(LoadedModel::for_host).transpose()?;
    let loaded = match (&alone, arguments.without_network) {
        (Some(alone), true) => alone.clone(),
        _ => given.for_host()?,
    };
    let mut budget = Budget::default();
    let mut scenes = |indices: &[usize]| -> anyhow::Result<Vec<RecordedScene>> {
        let one = |index: &usize| {
            interrupt::check()?;
            let scene = dataset.scene_within(*index, None, &mut budget)?;
            let last = if scene.has_velocities() { JOINING } else { settings.step as usize };
            Ok(if arguments.join { joined(scene, last)? } else { scene })
        };
        indices.iter().map(one).collect()
    };
    let (train, validation) = (scenes(&shares.train)?, scenes(&shares.validation)?);
    let test = scenes(&shares.test)?;
    let calibration =
        Calibration::new(&loaded, &train, &validation, settings.clone()).map_err(plain)?;
    calibration.takes(&test).map_err(plain)?;
    let of = fingerprint(&dataset, &loaded, (&settings, arguments.join), &shares);
    let mut memo = match arguments.resume.as_deref().filter(|path| path.exists()) {
        Some(path) => known(path, of)?,
        None => Memo::default(),
    };
    if !memo.is_empty() {
        output::note(&format!("goes on from {} rollouts of all scenes", memo.len()));
    }

    let mut predictors = vec![&loaded];
    predictors.extend(alone.as_ref().filter(|_| !arguments.without_network));
    let measured = |contact: &Contact| -> anyhow::Result<Measured> {
        let Settings { step, weights, .. } = settings;
        let of_share = |scenes: &Vec<RecordedScene>| {
            let of = |model: &&LoadedModel| {
                figures(model, scenes, contact, step, weights, cancelled).map_err(plain)
            };
            predictors.iter().map(of).collect::<anyhow::Result<Vec<_>>>()
        };
        Ok([of_share(&train)?, of_share(&validation)?, of_share(&test)?])
    };
    // Before the search: a scene that cannot be measured does not throw away what it found.
    let given = measured(&Contact::default())?;

    let mut state = State { path: arguments.resume.as_deref(), of, last: Instant::now() };
    // Likewise a file that cannot be written.
    state.write(&memo)?;
    let bar = output::progress(calibration.evaluations() as u64, dataset.name());
    let stepped = || bar.inc(1);
    let progress = Progress { cancelled, stepped: &stepped };
    let found = calibration.calibrate(&mut memo, &mut |memo| state.keep(memo), progress);
    bar.finish_and_clear();
    state.close(&memo);
    let found = found.map_err(|error| state.left(plain(error)))?;
    let fitted = measured(&found.contact).map_err(|error| state.left(error))?;
    let both = given.into_iter().zip(fitted);
    let shares = ["train", "validation", "test"].into_iter().zip(both);
    let shares = shares.map(|(name, (given, fitted))| Share {
        name,
        figures: given.into_iter().zip(fitted).collect(),
    });
    let shares: Vec<Share> = shares.collect();
    interrupt::check().map_err(|error| state.left(error.into()))?;
    let names: Vec<&str> = predictors.iter().map(|model| name_of(model, &alone)).collect();
    let noise = start_noise(&train);
    let result =
        Result { noise, dataset: &dataset, settings: &settings, found: &found, names, shares };
    match arguments.json {
        true => output::json(&result.document())?,
        false => result.print()?,
    }
    if let Some(path) = &arguments.out {
        output::write_results(&[(path.clone(), result.file().into_bytes())], arguments.json)
            .map_err(|error| state.left(error))?;
    }
    Ok(())
}

/// What a predictor is called.
fn name_of<'m>(model: &'m LoadedModel, alone: &Option<LoadedModel>) -> &'m str {
    let name = model.model().file().name();
    match alone.as_ref().is_some_and(|alone| alone.model().file().name() == name) {
        true => "impulses alone",
        false => name,
    }
}

fn settings(arguments: &Calibrate) -> anyhow::Result<Settings> {
    let &[position, rotation] = arguments.weights.as_slice() else {
        let problem =
            "--weights: give two numbers, the cost of a per cent and of a degree, such as 1,0.8";
        return Err(Usage(problem.into()).into());
    };
    if position + rotation == 0.0 {
        return Err(Usage(
            "--weights: both are 0, so that nothing counts; give one above 0".into(),
        )
        .into());
    }
    let mut fit = Vec::new();
    for group in &arguments.fit {
        let before = fit.len();
        fit.extend((0..NUMBERS.len()).filter(|at| NUMBERS[*at].group == group));
        if fit.len() == before {
            let mut groups: Vec<&str> = NUMBERS.iter().map(|number| number.group).collect();
            groups.dedup();
            let problem = format!(
                "--fit {group}: there is no such number; give some of {}",
                groups.join(", ")
            );
            return Err(Usage(problem).into());
        }
    }
    fit.sort_unstable();
    fit.dedup();
    if fit.is_empty() {
        fit = Settings::default().fit;
    }
    Ok(Settings {
        fit,
        step: arguments.step,
        weights: Weights { position, rotation },
        starts: usize::from(arguments.starts),
        evaluations: arguments.evaluations as usize,
        resamples: arguments.resamples as usize,
        seed: arguments.seed,
    })
}

fn shares(arguments: &Calibrate, dataset: &Dataset) -> anyhow::Result<Shares> {
    let path = dataset.path().display();
    let of = |split: Split| {
        let mut indices = dataset.scenes_of(split);
        indices.truncate(arguments.limit.map_or(usize::MAX, |limit| limit as usize));
        indices
    };
    let split = arguments.split.map(Split::from);
    let has_split = split.is_some() || !dataset.scenes_of(Split::Train).is_empty();
    let (mut pool, mut validation, mut test) = match has_split {
        true => {
            let own = split.unwrap_or(Split::Train);
            let other = |split: Split| if split == own { Vec::new() } else { of(split) };
            (of(own), other(Split::Validation), other(Split::Test))
        }
        false => {
            let all = 0..dataset.len();
            let limit = arguments.limit.map_or(usize::MAX, |limit| limit as usize);
            (all.take(limit).collect(), Vec::new(), Vec::new())
        }
    };
    let Some(count) = (!pool.is_empty()).then_some(pool.len()) else {
        let split = split.unwrap_or(Split::Train);
        anyhow::bail!(
            "{path}: scene_split: no scene is in the split {split}; choose another with --split"
        );
    };
    let draws = arguments.train.is_some() || arguments.validation.is_some_and(|share| share > 0.0);
    if draws {
        shuffle(&mut pool, arguments.seed);
    }
    if let Some(train) = arguments.train {
        if train as usize > count {
            let problem = format!("--train {train}: {path} has {count} scenes to fit to");
            return Err(Usage(problem).into());
        }
        let rest = pool.split_off(train as usize);
        // Of a file with splits the others are left out: its test is its own.
        if !has_split {
            test = rest;
        }
    }
    if let Some(share) = arguments.validation {
        let kept = pool.len() - (f64::from(share) * pool.len() as f64).round() as usize;
        if kept == 0 {
            let problem = format!(
                "--validation {share}: leaves no scene of {} to fit to; give a smaller share",
                pool.len()
            );
            return Err(Usage(problem).into());
        }
        validation = pool.split_off(kept);
    }
    // In the order of the file, so that figures do not depend on the order of draws.
    for indices in [&mut pool, &mut validation, &mut test] {
        indices.sort_unstable();
    }
    Ok(Shares { train: pool, validation, test })
}

fn shuffle(indices: &mut [usize], seed: u64) {
    let mut noise = Noise::new(seed, DRAW);
    for end in (1..indices.len()).rev() {
        // 24 bits of randomness draw among fewer scenes than that.
        let at = (f64::from(noise.uniform()) * (end + 1) as f64) as usize;
        indices.swap(end, at.min(end));
    }
}

/// Tells one calibration from another.
fn fingerprint(
    dataset: &Dataset,
    model: &LoadedModel,
    settings: (&Settings, bool),
    shares: &Shares,
) -> u64 {
    let hash = |bytes: &[u8], start: u64| {
        let word =
            |chunk: &[u8]| chunk.iter().fold(0, |word: u64, byte| (word << 8) | u64::from(*byte));
        let sum = |hash: u64, chunk: &[u8]| mix(hash ^ word(chunk));
        bytes.chunks(8).fold(mix(start ^ bytes.len() as u64), sum)
    };
    let file = model.model().file();
    let said = format!(
        "{} {:08x} {:?} {settings:?} {:?} {:?} {}",
        file.name(),
        file.payload_crc(),
        // The same weights move otherwise with other physics, at another rate or without the network.
        file.config(),
        shares.train,
        shares.validation,
        env!("CARGO_PKG_VERSION"),
    );
    hash(said.as_bytes(), hash(dataset.bytes(), 1))
}

/// What a state knows.
fn known(path: &Path, of: u64) -> anyhow::Result<Memo> {
    let bytes = files::read_whole(path)?;
    let text = String::from_utf8_lossy(&bytes);
    Memo::parse(&text, of).map_err(|error| anyhow::anyhow!("--resume {}: {error}", path.display()))
}

/// The error itself: by its type the program knows that Ctrl-C was pressed.
fn plain(error: CalibrateError) -> anyhow::Error {
    match error {
        CalibrateError::Cancelled => RolloutError::Cancelled.into(),
        other => other.into(),
    }
}

/// All that is told.
struct Result<'r> {
    dataset: &'r Dataset,
    settings: &'r Settings,
    found: &'r Calibrated,
    /// Of predictors.
    names: Vec<&'r str>,
    shares: Vec<Share>,
    noise: Option<StartNoise>,
}

impl Result<'_> {
    fn scenes(&self) -> usize {
        let first = self.shares.first().and_then(|share| share.figures.first());
        first.and_then(|(figures, _)| figures.as_ref()).map_or(0, |figures| figures.scenes)
    }

    /// (numbers) Place, fitted value, and bounds.
    fn numbers(&self) -> impl Iterator<Item = (usize, f32, Option<Bounds>)> + '_ {
        let bounds = self.settings.fit.iter().zip(&self.found.bounds);
        bounds.filter_map(|(at, bounds)| Some((*at, self.found.contact.at(*at)?, *bounds)))
    }

    fn print(&self) -> anyhow::Result<()> {
        let (first, step) = (self.names.first().copied().unwrap_or_default(), self.settings.step);
        output::line(format_args!(
            "{}: contact fitted to {} scenes with {first}, step {step}; 90 % intervals of resampled scenes",
            self.dataset.name(),
            self.scenes(),
        ))?;
        let mut table = output::table(["number", "in the file", "fitted", "90 %"]);
        for (at, value, bounds) in self.numbers() {
            let given = self.found.given.at(at).map_or(String::new(), shown);
            output::row(
                &mut table,
                [NUMBERS[at].name.to_owned(), given, shown(value), interval(bounds)],
            );
        }
        output::table_lines(&table)?;
        let mut table = output::table([
            "predictor",
            "numbers",
            "scenes",
            "",
            "position m",
            "% of the size",
            "rotation deg",
        ]);
        for (row, name) in self.names.iter().enumerate() {
            for share in &self.shares {
                let Some((given, fitted)) = share.figures.get(row) else { continue };
                for (numbers, figures) in [("in the file", given), ("fitted", fitted)] {
                    let Some(figures) = figures else { continue };
                    let cells = [
                        (*name).to_owned(),
                        numbers.to_owned(),
                        share.name.to_owned(),
                        figures.scenes.to_string(),
                        format!("{:.4}", figures.mean.position_m),
                        format!("{:.1}", figures.mean.position_percent),
                        format!("{:.1}", figures.mean.rotation_deg),
                    ];
                    output::row(&mut table, cells);
                }
            }
        }
        output::table_lines(&table)?;
        for note in self.notes() {
            output::note(&note);
        }
        Ok(())
    }

    fn notes(&self) -> Vec<String> {
        let mut notes = Vec::new();
        let Settings { evaluations, .. } = self.settings;
        let unfinished = self.found.starts.iter().filter(|start| start.evaluations >= *evaluations);
        if unfinished.count() > 0 {
            notes.push(format!("a search ended after {evaluations} rollouts and may go on; give more with --evaluations"));
        }
        if let Some(noise) = self.noise {
            notes.push(format!(
                "velocities at frame 0 are off by {:.3} m/s and {:.3} rad/s (a standard deviation of each coordinate, from {} flights)",
                noise.linear_m_s, noise.angular_rad_s, noise.units
            ));
        }
        let at_end = |at: usize, value: f32| NUMBERS[at].range.contains(&value);
        for (at, ..) in self.numbers().filter(|(at, value, _)| at_end(*at, *value)) {
            notes.push(format!("{} is at the end of its range", NUMBERS[at].name));
        }
        notes
    }

    fn document(&self) -> Value {
        let number = |(at, value, bounds): (usize, f32, Option<Bounds>)| {
            let bounds = bounds.map(|Bounds { low, high, open }| {
                json!({ "low": wide(low), "high": wide(high), "open": open })
            });
            json!({
                "name": NUMBERS[at].name,
                "in_file": self.found.given.at(at).map(wide),
                "fitted": wide(value),
                "interval": bounds,
            })
        };
        let figures = |figures: &Figures| {
            json!({
                "position_m": figures.mean.position_m,
                "position_percent": figures.mean.position_percent,
                "rotation_deg": figures.mean.rotation_deg,
                "cost": figures.cost,
            })
        };
        let share = |share: &Share| {
            let rows = self.names.iter().zip(&share.figures).map(|(name, (given, fitted))| {
                json!({
                    "predictor": name,
                    "in_file": given.as_ref().map(figures),
                    "fitted": fitted.as_ref().map(figures),
                })
            });
            let scenes = share.figures.first().and_then(|(figures, _)| figures.as_ref());
            json!({
                "share": share.name,
                "scenes": scenes.map_or(0, |figures| figures.scenes),
                "predictors": rows.collect::<Vec<_>>(),
            })
        };
        let start = |start: &Start| {
            json!({
                "train_cost": start.train,
                "validation_cost": start.validation,
                "evaluations": start.evaluations,
            })
        };
        let Settings { step, weights, seed, resamples, .. } = self.settings;
        json!({
            "dataset": self.dataset.name(),
            "model": self.names.first(),
            "step": step,
            "weights": { "percent": weights.position, "degree": weights.rotation },
            "seed": seed,
            "resamples": resamples,
            "probability": 0.9,
            "numbers": self.numbers().map(number).collect::<Vec<_>>(),
            "starts": self.found.starts.iter().map(start).collect::<Vec<_>>(),
            "chosen_start": self.found.chosen,
            "start_noise": self.noise.map(|noise| json!({
                "units": noise.units,
                "linear_m_s": noise.linear_m_s,
                "angular_rad_s": noise.angular_rad_s,
            })),
            "shares": self.shares.iter().map(share).collect::<Vec<_>>(),
        })
    }

    /// The text of contact.toml.
    fn file(&self) -> String {
        let (name, scenes) = (self.dataset.name(), self.scenes());
        let first = self.names.first().copied().unwrap_or_default();
        let Settings { step, seed, .. } = self.settings;
        let mut notes = vec![(
            "",
            format!(
                "Fitted by `rigidformer calibrate` to {scenes} scenes of {name} with {first}, step {step}, seed {seed}."
            ),
        )];
        for (at, _, bounds) in self.numbers().filter(|(.., bounds)| bounds.is_some()) {
            notes.push((NUMBERS[at].name, format!("90 %: {}", interval(bounds))));
        }
        self.found.contact.text(&notes)
    }
}

fn shown(value: f32) -> String {
    match value.abs() {
        0.0 => "0".into(),
        0.01.. => format!("{value:.3}"),
        _ => format!("{value:.5}"),
    }
}

fn interval(bounds: Option<Bounds>) -> String {
    let Some(Bounds { low, high, open: [below, above] }) = bounds else { return String::new() };
    let (below, above) = (if below { "< " } else { "" }, if above { "> " } else { "" });
    format!("{below}{} to {above}{}", shown(low), shown(high))
}

/// As f64: with `arbitrary_precision`, which another crate of a build may turn on, an f32 is written otherwise.
fn wide(value: f32) -> f64 {
    f64::from(value)
}
