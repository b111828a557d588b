//! `rigidformer pack`

mod header;

use std::path::{Path, PathBuf};

use rigidformer_evaluation::health::Seen;
use rigidformer_evaluation::models::{self, Policy, Precision, Quantised};
use rigidformer_evaluation::scenes::{Dataset, Split};
use rigidformer_runtime::core::weights::{AlignedBuffer, MAGIC, Quantity, Ranges, Scope};
use rigidformer_runtime::files;
use rigidformer_runtime::memory::Budget;
use rigidformer_runtime::models::{LoadedModel, to_panels};
use serde_json::{Map, Value as Json, json};
#[cfg(feature = "provenance")]
use toml::{Table, Value};

use crate::arguments::{Pack, PresetName, ScopeName};
use crate::inspect::WITHOUT;
use crate::{interrupt, output};

pub(crate) fn run(arguments: &Pack) -> anyhow::Result<()> {
    interrupt::watch();
    // IN may be OUT: a model that is packed in its place.
    let inputs = arguments.provenance.iter().chain(&arguments.ranges).chain(&arguments.metrics);
    output::apart("--out", &arguments.out, inputs.map(PathBuf::as_path))?;
    let input = match (&arguments.input, arguments.random) {
        (_, Some(preset)) => return random(arguments, preset),
        (Some(input), None) => input,
        (None, None) => return Ok(()), // clap asks for one of the two
    };
    if arguments.header {
        return header::run(arguments, input);
    }
    if let Some(entries) = &arguments.provenance {
        return provenance(arguments, input, entries);
    }
    if let Some(name) = arguments.scope {
        return scope(arguments, input, name);
    }
    if !arguments.ranges.is_empty() {
        return ranges(arguments, input);
    }
    if !arguments.metrics.is_empty() {
        return metrics(arguments, input);
    }
    let policy = Policy {
        precision: arguments.dtype.into(),
        wide: arguments.wide.clone(),
        narrow: arguments.narrow.clone(),
    };
    let mut packed = models::packed(input, &policy)?;
    if arguments.panels {
        packed.file = to_panels(input, &AlignedBuffer::copy_of(&packed.file))?;
    }
    output::write_whole(&arguments.out, &packed.file)?;
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

/// A packed model as it is.
fn read_packed(input: &Path, option: &str) -> anyhow::Result<Vec<u8>> {
    let packed = files::read_whole(input)?;
    if !packed.starts_with(&MAGIC) {
        anyhow::bail!("{}: is no packed model; pack it first, without {option}", input.display());
    }
    Ok(packed)
}

/// The headlines of an evaluation, as models call them.
fn headlines(path: &Path, name: &str) -> anyhow::Result<Vec<(String, f32)>> {
    let amiss = || {
        anyhow::anyhow!(
            "{}: is no output of `rigidformer evaluate --json` of a model; make one without --no-network",
            path.display()
        )
    };
    let document: Json = serde_json::from_slice(&files::read_whole(path)?).map_err(|_| amiss())?;
    let measured = document["model"]["name"].as_str().ok_or_else(amiss)?;
    if measured != name {
        let path = path.display();
        anyhow::bail!(
            "{path}: has the figures of {measured}, and the model is {name}; evaluate that one"
        );
    }
    if let Some([Json::String(option), ..]) = document["changed_by"].as_array().map(Vec::as_slice) {
        anyhow::bail!("{}: was made with {option}; evaluate the model without it", path.display());
    }
    let (dataset, split) = (document["dataset"].as_str(), document["split"].as_str());
    let (Some(dataset), Some(split)) = (dataset, split) else { return Err(amiss()) };
    let mut found = Vec::new();
    for gain in document["gains"].as_array().ok_or_else(amiss)? {
        let (step, figure) = (gain["step"].as_u64(), gain["figure"].as_str());
        let (Some(step), Some(figure)) = (step, figure) else { return Err(amiss()) };
        let name = format!("{dataset}.{split}.step{step}.{figure}");
        for (key, end) in [("with_network", ""), ("without_network", WITHOUT)] {
            let value = gain[key].as_f64().ok_or_else(amiss)?;
            found.push((format!("{name}{end}"), value as f32));
        }
    }
    Ok(found)
}

fn metrics(arguments: &Pack, input: &Path) -> anyhow::Result<()> {
    let packed = read_packed(input, "--metrics")?;
    let loaded = LoadedModel::copy_of(input, &packed)?;
    let mut all = Vec::new();
    for path in &arguments.metrics {
        all.extend(headlines(path, loaded.model().file().name())?);
    }
    let file = models::with_metrics(input, &packed, &all)?;
    output::write_whole(&arguments.out, &file)?;
    if arguments.json {
        return output::json(&json!({ "bytes": file.len(), "metrics": all.len() }));
    }
    let (out, count) = (arguments.out.display(), all.len());
    output::line(format_args!("{out}: {} bytes, {count} figures", file.len()))
}

fn scope(arguments: &Pack, input: &Path, name: ScopeName) -> anyhow::Result<()> {
    let (scope, said) = match name {
        ScopeName::All => (Scope::All, "all units of a scene"),
        ScopeName::Near => (Scope::Near, "units that it corrects and what may touch them"),
    };
    let file = models::with_scope(input, &read_packed(input, "--scope")?, scope)?;
    output::write_whole(&arguments.out, &file)?;
    let loaded = LoadedModel::copy_of(&arguments.out, &file)?;
    let payload = loaded.model().file().payload_crc();
    if arguments.json {
        return output::json(&json!({
            "bytes": file.len(),
            "payload_crc": format!("{payload:08x}"),
            "scope": if scope.is_near() { "near" } else { "all" },
        }));
    }
    output::line(format_args!(
        "{}: {} bytes, its network sees {said}, weights CRC-32 {payload:08x} as before",
        arguments.out.display(),
        file.len(),
    ))
}

/// What training saw: as a packed model says, or as scenes are.
fn measured(arguments: &Pack, loaded: &LoadedModel) -> anyhow::Result<(Ranges, String)> {
    let mut seen = Seen::default();
    let bar = output::progress(arguments.ranges.len() as u64, "files");
    for path in &arguments.ranges {
        if files::read_whole(path)?.starts_with(&MAGIC) {
            let shown = path.display();
            if arguments.ranges.len() > 1 {
                anyhow::bail!(
                    "--ranges: {shown} is a model, whose ranges are taken over; give it alone, or scene files alone"
                );
            }
            let other = LoadedModel::open(path)?;
            let Some(ranges) = other.model().file().ranges() else {
                anyhow::bail!("{shown}: does not say what its training saw; give scene files");
            };
            return Ok((*ranges, format!("ranges of {shown}")));
        }
        let dataset = Dataset::open(path)?;
        let mut budget = Budget::default();
        let mut scenes = Vec::new();
        for split in [Split::Train, Split::Extra] {
            for index in dataset.scenes_of(split) {
                interrupt::check()?;
                scenes.push(dataset.scene_within(index, None, &mut budget)?);
            }
        }
        if scenes.is_empty() {
            let shown = path.display();
            anyhow::bail!(
                "{shown}: scene_split: no scene is in the splits train and extra; give scenes that the model learnt from"
            );
        }
        seen.look(loaded, &scenes)?;
        bar.inc(1);
    }
    bar.finish_and_clear();
    let ranges = seen.ranges().ok_or_else(|| {
        anyhow::anyhow!("--ranges: the scenes have no free units at frame 15; give longer ones")
    })?;
    Ok((ranges, format!("ranges of {} looks at a unit", seen.len())))
}

fn ranges(arguments: &Pack, input: &Path) -> anyhow::Result<()> {
    let packed = read_packed(input, "--ranges")?;
    let loaded = LoadedModel::copy_of(input, &packed)?;
    let (ranges, said) = measured(arguments, &loaded)?;
    let file = models::with_ranges(input, &packed, &ranges)?;
    output::write_whole(&arguments.out, &file)?;
    let loaded = LoadedModel::copy_of(&arguments.out, &file)?;
    let payload = loaded.model().file().payload_crc();
    if arguments.json {
        // As f64: with `arbitrary_precision`, which another crate of a build may turn on, an f32 is written otherwise.
        let of = Quantity::ALL.iter().zip(ranges.of);
        return output::json(&json!({
            "bytes": file.len(),
            "payload_crc": format!("{payload:08x}"),
            "from": said,
            "ranges": of.map(|(quantity, range)| (quantity.name().to_owned(), json!(range.map(f64::from)))).collect::<Map<_, _>>(),
        }));
    }
    let mut table = output::table(["quantity", "lowest", "highest"]);
    for (quantity, [low, high]) in Quantity::ALL.iter().zip(ranges.of) {
        output::row(
            &mut table,
            [quantity.name().to_owned(), format!("{low:.4}"), format!("{high:.4}")],
        );
    }
    output::table_lines(&table)?;
    output::line(format_args!(
        "{}: {} bytes, {said}, weights CRC-32 {payload:08x} as before",
        arguments.out.display(),
        file.len(),
    ))
}

fn provenance(arguments: &Pack, input: &Path, entries: &Path) -> anyhow::Result<()> {
    let packed = read_packed(input, "--provenance")?;
    let file = models::with_provenance(input, &packed, &read_entries(entries)?)?;
    output::write_whole(&arguments.out, &file)?;
    let loaded = LoadedModel::copy_of(&arguments.out, &file)?;
    let model = loaded.model();
    if arguments.json {
        let said = model.file().provenance().map(|(key, value)| (key.to_owned(), json!(value)));
        return output::json(&json!({
            "bytes": file.len(),
            "payload_crc": format!("{:08x}", model.file().payload_crc()),
            "provenance": said.collect::<Map<_, _>>(),
        }));
    }
    output::line(format_args!(
        "{}: {} bytes, {} entries of provenance, weights CRC-32 {:08x} as before",
        arguments.out.display(),
        file.len(),
        model.file().provenance().len(),
        model.file().payload_crc(),
    ))
}

/// A program without TOML reads none.
#[cfg(not(feature = "provenance"))]
fn read_entries(_: &Path) -> anyhow::Result<Vec<(String, String)>> {
    Err(crate::usage::missing("pack --provenance", "provenance").into())
}

/// The texts of a TOML file, in its order.
#[cfg(feature = "provenance")]
fn read_entries(path: &Path) -> anyhow::Result<Vec<(String, String)>> {
    let example = "write lines such as \"run 1\" = \"seeds 1-1200, 92 min\"";
    let shown = path.display();
    let text = String::from_utf8(files::read_whole(path)?)
        .map_err(|_| anyhow::anyhow!("{shown}: is not a TOML file (no UTF-8); {example}"))?;
    let table: Table = text.parse().map_err(|error: toml::de::Error| {
        anyhow::anyhow!("{shown}: is not a TOML file ({}); {example}", error.message())
    })?;
    if table.is_empty() {
        anyhow::bail!("{shown}: has no entries; {example}");
    }
    let entries = table.into_iter().map(|(key, value)| match value {
        Value::String(text) => Ok((key, text)),
        other => {
            let kind = other.type_str();
            Err(anyhow::anyhow!("{shown}: {key}: is of type {kind}, not a text; {example}"))
        }
    });
    entries.collect()
}

fn random(arguments: &Pack, preset: PresetName) -> anyhow::Result<()> {
    let (name, config) = match preset {
        PresetName::Paper => ("paper", &models::random::PAPER),
        PresetName::Edge => ("edge", &models::random::EDGE),
    };
    let file = models::random::random(name, config, arguments.dtype.into(), arguments.seed)?;
    output::write_whole(&arguments.out, &file)?;
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
    output::table_lines(&table)?;
    output::line(format_args!(
        "norms, biases and constants: {others} parameters, {other_bytes} bytes, exact"
    ))
}
