//! What comes with the program: a scene, and the default model where the program was built with it.

use std::path::Path;

use rigidformer_evaluation::scenes::{Dataset, SceneError};
use rigidformer_runtime::models::LoadedModel;

use crate::arguments::Model;

static SCENE: &[u8] = include_bytes!("../scenes/default.safetensors");

/// The given scene file, or the embedded one.
pub(crate) fn dataset(path: Option<&Path>) -> Result<Dataset, SceneError> {
    match path {
        Some(path) => Dataset::open(path),
        None => Dataset::from_bytes("<default scene>", SCENE),
    }
}

/// The given model, or the embedded one.
///
/// # Errors
/// When it cannot be loaded, or none is embedded.
pub fn model(model: &Model) -> anyhow::Result<LoadedModel> {
    match &model.path {
        Some(path) => Ok(LoadedModel::open(path)?),
        None => embedded(),
    }
}

#[cfg(feature = "default-model")]
fn embedded() -> anyhow::Result<LoadedModel> {
    Ok(LoadedModel::embedded("<default model>", rigidformer_weights::EDGE)?)
}

#[cfg(not(feature = "default-model"))]
fn embedded() -> anyhow::Result<LoadedModel> {
    let remedy = "give one with --model, or build with the feature `default-model`";
    Err(crate::usage::Usage(format!(
        "--model: this program was built without a default model; {remedy}"
    ))
    .into())
}
