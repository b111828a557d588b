//! From a file to a robot.

use std::path::Path;

use crate::error::RobotError;
use crate::options::LoadOptions;
use crate::robot::Robot;
use crate::xml::{self, Element};
use crate::{merge, mjcf, urdf};

/// Reads a robot: URDF, or MJCF. Files that do not begin with `<robot` or `<mujoco` are refused by name, with the remedy.
///
/// ```
/// let folder = tempfile::tempdir()?;
/// let file = folder.path().join("pendulum.urdf");
/// std::fs::write(&file, r#"<robot name="pendulum">
///   <link name="base"/>
///   <link name="rod">
///     <inertial><origin xyz="0 0 -0.5"/><mass value="2"/>
///       <inertia ixx="0.1" iyy="0.1" izz="0.001" ixy="0" ixz="0" iyz="0"/></inertial>
///     <collision><origin xyz="0 0 -0.5"/><geometry><box size="0.05 0.05 1"/></geometry></collision>
///   </link>
///   <joint name="hinge" type="continuous">
///     <parent link="base"/><child link="rod"/><origin xyz="0 0 1"/><axis xyz="0 1 0"/>
///   </joint>
/// </robot>"#)?;
/// let robot = rigidformer_robots::load_robot(&file)?;
/// assert_eq!((robot.links.len(), robot.joints.len()), (2, 1));
/// let poses = robot.poses(&[std::f64::consts::FRAC_PI_2])?;
/// let end = poses[1] * nalgebra::Point3::new(0.0, 0.0, -1.0);
/// assert!((end - nalgebra::Point3::new(-1.0, 0.0, 1.0)).norm() < 1e-12);
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
///
/// # Errors
/// [`RobotError`]: which file, which element in which line, and the remedy.
pub fn load_robot(path: &Path) -> Result<Robot, RobotError> {
    load_robot_with(path, &LoadOptions::default())
}

/// As [`load_robot`], with options.
///
/// ```no_run
/// use rigidformer_robots::{LoadOptions, load_robot_with};
/// let mut options = LoadOptions::default();
/// options.package_paths.push("ros/src".into());
/// options.merge_fixed = true;
/// let robot = load_robot_with("ros/src/arm_description/urdf/arm.urdf".as_ref(), &options)?;
/// # Ok::<(), rigidformer_robots::RobotError>(())
/// ```
///
/// # Errors
/// As [`load_robot`].
pub fn load_robot_with(path: &Path, options: &LoadOptions) -> Result<Robot, RobotError> {
    refuse(path)?;
    let root = xml::read(path)?;
    read_root(path, &root, options)
}

/// A robot of a file that is in memory; its meshes and includes lie beside `path`, which errors name.
///
/// # Errors
/// As [`load_robot`].
pub fn parse_robot(path: &Path, bytes: &[u8], options: &LoadOptions) -> Result<Robot, RobotError> {
    refuse(path)?;
    read_root(path, &xml::parse(path, bytes)?, options)
}

fn read_root(path: &Path, root: &Element, options: &LoadOptions) -> Result<Robot, RobotError> {
    let refused = |found, remedy| Err(RobotError::Format { path: path.into(), found, remedy });
    let mut robot = match root.tag.as_str() {
        "robot" => urdf::robot(root, options)?,
        "mujoco" => mjcf::robot(path, root, options)?,
        "sdf" => return refused("SDF", SDF),
        _ => {
            return refused(
                "neither URDF nor MJCF",
                "give a file whose first element is <robot> or <mujoco>",
            );
        }
    };
    if options.merge_fixed {
        robot = merge::fixed(robot);
    }
    Ok(robot)
}

const SDF: &str = "give the URDF that it was made of, or convert it to MJCF or URDF";
const USD: &str = "export it as URDF or MJCF from the program that wrote it";

/// Refuses formats by the ends of their names.
fn refuse(path: &Path) -> Result<(), RobotError> {
    let end = path.extension().and_then(|end| end.to_str()).map(str::to_ascii_lowercase);
    let (found, remedy) = match end.as_deref() {
        Some("sdf") => ("SDF", SDF),
        Some("usd" | "usda" | "usdc" | "usdz") => ("USD", USD),
        Some("xacro") => ("a macro of xacro", "expand it first: xacro FILE > robot.urdf"),
        Some("mjb") => ("a compiled model of MuJoCo", "give the MJCF that it was made of"),
        _ => return Ok(()),
    };
    Err(RobotError::Format { path: path.into(), found, remedy })
}
