//! Sharing a step's work out to threads: who does which units, in which rows of the workspace.

use crate::kernels::{Divisible, Schedule};
use crate::sizes::Sizes;
use crate::trace::{NoTrace, Trace};
use crate::workspace::{RowLengths, Rows};

/// Work on parts that do not depend on each other.
pub(crate) trait Work<P>: Sync {
    /// What comes of a part.
    type Out: Send;

    /// Does a part.
    fn run<S: Schedule, T: Trace>(&self, schedule: S, part: P, trace: &mut T) -> Self::Out;

    /// What comes of two parts together.
    fn merge(a: Self::Out, b: Self::Out) -> Self::Out;
}

/// Does all of it here, or, where `may_share` and the schedule say so and nobody traces, in parts on several threads;
/// `cost` is about how many multiplications it takes.
pub(crate) fn share_out<S: Schedule, T: Trace, P: Divisible, W: Work<P>>(
    schedule: S,
    trace: &mut T,
    (may_share, cost): (bool, usize),
    work: &W,
    whole: P,
) -> W::Out {
    // Threads would record layers in no fixed order.
    if may_share && schedule.shares() && !trace.records() {
        let run = |schedule: S, part: P| work.run(schedule, part, &mut NoTrace);
        schedule.share(cost, whole, &run, &W::merge)
    } else {
        work.run(schedule, whole, trace)
    }
}

/// Units that are worked on together.
#[derive(Clone, Copy)]
pub(crate) struct Units {
    /// Number of the first.
    pub(crate) first: usize,
    pub(crate) count: usize,
    /// How much the rows have room for at a time: points in the encoder, units at the anchors.
    pub(crate) tile: usize,
}

impl Units {
    /// A part of `left` shares of `of`, and the rest; without units where there is no room for one.
    fn split(self, left: usize, of: usize) -> [Units; 2] {
        let Units { first, count, tile } = self;
        let room = tile * left / of;
        let units = if room == 0 { 0 } else { count * left / of };
        let rest = Units { first: first + units, count: count - units, tile: tile - room };
        [Units { first, count: units, tile: room }, rest]
    }
}

/// Units, and their rows of the workspace.
pub(crate) struct UnitRange<'p> {
    pub(crate) units: Units,
    pub(crate) sizes: &'p Sizes,
    pub(crate) w: Rows<'p>,
    /// What of the buffers belongs to units; scores and scratch aside.
    pub(crate) cut: fn(&Sizes, Units) -> RowLengths,
}

impl Divisible for UnitRange<'_> {
    fn split(self, left: usize, of: usize) -> [Self; 2] {
        let UnitRange { units, sizes, w, cut } = self;
        let [units, others] = units.split(left, of);
        let scores = w.scores.len() / of * left;
        let [w, rest] = w.split(&RowLengths { scores, scratch: (left, of), ..cut(sizes, units) });
        [UnitRange { units, sizes, w, cut }, UnitRange { units: others, sizes, w: rest, cut }]
    }
}
