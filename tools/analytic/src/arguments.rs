//! The command line.

use std::path::PathBuf;

use clap::{Args, Parser, Subcommand, ValueEnum};
use rigidformer_evaluation::scenes::Split;

/// Yardsticks for learned rigid bodies, from an analytic engine
#[derive(Parser)]
#[command(name = "rigidformer-analytic", version, propagate_version = true)]
#[command(after_help = "Exit codes: 0 done, 1 failed, 2 wrong usage.")]
pub(crate) struct Arguments {
    #[command(subcommand)]
    pub(crate) command: Command,
}

#[derive(Subcommand)]
pub(crate) enum Command {
    /// Predict recorded scenes with the Rapier engine, which is told what a model is not
    Rapier(Rapier),
    /// How deep units are in each other and in the ground, recorded and as a model predicts
    Overlap(Overlap),
    /// What a model does to units that have come to rest
    Rest(Rest),
    /// Whether long rollouts stay finite and above the ground
    Long(Long),
    /// How long impulses alone and Rapier take for the same scenes, in turns
    Time(Time),
}

#[derive(Args)]
#[command(after_help = "\
Rapier is given the friction and restitution of units and ground, combined by multiplication as Bullet does, and the
convex hulls of the units' points: also of shapes that are not convex, whose hollows are then filled. Like a model it
starts from frames 0 and S: their difference, corrected by half a step of gravity, is the velocity at frame S. Nothing
sleeps, nothing is damped. The body frame's origin is the centre of mass. The ground is a slab 200 m wide.

Inertia: Bullet, which made the records, gives a convex hull the inertia of the box around it. With `hull` a unit has
that of its hull, filled evenly: right for a body, not the recorded one.

Errors are those of HopNet's protocol: per scene and frame the root mean square over units, then the mean over scenes.
As with a model only every S-th frame is taken: where frame 50, 75 or 100 is none of them, it is interpolated.

Examples:
  rigidformer-analytic rapier wrecking-216.safetensors --steps 8
  rigidformer-analytic rapier movi-a.safetensors
  rigidformer-analytic rapier movi-b.safetensors --split validation --limit 20 --steps 10 --inertia box")]
pub(crate) struct Rapier {
    /// Scene file with at least 101 frames
    pub(crate) dataset: PathBuf,
    #[command(flatten)]
    pub(crate) scenes: Scenes,
    /// Step codes, with commas between: frames 0 and S are observed
    #[arg(long, value_name = "S", value_delimiter = ',', default_value = "1,5,10")]
    #[arg(value_parser = clap::value_parser!(u32).range(1..=25))]
    pub(crate) steps: Vec<u32>,
    /// Time steps of the engine per recorded frame; 10 make 1/2400 s at 240 Hz
    #[arg(long, value_name = "N", default_value_t = 10, value_parser = clap::value_parser!(u32).range(1..=1000))]
    pub(crate) sub_steps: u32,
    /// Where a unit's moments of inertia come from
    #[arg(long, value_enum, default_value_t = Inertia::Hull)]
    pub(crate) inertia: Inertia,
    /// Units of at least 120 points on a sphere are balls, not hulls
    #[arg(long)]
    pub(crate) balls: bool,
    /// Print one JSON document instead of a table
    #[arg(long)]
    pub(crate) json: bool,
}

/// Where a unit's moments of inertia come from.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub(crate) enum Inertia {
    /// The convex hull of its points, evenly filled
    Hull,
    /// The box around its points, evenly filled, as in Bullet
    Box,
    /// What the scene file gives, else the hull's
    File,
}

#[derive(Args)]
#[command(after_help = "\
Depth is that of the convex hulls of the units' points, by parry: the least distance that parts them. Of shapes that are
not convex the hulls overlap also where the shapes only interlock; the record's own figures are the yardstick.

Looked at are the frames that the model predicts. Shares are of all units at all those frames; the percentiles are over
the pairs of units (or, for the ground, over the units) at frames where the record or the rollout overlaps.

Examples:
  rigidformer-analytic overlap movi-a.safetensors --split validation --limit 40
  rigidformer-analytic overlap movi-b.safetensors --model edge-i8.rfm --step 5 --json")]
pub(crate) struct Overlap {
    /// Scene file
    pub(crate) dataset: PathBuf,
    #[command(flatten)]
    pub(crate) model: Model,
    #[command(flatten)]
    pub(crate) scenes: Scenes,
    /// Frames of the record between two predictions; frames 0 and S are observed
    #[arg(long, value_name = "S", default_value_t = 10, value_parser = clap::value_parser!(u32).range(1..=10_000))]
    pub(crate) step: u32,
    /// Last frame to look at
    #[arg(long, value_name = "N", default_value_t = 100, value_parser = clap::value_parser!(u32).range(1..=1_000_000))]
    pub(crate) frame: u32,
    /// Print one JSON document instead of a table
    #[arg(long)]
    pub(crate) json: bool,
}

#[derive(Args)]
#[command(after_help = "\
A unit rests if its net motion over the last 10 recorded frames is below 1 cm/s and 2 deg/s. A rollout of the whole scene
starts from the last recorded frame and the one S before it. Drift is measured against the last recorded frame. Energy
is potential and kinetic energy per kilogram, from the poses of two frames S apart and the inertia of the hull.

Other units of a scene may still move and push those that rest. Rapier's rollout from the same two frames, with the box's
inertia, shows how much of the drift that is; it comes with half a step's fall as its velocity, as in `rapier`, and so
settles before it rests.

Examples:
  rigidformer-analytic rest movi-a.safetensors --split validation
  rigidformer-analytic rest movi-sphere.safetensors --model edge-i8.rfm --frames 960")]
pub(crate) struct Rest {
    /// Scene file
    pub(crate) dataset: PathBuf,
    #[command(flatten)]
    pub(crate) model: Model,
    #[command(flatten)]
    pub(crate) scenes: Scenes,
    /// Frames of the record between two predictions
    #[arg(long, value_name = "S", default_value_t = 10, value_parser = clap::value_parser!(u32).range(1..=10_000))]
    pub(crate) step: u32,
    /// Frames to predict
    #[arg(long, value_name = "N", default_value_t = 480, value_parser = clap::value_parser!(u32).range(1..=1_000_000))]
    pub(crate) frames: u32,
    /// Print one JSON document instead of a table
    #[arg(long)]
    pub(crate) json: bool,
}

#[derive(Args)]
#[command(after_help = "\
A unit is lost once its lowest point is more than 5 cm below the ground, and low if it is more than 1 mm below at the last
predicted frame. A rollout that is not finite ends where the
simulator refuses to go on, and counts as one that is not.

Examples:
  rigidformer-analytic long movi-a.safetensors --split validation --limit 40
  rigidformer-analytic long movi-b.safetensors --model edge-i8.rfm --steps 10 --frames 2000")]
pub(crate) struct Long {
    /// Scene file
    pub(crate) dataset: PathBuf,
    #[command(flatten)]
    pub(crate) model: Model,
    #[command(flatten)]
    pub(crate) scenes: Scenes,
    /// Step codes, with commas between
    #[arg(long, value_name = "S", value_delimiter = ',', default_value = "1,5,10")]
    #[arg(value_parser = clap::value_parser!(u32).range(1..=10_000))]
    pub(crate) steps: Vec<u32>,
    /// Frames to predict
    #[arg(long, value_name = "N", default_value_t = 500, value_parser = clap::value_parser!(u32).range(1..=1_000_000))]
    pub(crate) frames: u32,
    /// Print one JSON document instead of a table
    #[arg(long)]
    pub(crate) json: bool,
}

#[derive(Args)]
#[command(after_help = "\
Both engines go through every scene from its frame S to frame 100, one after the other. Times are of the steps alone, without the
scene's building. Rapier takes one time step a recorded frame with `--sub-steps 1`, on one thread, which is how it is built by default.

Examples:
  rigidformer-analytic time wrecking-216.safetensors
  rigidformer-analytic time movi-a.safetensors --step 10 --sub-steps 10 --json")]
pub(crate) struct Time {
    /// Scene file with at least 101 frames
    pub(crate) dataset: PathBuf,
    #[command(flatten)]
    pub(crate) scenes: Scenes,
    /// Frames of the record between two predictions; frames 0 and S are observed
    #[arg(long, value_name = "S", default_value_t = 8, value_parser = clap::value_parser!(u32).range(1..=25))]
    pub(crate) step: u32,
    /// Time steps of Rapier per recorded frame; 10 make 1/2400 s at 240 Hz
    #[arg(long, value_name = "N", default_value_t = 1, value_parser = clap::value_parser!(u32).range(1..=1000))]
    pub(crate) sub_steps: u32,
    /// Impulses take all threads; without this, one
    #[arg(long)]
    pub(crate) threads: bool,
    /// Turns; the median of each scene counts
    #[arg(long, value_name = "N", default_value_t = 3, value_parser = clap::value_parser!(u32).range(1..=1000))]
    pub(crate) turns: u32,
    /// Print one JSON document instead of a table
    #[arg(long)]
    pub(crate) json: bool,
}

#[derive(Args)]
pub(crate) struct Scenes {
    /// Which scenes
    #[arg(long, value_enum, default_value_t = SplitName::Test)]
    pub(crate) split: SplitName,
    /// Only the first N scenes of the split
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(1..))]
    pub(crate) limit: Option<u32>,
}

#[derive(Args)]
pub(crate) struct Model {
    /// Packed model [default: the one that comes with the program]
    #[arg(long = "model", value_name = "FILE")]
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
