//! Pivots at which the parts of bodies are held together.

use rigidformer_runtime::metrics::Apart;
use rigidformer_runtime::pivots;
use rigidformer_runtime::scenes::RecordedScene;
use serde_json::{Value, json};

/// The scene, held together at pivots that its frames to a last one show.
pub(crate) fn joined(scene: RecordedScene, last: usize) -> anyhow::Result<RecordedScene> {
    if !pivots::has_parts(&scene) {
        return Ok(scene);
    }
    let name = scene.name();
    let found = pivots::of_scene(&scene, 0..(last + 1).min(scene.frames()));
    let found = found.map_err(|error| anyhow::anyhow!("{name}: {error}"))?;
    Ok(scene.with_pivots(found)?)
}

/// As [`joined`], of several.
pub(crate) fn all_joined(
    scenes: &[RecordedScene],
    last: usize,
) -> anyhow::Result<Vec<RecordedScene>> {
    scenes.iter().map(|scene| joined(scene.clone(), last)).collect()
}

/// How far parts come apart, in a table: millimetres.
pub(crate) fn cell(apart: Option<Apart>) -> String {
    let millimetres = |metres: f64| format!("{:.1}", metres * 1e3);
    apart.map_or(String::new(), |apart| {
        format!("{} / {}", millimetres(apart.median_m), millimetres(apart.most_m))
    })
}

pub(crate) fn apart_json(apart: Option<Apart>) -> Value {
    apart.map_or(Value::Null, |Apart { median_m, most_m, max_m }| {
        json!({ "median_m": median_m, "percentile_99_m": most_m, "max_m": max_m })
    })
}
