//! Integration: the coming motion, which units may leave it, and Verlet (docs/MODEL.md, section 6).

use crate::contact::prior::Solved;
use crate::geometry::Pose;
use crate::limits::ANCHORS;
use crate::scene::{Scene, UnitSlot};
use crate::structure::heading;
use nalgebra::Vector3;
use rigidformer_weights::{ModelConfig, Motion};

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

/// Where a free unit's anchors go by the network and by impulses, before the projection, and where they are to have been
/// before: `out` is the head's output for it (anchors, 6). The last value tells whether the prediction was used.
pub(crate) fn correct(
    config: &ModelConfig,
    scene: &Scene<'_>,
    (unit, solved): (&UnitSlot, &Solved),
    out: &[f32],
) -> ([[Vector3<f32>; ANCHORS]; 2], bool) {
    let anchors = scene.anchors_of(unit);
    let mut places = [&solved.next, &solved.before].map(|pose| anchors.map(|a| pose.apply(&a)));
    // 0 where nothing touches the unit, whose free motion is exact; below 0 where it rests.
    let active = solved.share > 0.0;
    if active {
        let scale = config.output_scale * solved.share * scene.dt;
        let [next, before] = &mut places;
        for ((next, before), row) in next.iter_mut().zip(before).zip(out.as_chunks::<6>().0) {
            let [x, y, z, u, v, w] = row;
            let way = Vector3::new(*x, *y, *z) * scale;
            // Three outputs correct the way, three the velocity that it ends with.
            *next += way;
            *before += way - Vector3::new(*u, *v, *w) * scale;
        }
    }
    (places, active)
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
    // Robots go on as their heaviest link does, and the network adds to that.
    if heading::is_robot(config) {
        let pose = heading::pose_with_leader(scene, index, unit);
        for ((a, local), u) in advanced.iter_mut().zip(&anchors).zip(&predicted) {
            *a = pose.apply(local) + heading::outward(unit, &(u * dt));
        }
        return (advanced, true);
    }
    // These models correct free motion, which is exact where nothing is near.
    if config.motion == Motion::Free {
        let active = !config.gate || may_touch(scene, index, unit);
        let free = unit.free(&scene.fall());
        for ((a, local), u) in advanced.iter_mut().zip(&anchors).zip(&predicted) {
            *a = free.apply(local);
            if active {
                *a += u * dt;
            }
        }
        return (advanced, active);
    }
    // The paper's own motion: Verlet with the predicted acceleration.
    for ((a, local), acceleration) in advanced.iter_mut().zip(&anchors).zip(&predicted) {
        let now = unit.current.apply(local);
        *a = (now + (now - unit.previous.apply(local))) + acceleration * (dt * dt);
    }
    (advanced, true)
}
