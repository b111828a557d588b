//! Models in memory, loaded from packed files (`weights/FORMAT.md`).

mod error;
mod loaded;
mod panels;

pub use error::ModelError;
pub use loaded::LoadedModel;
pub use panels::to_panels;
