//! The figures of a split of a data set of rigid bodies, and the document that `rigidformer evaluate --json` prints.

use std::sync::atomic::Ordering;

use rigidformer_runtime::memory::Budget;
use rigidformer_runtime::models::LoadedModel;
use rigidformer_runtime::progress::Progress;
use serde_json::{Value, json};

use super::scene::{self, FRAMES, Figures, GREATEST_STEP, LAST_FRAME, SceneFigures};
use crate::metrics::{Apart, FrameErrors, Penetration};
use crate::paper::{self, Published};
use crate::pivots::{self, HoldError};
use crate::rollout::RolloutError;
use crate::scenes::{Dataset, RecordedScene, SceneError, Split};

/// Frames of a scene until the last one that the published tables read.
pub const TO_LAST_FRAME: usize = LAST_FRAME as usize + 1;
/// The published split's scenes.
// Published figures are means over all 120, so fewer cannot be compared.
const PUBLISHED_SCENES: usize = 120;

/// Why a split has no figures. Its text names the file or the scene, and the remedy.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum SplitError {
    /// A scene cannot be read.
    #[error(transparent)]
    Scene(#[from] SceneError),
    /// A scene cannot be rolled out, or the caller asked to stop.
    #[error(transparent)]
    Rollout(#[from] RolloutError),
    /// Links of a scene cannot be held together.
    #[error(transparent)]
    Hold(#[from] HoldError),
    /// A step code that would have observed frames among those that have figures, or is 0.
    #[error(
        "step code {0}: figures are of frames 50, 75 and 100, and two frames are observed, a step apart; give 1 to {GREATEST_STEP}"
    )]
    Step(u32),
    /// There is nothing that figures could be of.
    #[error("there are no {0} to evaluate; give at least one")]
    Nothing(&'static str),
}

/// The first scenes of a split, all of them without a limit; so many of their frames, all of them without a number.
///
/// # Errors
/// [`SceneError`](crate::scenes::SceneError) where no scene is in the split or one cannot be read; cancelled as `progress` says.
pub fn scenes_of(
    dataset: &Dataset,
    split: Split,
    limit: Option<u32>,
    frames: Option<usize>,
    progress: Progress<'_>,
) -> Result<Vec<RecordedScene>, SplitError> {
    let mut indices = dataset.scenes_of(split);
    if indices.is_empty() {
        return Err(dataset.none_in(split).into());
    }
    if let Some(limit) = limit {
        // The first ones, so that a limit gives the same scenes each time.
        indices.truncate(limit as usize);
    }
    let mut budget = Budget::default();
    let scene = |index| {
        if progress.cancelled.load(Ordering::Relaxed) {
            return Err(RolloutError::Cancelled.into());
        }
        Ok(dataset.scene_within(index, frames, &mut budget)?)
    };
    indices.into_iter().map(scene).collect()
}

/// As [`scenes_of`], with as many frames as figures need: those of the tables, or all where pivots are read off them.
///
/// # Errors
/// As [`scenes_of`].
pub fn scenes_to_evaluate(
    dataset: &Dataset,
    split: Split,
    limit: Option<u32>,
    progress: Progress<'_>,
) -> Result<Vec<RecordedScene>, SplitError> {
    let scenes = scenes_of(dataset, split, limit, Some(TO_LAST_FRAME), progress)?;
    // Pivots are read off all frames, which take longer to read than the 101 of the tables.
    match scenes.iter().any(pivots::has_links) {
        true => scenes_of(dataset, split, limit, None, progress),
        false => Ok(scenes),
    }
}

/// Figures of a model over a split's scenes, beside free fall, the record and what is published.
#[derive(Clone, Debug, PartialEq)]
pub struct SplitFigures {
    /// Name of the model.
    pub model: String,
    /// Name of the data set.
    pub dataset: String,
    /// The split.
    pub split: Split,
    /// (scenes) Name, seed and number of units.
    pub names: Vec<(String, i64, usize)>,
    /// (step code, figures)
    pub by_step: Vec<(u32, Figures)>,
    /// Of free fall.
    pub free_fall: Figures,
    /// How deep the record itself penetrates: mean and maximum over scenes.
    pub recorded: (Penetration, Penetration),
}

/// Calls of [`Progress::stepped`] that figures of so many scenes make.
pub fn calls(steps: &[u32], scenes: usize) -> u64 {
    let of = |step: &u32| u64::from(LAST_FRAME.div_ceil((*step).max(1))).saturating_sub(1);
    steps.iter().map(of).sum::<u64>() * scenes as u64
}

/// Rolls scenes of a data set out at each step code, 1 to [`GREATEST_STEP`]. With `join`, links are held together at pivots that
/// the observed frames show.
///
/// # Errors
/// [`SplitError`]
pub fn evaluate(
    model: &LoadedModel,
    dataset: &Dataset,
    split: Split,
    scenes: &[RecordedScene],
    (steps, join): (&[u32], bool),
    progress: Progress<'_>,
) -> Result<SplitFigures, SplitError> {
    // Greater steps would observe frames that the tables call predicted.
    if let Some(step) = steps.iter().find(|step| !(1..=GREATEST_STEP).contains(*step)) {
        return Err(SplitError::Step(*step));
    }
    for (what, is_empty) in [("step codes", steps.is_empty()), ("scenes", scenes.is_empty())] {
        if is_empty {
            return Err(SplitError::Nothing(what));
        }
    }
    let mut by_step = Vec::with_capacity(steps.len());
    for step in steps {
        let joined = match join {
            // Each step observes other frames, and so shows other pivots.
            true => Some(pivots::all_joined(scenes, *step as usize)?),
            false => None,
        };
        let held = joined.as_deref().unwrap_or(scenes);
        by_step.push((*step, scene::model(model, held, *step, progress)?));
    }
    let name = |scene: &RecordedScene| (scene.name().to_owned(), scene.seed(), scene.units().len());
    Ok(SplitFigures {
        model: model.model().file().name().to_owned(),
        dataset: dataset.name().to_owned(),
        split,
        names: scenes.iter().map(name).collect(),
        by_step,
        free_fall: scene::free_falling(scenes)?,
        recorded: scene::recorded_penetration(scenes, 1),
    })
}

impl SplitFigures {
    /// Whether the published figures are of these very scenes.
    fn is_comparable(&self) -> bool {
        // Other scenes of the same data set are easier or harder.
        self.split == Split::Test && self.names.len() == PUBLISHED_SCENES
    }

    /// What a reader should know.
    pub fn notes(&self) -> Vec<String> {
        let mut notes = vec!["free fall keeps the velocity and spin of frames 2 and 3".to_owned()];
        for (step, _) in &self.by_step {
            let between: Vec<String> =
                FRAMES.iter().filter(|frame| **frame % step != 0).map(u32::to_string).collect();
            // An interpolated pose is an error of its own, which the reader should know of.
            if !between.is_empty() {
                let frames = between.join(", ");
                notes.push(format!(
                    "step {step} does not reach frame {frames}: poses there are interpolated (slerp)"
                ));
            }
        }
        if paper::hop_net(&self.dataset).is_none() {
            notes.push(format!("nothing is published for {}", self.dataset));
        } else if !self.is_comparable() {
            notes.push(format!(
                "the published rows are of all {PUBLISHED_SCENES} test scenes, this is {} of {}",
                self.names.len(),
                self.split
            ));
        }
        notes
    }

    /// All of it for machines.
    pub fn document(&self) -> Value {
        let rows = self
            .by_step
            .iter()
            .map(|(step, figures)| json!({ "step": step, "figures": figures_json(figures) }));
        let published: Vec<Value> = paper::PUBLISHED
            .iter()
            .filter(|row| row.dataset == self.dataset)
            .map(published_json)
            .collect();
        let (mean, max) = self.recorded;
        json!({
            "dataset": self.dataset,
            "split": self.split.to_string(),
            "scenes": self.names.len(),
            "model": { "name": self.model, "steps": rows.collect::<Vec<_>>() },
            "free_fall": figures_json(&self.free_fall),
            "recorded": { "penetration": penetration_json(mean, max) },
            "per_scene": self.per_scene(),
            "published": published,
            "published_scenes_are_these": self.is_comparable(),
            "notes": self.notes(),
        })
    }

    /// Every scene with its figures at each step code.
    fn per_scene(&self) -> Vec<Value> {
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
            let steps = self.by_step.iter();
            let steps = steps.map(|(step, all)| json!({ "step": step, "figures": of(all) }));
            json!({
                "name": name,
                "seed": seed,
                "units": units,
                "steps": steps.collect::<Vec<_>>(),
                "free_fall": of(&self.free_fall),
            })
        };
        self.names.iter().enumerate().map(scene).collect()
    }
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

/// How far links come apart, for machines.
pub fn apart_json(apart: Option<Apart>) -> Value {
    apart.map_or(Value::Null, |Apart { median_m, most_m, max_m }| {
        json!({ "median_m": median_m, "percentile_99_m": most_m, "max_m": max_m })
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
    // HopNet's script prints the mean over objects, and its rows have no step.
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
