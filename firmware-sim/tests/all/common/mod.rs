//! A tiny random model, its quantised forms, and a scene.
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)]

use nalgebra::{Isometry3, Point3, Translation3, UnitQuaternion, Vector3};
use rigidformer_evaluation::models::{Precision, quantise};
use rigidformer_evaluation::scenes::{RecordedScene, RecordedUnit, Split};
use rigidformer_runtime::core::weights::{ModelConfig, ModelWriter, Shape, TensorData};
use rigidformer_runtime::core::{LoadError, Physics};
use rigidformer_runtime::models::{LoadedModel, ModelError};

/// Packs a random model: each tensor that loading asks for is made up as it is asked for.
pub(crate) fn packed(config: ModelConfig) -> Vec<u8> {
    let mut tensors: Vec<(String, Shape, Vec<f32>)> = Vec::new();
    loop {
        let mut writer = ModelWriter::new("random", config);
        for (name, shape, values) in &tensors {
            writer = writer.tensor(name, *shape, TensorData::F32(values));
        }
        let bytes = writer.finish().unwrap();
        match LoadedModel::copy_of("random", &bytes) {
            Ok(_) => return bytes,
            Err(ModelError::Load { source: LoadError::MissingTensor(id), .. }) => {
                tensors.push((id.to_string(), Shape::Vector(1), vec![1.0]));
            }
            Err(ModelError::Load { source: LoadError::Shape { tensor, expected, .. }, .. }) => {
                let last = tensors.last_mut().unwrap();
                assert_eq!(last.0, tensor.to_string());
                *last = made_up(&last.0, expected);
            }
            Err(other) => panic!("{other}"),
        }
    }
}

fn made_up(name: &str, [rows, columns]: [u32; 2]) -> (String, Shape, Vec<f32>) {
    let seed = name.bytes().fold(7_u64, |seed, byte| seed * 31 % 1_000_003 + u64::from(byte));
    let spread = 1.0 / (columns as f32).sqrt();
    let value = |i: u64| {
        let mut x = (i + 1).wrapping_mul(0x9e37_79b9_7f4a_7c15).wrapping_add(seed);
        x = (x ^ (x >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        x = (x ^ (x >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        ((x >> 40) as f32 / (1_u64 << 23) as f32 - 1.0) * spread
    };
    let values = (0..u64::from(rows) * u64::from(columns)).map(value).collect();
    let shape = if columns == 1 { Shape::Vector(rows) } else { Shape::Matrix { rows, columns } };
    (name.into(), shape, values)
}

pub(crate) const CONFIG: ModelConfig = ModelConfig {
    gravity_m_s2: [0.0, 0.0, -10.0],
    frame_rate_hz: 240.0,
    command_size: 0,
    ..ModelConfig::TINY
};

pub(crate) fn loaded(bytes: &[u8]) -> LoadedModel {
    LoadedModel::copy_of("random.rfm", bytes).unwrap()
}

pub(crate) fn quantised(bytes: &[u8], precision: Precision) -> LoadedModel {
    let file = quantise("random.rfm".as_ref(), bytes, &precision.into()).unwrap().file;
    LoadedModel::copy_of("quantised.rfm", &file).unwrap()
}

/// Cubes that slide over the ground, 101 frames.
pub(crate) fn scene(seed: i64) -> RecordedScene {
    let corner = |i: usize| Point3::new((i & 1) as f32, (i >> 1 & 1) as f32, (i >> 2) as f32);
    let cube: Vec<Point3<f32>> = (0..8).map(|i| corner(i) - Vector3::repeat(0.5)).collect();
    let unit = |k: usize| {
        let pose = |frame: usize| {
            let t = frame as f32 / 240.0;
            let place = Translation3::new(1.3 * k as f32 + t, 0.2 * seed as f32 * t, 0.52);
            let turn = UnitQuaternion::from_axis_angle(&Vector3::z_axis(), 0.3 * seed as f32 * t);
            Isometry3::from_parts(place, turn)
        };
        let physics = Physics { mass_kg: 1.0, friction: 0.4, restitution: 0.3 };
        RecordedUnit::new("cube", cube.clone(), physics, (0..=100).map(pose).collect())
    };
    let gravity = Vector3::new(0.0, 0.0, -10.0);
    let units = (0..3).map(unit).collect();
    RecordedScene::new(format!("slide {seed}"), seed, Split::Test, 240.0, gravity, units).unwrap()
}
