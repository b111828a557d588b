//! Which units the network sees in a step, and in which rows of its buffers they are (docs/MODEL.md, section 4).
//!
//! Rows have the units in order. Units of one copy lie together: they are a **context**, with the registers behind them. Where the
//! network sees all, each copy is a context and rows are the scene's units.

use crate::contact::prior;
use crate::scene::{Scene, UnitSlot};
use crate::sizes::{NEAR_COUNTS, Sizes};
use crate::slices::slice_at;
use crate::stand_in::OfHost;
use core::ops::Range;

/// Rows of units.
#[derive(Clone, Copy)]
pub(crate) struct Present<'a> {
    contexts: OfHost<usize>,
    /// Units of a copy.
    per_copy: usize,
    some: OfHost<Option<Rows<'a>>>,
}

/// Rows of some of the units.
#[derive(Clone, Copy)]
struct Rows<'a> {
    /// (rows) the index of a row's unit.
    units: &'a [f32],
    /// (rows) points of the rows before one.
    points: &'a [f32],
    /// (contexts) rows up to the end of a context.
    ends: &'a [f32],
    /// Points of all rows.
    total: usize,
}

/// A whole number in the slab, as its bits: an f32 counts to 16 million alone.
fn bits(number: usize) -> f32 {
    f32::from_bits(number as u32)
}

/// Of [`bits`].
fn number(bits: &f32) -> usize {
    bits.to_bits() as usize
}

/// Finds the units that the network sees: those that it corrects, and those that may touch one of them within the step. `solved` is
/// what [`prior::solve`] has written; `out` is as long as [`near_numbers`](crate::sizes::near_numbers) says of those that there is room for.
pub(crate) fn find(sizes: &Sizes, scene: &Scene<'_>, solved: &[f32], out: &mut [f32]) {
    let room = sizes.units;
    let (counts, lists) = out.split_at_mut(NEAR_COUNTS.min(out.len()));
    let (units, lists) = lists.split_at_mut(room.min(lists.len()));
    let (before, ends) = lists.split_at_mut(room.min(lists.len()));
    let is_corrected = |index: usize| prior::share(scene, index, solved) > 0.0;
    let (mut rows, mut points, mut contexts) = (0, 0, 0);
    for copy in 0..scene.copies() {
        let first = copy * scene.per_copy;
        let (_, around) = scene.around(first);
        let start = rows;
        if !(first..first + around.len()).any(is_corrected) {
            continue;
        }
        for (index, unit) in (first..).zip(around) {
            // Its own way is looked at from the unit that is corrected.
            let reaches = |(other, corrected): (usize, &UnitSlot)| {
                is_corrected(other)
                    && scene.room_to_unit((corrected, &scene.travel(corrected)), unit) < 0.0
            };
            if !(is_corrected(index) || scene.others(index, unit).any(reaches)) {
                continue;
            }
            if let (Some(slot), Some(sum)) = (units.get_mut(rows), before.get_mut(rows)) {
                (*slot, *sum) = (bits(index), bits(points));
                (rows, points) = (rows + 1, points + unit.count);
            }
        }
        if rows > start
            && let Some(end) = ends.get_mut(contexts)
        {
            *end = bits(rows);
            contexts += 1;
        }
    }
    counts.iter_mut().zip([rows, points, contexts]).for_each(|(slot, n)| *slot = bits(n));
}

impl<'a> Present<'a> {
    /// All units.
    fn all(scene: &Scene<'_>) -> Self {
        let contexts = OfHost::new(scene.copies());
        Present { contexts, per_copy: scene.per_copy, some: OfHost::new(None) }
    }

    /// Rows of some of the units; none where the network sees all.
    fn some(&self) -> Option<Rows<'a>> {
        self.some.get().copied().flatten()
    }

    /// Those that [`find`] found, where the model's scope is that.
    pub(crate) fn of(sizes: &Sizes, scene: &Scene<'_>, found: Option<&'a [f32]>) -> Self {
        let all = Present::all(scene);
        let Some(found) = found.filter(|_| sizes.near > 0) else { return all };
        let room = sizes.units;
        let [rows, total, contexts] = match slice_at(found, 0, NEAR_COUNTS) {
            [rows, points, contexts] => [rows, points, contexts].map(number),
            _ => [0; 3],
        };
        let some = Rows {
            units: slice_at(found, NEAR_COUNTS, rows),
            points: slice_at(found, NEAR_COUNTS + room, rows),
            ends: slice_at(found, NEAR_COUNTS + 2 * room, contexts),
            total,
        };
        Present { contexts: OfHost::new(contexts), some: OfHost::new(Some(some)), ..all }
    }

    /// Contexts.
    pub(crate) fn contexts(&self) -> usize {
        self.contexts.get().copied().unwrap_or(1)
    }

    /// Whether there is one context, and it has all units: the compiler leaves out what would tell others apart.
    fn is_one(&self) -> bool {
        self.contexts.get().is_none()
    }

    /// Rows of a context.
    pub(crate) fn rows_of(&self, context: usize) -> Range<usize> {
        if let Some(some) = self.some() {
            let end = |context: usize| some.ends.get(context).map_or(self.rows(), number);
            let start = context.checked_sub(1).map_or(0, end);
            return start..if context < self.contexts() { end(context) } else { start };
        }
        if self.is_one() {
            return 0..self.per_copy;
        }
        let start = context * self.per_copy;
        start..start + if context < self.contexts() { self.per_copy } else { 0 }
    }

    /// Rows of all contexts.
    pub(crate) fn rows(&self) -> usize {
        if let Some(some) = self.some() {
            return some.units.len();
        }
        self.contexts() * self.per_copy
    }

    /// The context of a row; behind the last row, the one behind the last.
    pub(crate) fn context_of(&self, row: usize) -> usize {
        if let Some(some) = self.some() {
            return some.ends.partition_point(|end| number(end) <= row);
        }
        match self.contexts() {
            1 if self.is_one() || row < self.per_copy => 0,
            _ => row / self.per_copy.max(1),
        }
    }

    /// The context of a row of tokens, and the place in it, with so many registers behind each context's units.
    pub(crate) fn locate(&self, token: usize, registers: usize) -> (usize, usize) {
        if let Some(some) = self.some() {
            let (mut low, mut high) = (0, some.ends.len());
            // Contexts that end at the token or before it.
            while low < high {
                let middle = (low + high) / 2;
                let ends = self.token_start(middle + 1, registers) <= token;
                (low, high) = if ends { (middle + 1, high) } else { (low, middle) };
            }
            return (low, token - self.token_start(low, registers));
        }
        let context = self.per_copy + registers;
        match self.contexts() {
            1 => (0, token),
            _ => (token / context.max(1), token % context.max(1)),
        }
    }

    /// The row of tokens in which a context begins, with so many registers behind each context's units.
    pub(crate) fn token_start(&self, context: usize, registers: usize) -> usize {
        if self.is_one() {
            return context * (self.per_copy + registers);
        }
        self.rows_of(context).start + context * registers
    }

    /// The index in the scene of a row's unit.
    pub(crate) fn unit(&self, row: usize) -> usize {
        if let Some(some) = self.some() {
            return some.units.get(row).map_or(usize::MAX, number);
        }
        row
    }

    /// The row of a unit by its index; none of one that the network does not see.
    pub(crate) fn row(&self, unit: usize) -> Option<usize> {
        if let Some(some) = self.some() {
            return some.units.binary_search_by_key(&unit, number).ok();
        }
        Some(unit)
    }

    /// Points of the rows before one, where rows are some of the units.
    pub(crate) fn points_before(&self, row: usize) -> Option<usize> {
        if let Some(some) = self.some() {
            return Some(some.points.get(row).map_or(some.total, number));
        }
        let _ = row;
        None
    }

    /// The row that a point is of, by its number among those of all rows, where rows are some of the units.
    pub(crate) fn row_of_point(&self, point: usize) -> Option<usize> {
        if let Some(some) = self.some() {
            let after = some.points.partition_point(|points| number(points) <= point);
            return after.checked_sub(1);
        }
        let _ = point;
        None
    }
}
