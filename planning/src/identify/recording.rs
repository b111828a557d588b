//! Identification from recorded scenes.

use std::sync::Arc;

use rigidformer_core::Plane;
use rigidformer_core::kernels::in_own_environment;
use rigidformer_evaluation::scenes::RecordedScene;
use rigidformer_runtime::engine::Engine;
use rigidformer_runtime::futures::BatchSimulator;
use rigidformer_runtime::models::LoadedModel;
use rigidformer_runtime::progress::Progress;

use super::estimator::{Estimator, Identified};
use super::settings::{IdentifyError, PoseNoise, Settings};
use super::static_scene::StaticScene;
use super::track::{ObservedPose, Track};

/// An identification from recorded scenes.
pub struct Recording {
    estimator: Estimator,
    rounds: usize,
    noise: PoseNoise,
}

impl Recording {
    /// Cuts scenes into segments of motion. All scenes have the same units, and share the result.
    ///
    /// # Errors
    /// [`IdentifyError`] names the refused scene or setting.
    pub fn new(
        engine: Engine,
        model: &LoadedModel,
        scenes: &[RecordedScene],
        settings: Settings,
    ) -> Result<Self, IdentifyError> {
        let config = model.model().config();
        // Without a command such a model does not predict at all.
        if config.command_size > 0 {
            let scene = scenes.first().map_or("the scene", RecordedScene::name).to_owned();
            let what = "this model takes commands; give one of bodies that move by contact alone";
            return Err(IdentifyError::Scene { scene, what });
        }
        let ground = Plane::ground(config.ground_friction, config.ground_restitution);
        let mut estimator: Option<(Estimator, Arc<StaticScene>, &str)> = None;
        let mut noise = PoseNoise { position_m: 0.0, rotation_rad: 0.0 };
        for scene in scenes {
            let static_scene = Arc::new(StaticScene::new(scene, ground)?);
            if estimator.is_none() {
                let simulator = BatchSimulator::new(engine, model);
                let new = Estimator::new(simulator, static_scene.clone(), settings)?;
                estimator = Some((new, static_scene.clone(), scene.name()));
            }
            let Some((estimator, first, first_name)) = estimator.as_mut() else { continue };
            // Parameters belong to units, and scenes with other units share none.
            if !first.has_units_of(&static_scene) {
                let (scene, first) = (scene.name().to_owned(), (*first_name).to_owned());
                return Err(IdentifyError::OtherUnits { scene, first });
            }
            let mut track = Track::new(static_scene.free(), f64::from(static_scene.gravity.norm()));
            let rate = f64::from(scene.frame_rate_hz());
            for frame in 0..scene.frames() {
                let poses: Vec<Option<ObservedPose>> = (0..static_scene.units.len())
                    .map(|unit| scene.pose(frame, unit).map(|pose| ObservedPose::from(*pose)))
                    .collect();
                track.push(frame as f64 / rate, &poses)?;
            }
            let own = settings.noise.unwrap_or_else(|| track.noise());
            noise.position_m = noise.position_m.max(own.position_m);
            noise.rotation_rad = noise.rotation_rad.max(own.rotation_rad);
            while let Some(segment) = track.cut(f64::from(settings.step_s), own, true) {
                estimator.take(&static_scene, segment);
            }
        }
        let Some((estimator, ..)) = estimator else {
            let what = "there are no scenes; give at least one";
            return Err(IdentifyError::Scene { scene: "recording".to_owned(), what });
        };
        Ok(Recording { estimator, rounds: settings.rounds, noise })
    }

    /// Windows of motion with contact.
    pub fn windows(&self) -> usize {
        self.estimator.windows()
    }

    /// Noise of the poses: as in the settings, or as estimated from the noisiest scene.
    pub fn noise(&self) -> PoseNoise {
        self.noise
    }

    /// Predicts all windows round after round, at most [`Settings::rounds`] times. `progress` counts windows of rounds.
    ///
    /// # Errors
    /// [`IdentifyError::Cancelled`], or an error of a prediction.
    pub fn identify(&mut self, progress: Progress<'_>) -> Result<Identified, IdentifyError> {
        in_own_environment(|| {
            self.estimator.update(self.rounds, progress)?;
            Ok(self.estimator.identified())
        })
    }
}
