//! Writes a scene file with a single scene.

use std::path::Path;

use rigidformer_core::{Compliance, Role};
use rigidformer_runtime::files::{FileError, write_whole};
use serde_json::{Map, Value, json};

use super::dataset::{FORMAT, VERSIONS};
use super::recorded::role_code;
use super::{Problem, RecordedScene, SceneError};

/// What a scene file says besides its numbers.
#[derive(Clone, Debug, PartialEq)]
pub struct SceneNotes {
    /// Name of the data set, such as `primitives`.
    pub dataset: String,
    /// Where the scene comes from.
    pub provenance: String,
    /// Under which terms it may be used.
    pub licence: String,
}

/// Why a scene was not written. Its text names the file and the remedy.
#[derive(Debug, thiserror::Error)]
pub enum WriteError {
    /// The file cannot be written.
    #[error(transparent)]
    File(#[from] FileError),
    /// The scene lacks something that files have.
    #[error(transparent)]
    Scene(#[from] SceneError),
}

/// Writes a file with one scene, each unit with a shape of its own at scale 1, in the oldest version of the format that
/// has what the scene needs. The same scene gives the same bytes.
///
/// # Errors
/// [`WriteError::Scene`] for a scene whose planes are not known, [`WriteError::File`] for a file that cannot be written.
///
/// ```no_run
/// use rigidformer_evaluation::scenes::{Dataset, SceneNotes, write_scene};
/// let dataset = Dataset::open("primitives.safetensors".as_ref())?;
/// let notes = SceneNotes {
///     dataset: dataset.name().into(),
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
) -> Result<(), WriteError> {
    Ok(write_whole(path, &scene_file(path, scene, notes)?)?)
}

/// The bytes that [`write_scene`] writes, for who writes several files together; errors name `path`.
///
/// # Errors
/// For a scene whose planes are not known.
pub fn scene_file(
    path: &Path,
    scene: &RecordedScene,
    notes: &SceneNotes,
) -> Result<Vec<u8>, SceneError> {
    encode(scene, notes).map_err(|problem| SceneError {
        path: path.into(),
        field: scene.name().into(),
        problem,
    })
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

    /// (rows, 2)
    fn compliance(&mut self, name: &str, rows: impl ExactSizeIterator<Item = Compliance>) {
        let shape = [rows.len(), 2];
        // Files have finite numbers, and 0 is rigid.
        let stiffness = |row: &Compliance| if row.is_rigid() { 0.0 } else { row.stiffness_n_m };
        self.f32(name, &shape, rows.flat_map(|row| [stiffness(&row), row.dissipation_s_m]));
    }

    fn i32(&mut self, name: &str, values: impl ExactSizeIterator<Item = i32>) {
        let shape = [values.len()];
        self.tensor(name, "I32", &shape, values.map(|value| value.to_le_bytes().to_vec()));
    }

    /// (rows, N)
    fn i32_rows<const N: usize>(
        &mut self,
        name: &str,
        rows: usize,
        numbers: impl Iterator<Item = [usize; N]>,
    ) {
        // A scene of 2^31 points is larger than any file of it, so none is cut here.
        let numbers = numbers.flatten().map(|number| i32::try_from(number).unwrap_or(i32::MAX));
        self.tensor(name, "I32", &[rows, N], numbers.map(|number| number.to_le_bytes().to_vec()));
    }

    fn u8(&mut self, name: &str, values: impl Iterator<Item = u8>) {
        let values: Vec<u8> = values.collect();
        self.tensor(name, "U8", &[values.len()], values.iter().map(|value| vec![*value]));
    }

    fn i64(&mut self, name: &str, shape: &[usize], values: impl Iterator<Item = i64>) {
        self.tensor(name, "I64", shape, values.map(|value| value.to_le_bytes().to_vec()));
    }
}

fn encode(scene: &RecordedScene, notes: &SceneNotes) -> Result<Vec<u8>, Problem> {
    let units = scene.units();
    let (count, frames) = (units.len(), scene.frames());
    // A file cannot say that its planes are not known.
    let planes = scene.planes().ok_or(Problem::UnknownPlanes)?;
    let roles = units.iter().any(|unit| unit.role != Role::Free);
    let bodies = units.iter().any(|unit| unit.body.is_some());
    let soft = units.iter().any(|unit| unit.soft.is_some());
    let commands = scene.command_size() > 0;
    let velocities = scene.has_velocities();
    let inertias = units.iter().any(|unit| unit.inertia.is_some());
    let gives_way = units.iter().any(|unit| unit.compliance != Compliance::RIGID);
    let planes_give_way = !scene.plane_compliance().is_empty();
    let pieces = units.iter().any(|unit| !unit.pieces.is_empty());
    let (mesh, bonds) = (scene.mesh(), scene.bonds());
    let bonded = !bonds.is_empty();
    let more = roles || bodies || soft || commands || velocities || inertias || pieces || bonded;
    let more = more || gives_way || planes_give_way || scene.height_field().is_some();
    // Version 1 has one ground and no other tensors, and older programs read it.
    let ground = scene.ground().filter(|_| !more);
    let mut layout = Layout::default();

    let rising = |counts: &mut dyn Iterator<Item = usize>| -> Vec<i64> {
        let mut ends = vec![0];
        ends.extend(counts.scan(0, |end, count| {
            *end += count as i64;
            Some(*end)
        }));
        ends
    };
    if pieces {
        let mut counts =
            units.iter().flat_map(|unit| unit.pieces.counts()).map(|n| usize::from(*n));
        let offsets = rising(&mut counts);
        layout.i64("piece_offsets", &[offsets.len()], offsets.into_iter());
        let offsets = rising(&mut units.iter().map(|unit| unit.pieces.len()));
        layout.i64("shape_pieces", &[count + 1], offsets.into_iter());
    }
    let lists = [
        ("scene_bonds", bonds.len()),
        ("scene_edges", mesh.edges.len()),
        ("scene_faces", mesh.faces.len()),
        ("scene_tetrahedra", mesh.tetrahedra.len()),
    ];
    for (name, rows) in lists.into_iter().filter(|(_, rows)| *rows > 0) {
        layout.i64(name, &[2], [0, rows as i64].into_iter());
    }
    if scene.height_field().is_some() {
        layout.i64("scene_height_fields", &[2], [0, 1].into_iter());
    }
    if ground.is_none() {
        layout.i64("scene_planes", &[2], [0, planes.len() as i64].into_iter());
    }
    layout.i64("scene_seed", &[1], [scene.seed()].into_iter());
    layout.i64("scene_units", &[2], [0, count as i64].into_iter());
    let ends = units.iter().scan(0, |end, unit| {
        *end += unit.points.len() as i64;
        Some(*end)
    });
    layout.i64("shape_offsets", &[count + 1], std::iter::once(0).chain(ends));
    if commands {
        let values = (0..frames).filter_map(|frame| scene.command(frame)).flatten().copied();
        layout.f32("commands", &[1, frames, scene.command_size()], values);
    }
    if let Some(field) = scene.height_field() {
        let ([dx, dy], corner) = (field.spacing_m, field.corner_m);
        let (rows, columns) = (field.view().rows() as f32, field.columns as f32);
        let (friction, restitution) = (field.friction, field.restitution);
        let row = [rows, columns, dx, dy, corner.x, corner.y, corner.z, friction, restitution];
        layout.f32("height_fields", &[1, row.len()], row.into_iter());
        layout.f32("heights", &[field.heights_m.len()], field.heights_m.iter().copied());
    }
    if ground.is_none() {
        let numbers = planes.iter().flat_map(|plane| {
            let n = plane.normal;
            [n.x, n.y, n.z, plane.offset_m, plane.friction, plane.restitution]
        });
        layout.f32("planes", &[planes.len(), 6], numbers);
    }
    if planes_give_way {
        layout.compliance("plane_compliance", scene.plane_compliance().iter().copied());
    }
    if pieces {
        let points: Vec<_> = units.iter().flat_map(|unit| unit.pieces.points()).collect();
        let numbers = points.iter().flat_map(|point| [point.x, point.y, point.z]);
        layout.f32("piece_points", &[points.len(), 3], numbers);
    }
    let points = units.iter().flat_map(|unit| &unit.points);
    layout.f32(
        "shape_points",
        &[scene.points(), 3],
        points.flat_map(|point| [point.x, point.y, point.z]),
    );
    if soft {
        let mut numbers = Vec::new();
        let mut rows = 0;
        for (unit, recorded) in units.iter().filter_map(|unit| Some((unit, unit.soft.as_ref()?))) {
            rows += unit.points.len();
            for point in 0..unit.points.len() {
                let path = recorded.iter().filter_map(|frame| frame.get(point));
                numbers.extend(path.flat_map(|point| [point.x, point.y, point.z]));
            }
        }
        layout.f32("soft_points", &[rows, frames, 3], numbers.into_iter());
    }
    if gives_way {
        layout.compliance("unit_compliance", units.iter().map(|unit| unit.compliance));
    }
    if inertias {
        let moments = units.iter().flat_map(|unit| unit.inertia.unwrap_or_default());
        layout.f32("unit_inertia", &[count, 3], moments);
    }
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
    // Points carry their scale already: a shape a unit.
    layout.f32("unit_scale", &[count], units.iter().map(|_| 1.0));
    if velocities {
        let values = units.iter().filter_map(|unit| unit.velocity);
        let numbers = values.flat_map(|velocity| {
            let (v, w) = (velocity.linear_m_s, velocity.angular_rad_s);
            [v.x, v.y, v.z, w.x, w.y, w.z]
        });
        layout.f32("unit_velocity", &[count, 6], numbers);
    }
    if units.iter().any(|unit| unit.young_pa.is_some()) {
        layout.f32("unit_young", &[count], units.iter().map(|unit| unit.young_pa.unwrap_or(0.0)));
    }
    if bonded {
        let frame = |frame: usize| i32::try_from(frame).unwrap_or(i32::MAX);
        let breaks = bonds.iter().map(|bond| frame(bond.breaks_at.unwrap_or(frames)));
        layout.i32("bond_frame", breaks);
        layout.i32_rows("bonds", bonds.len(), bonds.iter().map(|bond| bond.units));
    }
    if !mesh.edges.is_empty() {
        layout.i32_rows("edges", mesh.edges.len(), mesh.edges.iter().copied());
    }
    if !mesh.faces.is_empty() {
        layout.i32_rows("faces", mesh.faces.len(), mesh.faces.iter().copied());
    }
    if !mesh.tetrahedra.is_empty() {
        layout.i32_rows("tetrahedra", mesh.tetrahedra.len(), mesh.tetrahedra.iter().copied());
    }
    if bodies {
        layout.i32("unit_body", units.iter().map(|unit| unit.body.map_or(-1, i32::from)));
    }
    layout.i32("unit_shape", (0..count).map(|unit| unit as i32));
    // Without set points a file needs no such tensor, and programs that do not know it read it.
    if scene.set_points().contains(&true) {
        layout.u8("command_last", scene.set_points().iter().map(|held| u8::from(*held)));
    }
    layout.u8("scene_split", std::iter::once(scene.split().code()));
    if roles {
        // A scene has no roles without a code.
        layout.u8("unit_role", units.iter().filter_map(|unit| role_code(unit.role)));
    }
    if soft {
        layout.u8("unit_soft", units.iter().map(|unit| u8::from(unit.soft.is_some())));
    }

    let g = scene.gravity_m_s2();
    let shape_names: Vec<&str> = units.iter().map(|unit| unit.shape.as_str()).collect();
    let mut metadata = json!({
        "format": FORMAT,
        "version": VERSIONS[usize::from(ground.is_none())],
        "dataset": notes.dataset,
        "frame_rate_hz": scene.frame_rate_hz().to_string(),
        "gravity_m_s2": format!("{} {} {}", g.x, g.y, g.z),
        "shape_names": json!(shape_names).to_string(),
        "provenance": notes.provenance,
        "licence": notes.licence,
    });
    if let (Some(ground), Some(metadata)) = (ground, metadata.as_object_mut()) {
        metadata.insert("ground_friction".into(), ground.friction.to_string().into());
        metadata.insert("ground_restitution".into(), ground.restitution.to_string().into());
    }
    let law = scene.contact_law();
    // Programs that do not know it read files without it.
    if let (false, Some(metadata)) = (law.is_rigid(), metadata.as_object_mut()) {
        metadata.insert("contact_law".into(), law.to_string().into());
    }
    layout.header.insert("__metadata__".into(), metadata);

    let mut header = Value::Object(layout.header).to_string();
    // Eight bytes align the first tensor, and safetensors allows blanks after the header.
    while !header.len().is_multiple_of(8) {
        header.push(' ');
    }
    let mut bytes = (header.len() as u64).to_le_bytes().to_vec();
    bytes.extend(header.as_bytes());
    bytes.extend(layout.payload);
    Ok(bytes)
}
