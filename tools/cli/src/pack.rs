//! `rigidformer pack`

use rigidformer_runtime::models::{self, Policy, Precision, Quantised};
use serde_json::json;

use crate::arguments::Pack;
use crate::output;

pub(crate) fn run(arguments: &Pack) -> anyhow::Result<()> {
    let policy = Policy {
        precision: arguments.dtype.into(),
        wide: arguments.wide.clone(),
        narrow: arguments.narrow.clone(),
    };
    let packed = models::pack(&arguments.input, &arguments.out, &policy)?;
    if arguments.json {
        let mut document = serde_json::to_value(&packed)?;
        if let Some(object) = document.as_object_mut() {
            object.insert("bytes".into(), json!(packed.file.len()));
            object.insert("bytes_per_parameter".into(), json!(packed.bytes_per_parameter()));
        }
        return output::json(&document);
    }
    if policy.precision != Precision::F32 {
        layers(&packed)?;
    }
    output::line(format_args!(
        "{}: {} bytes, {:.2} a parameter",
        arguments.out.display(),
        packed.file.len(),
        packed.bytes_per_parameter()
    ))
}

/// The linear layers; what stays f32 beside them is summed up.
fn layers(packed: &Quantised) -> anyhow::Result<()> {
    let mut table = output::table(["layer", "type", "parameters", "bytes", "SQNR dB", "kept wide"]);
    let (mut others, mut other_bytes) = (0, 0);
    for layer in &packed.layers {
        let Some(sqnr) = layer.sqnr_db else {
            others += layer.parameters;
            other_bytes += layer.bytes;
            continue;
        };
        output::row(
            &mut table,
            [
                layer.name.trim_end_matches(".weight").to_owned(),
                layer.dtype.clone(),
                layer.parameters.to_string(),
                layer.bytes.to_string(),
                format!("{sqnr:.1}"),
                layer.kept_wide.unwrap_or_default().to_owned(),
            ],
        );
    }
    output::line(table)?;
    output::line(format_args!(
        "norms, biases and constants: {others} parameters, {other_bytes} bytes, exact"
    ))
}
