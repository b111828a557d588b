//! `rigidformer trace` and `rigidformer diff`

use std::path::PathBuf;

use rigidformer_evaluation::scenes::Split;
use rigidformer_firmware_sim::trace::{self, Comparison, Recording};
use rigidformer_runtime::progress::Progress;

use crate::arguments::{Diff, Trace};
use crate::{defaults, interrupt, output};

pub(crate) fn record(arguments: &Trace) -> anyhow::Result<()> {
    let cancelled = interrupt::watch();
    let inputs = arguments.scene.iter().chain(&arguments.model.path);
    output::apart("--out", &arguments.out, inputs.map(PathBuf::as_path))?;
    let dataset = defaults::dataset(arguments.scene.as_deref())?;
    let first_of_test = || dataset.scenes_of(Split::Test).first().copied().unwrap_or(0);
    let index = arguments.index.unwrap_or_else(first_of_test);
    let frames = (arguments.step as usize).saturating_add(1);
    let scene = dataset.scene(index, Some(frames))?;
    let loaded = defaults::model(&arguments.model)?;

    let bar = output::progress(u64::from(arguments.steps), scene.name());
    let stepped = || bar.inc(1);
    let progress = Progress { cancelled, stepped: &stepped };
    let recording = trace::record(&loaded, &scene, arguments.step, arguments.steps, progress)?;
    bar.finish_and_clear();
    interrupt::check()?;
    recording.write(&arguments.out)?;
    output::line(format_args!(
        "{}: model {}, scene {}, {} steps of {} frames",
        arguments.out.display(),
        recording.model,
        recording.scene,
        arguments.steps,
        recording.step
    ))
}

pub(crate) fn diff(arguments: &Diff) -> anyhow::Result<()> {
    let (a, b) = (Recording::open(&arguments.a)?, Recording::open(&arguments.b)?);
    let comparison = trace::compare(&a, &b)?;
    if arguments.json {
        output::json(&serde_json::to_value(&comparison)?)?;
    } else {
        print(&comparison)?;
        if a.model != b.model {
            output::note(&format!(
                "the traces are of different models: {} and {}",
                a.model, b.model
            ));
        }
    }
    match &comparison.first {
        None => Ok(()),
        Some(first) => {
            let (a, b) = (arguments.a.display(), arguments.b.display());
            anyhow::bail!("{a} and {b} differ; first at {first}")
        }
    }
}

fn print(comparison: &Comparison) -> anyhow::Result<()> {
    let mut table =
        output::table(["layer", "elements", "different", "largest difference", "first in step"]);
    for layer in &comparison.layers {
        output::row(
            &mut table,
            [
                layer.layer.clone(),
                layer.elements.to_string(),
                layer.different.to_string(),
                format!("{:.1e}", layer.largest),
                layer.first_step.map_or(String::new(), |step| step.to_string()),
            ],
        );
    }
    output::table_lines(&table)?;
    if comparison.first.is_none() { output::line("the same bits") } else { Ok(()) }
}
