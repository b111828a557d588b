//! Small models, damaged models and what is done to them: for the tests and for `fuzz/`.

use crate::{Random, Room, seconds};
use nalgebra::{Isometry3, Point3};
use rigidformer_core::{
    ANCHORS, Limits, LoadError, Model, Observed, Physics, Simulator, SlabSizes, Unit,
};
use rigidformer_weights::{
    AlignedBuffer, Directions, Elastic, FeatureSet, Hidden, ModelConfig, ModelWriter, Motion,
    Scales, Shape, Similarity, TensorData,
};
use std::collections::BTreeMap;

/// About as small as a model with every part can be.
pub const SMALLEST: ModelConfig = ModelConfig {
    width: 4,
    heads: 1,
    head_dim: 6,
    blocks: 1,
    point_width: 4,
    registers: 1,
    feed_forward_width: 3,
    avp_width: 2,
    film_width: 2,
    command_size: 1,
    rope_frequencies: 1,
    scales: Scales(0b11),
    features: FeatureSet::Contact,
    motion: Motion::Free,
    gate: true,
    output_scale: 1.0,
    frame_rate_hz: 240.0,
    gravity_m_s2: [0.0, 0.0, -10.0],
    ground_friction: 0.3,
    ground_restitution: 0.5,
    hidden: Hidden::DEFAULT,
    similarity: Similarity::OFF,
    directions: Directions::NONE,
    elastic: Elastic::NONE,
    bonds: 0,
    scope: rigidformer_weights::Scope::All,
    most_units: 0,
};

/// As [`SMALLEST`], told of impacts between hulls: the geometry that sees what is observed first.
pub const SMALLEST_IMPACT: ModelConfig =
    ModelConfig { features: FeatureSet::Impact, command_size: 0, ..SMALLEST };

/// As [`SMALLEST`], of soft bodies.
pub const SMALLEST_SOFT: ModelConfig = ModelConfig {
    features: FeatureSet::Soft,
    motion: Motion::Soft,
    gate: false,
    command_size: 0,
    elastic: Elastic {
        neighbours: 2,
        falloff: 1,
        thickness_m: 0.0,
        stiffness: 1.0,
        damping_s: 0.01,
        skin_m: 0.005,
        rate_hz: 120.0,
        strain_sweeps: 1,
        strain_limit: 0.1,
    },
    ..SMALLEST
};

/// As [`SMALLEST_IMPACT`], which moves by impulses and breaks bonds.
pub const SMALLEST_BONDS: ModelConfig =
    ModelConfig { motion: Motion::Impulses, gate: false, bonds: 3, ..SMALLEST_IMPACT };

/// As [`SMALLEST_IMPACT`], which moves by impulses and sees what is in contact.
pub const SMALLEST_NEAR: ModelConfig = ModelConfig {
    motion: Motion::Impulses,
    gate: false,
    scope: rigidformer_weights::Scope::Near,
    ..SMALLEST_IMPACT
};

/// A packed f32 model of a configuration with seeded random tensors. It finds out which tensors
/// there are by asking the loader, over and over, what it misses.
pub fn random_model(config: ModelConfig, seed: u64) -> AlignedBuffer {
    let mut tensors: BTreeMap<String, (Shape, Vec<f32>)> = BTreeMap::new();
    let mut random = Random(seed);
    loop {
        let mut writer = ModelWriter::new("random", config);
        for (name, (shape, values)) in &tensors {
            writer = writer.tensor(name, *shape, TensorData::F32(values));
        }
        let file = AlignedBuffer::copy_of(&writer.finish().expect("sound model"));
        // The loader's errors name what is missing, so that no list of tensors is kept twice.
        let Some(missing) = Model::load(&file).err() else { return file };
        let (tensor, shape) = match missing {
            LoadError::MissingTensor(tensor) => (tensor, Shape::Vector(1)),
            LoadError::Shape { tensor, expected: [rows, 1], .. } => (tensor, Shape::Vector(rows)),
            LoadError::Shape { tensor, expected: [rows, columns], .. } => {
                (tensor, Shape::Matrix { rows, columns })
            }
            other => panic!("{other}"),
        };
        let values = (0..shape.elements()).map(|_| 0.5 * random.uniform()).collect();
        tensors.insert(tensor.to_string(), (shape, values));
    }
}

const CRC32: crc::Crc<u32, crc::Table<16>> =
    crc::Crc::<u32, crc::Table<16>>::new(&crc::CRC_32_ISO_HDLC);

/// The checksum of packed files, which PNG and ZIP have too.
pub fn crc32(bytes: &[u8]) -> u32 {
    CRC32.checksum(bytes)
}

/// Makes all three checksums of a packed file fit (`weights/FORMAT.md`), so that what is behind
/// them is reached; `false` where the lengths leave the file.
pub fn repair(file: &mut [u8]) -> bool {
    let Some(lengths) = file.get(12..32) else { return false };
    let number = |bytes: &[u8]| bytes.iter().rev().fold(0, |n: u64, b| (n << 8) | u64::from(*b));
    let (header, payload) = (number(&lengths[..4]) as usize, number(&lengths[4..]) as usize);
    for (at, section) in [(32, file.get(64..header.saturating_add(64))), (36, file.get(payload..))]
        .map(|(at, section)| (at, section.map(|section| CRC32.checksum(section))))
    {
        let Some(crc) = section else { return false };
        file[at..at + 4].copy_from_slice(&crc.to_le_bytes());
    }
    let Some(prefix) = file.get(..60) else { return false };
    // The prefix's own checksum is over the two before, so it comes last.
    let crc = CRC32.checksum(prefix).to_le_bytes();
    file.get_mut(60..64).is_some_and(|slot| {
        slot.copy_from_slice(&crc);
        true
    })
}

/// Loads a file of unknown quality and, where that succeeds, observes two units and steps twice.
/// Returns whether it loaded. Errors are fine, panics are what is looked for.
pub fn exercise(file: &[u8]) -> bool {
    let Ok(model) = Model::load(file) else { return false };
    let limits = Limits { units: 2, points: 10 };
    let mut room = Room::new(SlabSizes::new(model.config(), limits));
    let mut simulator =
        Simulator::new(&model, limits, room.slabs()).expect("slabs of the asked size");
    // A model without commands refuses them, which is no fault.
    let _ = simulator.set_command(&vec![0.5; model.config().command_size as usize]);
    let shape = [[0.0, 0.0, 0.0], [0.1, 0.0, 0.0], [0.0, 0.1, 0.0], [0.0, 0.0, 0.1], [0.1; 3]];
    let at = |x: f32, z: f32| shape.map(|p| Point3::from(p) + nalgebra::Vector3::new(x, 0.0, z));
    let (a, b) = ([at(0.0, 0.05), at(0.12, 0.3)], [at(0.01, 0.02), at(0.11, 0.2)]);
    let physics = Physics { mass_kg: 0.5, friction: 0.8, restitution: 0.7 };
    let mut units = [0, 1].map(|i| Observed { unit: Unit::new(&a[i], physics), current: &b[i] });
    let rest = at(0.0, 0.0);
    if model.config().motion.is_soft() {
        // One soft and one rigid unit, so that both kinds touch each other.
        units[0].unit = units[0].unit.soft(&rest, 1e4);
    }
    // Only units of one body hold together.
    if model.config().bonds > 0 {
        units = units.map(|observed| Observed { unit: observed.unit.body(1), ..observed });
    }
    if simulator.observe(seconds(10), units).is_ok() {
        let ids: Vec<_> = simulator.units().map(|unit| unit.id()).collect();
        // Models of other motions refuse bonds, which is no fault.
        if let [one, other] = ids[..] {
            let _ = simulator.bond(&[[one, other]]);
        }
        let _ = simulator.step();
        let _ = simulator.step();
    }
    true
}

/// Poses of a simulator, for telling whether they changed.
pub fn state(simulator: &Simulator<'_, '_>) -> Vec<[u32; 12]> {
    simulator
        .units()
        .map(|unit| {
            let pose = unit.internal_pose();
            let mut numbers = pose.rotation.iter().chain(&pose.centre);
            std::array::from_fn(|_| numbers.next().map_or(0, |v| v.to_bits()))
        })
        .collect()
}

/// Panics unless every pose is finite and a rotation, and a point's image is finite.
pub fn assert_rigid(simulator: &Simulator<'_, '_>) {
    for (number, unit) in simulator.units().enumerate() {
        let pose = unit.internal_pose();
        let error = pose.rotation * pose.rotation.transpose() - nalgebra::Matrix3::identity();
        assert!(error.iter().all(|v| v.abs() < 1e-3), "unit {number} is no rotation: {pose:?}");
        let isometry: Isometry3<f32> = unit.pose();
        assert!(isometry.translation.vector.iter().all(|v| v.is_finite()), "{isometry}");
        assert!(unit.points().take(ANCHORS).all(|p| p.iter().all(|v| v.is_finite())));
    }
}
