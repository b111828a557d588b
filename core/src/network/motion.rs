//! Integration: the coming motion, which units may leave it, and Verlet (docs/MODEL.md, section 6).

use crate::geometry::{Pose, State, rotate};
use crate::limits::ANCHORS;
use crate::scene::{Scene, UnitSlot};
use crate::structure::heading;
use nalgebra::Vector3;
use rigidformer_weights::{ModelConfig, Motion};

/// Of a radius: what a fit may be off.
const ROUNDING: f32 = 4.0 * f32::EPSILON;

/// Whether a free unit may touch anything within the step, by bounding spheres.
fn may_touch(scene: &Scene<'_>, index: usize, unit: &UnitSlot) -> bool {
    let travel = scene.travel(unit);
    let mut planes = scene.planes.iter();
    planes.any(|plane| scene.room_to_plane((unit, &travel), plane) < 0.0)
        || scene
            .others(index, unit)
            .any(|(_, other)| scene.room_to_unit((unit, &travel), other) < 0.0)
}

/// How far planes lift a unit at a pose that takes a point of its hull below them, or deeper below than one is now, metres. Units of
/// models that keep no hulls are not lifted.
pub(crate) fn lift_above_planes(scene: &Scene<'_>, unit: &UnitSlot, pose: &Pose) -> Vector3<f32> {
    let points = scene.hull_of(unit);
    let mut lift = Vector3::zeros();
    for (number, plane) in scene.planes.iter().enumerate() {
        // What gives way is pushed out by its spring.
        if unit.gives_way_on(scene, number) {
            continue;
        }
        let next = Pose { centre: pose.centre + lift, ..*pose };
        lift += plane.normal * plane.lift_m(points, unit.radius, &unit.current, &next);
    }
    lift
}

/// Where a free unit's anchors go by the network and by impulses, before the projection, and where they are to have been
/// before: each from the centre of its pose. `out` is the head's output for it (anchors, 6). The last value tells whether the
/// prediction was used.
pub(crate) fn correct(
    config: &ModelConfig,
    scene: &Scene<'_>,
    anchors: &[Vector3<f32>; ANCHORS],
    (next, before): (&State, &Pose),
    (share, radius): (f32, f32),
    out: &[f32],
) -> ([[Vector3<f32>; ANCHORS]; 2], bool) {
    let mut places = [&next.pose, before].map(|pose| anchors.map(|a| rotate(&pose.rotation, &a)));
    let scale = config.output_scale * share * scene.dt;
    // 0 where nothing touches the unit, whose free motion is exact; below 0 where it rests. Of corrections that are less than the
    // fit rounds, rounding alone would come.
    let is_slight = |v: &f32| v.abs() * scale <= ROUNDING * radius;
    // What is no number is not slight.
    let active = share > 0.0 && !out.iter().all(is_slight);
    if active {
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

/// Where a unit's anchors go.
pub(crate) struct Advanced {
    /// From the unit's centre now, before the projection, metres.
    pub(crate) places: [Vector3<f32>; ANCHORS],
    /// Whether the prediction was used.
    pub(crate) active: bool,
    /// Where the unit goes without it, where that is known exactly.
    pub(crate) free: Option<State>,
}

/// Where a free unit's anchors go: `out` is the head's output for it (anchors, 3).
pub(crate) fn advance(
    config: &ModelConfig,
    scene: &Scene<'_>,
    index: usize,
    unit: &UnitSlot,
    out: &[f32],
) -> Advanced {
    let (dt, scale) = (scene.dt, config.output_scale);
    let mut predicted = [Vector3::zeros(); ANCHORS];
    for (p, row) in predicted.iter_mut().zip(out.chunks_exact(3)) {
        if let [x, y, z] = row {
            *p = Vector3::new(*x, *y, *z) * scale;
        }
    }
    let anchors = scene.anchors_of(unit);
    let mut places = anchors;
    // Robots go on as their heaviest link does, and the network adds to that.
    if heading::is_robot(config) {
        let pose = heading::motion_with_leader(scene, index, unit);
        for ((a, local), u) in places.iter_mut().zip(&anchors).zip(&predicted) {
            *a = pose.apply(local) + heading::outward(unit, &(u * dt));
        }
        return Advanced { places, active: true, free: None };
    }
    // These models correct free motion, which is exact where nothing is near.
    if config.motion == Motion::Free {
        let active = !config.gate || may_touch(scene, index, unit);
        let free = unit.free(&scene.fall());
        let way = free.course.way;
        for ((a, local), u) in places.iter_mut().zip(&anchors).zip(&predicted) {
            *a = rotate(&free.pose.rotation, local) + way;
            if active {
                *a += u * dt;
            }
        }
        return Advanced { places, active, free: Some(free) };
    }
    // The paper's own motion: Verlet with the predicted acceleration.
    for ((a, local), acceleration) in places.iter_mut().zip(&anchors).zip(&predicted) {
        let lever = rotate(&unit.current.rotation, local);
        *a = (lever + unit.course.way_at(&lever)) + acceleration * (dt * dt);
    }
    Advanced { places, active: true, free: None }
}
