//! Identification from recorded scenes.

use std::sync::Arc;

use rigidformer_core::Plane;
use rigidformer_evaluation::scenes::RecordedScene;
use rigidformer_runtime::engine::Engine;
use rigidformer_runtime::futures::BatchSimulator;
use rigidformer_runtime::models::LoadedModel;
use rigidformer_runtime::progress::Progress;

use super::estimator::{Estimator, Identified};
use super::setting::Setting;
use super::settings::{IdentifyError, PoseNoise, Settings};
use super::track::{Seen, Track};

/// What the motion of recorded scenes says, before it is asked.
pub struct Recording {
    estimator: Estimator,
    rounds: usize,
    noise: PoseNoise,
}

impl Recording {
    /// Cuts scenes into pieces of motion. Scenes of one list are of the same units: what is found holds for all of them.
    ///
    /// # Errors
    /// [`IdentifyError`] names the scene that cannot be, or the setting.
    pub fn new(
        engine: Engine,
        model: &LoadedModel,
        scenes: &[RecordedScene],
        settings: Settings,
    ) -> Result<Self, IdentifyError> {
        let config = model.model().config();
        if config.command_size > 0 {
            let scene = scenes.first().map_or("the scene", RecordedScene::name).to_owned();
            let what = "this model takes commands; give one of bodies that move by contact alone";
            return Err(IdentifyError::Scene { scene, what });
        }
        let ground = Plane::ground(config.ground_friction, config.ground_restitution);
        let mut estimator: Option<(Estimator, Arc<Setting>, &str)> = None;
        let mut noise = PoseNoise { position_m: 0.0, rotation_rad: 0.0 };
        for scene in scenes {
            let setting = Arc::new(Setting::new(scene, ground)?);
            if estimator.is_none() {
                let simulator = BatchSimulator::new(engine, model);
                let new = Estimator::new(simulator, setting.clone(), settings)?;
                estimator = Some((new, setting.clone(), scene.name()));
            }
            let Some((estimator, first, first_name)) = estimator.as_mut() else { continue };
            if !first.has_units_of(&setting) {
                let (scene, first) = (scene.name().to_owned(), (*first_name).to_owned());
                return Err(IdentifyError::OtherUnits { scene, first });
            }
            let mut track = Track::new(setting.free(), f64::from(setting.gravity.norm()));
            let rate = f64::from(scene.frame_rate_hz());
            for frame in 0..scene.frames() {
                let poses: Vec<Option<Seen>> = (0..setting.units.len())
                    .map(|unit| scene.pose(frame, unit).map(|pose| Seen::from(*pose)))
                    .collect();
                track.push(frame as f64 / rate, &poses)?;
            }
            let own = settings.noise.unwrap_or_else(|| track.noise());
            noise.position_m = noise.position_m.max(own.position_m);
            noise.rotation_rad = noise.rotation_rad.max(own.rotation_rad);
            while let Some(piece) = track.cut(f64::from(settings.step_s), own, true) {
                estimator.take(&setting, piece);
            }
        }
        let Some((estimator, ..)) = estimator else {
            let what = "there are no scenes; give at least one";
            return Err(IdentifyError::Scene { scene: "recording".to_owned(), what });
        };
        Ok(Recording { estimator, rounds: settings.rounds, noise })
    }

    /// Pieces of motion in which something touches.
    pub fn windows(&self) -> usize {
        self.estimator.windows()
    }

    /// How far poses are off: as the settings say, or as estimated, of the worst scene.
    pub fn noise(&self) -> PoseNoise {
        self.noise
    }

    /// Predicts all pieces round after round, at most [`Settings::rounds`]; `progress` is told of each piece of each round.
    ///
    /// # Errors
    /// [`IdentifyError::Cancelled`], or what predictions met.
    pub fn identify(&mut self, progress: Progress<'_>) -> Result<Identified, IdentifyError> {
        self.estimator.update(self.rounds, progress)?;
        Ok(self.estimator.identified())
    }
}
