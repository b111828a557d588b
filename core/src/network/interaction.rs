//! Unit interaction: blocks over unit tokens and registers (docs/MODEL.md, section 4).

use crate::kernels::{Attention, Divisible, Kernels, Schedule};
use crate::limits::ANCHORS;
use crate::model::{Block, Cross, Model};
use crate::network::layers::attention::{norm_and_rotate, put_rows, turns};
use crate::network::layers::{add, modulate, rms_norm, swiglu};
use crate::network::present::Present;
use crate::network::{Buffers, View};
use crate::scene::Scene;
use crate::share::{Work, share_out};
use crate::sizes::Sizes;
use crate::slices::{rows_mut, slice_at, slice_at_mut};
use crate::structure::heading;
use crate::trace::{Layer, Trace};
use crate::workspace::{Lasting, RowLengths, Rows, command_places};

/// Runs all blocks on `tokens`, and leaves the units' keys and values of every scale in
/// `keys_values` (scales, units, 2 inner).
#[inline(never)]
pub(crate) fn interact<S: Schedule, T: Trace>(
    schedule: S,
    model: &Model<'_>,
    sizes: &Sizes,
    view: View<'_>,
    buffers: Buffers<'_, '_>,
    trace: &mut T,
) {
    let (View { scene, present }, Buffers { lasting, rows: w }) = (view, buffers);
    let shape = Shape { present, registers: sizes.registers, per_copy: scene.per_copy };
    for context in 0..present.contexts() {
        let (start, units) = shape.tokens_of(context);
        let count = (units + sizes.registers) * sizes.width;
        let tokens = slice_at_mut(w.tokens, start * sizes.width, count);
        put_rows(model.registers, units * sizes.width, tokens);
    }
    let Lasting { films, commands, keys_values, .. } = lasting;
    let fixed = Fixed { model, sizes, shape, films, commands };
    let count = present.token_start(present.contexts(), sizes.registers);
    let scale = present.rows() * 2 * sizes.inner;
    for level in 0..=model.blocks.len() {
        // Level 0 is what the encoder left: its keys and values come before any block.
        if level > 0 {
            attend(schedule, &fixed, w);
        }
        let place = model.config().scales.position(level).unwrap_or_default();
        let keys_values = slice_at_mut(keys_values, place * sizes.units * 2 * sizes.inner, scale);
        let tokens = Tokens { first: 0, count };
        let whole = TokenPart { tokens, shape, sizes, keys_values, w: w.reborrow() };
        let work = (sizes.is_small(), count * sizes.token_work());
        share_out(schedule, trace, work, &Between { fixed: &fixed, scene, level }, whole);
        record(trace, sizes, shape, level, w);
    }
}

/// What all rows read.
struct Fixed<'a> {
    model: &'a Model<'a>,
    sizes: &'a Sizes,
    shape: Shape<'a>,
    films: &'a [f32],
    commands: &'a [f32],
}

/// Rows of tokens, units and registers of copy after copy.
#[derive(Clone, Copy)]
struct Tokens {
    /// Number of the first.
    first: usize,
    count: usize,
}

/// Rows of tokens, and their rows of the workspace.
struct TokenPart<'p> {
    tokens: Tokens,
    shape: Shape<'p>,
    sizes: &'p Sizes,
    /// Those of a scale.
    keys_values: &'p mut [f32],
    w: Rows<'p>,
}

impl Divisible for TokenPart<'_> {
    fn split(self, left: usize, of: usize) -> [Self; 2] {
        let TokenPart { tokens: Tokens { first, count }, shape, sizes: s, keys_values, w } = self;
        let rows = count * left / of;
        let units = shape.units_before(first + rows) - shape.units_before(first);
        let (keys_values, more) =
            keys_values.split_at_mut((units * 2 * s.inner).min(keys_values.len()));
        let [w, others] = w.split(&RowLengths {
            tokens: rows * s.width,
            normed: rows * s.width,
            qkvg: rows * 4 * s.inner,
            attended: rows * s.inner,
            gate_up: rows * 2 * s.feed_forward,
            gated: rows * s.feed_forward,
            unit_turns: units * 2 * s.angles,
            scratch: (left, of),
            ..RowLengths::default()
        });
        let rest = Tokens { first: first + rows, count: count - rows };
        let tokens = Tokens { first, count: rows };
        [
            TokenPart { tokens, shape, sizes: s, keys_values, w },
            TokenPart { tokens: rest, shape, sizes: s, keys_values: more, w: others },
        ]
    }
}

/// Rows in use.
#[derive(Clone, Copy)]
struct Shape<'a> {
    present: Present<'a>,
    /// Of each context.
    registers: usize,
    /// Units of a copy of the scene.
    per_copy: usize,
}

impl Shape<'_> {
    /// The row of tokens in which a context begins, and its units.
    fn tokens_of(&self, context: usize) -> (usize, usize) {
        let rows = self.present.rows_of(context);
        (self.present.token_start(context, self.registers), rows.len())
    }

    /// The row of units of a row of tokens; none of a register.
    fn unit(&self, token: usize) -> Option<usize> {
        let (context, place) = self.present.locate(token, self.registers);
        let rows = self.present.rows_of(context);
        (place < rows.len()).then_some(rows.start + place)
    }

    /// Units among the rows of tokens before one.
    fn units_before(&self, token: usize) -> usize {
        let (context, place) = self.present.locate(token, self.registers);
        let rows = self.present.rows_of(context);
        rows.start + place.min(rows.len())
    }

    /// The copy of the scene that a row of tokens is of.
    fn copy_of(&self, token: usize) -> usize {
        let (context, _) = self.present.locate(token, self.registers);
        self.present.unit(self.present.rows_of(context).start) / self.per_copy.max(1)
    }
}

/// Shows the tokens of a scale.
fn record<T: Trace>(trace: &mut T, sizes: &Sizes, shape: Shape<'_>, scale: usize, w: &Rows<'_>) {
    for context in 0..shape.present.contexts() {
        let (start, units) = shape.tokens_of(context);
        let all = slice_at(w.tokens, start * sizes.width, (units + sizes.registers) * sizes.width);
        let (units, registers) = all.split_at(all.len().min(units * sizes.width));
        trace.record(Layer::Tokens, scale, units);
        trace.record(Layer::Registers, scale, registers);
    }
}

/// The work on rows of tokens between the attention of one block and that of the next: the rest of block `level - 1`,
/// the keys and values of scale `level`, and the queries, keys, values and gates of block `level`.
struct Between<'a> {
    fixed: &'a Fixed<'a>,
    scene: &'a Scene<'a>,
    level: usize,
}

impl Work<TokenPart<'_>> for Between<'_> {
    type Out = ();

    fn run<S: Schedule, T: Trace>(&self, schedule: S, part: TokenPart<'_>, trace: &mut T) {
        let Between { fixed, scene, level } = *self;
        let TokenPart { tokens, keys_values, mut w, .. } = part;
        let Fixed { model, sizes, shape, .. } = fixed;
        let before = shape.units_before(tokens.first);
        let units = shape.units_before(tokens.first + tokens.count) - before;
        match level.checked_sub(1).and_then(|block| model.blocks.get(block)) {
            Some(block) => finish(schedule, fixed, block, level, tokens, &mut w, trace),
            None => {
                let config = model.config();
                let own = before..before + units;
                for (row, out) in own.zip(rows_mut(w.unit_turns, 2 * sizes.angles)) {
                    let Some(unit) = scene.units().get(shape.present.unit(row)) else { break };
                    let [a, b, c, d] =
                        scene.anchors_of(unit).map(|anchor| heading::seen(config, unit, &anchor));
                    let mean = ((a + b) + (c + d)) * (1.0 / ANCHORS as f32);
                    turns([mean.x, mean.y, mean.z], model.rope_frequencies, out);
                }
            }
        }
        project_scale(schedule, fixed, level, tokens, (before, units), keys_values, &mut w);
        if let Some(block) = model.blocks.get(level) {
            begin(schedule, fixed, block, tokens, before, &mut w);
        }
    }

    fn merge((): (), (): ()) {}
}

/// Queries, keys, values and gates of rows.
fn begin<S: Schedule>(
    schedule: S,
    fixed: &Fixed<'_>,
    block: &Block<'_>,
    tokens: Tokens,
    units_before: usize,
    w: &mut Rows<'_>,
) {
    let Fixed { sizes, shape, .. } = fixed;
    let kernels = schedule.kernels();
    let Tokens { first, count } = tokens;
    let (width, inner) = (sizes.width, sizes.inner);
    let normed = slice_at_mut(w.normed, 0, count * width);
    rms_norm(kernels, slice_at(w.tokens, 0, count * width), block.norm, normed);
    let qkvg = slice_at_mut(w.qkvg, 0, count * 4 * inner);
    block.qkvg.apply(schedule, normed, qkvg, &mut w.scratch);
    let all_turns = &*w.unit_turns;
    schedule.each_row(qkvg, 4 * inner, 8 * inner, &mut [], |row, values, _| {
        // Registers have no place: no rotation, their norm alone.
        let unit = shape.unit(first + row);
        let turns = if unit.is_some() { 2 * sizes.angles } else { 0 };
        let unit = unit.unwrap_or_default().saturating_sub(units_before);
        let turn = slice_at(all_turns, unit * turns, turns);
        let (query, rest) = values.split_at_mut(inner.min(values.len()));
        norm_and_rotate(kernels, query, block.query_norm, turn);
        norm_and_rotate(kernels, slice_at_mut(rest, 0, inner), block.key_norm, turn);
    });
}

/// Leaves in `attended` what the tokens of each context saw in each other.
fn attend<S: Schedule>(schedule: S, fixed: &Fixed<'_>, w: &mut Rows<'_>) {
    let Fixed { sizes, shape, .. } = *fixed;
    let (kernels, together) = (schedule.kernels(), S::Kernels::QUERIES);
    let inner = sizes.inner;
    let stride = 4 * inner;
    for context in 0..shape.present.contexts() {
        let (start, units) = shape.tokens_of(context);
        let context = units + shape.registers;
        let tokens = slice_at(w.qkvg, start * stride, context * stride);
        let attended = slice_at_mut(w.attended, start * inner, context * inner);
        let cost = 2 * inner * context * together;
        schedule.each_row(attended, together * inner, cost, w.scores, |block, out, scratch| {
            let rows = out.len() / inner.max(1);
            let attention = Attention {
                queries: slice_at(tokens, block * together * stride, rows * stride),
                query_stride: stride,
                gate: 3 * inner,
                tokens,
                stride,
                key: inner,
                value: 2 * inner,
                head_dim: sizes.head_dim,
                inner,
                out_stride: inner,
                out_start: 0,
            };
            kernels.attend(&attention, scratch, out);
        });
    }
}

/// `Z' = Z + out(attended); Z'' = FiLM(Z'); Z = Z'' + SwiGLU(RMSNorm(Z''))`
fn finish<S: Schedule, T: Trace>(
    schedule: S,
    fixed: &Fixed<'_>,
    block: &Block<'_>,
    level: usize,
    rows: Tokens,
    w: &mut Rows<'_>,
    trace: &mut T,
) {
    let Fixed { sizes, shape, films, commands, .. } = fixed;
    let kernels = schedule.kernels();
    let Tokens { first, count } = rows;
    let (width, inner, hidden) = (sizes.width, sizes.inner, sizes.feed_forward);
    let tokens = slice_at_mut(w.tokens, 0, count * width);
    let normed = slice_at_mut(w.normed, 0, count * width);
    block.out.apply(schedule, slice_at(w.attended, 0, count * inner), normed, &mut w.scratch);
    add(tokens, normed);
    trace.record(Layer::Attention, level, tokens);

    modulate(tokens, slice_at(films, level * 2 * width, 2 * width));
    if block.command.is_some() {
        for (row, token) in rows_mut(tokens, width).enumerate() {
            let film = (shape.copy_of(first + row) * command_places(sizes) + level) * 2 * width;
            modulate(token, slice_at(commands, film, 2 * width));
        }
    }

    rms_norm(kernels, tokens, block.feed_forward_norm, normed);
    let at_once = (sizes.fed * width).max(1);
    for normed in normed.chunks_mut(at_once) {
        let count = normed.len() / width.max(1);
        let gate_up = slice_at_mut(w.gate_up, 0, count * 2 * hidden);
        block.gate_up.apply(schedule, normed, gate_up, &mut w.scratch);
        let gated = slice_at_mut(w.gated, 0, count * hidden);
        swiglu(kernels, gate_up, hidden, gated);
        block.down.apply(schedule, gated, normed, &mut w.scratch);
    }
    add(tokens, normed);
}

/// Keys and values for the anchors, where `level` is one of the scales.
fn project_scale<S: Schedule>(
    schedule: S,
    fixed: &Fixed<'_>,
    level: usize,
    tokens: Tokens,
    (before, units): (usize, usize),
    keys_values: &mut [f32],
    w: &mut Rows<'_>,
) {
    let Fixed { model, sizes, shape, .. } = fixed;
    let kernels = schedule.kernels();
    let Some(scale) = model.config().scales.position(level) else { return };
    let Some(cross) = model.anchors.cross.get(scale) else { return };
    let Cross { unit_norm, key_value, key_norm, .. } = cross;
    let (width, stride) = (sizes.width, 2 * sizes.inner);
    let normed = slice_at_mut(w.normed, 0, units * width);
    // The units of each context lie together, registers behind them.
    let (mut unit, end) = (before, before + units);
    while unit < end {
        let context = shape.present.context_of(unit);
        let rows = shape.present.rows_of(context);
        let (start, _) = shape.tokens_of(context);
        let count = rows.end.min(end) - unit;
        let row = (start + (unit - rows.start)).saturating_sub(tokens.first);
        let from = slice_at(w.tokens, row * width, count * width);
        let to = slice_at_mut(normed, (unit - before) * width, count * width);
        rms_norm(kernels, from, unit_norm, to);
        unit += count;
    }
    let out = slice_at_mut(keys_values, 0, units * stride);
    key_value.apply(schedule, normed, out, &mut w.scratch);
    let turns = &*w.unit_turns;
    schedule.each_row(out, stride, 4 * sizes.inner, &mut [], |row, values, _| {
        let turn = slice_at(turns, row * 2 * sizes.angles, 2 * sizes.angles);
        norm_and_rotate(kernels, slice_at_mut(values, 0, sizes.inner), key_norm, turn);
    });
}
