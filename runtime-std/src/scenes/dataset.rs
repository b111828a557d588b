//! A scene file: checked once, then read scene by scene.

use std::borrow::Cow;
use std::ops::Range;
use std::path::{Path, PathBuf};

use nalgebra::Vector3;

use super::check::{Tensors, error};
use super::read::{Shape, Unit, read_pose, read_shapes, read_units};
use super::{Problem, RecordedScene, RecordedUnit, SceneError, Split};

pub(super) const FORMAT: &str = "rigidformer-scenes";
pub(super) const VERSION: &str = "1";
/// Numbers of a pose in a file: position x, y, z, quaternion w, x, y, z.
pub(super) const POSE_NUMBERS: usize = 7;

/// The scenes of one data set.
///
/// ```no_run
/// use rigidformer_runtime::scenes::{Dataset, Split};
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
    ground_friction: f32,
    ground_restitution: f32,
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
    /// Bytes of the file that hold (units, frames, 7) f32.
    poses: Range<usize>,
}

impl Dataset {
    /// Reads a scene file and checks all of it but the poses, which [`Dataset::scene`] checks.
    pub fn open(path: &Path) -> Result<Self, SceneError> {
        let unreadable = |source| error(path, "file", Problem::Unreadable(source));
        if path.is_dir() {
            return Err(unreadable(std::io::ErrorKind::IsADirectory.into()));
        }
        let bytes = std::fs::read(path).map_err(unreadable)?;
        Self::from_bytes(path, bytes)
    }

    /// A scene file that is in memory already; errors call it `name`.
    pub fn from_bytes(
        name: impl Into<PathBuf>,
        bytes: impl Into<Cow<'static, [u8]>>,
    ) -> Result<Self, SceneError> {
        let (path, bytes) = (name.into(), bytes.into());
        let file = Tensors::parse(&path, &bytes)?;
        file.require("format", FORMAT)?;
        file.require("version", VERSION)?;

        let [frame_rate_hz] = file.numbers("frame_rate_hz", "a number above 0")?;
        let gravity_m_s2 = file.numbers("gravity_m_s2", "three numbers")?;
        let [ground_friction] = file.numbers("ground_friction", "a number of at least 0")?;
        let [ground_restitution] = file.numbers("ground_restitution", "a number of at least 0")?;
        for (name, fine, expected) in [
            ("frame_rate_hz", frame_rate_hz > 0.0, "a number above 0"),
            ("ground_friction", ground_friction >= 0.0, "a number of at least 0"),
            ("ground_restitution", ground_restitution >= 0.0, "a number of at least 0"),
        ] {
            if !fine {
                let found = file.entry(name)?.into();
                return Err(
                    file.fail(format!("metadata {name}"), Problem::Unparsable { found, expected })
                );
            }
        }
        let shapes = read_shapes(&file)?;
        let units = read_units(&file, shapes.len())?;

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
            file.f32_place("unit_poses", [Some(units.len()), None, Some(POSE_NUMBERS)], &bytes)?;
        let [_, frames, _] = shape;
        if frames == 0 {
            return Err(
                file.fail("tensor unit_poses", Problem::TooFewFrames { recorded: 0, asked: 1 })
            );
        }
        let (name, provenance, licence) = (
            file.entry("dataset")?.into(),
            file.entry("provenance")?.into(),
            file.entry("licence")?.into(),
        );
        drop(file);
        Ok(Self {
            path,
            bytes,
            name,
            frame_rate_hz,
            gravity_m_s2,
            ground_friction,
            ground_restitution,
            provenance,
            licence,
            shapes,
            seeds,
            splits,
            scene_units,
            units,
            frames,
            poses,
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

    /// Friction coefficient of the ground plane z = 0.
    pub fn ground_friction(&self) -> f32 {
        self.ground_friction
    }

    /// Restitution coefficient of the ground plane.
    pub fn ground_restitution(&self) -> f32 {
        self.ground_restitution
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

    /// Frames of every scene, at least one.
    pub fn frames(&self) -> usize {
        self.frames
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

    /// A scene, with its first `frames` frames or all of them; its poses are checked here.
    pub fn scene(&self, index: usize, frames: Option<usize>) -> Result<RecordedScene, SceneError> {
        let field = || {
            format!("scene {index} (seed {})", self.seeds.get(index).copied().unwrap_or_default())
        };
        let fail = |field: String, problem| error(&self.path, field, problem);
        let rows = self.units_of(index).ok_or_else(|| {
            fail("scene index".into(), Problem::NoSuchScene { index, scenes: self.len() })
        })?;
        let asked = frames.unwrap_or(self.frames);
        if asked == 0 || asked > self.frames {
            return Err(fail(field(), Problem::TooFewFrames { recorded: self.frames, asked }));
        }
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
            units.push(RecordedUnit {
                shape: shape.name.clone(),
                points: shape.points.iter().map(|point| point * known.scale).collect(),
                physics: known.physics,
                poses,
            });
        }
        let seed = self.seeds.get(index).copied().unwrap_or_default();
        let split = self.split(index).unwrap_or(Split::Extra);
        let name = format!("{} seed {seed}", self.name);
        RecordedScene::new(
            name,
            seed,
            split,
            self.frame_rate_hz,
            Vector3::from(self.gravity_m_s2),
            units,
        )
        .map(|scene| scene.with_ground(self.ground_friction, self.ground_restitution))
        .map_err(|cause| SceneError { path: self.path.clone(), ..cause })
    }

    /// (frames, 7) f32 of a unit, as bytes.
    fn pose_bytes(&self, row: usize) -> Option<&[u8]> {
        let unit_bytes = self.frames.checked_mul(POSE_NUMBERS * 4)?;
        let start = self.poses.start.checked_add(row.checked_mul(unit_bytes)?)?;
        self.bytes.get(start..start.checked_add(unit_bytes)?)
    }
}
