//! Identification from poses as they arrive.

use std::sync::Arc;

use nalgebra::Vector3;
use rigidformer_core::Plane;
use rigidformer_evaluation::scenes::RecordedUnit;
use rigidformer_runtime::engine::Engine;
use rigidformer_runtime::futures::BatchSimulator;
use rigidformer_runtime::models::LoadedModel;
use rigidformer_runtime::progress::Progress;

use super::estimator::{Estimator, Identified};
use super::settings::{IdentifyError, PoseNoise, Settings};
use super::static_scene::StaticScene;
use super::track::{ObservedPose, Track};

/// The scene of an identification.
#[derive(Clone, Debug)]
pub struct Scene {
    /// Shapes, roles and masses of the units; their frictions, restitutions and poses do not count. Masses may be guesses.
    pub units: Vec<RecordedUnit>,
    /// Planes, with known friction and restitution: motion depends on products of coefficients alone.
    pub planes: Vec<Plane>,
    /// m/s^2
    pub gravity_m_s2: Vector3<f32>,
}

/// Identifies the physics of units from poses as they arrive. An observation that completes a segment of motion takes
/// [`rounds_online`](Settings::rounds_online) rounds over at most [`windows`](Settings::windows) windows. Others take no time.
/// The same observations and seed give the same intervals to the bit, on any number of threads.
pub struct Filter {
    static_scene: Arc<StaticScene>,
    settings: Settings,
    track: Track,
    estimator: Estimator,
    noise: PoseNoise,
}

impl Filter {
    /// A filter without observations, on all threads.
    ///
    /// # Errors
    /// [`IdentifyError`] names the setting or the property of the scene that is refused.
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
        let static_scene = Arc::new(StaticScene::of(units, planes, gravity_m_s2)?);
        let track = Track::new(static_scene.free(), f64::from(gravity_m_s2.norm()));
        let simulator = BatchSimulator::new(engine, model);
        let estimator = Estimator::new(simulator, static_scene.clone(), settings)?;
        let noise = PoseNoise { position_m: 0.0, rotation_rad: 0.0 };
        Ok(Filter { static_scene, settings, track, estimator, noise })
    }

    /// Takes the poses of a time, seconds, after the last one: one entry for each unit, none where it is not observed. Whether the intervals
    /// change.
    ///
    /// # Errors
    /// [`IdentifyError`]. Refused poses and times change nothing. After another error the poses are taken, and the segment is left out.
    pub fn observe(
        &mut self,
        time_s: f64,
        poses: &[Option<ObservedPose>],
    ) -> Result<bool, IdentifyError> {
        self.track.push(time_s, poses)?;
        self.take(false, Progress::none())
    }

    /// Takes the rest of the motion, such as at its end. Whether the intervals change. More observations may follow.
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
            // Without a setting, the latest poses estimate the noise.
            self.noise = self.settings.noise.unwrap_or_else(|| self.track.noise());
            let step_s = f64::from(self.settings.step_s);
            let Some(segment) = self.track.cut(step_s, self.noise, finished) else { break };
            if self.estimator.take(&self.static_scene, segment) {
                self.estimator.update(self.settings.rounds_online, progress)?;
                changed = true;
            }
        }
        Ok(changed)
    }

    /// The present result.
    pub fn identified(&self) -> Identified {
        self.estimator.identified()
    }

    /// Noise of the poses: as in the settings, or as estimated from the last segment.
    pub fn noise(&self) -> PoseNoise {
        self.noise
    }
}
