//! Arguments of `rigidformer inspect`.

use std::path::PathBuf;

use clap::Args;

use super::model::Model;
use super::split::SplitName;

#[derive(Args)]
#[command(after_help = "\
Models: name, sizes, configuration, tensors, provenance, metrics. Scene files: counts, splits, shapes; every pose is checked.

--health looks at every unit every S frames: as it was recorded, and as it is predicted from the frames 0 and S. A unit is outside where
one of its quantities, such as its speed or its radius, is farther outside than a twentieth of the range that training saw. Needs a
model that says what training saw: `rigidformer pack --ranges`.

Examples:
  rigidformer inspect edge.rfm
  rigidformer inspect edge.rfm --card
  rigidformer inspect movi-a.safetensors --json
  rigidformer inspect movi-a.safetensors --health --split extra
  rigidformer inspect scenes.safetensors --health --split train --model edge.rfm --step 5 --json")]
pub(crate) struct Inspect {
    /// Packed model or scene file; which one is told from its contents
    pub(crate) file: PathBuf,
    /// Count the units of a scene file that are unlike what the training of --model saw
    #[arg(long)]
    pub(crate) health: bool,
    /// Print a model's card, in Markdown: data, training, figures with the network and without it, where it fails, licence
    #[arg(long, conflicts_with_all = ["health", "json"])]
    pub(crate) card: bool,
    #[command(flatten)]
    pub(crate) looks: Health,
    /// Print one JSON document instead of text
    #[arg(long)]
    pub(crate) json: bool,
}

/// What goes with `--health`.
#[derive(Args)]
pub(crate) struct Health {
    /// With --health: which scenes
    #[arg(long, value_enum, default_value_t = SplitName::Test, requires = "health")]
    pub(crate) split: SplitName,
    #[command(flatten)]
    pub(crate) model: Model,
    /// With --health: frames between two looks, and of a prediction
    #[arg(long, value_name = "S", default_value_t = 10, requires = "health", value_parser = clap::value_parser!(u32).range(1..=100))]
    pub(crate) step: u32,
    /// With --health: the last frame to look at
    #[arg(long, value_name = "N", default_value_t = 100, requires = "health", value_parser = clap::value_parser!(u32).range(1..=100_000))]
    pub(crate) last_frame: u32,
    /// With --health: only the first N scenes of the split
    #[arg(long, value_name = "N", requires = "health", value_parser = clap::value_parser!(u32).range(1..))]
    pub(crate) limit: Option<u32>,
}
