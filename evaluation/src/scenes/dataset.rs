//! A scene file: checked once, then read scene by scene.

use std::borrow::Cow;
use std::collections::BTreeMap;
use std::ops::Range;
use std::path::{Path, PathBuf};

use nalgebra::{Isometry3, Point3, Vector3};
use rigidformer_core::kernels::in_own_environment;
use rigidformer_core::{Compliance, ContactLaw, Physics, Plane, Role};
use rigidformer_runtime::files::{FileError, read_whole};
use rigidformer_runtime::memory::{Budget, TooLarge};
use rigidformer_runtime::terrain::HeightFieldBuf;

use super::check::{Tensors, elements, error};
use super::read::{
    FileCommands, FileHeightFields, Listed, POSE_NUMBERS, Shape, Unit, read_bonds, read_commands,
    read_compliance, read_list, read_pieces, read_planes, read_pose, read_roles, read_scene_frames,
    read_shapes, read_units,
};
use super::recorded::{SoftMesh, only_ground};
use super::{Problem, RecordedBond, RecordedScene, RecordedUnit, SceneError, Split};

pub(super) const FORMAT: &str = "rigidformer-scenes";
/// Mass, friction and restitution.
const PHYSICS_NUMBERS: usize = 3;
/// Versions of the format, the first at 0.
pub(super) const VERSIONS: [&str; 2] = ["1", "2"];

/// The scenes of one data set.
///
/// ```no_run
/// use rigidformer_evaluation::scenes::{Dataset, Split};
/// let dataset = Dataset::open("movi-a.safetensors".as_ref())?;
/// for index in dataset.scenes_of(Split::Test) {
///     let scene = dataset.scene(index, Some(101))?;
///     println!("{}: {} units, {} points", scene.name(), scene.units().len(), scene.points());
/// }
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
pub struct Dataset {
    path: PathBuf,
    bytes: Cow<'static, [u8]>,
    name: String,
    frame_rate_hz: f32,
    gravity_m_s2: [f32; 3],
    version: u32,
    contact_law: ContactLaw,
    /// Planes of all scenes.
    planes: Vec<Plane>,
    /// Of each of them, where files have it.
    plane_compliance: Vec<Compliance>,
    /// (scenes + 1) as `scene_units`; `None`: every scene has all planes.
    scene_planes: Option<Vec<usize>>,
    /// Numbers in a command, (scenes, frames, numbers)
    commands: Option<FileCommands>,
    height_fields: FileHeightFields,
    provenance: String,
    licence: String,
    shapes: Vec<Shape>,
    /// (scenes)
    seeds: Vec<i64>,
    /// (scenes)
    splits: Vec<Split>,
    /// (scenes + 1) scene s owns units scene_units[s]..scene_units[s + 1]
    scene_units: Vec<usize>,
    /// (units)
    units: Vec<Unit>,
    frames: usize,
    /// (scenes) How many of the frames were recorded; `None`: all.
    scene_frames: Option<Vec<usize>>,
    /// Bytes of the file that hold (units, frames, 7) f32.
    poses: Range<usize>,
    /// (units) First row of a soft unit in the file's soft points.
    soft_rows: Vec<Option<usize>>,
    /// Bytes of the file that hold (soft points, frames, 3) f32.
    soft_points: Range<usize>,
    mesh: FileMesh,
    bonds: Listed<2>,
    /// (bonds) The first frame in which each is broken.
    bond_frames: Vec<usize>,
}

/// Meshes of all scenes, in rows of the file's soft points.
struct FileMesh {
    faces: Listed<3>,
    edges: Listed<2>,
    tetrahedra: Listed<4>,
}

impl FileMesh {
    /// Reads what the file has. `ranges` (scenes) says which soft points a scene has.
    fn read(file: &Tensors<'_>, ranges: &[Range<usize>]) -> Result<Self, SceneError> {
        let three = "three different rows of soft_points, of its scene";
        let two = "two different rows of soft_points, of its scene";
        let four = "four different rows of soft_points, of its scene";
        Ok(Self {
            faces: read_list(file, ("faces", "scene_faces"), ranges, three)?,
            edges: read_list(file, ("edges", "scene_edges"), ranges, two)?,
            tetrahedra: read_list(file, ("tetrahedra", "scene_tetrahedra"), ranges, four)?,
        })
    }
}

impl Dataset {
    /// Reads a scene file and checks all of it but the poses, which [`Dataset::scene`] checks.
    pub fn open(path: &Path) -> Result<Self, SceneError> {
        let unreadable = |failed: FileError| {
            let source = failed.source;
            let inner = source.get_ref().and_then(|inner| inner.downcast_ref::<TooLarge>());
            let problem = match inner {
                Some(large) => Problem::Memory(*large),
                None => Problem::Unreadable(source),
            };
            error(path, "file", problem)
        };
        Self::from_bytes(path, read_whole(path).map_err(unreadable)?)
    }

    /// A scene file that is in memory already; errors call it `name`.
    pub fn from_bytes(
        name: impl Into<PathBuf>,
        bytes: impl Into<Cow<'static, [u8]>>,
    ) -> Result<Self, SceneError> {
        // What is refused does not depend on who reads it.
        in_own_environment(|| Self::checked(name.into(), bytes.into()))
    }

    fn checked(path: PathBuf, bytes: Cow<'static, [u8]>) -> Result<Self, SceneError> {
        let file = Tensors::parse(&path, &bytes)?;
        // First of all, so that another kind of file is named and not its missing entries.
        file.require("format", [FORMAT], FORMAT)?;
        let index = file.require("version", VERSIONS, "1 or 2")?;
        let version = if index == 0 { 1 } else { 2 };

        let [frame_rate_hz] = file.numbers("frame_rate_hz", "a number above 0")?;
        let gravity_m_s2 = file.numbers("gravity_m_s2", "three numbers")?;
        if frame_rate_hz <= 0.0 {
            return Err(unparsable(&file, "frame_rate_hz", "a number above 0"));
        }
        let contact_law = read_contact_law(&file)?;
        let mut shapes = read_shapes(&file)?;
        let mut units = read_units(&file, shapes.len())?;
        // Tensors of these names mean nothing in a file of version 1.
        if version > 1 {
            read_roles(&file, &mut units)?;
            read_pieces(&file, &mut shapes)?;
        }

        let ([scenes], seeds) = file.i64("scene_seed", [None])?;
        let (_, codes) = file.u8("scene_split", [Some(scenes)])?;
        let mut splits = Vec::with_capacity(scenes);
        for (row, code) in codes.into_iter().enumerate() {
            splits.push(
                Split::from_code(code)
                    .ok_or_else(|| file.bad_value("scene_split", row, code, "0, 1, 2 or 3"))?,
            );
        }
        let scene_units = file.offsets("scene_units", scenes, units.len())?;
        let (shape, poses) =
            file.f32_range("unit_poses", [Some(units.len()), None, Some(POSE_NUMBERS)], &bytes)?;
        let [_, frames, _] = shape;
        // A scene without a frame has no pose to start from.
        if frames == 0 {
            return Err(
                file.fail("tensor unit_poses", Problem::TooFewFrames { recorded: 0, asked: 1 })
            );
        }
        // Files of version 1 have one ground, which their metadata describe.
        let mut plane_compliance = Vec::new();
        let (planes, scene_planes, commands, scene_frames) = if version == 1 {
            (vec![read_ground(&file)?], None, None, None)
        } else {
            let (planes, scene_planes) = read_planes(&file, scenes)?;
            if file.has("plane_compliance") {
                plane_compliance = read_compliance(&file, "plane_compliance", planes.len())?;
            }
            let commands = read_commands(&file, scenes, frames)?;
            (planes, Some(scene_planes), commands, read_scene_frames(&file, scenes, frames)?)
        };
        let height_fields = match version > 1 && file.has("height_fields") {
            true => FileHeightFields::read(&file, scenes)?,
            false => FileHeightFields::default(),
        };
        let mut soft = 0usize;
        let mut soft_rows = Vec::with_capacity(units.len());
        for unit in &units {
            soft_rows.push(unit.soft.then_some(soft));
            let points = shapes.get(unit.shape).map_or(0, |shape| shape.points.len());
            // Saturating: numbers of a hostile file must not wrap round to a row that exists.
            soft = soft.saturating_add(if unit.soft { points } else { 0 });
        }
        let mut soft_points = 0..0;
        // Points without a soft unit are a mistake that is named.
        if version > 1 && (soft > 0 || file.has("soft_points")) {
            let shape = [None, Some(frames), Some(3)];
            let ([found, ..], range) = file.f32_range("soft_points", shape, &bytes)?;
            if found != soft {
                let problem = Problem::SoftPoints { found, expected: soft };
                return Err(file.fail("tensor soft_points", problem));
            }
            soft_points = range;
        }
        let ranges = |starts: &[usize]| -> Vec<Range<usize>> {
            starts.iter().zip(starts.iter().skip(1)).map(|(start, end)| *start..*end).collect()
        };
        // Tensors of these names mean nothing in version 1.
        let (mesh, (bonds, bond_frames)) = if version == 1 {
            let (faces, edges, tetrahedra) = (Listed::none(), Listed::none(), Listed::none());
            (FileMesh { faces, edges, tetrahedra }, (Listed::none(), Vec::new()))
        } else {
            let of_points = ranges(&soft_starts(&scene_units, &units, &shapes));
            let mesh = FileMesh::read(&file, &of_points)?;
            (mesh, read_bonds(&file, &ranges(&scene_units), frames)?)
        };
        let (name, provenance, licence) = (
            file.entry("dataset")?.into(),
            file.entry("provenance")?.into(),
            file.entry("licence")?.into(),
        );
        // The tensors borrow the bytes, which move into the data set.
        drop(file);
        Ok(Self {
            path,
            bytes,
            name,
            frame_rate_hz,
            gravity_m_s2,
            version,
            contact_law,
            planes,
            plane_compliance,
            scene_planes,
            commands,
            height_fields,
            provenance,
            licence,
            shapes,
            seeds,
            splits,
            scene_units,
            units,
            frames,
            scene_frames,
            poses,
            soft_rows,
            soft_points,
            mesh,
            bonds,
            bond_frames,
        })
    }

    /// Where it was read from.
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// Name of the data set, such as `movi-a`.
    pub fn name(&self) -> &str {
        &self.name
    }

    /// Frames per second.
    pub fn frame_rate_hz(&self) -> f32 {
        self.frame_rate_hz
    }

    /// Gravity, m/s².
    pub fn gravity_m_s2(&self) -> [f32; 3] {
        self.gravity_m_s2
    }

    /// How contacts that bounce differ from rigid ones in what recorded the scenes.
    pub fn contact_law(&self) -> ContactLaw {
        self.contact_law
    }

    /// Version of the format that the file is written in, 1 or 2.
    pub fn version(&self) -> u32 {
        self.version
    }

    /// How contact with each of a scene's planes gives way; nothing where files do not say it.
    fn plane_compliance_of(&self, index: usize) -> &[Compliance] {
        let rows = self
            .scene_planes
            .as_ref()
            .and_then(|rows| Some(*rows.get(index)?..*rows.get(index.checked_add(1)?)?));
        rows.and_then(|rows| self.plane_compliance.get(rows)).unwrap_or_default()
    }

    /// The planes of a scene; a scene of version 1 has the ground, the plane z = 0.
    pub fn planes_of(&self, index: usize) -> Option<&[Plane]> {
        match &self.scene_planes {
            Some(rows) => self.planes.get(*rows.get(index)?..*rows.get(index.checked_add(1)?)?),
            None => (index < self.len()).then_some(&self.planes),
        }
    }

    /// The ground of varying height of a scene.
    pub fn height_field_of(&self, index: usize) -> Option<&HeightFieldBuf> {
        self.height_fields.of(index)
    }

    /// The plane z = 0, if that is the only plane of every scene.
    pub fn ground(&self) -> Option<Plane> {
        let ground = only_ground(self.planes_of(0)?)?;
        (0..self.len()).all(|index| self.planes_of(index) == Some(&[ground])).then_some(ground)
    }

    /// Numbers in a command; 0 for a file without commands.
    pub fn command_size(&self) -> usize {
        self.commands.as_ref().map_or(0, |commands| commands.size)
    }

    /// Units of all scenes that have a role.
    pub fn units_in_role(&self, role: Role) -> usize {
        self.units.iter().filter(|unit| unit.role == role).count()
    }

    /// Units of all scenes that are soft.
    pub fn soft_units(&self) -> usize {
        self.units.iter().filter(|unit| unit.soft).count()
    }

    /// The least and the greatest Young's modulus of soft units, Pa; `None` where none is known.
    pub fn young_pa(&self) -> Option<(f32, f32)> {
        let known = self.units.iter().filter_map(|unit| unit.young_pa);
        known.fold(None, |range: Option<(f32, f32)>, young| {
            let (least, greatest) = range.unwrap_or((young, young));
            Some((least.min(young), greatest.max(young)))
        })
    }

    /// Points of the soft units of all scenes.
    pub fn soft_points(&self) -> usize {
        let soft = self.units.iter().filter(|unit| unit.soft);
        soft.filter_map(|unit| self.shapes.get(unit.shape)).map(|shape| shape.points.len()).sum()
    }

    /// Faces, edges and tetrahedra of the soft units of all scenes.
    pub fn mesh_sizes(&self) -> [usize; 3] {
        [self.mesh.faces.len(), self.mesh.edges.len(), self.mesh.tetrahedra.len()]
    }

    /// Bonds of all scenes, and how many of them break within the record.
    pub fn bonds(&self) -> (usize, usize) {
        let breaking = |scene: usize| {
            let frames = self.frames_of(scene).unwrap_or(self.frames);
            let own = self.bond_frames.get(self.bonds.rows_of(scene)).unwrap_or_default();
            own.iter().filter(|frame| **frame < frames).count()
        };
        (self.bonds.len(), (0..self.len()).map(breaking).sum())
    }

    /// Bodies of a scene, and how many of its units belong to bodies of two units and more.
    pub fn bodies_of(&self, index: usize) -> Option<(usize, usize)> {
        let units = self.units.get(self.units_of(index)?)?;
        let mut sizes = BTreeMap::new();
        for body in units.iter().filter_map(|unit| unit.body) {
            *sizes.entry(body).or_insert(0usize) += 1;
        }
        let single = units.iter().filter(|unit| unit.body.is_none()).count();
        Some((single + sizes.len(), sizes.into_values().filter(|size| *size > 1).sum()))
    }

    /// Where the scenes come from.
    pub fn provenance(&self) -> &str {
        &self.provenance
    }

    /// Under which terms they may be used.
    pub fn licence(&self) -> &str {
        &self.licence
    }

    /// Scenes in the file.
    pub fn len(&self) -> usize {
        self.seeds.len()
    }

    /// Whether it has no scenes.
    pub fn is_empty(&self) -> bool {
        self.seeds.is_empty()
    }

    /// Units of all scenes.
    pub fn units(&self) -> usize {
        self.units.len()
    }

    /// Frames of the longest scene, at least one.
    pub fn frames(&self) -> usize {
        self.scene_frames.iter().flatten().copied().max().unwrap_or(self.frames)
    }

    /// Recorded frames of a scene, at least one.
    pub fn frames_of(&self, index: usize) -> Option<usize> {
        match &self.scene_frames {
            Some(frames) => frames.get(index).copied(),
            None => (index < self.len()).then_some(self.frames),
        }
    }

    /// Whether the velocities of all units at frame 0 are known.
    pub fn has_velocities(&self) -> bool {
        self.units.iter().all(|unit| unit.velocity.is_some())
    }

    /// Units, of all scenes, whose moments of inertia are known.
    pub fn units_with_inertia(&self) -> usize {
        self.units.iter().filter(|unit| unit.inertia.is_some()).count()
    }

    /// Units, of all scenes, that touch with several convex pieces.
    pub fn units_in_pieces(&self) -> usize {
        let shape = |unit: &&Unit| self.shapes.get(unit.shape);
        let in_pieces = |shape: &Shape| !shape.pieces.is_empty();
        self.units.iter().filter(|unit| shape(unit).is_some_and(in_pieces)).count()
    }

    /// Name and number of points of every shape.
    pub fn shapes(&self) -> impl Iterator<Item = (&str, usize)> {
        self.shapes.iter().map(|shape| (shape.name.as_str(), shape.points.len()))
    }

    /// Split of a scene.
    pub fn split(&self, index: usize) -> Option<Split> {
        self.splits.get(index).copied()
    }

    /// Seed of a scene.
    pub fn seed(&self, index: usize) -> Option<i64> {
        self.seeds.get(index).copied()
    }

    /// Units of a scene, as rows of the file's unit tensors.
    pub fn units_of(&self, index: usize) -> Option<Range<usize>> {
        Some(*self.scene_units.get(index)?..*self.scene_units.get(index.checked_add(1)?)?)
    }

    /// Indices of a split's scenes, ascending.
    pub fn scenes_of(&self, split: Split) -> Vec<usize> {
        self.splits
            .iter()
            .enumerate()
            .filter(|(_, found)| **found == split)
            .map(|(index, _)| index)
            .collect()
    }

    /// The bytes of the file.
    pub fn bytes(&self) -> &[u8] {
        &self.bytes
    }

    /// The bytes of the same file with other physics of some units, by scene and unit. Units that are not there are left out.
    ///
    /// # Errors
    /// [`SceneError`] where a mass is not above 0, or a coefficient is below 0 or not finite.
    ///
    /// ```no_run
    /// use rigidformer_core::Physics;
    /// use rigidformer_evaluation::scenes::Dataset;
    /// use rigidformer_runtime::files::write_whole;
    /// let dataset = Dataset::open("tracked.safetensors".as_ref())?;
    /// let rubber = Physics { mass_kg: 0.2, friction: 0.9, restitution: 0.6 };
    /// let bytes = dataset.with_physics(&[((0, 3), rubber)].into())?; // of the first scene, its fourth unit
    /// write_whole("identified.safetensors".as_ref(), &bytes)?;
    /// # Ok::<(), Box<dyn std::error::Error>>(())
    /// ```
    pub fn with_physics(
        &self,
        changes: &BTreeMap<(usize, usize), Physics>,
    ) -> Result<Vec<u8>, SceneError> {
        let file = Tensors::parse(&self.path, &self.bytes)?;
        let shape = [Some(self.units.len()), Some(PHYSICS_NUMBERS)];
        let (_, range) = file.f32_range("unit_physics", shape, &self.bytes)?;
        let mut bytes = self.bytes.to_vec();
        for ((scene, unit), physics) in changes {
            let rows = self.units_of(*scene).unwrap_or_default();
            let Some(row) = rows.clone().nth(*unit) else { continue };
            let Physics { mass_kg, friction, restitution } = *physics;
            let numbers = [mass_kg, friction, restitution];
            // What is written must be what `open` accepts.
            let sound = in_own_environment(|| {
                numbers.iter().all(|v| v.is_finite() && *v >= 0.0) && mass_kg > 0.0
            });
            if !sound {
                let expected = "a mass above 0, and a friction and restitution of at least 0";
                return Err(file.bad_value("unit_physics", row, format!("{numbers:?}"), expected));
            }
            let start = range.start + row * PHYSICS_NUMBERS * 4;
            let slots = bytes.get_mut(start..start + PHYSICS_NUMBERS * 4).unwrap_or_default();
            for (slot, number) in slots.chunks_exact_mut(4).zip(numbers) {
                slot.copy_from_slice(&number.to_le_bytes());
            }
        }
        Ok(bytes)
    }

    /// The error for a split that no scene is in.
    pub(crate) fn none_in(&self, split: Split) -> SceneError {
        error(&self.path, "scene_split", Problem::NoneInSplit(split))
    }

    /// A scene, with its first `frames` frames or all that were recorded; its poses are checked here.
    ///
    /// # Errors
    /// [`SceneError`], also for a scene that takes more memory than [`memory::limit`](rigidformer_runtime::memory::limit).
    pub fn scene(&self, index: usize, frames: Option<usize>) -> Result<RecordedScene, SceneError> {
        self.scene_within(index, frames, &mut Budget::default())
    }

    /// As [`scene`](Self::scene), counted in a budget that several scenes share: a file may have many scenes with the same large shape,
    /// which each of them copies.
    ///
    /// # Errors
    /// As [`scene`](Self::scene), for the memory of this scene and those before.
    pub fn scene_within(
        &self,
        index: usize,
        frames: Option<usize>,
        budget: &mut Budget,
    ) -> Result<RecordedScene, SceneError> {
        in_own_environment(|| self.scene_here(index, frames, budget))
    }

    fn scene_here(
        &self,
        index: usize,
        frames: Option<usize>,
        budget: &mut Budget,
    ) -> Result<RecordedScene, SceneError> {
        let field = || {
            format!("scene {index} (seed {})", self.seeds.get(index).copied().unwrap_or_default())
        };
        let fail = |field: String, problem| error(&self.path, field, problem);
        let rows = self.units_of(index).ok_or_else(|| {
            fail("scene index".into(), Problem::NoSuchScene { index, scenes: self.len() })
        })?;
        let recorded = self.frames_of(index).unwrap_or(self.frames);
        let asked = frames.unwrap_or(recorded);
        // Frames beyond the scene's own repeat its last pose and are no record.
        if asked == 0 || asked > recorded {
            return Err(fail(field(), Problem::TooFewFrames { recorded, asked }));
        }
        budget
            .take(self.scene_bytes(index, rows.clone(), asked))
            .map_err(|large| fail(field(), large.into()))?;
        let mut units = Vec::with_capacity(rows.len());
        for (unit, row) in rows.enumerate() {
            let (Some(known), Some(bytes)) = (self.units.get(row), self.pose_bytes(row)) else {
                return Err(fail(field(), Problem::Missing));
            };
            let Some(shape) = self.shapes.get(known.shape) else {
                return Err(fail(field(), Problem::Missing));
            };
            let mut poses = Vec::with_capacity(asked);
            for (frame, numbers) in bytes.chunks_exact(POSE_NUMBERS * 4).take(asked).enumerate() {
                poses.push(read_pose(numbers).map_err(|what| {
                    fail(
                        format!("tensor unit_poses, {}", field()),
                        Problem::BadPose { unit, frame, what },
                    )
                })?);
            }
            // A reader that does not know `scene_frames` must see bodies that stop, and none that
            // jump.
            if let Some(frame) = first_after_the_end(bytes, recorded) {
                let what = "another pose than the last recorded one, and scene_frames says that none was recorded";
                let problem = Problem::BadPose { unit, frame, what };
                return Err(fail(format!("tensor unit_poses, {}", field()), problem));
            }
            let soft = match self.soft_rows.get(row).copied().flatten() {
                Some(first) => Some(self.soft_frames(first, shape.points.len(), asked, &field)?),
                None => None,
            };
            units.push(RecordedUnit {
                shape: shape.name.clone(),
                points: shape.points.iter().map(|point| point * known.scale).collect(),
                physics: known.physics,
                role: known.role,
                body: known.body,
                poses,
                soft,
                young_pa: known.young_pa,
                velocity: known.velocity,
                inertia: known.inertia,
                compliance: known.compliance,
                pieces: shape
                    .pieces
                    .iter()
                    .map(|piece| piece.iter().map(|point| point * known.scale).collect())
                    .collect(),
            });
        }
        let seed = self.seeds.get(index).copied().unwrap_or_default();
        let split = self.split(index).unwrap_or(Split::Extra);
        let name = format!("{} seed {seed}", self.name);
        let gravity = Vector3::from(self.gravity_m_s2);
        let in_file = |cause: SceneError| {
            // Errors name the tensor where there is one to correct.
            let moves = matches!(cause.problem, Problem::FixedMoves { .. });
            let field = if moves { format!("tensor unit_poses, {}", field()) } else { cause.field };
            fail(field, cause.problem)
        };
        let scene = RecordedScene::new(name, seed, split, self.frame_rate_hz, gravity, units)
            .map_err(in_file)?
            .with_checked_contact_law(self.contact_law)
            .with_checked_height_field(self.height_field_of(index).cloned())
            .with_checked_planes(self.planes_of(index).unwrap_or_default().to_vec())
            .with_checked_plane_compliance(self.plane_compliance_of(index).to_vec())
            .with_checked_mesh(self.mesh_of(index))
            .with_checked_bonds(self.bonds_of(index));
        let Some(FileCommands { size, values, set_points }) = &self.commands else {
            return Ok(scene);
        };
        // Commands lie by scene and frame, as many frames for each scene.
        let rows = values.chunks_exact(*size).skip(index.saturating_mul(self.frames)).take(asked);
        scene
            .with_commands(*size, rows.flatten().copied().collect())
            .and_then(|scene| scene.with_set_points(set_points.clone()))
            .map_err(in_file)
    }

    /// What the first frames of a scene take in memory.
    fn scene_bytes(&self, index: usize, rows: Range<usize>, frames: usize) -> u64 {
        let all = |count: usize, size: usize| (count as u64).saturating_mul(size as u64);
        let point = size_of::<Point3<f32>>();
        let of_unit = |unit: &Unit| {
            let Some(shape) = self.shapes.get(unit.shape) else { return 0 };
            let points = all(shape.points.len(), point);
            // A piece is a list of its own before it is one of the unit's.
            let pieces = all(shape.pieces.iter().map(Vec::len).sum(), 2 * point)
                .saturating_add(all(shape.pieces.len(), size_of::<Vec<Point3<f32>>>()));
            let frame = match unit.soft {
                true => points.saturating_add(size_of::<Vec<Point3<f32>>>() as u64),
                false => 0,
            };
            let frame = frame.saturating_add(size_of::<Isometry3<f32>>() as u64);
            (size_of::<RecordedUnit>() as u64)
                .saturating_add(shape.name.len() as u64)
                .saturating_add(points)
                .saturating_add(pieces)
                .saturating_add(frame.saturating_mul(frames as u64))
        };
        let units = self.units.get(rows).unwrap_or_default();
        let units = units.iter().map(of_unit).fold(0, u64::saturating_add);
        let lists = [
            all(self.mesh.faces.rows_of(index).len(), size_of::<[usize; 3]>()),
            all(self.mesh.edges.rows_of(index).len(), size_of::<[usize; 2]>()),
            all(self.mesh.tetrahedra.rows_of(index).len(), size_of::<[usize; 4]>()),
            all(self.bonds.rows_of(index).len(), 2 * size_of::<RecordedBond>()),
            all(frames.saturating_mul(self.command_size()), size_of::<f32>()),
            all(self.command_size(), size_of::<bool>()),
        ];
        lists.into_iter().fold(units, u64::saturating_add)
    }

    /// The mesh of a scene's soft units.
    fn mesh_of(&self, index: usize) -> SoftMesh {
        let mut rows = self.units_of(index).unwrap_or_default();
        // Files count points over all scenes, and a scene counts its own from 0.
        let first = rows.find_map(|row| self.soft_rows.get(row).copied().flatten());
        let start = first.unwrap_or_default();
        SoftMesh {
            faces: self.mesh.faces.of(index, start),
            edges: self.mesh.edges.of(index, start),
            tetrahedra: self.mesh.tetrahedra.of(index, start),
        }
    }

    /// The bonds of a scene's units.
    fn bonds_of(&self, index: usize) -> Vec<RecordedBond> {
        let start = self.units_of(index).unwrap_or_default().start;
        let frames = self.bond_frames.get(self.bonds.rows_of(index)).unwrap_or_default();
        let pairs = self.bonds.of(index, start).into_iter().zip(frames);
        pairs.map(|(units, frame)| RecordedBond { units, breaks_at: Some(*frame) }).collect()
    }

    /// (frames, points) The first frames of a soft unit's points, whose rows begin at `first`.
    fn soft_frames(
        &self,
        first: usize,
        points: usize,
        frames: usize,
        scene: &dyn Fn() -> String,
    ) -> Result<Vec<Vec<Point3<f32>>>, SceneError> {
        let field = || format!("tensor soft_points, {}", scene());
        let missing = || error(&self.path, field(), Problem::Missing);
        let file = self.bytes.get(self.soft_points.clone()).ok_or_else(missing)?;
        let mut recorded = vec![Vec::with_capacity(points); frames];
        // Files lie by point and frame, and scenes by frame and point.
        let rows = file.chunks_exact(self.frames.saturating_mul(3 * 4).max(1));
        for (row, bytes) in rows.enumerate().skip(first).take(points) {
            for (frame, (numbers, points)) in
                bytes.chunks_exact(3 * 4).zip(&mut recorded).enumerate()
            {
                let mut point = Point3::origin();
                for (coordinate, bytes) in point.iter_mut().zip(elements(numbers)) {
                    *coordinate = f32::from_le_bytes(bytes);
                }
                // Points are most of a file, so they are checked when a scene is read and not on
                // opening.
                if !point.iter().all(|coordinate| coordinate.is_finite()) {
                    let value = format!("{:?} at frame {frame}", <[f32; 3]>::from(point.coords));
                    let problem = Problem::BadValue { row, value, expected: "finite" };
                    return Err(error(&self.path, field(), problem));
                }
                points.push(point);
            }
        }
        Ok(recorded)
    }

    /// (frames, 7) f32 of a unit, as bytes.
    fn pose_bytes(&self, row: usize) -> Option<&[u8]> {
        let unit_bytes = self.frames.checked_mul(POSE_NUMBERS * 4)?;
        let start = self.poses.start.checked_add(row.checked_mul(unit_bytes)?)?;
        self.bytes.get(start..start.checked_add(unit_bytes)?)
    }
}

/// (scenes + 1) Scene s has the soft points `starts[s] .. starts[s + 1]`.
fn soft_starts(scene_units: &[usize], units: &[Unit], shapes: &[Shape]) -> Vec<usize> {
    let points = |unit: &Unit| {
        let shape = shapes.get(unit.shape).filter(|_| unit.soft);
        shape.map_or(0, |shape| shape.points.len())
    };
    let scenes = scene_units.iter().zip(scene_units.iter().skip(1));
    let counts = scenes.map(|(start, end)| units.get(*start..*end).unwrap_or_default());
    let mut starts = vec![0];
    starts.extend(counts.scan(0usize, |sum, own| {
        *sum = own.iter().map(points).fold(*sum, usize::saturating_add);
        Some(*sum)
    }));
    starts
}

/// The first frame after `recorded` ones in a unit's poses that does not repeat the last one.
fn first_after_the_end(poses: &[u8], recorded: usize) -> Option<usize> {
    let mut rest =
        poses.chunks_exact(POSE_NUMBERS * 4).enumerate().skip(recorded.saturating_sub(1));
    let (_, last) = rest.next()?;
    rest.find(|(_, pose)| *pose != last).map(|(frame, _)| frame)
}

fn unparsable(file: &Tensors<'_>, name: &str, expected: &'static str) -> SceneError {
    let found = file.entry(name).unwrap_or_default().into();
    file.fail(format!("metadata {name}"), Problem::Unparsable { found, expected })
}

/// How contacts differ from rigid ones; files that do not say it have rigid ones.
fn read_contact_law(file: &Tensors<'_>) -> Result<ContactLaw, SceneError> {
    let expected =
        "a number from 0 to 1, with `,pyramid` behind it or without, such as 0.03,pyramid";
    match file.has_entry("contact_law") {
        true => file
            .entry("contact_law")?
            .parse()
            .map_err(|_| unparsable(file, "contact_law", expected)),
        false => Ok(ContactLaw::RIGID),
    }
}

/// The one plane of all scenes of version 1.
fn read_ground(file: &Tensors<'_>) -> Result<Plane, SceneError> {
    let coefficient = |name| {
        let expected = "a number of at least 0";
        let [value] = file.numbers(name, expected)?;
        if value < 0.0 { Err(unparsable(file, name, expected)) } else { Ok(value) }
    };
    Ok(Plane::ground(coefficient("ground_friction")?, coefficient("ground_restitution")?))
}
