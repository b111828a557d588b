//! `rigidformer pack`

use rigidformer_runtime::core::weights::AlignedBuffer;
use rigidformer_runtime::files;
use rigidformer_runtime::models::{self, Policy, Precision, Quantised};
use serde_json::json;

use crate::arguments::{Pack, PresetName};
use crate::output;

pub(crate) fn run(arguments: &Pack) -> anyhow::Result<()> {
    let input = match (&arguments.input, arguments.random) {
        (_, Some(preset)) => return random(arguments, preset),
        (Some(input), None) => input,
        (None, None) => return Ok(()), // clap asks for one of the two
    };
    let policy = Policy {
        precision: arguments.dtype.into(),
        wide: arguments.wide.clone(),
        narrow: arguments.narrow.clone(),
    };
    let mut packed = models::pack(input, &arguments.out, &policy)?;
    if arguments.panels {
        packed.file = models::to_panels(&arguments.out, &AlignedBuffer::copy_of(&packed.file))?;
        files::write_whole(&arguments.out, &packed.file)?;
    }
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

fn random(arguments: &Pack, preset: PresetName) -> anyhow::Result<()> {
    let (name, config) = match preset {
        PresetName::Paper => ("paper", &models::random::PAPER),
        PresetName::Edge => ("edge", &models::random::EDGE),
    };
    let file = models::random::random(name, config, arguments.dtype.into(), arguments.seed)?;
    files::write_whole(&arguments.out, &file)?;
    output::line(format_args!(
        "{}: {} bytes, random weights of preset {name}",
        arguments.out.display(),
        file.len()
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
