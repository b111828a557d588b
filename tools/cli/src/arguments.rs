//! The command line.

use std::path::PathBuf;

use clap::{Args, Parser, Subcommand, ValueEnum};
use rigidformer_runtime::models::Precision;
use rigidformer_runtime::scenes::Split;

/// Rigid bodies, predicted: points in, poses out.
#[derive(Parser)]
#[command(name = "rigidformer", version, propagate_version = true)]
#[command(after_help = "Exit codes: 0 done, 1 failed, 2 wrong usage, 130 interrupted.")]
pub(crate) struct Arguments {
    #[command(subcommand)]
    pub(crate) command: Command,
}

#[derive(Subcommand)]
pub(crate) enum Command {
    /// Predict one recorded scene; compare with the record and with free fall; draw both
    Rollout(Rollout),
    /// Measure a model on a split of a data set, beside free fall and the published figures
    Evaluate(Evaluate),
    /// Describe a model or a scene file
    Inspect(Inspect),
    /// Turn a model exported by the lab into a packed model
    Pack(Pack),
}

#[derive(Args)]
#[command(after_help = "\
Writes into DIR:
  poses.csv   frame, time, unit, predicted pose, recorded pose (the first two frames are observed)
  errors.png  position and orientation error over time, the model's and free fall's
  strip.png   predicted and recorded units at four instants

Examples:
  rigidformer rollout
  rigidformer rollout movi-b.safetensors --index 71 --step 5 --frames 100 --out b72
  rigidformer rollout --model edge.rfm --step 1")]
pub(crate) struct Rollout {
    /// Scene file [default: a scene that comes with the program]
    pub(crate) scene: Option<PathBuf>,
    /// Which scene of the file, from 0 [default: its first of the test split, else its first]
    #[arg(long, value_name = "I")]
    pub(crate) index: Option<usize>,
    #[command(flatten)]
    pub(crate) model: Model,
    /// Frames of the record between two predictions; frames 0 and S are observed
    #[arg(long, value_name = "S", default_value_t = 10, value_parser = clap::value_parser!(u32).range(1..))]
    pub(crate) step: u32,
    /// Last frame to predict [default: the last recorded one, at most 120]
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(1..))]
    pub(crate) frames: Option<u32>,
    /// Folder for the results, made if need be
    #[arg(long, value_name = "DIR", default_value = "rollout")]
    pub(crate) out: PathBuf,
}

#[derive(Args)]
#[command(after_help = "\
Errors are those of HopNet's protocol: per scene and frame the root mean square over units, then the mean over scenes.

Examples:
  rigidformer evaluate movi-a.safetensors
  rigidformer evaluate movi-sphere.safetensors --model edge.rfm --steps 10 --limit 12
  rigidformer evaluate movi-b.safetensors --split validation --json > b.json")]
pub(crate) struct Evaluate {
    /// Scene file with at least 101 frames
    pub(crate) dataset: PathBuf,
    /// Which scenes
    #[arg(long, value_enum, default_value_t = SplitName::Test)]
    pub(crate) split: SplitName,
    #[command(flatten)]
    pub(crate) model: Model,
    /// Step codes, with commas between
    #[arg(long, value_name = "S", value_delimiter = ',', default_value = "1,5,10")]
    #[arg(value_parser = clap::value_parser!(u32).range(1..=100))]
    pub(crate) steps: Vec<u32>,
    /// Only the first N scenes of the split
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(1..))]
    pub(crate) limit: Option<u32>,
    /// Print one JSON document instead of tables
    #[arg(long)]
    pub(crate) json: bool,
}

#[derive(Args)]
#[command(after_help = "\
Models: name, sizes, configuration, tensors, provenance, metrics. Scene files: counts, splits, shapes; every pose is checked.

Examples:
  rigidformer inspect edge.rfm
  rigidformer inspect movi-a.safetensors --json")]
pub(crate) struct Inspect {
    /// Packed model or scene file; which one is told from its contents
    pub(crate) file: PathBuf,
    /// Print one JSON document instead of text
    #[arg(long)]
    pub(crate) json: bool,
}

#[derive(Args)]
#[command(after_help = "\
The result has been loaded before it is written: a missing or misshapen tensor is an error here.

Types: f32 is the reference; i8 has one scale per output channel and keeps the first and the last layer f16; mixed keeps
the point network, the anchor queries and the head f16 besides; f16 is f16 throughout. Norms and biases stay f32.

Examples:
  python -m rigidformer_lab.export runs/edge/checkpoint.pt --out edge.safetensors
  rigidformer pack edge.safetensors --out edge.rfm
  rigidformer pack edge.rfm --dtype i8 --out edge-i8.rfm
  rigidformer pack edge.rfm --dtype i8 --wide blocks.0.attention.qkvg --out edge-i8.rfm --json")]
pub(crate) struct Pack {
    /// Model exported by rigidformer_lab.export (safetensors), or a packed f32 model
    #[arg(value_name = "IN")]
    pub(crate) input: PathBuf,
    /// Packed model to write
    #[arg(long, value_name = "OUT")]
    pub(crate) out: PathBuf,
    /// Type of the linear layers' weights
    #[arg(long, value_enum, default_value_t = PrecisionName::F32)]
    pub(crate) dtype: PrecisionName,
    /// Keep this layer f16 in an i8 or mixed model; may be given more than once
    #[arg(long, value_name = "LAYER")]
    pub(crate) wide: Vec<String>,
    /// Print one JSON document instead of a table
    #[arg(long)]
    pub(crate) json: bool,
}

/// Types as the command line calls them.
#[derive(Clone, Copy, ValueEnum)]
pub(crate) enum PrecisionName {
    F32,
    F16,
    I8,
    Mixed,
}

impl From<PrecisionName> for Precision {
    fn from(name: PrecisionName) -> Self {
        match name {
            PrecisionName::F32 => Precision::F32,
            PrecisionName::F16 => Precision::F16,
            PrecisionName::I8 => Precision::I8,
            PrecisionName::Mixed => Precision::Mixed,
        }
    }
}

#[derive(Args)]
pub(crate) struct Model {
    /// Packed model [default: the one that comes with the program, if it was built with one]
    #[arg(long = "model", value_name = "M")]
    pub(crate) path: Option<PathBuf>,
}

#[derive(Clone, Copy, ValueEnum)]
pub(crate) enum SplitName {
    Train,
    Validation,
    Test,
    Extra,
}

impl From<SplitName> for Split {
    fn from(name: SplitName) -> Split {
        match name {
            SplitName::Train => Split::Train,
            SplitName::Validation => Split::Validation,
            SplitName::Test => Split::Test,
            SplitName::Extra => Split::Extra,
        }
    }
}
