//! Unit interaction: blocks over unit tokens and registers (docs/MODEL.md, section 4).

use crate::config::{ANCHORS, Sizes};
use crate::kernels::attention::Attention;
use crate::kernels::{Divisible, Kernels};
use crate::layers::attention::{norm_and_rotate, place, turns};
use crate::layers::{add, modulate, part, part_mut, rms_norm, rows, rows_mut, swiglu};
use crate::model::{Block, Cross, Model};
use crate::scene::Scene;
use crate::trace::{Layer, NoTrace, Trace};
use crate::workspace::{Cut, Workspace, command_places};

/// Runs all blocks on `tokens`, and leaves the units' keys and values of every scale in
/// `keys_values` (scales, units, 2 inner).
pub(crate) fn interact<K: Kernels, T: Trace, const UNITS: usize>(
    kernels: K,
    model: &Model<'_>,
    sizes: &Sizes,
    scene: &Scene<'_, UNITS>,
    w: &mut Workspace<'_>,
    trace: &mut T,
) {
    let shape = Shape::of(scene, sizes);
    for tokens in rows_mut(w.tokens, shape.context * sizes.width).take(scene.copies()) {
        place(model.registers, scene.per_copy * sizes.width, tokens);
    }
    // Read by all rows, or written by none at the same time.
    let (films, commands) = (core::mem::take(&mut w.films), core::mem::take(&mut w.commands));
    let keys_values = core::mem::take(&mut w.keys_values);
    let fixed = Fixed { model, sizes, shape, films, commands };
    let count = shape.copies * shape.context;
    let scale = shape.copies * shape.units * 2 * sizes.inner;
    for level in 0..=model.blocks.len() {
        if level > 0 {
            attend(kernels, &fixed, w);
        }
        let place = model.config().scales.position(level).unwrap_or_default();
        let keys_values = part_mut(keys_values, place * sizes.units * 2 * sizes.inner, scale);
        let tokens = Tokens { first: 0, count };
        if kernels.shares() && !trace.records() && sizes.is_small() {
            let whole = Part { tokens, shape, sizes, keys_values, w: w.reborrow() };
            let run = |kernels: K, mut p: Part<'_>| {
                let (tokens, w) = (p.tokens, &mut p.w);
                between(kernels, &fixed, scene, level, tokens, p.keys_values, w, &mut NoTrace);
            };
            kernels.share(count * sizes.token_work(), whole, &run, &|(), ()| ());
        } else {
            between(kernels, &fixed, scene, level, tokens, keys_values, w, trace);
        }
        record(trace, sizes, shape, level, w);
    }
    (w.films, w.commands, w.keys_values) = (films, commands, keys_values);
}

/// What all rows read.
struct Fixed<'a> {
    model: &'a Model<'a>,
    sizes: &'a Sizes,
    shape: Shape,
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

/// Rows of tokens, and a workspace whose rows are theirs.
struct Part<'p> {
    tokens: Tokens,
    shape: Shape,
    sizes: &'p Sizes,
    /// Those of a scale.
    keys_values: &'p mut [f32],
    w: Workspace<'p>,
}

impl Divisible for Part<'_> {
    fn split(self, left: usize, of: usize) -> [Self; 2] {
        let Part { tokens: Tokens { first, count }, shape, sizes: s, keys_values, w } = self;
        let rows = count * left / of;
        let units = shape.units_before(first + rows) - shape.units_before(first);
        let (keys_values, more) =
            keys_values.split_at_mut((units * 2 * s.inner).min(keys_values.len()));
        let [w, others] = w.split(&Cut {
            tokens: rows * s.width,
            normed: rows * s.width,
            qkvg: rows * 4 * s.inner,
            attended: rows * s.inner,
            gate_up: rows * 2 * s.feed_forward,
            gated: rows * s.feed_forward,
            unit_turns: units * 2 * s.angles,
            scratch: (left, of),
            ..Cut::default()
        });
        let rest = Tokens { first: first + rows, count: count - rows };
        let tokens = Tokens { first, count: rows };
        [
            Part { tokens, shape, sizes: s, keys_values, w },
            Part { tokens: rest, shape, sizes: s, keys_values: more, w: others },
        ]
    }
}

/// Rows in use.
#[derive(Clone, Copy)]
struct Shape {
    copies: usize,
    /// Units of a copy.
    units: usize,
    /// Units and registers of a copy.
    context: usize,
}

impl Shape {
    fn of<const UNITS: usize>(scene: &Scene<'_, UNITS>, sizes: &Sizes) -> Self {
        let units = scene.per_copy;
        Shape { copies: scene.copies(), units, context: units + sizes.registers }
    }

    /// The copy and the place in it of a row of tokens.
    fn locate(&self, row: usize) -> (usize, usize) {
        match self.copies {
            1 => (0, row),
            _ => (row / self.context.max(1), row % self.context.max(1)),
        }
    }

    /// Units among the rows before one.
    fn units_before(&self, row: usize) -> usize {
        let (copy, token) = self.locate(row);
        copy * self.units + token.min(self.units)
    }
}

/// Shows the tokens of a scale.
fn record<T: Trace>(trace: &mut T, sizes: &Sizes, shape: Shape, scale: usize, w: &Workspace<'_>) {
    for all in rows(w.tokens, shape.context * sizes.width).take(shape.copies) {
        let (units, registers) = all.split_at(all.len().min(shape.units * sizes.width));
        trace.record(Layer::Tokens, scale, units);
        trace.record(Layer::Registers, scale, registers);
    }
}

/// What happens to rows of tokens between the attention of one block and that of the next: what
/// follows on the attention of block `level - 1`, the keys and values of scale `level`, and the queries,
/// keys, values and gates of block `level`.
#[allow(clippy::too_many_arguments)]
fn between<K: Kernels, T: Trace, const UNITS: usize>(
    kernels: K,
    fixed: &Fixed<'_>,
    scene: &Scene<'_, UNITS>,
    level: usize,
    tokens: Tokens,
    keys_values: &mut [f32],
    w: &mut Workspace<'_>,
    trace: &mut T,
) {
    let Fixed { model, sizes, shape, .. } = fixed;
    let before = shape.units_before(tokens.first);
    let units = shape.units_before(tokens.first + tokens.count) - before;
    match level.checked_sub(1).and_then(|block| model.blocks.get(block)) {
        Some(block) => finish(kernels, fixed, block, level, tokens, w, trace),
        None => {
            let own = scene.units.iter().skip(before).take(units);
            for (unit, out) in own.zip(rows_mut(w.unit_turns, 2 * sizes.angles)) {
                let [a, b, c, d] = scene.anchors_of(unit).map(|anchor| unit.current.apply(&anchor));
                let mean = ((a + b) + (c + d)) * (1.0 / ANCHORS as f32);
                turns([mean.x, mean.y, mean.z], model.rope_frequencies, out);
            }
        }
    }
    project_scale(kernels, fixed, level, tokens, (before, units), keys_values, w);
    if let Some(block) = model.blocks.get(level) {
        begin(kernels, fixed, block, tokens, before, w);
    }
}

/// Queries, keys, values and gates of rows.
fn begin<K: Kernels>(
    kernels: K,
    fixed: &Fixed<'_>,
    block: &Block<'_>,
    tokens: Tokens,
    units_before: usize,
    w: &mut Workspace<'_>,
) {
    let Fixed { sizes, shape, .. } = fixed;
    let Tokens { first, count } = tokens;
    let (width, inner) = (sizes.width, sizes.inner);
    let normed = part_mut(w.normed, 0, count * width);
    rms_norm(kernels, part(w.tokens, 0, count * width), block.norm, normed);
    let qkvg = part_mut(w.qkvg, 0, count * 4 * inner);
    block.qkvg.apply(kernels, normed, qkvg, &mut w.scratch);
    let all_turns = &*w.unit_turns;
    kernels.each_row(qkvg, 4 * inner, 8 * inner, &mut [], |row, values, _| {
        // Registers have no place: no rotation, their norm alone.
        let (copy, token) = shape.locate(first + row);
        let turns = if token < shape.units { 2 * sizes.angles } else { 0 };
        let unit = (copy * shape.units + token).saturating_sub(units_before);
        let turn = part(all_turns, unit * turns, turns);
        let (query, rest) = values.split_at_mut(inner.min(values.len()));
        norm_and_rotate(kernels, query, block.query_norm, turn);
        norm_and_rotate(kernels, part_mut(rest, 0, inner), block.key_norm, turn);
    });
}

/// Leaves in `attended` what the tokens of each copy saw in each other.
fn attend<K: Kernels>(kernels: K, fixed: &Fixed<'_>, w: &mut Workspace<'_>) {
    let Fixed { sizes, shape: Shape { copies, context, .. }, .. } = *fixed;
    let inner = sizes.inner;
    let stride = 4 * inner;
    for copy in 0..copies {
        let tokens = part(w.qkvg, copy * context * stride, context * stride);
        let attended = part_mut(w.attended, copy * context * inner, context * inner);
        let cost = 2 * inner * context * K::QUERIES;
        kernels.each_row(attended, K::QUERIES * inner, cost, w.scores, |block, out, scratch| {
            let rows = out.len() / inner.max(1);
            let attention = Attention {
                queries: part(tokens, block * K::QUERIES * stride, rows * stride),
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
fn finish<K: Kernels, T: Trace>(
    kernels: K,
    fixed: &Fixed<'_>,
    block: &Block<'_>,
    level: usize,
    rows: Tokens,
    w: &mut Workspace<'_>,
    trace: &mut T,
) {
    let Fixed { sizes, shape, films, commands, .. } = fixed;
    let Tokens { first, count } = rows;
    let (width, inner, hidden) = (sizes.width, sizes.inner, sizes.feed_forward);
    let tokens = part_mut(w.tokens, 0, count * width);
    let normed = part_mut(w.normed, 0, count * width);
    block.out.apply(kernels, part(w.attended, 0, count * inner), normed, &mut w.scratch);
    add(tokens, normed);
    trace.record(Layer::Attention, level, tokens);

    modulate(tokens, part(films, level * 2 * width, 2 * width));
    if block.command.is_some() {
        for (row, token) in rows_mut(tokens, width).enumerate() {
            let (copy, _) = shape.locate(first + row);
            let film = (copy * command_places(sizes) + level) * 2 * width;
            modulate(token, part(commands, film, 2 * width));
        }
    }

    rms_norm(kernels, tokens, block.feed_forward_norm, normed);
    let gate_up = part_mut(w.gate_up, 0, count * 2 * hidden);
    block.gate_up.apply(kernels, normed, gate_up, &mut w.scratch);
    let gated = part_mut(w.gated, 0, count * hidden);
    swiglu(kernels, gate_up, hidden, gated);
    block.down.apply(kernels, gated, normed, &mut w.scratch);
    add(tokens, normed);
}

/// Keys and values for the anchors, where `level` is one of the scales.
fn project_scale<K: Kernels>(
    kernels: K,
    fixed: &Fixed<'_>,
    level: usize,
    tokens: Tokens,
    (before, units): (usize, usize),
    keys_values: &mut [f32],
    w: &mut Workspace<'_>,
) {
    let Fixed { model, sizes, shape, .. } = fixed;
    let Some(scale) = model.config().scales.position(level) else { return };
    let Some(cross) = model.anchors.cross.get(scale) else { return };
    let Cross { unit_norm, key_value, key_norm, .. } = cross;
    let (width, stride) = (sizes.width, 2 * sizes.inner);
    let normed = part_mut(w.normed, 0, units * width);
    // The units of each copy lie together, registers behind them.
    let (mut unit, end) = (before, before + units);
    while unit < end {
        let (copy, place) = match shape.copies {
            1 => (0, unit),
            _ => (unit / shape.units.max(1), unit % shape.units.max(1)),
        };
        let count = (shape.units - place).min(end - unit);
        let row = (copy * shape.context + place).saturating_sub(tokens.first);
        let from = part(w.tokens, row * width, count * width);
        let to = part_mut(normed, (unit - before) * width, count * width);
        rms_norm(kernels, from, unit_norm, to);
        unit += count;
    }
    let out = part_mut(keys_values, 0, units * stride);
    key_value.apply(kernels, normed, out, &mut w.scratch);
    let turns = &*w.unit_turns;
    kernels.each_row(out, stride, 4 * sizes.inner, &mut [], |row, values, _| {
        let turn = part(turns, row * 2 * sizes.angles, 2 * sizes.angles);
        norm_and_rotate(kernels, part_mut(values, 0, sizes.inner), key_norm, turn);
    });
}
