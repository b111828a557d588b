//! What a model's training saw, measured on its scenes, and how many units of others are unlike that (docs/HEALTH.md).

use rayon::prelude::*;
use rigidformer_core::{Role, Simulator};
use rigidformer_runtime::engine::Engine;
use rigidformer_runtime::models::LoadedModel;
use rigidformer_runtime::progress::Progress;
use rigidformer_weights::{Quantity, Ranges};

use crate::rollout::{Replay, RolloutError, on_all_threads, rollout_seen};
use crate::scenes::RecordedScene;

/// Frames of a step that scenes are looked at with, in turn.
// The step code is a quantity itself, and models are used with several.
const STEPS: [u32; 4] = [1, 3, 5, 10];
/// Frames from one look to the next.
// Neighbouring frames are nearly equal: they would cost time and tell nothing more.
const EVERY: usize = 15;
/// Share of the values at each end that may be chance, such as a blow that an engine made too much of.
// One value of 10,000 at each end is left out, so that no single frame sets a range.
const CHANCE: f64 = 1e-4;
/// A range is at least as wide as this share of its greater end: training that saw one gravity says little against another one.
// A quantity that never varies, such as gravity, would otherwise warn of any rounding.
const LEAST_SHARE: f32 = 0.2;
/// And as this.
// Around 0 a share of the value is no width.
const LEAST_WIDTH: f32 = 0.02;

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
        // No looks warn of nothing: 0, not 0 / 0.
        self.outside as f64 / self.all.max(1) as f64
    }

    /// Looks at all units as they are now.
    fn look(&mut self, simulator: &Simulator<'_, '_>) {
        for health in simulator.units().filter_map(|unit| simulator.health(unit.id())) {
            self.all += 1;
            self.outside += usize::from(health.outside != 0);
            for (quantity, count) in Quantity::ALL.into_iter().zip(&mut self.by_quantity) {
                // A unit may be outside in several quantities, so these counts may sum to more than
                // `outside`.
                *count += usize::from(health.is_outside(quantity));
            }
            if let Some(excess) = health.farthest {
                self.keep_farthest((excess.quantity, excess.beyond));
            }
        }
    }

    fn keep_farthest(&mut self, other: (Quantity, f32)) {
        if self.farthest.is_none_or(|(_, beyond)| other.1 > beyond) {
            self.farthest = Some(other);
        }
    }

    /// Of a scene that was looked at.
    fn of_scene(self) -> Self {
        Looks { scenes: 1, scenes_outside: usize::from(self.outside > 0), ..self }
    }

    fn merge(mut self, other: Looks) -> Looks {
        self.all += other.all;
        self.outside += other.outside;
        self.scenes += other.scenes;
        self.scenes_outside += other.scenes_outside;
        for (sum, count) in self.by_quantity.iter_mut().zip(other.by_quantity) {
            *sum += count;
        }
        if let Some(farthest) = other.farthest {
            self.keep_farthest(farthest);
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
    over_scenes(scenes, |engine, scene| {
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
/// use rigidformer_evaluation::health;
/// use rigidformer_runtime::models::LoadedModel;
/// use rigidformer_runtime::progress::Progress;
/// # fn scenes() -> Vec<rigidformer_evaluation::scenes::RecordedScene> { Vec::new() }
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
    over_scenes(scenes, |engine, scene| {
        let mut looks = Looks::default();
        let mut seen = |replay: &Replay<'_>| looks.look(replay.world.simulator());
        rollout_seen(engine, model, scene, step, last_frame, progress, &mut seen)?;
        Ok(looks)
    })
}

/// Of all scenes together.
fn over_scenes(
    scenes: &[RecordedScene],
    one: impl Fn(Engine, &RecordedScene) -> Result<Looks, RolloutError> + Sync,
) -> Result<Looks, RolloutError> {
    let looks = on_all_threads(scenes, one)?;
    Ok(looks.into_iter().map(Looks::of_scene).fold(Looks::default(), Looks::merge))
}

/// Values of all quantities of free units, as training saw them.
///
/// ```
/// use nalgebra::{Isometry3, Point3, Vector3};
/// use rigidformer_core::Physics;
/// use rigidformer_evaluation::health::Seen;
/// use rigidformer_evaluation::models::with_ranges;
/// use rigidformer_runtime::models::LoadedModel;
/// use rigidformer_evaluation::scenes::{RecordedScene, RecordedUnit, Split};
/// use rigidformer_weights::{EDGE, Quantity};
///
/// let model = LoadedModel::embedded("edge", EDGE)?;
/// // Training scenes, usually from `Dataset::open(path)?.scene(index, None)?`.
/// let fall = |frame| Isometry3::translation(0.0, 0.0, 3.0 - 5.0 * (frame as f32 / 240.0).powi(2));
/// let corner = |i: i32| [1, 2, 4].map(|bit| if i & bit == 0 { -0.1 } else { 0.1 });
/// let points = (0..8).map(|i| Point3::from(corner(i))).collect();
/// let rubber = Physics { mass_kg: 1.0, friction: 0.4, restitution: 0.3 };
/// let unit = RecordedUnit::new("cube", points, rubber, (0..=100).map(fall).collect());
/// let gravity = Vector3::new(0.0, 0.0, -10.0);
/// let scene = RecordedScene::new("drop", 1, Split::Train, 240.0, gravity, vec![unit])?;
///
/// let mut seen = Seen::default();
/// seen.look(&model, &[scene])?;
/// let ranges = seen.ranges().ok_or("nothing was seen")?;
/// assert!(ranges.beyond(Quantity::Friction, 0.9) > 1.0);
/// let file = with_ranges("edge.rfm".as_ref(), EDGE, &ranges)?;
/// assert_eq!(LoadedModel::copy_of("edge.rfm", &file)?.model().file().ranges(), Some(&ranges));
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
#[derive(Clone, Debug, Default)]
pub struct Seen {
    values: Vec<[f32; Quantity::COUNT]>,
}

impl Seen {
    /// Looks at scenes as the model measures them: at every 15th frame, in steps of 1, 3, 5 and 10 frames in turn.
    ///
    /// # Errors
    /// [`RolloutError`] of the first scene that the model cannot observe; nothing of these scenes counts then.
    pub fn look(
        &mut self,
        model: &LoadedModel,
        scenes: &[RecordedScene],
    ) -> Result<(), RolloutError> {
        // Scenes run side by side already, so each takes one thread.
        let engine = Engine::new()?.single();
        let seen: Vec<_> = scenes.par_iter().map(|scene| values(engine, model, scene)).collect();
        // An error must leave the values as they are, so all scenes are read first.
        let seen = seen.into_iter().collect::<Result<Vec<_>, _>>()?;
        self.values.extend(seen.into_iter().flatten());
        Ok(())
    }

    /// Units that were looked at, each time that they were.
    pub fn len(&self) -> usize {
        self.values.len()
    }

    /// Whether nothing was looked at.
    pub fn is_empty(&self) -> bool {
        self.values.is_empty()
    }

    /// The ranges of all values, but for one of 10,000 at each end; none of nothing.
    pub fn ranges(&self) -> Option<Ranges> {
        let mut ranges = Ranges { of: [[0.0; 2]; Quantity::COUNT] };
        for (quantity, range) in ranges.of.iter_mut().enumerate() {
            let of = self.values.iter().filter_map(|values| values.get(quantity).copied());
            // One value that is not finite would make a range that no value is outside of.
            let mut sorted: Vec<f32> = of.filter(|value| value.is_finite()).collect();
            sorted.sort_by(f32::total_cmp);
            let left_out = (sorted.len() as f64 * CHANCE) as usize;
            let low = *sorted.get(left_out)?;
            let high = *sorted.get(sorted.len() - 1 - left_out)?;
            *range = widened(low, high);
        }
        // Files refuse ranges that are not sound, so none is made here.
        ranges.are_sound().then_some(ranges)
    }
}

/// A range that is wide enough to say something.
fn widened(low: f32, high: f32) -> [f32; 2] {
    let least = (LEAST_SHARE * low.abs().max(high.abs())).max(LEAST_WIDTH);
    // A narrow range is widened at both ends alike, so that its middle stays.
    let missing = (least - (high - low)).max(0.0);
    [low - 0.5 * missing, high + 0.5 * missing]
}

/// Quantities of all free units of a scene, each time.
fn values(
    engine: Engine,
    model: &LoadedModel,
    scene: &RecordedScene,
) -> Result<Vec<[f32; Quantity::COUNT]>, RolloutError> {
    let mut replay = Replay::new(engine, model, scene)?;
    let mut values = Vec::new();
    let frames = (EVERY..scene.frames()).step_by(EVERY);
    for (frame, step) in frames.zip(STEPS.into_iter().cycle()) {
        replay.observe(step, frame as u32)?;
        let simulator = replay.world.simulator();
        // Training learns the motion of free units alone.
        let free = simulator.units().filter(|unit| unit.role() == Role::Free);
        let units = free.map(|unit| unit.id());
        values.extend(units.filter_map(|id| simulator.quantities(id)));
    }
    Ok(values)
}
