//! The motion that the network corrects, where that is motion by impulses (docs/MODEL.md, section 6).

use crate::contact::impacts;
use crate::contact::solver;
use crate::geometry::{STATE, State, rotate};
use crate::kernels::Schedule;
use crate::network::features::{CLAMP, Row};
use crate::scene::Scene;
use crate::slices::{slice_at, slice_at_mut};

/// Numbers of a unit, in a copy of so many, that motion by impulses takes: what it comes to, and what that is worked out in.
pub(crate) const fn solved_numbers(units: usize) -> usize {
    solver::PRIOR + solver::scratch(units)
}

/// And where layouts have an index.
pub(crate) const fn extra(units: usize) -> usize {
    solver::extra(units)
}

/// About how many multiplications a unit takes: decides whether threads share copies.
const SOLVED_COST: usize = 128 << 10;

/// What impulses make of a unit's step.
pub(crate) struct Solved {
    /// After the step.
    pub(crate) next: State,
    /// How much a correction of 1 is, m/s: what contact changed; 0: nothing touches the unit; below 0: it rests.
    pub(crate) share: f32,
}

/// Numbers that a unit of a scene takes.
#[inline]
fn numbers(scene: &Scene<'_>) -> usize {
    #[cfg(rigidformer_host)]
    return solved_numbers(scene.per_copy) + scene.extra;
    #[cfg(not(rigidformer_host))]
    solved_numbers(scene.per_copy)
}

/// Moves all units by impulses into `all`, (copies, [`numbers`] a unit).
pub(crate) fn solve<S: Schedule>(schedule: S, scene: &Scene<'_>, all: &mut [f32]) {
    let units = scene.per_copy;
    let width = units * numbers(scene);
    let all = slice_at_mut(all, 0, scene.copies() * width);
    schedule.each_row(all, width, units * SOLVED_COST, &mut [], |copy, row, _| {
        let (prior, scratch) = row.split_at_mut((units * solver::PRIOR).min(row.len()));
        solver::solve(schedule, scene, copy * units, (scratch, prior));
    });
}

/// Moves the units of a copy apart where they overlap: `next`, (units, [`STATE`]), after [`solve`] into `all`.
pub(crate) fn keep_apart(scene: &Scene<'_>, first: usize, all: &mut [f32], next: &mut [f32]) {
    let units = scene.per_copy;
    let all = slice_at_mut(all, first * numbers(scene), units * numbers(scene));
    let (_, scratch) = all.split_at_mut((units * solver::PRIOR).min(all.len()));
    solver::keep_apart(scene, first, scratch, next);
}

/// Finds the units of a copy that stay as they are until something changes, after [`solve`] into `all`: of those that the step left
/// as they were, those that can touch no other.
pub(crate) fn mark_still(scene: &mut Scene<'_>, copy: usize, all: &mut [f32]) {
    #[cfg(rigidformer_host)]
    {
        let units = scene.per_copy;
        let width = units * numbers(scene);
        let all = slice_at_mut(all, copy * width, width);
        let (prior, scratch) = all.split_at_mut((units * solver::PRIOR).min(all.len()));
        let slots = scene.units_mut().chunks_exact_mut(units.max(1)).nth(copy);
        solver::mark_still(slots.unwrap_or_default(), prior, scratch);
    }
    // Without an index of pairs there is nothing to save.
    #[cfg(not(rigidformer_host))]
    let _ = (scene, copy, all);
}

/// Where the numbers of a unit begin in the buffer of [`solve`].
fn start(scene: &Scene<'_>, index: usize) -> usize {
    let units = scene.per_copy.max(1);
    index / units * units * numbers(scene) + index % units * solver::PRIOR
}

/// [`Solved::share`] of a unit, from the buffer of [`solve`].
pub(crate) fn share(scene: &Scene<'_>, index: usize, all: &[f32]) -> f32 {
    *slice_at(all, start(scene, index) + STATE, 1).first().unwrap_or(&0.0)
}

/// What impulses make of a unit's step, from the buffer of [`solve`].
pub(crate) fn solved(scene: &Scene<'_>, index: usize, all: &[f32]) -> Solved {
    let (start, share) = (start(scene, index), share(scene, index, all));
    Solved { next: State::read(slice_at(all, start, STATE)), share }
}

/// Puts what impulses change of the anchors' ways and velocities (m/s) into a unit's record of impacts, in place of what
/// the impacts would.
pub(crate) fn push(scene: &Scene<'_>, index: usize, solved: &Solved, record: &mut [f32]) {
    // Impulses change nothing of units that are driven or fixed.
    let Some(unit) = scene.units().get(index).filter(|unit| unit.is_free()) else { return };
    let free = unit.free(&scene.fall());
    for (anchor, row) in scene.anchors_of(unit).iter().zip(impacts::pushes_mut(record)) {
        let way = solved.next.displacement_from(&free, anchor);
        let [now, freely] = [&solved.next, &free]
            .map(|state| state.course.way_at(&rotate(&state.pose.rotation, anchor)));
        let mut row = Row::new(row);
        for change in [way, now - freely] {
            row.vector((change / scene.dt).map(|v| v.clamp(-CLAMP, CLAMP)));
        }
    }
}
