//! The options of `rigidformer calibrate`, and of those that take what it writes.

use std::path::PathBuf;

use clap::Args;

use super::{Model, SplitName};

/// The option that names a file of contact's numbers.
#[derive(Args)]
pub(crate) struct Contact {
    /// Contact's numbers, as `calibrate` wrote them, in place of those of the scenes
    #[arg(id = "contact", long = "contact", value_name = "FILE.toml")]
    pub(crate) path: Option<PathBuf>,
}

#[derive(Args)]
#[command(after_help = "\
All scenes are rolled out in open loop with many numbers, and those count with which the rollouts come nearest to the record. Scenes
with unit_velocity, such as recorded tosses, begin with the poses and velocities of frame 0; others with the frames 0 and S.
What counts is a scene's mean position error in per cent of the units' size, plus .8 times its mean rotation error in degrees.

Numbers, by group:
  friction      of a unit with the roughest plane, the product of both coefficients
  stiffness     of a unit's contact points against what is rigid, N/m, and what they lose, s/m: compliant contact
  restitution   as friction; in place of stiffness, for contact that is rigid
  gravity       by that in the file; below 1 where a record's lengths are too short
  height        of the table above where the file has it: the plane that faces gravity most
  tilt          of the table, along x and along y
  inertia       a factor of all moments of inertia
They are the same for all scenes, units and planes. Without --fit all are fitted but restitution, which counts for nothing where
contact is compliant.

Scenes are fitted to that are of the split train, and the split test is only measured. A file without such scenes gives all, or the
N of --train, and the others are the test. Of several starts the one counts that does best on the validation scenes.

An interval holds 90 % of fits to resampled scenes. Each of those is where a quadratic is least that was fitted to costs around
the end of the search; a bound with < or > in front goes on beyond where that was fitted.

The same seed gives the same numbers, to the bit, on any number of threads. With --resume a state is kept in a file: after Ctrl-C
the same command goes on from there, and ends as if it had not been stopped.

Examples:
  rigidformer calibrate cube-tosses.safetensors --out contact.toml
  rigidformer evaluate cube-tosses.safetensors --steps 2 --contact contact.toml
  rigidformer calibrate cube-tosses.safetensors --without-network --train 30 --fit friction,stiffness --seed 3 --json
  rigidformer calibrate elbow-tosses.safetensors --join --out elbow.toml
  rigidformer calibrate tracked.safetensors --train 20 --validation 0.25 --step 1 --resume calibration.state --out contact.toml")]
pub(crate) struct Calibrate {
    /// Scene file with recorded poses, such as one of `rigidformer_lab.tosses` or one that `track` wrote
    #[arg(value_name = "RECORDING")]
    pub(crate) scenes: PathBuf,
    #[command(flatten)]
    pub(crate) model: Model,
    /// Impulses alone: the model's motion without what its network corrects
    #[arg(long)]
    pub(crate) without_network: bool,
    /// Which numbers, groups with commas between [default: all but restitution]
    #[arg(long, value_name = "GROUPS", value_delimiter = ',')]
    pub(crate) fit: Vec<String>,
    /// Hold the parts of each body together at pivots that are found from frames 0 to S; of a file with unit_velocity from
    /// frames 0 to 10
    #[arg(long)]
    pub(crate) join: bool,
    /// The split whose scenes are fitted to [default: train; of a file without it, all scenes]
    #[arg(long, value_enum)]
    pub(crate) split: Option<SplitName>,
    /// Fit to N of these scenes, drawn by the seed [default: all]
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(1..))]
    pub(crate) train: Option<u32>,
    /// Choose among starts by this share of the scenes to fit to instead, from 0 to .9 [default: the split validation]
    #[arg(long, value_name = "SHARE", value_parser = share)]
    pub(crate) validation: Option<f32>,
    /// Only the first N scenes of each split
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(1..))]
    pub(crate) limit: Option<u32>,
    /// Step code: native frames of the model (s/240 s), or frames of a record without unit_velocity
    #[arg(long, value_name = "S", default_value_t = 2, value_parser = clap::value_parser!(u32).range(1..=100))]
    pub(crate) step: u32,
    /// What a per cent of the units' size and a degree cost, with commas between
    #[arg(long, value_name = "P,R", value_delimiter = ',', num_args = 1, default_value = "1,0.8", value_parser = weight)]
    pub(crate) weights: Vec<f64>,
    /// Searches from different places; the first one's is what the scenes have
    #[arg(long, value_name = "N", default_value_t = 2, value_parser = clap::value_parser!(u8).range(1..=16))]
    pub(crate) starts: u8,
    /// Rollouts of all these scenes in a search, at most
    #[arg(long, value_name = "N", default_value_t = 400, value_parser = clap::value_parser!(u32).range(4..=100_000))]
    pub(crate) evaluations: u32,
    /// Resampled sets of scenes that intervals are of; 0: no intervals
    #[arg(long, value_name = "N", default_value_t = 400, value_parser = clap::value_parser!(u32).range(..=10_000))]
    pub(crate) resamples: u32,
    /// Which starts, scenes and resamples
    #[arg(long, value_name = "N", default_value_t = 1)]
    pub(crate) seed: u64,
    /// Keep what was computed in this file, and go on from it where it is there
    #[arg(long, value_name = "FILE")]
    pub(crate) resume: Option<PathBuf>,
    /// File of contact's numbers to write, for --contact
    #[arg(long, value_name = "FILE.toml")]
    pub(crate) out: Option<PathBuf>,
    /// Print one JSON document instead of tables
    #[arg(long)]
    pub(crate) json: bool,
}

fn share(text: &str) -> Result<f32, String> {
    let number: f32 = text.parse().map_err(|_| "is not a number".to_owned())?;
    if (0.0..=0.9).contains(&number) { Ok(number) } else { Err("is not from 0 to 0.9".into()) }
}

fn weight(text: &str) -> Result<f64, String> {
    let number: f64 = text.parse().map_err(|_| "is not a number".to_owned())?;
    if (0.0..=1e6).contains(&number) { Ok(number) } else { Err("is not from 0 to 1e6".into()) }
}
