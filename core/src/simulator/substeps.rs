//! Steps longer than the model knows, in equal substeps. A unit's motion is then that of the last substep.

use super::measure::Time;
use super::report::StepReport;
use super::state::Simulator;
use crate::error::{ObserveError, StepError};
use crate::geometry::{Course, Pose, STATE, State, read_pose, turn_between, turned_by, write_pose};
use crate::scene::{Retimed, Role, Scene, UnitSlot};
use crate::slices::{rows, rows_mut, slice_at, slice_at_mut};
use crate::structure::heading::is_robot;
use crate::workspace::START;
use nalgebra::Vector3;

/// Numbers of an outcome.
const OUTCOME: usize = 3;

impl Scene<'_> {
    /// Where a unit would have been a step ago, as its motion in the last substep says.
    pub(super) fn step_ago(&self, unit: &UnitSlot) -> State {
        let substeps = self.substeps() as f32;
        let lead = if unit.is_free() { self.lead() } else { 0.0 };
        let way = (unit.course.way - self.fall() * lead) * substeps;
        let course = unit.course.moving(way, unit.course.turn() * substeps);
        let pose = State { pose: unit.current, course }.before();
        State { pose, course: unit.resting().course }
    }

    /// Falls that gravity has added to a free unit's way in the last substep since the middle of the step.
    fn lead(&self) -> f32 {
        0.5 * self.substeps().saturating_sub(1) as f32
    }
}

impl Simulator<'_, '_> {
    /// The course of a unit that goes from one pose to another in a step. The same pose twice is rest: no velocity now, not
    /// none in the mean of the step.
    #[cfg_attr(rigidformer_dsp, inline(never))]
    pub(super) fn course_between(&self, role: Role, before: &Pose, now: &Pose) -> Course {
        let share = 1.0 / self.scene.substeps() as f32;
        let turn = turn_between(&before.rotation, &now.rotation) * share;
        let way = (now.centre - before.centre) * share;
        let zero = Vector3::zeros();
        let rests = way == zero && turn == zero && !is_robot(self.model.config());
        let falls = match role {
            Role::Free if rests => -0.5,
            Role::Free => self.scene.lead(),
            _ => 0.0,
        };
        Course::REST.moving(way + self.scene.fall() * falls, turn)
    }

    /// What gravity changes of a free unit's way from the middle of a substep to its end, metres.
    pub(super) fn half_fall(&self) -> Vector3<f32> {
        match is_robot(self.model.config()) {
            // What a robot's gravity does is the network's to say.
            true => Vector3::zeros(),
            false => self.scene.fall() * 0.5,
        }
    }

    /// Makes the motion of all units that of another step or substep, under another
    /// gravity, at the velocities that they have now: `set_time` and `set_measure` come next.
    pub(super) fn retime(
        &mut self,
        time: &Time,
        gravity: &Vector3<f32>,
    ) -> Result<(), ObserveError> {
        let before = (self.given.dt_s, self.scene.substeps());
        let falls_as_before = (*gravity, time.dt_s) == (self.scene.gravity, self.scene.dt);
        if self.scene.count == 0 || (before == (time.given_s, time.substeps) && falls_as_before) {
            return Ok(());
        }
        let share = (time.given_s / time.substeps as f32) / (before.0 / before.1 as f32);
        // A way tells the velocity of the middle of a substep; from there to now gravity adds half of a fall.
        let halves = match is_robot(self.model.config()) {
            true => [Vector3::zeros(); 2],
            false => [self.half_fall(), gravity * (0.5 * time.dt_s * time.dt_s)],
        };
        let motion = Retimed { share, halves };
        let measure = self.scene.measure;
        // All are tried before any is changed.
        for changes in [false, true] {
            for unit in self.scene.units_mut() {
                let turn = unit.course.turn() * share;
                let way = match unit.is_free() {
                    true => motion.way(&unit.course.way),
                    false => unit.course.way * share,
                };
                let course = unit.course.moving(way, turn);
                // A longer step at the same velocity may come from beyond the largest coordinate.
                let state = State { pose: unit.current, course };
                if !measure.allows(&state) {
                    return Err(ObserveError::BadTimestep);
                }
                if changes {
                    unit.course = course;
                }
            }
            #[cfg(feature = "deform")]
            crate::structure::soft::retime(&mut self.scene, &motion, changes)
                .ok_or(ObserveError::BadTimestep)?;
        }
        Ok(())
    }

    /// Keeps where all units are before the first substep.
    pub(super) fn keep_start(&mut self) {
        let Self { scene, lasting, .. } = self;
        lasting.outcomes.fill(0.0);
        for (unit, start) in scene.units().iter().zip(rows_mut(lasting.start, START)) {
            let (state, target) = start.split_at_mut(STATE.min(start.len()));
            unit.state().write(state);
            write_pose(&unit.target, target);
        }
    }

    /// Tells driven units where to be after a substep, from 1 on: in equal ways and turns, and in the end at the target.
    pub(super) fn aim(&mut self, number: u32) {
        let Self { scene, lasting, .. } = self;
        let rest = scene.substeps().saturating_sub(number) as f32 / scene.substeps() as f32;
        for (unit, start) in scene.units_mut().iter_mut().zip(rows(lasting.start, START)) {
            let (State { pose: from, .. }, target) = started(start);
            unit.target = match unit.role {
                Role::Driven if rest > 0.0 && from != target => turned_by(&target, &from, rest),
                _ => target,
            };
        }
    }

    /// Puts the units of a copy back to where they were before the first substep.
    pub(super) fn back_to_start(&mut self, copy: usize) {
        let Self { scene, lasting, .. } = self;
        let per_copy = scene.per_copy;
        let starts = rows(lasting.start, START).skip(copy * per_copy).take(per_copy);
        for (unit, start) in scene.units_mut().iter_mut().skip(copy * per_copy).zip(starts) {
            let (state, target) = started(start);
            (unit.current, unit.course, unit.target) = (state.pose, state.course, target);
            #[cfg(rigidformer_host)]
            (unit.still = 0);
        }
    }

    /// What became of a copy so far.
    pub(super) fn outcome(&self, copy: usize) -> Result<StepReport, StepError> {
        // Numbers of units, which an f32 holds.
        let whole = |number: f32| number as u32;
        match slice_at(self.lasting.outcomes, copy * OUTCOME, OUTCOME) {
            [active, degenerate, failed] if *failed == 0.0 => {
                let report = StepReport::of(whole(*active), whole(*degenerate));
                Ok(self.with_quarantined(copy, report))
            }
            [_, _, failed] => Err(StepError::Diverged { unit: whole(*failed - 1.0) as usize }),
            _ => Ok(StepReport::default()),
        }
    }

    /// Notes what became of a copy in a substep: the most units of all substeps count.
    pub(super) fn note(&mut self, copy: usize, found: Result<StepReport, StepError>) {
        let row = slice_at_mut(self.lasting.outcomes, copy * OUTCOME, OUTCOME);
        let [active, degenerate, failed] = row else { return };
        match found {
            Ok(report) => {
                *active = active.max(report.active_units as f32);
                *degenerate = degenerate.max(report.degenerate_units as f32);
            }
            Err(StepError::Diverged { unit }) => *failed = unit as f32 + 1.0,
            // No other error comes from a substep.
            Err(_) => *failed = 1.0,
        }
    }
}

/// The state of a unit and its target, where the step began.
fn started(start: &[f32]) -> (State, Pose) {
    let (state, target) = start.split_at(STATE.min(start.len()));
    (State::read(state), read_pose(target))
}
