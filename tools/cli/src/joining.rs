//! How far parts of bodies come apart.

use rigidformer_runtime::metrics::Apart;
use serde_json::{Value, json};

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
