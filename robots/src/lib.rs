//! Robots for RigidFormer: a URDF or MJCF file with its meshes becomes links, joints and a scene.
//!
//! | entry point | does |
//! |---|---|
//! | [`load_robot`] | a file to a [`Robot`]: links with mass, inertia and surface, and the joints between them |
//! | [`Robot::poses`] | where all links are at joint positions |
//! | [`Robot::scene`] | the units of a scene at rest, joined at pivots, and its file |
//! | [`RobotScene::world`] | that scene as a world that can step |
//! | [`load_meshes`] | a folder of meshes to free bodies, weighed by their density |
//!
//! Lengths are metres, masses kilograms, angles radians, z up, whatever a file's own units are.
#![cfg_attr(test, allow(clippy::unwrap_used, clippy::expect_used, clippy::panic))]

mod describe;
mod error;
mod inertia;
mod load;
mod merge;
mod meshes;
mod mjcf;
mod options;
mod robot;
mod sample;
mod scene;
mod sets;
mod solid;
mod tree;
mod urdf;
mod world;
mod xml;

pub use error::{Problem, RobotError};
pub use inertia::Inertia;
pub use load::{load_robot, load_robot_with, parse_robot};
pub use options::LoadOptions;
pub use robot::{JointKind, Link, Mimic, Robot, RobotJoint};
pub use scene::{HeldJoint, RobotScene, SceneOptions};
pub use sets::{MeshSetOptions, load_meshes};
pub use world::RobotWorldError;
