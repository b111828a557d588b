//! Copies of a scene that advance in lockstep: weights are read once for all of them.

use super::state::Simulator;
use crate::scene::UnitSlot;
use crate::slices::{copy_slice, rows_mut, slice_at, slice_at_mut};

impl Simulator<'_, '_> {
    /// Copies of the scene: 1 once it has units, 0 before.
    pub fn copies(&self) -> usize {
        self.scene.copies()
    }

    /// Makes the first copy of the scene, as it is now, with its command, into so many; the others are dropped. The
    /// number of copies that there are now: less than `copies` where the limits have no room or, of models that move soft bodies, beyond 2^24
    /// points of all copies; 0 before an observation. Each copy's result is that of the scene alone, bit for bit.
    pub fn replicate(&mut self, copies: usize) -> usize {
        let (per_copy, size) = (self.scene.per_copy, self.sizes.command);
        let copies = copies.clamp(1, self.most_copies());
        let own = self.own_points();
        let (first, others) = self.scene.slots.split_at_mut(per_copy.min(self.scene.slots.len()));
        let others = others.chunks_exact_mut(per_copy.max(1)).take(copies - 1);
        for (number, other) in (1..).zip(others) {
            for (slot, unit) in other.iter_mut().zip(first.iter()) {
                *slot = UnitSlot { start: unit.start + number * own, ..*unit };
            }
        }
        for number in 1..copies {
            self.copy_state(own, 0, number);
        }
        let commands = &mut *self.lasting.command_inputs;
        let (first, others) = commands.split_at_mut(size.min(commands.len()));
        for other in rows_mut(others, size) {
            copy_slice(first, other);
        }
        self.commands_stale |= size > 0 && self.commanded;
        self.scene.count = per_copy * copies;
        self.scene.copies()
    }

    /// Points that each copy has for itself: those of all units where they may deform, else none.
    fn own_points(&self) -> usize {
        if self.sizes.is_soft() { self.scene.points_per_copy() } else { 0 }
    }

    /// Makes of a copy what another one is, but for its units and its command.
    fn copy_state(&mut self, own: usize, from: usize, to: usize) {
        let _ = (own, from, to);
        #[cfg(feature = "deform")]
        if self.sizes.is_soft() {
            crate::structure::soft::replicate(
                &mut self.scene,
                self.lasting.avp_weights,
                own,
                (from, to),
            );
        }
        #[cfg(feature = "deform")]
        self.bonds.copy(from, to);
    }

    /// Copies that the limits have room for, at least 1.
    fn most_copies(&self) -> usize {
        #[cfg(feature = "deform")]
        if self.sizes.is_soft() {
            let counted =
                crate::structure::soft_points::MAX_ROWS / self.scene.points_per_copy().max(1);
            return self.sizes.copies.min(counted).max(1);
        }
        self.sizes.copies
    }

    /// Drops the copies for which `keep`, called in ascending order, is false; those that stay
    /// move up.
    pub fn retain_copies(&mut self, mut keep: impl FnMut(usize) -> bool) {
        let (per_copy, size) = (self.scene.per_copy, self.sizes.command);
        let own = self.own_points();
        let mut kept = 0;
        for from in 0..self.scene.copies() {
            if !keep(from) {
                continue;
            }
            if kept < from {
                let (to, rest) = self.scene.slots.split_at_mut(from * per_copy);
                let to = to.get_mut(kept * per_copy..).unwrap_or_default();
                for (to, unit) in to.iter_mut().zip(rest.iter()).take(per_copy) {
                    *to = UnitSlot { start: unit.start - (from - kept) * own, ..*unit };
                }
                self.copy_state(own, from, kept);
                let (to, rest) = self.lasting.command_inputs.split_at_mut(from * size);
                copy_slice(slice_at(rest, 0, size), slice_at_mut(to, kept * size, size));
                self.commands_stale |= size > 0;
            }
            kept += 1;
        }
        self.scene.count = kept * per_copy;
        if kept == 0 {
            self.scene.per_copy = 0;
            #[cfg(feature = "deform")]
            self.bonds.clear();
        }
    }
}
