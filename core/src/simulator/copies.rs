//! Copies of a scene that advance in lockstep: weights are read once for all of them.

use super::state::Simulator;
use crate::layers::{copy, part_mut, rows_mut};
use crate::scene::UnitSlot;

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
        let (first, others) = self.scene.slots.split_at_mut(per_copy.min(self.scene.slots.len()));
        for other in others.chunks_exact_mut(per_copy.max(1)).take(copies - 1) {
            for (slot, unit) in other.iter_mut().zip(first.iter()) {
                *slot = *unit;
            }
        }
        #[cfg(feature = "soft")]
        if self.sizes.is_soft() {
            let (scene, weights) = (&mut self.scene, &mut *self.lasting.avp_weights);
            (1..copies).for_each(|copy| crate::soft::replicate(scene, weights, 0, copy));
        }
        #[cfg(feature = "bonds")]
        (1..copies).for_each(|copy| self.bonds.copy(0, copy));
        let commands = &mut *self.lasting.command_inputs;
        let (first, others) = commands.split_at_mut(size.min(commands.len()));
        for other in rows_mut(others, size) {
            copy(first, other);
        }
        self.commands_stale |= size > 0 && self.commanded;
        self.scene.count = per_copy * copies;
        self.scene.copies()
    }

    /// Copies that the limits have room for, at least 1.
    fn most_copies(&self) -> usize {
        #[cfg(feature = "soft")]
        if self.sizes.is_soft() {
            let counted = crate::soft_points::MAX_ROWS / self.scene.points_per_copy().max(1);
            return self.sizes.copies.min(counted).max(1);
        }
        self.sizes.copies
    }

    /// Drops the copies for which `keep`, called in ascending order, is false; those that stay
    /// move up.
    pub fn retain_copies(&mut self, mut keep: impl FnMut(usize) -> bool) {
        let (per_copy, size) = (self.scene.per_copy, self.sizes.command);
        let mut kept = 0;
        for from in 0..self.scene.copies() {
            if !keep(from) {
                continue;
            }
            if kept < from {
                // First: it reads where the first copy's points are.
                #[cfg(feature = "soft")]
                if self.sizes.is_soft() {
                    let weights = &mut *self.lasting.avp_weights;
                    crate::soft::replicate(&mut self.scene, weights, from, kept);
                }
                let (to, rest) = self.scene.slots.split_at_mut(from * per_copy);
                let to = to.get_mut(kept * per_copy..).unwrap_or_default();
                for (to, from) in to.iter_mut().zip(rest.iter()).take(per_copy) {
                    let start = if self.sizes.is_soft() { to.start } else { from.start };
                    *to = UnitSlot { start, ..*from };
                }
                #[cfg(feature = "bonds")]
                self.bonds.copy(from, kept);
                let (to, rest) = self.lasting.command_inputs.split_at_mut(from * size);
                copy(rest, part_mut(to, kept * size, size));
                self.commands_stale |= size > 0;
            }
            kept += 1;
        }
        self.scene.count = kept * per_copy;
        if kept == 0 {
            self.scene.per_copy = 0;
            #[cfg(feature = "bonds")]
            self.bonds.clear();
        }
    }
}
