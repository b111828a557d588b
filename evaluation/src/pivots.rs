//! Pivots of recorded scenes: those that their frames show, and those that rollouts hold and errors are measured by.

use std::ops::Range;

use rigidformer_core::Role;
use rigidformer_runtime::pivots::{Link, Pivot, PivotError, find};

use crate::scenes::{RecordedScene, SceneError};

/// As [`find`], of a recorded scene's units at some of its frames.
///
/// # Errors
/// [`PivotError`]: [`PivotError::TooFewFrames`] also where frames of the range were not recorded.
pub fn of_scene(scene: &RecordedScene, frames: Range<usize>) -> Result<Vec<Pivot>, PivotError> {
    let links = scene.units().iter().map(|unit| Link {
        points: &unit.points,
        body: unit.body,
        poses: unit.poses.get(frames.clone()).unwrap_or_default(),
    });
    find(&links.collect::<Vec<_>>())
}

/// Pivots to measure a prediction by: those of all recorded frames, where at least one of the two links is free. None where there
/// are none, or the scene has one frame.
pub fn recorded(scene: &RecordedScene) -> Vec<Pivot> {
    // Between two commanded links nothing is predicted, so nothing can come apart.
    let is_free = |unit: usize| scene.units().get(unit).is_some_and(|unit| unit.role == Role::Free);
    let mut pivots = match has_links(scene) {
        // The search takes time, and without links it finds nothing.
        true => of_scene(scene, 0..scene.frames()).unwrap_or_default(),
        false => Vec::new(),
    };
    pivots.retain(|pivot| is_free(pivot.unit) || is_free(pivot.parent));
    pivots
}

/// Whether a body of the scene has several units, which may be links of a robot.
pub fn has_links(scene: &RecordedScene) -> bool {
    let mut bodies: Vec<u16> = scene.units().iter().filter_map(|unit| unit.body).collect();
    bodies.sort_unstable();
    // Sorted numbers have equal ones side by side.
    bodies.windows(2).any(|pair| pair[0] == pair[1])
}

/// Why a scene is not held together.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum HoldError {
    /// Its frames show no pivots.
    #[error("{scene}: {source}")]
    Pivots {
        /// The scene.
        scene: String,
        /// Why.
        source: PivotError,
    },
    /// The pivots are none of the scene's.
    #[error(transparent)]
    Scene(#[from] SceneError),
}

/// The scene, held together at pivots that its frames to a last one show; as it is where no body has several units.
///
/// # Errors
/// [`HoldError`]
pub fn joined(scene: RecordedScene, last: usize) -> Result<RecordedScene, HoldError> {
    // Scenes of single bodies go on as they are, so that one option serves all files.
    if !has_links(&scene) {
        return Ok(scene);
    }
    // Later frames are what the rollout has to predict.
    let found = of_scene(&scene, 0..last.saturating_add(1).min(scene.frames()));
    let found = found.map_err(|source| HoldError::Pivots { scene: scene.name().into(), source })?;
    Ok(scene.with_pivots(found)?)
}

/// As [`joined`], of several.
///
/// # Errors
/// That of the first scene, in their order, that has one.
pub fn all_joined(scenes: &[RecordedScene], last: usize) -> Result<Vec<RecordedScene>, HoldError> {
    scenes.iter().map(|scene| joined(scene.clone(), last)).collect()
}
