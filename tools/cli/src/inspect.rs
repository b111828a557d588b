//! `rigidformer inspect`

mod card;
mod health;

pub(crate) use card::WITHOUT;
use std::collections::{HashMap, HashSet};

use rigidformer_core::{Plane, Role};
use rigidformer_evaluation::scenes::{Dataset, Split};
use rigidformer_runtime::files::read_whole;
use rigidformer_runtime::models::LoadedModel;
use rigidformer_weights::{MAGIC, ModelConfig, ModelFile, Quantity, Shape};
use serde_json::{Map, Value, json};

use crate::arguments::Inspect;
use crate::usage::Usage;
use crate::{interrupt, output};

pub(crate) fn run(arguments: &Inspect) -> anyhow::Result<()> {
    if arguments.health {
        return health::run(arguments);
    }
    if arguments.looks.model.path.is_some() {
        return Err(
            Usage("--model goes with --health; the model to describe is FILE".into()).into()
        );
    }
    interrupt::watch();
    let path = &arguments.file;
    let bytes = read_whole(path)?;
    if bytes.starts_with(&MAGIC) {
        let loaded = LoadedModel::copy_of(path, &bytes)?;
        let (model, length) = (loaded.model(), loaded.len());
        if arguments.card {
            return card::run(model.file(), length);
        }
        return if arguments.json {
            model_json(model.file(), length)
        } else {
            model_text(model.file(), length)
        };
    }
    if arguments.card {
        return Err(Usage(format!(
            "--card: {} is no model; cards are of packed models",
            path.display()
        ))
        .into());
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
    fields.insert("similarity".into(), serde_json::to_value(config.similarity)?);
    let directions: Vec<usize> = config.directions.indices().collect();
    fields.insert("directions".into(), json!(directions));
    if config.bonds > 0 {
        fields.insert("bonds".into(), config.bonds.into());
    }
    if config.scope.is_near() {
        fields.insert("scope".into(), json!("near"));
    }
    if config.most_units > 0 {
        fields.insert("most_units".into(), config.most_units.into());
    }
    if config.motion.is_soft() {
        fields.insert("elastic".into(), serde_json::to_value(config.elastic)?);
    }
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
        "ranges": file.ranges().map(|ranges| {
            let of = Quantity::ALL.iter().zip(ranges.of);
            of.map(|(quantity, range)| (quantity.name().to_owned(), json!(range.map(short)))).collect::<Map<_, _>>()
        }),
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
    let ranges = file.ranges().map(|ranges| Quantity::ALL.iter().zip(ranges.of));
    section(
        "ranges that training saw",
        ranges.into_iter().flatten().map(|(quantity, [low, high])| {
            (quantity.name().to_owned(), format!("{low} to {high}"))
        }),
    )?;
    section("metrics", file.metrics().map(|(name, value)| (name.into(), value.to_string())))?;
    let describe = |tensor: rigidformer_weights::Tensor<'_>| {
        (tensor.name.to_owned(), format!("{} {}", tensor.data.dtype(), tensor.shape))
    };
    section("tensors", file.tensors().map(describe))
}

fn section(title: &str, rows: impl Iterator<Item = (String, String)>) -> anyhow::Result<()> {
    // Names are as long as a file has them; a width has 16 bits.
    let rows: Vec<(String, String)> =
        rows.map(|(name, value)| (output::name(&name), value)).collect();
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

/// A role's name and how many units have it.
fn roles(dataset: &Dataset) -> [(&'static str, usize); 3] {
    [("free", Role::Free), ("driven", Role::Driven), ("fixed", Role::Fixed)]
        .map(|(name, role)| (name, dataset.units_in_role(role)))
}

/// Different planes, and how many scenes have each.
fn planes(dataset: &Dataset) -> Vec<(Plane, usize)> {
    let mut counted: Vec<(Plane, usize)> = Vec::new();
    let mut places: HashMap<[u32; 6], usize> = HashMap::new();
    for index in 0..dataset.len() {
        let mut seen = HashSet::new();
        for plane in dataset.planes_of(index).unwrap_or_default() {
            let n = plane.normal;
            let key = [n.x, n.y, n.z, plane.offset_m, plane.friction, plane.restitution];
            let key = key.map(f32::to_bits);
            if !seen.insert(key) {
                continue;
            }
            let place = *places.entry(key).or_insert(counted.len());
            match counted.get_mut(place) {
                Some((_, scenes)) => *scenes += 1,
                None => counted.push((*plane, 1)),
            }
        }
    }
    counted
}

/// Bodies of all scenes, and units that share one with others.
fn bodies(dataset: &Dataset) -> (usize, usize) {
    let scenes = (0..dataset.len()).filter_map(|index| dataset.bodies_of(index));
    scenes.fold((0, 0), |sum, scene| (sum.0 + scene.0, sum.1 + scene.1))
}

/// Frames of the shortest scene.
fn shortest(dataset: &Dataset) -> usize {
    let frames = (0..dataset.len()).filter_map(|index| dataset.frames_of(index));
    frames.min().unwrap_or_else(|| dataset.frames())
}

/// Scenes without any plane.
fn without_planes(dataset: &Dataset) -> usize {
    let bare = |index: &usize| dataset.planes_of(*index).is_some_and(<[Plane]>::is_empty);
    (0..dataset.len()).filter(bare).count()
}

/// Scenes on ground of varying height.
fn with_height_field(dataset: &Dataset) -> usize {
    (0..dataset.len()).filter(|index| dataset.height_field_of(*index).is_some()).count()
}

fn scenes_json(dataset: &Dataset, length: usize) -> anyhow::Result<()> {
    let split = |(split, scenes, units): (Split, usize, usize)| {
        (split.to_string(), json!({ "scenes": scenes, "units": units }))
    };
    let plane = |(plane, scenes): (Plane, usize)| {
        let normal: [f32; 3] = plane.normal.into();
        json!({
            "normal": normal.map(short),
            "offset_m": short(plane.offset_m),
            "friction": short(plane.friction),
            "restitution": short(plane.restitution),
            "scenes": scenes,
        })
    };
    let (bodies, sharing) = bodies(dataset);
    let ([faces, edges, tetrahedra], (bonds, breaking)) = (dataset.mesh_sizes(), dataset.bonds());
    let shapes: Vec<Value> =
        dataset.shapes().map(|(name, points)| json!({ "name": name, "points": points })).collect();
    let mut document = json!({
        "kind": "scenes",
        "version": dataset.version(),
        "dataset": dataset.name(),
        "bytes": length,
        "scenes": dataset.len(),
        "units": dataset.units(),
        "frames": dataset.frames(),
        "shortest_scene_frames": shortest(dataset),
        "unit_velocities": dataset.has_velocities(),
        "units_with_inertia": dataset.units_with_inertia(),
        "units_in_pieces": dataset.units_in_pieces(),
        "frame_rate_hz": short(dataset.frame_rate_hz()),
        "gravity_m_s2": dataset.gravity_m_s2().map(short),
        "contact_law": dataset.contact_law().to_string(),
        "roles": roles(dataset).into_iter().map(|(name, units)| (name.to_owned(), json!(units))).collect::<Map<_, _>>(),
        "bodies": bodies,
        "units_sharing_a_body": sharing,
        "soft_units": dataset.soft_units(),
        "soft_points": dataset.soft_points(),
        "young_pa": dataset.young_pa().map(|(least, most)| [least, most].map(short)),
        "faces": faces,
        "edges": edges,
        "tetrahedra": tetrahedra,
        "bonds": bonds,
        "bonds_that_break": breaking,
        "command_size": dataset.command_size(),
        "planes": planes(dataset).into_iter().map(plane).collect::<Vec<_>>(),
        "scenes_without_planes": without_planes(dataset),
        "scenes_with_height_field": with_height_field(dataset),
        "splits": splits(dataset).into_iter().map(split).collect::<Map<_, _>>(),
        "shapes": shapes,
        "provenance": dataset.provenance(),
        "licence": dataset.licence(),
    });
    if let (Some(ground), Some(document)) = (dataset.ground(), document.as_object_mut()) {
        document.insert("ground_friction".into(), short(ground.friction));
        document.insert("ground_restitution".into(), short(ground.restitution));
    }
    output::json(&document)
}

/// Shapes that the text names one by one; JSON names all.
const SHOWN_SHAPES: usize = 24;

/// Every shape, or what all have in common where they are many: files of fragments have one a unit.
fn shapes(dataset: &Dataset) -> Vec<(String, String)> {
    let counts: Vec<usize> = dataset.shapes().map(|(_, points)| points).collect();
    if counts.len() <= SHOWN_SHAPES {
        let row = |(name, points): (&str, usize)| (name.to_owned(), format!("{points} points"));
        return dataset.shapes().map(row).collect();
    }
    let (least, most) = (counts.iter().min(), counts.iter().max());
    let (least, most) = (least.copied().unwrap_or(0), most.copied().unwrap_or(0));
    let sum: usize = counts.iter().sum();
    let all = format!("{least} to {most} points each, {sum} together (--json has all)");
    vec![(counts.len().to_string(), all)]
}

/// What soft units consist of; nothing where there are none.
fn soft_rows(dataset: &Dataset) -> Vec<(String, String)> {
    if dataset.soft_units() == 0 {
        return Vec::new();
    }
    let young = match dataset.young_pa() {
        None => "not known".to_owned(),
        Some((least, most)) if least == most => format!("{least:e} Pa"),
        Some((least, most)) => format!("{least:e} to {most:e} Pa"),
    };
    let [faces, edges, tetrahedra] = dataset.mesh_sizes();
    let lists = [("faces", faces), ("edges", edges), ("tetrahedra", tetrahedra)];
    let lists = lists.into_iter().filter(|(_, rows)| *rows > 0);
    [("points".to_owned(), dataset.soft_points().to_string()), ("Young's modulus".into(), young)]
        .into_iter()
        .chain(lists.map(|(name, rows)| (name.to_owned(), rows.to_string())))
        .collect()
}

/// Planes that the text names; JSON names all.
const SHOWN_PLANES: usize = 12;

fn scenes_text(dataset: &Dataset, length: usize) -> anyhow::Result<()> {
    output::line(format_args!("scenes of {}, file version {}", dataset.name(), dataset.version()))?;
    output::line(format_args!(
        "{length} bytes, {} scenes, {} units, {} frames at {} Hz ({:.3} s); every pose checked",
        dataset.len(),
        dataset.units(),
        match shortest(dataset) {
            shortest if shortest < dataset.frames() =>
                format!("{shortest} to {}", dataset.frames()),
            frames => frames.to_string(),
        },
        dataset.frame_rate_hz(),
        (dataset.frames() - 1) as f32 / dataset.frame_rate_hz(),
    ))?;
    let row = |(split, scenes, units): (Split, usize, usize)| {
        (split.to_string(), format!("{scenes} scenes, {units} units"))
    };
    section("splits", splits(dataset).into_iter().map(row))?;
    section("shapes", shapes(dataset).into_iter())?;
    let (bodies, sharing) = bodies(dataset);
    let soft = Some(dataset.soft_units()).filter(|units| *units > 0);
    let inertia = Some(dataset.units_with_inertia()).filter(|units| *units > 0);
    let pieces = Some(dataset.units_in_pieces()).filter(|units| *units > 0);
    let moved = roles(dataset)
        .into_iter()
        .filter(|(_, units)| *units > 0)
        .map(|(name, units)| (name.to_owned(), units.to_string()))
        .chain(soft.map(|units| ("soft".to_owned(), units.to_string())))
        .chain(inertia.map(|units| ("with known inertia".to_owned(), units.to_string())))
        .chain(pieces.map(|units| ("of several convex pieces".to_owned(), units.to_string())))
        .chain([("bodies".to_owned(), format!("{bodies}, {sharing} units share one with others"))]);
    section("units", moved)?;
    section("soft units", soft_rows(dataset).into_iter())?;
    let (bonds, breaking) = dataset.bonds();
    let row = ("pairs of units".to_owned(), format!("{bonds}, {breaking} break within the record"));
    section("bonds", (bonds > 0).then_some(row).into_iter())?;
    let [x, y, z] = dataset.gravity_m_s2();
    let mut world = vec![("gravity".to_owned(), format!("{x} {y} {z} m/s²"))];
    if !dataset.contact_law().is_rigid() {
        world.push(("contact law".into(), dataset.contact_law().to_string()));
    }
    let fields = with_height_field(dataset);
    if fields > 0 {
        world.push(("height fields".into(), format!("in {fields} scenes")));
    }
    if dataset.has_velocities() {
        world.push(("velocities".into(), "of all units at frame 0".into()));
    }
    if dataset.command_size() > 0 {
        let text = format!("{} numbers a frame", dataset.command_size());
        world.push(("commands".into(), text));
    }
    if let Some(ground) = dataset.ground() {
        world.push(("ground friction".into(), ground.friction.to_string()));
        world.push(("ground restitution".into(), ground.restitution.to_string()));
    }
    section("world", world.into_iter())?;
    if dataset.ground().is_none() {
        let planes = planes(dataset);
        let row = |(plane, scenes): &(Plane, usize)| {
            let n = plane.normal;
            let text = format!(
                "offset {} m, friction {}, restitution {}, in {scenes} scenes",
                plane.offset_m, plane.friction, plane.restitution
            );
            (format!("normal {} {} {}", n.x, n.y, n.z), text)
        };
        let more = planes.len().saturating_sub(SHOWN_PLANES);
        let more = (more > 0).then(|| ("more".to_owned(), format!("{more} (--json has all)")));
        let bare = Some(without_planes(dataset)).filter(|scenes| *scenes > 0);
        let bare = bare.map(|scenes| ("none".to_owned(), format!("in {scenes} scenes")));
        section("planes", planes.iter().take(SHOWN_PLANES).map(row).chain(more).chain(bare))?;
    }
    section(
        "origin",
        [
            ("provenance".into(), dataset.provenance().into()),
            ("licence".into(), dataset.licence().into()),
        ]
        .into_iter(),
    )
}
