//! `rigidformer inspect --health`

use rigidformer_evaluation::health::{self, Looks};
use rigidformer_evaluation::scenes::{Dataset, Split};
use rigidformer_runtime::core::weights::Quantity;
use rigidformer_runtime::progress::Progress;
use serde_json::{Map, Value, json};

use crate::arguments::Inspect;
use crate::loading::load_scenes;
use crate::{defaults, interrupt, output};

pub(super) fn run(inspect: &Inspect) -> anyhow::Result<()> {
    let cancelled = interrupt::watch();
    let arguments = &inspect.looks;
    let dataset = Dataset::open(&inspect.file)?;
    let split = Split::from(arguments.split);
    let frames = arguments.last_frame as usize + 1;
    let scenes = load_scenes(&dataset, split, arguments.limit, Some(frames))?;
    let loaded = defaults::model(&arguments.model)?.for_host()?;
    let name = loaded.model().file().name();
    if loaded.model().file().ranges().is_none() {
        anyhow::bail!(
            "{name} does not say what its training saw; `rigidformer pack --ranges` measures that on its scenes"
        );
    }
    let step = arguments.step;
    let predictions = u64::from(arguments.last_frame.div_ceil(step)).saturating_sub(1);
    let bar = output::progress(predictions * scenes.len() as u64, dataset.name());
    let stepped = || bar.inc(1);
    let recorded = health::recorded(&loaded, &scenes, step)?;
    let progress = Progress { cancelled, stepped: &stepped };
    let predicted = health::predicted(&loaded, &scenes, step, arguments.last_frame, progress)?;
    bar.finish_and_clear();
    interrupt::check()?;
    if inspect.json {
        return output::json(&json!({
            "dataset": dataset.name(),
            "model": name,
            "step": step,
            "recorded": looks_json(&recorded),
            "predicted": looks_json(&predicted),
        }));
    }
    output::line(format_args!(
        "{}, split {split}, {} scenes, step {step}: units outside of what the training of {name} saw",
        dataset.name(),
        scenes.len()
    ))?;
    let mut table =
        output::table(["units", "looks", "outside", "scenes with any", "farthest", "by quantity"]);
    for (what, looks) in [("recorded", &recorded), ("predicted", &predicted)] {
        let farthest = looks.farthest.map_or(String::new(), |(quantity, beyond)| {
            format!("{}, {beyond:+.2} of its range", quantity.name())
        });
        let counts = Quantity::ALL.iter().zip(looks.by_quantity).filter(|(_, count)| *count > 0);
        let counts: Vec<_> =
            counts.map(|(quantity, count)| format!("{} {count}", quantity.name())).collect();
        output::row(
            &mut table,
            [
                what.to_owned(),
                looks.all.to_string(),
                format!("{} ({:.2} %)", looks.outside, 100.0 * looks.share()),
                format!("{} of {}", looks.scenes_outside, looks.scenes),
                farthest,
                counts.join(", "),
            ],
        );
    }
    output::table_lines(&table)
}

fn looks_json(looks: &Looks) -> Value {
    let counts = Quantity::ALL.iter().zip(looks.by_quantity);
    let counts = counts.map(|(quantity, count)| (quantity.name().to_owned(), json!(count)));
    json!({
        "looks": looks.all,
        "outside": looks.outside,
        "share": looks.share(),
        "scenes": looks.scenes,
        "scenes_outside": looks.scenes_outside,
        "farthest": looks.farthest.map(|(quantity, beyond)| json!({ "quantity": quantity.name(), "beyond": beyond })),
        "by_quantity": counts.collect::<Map<_, _>>(),
    })
}
