//! Writes a scene file with a single scene.

use std::path::Path;

use serde_json::{Map, Value, json};

use super::RecordedScene;
use super::dataset::{FORMAT, VERSION};
use crate::files::{FileError, write_whole};

/// What a scene file says besides its numbers.
#[derive(Clone, Debug, PartialEq)]
pub struct SceneNotes {
    /// Name of the data set, such as `primitives`.
    pub dataset: String,
    /// Friction coefficient of the ground plane z = 0.
    pub ground_friction: f32,
    /// Restitution coefficient of the ground plane.
    pub ground_restitution: f32,
    /// Where the scene comes from.
    pub provenance: String,
    /// Under which terms it may be used.
    pub licence: String,
}

/// Writes a file with one scene, each unit with a shape of its own at scale 1. The same scene gives the same bytes.
///
/// ```no_run
/// use rigidformer_runtime::scenes::{Dataset, SceneNotes, write_scene};
/// let dataset = Dataset::open("primitives.safetensors".as_ref())?;
/// let notes = SceneNotes {
///     dataset: dataset.name().into(),
///     ground_friction: dataset.ground_friction(),
///     ground_restitution: dataset.ground_restitution(),
///     provenance: dataset.provenance().into(),
///     licence: dataset.licence().into(),
/// };
/// write_scene("one.safetensors".as_ref(), &dataset.scene(0, Some(121))?, &notes)?;
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
pub fn write_scene(
    path: &Path,
    scene: &RecordedScene,
    notes: &SceneNotes,
) -> Result<(), FileError> {
    write_whole(path, &encode(scene, notes))
}

/// Tensors in the order of the file, widest element first, so that each starts aligned.
#[derive(Default)]
struct Layout {
    header: Map<String, Value>,
    payload: Vec<u8>,
}

impl Layout {
    fn tensor(
        &mut self,
        name: &str,
        dtype: &str,
        shape: &[usize],
        values: impl Iterator<Item = Vec<u8>>,
    ) {
        let start = self.payload.len();
        self.payload.extend(values.flatten());
        let end = self.payload.len();
        self.header.insert(
            name.into(),
            json!({ "dtype": dtype, "shape": shape, "data_offsets": [start, end] }),
        );
    }

    fn f32(&mut self, name: &str, shape: &[usize], values: impl Iterator<Item = f32>) {
        self.tensor(name, "F32", shape, values.map(|value| value.to_le_bytes().to_vec()));
    }

    fn i64(&mut self, name: &str, shape: &[usize], values: impl Iterator<Item = i64>) {
        self.tensor(name, "I64", shape, values.map(|value| value.to_le_bytes().to_vec()));
    }
}

fn encode(scene: &RecordedScene, notes: &SceneNotes) -> Vec<u8> {
    let units = scene.units();
    let (count, frames) = (units.len(), scene.frames());
    let mut layout = Layout::default();

    layout.i64("scene_seed", &[1], [scene.seed()].into_iter());
    layout.i64("scene_units", &[2], [0, count as i64].into_iter());
    let ends = units.iter().scan(0, |end, unit| {
        *end += unit.points.len() as i64;
        Some(*end)
    });
    layout.i64("shape_offsets", &[count + 1], std::iter::once(0).chain(ends));
    let points = units.iter().flat_map(|unit| &unit.points);
    layout.f32(
        "shape_points",
        &[scene.points(), 3],
        points.flat_map(|point| [point.x, point.y, point.z]),
    );
    let physics = units.iter().map(|unit| unit.physics);
    layout.f32(
        "unit_physics",
        &[count, 3],
        physics.flat_map(|p| [p.mass_kg, p.friction, p.restitution]),
    );
    let poses = units.iter().flat_map(|unit| &unit.poses).flat_map(|pose| {
        let (t, q) = (pose.translation.vector, pose.rotation.quaternion());
        [t.x, t.y, t.z, q.w, q.i, q.j, q.k]
    });
    layout.f32("unit_poses", &[count, frames, 7], poses);
    layout.f32("unit_scale", &[count], units.iter().map(|_| 1.0));
    let shapes = (0..count).map(|unit| (unit as i32).to_le_bytes().to_vec());
    layout.tensor("unit_shape", "I32", &[count], shapes);
    layout.tensor("scene_split", "U8", &[1], std::iter::once(vec![scene.split().code()]));

    let g = scene.gravity_m_s2();
    let shape_names: Vec<&str> = units.iter().map(|unit| unit.shape.as_str()).collect();
    let metadata = json!({
        "format": FORMAT,
        "version": VERSION,
        "dataset": notes.dataset,
        "frame_rate_hz": scene.frame_rate_hz().to_string(),
        "gravity_m_s2": format!("{} {} {}", g.x, g.y, g.z),
        "ground_friction": notes.ground_friction.to_string(),
        "ground_restitution": notes.ground_restitution.to_string(),
        "shape_names": json!(shape_names).to_string(),
        "provenance": notes.provenance,
        "licence": notes.licence,
    });
    layout.header.insert("__metadata__".into(), metadata);

    let mut header = Value::Object(layout.header).to_string();
    while !header.len().is_multiple_of(8) {
        header.push(' ');
    }
    let mut bytes = (header.len() as u64).to_le_bytes().to_vec();
    bytes.extend(header.as_bytes());
    bytes.extend(layout.payload);
    bytes
}
