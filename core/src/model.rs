//! Typed views over a loaded file; nothing is copied out of it.

use crate::error::{LoadError, TensorId};
use crate::kernels::Storage;
use crate::kernels::in_own_environment;
use crate::limits::{MAX_BLOCKS, MAX_COMMAND, MAX_SCALES};
use crate::math;
use crate::network::layers::{Chain, Film, Linear, Mlp};
use crate::sizes::{pools, query_inputs};
use crate::structure::heading::ROBOT;
#[cfg(feature = "deform")]
use rigidformer_weights::BOND_FEATURES;
#[cfg(feature = "deform")]
use rigidformer_weights::{BLEND_CODE, BLEND_HIDDEN};
use rigidformer_weights::{IMPACT_FEATURES, ModelConfig, ModelFile, Shape, TensorData};

/// A model whose file has been checked completely: after this nothing about it can fail.
///
/// ```
/// use rigidformer_core::{LoadError, Model};
/// let model = Model::load(rigidformer_weights::EDGE)?; // or any aligned bytes, in flash
/// assert_eq!(model.config().command_size, 0);
/// assert!(matches!(Model::load(b"no model"), Err(LoadError::Format(_))));
/// # Ok::<(), LoadError>(())
/// ```
pub struct Model<'m> {
    file: ModelFile<'m>,
    config: ModelConfig,
    pub(crate) encoder: Encoder<'m>,
    /// (registers, width)
    pub(crate) registers: &'m [f32],
    pub(crate) blocks: heapless::Vec<Block<'m>, MAX_BLOCKS>,
    pub(crate) anchors: Anchors<'m>,
    /// (frequencies) rad/m
    pub(crate) rope_frequencies: &'m [f32],
    /// What a point of a soft body adds to the blend of its anchors.
    #[cfg(feature = "deform")]
    pub(crate) blend: Option<Mlp<'m>>,
    /// Of the blend's kernel, in radii of units.
    #[cfg(feature = "deform")]
    pub(crate) blend_radius: f32,
    /// Only in files of version 7.
    #[cfg(feature = "deform")]
    pub(crate) breaking: Option<Breaking<'m>>,
}

/// What says which bonds break.
#[cfg(feature = "deform")]
pub(crate) struct Breaking<'m> {
    pub(crate) mean: &'m [f32],
    pub(crate) scale: &'m [f32],
    pub(crate) net: Mlp<'m>,
}

pub(crate) struct Encoder<'m> {
    pub(crate) feature_mean: &'m [f32],
    pub(crate) feature_scale: &'m [f32],
    pub(crate) point: Chain<'m>,
    /// For models with impacts.
    pub(crate) impact: Option<Impacts<'m>>,
    pub(crate) fuse: Mlp<'m>,
    pub(crate) film: Film<'m>,
    pub(crate) command: Option<Film<'m>>,
}

pub(crate) struct Impacts<'m> {
    pub(crate) mean: &'m [f32],
    pub(crate) scale: &'m [f32],
    pub(crate) network: Chain<'m>,
}

pub(crate) struct Block<'m> {
    pub(crate) norm: &'m [f32],
    pub(crate) qkvg: Linear<'m>,
    pub(crate) query_norm: &'m [f32],
    pub(crate) key_norm: &'m [f32],
    pub(crate) out: Linear<'m>,
    pub(crate) film: Film<'m>,
    pub(crate) command: Option<Film<'m>>,
    pub(crate) feed_forward_norm: &'m [f32],
    pub(crate) gate_up: Linear<'m>,
    pub(crate) down: Linear<'m>,
}

pub(crate) struct Anchors<'m> {
    pub(crate) position_mean: &'m [f32],
    pub(crate) position_scale: &'m [f32],
    /// Reach of anchor-vertex pooling, metres.
    pub(crate) sigma_m: f32,
    pub(crate) avp: Mlp<'m>,
    pub(crate) query: Mlp<'m>,
    pub(crate) cross: heapless::Vec<Cross<'m>, MAX_SCALES>,
    pub(crate) fuse: Linear<'m>,
    pub(crate) film: Film<'m>,
    pub(crate) norm: &'m [f32],
    pub(crate) head: Mlp<'m>,
}

pub(crate) struct Cross<'m> {
    pub(crate) input_norm: &'m [f32],
    pub(crate) unit_norm: &'m [f32],
    pub(crate) query_gate: Linear<'m>,
    pub(crate) key_value: Linear<'m>,
    pub(crate) query_norm: &'m [f32],
    pub(crate) key_norm: &'m [f32],
}

/// Identifies a tensor by name, with an index in the middle where it has one.
const fn id(prefix: &'static str, index: Option<u32>, suffix: &'static str) -> TensorId {
    TensorId { prefix, index, suffix }
}

/// A two-layer network: `mlp!(loader, "prefix", index, ".suffix", [inputs, hidden, outputs])`.
macro_rules! mlp {
    ($loader:expr, $prefix:literal, $index:expr, $suffix:literal, $sizes:expr) => {
        $loader.mlp(
            [
                id($prefix, $index, concat!($suffix, ".0.weight")),
                id($prefix, $index, concat!($suffix, ".0.bias")),
                id($prefix, $index, concat!($suffix, ".1.weight")),
                id($prefix, $index, concat!($suffix, ".1.bias")),
            ],
            $sizes,
        )?
    };
}

impl<'m> Model<'m> {
    /// Checks a packed model completely and views it in place.
    ///
    /// # Errors
    /// [`LoadError`] names the first fault of the file, or the first tensor that is missing,
    /// of another shape than its configuration calls for, or of a type this build cannot read.
    pub fn load(bytes: &'m [u8]) -> Result<Self, LoadError> {
        in_own_environment(|| Self::view(ModelFile::parse(bytes)?))
    }

    /// As [`load`](Self::load) of bytes that were [checked](ModelFile::checked) before and have not
    /// changed since: only the header is read again.
    ///
    /// # Errors
    /// As [`load`](Self::load).
    #[cfg(feature = "host")]
    pub fn load_again(
        bytes: &'m [u8],
        checked: &rigidformer_weights::Checked,
    ) -> Result<Self, LoadError> {
        in_own_environment(|| Self::view(ModelFile::parse_again(bytes, checked)?))
    }

    fn view(file: ModelFile<'m>) -> Result<Self, LoadError> {
        let config = *file.config();
        let c = &config;
        if c.blocks as usize > MAX_BLOCKS {
            return Err(LoadError::Blocks { found: c.blocks, limit: MAX_BLOCKS as u32 });
        }
        if c.scales.len() > MAX_SCALES {
            return Err(LoadError::Scales {
                found: c.scales.len() as u32,
                limit: MAX_SCALES as u32,
            });
        }
        if c.command_size as usize > MAX_COMMAND {
            return Err(LoadError::Command { found: c.command_size, limit: MAX_COMMAND as u32 });
        }
        if !ROBOT && c.motion.is_robot() {
            return Err(LoadError::Heading);
        }
        if cfg!(not(feature = "deform")) && c.motion.is_soft() {
            return Err(LoadError::Soft);
        }
        if cfg!(not(feature = "deform")) && c.bonds > 0 {
            return Err(LoadError::Bonds);
        }
        // Readers of the format without `host` refuse hidden widths themselves.
        #[cfg(all(feature = "host", not(rigidformer_host)))]
        if c.hidden.point != [0, 0] {
            return Err(LoadError::PointHidden);
        }
        if cfg!(not(feature = "host")) && c.scope.is_near() {
            // As a reader of the format without it says.
            return Err(rigidformer_weights::FormatError::Version { found: 8, supported: 7 }.into());
        }
        let loader = Loader { file: &file };
        let width = c.width as usize;
        let mut blocks = heapless::Vec::new();
        for i in 0..c.blocks {
            // The length was checked above.
            let _ = blocks.push(loader.block(c, i)?);
        }
        let mut cross = heapless::Vec::new();
        for k in 0..c.scales.len() as u32 {
            let _ = cross.push(loader.cross(c, k)?);
        }
        let encoder = loader.encoder(c)?;
        let anchors = loader.anchors(c, cross)?;
        let registers = match c.registers as usize {
            // A file holds no empty tensors.
            0 => &[],
            count => loader.matrix(id("registers", None, ""), count, width)?,
        };
        let rope_frequencies =
            loader.vector(id("rope_frequencies", None, ""), c.rope_frequencies as usize)?;
        #[cfg(feature = "deform")]
        let (blend, blend_radius) = match c.motion.is_soft() {
            true => {
                let inputs = c.point_width as usize + BLEND_CODE;
                let net = mlp!(loader, "blend.residual", None, "", [inputs, BLEND_HIDDEN, 6]);
                let radius = loader.vector(id("log_radius", None, ""), 1)?;
                let radius = radius.first().copied().unwrap_or_default();
                (Some(net), math::exp(radius))
            }
            false => (None, 0.0),
        };
        #[cfg(feature = "deform")]
        let breaking = if c.bonds == 0 { None } else { Some(loader.breaking(c)?) };
        Ok(Model {
            config,
            encoder,
            registers,
            blocks,
            anchors,
            rope_frequencies,
            #[cfg(feature = "deform")]
            blend,
            #[cfg(feature = "deform")]
            blend_radius,
            #[cfg(feature = "deform")]
            breaking,
            file,
        })
    }

    /// The file: name, provenance, metrics and tensors.
    pub fn file(&self) -> &ModelFile<'m> {
        &self.file
    }

    /// Sizes and physics.
    pub fn config(&self) -> &ModelConfig {
        &self.config
    }
}

struct Loader<'f, 'm> {
    file: &'f ModelFile<'m>,
}

/// As `Display` writes it, without the formatting code, which would be much of a firmware's text. Every name is
/// shorter; a cut one would merely not be found.
fn name(id: &TensorId) -> heapless::String<96> {
    let mut name = heapless::String::new();
    let _ = name.push_str(id.prefix);
    if let Some(index) = id.index {
        for (digit, from) in [(index / 100 % 10, 100), (index / 10 % 10, 10), (index % 10, 0)] {
            if index >= from {
                let _ = name.push(char::from_digit(digit, 10).unwrap_or_default());
            }
        }
    }
    let _ = name.push_str(id.suffix);
    name
}

impl<'m> Loader<'_, 'm> {
    fn tensor(
        &self,
        id: TensorId,
        rows: usize,
        columns: usize,
    ) -> Result<TensorData<'m>, LoadError> {
        let tensor = self.file.tensor(&name(&id)).ok_or(LoadError::MissingTensor(id))?;
        let expected = [rows as u32, columns as u32];
        let found = match tensor.shape {
            Shape::Scalar => [1, 1],
            Shape::Vector(length) => [length, 1],
            Shape::Matrix { rows, columns } => [rows, columns],
        };
        if found != expected {
            return Err(LoadError::Shape { tensor: id, expected, found });
        }
        Ok(tensor.data)
    }

    fn matrix(&self, id: TensorId, rows: usize, columns: usize) -> Result<&'m [f32], LoadError> {
        match self.tensor(id, rows, columns)? {
            TensorData::F32(values) => Ok(values),
            _ => Err(LoadError::Dtype(id)),
        }
    }

    fn vector(&self, id: TensorId, length: usize) -> Result<&'m [f32], LoadError> {
        self.matrix(id, length, 1)
    }

    fn linear(
        &self,
        weight: TensorId,
        bias: Option<TensorId>,
        inputs: usize,
        outputs: usize,
    ) -> Result<Linear<'m>, LoadError> {
        let data = self.tensor(weight, outputs, inputs)?;
        let weight = Storage::new(data).ok_or(LoadError::Dtype(weight))?;
        let bias = match bias {
            Some(id) => self.vector(id, outputs)?,
            None => &[],
        };
        Ok(Linear { weight, bias, inputs })
    }

    fn mlp(
        &self,
        [weight, bias, second_weight, second_bias]: [TensorId; 4],
        [inputs, hidden, outputs]: [usize; 3],
    ) -> Result<Mlp<'m>, LoadError> {
        Ok(Mlp {
            first: self.linear(weight, Some(bias), inputs, hidden)?,
            second: self.linear(second_weight, Some(second_bias), hidden, outputs)?,
        })
    }

    fn point(&self, c: &ModelConfig) -> Result<Chain<'m>, LoadError> {
        let layer = |index: u32, inputs, outputs| {
            let weight = id("encoder.point.", Some(index), ".weight");
            self.linear(weight, Some(id("encoder.point.", Some(index), ".bias")), inputs, outputs)
        };
        let (features, points) = (c.features.len(), c.point_width as usize);
        if cfg!(not(rigidformer_host)) {
            let Mlp { first, second: last } =
                mlp!(self, "encoder.point", None, "", [features, points, points]);
            return Ok(Chain { first, middle: None, last });
        }
        let [hidden, second] = c.point_hidden().map(|width| width as usize);
        let first = layer(0, features, hidden)?;
        Ok(match second {
            0 => Chain { first, middle: None, last: layer(1, hidden, points)? },
            _ => {
                let middle = Some(layer(1, hidden, second)?);
                Chain { first, middle, last: layer(2, second, points)? }
            }
        })
    }

    fn impacts(&self, points: usize) -> Result<Impacts<'m>, LoadError> {
        let Mlp { first, second: last } =
            mlp!(self, "encoder.impact", None, "", [IMPACT_FEATURES, points, points]);
        Ok(Impacts {
            mean: self.vector(id("encoder.impact_mean", None, ""), IMPACT_FEATURES)?,
            scale: self.vector(id("encoder.impact_scale", None, ""), IMPACT_FEATURES)?,
            network: Chain { first, middle: None, last },
        })
    }

    fn encoder(&self, c: &ModelConfig) -> Result<Encoder<'m>, LoadError> {
        let features = c.features.len();
        let (points, width) = (c.point_width as usize, c.width as usize);
        let (film, command) = (c.film_width as usize, c.command_size as usize);
        let fuse = c.fuse_hidden() as usize;
        Ok(Encoder {
            feature_mean: self.vector(id("encoder.feature_mean", None, ""), features)?,
            feature_scale: self.vector(id("encoder.feature_scale", None, ""), features)?,
            point: self.point(c)?,
            impact: if c.features.has_impacts() { Some(self.impacts(points)?) } else { None },
            fuse: mlp!(self, "encoder.fuse", None, "", [pools(c) * points, fuse, width]),
            film: Film { mlp: mlp!(self, "encoder.film.mlp", None, "", [2, film, 2 * width]) },
            command: if command == 0 {
                None
            } else {
                let mlp = mlp!(self, "encoder.command.mlp", None, "", [command, film, 2 * width]);
                Some(Film { mlp })
            },
        })
    }

    #[cfg(feature = "deform")]
    fn breaking(&self, c: &ModelConfig) -> Result<Breaking<'m>, LoadError> {
        let inputs = crate::sizes::bond_inputs(c);
        Ok(Breaking {
            mean: self.vector(id("bonds.feature_mean", None, ""), BOND_FEATURES)?,
            scale: self.vector(id("bonds.feature_scale", None, ""), BOND_FEATURES)?,
            net: mlp!(self, "bonds.net", None, "", [inputs, c.bonds as usize, 1]),
        })
    }

    fn block(&self, c: &ModelConfig, i: u32) -> Result<Block<'m>, LoadError> {
        let width = c.width as usize;
        let head_dim = c.head_dim as usize;
        let inner = c.heads as usize * head_dim;
        let hidden = c.feed_forward_width as usize;
        let (film, command) = (c.film_width as usize, c.command_size as usize);
        let i = Some(i);
        let name = |suffix| id("blocks.", i, suffix);
        Ok(Block {
            norm: self.vector(name(".attention.norm.weight"), width)?,
            qkvg: self.linear(name(".attention.qkvg.weight"), None, width, 4 * inner)?,
            query_norm: self.vector(name(".attention.query_norm.weight"), head_dim)?,
            key_norm: self.vector(name(".attention.key_norm.weight"), head_dim)?,
            out: self.linear(name(".attention.out.weight"), None, inner, width)?,
            film: Film { mlp: mlp!(self, "blocks.", i, ".film.mlp", [2, film, 2 * width]) },
            command: if command == 0 {
                None
            } else {
                Some(Film {
                    mlp: mlp!(self, "blocks.", i, ".command.mlp", [command, film, 2 * width]),
                })
            },
            feed_forward_norm: self.vector(name(".feed_forward.norm.weight"), width)?,
            gate_up: self.linear(name(".feed_forward.gate_up.weight"), None, width, 2 * hidden)?,
            down: self.linear(name(".feed_forward.down.weight"), None, hidden, width)?,
        })
    }

    fn cross(&self, c: &ModelConfig, k: u32) -> Result<Cross<'m>, LoadError> {
        let width = c.width as usize;
        let head_dim = c.head_dim as usize;
        let inner = c.heads as usize * head_dim;
        let name = |suffix| id("anchors.cross.", Some(k), suffix);
        Ok(Cross {
            input_norm: self.vector(name(".input_norm.weight"), width)?,
            unit_norm: self.vector(name(".unit_norm.weight"), width)?,
            query_gate: self.linear(name(".query_gate.weight"), None, width, 2 * inner)?,
            key_value: self.linear(name(".key_value.weight"), None, width, 2 * inner)?,
            query_norm: self.vector(name(".query_norm.weight"), head_dim)?,
            key_norm: self.vector(name(".key_norm.weight"), head_dim)?,
        })
    }

    fn anchors(
        &self,
        c: &ModelConfig,
        cross: heapless::Vec<Cross<'m>, MAX_SCALES>,
    ) -> Result<Anchors<'m>, LoadError> {
        let width = c.width as usize;
        let inner = c.heads as usize * c.head_dim as usize;
        let (points, avp) = (c.point_width as usize, c.avp_width as usize);
        let film = c.film_width as usize;
        let log_sigma = self.vector(id("anchors.log_sigma", None, ""), 1)?;
        Ok(Anchors {
            position_mean: self.vector(id("anchors.position_mean", None, ""), 3)?,
            position_scale: self.vector(id("anchors.position_scale", None, ""), 3)?,
            sigma_m: math::exp(log_sigma.first().copied().unwrap_or_default()),
            avp: mlp!(self, "anchors.avp", None, "", [points, avp, avp]),
            query: mlp!(self, "anchors.query", None, "", [query_inputs(c), width, width]),
            fuse: self.linear(
                id("anchors.fuse.weight", None, ""),
                Some(id("anchors.fuse.bias", None, "")),
                cross.len() * inner,
                width,
            )?,
            cross,
            film: Film { mlp: mlp!(self, "anchors.film.mlp", None, "", [2, film, 2 * width]) },
            norm: self.vector(id("anchors.norm.weight", None, ""), width)?,
            head: mlp!(self, "anchors.head", None, "", [width, width, c.motion.outputs()]),
        })
    }
}
