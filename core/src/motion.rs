//! Integration: the coming motion, which units may leave it, and Verlet (docs/MODEL.md, section 6).

use crate::features::{CLAMP, Row};
use crate::geometry::{POSE, Pose, read_pose};
use crate::impacts;
use crate::kernels::Schedule;
use crate::layers::{part, part_mut};
use crate::limits::ANCHORS;
use crate::scene::{Scene, UnitSlot};
use crate::solver;
use nalgebra::Vector3;
use rigidformer_weights::{ModelConfig, Motion};

/// Numbers of a unit that motion by impulses takes: what it comes to, and what that is worked out in.
pub(crate) const SOLVED: usize = solver::PRIOR + solver::SCRATCH;
/// About how many multiplications it takes.
const SOLVED_COST: usize = 128 << 10;

/// What impulses make of a unit's step.
pub(crate) struct Solved {
    /// After the step.
    pub(crate) next: Pose,
    /// What counts as the pose before it then.
    pub(crate) before: Pose,
    /// How much a correction of 1 is, m/s: what contact changed; 0: nothing touches the unit; below 0: it rests.
    pub(crate) share: f32,
}

/// Moves all units by impulses into `all`, (copies, [`SOLVED`] numbers a unit).
pub(crate) fn solve<S: Schedule>(schedule: S, scene: &Scene<'_>, all: &mut [f32]) {
    let units = scene.per_copy;
    let all = part_mut(all, 0, scene.count * SOLVED);
    schedule.each_row(all, units * SOLVED, units * SOLVED_COST, &mut [], |copy, row, _| {
        let (prior, scratch) = row.split_at_mut((units * solver::PRIOR).min(row.len()));
        solver::solve(scene, copy * units, scratch, prior);
    });
}

/// What impulses make of a unit's step, from the buffer of [`solve`].
pub(crate) fn solved(scene: &Scene<'_>, index: usize, all: &[f32]) -> Solved {
    let units = scene.per_copy.max(1);
    let start = index / units * units * SOLVED + index % units * solver::PRIOR;
    let share = *part(all, start + 2 * POSE, 1).first().unwrap_or(&0.0);
    let [next, before] = [start, start + POSE].map(|start| read_pose(part(all, start, POSE)));
    Solved { next, before, share }
}

/// Puts what impulses change of the anchors' ways and velocities (m/s) into a unit's record of impacts, in place of what
/// the impacts would.
pub(crate) fn push(scene: &Scene<'_>, index: usize, solved: &Solved, record: &mut [f32]) {
    let Some(unit) = scene.units().get(index).filter(|unit| unit.is_free()) else { return };
    let free = unit.free(&scene.fall());
    for (anchor, row) in scene.anchors_of(unit).iter().zip(impacts::pushes_mut(record)) {
        let way = solved.next.displacement_from(&free, anchor);
        let earlier = solved.before.displacement_from(&unit.current, anchor);
        let mut row = Row::new(row);
        for change in [way, way - earlier] {
            row.vector((change / scene.dt).map(|v| v.clamp(-CLAMP, CLAMP)));
        }
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
    let active = solved.share > 0.0;
    if active {
        let scale = config.output_scale * solved.share * scene.dt;
        let [next, before] = &mut places;
        for ((next, before), row) in next.iter_mut().zip(before).zip(out.as_chunks::<6>().0) {
            let [x, y, z, u, v, w] = row;
            let way = Vector3::new(*x, *y, *z) * scale;
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
    if config.motion != Motion::Verlet {
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
    for ((a, local), acceleration) in advanced.iter_mut().zip(&anchors).zip(&predicted) {
        let now = unit.current.apply(local);
        *a = (now + (now - unit.previous.apply(local))) + acceleration * (dt * dt);
    }
    (advanced, true)
}
