//! A simulator of one scene.

use nalgebra::{Isometry3, Point3};
use rigidformer_runtime::core::{ANCHORS, Limits, Model, Unit};
use rigidformer_runtime::engine::{Engine, Stepping};
use rigidformer_runtime::rollout::{RolloutError, check_fit};
use rigidformer_runtime::scenes::RecordedScene;

/// Starts from the recorded poses at frames `frame - step` and `frame`.
pub(crate) fn observe(
    simulator: &mut dyn Stepping,
    scene: &RecordedScene,
    step: u32,
    frame: u32,
) -> Result<(), RolloutError> {
    let poses =
        |frame: Option<u32>| -> Option<Vec<Isometry3<f32>>> { scene.poses_at(frame? as usize) };
    let (Some(previous), Some(current)) = (poses(frame.checked_sub(step)), poses(Some(frame)))
    else {
        let (scene, recorded) = (scene.name().into(), scene.frames());
        return Err(RolloutError::TooFewFrames { scene, step, recorded });
    };
    let units: Vec<Unit<'_>> = scene
        .units()
        .iter()
        .map(|recorded| Unit { points: &recorded.points, physics: recorded.physics })
        .collect();
    simulator
        .observe_poses(step, &units, &previous, &current)
        .map_err(|source| RolloutError::Observe { scene: scene.name().into(), source })?;
    Ok(())
}

/// World positions of a unit's anchors.
pub(crate) fn anchors(simulator: &dyn Stepping, unit: usize) -> [Point3<f32>; ANCHORS] {
    // The farthest-point order begins with the anchors.
    let mut points = [Point3::origin(); ANCHORS];
    simulator.first_points(unit, &mut points);
    points
}

/// Runs `body` with a simulator that has room for the scene, on one thread: scenes are on threads of their own.
pub(crate) fn with_simulator<R: Send>(
    model: &Model<'_>,
    scene: &RecordedScene,
    body: impl FnOnce(&mut dyn Stepping) -> Result<R, RolloutError> + Send,
) -> Result<R, RolloutError> {
    check_fit(model, scene)?;
    let limits = Limits { units: scene.units().len(), points: scene.points() };
    Engine::new()?
        .single()
        .simulate(model, limits, 1, body)
        .map_err(|source| RolloutError::Engine { scene: scene.name().into(), source })?
}
