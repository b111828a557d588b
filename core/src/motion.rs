//! Integration: free motion, which units may leave it, and Verlet (docs/MODEL.md, section 6).

use crate::config::{ANCHORS, is_free};
use crate::geometry::{Hull, Pose, norm, product, product_transposed};
use crate::scene::{Scene, UnitState};
use nalgebra::Vector3;
use rigidformer_weights::ModelConfig;

/// Allowance on the distance that units travel towards each other.
pub(crate) const REACH_FACTOR: f32 = 1.05;
/// Allowance on every gap, metres.
pub(crate) const REACH_MARGIN_M: f32 = 0.03;

/// Motion without contact: ballistic centre, the last step's rotation again.
pub(crate) fn free(unit: &UnitState, gravity: &Vector3<f32>, dt: f32) -> Pose {
    let (now, before) = (&unit.current, &unit.previous);
    Pose {
        rotation: product(&product_transposed(&now.rotation, &before.rotation), &now.rotation),
        centre: (now.centre + (now.centre - before.centre)) + gravity * (dt * dt),
    }
}

/// Whether a unit may touch anything within the step, by bounding spheres.
pub(crate) fn may_touch<const UNITS: usize>(
    scene: &Scene<'_, UNITS>,
    index: usize,
    unit: &UnitState,
    gravity: &Vector3<f32>,
) -> bool {
    let travel = unit.current.centre - unit.previous.centre;
    let fall = travel.z + gravity.z * (scene.dt * scene.dt);
    let lowest = (unit.current.centre.z - unit.radius) + fall.min(0.0) * REACH_FACTOR;
    let mut touch = lowest < REACH_MARGIN_M;
    let (first, around) = scene.around(index);
    for (j, other) in (first..).zip(around) {
        let apart = norm(&(unit.current.centre - other.current.centre));
        let gap = (apart - unit.radius) - other.radius;
        let towards = norm(&(travel - (other.current.centre - other.previous.centre)));
        touch |= j != index && gap < towards * REACH_FACTOR + REACH_MARGIN_M;
    }
    touch
}

/// The pose, lifted where it takes a point of the unit's hull below the ground, or deeper below it than one is now.
/// Units of models that keep no hulls stay where they are.
pub(crate) fn above_ground<const UNITS: usize>(
    scene: &Scene<'_, UNITS>,
    unit: &UnitState,
    mut pose: Pose,
) -> Pose {
    let points = scene.hull_of(unit);
    let depth = |pose: &Pose| {
        if points.is_empty() || pose.centre.z >= unit.radius {
            return 0.0;
        }
        let lowest = Hull { points, rotation: pose.rotation }.support(&-Vector3::z());
        (-(pose.centre.z + lowest.z)).max(0.0)
    };
    let depth_after = depth(&pose);
    if depth_after > 0.0 {
        pose.centre.z += (depth_after - depth(&unit.current)).max(0.0);
    }
    pose
}

/// Where a unit's anchors go, before the projection: `out` is the head's output for it
/// (anchors, 3). The second value tells whether the prediction was used.
pub(crate) fn advance<const UNITS: usize>(
    config: &ModelConfig,
    scene: &Scene<'_, UNITS>,
    index: usize,
    unit: &UnitState,
    out: &[f32],
) -> ([Vector3<f32>; ANCHORS], bool) {
    let gravity = Vector3::from(config.gravity_m_s2);
    let (dt, scale) = (scene.dt, config.output_scale);
    let mut predicted = [Vector3::zeros(); ANCHORS];
    for (p, row) in predicted.iter_mut().zip(out.chunks_exact(3)) {
        if let [x, y, z] = row {
            *p = Vector3::new(*x, *y, *z) * scale;
        }
    }
    let anchors = scene.anchors_of(unit);
    let mut advanced = anchors;
    if is_free(config) {
        let active = !config.gate || may_touch(scene, index, unit, &gravity);
        let free = free(unit, &gravity, dt);
        for ((a, local), u) in advanced.iter_mut().zip(&anchors).zip(&predicted) {
            *a = free.apply(local);
            if active {
                *a += u * dt;
            }
        }
        return (advanced, active);
    }
    for ((a, local), acceleration) in advanced.iter_mut().zip(&anchors).zip(&predicted) {
        let now = unit.current.apply(local);
        *a = (now + (now - unit.previous.apply(local))) + acceleration * (dt * dt);
    }
    (advanced, true)
}
