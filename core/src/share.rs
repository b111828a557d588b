//! Units that a thread works on, and its part of the workspace.

use crate::config::Sizes;
use crate::kernels::Divisible;
use crate::workspace::{Cut, Workspace};

/// Units that are worked on together.
#[derive(Clone, Copy)]
pub(crate) struct Units {
    /// Number of the first.
    pub(crate) first: usize,
    pub(crate) count: usize,
    /// How much the workspace has room for at a time: points in the encoder, units at the anchors.
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

/// Units, and a workspace whose rows are theirs.
pub(crate) struct Part<'p> {
    pub(crate) units: Units,
    pub(crate) sizes: &'p Sizes,
    pub(crate) w: Workspace<'p>,
    /// What of the buffers belongs to units; scores and scratch aside.
    pub(crate) cut: fn(&Sizes, Units) -> Cut,
}

impl Divisible for Part<'_> {
    fn split(self, left: usize, of: usize) -> [Self; 2] {
        let Part { units, sizes, w, cut } = self;
        let [units, others] = units.split(left, of);
        let scores = w.scores.len() / of * left;
        let [w, rest] = w.split(&Cut { scores, scratch: (left, of), ..cut(sizes, units) });
        [Part { units, sizes, w, cut }, Part { units: others, sizes, w: rest, cut }]
    }
}
