//! `rigidformer inspect`

use rigidformer_runtime::files::read_whole;
use rigidformer_runtime::models::LoadedModel;
use rigidformer_runtime::scenes::{Dataset, Split};
use rigidformer_weights::{MAGIC, ModelConfig, ModelFile, Shape};
use serde_json::{Map, Value, json};

use crate::arguments::Inspect;
use crate::{interrupt, output};

pub(crate) fn run(arguments: &Inspect) -> anyhow::Result<()> {
    interrupt::watch();
    let path = &arguments.file;
    let bytes = read_whole(path)?;
    if bytes.starts_with(&MAGIC) {
        let loaded = LoadedModel::copy_of(path, &bytes)?;
        let (model, length) = (loaded.model()?, loaded.len());
        return if arguments.json {
            model_json(model.file(), length)
        } else {
            model_text(model.file(), length)
        };
    }
    // A safetensors file starts with the length of its JSON header.
    if bytes.get(8) != Some(&b'{') {
        let kind = if bytes.is_empty() {
            "is empty"
        } else {
            "is neither a packed model nor a scene file"
        };
        anyhow::bail!(
            "{}: {kind}; give a model (*.rfm) or a scene file (*.safetensors)",
            path.display()
        );
    }
    let length = bytes.len();
    let dataset = Dataset::from_bytes(path, bytes)?;
    for index in 0..dataset.len() {
        interrupt::check()?;
        dataset.scene(index, None)?;
    }
    if arguments.json { scenes_json(&dataset, length) } else { scenes_text(&dataset, length) }
}

/// Fields of a configuration with their values, scales as levels.
fn config_fields(config: &ModelConfig) -> anyhow::Result<Map<String, Value>> {
    // By way of text, in which an f32 has no digits of an f64.
    let mut fields: Map<String, Value> = serde_json::from_str(&serde_json::to_string(config)?)?;
    // Not among the serialised fields, because version 1 of the format has none.
    fields.insert("hidden".into(), serde_json::to_value(config.hidden)?);
    let levels: Vec<u32> = (0..32).filter(|level| config.scales.0 >> level & 1 == 1).collect();
    fields.insert("scales".into(), json!(levels));
    Ok(fields)
}

/// An f32 without the digits that f64 would add.
fn short(value: f32) -> Value {
    json!(value.to_string().parse::<f64>().unwrap_or(f64::from(value)))
}

fn dimensions(shape: Shape) -> Vec<u32> {
    match shape {
        Shape::Scalar => vec![],
        Shape::Vector(length) => vec![length],
        Shape::Matrix { rows, columns } => vec![rows, columns],
    }
}

fn model_json(file: &ModelFile<'_>, length: usize) -> anyhow::Result<()> {
    let tensors: Vec<Value> = file
        .tensors()
        .map(|tensor| {
            let dtype = tensor.data.dtype().to_string();
            json!({ "name": tensor.name, "dtype": dtype, "shape": dimensions(tensor.shape) })
        })
        .collect();
    output::json(&json!({
        "kind": "model",
        "name": file.name(),
        "bytes": length,
        "parameters": file.parameters(),
        "payload_crc": format!("{:08x}", file.payload_crc()),
        "config": config_fields(file.config())?,
        "provenance": file.provenance().map(|(key, value)| (key.to_owned(), json!(value))).collect::<Map<_, _>>(),
        "metrics": file.metrics().map(|(name, value)| (name.to_owned(), short(value))).collect::<Map<_, _>>(),
        "tensors": tensors,
    }))
}

fn model_text(file: &ModelFile<'_>, length: usize) -> anyhow::Result<()> {
    output::line(format_args!("model {}", file.name()))?;
    output::line(format_args!(
        "{length} bytes, {} parameters, weights CRC-32 {:08x}",
        file.parameters(),
        file.payload_crc()
    ))?;
    section(
        "configuration",
        config_fields(file.config())?.iter().map(|(name, value)| (name.clone(), value.to_string())),
    )?;
    section("provenance", file.provenance().map(|(key, value)| (key.into(), value.into())))?;
    section("metrics", file.metrics().map(|(name, value)| (name.into(), value.to_string())))?;
    let describe = |tensor: rigidformer_weights::Tensor<'_>| {
        (tensor.name.to_owned(), format!("{} {}", tensor.data.dtype(), tensor.shape))
    };
    section("tensors", file.tensors().map(describe))
}

fn section(title: &str, rows: impl Iterator<Item = (String, String)>) -> anyhow::Result<()> {
    let rows: Vec<(String, String)> = rows.collect();
    if rows.is_empty() {
        return Ok(());
    }
    output::line(format_args!("\n{title}"))?;
    let width = rows.iter().map(|(name, _)| name.chars().count()).max().unwrap_or(0);
    for (name, value) in rows {
        output::line(format_args!("  {name:width$}  {value}"))?;
    }
    Ok(())
}

/// (split, scenes, units) of every split that has scenes.
fn splits(dataset: &Dataset) -> Vec<(Split, usize, usize)> {
    let counted = Split::ALL.map(|split| {
        let scenes = dataset.scenes_of(split);
        let units = scenes
            .iter()
            .filter_map(|index| dataset.units_of(*index))
            .map(|units| units.len())
            .sum();
        (split, scenes.len(), units)
    });
    counted.into_iter().filter(|(_, scenes, _)| *scenes > 0).collect()
}

fn scenes_json(dataset: &Dataset, length: usize) -> anyhow::Result<()> {
    let split = |(split, scenes, units): (Split, usize, usize)| {
        (split.to_string(), json!({ "scenes": scenes, "units": units }))
    };
    let shapes: Vec<Value> =
        dataset.shapes().map(|(name, points)| json!({ "name": name, "points": points })).collect();
    output::json(&json!({
        "kind": "scenes",
        "dataset": dataset.name(),
        "bytes": length,
        "scenes": dataset.len(),
        "units": dataset.units(),
        "frames": dataset.frames(),
        "frame_rate_hz": short(dataset.frame_rate_hz()),
        "gravity_m_s2": dataset.gravity_m_s2().map(short),
        "ground_friction": short(dataset.ground_friction()),
        "ground_restitution": short(dataset.ground_restitution()),
        "splits": splits(dataset).into_iter().map(split).collect::<Map<_, _>>(),
        "shapes": shapes,
        "provenance": dataset.provenance(),
        "licence": dataset.licence(),
    }))
}

fn scenes_text(dataset: &Dataset, length: usize) -> anyhow::Result<()> {
    output::line(format_args!("scenes of {}", dataset.name()))?;
    output::line(format_args!(
        "{length} bytes, {} scenes, {} units, {} frames at {} Hz ({:.3} s); every pose checked",
        dataset.len(),
        dataset.units(),
        dataset.frames(),
        dataset.frame_rate_hz(),
        (dataset.frames() - 1) as f32 / dataset.frame_rate_hz(),
    ))?;
    let row = |(split, scenes, units): (Split, usize, usize)| {
        (split.to_string(), format!("{scenes} scenes, {units} units"))
    };
    section("splits", splits(dataset).into_iter().map(row))?;
    section(
        "shapes",
        dataset.shapes().map(|(name, points)| (name.to_owned(), format!("{points} points"))),
    )?;
    let [x, y, z] = dataset.gravity_m_s2();
    section(
        "world",
        [
            ("gravity".into(), format!("{x} {y} {z} m/s²")),
            ("ground friction".into(), dataset.ground_friction().to_string()),
            ("ground restitution".into(), dataset.ground_restitution().to_string()),
        ]
        .into_iter(),
    )?;
    section(
        "origin",
        [
            ("provenance".into(), dataset.provenance().into()),
            ("licence".into(), dataset.licence().into()),
        ]
        .into_iter(),
    )
}
