//! `rigidformer-analytic overlap`

use nalgebra::Isometry3;
use rigidformer_evaluation::rollout::rollout_on;
use rigidformer_evaluation::scenes::{Dataset, RecordedScene, Split};
use rigidformer_runtime::engine::Engine;
use rigidformer_runtime::progress::Progress;
use serde_json::{Value, json};

use crate::arguments::Overlap;
use crate::bodies::{Hull, lowest_m};
use crate::output;
use crate::rollouts::{each_scene, load_model, load_scenes};
use crate::statistics::{largest, percentile, share};

/// Depth from which a unit counts as overlapping, metres.
const COUNTED_M: f64 = 1e-3;

/// Depths at frames of the record and of a rollout, which are looked at together.
#[derive(Clone, Debug, Default, PartialEq)]
struct Depths {
    /// Units at frames.
    unit_frames: usize,
    recorded: Side,
    predicted: Side,
}

#[derive(Clone, Debug, Default, PartialEq)]
struct Side {
    /// Units at frames that are deeper than counted in another unit.
    overlapping: usize,
    /// (pairs at frames that overlap on either side) metres
    pairs: Vec<f64>,
    /// Units at frames that are deeper than counted in the ground.
    sunk: usize,
    /// (units at frames that are below ground on either side) metres
    ground: Vec<f64>,
}

pub(crate) fn run(arguments: &Overlap) -> anyhow::Result<()> {
    let dataset = Dataset::open(&arguments.dataset)?;
    let Overlap { step, frame, .. } = *arguments;
    anyhow::ensure!(
        frame >= 2 * step,
        "--frame: the first predicted frame at step {step} is {}; give at least that",
        2 * step
    );
    let scenes = load_scenes(&dataset, &arguments.scenes, Some(frame as usize + 1))?;
    let loaded = load_model(&arguments.model)?;
    // Scenes run side by side, so each takes one thread.
    let engine = Engine::new()?.single();

    let by_scene = each_scene(&scenes, |scene| {
        let hulls = Hull::of_scene(scene)?;
        let predicted = rollout_on(engine, &loaded, scene, step, frame, Progress::none())?;
        let mut depths = Depths::default();
        // Frames up to `step` are observed, and frames beyond `frame` are not compared.
        for (at, poses) in predicted.iter().filter(|(at, _)| (2 * step..=frame).contains(at)) {
            let Some(recorded) = scene.poses_at(at as usize) else { continue };
            depths.add(scene, &hulls, &recorded, poses);
        }
        Ok(depths)
    })?;
    let mut depths = Depths::default();
    for scene in by_scene {
        depths.merge(scene);
    }

    let name = loaded.model().file().name();
    let split = Split::from(arguments.scenes.split);
    if arguments.json {
        return output::json(&json!({
            "dataset": dataset.name(),
            "split": split.to_string(),
            "scenes": scenes.len(),
            "model": name,
            "step": step,
            "last_frame": frame,
            "unit_frames": depths.unit_frames,
            "counted_m": COUNTED_M,
            "recorded": side_json(&depths.recorded, depths.unit_frames),
            "predicted": side_json(&depths.predicted, depths.unit_frames),
        }));
    }
    output::line(format_args!(
        "{}, split {split}, {} scenes, step {step}, predicted frames until {frame}: {} units at frames",
        dataset.name(),
        scenes.len(),
        depths.unit_frames
    ))?;
    output::line(format_args!(
        "share of those deeper than 1 mm; depth in mm over the {} pairs of units, and the {} units in the ground,",
        depths.recorded.pairs.len(),
        depths.recorded.ground.len()
    ))?;
    output::line(
        "that overlap in the record or in the rollout; hulls of hollow shapes overlap more than the shapes",
    )?;
    let units = ["units", "p50", "p99", "max"];
    let ground = ["ground", "p50", "p99", "max"];
    let mut rows = vec![output::row([""].into_iter().chain(units).chain(ground))];
    for (label, side) in [("recorded", &depths.recorded), (name, &depths.predicted)] {
        let mut row = vec![label.to_owned()];
        for (count, values) in [(side.overlapping, &side.pairs), (side.sunk, &side.ground)] {
            row.push(output::percent(share(count, depths.unit_frames)));
            let [p50, p99, max] = summary(values);
            row.extend([p50, p99, max].map(|m| output::number(m.map(|m| 1e3 * m), 2)));
        }
        rows.push(row);
    }
    output::table(&rows)
}

impl Depths {
    /// Adds the units of a scene at one frame.
    fn add(
        &mut self,
        scene: &RecordedScene,
        hulls: &[Hull],
        recorded: &[Isometry3<f32>],
        predicted: &[Isometry3<f32>],
    ) {
        let units = scene.units();
        self.unit_frames += units.len();
        let mut deepest = vec![[0.0_f64; 2]; units.len()];
        let sides = [recorded, predicted];
        for (a, hull) in hulls.iter().enumerate() {
            for (b, other) in hulls.iter().enumerate().skip(a + 1) {
                let depths = sides.map(|poses| hull.depth_m(&poses[a], other, &poses[b]));
                for unit in [a, b] {
                    for (deepest, depth) in deepest[unit].iter_mut().zip(depths) {
                        *deepest = deepest.max(depth);
                    }
                }
                // A pair counts on both sides, so that their percentiles are over the same pairs.
                if depths.iter().any(|depth| *depth > 0.0) {
                    self.recorded.pairs.push(depths[0]);
                    self.predicted.pairs.push(depths[1]);
                }
            }
        }
        for (index, (unit, deepest)) in units.iter().zip(deepest).enumerate() {
            let sunk = sides.map(|poses| (-lowest_m(&unit.points, &poses[index])).max(0.0));
            for (at, side) in [&mut self.recorded, &mut self.predicted].into_iter().enumerate() {
                side.overlapping += usize::from(deepest[at] > COUNTED_M);
                side.sunk += usize::from(sunk[at] > COUNTED_M);
                if sunk.iter().any(|depth| *depth > 0.0) {
                    side.ground.push(sunk[at]);
                }
            }
        }
    }

    fn merge(&mut self, other: Depths) {
        self.unit_frames += other.unit_frames;
        let sides = [(&mut self.recorded, other.recorded), (&mut self.predicted, other.predicted)];
        for (side, other) in sides {
            side.overlapping += other.overlapping;
            side.sunk += other.sunk;
            side.pairs.extend(other.pairs);
            side.ground.extend(other.ground);
        }
    }
}

/// Median, 99th percentile and maximum.
fn summary(values: &[f64]) -> [Option<f64>; 3] {
    [percentile(values, 0.5), percentile(values, 0.99), largest(values)]
}

fn side_json(side: &Side, unit_frames: usize) -> Value {
    let of = |count: usize, values: &[f64]| {
        let [p50, p99, max] = summary(values);
        json!({
            "share": share(count, unit_frames),
            "depths": values.len(),
            "p50_m": p50,
            "p99_m": p99,
            "max_m": max,
        })
    };
    json!({ "units": of(side.overlapping, &side.pairs), "ground": of(side.sunk, &side.ground) })
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::Vector3;
    use rigidformer_core::Physics;
    use rigidformer_evaluation::scenes::RecordedUnit;

    use crate::bodies::tests::cube;

    #[test]
    fn overlaps_of_either_side_are_kept_on_both() {
        let unit = |x: f32, z: f32| {
            let physics = Physics { mass_kg: 1.0, friction: 0.4, restitution: 0.3 };
            let poses = vec![Isometry3::translation(x, 0.0, z)];
            RecordedUnit::new("cube", cube(1.0), physics, poses)
        };
        let gravity = Vector3::new(0.0, 0.0, -10.0);
        let units = vec![unit(0.0, 0.5), unit(2.0, 0.5), unit(6.0, 0.4)];
        let scene = RecordedScene::new("made", 1, Split::Test, 240.0, gravity, units).unwrap();
        let hulls = Hull::of_scene(&scene).unwrap();
        let recorded = scene.poses_at(0).unwrap();
        let mut predicted = recorded.clone();
        predicted[1].translation.x = 0.9;
        let mut depths = Depths::default();
        depths.add(&scene, &hulls, &recorded, &predicted);
        assert_eq!(depths.unit_frames, 3);
        assert_eq!((depths.recorded.overlapping, depths.predicted.overlapping), (0, 2));
        assert_eq!(depths.recorded.pairs, [0.0]);
        assert!((depths.predicted.pairs[0] - 0.1).abs() < 1e-4);
        assert_eq!((depths.recorded.sunk, depths.predicted.sunk), (1, 1));
        assert!((depths.recorded.ground[0] - 0.1).abs() < 1e-6);
    }
}
