//! The stage of a step that takes units where the network's output says.

use super::report::StepReport;
use super::state::Simulator;
use crate::contact::prior;
use crate::error::StepError;
use crate::geometry::{Pose, Rank, kabsch_here, write_pose};
use crate::kernels::{Divisible, Schedule};
use crate::limits::ANCHORS;
use crate::model::Model;
use crate::network::present::Present;
use crate::network::{View, motion};
use crate::scene::{Role, Scene, UnitSlot};
use crate::share::{Work, share_out};
use crate::sizes::Sizes;
use crate::slices::{rows_mut, slice_at, slice_at_mut};
use crate::structure::{SoftBodies, Structure};
use crate::trace::{Layer, Trace};
use crate::workspace::POSE;

/// Cost of moving one unit, in multiplications (about 1 us): decides whether threads share it.
const UNIT_COST: usize = 256 << 10;

impl Simulator<'_, '_> {
    /// Finds where the network's output takes a copy's units, each for itself.
    pub(super) fn integrate<S: Schedule, T: Trace>(
        &mut self,
        schedule: S,
        copy: usize,
        trace: &mut T,
    ) -> Result<StepReport, StepError> {
        let Self { model, sizes, scene, lasting, rows, present, .. } = self;
        let View { scene, present } = View::new(sizes, scene, present.get().map(|found| &**found));
        let (first, count) = (copy * scene.per_copy, scene.per_copy);
        let width = sizes.poses * POSE;
        let next = slice_at_mut(lasting.next, first * width, count * width);
        let (head, solved) = (&*rows.head, &*lasting.solved);
        let moving = Moving { model, sizes, scene, present, head, solved, first };
        let moves = Moves { first, width, next };
        share_out(schedule, trace, (true, count * UNIT_COST), &moving, moves)
    }
}

/// Units and where they go.
struct Moves<'p> {
    first: usize,
    /// Numbers of a unit.
    width: usize,
    /// (units, poses)
    next: &'p mut [f32],
}

impl Divisible for Moves<'_> {
    fn split(self, left: usize, of: usize) -> [Self; 2] {
        let Moves { first, width, next } = self;
        let count = next.len() / width.max(1) * left / of;
        let (next, others) = next.split_at_mut((count * width).min(next.len()));
        [Moves { first, width, next }, Moves { first: first + count, width, next: others }]
    }
}

/// What all units' motions read.
struct Moving<'a> {
    model: &'a Model<'a>,
    sizes: &'a Sizes,
    scene: &'a Scene<'a>,
    present: Present<'a>,
    /// (rows of units, anchors, outputs)
    head: &'a [f32],
    /// Motion by impulses; empty for models without.
    solved: &'a [f32],
    /// Number of the copy's first unit.
    first: usize,
}

impl Work<Moves<'_>> for Moving<'_> {
    type Out = Result<StepReport, StepError>;

    fn run<S: Schedule, T: Trace>(&self, _: S, part: Moves<'_>, trace: &mut T) -> Self::Out {
        let mut report = StepReport::default();
        for (index, next) in (part.first..).zip(rows_mut(part.next, part.width)) {
            let diverged = StepError::Diverged { unit: index - self.first };
            let unit = self.scene.units().get(index).ok_or(diverged)?;
            let (next, before) = next.split_at_mut(POSE.min(next.len()));
            if self.sizes.is_soft() && unit.is_free() {
                report.active_units += u32::from(unit.is_soft());
                let [there, earlier] = SoftBodies::poses(self.scene, index, unit);
                if ![&there, &earlier].into_iter().all(Pose::is_somewhere) {
                    return Err(diverged);
                }
                write_pose(&there, next);
                write_pose(&earlier, before);
                continue;
            }
            match unit.role {
                Role::Free if self.solved.is_empty() => {
                    let own = self.free(index, unit, next, trace).ok_or(diverged)?;
                    report = report.and(own);
                }
                Role::Free => {
                    let own = self.solved(index, unit, [next, before], trace).ok_or(diverged)?;
                    report = report.and(own);
                }
                Role::Driven | Role::Fixed => {
                    let there = if unit.is_driven() { &unit.target } else { &unit.current };
                    write_pose(there, next);
                    write_pose(&unit.current, before);
                }
            }
        }
        Ok(report)
    }

    /// Of two that fail, the first one's error.
    fn merge(a: Self::Out, b: Self::Out) -> Self::Out {
        Ok(a?.and(b?))
    }
}

impl Moving<'_> {
    /// Where a free unit goes; none where the prediction is nowhere.
    fn free<T: Trace>(
        &self,
        index: usize,
        unit: &UnitSlot,
        next: &mut [f32],
        trace: &mut T,
    ) -> Option<StepReport> {
        let Moving { model, scene, head, .. } = *self;
        let out = slice_at(head, index * ANCHORS * 3, ANCHORS * 3);
        let (advanced, active) = motion::advance(model.config(), scene, index, unit, out);
        trace.record(Layer::Advanced, index, advanced.map(|a| [a.x, a.y, a.z]).as_flattened());
        // From the reference each step, so that no drift accumulates.
        let mut fit = kabsch_here(&scene.anchors_of(unit), &advanced, &unit.current.rotation);
        if !fit.pose.is_somewhere() {
            return None;
        }
        motion::lift_above_planes(scene, unit, &mut fit.pose);
        write_pose(&fit.pose, next);
        Some(StepReport::of(u32::from(active), u32::from(fit.rank != Rank::Full)))
    }

    /// As [`free`](Self::free), by impulses.
    fn solved<T: Trace>(
        &self,
        index: usize,
        unit: &UnitSlot,
        [next, before]: [&mut [f32]; 2],
        trace: &mut T,
    ) -> Option<StepReport> {
        let Moving { model, sizes, scene, present, head, solved, .. } = *self;
        let mut solved = prior::solved(scene, index, solved);
        let width = ANCHORS * sizes.outputs;
        // Of units that the network does not see it corrects nothing.
        let row = present.row(index);
        let out =
            slice_at(head, row.unwrap_or_default() * width, if row.is_some() { width } else { 0 });
        let (places, active) = motion::correct(model.config(), scene, (unit, &solved), out);
        let [advanced, earlier] = &places;
        trace.record(Layer::Advanced, index, advanced.map(|a| [a.x, a.y, a.z]).as_flattened());
        let mut rank = Rank::Full;
        // What rests stays to the bit.
        if solved.share >= 0.0 {
            let anchors = scene.anchors_of(unit);
            let fit = kabsch_here(&anchors, advanced, &unit.current.rotation);
            (solved.next, rank) = (fit.pose, fit.rank);
            if active {
                solved.before = kabsch_here(&anchors, earlier, &solved.before.rotation).pose;
            }
        }
        if ![&solved.next, &solved.before].into_iter().all(Pose::is_somewhere) {
            return None;
        }
        // Clusters are lifted as a whole.
        if unit.cluster_root().is_none() {
            let low = solved.next.centre;
            motion::lift_above_planes(scene, unit, &mut solved.next);
            // A lift is no velocity.
            solved.before.centre += solved.next.centre - low;
        }
        write_pose(&solved.next, next);
        write_pose(&solved.before, before);
        Some(StepReport::of(u32::from(active), u32::from(rank != Rank::Full)))
    }
}
