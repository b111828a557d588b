//! Every buffer, named and carved once from the caller's slab. There is room for all units; rows are those that the network sees in a step (`present`).

use crate::geometry::{POSE, STATE};
use crate::limits::ANCHORS;
use crate::quant::Scratch;
use crate::sizes::Sizes;

/// Numbers of where a step began for a unit: its state and its target.
pub(crate) const START: usize = STATE + POSE;

macro_rules! buffers {
    (
        |$s:ident|
        $( #[$lasting_doc:meta] )* struct $Lasting:ident { $( $(#[$a_doc:meta])* $a:ident = [$($a_factor:expr),+ $(,)?]; )+ }
        $( #[$rows_doc:meta] )* struct $Rows:ident { $( $(#[$b_doc:meta])* $b:ident = [$($b_factor:expr),+ $(,)?]; )+ }
    ) => {
        $( #[$lasting_doc] )*
        pub(crate) struct $Lasting<'s> {
            $( $(#[$a_doc])* pub(crate) $a: &'s mut [f32], )+
        }

        $( #[$rows_doc] )*
        pub(crate) struct $Rows<'s> {
            $( $(#[$b_doc])* pub(crate) $b: &'s mut [f32], )+
            /// Rows on their way into a quantised layer.
            pub(crate) scratch: Scratch<'s>,
        }

        /// Lengths of the buffers, in order; the last is that of the scratch's scales.
        #[cfg_attr(rigidformer_dsp, inline(never))]
        const fn lengths($s: &Sizes) -> [usize; BUFFERS] {
            [
                $( padded($s, &[$($a_factor),+]), )+
                $( padded($s, &[$($b_factor),+]), )+
                $s.tiles.rows,
            ]
        }

        const BUFFERS: usize = [$(stringify!($a),)+ $(stringify!($b),)+ "scales"].len();

        /// Numbers of each buffer that go to the left of two parts.
        #[derive(Clone, Copy, Default)]
        pub(crate) struct RowLengths {
            $( pub(crate) $b: usize, )+
            /// Shares of the scratch, of how many.
            pub(crate) scratch: (usize, usize),
        }

        impl<'s> $Rows<'s> {
            /// Borrows every buffer for a shorter lifetime.
            pub(crate) fn reborrow(&mut self) -> $Rows<'_> {
                let scratch = Scratch { values: self.scratch.values, scales: self.scratch.scales };
                $Rows { $($b: self.$b,)+ scratch }
            }

            /// Two parts that can be worked in at the same time; the right one gets all that `cut` leaves out.
            pub(crate) fn split(self, cut: &RowLengths) -> [$Rows<'s>; 2] {
                $( let $b = self.$b.split_at_mut(cut.$b.min(self.$b.len())); )+
                let [scratch, more] = self.scratch.split(cut.scratch);
                [$Rows { $($b: $b.0,)+ scratch }, $Rows { $($b: $b.1,)+ scratch: more }]
            }
        }

        /// Carves the buffers off the front of `slab`, which holds at least [`total`].
        pub(crate) fn carve<'s>(
            s: &Sizes,
            slab: &'s mut [f32],
            values: &'s mut [i8],
        ) -> ($Lasting<'s>, $Rows<'s>) {
            let [$($a,)+ $($b,)+ scales] = lengths(s);
            let mut rest = slab;
            $( let $a = take(&mut rest, $a); )+
            $( let $b = take(&mut rest, $b); )+
            let scales = take(&mut rest, scales);
            ($Lasting { $($a,)+ }, $Rows { $($b,)+ scratch: Scratch { values, scales } })
        }
    };
}

/// Bonds that the network of bonds judges at a time: weights are read once for all of them.
pub(crate) const BOND_TILE: usize = 8;
/// Numbers in a cache line: wide registers are slower across two.
const LINE: usize = 16;

/// Length of all buffers together, f32 numbers.
pub(crate) const fn total(s: &Sizes) -> usize {
    let lengths = lengths(s);
    let (mut rest, mut sum) = (lengths.as_slice(), 0_usize);
    while let [length, others @ ..] = rest {
        sum = sum.saturating_add(*length);
        rest = others;
    }
    sum
}

/// A buffer's length: whole cache lines where many queries attend together, in wide registers.
#[cfg_attr(rigidformer_dsp, inline(never))]
const fn padded(s: &Sizes, mut factors: &[usize]) -> usize {
    let mut length = 1_usize;
    while let [factor, others @ ..] = factors {
        length = length.saturating_mul(*factor);
        factors = others;
    }
    if s.layout.queries > 1 { length.div_ceil(LINE).saturating_mul(LINE) } else { length }
}

#[cfg_attr(rigidformer_dsp, inline(never))]
fn take<'s>(rest: &mut &'s mut [f32], length: usize) -> &'s mut [f32] {
    let slab = core::mem::take(rest);
    let length = length.min(slab.len());
    let (head, tail) = slab.split_at_mut(length);
    *rest = tail;
    head
}

/// Modulated places: the encoder output, every block, the anchors.
const fn film_places(s: &Sizes) -> usize {
    s.blocks.saturating_add(2)
}

/// Places that a command modulates: the encoder output and every block; none for models without commands.
pub(crate) const fn command_places(s: &Sizes) -> usize {
    if s.command == 0 { 0 } else { s.blocks.saturating_add(1) }
}

/// Numbers of the index of the points.
const fn index_numbers(s: &Sizes) -> usize {
    if cfg!(rigidformer_host) && s.layout.index { s.room().numbers() } else { 0 }
}

buffers! { |s|
    /// Buffers that all parts of a step read, or that last from step to step, each row-major.
    struct Lasting {
        /// (points) scratch of the farthest-point ordering; behind it the index, for kernels with one.
        distance = [s.points.saturating_add(index_numbers(s))];
        /// (points, anchors) weights of anchor-vertex pooling, constant while units are rigid.
        avp_weights = [s.point_rows(), ANCHORS];
        /// (films, 2 width) gains and biases of the step code.
        films = [film_places(s), 2, s.width];
        /// (copies, commands, 2 width) gains and biases of the commands.
        commands = [s.copies, command_places(s), 2, s.width];
        /// (copies, command) the commands themselves.
        command_inputs = [s.copies, s.command];
        /// (scales, units of all copies, 2 inner) keys and values of the units at each scale.
        keys_values = [s.scales, s.units, 2, s.inner];
        /// (units, [`STATE`]) where the step under way takes units.
        next = [s.units, STATE];
        /// (copies, units of a copy): motion by impulses, then what that was worked out in; behind all, room for bonds.
        solved = [s.units, s.solved];
        /// (units, [`STATE`] and target) of a step in substeps, where it began.
        start = [s.substepped, s.units, START];
        /// State and scratch of soft bodies.
        soft = [s.soft];
        /// (copies, 3) of a step in substeps: active and degenerate units so far, one more than the unit that failed or 0.
        outcomes = [s.substepped, s.copies, 3];
    }
    /// Activations, each row-major: of threads that share a step each has rows of its own.
    struct Rows {
        /// (film) hidden layer of a modulation.
        film_hidden = [s.film];
        /// (point tile, features) inputs of a tile of points, later of impacts.
        tile_features = [s.tiles.points, s.row_features];
        /// (point tile, hidden) first hidden layer of the point network.
        tile_hidden = [s.tiles.points, s.row_hidden];
        /// (point tile, hidden) second hidden layer of the point network, where it has one.
        tile_second = [s.tiles.points, s.point_hidden[1]];
        /// (point tile, point width) last layer of the point network.
        tile_points = [s.tiles.points, s.row_out];
        /// (points, point width) the point network's outputs, for soft ones to read.
        point_channels = [s.kept_points, s.point_width];
        /// (rows, 8 point width) pooled levels: maximum and mean, level by level; then, for models with impacts, maximum
        /// and sum of those.
        pooled = [s.units, s.pools, s.point_width];
        /// (rows, record) their impacts.
        impacts = [s.units, s.impacts];
        /// (rows, anchors, point width) point features pooled about each anchor.
        avp_pooled = [s.units, ANCHORS, s.point_width];
        /// (rows, anchors, features) inputs of the anchors.
        anchor_features = [s.units, ANCHORS, s.features];
        /// (rows, hidden) hidden layer of the fusion.
        fuse_hidden = [s.units, s.fuse_hidden];
        /// (copies, tokens of a copy, width) unit tokens, then registers.
        tokens = [s.tokens, s.width];
        /// (tokens, width) normalised tokens, and block outputs before they are added.
        normed = [s.tokens, s.width];
        /// (tokens, 4 inner) queries, keys, values, gates.
        qkvg = [s.tokens, 4, s.inner];
        /// (tokens, inner) attended values.
        attended = [s.tokens, s.inner];
        /// (workers, what attention needs) scores of queries that attend together.
        scores = [s.tiles.workers, s.scores];
        /// (tokens at a time, 2 feed forward) gate and up projections.
        gate_up = [s.fed, 2, s.feed_forward];
        /// (tokens at a time, feed forward) their product.
        gated = [s.fed, s.feed_forward];
        /// (rows, 2 angles) cosines, then sines, of the units.
        unit_turns = [s.units, 2, s.angles];
        /// (anchor tile, 2 angles) cosines, then sines, of the anchors.
        anchor_turns = [s.tiles.anchor_units, ANCHORS, 2, s.angles];
        /// (anchor tile, avp) hidden layer of the pooled features.
        avp_hidden = [s.tiles.anchor_units, ANCHORS, s.avp];
        /// (anchor tile, avp) the pooled features' projection.
        avp_out = [s.tiles.anchor_units, ANCHORS, s.avp];
        /// (anchor tile, 3 + features + avp, and the pushes of impacts) anchor states.
        anchor_state = [s.tiles.anchor_units, ANCHORS, s.query];
        /// (anchor tile, width) hidden layers of query and head.
        anchor_hidden = [s.tiles.anchor_units, ANCHORS, s.width];
        /// (anchor tile, width) anchor queries, later anchor tokens.
        anchor_tokens = [s.tiles.anchor_units, ANCHORS, s.width];
        /// (anchor tile, width) normalised anchor tokens.
        anchor_normed = [s.tiles.anchor_units, ANCHORS, s.width];
        /// (anchor tile, 2 inner) queries and gates.
        query_gate = [s.tiles.anchor_units, ANCHORS, 2, s.inner];
        /// (anchor tile, scales inner) what the anchors saw at each scale.
        seen = [s.tiles.anchor_units, ANCHORS, s.scales, s.inner];
        /// (bonds at a time, inputs) what the network of bonds sees.
        bond_inputs = [BOND_TILE, s.bonds[0]];
        /// (bonds at a time, hidden) its hidden layer.
        bond_hidden = [BOND_TILE, s.bonds[1]];
        /// (rows, anchors, outputs) the head's output.
        head = [s.units, ANCHORS, s.outputs];
    }
}
