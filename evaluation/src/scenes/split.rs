//! What scenes may be used for.

use std::fmt;
use std::str::FromStr;

/// What a scene may be used for.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum Split {
    /// Models learn from it.
    Train,
    /// Training looks at it to choose between models.
    Validation,
    /// Only `evaluate` looks at it.
    Test,
    /// Beyond the published benchmark; models may learn from it.
    Extra,
}

impl Split {
    /// All of them, in the order of their codes in a file.
    pub const ALL: [Split; 4] = [Split::Train, Split::Validation, Split::Test, Split::Extra];

    /// The split of a code in a scene file.
    pub fn from_code(code: u8) -> Option<Split> {
        Split::ALL.get(usize::from(code)).copied()
    }

    /// Its code in a scene file.
    pub fn code(self) -> u8 {
        match self {
            Split::Train => 0,
            Split::Validation => 1,
            Split::Test => 2,
            Split::Extra => 3,
        }
    }
}

impl fmt::Display for Split {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        // `pad` keeps widths of tables, which `write_str` drops.
        f.pad(match self {
            Split::Train => "train",
            Split::Validation => "validation",
            Split::Test => "test",
            Split::Extra => "extra",
        })
    }
}

/// A name that is no split.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("there is no split {0:?}; use train, validation, test or extra")]
pub struct UnknownSplit(pub String);

impl FromStr for Split {
    type Err = UnknownSplit;

    fn from_str(name: &str) -> Result<Split, UnknownSplit> {
        Split::ALL
            .into_iter()
            .find(|split| split.to_string() == name)
            .ok_or_else(|| UnknownSplit(name.into()))
    }
}
