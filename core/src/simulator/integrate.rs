//! The stage of a step that takes units where the network's output says.

use super::report::StepReport;
use super::state::Simulator;
use crate::contact::prior::{self, Solved};
use crate::error::StepError;
use crate::geometry::{Rank, STATE, State, kabsch_here, turn_between};
use crate::kernels::{Divisible, Schedule};
use crate::limits::ANCHORS;
use crate::model::Model;
use crate::network::View;
use crate::network::motion::{self, Advanced};
use crate::network::present::Present;
use crate::scene::{Role, Scene, UnitSlot};
use crate::share::{Work, share_out};
use crate::sizes::Sizes;
use crate::slices::{rows_mut, slice_at, slice_at_mut};
use crate::structure::{SoftBodies, Structure};
use crate::trace::{Layer, Trace};
use nalgebra::Vector3;

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
        let next = slice_at_mut(lasting.next, first * STATE, count * STATE);
        let (head, solved) = (&*rows.head, &*lasting.solved);
        let moving = Moving { model, sizes, scene, present, head, solved, first };
        let moves = Moves { first, next };
        share_out(schedule, trace, (true, count * UNIT_COST), &moving, moves)
    }
}

/// Units and where they go.
struct Moves<'p> {
    first: usize,
    /// (units, [`STATE`])
    next: &'p mut [f32],
}

impl Divisible for Moves<'_> {
    fn split(self, left: usize, of: usize) -> [Self; 2] {
        let Moves { first, next } = self;
        let count = next.len() / STATE * left / of;
        let (next, others) = next.split_at_mut((count * STATE).min(next.len()));
        [Moves { first, next }, Moves { first: first + count, next: others }]
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
        for (index, next) in (part.first..).zip(rows_mut(part.next, STATE)) {
            let diverged = StepError::Diverged { unit: index - self.first };
            let unit = self.scene.units().get(index).ok_or(diverged)?;
            if self.sizes.is_soft() && unit.is_free() {
                report.active_units += u32::from(unit.is_soft());
                let there = SoftBodies::state(self.scene, index, unit);
                if !self.scene.measure.allows(&there) {
                    return Err(diverged);
                }
                there.write(next);
                continue;
            }
            match unit.role {
                Role::Free if self.solved.is_empty() => {
                    let own = self.free(index, unit, next, trace).ok_or(diverged)?;
                    report = report.and(own);
                }
                Role::Free => {
                    let own = self.solved(index, unit, next, trace).ok_or(diverged)?;
                    report = report.and(own);
                }
                Role::Driven => unit.driven().write(next),
                Role::Fixed => unit.resting().write(next),
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
        row: &mut [f32],
        trace: &mut T,
    ) -> Option<StepReport> {
        let Moving { model, scene, head, .. } = *self;
        let out = slice_at(head, index * ANCHORS * 3, ANCHORS * 3);
        let Advanced { places, active, free } =
            motion::advance(model.config(), scene, index, unit, out);
        record(trace, index, &unit.current.centre, &places);
        // From the reference each step, so that no drift accumulates. The fit's centre is how far the unit's moves.
        let fit = kabsch_here(&scene.anchors_of(unit), &places, &unit.current.rotation);
        let mut next = match free.filter(|_| !active) {
            // What nothing can touch flies with all of its digits.
            Some(free) => free,
            None => {
                let mut next = unit.resting();
                next.push(&fit.pose.centre);
                let turn = turn_between(&unit.current.rotation, &fit.pose.rotation);
                next.pose.rotation = fit.pose.rotation;
                next.course.turn_low = Vector3::zeros();
                State { course: next.course.moving(next.course.way, turn), ..next }
            }
        };
        if !scene.measure.allows(&next) {
            return None;
        }
        let lift = motion::lift_above_planes(scene, unit, &next.pose);
        next.push(&lift);
        next.write(row);
        Some(StepReport::of(u32::from(active), u32::from(fit.rank != Rank::Full)))
    }

    /// As [`free`](Self::free), by impulses.
    fn solved<T: Trace>(
        &self,
        index: usize,
        unit: &UnitSlot,
        row: &mut [f32],
        trace: &mut T,
    ) -> Option<StepReport> {
        let Moving { model, sizes, scene, present, head, solved, .. } = *self;
        let Solved { mut next, share } = prior::solved(scene, index, solved);
        let width = ANCHORS * sizes.outputs;
        // Of units that the network does not see it corrects nothing.
        let seen = present.row(index);
        let out = slice_at(
            head,
            seen.unwrap_or_default() * width,
            if seen.is_some() { width } else { 0 },
        );
        let anchors = scene.anchors_of(unit);
        let before = next.before();
        let ([places, earlier], active) = motion::correct(
            model.config(),
            scene,
            &anchors,
            (&next, &before),
            (share, unit.radius),
            out,
        );
        record(trace, index, &next.pose.centre, &places);
        let mut rank = Rank::Full;
        // What rests stays to the bit.
        if share >= 0.0 {
            let fit = kabsch_here(&anchors, &places, &unit.current.rotation);
            rank = fit.rank;
            if active {
                let earlier = kabsch_here(&anchors, &earlier, &before.rotation).pose;
                next.shift(&fit.pose.centre);
                next.pose.rotation = fit.pose.rotation;
                next.course.turn_low = Vector3::zeros();
                let way = next.course.way + (fit.pose.centre - earlier.centre);
                let turn = turn_between(&earlier.rotation, &fit.pose.rotation);
                next.course = next.course.moving(way, turn);
            }
        }
        if !scene.measure.allows(&next) {
            return None;
        }
        // Clusters are lifted as a whole. A lift is no velocity.
        if unit.cluster_root().is_none() {
            next.shift(&motion::lift_above_planes(scene, unit, &next.pose));
        }
        next.write(row);
        Some(StepReport::of(u32::from(active), u32::from(rank != Rank::Full)))
    }
}

/// Shows where a unit's anchors go, which are given from a place.
fn record<T: Trace>(
    trace: &mut T,
    index: usize,
    from: &Vector3<f32>,
    places: &[Vector3<f32>; ANCHORS],
) {
    let places = places.map(|place| (place + from).into());
    trace.record(Layer::Advanced, index, places.as_flattened());
}
