//! The command line.

use std::path::PathBuf;

use clap::Parser;
use rigidformer_cli::shared::Model;

/// Find the commands that bring a robot to a place, by trying many in the model.
#[derive(Parser)]
#[command(name = "walk", version)]
#[command(after_help = "\
Frames 0 and S of the scene are observed; then the robot is told the first of the commands that were found, for S frames. A
controller looks again after that and plans anew: `python -m rigidformer_lab.research.walk_to` does so, with MuJoCo as the robot.

A command is forward speed, speed to the left (m/s) and turn to the left (rad/s), in the robot's heading. The place is that of its
heaviest part. The same seed gives the same plan, to the bit, unless there is a deadline.

Examples:
  cargo run --release -p rigidformer-planning --example walk -- g1-test.safetensors --model g1.rfm --join --to 2,1
  cargo run --release -p rigidformer-planning --example walk -- g1-test.safetensors --index 3 --model g1.rfm --join --to 0,1.5 --heading 90 --json
  cargo run --release -p rigidformer-planning --example walk -- g1-test.safetensors --model g1.rfm --join --to 2,1 --first 0.5,0,0.2,0.6,0,0,0,0,0")]
pub(crate) struct Walk {
    /// Scene file with a robot
    pub(crate) scene: PathBuf,
    /// Which scene of the file, from 0
    #[arg(long, value_name = "I", default_value_t = 0)]
    pub(crate) index: usize,
    #[command(flatten)]
    pub(crate) model: Model,
    /// Where to, on the ground, metres
    #[arg(
        long,
        value_name = "X,Y",
        value_delimiter = ',',
        allow_hyphen_values = true,
        required = true
    )]
    pub(crate) to: Vec<f32>,
    /// Which way it shall look there, degrees from x towards y [default: any]
    #[arg(long, value_name = "DEG", allow_hyphen_values = true)]
    pub(crate) heading: Option<f32>,
    /// Frames of the record between two predictions
    #[arg(long, value_name = "S", default_value_t = 10, value_parser = clap::value_parser!(u32).range(1..))]
    pub(crate) step: u32,
    /// Hold the parts together at pivots that are found from frames 0 to S
    #[arg(long)]
    pub(crate) join: bool,
    /// Futures tried an iteration
    #[arg(long, value_name = "N", default_value_t = 16, value_parser = clap::value_parser!(u32).range(1..=10_000))]
    pub(crate) futures: u32,
    /// Iterations
    #[arg(long, value_name = "N", default_value_t = 2, value_parser = clap::value_parser!(u32).range(1..=1000))]
    pub(crate) iterations: u32,
    /// Begin the search with these commands, three numbers each, such as what is left of the last plan
    #[arg(long, value_name = "C", value_delimiter = ',', allow_hyphen_values = true)]
    pub(crate) first: Vec<f32>,
    /// Another seed, other samples
    #[arg(long, value_name = "S", default_value_t = 1)]
    pub(crate) seed: u64,
    /// Take the best commands found after so many milliseconds
    #[arg(long, value_name = "MS")]
    pub(crate) deadline_ms: Option<u64>,
    /// Print one JSON document instead of a table
    #[arg(long)]
    pub(crate) json: bool,
}
