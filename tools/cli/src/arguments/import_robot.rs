//! Arguments of `rigidformer import-robot`.

use std::path::PathBuf;

use clap::Args;

use super::Model;

#[derive(Args)]
#[command(after_help = "\
FILE is a URDF or an MJCF file with its meshes (STL, OBJ, COLLADA, MSH), or a folder of meshes, each a unit of its own. SDF and USD are
refused. Each link with a shape and a mass becomes a unit: points on its surface, mass, moments of inertia, convex pieces. Links of one
robot have one body number. The scene has two frames, both with the robot at rest. Its metadata robot_joints has the joints.

A state of --state is for the model of --model, edge unless told otherwise, and for limits of as many units and points as it says.

Meshes are read from the folders of FILE, up to four above it, ROS_PACKAGE_PATH, and --package-path.

Examples:
  rigidformer import-robot arm.urdf --out arm.safetensors
  rigidformer import-robot arm.urdf --package-path ros/src --merge-fixed --fixed-base --out arm.safetensors
  rigidformer import-robot humanoid.xml --points 64 --principal --out humanoid.safetensors --json
  rigidformer import-robot arm.urdf --fixed-base --out arm.safetensors --state arm.state --model edge-i8.rfm
  rigidformer import-robot parts/ --scale .001 --density 2700 --out parts.safetensors")]
pub(crate) struct ImportRobot {
    /// URDF, MJCF, or a folder of meshes
    #[arg(value_name = "FILE")]
    pub(crate) input: PathBuf,
    /// Scene file to write
    #[arg(long, value_name = "FILE")]
    pub(crate) out: PathBuf,
    /// The scene with its joints as a state too, which rf_load of C and World::restore of Rust take
    #[arg(long, value_name = "FILE")]
    pub(crate) state: Option<PathBuf>,
    #[command(flatten)]
    pub(crate) model: Model,
    /// Folder of a package, or of packages, for package://; may be given more than once
    #[arg(long, value_name = "FOLDER")]
    pub(crate) package_path: Vec<PathBuf>,
    /// Leave out shapes whose mesh is not found
    #[arg(long)]
    pub(crate) skip_meshes: bool,
    /// Make one unit of links that fixed joints hold together
    #[arg(long)]
    pub(crate) merge_fixed: bool,
    /// Give links whose moments no body has those of a ball of the same sum
    #[arg(long)]
    pub(crate) balance: bool,
    /// The first link never moves; what a file fixes to its world never does
    #[arg(long)]
    pub(crate) fixed_base: bool,
    /// Points of a unit, 4 to 4096
    #[arg(long, value_name = "N", default_value_t = 32)]
    pub(crate) points: usize,
    /// Turn each unit's frame to its principal axes, so that its moments are exact
    #[arg(long)]
    pub(crate) principal: bool,
    /// Where the first link is, metres
    #[arg(long, value_name = "X,Y,Z", default_value = "0,0,0", allow_hyphen_values = true)]
    pub(crate) at: String,
    /// Frames a second of the scene file
    #[arg(long, value_name = "HZ", default_value_t = 60.0)]
    pub(crate) fps: f32,
    /// Friction of what has none in its file
    #[arg(long, value_name = "F", default_value_t = 0.5)]
    pub(crate) friction: f32,
    /// Restitution of all units
    #[arg(long, value_name = "R", default_value_t = 0.4)]
    pub(crate) restitution: f32,
    /// Density of a folder's meshes, kg/m^3 [default: 1000]
    #[arg(long, value_name = "D")]
    pub(crate) density: Option<f64>,
    /// Metres that a length of 1 in a folder's meshes stands for [default: 1]
    #[arg(long, value_name = "METRES")]
    pub(crate) scale: Option<f64>,
    /// Under which terms the robot may be used
    #[arg(long, value_name = "TEXT", default_value = "not told")]
    pub(crate) licence: String,
    /// Print one JSON document instead of text: the robot too
    #[arg(long)]
    pub(crate) json: bool,
}
