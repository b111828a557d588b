//! The Python module `rigidformer._native`: PyO3's view of the runtime. `rigidformer/__init__.py` re-exports it.
//!
//! | module | does |
//! |---|---|
//! | `model`, `unit`, `world`, `scene`, `rollout` | models, units and planes, worlds, recorded scenes and their rollouts |
//! | `arrays` | numpy arrays as slices, and back |
//! | `errors` | Rust's errors as exceptions |
//! | `interrupt` | long calls that Ctrl-C ends |
//! | `json` | documents as dictionaries |
//!
//! A call that only looks holds the interpreter; one that computes frees it. Objects are shared between threads, so each that
//! changes is behind a lock.

mod arrays;
mod errors;
mod interrupt;
mod json;
mod model;
mod rollout;
mod scene;
mod unit;
mod world;

/// What `rigidformer` re-exports.
#[pyo3::pymodule]
mod _native {
    #[pymodule_export]
    use super::model::Model;
    #[pymodule_export]
    use super::rollout::{Trajectory, falling, rollout};
    #[pymodule_export]
    use super::scene::{Dataset, Scene};
    #[pymodule_export]
    use super::unit::{Plane, Unit};
    #[pymodule_export]
    use super::world::{Observation, Report, World, kernels};
}
