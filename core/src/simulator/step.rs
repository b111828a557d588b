//! The forward pass and the rollout, one page: the only file that composes blocks.
//!
//! A step is one substep, or several equal ones where it is longer than the model knows. A substep has six stages:
//!
//! | stage | does | where |
//! |---|---|---|
//! | `prepare` | checks units and command; modulations; a robot's heading | `simulator` |
//! | `prior` | motion without the network: impulses, and springs in soft bodies | `contact`, `structure` |
//! | `network` | features and encoder, interaction, anchors; which bonds break | `network`, `structure` |
//! | `integrate` | prior plus corrections; the rigid fit gives a pose a unit | `simulator`, `network`, `geometry` |
//! | `constrain` | soft bodies, bonds, overlaps, joints | `structure`, `contact` |
//! | `commit` | each copy's units move, or none of them | `simulator` |
//!
//! No pose changes before `commit`. What else changes is worked out anew in each step, or is put back where a step fails: by
//! `finish_bonds` and `end`, and after substeps by `back_to_start`.

use super::report::StepReport;
use super::state::Simulator;
use crate::contact::prior;
use crate::error::StepError;
use crate::geometry::STATE;
use crate::kernels::{Native, Schedule, Serial, in_own_environment};
use crate::limits::ANCHORS;
use crate::network::wanted::Wanted;
use crate::network::{Buffers, View, anchors, encoder, interaction, present};
use crate::slices::{rows, slice_at, slice_at_mut};
use crate::structure::{Attempt, Bonds, Joints, SoftBodies, Structure};
use crate::trace::{Layer, NoTrace, Stage, Trace};

/// Who hears what became of the copies of a scene in a step.
trait Listener {
    /// Whether one copy that fails undoes the step of all.
    const TOGETHER: bool;

    fn hear(&mut self, copy: usize, outcome: Result<StepReport, StepError>);
}

/// All copies advance, or none.
struct Together;

impl Listener for Together {
    const TOGETHER: bool = true;

    fn hear(&mut self, _: usize, _: Result<StepReport, StepError>) {}
}

/// A copy that fails is what it was, and the others go on.
struct Apart<F>(F);

impl<F: FnMut(usize, Result<StepReport, StepError>)> Listener for Apart<F> {
    const TOGETHER: bool = false;

    fn hear(&mut self, copy: usize, outcome: Result<StepReport, StepError>) {
        (self.0)(copy, outcome);
    }
}

impl<'s> Simulator<'_, 's> {
    /// Advances the scene by one step, on this crate's kernels and one thread. Models with the inputs `Impact` let no
    /// extreme point of a unit end it below a plane, or deeper than the unit was (docs/MODEL.md, section 7). Planes are
    /// taken in turn, once: the lift off one may push a unit into an earlier one that leans towards it. Models whose motion
    /// is by impulses put units together again that [hold together](Self::bond), and move units apart that overlap in the end (section 7). Last, units that are joined come together.
    /// Models that break bonds say first which break; those do not hold in this step, and never again.
    ///
    /// # Errors
    /// [`StepError`]; the scene is what it was, its bonds too.
    pub fn step(&mut self) -> Result<StepReport, StepError> {
        self.step_traced(&mut NoTrace)
    }

    /// As [`step`](Self::step), showing every layer to `trace`.
    ///
    /// # Errors
    /// [`StepError`]; the scene is what it was.
    pub fn step_traced<T: Trace>(&mut self, trace: &mut T) -> Result<StepReport, StepError> {
        self.step_on(Serial(Native), trace)
    }

    /// As [`step_traced`](Self::step_traced) on any schedule of the simulator's
    /// [layout](Self::with_layout): the same bits.
    ///
    /// # Errors
    /// [`StepError`]; the scene is what it was.
    pub fn step_on<S: Schedule, T: Trace>(
        &mut self,
        schedule: S,
        trace: &mut T,
    ) -> Result<StepReport, StepError> {
        self.advance(schedule, trace, Together)
    }

    /// Advances every copy by one step and tells `report` of each, in order. A copy that fails is
    /// what it was; the others go on. Layers go to `trace`, [`NoTrace`] if nobody looks.
    ///
    /// # Errors
    /// [`StepError::NoUnits`], [`StepError::NoCommand`] or [`StepError::Layout`]: nothing was advanced.
    pub fn step_copies<S: Schedule, T: Trace>(
        &mut self,
        schedule: S,
        trace: &mut T,
        report: impl FnMut(usize, Result<StepReport, StepError>),
    ) -> Result<(), StepError> {
        self.advance(schedule, trace, Apart(report)).map(|_| ())
    }

    /// Advances all copies by one step.
    fn advance<S: Schedule, T: Trace, L: Listener>(
        &mut self,
        schedule: S,
        trace: &mut T,
        listener: L,
    ) -> Result<StepReport, StepError> {
        in_own_environment(|| self.advance_here(schedule, trace, listener))
    }

    fn advance_here<S: Schedule, T: Trace, L: Listener>(
        &mut self,
        schedule: S,
        trace: &mut T,
        mut listener: L,
    ) -> Result<StepReport, StepError> {
        self.hold_lost();
        let (copies, substeps) = (0..self.scene.copies(), self.scene.substeps());
        if substeps > 1 {
            self.keep_start();
        }
        let mut report = StepReport::default();
        for number in 1..=substeps {
            if substeps > 1 {
                self.aim(number);
            }
            match self.substep(schedule, trace, &mut listener) {
                Ok(found) => report = report.or(found),
                Err(error) => {
                    copies.for_each(|copy| self.end(copy, true));
                    return Err(error);
                }
            }
        }
        // Copies that advance apart in one substep have ended theirs already.
        for copy in copies.filter(|_| L::TOGETHER || substeps > 1) {
            let outcome = if L::TOGETHER { Ok(report) } else { self.outcome(copy) };
            self.end(copy, outcome.is_err());
            listener.hear(copy, outcome);
        }
        Ok(report)
    }

    /// Ends the step of a copy; one that failed is as it was before the first substep.
    fn end(&mut self, copy: usize, has_failed: bool) {
        if has_failed && self.scene.substeps() > 1 {
            self.back_to_start(copy);
        }
        self.end_holding(copy, has_failed);
    }

    /// Advances all copies by one substep.
    // One copy of it, whoever steps: flash counts on controllers.
    #[inline(never)]
    fn substep<S: Schedule, T: Trace, L: Listener>(
        &mut self,
        schedule: S,
        trace: &mut T,
        listener: &mut L,
    ) -> Result<StepReport, StepError> {
        self.prepare(schedule)?;
        self.prior(schedule, trace);
        self.network(schedule, trace);
        let (copies, is_whole) = (0..self.scene.copies(), self.scene.substeps() == 1);
        let mut report = StepReport::default();
        for copy in copies.clone() {
            // One that failed in an earlier substep waits for the others.
            if !L::TOGETHER && !is_whole && self.outcome(copy).is_err() {
                continue;
            }
            let outcome = self.attempt(schedule, copy, trace);
            match outcome {
                Ok(found) if L::TOGETHER => report = report.and(found),
                Err(error) if L::TOGETHER => {
                    copies.for_each(|copy| self.finish_bonds(copy, true));
                    return Err(error);
                }
                _ => {
                    self.finish(copy, outcome.is_err());
                    if is_whole {
                        self.end_holding(copy, outcome.is_err());
                        listener.hear(copy, outcome);
                    } else {
                        self.note(copy, outcome);
                    }
                }
            }
        }
        if L::TOGETHER {
            copies.for_each(|copy| self.finish(copy, false));
        }
        Ok(report)
    }

    /// Finds the motion that the network corrects, and which units it sees.
    fn prior<S: Schedule, T: Trace>(&mut self, schedule: S, trace: &mut T) {
        let Self { model, sizes, scene, lasting, present, .. } = self;
        if sizes.solved > 0 {
            trace.enter(Stage::Impulses);
            prior::solve(schedule, scene, lasting.solved);
        }
        if sizes.is_soft() {
            trace.enter(Stage::Impulses);
            (0..scene.copies()).for_each(|copy| SoftBodies::prior(model.config(), scene, copy));
        }
        if let Some(found) = present.get_mut().filter(|_| sizes.near > 0) {
            present::find(sizes, scene, lasting.solved, found);
        }
    }

    /// Leaves the network's output in `rows.head`.
    fn network<S: Schedule, T: Trace>(&mut self, schedule: S, trace: &mut T) {
        if !self.corrects() {
            // Nobody reads tokens then, and no bond breaks.
            self.rows.head.fill(0.0);
            trace.enter(Stage::Motion);
            return;
        }
        self.encode_and_interact(schedule, trace);
        if self.come_apart(schedule) {
            // What has come apart moves apart in this step already.
            trace.begin_again();
            self.prior(schedule, trace);
            self.encode_and_interact(schedule, trace);
        }
        let Self { model, sizes, scene, lasting, rows, present, .. } = self;
        let view = View::new(sizes, scene, present.get().map(|found| &**found));
        trace.enter(Stage::Anchors);
        let wanted = Wanted::of(schedule, sizes, trace);
        let buffers = Buffers { lasting, rows: &mut *rows };
        anchors::predict(schedule, model, sizes, view, buffers, wanted, trace);
        let outputs = view.present.rows() * ANCHORS * sizes.outputs;
        trace.record(Layer::Head, 0, slice_at(rows.head, 0, outputs));
        trace.enter(Stage::Motion);
    }

    /// Encodes units to tokens, and lets tokens attend to each other.
    fn encode_and_interact<S: Schedule, T: Trace>(&mut self, schedule: S, trace: &mut T) {
        let Self { model, sizes, scene, lasting, rows, present, .. } = self;
        let wanted = Wanted::of(schedule, sizes, trace);
        // Impulses may have left nothing to correct.
        if schedule.skips() && !wanted.any(scene, lasting.solved) {
            return;
        }
        let view = View::new(sizes, scene, present.get().map(|found| &**found));
        trace.enter(Stage::Encoder);
        let buffers = Buffers { lasting: &mut *lasting, rows: &mut *rows };
        encoder::encode(schedule, model, sizes, view, buffers, trace);
        trace.enter(Stage::Interaction);
        interaction::interact(schedule, model, sizes, view, Buffers { lasting, rows }, trace);
    }

    /// Breaks the bonds of all copies that the network says break in this step; whether there are any.
    /// [`finish_bonds`](Self::finish_bonds) says whether that lasts.
    fn come_apart<S: Schedule>(&mut self, schedule: S) -> bool {
        let Self { model, sizes, scene, lasting, rows, bonds, .. } = self;
        bonds.come_apart(schedule, (model, sizes), scene, (lasting.solved, rows))
    }

    /// Finds where a copy's units go, for `commit`; nothing moves yet. In quarantine a unit that goes nowhere is held instead.
    fn attempt<S: Schedule, T: Trace>(
        &mut self,
        schedule: S,
        copy: usize,
        trace: &mut T,
    ) -> Result<StepReport, StepError> {
        // Each try holds a unit that the one before did not.
        for _ in 0..self.most_held() {
            let outcome = self.integrate_and_constrain(schedule, copy, trace);
            match outcome {
                Err(StepError::Diverged { unit }) if self.hold(copy, unit) => {}
                _ => return outcome.map(|report| self.with_quarantined(copy, report)),
            }
        }
        let outcome = self.integrate_and_constrain(schedule, copy, trace);
        outcome.map(|report| self.with_quarantined(copy, report))
    }

    /// As [`attempt`](Self::attempt), where any unit that goes nowhere is an error.
    fn integrate_and_constrain<S: Schedule, T: Trace>(
        &mut self,
        schedule: S,
        copy: usize,
        trace: &mut T,
    ) -> Result<StepReport, StepError> {
        let report = self.integrate(schedule, copy, trace)?;
        self.constrain(schedule, copy).map_err(|unit| StepError::Diverged { unit })?;
        Ok(report)
    }

    /// Changes where a copy's units go, so that they hold together and do not overlap. Joints come last: they hold exactly.
    fn constrain<S: Schedule>(&mut self, schedule: S, copy: usize) -> Result<(), usize> {
        SoftBodies::constrain(schedule, self.next_of(copy))?;
        Bonds::constrain(schedule, self.next_of(copy))?;
        let Self { sizes, scene, lasting, .. } = self;
        if sizes.solved > 0 {
            let first = copy * scene.per_copy;
            let next = slice_at_mut(lasting.next, first * STATE, scene.per_copy * STATE);
            prior::keep_apart(scene, first, lasting.solved, next);
        }
        Joints::constrain(schedule, self.next_of(copy))
    }

    /// Where the step under way takes a copy.
    fn next_of(&mut self, copy: usize) -> Attempt<'_, 's> {
        let Self { model, sizes, scene, lasting, rows, .. } = self;
        let width = scene.per_copy * STATE;
        let next = slice_at_mut(lasting.next, copy * width, width);
        Attempt { model, sizes, scene, copy, solved: lasting.solved, next, rows }
    }

    /// Ends a substep of a copy: it goes where it was taken, or stays where the substep failed.
    fn finish(&mut self, copy: usize, has_failed: bool) {
        self.finish_bonds(copy, has_failed);
        if !has_failed {
            self.commit(copy);
        }
    }

    /// Ends a substep for a copy's bonds: those that broke in it are broken, or hold again where it failed.
    fn finish_bonds(&mut self, copy: usize, has_failed: bool) {
        let Self { model, scene, bonds, .. } = self;
        bonds.finish(model, scene, copy, has_failed);
    }

    /// Moves all units of a copy to where they go.
    fn commit(&mut self, copy: usize) {
        let Self { sizes, scene, lasting, .. } = self;
        let (first, count) = (copy * scene.per_copy, scene.per_copy);
        let next = slice_at(lasting.next, first * STATE, count * STATE);
        let units = scene.units_mut().iter_mut().skip(first);
        for (unit, next) in units.zip(rows(next, STATE)) {
            unit.go_to(next);
        }
        if sizes.solved > 0 {
            prior::mark_still(scene, copy, lasting.solved);
        }
        if sizes.is_soft() {
            SoftBodies::commit(scene, copy);
            self.weigh_soft(copy);
        }
    }
}
