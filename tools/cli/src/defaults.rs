//! What comes with the program: a scene, and the default model where the program was built with it.

use std::path::Path;

use rigidformer_evaluation::models::random;
use rigidformer_evaluation::scenes::{Dataset, SceneError};
use rigidformer_runtime::models::LoadedModel;

use crate::arguments::Model;
use crate::usage::Usage;

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

/// The model without its network: impulses alone.
///
/// # Errors
/// Where its motion is not by impulses.
pub(crate) fn without_network(loaded: &LoadedModel) -> anyhow::Result<LoadedModel> {
    let of = loaded.model();
    let Some(packed) = random::without_network(of.config())? else {
        let (name, remedy) = (of.file().name(), "give one of rigid bodies, or leave it out");
        let problem =
            format!("--without-network: {name} does not move units by impulses; {remedy}");
        return Err(Usage(problem).into());
    };
    Ok(LoadedModel::copy_of("<impulses alone>", &packed)?)
}

/// The same motion without the network, whatever it is.
pub(crate) fn uncorrected(loaded: &LoadedModel) -> anyhow::Result<LoadedModel> {
    let packed = random::uncorrected(loaded.model().config())?;
    Ok(LoadedModel::copy_of("<without the network>", &packed)?)
}

#[cfg(feature = "default-model")]
fn embedded() -> anyhow::Result<LoadedModel> {
    Ok(LoadedModel::embedded("<default model>", rigidformer_weights::EDGE)?)
}

#[cfg(not(feature = "default-model"))]
fn embedded() -> anyhow::Result<LoadedModel> {
    let remedy = "give one with --model, or build with the feature `default-model`";
    Err(Usage(format!("--model: this program was built without a default model; {remedy}")).into())
}
