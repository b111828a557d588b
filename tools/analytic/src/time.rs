//! `rigidformer-analytic time`

use std::time::{Duration, Instant};

use rigidformer_evaluation::figures::LAST_FRAME;
use rigidformer_evaluation::models::random;
use rigidformer_evaluation::rollout::{Replay, rollout_seen};
use rigidformer_evaluation::scenes::{Dataset, RecordedScene, Split};
use rigidformer_runtime::engine::Engine;
use rigidformer_runtime::models::LoadedModel;
use rigidformer_runtime::progress::Progress;
use serde_json::json;

use crate::arguments::{Inertia, Time};
use crate::output;
use crate::rollouts::load_scenes;
use crate::simulation::{Settings, simulate_timed};

pub(crate) fn run(arguments: &Time) -> anyhow::Result<()> {
    let dataset = Dataset::open(&arguments.dataset)?;
    let scenes = load_scenes(&dataset, &arguments.scenes, Some(LAST_FRAME as usize + 1))?;
    let edge = LoadedModel::embedded("<default model>", rigidformer_weights::EDGE)?;
    let alone = random::without_network(edge.model().config())?;
    let packed =
        alone.ok_or_else(|| anyhow::anyhow!("the default model moves no units by impulses"))?;
    let alone = LoadedModel::copy_of("<impulses alone>", &packed)?;
    let mut engine = Engine::new()?;
    if !arguments.threads {
        engine = engine.single();
    }
    let settings =
        Settings { sub_steps: arguments.sub_steps, inertia: Inertia::Hull, balls: false };
    let (step, mut times) = (arguments.step, [Vec::new(), Vec::new()]);
    for scene in &scenes {
        let mut turns = [Vec::new(), Vec::new()];
        for _ in 0..arguments.turns {
            let [ours, theirs] = &mut turns;
            ours.push(impulses(engine, &alone, scene, step)?);
            theirs.push(simulate_timed(scene, step, step, LAST_FRAME, settings)?.1);
        }
        for (times, turns) in times.iter_mut().zip(turns) {
            times.push(median(turns));
        }
    }
    let steps = f64::from((LAST_FRAME - step).div_ceil(step));
    let [ours, theirs] = times
        .map(|of| of.iter().map(|t| t.as_secs_f64() * 1e3 / steps).sum::<f64>() / of.len() as f64);
    let (split, frame_s) = (Split::from(arguments.scenes.split), 1.0 / dataset.frame_rate_hz());
    let engine_step_s = frame_s / arguments.sub_steps as f32;
    if arguments.json {
        return output::json(&json!({
            "dataset": dataset.name(),
            "split": split.to_string(),
            "scenes": scenes.len(),
            "step": step,
            "rapier_time_step_s": engine_step_s,
            "impulses_ms": ours,
            "rapier_ms": theirs,
            "ratio": ours / theirs,
        }));
    }
    output::line(format_args!(
        "{}, split {split}, {} scenes; {:.1} ms a step, mean over scenes of the median of {} turns",
        dataset.name(),
        scenes.len(),
        step as f32 * frame_s * 1e3,
        arguments.turns
    ))?;
    output::table(&[
        output::row(["", "ms", "ratio"]),
        output::row(["impulses alone", &format!("{ours:.2}"), &format!("{:.2}", ours / theirs)]),
        output::row([&format!("Rapier, {engine_step_s:.2e} s"), &format!("{theirs:.2}"), "1.00"]),
    ])
}

/// How long impulses alone take for a scene, without its building.
fn impulses(
    engine: Engine,
    alone: &LoadedModel,
    scene: &RecordedScene,
    step: u32,
) -> anyhow::Result<Duration> {
    let mut seen: Option<(Instant, Instant)> = None;
    let mut see = |_: &Replay<'_>| {
        let now = Instant::now();
        seen = Some((seen.map_or(now, |(begun, _)| begun), now));
    };
    rollout_seen(engine, alone, scene, step, LAST_FRAME, Progress::none(), &mut see)?;
    let (begun, ended) =
        seen.ok_or_else(|| anyhow::anyhow!("{}: no step was made", scene.name()))?;
    Ok(ended - begun)
}

fn median(mut times: Vec<Duration>) -> Duration {
    times.sort_unstable();
    times.get(times.len() / 2).copied().unwrap_or_default()
}
