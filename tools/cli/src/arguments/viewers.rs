//! Files for viewers, which several commands write.

use std::path::PathBuf;

use clap::Args;

/// The options that ask for files for viewers.
#[derive(Args)]
pub struct Viewers {
    /// Also write an MCAP file for Foxglove, Lichtblick or Rerun, such as --mcap scene.mcap (docs/VIEWERS.md)
    #[arg(long, value_name = "FILE.mcap")]
    pub mcap: Option<PathBuf>,
    /// Also write a binary glTF 2.0 file with animations, such as --gltf scene.glb, for Blender and browsers
    #[arg(long, value_name = "FILE.glb")]
    pub gltf: Option<PathBuf>,
    /// Also write a page that plays the scene in a browser, such as --html scene.html; it needs no network
    #[arg(long, value_name = "FILE.html")]
    pub html: Option<PathBuf>,
}
