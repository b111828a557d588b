//! The model that a command uses.

use std::path::PathBuf;

use clap::Args;

/// The option that names a model.
#[derive(Args)]
pub struct Model {
    /// Packed model [default: the one that comes with the program, if it was built with one]
    #[arg(long = "model", value_name = "M")]
    pub path: Option<PathBuf>,
}
