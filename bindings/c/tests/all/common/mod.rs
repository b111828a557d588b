//! A small model, and memory for simulators.
#![allow(
    dead_code,
    unreachable_pub,
    clippy::unwrap_used,
    clippy::expect_used,
    clippy::panic,
    unsafe_code
)]

use rigidformer_capi::ffi::*;
use rigidformer_capi::types::*;
use rigidformer_core::{LoadError, Model};
use rigidformer_weights::{
    Aligned, AlignedBuffer, FeatureSet, Hidden, ModelConfig, ModelWriter, Motion, Scales, Shape,
    TensorData, include_model,
};
use std::collections::BTreeMap;
use std::ptr::{null, null_mut};

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
    command_size: 0,
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
    similarity: rigidformer_weights::Similarity::OFF,
    directions: rigidformer_weights::Directions::NONE,
    elastic: rigidformer_weights::Elastic::NONE,
    bonds: 0,
    scope: rigidformer_weights::Scope::All,
    most_units: 0,
};

/// A packed model of that configuration: what [`model`] makes, for which an interpreter needs long.
pub fn smallest() -> &'static [u8] {
    static MODEL: &Aligned<[u8]> = include_model!("../../data/smallest.rfm");
    MODEL
}

/// A packed model with made-up weights; asks the loader, over and over, which tensor it misses.
pub fn model(config: ModelConfig) -> AlignedBuffer {
    let mut tensors: BTreeMap<String, (Shape, Vec<f32>)> = BTreeMap::new();
    let mut state = 1_u32;
    loop {
        let mut writer = ModelWriter::new("small", config);
        for (name, (shape, values)) in &tensors {
            writer = writer.tensor(name, *shape, TensorData::F32(values));
        }
        let file = AlignedBuffer::copy_of(&writer.finish().expect("a sound model"));
        let missing = Model::load(&file).err();
        let (tensor, shape) = match missing {
            None => return file,
            Some(LoadError::MissingTensor(tensor)) => (tensor, Shape::Vector(1)),
            Some(LoadError::Shape { tensor, expected: [rows, 1], .. }) => {
                (tensor, Shape::Vector(rows))
            }
            Some(LoadError::Shape { tensor, expected: [rows, columns], .. }) => {
                (tensor, Shape::Matrix { rows, columns })
            }
            Some(other) => panic!("{other}"),
        };
        let mut next = || {
            state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
            (state >> 8) as f32 / (1 << 24) as f32 - 0.5
        };
        tensors
            .insert(tensor.to_string(), (shape, (0..shape.elements()).map(|_| next()).collect()));
    }
}

/// Limits and a model, as C hands them in.
pub fn config(model: &[u8], max_units: u32, max_points: u32) -> rf_config {
    rf_config {
        abi_version: RF_ABI_VERSION,
        max_units,
        max_points,
        threads: 0,
        model: model.as_ptr(),
        model_bytes: model.len(),
    }
}

/// Memory of exactly the length that was asked for, never initialised, with a rim behind it.
pub struct Workspace {
    blocks: Vec<std::mem::MaybeUninit<Block>>,
    pub bytes: usize,
}

#[repr(C, align(16))]
#[derive(Clone, Copy)]
struct Block([u8; 16]);

impl Workspace {
    pub fn new(bytes: usize) -> Self {
        let count = bytes.div_ceil(16);
        let mut blocks = Vec::with_capacity(count + 1);
        // SAFETY: MaybeUninit needs no initial value.
        unsafe { blocks.set_len(count) };
        blocks.push(std::mem::MaybeUninit::new(Block([0xa5; 16])));
        Workspace { blocks, bytes }
    }

    pub fn of(config: &rf_config) -> Self {
        let mut bytes = 0;
        // SAFETY: both point to what they say.
        assert_eq!(unsafe { rf_workspace_bytes(config, &mut bytes) }, rf_status::RF_OK);
        Self::new(bytes)
    }

    pub fn pointer(&mut self) -> *mut u8 {
        self.blocks.as_mut_ptr().cast()
    }

    pub fn rim_is_whole(&self) -> bool {
        // SAFETY: `new` initialised it.
        unsafe { self.blocks.last().unwrap().assume_init_ref().0 == [0xa5; 16] }
    }

    pub fn init(&mut self, config: &rf_config) -> *mut rf_simulator {
        let (handle, detail) = self.try_init(config);
        assert_eq!(detail.code, rf_status::RF_OK, "{detail:?}");
        handle
    }

    pub fn try_init(&mut self, config: &rf_config) -> (*mut rf_simulator, rf_detail) {
        let (mut handle, mut detail) = (null_mut(), NO_DETAIL);
        let bytes = self.bytes;
        // SAFETY: the workspace is as long as it says.
        let status =
            unsafe { rf_init(config, self.pointer().cast(), bytes, &mut handle, &mut detail) };
        assert_eq!(status, detail.code);
        assert_eq!(handle.is_null(), status != rf_status::RF_OK);
        (handle, detail)
    }
}

pub const NO_DETAIL: rf_detail = rf_detail {
    code: rf_status::RF_OK,
    unit: RF_NONE,
    index: RF_NONE,
    reserved: 0,
    found: 0,
    expected: 0,
};

/// Seconds between the frames of a [`Scene`].
pub const DT_S: f32 = 10.0 / 240.0;

/// Units of five points that move, as C hands them in.
pub struct Scene {
    pub physics: Vec<rf_physics>,
    pub counts: Vec<u32>,
    pub previous: Vec<[f32; 3]>,
    pub current: Vec<[f32; 3]>,
}

impl Scene {
    pub fn new(units: usize) -> Self {
        let shape =
            [[0.0, 0.0, 0.0], [0.1, 0.0, 0.0], [0.0, 0.1, 0.0], [0.0, 0.0, 0.1], [0.1, 0.1, 0.1]];
        let frame = |speed: f32| {
            let unit = |i: usize| {
                let (x, z) = (0.12 * i as f32 + 0.01 * speed, 0.05 + 0.1 * i as f32 - 0.03 * speed);
                shape.map(|[a, b, c]: [f32; 3]| [a + x, b, c + z])
            };
            (0..units).flat_map(unit).collect()
        };
        let rubber = rf_physics { mass_kg: 0.5, friction: 0.8, restitution: 0.7 };
        Scene {
            physics: vec![rubber; units],
            counts: vec![5; units],
            previous: frame(0.0),
            current: frame(1.0),
        }
    }

    pub fn units(&self) -> rf_units {
        rf_units {
            unit_count: self.physics.len(),
            physics: self.physics.as_ptr(),
            point_counts: self.counts.as_ptr(),
            point_count: self.previous.len(),
            roles: null(),
            bodies: null(),
            inertias_kg_m2: null(),
            unit_pieces: null(),
            piece_counts: null(),
            piece_count: 0,
            piece_points: null(),
            piece_point_count: 0,
            young_pa: null(),
            rest_points: null(),
        }
    }

    pub fn observe(&self, handle: *mut rf_simulator) -> rf_status {
        let units = self.units();
        let (previous, current) = (self.previous.as_ptr().cast(), self.current.as_ptr().cast());
        // SAFETY: the handle is one, the arrays are as long as they say.
        unsafe { rf_observe(handle, DT_S, &units, previous, current, null_mut()) }
    }
}

pub fn step(handle: *mut rf_simulator) -> rf_status {
    // SAFETY: the handle is one.
    unsafe { rf_step(handle, null_mut()) }
}

pub fn detail(handle: *const rf_simulator) -> rf_detail {
    let mut detail = NO_DETAIL;
    // SAFETY: the handle is one.
    assert_eq!(unsafe { rf_last_error_detail(handle, &mut detail) }, rf_status::RF_OK);
    detail
}

pub fn ids(handle: *const rf_simulator) -> Vec<rf_unit_id> {
    let mut count = 0;
    // SAFETY: the handle is one.
    assert_eq!(unsafe { rf_unit_count(handle, &mut count) }, rf_status::RF_OK);
    let mut ids = vec![0; count as usize];
    // SAFETY: the handle is one, and the array as long as it says.
    assert_eq!(unsafe { rf_unit_ids(handle, ids.as_mut_ptr(), ids.len()) }, rf_status::RF_OK);
    ids
}

/// A pose without a rotation.
pub const fn at(x: f32, y: f32, z: f32) -> rf_pose {
    rf_pose { position: [x, y, z], quaternion: [0.0, 0.0, 0.0, 1.0] }
}

pub fn poses(handle: *const rf_simulator) -> Vec<[u32; 12]> {
    let mut count = 0;
    // SAFETY: the handle is one.
    assert_eq!(unsafe { rf_unit_count(handle, &mut count) }, rf_status::RF_OK);
    let mut poses = vec![rf_internal_pose { rotation: [0.0; 9], centre: [0.0; 3] }; count as usize];
    // SAFETY: the handle is one, and the array as long as it says.
    let status = unsafe { rf_internal_poses(handle, poses.as_mut_ptr(), poses.len()) };
    assert_eq!(status, rf_status::RF_OK);
    let bits = |pose: &rf_internal_pose| {
        let mut numbers = pose.rotation.iter().chain(&pose.centre);
        std::array::from_fn(|_| numbers.next().unwrap().to_bits())
    };
    poses.iter().map(bits).collect()
}

/// A pointer for functions that must not get as far as using it.
pub fn nothing<T>() -> *const T {
    null()
}
