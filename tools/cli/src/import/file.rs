//! A scene file of several scenes, as `evaluation/SCENES.md` has it.

use std::collections::HashMap;
use std::hash::{DefaultHasher, Hash, Hasher};
use std::path::PathBuf;

use nalgebra::{Point3, Vector3};
use rigidformer_evaluation::scenes::{Split, Velocity};
use rigidformer_runtime::core::{Physics, Plane, Role};
use serde_json::{Map, Value, json};

/// One unit of a scene.
pub(super) struct ImportedUnit {
    pub(super) name: String,
    pub(super) points: Vec<Point3<f32>>,
    pub(super) physics: Physics,
    pub(super) inertia: Option<[f32; 3]>,
    pub(super) role: Role,
    pub(super) velocity: Option<Velocity>,
    /// (frames) x, y, z, qw, qx, qy, qz
    pub(super) poses: Vec<[f32; 7]>,
}

/// One scene.
pub(super) struct ImportedScene {
    pub(super) seed: i64,
    pub(super) split: Split,
    pub(super) units: Vec<ImportedUnit>,
    pub(super) from: PathBuf,
}

impl ImportedScene {
    pub(super) fn frames(&self) -> usize {
        self.units.first().map_or(0, |unit| unit.poses.len())
    }
}

/// What holds for all scenes.
pub(super) struct Notes {
    pub(super) dataset: String,
    pub(super) licence: String,
    pub(super) rate_hz: f64,
    pub(super) gravity_m_s2: Vector3<f32>,
    pub(super) planes: Vec<Plane>,
}

/// Tensors, widest element first, so that each starts aligned.
#[derive(Default)]
struct Tensors {
    header: Map<String, Value>,
    payload: Vec<u8>,
}

impl Tensors {
    fn add<const N: usize>(
        &mut self,
        name: &str,
        dtype: &str,
        shape: &[usize],
        values: impl Iterator<Item = [u8; N]>,
    ) {
        let start = self.payload.len();
        self.payload.extend(values.flatten());
        let place =
            json!({ "dtype": dtype, "shape": shape, "data_offsets": [start, self.payload.len()] });
        self.header.insert(name.into(), place);
    }

    fn i64(&mut self, name: &str, values: Vec<i64>) {
        self.add(name, "I64", &[values.len()], values.into_iter().map(i64::to_le_bytes));
    }

    fn f32(&mut self, name: &str, shape: &[usize], values: impl Iterator<Item = f32>) {
        self.add(name, "F32", shape, values.map(f32::to_le_bytes));
    }

    fn i32(&mut self, name: &str, values: Vec<i32>) {
        self.add(name, "I32", &[values.len()], values.into_iter().map(i32::to_le_bytes));
    }

    fn u8(&mut self, name: &str, values: Vec<u8>) {
        self.add(name, "U8", &[values.len()], values.into_iter().map(|value| [value]));
    }
}

fn rising(counts: impl Iterator<Item = usize>) -> Vec<i64> {
    let ends = counts.scan(0_i64, |end, count| {
        *end += count as i64;
        Some(*end)
    });
    std::iter::once(0).chain(ends).collect()
}

/// A sum of points that is the same of equal ones.
fn sum(points: &[Point3<f32>]) -> u64 {
    let mut hasher = DefaultHasher::new();
    // 0 and -0 are equal, and 0 is added to make them one.
    points
        .iter()
        .flat_map(|point| point.iter())
        .for_each(|v| (*v + 0.0).to_bits().hash(&mut hasher));
    hasher.finish()
}

/// Units, and frames of the longest scene.
pub(super) fn sizes(scenes: &[ImportedScene]) -> (usize, usize) {
    let longest = scenes.iter().map(ImportedScene::frames).max().unwrap_or(0);
    (scenes.iter().map(|scene| scene.units.len()).sum(), longest)
}

/// The bytes of the file. The same scenes give the same bytes.
pub(super) fn encode(scenes: &[ImportedScene], notes: &Notes) -> Vec<u8> {
    let units: Vec<&ImportedUnit> = scenes.iter().flat_map(|scene| &scene.units).collect();
    let count = units.len();
    let longest = scenes.iter().map(ImportedScene::frames).max().unwrap_or(0);
    // Units of one name and equal points share a shape.
    let mut shapes: Vec<&ImportedUnit> = Vec::new();
    let mut places: HashMap<(&str, u64), Vec<usize>> = HashMap::new();
    let shape_of: Vec<i32> = units
        .iter()
        .map(|unit| {
            // Few have one name and one sum, so that the time does not grow with the square of the units.
            let alike = places.entry((unit.name.as_str(), sum(&unit.points))).or_default();
            let is_same =
                |place: &usize| shapes.get(*place).is_some_and(|s| s.points == unit.points);
            let same = alike.iter().copied().find(is_same);
            let place = same.unwrap_or_else(|| {
                alike.push(shapes.len());
                shapes.push(unit);
                shapes.len() - 1
            });
            i32::try_from(place).unwrap_or(i32::MAX)
        })
        .collect();
    let mut tensors = Tensors::default();
    tensors.i64("scene_frames", scenes.iter().map(|scene| scene.frames() as i64).collect());
    tensors.i64("scene_planes", rising(scenes.iter().map(|_| notes.planes.len())));
    tensors.i64("scene_seed", scenes.iter().map(|scene| scene.seed).collect());
    tensors.i64("scene_units", rising(scenes.iter().map(|scene| scene.units.len())));
    tensors.i64("shape_offsets", rising(shapes.iter().map(|shape| shape.points.len())));
    let planes = scenes.iter().flat_map(|_| &notes.planes).flat_map(|plane| {
        let n = plane.normal;
        [n.x, n.y, n.z, plane.offset_m, plane.friction, plane.restitution]
    });
    tensors.f32("planes", &[scenes.len() * notes.planes.len(), 6], planes);
    let points: Vec<&Point3<f32>> = shapes.iter().flat_map(|shape| &shape.points).collect();
    let numbers = points.iter().flat_map(|point| [point.x, point.y, point.z]);
    tensors.f32("shape_points", &[points.len(), 3], numbers);
    if units.iter().any(|unit| unit.inertia.is_some()) {
        let moments = units.iter().flat_map(|unit| unit.inertia.unwrap_or_default());
        tensors.f32("unit_inertia", &[count, 3], moments);
    }
    let physics = units.iter().map(|unit| unit.physics);
    let physics = physics.flat_map(|p| [p.mass_kg, p.friction, p.restitution]);
    tensors.f32("unit_physics", &[count, 3], physics);
    // Shorter scenes stay at their last frame, which `scene_frames` says.
    let poses = units.iter().flat_map(|unit| {
        let last = unit.poses.last().into_iter().cycle();
        unit.poses.iter().chain(last).take(longest).flatten().copied()
    });
    tensors.f32("unit_poses", &[count, longest, 7], poses);
    tensors.f32("unit_scale", &[count], units.iter().map(|_| 1.0));
    if units.iter().any(|unit| unit.velocity.is_some()) {
        let numbers = units.iter().flat_map(|unit| {
            let velocity = unit.velocity.unwrap_or_default();
            let (v, w) = (velocity.linear_m_s, velocity.angular_rad_s);
            [v.x, v.y, v.z, w.x, w.y, w.z]
        });
        tensors.f32("unit_velocity", &[count, 6], numbers);
    }
    tensors.i32("unit_shape", shape_of);
    tensors.u8("scene_split", scenes.iter().map(|scene| scene.split.code()).collect());
    if units.iter().any(|unit| unit.role != Role::Free) {
        let code = |role: Role| match role {
            Role::Driven => 1,
            Role::Fixed => 2,
            _ => 0,
        };
        tensors.u8("unit_role", units.iter().map(|unit| code(unit.role)).collect());
    }
    let g = notes.gravity_m_s2;
    let names: Vec<&str> = shapes.iter().map(|shape| shape.name.as_str()).collect();
    let metadata = json!({
        "format": "rigidformer-scenes",
        "version": "2",
        "dataset": notes.dataset,
        "frame_rate_hz": (notes.rate_hz as f32).to_string(),
        "gravity_m_s2": format!("{} {} {}", g.x, g.y, g.z),
        "shape_names": json!(names).to_string(),
        "provenance": "Recorded poses, resampled to a constant rate by `rigidformer import`.",
        "licence": notes.licence,
    });
    tensors.header.insert("__metadata__".into(), metadata);
    let mut header = Value::Object(tensors.header).to_string();
    while !header.len().is_multiple_of(8) {
        header.push(' ');
    }
    let head = (header.len() as u64).to_le_bytes().into_iter().chain(header.bytes());
    // In place: the poses may be half of the memory.
    let mut bytes = tensors.payload;
    bytes.splice(0..0, head.collect::<Vec<_>>());
    bytes
}
