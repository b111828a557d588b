//! The command line.

use std::path::PathBuf;

use clap::{Parser, ValueEnum};
use rigidformer_cli::shared::{Model, ViewerOptions};

/// Plan a throw over a wall, by trying many in the model.
#[derive(Parser)]
#[command(name = "throw", version)]
#[command(after_help = "\
A ball is to hit another one that falls behind a wall, and to drive it to the far left. Chosen is the velocity that it is
let go with. A throw costs the least distance between the centres, in metres, less how far the target was driven that way
within a second. The chosen throw is predicted once more, alone; it must be the same to the bit.

Columns: the iteration's least cost, the least so far, the median; the deviation of what is tried next.

Writes into DIR, if given:
  throw.png   paths tried by the first and the last iteration; the planned throw at four instants

Examples:
  cargo run --release -p rigidformer-planning --example throw
  cargo run --release -p rigidformer-planning --example throw -- --method mppi --futures 512 --iterations 8 --seed 3 --out throw
  cargo run --release -p rigidformer-planning --example throw -- --gltf throw.glb --html throw.html
  cargo run --release -p rigidformer-planning --example throw -- --deadline-ms 200 --json")]
pub(crate) struct Throw {
    #[command(flatten)]
    pub(crate) model: Model,
    /// How to search
    #[arg(long, value_enum, default_value_t = MethodName::Cem)]
    pub(crate) method: MethodName,
    /// Futures an iteration
    #[arg(long, value_name = "N", default_value_t = 256, value_parser = clap::value_parser!(u32).range(1..=100_000))]
    pub(crate) futures: u32,
    /// Iterations
    #[arg(long, value_name = "N", default_value_t = 6, value_parser = clap::value_parser!(u32).range(1..=1000))]
    pub(crate) iterations: u32,
    /// Which random throws
    #[arg(long, value_name = "N", default_value_t = 1)]
    pub(crate) seed: u64,
    /// Choose the ball's spin too
    #[arg(long)]
    pub(crate) spin: bool,
    /// Take the best throw found after so many milliseconds
    #[arg(long, value_name = "MS")]
    pub(crate) deadline_ms: Option<u64>,
    /// Folder for the picture, made if need be [default: no picture]
    #[arg(long, value_name = "DIR")]
    pub(crate) out: Option<PathBuf>,
    #[command(flatten)]
    pub(crate) viewers: ViewerOptions,
    /// Print one JSON document, with the plan's poses, instead of a table
    #[arg(long)]
    pub(crate) json: bool,
}

/// Planning methods as the command line calls them.
#[derive(Clone, Copy, ValueEnum)]
pub(crate) enum MethodName {
    /// Weights all throws by their cost
    Mppi,
    /// Keeps the best tenth (the cross-entropy method)
    Cem,
}
