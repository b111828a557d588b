//! Robots from files of this folder, and from files that mean harm.
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)]

mod hostile;
mod mended;
mod mjcf;
mod urdf;

use std::path::{Path, PathBuf};

/// A file of this folder.
fn data(name: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/data").join(name)
}
