//! Splits by name.

use clap::ValueEnum;
use rigidformer_evaluation::scenes::Split;

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
