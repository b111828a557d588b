//! `rigidformer pack`

use rigidformer_runtime::models;

use crate::arguments::Pack;
use crate::output;

pub(crate) fn run(arguments: &Pack) -> anyhow::Result<()> {
    let bytes = models::pack(&arguments.input, &arguments.out)?;
    output::line(format_args!("{}: {bytes} bytes", arguments.out.display()))
}
