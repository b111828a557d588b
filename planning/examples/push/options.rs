//! The command line.

use std::path::PathBuf;

use clap::{Parser, ValueEnum};
use rigidformer_cli::shared::{Model, ViewerOptions};

/// Push a cube to random goals in PyBullet, planning in the model again and again.
#[derive(Parser)]
#[command(name = "push", version)]
#[command(after_help = "\
A ball pushes a cube of 5 cm over a plane in PyBullet, which runs beside this program (rigidformer_lab.push_world; install it
with tools/lab/setup.sh). Starts and goals are random: .1 to .3 m away, turned by up to 60 degrees. Every control cycle the
cube and the ball are seen, pushes are tried in the model, and the best is begun. A trial ends when no push is worth its time,
or after --seconds. docs/PLANNING.md has the protocol.

Without --model the model that comes with the program is used with int8 weights. --planner engine tries pushes in the world
itself, free in a model of free motion, without contact. The same seed gives the same plans, to the bit, unless there is a
deadline.

Columns: trials that end at most 5 cm from the goal; at most 2 cm and .1 rad; medians of the last errors; mean time in the
world; plans; plans a second of planning.

Examples:
  cargo run --release -p rigidformer-planning --example push -- --trials 3
  cargo run --release -p rigidformer-planning --example push -- --trials 1 --mcap push.mcap --html push.html
  cargo run --release -p rigidformer-planning --example push -- --trials 100 --json
  cargo run --release -p rigidformer-planning --example push -- --trials 100 --planner engine
  cargo run --release -p rigidformer-planning --example push -- --model weights/models/nano.rfm --trials 10 --python ~/lab/bin/python")]
pub(crate) struct Push {
    #[command(flatten)]
    pub(crate) model: Model,
    /// How many starts and goals
    #[arg(long, value_name = "N", default_value_t = 10, value_parser = clap::value_parser!(u32).range(1..=100_000))]
    pub(crate) trials: u32,
    /// The first trial's seed; the next trial's is one more
    #[arg(long, value_name = "S", default_value_t = 1, value_parser = clap::value_parser!(u64).range(..1 << 62))]
    pub(crate) seed: u64,
    /// In what pushes are tried
    #[arg(long, value_enum, default_value_t = Oracle::Model)]
    pub(crate) planner: Oracle,
    /// Pushes tried an iteration
    #[arg(long, value_name = "N", default_value_t = 8, value_parser = clap::value_parser!(u32).range(1..=10_000))]
    pub(crate) futures: u32,
    /// Iterations of a plan
    #[arg(long, value_name = "N", default_value_t = 2, value_parser = clap::value_parser!(u32).range(1..=1000))]
    pub(crate) iterations: u32,
    /// Length of a control cycle, in milliseconds of the world
    #[arg(long, value_name = "MS", default_value_t = 400, value_parser = clap::value_parser!(u32).range(1..=10_000))]
    pub(crate) cycle_ms: u32,
    /// Longest trial, in seconds of the world
    #[arg(long, value_name = "S", default_value_t = 20.0, value_parser = positive)]
    pub(crate) seconds: f32,
    /// Take the best push found after so many milliseconds
    #[arg(long, value_name = "MS")]
    pub(crate) deadline_ms: Option<u64>,
    /// Python that has the lab, such as tools/lab/.venv/bin/python [default: python3 of PATH]
    #[arg(long, value_name = "PATH")]
    pub(crate) python: Option<PathBuf>,
    #[command(flatten)]
    pub(crate) viewers: ViewerOptions,
    /// Print one JSON document, with every trial, instead of a table
    #[arg(long)]
    pub(crate) json: bool,
}

/// In what a planner tries pushes, as the command line calls it.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub(crate) enum Oracle {
    /// In the model
    Model,
    /// In the world itself, which knows everything
    Engine,
    /// In a model of free motion
    Free,
}

impl Oracle {
    pub(crate) fn name(self) -> &'static str {
        match self {
            Oracle::Model => "model",
            Oracle::Engine => "engine",
            Oracle::Free => "free",
        }
    }
}

fn positive(text: &str) -> Result<f32, String> {
    let number: f32 = text.parse().map_err(|_| "is not a number".to_owned())?;
    if (1e-6..=1e6).contains(&number) { Ok(number) } else { Err("is not from 1e-6 to 1e6".into()) }
}
