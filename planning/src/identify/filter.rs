//! Identification while poses come in.

use std::sync::Arc;

use nalgebra::Vector3;
use rigidformer_core::Plane;
use rigidformer_evaluation::scenes::RecordedUnit;
use rigidformer_runtime::engine::Engine;
use rigidformer_runtime::futures::BatchSimulator;
use rigidformer_runtime::models::LoadedModel;
use rigidformer_runtime::progress::Progress;

use super::estimator::{Estimator, Identified};
use super::setting::Setting;
use super::settings::{IdentifyError, PoseNoise, Settings};
use super::track::{Seen, Track};

/// What is known of a scene before it moves.
#[derive(Clone, Debug)]
pub struct Scene {
    /// Shapes, roles and masses of the units; their frictions, restitutions and poses do not count. Masses may be guesses.
    pub units: Vec<RecordedUnit>,
    /// What they move on, with known friction and restitution: only products can be seen.
    pub planes: Vec<Plane>,
    /// m/s^2
    pub gravity_m_s2: Vector3<f32>,
}

/// Identifies what units are made of while they are seen. An observation that completes a piece of motion takes
/// [`rounds_online`](Settings::rounds_online) rounds over at most [`windows`](Settings::windows) pieces; others take no time.
/// The same observations and seed give the same intervals to the bit, on any number of threads.
pub struct Filter {
    setting: Arc<Setting>,
    settings: Settings,
    track: Track,
    estimator: Estimator,
    noise: PoseNoise,
}

impl Filter {
    /// A filter that has seen nothing yet, on all threads.
    ///
    /// # Errors
    /// [`IdentifyError`] names the setting or the part of the scene that cannot be.
    pub fn new(
        model: &LoadedModel,
        scene: Scene,
        settings: Settings,
    ) -> Result<Self, IdentifyError> {
        Filter::on(Engine::new()?, model, scene, settings)
    }

    /// As [`new`](Self::new) on kernels and threads of the caller's choice.
    ///
    /// # Errors
    /// As [`new`](Self::new).
    pub fn on(
        engine: Engine,
        model: &LoadedModel,
        scene: Scene,
        settings: Settings,
    ) -> Result<Self, IdentifyError> {
        settings.check()?;
        let Scene { units, planes, gravity_m_s2 } = scene;
        let setting = Arc::new(Setting::of(units, planes, gravity_m_s2)?);
        let track = Track::new(setting.free(), f64::from(gravity_m_s2.norm()));
        let simulator = BatchSimulator::new(engine, model);
        let estimator = Estimator::new(simulator, setting.clone(), settings)?;
        let noise = PoseNoise { position_m: 0.0, rotation_rad: 0.0 };
        Ok(Filter { setting, settings, track, estimator, noise })
    }

    /// Takes what was seen at a time, seconds, after the last one: one entry a unit, none where it was not seen. Whether the intervals
    /// have changed.
    ///
    /// # Errors
    /// [`IdentifyError`]. Poses and times that cannot be are not taken; after another error the pose was taken and the piece of motion
    /// left out.
    pub fn observe(&mut self, time_s: f64, poses: &[Option<Seen>]) -> Result<bool, IdentifyError> {
        self.track.push(time_s, poses)?;
        self.take(false, Progress::none())
    }

    /// Takes what is left of the motion, such as at its end. Whether the intervals have changed. More may be observed afterwards.
    ///
    /// # Errors
    /// As [`observe`](Self::observe).
    pub fn finish(&mut self) -> Result<bool, IdentifyError> {
        let changed = self.take(true, Progress::none())?;
        self.estimator.update(self.settings.rounds, Progress::none())?;
        Ok(changed)
    }

    fn take(&mut self, finished: bool, progress: Progress<'_>) -> Result<bool, IdentifyError> {
        let mut changed = false;
        while self.track.is_ready(finished) {
            self.noise = self.settings.noise.unwrap_or_else(|| self.track.noise());
            let step_s = f64::from(self.settings.step_s);
            let Some(piece) = self.track.cut(step_s, self.noise, finished) else { break };
            if self.estimator.take(&self.setting, piece) {
                self.estimator.update(self.settings.rounds_online, progress)?;
                changed = true;
            }
        }
        Ok(changed)
    }

    /// What is known now.
    pub fn identified(&self) -> Identified {
        self.estimator.identified()
    }

    /// How far poses are off: as the settings say, or as the last piece of motion told.
    pub fn noise(&self) -> PoseNoise {
        self.noise
    }
}
