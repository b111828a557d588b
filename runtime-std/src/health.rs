//! How many units of scenes are unlike what a model's training saw (docs/HEALTH.md).

use rigidformer_core::Simulator;
use rigidformer_weights::Quantity;

use crate::engine::Engine;
use crate::models::LoadedModel;
use crate::rollout::{Progress, Replay, RolloutError, on_all_threads, rollout_seen};
use crate::scenes::RecordedScene;

/// Looks at units: at one unit each time that a frame is looked at.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Looks {
    /// Looks.
    pub all: usize,
    /// Those of which a quantity is outside.
    pub outside: usize,
    /// How often each of [`Quantity::ALL`] is outside.
    pub by_quantity: [usize; Quantity::COUNT],
    /// Scenes.
    pub scenes: usize,
    /// Those in which any unit is ever outside.
    pub scenes_outside: usize,
    /// How far the farthest quantity is outside, in widths of its range; below 0 where all are inside.
    pub farthest: Option<(Quantity, f32)>,
}

impl Looks {
    /// Share of the looks that warn, from 0 to 1.
    pub fn share(&self) -> f64 {
        self.outside as f64 / self.all.max(1) as f64
    }

    /// Looks at all units as they are now.
    fn look(&mut self, simulator: &Simulator<'_, '_>) {
        for health in simulator.units().filter_map(|unit| simulator.health(unit.id())) {
            self.all += 1;
            self.outside += usize::from(health.outside != 0);
            for (quantity, count) in Quantity::ALL.into_iter().zip(&mut self.by_quantity) {
                *count += usize::from(health.is_outside(quantity));
            }
            if let Some(excess) = health.farthest {
                self.meet((excess.quantity, excess.beyond));
            }
        }
    }

    fn meet(&mut self, other: (Quantity, f32)) {
        if self.farthest.is_none_or(|(_, beyond)| other.1 > beyond) {
            self.farthest = Some(other);
        }
    }

    /// Of a scene that was looked at.
    fn of_scene(self) -> Self {
        Looks { scenes: 1, scenes_outside: usize::from(self.outside > 0), ..self }
    }

    fn and(mut self, other: Looks) -> Looks {
        self.all += other.all;
        self.outside += other.outside;
        self.scenes += other.scenes;
        self.scenes_outside += other.scenes_outside;
        for (sum, count) in self.by_quantity.iter_mut().zip(other.by_quantity) {
            *sum += count;
        }
        if let Some(farthest) = other.farthest {
            self.meet(farthest);
        }
        self
    }
}

/// Looks at units as they were recorded, `step` frames apart, every `step` frames.
///
/// # Errors
/// [`RolloutError`] of the first scene that the model cannot observe.
pub fn recorded(
    model: &LoadedModel,
    scenes: &[RecordedScene],
    step: u32,
) -> Result<Looks, RolloutError> {
    let step = step.max(1);
    sum(scenes, |engine, scene| {
        let mut replay = Replay::new(engine, model, scene)?;
        let mut looks = Looks::default();
        for frame in (step as usize..scene.frames()).step_by(step as usize) {
            replay.observe(step, frame as u32)?;
            looks.look(replay.world.simulator());
        }
        Ok(looks)
    })
}

/// Looks at units as they are predicted, from the frames 0 and `step` on, every `step` frames until `last_frame`.
///
/// ```
/// use rigidformer_runtime::{health, models::LoadedModel, rollout::Progress};
/// # fn scenes() -> Vec<rigidformer_runtime::scenes::RecordedScene> { Vec::new() }
/// let model = LoadedModel::embedded("edge", rigidformer_weights::EDGE)?;
/// let looks = health::predicted(&model, &scenes(), 10, 100, Progress::none())?;
/// assert!(looks.share() <= 0.02, "{looks:?}");
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
///
/// # Errors
/// As [`rollout`](crate::rollout::rollout).
pub fn predicted(
    model: &LoadedModel,
    scenes: &[RecordedScene],
    step: u32,
    last_frame: u32,
    progress: Progress<'_>,
) -> Result<Looks, RolloutError> {
    sum(scenes, |engine, scene| {
        let mut looks = Looks::default();
        let mut seen = |replay: &Replay<'_>| looks.look(replay.world.simulator());
        rollout_seen(engine, model, scene, step, last_frame, progress, &mut seen)?;
        Ok(looks)
    })
}

/// Of all scenes together.
fn sum(
    scenes: &[RecordedScene],
    one: impl Fn(Engine, &RecordedScene) -> Result<Looks, RolloutError> + Sync,
) -> Result<Looks, RolloutError> {
    let looks = on_all_threads(scenes, one)?;
    Ok(looks.into_iter().map(Looks::of_scene).fold(Looks::default(), Looks::and))
}
