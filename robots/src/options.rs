//! How a robot's file is read.

use std::path::PathBuf;

/// What to do with a file's meshes and links. The default reads all.
#[derive(Clone, Debug, Default, PartialEq)]
#[non_exhaustive]
pub struct LoadOptions {
    /// Folders in which packages are looked for (`package://NAME/...`): a package's own folder, or one that holds it.
    pub package_paths: Vec<PathBuf>,
    /// Passes over meshes that are not found; their links have no such shape.
    pub skip_missing_meshes: bool,
    /// Makes one link of those that fixed joints hold together.
    pub merge_fixed: bool,
    /// Gives a link whose moments no body has those of a ball of the same sum, as MuJoCo's `balanceinertia`.
    pub balance_inertia: bool,
}
