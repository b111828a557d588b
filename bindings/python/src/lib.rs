//! The Python module `rigidformer._native`: PyO3's view of the runtime. `rigidformer/__init__.py` re-exports it.
//!
//! | module | does |
//! |---|---|
//! | `model`, `unit`, `world`, `scene`, `rollout` | models, units and planes, worlds, recorded scenes and their rollouts |
//! | `bonds` | what holds units together |
//! | `copies` | copies of a scene that go on from step to step |
//! | `futures`, `planner` | many futures of a scene, and planners over them |
//! | `pushing`, `walking` | planners that know what they plan |
//! | `perception` | depth images and clouds, and the tracker |
//! | `pack` | models packed, and said more about |
//! | `robot` | robots from URDF and MJCF files |
//! | `tools` | check, evaluate |
//! | `windows` | what training learns from |
//! | `arrays` | numpy arrays as slices, and back |
//! | `errors` | Rust's errors as exceptions |
//! | `interrupt` | long calls that Ctrl-C ends |
//! | `locked` | objects that threads share |
//! | `whole` | whole numbers, whose errors name them |
//! | `pickle` | what pickle makes an object of again |
//! | `json` | documents as dictionaries |
//!
//! A call that only looks holds the interpreter; one that computes frees it. Objects are shared between threads, so each that
//! changes is behind a lock.

mod arrays;
mod bonds;
mod copies;
mod errors;
mod futures;
mod group;
mod interrupt;
mod json;
mod locked;
mod model;
mod pack;
mod perception;
mod pickle;
mod planner;
mod pushing;
mod robot;
mod rollout;
mod scene;
mod tools;
mod unit;
mod walking;
mod whole;
mod windows;
mod world;

/// What `rigidformer` re-exports.
#[pyo3::pymodule]
mod _native {
    #[pymodule_export]
    use super::bonds::{Bond, Joint, Pivot};
    #[pymodule_export]
    use super::copies::Copies;
    #[pymodule_export]
    use super::futures::{BatchSimulator, Futures, Start, VelocityNoise};
    #[pymodule_export]
    use super::group::{Gap, Group};
    #[pymodule_export]
    use super::model::Model;
    #[pymodule_export]
    use super::pack::pack;
    #[pymodule_export]
    use super::perception::{Camera, Cloud, DepthView, Estimate, Forecast, Track, Tracker};
    #[pymodule_export]
    use super::planner::{Cem, Commands, Launch, Mppi, Parameter, Plan, Planner};
    #[pymodule_export]
    use super::pushing::{PushGoal, PushPlan, PushPlanner};
    #[pymodule_export]
    use super::robot::{Robot, load_meshes, load_robot};
    #[pymodule_export]
    use super::rollout::{Trajectory, falling, rollout};
    #[pymodule_export]
    use super::scene::{Dataset, Scene};
    #[pymodule_export]
    use super::tools::{check, evaluate};
    #[pymodule_export]
    use super::unit::{HeightField, Plane, Unit};
    #[pymodule_export]
    use super::walking::{WalkPlan, WalkPlanner};
    #[pymodule_export]
    use super::windows::network_inputs;
    #[pymodule_export]
    use super::world::{Observation, Report, World, kernels};
}
