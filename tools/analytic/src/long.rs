//! `rigidformer-analytic long`

use rigidformer_evaluation::rollout::{RolloutError, Trajectory, rollout_on};
use rigidformer_evaluation::scenes::{Dataset, RecordedScene, Split};
use rigidformer_runtime::engine::Engine;
use rigidformer_runtime::progress::Progress;
use serde_json::json;

use crate::arguments::Long;
use crate::bodies::lowest_m;
use crate::output;
use crate::rollouts::{each_scene, load_model, load_scenes};
use crate::statistics::share;

/// Below the ground, a unit is lost.
pub(crate) const LOST_BELOW_M: f64 = 0.05;

/// Below the ground at the end, a unit is low.
// The projection keeps units above the ground, so a millimetre below means that it fails.
const LOW_BELOW_M: f64 = 0.001;

/// What became of a scene, or of several.
#[derive(Clone, Debug, PartialEq)]
struct Outcome {
    finite: usize,
    units: usize,
    lost: usize,
    low: usize,
    lowest_m: f64,
    /// Of an origin from the middle of the scene file's world.
    farthest_m: f64,
}

impl Outcome {
    const NONE: Outcome =
        Outcome { finite: 0, units: 0, lost: 0, low: 0, lowest_m: f64::INFINITY, farthest_m: 0.0 };

    fn merge(self, other: &Outcome) -> Outcome {
        Outcome {
            finite: self.finite + other.finite,
            units: self.units + other.units,
            lost: self.lost + other.lost,
            low: self.low + other.low,
            lowest_m: self.lowest_m.min(other.lowest_m),
            farthest_m: self.farthest_m.max(other.farthest_m),
        }
    }
}

pub(crate) fn run(arguments: &Long) -> anyhow::Result<()> {
    let dataset = Dataset::open(&arguments.dataset)?;
    // Rollouts start from two observed frames and need no more of the record.
    let observed = arguments.steps.iter().max().map_or(1, |step| *step as usize + 1);
    let scenes = load_scenes(&dataset, &arguments.scenes, Some(observed))?;
    let loaded = load_model(&arguments.model)?;
    // Scenes run side by side, so each takes one thread.
    let engine = Engine::new()?.single();

    let mut by_step = Vec::new();
    for step in &arguments.steps {
        let last = step.saturating_add(arguments.frames);
        let by_scene = each_scene(&scenes, |scene| {
            match rollout_on(engine, &loaded, scene, *step, last, Progress::none()) {
                Ok(path) => Ok(outcome(scene, &path)),
                // The simulator refuses poses that are not finite.
                Err(RolloutError::Step { .. }) => {
                    // Its units count, or a model that diverges would have better shares.
                    Ok(Outcome { units: scene.units().len(), ..Outcome::NONE })
                }
                Err(error) => Err(error.into()),
            }
        })?;
        by_step.push((*step, by_scene.iter().fold(Outcome::NONE, Outcome::merge)));
    }

    let split = Split::from(arguments.scenes.split);
    let name = loaded.model().file().name();
    if arguments.json {
        let steps = by_step.iter().map(|(step, all)| {
            json!({
                "step": step,
                "share_finite": share(all.finite, scenes.len()),
                "units": all.units,
                "lowest_m": all.lowest_m,
                "farthest_m": all.farthest_m,
                "share_lost": share(all.lost, all.units),
                "low_at_the_end": all.low,
            })
        });
        return output::json(&json!({
            "dataset": dataset.name(),
            "split": split.to_string(),
            "scenes": scenes.len(),
            "model": name,
            "frames": arguments.frames,
            "steps": steps.collect::<Vec<_>>(),
        }));
    }
    output::line(format_args!(
        "{}, split {split}, {} scenes; {name}, {} frames; lost: units below -5 cm at any frame; low: below -1 mm at the last",
        dataset.name(),
        scenes.len(),
        arguments.frames
    ))?;
    let header =
        ["step", "finite scenes", "units", "lowest m", "farthest m", "lost units", "low units"];
    let mut rows = vec![output::row(header)];
    for (step, all) in &by_step {
        rows.push(vec![
            step.to_string(),
            output::percent(share(all.finite, scenes.len())),
            all.units.to_string(),
            output::number(Some(all.lowest_m), 4),
            output::number(Some(all.farthest_m), 2),
            output::percent(share(all.lost, all.units)),
            all.low.to_string(),
        ]);
    }
    output::table(&rows)
}

/// Of the predicted samples, which are all but the first two.
fn outcome(scene: &RecordedScene, path: &Trajectory) -> Outcome {
    let mut all = Outcome { finite: 1, units: scene.units().len(), ..Outcome::NONE };
    for (index, unit) in scene.units().iter().enumerate() {
        let (mut lowest, mut last) = (f64::INFINITY, f64::INFINITY);
        // The first two samples are observed.
        for pose in path.iter().skip(2).filter_map(|(_, poses)| poses.get(index)) {
            last = lowest_m(&unit.points, pose);
            lowest = lowest.min(last);
            let far = f64::from(pose.translation.vector.norm());
            all.farthest_m = all.farthest_m.max(far);
            // A pose that is not finite has no height, and comparisons with NaN would call it
            // sound.
            if !far.is_finite() || !pose.rotation.coords.iter().all(|q| q.is_finite()) {
                all.finite = 0;
            }
        }
        all.lost += usize::from(lowest < -LOST_BELOW_M);
        all.low += usize::from(last < -LOW_BELOW_M);
        all.lowest_m = all.lowest_m.min(lowest);
    }
    all
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::{Isometry3, Vector3};
    use rigidformer_core::Physics;
    use rigidformer_evaluation::scenes::RecordedUnit;

    use crate::bodies::tests::cube;

    #[test]
    fn a_unit_below_the_ground_is_lost_for_good() {
        let at = |z: f32| Isometry3::translation(0.0, 0.0, z);
        let physics = Physics { mass_kg: 1.0, friction: 0.4, restitution: 0.3 };
        let unit = RecordedUnit::new("cube", cube(1.0), physics, vec![at(0.5)]);
        let gravity = Vector3::new(0.0, 0.0, -10.0);
        let units = vec![unit.clone(), unit];
        let scene = RecordedScene::new("made", 1, Split::Test, 240.0, gravity, units).unwrap();
        let mut path = Trajectory::new(0, 1, vec![at(0.5), at(0.5)]);
        for (a, b) in [(0.5, 0.5), (0.5, 0.3), (0.4985, 0.4995)] {
            path.push([at(a), at(b)]);
        }
        let found = outcome(&scene, &path);
        assert_eq!((found.finite, found.units, found.lost, found.low), (1, 2, 1, 1));
        assert!((found.lowest_m + 0.2).abs() < 1e-6);
    }
}
