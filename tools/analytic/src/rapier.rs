//! `rigidformer-analytic rapier`

use rigidformer_evaluation::figures::{self, FRAMES, LAST_FRAME};
use rigidformer_evaluation::metrics::{FrameErrors, frame_errors, mean};
use rigidformer_evaluation::scenes::{Dataset, RecordedScene, Split};
use serde_json::{Value, json};

use crate::arguments::Rapier;
use crate::output;
use crate::rollouts::{each_scene, load_scenes};
use crate::simulation::{Settings, simulate};

type Errors = [FrameErrors; FRAMES.len()];

pub(crate) fn run(arguments: &Rapier) -> anyhow::Result<()> {
    let dataset = Dataset::open(&arguments.dataset)?;
    let scenes = load_scenes(&dataset, &arguments.scenes, Some(LAST_FRAME as usize + 1))?;
    let settings = Settings {
        sub_steps: arguments.sub_steps,
        inertia: arguments.inertia,
        balls: arguments.balls,
    };
    let mut by_step = Vec::new();
    for step in &arguments.steps {
        by_step.push((*step, errors(&scenes, *step, settings)?));
    }
    let free_fall = figures::free_falling(&scenes)?.errors;

    let split = Split::from(arguments.scenes.split);
    let step_s = 1.0 / (dataset.frame_rate_hz() * arguments.sub_steps as f32);
    if arguments.json {
        let steps = by_step.iter().map(|(step, errors)| {
            let frames = frames_json(errors);
            json!({ "step": step, "frames": frames })
        });
        return output::json(&json!({
            "dataset": dataset.name(),
            "split": split.to_string(),
            "scenes": scenes.len(),
            "time_step_s": step_s,
            "inertia": format!("{:?}", arguments.inertia).to_lowercase(),
            "rapier": { "steps": steps.collect::<Vec<_>>() },
            "free_fall": { "frames": frames_json(&free_fall) },
        }));
    }
    output::line(format_args!(
        "{}, split {split}, {} scenes; time step {step_s:.2e} s, inertia of the {}",
        dataset.name(),
        scenes.len(),
        format!("{:?}", arguments.inertia).to_lowercase()
    ))?;
    output::line(
        "position error m / orientation error degrees (RMS over units, mean over scenes) at frame",
    )?;
    let mut rows = vec![output::row(["predictor", "step", "50", "75", "100"])];
    let mut add = |name: &str, step: String, errors: &Errors| {
        let cells = errors.map(|e| format!("{:.3} / {:5.2}", e.position_m, e.orientation_rms_deg));
        rows.push([name.to_owned(), step].into_iter().chain(cells).collect());
    };
    for (step, errors) in &by_step {
        add("Rapier", step.to_string(), errors);
    }
    add("free fall", String::new(), &free_fall);
    output::table(&rows)
}

/// Means over scenes at each of [`FRAMES`].
fn errors(scenes: &[RecordedScene], step: u32, settings: Settings) -> anyhow::Result<Errors> {
    let by_scene: Vec<Errors> = each_scene(scenes, |scene| {
        // Sampled every `step` frames, as a model's rollout is, so that interpolation costs both
        // alike.
        let path = simulate(scene, step, step, LAST_FRAME, settings)?;
        let mut errors = Errors::default();
        for (errors, frame) in errors.iter_mut().zip(FRAMES) {
            *errors = frame_errors(&path, scene, frame).ok_or_else(|| {
                anyhow::anyhow!(
                    "{}: frame {frame} is not recorded; give scenes of at least {} frames",
                    scene.name(),
                    LAST_FRAME + 1
                )
            })?;
        }
        Ok(errors)
    })?;
    Ok(std::array::from_fn(|at| {
        mean(&by_scene.iter().map(|errors| errors[at]).collect::<Vec<_>>())
    }))
}

fn frames_json(errors: &Errors) -> Vec<Value> {
    let frame = |(frame, errors): (u32, &FrameErrors)| {
        json!({
            "frame": frame,
            "position_m": errors.position_m,
            "orientation_rms_deg": errors.orientation_rms_deg,
            "orientation_mean_deg": errors.orientation_mean_deg,
        })
    };
    FRAMES.into_iter().zip(errors).map(frame).collect()
}
