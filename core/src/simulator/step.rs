//! The forward pass and the rollout. The only file that composes blocks.

use super::state::Simulator;
use crate::contact::prior;
use crate::error::StepError;
use crate::geometry::{Pose, Rank, kabsch, read_pose, write_pose};
use crate::kernels::{Divisible, Native, Schedule, Serial};
use crate::limits::{ANCHORS, MAX_COMMAND, MAX_COORDINATE_M};
use crate::model::Model;
use crate::network::layers::{self, part, part_mut, rows_mut};
use crate::network::present::Present;
use crate::network::wanted::Wanted;
use crate::network::{anchors, encoder, interaction, motion};
use crate::scene::{Role, Scene, UnitSlot};
use crate::share::{Work, share_out};
use crate::sizes::Sizes;
use crate::structure::heading::{self, HEADING, is_carried};
use crate::trace::{Layer, NoTrace, Stage, Trace};
use crate::workspace::{POSE, command_places};
use rigidformer_weights::Directions;

/// Room for a command as a heading has it.
const SEEN: usize = if HEADING { MAX_COMMAND } else { 0 };
/// Cost of moving one unit, in multiplications (about 1 us): decides whether threads share it.
const UNIT_COST: usize = 256 << 10;

/// What a step did; of a step in parts the most that one of them did.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct StepReport {
    /// Units whose motion the network predicted; the others can touch nothing within the
    /// step and moved freely, exactly, or are driven or fixed.
    pub active_units: u32,
    /// Units whose anchors left their rotation open; see [`Rank`].
    pub degenerate_units: u32,
    /// Units in [quarantine](Simulator::set_quarantine) after the step.
    #[cfg(feature = "health")]
    pub quarantined_units: u32,
}

impl StepReport {
    /// Of units, none of them in quarantine.
    pub(super) fn of(active_units: u32, degenerate_units: u32) -> Self {
        StepReport {
            active_units,
            degenerate_units,
            #[cfg(feature = "health")]
            quarantined_units: 0,
        }
    }

    /// Of two parts of a step.
    fn or(self, other: StepReport) -> StepReport {
        StepReport {
            active_units: self.active_units.max(other.active_units),
            degenerate_units: self.degenerate_units.max(other.degenerate_units),
            #[cfg(feature = "health")]
            quarantined_units: self.quarantined_units.max(other.quarantined_units),
        }
    }

    fn and(self, other: StepReport) -> StepReport {
        StepReport {
            active_units: self.active_units + other.active_units,
            degenerate_units: self.degenerate_units + other.degenerate_units,
            #[cfg(feature = "health")]
            quarantined_units: self.quarantined_units + other.quarantined_units,
        }
    }
}

/// The rows of units that the network sees: a macro, since it borrows a part of the simulator.
macro_rules! present {
    ($simulator:ident) => {{
        #[cfg(feature = "host")]
        let present = Present::of(&$simulator.sizes, &$simulator.scene, $simulator.present);
        #[cfg(not(feature = "host"))]
        let present = Present::all(&$simulator.scene);
        present
    }};
}

impl Simulator<'_, '_> {
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
        #[cfg(feature = "health")]
        self.hold_lost();
        let report = match self.scene.parts() {
            2.. => self.step_in_parts(schedule, trace),
            _ => self.step_part(schedule, trace),
        };
        #[cfg(feature = "health")]
        (0..self.scene.copies()).for_each(|copy| self.end_holding(copy, report.is_err()));
        report
    }

    /// As [`step_on`](Self::step_on), the whole step or a part of it.
    fn step_part<S: Schedule, T: Trace>(
        &mut self,
        schedule: S,
        trace: &mut T,
    ) -> Result<StepReport, StepError> {
        self.predict(schedule, trace)?;
        let mut report = StepReport::default();
        for copy in 0..self.scene.copies() {
            match self.advance(schedule, copy, trace) {
                Ok(found) => report = report.and(found),
                Err(error) => {
                    (0..self.scene.copies()).for_each(|copy| self.settle(copy, true));
                    return Err(error);
                }
            }
        }
        for copy in 0..self.scene.copies() {
            self.settle(copy, false);
            self.commit(copy);
        }
        Ok(report)
    }

    /// As [`step_on`](Self::step_on), for a step in parts.
    fn step_in_parts<S: Schedule, T: Trace>(
        &mut self,
        schedule: S,
        trace: &mut T,
    ) -> Result<StepReport, StepError> {
        self.keep_start();
        let mut report = StepReport::default();
        for number in 1..=self.scene.parts() {
            self.aim(number);
            match self.step_part(schedule, trace) {
                Ok(found) => report = report.or(found),
                Err(error) => {
                    (0..self.scene.copies()).for_each(|copy| self.restore(copy));
                    return Err(error);
                }
            }
        }
        Ok(report)
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
        mut report: impl FnMut(usize, Result<StepReport, StepError>),
    ) -> Result<(), StepError> {
        #[cfg(feature = "health")]
        self.hold_lost();
        if self.scene.parts() > 1 {
            return self.step_copies_in_parts(schedule, trace, report);
        }
        if let Err(error) = self.predict(schedule, trace) {
            #[cfg(feature = "health")]
            (0..self.scene.copies()).for_each(|copy| self.end_holding(copy, true));
            return Err(error);
        }
        for copy in 0..self.scene.copies() {
            let outcome = self.advance(schedule, copy, trace);
            self.settle(copy, outcome.is_err());
            if outcome.is_ok() {
                self.commit(copy);
            }
            #[cfg(feature = "health")]
            self.end_holding(copy, outcome.is_err());
            report(copy, outcome);
        }
        Ok(())
    }

    /// As [`step_copies`](Self::step_copies), for a step in parts: a copy that fails waits for the others.
    fn step_copies_in_parts<S: Schedule, T: Trace>(
        &mut self,
        schedule: S,
        trace: &mut T,
        mut report: impl FnMut(usize, Result<StepReport, StepError>),
    ) -> Result<(), StepError> {
        self.keep_start();
        for number in 1..=self.scene.parts() {
            self.aim(number);
            if let Err(error) = self.predict(schedule, trace) {
                (0..self.scene.copies()).for_each(|copy| {
                    self.restore(copy);
                    #[cfg(feature = "health")]
                    self.end_holding(copy, true);
                });
                return Err(error);
            }
            for copy in 0..self.scene.copies() {
                if self.outcome(copy).is_ok() {
                    let found = self.advance(schedule, copy, trace);
                    if found.is_ok() {
                        self.commit(copy);
                    }
                    self.note(copy, found);
                }
            }
        }
        for copy in 0..self.scene.copies() {
            let outcome = self.outcome(copy);
            if outcome.is_err() {
                self.restore(copy);
            }
            #[cfg(feature = "health")]
            self.end_holding(copy, outcome.is_err());
            report(copy, outcome);
        }
        Ok(())
    }

    /// Runs the network on the current scene; leaves its output in `rows.head`.
    fn predict<S: Schedule, T: Trace>(
        &mut self,
        schedule: S,
        trace: &mut T,
    ) -> Result<(), StepError> {
        if self.scene.count == 0 {
            return Err(StepError::NoUnits);
        }
        if self.sizes.command > 0 && !self.commanded {
            return Err(StepError::NoCommand { size: self.sizes.command });
        }
        if self.sizes.layout != S::LAYOUT {
            return Err(StepError::Layout);
        }
        if is_carried(self.model.config()) {
            heading::face(&mut self.scene);
        }
        self.modulate(schedule);
        self.see(schedule, trace);
        #[cfg(feature = "deform")]
        if self.break_bonds(schedule) {
            // What has parted moves in this step already.
            trace.begin_again();
            self.see(schedule, trace);
        }
        let present = present!(self);
        let Self { model, sizes, scene, lasting, rows, .. } = self;
        trace.enter(Stage::Anchors);
        let wanted = Wanted::of(schedule, sizes, trace);
        anchors::predict(schedule, model, sizes, (scene, present), (lasting, rows), wanted, trace);
        trace.record(Layer::Head, 0, part(rows.head, 0, present.rows() * ANCHORS * sizes.outputs));

        trace.enter(Stage::Motion);
        Ok(())
    }

    /// Finds the motion that the network corrects, and the units' tokens.
    fn see<S: Schedule, T: Trace>(&mut self, schedule: S, trace: &mut T) {
        let Self { sizes, scene, lasting, .. } = self;
        if sizes.solved > 0 {
            trace.enter(Stage::Impulses);
            prior::solve(schedule, scene, lasting.solved);
        }
        #[cfg(feature = "deform")]
        if sizes.is_soft() {
            trace.enter(Stage::Impulses);
            let elastic = &self.model.config().elastic;
            (0..scene.copies())
                .for_each(|copy| crate::structure::soft::solve(scene, elastic, copy));
        }
        #[cfg(feature = "host")]
        if sizes.near > 0 {
            crate::network::present::find(sizes, scene, lasting.solved, self.present);
        }
        let wanted = Wanted::of(schedule, sizes, trace);
        if schedule.skips() && !wanted.any(scene, lasting.solved) {
            return;
        }
        let present = present!(self);
        let Self { model, sizes, scene, lasting, rows, .. } = self;
        trace.enter(Stage::Encoder);
        encoder::encode(schedule, model, sizes, (scene, present), (lasting, rows), trace);
        trace.enter(Stage::Interaction);
        interaction::interact(schedule, model, sizes, (scene, present), (lasting, rows), trace);
    }

    /// Breaks the bonds of all copies that the network says break in this step; whether there are any. [`settle`](Self::settle) says
    /// whether that lasts.
    #[cfg(feature = "deform")]
    fn break_bonds<S: Schedule>(&mut self, schedule: S) -> bool {
        let Self { model, sizes, scene, lasting, rows, bonds, .. } = self;
        if model.breaking.is_none() || bonds.len() == 0 {
            return false;
        }
        crate::structure::bonds::keep_bodies(scene.units_mut());
        let mut any = false;
        for copy in 0..scene.copies() {
            let seen = (&*lasting.solved, &mut *rows);
            any |= crate::structure::breaking::break_bonds(
                schedule,
                model,
                sizes,
                scene,
                (bonds, copy),
                seen,
            );
        }
        any
    }

    /// Ends a step of a copy: the bonds that broke in it are broken, or hold again where it failed.
    #[cfg(feature = "deform")]
    fn settle(&mut self, copy: usize, has_failed: bool) {
        let Self { model, scene, bonds, .. } = self;
        if model.breaking.is_some() && bonds.settle(copy, has_failed) > 0 && has_failed {
            let per_copy = scene.per_copy;
            let units = scene.units_mut().chunks_exact_mut(per_copy.max(1)).nth(copy);
            crate::structure::bonds::restore(units.unwrap_or_default(), bonds.of(copy));
        }
    }

    /// As above, without bonds.
    #[cfg(not(feature = "deform"))]
    fn settle(&mut self, _: usize, _: bool) {}

    /// Computes the modulations by the step code and the commands, where those have changed.
    fn modulate<S: Schedule>(&mut self, schedule: S) {
        let Self { model, sizes, scene, lasting, rows, .. } = self;
        let width = 2 * sizes.width;
        if self.films_stale {
            let code = self.step_code / 10.0;
            let condition = [code, code * code];
            let films = core::iter::once(&model.encoder.film)
                .chain(model.blocks.iter().map(|block| &block.film))
                .chain(core::iter::once(&model.anchors.film));
            for (film, out) in films.zip(rows_mut(lasting.films, width)) {
                film.mlp.apply(schedule, &condition, rows.film_hidden, out, &mut rows.scratch);
            }
            self.films_stale = false;
        }
        let turned = HEADING && model.config().directions != Directions::NONE;
        if self.commands_stale || turned {
            let places = command_places(sizes);
            let all = rows_mut(lasting.commands, places * width);
            let commands = layers::rows(lasting.command_inputs, sizes.command);
            for ((copy, command), out) in commands.enumerate().zip(all) {
                let mut seen = [0.0; SEEN];
                let command = match scene.units().get(copy * scene.per_copy).filter(|_| turned) {
                    Some(unit) => heading::command(model.config(), unit, command, &mut seen),
                    None => command,
                };
                let films = core::iter::once(&model.encoder.command)
                    .chain(model.blocks.iter().map(|block| &block.command));
                for (film, out) in films.flatten().zip(rows_mut(out, width)) {
                    film.mlp.apply(schedule, command, rows.film_hidden, out, &mut rows.scratch);
                }
            }
            self.commands_stale = false;
        }
    }

    /// Finds where the network's output moves a copy's units, for `commit`; nothing moves yet. In quarantine a unit that
    /// goes nowhere is held instead.
    fn advance<S: Schedule, T: Trace>(
        &mut self,
        schedule: S,
        copy: usize,
        trace: &mut T,
    ) -> Result<StepReport, StepError> {
        #[cfg(feature = "health")]
        if self.quarantines {
            // Each try holds a unit that the one before did not.
            for _ in 0..self.scene.per_copy {
                match self.advance_all(schedule, copy, trace) {
                    Err(StepError::Diverged { unit }) if self.hold(copy, unit) => {}
                    other => return other.map(|report| self.with_quarantined(copy, report)),
                }
            }
        }
        let report = self.advance_all(schedule, copy, trace);
        #[cfg(feature = "health")]
        let report = report.map(|report| self.with_quarantined(copy, report));
        report
    }

    /// As [`advance`](Self::advance), where any unit that goes nowhere is an error.
    fn advance_all<S: Schedule, T: Trace>(
        &mut self,
        schedule: S,
        copy: usize,
        trace: &mut T,
    ) -> Result<StepReport, StepError> {
        let present = present!(self);
        let Self { model, sizes, scene, lasting, rows: activations, .. } = self;
        let (first, count) = (copy * scene.per_copy, scene.per_copy);
        let width = sizes.poses * POSE;
        let next = part_mut(lasting.next, first * width, count * width);
        let (head, solved) = (&*activations.head, &*lasting.solved);
        let moving = Moving { model, sizes, scene, present, head, solved, first };
        let moves = Moves { first, width, next };
        let report = share_out(schedule, trace, (true, count * UNIT_COST), &moving, moves)?;
        #[cfg(feature = "deform")]
        if sizes.is_soft() {
            crate::structure::soft::blend(schedule, model, sizes, (scene, copy), activations)
                .map_err(|unit| StepError::Diverged { unit })?;
        }
        #[cfg(feature = "deform")]
        if sizes.solved > 0 {
            let next = part_mut(lasting.next, first * width, count * width);
            let any = crate::structure::bonds::hold_together(scene, first, lasting.solved, next);
            let nowhere = |pose: &[f32]| !is_somewhere(&read_pose(pose));
            if let Some(pose) = layers::rows(next, POSE).position(nowhere).filter(|_| any) {
                return Err(StepError::Diverged { unit: pose / sizes.poses.max(1) });
            }
        }
        if sizes.solved > 0 {
            let next = part_mut(lasting.next, first * width, count * width);
            prior::keep_apart(scene, first, lasting.solved, next);
        }
        #[cfg(feature = "robot")]
        {
            let next = part_mut(lasting.next, first * width, count * width);
            let sweeps = crate::structure::joints::sweeps(model.config().motion);
            crate::structure::joints::hold_together(scene, first, sweeps, (&mut *next, width));
            let mut units = layers::rows(next, width).zip(scene.units().iter().skip(first));
            // What is held stays, wherever that is.
            let is_lost = |(pose, unit): (&[f32], &UnitSlot)| {
                !unit.is_quarantined() && !is_somewhere(&read_pose(pose))
            };
            if let Some(unit) = units.position(is_lost) {
                return Err(StepError::Diverged { unit });
            }
        }
        Ok(report)
    }

    /// Moves all units of a copy to where they go.
    fn commit(&mut self, copy: usize) {
        let Self { sizes, scene, lasting, .. } = self;
        let (first, count) = (copy * scene.per_copy, scene.per_copy);
        let width = sizes.poses * POSE;
        let next = part(lasting.next, first * width, count * width);
        let units = scene.units_mut().iter_mut().skip(first);
        for (unit, next) in units.zip(layers::rows(next, width)) {
            // Nothing that is done to all units may move it.
            if unit.is_quarantined() {
                unit.previous = unit.current;
                continue;
            }
            let (next, before) = next.split_at(POSE.min(next.len()));
            #[cfg(rigidformer_host)]
            let was = [unit.previous, unit.current];
            unit.previous = if before.is_empty() { unit.current } else { read_pose(before) };
            unit.current = read_pose(next);
            #[cfg(rigidformer_host)]
            {
                let mut now = [&unit.previous, &unit.current].into_iter().zip(&was);
                let is_left = now.all(|(now, was)| now.has_bits_of(was));
                unit.still = if is_left { unit.still.max(1) } else { 0 };
            }
        }
        #[cfg(rigidformer_host)]
        if sizes.solved > 0 {
            prior::settle(scene, copy, lasting.solved);
        }
        #[cfg(feature = "deform")]
        if sizes.is_soft() {
            crate::structure::soft::commit(scene, copy);
            self.weigh_soft(copy);
        }
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
            #[cfg(feature = "deform")]
            if self.sizes.is_soft() && unit.is_free() {
                report.active_units += u32::from(unit.is_soft());
                let [there, earlier] = match unit.is_soft() {
                    true => [unit.current; 2],
                    false => crate::structure::soft::rigid_poses(self.scene, index, unit),
                };
                if ![&there, &earlier].into_iter().all(is_somewhere) {
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
        let out = part(head, index * ANCHORS * 3, ANCHORS * 3);
        let (advanced, active) = motion::advance(model.config(), scene, index, unit, out);
        trace.record(Layer::Advanced, index, advanced.map(|a| [a.x, a.y, a.z]).as_flattened());
        // From the reference each step, so that no drift accumulates.
        let mut fit = kabsch(&scene.anchors_of(unit), &advanced, &unit.current.rotation);
        if !is_somewhere(&fit.pose) {
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
            part(head, row.unwrap_or_default() * width, if row.is_some() { width } else { 0 });
        let (places, active) = motion::correct(model.config(), scene, (unit, &solved), out);
        let [advanced, earlier] = &places;
        trace.record(Layer::Advanced, index, advanced.map(|a| [a.x, a.y, a.z]).as_flattened());
        let mut rank = Rank::Full;
        // What rests stays to the bit.
        if solved.share >= 0.0 {
            let anchors = scene.anchors_of(unit);
            let fit = kabsch(&anchors, advanced, &unit.current.rotation);
            (solved.next, rank) = (fit.pose, fit.rank);
            if active {
                solved.before = kabsch(&anchors, earlier, &solved.before.rotation).pose;
            }
        }
        if ![&solved.next, &solved.before].into_iter().all(is_somewhere) {
            return None;
        }
        // Clusters are lifted as a whole.
        if unit.lead().is_none() {
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

/// Whether a pose is finite and near enough. A number that is not finite, in an anchor or in the rotation, leaves none in
/// the centre: it is in the sums.
pub(super) fn is_somewhere(pose: &Pose) -> bool {
    pose.centre.iter().all(|v| v.abs() <= MAX_COORDINATE_M)
}
