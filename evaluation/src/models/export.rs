//! What the lab writes: safetensors with the configuration in its metadata.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use rigidformer_weights::{
    Directions, Elastic, FeatureSet, Hidden, ModelConfig, Motion, Scales, Scope, Shape, Similarity,
};
use safetensors::{Dtype, SafeTensors, tensor::TensorView};
use serde::Deserialize;

// Scene files and traces are safetensors too, and only this entry tells them apart.
const FORMAT: &str = "rigidformer-model";

/// An exported model that cannot be packed. Its text names the file, the field and the remedy.
#[derive(Debug, thiserror::Error)]
#[error("{}: {field}: {problem}; {}", .path.display(), .problem.remedy())]
pub struct ExportError {
    /// The file.
    pub path: PathBuf,
    /// The metadata entry or tensor at fault.
    pub field: String,
    /// What is wrong with it.
    pub problem: ExportProblem,
}

/// What is wrong with a field of an exported model.
#[derive(Debug, thiserror::Error)]
pub enum ExportProblem {
    /// Not a safetensors file, or a damaged one.
    #[error("is not a whole safetensors file ({0})")]
    NotSafetensors(String),
    /// A safetensors file with other contents.
    #[error("is {found:?}, not {FORMAT:?}")]
    Foreign {
        /// What the file says.
        found: String,
    },
    /// A metadata entry is not there.
    #[error("is missing")]
    Missing,
    /// A metadata entry is not the JSON it should be.
    #[error("does not parse: {0}")]
    Unparsable(String),
    /// A tensor of another type.
    #[error("is stored as {0}, not F32")]
    Dtype(String),
    /// A tensor of more than two dimensions, or of one beyond 32 bits.
    #[error("has shape {0:?}; a packed tensor has at most two dimensions")]
    Shape(Vec<usize>),
}

impl ExportProblem {
    /// What the user can do about it.
    pub fn remedy(&self) -> &'static str {
        match self {
            ExportProblem::NotSafetensors(_) | ExportProblem::Foreign { .. } => {
                "give the file that rigidformer_lab.export wrote"
            }
            ExportProblem::Missing | ExportProblem::Unparsable(_) | ExportProblem::Shape(_) => {
                "export the model again with the lab of this version"
            }
            ExportProblem::Dtype(_) => "export it in float32",
        }
    }
}

/// An exported model, borrowed from its bytes but for the tensors' numbers.
pub(super) struct Export {
    pub(super) name: String,
    pub(super) config: ModelConfig,
    pub(super) provenance: BTreeMap<String, String>,
    pub(super) metrics: BTreeMap<String, f32>,
    pub(super) tensors: BTreeMap<String, (Shape, Vec<f32>)>,
}

/// `config` as the lab's `ModelConfig` writes it.
#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct LabConfig {
    name: String,
    width: u32,
    heads: u32,
    head_dim: u32,
    blocks: u32,
    point_width: u32,
    registers: u32,
    feed_forward_width: u32,
    avp_width: u32,
    film_width: u32,
    command_size: u32,
    features: LabFeatures,
    motion: LabMotion,
    gate: bool,
    rope_frequencies: u32,
    /// The frequencies themselves travel as a tensor.
    #[serde(rename = "rope_min_rad_per_m")]
    _rope_min_rad_per_m: f32,
    #[serde(rename = "rope_max_rad_per_m")]
    _rope_max_rad_per_m: f32,
    output_scale: f32,
    frame_rate_hz: f32,
    gravity_m_s2: [f32; 3],
    ground_friction: f32,
    ground_restitution: f32,
    scales: Vec<u32>,
    /// None: one hidden layer of `point_width`.
    #[serde(default)]
    point_hidden: Vec<u32>,
    /// 0: `width`.
    #[serde(default)]
    fuse_hidden: u32,
    /// 0: SI units.
    #[serde(default)]
    length_m: f32,
    /// 0: whole steps.
    #[serde(default)]
    longest_step: f32,
    /// Places of directions in the world among a command's numbers.
    #[serde(default)]
    directions: Vec<u32>,
    /// None: rigid bodies.
    #[serde(default)]
    elastic: Option<LabElastic>,
    /// 0: no network of bonds.
    #[serde(default)]
    bonds: u32,
    /// Units that the network sees.
    #[serde(default)]
    scope: LabScope,
    /// Null: contact laws are those of scenes. Older exports say so.
    #[serde(default, rename = "law")]
    _law: (),
    /// 0: copies of any number of units are corrected.
    #[serde(default)]
    most_units: u32,
}

#[derive(Clone, Copy, Default, Deserialize)]
#[serde(rename_all = "lowercase")]
enum LabScope {
    #[default]
    All,
    Near,
}

#[derive(Clone, Copy, Deserialize)]
#[serde(deny_unknown_fields)]
struct LabElastic {
    neighbours: u32,
    thickness_m: f32,
    stiffness: f32,
    falloff: u32,
    damping_s: f32,
    skin_m: f32,
    rate_hz: f32,
    #[serde(default)]
    strain_sweeps: u32,
    #[serde(default)]
    strain_limit: f32,
}

impl LabElastic {
    fn packed(self) -> Elastic {
        Elastic {
            neighbours: self.neighbours,
            falloff: self.falloff,
            thickness_m: self.thickness_m,
            stiffness: self.stiffness,
            damping_s: self.damping_s,
            skin_m: self.skin_m,
            rate_hz: self.rate_hz,
            strain_sweeps: self.strain_sweeps,
            strain_limit: self.strain_limit,
        }
    }
}

#[derive(Deserialize)]
#[serde(rename_all = "lowercase")]
enum LabFeatures {
    Paper,
    Contact,
    Impact,
    Soft,
}

#[derive(Deserialize)]
#[serde(rename_all = "lowercase")]
enum LabMotion {
    Verlet,
    Free,
    Impulses,
    #[serde(alias = "carried")]
    Robot,
    #[serde(alias = "elastic")]
    Soft,
}

impl LabConfig {
    fn packed(&self) -> Result<ModelConfig, ExportProblem> {
        // Scales are bits of 32 in a packed file.
        if let Some(level) = self.scales.iter().find(|level| **level > 31) {
            return Err(ExportProblem::Unparsable(format!("scales has level {level}, above 31")));
        }
        // Bits have one order, and tensors of attention are numbered by it.
        if !self.scales.is_sorted_by(|a, b| a < b) {
            let text = "scales must ascend: the attention of each is found by its place".into();
            return Err(ExportProblem::Unparsable(text));
        }
        // Two layers are what a packed configuration has room for.
        let point = match *self.point_hidden {
            [] => [0, 0],
            [first] => [first, 0],
            [first, second] => [first, second],
            _ => {
                let text = "point_hidden has more than two layers".into();
                return Err(ExportProblem::Unparsable(text));
            }
        };
        Ok(ModelConfig {
            width: self.width,
            heads: self.heads,
            head_dim: self.head_dim,
            blocks: self.blocks,
            point_width: self.point_width,
            registers: self.registers,
            feed_forward_width: self.feed_forward_width,
            avp_width: self.avp_width,
            film_width: self.film_width,
            command_size: self.command_size,
            rope_frequencies: self.rope_frequencies,
            scales: Scales::new(&self.scales),
            features: match self.features {
                LabFeatures::Paper => FeatureSet::Paper,
                LabFeatures::Contact => FeatureSet::Contact,
                LabFeatures::Impact => FeatureSet::Impact,
                LabFeatures::Soft => FeatureSet::Soft,
            },
            motion: match self.motion {
                LabMotion::Verlet => Motion::Verlet,
                LabMotion::Free => Motion::Free,
                LabMotion::Impulses => Motion::Impulses,
                LabMotion::Robot => Motion::Robot,
                LabMotion::Soft => Motion::Soft,
            },
            gate: self.gate,
            output_scale: self.output_scale,
            frame_rate_hz: self.frame_rate_hz,
            gravity_m_s2: self.gravity_m_s2,
            ground_friction: self.ground_friction,
            ground_restitution: self.ground_restitution,
            hidden: Hidden { point, fuse: self.fuse_hidden },
            directions: Directions::new(&self.directions),
            elastic: self.elastic.map_or(Elastic::NONE, LabElastic::packed),
            bonds: self.bonds,
            scope: match self.scope {
                LabScope::All => Scope::All,
                LabScope::Near => Scope::Near,
            },
            most_units: self.most_units,
            similarity: Similarity { length_m: self.length_m, longest_step: self.longest_step },
        })
    }
}

impl Export {
    pub(super) fn parse(path: &Path, bytes: &[u8]) -> Result<Self, ExportError> {
        let fail = |field: String, problem| ExportError { path: path.into(), field, problem };
        let damaged = |error: &dyn ToString| {
            fail("file".into(), ExportProblem::NotSafetensors(error.to_string()))
        };
        // safetensors calls an empty file a header that is too short, which helps nobody.
        if bytes.is_empty() {
            return Err(damaged(&"it is empty"));
        }
        let (_, header) = SafeTensors::read_metadata(bytes).map_err(|error| damaged(&error))?;
        let file = SafeTensors::deserialize(bytes).map_err(|error| damaged(&error))?;

        let metadata = header.metadata().clone().unwrap_or_default();
        let entry = |name: &str| {
            let field = || format!("metadata {name}");
            metadata.get(name).ok_or_else(|| fail(field(), ExportProblem::Missing))
        };
        // First of all, so that another kind of file is named and not its missing entries.
        let found = metadata.get("format").cloned().unwrap_or_else(|| "nothing".into());
        if found != FORMAT {
            return Err(fail("metadata format".into(), ExportProblem::Foreign { found }));
        }
        let unparsable = |field: &str, error: serde_json::Error| {
            fail(format!("metadata {field}"), ExportProblem::Unparsable(error.to_string()))
        };
        let config: LabConfig =
            serde_json::from_str(entry("config")?).map_err(|error| unparsable("config", error))?;
        let provenance = serde_json::from_str(entry("provenance")?)
            .map_err(|error| unparsable("provenance", error))?;
        let metrics = serde_json::from_str(entry("metrics")?)
            .map_err(|error| unparsable("metrics", error))?;

        let mut tensors = BTreeMap::new();
        for (name, view) in file.tensors() {
            let tensor =
                read_tensor(&view).map_err(|problem| fail(format!("tensor {name}"), problem))?;
            tensors.insert(name, tensor);
        }
        let packed = config.packed().map_err(|problem| fail("metadata config".into(), problem))?;
        Ok(Export { name: config.name, config: packed, provenance, metrics, tensors })
    }
}

fn read_tensor(view: &TensorView<'_>) -> Result<(Shape, Vec<f32>), ExportProblem> {
    // Quantisation starts from f32, so that errors do not add up.
    if view.dtype() != Dtype::F32 {
        return Err(ExportProblem::Dtype(format!("{:?}", view.dtype())));
    }
    let sizes: Option<Vec<u32>> =
        view.shape().iter().map(|size| u32::try_from(*size).ok()).collect();
    let shape = match sizes.as_deref() {
        Some([]) => Shape::Scalar,
        Some([length]) => Shape::Vector(*length),
        Some([rows, columns]) => Shape::Matrix { rows: *rows, columns: *columns },
        _ => return Err(ExportProblem::Shape(view.shape().to_vec())),
    };
    let (numbers, _) = view.data().as_chunks::<4>();
    Ok((shape, numbers.iter().copied().map(f32::from_le_bytes).collect()))
}
