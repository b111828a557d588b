//! What rollouts with some numbers cost.

use std::sync::atomic::AtomicBool;

use rayon::prelude::*;
use rigidformer_core::Role;
use rigidformer_core::kernels::in_own_environment;
use rigidformer_evaluation::contact::{Contact, size_m};
use rigidformer_evaluation::open_loop;
use rigidformer_evaluation::rollout::{RolloutError, Trajectory, open_loop_on, rollout_on};
use rigidformer_evaluation::scenes::RecordedScene;
use rigidformer_runtime::engine::Engine;
use rigidformer_runtime::models::LoadedModel;
use rigidformer_runtime::progress::Progress;

use super::error::CalibrateError;

/// What an error of a scene costs.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Weights {
    /// A per cent of a unit's size, from 0.
    pub position: f64,
    /// A degree, from 0.
    pub rotation: f64,
}

impl Default for Weights {
    fn default() -> Self {
        Weights { position: 1.0, rotation: 0.8 }
    }
}

/// Errors that stand for a rollout that ends nowhere: worse than any that does not.
const NOWHERE: Errors = Errors { position_m: 1e3, position_percent: 1e5, rotation_deg: 180.0 };

/// Mean errors of a rollout, over the frames after frame 0 and the free units.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Errors {
    /// Metres.
    pub position_m: f64,
    /// Per cent of the units' size.
    pub position_percent: f64,
    /// Degrees.
    pub rotation_deg: f64,
}

impl Errors {
    fn cost(&self, weights: Weights) -> f64 {
        weights.position * self.position_percent + weights.rotation * self.rotation_deg
    }
}

/// Mean errors over scenes.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Figures {
    /// Scenes.
    pub scenes: usize,
    /// Means.
    pub mean: Errors,
    /// What they cost.
    pub cost: f64,
}

/// Errors of scenes with these numbers in place of theirs; none of no scenes.
///
/// # Errors
/// [`CalibrateError`] as of [`Calibration::new`](super::Calibration::new), or cancelled.
pub fn figures(
    model: &LoadedModel,
    scenes: &[RecordedScene],
    contact: &Contact,
    step: u32,
    weights: Weights,
    cancelled: &AtomicBool,
) -> Result<Option<Figures>, CalibrateError> {
    let objective = Objective::new(model, scenes, step, weights)?;
    let all = in_own_environment(|| objective.errors(contact, cancelled))?;
    let mean = |of: fn(&Errors) -> f64| all.iter().map(of).sum::<f64>() / all.len() as f64;
    let mean = Errors {
        position_m: mean(|of| of.position_m),
        position_percent: mean(|of| of.position_percent),
        rotation_deg: mean(|of| of.rotation_deg),
    };
    Ok((!all.is_empty()).then(|| Figures { scenes: all.len(), mean, cost: mean.cost(weights) }))
}

/// Scenes that are rolled out again and again.
pub(super) struct Objective<'m> {
    engine: Engine,
    model: &'m LoadedModel,
    pub(super) scenes: &'m [RecordedScene],
    /// (scenes) Of their units, metres.
    sizes: Vec<f64>,
    step: u32,
    weights: Weights,
}

impl<'m> Objective<'m> {
    pub(super) fn new(
        model: &'m LoadedModel,
        scenes: &'m [RecordedScene],
        step: u32,
        weights: Weights,
    ) -> Result<Self, CalibrateError> {
        let sizes: Vec<f64> = in_own_environment(|| scenes.iter().map(size_m).collect());
        for (scene, size) in scenes.iter().zip(&sizes) {
            let refused =
                |what| Err(CalibrateError::Scene { scene: scene.name().to_owned(), what });
            if !scene.units().iter().any(|unit| unit.role == Role::Free) {
                return refused("has no unit that moves freely; leave it out");
            }
            if !(size.is_finite() && *size > 0.0) {
                return refused("has units without a size; leave it out");
            }
            if scene.units().iter().any(|unit| unit.soft.is_some()) {
                return refused("has soft units, whose contact has other numbers; leave it out");
            }
            let least = if scene.has_velocities() { 2 } else { step as usize + 2 };
            if scene.frames() < least {
                return refused(
                    "has too few frames to compare with; leave it out, or give a smaller step",
                );
            }
        }
        let engine = Engine::new().map_err(RolloutError::from)?.single();
        Ok(Objective { engine, model, scenes, sizes, step, weights })
    }

    /// (scenes) What each costs, whatever the threads do.
    pub(super) fn costs(
        &self,
        contact: &Contact,
        cancelled: &AtomicBool,
    ) -> Result<Vec<f64>, CalibrateError> {
        let all = self.errors(contact, cancelled)?;
        Ok(all.iter().map(|errors| errors.cost(self.weights)).collect())
    }

    fn errors(
        &self,
        contact: &Contact,
        cancelled: &AtomicBool,
    ) -> Result<Vec<Errors>, CalibrateError> {
        let one = |(scene, size): (&RecordedScene, &f64)| {
            in_own_environment(|| self.of_scene(scene, *size, contact, cancelled))
        };
        let all: Vec<_> = self.scenes.par_iter().zip(&self.sizes).map(one).collect();
        // The first error in the order of the scenes.
        all.into_iter().collect()
    }

    fn of_scene(
        &self,
        scene: &RecordedScene,
        size_m: f64,
        contact: &Contact,
        cancelled: &AtomicBool,
    ) -> Result<Errors, CalibrateError> {
        let scene = contact.applied(scene)?;
        let predicted = match self.predicted(&scene, Progress { cancelled, ..Progress::none() }) {
            Ok(predicted) => predicted,
            // Numbers with which a body goes nowhere are bad ones, and others are tried.
            Err(RolloutError::Step { .. }) => return Ok(NOWHERE),
            Err(error) => return Err(error.into()),
        };
        let rate = match scene.has_velocities() {
            true => self.model.model().config().frame_rate_hz,
            false => scene.frame_rate_hz(),
        };
        let Some(errors) = open_loop::errors(&predicted, &scene, f64::from(rate)) else {
            return Ok(NOWHERE);
        };
        Ok(Errors {
            position_m: errors.position_m,
            position_percent: errors.position_m / size_m * 100.0,
            rotation_deg: errors.rotation_deg,
        })
    }

    /// In open loop: from a velocity where there is one, else from the frames 0 and step.
    fn predicted(
        &self,
        scene: &RecordedScene,
        progress: Progress<'_>,
    ) -> Result<Trajectory, RolloutError> {
        if scene.has_velocities() {
            return open_loop_on(self.engine, self.model, scene, self.step, progress);
        }
        let last = u32::try_from(scene.frames() - 1).unwrap_or(u32::MAX);
        rollout_on(self.engine, self.model, scene, self.step, last, progress)
    }
}
