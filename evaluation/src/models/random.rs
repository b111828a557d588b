//! Models of a preset's sizes with random weights: for speed, which does not depend on what the weights are.

use half::f16;
use rigidformer_core::kernels::in_own_environment;
use rigidformer_runtime::noise::mix;
use rigidformer_weights::{
    BLEND_CODE, BLEND_HIDDEN, BOND_FEATURES, Directions, Elastic, FeatureSet, Hidden,
    IMPACT_FEATURES, IMPACT_PUSHES, ModelConfig, ModelWriter, Motion, PANEL, PANEL_DEPTH, Panels,
    Scales, Shape, Similarity, TensorData, WriteError,
};

use super::Precision;
use super::quantise::is_wide;

/// The paper's model: what it discloses is as disclosed. It does not say where 125 of its 174.8 million parameters are;
/// here they are in the fusion of pooled levels, once a unit, so that a step reads as many weights (175.06 million).
pub const PAPER: ModelConfig = ModelConfig {
    width: 768,
    heads: 6,
    head_dim: 128,
    blocks: 4,
    point_width: 1024,
    registers: 16,
    feed_forward_width: 1920,
    avp_width: 256,
    film_width: 64,
    command_size: 0,
    rope_frequencies: 16,
    scales: Scales::new(&[0, 1, 2, 4]),
    features: FeatureSet::Paper,
    motion: Motion::Verlet,
    gate: false,
    output_scale: 1.0,
    frame_rate_hz: 240.0,
    gravity_m_s2: [0.0, 0.0, -10.0],
    ground_friction: 0.3,
    ground_restitution: 0.5,
    hidden: Hidden { point: [256, 512], fuse: 14_592 },
    similarity: Similarity::OFF,
    directions: Directions::NONE,
    elastic: Elastic::NONE,
    bonds: 0,
    scope: rigidformer_weights::Scope::All,
    most_units: 0,
};

/// The sizes of the committed edge model.
pub const EDGE: ModelConfig = ModelConfig {
    width: 128,
    heads: 4,
    head_dim: 32,
    point_width: 128,
    registers: 4,
    feed_forward_width: 320,
    avp_width: 64,
    film_width: 32,
    rope_frequencies: 4,
    features: FeatureSet::Impact,
    motion: Motion::Free,
    gate: true,
    hidden: Hidden::DEFAULT,
    ..PAPER
};

/// Presets by name.
pub const PRESETS: [(&str, ModelConfig); 2] = [("paper", PAPER), ("edge", EDGE)];

/// How a tensor is filled.
#[derive(Clone, Copy)]
enum Fill {
    Constant(f32),
    /// Uniform with this standard deviation.
    Noise(f32),
    /// From 0.25 to 12 rad/m, evenly in the logarithm.
    Frequencies,
}

/// All tensors of a configuration.
fn tensors(c: &ModelConfig) -> Vec<(String, Shape, Fill)> {
    let mut all = Vec::new();
    let vector = |all: &mut Vec<_>, name: String, length, value| {
        all.push((name, Shape::Vector(length), Fill::Constant(value)));
    };
    let matrix = |all: &mut Vec<_>, name: String, rows, columns: u32| {
        // Activations then keep their size from layer to layer.
        let noise = Fill::Noise((columns as f32).powf(-0.5));
        all.push((name, Shape::Matrix { rows, columns }, noise));
    };
    let chain = |all: &mut Vec<_>, prefix: &str, widths: &[u32]| {
        for (index, pair) in widths.windows(2).enumerate() {
            matrix(all, format!("{prefix}.{index}.weight"), pair[1], pair[0]);
            vector(all, format!("{prefix}.{index}.bias"), pair[1], 0.0);
        }
    };
    let (width, points, inner) = (c.width, c.point_width, c.heads * c.head_dim);
    let features = c.features.len() as u32;
    let film = [2, c.film_width, 2 * width];
    let command = [c.command_size, c.film_width, 2 * width];

    vector(&mut all, "encoder.feature_mean".into(), features, 0.0);
    vector(&mut all, "encoder.feature_scale".into(), features, 1.0);
    let [first, second] = c.point_hidden();
    match second {
        0 => chain(&mut all, "encoder.point", &[features, first, points]),
        _ => chain(&mut all, "encoder.point", &[features, first, second, points]),
    }
    // Impacts add two pooled levels to a unit and their pushes to an anchor's query.
    let (pools, pushes) = match c.features.has_impacts() {
        true => (10, IMPACT_PUSHES as u32),
        false => (8, 0),
    };
    if c.features.has_impacts() {
        vector(&mut all, "encoder.impact_mean".into(), IMPACT_FEATURES as u32, 0.0);
        vector(&mut all, "encoder.impact_scale".into(), IMPACT_FEATURES as u32, 1.0);
        chain(&mut all, "encoder.impact", &[IMPACT_FEATURES as u32, points, points]);
    }
    chain(&mut all, "encoder.fuse", &[pools * points, c.fuse_hidden(), width]);
    chain(&mut all, "encoder.film.mlp", &film);
    if c.command_size > 0 {
        chain(&mut all, "encoder.command.mlp", &command);
    }
    for i in 0..c.blocks {
        let name = |suffix: &str| format!("blocks.{i}.{suffix}");
        vector(&mut all, name("attention.norm.weight"), width, 1.0);
        matrix(&mut all, name("attention.qkvg.weight"), 4 * inner, width);
        vector(&mut all, name("attention.query_norm.weight"), c.head_dim, 1.0);
        vector(&mut all, name("attention.key_norm.weight"), c.head_dim, 1.0);
        matrix(&mut all, name("attention.out.weight"), width, inner);
        chain(&mut all, &name("film.mlp"), &film);
        if c.command_size > 0 {
            chain(&mut all, &name("command.mlp"), &command);
        }
        vector(&mut all, name("feed_forward.norm.weight"), width, 1.0);
        matrix(&mut all, name("feed_forward.gate_up.weight"), 2 * c.feed_forward_width, width);
        matrix(&mut all, name("feed_forward.down.weight"), width, c.feed_forward_width);
    }
    for k in 0..c.scales.len() {
        let name = |suffix: &str| format!("anchors.cross.{k}.{suffix}");
        vector(&mut all, name("input_norm.weight"), width, 1.0);
        vector(&mut all, name("unit_norm.weight"), width, 1.0);
        matrix(&mut all, name("query_gate.weight"), 2 * inner, width);
        matrix(&mut all, name("key_value.weight"), 2 * inner, width);
        vector(&mut all, name("query_norm.weight"), c.head_dim, 1.0);
        vector(&mut all, name("key_norm.weight"), c.head_dim, 1.0);
    }
    vector(&mut all, "anchors.position_mean".into(), 3, 0.0);
    vector(&mut all, "anchors.position_scale".into(), 3, 0.5);
    all.push(("anchors.log_sigma".into(), Shape::Scalar, Fill::Constant(-1.5)));
    chain(&mut all, "anchors.avp", &[points, c.avp_width, c.avp_width]);
    chain(&mut all, "anchors.query", &[3 + features + c.avp_width + pushes, width, width]);
    matrix(&mut all, "anchors.fuse.weight".into(), width, c.scales.len() as u32 * inner);
    vector(&mut all, "anchors.fuse.bias".into(), width, 0.0);
    chain(&mut all, "anchors.film.mlp", &film);
    vector(&mut all, "anchors.norm.weight".into(), width, 1.0);
    chain(&mut all, "anchors.head", &[width, width, c.motion.outputs() as u32]);
    if c.bonds > 0 {
        vector(&mut all, "bonds.feature_mean".into(), BOND_FEATURES as u32, 0.0);
        vector(&mut all, "bonds.feature_scale".into(), BOND_FEATURES as u32, 1.0);
        chain(&mut all, "bonds.net", &[2 * width + BOND_FEATURES as u32, c.bonds, 1]);
    }
    if c.motion.is_soft() {
        let (inputs, hidden) = (points + BLEND_CODE as u32, BLEND_HIDDEN as u32);
        chain(&mut all, "blend.residual", &[inputs, hidden, 6]);
        all.push(("log_radius".into(), Shape::Scalar, Fill::Constant(-0.5)));
    }
    if c.registers > 0 {
        matrix(&mut all, "registers".into(), c.registers, width);
    }
    all.push(("rope_frequencies".into(), Shape::Vector(c.rope_frequencies), Fill::Frequencies));
    all
}

enum Stored {
    F32(Vec<f32>),
    F16(Vec<f16>),
    Panels { values: Vec<i8>, scales: Vec<f32>, sums: Vec<i32> },
}

/// Square root of 3: the bound of a uniform distribution whose deviation is 1.
const BOUND: f32 = 1.732_050_8;

fn store(name: &str, shape: Shape, fill: Fill, precision: Precision, seed: u64) -> Stored {
    let count = shape.elements();
    let deviation = match fill {
        Fill::Constant(value) => return Stored::F32(vec![value; count as usize]),
        Fill::Frequencies => {
            let last = (count.max(2) - 1) as f32;
            let frequency = |i: u64| 0.25 * 48.0_f32.powf(i as f32 / last);
            return Stored::F32((0..count).map(frequency).collect());
        }
        Fill::Noise(deviation) => deviation,
    };
    // A hash of the index, so that a number does not depend on the order in which they are made.
    let word = |index: u64| mix(seed ^ mix(index.wrapping_add(0x9e37_79b9_7f4a_7c15)));
    let number = |index: u64| {
        // 24 bits are what f32 holds exactly.
        ((word(index) >> 40) as f32 / (1_u64 << 23) as f32 - 1.0) * (BOUND * deviation)
    };
    let Shape::Matrix { rows, columns } = shape else {
        return Stored::F32((0..count).map(number).collect());
    };
    let layer = name.strip_suffix(".weight");
    match (precision, layer) {
        (_, None) | (Precision::F32, _) => Stored::F32((0..count).map(number).collect()),
        (Precision::F16, _) => Stored::F16((0..count).map(|i| f16::from_f32(number(i))).collect()),
        (_, Some(layer)) if is_wide(layer, precision) => {
            Stored::F16((0..count).map(|i| f16::from_f32(number(i))).collect())
        }
        _ => {
            let (rows, columns) = (rows as usize, columns as usize);
            // Panels are written directly, so that 175 million weights are laid out once.
            let mut values = vec![0_i8; Panels::length(rows as u64, columns as u64) as usize];
            let mut sums = vec![0_i32; rows];
            let depth = columns.next_multiple_of(PANEL_DEPTH);
            for (index, slot) in values.iter_mut().enumerate() {
                let (panel, rest) = (index / (PANEL * depth), index % (PANEL * depth));
                let (group, rest) = (rest / (PANEL * PANEL_DEPTH), rest % (PANEL * PANEL_DEPTH));
                let row = panel * PANEL + rest / PANEL_DEPTH;
                let column = group * PANEL_DEPTH + rest % PANEL_DEPTH;
                // Padding stays 0 and is in no sum.
                if row < rows && column < columns {
                    // From -127 to 127: symmetric int8 has no -128.
                    *slot = (((word(index as u64) >> 32) * 255) >> 32) as i8 ^ i8::MIN;
                    *slot = (*slot).max(-127);
                    sums[row] += i32::from(*slot);
                }
            }
            // This scale gives the int8 values the deviation of the layer.
            Stored::Panels { values, scales: vec![BOUND * deviation / 127.0; rows], sums }
        }
    }
}

/// A packed model of these sizes with random weights, the same for the same seed; int8 matrices are in panels.
///
/// ```
/// use rigidformer_runtime::core::Model;
/// use rigidformer_evaluation::models::{Precision, random};
/// use rigidformer_runtime::models::LoadedModel;
/// let packed = random::random("edge", &random::EDGE, Precision::I8, 1)?;
/// let loaded = LoadedModel::copy_of("random.rfm", &packed)?;
/// assert_eq!(loaded.model().config().width, 128);
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
///
/// # Errors
/// [`WriteError`] where the configuration is outside the format's limits.
pub fn random(
    name: &str,
    config: &ModelConfig,
    precision: Precision,
    seed: u64,
) -> Result<Vec<u8>, WriteError> {
    in_own_environment(|| random_here(name, config, precision, seed))
}

/// A packed model that moves units as this one does but for its network, which corrects nothing: motion by impulses alone. None where
/// the model's motion is not by impulses.
///
/// # Errors
/// [`WriteError`] where the configuration is outside the format's limits.
pub fn without_network(config: &ModelConfig) -> Result<Option<Vec<u8>>, WriteError> {
    if !config.motion.has_impulses() {
        return Ok(None);
    }
    uncorrected(config).map(Some)
}

/// As [`without_network`], of any motion: what a model's network corrects.
///
/// # Errors
/// As [`without_network`].
pub fn uncorrected(config: &ModelConfig) -> Result<Vec<u8>, WriteError> {
    let name = match config.motion {
        Motion::Impulses => "impulses alone",
        Motion::Soft => "springs alone",
        Motion::Robot => "the heading alone",
        Motion::Free | Motion::Verlet => "free motion",
    };
    // The least that a network can be: all of it is computed for nothing.
    let least = ModelConfig {
        width: 8,
        heads: 1,
        head_dim: 6,
        blocks: 1,
        point_width: 8,
        registers: 0,
        feed_forward_width: 8,
        avp_width: 8,
        film_width: 8,
        rope_frequencies: 1,
        scales: Scales::new(&[0]),
        hidden: Hidden { point: [8, 0], fuse: 8 },
        directions: Directions::NONE,
        bonds: 0,
        scope: rigidformer_weights::Scope::All,
        most_units: 0,
        ..*config
    };
    in_own_environment(|| {
        let mut all = tensors(&least);
        for (name, _, fill) in &mut all {
            if name.starts_with("anchors.head.") {
                *fill = Fill::Constant(0.0);
            }
        }
        written(name, &least, &all, Precision::F32, 1)
    })
}

fn random_here(
    name: &str,
    config: &ModelConfig,
    precision: Precision,
    seed: u64,
) -> Result<Vec<u8>, WriteError> {
    // Sizes that are out of range could ask for more memory than there is.
    config.validate()?;
    written(name, config, &tensors(config), precision, seed)
}

fn written(
    name: &str,
    config: &ModelConfig,
    all: &[(String, Shape, Fill)],
    precision: Precision,
    seed: u64,
) -> Result<Vec<u8>, WriteError> {
    let stored: Vec<Stored> = (1..)
        .zip(all)
        .map(|(index, (name, shape, fill))| {
            store(name, *shape, *fill, precision, mix(seed.wrapping_add(mix(index))))
        })
        .collect();
    let mut writer = ModelWriter::new(name, *config)
        .provenance("weights", &format!("random, seed {seed}; for measurements of speed only"));
    for ((name, shape, _), stored) in all.iter().zip(&stored) {
        let data = match stored {
            Stored::F32(values) => TensorData::F32(values),
            Stored::F16(values) => TensorData::F16(values),
            Stored::Panels { values, scales, sums } => {
                TensorData::Panels(Panels { values, scales, sums })
            }
        };
        writer = writer.tensor(name, *shape, data);
    }
    writer.finish()
}
