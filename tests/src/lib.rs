//! What the suites in `tests/` share: golden files, models, scenes and a random source.
//!
//! This crate is for tests alone: it panics on what a test could not go on without.
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)]

/// The README, whose example must compile.
#[cfg(doctest)]
#[doc = include_str!("../../README.md")]
pub struct Readme;

pub mod bits;
/// What the image `drape` does, as the board compiles it.
#[path = "../../firmware-sim/firmware/src/drape.rs"]
pub mod drape;
pub mod firmware;
/// What the image `health` does, as the board compiles it.
#[path = "../../firmware-sim/firmware/src/health.rs"]
pub mod health;
pub mod hostile;
/// What the image `walk` does, as the board compiles it.
#[path = "../../firmware-sim/firmware/src/walk.rs"]
pub mod walk;
/// What the image `robot` does, as the board compiles it.
#[path = "../../firmware-sim/firmware/src/workcell.rs"]
pub mod workcell;

use nalgebra::{Isometry3, Point3, Quaternion, Translation3, UnitQuaternion, Vector3};
use rigidformer_core::{
    Limits, Model, ObserveError, Observed, Physics, Posed, Simulator, SlabSizes, Slabs, Unit,
    UnitSlot,
};
use rigidformer_evaluation::models::pack_bytes;
use rigidformer_evaluation::scenes::{Dataset, RecordedScene};
use rigidformer_weights::{
    AlignedBuffer, ModelConfig, ModelFile, ModelWriter, Similarity, TensorData,
};
use safetensors::SafeTensors;
use std::path::{Path, PathBuf};

/// A file of `tests/data`.
pub fn data(name: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("data").join(name)
}

/// A model of `tests/data`, packed as `rigidformer pack` packs it.
pub fn packed_model(name: &str) -> AlignedBuffer {
    let path = data(&format!("{name}.model.safetensors"));
    let bytes = std::fs::read(&path).expect("golden model");
    AlignedBuffer::copy_of(&pack_bytes(&path, &bytes).expect("golden model packs"))
}

/// A recorded scene with soft units, and what a simulator is told of it: points of all units in two frames.
pub struct Seen {
    /// The scene.
    pub scene: RecordedScene,
    step: u32,
    previous: Vec<Vec<Point3<f32>>>,
    current: Vec<Vec<Point3<f32>>>,
}

impl Seen {
    /// Frames from the first to the second one of the golden scene, and of its steps.
    pub const STEP: u32 = 5;

    /// The golden scene: a sheet of four patches over a fixed ball, a fixed box and a free ball.
    pub fn golden() -> Self {
        let file = Dataset::open(&data("tiny-soft.scene.safetensors")).expect("scene file");
        Self::of(file.scene(0, None).expect("scene"), Self::STEP)
    }

    /// The frames 0 and `step` of a scene.
    pub fn of(scene: RecordedScene, step: u32) -> Self {
        let at = |frame| scene.units().iter().map(|u| u.points_at(frame).expect("frame")).collect();
        let (previous, current) = (at(0), at(step as usize));
        Seen { scene, step, previous, current }
    }

    /// Seconds between the two.
    pub fn dt_s(&self) -> f32 {
        self.step as f32 / self.scene.frame_rate_hz()
    }

    /// Units as a simulator observes them.
    pub fn units(&self) -> Vec<Observed<'_>> {
        let frames = self.previous.iter().zip(&self.current);
        let units = self.scene.units().iter().zip(frames);
        let observed = units.map(|(recorded, (previous, current))| {
            let unit = Unit { points: previous, ..recorded.as_unit() };
            let soft = |young_pa| unit.soft(&recorded.points, young_pa);
            Observed { unit: recorded.young_pa.map_or(unit, soft), current }
        });
        observed.collect()
    }

    /// Has a simulator observe them, in the scene's world.
    ///
    /// # Errors
    /// Those of the observation.
    pub fn observe(&self, simulator: &mut Simulator<'_, '_>) -> Result<(), ObserveError> {
        // World first: an observation works out contacts with the planes that are there.
        simulator.set_gravity(self.scene.gravity_m_s2()).expect("gravity");
        simulator.set_planes(self.scene.planes().expect("planes")).expect("planes");
        simulator.set_contact_law(self.scene.contact_law()).expect("contact law");
        simulator.observe(self.dt_s(), self.units()).map(|_| ())
    }
}

/// A golden file: inputs and what PyTorch made of them in f64.
pub struct Golden {
    bytes: Vec<u8>,
    /// Step code of its rollout.
    pub step: u32,
}

/// Units as a golden file gives them.
pub struct Inputs {
    /// Points by unit, reference frame.
    pub points: Vec<Vec<Point3<f32>>>,
    /// Physics by unit.
    pub physics: Vec<Physics>,
    /// Poses of the previous frame.
    pub previous: Vec<Isometry3<f32>>,
    /// Poses of the current frame.
    pub current: Vec<Isometry3<f32>>,
}

impl Golden {
    /// Reads `tests/data/NAME.golden.safetensors`.
    pub fn read(name: &str) -> Self {
        let bytes = std::fs::read(data(&format!("{name}.golden.safetensors"))).expect("golden");
        let (_, metadata) = SafeTensors::read_metadata(&bytes).expect("golden header");
        let step = metadata.metadata().as_ref().expect("golden metadata")["step"].parse().unwrap();
        Golden { bytes, step }
    }

    fn tensors(&self) -> SafeTensors<'_> {
        SafeTensors::deserialize(&self.bytes).expect("golden tensors")
    }

    /// Whether there is such a tensor.
    pub fn has(&self, name: &str) -> bool {
        self.tensors().tensor(name).is_ok()
    }

    /// A tensor's values, and its shape.
    pub fn tensor(&self, name: &str) -> (Vec<f32>, Vec<usize>) {
        let file = self.tensors();
        let view = file.tensor(name).unwrap_or_else(|e| panic!("{name}: {e}"));
        let values = view.data().chunks_exact(4);
        (values.map(|b| f32::from_le_bytes(b.try_into().unwrap())).collect(), view.shape().to_vec())
    }

    /// A tensor of integers.
    pub fn integers(&self, name: &str) -> Vec<i64> {
        let file = self.tensors();
        let view = file.tensor(name).unwrap_or_else(|e| panic!("{name}: {e}"));
        let values = view.data().chunks_exact(8);
        values.map(|b| i64::from_le_bytes(b.try_into().unwrap())).collect()
    }

    /// Seconds of a step.
    pub fn dt_s(&self) -> f32 {
        // Files of models with other frame rates say the seconds themselves.
        if self.has("dt") { self.tensor("dt").0[0] } else { seconds(self.step) }
    }

    /// The command, where the model takes one.
    pub fn command(&self) -> Option<Vec<f32>> {
        self.tensors().names().contains(&"command").then(|| self.tensor("command").0)
    }

    /// Bonds the units that it bonds.
    pub fn bond(&self, simulator: &mut Simulator<'_, '_>) {
        let pairs = if self.has("bonds") { self.integers("bonds") } else { vec![] };
        for pair in pairs.as_chunks::<2>().0 {
            let pair = pair.map(|unit| simulator.unit(unit as usize).expect("a unit").id());
            simulator.bond(&[pair]).expect("a bond");
        }
    }

    /// The scene.
    pub fn inputs(&self) -> Inputs {
        let mut all = self.tensor("points").0.into_iter();
        let mut points = Vec::new();
        for count in self.integers("point_counts") {
            let mut next = || all.next().unwrap();
            points.push((0..count).map(|_| Point3::new(next(), next(), next())).collect());
        }
        let physics = self.tensor("physics").0;
        let physics = physics.chunks_exact(3).map(|p| Physics {
            mass_kg: p[0],
            friction: p[1],
            restitution: p[2],
        });
        let poses = |name| self.tensor(name).0.chunks_exact(7).map(isometry).collect();
        Inputs {
            points,
            physics: physics.collect(),
            previous: poses("previous"),
            current: poses("current"),
        }
    }
}

impl Inputs {
    /// Units with their poses, as the simulator takes them.
    pub fn posed(&self) -> Vec<Posed<'_>> {
        let units = self.points.iter().zip(&self.physics);
        let poses = self.previous.iter().zip(&self.current);
        let posed = units.zip(poses).map(|((points, physics), (previous, current))| Posed {
            unit: Unit::new(points, *physics),
            previous: *previous,
            current: *current,
        });
        posed.collect()
    }

    /// World points of every unit under the given poses.
    pub fn frame(&self, poses: &[Isometry3<f32>]) -> Vec<Vec<Point3<f32>>> {
        let units = self.points.iter().zip(poses);
        units.map(|(points, pose)| points.iter().map(|p| pose * p).collect()).collect()
    }

    /// The units in another order.
    pub fn permuted(&self, order: &[usize]) -> Inputs {
        Inputs {
            points: order.iter().map(|&i| self.points[i].clone()).collect(),
            physics: order.iter().map(|&i| self.physics[i]).collect(),
            previous: order.iter().map(|&i| self.previous[i]).collect(),
            current: order.iter().map(|&i| self.current[i]).collect(),
        }
    }
}

/// x y z, w x y z to an isometry.
pub fn isometry(row: &[f32]) -> Isometry3<f32> {
    let rotation = UnitQuaternion::new_normalize(Quaternion::new(row[3], row[4], row[5], row[6]));
    Isometry3::from_parts(Translation3::new(row[0], row[1], row[2]), rotation)
}

/// Units as two frames of points show them.
pub fn observed<'a>(
    physics: &[Physics],
    previous: &'a [Vec<Point3<f32>>],
    current: &'a [Vec<Point3<f32>>],
) -> Vec<Observed<'a>> {
    let frames = previous.iter().zip(current).zip(physics);
    let observed = frames.map(|((previous, current), physics)| Observed {
        unit: Unit::new(previous, *physics),
        current,
    });
    observed.collect()
}

/// Seconds of a step code of the models here.
pub fn seconds(step: u32) -> f32 {
    step as f32 / 240.0
}

/// Slabs of a simulator, filled with what nothing may depend on.
pub struct Room {
    numbers: Vec<f32>,
    bytes: Vec<i8>,
    points: Vec<Point3<f32>>,
    units: Vec<UnitSlot>,
}

impl Room {
    /// Of these lengths.
    pub fn new(sizes: SlabSizes) -> Self {
        Room {
            // A simulator that reads before it writes then gives NaN, which no test passes.
            numbers: vec![f32::NAN; sizes.f32],
            bytes: vec![-1; sizes.i8],
            points: vec![Point3::origin(); sizes.points],
            units: vec![UnitSlot::EMPTY; sizes.units],
        }
    }

    /// For a simulator.
    pub fn slabs(&mut self) -> Slabs<'_> {
        let Room { numbers, bytes, points, units } = self;
        Slabs { f32: numbers, i8: bytes, points, units }
    }
}

/// Runs `body` with a simulator of up to 16 units that works in slabs of its own.
pub fn with_simulator<R>(
    file: &[u8],
    points: usize,
    body: impl FnOnce(&mut Simulator<'_, '_>) -> R,
) -> R {
    let model = Model::load(file).expect("model loads");
    let limits = Limits { units: 16, points };
    let mut room = Room::new(SlabSizes::new(model.config(), limits));
    body(&mut Simulator::new(&model, limits, room.slabs()).expect("simulator"))
}

/// Largest position difference (m) and rotation angle (rad) between poses.
pub fn pose_difference(a: &[Isometry3<f32>], b: &[Isometry3<f32>]) -> (f32, f32) {
    let pairs = a.iter().zip(b);
    pairs.fold((0.0, 0.0), |(p, r), (a, b)| {
        // Rounding makes a unit quaternion longer than 1, where asin is NaN.
        let turn = (a.rotation.inverse() * b.rotation).imag().norm().min(1.0).asin() * 2.0;
        (f32::max(p, (a.translation.vector - b.translation.vector).norm()), f32::max(r, turn))
    })
}

/// Current poses of all units.
pub fn poses(simulator: &Simulator<'_, '_>) -> Vec<Isometry3<f32>> {
    simulator.units().map(|unit| unit.pose()).collect()
}

/// A small seeded random source: SplitMix64.
pub struct Random(pub u64);

impl Random {
    /// The next 64 bits.
    pub fn bits(&mut self) -> u64 {
        self.0 = self.0.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let mut z = self.0;
        z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        z ^ (z >> 31)
    }

    /// Uniform in [-1, 1).
    pub fn uniform(&mut self) -> f32 {
        // 24 bits are what f32 holds exactly.
        (self.bits() >> 40) as f32 / (1_u64 << 23) as f32 - 1.0
    }

    /// A vector with uniform coordinates in [-1, 1).
    pub fn vector(&mut self) -> Vector3<f32> {
        Vector3::new(self.uniform(), self.uniform(), self.uniform())
    }

    /// A uniform random rotation.
    pub fn rotation(&mut self) -> UnitQuaternion<f32> {
        loop {
            let q = Quaternion::new(self.uniform(), self.uniform(), self.uniform(), self.uniform());
            // Corners of the cube would make some rotations more frequent, so only the ball counts.
            if q.norm() > 0.1 && q.norm() < 1.0 {
                return UnitQuaternion::new_normalize(q);
            }
        }
    }

    /// A random order of 0..n.
    pub fn order(&mut self, n: usize) -> Vec<usize> {
        let mut order: Vec<usize> = (0..n).collect();
        for i in (1..n).rev() {
            order.swap(i, (self.bits() % (i as u64 + 1)) as usize);
        }
        order
    }
}

/// A packed model that measures scenes in their own length, or takes long steps in parts.
pub fn with_similarity(file: &[u8], similarity: Similarity) -> AlignedBuffer {
    let file = ModelFile::parse(file).expect("a model");
    let config = ModelConfig { similarity, ..*file.config() };
    let mut writer = ModelWriter::new(file.name(), config);
    for tensor in file.tensors() {
        writer = writer.tensor(tensor.name, tensor.shape, tensor.data);
    }
    AlignedBuffer::copy_of(&writer.finish().expect("packs"))
}

/// A packed f32 model whose head says nothing: what is left is the motion that the network corrects.
pub fn with_silent_head(file: &[u8]) -> AlignedBuffer {
    let file = ModelFile::parse(file).expect("a model");
    let mut writer = ModelWriter::new(file.name(), *file.config());
    let silence =
        vec![0.0; file.tensors().map(|tensor| tensor.shape.elements() as usize).max().unwrap_or(0)];
    for tensor in file.tensors() {
        let data = match tensor.name.starts_with("anchors.head.1") {
            // The last layer alone, so that all others run as ever.
            true => TensorData::F32(&silence[..tensor.shape.elements() as usize]),
            false => tensor.data,
        };
        writer = writer.tensor(tensor.name, tensor.shape, data);
    }
    AlignedBuffer::copy_of(&writer.finish().expect("packs"))
}
