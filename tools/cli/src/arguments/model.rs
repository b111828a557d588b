//! The model that a command uses.

use std::path::PathBuf;

use clap::Args;

#[derive(Args)]
pub(crate) struct Model {
    /// Packed model [default: the one that comes with the program, if it was built with one]
    #[arg(long = "model", value_name = "M")]
    pub(crate) path: Option<PathBuf>,
}
