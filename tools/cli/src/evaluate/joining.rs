//! How far parts of bodies come apart.

use rigidformer_evaluation::metrics::Apart;

/// How far parts come apart, in a table: millimetres.
pub(super) fn cell(apart: Option<Apart>) -> String {
    let millimetres = |metres: f64| format!("{:.1}", metres * 1e3);
    apart.map_or(String::new(), |apart| {
        format!("{} / {}", millimetres(apart.median_m), millimetres(apart.most_m))
    })
}
