//! Contact's numbers fitted to recorded scenes: those with which rollouts in open loop come nearest to the record.
//!
//! A start's simplex goes downhill (Nelder and Mead, of the crate `argmin`); of several starts the one counts that does best on the
//! validation scenes. A quadratic fitted to the costs around it gives the last step and, over resampled scenes, the intervals.
//! docs/IDENTIFY.md says what was measured. [`identify`](crate::identify) tells what one motion shows; this tells what fits many.
//!
//! ```
//! use nalgebra::{Isometry3, Point3, Vector3};
//! use rigidformer_core::{Physics, Plane};
//! use rigidformer_evaluation::scenes::{RecordedScene, RecordedUnit, Split, Velocity};
//! use rigidformer_planning::calibrate::{Calibration, Memo, Settings, number};
//! use rigidformer_runtime::models::LoadedModel;
//! use rigidformer_runtime::progress::Progress;
//!
//! // A slab that slides to a stop under friction .3; the file's guess is .5.
//! let pose = |frame: u32| {
//!     let t = (frame as f32 / 120.0).min(1.0 / (0.3 * 9.81));
//!     Isometry3::translation(t - 0.5 * 0.3 * 9.81 * t * t, 0.0, 0.02)
//! };
//! let corner = |i: i32| Point3::from([1, 2, 4].map(|bit| if i & bit == 0 { -1.0_f32 } else { 1.0 }));
//! let points = (0..8).map(|i| Point3::new(0.05 * corner(i).x, 0.05 * corner(i).y, 0.02 * corner(i).z)).collect();
//! let guess = Physics { mass_kg: 1.0, friction: 0.5, restitution: 0.0 };
//! let slab = RecordedUnit::new("slab", points, guess, (0..60).map(pose).collect())
//!     .with_velocity(Velocity { linear_m_s: Vector3::x(), ..Velocity::default() });
//! let gravity = Vector3::new(0.0, 0.0, -9.81);
//! let scene = RecordedScene::new("slide", 1, Split::Train, 120.0, gravity, vec![slab])?
//!     .with_planes(vec![Plane::ground(1.0, 1.0)])?;
//!
//! let loaded = LoadedModel::embedded("edge", rigidformer_weights::EDGE)?;
//! let settings = Settings { fit: vec![number("friction").ok_or("no such number")?], evaluations: 16, ..Settings::default() };
//! let calibration = Calibration::new(&loaded, std::slice::from_ref(&scene), &[], settings)?;
//! let found = calibration.calibrate(&mut Memo::default(), &mut |_| (), Progress::none())?;
//! let friction = found.contact.get("friction").ok_or("not fitted")?;
//! assert!((friction - 0.3).abs() < 0.02, "{friction}");
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```

mod cost;
mod error;
mod flight;
mod intervals;
mod memo;
mod search;
mod space;

use std::sync::atomic::Ordering;

use rigidformer_core::Compliance;
use rigidformer_core::kernels::in_own_environment;
use rigidformer_evaluation::contact::{Contact, NUMBERS};
use rigidformer_evaluation::scenes::RecordedScene;
use rigidformer_runtime::models::LoadedModel;
use rigidformer_runtime::progress::Progress;

pub use cost::{Errors, Figures, Weights, figures};
pub use error::CalibrateError;
pub use flight::{StartNoise, start_noise};
pub use intervals::Bounds;
pub use memo::{Memo, MemoError};

use cost::Objective;
use intervals::mean;
use space::Space;

/// Counts where contact is rigid.
const RESTITUTION: &str = "restitution";
/// Counts where it is not.
const STIFFNESS: &str = "stiffness_n_m";

/// How numbers are fitted.
#[derive(Clone, Debug, PartialEq)]
pub struct Settings {
    /// Places of the fitted numbers among the [`NUMBERS`], at least one; all but restitution. It counts for nothing where contact gives
    /// way, so that it is fitted without a stiffness alone.
    pub fit: Vec<usize>,
    /// Step code of the rollouts, from 1 to 100.
    pub step: u32,
    /// What errors cost.
    pub weights: Weights,
    /// Searches from different places, from 1 to 16; the first one's is what the scenes have.
    pub starts: usize,
    /// Rollouts of all training scenes in a search, at most; from 4 to 100,000.
    pub evaluations: usize,
    /// Resampled sets of scenes that intervals are of; 0: no intervals, and the same numbers. At most 10,000.
    pub resamples: usize,
    /// Another seed, other starts and other resamples.
    pub seed: u64,
}

impl Default for Settings {
    fn default() -> Self {
        Settings {
            fit: (0..NUMBERS.len()).filter(|at| Some(*at) != number(RESTITUTION)).collect(),
            step: 2,
            weights: Weights::default(),
            starts: 2,
            evaluations: 400,
            resamples: 400,
            seed: 1,
        }
    }
}

/// The place of a number among the [`NUMBERS`], by its name.
pub fn number(name: &str) -> Option<usize> {
    NUMBERS.iter().position(|number| number.name == name)
}

/// How a start did.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Start {
    /// Mean cost of the training scenes.
    pub train: f64,
    /// Of the validation scenes.
    pub validation: Option<f64>,
    /// Rollouts of all training scenes.
    pub evaluations: usize,
}

/// What was fitted.
#[derive(Clone, Debug, PartialEq)]
pub struct Calibrated {
    /// The fitted numbers.
    pub contact: Contact,
    /// What the scenes had.
    pub given: Contact,
    /// (numbers of [`Settings::fit`]) Where there were scenes enough to resample.
    pub bounds: Vec<Option<Bounds>>,
    /// In their order.
    pub starts: Vec<Start>,
    /// The start whose end the numbers are of.
    pub chosen: usize,
}

/// Scenes to fit to, and how.
pub struct Calibration<'m> {
    train: Objective<'m>,
    validation: Objective<'m>,
    settings: Settings,
    space: Space,
}

impl<'m> Calibration<'m> {
    /// Checks scenes and settings.
    ///
    /// # Errors
    /// [`CalibrateError`] names the refused scene or setting.
    pub fn new(
        model: &'m LoadedModel,
        train: &'m [RecordedScene],
        validation: &'m [RecordedScene],
        settings: Settings,
    ) -> Result<Self, CalibrateError> {
        check(&settings)?;
        if train.is_empty() {
            return Err(CalibrateError::NoScenes);
        }
        let space = in_own_environment(|| Space::new(&settings.fit, train));
        let of = |scenes: &'m [RecordedScene]| {
            Objective::new(model, scenes, settings.step, settings.weights)
        };
        let (train, validation) = (of(train)?, of(validation)?);
        let calibration = Calibration { train, validation, settings, space };
        calibration.takes(calibration.train.scenes)?;
        calibration.takes(calibration.validation.scenes)?;
        Ok(calibration)
    }

    /// Checks that scenes can take the numbers that are fitted, also those of a test: what a search has found is not to be lost to them.
    ///
    /// # Errors
    /// [`CalibrateError::Contact`] names the first that cannot, [`CalibrateError::Scene`] the first that gives way where restitution is fitted.
    pub fn takes(&self, scenes: &[RecordedScene]) -> Result<(), CalibrateError> {
        let given = self.space.given();
        let bounces = given.get(RESTITUTION).is_some();
        scenes.iter().try_for_each(|scene| {
            let mut all = scene.units().iter().map(|unit| unit.compliance);
            let rigid = |compliance: &Compliance| compliance.is_rigid();
            if bounces
                && !(all.all(|own| rigid(&own)) && scene.plane_compliance().iter().all(rigid))
            {
                let what =
                    "has compliant contact, in which restitution counts for nothing; fit stiffness in its place";
                return Err(CalibrateError::Scene { scene: scene.name().to_owned(), what });
            }
            Ok(given.applied(scene).map(drop)?)
        })
    }

    /// Rollouts of all training scenes that it takes, about.
    pub fn evaluations(&self) -> usize {
        let last = if self.has_quadratic() { intervals::designs(self.space.len()) + 1 } else { 1 };
        self.settings.starts * self.settings.evaluations + last
    }

    /// Whether a quadratic gives the last step: few scenes tell nothing of how others would do. How many sets are drawn does not count, so
    /// that the numbers are the same without intervals.
    fn has_quadratic(&self) -> bool {
        self.train.scenes.len() >= intervals::LEAST_SCENES
    }

    /// Fits the numbers. What `memo` knows is not computed again, and it knows more afterwards, also where this is cancelled; `kept` sees
    /// it whenever it has grown. `progress` counts rollouts of all training scenes.
    ///
    /// # Errors
    /// [`CalibrateError::Cancelled`], or an error of a rollout.
    pub fn calibrate(
        &self,
        memo: &mut Memo,
        kept: &mut dyn FnMut(&Memo),
        progress: Progress<'_>,
    ) -> Result<Calibrated, CalibrateError> {
        in_own_environment(|| self.calibrate_here(memo, kept, progress))
    }

    fn calibrate_here(
        &self,
        memo: &mut Memo,
        kept: &mut dyn FnMut(&Memo),
        progress: Progress<'_>,
    ) -> Result<Calibrated, CalibrateError> {
        let Calibration { train, validation, settings, space } = self;
        let cost_of = |contact: &Contact,
                       memo: &mut Memo,
                       kept: &mut dyn FnMut(&Memo)|
         -> Result<f64, CalibrateError> {
            if progress.cancelled.load(Ordering::Relaxed) {
                return Err(CalibrateError::Cancelled);
            }
            let key = space.key(contact);
            let found = match memo.mean(&key) {
                Some(known) => known,
                None => {
                    let found = mean(&train.costs(contact, progress.cancelled)?);
                    memo.keep_mean(key, found);
                    kept(memo);
                    found
                }
            };
            (progress.stepped)();
            Ok(found)
        };
        let (mut starts, mut ends) = (Vec::new(), Vec::new());
        for number in 0..settings.starts {
            let simplex = search::simplex(space.len(), settings.seed, number as u64);
            let cost =
                |at: &[f64]| Ok(cost_of(&space.contact(at), memo, kept)? + space.penalty(at));
            let end = search::downhill(simplex, settings.evaluations, cost)?;
            let contact = space.contact(&end.at);
            let of_validation = match validation.scenes.len() {
                0 => None,
                _ => Some(mean(&validation.costs(&contact, progress.cancelled)?)),
            };
            let train = cost_of(&contact, memo, kept)?;
            starts.push(Start { train, validation: of_validation, evaluations: end.evaluations });
            ends.push(contact);
        }
        let worth = |start: &Start| start.validation.unwrap_or(start.train);
        let best = starts.iter().enumerate().min_by(|a, b| worth(a.1).total_cmp(&worth(b.1)));
        let chosen = best.map_or(0, |(number, _)| number);
        let mut contact = ends.get(chosen).copied().unwrap_or_default();
        let mut bounds = vec![None; space.len()];
        if self.has_quadratic() {
            let around = space.place(&contact);
            let mut costs = Vec::new();
            let designs = intervals::design(&around, settings.seed);
            let designs: Vec<Contact> = designs.iter().map(|at| space.contact(at)).collect();
            for design in &designs {
                if progress.cancelled.load(Ordering::Relaxed) {
                    return Err(CalibrateError::Cancelled);
                }
                let key = space.key(design);
                let of_scenes = match memo.scenes(&key).filter(|of| of.len() == train.scenes.len())
                {
                    Some(known) => known.to_vec(),
                    None => {
                        let found = train.costs(design, progress.cancelled)?;
                        memo.keep_scenes(key, found.clone());
                        kept(memo);
                        found
                    }
                };
                costs.push(of_scenes);
                (progress.stepped)();
            }
            // Numbers are rounded and kept in their ranges, so places are those that they have.
            let places: Vec<Vec<f64>> = designs.iter().map(|design| space.place(design)).collect();
            if let Some(fit) = intervals::Fit::new(&around, &places) {
                let least = fit.least(&costs, None);
                let last = space.contact(&least);
                if cost_of(&last, memo, kept)? < cost_of(&contact, memo, kept)? {
                    contact = last;
                }
                let ends = fit.resampled(&costs, settings.resamples, settings.seed);
                bounds = space.bounds((&ends, &least), &fit, &contact);
            }
        }
        Ok(Calibrated { contact, given: space.given(), bounds, starts, chosen })
    }
}

fn check(settings: &Settings) -> Result<(), CalibrateError> {
    let Settings { fit, step, weights, starts, evaluations, resamples, .. } = settings;
    let weight = |weight: f64| (0.0..=1e6).contains(&weight);
    let has = |name: &str| number(name).is_some_and(|at| fit.contains(&at));
    let mut once = fit.clone();
    once.sort_unstable();
    once.dedup();
    let checks = [
        (
            !fit.is_empty() && once.len() == fit.len() && fit.iter().all(|at| *at < NUMBERS.len()),
            "fit",
            format!("{fit:?}"),
            "one or more of the numbers, each once",
        ),
        (
            ![RESTITUTION, STIFFNESS].iter().all(|name| has(name)),
            "fit",
            format!("{RESTITUTION} and {STIFFNESS}"),
            "one of the two: restitution counts for nothing where contact is compliant",
        ),
        ((1..=100).contains(step), "step", step.to_string(), "from 1 to 100"),
        (
            weight(weights.position)
                && weight(weights.rotation)
                && weights.position + weights.rotation > 0.0,
            "weights",
            format!("{weights:?}"),
            "from 0 to 1e6, one of them above 0",
        ),
        ((1..=16).contains(starts), "starts", starts.to_string(), "from 1 to 16"),
        (
            (4..=100_000).contains(evaluations),
            "evaluations",
            evaluations.to_string(),
            "from 4 to 100,000",
        ),
        (*resamples <= 10_000, "resamples", resamples.to_string(), "at most 10,000"),
    ];
    match checks.into_iter().find(|(is_sound, ..)| !is_sound) {
        Some((_, name, value, range)) => Err(CalibrateError::Setting { name, value, range }),
        None => Ok(()),
    }
}
