//! Integration: the coming motion, which units may leave it, and Verlet (docs/MODEL.md, section 6).

use crate::geometry::{Pose, product, product_transposed};
use crate::limits::ANCHORS;
use crate::scene::{Scene, UnitSlot};
use nalgebra::Vector3;
use rigidformer_weights::{ModelConfig, Motion};

/// Motion of a free unit without contact: ballistic centre, the last step's rotation again.
pub(crate) fn free(unit: &UnitSlot, fall: &Vector3<f32>) -> Pose {
    let (now, before) = (&unit.current, &unit.previous);
    Pose {
        rotation: product(&product_transposed(&now.rotation, &before.rotation), &now.rotation),
        centre: (now.centre + (now.centre - before.centre)) + fall,
    }
}

/// Whether a free unit may touch anything within the step, by bounding spheres.
fn may_touch(scene: &Scene<'_>, index: usize, unit: &UnitSlot) -> bool {
    let travel = scene.travel(unit);
    let mut planes = scene.planes.iter();
    planes.any(|plane| scene.room_to_plane((unit, &travel), plane) < 0.0)
        || scene
            .others(index, unit)
            .any(|(_, other)| scene.room_to_unit((unit, &travel), other) < 0.0)
}

/// Lifts a pose that takes a point of the unit's hull below a plane, or deeper below it than one is now. Units of
/// models that keep no hulls are not lifted.
pub(crate) fn lift_above_planes(scene: &Scene<'_>, unit: &UnitSlot, pose: &mut Pose) {
    let points = scene.hull_of(unit);
    for plane in &scene.planes {
        plane.lift(points, unit.radius, &unit.current, pose);
    }
}

/// Where a free unit's anchors go, before the projection: `out` is the head's output for it
/// (anchors, 3). The second value tells whether the prediction was used.
pub(crate) fn advance(
    config: &ModelConfig,
    scene: &Scene<'_>,
    index: usize,
    unit: &UnitSlot,
    out: &[f32],
) -> ([Vector3<f32>; ANCHORS], bool) {
    let (dt, scale) = (scene.dt, config.output_scale);
    let mut predicted = [Vector3::zeros(); ANCHORS];
    for (p, row) in predicted.iter_mut().zip(out.chunks_exact(3)) {
        if let [x, y, z] = row {
            *p = Vector3::new(*x, *y, *z) * scale;
        }
    }
    let anchors = scene.anchors_of(unit);
    let mut advanced = anchors;
    if config.motion == Motion::Free {
        let active = !config.gate || may_touch(scene, index, unit);
        let free = free(unit, &scene.fall());
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
