//! `rigidformer-analytic rest`

use nalgebra::{Isometry3, Vector3};
use rapier3d::dynamics::MassProperties;
use rigidformer_evaluation::metrics::angle_deg;
use rigidformer_evaluation::rollout::{RolloutError, Trajectory, rollout_on};
use rigidformer_evaluation::scenes::{Dataset, RecordedScene, RecordedUnit, Split};
use rigidformer_runtime::engine::Engine;
use rigidformer_runtime::progress::Progress;
use serde_json::{Value, json};

use crate::arguments::{Inertia, Rest};
use crate::bodies::{Hull, lowest_m, mass_properties, vector};
use crate::long::LOST_BELOW_M;
use crate::output;
use crate::rollouts::{each_scene, load_model, load_scenes};
use crate::simulation::{Settings, simulate, velocities};
use crate::statistics::{largest, percentile, share};

/// Frames at the end of the record over which motion is measured.
const LOOKED_AT: usize = 10;
const RESTING_M_S: f64 = 0.01;
const RESTING_DEG_S: f64 = 2.0;

/// What became of one unit that rested.
#[derive(Clone, Debug, PartialEq)]
struct Outcome {
    /// From the last recorded to the last predicted frame.
    drift_m: f64,
    turn_deg: f64,
    /// Of its origin, most over all predicted frames.
    gained_m: f64,
    lowest_m: f64,
    /// Potential and kinetic energy, last less first.
    energy_j_kg: f64,
}

/// Outcomes of one scene, or of all.
#[derive(Default)]
struct Found {
    /// Scenes with units at rest.
    scenes: usize,
    predicted: Vec<Outcome>,
    /// Units whose rollout ended before its last frame.
    not_finite: usize,
    /// By Rapier: what the others of a scene do to units at rest is in it as well.
    simulated: Vec<Outcome>,
}

impl Found {
    fn merge(&mut self, other: Found) {
        self.scenes += other.scenes;
        self.predicted.extend(other.predicted);
        self.not_finite += other.not_finite;
        self.simulated.extend(other.simulated);
    }
}

pub(crate) fn run(arguments: &Rest) -> anyhow::Result<()> {
    let dataset = Dataset::open(&arguments.dataset)?;
    let scenes = load_scenes(&dataset, &arguments.scenes, None)?;
    let loaded = load_model(&arguments.model)?;
    let engine = Engine::new()?.single();
    let step = arguments.step;

    let frames = arguments.frames;
    // The record's engine has the inertia of boxes, so units come to rest as recorded.
    let settings = Settings { sub_steps: 10, inertia: Inertia::Box, balls: false };
    let by_scene = each_scene(&scenes, |scene| {
        let mut found = Found::default();
        let resting = resting_units(scene)?;
        // A rollout of a scene without resting units tells nothing here.
        if resting.is_empty() {
            return Ok(found);
        }
        found.scenes = 1;
        let end = end_of(scene, step)?;
        let last = step.saturating_add(frames);
        match rollout_on(engine, &loaded, &end, step, last, Progress::none()) {
            Ok(path) => found.predicted = outcomes(&end, &path, &resting)?,
            // The simulator refuses poses that are not finite.
            Err(RolloutError::Step { .. }) => found.not_finite = resting.len(),
            Err(error) => return Err(error.into()),
        }
        found.simulated = outcomes(&end, &simulated(&end, step, last, settings)?, &resting)?;
        Ok(found)
    })?;
    let mut all = Found::default();
    for scene in by_scene {
        all.merge(scene);
    }

    let split = Split::from(arguments.scenes.split);
    let name = loaded.model().file().name();
    if arguments.json {
        return output::json(&json!({
            "dataset": dataset.name(),
            "split": split.to_string(),
            "scenes": scenes.len(),
            "scenes_with_resting_units": all.scenes,
            "model": name,
            "step": step,
            "frames": frames,
            "predicted_not_finite": all.not_finite,
            "predicted": outcomes_json(&all.predicted),
            "rapier": outcomes_json(&all.simulated),
        }));
    }
    output::line(format_args!(
        "{}, split {split}, {} scenes, {} with units at rest; step {step}, {frames} frames from the last recorded one",
        dataset.name(),
        scenes.len(),
        all.scenes
    ))?;
    output::line(
        "drift of position m and orientation degrees, of energy J/kg; up: share of units that gain energy;",
    )?;
    output::line(
        "gained: most height of the origin, m; lost: units below -5 cm; others may push a unit that rests",
    )?;
    let mut rows = vec![output::row([
        "predictor",
        "units",
        "drift p50",
        "p99",
        "turn p50",
        "p99",
        "energy p50",
        "|energy| p50",
        "p99",
        "up",
        "gained p50",
        "p99",
        "max",
        "lowest m",
        "lost",
        "not finite",
    ])];
    for (label, set, not_finite) in
        [(name, &all.predicted, all.not_finite), ("Rapier", &all.simulated, 0)]
    {
        let s = Summary::of(set);
        rows.push(vec![
            label.into(),
            set.len().to_string(),
            output::number(s.drift_m[0], 4),
            output::number(s.drift_m[1], 4),
            output::number(s.turn_deg[0], 2),
            output::number(s.turn_deg[1], 2),
            output::number(s.energy_p50_j_kg, 4),
            output::number(s.energy_abs_j_kg[0], 4),
            output::number(s.energy_abs_j_kg[1], 4),
            output::percent(s.gaining),
            output::number(s.gained_m[0], 4),
            output::number(s.gained_m[1], 4),
            output::number(s.gained_m[2], 4),
            output::number(s.lowest_m, 4),
            s.lost.to_string(),
            not_finite.to_string(),
        ]);
    }
    output::table(&rows)
}

/// Rapier's rollout, with the samples of a model's.
fn simulated(
    end: &RecordedScene,
    step: u32,
    last_frame: u32,
    settings: Settings,
) -> anyhow::Result<Trajectory> {
    let path = simulate(end, step, 1, last_frame, settings)?;
    let mut trajectory = Trajectory::new(0, step, end.poses_at(0).unwrap_or_default());
    let samples = path.iter().filter(|(frame, _)| frame.is_multiple_of(step));
    for (_, poses) in samples {
        trajectory.push(poses.iter().copied());
    }
    Ok(trajectory)
}

/// Units whose net motion at the end of the record is as good as none.
fn resting_units(scene: &RecordedScene) -> anyhow::Result<Vec<usize>> {
    let last = scene.frames() - 1;
    let (Some(first), true) = (last.checked_sub(LOOKED_AT), scene.frame_rate_hz() > 0.0) else {
        anyhow::bail!(
            "{}: {} frames are recorded, {} are looked at; give a longer record",
            scene.name(),
            scene.frames(),
            LOOKED_AT + 1
        );
    };
    let seconds = LOOKED_AT as f64 / f64::from(scene.frame_rate_hz());
    let rests = |unit: &RecordedUnit| {
        let (before, now) = (&unit.poses[first], &unit.poses[last]);
        // Net motion, so that a unit that trembles in place counts as resting.
        let moved = f64::from((now.translation.vector - before.translation.vector).norm());
        // Both must be small: a ball may turn in place, and a cylinder roll without a turn that
        // shows.
        moved / seconds < RESTING_M_S && angle_deg(before, now) / seconds < RESTING_DEG_S
    };
    let units = scene.units().iter().enumerate();
    Ok(units.filter(|(_, unit)| rests(unit)).map(|(index, _)| index).collect())
}

/// The last `step + 1` frames as a scene of their own.
fn end_of(scene: &RecordedScene, step: u32) -> anyhow::Result<RecordedScene> {
    let Some(first) = scene.frames().checked_sub(step as usize + 1) else {
        anyhow::bail!(
            "{}: {} frames are recorded; use a step below that",
            scene.name(),
            scene.frames()
        );
    };
    // Rollouts start from a scene's first frames.
    Ok(scene.clone().skipping(first))
}

/// Of the units that rested at the second sample of `path`.
fn outcomes(
    scene: &RecordedScene,
    path: &Trajectory,
    resting: &[usize],
) -> anyhow::Result<Vec<Outcome>> {
    let samples: Vec<&[Isometry3<f32>]> = path.iter().map(|(_, poses)| poses).collect();
    // Energy needs two samples at each end.
    let ([start, now, ..], [.., before_last, last]) = (&samples[..], &samples[..]) else {
        return Ok(Vec::new());
    };
    let hulls = Hull::of_scene(scene)?;
    let apart_s = f64::from(path.step()) / f64::from(scene.frame_rate_hz());
    let gravity = scene.gravity_m_s2();
    let one = |index: &usize| {
        let (index, unit) = (*index, &scene.units()[*index]);
        // The energy is the body's own, so its hull's inertia counts, whatever the engine takes.
        let properties = mass_properties(unit, &hulls[index], Inertia::Hull);
        let energy = |before: &[Isometry3<f32>], now: &[Isometry3<f32>]| {
            energy_j_kg(&before[index], &now[index], &gravity, apart_s, &properties)
        };
        let rested = now[index].translation.vector;
        let later = || samples.iter().skip(2).map(|poses| &poses[index]);
        Outcome {
            drift_m: f64::from((last[index].translation.vector - rested).norm()),
            turn_deg: angle_deg(&now[index], &last[index]),
            gained_m: later()
                .map(|pose| f64::from(pose.translation.z - rested.z))
                .fold(0.0, f64::max),
            lowest_m: later()
                .map(|pose| lowest_m(&unit.points, pose))
                .fold(f64::INFINITY, f64::min),
            energy_j_kg: energy(before_last, last) - energy(start, now),
        }
    };
    Ok(resting.iter().map(one).collect())
}

/// Half-way between two poses, where the mean velocity is the velocity. The mean of the positions is too low by g h²/8 in
/// free fall: 0.02 J/kg for poses 10 frames apart, nothing at rest.
fn energy_j_kg(
    before: &Isometry3<f32>,
    now: &Isometry3<f32>,
    gravity_m_s2: &Vector3<f32>,
    apart_s: f64,
    properties: &MassProperties,
) -> f64 {
    // Without gravity this is the mean velocity, which is that half-way.
    let (velocity, spin) = velocities(before, now, &Vector3::zeros(), apart_s);
    let middle = (before.translation.vector + now.translation.vector) / 2.0;
    let spin = vector(&(now.rotation.inverse() * spin));
    let turning = spin.dot(properties.reconstruct_inertia_matrix() * spin) / properties.mass();
    f64::from(0.5 * velocity.norm_squared() + 0.5 * turning - gravity_m_s2.dot(&middle))
}

/// Medians and 99th percentiles.
struct Summary {
    drift_m: [Option<f64>; 2],
    turn_deg: [Option<f64>; 2],
    energy_p50_j_kg: Option<f64>,
    energy_abs_j_kg: [Option<f64>; 2],
    /// Share of units with more energy than before.
    gaining: Option<f64>,
    /// With the maximum.
    gained_m: [Option<f64>; 3],
    lowest_m: Option<f64>,
    lost: usize,
}

impl Summary {
    fn of(outcomes: &[Outcome]) -> Self {
        let values = |of: fn(&Outcome) -> f64| outcomes.iter().map(of).collect::<Vec<f64>>();
        let both = |values: &[f64]| [percentile(values, 0.5), percentile(values, 0.99)];
        let (gained, energy) = (values(|o| o.gained_m), values(|o| o.energy_j_kg));
        let gaining = energy.iter().filter(|energy| **energy > 0.0).count();
        Summary {
            drift_m: both(&values(|o| o.drift_m)),
            turn_deg: both(&values(|o| o.turn_deg)),
            energy_p50_j_kg: percentile(&energy, 0.5),
            energy_abs_j_kg: both(&values(|o| o.energy_j_kg.abs())),
            gaining: share(gaining, outcomes.len()),
            gained_m: [percentile(&gained, 0.5), percentile(&gained, 0.99), largest(&gained)],
            // The least value is the greatest of the negated ones.
            lowest_m: largest(&values(|o| -o.lowest_m)).map(|depth| -depth),
            lost: outcomes.iter().filter(|o| o.lowest_m < -LOST_BELOW_M).count(),
        }
    }
}

fn outcomes_json(outcomes: &[Outcome]) -> Value {
    let s = Summary::of(outcomes);
    json!({
        "units": outcomes.len(),
        "drift_p50_m": s.drift_m[0],
        "drift_p99_m": s.drift_m[1],
        "turn_p50_deg": s.turn_deg[0],
        "turn_p99_deg": s.turn_deg[1],
        "energy_p50_j_kg": s.energy_p50_j_kg,
        "energy_abs_p50_j_kg": s.energy_abs_j_kg[0],
        "energy_abs_p99_j_kg": s.energy_abs_j_kg[1],
        "share_gaining_energy": s.gaining,
        "height_gained_p50_m": s.gained_m[0],
        "height_gained_p99_m": s.gained_m[1],
        "height_gained_max_m": s.gained_m[2],
        "lowest_m": s.lowest_m,
        "lost": s.lost,
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::UnitQuaternion;
    use rigidformer_core::Physics;

    use crate::bodies::tests::cube;

    fn scene(paths: &[fn(f32) -> Isometry3<f32>]) -> RecordedScene {
        let unit = |path: &fn(f32) -> Isometry3<f32>| {
            let physics = Physics { mass_kg: 2.0, friction: 0.4, restitution: 0.3 };
            let poses = (0..=20).map(|frame| path(frame as f32 / 240.0)).collect();
            RecordedUnit::new("cube", cube(1.0), physics, poses)
        };
        let gravity = Vector3::new(0.0, 0.0, -10.0);
        let units = paths.iter().map(unit).collect();
        RecordedScene::new("made", 1, Split::Test, 240.0, gravity, units).unwrap()
    }

    #[test]
    fn only_units_that_neither_move_nor_turn_rest() {
        let scene = scene(&[
            |_| Isometry3::translation(0.0, 0.0, 0.5),
            |t| Isometry3::translation(0.02 * t, 0.0, 0.5),
            |t| Isometry3::new(Vector3::new(5.0, 0.0, 0.5), Vector3::new(0.0, 0.0, 0.1 * t)),
        ]);
        assert_eq!(resting_units(&scene).unwrap(), [0]);
        let end = end_of(&scene, 10).unwrap();
        assert_eq!(end.frames(), 11);
        assert_eq!(end.pose(10, 1), scene.pose(20, 1));
        assert!(end_of(&scene, 21).is_err());
    }

    #[test]
    fn energy_is_kept_in_free_fall() {
        let fall = |t: f32| {
            let turn = UnitQuaternion::from_scaled_axis(Vector3::new(0.0, 0.0, 2.0 * t));
            Isometry3::from_parts((Vector3::new(t, 0.0, 9.0 - 5.0 * t * t)).into(), turn)
        };
        let scene = scene(&[fall]);
        let unit = &scene.units()[0];
        let hull = Hull::new(&unit.points).unwrap();
        let properties = mass_properties(unit, &hull, Inertia::Hull);
        let energy = |t: f32| {
            let gap = 10.0 / 240.0;
            let gravity = scene.gravity_m_s2();
            energy_j_kg(&fall(t), &fall(t + gap), &gravity, f64::from(gap), &properties)
        };
        // Of 1 m/s, 2 rad/s about an axis with a sixth of m² and 9 m of height.
        assert!((energy(0.0) - (0.5 + 2.0 / 6.0 + 90.0)).abs() < 0.03, "{}", energy(0.0));
        assert!((energy(0.5) - energy(0.0)).abs() < 0.01);
    }

    #[test]
    fn a_unit_that_rises_has_gained_and_drifted() {
        let still: fn(f32) -> Isometry3<f32> = |_| Isometry3::translation(0.0, 0.0, 0.5);
        let scene = scene(&[still]);
        let mut path = Trajectory::new(0, 10, vec![still(0.0)]);
        path.push([still(0.0)]);
        path.push([Isometry3::translation(0.0, 0.0, 0.4)]);
        path.push([Isometry3::translation(0.3, 0.0, 0.9)]);
        path.push([Isometry3::translation(0.3, 0.0, 0.9)]);
        let found = outcomes(&scene, &path, &[0]).unwrap();
        let [outcome] = &found[..] else { panic!("{found:?}") };
        assert!((outcome.drift_m - 0.5).abs() < 1e-6);
        assert!((outcome.gained_m - 0.4).abs() < 1e-6);
        assert!((outcome.lowest_m + 0.1).abs() < 1e-6);
        assert!((outcome.energy_j_kg - 4.0).abs() < 1e-4);
    }
}
