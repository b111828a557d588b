//! A simulator's state from a snapshot that was checked: nothing here fails.

use super::check::Checked;
use super::layout::{COMMANDED, COPY_COURSE, NO_NETWORK, QUARANTINES};
use crate::geometry::POSE;
use crate::scene::{Compliance, Quarantine, Role, UnitId, UnitSlot};
use crate::simulator::state::Simulator;
use crate::slices::slice_at_mut;
use crate::stand_in::{OfCompliance, OfHealth};
use nalgebra::Point3;

impl Simulator<'_, '_> {
    /// Takes what all copies share, and makes room for them; [`take_copy`](Self::take_copy) of each copy comes next.
    pub(super) fn take_scene(&mut self, checked: &Checked<'_>) {
        let words = &checked.words;
        self.scene.count = 0;
        self.scene.per_copy = 0;
        self.given.planes.clear();
        for plane in 0..checked.planes {
            // No more than there is room for.
            let _ = self.given.planes.push(checked.plane(plane));
        }
        if let Some(all) = self.scene.plane_compliance.get_mut() {
            let planes = (0..).map(|plane| match plane < checked.planes {
                true => checked.plane_compliance(plane),
                false => Compliance::RIGID,
            });
            all.iter_mut().zip(planes).for_each(|(place, compliance)| *place = compliance);
        }
        self.given.gravity = checked.gravity();
        self.set_measure(checked.measure);
        self.given.dt_s = checked.dt_s();
        if let Some(time) = checked.time {
            self.set_time(time);
        }
        // Names stay unique in a simulator that goes back.
        self.next_id = self.next_id.max(checked.next_id());
        self.commanded = checked.flags() & COMMANDED != 0;
        self.has_network = checked.flags() & NO_NETWORK == 0;
        self.scene.contact_law = checked.contact_law();
        self.quarantines = OfHealth::new(checked.flags() & QUARANTINES != 0);
        let (mut start, mut hull_start, mut at) = (0, 0, checked.start_of_points());
        let points = checked.points();
        for (number, unit) in checked.records().enumerate() {
            let slot = UnitSlot {
                id: UnitId::from_bits(words.long(unit.at)),
                start,
                count: unit.count,
                role: unit.role,
                is_ball: unit.is_ball,
                pieces: unit.pieces,
                #[cfg(feature = "robot")]
                link: above(checked, &unit),
                #[cfg(feature = "deform")]
                is_patch: unit.is_patch,
                #[cfg(feature = "deform")]
                ln_young: words.number(unit.at + 5),
                offset: Point3::from(words.vector(unit.at + 6)),
                hull: unit.hull,
                hull_start,
                inertia_m2: words.vector(unit.at + 9),
                ..UnitSlot::EMPTY
            };
            for copy in 0..checked.copies {
                let own = if self.sizes.is_soft() { copy * points } else { 0 };
                if let Some(place) = self.scene.slots.get_mut(copy * checked.units + number) {
                    *place = UnitSlot { start: start + own, ..slot };
                }
                self.take_points(checked, &unit, (start + own, at));
            }
            start += unit.count;
            hull_start += unit.rows();
            at += unit.point_words();
        }
        let rows = self.scene.hulls.iter_mut().take(hull_start);
        for (number, row) in rows.enumerate() {
            *row = Point3::from(words.vector(at + 3 * number));
        }
        self.scene.per_copy = checked.units;
        self.scene.count = checked.units * checked.copies;
        #[cfg(feature = "deform")]
        {
            self.bonds.clear();
            for bond in 0..checked.bonds {
                // What a copy has of it comes with the copy.
                self.bonds.add(checked.pair(bond), 1, |_| Default::default());
            }
        }
    }

    /// Takes the points of a unit into the rows of a copy.
    fn take_points(
        &mut self,
        checked: &Checked<'_>,
        unit: &super::check::Record,
        (start, at): (usize, usize),
    ) {
        let words = &checked.words;
        #[cfg(feature = "deform")]
        if unit.is_patch {
            for row in 0..unit.count {
                let place = at + row * super::layout::REST;
                self.scene.soft.set_rest(start + row, &words.vector(place), words.count(place + 3));
            }
            return;
        }
        let own = self.scene.points.get_mut(start..start + unit.count).unwrap_or_default();
        for (number, point) in own.iter_mut().enumerate() {
            *point = Point3::from(words.vector(at + 3 * number));
        }
    }

    /// Takes what one copy of a snapshot has for itself, into one of the scene.
    pub(super) fn take_copy(&mut self, checked: &Checked<'_>, from: usize, to: usize) {
        let (words, measure) = (&checked.words, self.scene.measure);
        let slots = self.scene.units_mut().iter_mut().skip(to * checked.units);
        for (number, slot) in slots.take(checked.units).enumerate() {
            let at = checked.copy_unit(from, number);
            slot.set_physics(checked.physics(at), &measure);
            slot.compliance = OfCompliance::new(checked.unit_compliance(at));
            slot.body = words.word(at + 3);
            match words.word(at + 4) {
                0 => slot.set_quarantine(Quarantine::None, checked.unit(number).role),
                _ => slot.set_quarantine(Quarantine::Held, Role::Fixed),
            }
            slot.radius = words.number(at + 5);
            let poses = [&mut slot.first, &mut slot.current, &mut slot.target];
            for (pose, place) in poses.into_iter().zip(0..) {
                *pose = words.pose(at + 6 + place * POSE);
            }
            slot.course = words.course(at + COPY_COURSE);
            #[cfg(feature = "robot")]
            if let Some(above) = &mut slot.link.above {
                above.guide.target = checked.target(at);
            }
            // Clusters are found anew.
            #[cfg(feature = "deform")]
            (slot.member = crate::structure::member::Member::ALONE);
            #[cfg(rigidformer_host)]
            (slot.still = 0);
        }
        let size = self.sizes.command;
        let command = slice_at_mut(self.lasting.command_inputs, to * size, size);
        for (number, slot) in command.iter_mut().enumerate() {
            *slot = words.number(checked.copy_command(from) + number);
        }
        self.commands_stale |= size > 0 && self.commanded;
        #[cfg(feature = "deform")]
        {
            self.take_bonds(checked, (from, to));
            self.take_soft(checked, (from, to));
        }
    }

    #[cfg(feature = "deform")]
    fn take_bonds(&mut self, checked: &Checked<'_>, (from, to): (usize, usize)) {
        use crate::structure::bonds::{Kept, Seam};
        let words = &checked.words;
        for bond in 0..checked.bonds {
            let at = checked.copy_bond(from, bond);
            let [spread_m2, touches] = [at + 1, at + 2].map(|at| words.number(at));
            let middle = [at + 3, at + 4, at + 5].map(|at| words.number(at));
            let seam = Seam { spread_m2, touches, middle };
            let (pair, holds) = (checked.pair(bond), words.word(at) == 1);
            self.bonds.set(to, bond, &Kept { pair, holds, breaks: false, seam });
        }
    }

    #[cfg(feature = "deform")]
    fn take_soft(&mut self, checked: &Checked<'_>, (from, to): (usize, usize)) {
        let (words, mut at) = (&checked.words, checked.copy_soft(from));
        let first = to * checked.units;
        for number in first..first + checked.units {
            let unit = self.scene.units().get(number).copied().filter(UnitSlot::is_soft);
            let Some(unit) = unit else { continue };
            for row in unit.start..unit.start + unit.count {
                let (way, current) = (words.vector(at), words.vector(at + 3));
                self.scene.soft.set_state(row, &way, &current);
                if let Some(point) = self.scene.points.get_mut(row) {
                    *point = Point3::from(current - unit.current.centre);
                }
                at += super::layout::SOFT;
            }
        }
    }

    /// Finds all that follows from the state, once all copies are there.
    pub(super) fn derive(&mut self) {
        // Copies share what is rigid; of scenes with soft units each has all for itself.
        let units = if self.sizes.is_soft() { self.scene.count } else { self.scene.per_copy };
        for number in 0..units {
            let unit = self.scene.units().get(number).copied().filter(|unit| !unit.is_soft());
            if let Some(unit) = unit {
                self.weigh(&unit);
            }
        }
        self.index_from(0);
        for copy in 0..self.scene.copies() {
            self.derive_copy(copy);
        }
    }

    /// Finds what follows from the state of one copy.
    pub(super) fn derive_copy(&mut self, copy: usize) {
        let _ = copy;
        #[cfg(feature = "deform")]
        {
            let Self { scene, bonds, model, sizes, .. } = self;
            let units = scene.per_copy.max(1);
            let own = scene.units_mut().chunks_exact_mut(units).nth(copy).unwrap_or_default();
            crate::structure::bonds::group(own, bonds.of(copy));
            if sizes.is_soft() {
                crate::structure::soft::bind(scene, &model.config().elastic, copy);
                self.weigh_soft(copy);
            }
        }
    }
}

/// What a unit hangs from.
#[cfg(feature = "robot")]
fn above(checked: &Checked<'_>, unit: &super::check::Record) -> crate::structure::link::Link {
    use crate::structure::link::{Above, Guide, Link};
    let Some(parent) = unit.parent.checked_sub(1) else { return Link::NONE };
    let parent = checked.words.long(checked.unit(parent).at);
    let [pivot, parent_pivot] = [13, 16].map(|at| Point3::from(checked.words.vector(unit.at + at)));
    // Checked to be sound.
    let guide = checked.guide(unit.at).unwrap_or(Guide::BALL);
    Link { above: Some(Above { parent, pivot, parent_pivot, guide }), ..Link::NONE }
}
